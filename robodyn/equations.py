"""The equations of motion of a scene in symbols: the closed form of `mechanism.py`, entry by entry.

    M qdd + C qd + D qd + G = tau + Psi^T lambda        gap(q) = 0                            (1)

With rho_bk the coefficient of E_k in the centre of gravity of body b, theta_jk the angle of link k
against link j above it, A_jk = sum_b m_b conj(rho_bj) rho_bk and B_k = sum_b m_b rho_bk,

    M_ac  = sum_b (m_b sum_jk Re(conj(rho_bj) rho_bk exp(i theta_jk)) + I_b)
    C_ac  = sum_jk Im(A_jk exp(i theta_jk)) (alphad_j [k of a, j of c] - alphad_k [j of a, k of c])
    G_a   = sum_k Im(conj(gamma) B_k E_k)
    gap   = Re(P E) + offset        Psi_a = sum_k Re(i P_k E_k)        Psidot qd = -Re(P E alphad^2)

where [k of a] holds for the links k that joint a moves, and sums run over these.  Every entry is a
sum of products: angles and rates are sums of those of joints, and nothing is left but to collect
terms.  Another term of the left side is one more `Block` in `_left`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Literal, NamedTuple

from robodyn.description import Point
from robodyn.errors import InputError
from robodyn.factoring import Key, Written, as_one, by_angle, by_function, by_role, written
from robodyn.mechanism import Mechanism
from robodyn.parameters import Parameter, Parameters
from robodyn.symbolic import (
    NOWHERE,
    ONE,
    ZERO,
    Planar,
    Rates,
    Role,
    Sum,
    Symbol,
    of,
    total,
)

Rows = tuple[tuple[Written, ...], ...]

# How the terms of an entry are collected: by the first of these, then within by the next.
BY_BODY = (by_role(Role.mass, Role.inertia), by_angle, by_function)
BY_RATE = (as_one, by_role(Role.rate), by_angle, by_function)
BY_GRAVITY = (by_role(Role.gravity), by_angle, by_function)
BY_LINE = (by_role(Role.normal), by_role(Role.rate), by_function)


@dataclass(frozen=True, slots=True)
class Block:
    """One matrix or vector of the equations, its entries written out; a vector has one column.

    `inputs` are what it depends on; in equation (1) a matrix of the left side stands before `rate`.
    """

    name: str
    meaning: str
    unit: str
    shape: Literal["symmetric", "matrix", "diagonal", "vector"]
    rows: Rows
    inputs: tuple[str, ...] = ("q",)
    rate: str = ""

    @property
    def zero(self) -> bool:
        """Whether every entry is zero."""
        return not any(entry.terms for row in self.rows for entry in row)


@dataclass(frozen=True, slots=True)
class Equations:
    """The blocks of equation (1) for one scene, and what its symbols mean.

    The sum of the blocks of `left`, each times its rate, is the left side; `closures` are Psi,
    Psidot qd and gap.  `zero` names parameters that are 0 in the scene, `unused` those that have
    no effect.
    """

    mechanism: Mechanism
    left: tuple[Block, ...]
    closures: tuple[Block, ...]
    parameters: tuple[Parameter, ...]
    zero: tuple[str, ...]
    unused: tuple[str, ...]

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All of them."""
        return self.left + self.closures

    @property
    def terms(self) -> list[tuple[str, str]]:
        """The left side's terms that are not zero: a block's name and the rate it stands before."""
        return [(block.name, block.rate) for block in self.left if not block.zero]


def equations(mechanism: Mechanism, numeric: bool = False) -> Equations:
    """The equations of motion of the mechanism's scene, in symbols or with its numbers put in.

    Raises InputError where a number that is put in leaves the range of floats.
    """
    scene = _Scene(mechanism, numeric)
    left, closures = tuple(_left(scene)), tuple(_closures(scene))
    entries = [entry for block in left + closures for row in block.rows for entry in row]
    used = {a.name for entry in entries for a in entry.atoms() if isinstance(a, Symbol)}
    known = scene.parameters.known.values()
    return Equations(
        mechanism=mechanism,
        left=left,
        closures=closures,
        parameters=tuple(x for x in known if x.name in used),
        zero=tuple(scene.parameters.zero),
        unused=() if numeric else tuple(x.name for x in known if x.name not in used),
    )


class Body(NamedTuple):
    """A mass, and the coefficients of E of its centre, by link from the ground on."""

    mass: Sum
    rho: dict[int, Planar]


NOTHING = Body(ZERO, {})  # a link without mass


