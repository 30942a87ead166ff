"""Compares robodyn with other engines: `make peers`.

Parts of one table, the same in bench/peers.json:

agreement  the largest difference over random states, relative to the size of the terms that are
           added up in what is compared (at most ROUNDING)
export     the same of the models that `robodyn export` writes, and of the constraints that close
           loops there; what these allow, as the README tells it
batch      inverse dynamics of the same states, closures opened; states a second, medians, in turn
ready      milliseconds before the first motion
motion     milliseconds for an error at the end, read off curves over tolerances as in `make bench`;
           the compiled Taylor engine must take at most BOUND times what heyoka's takes

An engine that cannot be imported is named, with the reason, and left out.  Exits 1 where a bound
is missed.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import import_module
from importlib.metadata import version
from statistics import median
from time import perf_counter
from timeit import timeit
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from bench_frontier import ROOT, Array, Curve, case, taylor
from rich.console import Console
from rich.progress import track
from rich.table import Table

import robodyn
from robodyn.assembly import loop_size
from robodyn.closed_form import closure_bias
from robodyn.description import from_text
from robodyn.errors import InputError
from robodyn.loop_rates import loop_accelerations, loop_velocities
from robodyn.mechanism import Mechanism, build

PEERS = {  # and their names on PyPI
    "mujoco": "mujoco",
    "pinocchio": "pin",
    "heyoka": "heyoka",
    "sympy": "sympy",
    "scipy": "scipy",
}
ROUNDING = 1e-13
BOUND = 3.0
WIDTH = 160
STATES, BATCH, TURNS, REPEATS = 200, 100_000, 5, 9
EXPORTED = (
    *("pendulum", "2r", "3r", "four-bar", "parallelogram", "slider-crank", "five-bar"),
    *("watt-six-bar", "stephenson-six-bar"),
)
RIG = """
gravity: [1.3, -9.6]
links:
  - {name: plate, m: 2.0, l: 0.5, r: [0.21, 0.13], I: 0.05, payload: 0.4, damping: 0.02}
  - {name: left, m: 0.5, l: 0.3, r: 0.14, I: 0.004, from: {link: plate, at: [0.3, 0.2]}}
  - {name: far hand, m: 0.6, l: 0.4, r: [-0.1, 0], I: 0.007, from: slide, damping: 0.3}
  - {name: slide, m: 0.7, l: 0.9, r: 0.4, I: 0.06, from: [0.4, -0.2], payload: 0.1}
"""
FORCES = """
springs:
  - {between: [far hand, [0.9, 0.5]], stiffness: 40, length: 0.3, damping: 2}
  - {between: [left, {link: slide, at: [0.1, 0.2]}], stiffness: 25, length: 0}
  - {joint: plate, stiffness: 5, angle: 0.4, damping: 0.3}
loads:
  - {link: slide, at: [0.5, 0.1], force: [3, -2]}
  - {link: left, at: [0.2, 0], force: [1, 4], frame: link}
  - {link: far hand, torque: 1.5}
"""
GEARS = {
    "rig, geared": """
couplings: ["q3 = -2 q1 + 0.1", "q2 = q4 - 1/3 q1"]
actuated: [plate, slide]
""",
    "rig, locked": """
couplings: q3 = 30deg
actuated: [plate, left, slide]
""",
    "rig, one gear": """
