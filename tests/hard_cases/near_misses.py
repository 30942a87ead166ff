"""Linkages that narrowly miss a change point: against mpmath, and motions in longdoubles."""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import mpmath as mp
import numpy as np

import robodyn
from hard_cases.many_digits import followed
from robodyn.engines import machine
from robodyn.loops.change_points import nearness
from robodyn.loops.closing import loop_size
from robodyn.loops.closures import closure_jacobian
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs import benchmark
from robodyn.runs.report import Report
from robodyn.runs.settings import METHODS
from robodyn.runs.simulation import simulate
from robodyn.scene.description import from_text
from robodyn.sweeps.sweep_chunks import run_chunk
from robodyn.sweeps.sweep_plan import Axis, Plan, Variation

Options = Mapping[str, object]
Command = Callable[..., tuple[str, str]]  # stdout, stderr of its arguments, and of `stdin`

EPS = float(np.finfo(float).eps)
BARS = """gravity: 9.81
links:
  - {{name: a, m: 0.45, l: {a!r}, r: 0.14, I: 0.0041}}
  - {{name: b, m: 1.1, l: {b!r}, r: 0.36, I: 0.049, from: a}}
  - {{name: c, m: 0.55, l: {c!r}, r: 0.16, I: 0.0052, from: [{d!r}, 0]}}
closures: [[b, c]]
actuated: [a]
"""
CRANK = """gravity: 9.81
links:
  - {{name: a, m: 0.45, l: 0.3, r: 0.14, I: 0.0041}}
  - {{name: b, m: 1.1, l: {b!r}, r: 0.16, I: 0.049, from: a}}
closures: [{{point: b, on: {{through: [0, 0], along: [1, 0]}}}}]
actuated: [a]
assembly: open
"""
WATT = """gravity: 9.81
links:
  - {{name: crank, m: 0.5, l: 0.375, r: 0.1, I: 0.0024}}
  - {{name: coupler, m: 1.7, l: 0.8125, r: [0.31, 0.09], I: 0.052, from: crank}}
  - {{name: rocker, m: 1.4, l: 0.5625, r: [0.44, -0.06], I: 0.043, from: [{d!r}, 0]}}
  - {{name: rod, m: 0.8, l: 0.66, r: 0.32, I: 0.034, from: {{link: coupler, at: [0.2, 0.3]}}}}
  - {{name: output, m: 0.6, l: 0.45, r: 0.21, I: 0.0115, from: {{link: rocker, at: [0.75, -0.2]}}}}
closures: [[coupler, rocker], [rod, output]]
actuated: [crank]
assembly: [open, open]
"""


MISSES = (1e-14, 1e-13, 1e-12, 1e-9, 1e-6, 1e-3, -1e-12, -1e-6)  # m; negative: too short
ROUNDING = (0.0, 2.0, -3.0)  # eps L
BESIDE = (0.03, 0.01, 1e-3, 1e-5, 1e-7)  # rad, from the near miss
THROUGH = 1e-5  # s/L that a motion right through a change point, where it vanishes, is held to
ABOUT = 0.01  # rad from the near miss: states of commands
COMMANDS = ("accel", "torque", "trajectory", "DOP853", "taylor", "sweep")
UNITS = "error / eps (w^2 + |qdd|)/(s/L)^2"
FAR = 0.02  # rad from a change point: a miss of rounding may count
BATCH = 200  # states, which go another way than one
TIGHT: dict[str, Options] = {
    "taylor": {"method": "taylor", "rtol": 1e-14, "atol": 1e-14},
    "DOP853": {"method": "DOP853", "rtol": 1e-13, "atol": 1e-13},
    "RK45": {"method": "RK45", "rtol": 1e-12, "atol": 1e-12},
    "Radau": {"method": "Radau", "rtol": 1e-11, "atol": 1e-11},
}
SWEPT = ("sweep",) if machine.available() else ()
WAYS = (*(way for way in TIGHT if machine.available() or way != "taylor"), *SWEPT)
# what these miss of any motion, at such tolerances
OWN = {"DOP853": 2e-11, "RK45": 1e-9, "Radau": 1e-8}


