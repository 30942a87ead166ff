"""The entries of a scene's equations of motion, from the rows that robodyn computes with.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

The rows (`mechanics/equations_of_motion.py`) are written for a mechanism whose numbers are symbols
or recorded arithmetic, of which each block takes what makes it.  M and C are, in the links' angles,

    M_jk = Re(X_jk)     C_jk = -Im(X_jk) alphad_k     C_kj = Im(X_jk) alphad_j     (j above k)

with X_jk = conj(E_j) A_jk E_k: Im(X) are the masses of a mechanism that has -i A for A.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from robodyn.engines.formulas import Recorded, balance, joint_jacobian
from robodyn.engines.series import Series
from robodyn.mechanics import parts
from robodyn.mechanics.planar_model import Mechanism

Value = Any
Matrix = list[list[Value]]
CouplingRow = tuple[Value, Mapping[int, Value]]  # offset, turns of joints


class Entries:
    """The blocks of a mechanism, each from the rows of what makes it.

    `named` is the mechanism without its couplings, whose rows are `couplings`; `state` makes the
    state at which the rows are taken, with rates qd.  `drag` (n) are weights that belong to Q.
    """

    def __init__(
        self,
        named: Mechanism,
        couplings: Sequence[CouplingRow],
        state: Callable[[Mechanism], Recorded],
        drag: Sequence[Value] = (),
    ) -> None:
        self.named, self.couplings, self.state = named, couplings, state
        self.drag = tuple(drag) or (0.0,) * named.n

    def of(self, name: str) -> Matrix:
        """The entries of the block of this name, row by row."""
        named, joints = self.named, range(self.named.n)
        match name:
            case "M":
                M = self._in_joints(self._masses(named.A))
                return [[M[min(a, c)][max(a, c)] for c in joints] for a in joints]
            case "C":
                X = self._masses(tuple((j, k, A * -1j) for j, k, A in named.A if j != k))
                w = self._at.absolute("qd")
                W: Matrix = [[0.0 for _ in joints] for _ in joints]
                for j, k, _ in named.A:
                    if j != k:
                        W[j][k], W[k][j] = -X[j][k] * w[k], X[j][k] * w[j]
                return self._in_joints(W)
            case "D":
                return [[x if j == k else 0.0 for j in joints] for k, x in enumerate(named.damping)]
            case "G":
                springs = parts.stored(named)
                return self._load(replace(springs, weights=named.weights, moments=named.moments))
            case "Q":
                load = self._load(replace(parts.spent(named), weights=self.drag))
                return [[-x] for [x] in load]
            case "Psi":
                series = self._series(rows=named.rows)
                series.residuals(0)
                slopes = [[turns.get(k, 0.0) for k in joints] for _, turns in self.couplings]
                return joint_jacobian(self._at, series) + slopes
            case "Psidot_qd":
                bias = self._series(rows=named.rows).residuals(0)[named.n :]
                return [[x] for x in (*bias, *(0.0 for _ in self.couplings))]
            case "gap":
                gaps = [gap for gap, _ in self.gaps()]
                for offset, turns in self.couplings:
                    gaps.append(offset)
                    for k, turn in turns.items():
                        gaps[-1] = gaps[-1] + turn * self._at.relative["q"][k]
                return [[x] for x in gaps]
        raise AssertionError(name)

    def gaps(self) -> list[tuple[Value, Value]]:
        """The gaps of the closures, and their rates."""
        series = self._series(rows=self.named.rows)
        gaps = (series.real[slot] for slot in series.program.named["gap"])
        return [(gap[0], gap[1]) for gap in gaps]

    def _series(self, **has: Any) -> Series:
        """The rows of a mechanism that has these parts and nothing else."""
        return self._rows_of(replace(parts.bare(self.named), **has))

    def _rows_of(self, part: Mechanism) -> Series:
        self._at = self.state(part)
        return self._at.series([0.0] * part.n)

    def _load(self, part: Mechanism) -> Matrix:
        """What the joints carry at rest."""
        series = self._rows_of(part)
        series.residuals(0)
        return [[x] for x in balance(self._at, series)]

    def _masses(self, A: Sequence[tuple[int, int, complex]]) -> Matrix:
        """M in the links' angles."""
        series = self._series(A=A)
        series.residuals(0)
        return [[row.get(k, 0.0) for k in range(self.named.n)] for row in series.matrix()]

    def _in_joints(self, W: Matrix) -> Matrix:
        """J^T W J."""
        summed = [self._at.to_joints(row) for row in W]
        columns = [self._at.to_joints(column) for column in zip(*summed, strict=True)]
        return [list(row) for row in zip(*columns, strict=True)]
