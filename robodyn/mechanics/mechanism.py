"""Builds a mechanism: the constants of the formula that covers every planar linkage.

Points of the plane are complex numbers and E_k = exp(i alpha_k), alpha_k the angle of link k's
frame.  A link on a prismatic joint has the frame of the link on which it slides, and moves with its
displacement s_k: X_k = s_k E there, X_k = E_k for the others.  Every point of the mechanism is then
`constant + sum_k rho_k X_k`, and the whole dynamics follows from

    A_jk = sum_b m_b conj(rho_bj) rho_bk + I_j delta_jk      B_k = sum_b m_b rho_bk      (b: bodies)

and from the closures, which are linear in X. For j above k in the tree every body below k leaves
link j at the same point p_jk, so A_jk = conj(p_jk) B_k, with B_k the first moment of all that link
k carries.  So the constants cost O(links * depth), and only nonzero ones are kept.  Expensive ones
(A, and points in terms of X) are computed when first read, so that a command with wrong options
fails at once.

Constant forces and torques act like weights: with p_b = const + sum_k c_k X_k the point of such a
force F, the potential energy is

    PE = const - Re(weights . X) - moments . alpha,      weights_k = conj(gamma) B_k + conj(F) c_k

The result is a `Mechanism` (`planar_model.py`).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from robodyn.elements.base import Element, whole
from robodyn.elements.contacts import HARD, STICKS
from robodyn.elements.joints import Range, Rotor
from robodyn.elements.kinds import place_of
from robodyn.elements.springs import JointDamper
from robodyn.errors import InputError
from robodyn.mechanics.driven import driven_joints
from robodyn.mechanics.link_tree import Bodies, Tree, carried_by, largest, places_of
from robodyn.mechanics.link_tree import bodies as bodies_of
from robodyn.mechanics.loop_rows import closure_rows, coupling_rows
from robodyn.mechanics.planar_model import ClosureRow as ClosureRow
from robodyn.mechanics.planar_model import Inertias, OnDemand
from robodyn.mechanics.planar_model import Mechanism as Mechanism
from robodyn.mechanics.planar_model import PlanarPoint as PlanarPoint
from robodyn.mechanics.planar_model import joint_index as joint_index
from robodyn.scene import description as scene_files
from robodyn.scene.scene import Description, Point
from robodyn.scene.welds import without_welds


def load(path: str | Path) -> Mechanism:
    """Return the mechanism of the scene file at `path`.

    Raises DescriptionError (an InputError) that lists every fault of the file.
    """
    return build(scene_files.read(path))


def build(description: Description) -> Mechanism:
    """Return the numeric model of a description.

    Raises InputError if products of masses and lengths overflow, for a closure of points that
    cannot move apart, and for friction by the forces in pins beside contacts.
    """
    try:
        description = without_welds(description)
        mechanism = constants(description)
        moments, phases = mechanism.steady_moments, Tree(description.links).phases
        if moments and any(x != 1.0 for x in phases):  # PE is zero where the link lies along +X
            turned = sum(torque * cmath.phase(phases[k]) for k, torque in moments)
            mechanism = replace(mechanism, energy_offset=mechanism.energy_offset - turned)
        if description.couplings:
            rows = mechanism.rows + tuple(coupling_rows(description))
            mechanism = replace(mechanism, rows=rows)
        numbers = [*mechanism.B, *mechanism.weights, *largest(Tree(description.links))]
        numbers += [mechanism.energy_offset, *(row.offset for row in mechanism.rows)]
        numbers += mechanism.damping
        numbers += [x.inertia * c * c for x in mechanism.spins for c in x.rates.values()]
    except OverflowError:
        raise too_large(description) from None
    if not all(math.isfinite(x.real) and math.isfinite(x.imag) for x in numbers):
        raise too_large(description)
    if mechanism.rubbing and mechanism.contacts & {STICKS, HARD}:
        place = f"{mechanism.rubbing_place(mechanism.rubbing[0])}.coefficient"
        limit = "stands beside friction with static, or stops with restitution: what sticks and "
        limit += "bounces is decided without friction by the force in a pin"
        raise InputError(place, where=description.source, limit=limit)
    return mechanism


def constants(description: Description, bodies: Bodies | None = None) -> Mechanism:
    """Return the numeric model without couplings; numbers may be symbols.

    `bodies` replace the mass properties of the links.  Raises InputError for a closure of points
    that cannot move apart.
    """
    links, tree = description.links, Tree(description.links)
    carried, first, inertia = carried_by(tree, bodies)
    elements = [element for _, element in description.elements]
    forces = (y.steady_force for x in elements for y in x.placed(tree))
    steady = [0j] * len(links)  # of constant forces: their sum below each link, and its moment
    moment = [0j] * len(links)
    for point, force in filter(None, forces):
        if point.link is not None:
            steady[point.link] += force.conjugate()
            moment[point.link] += point.at * force.conjugate()
    for k in reversed(tree.order):
        p, j = links[k].hangs_from.at, tree.parent[k]
        if j is not None:
            steady[j] += steady[k]
            moment[j] += p * steady[k]

    gamma = description.gravity.conjugate()
    roots = [(k, link.hangs_from.at) for k, link in enumerate(links) if tree.parent[k] is None]
    offset = -sum((gamma * at).real * carried[k] + (at * steady[k]).real for k, at in roots)
    B, weights, moments = [0j] * len(links), [0j] * len(links), [0.0] * len(links)
    for k, d in enumerate(tree.frames):
        own = tree.turned(k, first[k]), tree.turned(k, gamma * first[k] + moment[k])
        if d is None:
            offset -= own[1].real
        else:
            B[d], weights[d] = (B[d] + own[0], weights[d] + own[1]) if d != k else own
        if links[k].slides:
            phase = tree.phases[k]
            B[k], weights[k] = phase * carried[k], phase * (gamma * carried[k] + steady[k])
    for k, torque in filter(None, (x.steady_moment for x in elements)):
        if (d := tree.frames[k]) is not None:
            moments[d] += torque
    return Mechanism(
        name=description.name,
        source=description.source,
        description=description,
        link_names=tuple(link.name for link in links),
        parent=tree.parent,
        order=tree.order,
        A=Inertias(_couplings_of_links, _dense_couplings, tree, carried, first, inertia),
        B=tuple(B),
        gamma=description.gravity,
        energy_offset=offset,
        rows=tuple(closure_rows(description, tree)),
        actuated=_actuated(description, tree),
        pivots=OnDemand(map, tree.point, [link.hangs_from for link in links]),
        tips=OnDemand(map, tree.point, [Point(k, x.l) for k, x in enumerate(links)]),
        centres=OnDemand(map, tree.point, [Point(k, x.r) for k, x in enumerate(links)]),
        weights=tuple(weights),
        moments=tuple(moments),
        elements=OnDemand(_elements, tree, description, bodies),
        ranges=tuple(_ranges(description)),
        tree=tree,
        slides=tuple(k for k, link in enumerate(links) if link.slides),
        frames=tuple(tree.frames),
        unit=tree.unit,
    )


def with_kept(named: Mechanism, kept: Mapping[int, ClosureRow]) -> Mechanism:
    """Return the mechanism with rows of fixed angles, each after its closure's other rows."""
    rows: list[Any] = [*((row.closure, row) for row in named.rows), *kept.items()]
    return replace(named, rows=tuple(row for _, row in sorted(rows, key=lambda pair: pair[0])))


