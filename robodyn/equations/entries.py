"""The entries of a scene's equations of motion, from the rows with which robodyn computes.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

The rows (`mechanics/equations_of_motion.py`) are evaluated for a mechanism whose numbers are
symbols or recorded arithmetic.  Each block uses only the parts of the mechanism that enter it.  The
rates alone give h = C qd, a quadratic form, and the Christoffel C is symmetric in the two rates of
each term, so that

    C = 1/2 dh/dqd
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from robodyn.engines.arithmetic import plus, times
from robodyn.engines.formulas import Recorded, balance, joint_jacobian
from robodyn.engines.series import Series
from robodyn.equations.law_terms import TIME, LawTerms
from robodyn.mechanics import parts
from robodyn.mechanics.planar_model import Mechanism

Value = Any
Matrix = list[list[Value]]
CouplingRow = tuple[Value, Mapping[int, Value], LawTerms | None]  # offset, turns of joints, law


class Entries:
    """The blocks of a mechanism, each from the rows that produce it.

    `named` is the mechanism without its couplings, whose rows are `couplings`.  `state` makes the
    state at which rows are evaluated, with rates qd; `at` is the last one.  M and C are J^T W J.
    `shared` may replace the entries of W (level 0) and of W J (level 1) by names.
    """

    def __init__(
        self,
        named: Mechanism,
        couplings: Sequence[CouplingRow],
        state: Callable[[Mechanism], Recorded],
        shared: Callable[[str, int, Matrix], Matrix] = lambda name, level, W: W,
    ) -> None:
        self.named, self.couplings, self.state = named, couplings, state
        self.shared = shared

    def of(self, name: str) -> Matrix:
        """Return the entries of the block `name`, row by row."""
        named, joints = self.named, range(self.named.n)
        match name:
            case "M":
                K = self._series(A=named.A).matrix()
                M = self._in_joints(name, [[row.get(k, 0.0) for k in joints] for row in K])
                for spin in named.spins:
                    spins = spin.rates.items()
                    for (a, x), (c, y) in product(spins, spins):
                        M[a][c] = plus(M[a][c], times(spin.inertia, times(x, y)))
                return [[M[min(a, c)][max(a, c)] for c in joints] for a in joints]
            case "C":
                series = self._series(A=named.A)
                loads = [series.real[slot][0] for slot in series.program.named["load"]]
                return self._in_joints(name, self.at.half_slopes(loads))
            case "D":
                return [[x if j == k else 0.0 for j in joints] for k, x in enumerate(named.damping)]
            case "G":
                springs = parts.stored(named)
                return self._load(replace(springs, weights=named.weights, moments=named.moments))
            case "Q":
                return [[-x] for [x] in self._load(parts.spent(named))]
            case "Psi":
                series = self._series(rows=named.rows)
                slopes = [[turns.get(k, 0.0) for k in joints] for _, turns, _ in self.couplings]
                for row, (_, _, law) in zip(slopes, self.couplings, strict=True):
                    if law is not None:
                        for k, x in law.slopes.items():
                            if k != TIME:
                                row[k] = row[k] - law.arm * x
                return joint_jacobian(self.at, series) + slopes
            case "Psidot_qd":
                bias = self._series(rows=named.rows).residuals(0)[named.n :]
                rates = self.at.relative["qd"]
                laws = [law for _, _, law in self.couplings]
                bends = [0.0 if x is None else 0.0 - x.arm * x.bend(rates) for x in laws]
                return [[x] for x in (*bias, *bends)]
            case "gap_t":
                drifts = [0.0 for _ in self._series(rows=named.rows).program.named["gap"]]
                for _, _, law in self.couplings:
                    own = 0.0 if law is None else law.slopes.get(TIME, 0.0)
                    drifts.append(0.0 if law is None else 0.0 - law.arm * own)
                return [[x] for x in drifts]
            case "inverse_dynamics" | "joint_torques":
                return self._load(replace(named, rows=()), accelerated=True)
            case "gap":
                gaps = [gap for gap, _ in self.gaps()]
                for offset, turns, law in self.couplings:
                    gaps.append(offset)
                    for k, turn in turns.items():
                        gaps[-1] = gaps[-1] + turn * self.at.relative["q"][k]
                    if law is not None:
                        gaps[-1] = gaps[-1] - law.arm * law.value
                return [[x] for x in gaps]
        raise AssertionError(name)

    def gaps(self) -> list[tuple[Value, Value]]:
        """Return the gaps of the closures and their rates."""
        series = self._series(rows=self.named.rows)
        gaps = (series.real[slot] for slot in series.program.named["gap"])
        return [(gap[0], gap[1]) for gap in gaps]

    def _series(self, **has: Any) -> Series:
        """Return the series of a mechanism that has only these parts."""
        return self._rows_of(replace(parts.bare(self.named), **has))

    def _rows_of(self, part: Mechanism, accelerated: bool = False) -> Series:
        self.at = self.state(part)
        chained = accelerated and self.at.by_direction and len(part.A) > 2 * part.n
        series = self.at.series([0.0] * part.n, chained=chained, accelerated=accelerated)
        series.residuals(0)
        return series

    def _load(self, part: Mechanism, accelerated: bool = False) -> Matrix:
        """Return the load of the joints as a column."""
        series = self._rows_of(part, accelerated)
        return [[x] for x in balance(self.at, series)]

    def _in_joints(self, name: str, W: Matrix) -> Matrix:
        """Return J^T W J for the block called `name`."""
        summed = [self.at.to_joints(row) for row in self.shared(name, 0, W)]
        columns = zip(*self.shared(name, 1, summed), strict=True)
        entries = [self.at.to_joints(column) for column in columns]
        return [list(row) for row in zip(*entries, strict=True)]