class _Scene:
    """The tree of a scene in symbols: paths, bodies and points."""

    def __init__(self, mechanism: Mechanism, numeric: bool) -> None:
        self.n = mechanism.n
        self.description = mechanism.description
        self.numeric = numeric
        self.parameters = Parameters(mechanism.description)
        self.path: list[tuple[int, ...]] = [()] * self.n  # the joints from the ground to each link
        for k in mechanism.order:
            above = mechanism.parent[k]
            self.path[k] = (*(() if above is None else self.path[above]), k)
        self.bodies = [self._bodies(k) for k in range(self.n)]

    def _bodies(self, k: int) -> list[Body]:
        """The link itself and its payload."""
        parts = [
            (self.parameters.mass(k), self.parameters.centre(k)),
            (self.parameters.payload(k), self.parameters.tip(k)),
        ]
        return [Body(mass, self.terms(k, at)) for mass, at in parts if mass]

    def terms(self, k: int, at: Planar) -> dict[int, Planar]:
        """The coefficients of E of a point of link k, `at` in its frame."""
        *above, _ = path = self.path[k]
        leaving = [*(self.parameters.hanging(j) for j in path[1:]), at]
        assert len(leaving) == len(above) + 1
        return {j: x for j, x in zip(path, leaving, strict=True) if x != NOWHERE}

    def place(self, point: Point, at: Planar) -> tuple[Planar, dict[int, Planar]]:
        """The constant and the coefficients of E of a point of a link or of the ground."""
        if point.link is None:
            return at, {}
        return self.parameters.hanging(self.path[point.link][0]), self.terms(point.link, at)

    def angle(self, j: int, k: int) -> tuple[int, ...]:
        """The joints whose angles make up that of link k against link j above it."""
        return tuple(sorted(self.path[k][len(self.path[j]) :]))

    def direction(self, k: int) -> tuple[int, ...]:
        """The joints whose angles make up alpha_k."""
        return tuple(sorted(self.path[k]))

    def rows(self, sums: Sequence[Sequence[Sum]], levels: Sequence[Key]) -> Rows:
        """Entries as they are to be written."""
        return tuple(tuple(self._entry(entry, levels) for entry in row) for row in sums)

    def _entry(self, entry: Sum, levels: Sequence[Key]) -> Written:
        if self.numeric:
            entry = entry.substituted(self.parameters.values)
            most = sys.float_info.max
            if any(not -most <= number <= most for number in entry.terms.values()):
                limit = "masses, lengths or gravity are too large: their products overflow"
                raise InputError("links", where=self.description.source, limit=limit)
        return written(entry, levels)


# -- the left side -------------------------------------------------------------------------------


def _left(scene: _Scene) -> Iterator[Block]:
    """The terms of the left side, those that the scene has."""
    yield _mass_matrix(scene)
    yield _coriolis_matrix(scene)
    if any(link.damping for link in scene.description.links):
        yield _damping_matrix(scene)
    if scene.description.gravity != 0.0:
        yield _gravity_vector(scene)


def _mass_matrix(scene: _Scene) -> Block:
    n, path = scene.n, scene.path
    inertia = [scene.parameters.inertia(b) for b in range(n)]
    parts = [[(body, *_products(scene, body)) for body in scene.bodies[b]] for b in range(n)]

    def entry(a: int, c: int) -> Sum:
        found = []
        for b in range(n):
            if a not in path[b] or c not in path[b]:
                continue
            for i, (body, squares, pairs) in enumerate(parts[b] or [(NOTHING, {}, {})]):
                arms = [x for k, x in squares.items() if a in path[k] and c in path[k]]
                for (j, k), x in pairs.items():
                    times = (a in path[j] and c in path[k]) + (a in path[k] and c in path[j])
                    arms += [x.times(times)] if times else []
                found += [body.mass * total(arms), *([inertia[b]] if i == 0 else [])]
        return total(found)

    upper = {(a, c): entry(a, c) for a in range(n) for c in range(a, n)}
    sums = [[upper[min(a, c), max(a, c)] for c in range(n)] for a in range(n)]
    rows = scene.rows(sums, BY_BODY)
    return Block("M", "mass matrix", "kg m²", "symmetric", rows, ("q",), "qdd")


def _products(scene: _Scene, body: Body) -> tuple[dict[int, Sum], dict[tuple[int, int], Sum]]:
    """|rho_k|^2 of every link k, and Re(conj(rho_j) rho_k exp(i theta_jk)) of every pair."""
    squares = {k: rho.x * rho.x + rho.y * rho.y for k, rho in body.rho.items()}
    pairs = {
        (j, k): (body.rho[j].conjugate * body.rho[k]).turned(scene.angle(j, k)).x
        for j, k in combinations(body.rho, 2)
    }
    return squares, pairs


