"""The matrices and vectors of a scene's equations of motion in symbols, entry by entry.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0                        (1)

With rho_bk the coefficient of E_k in the centre of gravity of body b, theta_jk the angle of link k
against link j above it, A_jk = sum_b m_b conj(rho_bj) rho_bk and B_k = sum_b m_b rho_bk,

    M_ac  = sum_b (m_b sum_jk Re(conj(rho_bj) rho_bk exp(i theta_jk)) + I_b)
    C_ac  = sum_jk Im(A_jk exp(i theta_jk)) (alphad_j [k of a, j of c] - alphad_k [j of a, k of c])
    G_a   = sum_k Im(conj(gamma) B_k E_k), and springs and loads, see `forces.py`
    gap   = Re(P E) + offset        Psi_a = sum_k Re(i P_k E_k)        Psidot qd = -Re(P E alphad^2)

where [k of a] holds for the links k that joint a moves, and sums run over these.  Every entry is a
sum of products: angles and rates are sums of those of joints, and nothing is left but to collect
terms.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Literal, NamedTuple

from robodyn.equations.factoring import Key, Written, as_one, by_angle, by_function, by_role
from robodyn.equations.scene_symbols import Body, SymbolicScene
from robodyn.equations.symbolic import (
    NOWHERE,
    ONE,
    ZERO,
    Angle,
    Atom,
    Planar,
    Rates,
    Role,
    Sum,
    of,
    total,
)
from robodyn.scene import JointSpring


class Definition(NamedTuple):
    """A name that stands for a formula in the entries."""

    name: str
    value: Written
    unit: str
    meaning: str


Rows = tuple[tuple[Written, ...], ...]

# How the terms of an entry are collected: by the first of these, then within by the next.
BY_BODY = (by_role(Role.mass, Role.inertia), by_angle, by_function)
BY_RATE = (as_one, by_role(Role.rate), by_angle, by_function)
BY_GRAVITY = (by_role(Role.gravity, Role.force), by_angle, by_function)
BY_LINE = (by_role(Role.normal), by_role(Role.rate), by_function)


NOTHING = Body(ZERO, {})  # a link without mass


@dataclass(frozen=True, slots=True)
class Block:
    """One matrix or vector of the equations, its entries written out; a vector has one column.

    `inputs` are what it depends on, `where` names that its entries use; in equation (1) a matrix
    of the left side stands before `rate`.
    """

    name: str
    meaning: str
    unit: str
    shape: Literal["symmetric", "matrix", "diagonal", "vector"]
    rows: Rows
    inputs: tuple[str, ...] = ("q",)
    rate: str = ""
    where: tuple[Definition, ...] = ()

    def atoms(self) -> Iterator[Atom]:
        """Every atom, those of the definitions too."""
        entries = (entry for row in self.rows for entry in row)
        for entry in chain((name.value for name in self.where), entries):
            yield from entry.atoms()

    @property
    def zero(self) -> bool:
        """Whether every entry is zero."""
        return not any(entry.terms for row in self.rows for entry in row)


def written_rows(
    scene: SymbolicScene, sums: Sequence[Sequence[Sum]], levels: Sequence[Key]
) -> Rows:
    """Entries as they are to be written."""
    return tuple(tuple(scene.written(entry, levels) for entry in row) for row in sums)


# -- the left side -------------------------------------------------------------------------------


def mass_matrix(scene: SymbolicScene) -> Block:
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
    rows = written_rows(scene, sums, BY_BODY)
    return Block("M", "mass matrix", "kg m²", "symmetric", rows, ("q",), "qdd")


def _products(
    scene: SymbolicScene, body: Body
) -> tuple[dict[int, Sum], dict[tuple[int, int], Sum]]:
    """|rho_k|^2 of every link k, and Re(conj(rho_j) rho_k exp(i theta_jk)) of every pair."""
    squares = {k: rho.x * rho.x + rho.y * rho.y for k, rho in body.rho.items()}
    pairs = {
        (j, k): (body.rho[j].conjugate * body.rho[k]).turned(scene.angle(j, k)).x
        for j, k in combinations(body.rho, 2)
    }
    return squares, pairs


def coriolis_matrix(scene: SymbolicScene) -> Block:
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

    rows = written_rows(scene, [[entry(a, c) for c in range(n)] for a in range(n)], BY_RATE)
    meaning = "Coriolis and centrifugal matrix, by Christoffel symbols"
    return Block("C", meaning, "kg m²/s", "matrix", rows, ("q", "qd"), "qd")


def damping_matrix(scene: SymbolicScene) -> Block:
    """The dampers of joints, and of the springs at them."""
    damping = [scene.parameters.damping(k) for k in range(scene.n)]
    for i, spring in enumerate(scene.description.springs):
        if isinstance(spring, JointSpring):
            damping[spring.joint] = damping[spring.joint] + scene.parameters.spring_damping(i)
    sums = [[x if j == k else ZERO for j in range(scene.n)] for k, x in enumerate(damping)]
    rows = written_rows(scene, sums, ())
    return Block("D", "damping matrix", "N m s/rad", "diagonal", rows, (), "qd")


# -- closures ------------------------------------------------------------------------------------


def closures(scene: SymbolicScene) -> Iterator[Block]:
    """Psi, Psidot qd and gap, where the scene has closures or couplings."""
    if not scene.mechanism.rows:
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
    for c, coupling in enumerate(scene.description.couplings):
        arm = scene.parameters.arm(c)
        turns = {j: -(arm * scene.parameters.ratio(c, j)) for j, _ in coupling.terms}
        turns = {coupling.joint: arm, **turns}
        angle = -(arm * scene.parameters.offset_angle(c))
        gaps.append([total([*(x * of(Angle(j)) for j, x in turns.items()), angle])])
        slopes.append([turns.get(a, ZERO) for a in range(scene.n)])
        bends.append([ZERO])
    rows = [written_rows(scene, sums, BY_LINE) for sums in (slopes, bends, gaps)]
    yield Block("Psi", "closure Jacobian, d gap/dq", "m", "matrix", rows[0])
    yield Block("Psidot_qd", "closure bias", "m/s²", "vector", rows[1], ("q", "qd"))
    yield Block("gap", "closure gap, first side less second", "m", "vector", rows[2])


def _closure_rows(scene: SymbolicScene) -> Iterator[tuple[Sum, dict[int, Planar]]]:
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
