"""Forces of a motion as formulas of its state and of a scene's numbers.

Inputs are q, qd, qdd, the forces f = (tau of actuated joints, lambda), the time, and the changes
p of named numbers; what a motion does with them is `lane_states.py`'s.
Points are linear in X, so with X' and X'' they move; reactions and what the ground feels are
as `reaction_forces.py` has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.closed_form import points_of
from robodyn.dynamics.dynamics import pins_at
from robodyn.dynamics.named_numbers import with_variables
from robodyn.dynamics.placed import Placed
from robodyn.dynamics.reaction_forces import Felt, Part
from robodyn.engines import expression
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import Recorded, balance, joint_jacobian
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.row_values import RowValues
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint


class ForceFormulas:
    """The formulas of a mechanism whose numbers `names` change by p0, p1, ..."""

    def __init__(self, mechanism: Mechanism, names: Sequence[str]) -> None:
        self.mechanism, self.names = mechanism, tuple(names)
        self.graph = graph = Graph()
        self.p = [graph.variable(f"p{k}") for k in range(len(names))]
        self.named = with_variables(mechanism, dict(zip(names, self.p, strict=True)))
        self.state = Recorded(self.named, ("qd", "qdd"), True, graph=graph)
        n, r, a = mechanism.n, len(mechanism.rows), len(mechanism.actuated)
        self.forces = [graph.variable(f"f{k}") for k in range(a + r)]
        series = self.state.series([0.0] * n, accelerated=True)
        found = series.residuals(0)
        self.gap, self.gap_rate = (
            [series.real[slot][m] for slot in series.program.named["gap"]] for m in (0, 1)
        )
        self.gap_bend = found[n:]
        self.load = balance(self.state, series)
        self.Psi = joint_jacobian(self.state, series)
        pulled = [
            sum((self.Psi[i][k] * self.forces[a + i] for i in range(r)), 0.0) for k in range(n)
        ]
        driven = dict(zip(mechanism.actuated, self.forces, strict=False))
        self.balance = [
            x - y - driven.get(k, 0.0)
            for k, (x, y) in enumerate(zip(self.load, pulled, strict=True))
        ]

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """The names of all inputs, in their order: those of the state, t, forces, changes."""
        forces = (f"f{k}" for k in range(len(self.forces)))
        return (*self.state.inputs, "t", *forces, *(f"p{k}" for k in range(len(self.p))))

    def moved(self, point: PlanarPoint, order: int) -> Any:
        """A point, its velocity (1) or its acceleration (2)."""
        points = points_of(self.named, [point])
        return (points.moved(self.moving[order]) if order else points.place(self.moving[0]))[0]

    @cached_property
    def moving(self) -> tuple[Placed, Placed, Placed]:
        """Where the mechanism is, and its rates and accelerations."""
        mechanism, x = self.mechanism, self.state.absolute("q")
        E = [
            Planar(1.0, 0.0) if d is None else Planar(expression.cos(x[d]), expression.sin(x[d]))
            for d in mechanism.frames
        ]
        X = [e * x[k] if k in mechanism.slides else e for k, e in enumerate(E)]
        at = Placed(*(np.array(values, object) for values in (x, X, E)))
        w, a = (self._planar(self.state.absolute(name)) for name in ("qd", "qdd"))
        return at, at.rates(mechanism, w), at.accelerations(mechanism, w, a)

    @staticmethod
    def _planar(values: Sequence[Value]) -> NDArray[Any]:
        return np.array([Planar(x, 0.0) for x in values], object)

    # -- forces ------------------------------------------------------------------------------------

    @cached_property
    def _felt(self) -> Felt:
        at, _, bent = self.moving
        lam, rows = self.forces[len(self.mechanism.actuated) :], self.mechanism.rows
        kept = [x * row.arm for x, row in zip(lam, rows, strict=True) if row.arm]
        pins = pins_at(self.named, self._planar(lam), at.E)
        each = self.state.absolute("qdd"), self.state.relative["qdd"], kept
        xdd, qdd, moments = (np.array(values, object) for values in each)
        return Felt(self.named, at, bent, xdd, qdd, pins, moments, self._rows)

    def _rows(self, part: Part, name: str) -> NDArray[Any]:
        """What acts, from the rows of its program."""
        found: Sequence[Any] = RowValues(part(self.named), self.graph).nodes(name)
        if name != "moments":
            found = [Planar(x, y) for x, y in zip(found[::2], found[1::2], strict=True)]
        return np.array(found, object)

    @cached_property
    def loop_forces(self) -> list[Value]:
        """Those of closures, moments of angles that are kept, torques of couplings."""
        return [*(x for pin in self._felt.pins for x in (pin.real, pin.imag)), *self._felt.kept]

    @cached_property
    def reactions(self) -> list[Any]:
        """The force on each link at its own joint."""
        return list(self._felt.reactions())

    @cached_property
    def slide_moments(self) -> dict[int, Value]:
        """What keeps the links that slide from turning, about their origins."""
        found: list[Any] = self._felt.slide_moments()
        return dict(zip(self.mechanism.slides, found, strict=True))

    @cached_property
    def shaking(self) -> Sequence[Any]:
        """Fx, Fy and M on the ground."""
        return self._felt.shaking()
