"""Parts of the numeric model: rows of closures, and lists that are made on demand."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

from robodyn.elements.values import Curve, Law

T = TypeVar("T")
Terms = Sequence[tuple[int, complex]]  # (k, coefficient of X_k), nonzero ones only


class OnDemand(Sequence[T]):
    """A list that `make(*arguments)` returns when it is first read."""

    def __init__(self, make: Callable[..., Iterable[T]], *arguments: object) -> None:
        self._recipe = make, arguments

    @cached_property
    def _made(self) -> tuple[T, ...]:
        make, arguments = self._recipe
        return tuple(make(*arguments))

    def __getitem__(self, at: Any) -> Any:
        return self._made[at]

    def __len__(self) -> int:
        return len(self._made)

    def __iter__(self) -> Iterator[T]:
        return iter(self._made)

    def __getstate__(self) -> dict[str, object]:
        return {"_recipe": self._recipe}


class Inertias(OnDemand[tuple[int, int, complex]]):
    """Nonzero entries (j, k, A_jk) of A; `dense` makes all of A (n, n) at once."""

    def __init__(
        self,
        make: Callable[..., Iterable[tuple[int, int, complex]]],
        whole: Callable[..., Any],
        *arguments: object,
    ) -> None:
        super().__init__(make, *arguments)
        self._whole = whole

    def dense(self) -> Any:
        """Return A as an array, for long chains much faster than from its entries."""
        return self._whole(*self._recipe[1])

    def __getstate__(self) -> dict[str, object]:
        return {"_recipe": self._recipe, "_whole": self._whole}


class ClosureRow(NamedTuple):
    """One real equation of the gap, m; with E_line = 1 if no link carries the line,

        Re(conj(E_line) (ground + sum_k P_k X_k)) + sum_k angles_k x_k + offset = 0

    `direction` is the unit vector along which the gap (first side minus second) is measured, in the
    frame E_line.  A multiplier lambda of this row is the force lambda * direction * E_line on the
    first side, N.

    A coupling has no P: its equation of coordinates is multiplied by `arm` (m), so that gaps
    compare, and arm * lambda is the torque on the coupling's joint, N m.  For a fixed angle, the
    gap is arm times the sine of its error, and arm * lambda the moment on the first side's link.  A
    joint that is `held` has a row of rates alone; its gap counts as zero.  For a coupling with a
    `law` f the row is that of its joint alone, and the gap includes -arm f.
    """

    closure: int | None  # None: of a coupling
    direction: complex
    P: Terms
    offset: float
    angles: tuple[tuple[int, float], ...] = ()  # m
    arm: float = 0.0
    line: int | None = None
    ground: complex = 0j
    held: bool = False
    law: Law | Curve | None = None
    lengths: Mapping[int, float] = {}  # that displacements are compared by, m

    @property
    def size(self) -> float:
        """The sum of the sizes of its terms, m."""
        terms = sum(abs(c) * self.lengths.get(k, 1.0) for k, c in (*self.P, *self.angles))
        return terms + abs(self.ground)