class Case(NamedTuple):
    """A linkage, and a motion past its near miss; angles and rates of the actuated joints."""

    make: Callable[[float], Case]  # of a miss
    name: str
    miss: float  # m; where it is negative cranks turn back
    scene: str  # its text
    near: tuple[float, ...]  # where it all but is singular
    aside: tuple[float, ...]  # the way there
    start: tuple[float, ...]
    rates: tuple[float, ...]
    time: float

    @property
    def mechanism(self) -> Mechanism:
        return _built(self.scene, self.name)

    @property
    def meant(self) -> Case:
        """What is right: of a miss of rounding, with one freedom, the change point itself."""
        rounding = 0.0 < abs(self.miss) <= 4.0 * EPS * loop_size(self.mechanism)
        return self.make(0.0) if rounding and len(self.near) == 1 else self


@lru_cache(maxsize=256)
def _built(text: str, name: str) -> Mechanism:
    return build(from_text(text, name))


def parallelogram(miss: float) -> Case:
    text = BARS.format(a=0.3, b=0.7, c=0.3, d=0.7 + miss)
    return Case(parallelogram, "parallelogram", miss, text, (0.0,), (1.0,), (0.5,), (-5.0,), 0.2)


def generic(miss: float) -> Case:
    """The longest and the shortest bar as long as the other two, but for the miss."""
    text = BARS.format(a=0.375, b=0.8125, c=0.5625, d=0.625 + miss)
    return Case(generic, "four-bar", miss, text, (0.0,), (1.0,), (0.5,), (-5.0,), 0.2)


def slider_crank(miss: float) -> Case:
    """A rod as long as the crank: it can stay at the pivot, or turn with the crank."""
    text = CRANK.format(b=0.3 + miss)
    return Case(
        slider_crank, "slider-crank", miss, text, (np.pi / 2,), (-1.0,), (1.2,), (5.0,), 0.2
    )


def watt(miss: float) -> Case:
    """The four-bar as the first loop of a six-bar."""
    text = WATT.format(d=0.625 + miss)
    return Case(watt, "Watt six-bar", miss, text, (0.0,), (1.0,), (0.5,), (-5.0,), 0.2)


def five_bar(miss: float) -> Case:
    """Two freedoms: its bars can all but lie in one line."""
    lengths = (0.375, 0.5, 0.625, 0.25)
    names = ("a", "b", "c", "d")
    hangs = ("[0, 0]", "a", f"[{0.5 + miss!r}, 0]", "c")
    links = [
        f"{{name: {k}, m: {1 + l}, l: {l}, r: {l / 2}, I: {l / 9}, from: {h}}}"
        for k, l, h in zip(names, lengths, hangs, strict=True)
    ]
    text = f"gravity: 9.81\nlinks: [{', '.join(links)}]\nclosures: [[b, d]]\nactuated: [a, c]\n"
    way = (0.0, 0.0), (0.2, 1.0), (0.08, 0.4), (-0.8, -4.0)
    return Case(five_bar, "five-bar", miss, text, *way, 0.2)


def four_bars(count: int, miss: float) -> Case:
    """The N-four-bar, half as wide again as it is high, of pivots that are too far apart."""
    pivots = [1.5 * k + 0.5 * k * (k + 1) * miss for k in range(count + 1)]
    bar, wide = "m: 1, l: 1, r: 0.5, I: 0.083", "m: 1.5, l: 1.5, r: 0.75, I: 0.28"
    links = [f"{{name: v{k}, {bar}, from: [{x!r}, 0]}}" for k, x in enumerate(pivots)]
    links += [f"{{name: h{k}, {wide}, from: v{k}}}" for k in range(count)]
    closures = ", ".join(f"[h{k}, v{k + 1}]" for k in range(count))
    text = f"gravity: 9.81\nlinks: [{', '.join(links)}]\nclosures: [{closures}]\n"
    text += "actuated: [v0]\n"
    make = {2: two_four_bars, 5: five_four_bars}[count]
    name = f"{count}-four-bar"
    return Case(make, name, miss, text, (0.0,), (1.0,), (0.5,), (-5.0,), 0.2)


