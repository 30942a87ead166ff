"""Where a series starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robodyn.engines.arithmetic import Planar, Value


@dataclass(frozen=True, slots=True)
class State:
    """Where a series starts: the links' directions E (n), rates w, and the values of `Given`s.

    `given` maps a name to its first coefficients, or to a function of the order that returns one.
    `turn` (j, k) gives conj(E_j) E_k where there is a cheaper way than to multiply.
    """

    E: Sequence[Planar]
    w: Sequence[Value]
    given: dict[str, Sequence[Value] | Callable[[int], Value]]
    turn: Callable[[int, int], Planar] | None = None
