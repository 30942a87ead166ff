"""The links of a scene as a tree: paths to its points, and loops of its closures.

Also the mass properties of links, in which the equations of motion are linear, and their sums along
the tree.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from robodyn.elements.link_rows import PlanarPoint
from robodyn.scene.scene import Closure, Link, Point


class Tree:
    """The links as a tree; points are linear in X.

    The frame of link k is phase_k E_frame, with constants phase_k: axes of prismatic joints, and
    turns of welds.
    """

    def __init__(self, links: Sequence[Link]) -> None:
        self.links = links
        self.parent = tuple(link.hangs_from.link for link in links)
        children: dict[int | None, list[int]] = {}
        for k, j in enumerate(self.parent):
            children.setdefault(j, []).append(k)
        order = children.get(None, [])
        for k in order:  # it grows: each link after the one it hangs from
            order += children.get(k, [])
        self.order = tuple(order)
        self.frames: list[int | None] = [None] * len(links)
        self.phases: list[complex] = [1.0 + 0j] * len(links)
        for k in self.order:
            j, axis = self.parent[k], links[k].axis
            own = links[k].turn if axis is None else axis
            above = 1.0 if j is None else self.phases[j]
            self.phases[k] = above if own == 1.0 else own if above == 1.0 else above * own
            self.frames[k] = k if axis is None else None if j is None else self.frames[j]
        self._depth: dict[int | None, int] = {None: 0}
        self._root: dict[int, int] = {}
        for k in self.order:
            j = self.parent[k]
            self._depth[k] = self._depth[j] + 1
            self._root[k] = k if j is None else self._root[j]

    def turned(self, k: int, at: complex) -> complex:
        """Return a vector of link k's frame in the frame of its E."""
        return at if self.phases[k] == 1.0 else self.phases[k] * at

    def terms(self, point: Point) -> Iterator[tuple[int | None, complex]]:
        """Yield the terms that a point's own link adds to the place of its joint."""
        k = point.link
        assert k is not None
        if point.at:
            yield self.frames[k], self.turned(k, point.at)
        if self.links[k].slides:
            yield k, self.phases[k]

    def point(self, point: Point) -> PlanarPoint:
        """Return the point as a sum from the ground."""
        return self.difference(point, Point(None, 0j))

    def ground(self, point: Point) -> complex:
        """Return where on the ground the path to a point begins."""
        return point.at if point.link is None else self.links[self._root[point.link]].hangs_from.at

    def common(self, first: Point, second: Point) -> int | None:
        """Return the last link shared by the paths to two points; None for the ground."""
        one, two = first.link, second.link
        if one is None or two is None or self._root[one] != self._root[two]:
            return None
        while one is not None and two is not None and one != two:
            if self._depth[one] >= self._depth[two]:
                one = self.parent[one]
            else:
                two = self.parent[two]
        return one

    def leaves(self, point: Point, common: int | None) -> Iterator[Point]:
        """Yield the points at which the path to `point` leaves its links, down to `common`."""
        while point.link is not None and point.link != common:
            yield point
            point = self.links[point.link].hangs_from
        yield point

    def difference(self, first: Point, second: Point) -> PlanarPoint:
        """Return first less second, without terms that cancel."""
        common = self.common(first, second)
        (*one, a), (*two, b) = self.leaves(first, common), self.leaves(second, common)
        found: dict[int | None, complex] = {None: self.ground(first) - self.ground(second)}
        if common is not None and a.at != b.at:
            found[self.frames[common]] = self.turned(common, a.at - b.at)
        for sign, way in ((1.0, one), (-1.0, two)):
            for k, c in (term for point in reversed(way) for term in self.terms(point)):
                c = c if sign > 0.0 else -c
                found[k] = found[k] + c if k in found else c
        constant = found.pop(None)
        return PlanarPoint(constant, tuple((k, c) for k, c in found.items() if k is not None and c))

    def constant(self, first: Point, second: Point) -> complex:
        """Return the constant part of first less second."""
        if None not in self.frames:  # all links turn: paths need not be walked
            return self.ground(first) - self.ground(second)
        return self.difference(first, second).constant

    @cached_property
    def lengths(self) -> dict[int, float]:
        """The length (m) that displacements of each sliding joint are compared with."""
        return {k: self.unit for k, link in enumerate(self.links) if link.slides}

    @cached_property
    def unit(self) -> float:
        """A length of the mechanism (m), by which displacements are compared with angles.

        It is 1 if the scene has symbols for numbers.
        """
        lengths = [z for x in self.links for z in (x.l, x.r, x.hangs_from.at)]
        if not all(isinstance(z, (int, float, complex)) for z in lengths):
            return 1.0
        return max(map(abs, lengths), default=0.0) or 1.0

    @cached_property
    def _length(self) -> dict[int | None, float]:
        """The length of the path from the ground to each link's joint, m."""
        found: dict[int | None, float] = {None: 0.0}
        for k in self.order:
            j = self.parent[k]
            found[k] = 0.0 if j is None else found[j] + abs(self.links[k].hangs_from.at)
        return found

    def reach(self, first: Point, second: Point) -> float:
        """Return the length of the paths from one point to another, m."""
        common = self.common(first, second)
        ends = [abs(x.at) + self._length[x.link] for x in (first, second) if x.link is not None]
        return sum(ends) - len(ends) * self._length[common]

    def moves(self, first: Point, second: Point) -> bool:
        """Return whether the difference of two points can change."""
        common = self.common(first, second)
        paths = (x for point in (first, second) for x in self.leaves(point, common))
        return any(x.at for x in paths if x.link not in (common, None)) or bool(
            self.difference(first, second).terms
        )

    def loops(self, closures: Sequence[Closure]) -> Iterator[set[int]]:
        """Yield for each closure the joints on the path to one side only.

        If earlier closures share a part of the path, one joint stands for that part: the cost is
        the number of links plus closures, not their product.
        """
        shared: dict[int, tuple[int, set[int]]] = {}
        for closure in closures:
            common = self.common(closure.first, closure.second)
            loop: set[int] = set()
            last: list[Point] = []  # of both sides, on the common link
            for point in (closure.first, closure.second):
                k = point.link
                if k is not None and k != common:
                    carries = point is closure.second and closure.along is not None
                    loop |= {k} if point.at or carries or self.links[k].slides else set()
                    k = self._climb(k, self._depth[common] + 1, shared, loop)
                    point = self.links[k].hangs_from
                last.append(point)
            if common is not None and bool(last[0].at) != bool(last[1].at):
                loop.add(common)
            yield loop

    def _climb(
        self, k: int, depth: int, shared: dict[int, tuple[int, set[int]]], loop: set[int]
    ) -> int:
        """Return the link at `depth` below which link k hangs; add joints on the way to `loop`."""
        passed: list[int] = []
        while self._depth[k] > depth:
            passed.append(k)
            top, joint = shared.get(k, (None, set()))
            if top is not None and self._depth[top] >= depth:
                k = top
                loop |= joint
            else:
                own, above = self.links[k], self.parent[k]
                assert above is not None
                k = above
                moves = own.hangs_from.at or own.slides or self.links[above].slides
                loop |= {above} if moves else set()
        for link in passed:
            shared[link] = k, set(list(loop)[:1])
        return k