def two_four_bars(miss: float) -> Case:
    return four_bars(2, miss)


def five_four_bars(miss: float) -> Case:
    return four_bars(5, miss)


MAKERS = (
    parallelogram, generic, slider_crank, five_bar, watt, two_four_bars, five_four_bars,
)  # fmt: skip


# -- states ---------------------------------------------------------------------------------------


def exact_state(
    mechanism: Mechanism,
    q: np.ndarray,
    rates: Sequence[float],
    tau: float,
    given: Sequence[float] | None = None,
) -> list[np.ndarray]:
    """q, qd, qdd under torques; that of `given` or steady cranks, their torques."""
    found = exact_values(mechanism, q, rates, tau, given)
    return [np.array([float(mp.re(v)) for v in values]) for values in found]


def exact_values(
    mechanism: Mechanism,
    q: np.ndarray,
    rates: Sequence[float],
    tau: float = 0.0,
    given: Sequence[float] | None = None,
) -> tuple[Sequence[mp.mpf], ...]:
    """The same in 60 digits."""
    n, arrays = mechanism.n, mechanism.arrays
    driven = list(mechanism.actuated)
    passive = list(mechanism.passive)
    with mp.workdps(60):

        def matrix(values: np.ndarray) -> mp.matrix:
            return mp.matrix([[mp.mpmathify(complex(x)) for x in row] for row in values])

        J, A, P = (matrix(x) for x in (arrays.J, arrays.A, arrays.P))
        rows = range(P.rows)

        def part(values: mp.matrix, columns: Sequence[int]) -> mp.matrix:
            return mp.matrix([[values[i, k] for k in columns] for i in rows])

        def loop(q: mp.matrix) -> tuple[list, mp.matrix, mp.matrix]:
            E = [mp.expj(x.real) for x in J * q]
            gap = [sum((P[r, k] * E[k]).real for k in range(n)) + arrays.offset[r] for r in rows]
            Psi = mp.matrix([[-(P[r, k] * E[k]).imag for k in range(n)] for r in rows]) * J
            return E, mp.matrix(gap), Psi

        def follow(Psi: mp.matrix, values: Sequence[float], bias: mp.matrix) -> mp.matrix:
            found = mp.matrix(n, 1)
            for k, value in zip(driven, values, strict=True):
                found[k] = mp.mpf(value)
            others = mp.lu_solve(part(Psi, passive), -(Psi * found + bias))
            for i, k in enumerate(passive):
                found[k] = others[i]
            return found

        x = mp.matrix([mp.mpf(float(v)) for v in q])
        for _ in range(60):
            E, gap, Psi = loop(x)
            step = mp.lu_solve(part(Psi, passive), gap)
            for i, k in enumerate(passive):
                x[k] -= step[i].real
            if mp.norm(step) < mp.mpf(10) ** -45:
                break
        E, gap, Psi = loop(x)
        qd = follow(Psi, rates, mp.matrix(P.rows, 1))
        w = J * qd
        W = mp.matrix([[mp.conj(E[j]) * A[j, k] * E[k] for k in range(n)] for j in range(n)])
        M = J.T * W.apply(mp.re) * J
        bias = mp.matrix([-sum((P[r, k] * E[k]).real * w[k] ** 2 for k in range(n)) for r in rows])
        weights = [mp.mpmathify(complex(v)) for v in arrays.weights]
        turning = [sum(W[j, k].imag * w[k] ** 2 for k in range(n)) for j in range(n)]
        force = J.T * mp.matrix([turning[j] - (weights[j] * E[j]).imag for j in range(n)])
        K = mp.matrix(n + P.rows, n + P.rows)
        right = mp.matrix(n + P.rows, 1)
        for i in range(n):
            right[i] = force[i] + (tau if i in driven else 0)
            for j in range(n):
                K[i, j] = M[i, j]
            for j in rows:
                K[i, n + j], K[n + j, i] = -Psi[j, i], Psi[j, i]
        for j in rows:
            right[n + j] = -bias[j]
        qdd = mp.lu_solve(K, right)[:n]
        steady = follow(Psi, [0.0] * len(driven) if given is None else given, bias)
        load = M * steady - force
        lam = mp.lu_solve(part(Psi, passive).T, mp.matrix([load[k] for k in passive]))
        torque = [load[k] - sum(Psi[j, k] * lam[j] for j in rows) for k in driven]
        return x, qd, qdd, steady, torque


