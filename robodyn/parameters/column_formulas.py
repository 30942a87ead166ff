"""Columns of `points`, `torque` and `reactions` as formulas of a state and of a scene's numbers.

Inputs are q, qd, qdd, the forces f = (tau of actuated joints, lambda), the time, and the changes
p of named numbers; what a motion does with them is `lane_states.py`'s.
Points are linear in X, so with X' and X'' they move; reactions and what the ground feels are
as `reaction_forces.py` has them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.closed_form import points_of
from robodyn.dynamics.dynamics import pins_at
from robodyn.dynamics.named_numbers import with_variables
from robodyn.dynamics.placed import Placed
from robodyn.dynamics.reaction_forces import Felt, Part
from robodyn.engines import expression
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import Recorded, balance, joint_jacobian
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.recorded_numbers import evaluated
from robodyn.engines.row_values import RowValues
from robodyn.engines.tangents import substituted
from robodyn.errors import InputError
from robodyn.kinematics.named_points import NamedPoint, named_points
from robodyn.kinematics.transmission import ratio_named, transmission_loops, turn_between
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.loop_rows import loop_columns
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.motors import motor_columns, motor_values
from robodyn.scene.expressions import NO_BENDS, Written, check_smooth
from robodyn.scene.yaml_values import nearest
from robodyn.tables.csv_fields import shown

SHAKES = ("shake_fx", "shake_fy", "shake_m")
PARTS = ("x", "y", "vx", "vy", "ax", "ay")
_SLOPE = re.compile("J([xy])([1-9][0-9]*)", re.ASCII)
_RELATION = re.compile(r"<=|>=|==|<|>")


class ColumnFormulas:
    """The formulas of a mechanism whose numbers `names` change by p0, p1, ..."""

    def __init__(self, mechanism: Mechanism, names: Sequence[str], of: Sequence[str] = ()) -> None:
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
        if of:
            named_points(mechanism, of, "--of")  # says what is wrong with them
        self._points = {x.name: x for x in named_points(self.named, of)} if of else {}

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

    # -- columns -----------------------------------------------------------------------------------

    def column(self, name: str, where: str = "column") -> Value:
        """The formula of a column; InputError, naming `where`, for one that is none."""
        found = self._named[name]() if name in self._named else self._point(name)
        if found is None and "/" in name:
            found = self._ratio(name)
        if found is None:
            limit = f"is no column that can be fitted{nearest(name, self.known)}"
            raise InputError(where, value=shown(name), limit=limit)
        return found

    @cached_property
    def known(self) -> list[str]:
        """The names of columns, but for those of points without a name."""
        points = [*self._points, *(x.name for x in named_points(self.mechanism))]
        points += self.mechanism.link_names
        return [*self._named, *(f"{point}_{part}" for point in points for part in PARTS)]

    @cached_property
    def _named(self) -> dict[str, Callable[[], Any]]:
        """What makes the columns that are no point's."""
        mechanism, state = self.mechanism, self.state.relative
        found: dict[str, Callable[[], Any]] = {
            f"{kind}{k + 1}": partial(values.__getitem__, k)
            for kind, values in state.items()
            for k in range(mechanism.n)
        }
        torques = dict(zip(mechanism.actuated, self.forces, strict=False))
        for k, tau in torques.items():
            found[f"tau{k + 1}"] = partial(torques.__getitem__, k)
            found[f"power{k + 1}"] = partial(expression.multiply, tau, state["qd"][k])
        for order, kind in enumerate(("angle", "w", "wd")):
            found |= {f"{kind}{k + 1}": partial(self._turn, k, order) for k in range(mechanism.n)}
        taken = {f"r{axis}{k + 1}": ("reactions", k) for k in range(mechanism.n) for axis in "xy"}
        taken |= {f"rm{k + 1}": ("slide_moments", k) for k in mechanism.slides}
        taken |= {name: ("loop_forces", i) for i, name in enumerate(loop_columns(mechanism))}
        taken |= {name: ("shaking", i) for i, name in enumerate(SHAKES)}
        taken |= {name: ("motors", i) for i, name in enumerate(motor_columns(mechanism))}
        for name, (values, at) in taken.items():
            found[name] = partial(self._taken, values, at, "imag" if name[:2] == "ry" else "real")
        for c in transmission_loops(mechanism):
            found[f"transmission{c + 1}"] = partial(self._transmission, c)
        return found

    def serves(self, name: str) -> bool:
        """Whether there is a column of this name."""
        try:
            self.column(name)
        except InputError:
            return False
        return True

    def _point(self, name: str) -> Value | None:
        stem, _, part = name.rpartition("_")
        slope = _SLOPE.fullmatch(part)
        if part not in PARTS and not slope:
            return None
        point: NamedPoint | None = self._points.get(stem)
        if point is None:
            try:
                (point,) = named_points(self.named, [stem])
            except (InputError, ValueError):
                return None
        if slope:  # how fast the point moves with an actuated joint
            units, moved = self._units.get(int(slope[2]) - 1), self.moved(point.point, 1)
            along = moved.real if slope[1] == "x" else moved.imag
            return None if units is None else substituted([along], units)[0]
        moved = self.moved(
            point.point, (len(part) - 1) if part in "xy" else "va".index(part[0]) + 1
        )
        return moved.real if part[-1] == "x" else moved.imag  # type: ignore[no-any-return]

    @cached_property
    def _units(self) -> dict[int, dict[str, Value]]:
        """The rates of all joints, by their names, where one of the actuated joints moves at 1.

        The others' v, of least length, follow from Psi v = -Psi_k.
        """
        rates, driven = self.state.inputs[self.mechanism.n :], self.mechanism.actuated
        passive = [k for k in range(self.mechanism.n) if k not in driven]
        count = len(passive)
        matrix: list[dict[int, Value]] = [{i: 1.0} for i in range(count)]
        matrix += [{} for _ in self.Psi]
        for r, row in enumerate(self.Psi, start=count):
            for i, k in enumerate(passive):
                if isinstance(row[k], Expression) or row[k]:
                    matrix[i][r] = matrix[r][i] = row[k]
        factors, found = Factors(matrix, count), {}
        for k in driven:
            each = factors.solve([0.0] * count + [-row[k] for row in self.Psi])
            values = {k: 1.0, **dict(zip(passive, each, strict=False))}
            found[k] = {rates[j]: values.get(j, 0.0) for j in range(self.mechanism.n)}
        return found

    def _ratio(self, name: str) -> Value | None:
        """The rate of a link over that of another; of one freedom, at any rate."""
        try:
            ratio = ratio_named(self.mechanism, name)
        except InputError:
            return None
        slides, qd = self.mechanism.slides, self.state.relative["qd"]
        both = [qd[k] if k in slides else self._turn(k, 1) for k in (ratio.of, ratio.over)]
        if len(self._units) == 1:
            both = substituted(both, next(iter(self._units.values())))
        return expression.multiply(both[0], 1.0 / both[1])

    def _taken(self, values: str, at: int, part: str) -> Value:
        found: Value = getattr(getattr(self, values)[at], part)
        return found

    @cached_property
    def motors(self) -> list[Any]:
        """The columns of motors."""
        torques = dict(zip(self.mechanism.actuated, self.forces, strict=False))
        each = [torques.get(k, 0.0) for k in range(self.mechanism.n)]
        return motor_values(self.named, each, self.state.relative["qd"])

    def _turn(self, k: int, order: int) -> Value:
        """The angle of a link, its rate (1) or its acceleration (2)."""
        d = self.mechanism.frames[k] if k in self.mechanism.slides else k
        turned = 0.0 if d is None else self.state.absolute(("q", "qd", "qdd")[order])[d]
        if order or (phase := Tree(self.named.description.links).phases[k]) == 1.0:
            return turned
        return turned + expression.arctangent(phase.imag, phase.real)

    def _transmission(self, closure: int) -> Value:
        """The angle between the directions to the outer pairs, at the middle one."""
        loop = transmission_loops(self.named)[closure]
        turn = turn_between(self.named, self.moving[0], *loop)
        return expression.arctangent(abs(turn.imag), turn.real)

    # -- conditions --------------------------------------------------------------------------------

    def condition(self, text: str, numbers: Mapping[str, float]) -> tuple[Value, bool]:
        """Of LEFT <= RIGHT (or >=, ==) what must not be above zero; and whether it must be zero.

        Names are those of the scene's `numbers`, of which the varied ones change, and of columns.
        Raises InputError for what is no such condition.
        """
        where = "--subject-to"
        signs = _RELATION.findall(text)
        if len(signs) != 1:
            limit = "must be one comparison: EXPR <= EXPR, EXPR >= EXPR or EXPR == EXPR"
            raise InputError(where, value=shown(text), limit=limit)
        places: dict[str, Value] = {}
        written = text
        changes = dict(zip(self.names, self.p, strict=True))
        for name in sorted(numbers, key=len, reverse=True):
            if name in written:
                key = f"number_{len(places)}_"
                written = written.replace(name, key)
                places[key] = changes[name] + numbers[name] if name in changes else numbers[name]
        known = "numbers such as " + (self.names or ("gravity",))[0] + ", columns such as tau1"

        def rename(name: str) -> str | None:
            if name not in places and self.serves(name):
                places[name] = self.column(name)
            return name if name in places else None

        sides: list[Any] = []
        try:
            for side in _RELATION.split(written):
                codes = Written(side, rename, known).codes
                check_smooth(codes)
                sides.append(evaluated(codes[0], places))
            left, right = sides
        except (ValueError, TypeError, NameError, ArithmeticError, AttributeError) as error:
            told = str(error).replace(NO_BENDS, "which bends or jumps")
            raise InputError(where, value=shown(text), limit=f"has no meaning: {told}") from None
        return right - left if signs[0].startswith(">") else left - right, signs[0] == "=="
