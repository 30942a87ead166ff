"""The equations of loops: pins, points on lines, fixed angles, and couplings.

Also the kind of loop that each closure makes (Grashof's classes of four-bars, slider-cranks, ...).
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator

from robodyn.errors import InputError
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.planar_model import ClosureRow, Mechanism, OnDemand, Terms
from robodyn.scene.scene import Closure, Description

PARALLEL = 1e-9  # sine of the angle between a flat face and the way that its follower slides
EQUAL = 1e-12  # lengths that differ by less than this part count as equal


def closure_rows(description: Description, tree: Tree) -> list[ClosureRow]:
    """Return the equations of the closures; InputError for points that cannot move apart."""
    rows: list[ClosureRow] = []
    for c, closure in enumerate(description.closures):
        if not tree.moves(closure.first, closure.second):  # nothing to measure its row against
            limit = "joins points that cannot move apart: it says nothing, or never holds"
            raise InputError(f"closures[{c}]", where=description.source, limit=limit)
        rows += _point_rows(tree, c, closure)
        if closure.aligned is not None:
            rows.append(_aligned_row(description, tree, c))
    return rows


def _point_rows(tree: Tree, c: int, closure: Closure) -> Iterator[ClosureRow]:
    """Yield the rows of a closure's points; on a link's line they are in its frame."""
    constant = tree.constant(closure.first, closure.second)
    directions: tuple[complex, ...] = (1 + 0j, 1j)
    line = None
    if closure.along is not None:
        carrier, normal = closure.second.link, 1j * closure.along
        directions = (normal if carrier is None else tree.turned(carrier, normal),)
        line = None if carrier is None else tree.frames[carrier]
    for direction in directions:
        w = direction.conjugate()
        row = ClosureRow(c, direction, OnDemand(_turned, tree, closure, w, line), 0.0)
        row = row._replace(line=line, lengths=tree.lengths)
        if line is None:
            yield row._replace(offset=(w * constant).real)
            continue
        # what turns with the line is constant there, what slides on its frame linear
        own = [(k, (w * p).real) for k, p in _gap(tree, closure) if tree.frames[k] == line]
        offset = sum(p for k, p in own if k == line)
        angles = tuple((k, p) for k, p in own if k != line and p)
        yield row._replace(ground=w * constant, offset=offset, angles=angles)


def _aligned_row(description: Description, tree: Tree, c: int) -> ClosureRow:
    """Return the row of a fixed angle: the sine of the angle's error, times a length."""
    closure = description.closures[c]
    k, j = closure.first.link, closure.second.link
    assert k is not None
    assert closure.aligned is not None
    line = None if j is None else tree.frames[j]
    if tree.frames[k] == line:
        limit = "its links cannot turn against one another: it says nothing, or never holds"
        raise InputError(f"closures[{c}].aligned", where=description.source, limit=limit)
    arm = tree.reach(closure.first, closure.second) or tree.unit
    off = -1j * arm * cmath.exp(-1j * closure.aligned) * tree.phases[k]
    if j is not None:
        off *= tree.phases[j].conjugate()
    row = ClosureRow(c, 0j, (), 0.0, arm=arm, line=line, lengths=tree.lengths)
    d = tree.frames[k]
    return row._replace(ground=off) if d is None else row._replace(P=((d, off),))


def coupling_rows(description: Description) -> list[ClosureRow]:
    """Return each coupling in absolute angles, scaled like the closures' rows."""
    links, tree = description.links, Tree(description.links)
    size = max((tree.reach(x.first, x.second) for x in description.closures), default=0.0)
    length = size or max((link.l for link in links), default=0.0) or 1.0
    found: list[ClosureRow] = []
    for coupling in description.couplings:
        arm = 1.0 if links[coupling.joint].slides else length
        angles: dict[int, float] = {}
        for joint, ratio in ((coupling.joint, -1.0), *coupling.terms):
            # q_k = x_k - x_above
            angles[joint] = angles.get(joint, 0.0) - ratio * arm
            above = None if links[joint].slides else links[joint].hangs_from.link
            if above is not None and (d := tree.frames[above]) is not None:
                angles[d] = angles.get(d, 0.0) + ratio * arm
        kept = tuple((k, value) for k, value in angles.items() if value != 0.0)
        row = ClosureRow(None, 0j, (), -arm * coupling.angle, kept, arm, lengths=tree.lengths)
        found.append(row._replace(law=coupling.law))
    check_cams(description)
    return found


