"""The force in every joint, and the force of a mechanism on the ground.

Newton's equation for all bodies b carried by link k, itself and payloads included, has one unknown:
the force R_k that acts on link k at its own joint, from the link (or ground) that it hangs from.
With the pin forces f_c on the first side of closure c,

    R_k = sum_b m_b (a_b - gamma) - sum_c (+1 first side, -1 second side below k) f_c - F_k

F_k is the force of springs and loads on all that link k carries.

The ground feels the change of momentum and the weight, on whatever path the forces take:

    F = sum_b m_b (gamma - a_b)      M = sum_b s_b x m_b (gamma - a_b) - sum_k I_k alphadd_k

and the loads besides.  A rotor that accelerates turns back the link that carries it, and so the
ground: - sum J (w_carrier + ratio qd)' is in M too.  Joint torques, dampers, pins and springs
between links are internal; those at the ground are included in F and M.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.cam_contacts import ContactForce, contacts_on_links
from robodyn.dynamics.closed_form import Points, dense, points_of
from robodyn.dynamics.dense_dynamics import decompose
from robodyn.dynamics.dynamics import (
    as_multipliers,
    coupling_torques,
    kept_moments,
    pin_forces,
    pins_at,
)
from robodyn.dynamics.pin_friction import at_closures
from robodyn.elements.builder import LinkMoment, PointForce
from robodyn.engines.row_values import rows_of
from robodyn.loops.closing import loop_size
from robodyn.loops.closures import scaled_jacobian
from robodyn.mechanics import parts
from robodyn.mechanics.link_tree import Tree, places_of
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.placed import Placed, absolute_rates, as_states, frame_rates, matvec, placed
from robodyn.scene.scene import Point
from robodyn.tables.arrays import Array, Complex

Part = Callable[[Mechanism], Mechanism]


class Acts(NamedTuple):
    """Effects of elements on links: forces at points, N, and moments, N m, of numbers (...)."""

    forces: Sequence[tuple[PointForce, Any]]  # complex ones
    moments: Sequence[tuple[LinkMoment, Any]]


Push = tuple[Complex, Complex, Array]  # where a force acts, the force, which links carry that

FELT = 1e-9  # part of the largest force of a null vector that is more than rounding


class Bodies(NamedTuple):
    """The b point masses (centres of gravity and payloads) of a mechanism with n links.

    Numbers are floats, or formulas in arrays of objects.
    """

    mass: Array  # (b,) kg
    points: Points
    below: Array  # (b, n), 1 where link k carries body b
    carried: Array  # (n, n), 1 where link k is on the path to link j, itself included
    inertia: Array  # (n,) kg m^2
    rotors: Array  # (m,) kg m^2
    spins: Array  # (m, n): rates of rotors are spins @ qd


class Felt:
    """The quantities from which joint and ground forces follow, in numbers (...) or formulas.

    Formulas are in arrays of objects, complex ones as `Planar`.  `at` is the placement, `bent` has
    X'' and E''; also x'' and qdd (n,).  `pins` (..., closures), N, act on the first sides, `kept`
    (..., k), N m, belong to fixed angles, `rubbed` (..., closures), N m, are friction moments
    there.  `rows` returns what acts for a part of the mechanism (`parts.py`).
    """

    def __init__(
        self,
        mechanism: Mechanism,
        at: Placed,
        bent: Placed,
        xdd: Array,
        qdd: Array,
        pins: Complex,
        kept: Array,
        rows: Callable[[Part], Acts],
        contacts: Sequence[ContactForce] = (),
        rubbed: Array | None = None,
    ) -> None:
        self.mechanism, self.bodies, self.at = mechanism, bodies_of(mechanism), at
        self.contacts = contacts
        self.pins, self.kept, self.rows, self.rubbed = pins, kept, rows, rubbed
        bodies = self.bodies
        # where the bodies are, (..., b) m, and the load m (gamma - a) of each, (..., b) N
        self.place = bodies.points.place(at)
        self.load = (-bodies.points.moved(bent) + mechanism.gamma) * bodies.mass
        self.turning = frame_rates(mechanism, xdd)
        # the moment of each rotor's spin on what carries it, N m
        self.spun = list(np.moveaxis(-(matvec(bodies.spins, qdd) * bodies.rotors), -1, 0))

    def reactions(self) -> Complex:
        """Return the force on each link at its own joint, (..., n)."""
        forces: Complex = -matvec(self.bodies.below.T, self.load)
        for _, force, link in self._acting():
            if link is not None:
                forces = forces - np.multiply.outer(force, self.bodies.carried[link])
        if self.mechanism.description.closures:
            forces = forces - matvec(sides_of(self.mechanism).T, self.pins)
        return forces

    def slide_moments(self) -> list[Array]:
        """Return the moment on each sliding link about its origin."""
        carried, tree = self.bodies.carried, Tree(self.mechanism.description.links)
        each = (np.moveaxis(x, -1, 0) for x in (self.place, self.load))
        forces: list[Push] = list(zip(*each, self.bodies.below, strict=True))
        moments = self._moments(parts.acting)[..., :-1]
        for there, force, link in self._acting():
            if link is not None:
                forces.append((there, force, carried[link]))
        for there, pin, held, side in self._pinned(tree):
            forces.append((there, pin, carried[side]))
            moments[..., side] += held
        found = []
        for k in self.mechanism.slides:
            origin = self._place(tree.point(Point(k, 0j)))
            total = (moments * carried[:, k]).sum(axis=-1)
            for there, force, below in forces:
                turning = np.multiply((there - origin).conjugate(), force).imag
                total = total + turning * below[k]
            found.append(-total)
        return found

    def _moments(self, part: Part) -> Array:
        """Return the moments on each link of inertia, rotors and `part`, (..., n + 1).

        The last is that on the ground.
        """
        mechanism = self.mechanism
        own = -(self.turning * self.bodies.inertia)
        moments = np.concatenate([own, np.zeros_like(own[..., :1])], axis=-1)
        for spin, back in zip(mechanism.spins, self.spun, strict=True):
            moments[..., -1 if spin.carrier is None else spin.carrier] += back
        for link, torque in mechanism.steady_moments:
            moments[..., link] += torque
        for couple, value in self.rows(part).moments:
            moments[..., -1 if couple.link is None else couple.link] += value
        return moments

    def _acting(self) -> Iterator[tuple[Complex, Complex, int | None]]:
        """Yield the forces of elements and cams: point, force and link."""
        for contact in self.contacts:
            yield contact.place, contact.force, contact.cam.link
            yield contact.place, -contact.force, contact.cam.driver
        for acting, force in self.rows(parts.acting).forces:
            yield self._place(acting.at[0]), force, acting.at[1]
            if acting.back is not None:
                yield self._place(acting.back[0]), -force, acting.back[1]

    def _pinned(self, tree: Tree) -> Iterator[tuple[Complex, Complex, Array | float, int]]:
        """Yield the effects of closures on their links: point, force, moment and link."""
        kept = iter(np.moveaxis(self.kept, -1, 0))
        pins = np.moveaxis(self.pins, -1, 0)
        for c, (closure, pin) in enumerate(
            zip(self.mechanism.description.closures, pins, strict=True)
        ):
            there = self._place(tree.point(closure.first))
            held = 0.0 if closure.aligned is None else next(kept)
            if self.rubbed is not None:
                held = held + self.rubbed[..., c]
            for side, sign in ((closure.first, 1.0), (closure.second, -1.0)):
                if side.link is not None:
                    yield there, pin * sign, held * sign, side.link

    def _place(self, point: PlanarPoint) -> Complex:
        return np.moveaxis(points_of(self.mechanism, [point]).place(self.at), -1, 0)[0]  # type: ignore[no-any-return]

    def shaking(self) -> tuple[Array, Array, Array]:
        """Return Fx, Fy and M on the ground."""
        force = self.load.sum(axis=-1)
        # moments on links that cannot turn are no load of the mechanism's, but of the ground's
        moment = _imaginary(self.place.conj() * self.load).sum(axis=-1)
        moment = moment + self._moments(parts.loaded).sum(axis=-1)
        if loads := self.rows(parts.loaded).forces:
            F = np.stack([value for _, value in loads], axis=-1)
            arms = points_of(self.mechanism, [x.at[0] for x, _ in loads]).place(self.at)
            force = force + F.sum(axis=-1)
            moment = moment + _imaginary(arms.conj() * F).sum(axis=-1)
        return force.real, force.imag, moment


def _imaginary(z: NDArray[Any]) -> NDArray[Any]:
    if z.dtype != object:
        return z.imag
    return np.array([x.imag for x in z], object)


def reactions(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    multipliers: ArrayLike,
    t: ArrayLike = 0.0,
) -> Array:
    """Return the force on each link at its own joint, (..., n, 2), N, ground axes.

    R_k = sum_b m_b (a_b - gamma) - F_k less the pin forces, over the bodies b that link k carries;
    F_k includes the contact forces of cams.  It comes from the link, or the ground, from which the
    link hangs. q, qd, qdd (..., n) are a motion, rad and s, and multipliers (..., r) N those of
    `inverse_dynamics_and_forces` or `forward_dynamics_and_forces` for it, (..., 0) without
    closures.  Raises InputError for arrays that do not fit.
    """
    lam = as_multipliers(mechanism, multipliers)
    forces = _of_numbers(mechanism, q, qd, qdd, t, lam).reactions()
    return np.stack([forces.real, forces.imag], axis=-1)


def slide_moments(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    multipliers: ArrayLike,
    t: ArrayLike = 0.0,
) -> Array:
    """Return the moment on each sliding link about its origin, (..., slides), N m.

    It comes from the link it slides on, and keeps it from turning.  Arguments as for `reactions`.
    """
    felt = _of_numbers(mechanism, q, qd, qdd, t, as_multipliers(mechanism, multipliers))
    if not mechanism.slides:
        return np.zeros((*felt.place.shape[:-1], 0))
    return np.stack(felt.slide_moments(), axis=-1)


def shaking_force(
    mechanism: Mechanism, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, t: ArrayLike = 0.0
) -> Array:
    """Return the force of the mechanism on the ground, (..., 3): Fx, Fy N, M N m.

    F = sum_b m_b (gamma - a_b), plus loads; M is about the origin, counter-clockwise.  It includes
    all joints on the ground, closures to ground points, sliders, springs to the ground, and torques
    and dampers of ground joints. q, qd, qdd (..., n) are a motion that the torques make, rad and s,
    at times t.  Raises InputError for arrays that do not fit.
    """
    return np.stack(_of_numbers(mechanism, q, qd, qdd, t).shaking(), axis=-1)


def _of_numbers(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    t: ArrayLike,
    lam: Array | None = None,
) -> Felt:
    """Build `Felt` from arrays; without `lam` it has no pin forces."""
    at, xd = placed(mechanism, q), absolute_rates(mechanism, qd)
    xdd, joints = absolute_rates(mechanism, qdd, "qdd"), np.asarray(qdd, float)
    pins, kept, rubbed = np.zeros(0, complex), np.zeros(0), None
    if lam is not None:
        pins, kept = pins_at(mechanism, lam, at.E), kept_moments(mechanism, lam)
        if any(x.closure is not None for x in mechanism.rubbing):
            friction, rubbed = at_closures(mechanism, q, qd, pins)
            pins = pins + friction

    def rows(part: Part) -> Acts:
        if not any(x.acts for x in mechanism.elements):
            return Acts((), ())
        found = rows_of(part, mechanism)
        forces, couples = found.acting, found.couples
        each = np.moveaxis(found.planar("forces", q, qd, t), -1, 0) if forces else ()
        moments = np.moveaxis(found("moments", q, qd, t), -1, 0) if couples else ()
        return Acts(list(zip(forces, each, strict=True)), list(zip(couples, moments, strict=True)))

    bent = at.accelerations(mechanism, xd, xdd)
    contacts = (
        () if lam is None else contacts_on_links(mechanism, as_states(mechanism, "q", q), at, lam)
    )
    return Felt(mechanism, at, bent, xdd, joints, pins, kept, rows, contacts, rubbed)


def dependent_rows(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> NDArray[np.int64]:
    """Return how many closure rows depend on the others at q (..., n): r - rank Psi, (...).

    If it is not zero, the pin forces are not unique.
    """
    found = decompose(mechanism, scaled_jacobian(mechanism, q, t))
    return np.asarray(len(mechanism.rows) - found.rank)


def not_unique(
    mechanism: Mechanism, q: ArrayLike, t: ArrayLike
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return closures and links whose pin force or reaction is not unique at q (n,).

    lambda may change by any null vector of Psi^T, which `reactions` carry into the joints of the
    loops.  Both are empty if the closures are independent.
    """
    changes = pin_forces(mechanism, _free_multipliers(mechanism, q, t), q) @ [1, 1j]
    return _felt(changes, FELT), _felt(changes @ sides_of(mechanism), FELT)


