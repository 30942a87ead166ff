"""`robodyn check`: what was read from a scene, what it is, and whether the identities hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import typer

from robodyn.cli.options import Model, Out, OutputStructured
from robodyn.cli.output import Grid, degrees, in_told_units, note, write_structure
from robodyn.cli.progress import progress
from robodyn.cli.states import overflow, remarks
from robodyn.dynamics import closed_form
from robodyn.dynamics.identities import BOUND, Identity, Sample, identities, sample_states
from robodyn.errors import InputError
from robodyn.loops import assembly
from robodyn.mechanics.loop_rows import loop_class
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import Mode, in_mode
from robodyn.pictures.column_units import DEGREES, IN_DEGREES, TURNING, in_degrees, scene_units
from robodyn.scene.grammar import Form, form_of
from robodyn.scene.scene import (
    FRAMES,
    JOINTS,
    Coupling,
    JointSpring,
    Moment,
    Point,
    Signal,
    Table,
    told,
)

STATES = 200
OF_JOINTS = {"min": "rad", "max": "rad", "speed": "rad/s", "stribeck": "rad/s"}  # which turn
ENTRIES = 1_000_000  # of M over all sampled states: memory and time stay small in long chains


def check(model: Model, format: OutputStructured = None, out: Out = None) -> None:
    """What was read from a scene, and a self-test.

    Links, mobility, loop classes, and how well M and Psi are conditioned.

    The self-test evaluates the identities that every mechanism must keep (Mdot - 2C skew,
    G = dPE/dq, power in = dE/dt, ...) at random closed states and tells their residuals,
    relative to the size of the terms.  Exit code 1 if one does not hold, or M is singular.

    \b
    Examples:
      robodyn check four-bar
      robodyn check 2r --format json
    """
    mechanism = model.load()
    free = in_mode(mechanism, Mode()) if mechanism.switches else mechanism
    unknown = False
    try:
        count = max(2, min(STATES, ENTRIES // mechanism.n**2))
        with remarks(), progress("closing") as watch:
            sample = sample_states(mechanism, count, watch)
    except InputError as error:
        unknown = True
        note(f"Note: no self-test over closed states: {error}")
        sample = Sample(np.zeros((0, mechanism.n)), np.zeros((0, mechanism.n)), 0.0)
    try:
        with remarks():
            results = identities(free, sample) if len(sample.q) else []
    except InputError:  # a state of ours left the range of numbers
        raise overflow() from None
    singular = next((item.reason for item in results if item.reason), None)
    content: dict[str, Any] = {
        "name": mechanism.name,
        "gravity": [mechanism.gamma.real, mechanism.gamma.imag],
        "links": [_link(mechanism, k) for k in range(mechanism.n)],
        **_forces(mechanism),
        "actuated": [mechanism.link_names[k] for k in mechanism.actuated],
        "loops": [loop_class(mechanism, c) for c in range(len(mechanism.description.closures))],
        **_conditioning(mechanism, sample),
        "states": len(sample.q),
        "closing": sample.closing if mechanism.rows else None,
        "identities": {item.name: item.residual for item in results},
        "singular": singular,
        "bound": BOUND,
        "passed": all(item.holds for item in results) if results else None,
    }
    write_structure(format, out, content, lambda: _tables(mechanism, content, results))
    if mechanism.rows and sample.closing == 0.0 and not len(sample.q) and not unknown:
        note("Error: the loops close at none of the random positions of the actuated joints")
        raise typer.Exit(1)
    failed = [item.name for item in results if not item.holds and not item.reason]
    if singular is not None:
        note(f"Error: M is singular: {singular}")
    if failed:
        note(f"Error: does not hold to {BOUND:g}: {'; '.join(failed)}")
    if failed or singular is not None:
        raise typer.Exit(1)


def _link(mechanism: Mechanism, k: int) -> dict[str, Any]:
    """A link, key by key."""
    link = mechanism.description.links[k]
    found = _as_written(mechanism, link, link.slides)
    first = {"name": found.pop("name")}
    if link.slides:
        first |= {"joint": JOINTS[1], "axis": found.pop("axis")}
    units = TURNING if link.slides else OF_JOINTS
    inner = {x: found.pop(x, None) for x in ("friction", "limits")}
    motor = {"motor": found.pop("motor")} if link.motor is not None else {}
    return {**first, **found, **in_told_units(inner, units), **in_told_units(motor, OF_JOINTS)}


def _as_written(mechanism: Mechanism, item: Any, slides: bool = False) -> dict[str, Any]:
    """What a link or its joint has, key by key, as its scene writes it."""
    keys = {"low": "min", "high": "max", "hangs_from": "from"}
    keys |= {"torque": "force"} if slides else {}
    found: dict[str, Any] = {}
    for name, x in item._asdict().items():
        match x:
            case Point():
                x = _place(mechanism, x)
            case complex():
                x = [x.real, x.imag]
            case tuple():
                x = _as_written(mechanism, x, slides)
        if x is not None:
            found[keys.get(name, name)] = x
    return found


def _shown(number: float, signal: Signal | None) -> Any:
    """A load as the scene writes it."""
    if not isinstance(signal, Table):
        return number if signal is None else signal.text
    over = signal.over if signal.over == "t" else f"q{int(signal.over[1:]) + 1}"
    return {"table": signal.file, "over": over, "column": signal.column}


def _forces(mechanism: Mechanism) -> dict[str, list[Any]]:
    """Springs, loads and couplings as the scene writes them; nothing where it has none."""
    names, found = mechanism.link_names, mechanism.description
    lists: dict[str, list[Any]] = {"springs": [], "loads": []}
    for spring in found.springs:
        values: dict[str, Any] = {"stiffness": spring.stiffness, "damping": spring.damping}
        if spring.law is not None:
            key = "table" if isinstance(spring.law, Table) else "law"
            values = {key: told(spring.law), "damping": spring.damping}
        if isinstance(spring, JointSpring):
            free = "length" if spring.joint in mechanism.slides else "angle"
            values = {"joint": names[spring.joint], free: spring.angle} | values
        else:
            ends = [_place(mechanism, point) for point in (spring.first, spring.second)]
            values = {"between": ends, "length": spring.length} | values
        lists["springs"].append(values)
    for item in found.loads:
        if isinstance(item, Moment):
            torque = _shown(item.torque, item.varying)
            lists["loads"].append({"link": names[item.link], "torque": torque})
        else:
            parts = zip((item.force.real, item.force.imag), item.varying, strict=True)
            place, force = _place(mechanism, item.point), [_shown(*part) for part in parts]
            frame = FRAMES[1] if item.turns else FRAMES[0]
            lists["loads"].append({"at": place, "force": force, "frame": frame})
    lists["couplings"] = [_equation(mechanism, coupling) for coupling in found.couplings]
    return dict(in_told_units({key: entries for key, entries in lists.items() if entries}))


def _place(mechanism: Mechanism, point: Point) -> str:
    at = f"({point.at.real:g}, {point.at.imag:g})"
    return f"ground {at}" if point.link is None else f"{mechanism.link_names[point.link]} {at}"


def _equation(mechanism: Mechanism, coupling: Coupling, digits: int = 17) -> str:
    """q3 = -2 q1 + 0.1"""
    joint, angle = f"q{coupling.joint + 1}", f"{coupling.angle:+.{digits}g}"
    if degrees.get() and (factor := in_degrees(joint, scene_units(mechanism))[1]) != 1.0:
        angle = f"{factor * coupling.angle:+.{digits}g} deg"
    parts = [f"{ratio:+.{digits}g} q{k + 1}" for k, ratio in coupling.terms]
    if coupling.angle or not parts:
        parts.append(angle)
    later = "".join(f" {part[0]} {part[1:]}" for part in parts[1:])
    return f"{joint} = {parts[0].removeprefix('+')}{later}"


def _conditioning(mechanism: Mechanism, sample: Sample) -> dict[str, object]:
    """Mobility, and the range of the condition numbers of M and Psi over the sample."""
    q = sample.q
    if not len(q):
        return {"mobility": None, "cond_M": None, "cond_Psi": None}
    sizes = np.abs(np.linalg.eigvalsh(closed_form.mass_matrix(mechanism, q)))
    with np.errstate(divide="ignore", invalid="ignore"):
        cond_M = sizes.max(axis=-1) / sizes.min(axis=-1)
    mobility, cond_Psi = mechanism.n, None
    if mechanism.rows:
        s = np.linalg.svd(closed_form.scaled_jacobian(mechanism, q), compute_uv=False)
        rank = int((s > assembly.CLOSED * s[..., :1]).sum(axis=-1).max())
        mobility, cond_Psi = mechanism.n - rank, _span(s[:, 0] / s[:, rank - 1])
        if rank < len(mechanism.rows):
            note(f"Note: {len(mechanism.rows) - rank} of the closures' equations are redundant")
    return {"mobility": mobility, "cond_M": _span(cond_M), "cond_Psi": cond_Psi}


def _span(values: np.ndarray) -> list[float | None]:
    """The least and the largest value; None for infinity, which JSON does not know."""
    return [float(x) if np.isfinite(x) else None for x in (values.min(), values.max())]


def _tables(mechanism: Mechanism, content: dict[str, Any], results: list[Identity]) -> list[Grid]:
    facts = [["gravity", "({:g}, {:g}) m/s²".format(*content["gravity"])]]
    facts.append(["actuated", ", ".join(content["actuated"]) or "no joint"])
    facts.append(["mobility", str(content["mobility"])])
    for k, coupling in enumerate(mechanism.description.couplings, start=1):
        facts.append([f"coupling {k}", _equation(mechanism, coupling, 6)])
    facts += [[f"loop {c}", kind] for c, kind in enumerate(content["loops"], start=1)]
    for key, label in (("cond_M", "condition of M"), ("cond_Psi", "condition of Psi")):
        if content[key]:
            span = ["infinite" if x is None else f"{x:.3g}" for x in content[key]]
            facts.append([label, " to ".join(span)])
    if content["closing"] is not None:
        facts.append(["closes at", f"{100 * content['closing']:.0f} % of positions"])
    proof = []
    for item in results:
        verdict = ["", "M is singular"]
        if item.residual is not None:
            verdict = [f"{item.residual:.1e}", "holds" if item.holds else "FAILS"]
        proof.append([item.name, *verdict])
    title = f"identities at {content['states']} random states (bound {BOUND:g})"
    forces = [_listed(kind, content.get(f"{kind}s", [])) for kind in ("spring", "load")]
    return [
        _listed("link", content["links"])._replace(title=mechanism.name),
        *(table for table in forces if table.rows),
        Grid(["", ""], facts),
        Grid(["identity", "residual", ""], proof, title),
    ]


def _listed(what: str, entries: Sequence[Mapping[str, Any]]) -> Grid:
    """Entries of the scene, one a row; units by the grammar, of each value where they differ."""
    keys = (x for x in dict.fromkeys(chain(*entries)) if x != "name")
    names = [x for x in keys if any(entry.get(x) for entry in entries)]
    forms = [form_of(what, [x.removesuffix(IN_DEGREES) for x in entry]) for entry in entries]
    pairs = list(zip(forms, entries, strict=True))
    units = {x: {_unit(form, x) for form, entry in pairs if entry.get(x)} for x in names}
    plain = {x: x.removesuffix(IN_DEGREES) for x in names}
    heads = [plain[x] + (f" [{min(units[x])}]" if len(units[x] - {""}) == 1 else "") for x in names]
    rows = [
        [f"{k} {entry.get('name', '')}".rstrip()]
        + [_cell(form, x, entry.get(x), len(units[x]) > 1) for x in names]
        for k, (form, entry) in enumerate(pairs, start=1)
    ]
    return Grid([what, *heads], rows)


def _unit(form: Form, name: str) -> str:
    key = form.keys.get(name.removesuffix(IN_DEGREES))
    unit = "" if key is None else key.unit
    return DEGREES[unit] if name.endswith(IN_DEGREES) else unit


def _cell(form: Form, name: str, value: Any, with_unit: bool) -> str:
    """A value as text, one with parts by its keys."""
    match value:
        case None:
            return ""
        case Mapping():
            kind = form.keys[name].kind.removesuffix("_vector")  # of an entry that is a table
            inner = form_of(kind, [x.removesuffix(IN_DEGREES) for x in value])
            needed = [x for x, key in inner.keys.items() if key.default != "0"]
            return ", ".join(
                f"{x.removesuffix(IN_DEGREES).replace('_', ' ')} {_cell(inner, x, part, True)}"
                for x, part in value.items()
                if part or (part is not None and x.removesuffix(IN_DEGREES) in needed)
            )
        case list():
            if name == "r" and value[1] == 0.0:
                value = value[:1]
            parts = ", ".join(_cell(form, name, part, False) for part in value)
            return parts if len(value) == 1 else f"({parts})"
        case float() | int():
            return f"{value:g} {_unit(form, name) if with_unit else ''}".rstrip()
    return str(value)
