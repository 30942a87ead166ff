"""Description -> mechanism: the constants of the one formula that covers every planar linkage.

Points of the plane are complex numbers and E_k = exp(i alpha_k), alpha_k the absolute angle of
link k.  Every point of the mechanism is then `constant + sum_k rho_k E_k`, and the whole dynamics
follows from

    A_jk = sum_b m_b conj(rho_bj) rho_bk + I_j delta_jk      B_k = sum_b m_b rho_bk      (b: bodies)

and from the closures, which are linear in E.  For j above k in the tree every body below k leaves
link j at the same point p_jk, so A_jk = conj(p_jk) B_k, with B_k the first moment of all that
link k carries: the constants cost O(links * depth), and only nonzero ones are kept.

Constant forces and torques act like weights: with p_b = const + sum_k c_k E_k the point of such a
force F, the potential energy is

    PE = const - Re(weights . E) - moments . alpha,      weights_k = conj(gamma) B_k + conj(F) c_k

Nothing here needs numpy until `Mechanism.arrays` is asked for: a command that evaluates one state
in plain floats starts without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from robodyn import description as scene
from robodyn.errors import InputError
from robodyn.scene import (
    Description,
    Friction,
    JointSpring,
    Load,
    Moment,
    Point,
    Spring,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Terms = tuple[tuple[int, complex], ...]  # (k, coefficient of E_k), nonzero ones only


@dataclass(frozen=True, slots=True)
class PlanarPoint:
    """A point `constant + sum_k coefficient_k E_k` of the mechanism, m."""

    constant: complex
    terms: Terms


@dataclass(frozen=True, slots=True)
class ClosureRow:
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


@dataclass(frozen=True, slots=True)
class PointSpring:
    """A spring between points of two links (None: the ground): `between`, first less second."""

    first: int | None
    second: int | None
    ends: tuple[PlanarPoint, PlanarPoint]
    between: PlanarPoint
    stiffness: float  # N/m
    length: float  # free length, m
    damping: float  # N s/m


@dataclass(frozen=True, slots=True)
class Force:
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
    A: tuple[tuple[int, int, complex], ...]  # (j, k, A_jk) with j above k or j = k, kg m^2
    B: tuple[complex, ...]  # kg m
    gamma: complex  # gravity as gx + i gy, m/s^2
    energy_offset: float  # potential energy of the constants, J
    damping: tuple[float, ...]  # N m s/rad, of joints and of the springs at them
    rows: tuple[ClosureRow, ...]
    actuated: tuple[int, ...]
    pivots: tuple[PlanarPoint, ...]  # each link's own joint
    tips: tuple[PlanarPoint, ...]
    centres: tuple[PlanarPoint, ...]  # centres of gravity, payload not included
    weights: tuple[complex, ...]  # of gravity and constant forces, N m
    moments: tuple[float, ...]  # constant torques on links, N m
    springs: tuple[PointSpring, ...] = ()
    joint_springs: tuple[JointSpring, ...] = ()
    forces: tuple[Force, ...] = ()
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

    @property
    def has_forces(self) -> bool:
        """Whether anything acts but gravity, constant forces and torques, and joint dampers."""
        turning = any(force.turns for force in self.forces)
        return bool(self.springs or self.joint_springs or self.friction or turning)

    @property
    def dissipates(self) -> bool:
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


@dataclass(frozen=True, slots=True)
class Arrays:
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


def load(path: str | Path) -> Mechanism:
    """The mechanism that the scene file at `path` describes.

    Raises DescriptionError (an InputError) that tells every fault of the file.
    """
    return build(scene.read(path))


def build(description: Description) -> Mechanism:
    """The numeric model of a description.

    Raises InputError where the products of masses and lengths leave the range of floats.
    """
    try:
        return _build(description)
    except OverflowError:
        raise _too_large(description) from None


def _build(description: Description) -> Mechanism:
    links = description.links
    parent = tuple(link.hangs_from.link for link in links)
    order = _order(parent)
    carried = [link.m + link.payload for link in links]
    B = [link.m * link.r + link.payload * link.l for link in links]
    inertia = [link.I + link.m * abs(link.r) ** 2 + link.payload * link.l**2 for link in links]
    for k in reversed(order):  # what link k carries acts on its parent at k's own joint
        p, j = links[k].hangs_from.at, parent[k]
        if j is not None:
            carried[j] += carried[k]
            B[j] += carried[k] * p
            inertia[j] += carried[k] * abs(p) ** 2

    A = [(k, k, complex(inertia[k])) for k in range(len(links))]
    pivots: list[PlanarPoint] = [PlanarPoint(0j, ())] * len(links)
    for k in order:
        pivots[k] = _point(pivots, links[k].hangs_from)
        A += [(j, k, p.conjugate() * B[k]) for j, p in pivots[k].terms if p * B[k] != 0]

    offset = -sum(
        (description.gravity.conjugate() * pivot.constant).real * (link.m + link.payload)
        for pivot, link in zip(pivots, links, strict=True)
    )
    weights = [description.gravity.conjugate() * b for b in B]
    moments, damping = [0.0] * len(links), [link.damping for link in links]
    forces: list[Force] = []
    for entry in description.loads:
        if isinstance(entry, Moment):
            moments[entry.link] += entry.torque
            continue
        forces.append(_force(entry, pivots))
        if not entry.turns:
            offset -= (entry.force.conjugate() * forces[-1].point.constant).real
            for k, c in forces[-1].point.terms:
                weights[k] += entry.force.conjugate() * c
    joint_springs = [x for x in description.springs if isinstance(x, JointSpring)]
    for spring in joint_springs:
        damping[spring.joint] += spring.damping
    rows = _rows(description, pivots)
    rows += _coupling_rows(description, max((row.size for row in rows), default=0.0))
    numbers = [*(entry[2] for entry in A), *B, complex(offset), *(complex(r.offset) for r in rows)]
    numbers += weights
    if not all(math.isfinite(x.real) and math.isfinite(x.imag) for x in numbers):
        raise _too_large(description)
    return Mechanism(
        name=description.name,
        source=description.source,
        description=description,
        link_names=tuple(link.name for link in links),
        parent=parent,
        order=order,
        A=tuple(A),
        B=tuple(B),
        gamma=description.gravity,
        energy_offset=offset,
        damping=tuple(damping),
        rows=tuple(rows),
        actuated=_actuated(description, pivots),
        pivots=tuple(pivots),
        tips=tuple(_point(pivots, Point(k, complex(link.l))) for k, link in enumerate(links)),
        centres=tuple(_point(pivots, Point(k, link.r)) for k, link in enumerate(links)),
        weights=tuple(weights),
        moments=tuple(moments),
        springs=tuple(_spring(x, pivots) for x in description.springs if isinstance(x, Spring)),
        joint_springs=tuple(x for x in joint_springs if x.stiffness),
        forces=tuple(forces),
        friction=tuple(
            (k, link.friction)
            for k, link in enumerate(links)
            if link.friction is not None and link.friction.torque
        ),
    )


def _too_large(description: Description) -> InputError:
    limit = "masses, lengths or gravity are too large: their products overflow"
    return InputError("links", where=description.source, limit=limit)


def _order(parent: Sequence[int | None]) -> tuple[int, ...]:
    """The links, each after the one it hangs from."""
    children: dict[int | None, list[int]] = {}
    for k, j in enumerate(parent):
        children.setdefault(j, []).append(k)
    order = list(children.get(None, []))
    for k in order:
        order += children.get(k, [])
    return tuple(order)


def _point(pivots: Sequence[PlanarPoint], point: Point) -> PlanarPoint:
    """The point in terms of E; the pivot of its link must be known."""
    if point.link is None:
        return PlanarPoint(point.at, ())
    pivot = pivots[point.link]
    return PlanarPoint(pivot.constant, (*pivot.terms, (point.link, point.at)))


def _difference(first: PlanarPoint, second: PlanarPoint) -> PlanarPoint:
    """First less second, without the terms that cancel."""
    terms: dict[int, complex] = dict(first.terms)
    for k, coefficient in second.terms:
        terms[k] = terms.get(k, 0j) - coefficient
    kept = tuple((k, coefficient) for k, coefficient in terms.items() if coefficient != 0)
    return PlanarPoint(first.constant - second.constant, kept)


def _force(load: Load, pivots: Sequence[PlanarPoint]) -> Force:
    assert load.point.link is not None
    return Force(load.point.link, _point(pivots, load.point), load.force, load.turns)


def _spring(spring: Spring, pivots: Sequence[PlanarPoint]) -> PointSpring:
    first, second = _point(pivots, spring.first), _point(pivots, spring.second)
    return PointSpring(
        first=spring.first.link,
        second=spring.second.link,
        ends=(first, second),
        between=_difference(first, second),
        stiffness=spring.stiffness,
        length=spring.length,
        damping=spring.damping,
    )


def _rows(description: Description, pivots: Sequence[PlanarPoint]) -> list[ClosureRow]:
    rows: list[ClosureRow] = []
    for c, closure in enumerate(description.closures):
        gap = _difference(_point(pivots, closure.first), _point(pivots, closure.second))
        directions = (1 + 0j, 1j) if closure.along is None else (1j * closure.along,)
        for direction in directions:
            w = direction.conjugate()
            P = tuple((k, w * coefficient) for k, coefficient in gap.terms)
            rows.append(ClosureRow(c, direction, P, (w * gap.constant).real))
    return rows


def _coupling_rows(description: Description, size: float) -> list[ClosureRow]:
    """Each coupling in absolute angles, as long as the closures' rows are."""
    links = description.links
    arm = size or max((link.l for link in links), default=0.0) or 1.0
    found: list[ClosureRow] = []
    for coupling in description.couplings:
        angles: dict[int, float] = {}
        for joint, ratio in ((coupling.joint, -1.0), *coupling.terms):
            # q_k = alpha_k - alpha_above
            for link, sign in ((joint, -1.0), (links[joint].hangs_from.link, 1.0)):
                if link is not None:
                    angles[link] = angles.get(link, 0.0) + sign * ratio * arm
        kept = tuple((k, value) for k, value in angles.items() if value != 0.0)
        found.append(ClosureRow(None, 0j, (), -arm * coupling.angle, kept, arm))
    return found


