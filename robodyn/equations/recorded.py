"""The equations of motion as recorded arithmetic on named numbers, for what writes code.

The formulas are those that robodyn computes with; their numbers are the scene's parameters.  M and
C are those of `closed_form.py`, summed over what each link carries: with the first moments
H_c = sum_k B_k E_k of the links k that link c carries, itself included, and p_ac E_a the way from
link a's joint to where link c's branch leaves it,

    X_ac = conj(p_ac E_a) H_c        M_ac = sum Re(X)        C_ac = sum -+ Im(X) alphad

or with the cosines of angle differences, X_ac = sum_k conj(p_ac) B_k exp(i theta_ak), as textbooks
do: whichever costs less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TypeVar

from robodyn import expression
from robodyn.equations import Equations, with_parameters
from robodyn.equations.named import Numbers, named_mechanism
from robodyn.equations.outline import Block, heads
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.expression import Expression, Graph, Value
from robodyn.force_formulas import other_torques, potential_torques
from robodyn.formula_state import Planar, State, planar, plus, times, to_joints
from robodyn.formulas import closure_bends, closure_gap, joint_jacobian
from robodyn.mechanism import Mechanism, too_large

T = TypeVar("T")
Matrix = list[list[Value]]
Pairs = Mapping[tuple[int, int], T]
CouplingRow = tuple[Value, Mapping[int, Value]]  # offset, turns of joints


def recorded(mechanism: Mechanism, numeric: bool = False) -> Equations[Value]:
    """The equations of motion of the mechanism's scene; inputs are called q0, .., qd0, ..

    Raises InputError where a number that is put in leaves the range of floats.
    """
    graph = Graph()
    scene = SymbolicScene(mechanism, numeric)
    numbers = Numbers(scene, graph)
    couplings = [numbers.coupling(*row) for row in scene.coupling_rows()]
    try:
        named = named_mechanism(scene, numbers)
        states = [State(named, ("qd",), by_direction, graph) for by_direction in (False, True)]
        found = []
        for head in heads(mechanism):
            written = [_entries(head.name, state, couplings) for state in states]
            rows = min(written, key=lambda rows: expression.cost(list(chain.from_iterable(rows))))
            found.append(Block(head, tuple(map(tuple, rows))))
        entries = list(chain.from_iterable(row for block in found for row in block.rows))
        nodes = expression.needed(entries)
        constants = chain(entries, (a for node in nodes for a in node.args))
        folded = [abs(float(x)) for x in constants if not isinstance(x, (str, Expression))]
        sums = sum(abs(x) for *_, x in mechanism.A) if numeric else 0.0  # as in M's entries
        if not math.isfinite(max([sums, *folded])):
            raise OverflowError
    except OverflowError:
        raise too_large(mechanism.description) from None
    used = {str(node.args[0]) for node in nodes if node.op == "var"}
    return with_parameters(mechanism, found, scene.parameters, used, numeric)


def _entries(name: str, state: State, couplings: Sequence[CouplingRow]) -> Matrix:
    """The entries of the block of this name."""
    mechanism = state.mechanism
    match name:
        case "M":
            return mass_matrix(state)
        case "C":
            return coriolis_matrix(state)
        case "D":
            D = mechanism.damping
            return [[D[k] if j == k else 0.0 for j in range(len(D))] for k in range(len(D))]
        case "G":
            gravity = to_joints(mechanism, [state.gravity(k) for k in range(mechanism.n)])
            springs = potential_torques(state)
            return [[x - y] for x, y in zip(gravity, springs, strict=True)]
        case "Q":
            return [[x] for x in other_torques(state)]
        case "Psi":
            joints = range(mechanism.n)
            return joint_jacobian(state) + [[x.get(k, 0.0) for k in joints] for _, x in couplings]
        case "Psidot_qd":
            return [[-x] for x in closure_bends(state)] + [[0.0] for _ in couplings]
        case "gap":
            gaps = [closure_gap(state, row) for row in range(len(mechanism.rows))]
            for offset, turns in couplings:
                gaps.append(offset)
                for k, turn in turns.items():
                    gaps[-1] = gaps[-1] + turn * state.relative["q"][k]
            return [[x] for x in gaps]
    raise AssertionError(name)


def mass_matrix(state: State) -> Matrix:
    """M."""
    inertia = {j: A.real for j, k, A in state.mechanism.A if j == k}
    real = {pair: X[0] for pair, X in _moments(state).items()}
    return _summed(state.mechanism, inertia, real, real)


def coriolis_matrix(state: State) -> Matrix:
    """C, by Christoffel symbols."""
    rates = state.absolute("qd")
    upper = {pair: -X[1] for pair, X in _moments(state, rates).items()}
    lower = {(a, c): rates[a] * X[1] for (a, c), X in _moments(state).items()}
    return _summed(state.mechanism, {}, upper, lower)


def _summed(
    mechanism: Mechanism, diagonal: Mapping[int, Value], upper: Pairs[Value], lower: Pairs[Value]
) -> Matrix:
    """J^T W J, of W summed over the links that link c, below link a, carries.

    `upper` has the sums of row a, `lower` those of column a; `diagonal` is that of W.
    """
    joints = range(mechanism.n)
    found: Matrix = [[0.0 for _ in joints] for _ in joints]
    for c in reversed(mechanism.order):
        found[c][c] = found[c][c] + diagonal.get(c, 0.0)
        path = mechanism.path(c)
        for a, down in zip(path[-2::-1], path[:0:-1], strict=True):
            found[a][c] = found[down][c] + upper.get((a, c), 0.0)
            found[c][a] = found[c][down] + lower.get((a, c), 0.0)
        if len(path) > 1:
            above = path[-2]
            found[above][above] = found[above][above] + found[c][above] + upper.get((above, c), 0.0)
    return found


def _moments(state: State, rates: Sequence[Value] | None = None) -> Pairs[Planar]:
    """X_ac for a above c; with `rates` those of the links k as factors in H and in the sum."""
    mechanism = state.mechanism

    def scaled(z: Planar, k: int) -> Planar:
        return z if rates is None else (z[0] * rates[k], z[1] * rates[k])

    X: dict[tuple[int, int], Planar] = {}
    if not state.by_direction:
        for a, k, A in mechanism.A:
            if a != k:
                X[a, k] = scaled(times(planar(A), state.turn(a, k)), k)
        for k in reversed(mechanism.order):
            path = mechanism.path(k)
            for a in path[:-2]:
                if (a, k) in X:
                    X[a, path[-2]] = plus(X.get((a, path[-2]), (0.0, 0.0)), X[a, k])
        return X
    H = [scaled(times(planar(b), state.direction(k)), k) for k, b in enumerate(mechanism.B)]
    for k in reversed(mechanism.order):
        above = mechanism.parent[k]
        if above is not None:
            H[above] = plus(H[above], H[k])
    for c, pivot in enumerate(mechanism.pivots):
        for a, p in pivot.terms:
            x, y = times(planar(p), state.direction(a))
            X[a, c] = x * H[c][0] + y * H[c][1], x * H[c][1] - y * H[c][0]
    return X
