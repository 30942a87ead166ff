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
from collections.abc import Sequence
from pathlib import Path

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import ClosureRow as ClosureRow
from robodyn.mechanics.planar_model import Force as Force
from robodyn.mechanics.planar_model import Mechanism as Mechanism
from robodyn.mechanics.planar_model import PlanarPoint as PlanarPoint
from robodyn.mechanics.planar_model import PointSpring as PointSpring
from robodyn.mechanics.planar_model import joint_index as joint_index
from robodyn.scene import description as scene_files
from robodyn.scene.scene import Description, JointSpring, Load, Moment, Point, Spring


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
        return _build(description)
    except OverflowError:
        raise too_large(description) from None


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
        raise too_large(description)
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


def _point(pivots: Sequence[PlanarPoint], point: Point) -> PlanarPoint:
    """The point in terms of E; the pivot of its link must be known."""
    if point.link is None:
        return PlanarPoint(point.at, ())
    pivot = pivots[point.link]
    own = ((point.link, point.at),) if point.at != 0 else ()
    return PlanarPoint(pivot.constant, pivot.terms + own)


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
        sides = [_point(pivots, point).terms for point in (closure.first, closure.second)]
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
