"""The equations of motion as recorded arithmetic on named numbers, for what writes code.

Their entries come from the rows that robodyn computes with (`mechanics/equations_of_motion.py`),
written for a mechanism whose numbers are the scene's parameters, of which each block takes what
makes it.  M and C are, in the links' angles,

    M_jk = Re(X_jk)     C_jk = -Im(X_jk) alphad_k     C_kj = Im(X_jk) alphad_j     (j above k)

with X_jk = conj(E_j) A_jk E_k: Im(X) are the masses of a mechanism that has -i A for A.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from robodyn.engines import expression
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.engines.formulas import RECORDED, Recorded, balance, joint_jacobian
from robodyn.engines.series import Series
from robodyn.equations import Equations, with_parameters
from robodyn.equations.named import Numbers
from robodyn.equations.outline import Block, heads
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.mechanics.mechanism import Mechanism, too_large

Matrix = list[list[Value]]
SHORT = replace(RECORDED, keep=lambda value: value)  # signs and factors move where they fold
CouplingRow = tuple[Value, Mapping[int, Value]]  # offset, turns of joints


def recorded(mechanism: Mechanism, numeric: bool = False) -> Equations[Value]:
    """The equations of motion of the mechanism's scene; inputs are called q0, .., qd0, ..

    Raises InputError where a number that is put in leaves the range of floats, SingularError where
    the ends of a spring coincide at every state.
    """
    graph = Graph()
    scene = SymbolicScene(mechanism, numeric)
    numbers = Numbers(scene, graph)
    couplings = [
        (numbers(offset), dict(numbers(tuple(turns.items()))))
        for offset, turns in scene.coupling_rows()
    ]
    try:
        named = numbers.mechanism()
        ways = [_Parts(named, graph, by_direction) for by_direction in (False, True)]
        found = []
        for head in heads(mechanism):
            written = [way.entries(head.name, couplings) for way in ways]
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
    except ZeroDivisionError:
        from robodyn.dynamics.forces import no_direction  # with numpy

        for i, spring in enumerate(named.springs):
            d, directed = spring.between, spring.length or spring.damping
            if directed and not (d.terms or d.constant):
                raise no_direction(mechanism, i) from None
        raise
    used = {str(node.args[0]) for node in nodes if node.op == "var"}
    return with_parameters(mechanism, found, scene.parameters, used, numeric)


class _Parts:
    """The blocks of a mechanism, each from the rows of what makes it."""

    def __init__(self, named: Mechanism, graph: Graph, by_direction: bool) -> None:
        self.named, self.graph, self.by_direction = named, graph, by_direction
        zero = (0.0,) * named.n
        self.bare = replace(named, A=(), damping=zero, rows=(), weights=zero, moments=zero)
        self.bare = replace(self.bare, springs=(), joint_springs=(), forces=(), friction=())

    def entries(self, name: str, couplings: Sequence[CouplingRow]) -> Matrix:
        """The entries of the block of this name."""
        named, joints = self.named, range(self.named.n)
        match name:
            case "M":
                M = self._in_joints(self._masses(named.A))
                return [[M[min(a, c)][max(a, c)] for c in joints] for a in joints]
            case "C":
                X = self._masses(tuple((j, k, A * -1j) for j, k, A in named.A if j != k))
                w = self._state.absolute("qd")
                W: Matrix = [[0.0 for _ in joints] for _ in joints]
                for j, k, _ in named.A:
                    if j != k:
                        W[j][k], W[k][j] = -X[j][k] * w[k], X[j][k] * w[j]
                return self._in_joints(W)
            case "D":
                return [[x if j == k else 0.0 for j in joints] for k, x in enumerate(named.damping)]
            case "G":
                springs = tuple(replace(x, damping=0.0) for x in named.springs)
                return self._load(
                    weights=named.weights,
                    moments=named.moments,
                    springs=springs,
                    joint_springs=named.joint_springs,
                )
            case "Q":
                springs = tuple(replace(x, stiffness=0.0) for x in named.springs if x.damping)
                load = self._load(springs=springs, forces=named.forces, friction=named.friction)
                return [[-x] for [x] in load]
        series = self._series(rows=named.rows)
        bias = series.residuals(0)[named.n :]
        match name:
            case "Psi":
                slopes = [[turns.get(k, 0.0) for k in joints] for _, turns in couplings]
                return joint_jacobian(self._state, series) + slopes
            case "Psidot_qd":
                return [[x] for x in (*bias, *(0.0 for _ in couplings))]
            case "gap":
                gaps: list[Value] = [series.real[x][0] for x in series.program.named["gap"]]
                for offset, turns in couplings:
                    gaps.append(offset)
                    for k, turn in turns.items():
                        gaps[-1] = gaps[-1] + turn * self._state.relative["q"][k]
                return [[x] for x in gaps]
        raise AssertionError(name)

    def _series(self, **parts: Any) -> Series:
        """The rows of a mechanism that has these parts and nothing else."""
        part = replace(self.bare, **parts)
        way = self.by_direction
        self._state = Recorded(part, ("qd",), way, graph=self.graph, arithmetic=SHORT)
        return self._state.series([0.0] * part.n)

    def _load(self, **parts: Any) -> Matrix:
        """What the joints carry at rest."""
        series = self._series(**parts)
        series.residuals(0)
        return [[x] for x in balance(self._state, series)[0]]

    def _masses(self, A: Sequence[tuple[int, int, complex]]) -> Matrix:
        """M in the links' angles."""
        series = self._series(A=A)
        series.residuals(0)
        return [[row.get(k, 0.0) for k in range(self.named.n)] for row in series.matrix()]

    def _in_joints(self, W: Matrix) -> Matrix:
        """J^T W J."""
        summed = [self._state.to_joints(row) for row in W]
        columns = [self._state.to_joints(column) for column in zip(*summed, strict=True)]
        return [list(row) for row in zip(*columns, strict=True)]
