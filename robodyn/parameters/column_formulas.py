"""Columns of `points`, `torque` and `reactions` as formulas of a state and of a scene's numbers.

Inputs are q, qd, qdd, the forces f = (tau of actuated joints, lambda), the time, and the changes
p of named numbers; what a motion that obeys equation (1) makes of them is `lane_states.py`'s.
Points are linear in X, so with X' and X'' they move; reactions and what the ground feels are
equations (2) and (3) of `reaction_forces.py`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

from robodyn.dynamics.named_numbers import with_variables
from robodyn.engines import expression
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import Recorded, balance, joint_jacobian
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.row_values import RowValues
from robodyn.engines.tangents import SLOPES
from robodyn.errors import InputError
from robodyn.kinematics.point_motion import NamedPoint, named_points
from robodyn.mechanics import parts
from robodyn.mechanics.loop_columns import loop_columns
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.scene.expressions import NO_BENDS, Written, check_smooth
from robodyn.scene.scene import Moment
from robodyn.scene.yaml_values import nearest
from robodyn.tables.csv_fields import shown

PARTS = ("x", "y", "vx", "vy", "ax", "ay")
SHAKES = ("shake_fx", "shake_fy", "shake_m")
_JOINT = re.compile(r"(q|qd|qdd|tau|power|rx|ry)([1-9][0-9]*)", re.ASCII)
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
        self._points = {x.name: x for x in named_points(self.named, of)} if of else {}
        if self._points:
            named_points(mechanism, of, "--of")  # says what is wrong with them
        series = self.state.series([0.0] * n, accelerated=True)
        found = series.residuals(0)
        self.gap, self.gap_rate = (
            [self._of(series.real[slot], m) for slot in series.program.named["gap"]] for m in (0, 1)
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

    @staticmethod
    def _of(coefficients: Any, m: int) -> Value:
        found: Value = coefficients[m]
        return found

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """The names of all inputs, in their order: those of the state, t, forces, changes."""
        forces = (f"f{k}" for k in range(len(self.forces)))
        return (*self.state.inputs, "t", *forces, *(f"p{k}" for k in range(len(self.p))))

    # -- columns -----------------------------------------------------------------------------------

    def column(self, name: str, where: str = "column") -> Value:
        """The formula of a column; InputError, naming `where`, for one that is none."""
        found = self._joint(name) if (match := _JOINT.fullmatch(name)) else None
        if found is None and not match:
            if name in SHAKES:
                found = self._shaking[SHAKES.index(name)]
            elif name in loop_columns(self.mechanism):
                found = self._loop_forces[name]
            else:
                found = self._point(name)
        if found is None:
            limit = f"is no column that can be fitted{nearest(name, self.known)}"
            raise InputError(where, value=shown(name), limit=limit)
        return found

    @cached_property
    def known(self) -> list[str]:
        """The names of columns, but for those of points without a name."""
        joints = range(1, self.mechanism.n + 1)
        kinds = ("q", "qd", "qdd", "rx", "ry")
        names = [f"{kind}{k}" for kind in kinds for k in joints]
        names += [f"{kind}{k + 1}" for kind in ("tau", "power") for k in self.mechanism.actuated]
        points = [*self._points, *(x.name for x in named_points(self.mechanism))]
        names += [f"{point}_{part}" for point in points for part in PARTS]
        return [*names, *loop_columns(self.mechanism), *SHAKES]

    def serves(self, name: str) -> bool:
        """Whether there is a column of this name."""
        try:
            self.column(name)
        except InputError:
            return False
        return True

    def _joint(self, name: str) -> Value | None:
        match = _JOINT.fullmatch(name)
        assert match is not None
        kind, k = match[1], int(match[2]) - 1
        if k >= self.mechanism.n:
            return None
        if kind in self.state.relative:
            return self.state.relative[kind][k]
        if kind in ("rx", "ry"):
            force = self._reactions[k]
            return force.real if kind == "rx" else force.imag  # type: ignore[no-any-return]
        if k not in self.mechanism.actuated:
            return None
        tau = self.forces[self.mechanism.actuated.index(k)]
        return tau if kind == "tau" else tau * self.state.relative["qd"][k]

    def _point(self, name: str) -> Value | None:
        stem, _, part = name.rpartition("_")
        if part not in PARTS:
            return None
        point: NamedPoint | None = self._points.get(stem)
        if point is None:
            try:
                (point,) = named_points(self.named, [stem])
            except (InputError, ValueError):
                return None
        moved = self.moved(
            point.point, (len(part) - 1) if part in "xy" else "va".index(part[0]) + 1
        )
        return moved.real if part[-1] == "x" else moved.imag  # type: ignore[no-any-return]

    def moved(self, point: PlanarPoint, order: int) -> Any:
        """A point, its velocity (1) or its acceleration (2)."""
        total: Any = Planar(0.0, 0.0) + point.constant if order == 0 else Planar(0.0, 0.0)
        for k, c in point.terms:
            total = total + self._X[order][k] * c
        return total

    @cached_property
    def _X(self) -> list[list[Planar]]:
        """X, X' and X''."""
        mechanism, i = self.mechanism, Planar(0.0, 1.0)
        x, w, a = (self.state.absolute(name) for name in ("q", "qd", "qdd"))
        one = Planar(1.0, 0.0), Planar(0.0, 0.0), Planar(0.0, 0.0)
        found: list[list[Planar]] = [[], [], []]
        for k in range(mechanism.n):
            d = mechanism.frames[k]
            E = one
            if d is not None:
                turn = Planar(expression.cos(x[d]), expression.sin(x[d]))
                E = turn, turn * i * Planar(w[d], 0.0), turn * Planar(-(w[d] * w[d]), a[d])
            if k in mechanism.slides:
                s, v, b = (Planar(y[k], 0.0) for y in (x, w, a))
                two = Planar(2.0, 0.0)
                E = E[0] * s, E[0] * v + E[1] * s, E[0] * b + E[1] * v * two + E[2] * s
            for order, value in zip(found, E, strict=True):
                order.append(value)
        return found

    # -- forces ------------------------------------------------------------------------------------

    @cached_property
    def _bodies(self) -> list[tuple[int, PlanarPoint, Any]]:
        """Of each body its link, its point, and the load m (gamma - a) on it."""
        named = self.named
        links = named.description.links
        own = [(k, link.m, named.centres[k]) for k, link in enumerate(links)]
        own += [(k, link.payload, named.tips[k]) for k, link in enumerate(links)]
        gravity = Planar(named.gamma.real, named.gamma.imag)
        return [
            (k, point, (gravity - self.moved(point, 2)) * Planar(mass, 0.0))
            for k, mass, point in own
            if not (isinstance(mass, float) and mass == 0.0)
        ]

    @cached_property
    def _pins(self) -> list[Any]:
        """The force on the side of each closure that is named first."""
        mechanism, a = self.mechanism, len(self.mechanism.actuated)
        found: list[Any] = [Planar(0.0, 0.0) for _ in mechanism.description.closures]
        for r, row in enumerate(self.named.rows):
            if row.closure is None or row.arm:
                continue
            force = Planar(self.forces[a + r], 0.0) * row.direction
            if row.line is not None:
                force = force * self._X[0][row.line]
            found[row.closure] = found[row.closure] + force
        return found

    @cached_property
    def _loop_forces(self) -> dict[str, Value]:
        a, rows = len(self.mechanism.actuated), self.mechanism.rows
        found = [x for pin in self._pins for x in (pin.real, pin.imag)]
        kept = [r for r, row in enumerate(rows) if row.closure is not None and row.arm]
        tied = [r for r, row in enumerate(rows) if row.closure is None]
        found += [self.forces[a + r] * rows[r].arm for r in (*kept, *tied)]
        return dict(zip(loop_columns(self.mechanism), found, strict=True))

    def _acting(self, part: Callable[[Mechanism], Mechanism], name: str) -> list[Any]:
        """Forces of the scene, from the rows of its program."""
        found = RowValues(part(self.named), self.graph).nodes(name)
        return [Planar(x, y) for x, y in zip(found[::2], found[1::2], strict=True)]

    @cached_property
    def _reactions(self) -> list[Any]:
        """Equation (2)."""
        mechanism, closures = self.mechanism, self.mechanism.description.closures
        on_links: list[Any] = [Planar(0.0, 0.0) for _ in range(mechanism.n)]
        for k, _, load in self._bodies:
            on_links[k] = on_links[k] + load
        if mechanism.springs or mechanism.forces:
            forces = self._acting(parts.acting, "on links")
            on_links = [x + y for x, y in zip(on_links, forces, strict=True)]
        for closure, pin in zip(closures, self._pins, strict=True):
            for side, force in ((closure.first, pin), (closure.second, -pin)):
                if side.link is not None:
                    on_links[side.link] = on_links[side.link] + force
        for k in reversed(mechanism.order):
            above = mechanism.parent[k]
            if above is not None:
                on_links[above] = on_links[above] + on_links[k]
        return [-x for x in on_links]

    @cached_property
    def _shaking(self) -> tuple[Value, Value, Value]:
        """Equation (3)."""
        mechanism, named = self.mechanism, self.named
        acting = [(self.moved(point, 0), load) for _, point, load in self._bodies]
        loads = named.description.loads
        moment: Any = sum((x.torque for x in loads if isinstance(x, Moment)), 0.0)
        turning = self.state.absolute("qdd")
        for k, link in enumerate(named.description.links):
            d = mechanism.frames[k]
            moment = moment - (0.0 if d is None else link.I * turning[d])
        for rotor in named.rotors:
            for k, c in named.spins(rotor).items():
                moment = moment - self.state.relative["qdd"][k] * (rotor.inertia * c)
        if mechanism.varying_moments:
            rows = RowValues(parts.loaded(named), self.graph)
            moment = moment + sum(rows.nodes("moments"), 0.0)
        if mechanism.forces:
            forces = self._acting(parts.loaded, "forces")
            places = [self.moved(x.point, 0) for x in named.forces]
            acting += zip(places, forces, strict=True)
        force: Any = Planar(0.0, 0.0)
        for place, load in acting:
            force = force + load
            moment = moment + (place.conjugate() * load).imag
        return force.real, force.imag, moment

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

        scope: dict[str, object] = {f"_{f}": partial(expression.call, f) for f in SLOPES}
        scope |= {"_pow": expression.power, "_atan2": expression.arctangent, "__builtins__": {}}
        sides: list[Any] = []
        try:
            for side in _RELATION.split(written):
                codes = Written(side, rename, known).codes
                check_smooth(codes)
                sides.append(eval(codes[0], {**scope, **places}))
            left, right = sides
        except (ValueError, TypeError, NameError, ArithmeticError, AttributeError) as error:
            told = str(error).replace(NO_BENDS, "which bends or jumps")
            raise InputError(where, value=shown(text), limit=f"has no meaning: {told}") from None
        return right - left if signs[0].startswith(">") else left - right, signs[0] == "=="
