"""The matrices and vectors of a scene's equations of motion in symbols, entry by entry.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0                        (1)

With rho_bk the coefficient of E_k in the centre of gravity of body b, theta_jk the angle of link k
against link j above it, A_jk = sum_b m_b conj(rho_bj) rho_bk and B_k = sum_b m_b rho_bk,

    M_ac  = sum_b (m_b sum_jk Re(conj(rho_bj) rho_bk exp(i theta_jk)) + I_b)
    C_ac  = sum_jk Im(A_jk exp(i theta_jk)) (alphad_j [k of a, j of c] - alphad_k [j of a, k of c])
    G_a   = sum_k Im(conj(gamma) B_k E_k), and springs and loads, see `force_terms.py`
    gap   = Re(P E) + offset        Psi_a = sum_k Re(i P_k E_k)        Psidot qd = -Re(P E alphad^2)

where [k of a] holds for the links k that joint a moves, and sums run over these.  Every entry is a
sum of products: angles and rates are sums of those of joints, and nothing is left but to collect
terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain, combinations
from typing import Any

from robodyn.equations.factoring import Key, Written, as_one, by_angle, by_function, by_role
from robodyn.equations.scene_symbols import Body, SymbolicScene
from robodyn.equations.symbolic import (
    NOWHERE,
    ZERO,
    Angle,
    Planar,
    Rates,
    Role,
    Sum,
    of,
    total,
)
from robodyn.mechanics.mechanism import joint_damping

Rows = tuple[tuple[Written, ...], ...]

# How the terms of an entry are collected: by the first of these, then within by the next.
BY_BODY = (by_role(Role.mass, Role.inertia), by_angle, by_function)
BY_RATE = (as_one, by_role(Role.rate), by_angle, by_function)
BY_GRAVITY = (by_role(Role.gravity, Role.force), by_angle, by_function)
BY_LINE = (by_role(Role.normal), by_role(Role.rate), by_function)


NOTHING = Body(ZERO, {})  # a link without mass


def column(scene: SymbolicScene, sums: Iterable[Sum], levels: Sequence[Key]) -> Rows:
    """The entries of a vector as they are to be written."""
    return tuple((scene.written(entry, levels),) for entry in sums)


def mass_matrix(scene: SymbolicScene) -> Rows:
    n, path = scene.n, scene.path
    inertia = [scene.symbols.links[b].I for b in range(n)]
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

    upper = {(a, c): scene.written(entry(a, c), BY_BODY) for a in range(n) for c in range(a, n)}
    return tuple(tuple(upper[min(a, c), max(a, c)] for c in range(n)) for a in range(n))


def _products(
    scene: SymbolicScene, body: Body
) -> tuple[dict[int, Sum], dict[tuple[int, int], Sum]]:
    """|rho_k|^2 of every link k, and Re(conj(rho_j) rho_k exp(i theta_jk)) of every pair."""
    squares = {k: rho.real * rho.real + rho.imag * rho.imag for k, rho in body.rho.items()}
    pairs = {
        (j, k): (body.rho[j].conjugate() * body.rho[k]).turned(scene.angle(j, k)).real
        for j, k in combinations(body.rho, 2)
    }
    return squares, pairs


def coriolis_matrix(scene: SymbolicScene) -> Rows:
    n, path = scene.n, scene.path
    A: dict[tuple[int, int], Planar] = {}
    for body in chain.from_iterable(scene.bodies):
        for j, k in combinations(body.rho, 2):
            moment = (body.rho[j].conjugate() * body.rho[k]) * body.mass
            A[j, k] = A.get((j, k), NOWHERE) + moment
    imaginary = {pair: x.turned(scene.angle(*pair)).imag for pair, x in sorted(A.items())}

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

    joints = range(n)
    return tuple(tuple(scene.written(entry(a, c), BY_RATE) for c in joints) for a in joints)


def damping_matrix(scene: SymbolicScene) -> Rows:
    """The dampers of joints, and of the springs at them."""
    joints = range(scene.n)
    damping: Any = joint_damping(scene.symbols)
    return tuple(
        tuple(scene.written(x if j == k else ZERO, ()) for j in joints)
        for k, x in enumerate(damping)
    )


def closure_jacobian(scene: SymbolicScene) -> Rows:
    slopes = []
    for _, P in scene.closure_rows():
        slope = {k: x.quarter_turn.turned(scene.direction(k)).real for k, x in P.items()}
        slopes.append(
            [total(x for k, x in slope.items() if a in scene.path[k]) for a in range(scene.n)]
        )
    for _, turns in scene.coupling_rows():
        slopes.append([turns.get(a, ZERO) for a in range(scene.n)])
    return tuple(tuple(scene.written(entry, BY_LINE) for entry in row) for row in slopes)


def closure_bias(scene: SymbolicScene) -> Rows:
    bends = []
    for _, P in scene.closure_rows():
        rates = {k: of(Rates(scene.direction(k))) for k in P}
        turned = {k: x.turned(scene.direction(k)).real for k, x in P.items()}
        bends.append(-total(x * rates[k] * rates[k] for k, x in turned.items()))
    bends += [ZERO] * len(scene.description.couplings)
    return column(scene, bends, BY_LINE)


def closure_gap(scene: SymbolicScene) -> Rows:
    gaps = []
    for offset, P in scene.closure_rows():
        gaps.append(total([*(x.turned(scene.direction(k)).real for k, x in P.items()), offset]))
    for offset, turns in scene.coupling_rows():
        gaps.append(total([*(x * of(Angle(j)) for j, x in turns.items()), offset]))
    return column(scene, gaps, BY_LINE)


ENTRIES = {
    "M": mass_matrix,
    "C": coriolis_matrix,
    "D": damping_matrix,
    "Psi": closure_jacobian,
    "Psidot_qd": closure_bias,
    "gap": closure_gap,
}