def places_of(tree: Tree, points: Sequence[Point] | None = None) -> tuple[Any, Any]:
    """Return points of the tree as arrays: constants (p,) and coefficients of X (p, n).

    By default, the joints of the links.  Numbers are complex, or objects if links have formulas.
    """
    import numpy as np

    links, n = tree.links, len(tree.links)
    numbers = [z for x in links for z in (x.l, x.r, x.hangs_from.at)]
    kind = complex if all(isinstance(z, int | float | complex) for z in numbers) else object
    constant, c = np.zeros(n, kind), np.zeros((n, n), kind)

    def put(k: int, point: Point) -> None:
        if point.link is None:
            constant[k] = point.at
            return
        constant[k], c[k] = joints[0][point.link], joints[1][point.link]
        for frame, value in tree.terms(point):
            if frame is None:
                constant[k] = constant[k] + value
            else:
                c[k, frame] = c[k, frame] + value

    joints = constant, c
    for k in tree.order:
        put(k, links[k].hangs_from)
    if points is None:
        return joints
    constant, c = np.zeros(len(points), kind), np.zeros((len(points), n), kind)
    for k, point in enumerate(points):
        put(k, point)
    return constant, c


class Bodies(NamedTuple):
    """Mass properties of each link with payload: mass (kg), first moment (kg m), J (kg m^2).

    First moment and J are about the link's own origin, in its frame.
    """

    mass: list[float]
    first: list[complex]
    inertia: list[float]


def bodies(links: Sequence[Link]) -> Bodies:
    """Return the mass properties of links, in which the equations of motion are linear."""
    return Bodies(
        [link.m + link.payload for link in links],
        [link.r * link.m + link.l * link.payload for link in links],
        [link.I + link.m * _square(link.r) + link.payload * link.l * link.l for link in links],
    )


def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


def carried_by(
    tree: Tree, own: Bodies | None = None
) -> tuple[list[float], list[complex], list[float]]:
    """Return mass, first moment B_k, and A_kk of all that each link carries."""
    links = tree.links
    given = own or bodies(links)
    mass, B, inertia = list(given.mass), list(given.first), list(given.inertia)
    for k in reversed(tree.order):  # what link k carries acts on its parent at k's own joint
        p, j = links[k].hangs_from.at, tree.parent[k]
        if j is not None:
            mass[j] += mass[k]
            B[j] += p * mass[k]
            inertia[j] += mass[k] * _square(p)
    return mass, B, inertia


def largest(tree: Tree) -> Iterator[complex]:
    """Yield numbers that are finite only if A is."""
    _, B, inertia = carried_by(tree)
    yield from map(complex, inertia)
    most = [max(abs(b.real), abs(b.imag)) for b in B]
    for k in reversed(tree.order):
        p, j = tree.links[k].hangs_from.at, tree.parent[k]
        if j is not None:
            most[j] = max(most[j], most[k])
            yield complex(max(abs(p.real), abs(p.imag)) * most[k] * 2.0)
