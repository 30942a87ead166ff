"""`robodyn check`: what was read from a scene, what it is, and whether the identities hold."""

from __future__ import annotations

import numpy as np
import typer

from robodyn.cli.options import Model, Out, OutputStructured
from robodyn.cli.output import Grid, note, wants_tables, write_structure
from robodyn.cli.scene_facts import force_facts, links, springs_and_loads
from robodyn.cli.states import overflow, remarks
from robodyn.dynamics import closed_form
from robodyn.dynamics.identities import BOUND, Identity, Sample, identities, sample_states
from robodyn.errors import InputError
from robodyn.loops import assembly
from robodyn.mechanics.loop_class import loop_class
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.grammar import FORMS

STATES = 200
ENTRIES = 1_000_000  # of M over all sampled states: memory and time stay small in long chains


def check(model: Model, format: OutputStructured = None, out: Out = None) -> None:
    """What was read from a scene, and a self-test.

    Links, mobility, loop classes, and how well M and Psi are conditioned.

    The self-test evaluates the identities that every mechanism must keep (Mdot - 2C skew,
    G = dPE/dq, power in = dE/dt, ...) at random closed states and tells their residuals,
    relative to the size of the terms.  Exit code 1 if one does not hold, or M is singular.

    \b
    Examples:
      robodyn check robots/four-bar.yaml
      robodyn check robots/2r.yaml --format json
    """
    mechanism = load(model)
    unknown = False
    try:
        count = max(2, min(STATES, ENTRIES // mechanism.n**2))
        with remarks():
            sample = sample_states(mechanism, count)
    except InputError as error:
        unknown = True
        note(f"Note: no self-test over closed states: {error}")
        sample = Sample(np.zeros((0, mechanism.n)), np.zeros((0, mechanism.n)), 0.0)
    try:
        with remarks():
            results = identities(mechanism, sample) if len(sample.q) else []
    except InputError:  # a state of ours left the range of numbers
        raise overflow() from None
    singular = next((item.reason for item in results if item.reason), None)
    content = {
        "name": mechanism.name,
        "gravity": [mechanism.gamma.real, mechanism.gamma.imag],
        "links": links(mechanism),
        **springs_and_loads(mechanism),
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
    tables = _tables(mechanism, content, results) if wants_tables(format, out) else None
    write_structure(out, content, tables)
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


def _conditioning(mechanism: Mechanism, sample: Sample) -> dict[str, object]:
    """Mobility, and the range of the condition numbers of M and Psi over the sample."""
    q = sample.q
    if not len(q):
        return {"mobility": None, "cond_M": None, "cond_Psi": None}
    sizes = np.abs(np.linalg.eigvalsh(closed_form.mass_matrix(mechanism, q)))
    with np.errstate(divide="ignore", invalid="ignore"):
        cond_M = sizes.max(axis=-1) / sizes.min(axis=-1)
    result: dict[str, object] = {
        "mobility": mechanism.n,
        "cond_M": _span(cond_M),
        "cond_Psi": None,
    }
    if mechanism.rows:
        Psi = closed_form.closure_jacobian(mechanism, q)
        s = np.linalg.svd(Psi, compute_uv=False)
        rank = int((s > assembly.CLOSED * s[..., :1]).sum(axis=-1).max())
        result["mobility"] = mechanism.n - rank
        cond = s[:, 0] / s[:, rank - 1]
        result["cond_Psi"] = _span(cond)
        if rank < len(mechanism.rows):
            note(f"Note: {len(mechanism.rows) - rank} of the closures' equations are redundant")
    return result


def _span(values: np.ndarray) -> list[float | None]:
    """The least and the largest value; None for infinity, which JSON does not know."""
    return [float(x) if np.isfinite(x) else None for x in (values.min(), values.max())]


def _tables(
    mechanism: Mechanism, content: dict[str, object], results: list[Identity]
) -> list[Grid]:
    described = mechanism.description.links
    extras = [key for key in ("payload", "damping") if any(getattr(x, key) for x in described)]
    headed = {name: f"{name} [{key.unit}]" for name, key in FORMS["link"].keys.items()}
    columns = ["link", *(headed[key] for key in "mlrI"), "hangs from"]
    columns += [headed[key] for key in extras]
    rows = []
    for k, (link, shown) in enumerate(zip(described, links(mechanism), strict=True)):
        r = f"{link.r.real:g}" if link.r.imag == 0 else f"({link.r.real:g}, {link.r.imag:g})"
        values = [f"{link.m:g}", f"{link.l:g}", r, f"{link.I:g}", str(shown["from"])]
        values += [f"{getattr(link, key):g}" for key in extras]
        driven = "yes" if k in mechanism.actuated else ""
        rows.append([f"{k + 1} {link.name}", *values, driven])
    if any(link.friction for link in described):
        columns.append("friction [N m]")
        for row, link in zip(rows, described, strict=True):
            rubbing = link.friction
            above = "" if rubbing is None else f"{rubbing.torque:g} above {rubbing.speed:g} rad/s"
            row.insert(-1, above)
    gravity = mechanism.gamma
    facts = [["gravity", f"({gravity.real:g}, {gravity.imag:g}) m/s²"]]
    facts.append(["mobility", str(content["mobility"])])
    facts += force_facts(mechanism)
    loops = content["loops"]
    assert isinstance(loops, list)
    facts += [[f"loop {c + 1}", kind] for c, kind in enumerate(loops)]
    for key, label in (("cond_M", "condition of M"), ("cond_Psi", "condition of Psi")):
        span = content[key]
        if isinstance(span, list):
            facts.append(
                [label, " to ".join("infinite" if x is None else f"{x:.3g}" for x in span)]
            )
    if content["closing"] is not None:
        facts.append(["closes at", f"{100 * float(str(content['closing'])):.0f} % of positions"])

    read = Grid([*columns, "actuated"], rows, mechanism.name)
    title = f"identities at {content['states']} random states (bound {BOUND:g})"
    proof = [[item.name, *_verdict(item)] for item in results]
    return [read, Grid(["", ""], facts), Grid(["identity", "residual", ""], proof, title)]


def _verdict(item: Identity) -> list[str]:
    if item.residual is None:
        return ["", "M is singular"]
    return [f"{item.residual:.1e}", "holds" if item.holds else "FAILS"]
