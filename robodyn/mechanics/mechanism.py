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

What holds them all is `planar_model.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import ClosureRow as ClosureRow
from robodyn.mechanics.planar_model import Force as Force
from robodyn.mechanics.planar_model import Mechanism as Mechanism
from robodyn.mechanics.planar_model import PlanarPoint as PlanarPoint
from robodyn.mechanics.planar_model import PointSpring as PointSpring
from robodyn.mechanics.planar_model import joint_index as joint_index
from robodyn.scene import description as scene_files
from robodyn.scene.scene import Description, JointSpring, Moment, Point, Spring


def load(path: str | Path) -> Mechanism:
    """The mechanism that the scene file at `path` describes.

    Raises DescriptionError (an InputError) that tells every fault of the file.
    """
    return build(scene_files.read(path))


def build(description: Description) -> Mechanism:
    """The numeric model of a description.

    Raises InputError where the products of masses and lengths leave the range of floats, and for a
    closure of points that cannot move apart.
    """
    try:
        mechanism = constants(description)
        size = max((row.size for row in mechanism.rows), default=0.0)
        rows = mechanism.rows + tuple(_coupling_rows(description, size))
        mechanism = replace(mechanism, rows=rows)
    except OverflowError:
        raise too_large(description) from None
    numbers = [*(entry[2] for entry in mechanism.A), *mechanism.B, *mechanism.weights]
    numbers += [mechanism.energy_offset, *(row.offset for row in rows)]
    if not all(math.isfinite(x.real) and math.isfinite(x.imag) for x in numbers):
        raise too_large(description)
    return mechanism


def constants(description: Description) -> Mechanism:
    """The numeric model less couplings; of symbols too, where a description has them for numbers.

    Raises InputError for a closure of points that cannot move apart.
    """
    links = description.links
    parent = tuple(link.hangs_from.link for link in links)
    order = _order(parent)
    carried = [link.m + link.payload for link in links]
    B = [link.r * link.m + link.l * link.payload for link in links]
    inertia = [link.I + link.m * _square(link.r) + link.payload * link.l * link.l for link in links]
    for k in reversed(order):  # what link k carries acts on its parent at k's own joint
        p, j = links[k].hangs_from.at, parent[k]
        if j is not None:
            carried[j] = carried[j] + carried[k]
            B[j] = B[j] + p * carried[k]
            inertia[j] = inertia[j] + carried[k] * _square(p)

    places = pivots(description)
    A: list[tuple[int, int, complex]] = [(k, k, inertia[k]) for k in range(len(links))]
    for k in order:
        A += [(j, k, p.conjugate() * B[k]) for j, p in places[k].terms if p * B[k]]

    pull = description.gravity.conjugate()
    offset = -sum(
        (pull * place.constant).real * (link.m + link.payload)
        for place, link in zip(places, links, strict=True)
    )
    weights, moments = [pull * b for b in B], [0.0] * len(links)
    forces: list[Force] = []
    for entry in description.loads:
        if isinstance(entry, Moment):
            moments[entry.link] = moments[entry.link] + entry.torque
            continue
        assert entry.point.link is not None
        at = point_of(places, entry.point)
        forces.append(Force(entry.point.link, at, entry.force, entry.turns))
        if not entry.turns:
            force = entry.force.conjugate()
            offset = offset - (force * at.constant).real
            for k, c in at.terms:
                weights[k] = weights[k] + force * c
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
        damping=joint_damping(description),
        rows=tuple(closure_rows(description, places)),
        actuated=_actuated(description, places),
        pivots=tuple(places),
        tips=tuple(point_of(places, Point(k, link.l)) for k, link in enumerate(links)),
        centres=tuple(point_of(places, Point(k, link.r)) for k, link in enumerate(links)),
        weights=tuple(weights),
        moments=tuple(moments),
        springs=tuple(_spring(x, places) for x in description.springs if isinstance(x, Spring)),
        joint_springs=tuple(
            x for x in description.springs if isinstance(x, JointSpring) and x.stiffness
        ),
        forces=tuple(forces),
        friction=tuple(
            (k, link.friction)
            for k, link in enumerate(links)
            if link.friction is not None and link.friction.torque
        ),
    )


def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


def too_large(description: Description) -> InputError:
    """The error of a scene whose numbers leave the range of floats."""
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


def pivots(description: Description) -> list[PlanarPoint]:
    """Each link's own joint in terms of E."""
    found: dict[int, PlanarPoint] = {}
    for k in _order([link.hangs_from.link for link in description.links]):
        found[k] = point_of(found, description.links[k].hangs_from)
    return [found[k] for k in range(len(found))]


def joint_damping(description: Description) -> tuple[float, ...]:
    """Of the joints' own dampers and those of the springs at them."""
    damping = [link.damping for link in description.links]
    for spring in description.springs:
        if isinstance(spring, JointSpring):
            damping[spring.joint] = damping[spring.joint] + spring.damping
    return tuple(damping)


def point_of(
    pivots: Sequence[PlanarPoint] | Mapping[int, PlanarPoint], point: Point
) -> PlanarPoint:
    """The point in terms of E; the pivot of its link must be known."""
    if point.link is None:
        return PlanarPoint(point.at, ())
    pivot = pivots[point.link]
    own = ((point.link, point.at),) if point.at else ()
    return PlanarPoint(pivot.constant, pivot.terms + own)


def difference(first: PlanarPoint, second: PlanarPoint) -> PlanarPoint:
    """First less second, without the terms that cancel."""
    terms: dict[int, complex] = dict(first.terms)
    for k, coefficient in second.terms:
        terms[k] = terms.get(k, 0j) - coefficient
    kept = tuple((k, coefficient) for k, coefficient in terms.items() if coefficient)
    return PlanarPoint(first.constant - second.constant, kept)


def _spring(spring: Spring, pivots: Sequence[PlanarPoint]) -> PointSpring:
    first, second = point_of(pivots, spring.first), point_of(pivots, spring.second)
    return PointSpring(
        first=spring.first.link,
        second=spring.second.link,
        ends=(first, second),
        between=difference(first, second),
        stiffness=spring.stiffness,
        length=spring.length,
        damping=spring.damping,
    )


def closure_rows(description: Description, pivots: Sequence[PlanarPoint]) -> list[ClosureRow]:
    """The equations of the closures; InputError for points that cannot move apart."""
    rows: list[ClosureRow] = []
    for c, closure in enumerate(description.closures):
        gap = difference(point_of(pivots, closure.first), point_of(pivots, closure.second))
        if not gap.terms:  # a row of zeros, against which nothing can be measured
            limit = "joins points that cannot move apart: it says nothing, or never holds"
            raise InputError(f"closures[{c}]", where=description.source, limit=limit)
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
        sides = [point_of(pivots, point).terms for point in (closure.first, closure.second)]
        first, second = ({k for k, _ in terms} for terms in sides)
        loops.append(first ^ second)
    return loops


def _actuated(description: Description, pivots: Sequence[PlanarPoint]) -> tuple[int, ...]:
    """As the scene says; else every joint outside of loops, and the first of each group of loops.

    Loops that share joints, or have coupled ones, are a group; a joint that a coupling gives is
    never actuated, and a group with a coupled joint outside of loops is driven from there.
    """
    if description.actuated is not None:
        return description.actuated
    loops = loop_joints(description, pivots)
    in_loops = set().union(*loops)
    followers = {coupling.joint for coupling in description.couplings}
    groups: list[set[int]] = []
    coupled = [{x.joint, *(k for k, _ in x.terms)} for x in description.couplings]
    for tied in loops + coupled:
        apart = [group for group in groups if not group & tied]
        joined = tied.union(*(group for group in groups if group & tied))
        groups = [*apart, joined]
    driven = {k for k in range(len(description.links)) if k not in in_loops | followers}
    for group in groups:
        if group & in_loops and not group & driven:
            driven.update(sorted(group - followers)[:1])
    return tuple(sorted(driven))