def loop_joints(description: Description, pivots: Sequence[PlanarPoint]) -> list[set[int]]:
    """For each closure the joints of its loop: those on the path to one side only."""
    loops: list[set[int]] = []
    for closure in description.closures:
        sides = [_point(pivots, point).terms for point in (closure.first, closure.second)]
        first, second = ({k for k, _ in terms} for terms in sides)
        loops.append(first ^ second)
    return loops


def _actuated(description: Description, pivots: Sequence[PlanarPoint]) -> tuple[int, ...]:
    """As the scene says; else every joint that is free, and the first of each group of loops.

    The joints of a coupling belong together as those of a loop do.
    """
    if description.actuated is not None:
        return description.actuated
    groups: list[set[int]] = []
    coupled = [{x.joint, *(k for k, _ in x.terms)} for x in description.couplings]
    for loop in loop_joints(description, pivots) + coupled:
        apart = [group for group in groups if not group & loop]
        joined = loop.union(*(group for group in groups if group & loop))
        groups = [*apart, joined]
    closed = set().union(*groups)
    free = {k for k in range(len(description.links)) if k not in closed}
    return tuple(sorted(free | {min(group) for group in groups if group}))


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
    for name in Arrays.__slots__:
        getattr(arrays, name).flags.writeable = False
    return arrays


def joint_index(mechanism: Mechanism) -> Mapping[str, int]:
    """The joint (from 0) of each link name."""
    return {name: k for k, name in enumerate(mechanism.link_names)}
