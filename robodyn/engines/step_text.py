"""Steps of the Taylor series as straight-line Python, of one mechanism and its torques."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

from robodyn.engines import source_text, straightline
from robodyn.engines.expansion import Expansion, MotionProgram, end_of_step, expansion
from robodyn.engines.expression import Expression, Value
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.planar_model import Mechanism

# t, y, tau and slope (n each), most, direction, rtol, atol -> h, y at its end, series
Expand = Callable[..., tuple[float, list[float], tuple[tuple[float, ...], ...]]]


class StepText(NamedTuple):
    """`expand` makes a step; `watched` gives the values at (t, y) of what may bend within it.

    The series are rho (n), theta (n), the power where something `works` that is no steady torque,
    then those of what may bend; `arms` make torques of these.  Of a step that cannot be made there
    are none.
    """

    expand: Expand
    watched: Callable[..., tuple[float, ...]]
    arms: list[float]
    works: bool


def step_text(
    mechanism: Mechanism,
    actuation: Actuation,
    order: int,
    work: bool,
    held: Sequence[float] | None = None,
) -> StepText:
    """The code; raises InputError where a torque has no series (for `held` see `torque_slots`)."""
    found = expansion(MotionProgram(mechanism, actuation, work, held), order)
    state = end_of_step(mechanism, found, work, found.graph)
    series = [*found.rho, *found.theta, *([found.power] if found.power else []), *found.watched]
    return StepText(
        _expand(found, state, series, mechanism.n, work),
        _watched(found, mechanism.n),
        found.arms,
        bool(found.power),
    )


def _expand(
    found: Expansion, state: list[Value], series: list[list[Value]], n: int, work: bool
) -> Expand:
    flat = [value for each in series for value in each]
    lines, shown = source_text.float_source([found.longest, *state, *flat])
    last = found.longest.index if isinstance(found.longest, Expression) else -1
    before = [line for line in lines if int(line[1 : line.index(" ")]) <= last]
    end, written = shown[1 : 1 + len(state)], shown[1 + len(state) :]
    bounds = [0, *accumulate(map(len, series))]
    tuples = [f"({', '.join(written[a:b])},)" for a, b in pairwise(bounds)]
    body = [
        _unpacked(found, n, work),
        *before,
        f"h = {shown[0]}",
        "if h != h: return 0.0, y, ()",
        "if h > most: h = most",
        "x = h*direction",
        *lines[len(before) :],
        f"return h, [{', '.join(end)}], ({', '.join(tuples)},)",
    ]
    return _defined("expand", "t, y, tau, dtau, most, direction, rtol, atol", body)


def _watched(found: Expansion, n: int) -> Callable[..., tuple[float, ...]]:
    lines, shown = source_text.float_source([each[0] for each in found.watched])
    body = [_unpacked(found, n, False), *lines, f"return ({''.join(f'{x}, ' for x in shown)})"]
    return _defined("watched", "t, y, tau, dtau", body)


def _unpacked(found: Expansion, n: int, work: bool) -> str:
    names = [f"{name}{k}" for name in ("q", "qd") for k in range(n)] + ["work"] * work
    text = f"{', '.join(names)}, *_ = y"
    if not found.given:
        return text
    for name in ("tau", "dtau"):
        text += f"; {', '.join(f'{name}{k}' for k in range(n))}, = {name}"
    return text


def _defined(name: str, arguments: str, body: Sequence[str]) -> Callable[..., Any]:
    text = "\n    ".join(body)
    return straightline.define(f"def {name}({arguments}):\n    {text}\n", name)