couplings: q2 = -2 q1 + 0.1  # Pinocchio forgets turns, which a fraction would not
actuated: [plate, far hand, slide]
""",
}
SOFT, SOFT_GEARS = 1e-5, 2e-4  # relative, of the accelerations that MuJoCo's constraints allow
PIN_MOTION, SLIDER_MOTION = (2e-5, 1e-6), (6e-3, 1e-4)  # rad and m, see ran in mujoco_peer
SOLVED = 1e-12  # relative, what the solver of its constraints leaves
TOLERANCES = (10.0 ** -np.arange(3.0, 15.01, 0.5)).tolist()
MOTIONS = (("2r-regular", 10.0), ("2r-chaotic", 10.0), ("four-bar", 5.0))
TARGETS = (1e-6, 1e-9, 1e-12)

States = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True)
class Row:
    """One line: what an engine needs or reaches, and robodyn; ratio: of seconds, ours / theirs."""

    part: str
    what: str
    engine: str
    theirs: float
    unit: str
    ours: float | None = None
    ratio: float | None = None
    bound: float | None = None

    @property
    def ok(self) -> bool | None:
        if self.bound is None:
            return None
        value = self.theirs if self.ratio is None else self.ratio
        return bool(value <= self.bound)


def motion_states(mechanism: Mechanism, count: int) -> States:
    """Random q, qd, qdd that keep the closures, of any size there."""
    free = np.random.default_rng(mechanism.n).normal(size=(3, count, len(mechanism.actuated)))
    if not mechanism.rows:
        return free[0] * 2.0, free[1], free[2]
    q = robodyn.assemble(mechanism, free[0] * 2.0)
    qd = loop_velocities(mechanism, q, free[1])
    return q, qd, loop_accelerations(mechanism, q, qd, free[2])


def opened(mechanism: Mechanism) -> Mechanism:
    """The tree of a mechanism, every joint actuated."""
    parts = replace(mechanism.description, closures=(), branches=(), actuated=None)
    return build(parts)


class Compared(NamedTuple):
    """What is compared: robodyn's values, what they are functions of, the size of their terms."""

    ours: Array
    arguments: tuple[Array, ...]
    terms: Array


