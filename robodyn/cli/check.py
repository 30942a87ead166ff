"""`robodyn check`: what a scene is, and whether the identities hold."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import typer

from robodyn.cli.options import Model, Out, OutputStructured
from robodyn.cli.output import Grid, note, write_structure
from robodyn.cli.progress import progress
from robodyn.cli.states import remarks
from robodyn.dynamics import closed_form
from robodyn.dynamics.identities import (
    BOUND,
    Identity,
    Sample,
    condition_numbers,
    identities,
    sample_states,
)
from robodyn.elements.contacts import Mode
from robodyn.elements.values import Curve
from robodyn.errors import InputError, overflow
from robodyn.loops import assembly, closures
from robodyn.loops.branches import scene_start
from robodyn.mechanics.loop_rows import loop_class
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.mechanics.standing import steady

STATES = 200
ENTRIES = 1_000_000  # of M over all sampled states: memory and time stay small in long chains


DIGITS = 0.01  # part of the largest second derivative that digits may make


def check(model: Model, format: OutputStructured = None, out: Out = None) -> None:
    """What a scene is, and a self-test.

    Its mobility, actuated joints, loop classes, and how well M and Psi are conditioned.

    The self-test evaluates the identities that every mechanism must keep (Mdot - 2C skew,
    G = dPE/dq, power in = dE/dt, ...) at random closed states and tells their residuals,
    relative to the size of the terms.  Exit code 1 if one does not hold, or M is singular.

    \b
    Examples:
      robodyn check four-bar
      robodyn check 2r --format json
    """
    mechanism = model.load()
    for coupling in mechanism.description.couplings:
        kept = steady(coupling)
        if kept is not None and not kept.terms:
            name = mechanism.link_names[coupling.joint]
            told = f"Note: a coupling keeps q{coupling.joint + 1} ({name}) constant"
            note(f"{told}: `joint: fixed` with an `angle` says that of a joint which turns")
    free = in_mode(mechanism, Mode()) if mechanism.switches else mechanism
    unknown = False
    try:
        count = max(1, min(STATES, ENTRIES // mechanism.n**2))
        with remarks(), progress("closing") as watch:
            sample = sample_states(mechanism, count, watch)
    except InputError as error:
        unknown = True
        note(f"Note: no self-test over closed states: {error}")
        sample = Sample(np.zeros((0, mechanism.n)), np.zeros((0, mechanism.n)), 0.0, np.zeros(0))
    try:
        with remarks():
            results = identities(free, sample) if len(sample.q) else []
    except InputError:  # a state of ours left the range of numbers
        raise overflow() from None
    singular = next((item.reason for item in results if item.reason), None)
    content: dict[str, Any] = {
        "name": mechanism.name,
        "actuated": [mechanism.link_names[k] for k in mechanism.actuated],
        "start": _start(mechanism),
        "loops": [loop_class(mechanism, c) for c in range(len(mechanism.description.closures))],
        **({"cams": cams} if (cams := _cams(mechanism)) else {}),
        **({"friction": _rubbing(mechanism)} if mechanism.rubbing else {}),
        **_conditioning(mechanism, sample),
        "states": len(sample.q),
        "closing": sample.closing if mechanism.rows else None,
        "identities": {item.name: item.residual for item in results},
        "singular": singular,
        "bound": BOUND,
        "passed": all(item.holds for item in results) if results else None,
    }
    if tables := [*_curves(mechanism)]:
        content["tables"] = tables
    write_structure(format, out, content, lambda: _tables(content, results))
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


def _curves(mechanism: Mechanism) -> Iterator[dict[str, object]]:
    """Yield the largest second derivative of each table coupling; note if digits are lacking."""
    for c, coupling in enumerate(mechanism.description.couplings, start=1):
        if isinstance(law := coupling.law, Curve):
            bend, off = law.largest_bend, law.bend_of_digits
            yield {"coupling": c, "file": law.file, "bend": bend, "bend_of_digits": off}
            if off > DIGITS * bend:
                told = f"{off:.2g} of {bend:.2g}, for the digits of its values"
                note(f"Warning: {law.text}: its second derivative may be off by {told}: give more")


def _start(mechanism: Mechanism) -> dict[str, object] | None:
    """Return the gap of the scene's start, and its distance from the nearest closed pose."""
    start = scene_start(mechanism)
    if start is None:
        return None
    return {
        "gap": None if math.isnan(start.gap) else start.gap,
        "closed": start.closed,
        "joint": mechanism.link_names[start.joint],
        "change": start.change,
        "unit": "m" if start.joint in mechanism.slides else "rad",
    }


def _cams(mechanism: Mechanism) -> list[dict[str, Any]]:
    """Return facts on each cam over a turn; note profiles that cannot be cut."""
    from robodyn.dynamics.cam_contacts import cams_of, profile_of

    found: list[dict[str, Any]] = []
    for cam in cams_of(mechanism):
        follower, own = mechanism.link_names[cam.link], profile_of(mechanism, cam)
        what = f"the profile of {follower}'s cam"
        if own.undercut is not None:
            where = f"Warning: {what} is undercut, most at q{cam.driver + 1} = {own.undercut:.6g}"
            radius = f"a roller of {cam.follower.radius:g} m is too large there"
            note(f"{where}: {'the face meets a hollow' if own.face else radius}")
        if not own.one_side:
            note(f"Warning: {what} changes sides: a tangent of it passes through the cam's joint")
        if not own.closed:
            note(f"Note: {what} does not end where it begins")
        facts = own._asdict()
        del facts["one_side"]
        for name, x in facts.items():
            if isinstance(x, float) and not math.isfinite(x):
                facts[name] = None
        found.append({"follower": follower, **facts})
    return found