def _couplings_of_links(
    tree: Tree, mass: Sequence[float], B: Sequence[complex], inertia: Sequence[float]
) -> Iterator[tuple[int, int, complex]]:
    """Yield the nonzero entries of A, diagonal first."""
    found: dict[tuple[int, int], complex] = {}

    def add(j: int | None, k: int | None, value: complex) -> None:
        if j is None or k is None or not value:
            return
        if j == k:  # as A_jk and as A_kj
            value = 2.0 * value.real
        elif (k, j) in found:
            j, k, value = k, j, value.conjugate()
        found[j, k] = found[j, k] + value if (j, k) in found else value

    for k, value in enumerate(inertia):
        if tree.frames[k] == k:
            found[k, k] = value
        elif tree.links[k].slides:
            found[k, k] = mass[k]
    for k, value in enumerate(inertia):
        if tree.links[k].slides and (d := tree.frames[k]) is not None:
            found[d, d] += value
    for k in tree.order:
        own = tree.turned(k, B[k])
        above = tree.point(tree.links[k].hangs_from).terms
        if tree.links[k].slides:
            add(tree.frames[k], k, (own.conjugate() * tree.phases[k]))
            for j, p in above:
                add(j, k, p.conjugate() * (tree.phases[k] * mass[k]))
        for j, p in above:
            add(j, tree.frames[k], p.conjugate() * own)
    yield from ((j, k, value) for (j, k), value in found.items())