def compared(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> dict[str, Compared]:
    M, C = robodyn.mass_matrix(mechanism, q), robodyn.coriolis_matrix(mechanism, q, qd)
    G = robodyn.gravity_vector(mechanism, q)
    rates, accelerations = qd[..., None], qdd[..., None]
    arrays = mechanism.arrays
    weight = arrays.J.T @ np.abs(mechanism.gamma * arrays.B)  # the largest that gravity makes G
    weight = np.maximum(weight, np.abs(G))  # springs may make it larger
    passing = (np.abs(C) @ np.abs(rates))[..., 0] + weight + np.abs(arrays.damping * qd)
    passing += np.abs(robodyn.other_forces(mechanism, q, qd))
    bias, T = (C @ rates)[..., 0] + G, freedoms(mechanism)
    torques = np.zeros_like(q)
    torques[..., list(mechanism.actuated)] = qdd[..., list(mechanism.actuated)]
    return {
        "M": Compared(M, (q,), M),
        "G": Compared(G, (q,), weight),
        "bias": Compared(bias, (q, qd), passing),
        "tau": Compared(
            robodyn.inverse_dynamics(mechanism, q, qd, qdd),
            (q, qd, qdd),
            passing + (np.abs(M) @ np.abs(accelerations))[..., 0],
        ),
        "qdd": Compared(
            robodyn.forward_dynamics(mechanism, q, qd, np.zeros_like(q)),
            (q, qd),
            (np.abs(np.linalg.inv(M)) @ passing[..., None])[..., 0],
        ),
        "M reduced": Compared(T.T @ M @ T, (q,), np.abs(T.T) @ np.abs(M) @ np.abs(T)),
        "bias reduced": Compared(bias @ T, (q, qd), passing @ np.abs(T)),
        "driven": Compared(  # qdd by torques of the actuated joints, of any size
            robodyn.forward_dynamics(mechanism, q, qd, torques),
            (q, qd, torques),
            (np.abs(np.linalg.inv(M)) @ (passing + np.abs(torques))[..., None])[..., 0],
        ),
    }


def freedoms(mechanism: Mechanism) -> Array:
    """T of qd = T ud, u the joints that no coupling gives, where couplings follow only those."""
    couplings = mechanism.description.couplings
    T = np.eye(mechanism.n)
    for coupling in couplings:
        T[coupling.joint, coupling.joint] = 0.0
        for k, ratio in coupling.terms:
            T[coupling.joint, k] = ratio
    return np.delete(T, [coupling.joint for coupling in couplings], axis=1)


def apart(known: Compared, function: Callable[..., Array]) -> float:
    """The largest difference of their values from ours, relative to the size of the terms."""
    theirs = np.array([np.array(function(*x)) for x in zip(*known.arguments, strict=True)])
    return worst(theirs - known.ours, known.terms)


def agreement(engines: dict[str, ModuleType]) -> Iterator[Row]:
    for scene in ("2r", "3r", "four-bar"):
        mechanism = robodyn.load(ROOT / f"robots/{scene}.yaml")
        known = compared(mechanism, *motion_states(mechanism, STATES))
        rows = []
        for name, engine in engines.items():
            try:
                terms = engine.terms(mechanism)
            except NotImplementedError:
                continue
            for term, function in terms.items():
                kind, _, remark = term.partition(", ")
                bound = None if remark else ROUNDING
                value = apart(known[kind], function)
                rows.append(Row("agreement", f"{scene}, {term}", name, value, "", bound=bound))
        yield from sorted(rows, key=lambda row: list(known).index(row.what.split(", ")[1]))


def exports(engines: dict[str, ModuleType]) -> Iterator[Row]:
    """The written models, loaded."""
    mechanisms = {name: robodyn.load(ROOT / f"robots/{name}.yaml") for name in EXPORTED}
    mechanisms["rig"] = build(from_text(RIG, "rig"))
    mechanisms["rig with springs and loads"] = build(from_text(RIG + FORCES, "rig"))
    mechanisms |= {name: build(from_text(RIG + text, name)) for name, text in GEARS.items()}
    geared = (ROOT / "robots/five-bar.yaml").read_text().replace(", right crank]", "]")
    mechanisms["five-bar, geared"] = build(from_text(geared + "couplings: q3 = -2 q1 + 0.1", ""))
    for scene, mechanism in mechanisms.items():
        q, qd, qdd = motion_states(mechanism, STATES)
        known = compared(mechanism, q, qd, qdd)
        for name, engine in engines.items():
            if not hasattr(engine, "exported"):
                continue
            try:
                model = engine.exported(mechanism)
            except InputError:  # what URDF cannot say
                continue
            terms = model.terms()
            value = max(apart(known[term], function) for term, function in terms.items())
            what = f"{scene}, {' '.join(terms)}"
            yield Row("export", what, f"{name}, exported", value, "", bound=ROUNDING)
            if mechanism.rows and name == "mujoco":
                yield from closed_exports(scene, mechanism, model, known)


def closed_exports(
    scene: str, mechanism: Mechanism, model: Any, known: dict[str, Compared]
) -> Iterator[Row]:
    """Constraints of a model against the closures, their forces, and what softness does.

    The forces f of the constraints obey, with the matrix R of MuJoCo's softness and the gains
    k and b with which it closes gaps,

        M qdd + C qd + D qd + G = Psi^T f        Psi qdd + Psidot qd + R f = -k gap - b Psi qd

    where Psidot qd is left out for tendons.  Near change points any softness shows.
    """
    q, qd = known["bias"].arguments
    found = [model.constraints(*state) for state in zip(q, qd, strict=True)]
    J, gap, force, R, closing, qdd = (np.array(part) for part in zip(*found, strict=True))
    slider = [row.closure in sliders(mechanism) for row in mechanism.rows]
    Psi, bias = robodyn.closure_jacobian(mechanism, q), closure_bias(mechanism, q, qd)
    bias[..., slider] = 0.0
    M, C = robodyn.mass_matrix(mechanism, q), robodyn.coriolis_matrix(mechanism, q, qd)
    damping = np.diag(mechanism.arrays.damping)
    motion = [product(M, qdd), product(C + damping, qd), robodyn.gravity_vector(mechanism, q)]
    forces = -product(np.swapaxes(Psi, -1, -2), force)
    size = np.full(len(q), loop_size(mechanism))
    hard = known["qdd"].ours
    soft = SOFT_GEARS if mechanism.description.couplings else SOFT
    rows = {
        "Psi and gap": (max(worst(J - Psi, Psi), worst(gap, size)), ROUNDING),
        "qdd and forces": (worst(sum(motion) + forces, *motion, forces), SOLVED),
        "softness": (
            worst(
                product(Psi, qdd) + bias + R * force - closing,
                product(np.abs(Psi), np.abs(qdd)),
                bias,
            ),
            SOLVED,
        ),
        "qdd of hard closures": (
            worst(qdd - hard, known["qdd"].terms),
            None if any(slider) or scene == "parallelogram" else soft,
        ),
    }
    for term, (value, bound) in rows.items():
        yield Row("export", f"{scene}, {term}", "mujoco, exported", value, "", bound=bound)
    for timestep, part in ((1e-3, 1.0), (1e-4, 0.02)):
        what = f"{scene}, 1 s in steps of {timestep:g} s"
        limits = SLIDER_MOTION if any(slider) else PIN_MOTION
        for value, unit, limit in zip(model.ran(timestep), ("rad", "m"), limits, strict=True):
            name = f"{what}, {'q' if unit == 'rad' else 'gap'}"
            yield Row("export", name, "mujoco, exported", value, unit, bound=limit * part)


def sliders(mechanism: Mechanism) -> set[int]:
    closures = enumerate(mechanism.description.closures)
    return {c for c, closure in closures if closure.along is not None}


def product(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]


def worst(differences: Array, *terms: Array) -> float:
    """The largest difference at a state (the first axis), relative to the size of the terms."""

    def largest(values: Array) -> Array:
        return np.abs(values).reshape(len(values), -1).max(axis=1)

    return float((largest(differences) / sum(largest(term) for term in terms)).max())


def batch(engines: dict[str, ModuleType]) -> Iterator[Row]:
    from bench import chain_text

    scenes = {
        "2R": robodyn.load(ROOT / "robots/2r.yaml"),
        "four-bar, opened": opened(robodyn.load(ROOT / "robots/four-bar.yaml")),
        "6R chain": build(from_text(chain_text(6), "6R")),
    }
    for what, tree in scenes.items():
        states = motion_states(tree, BATCH)
        ways: dict[str, Callable[[], Array]] = {
            "robodyn": partial(robodyn.inverse_dynamics, tree, *states)
        }
        for name, engine in engines.items():
            if hasattr(engine, "batches"):
                found = engine.batches(tree, *states)
                ways |= {f"{name} {how}": run for how, run in found.items()}
        tau = ways["robodyn"]()
        for run in ways.values():
            np.testing.assert_allclose(run(), tau, rtol=1e-10, atol=1e-10)
        turns = [[timeit(run, number=1) for run in ways.values()] for _ in range(TURNS)]
        ours, *theirs = (median(times) for times in zip(*turns, strict=True))
        for how, seconds in zip(list(ways)[1:], theirs, strict=True):
            rates = BATCH / seconds, "states/s", BATCH / ours
            yield Row("batch", f"inverse dynamics, {what}", how, *rates, ratio=ours / seconds)


def making_ready(engines: dict[str, ModuleType]) -> Iterator[Row]:
    """Before the first motion: heyoka compiles for a mechanism and a tolerance, robodyn loads."""
    for reference, time in MOTIONS[::2]:
        problem = case(reference, time)
        if reference == MOTIONS[0][0]:
            start = perf_counter()
            taylor(problem, "compiled", 1e-9)()
            what = "compiled engine, loaded once a process"
            yield Row("ready", what, "robodyn compiled", math.nan, "ms", milliseconds(start))
        if "heyoka" in engines:
            for tolerance in (1e-6, 1e-15):
                anew, cached = engines["heyoka"].ready_seconds(problem, tolerance)
                start = perf_counter()
                taylor(problem, "compiled", tolerance)
                ours = milliseconds(start)
                what = f"{reference}, ready for {tolerance:g}"
                yield Row("ready", what, "heyoka, compiled anew", 1e3 * anew, "ms", ours)
                yield Row("ready", what, "heyoka, from its cache", 1e3 * cached, "ms", ours)


def milliseconds(start: float) -> float:
    return 1e3 * (perf_counter() - start)


def motions(engines: dict[str, ModuleType]) -> Iterator[Row]:
    for reference, time in MOTIONS:
        problem = case(reference, time)
        curves = {
            f"robodyn {name}": Curve(problem, [taylor(problem, name, x) for x in TOLERANCES])
            for name in ("compiled", "python")
        }
        for name, engine in engines.items():
            try:
                found = engine.runs(problem, TOLERANCES) if hasattr(engine, "runs") else {}
            except NotImplementedError:
                continue
            curves |= {f"{name} {how}": Curve(problem, runs) for how, runs in found.items()}
        for curve in curves.values():
            curve.measure()
        for _ in range(REPEATS):
            for curve in curves.values():
                curve.turn()
        compiled = curves.pop("robodyn compiled")
        for target in TARGETS:
            ours = 1e3 * compiled.time(target)
            for name, curve in curves.items():
                theirs = 1e3 * curve.time(target)
                reached = np.isfinite(theirs)
                yield Row(
                    "motion",
                    f"{problem.name}, to {target:g}",
                    name,
                    theirs,
                    "ms",
                    ours,
                    ratio=ours / theirs if reached else None,
                    bound=BOUND if reached and name.startswith("heyoka") else None,
                )
        for name, curve in curves.items():
            best, ours = float(np.nanmin(curve.errors)), float(np.nanmin(compiled.errors))
            yield Row("motion", f"{problem.name}, error reached", name, best, "", ours)


def drawn(rows: list[Row], versions: dict[str, str]) -> Table:
    title = "robodyn beside " + ", ".join(f"{name} {text}" for name, text in versions.items())
    table = Table(title=title, caption="ratio: seconds of robodyn / seconds of theirs")
    for column in ("what", "engine"):
        table.add_column(column, no_wrap=True)
    for column in ("theirs", "robodyn", "", "ratio", "bound", "ok"):
        table.add_column(column, justify="right", no_wrap=True)
    before = rows[0]
    for row in rows:
        if row.part != before.part or row.what.split(", ")[0] != before.what.split(", ")[0]:
            table.add_section()
        before = row
        numbers = [row.theirs, row.ours, row.ratio, row.bound]
        shown = ["" if x is None else f"{x:.3g}" if np.isfinite(x) else "-" for x in numbers]
        verdict = {None: "", True: "yes", False: "MISSED"}[row.ok]
        table.add_row(row.what, row.engine, *shown[:2], row.unit, *shown[2:], verdict)
    return table


def finite(content: dict[str, Any]) -> dict[str, Any]:
    """With null for what is not reached, which JSON has no number for."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in content.items()
    }


def main() -> int:
    engines, versions, absent = {}, {}, {}
    for name, package in PEERS.items():
        try:
            engine, number = import_module(f"peers.{name}_peer"), version(package)
        except (ImportError, OSError) as error:
            absent[name] = f"{type(error).__name__}: {error}"
        else:
            engines[name], versions[name] = engine, number
    rows: list[Row] = []
    console = Console(stderr=True)
    parts = agreement, exports, batch, making_ready, motions
    for part in track(parts, "comparing", console=console, transient=True):
        rows += part(engines)
    Console(width=WIDTH).print(drawn(rows, versions))
    for name, reason in absent.items():
        print(f"absent: {name}, {reason}")
    target = ROOT / "bench" / "peers.json"
    target.parent.mkdir(exist_ok=True)
    content = {
        "cores": os.cpu_count(),
        "versions": versions,
        "absent": absent,
        "rows": [finite(asdict(row)) | {"ok": row.ok} for row in rows],
    }
    target.write_text(json.dumps(content, indent=2) + "\n")
    missed = [row for row in rows if row.ok is False]
    print(f"{len(missed)} of {sum(row.ok is not None for row in rows)} bounds missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
