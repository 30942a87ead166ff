"""The entries of a scene's equations of motion, from the rows that robodyn computes with.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

The rows (`mechanics/equations_of_motion.py`) are written for a mechanism whose numbers are symbols
or recorded arithmetic, of which each block takes what makes it.  M and C are, in the links' angles,

    M_jk = Re(X_jk)     C_jk = -Im(X_jk) alphad_k     C_kj = Im(X_jk) alphad_j     (j above k)

with X_jk = conj(E_j) A_jk E_k: Im(X) are the masses of a mechanism that has -i A for A.  Where
links slide, X = T^H A T with the slopes T of `closed_form.py`.  The slope of what turns and of
what slides on it grow as T' = i (alphad_k T_k + sum sd_j T_j) and T' = i alphad_k T_j, so that

    C_jk = -Im(X_jk) alphad_k - sum Im(X_ji) sd_i       (i on k)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from robodyn.engines.arithmetic import plus, times
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
    state at which the rows are taken, with rates qd.  Weights and moments of `drag` belong to Q.
    """

    def __init__(
        self,
        named: Mechanism,
        couplings: Sequence[CouplingRow],
        state: Callable[[Mechanism], Recorded],
        drag: Mechanism | None = None,
    ) -> None:
        self.named, self.couplings, self.state = named, couplings, state
        self.drag = parts.bare(named) if drag is None else drag

    def of(self, name: str) -> Matrix:
        """The entries of the block of this name, row by row."""
        named, joints = self.named, range(self.named.n)
        match name:
            case "M":
                M = self._in_joints(self._masses(named.A))
                for rotor in named.rotors:
                    spins = named.spins(rotor).items()
                    for (a, x), (c, y) in product(spins, spins):
                        M[a][c] = plus(M[a][c], times(rotor.inertia, times(x, y)))
                return [[M[min(a, c)][max(a, c)] for c in joints] for a in joints]
            case "C":
                return self._in_joints(self._coriolis())
            case "D":
                return [[x if j == k else 0.0 for j in joints] for k, x in enumerate(named.damping)]
            case "G":
                springs = parts.stored(named)
                return self._load(replace(springs, weights=named.weights, moments=named.moments))
            case "Q":
                weights, moments = self.drag.weights, self.drag.moments
                load = self._load(replace(parts.spent(named), weights=weights, moments=moments))
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

    def _coriolis(self) -> Matrix:
        """C in the links' angles and the displacements."""
        named, joints = self.named, range(self.named.n)
        rank = {None: -1} | {k: place for place, k in enumerate(named.order)}
        place = [rank[frame] for frame in named.frames]
        between: list[tuple[int, int, Value]] = []  # of different frames, in their order
        within: dict[tuple[int, int], Value] = {}
        for j, k, A in named.A:
            if place[j] == place[k]:
                within[j, k], within[k, j] = A, A if j == k else A.conjugate()
            else:
                one = (j, k, A) if place[j] < place[k] else (k, j, A.conjugate())
                between.append((*one[:2], one[2] * -1j))
        X = self._masses(between)
        w, s = self._at.absolute("qd"), self._at.relative["q"]
        on = [[i for i in named.slides if named.frames[i] == k] for k in joints]

        def turning(j: int, k: int) -> Value:
            """-Im(X_jk)."""
            if place[j] != place[k]:
                return -X[j][k] if place[j] < place[k] else X[j][k]
            if j == k:
                return 0.0
            if j in named.slides and k in named.slides:
                return -within[j, k].imag if (j, k) in within else 0.0
            d, i = (j, k) if k in named.slides else (k, j)
            arm: Value = within[d, i].real if (d, i) in within else 0.0
            for c in on[d]:
                if (c, i) in within:
                    arm = arm + within[c, i].real * s[c]
            return arm if i == k else -arm

        def entry(j: int, k: int) -> Value:
            frame, total = named.frames[k], 0.0
            rates = [(i, w[i]) for i in on[k]] + ([] if frame is None else [(k, w[frame])])
            for i, rate in rates:
                total = plus(total, times(turning(j, i), rate))
            return total

        W: Matrix = [[0.0 for _ in joints] for _ in joints]
        for k in named.order:
            for j in named.order[: named.order.index(k) + 1]:
                W[j][k], W[k][j] = entry(j, k), entry(k, j)
        return W

    def _in_joints(self, W: Matrix) -> Matrix:
        """J^T W J."""
        summed = [self._at.to_joints(row) for row in W]
        columns = [self._at.to_joints(column) for column in zip(*summed, strict=True)]
        return [list(row) for row in zip(*columns, strict=True)]
