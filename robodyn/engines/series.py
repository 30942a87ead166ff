"""Evaluates a program of rows as power series in time, order by order, over any kind of numbers.

The numbers are what `Arithmetic` says: floats, nodes of a recorded formula, numpy arrays over
lanes, or numbers of many digits.  One order is enough for values: the accelerations at a state.

At order p every slot gets the coefficient that the program's schedule wants: first what is known of
it (the unknowns of this order taken as zero), then, once the residuals are solved for the unknowns,
the rest.  The unknowns of every order enter through the same matrix K = [M Psi^T; Psi 0], which
follows from the rows by walking them; it is factored once.

A direction is E_m = (rho_m + i theta_m) E_0.  As |E| = 1 its radial coefficient is known,

    rho_m = -1/2 sum_{0<j<m} (rho_j rho_{m-j} + theta_j theta_{m-j}),

and theta_m = u/(m (m-1)) with the unknown u of order m - 2, which at order 0 is the link's angular
acceleration.  Planar coefficients stay sums over such frames E_0, and a moment about a link is
taken in the frame of that link: products of two directions are found once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from robodyn.engines.arithmetic import FLOATS as FLOATS
from robodyn.engines.arithmetic import Arithmetic as Arithmetic
from robodyn.engines.arithmetic import Planar as Planar
from robodyn.engines.arithmetic import Value as Value
from robodyn.engines.arithmetic import conjugate_times as conjugate_times
from robodyn.engines.arithmetic import plus, some, times
from robodyn.engines.factors import Factors
from robodyn.engines.frames import State as State
from robodyn.engines.rules import Rules
from robodyn.mechanics import program as rows
from robodyn.mechanics.program import COORDINATES, Slot


@dataclass(eq=False, repr=False)
class Series(Rules):
    """The coefficients of a program's slots along one motion.

    `orders` of unknowns are expanded; `slots` are wanted besides the residuals.  With `grounded`
    forces are summed in the ground's frame, which pays on deep trees.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        program, room, K = self.program, self.arithmetic.room, self.orders + 3
        for slot, row in self.rows:
            if program.planar[slot]:
                self.planar[slot] = self.planar_room(slot, K)
                if isinstance(row, rows.Turn):
                    self._moment[slot] = (room(K), room(K))  # rho, theta
            else:
                self.real[slot] = room(K)
            if isinstance(row, rows.Slide):
                self._extra[slot] = room(K)
                self._extra[slot][0] = 1.0
            if isinstance(row, rows.Moment):
                self._moment[slot] = (room(K), room(K))
            if isinstance(row, rows.Function):
                self._extra[slot] = room(K)
        for slot, row in self.rows:
            for m in range(self.ahead[slot]):
                self.put(slot, m, self.known(slot, row, m))
        self._balance: dict[Slot, int] = {}
        self._residuals: list[Value] = []
        self.factors: Factors | None = None
        self.p = 0

    def planar_room(self, slot: Slot, orders: int) -> Any:
        """Room for the coefficients of a planar slot."""
        return [()] * orders

    # -- one order ---------------------------------------------------------------------------------

    def residuals(self, p: int) -> list[Value]:
        """What the residuals are at order p with the unknowns of that order zero."""
        self.p, self.unknown_values = p, {}
        for slot, row in self.rows:
            m = p + self.ahead[slot]
            self.put(slot, m, self.known(slot, row, m))
        self._residuals = [self.real[slot][p] for slot in self.program.residuals]
        return self._residuals

    def complete(self, unknowns: Sequence[Value], balanced: bool = False) -> None:
        """Add what the unknowns of this order make; `balanced`: they solve the residuals."""
        self._balance = self._balances() if balanced else {}
        p, program = self.p, self.program
        self.unknown_values = dict(zip(program.unknowns, unknowns, strict=True))
        change: dict[Slot, Any] = {}
        for slot, row in self.rows:
            if slot not in self.live:
                continue
            m = p + self.ahead[slot]
            through = {x: change[x] for x in self.live[slot]}
            delta = change[slot] = self.change(slot, row, m, through)
            match row:
                case rows.Turn(link=k):
                    rho, theta = self._moment[slot]
                    theta[m] = self.arithmetic.keep(delta[0][2][1])
                    self.put(slot, m, ((k, None, (rho[m], theta[m])),))
                case rows.Derivative() if program.planar[slot]:
                    self.put(slot, m, self.known(slot, row, m))
                case _ if program.planar[slot]:
                    self.put(slot, m, (*self.planar[slot][m], *delta))
                case rows.Moment():
                    x, y = self._moment[slot]
                    added = self._moment_change(row, through)
                    if slot in self._balance:  # its residual vanishes: no need to add up again
                        delta = change[slot] = times(-1.0, self._residuals[self._balance[slot]])
                    else:
                        delta = added[1]
                    x[m] = self.arithmetic.keep(plus(x[m], added[0]))
                    y[m] = self.arithmetic.keep(plus(y[m], delta))
                    self.real[slot][m] = plus(self.real[slot][m], delta)
                case _:
                    self.real[slot][m] = plus(self.real[slot][m], delta)

    def expand(self, factors: Factors | None = None) -> list[list[Value]]:
        """All orders; the unknowns of each."""
        return [self.advance(p, factors) for p in range(self.orders)]

    def advance(self, p: Any, factors: Factors | None = None) -> list[Value]:
        """One order after those before it; its unknowns."""
        right = [times(-1.0, x) if type(x) is float else -x for x in self.residuals(p)]
        self.factors = self.factors or factors or self.factorise()
        solution = self.factors.solve(right)
        self.complete(solution, balanced=True)
        return solution

    def turn(self, slot: Slot) -> tuple[Any, Any]:
        """The coefficients rho and theta of a direction; of a displacement s 1 and s.

        So a rate is Im(conj(z) z') of z = rho + i theta for both.
        """
        if slot in self._moment:
            return self._moment[slot]
        return self._extra[slot], self.real[slot]

    def factorise(self) -> Factors:
        """K factored; after `residuals(0)`."""
        return Factors(self.matrix(), self.first_unknowns, self.arithmetic.keep)

    @property
    def first_unknowns(self) -> int:
        """How many of the unknowns are accelerations."""
        program = self.program
        return sum(isinstance(program.rows[x], COORDINATES) for x in program.unknowns)

    def _balances(self) -> dict[Slot, int]:
        """The moments that the unknowns change by as much as they change a residual."""
        found: dict[Slot, int] = {}
        for place, slot in enumerate(self.program.residuals):
            while isinstance(row := self.program.rows[slot], rows.Sum):
                changing = [(c, x) for c, x in row.terms if x in self.live[slot]]
                if len(changing) != 1 or changing[0][0] != 1.0:
                    break
                slot = changing[0][1]
            if isinstance(row, rows.Moment):
                found[slot] = place
        return found

    def matrix(self) -> list[dict[int, Value]]:
        """The rows of K, the tangents of the residuals in the unknowns; after `residuals(0)`."""
        place = {slot: i for i, slot in enumerate(self.program.unknowns)}
        tangents: dict[Slot, dict[Slot, Any]] = {}
        for slot, row in self.rows:
            if slot not in self.live:
                continue
            tangents[slot] = {}
            by_unknown: dict[Slot, dict[Slot, Any]] = {}
            if isinstance(row, (*COORDINATES, rows.Unknown)):
                by_unknown[slot] = {}
            else:
                for x in self.live[slot]:
                    for unknown, value in tangents[x].items():
                        by_unknown.setdefault(unknown, {})[x] = value
            for unknown, change in by_unknown.items():
                self.unknown_values = {unknown: 1.0}
                tangents[slot][unknown] = self.change(slot, row, self.ahead[slot], change)
        self.unknown_values = {}
        return [
            {place[u]: value for u, value in tangents.get(slot, {}).items() if some(value)}
            for slot in self.program.residuals
        ]
