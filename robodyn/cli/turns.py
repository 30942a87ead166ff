"""What is told of a turn of a machine in place of its rows: its flywheel, its shaking orders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from robodyn.cli.output import degrees
from robodyn.cli.states import Quantity, TableOptions, evaluate
from robodyn.dynamics.dynamics import inverse_dynamics
from robodyn.dynamics.flywheel import Flywheel, flywheel, harmonics
from robodyn.errors import InputError, at_place, named_options
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.tables.summaries import KeptRows, Rows

FLYWHEEL, ORDERS = "--fluctuation", "--harmonics"
SHAKE = ("shake_fx", "shake_fy", "shake_m")
MOST = 10_000  # orders


def tell_flywheel(
    mechanism: Mechanism, given: TableOptions, quantities: Sequence[Quantity], delta: float
) -> None:
    """Write the flywheel for a turn, the rows given; InputError naming what is none."""
    k = _driven_joint(mechanism, given, FLYWHEEL)
    if degrees.get():
        raise InputError(f"--degrees and {FLYWHEEL}", limit="exclude each other")
    if not 0.0 < delta < 2.0:
        limit = "must be > 0 and < 2: greatest less least speed, by their mean"
        raise InputError(FLYWHEEL, value=f"{delta:g}", limit=limit)

    def compute(q: Array, qd: Array, qdd: Array, t: Array | float = 0.0) -> Array:
        tau = inverse_dynamics(mechanism, q, qd, qdd, t)
        return np.stack([q[:, k], qd[:, k], tau[:, k]], axis=-1)

    def told(header: Sequence[str], rows: Array, own: Array) -> tuple[Sequence[str], Rows]:
        q, qd, tau = own.T
        t = rows[:, header.index("t")] if "t" in header else np.full(len(q), np.nan)
        seconds = _duration(t, q, qd)
        return Flywheel._fields, [list(flywheel(q, tau, seconds, delta))]

    names = [f"{name}{k + 1}" for name in ("q", "qd", "tau")]
    summary = partial(KeptRows, of=at_place(FLYWHEEL)(told))
    evaluate(mechanism, given, quantities, names, compute, summary=summary)


def tell_shaking_orders(
    mechanism: Mechanism,
    given: TableOptions,
    quantities: Sequence[Quantity],
    either: Sequence[Quantity],
    reactions: Callable[..., Array],
    most: int,
) -> None:
    """Write the orders, up to `most`, of the last columns of `reactions`: those of `SHAKE`."""
    if not 0 <= most <= MOST:
        raise InputError(ORDERS, value=most, limit=f"must be in [0, {MOST}]")
    k = _driven_joint(mechanism, given, ORDERS)

    def compute(q: Array, **motion: Array) -> Array:
        return np.column_stack([q[:, k], reactions(q, **motion)[:, -len(SHAKE) :]])

    def told(_: Sequence[str], __: Array, own: Array) -> tuple[Sequence[str], Rows]:
        in_degrees = degrees.get()
        theta = np.radians(own[:, 0]) if in_degrees else own[:, 0]
        with named_options((), orders="harmonics"), at_place(ORDERS, "the "):
            amplitudes, phases = harmonics(theta, own[:, 1:], most)
        phase = "phase_deg" if in_degrees else "phase"
        pairs = [amplitudes, np.degrees(phases) if in_degrees else phases]
        each = np.stack(pairs, axis=-1).reshape(len(amplitudes), -1)
        header = ["order", *(f"{name}_{what}" for name in SHAKE for what in ("amp", phase))]
        return header, [[str(order), *row] for order, row in enumerate(each.tolist())]

    names = [f"q{k + 1}", *SHAKE]
    summary = partial(KeptRows, of=told)
    evaluate(mechanism, given, quantities, names, compute, either, summary=summary)


def _driven_joint(mechanism: Mechanism, given: TableOptions, flag: str) -> int:
    """The one joint that is actuated, of a machine that turns; InputError where there is none."""
    if given.extremes:
        raise InputError(f"--extremes and {flag}", limit="exclude each other")
    if given.states is None:
        raise InputError(flag, limit="needs STATES: rows over a turn")
    names = [mechanism.link_names[k] for k in mechanism.actuated]
    if len(names) != 1:
        limit = f"one actuated joint must drive the machine; here {', '.join(names) or 'none'}"
        raise InputError(flag, where=mechanism.source, limit=limit)
    if mechanism.actuated[0] in mechanism.slides:
        limit = f"the joint {names[0]} slides: it has no turns"
        raise InputError(flag, where=mechanism.source, limit=limit)
    return mechanism.actuated[0]


def _duration(t: Array, q: Array, qd: Array) -> float:
    """The time of the rows, s: by their times, else by their rates."""
    if np.isfinite(t).all():
        if not (np.diff(t) > 0.0).all():
            raise InputError("t", limit="must rise from row to row")
        return float(np.ptp(t))
    if not qd.all() or (qd * (q[-1] - q[0]) < 0.0).any():
        limit = "needs the speed: a column t, or --qd (or columns) not zero, along the turn"
        raise InputError("the rows", limit=limit)
    paces = 1.0 / qd
    return float(np.diff(q) @ (paces[1:] + paces[:-1]) / 2.0)