def off(
    mechanism: Mechanism,
    q: np.ndarray,
    qd: np.ndarray,
    found: np.ndarray,
    exact: np.ndarray,
    beside: np.ndarray | float = 0.0,
) -> float:
    """What `found` misses `exact` by, in eps (w^2 + |qdd|)/(s/L)^2; `beside` it counts too."""
    Psi = closure_jacobian(mechanism, q, t=0.0)
    if len(mechanism.actuated) > 1:  # two cranks may be at a dead centre where Psi is regular
        Psi = Psi[:, list(mechanism.passive)]
    size = np.abs(qd).max() ** 2 + np.abs(exact).max() + np.abs(beside).max()
    error = np.abs(found - exact).max() / size * float(nearness(mechanism, Psi)) ** 2 / EPS
    return float(np.nan_to_num(error, nan=np.inf))


def state_error(
    case: Case, beside: float, tau: float = 1.5, batches: Sequence[int] = (1, BATCH)
) -> float:
    """What `accel` and `torque` miss `beside` the near miss, of one state, and of a batch.

    Of a miss of rounding either the change point counts or, where that is far, what is given.
    """
    mechanism, rates = case.mechanism, case.rates
    driven = list(mechanism.actuated)
    q = robodyn.assemble(mechanism, np.array(case.near) + beside * np.array(case.aside))
    references = {case.meant.mechanism, mechanism} if beside > FAR else {case.meant.mechanism}
    known = [exact_state(each, q, rates, tau)[1:] for each in references]
    applied = np.zeros(mechanism.n)
    applied[driven] = tau
    worst = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for many in batches:
            states = np.tile(q, (many, 1))
            moving = robodyn.loop_velocities(mechanism, states, np.tile(rates, (many, 1)))
            held = robodyn.loop_accelerations(
                mechanism, states, moving, np.zeros((many, len(driven)))
            )
            found = robodyn.forward_dynamics(mechanism, states, moving, np.tile(applied, (many, 1)))
            needed = robodyn.inverse_dynamics(mechanism, states, moving, held)
            errors = []
            for qd, qdd, steady, torque in known:
                each = (found, qdd), (held, steady, torque), (needed[:, driven], torque, steady)
                errors.append(max(off(mechanism, q, qd, *values) for values in each))
            worst = max(worst, min(errors))
    return worst


# -- commands -------------------------------------------------------------------------------------