def check_cams(description: Description) -> None:
    """Raise InputError for a cam on another carrier, or one that cannot move its follower."""
    links = description.links
    for c, coupling in enumerate(description.couplings):
        cam = coupling.cam
        if cam is None:
            continue
        follower, own = links[coupling.joint], links[next(iter(coupling.others))]
        limit = ""
        if follower.hangs_from.link != own.hangs_from.link:
            limit = (
                f"{own.name} and {follower.name} must hang from one link, or both from the ground"
            )
        elif cam.face is None and follower.axis is None and cam.at == 0:
            limit = f"the roller's centre is the joint of {follower.name}: at must be elsewhere"
        elif cam.face is not None and follower.slides and abs(cam.face.along.imag) < PARALLEL:
            limit = f"the face lies along the way of {follower.name}: nothing would move it"
        if limit:
            raise InputError(f"couplings[{c}].cam", where=description.source, limit=limit)


def _gap(tree: Tree, closure: Closure) -> Terms:
    return tree.difference(closure.first, closure.second).terms


def _turned(
    tree: Tree, closure: Closure, w: complex, line: int | None
) -> Iterator[tuple[int, complex]]:
    """Yield the terms of a gap along w, except those in the frame of the line."""
    for k, p in _gap(tree, closure):
        if line is None or tree.frames[k] != line:
            yield k, w * p


def loop_class(mechanism: Mechanism, closure: int) -> str:
    """Return the class of a closure's loop: `crank-rocker (Grashof)`, `slider-crank ...`, ...

    For a four-bar, cranks and rockers are the links that hang from the ground in the scene.
    """
    row = next(row for row in mechanism.rows if row.closure == closure)
    sliding = [k for k, _ in (*row.P, *row.angles) if k in mechanism.slides]
    if sliding or row.line is not None:
        turning = {k for k, _ in row.P if k not in mechanism.slides} | ({row.line} - {None})
        joints = f"{len(turning)} turning" + f" and {len(sliding)} sliding" * bool(sliding)
        return f"{'loop with a slot' if row.line is not None else 'loop'} of {joints} links"
    each = [x.offset for x in mechanism.rows if x.closure == closure]
    offset = float(sum(x**2 for x in each) ** 0.5)  # the length of the ground's side, m
    links = [k for k, _ in row.P]
    lengths = [abs(p) for _, p in row.P]
    if mechanism.description.closures[closure].along is not None:
        if len(links) != 2:
            return f"slider loop of {len(links)} links"
        crank, rod = lengths
        turns = crank + abs(row.offset) <= rod * (1 + EQUAL)
        return "slider-crank, crank " + ("turns fully" if turns else "rocks")
    if len(links) != 3 or offset == 0.0:
        return f"{len(links) + (offset > 0.0)}-link loop"
    sides = mechanism.description.closures[closure]
    pinned = (
        {sides.first.link, sides.second.link}
        if None in (sides.first.link, sides.second.link)
        else set()
    )
    grounded = [mechanism.parent[k] is None or k in pinned for k in links]
    if grounded.count(True) != 2:
        return "4-link loop"
    return _four_bar(lengths, grounded, offset)


def _four_bar(lengths: list[float], grounded: list[bool], ground: float) -> str:
    shortest, *middle, longest = sorted([*lengths, ground])
    difference = shortest + longest - sum(middle)
    if abs(difference) <= EQUAL * longest:
        return "change point"
    if difference > 0.0:
        return "triple-rocker (not Grashof)"
    if ground == shortest:
        return "double-crank (Grashof)"
    return (
        "crank-rocker (Grashof)" if grounded[lengths.index(shortest)] else "double-rocker (Grashof)"
    )
