"""The numeric model of a planar mechanism: what every computation reads, and nothing else.

`mechanism.py` makes it from a description, and has the formulas of its constants.  Nothing here
needs numpy until `Mechanism.arrays` is asked for: a command that evaluates one state in plain
floats starts without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeVar, overload

from robodyn.scene.scene import Description, Friction, JointSpring

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

T = TypeVar("T")
Terms = Sequence[tuple[int, complex]]  # (k, coefficient of E_k), nonzero ones only


class OnDemand(Sequence[T]):
    """What `make(*arguments)` gives, made when it is first read."""

    def __init__(self, make: Callable[..., Iterable[T]], *arguments: object) -> None:
        self._recipe = make, arguments

    @cached_property
    def _made(self) -> tuple[T, ...]:
        make, arguments = self._recipe
        return tuple(make(*arguments))

    @overload
    def __getitem__(self, at: int) -> T: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[T, ...]: ...
    def __getitem__(self, at: int | slice) -> T | tuple[T, ...]:
        return self._made[at]

    def __len__(self) -> int:
        return len(self._made)

    def __iter__(self) -> Iterator[T]:
        return iter(self._made)

    def __getstate__(self) -> dict[str, object]:
        return {"_recipe": self._recipe}


class PlanarPoint(NamedTuple):
    """A point `constant + sum_k coefficient_k E_k` of the mechanism, m."""

    constant: complex
    terms: Terms


class ClosureRow(NamedTuple):
    """One real equation `Re(sum_k P_k E_k) + sum_k angles_k alpha_k + offset = 0`, m.

    Of a closure it has no `angles`.  `direction` is the unit vector along which the gap (first side
    minus second) is measured; a multiplier lambda of this row is the force lambda * direction on
    the side named first, N.  Of a coupling it has no P: the equation of angles is multiplied by
    `arm` (m), so that gaps compare, and arm * lambda is the torque on the coupling's joint, N m.
    """

    closure: int | None  # None: of a coupling
    direction: complex
    P: Terms
    offset: float
    angles: tuple[tuple[int, float], ...] = ()  # m
    arm: float = 0.0

    @property
    def size(self) -> float:
        """The sum of its terms' sizes, m."""
        return sum(abs(p) for _, p in self.P) + sum(abs(a) for _, a in self.angles)


class PointSpring(NamedTuple):
    """A spring between points of two links (None: the ground): `between`, first less second."""

    first: int | None
    second: int | None
    ends: tuple[PlanarPoint, PlanarPoint]
    between: PlanarPoint
    stiffness: float  # N/m
    length: float  # free length, m
    damping: float  # N s/m

    @property
    def directed(self) -> bool:
        """Whether its force has no limit where its ends meet."""
        return bool(self.stiffness and self.length) or bool(self.damping)