def dependent_couplings(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> tuple[int, ...]:
    """Return the couplings whose torque is not unique at q (n,)."""
    changes = coupling_torques(mechanism, _free_multipliers(mechanism, q, t))
    return _felt(changes, FELT * loop_size(mechanism))


def names_not_unique(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> str:
    """Return the names of force columns that are not unique, at the first such state.

    q is (T, n).  Returns "" if all are unique.
    """
    states = as_states(mechanism, "q", q)
    dependent = dependent_rows(mechanism, states, t)
    if not dependent.any():
        return ""
    first = int(np.argmax(dependent > 0))
    state, now = states[first], np.broadcast_to(np.asarray(t, float), dependent.shape)[first]
    closures, links = not_unique(mechanism, state, now)
    names = [f"fx{c + 1},fy{c + 1}" for c in closures]
    names += [f"tc{c + 1}" for c in dependent_couplings(mechanism, state, now)]
    names += [f"rx{k + 1},ry{k + 1} ({mechanism.link_names[k]})" for k in links]
    return "; ".join(names)


def _free_multipliers(mechanism: Mechanism, q: ArrayLike, t: ArrayLike) -> Array:
    """Return the null vectors of Psi^T at q (n,), (d, r)."""
    found = decompose(mechanism, scaled_jacobian(mechanism, q, t))
    return found.U[:, int(found.rank) :].T


def _felt(changes: NDArray[np.inexact], least: float) -> tuple[int, ...]:
    return tuple(np.flatnonzero((np.abs(changes) > least).any(axis=0)).tolist())


@lru_cache(maxsize=64)
def bodies_of(mechanism: Mechanism) -> Bodies:
    """Return the bodies of a mechanism, at points summed from the ground."""
    scene = mechanism.description
    mechanism.check_masses(still=scene.gravity != 0 or scene.field is not None)
    links, n = mechanism.description.links, mechanism.n
    own = [(k, link.m, Point(k, link.r)) for k, link in enumerate(links) if link.m]
    own += [(k, x.payload, Point(k, x.l)) for k, x in enumerate(links) if x.payload]
    carried = np.eye(n)
    for k in mechanism.order:
        above = mechanism.parent[k]
        if above is not None:
            carried[k] += carried[above]
    spins = [spin.rates for spin in mechanism.spins]
    return Bodies(
        mass=dense([mass for _, mass, _ in own], float),
        points=Points(*places_of(Tree(links), [point for _, _, point in own])),
        below=carried[[k for k, _, _ in own]],
        carried=carried,
        inertia=dense([link.I for link in links], float),
        rotors=dense([spin.inertia for spin in mechanism.spins], float),
        spins=dense([x.get(k, 0.0) for x in spins for k in range(n)], float).reshape(-1, n),
    )


def sides_of(mechanism: Mechanism) -> Array:
    """Return +1 and -1 where link k carries the first or second side, (closures, n)."""
    carried = bodies_of(mechanism).carried
    sides = np.zeros((len(mechanism.description.closures), mechanism.n))
    for row, closure in zip(sides, mechanism.description.closures, strict=True):
        for side, sign in ((closure.first, 1.0), (closure.second, -1.0)):
            if side.link is not None:
                row += sign * carried[side.link]
    return sides
