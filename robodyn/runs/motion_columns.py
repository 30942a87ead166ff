"""The columns of a simulated motion, as `robodyn simulate` writes them, and its torques."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache

import numpy as np

from robodyn.dynamics.columns import MOTION, column_names
from robodyn.dynamics.state import State
from robodyn.errors import InputError, RobodynError
from robodyn.loops.loop_rates import near_dead_centre
from robodyn.mechanics import actuation as torque_sources
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import finite, numbers
from robodyn.mechanics.run_control import Control
from robodyn.tables.arrays import Array


def motion_columns(mechanism: Mechanism, tracked: bool) -> list[str]:
    """Return the names of a motion's columns, with tracking errors if it was `tracked`."""
    return column_names(mechanism, [*MOTION, *(["errors"] if tracked else [])])


def motion_values(
    mechanism: Mechanism, moving: Mechanism, t: Array, q: Array, qd: Array, tau: Array
) -> Array:
    """Return the values (T, columns) of a motion's columns, without tracking errors.

    t is (T,), the states and torques (T, n).  `moving` is the mechanism, or the mode that moves.
    """
    state = State(mechanism, q, qd, tau=tau, t=t, moving=moving)
    return state.columns(column_names(mechanism, MOTION))


def as_actuation(
    mechanism: Mechanism,
    tau: Sequence[float]
    | str
    | Callable[[float, list[float], list[float]], Sequence[float]]
    | Actuation
    | None,
) -> Actuation:
    """Convert constants, an expression, a function tau(t, q, qd) or None to an Actuation."""
    if tau is None:
        return _none(mechanism.n)
    if isinstance(tau, Actuation):
        return tau
    if isinstance(tau, str):
        return torque_sources.expressions(mechanism, tau, "tau")
    if callable(tau):
        return torque_sources.callback(mechanism, tau)
    return torque_sources.constant(mechanism, finite("tau", numbers("tau", tau)).tolist())


TOO_FAST = "the torque changes too fast to be sampled: steps go by their errors alone (--max-step)"


@lru_cache
def _none(n: int) -> Actuation:
    return Actuation((0.0,) * n)


def applied_torques(mechanism: Mechanism, actuation: Actuation, t: Array, y: Array) -> Array:
    """Return the joint torques (T, n) at times (T,) and states y (T, 2n or more)."""
    if actuation.constants is not None:
        steady = np.empty((len(t), mechanism.n))
        steady[:] = actuation.constants
        return steady
    torques = at = actuation.function(mechanism.n)
    if actuation.original is not None:
        original = actuation.original.function(mechanism.n)

        def at(t: float, y: Sequence[float]) -> list[float]:
            for function in (original, torques):  # which knows what sin(t)/t is at 0
                with suppress(ArithmeticError, ValueError):
                    return function(t, y)
            return [np.nan] * mechanism.n  # where the run could not go on

    rows = [at(*row) for row in zip(t.tolist(), y.tolist(), strict=True)]
    count = mechanism.n + actuation.states
    return np.array(rows, float).reshape(len(t), count)[:, : mechanism.n]


def check_start(mechanism: Mechanism, actuation: Actuation, t: float, y: Array) -> None:
    """Raise RobodynError that names the torque if one is not finite at time t."""
    try:
        torques = actuation.constants or actuation.function(mechanism.n)(t, y.tolist())
        if all(map(math.isfinite, torques)):
            return
    except (ArithmeticError, ValueError):
        pass
    place = f"{actuation.where}: " if actuation.where else ""
    when = "at"
    if actuation.original is not None:
        with suppress(ArithmeticError, ValueError):
            before = actuation.original.function(mechanism.n)(t, y.tolist())
            when = "next to" if all(map(math.isfinite, before)) else "at"
    limit = f"{place}{_not_finite(actuation, mechanism.n, t, y)} is not finite {when} t = {t:g} s"
    raise RobodynError("cannot start", where=mechanism.source, limit=limit)


def _not_finite(actuation: Actuation, n: int, t: float, y: Array) -> str:
    """Return the first torque without a finite value, with its formula."""
    names = [*(f"{name}{k}" for name in ("q", "qd") for k in range(n)), *actuation.own("z")]
    values = {"__builtins__": {}, "t": t, **actuation.scope, **dict(zip(names, y, strict=False))}
    for line in actuation.lines:
        name, _, _ = line.partition(" = ")
        try:
            exec(line, values)
            if not re.fullmatch(r"tau\d+", name) or math.isfinite(values[name]):
                continue
        except (ArithmeticError, ValueError):
            pass
        except SyntaxError:  # a part of a statement
            break
        written = actuation if actuation.original is None else actuation.original
        line = next((x for x in written.lines if x.startswith(f"{name} = ")), line)
        line = re.sub(r"\b(q|qd|tau)(\d+)\b", _from_one, line)
        line = re.sub(r"\b_pow\(([^(),]+), ([^(),]+)\)", r"\1 ** \2", line)
        return re.sub(r"\b_(\w+)\(", r"\1(", line)
    return "the torque"


def _from_one(name: re.Match[str]) -> str:
    return f"{name[1]}{int(name[2]) + 1}"


def check_span(actuation: Actuation, t_end: float) -> None:
    """Raise InputError if the torques are not defined over the whole run to t_end."""
    if actuation.span is not None:
        what, first, last = actuation.span
        if not (first <= min(0.0, t_end) and last >= max(0.0, t_end)):
            span = f"{first:g} to {last:g} s"
            raise InputError(what, value=span, limit=f"must cover 0 to {t_end:g} s")


def no_hold(mechanism: Mechanism, control: Control) -> str:
    """Return advice for a controlled run that fails near a dead centre, else ""."""
    if control.hardest is None or not near_dead_centre(
        mechanism, control.hardest[1], control.hardest[0]
    ):
        return ""
    most = max(control.tracking(), key=lambda joint: joint.largest_torque)
    unit = "N" if mechanism.link_names.index(most.joint) in mechanism.slides else "N m"
    return (
        f"the controller asked {most.largest_torque:.3g} {unit} of {most.joint} at t = "
        f"{control.hardest[0]:.6g} s, beside a dead centre, where no finite torque of the actuated "
        "joints moves the others: keep the reference away from there, or cut torques off "
        "(--tau-max)"
    )
