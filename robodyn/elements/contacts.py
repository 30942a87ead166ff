"""Modes of contacts: which joints are held, slip or press a stop, and what ends a mode."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

NEAR = 1e-12  # rad or m, or part of where it is: so near to an end a joint touches it

STICKS, HARD, COMPLIANT = "sticks", "hard", "compliant"  # contacts: what acts in modes alone

End = tuple[int, int]  # a joint, and the side of it that ends: -1 or 1


class Mode(NamedTuple):
    """Joints that are held, joints that slip with direction, and pressed stops with side."""

    held: tuple[int, ...] = ()
    slips: tuple[tuple[int, int], ...] = ()
    pressed: tuple[End, ...] = ()
    stands: bool = False  # nothing can move: each joint stands alone


class Guard(NamedTuple):
    """A condition that keeps a joint in its contact mode; the mode ends when it fails.

    Kinds: a joint that "slips", is "inside" of a hard end, "presses" a compliant stop or is "apart"
    from one.  `value` is positive while the mode lasts, and `size` is that of its terms, (k,) by
    states q, qd (k, n).  None: what "holds" joints at rest has one margin of all, by their forces.
    """

    kind: str
    joint: int
    side: int  # of the joint's end; or the way that it slips
    value: Callable[[Any, Any], Any] | None = None
    size: Callable[[Any, Any], Any] | None = None