class Force(NamedTuple):
    """A constant force at a point of a link, N; one that turns with the link has no potential."""

    link: int
    point: PlanarPoint
    force: complex
    turns: bool


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A planar mechanism as numbers; immutable, compared by identity.

    q_i is the angle (rad) of link i relative to the link it hangs from, or from +X.
    """

    name: str
    source: str
    description: Description
    link_names: tuple[str, ...]
    parent: tuple[int | None, ...]
    order: tuple[int, ...]  # the links, each after the one it hangs from
    A: Sequence[tuple[int, int, complex]]  # (j, k, A_jk) with j above k or j = k, kg m^2
    B: tuple[complex, ...]  # kg m
    gamma: complex  # gravity as gx + i gy, m/s^2
    energy_offset: float  # potential energy of the constants, J
    damping: tuple[float, ...]  # N m s/rad, of joints and of the springs at them
    rows: tuple[ClosureRow, ...]
    actuated: tuple[int, ...]
    pivots: Sequence[PlanarPoint]  # each link's own joint
    tips: Sequence[PlanarPoint]
    centres: Sequence[PlanarPoint]  # centres of gravity, payload not included
    weights: tuple[complex, ...]  # of gravity and constant forces, N m
    moments: tuple[float, ...]  # constant torques on links, N m
    springs: Sequence[PointSpring] = ()
    joint_springs: tuple[JointSpring, ...] = ()
    forces: Sequence[Force] = ()
    friction: tuple[tuple[int, Friction], ...] = ()  # of joints

    @property
    def n(self) -> int:
        """Number of links, which is the number of joints and of coordinates."""
        return len(self.parent)

    @property
    def passive(self) -> tuple[int, ...]:
        """The joints that carry no torque of their own."""
        actuated = set(self.actuated)
        return tuple(i for i in range(self.n) if i not in actuated)

    def path(self, link: int | None) -> list[int]:
        """The links from the ground to `link`, that included; none for the ground."""
        path: list[int] = []
        while link is not None:
            path.append(link)
            link = self.parent[link]
        return path[::-1]

    @property
    def has_state_forces(self) -> bool:
        """Whether anything acts but gravity, constant forces and torques, and joint dampers."""
        turning = any(force.turns for force in self.forces)
        return bool(self.springs or self.joint_springs or self.friction or turning)

    @property
    def changes_energy(self) -> bool:
        """Whether the scene itself changes the energy: dampers, friction, forces that turn."""
        turning = any(force.turns for force in self.forces)
        dampers = any(self.damping) or any(spring.damping for spring in self.springs)
        return bool(dampers or self.friction or turning)

    @cached_property
    def arrays(self) -> Arrays:
        """The constants as dense numpy arrays (numpy is imported here)."""
        return _arrays(self)

    def __getstate__(self) -> dict[str, object]:
        return {key: value for key, value in self.__dict__.items() if key != "arrays"}


class Arrays(NamedTuple):
    """The constants of a mechanism as read-only dense arrays; n links, r closure rows."""

    A: NDArray[np.complex128]  # (n, n) Hermitian, kg m^2
    B: NDArray[np.complex128]  # (n,) kg m
    J: NDArray[np.float64]  # (n, n), alpha = J q
    P: NDArray[np.complex128]  # (r, n), gap = Re(P E) + angles alpha + offset
    angles: NDArray[np.float64]  # (r, n) m
    offset: NDArray[np.float64]  # (r,) m
    damping: NDArray[np.float64]  # (n,) N m s/rad
    weights: NDArray[np.complex128]  # (n,) N m
    moments: NDArray[np.float64]  # (n,) N m


def _arrays(mechanism: Mechanism) -> Arrays:
    import numpy as np

    n, r = mechanism.n, len(mechanism.rows)
    A = np.zeros((n, n), complex)
    for j, k, value in mechanism.A:
        A[j, k] = value
        A[k, j] = value.conjugate()
    J = np.zeros((n, n))
    for k in mechanism.order:
        above = mechanism.parent[k]
        if above is not None:
            J[k] = J[above]
        J[k, k] = 1.0
    P = np.zeros((r, n), complex)
    angles = np.zeros((r, n))
    for row, entry in enumerate(mechanism.rows):
        for k, coefficient in entry.P:
            P[row, k] = coefficient
        for k, turn in entry.angles:
            angles[row, k] = turn
    arrays = Arrays(
        A=A,
        B=np.array(mechanism.B, complex),
        J=J,
        P=P,
        angles=angles,
        offset=np.array([row.offset for row in mechanism.rows], float),
        damping=np.array(mechanism.damping, float),
        weights=np.array(mechanism.weights, complex),
        moments=np.array(mechanism.moments, float),
    )
    for array in arrays:
        array.flags.writeable = False
    return arrays


def joint_index(mechanism: Mechanism) -> Mapping[str, int]:
    """The joint (from 0) of each link name."""
    return {name: k for k, name in enumerate(mechanism.link_names)}