def _coriolis_matrix(scene: _Scene) -> Block:
    n, path = scene.n, scene.path
    A: dict[tuple[int, int], Planar] = {}
    for body in chain.from_iterable(scene.bodies):
        for j, k in combinations(body.rho, 2):
            moment = (body.rho[j].conjugate * body.rho[k]).scaled(body.mass)
            A[j, k] = A.get((j, k), NOWHERE) + moment
    imaginary = {pair: x.turned(scene.angle(*pair)).y for pair, x in sorted(A.items())}

    def entry(a: int, c: int) -> Sum:
        found = []
        for (j, k), moment in imaginary.items():
            one, other = a in path[k] and c in path[j], a in path[j] and c in path[k]
            if one and other:
                found.append(-(moment * of(Rates(scene.angle(j, k)))))
            elif one:
                found.append(moment * of(Rates(scene.direction(j))))
            elif other:
                found.append(-(moment * of(Rates(scene.direction(k)))))
        return total(found)

    rows = scene.rows([[entry(a, c) for c in range(n)] for a in range(n)], BY_RATE)
    meaning = "Coriolis and centrifugal matrix, by Christoffel symbols"
    return Block("C", meaning, "kg m²/s", "matrix", rows, ("q", "qd"), "qd")


def _damping_matrix(scene: _Scene) -> Block:
    damping = [scene.parameters.damping(k) for k in range(scene.n)]
    sums = [[x if j == k else ZERO for j in range(scene.n)] for k, x in enumerate(damping)]
    rows = scene.rows(sums, ())
    return Block("D", "damping matrix", "N m s/rad", "diagonal", rows, (), "qd")


def _gravity_vector(scene: _Scene) -> Block:
    B = [NOWHERE] * scene.n
    for body in chain.from_iterable(scene.bodies):
        for k, rho in body.rho.items():
            B[k] = B[k] + rho.scaled(body.mass)
    pull = scene.parameters.gravity().conjugate
    torque = [(pull * B[k].turned(scene.direction(k))).y for k in range(scene.n)]
    sums = [[total(x for k, x in enumerate(torque) if a in scene.path[k])] for a in range(scene.n)]
    rows = scene.rows(sums, BY_GRAVITY)
    return Block("G", "gravity vector", "N m", "vector", rows)


# -- closures ------------------------------------------------------------------------------------


def _closures(scene: _Scene) -> Iterator[Block]:
    """Psi, Psidot qd and gap, where the scene has closures."""
    if not scene.description.closures:
        return
    gaps, slopes, bends = [], [], []
    for offset, P in _closure_rows(scene):
        turned = {k: x.turned(scene.direction(k)) for k, x in P.items()}
        gaps.append([total([*(x.x for x in turned.values()), offset])])
        slope = {k: x.quarter_turn.turned(scene.direction(k)).x for k, x in P.items()}
        slopes.append(
            [total(x for k, x in slope.items() if a in scene.path[k]) for a in range(scene.n)]
        )
        rates = {k: of(Rates(scene.direction(k))) for k in P}
        bends.append([-total(x.x * rates[k] * rates[k] for k, x in turned.items())])
    rows = [scene.rows(sums, BY_LINE) for sums in (slopes, bends, gaps)]
    yield Block("Psi", "closure Jacobian, d gap/dq", "m", "matrix", rows[0])
    yield Block("Psidot_qd", "closure bias", "m/s²", "vector", rows[1], ("q", "qd"))
    yield Block("gap", "closure gap, first side less second", "m", "vector", rows[2])


def _closure_rows(scene: _Scene) -> Iterator[tuple[Sum, dict[int, Planar]]]:
    """offset and P_k of every row Re(sum_k P_k E_k) + offset = 0."""
    for c, closure in enumerate(scene.description.closures):
        constant, R = scene.place(closure.first, scene.parameters.side(c, "a"))
        other, terms = scene.place(closure.second, scene.parameters.side(c, "b"))
        for k, x in terms.items():
            R[k] = R.get(k, NOWHERE) - x
        constant = constant - other
        if closure.along is None:
            directions = [Planar(ONE, ZERO), Planar(ZERO, ONE)]
        else:
            directions = [scene.parameters.normal(c)]
        for direction in directions:
            w = direction.conjugate
            yield (w * constant).x, {k: w * x for k, x in R.items()}