def _dense_couplings(
    tree: Tree, mass: Sequence[float], B: Sequence[complex], inertia: Sequence[float]
) -> Any:
    """Return A as an array (n, n)."""
    import numpy as np

    n, above = len(inertia), places_of(tree)[1]
    half, own = np.zeros((n, n), complex), np.zeros(n)  # half[k, j] of A_jk, as A_kj is conjugate
    for k in tree.order:
        first, d = tree.turned(k, B[k]), tree.frames[k]
        if tree.links[k].slides:
            half[k] += above[k].conj() * (tree.phases[k] * mass[k])
            own[k] += mass[k]
            if d is not None:
                half[k, d] += first.conjugate() * tree.phases[k]
        if d is not None:
            half[d] += above[k].conj() * first
            own[d] += inertia[k]
    A = half.conj()
    A += half.T
    A[np.diag_indices(n)] += own
    return A


def _elements(tree: Tree, description: Description, own: Bodies | None = None) -> Iterator[Element]:
    """Yield what acts, by kind, in the order of the scene."""
    found: list[Element] = list(_dampers(description))
    found += [y for _, x in description.elements for each in whole([x]) for y in each.placed(tree)]
    if description.field is not None:
        masses, first, _ = own or bodies_of(tree.links)
        found.append(description.field._replace(masses=tuple(masses), first=tuple(first)))
    yield from sorted([*found, *_rotors(tree)], key=place_of)


def _ranges(description: Description) -> Iterator[Range]:
    for k, link in enumerate(description.links):
        if link.limits is not None:
            yield Range(k, link.limits.low, link.limits.high, link.limits.stiffness is None)


def _rotors(tree: Tree) -> Iterator[Rotor]:
    for k, link in enumerate(tree.links):
        if link.motor is not None and link.motor.inertia:
            above = tree.parent[k]
            carrier = None if above is None else tree.frames[above]
            yield Rotor(k, link.motor.inertia, link.motor.ratio, carrier, link.slides)


def _dampers(description: Description) -> Iterator[JointDamper]:
    """Yield the dampers of joints and their rotors, without those of elements."""
    for k, link in enumerate(description.links):
        damping = link.damping
        if link.motor is not None and link.motor.damping:
            damping += link.motor.damping * link.motor.ratio * link.motor.ratio
        yield JointDamper(k, damping)


def joint_damping(description: Description) -> tuple[float, ...]:
    """Return the damping at each joint: of joints, rotors and elements."""
    damping = [x.damping for x in _dampers(description)]
    for x in whole(element for _, element in description.elements):
        if isinstance(x, JointDamper):
            damping[x.joint] += x.damping
    return tuple(damping)


def too_large(description: Description) -> InputError:
    """Return the error for a scene whose numbers overflow."""
    limit = "masses, lengths or gravity are too large: their products overflow"
    return InputError("links", where=description.source, limit=limit)


def _actuated(description: Description, tree: Tree) -> tuple[int, ...]:
    """Return the actuated joints: the scene's, else joints outside loops and one per group.

    A group are loops that share joints or have coupled ones; its first joint is actuated.  A joint
    given by a coupling is never actuated, and a group with a coupled joint outside loops is driven
    from there.
    """
    if description.actuated is not None:
        for k in sorted(driven_joints(description) & set(description.actuated)):
            limit = f"names {description.links[k].name}, which a law of the time drives"
            raise InputError("actuated", where=description.source, limit=limit)
        return description.actuated
    leader = list(range(len(description.links)))  # of each joint, in its group

    def group_of(k: int) -> int:
        while leader[k] != k:
            leader[k] = k = leader[leader[k]]
        return k

    in_loops: set[int] = set()
    coupled = [x.joints for x in description.couplings]
    for loop in tree.loops(description.closures):
        in_loops |= loop
        for k in loop:
            leader[group_of(k)] = group_of(next(iter(loop)))
    for tied in coupled:
        for k in tied:
            leader[group_of(k)] = group_of(next(iter(tied)))
    followers = {coupling.joint for coupling in description.couplings}
    driven = set(range(len(leader))) - in_loops - followers
    groups: dict[int, set[int]] = {}
    for k in in_loops.union(*coupled):
        groups.setdefault(group_of(k), set()).add(k)
    known = driven | driven_joints(description)
    for group in groups.values():
        if group & in_loops and not group & known:
            driven.update(sorted(group - followers)[:1])
    return tuple(sorted(driven))