def by_commands(
    case: Case, folder: Path, command: Command, names: Sequence[str] = COMMANDS
) -> Iterator[tuple[str, str, float, float]]:
    """Of each command its name, a measure, what is found, and its bound.

    Torques are also those along what `trajectory` writes; motions at default tolerances need only
    stay on their branch.  At last, how many commands say the wrong thing of the miss.
    """
    mechanism, known = case.mechanism, case.meant.mechanism
    driven, size = list(mechanism.actuated), loop_size(case.mechanism)
    path = folder / "near.yaml"
    path.write_text(case.scene)
    narrow, wrong, out = 4.0 * EPS * size < abs(case.miss) <= 1e4 * EPS * size, 0, ""

    def run(name: str, *options: str) -> dict[str, np.ndarray]:
        """The columns of its table, which the next command may read."""
        nonlocal wrong, out
        out, told = command(name, path, *options, stdin=out)
        wrong += ("misses a change point by" in told) is not narrow
        rows = list(csv.DictReader(io.StringIO(out)))
        columns = [k for k in rows[0] if k != "outcome"]
        return {k: np.array([float(row[k] or "nan") for row in rows]) for k in columns}

    def joints(found: dict[str, np.ndarray], name: str, end: str = "") -> np.ndarray:
        return np.stack([found[f"{name}{k + 1}{end}"] for k in range(mechanism.n)], axis=1)

    def torques(found: dict[str, np.ndarray]) -> np.ndarray:
        return np.stack([found[f"tau{k + 1}"] for k in driven], axis=1)

    def given(**values: Sequence[float]) -> list[str]:
        return [
            f"--{k.strip('_')}={','.join(repr(float(x)) for x in v)}" for k, v in values.items()
        ]

    def vary(crank: Sequence[float]) -> str:
        return f"--vary=q{driven[0] + 1}={float(crank[0])!r}"

    ends = [np.array(case.near) + x * np.array(case.aside) for x in (ABOUT, 10.0 * ABOUT)]
    state, none = given(q=ends[0], qd=case.rates), [0.0] * len(driven)
    try:
        q = robodyn.assemble(mechanism, ends[0])
    except robodyn.AssemblyError:  # out of reach
        names = names[3:]
    else:
        q, qd, qdd, steady, torque = exact_state(known, q, case.rates, 1.5)
    if "accel" in names:
        found = run("accel", *state, *given(tau=[1.5] * len(driven)))
        yield "accel", UNITS, off(mechanism, q, qd, joints(found, "qdd"), qdd), 100.0
    if "torque" in names:
        for name, *more in (("torque",), ("sweep", vary(ends[0]), "--kind=torque")):
            found = run(name, *more, *state, *given(qdd=none))
            worst = off(mechanism, q, qd, torques(found), torque, steady)
            yield " ".join([name, *more[1:]]), UNITS, worst, 100.0
    if "trajectory" in names:
        time = float(np.abs(ends[1] - ends[0]).max() / np.abs(case.rates).max())
        found = run("trajectory", *given(_from=ends[1], to=ends[0], time=[time]), "--points=5")
        rows = [*(joints(found, name) for name in ("q", "qd", "qdd")), torques(run("torque", "-"))]
        worst = 0.0
        for q, qd, qdd, tau in [*zip(*rows, strict=True)][1:-1]:
            *_, right, torque = exact_state(known, q, qd[driven], 0.0, qdd[driven])
            worst = max(worst, off(mechanism, q, qd, qdd, right))
            worst = max(worst, off(mechanism, q, qd, tau, torque, right))
        yield "trajectory | torque", UNITS, worst, 100.0
    motion = [*given(q=case.start, qd=case.rates, time=[case.time])]
    for name in names:
        if name in METHODS:
            found = joints(run("simulate", *motion, f"--method={name}", "--points=2"), "q")
        elif name == "sweep":
            found = joints(run("sweep", vary(case.start), *motion), "q", "_end")
        else:
            continue
        error = np.abs(found[-1] - exact_motion(case.meant, False).end[: mechanism.n]).max()
        what = name if name == "sweep" else f"simulate --method {name}"
        yield what, "error of q at the end: the branch, rad", np.nan_to_num(error, nan=1.0), 1e-4
    yield "all commands", "say wrongly that they miss a change point", float(wrong), 0.0


# -- motions --------------------------------------------------------------------------------------


def start(case: Case) -> np.ndarray:
    q = robodyn.assemble(case.mechanism, case.start)
    return np.concatenate([q, robodyn.loop_velocities(case.mechanism, q, case.rates)])


class Exact(NamedTuple):
    """The state at the end, how sure it is, and s/L and qdd on the way."""

    end: np.ndarray
    uncertainty: float
    nearest: float


@lru_cache(maxsize=64)
def exact_motion(case: Case, sure: bool = True) -> Exact:
    """By two computations, or where it need not be `sure` by one of the two."""
    mechanism = case.mechanism
    given = mechanism, start(case), np.array([case.time]), Actuation((0.0,) * mechanism.n)
    if case.miss == 0.0 and len(case.near) == 1:  # next to the change point longdoubles are too few
        state = exact_values(mechanism, robodyn.assemble(mechanism, case.start), case.rates)[:2]
        end = followed(mechanism, *([mp.re(v) for v in values] for values in state), case.time)
        found = benchmark.Reference(np.array([[float(v) for v in end]]), 0.0)
    else:
        orders = (30, 21) if sure else (30,)
        both = [benchmark.followed(*given, order, 0.1)[-1] for order in orders]
        apart = float(np.abs(both[0] - both[-1]).max())
        found = benchmark.Reference(both[0].astype(float)[None], apart)
    motion = simulate(mechanism, *np.split(start(case), 2), case.time, **TIGHT["taylor"])
    nearest = motion.report.nearest_singular
    assert nearest is not None
    return Exact(found.y[-1], found.uncertainty, nearest)