def _cams_told(cams: list[dict[str, Any]]) -> Iterator[list[str]]:
    """Yield the result of `_cams` as rows of a table."""
    for cam in cams:
        told = [f"base circle {cam['base_circle']:.6g} m"]
        if cam["offset"] is not None:
            told.append(f"offset {cam['offset']:.6g} m")
        yield [f"cam of {cam['follower']}", ", ".join(told)]
        told = []
        if cam["pressure"] is not None:
            told.append(f"pressure angle up to {math.degrees(cam['pressure']):.3g} deg")
        if cam["undercut"] is not None:
            told.append("UNDERCUT")
        elif cam["least_radius"] is not None:
            told.append(f"least radius {cam['least_radius']:.6g} m")
        yield ["", ", ".join(told)]
        if cam["face"] is not None:
            first, last = cam["face"]
            yield ["", f"face touched from {first:.6g} to {last:.6g} m: {last - first:.6g} m long"]


def _rubbing(mechanism: Mechanism) -> list[dict[str, Any]]:
    """Friction by the forces in pins and slides; a slide has no radius."""
    found = []
    for x in mechanism.rubbing:
        place: dict[str, Any] = {"loop": None if x.closure is None else x.closure + 1}
        place["joint"] = None if x.joint is None else mechanism.link_names[x.joint]
        numbers = {"coefficient": x.coefficient, "radius": x.radius, "speed": x.speed}
        found.append(place | numbers | {"unit": "m/s" if x.radius is None else "rad/s"})
    return found


def _rubbing_told(rubbing: list[dict[str, Any]]) -> Iterator[list[str]]:
    """Yield the result of `_rubbing` as rows of a table."""
    for x in rubbing:
        radius = "" if x["radius"] is None else f"radius {x['radius']:.6g} m, "
        told = f"coefficient {x['coefficient']:.6g}, {radius}speed {x['speed']:.6g} {x['unit']}"
        yield [f"friction of {x['joint'] or 'loop ' + str(x['loop'])}", told]


def _start_told(start: dict[str, Any]) -> str:
    """Return the result of `_start` as a sentence."""
    if not start["closed"]:
        return "does not close, nor does a pose near to it"
    gap = "" if start["gap"] is None else f"misses closing by {start['gap']:.3g} m, "
    most = f"{start['change']:.3g} m"
    if start["unit"] == "rad":
        most = f"{math.degrees(start['change']):.3g} deg"
    return f"{gap}nearest closed pose within {most} ({start['joint']})"


def _conditioning(mechanism: Mechanism, sample: Sample) -> dict[str, object]:
    """Mobility, and the range of the condition numbers of M and Psi over the sample."""
    q = sample.q
    if not len(q):
        return {"mobility": None, "cond_M": None, "cond_Psi": None}
    massless = bool(mechanism.massless)
    cond_M = None if massless else _span(condition_numbers(closed_form.mass_matrix(mechanism, q)))
    mobility, cond_Psi = mechanism.n, None
    if mechanism.rows:
        s = np.linalg.svd(closures.scaled_jacobian(mechanism, q, sample.t), compute_uv=False)
        rank = int((s > assembly.CLOSED * s[..., :1]).sum(axis=-1).max())
        mobility, cond_Psi = mechanism.n - rank, _span(s[:, 0] / s[:, rank - 1])
        if rank < len(mechanism.rows):
            note(f"Note: {len(mechanism.rows) - rank} of the closures' equations are redundant")
    return {"mobility": mobility, "cond_M": cond_M, "cond_Psi": cond_Psi}


def _span(values: np.ndarray) -> list[float | None]:
    """The least and the largest value; None for infinity, which JSON does not know."""
    return [float(x) if np.isfinite(x) else None for x in (values.min(), values.max())]


def _tables(content: dict[str, Any], results: list[Identity]) -> list[Grid]:
    facts = [["actuated", ", ".join(content["actuated"]) or "no joint"]]
    if content["start"]:
        facts.append(["start", _start_told(content["start"])])
    facts.append(["mobility", str(content["mobility"])])
    facts += [[f"loop {c}", kind] for c, kind in enumerate(content["loops"], start=1)]
    facts += _cams_told(content.get("cams", []))
    facts += _rubbing_told(content.get("friction", []))
    for key, label in (("cond_M", "condition of M"), ("cond_Psi", "condition of Psi")):
        if content[key]:
            span = ["infinite" if x is None else f"{x:.3g}" for x in content[key]]
            facts.append([label, " to ".join(span)])
    for table in content.get("tables", ()):
        told = f"largest second derivative {table['bend']:.3g}"
        facts.append([table["file"], told])
    if content["closing"] is not None:
        facts.append(["closes at", f"{100 * content['closing']:.0f} % of positions"])
    proof = []
    for item in results:
        verdict = ["", "M is singular"]
        if item.residual is not None:
            verdict = [f"{item.residual:.1e}", "holds" if item.holds else "FAILS"]
        proof.append([item.name, *verdict])
    title = f"identities at {content['states']} random states (bound {BOUND:g})"
    heading = content["name"]
    return [Grid(["", ""], facts, heading), Grid(["identity", "residual", ""], proof, title)]
