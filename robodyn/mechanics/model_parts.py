"""What the numeric model of a mechanism consists of: points, rows of closures, springs, loads."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

from robodyn.scene.scene import Signal

T = TypeVar("T")
Terms = Sequence[tuple[int, complex]]  # (k, coefficient of X_k), nonzero ones only


class OnDemand(Sequence[T]):
    """What `make(*arguments)` gives, made when it is first read."""

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
    """Entries (j, k, A_jk) of A that are not zero, or by `dense` all of A (n, n) at once."""

    def __init__(
        self,
        make: Callable[..., Iterable[tuple[int, int, complex]]],
        whole: Callable[..., Any],
        *arguments: object,
    ) -> None:
        super().__init__(make, *arguments)
        self._whole = whole

    def dense(self) -> Any:
        """A as an array: of long chains far sooner than from its entries."""
        return self._whole(*self._recipe[1])

    def __getstate__(self) -> dict[str, object]:
        return {"_recipe": self._recipe, "_whole": self._whole}


class PlanarPoint(NamedTuple):
    """A point `constant + sum_k coefficient_k X_k` of the mechanism, m."""

    constant: complex
    terms: Terms


class ClosureRow(NamedTuple):
    """One real equation of the gap, m: with E_line = 1 where no link carries the line,

        Re(conj(E_line) (ground + sum_k P_k X_k)) + sum_k angles_k x_k + offset = 0

    `direction` is the unit vector along which the gap (first side minus second) is measured, in
    the frame E_line of the link that carries the line, if one does (else E_line = 1); a multiplier
    lambda of this row is the force lambda * direction * E_line on the side named first, N.  A
    coupling has no P: an equation of coordinates is multiplied by `arm` (m), so that gaps compare,
    and arm * lambda is the torque on the coupling's joint, N m.  Of an angle that a closure keeps
    the gap is arm times the sine of what it is off, arm * lambda the moment on the first side's
    link.  A joint that is `held` where it is has a row of rates alone: its gap counts as zero.
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
    lengths: Mapping[int, float] = {}  # that displacements are compared by, m

    @property
    def size(self) -> float:
        """The sum of its terms' sizes, m."""
        terms = sum(abs(c) * self.lengths.get(k, 1.0) for k, c in (*self.P, *self.angles))
        return terms + abs(self.ground)


class PointSpring(NamedTuple):
    """A spring between points of two links (None: the ground): `between`, first less second."""

    first: int | None
    second: int | None
    ends: tuple[PlanarPoint, PlanarPoint]
    between: PlanarPoint
    stiffness: float  # N/m
    length: float  # free length, m
    damping: float  # N s/m
    law: Signal | None = None  # its pull, N, in place of the stiffness

    @property
    def directed(self) -> bool:
        """Whether its force has no limit where its ends meet."""
        return bool((self.stiffness and self.length) or self.damping or self.law)


class Force(NamedTuple):
    """A force at a point of a link, N; one that turns with the link, or varies, has no potential.

    Where it varies it is `turned` times the `signals` of its x and y (a number: that for ever).
    """

    link: int
    point: PlanarPoint
    force: complex
    turns: bool
    signals: tuple[Signal | float, Signal | float] | None = None
    turned: complex = 1.0

    @property
    def constant(self) -> bool:
        """Whether it is among the weights."""
        return not self.turns and self.signals is None


class VaryingMoment(NamedTuple):
    """A torque on a link, N m, that varies."""

    link: int
    signal: Signal


def conserves(law: Signal | None) -> bool:
    """Whether what a spring gives depends on its extension alone, and has a potential."""
    return law is None or law.names <= {"x"}


class Rotor(NamedTuple):
    """The rotor of the motor at a joint; it sits on the link that carries the joint.

    It spins with w_carrier + ratio qd, w_carrier the rate of what turns that link, if anything
    does.  So KE has inertia/2 (w_carrier + ratio qd)^2 more, and M the constant inertia r r^T.
    """

    joint: int
    inertia: float  # kg m^2
    ratio: float  # rad/m where the joint slides
    carrier: int | None  # the link whose E the carrying link has; None: the ground
    slides: bool  # whether the joint does

    @property
    def spin(self) -> tuple[tuple[int, float], ...]:
        """r in x: its rate is the sum of coefficients times x'."""
        own = self.joint, self.ratio
        if self.carrier is None:
            return (own,)
        return own, (self.carrier, 1.0 if self.slides else 1.0 - self.ratio)