def run(case: Case, **options: object) -> tuple[np.ndarray, Report]:
    """The state at the end, nan where the motion does not get there, and what is told of it."""
    motion = simulate(case.mechanism, *np.split(start(case), 2), case.time, **options)  # type: ignore[arg-type]
    end = np.concatenate([motion.q[-1], motion.qd[-1]])
    return (end if motion.t[-1] == case.time else end * np.nan), motion.report


def swept(case: Case, tolerance: float) -> np.ndarray:
    """The same of a sweep's only point."""
    mechanism = case.mechanism
    joint = mechanism.actuated[0]
    variation = Variation((Axis(f"q{joint + 1}", case.start[:1]),))
    plan = Plan(
        case.scene,
        case.name,
        variation,
        case.start,
        case.rates,
        (0.0,) * len(case.start),
        t_end=case.time,
        results=("final",),
        rtol=tolerance,
        atol=tolerance,
        method="taylor",
    )
    values = run_chunk(plan, 0).values[0]
    end = values[-2 * mechanism.n :]
    return end if values[-2 * mechanism.n - 1] == case.time else end * np.nan


def motion_error(case: Case, way: str, sure: bool = True) -> tuple[float, float]:
    """What a motion misses at its end, and 2,000 eps L/s of s on the way."""
    exact = exact_motion(case.meant, sure)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if way in TIGHT:
            end, _ = run(case, **TIGHT[way])
        else:
            end = swept(case, 1e-14)
    error = float(np.abs(end - exact.end).max())
    near = exact.nearest if case.meant.miss else min(exact.nearest, THROUGH)
    bound = 2000.0 * EPS / near + exact.uncertainty
    return np.nan_to_num(error, nan=np.inf), bound + OWN.get(way, 0.0)


def cases(
    make: Callable[[float], Case], misses: Sequence[float], rounding: Sequence[float] = ROUNDING
) -> Iterator[Case]:
    """Those of misses in m, and of some of rounding, in eps L of the loop that misses by most."""
    unit = EPS * loop_size(make(0.0).mechanism)
    most = len(make(0.0).mechanism.rows) / 2 if "-four-bar" in make(0.0).name else 1.0
    yield from map(make, (*(factor * unit / most for factor in rounding), *misses))


def states(
    misses: Sequence[float] = MISSES, rounding: Sequence[float] = ROUNDING
) -> Iterator[tuple[str, float]]:
    """Of each linkage the worst of several states, of `accel` and `torque`."""
    for make in MAKERS:
        for case in cases(make, misses, rounding):
            found = []
            for beside in BESIDE:
                # at a change point states go one by one, and 200 of them take seconds
                batches = (1, BATCH) if case.meant.miss or beside == ABOUT else (1,)
                # out of reach, or so little that neither way finds a closed state
                with suppress(robodyn.AssemblyError, robodyn.SingularError, ZeroDivisionError):
                    found.append(state_error(case, beside, batches=batches))
            if found:
                yield f"{case.name}, misses by {case.miss:.2g} m", max(found)


def commands(
    command: Command, misses: Sequence[float] = MISSES
) -> Iterator[tuple[str, str, float, float]]:
    """Each linkage by each command: what, measure, what is found, and bound."""
    with TemporaryDirectory() as folder:
        for make in MAKERS:
            for case in cases(make, misses):
                for name, *found in by_commands(case, Path(folder), command):
                    yield f"{case.name}, misses by {case.miss:.2g} m, {name}", *found


def motions(
    misses: Sequence[float] = MISSES, ways: Sequence[str] = WAYS
) -> Iterator[tuple[str, float, float]]:
    """Each linkage, by each way of integration, past its near miss: error and bound."""
    for make in MAKERS:
        for case in cases(make, misses):
            for way in ways:
                found, bound = motion_error(case, way)
                yield f"{case.name}, misses by {case.miss:.2g} m, {way}", found, bound
