"""Modes of a mechanism with contacts; in each, the equations of motion are smooth.

A joint with dry friction sticks, or slips in one direction.  A joint with stops is free, presses a
compliant stop, or rests on a hard one.  A joint that sticks or rests is held: it has a row in its
rates, whose multiplier is the holding force.  The mechanism in a mode is an ordinary mechanism for
every engine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from robodyn.elements.contacts import COMPLIANT, NEAR, End, Mode
from robodyn.elements.joints import CompliantStop
from robodyn.mechanics.loop_rows import coupling_rows
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Coupling, Link, Point

if TYPE_CHECKING:
    from numpy.typing import NDArray


@lru_cache(maxsize=256)
def in_mode(mechanism: Mechanism, mode: Mode) -> Mechanism:
    """Return the mechanism in a mode; rows of held joints follow its own rows."""
    if mode.stands:
        return _standing(mechanism)
    description = mechanism.description
    held = description._replace(couplings=tuple(Coupling(k, (), 0.0) for k in mode.held))
    rows = [row._replace(held=True) for row in (coupling_rows(held) if mode.held else ())]
    return replace(
        mechanism,
        rows=mechanism.rows + tuple(rows),
        elements=tuple(part for x in mechanism.elements for part in x.in_mode(mode)),
        ranges=(),
        mode=mode,
    )


def _standing(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with every joint held by itself, so that nothing ever moves."""
    from robodyn.mechanics.mechanism import build

    description = mechanism.description
    alone = [
        Link(x.name, 1.0, 0.0, 0j, 1.0, Point(None, 0j), axis=1.0 + 0j if x.slides else None)
        for x in description.links
    ]
    joints = description._replace(
        gravity=0j,
        links=tuple(alone),
        closures=(),
        branches=(),
        springs=(),
        loads=(),
        points=(),
        actuated=mechanism.actuated,
        start=None,
        couplings=tuple(Coupling(k, (), 0.0) for k in range(mechanism.n)),
    )
    made = build(joints)
    rows = tuple(row._replace(held=True) for row in made.rows)
    return replace(made, rows=rows, mode=Mode(stands=True))


def pressed(mechanism: Mechanism, q: Sequence[float], qd: Sequence[float]) -> tuple[End, ...]:
    """Return the compliant stops that push in a state (q, qd)."""
    if COMPLIANT not in mechanism.contacts:
        return ()
    stops = mechanism.of(CompliantStop)
    return tuple((x.joint, x.side) for x in stops if x.pushes(q[x.joint], qd[x.joint]))


def pushes(
    mechanism: Mechanism, mode: Mode, q: NDArray[Any], qd: NDArray[Any]
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield the joints that press compliant stops in a mode, and the forces (k,) on them.

    The states q, qd are (k, n).  Forces are in N m or N, positive towards larger q.
    """
    for stop in mechanism.of(CompliantStop):
        if (stop.joint, stop.side) in mode.pressed:
            push = stop.push(q[:, stop.joint], qd[:, stop.joint])
            yield stop.joint, -stop.side * stop.stiffness * push


def beyond(
    mechanism: Mechanism, q: Sequence[float], turns: bool = False
) -> list[tuple[int, int, float]]:
    """Return the firm ends that q is beyond by more than rounding: (joint, side, position).

    Compliant stops yield and do not count.  With `turns`, full turns are ignored for angles with
    limits on both sides.
    """
    found = []
    for joint, ends in ((x.joint, x.ends) for x in mechanism.ranges if x.firm):
        for side, end in ends:
            way = side * (q[joint] - end)
            if turns and joint not in mechanism.slides and len(ends) == 2 and way > 0.0:
                range_ = ends[1][1] - ends[0][1]
                way = -1.0 if -way % math.tau <= range_ + NEAR else way
            if way > NEAR * max(1.0, abs(end)):
                found.append((joint, side, end))
    return found


def end_word(side: int) -> str:
    """Return "max" or "min"."""
    return "max" if side > 0 else "min"


def resting_friction(mechanism: Mechanism, qd: NDArray[Any], qdd: NDArray[Any]) -> bool:
    """Return whether a joint with dry friction is at rest in any motion (k, n)."""
    joints = list(mechanism.dry)
    return bool(((qd[:, joints] == 0.0) & (qdd[:, joints] == 0.0)).any())


def moving_mode(
    mechanism: Mechanism, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float]
) -> Mode:
    """Return the mode of a given motion: joints slip in the direction in which they move.

    A joint that neither moves nor starts has no friction in this mode.
    """
    ways = ((j, qd[j] or qdd[j]) for j in mechanism.dry)
    slips = tuple((j, 1 if way > 0.0 else -1) for j, way in ways if way)
    return Mode((), slips, pressed(mechanism, q, qd))


def falls_over(
    mechanism: Mechanism, before: Sequence[float], after: Sequence[float], h: float
) -> bool:
    """Return whether a step may have leapt over a peak of friction at low rates.

    The peak, exp(-(v/width)^2) or exp(-|v|/width), and all its derivatives vanish beyond some reach
    of v, so no method sees it coming.  The states (q, qd, ...) are h (s) apart; v in the middle
    follows from Simpson's rule, since the motion may turn back within the step.
    """
    n = mechanism.n
    for joint, width, reach in mechanism.bells:
        v, then = before[n + joint], after[n + joint]
        for there in (then, 1.5 * (after[joint] - before[joint]) / h - 0.25 * (v + then)):
            if abs(there - v) > max(0.5 * abs(v), width):
                nearest = min(abs(v), abs(there)) if v * there > 0.0 else 0.0
                if nearest < reach:
                    return True
    return False
