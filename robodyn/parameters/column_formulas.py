"""Columns of states as formulas of a state and of a scene's numbers.

Inputs are q, qd, qdd, the forces f = (tau of actuated joints, lambda), the time, and the changes
p of named numbers.
Points are linear in X, so with X' and X'' they move; reactions and what the ground feels are
as `reaction_forces.py` has them.

`LaneStates` has the columns of many mechanisms at once, and their derivatives by the numbers that
differ.  Lanes are starts x rows.  Loops are closed by dyads, or by Newton's method from where the
scene's own are; rates, accelerations and forces follow from linear equations, and so do the
derivatives of all of them: with F(z, p) = 0 for what follows, dz/dp = -F_z^-1 F_p, exact.

Where a dyad does not reach, its links point at one another (the discriminant is clipped).  Then
|gap|^2 is least: F is its slope Psi^T gap, and what is missing, |gap|, has the derivative
gap . d gap/dp / |gap|.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, combinations, pairwise
from typing import Any

import numpy as np

from robodyn.dynamics.cam_contacts import cams_of
from robodyn.dynamics.closed_form import points_of
from robodyn.dynamics.columns import FAMILIES, LOOPS, MOTORS, column_names, known_loop_forces
from robodyn.dynamics.dense_dynamics import RANK_CUT
from robodyn.dynamics.named_numbers import with_variables
from robodyn.dynamics.named_points import NamedPoint, named_points
from robodyn.dynamics.reaction_forces import Felt
from robodyn.dynamics.reaction_formulas import felt_formulas, placed_formulas, planar_values
from robodyn.dynamics.transmission import ratio_named, transmission_loops, turn_between
from robodyn.engines import expression
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.expression import Expression, Graph, Value, slopes_by, substituted, tangents
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import Recorded, balance, energies, evaluated, joint_jacobian
from robodyn.errors import InputError
from robodyn.loops.assembly import assemble
from robodyn.loops.assembly_plan import Plan, Step, assembly_plan
from robodyn.loops.branches import scene_branches
from robodyn.loops.closing import CLOSED as ROUNDING
from robodyn.loops.closing import PASSES, loop_size
from robodyn.loops.dyads import by_dyads, known_joints
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.motors import drives, motor_values, powered_joints
from robodyn.mechanics.placed import Placed
from robodyn.mechanics.planar_model import ClosureRow
from robodyn.scene.expressions import NO_BENDS, check_smooth
from robodyn.scene.quantities import Variables, expressions
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown

PARTS = [
    word.removeprefix("{P}_")
    for family in ("points", "manipulability", "kappa")
    for word, _ in FAMILIES[family].each
]
_SLOPE = re.compile("J([xy])([1-9][0-9]*)", re.ASCII)
_RELATION = re.compile(r"<=|>=|==|<|>")


def _zero(value: Any) -> bool:
    """Whether a formula is zero in all states."""
    return not isinstance(value, Expression) and not value


class ColumnFormulas:
    """The formulas of a mechanism whose numbers `names` change by p0, p1, ..."""

    def __init__(self, mechanism: Mechanism, names: Sequence[str], of: Sequence[str] = ()) -> None:
        mechanism.check_rubbing("fits")
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
        """The placement of the mechanism, and its rates and accelerations."""
        mechanism, at = self.mechanism, placed_formulas(self.state)
        w, a = (planar_values(self.state.absolute(name)) for name in ("qd", "qdd"))
        return at, at.rates(mechanism, w), at.accelerations(mechanism, w, a)

    # -- forces ------------------------------------------------------------------------------------

    @cached_property
    def _felt(self) -> Felt:
        at, _, bent = self.moving
        both = self.state.absolute("qdd"), self.state.relative["qdd"]
        lam = self.forces[len(self.mechanism.actuated) :]
        return felt_formulas(self.state, at, bent, both, lam, self.Psi)

    @cached_property
    def loop_forces(self) -> list[Value]:
        """Pin forces, moments of fixed angles, and torques of couplings."""
        return [*(x for pin in self._felt.pins for x in (pin.real, pin.imag)), *self._felt.kept]

    @cached_property
    def reactions(self) -> list[Any]:
        """The force on each link at its own joint."""
        return list(self._felt.reactions())

    @cached_property
    def slide_moments(self) -> dict[int, Value]:
        """Moments about their origins that keep sliding links from turning."""
        found: list[Any] = self._felt.slide_moments()
        return dict(zip(self.mechanism.slides, found, strict=True))

    @cached_property
    def shaking(self) -> Sequence[Any]:
        """Fx, Fy and M on the ground."""
        return self._felt.shaking()

    # -- columns -----------------------------------------------------------------------------------

    def column(self, name: str) -> Value:
        """The formula of a column; InputError for one that is none."""
        found = self._named[name]() if name in self._named else self._point(name)
        if found is None and "/" in name:
            found = self._ratio(name)
        if found is None:
            limit = f"is no column that can be fitted{nearest(name, self.known)}"
            raise InputError("column", value=shown(name), limit=limit)
        return found

    @cached_property
    def known(self) -> list[str]:
        """The names of columns, but for those of points without a name."""
        points = [*self._points, *(x.name for x in named_points(self.mechanism))]
        points += self.mechanism.link_names
        return [*self._named, *(f"{point}_{part}" for point in points for part in PARTS)]

    @cached_property
    def _named(self) -> dict[str, Callable[[], Any]]:
        """Functions that make the columns that belong to no point."""
        mechanism, state, n = self.mechanism, self.state.relative, self.mechanism.n
        torques = dict(zip(mechanism.actuated, self.forces, strict=False))
        taken = partial(partial, self._taken)
        each: dict[str, list[Callable[[], Any]]] = {
            kind: [partial(values.__getitem__, k) for k in range(n)]
            for kind, values in state.items()
        }
        each |= {
            "tau": [partial(torques.__getitem__, k) for k in torques],
            "power": [
                partial(expression.multiply, tau, state["qd"][k]) for k, tau in torques.items()
            ],
            "links": [partial(self._turn, k, order) for k in range(n) for order in range(3)],
            "reactions": [
                taken("reactions", k, part) for k in range(n) for part in ("real", "imag")
            ],
            "slide_moments": [taken("slide_moments", k, "real") for k in mechanism.slides],
            "shaking": [taken("shaking", i, "real") for i in range(3)],
            "transmission": [partial(self._transmission, c) for c in transmission_loops(mechanism)],
            "contacts": [partial(self._pressed, k) for k in range(len(cams_of(mechanism)))],
            "centres": [partial(self._centre, k, part) for k in range(n) for part in (0, 1)],
            "places": [*self._places()],
            "KE": [lambda: self._energies[0]],
            "PE": [lambda: self._energies[1]],
            "energy": [lambda: self._energies[0] + self._energies[1]],
        }
        found = {
            name: make
            for family, makers in each.items()
            for name, make in zip(column_names(mechanism, [family]), makers, strict=True)
        }
        motors = column_names(mechanism, MOTORS)
        found |= {name: taken("motors", i, "real") for i, name in enumerate(motors)}
        names = column_names(mechanism, LOOPS)
        places = known_loop_forces(mechanism)
        return found | {
            name: taken("loop_forces", i, "real") for i, name in zip(places, names, strict=True)
        }

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
        if part == "manipulability":
            moved = self.moved(point.point, 1)
            ways = [substituted([moved.real, moved.imag], x) for x in self._units.values()]
            minors = ((a[0] * b[1] - a[1] * b[0]) ** 2 for a, b in combinations(ways, 2))
            squares = sum(minors, 0.0)
            return None if _zero(squares) else expression.call("sqrt", squares)
        if part == "kappa":
            v, a = (self.moved(point.point, order) for order in (1, 2))
            vx, vy, ax, ay = substituted([v.real, v.imag, a.real, a.imag], self._along)
            speed = expression.power(vx**2 + vy**2, 1.5)
            return None if _zero(speed) else expression.divide(vx * ay - vy * ax, speed)
        moved = self.moved(point.point, 0 if part in "xy" else "va".index(part[0]) + 1)
        return moved.real if part[-1] == "x" else moved.imag  # type: ignore[no-any-return]

    @cached_property
    def _units(self) -> dict[int, dict[str, Value]]:
        """The rates of all joints, by their names, where one of the actuated joints moves at 1.

        The others' v, of least length, follow from Psi v = -Psi_k.
        """
        driven = self.mechanism.actuated
        return {k: self._following({k: 1.0}, [-row[k] for row in self.Psi]) for k in driven}

    def _following(self, given: Mapping[int, float], right: Sequence[Value]) -> dict[str, Value]:
        """The rates v of all joints, by their names: actuated ones are given, else zero.

        The passive ones', of least length, follow from Psi v = right.
        """
        rates = self.state.inputs[self.mechanism.n :]
        factors, passive = self._factors
        values: dict[int, Value] = dict.fromkeys(range(self.mechanism.n), 0.0)
        values |= given
        values |= dict(zip(passive, factors.solve([0.0] * len(passive) + [*right]), strict=False))
        return {rates[j]: values[j] for j in values}

    @cached_property
    def _factors(self) -> tuple[Factors, list[int]]:
        """The factors for `_following`, and the passive joints."""
        driven = self.mechanism.actuated
        passive = [k for k in range(self.mechanism.n) if k not in driven]
        count = len(passive)
        matrix: list[dict[int, Value]] = [{i: 1.0} for i in range(count)]
        matrix += [{} for _ in self.Psi]
        for r, row in enumerate(self.Psi, start=count):
            for i, k in enumerate(passive):
                if isinstance(row[k], Expression) or row[k]:
                    matrix[i][r] = matrix[r][i] = row[k]
        return Factors(matrix, count), passive

    def _ratio(self, name: str) -> Value | None:
        """The rate of a link over that of another; of one freedom, at any rate."""
        try:
            ratio = ratio_named(self.mechanism, name)
        except InputError:
            return None
        slides, qd = self.mechanism.slides, self.state.relative["qd"]
        both = [qd[k] if k in slides else self._turn(k, 1) for k in (ratio.of, ratio.over)]
        both = substituted(both, self._along)
        return expression.multiply(both[0], 1.0 / both[1])

    @cached_property
    def _along(self) -> dict[str, Value]:
        """Rates and accelerations of the path, by name: of one freedom those at its rate 1."""
        if len(self._units) != 1 or self.mechanism.driven:
            return {}
        ((joint, rates),) = self._units.items()
        still = rates | {name.replace("qd", "qdd"): 0.0 for name in rates}
        bend = substituted(self.gap_bend, still)
        found = self._following({joint: 0.0}, [-x for x in bend])
        return rates | {name.replace("qd", "qdd"): x for name, x in found.items()}

    def _centre(self, k: int, part: int) -> Value | None:
        """The instant centre of a link: c = p + i v/w, of its tip p."""
        tip, w = self.named.tips[k], self._turn(k, 1)
        p, v = self.moved(tip, 0), self.moved(tip, 1)
        w, vx, vy = substituted([w, v.real, v.imag], self._along)
        if _zero(w):
            return None
        place: Value = p.imag if part else p.real
        return place + expression.divide(vx if part else -vy, w)

    def _places(self) -> Iterator[Callable[[], Value]]:
        """What makes the columns of the joint, tip and centre of each link."""

        def made(point: PlanarPoint, order: int, part: str) -> Value:
            found: Value = getattr(self.moved(point, order), part)
            return found

        named = self.named
        for k, points in enumerate(zip(named.pivots, named.tips, named.centres, strict=True)):
            there = points[: 2 if k in self.mechanism.massless else 3]
            for point in there:
                yield from (
                    partial(made, point, order, x) for order in (0, 1) for x in ("real", "imag")
                )

    @cached_property
    def _energies(self) -> tuple[Value, Value]:
        relative = self.state.relative
        KE, PE = energies(self.named, lambda x: x, relative["q"], relative["qd"])
        return KE, PE + self.named.energy_offset

    def _pressed(self, k: int) -> Value:
        found: Value = self._felt.contacts[k].pressed
        return found

    def _taken(self, values: str, at: int, part: str) -> Value:
        found: Value = getattr(getattr(self, values)[at], part)
        return found

    @cached_property
    def motors(self) -> list[Any]:
        """The columns of motors."""
        torques: dict[int, Value] = dict(zip(self.mechanism.actuated, self.forces, strict=False))
        first = len(self.loop_forces) - len(self.mechanism.description.couplings)
        torques |= {k: self.loop_forces[first + c] for k, c in drives(self.mechanism).items()}
        each = [torques.get(k, 0.0) for k in range(self.mechanism.n)]
        joints = powered_joints(self.mechanism)
        return [*chain(*motor_values(self.named, joints, each, self.state.relative["qd"]))]

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
        """Return what must not be positive in LEFT <= RIGHT, and if it must be zero.

        Also for >= and ==. Names are those of the scene's `numbers`, of which the varied ones
        change, and of columns.  Raises InputError for another text.
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

        def named(name: str) -> str | None:
            if name not in places and self.serves(name):
                places[name] = self.column(name)
            return name if name in places else None

        sides: list[Any] = []
        try:
            for side in _RELATION.split(written):
                nodes = [x.node for x in expressions(side, Variables(named, known))]
                check_smooth(nodes)
                sides.append(evaluated(nodes[0], places))
            left, right = sides
        except (ValueError, TypeError, KeyError, ArithmeticError, AttributeError) as error:
            told = str(error).replace(NO_BENDS, "which bends or jumps")
            raise InputError(where, value=shown(text), limit=f"has no meaning: {told}") from None
        return right - left if signs[0].startswith(">") else left - right, signs[0] == "=="


Shaped = tuple[tuple[int, ...], Sequence[Value]]  # a shape, and what is in it
Outputs = Sequence[Shaped]
Group = tuple[tuple[int, ...], tuple[int, ...]]  # rows of closures, and the joints they serve

LANES = 60_000  # states at once
MISSED = 1e-9  # of the loop's size: a gap that Newton's method leaves and that is no rounding


@dataclass(frozen=True)
class Rows:
    """Known data of each row: q, qd, qdd (T, a) of the actuated joints, and time (T,)."""

    q: Array
    qd: Array
    qdd: Array
    t: Array


class LaneStates:
    """Columns at rows, by numbers of a scene."""

    def __init__(self, formulas: ColumnFormulas, columns: Sequence[Value], rows: Rows) -> None:
        self.formulas, self.columns, self.rows = formulas, list(columns), rows
        self.mechanism = mechanism = formulas.mechanism
        n, state = mechanism.n, formulas.state.inputs
        self.n, self.k = n, len(formulas.p)
        slopes = tangents(self.columns, formulas.inputs)
        needed = {name for slope in slopes for name in slope}
        self.moves = bool(needed & {*state[n:], *(f"f{i}" for i in range(len(formulas.forces)))})
        follows = mechanism.rows or mechanism.passive
        self.plan: Plan | None = assembly_plan(mechanism) if follows else None
        self._conditions = list(self._closings())
        self._codes: dict[str, Callable[[Array], list[Array]]] = {}

    # -- formulas ----------------------------------------------------------------------------------

    def _closings(self) -> list[Group]:
        """The rows of closures that serve to find joints, each group with these joints."""
        if self.plan is None:
            return []
        rows, couplings = self.mechanism.rows, self.mechanism.description.couplings
        first = len(rows) - len(couplings)
        found: list[Group] = [((first + c,), (joint,)) for joint, c in self.plan.coupled]
        for step in self.plan.steps:
            own = tuple(r for r, row in enumerate(rows) if any(row is x for x in step.rows))
            found.append((own, step.unknown))
        if self.plan.rest:
            used = {r for own, _ in found for r in own}
            left = tuple(r for r in range(len(rows)) if r not in used)
            found.append((left, self.plan.later))
        return found

    def _code(self, name: str) -> Callable[[Array], list[Array]]:
        """A function of inputs (N, inputs) that returns what is called so."""
        if name not in self._codes:
            parts = self._parts(name)
            self._codes[name] = compiled(self.formulas.inputs, parts)
        return self._codes[name]

    def _parts(self, name: str) -> Outputs:
        """Return the values called `name`, and their derivatives by groups of inputs."""
        f, n, r = self.formulas, self.n, len(self.formulas.gap)
        q, qd, qdd = (f.state.inputs[i : i + n] for i in (0, n, 2 * n))
        p = [f"p{i}" for i in range(self.k)]
        forces = [f"f{i}" for i in range(len(f.forces))]
        if name == "rows":
            numbers = [x for row in f.named.rows for x in _numbers_of(row)]
            return [((len(numbers),), numbers)]
        Psi: Shaped = ((r, n), [x for row in f.Psi for x in row])
        # values that are given themselves, and values of which slopes are
        given: dict[str, list[Shaped]] = {
            "gap": [((r,), f.gap), Psi],
            "closing": [Psi],
            "drift": [((r,), f.gap_rate)],
            "bend": [((r,), f.gap_bend)],
            "load": [((n,), f.load)],
            "columns": [((len(self.columns),), self.columns)],
        }
        closed, least = self._least if name == "closing" else ([], [])
        sloped: dict[str, list[tuple[Sequence[Value], Sequence[Sequence[str]]]]] = {
            "closing": [(f.gap, [p]), (closed, [q, p]), (least, [q, p])],
            "rates": [(f.gap_rate, [q, p]), (f.gap_bend, [q, qd, p]), (f.balance, [q, qd, qdd, p])],
            "columns": [(self.columns, [q, qd, qdd, forces, p])],
        }
        slopes = [(nodes, by) for nodes, every in sloped.get(name, ()) for by in every]
        own = given.get(name, [])
        return own + [((len(x), len(by)), slopes_by(x, by)) for x, by in slopes]

    @cached_property
    def _least(self) -> tuple[list[Value], list[Value]]:
        """Return what is zero for closed loops, and Psi^T gap per group and dependent joint."""
        f = self.formulas
        closed: list[Value] = []
        least: list[Value] = []
        for rows, joints in self._conditions:
            slopes = [sum((f.Psi[r][u] * f.gap[r] for r in rows), 0.0) for u in joints]
            closed += [f.gap[r] for r in rows] if len(rows) == len(joints) else slopes
            least += slopes
        return closed, least

    # -- lanes -------------------------------------------------------------------------------------

    def __call__(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Return columns (S, T, c) for changes p (S, k), their derivatives, and gaps.

        Derivatives are (S, T, c, k).  Gaps are (S, T, g), m, zero if loops close, with derivatives
        (S, T, g, k).  Undefined values are nan.
        """
        T = len(self.rows.t)
        size = max(1, LANES // T)
        parts = [self._lanes(p[s : s + size]) for s in range(0, len(p), size)]
        columns, slopes, missing, by = (np.concatenate(x) for x in zip(*parts, strict=True))
        return columns, slopes, missing, by

    def _lanes(self, p: Array) -> tuple[Array, Array, Array, Array]:
        mechanism, n, k, T = self.mechanism, self.n, self.k, len(self.rows.t)
        S = len(p)
        given = np.broadcast_to(self.rows.q, (S, *self.rows.q.shape))
        q, missed = self._closed(p, given)
        inputs = np.zeros((S, T, len(self.formulas.inputs)))
        inputs[..., :n] = q
        inputs[..., 3 * n] = self.rows.t
        inputs[..., inputs.shape[-1] - k :] = p[:, None]
        x = inputs.reshape(S * T, -1)
        N, groups = S * T, len(self._conditions)
        missing, by_missing = np.zeros((N, groups)), np.zeros((N, groups, k))
        dq = np.zeros((N, n, k))
        passive = [u for _, joints in self._conditions for u in joints]
        Psi = np.zeros((N, 0, n))
        with np.errstate(all="ignore"):
            if mechanism.rows:
                Psi, gap_p, closed_q, closed_p, least_q, least_p = self._code("closing")(x)
                gap = self._code("gap")(x)[0]
                lost = missed.reshape(N, groups)
                ends = np.cumsum([0, *(len(joints) for _, joints in self._conditions)])
                for g, (a, b) in enumerate(pairwise(ends)):
                    here = lost[:, g] > 0.0
                    closed_q[here, a:b] = least_q[here, a:b]
                    closed_p[here, a:b] = least_p[here, a:b]
                if passive:
                    dq[:, passive] = -solved_lanes(closed_q[..., passive], closed_p)
                moved = gap_p + Psi @ dq
                for g, (rows, _) in enumerate(self._conditions):
                    own = list(rows)
                    length = np.where(lost[:, g] > 0.0, np.linalg.norm(gap[:, own], axis=-1), 0.0)
                    missing[:, g] = length
                    along = gap[:, own] / np.where(length > 0.0, length, np.inf)[:, None]
                    by_missing[:, g] = np.einsum("ni,nik->nk", along, moved[:, own])
            dx = [dq]
            if self.moves:
                dx += self._moving(x, Psi, dq)
            found, *slopes = self._code("columns")(x)
            total = slopes[-1]
            for slope, step in zip(slopes, dx, strict=False):
                total = total + slope @ step
            if self.moves:
                found[missing.any(axis=-1)] = np.nan
        c = len(self.columns)
        return (
            found.reshape(S, T, c),
            total.reshape(S, T, c, k),
            missing.reshape(S, T, groups),
            by_missing.reshape(S, T, groups, k),
        )

    def _moving(self, x: Array, Psi: Array, dq: Array) -> list[Array]:
        """Writes rates, accelerations and forces into inputs x (N, inputs): their derivatives."""
        n, driven = self.n, list(self.mechanism.actuated)
        N, r, a = len(x), Psi.shape[1], len(driven)
        S = N // len(self.rows.t)
        chosen = np.broadcast_to(np.eye(n)[driven], (N, a, n))
        A = np.concatenate([Psi, chosen], axis=1)
        right = np.zeros((N, r + a, 1))
        if self.mechanism.driven:
            right[:, :r, 0] = -self._code("drift")(x)[0]  # with qd zero
        right[:, r:, 0] = np.tile(self.rows.qd, (S, 1))
        x[:, n : 2 * n] = solved_lanes(A, right)[..., 0]
        right[:, :r, 0] = -self._code("bend")(x)[0]  # with qdd zero
        right[:, r:, 0] = np.tile(self.rows.qdd, (S, 1))
        x[:, 2 * n : 3 * n] = solved_lanes(A, right)[..., 0]
        (load,) = self._code("load")(x)
        torques = np.broadcast_to(np.eye(n)[:, driven], (N, n, a))
        shares = np.concatenate([torques, np.swapaxes(Psi, 1, 2)], axis=-1)
        x[:, 3 * n + 1 : 3 * n + 1 + a + r] = solved_lanes(shares, load[..., None])[..., 0]
        rates = self._code("rates")(x)
        rate_q, rate_p, bend_q, bend_qd, bend_p, load_q, load_qd, load_qdd, load_p = rates
        none = np.zeros((N, a, self.k))
        dqd = -solved_lanes(A, np.concatenate([rate_p + rate_q @ dq, none], axis=1))
        bent = bend_p + bend_q @ dq + bend_qd @ dqd
        dqdd = -solved_lanes(A, np.concatenate([bent, none], axis=1))
        df = solved_lanes(shares, load_p + load_q @ dq + load_qd @ dqd + load_qdd @ dqdd)
        return [dqd, dqdd, df]

    # -- loops -------------------------------------------------------------------------------------

    def _closed(self, p: Array, given: Array) -> tuple[Array, Array]:
        """q (S, T, n), and what each group of rows misses (S, T, groups), m."""
        mechanism, plan = self.mechanism, self.plan
        q = np.zeros((*given.shape[:2], self.n))
        q[..., list(mechanism.actuated)] = given
        if plan is None:
            return q, np.zeros((*given.shape[:2], 0))
        lanes = replace(plan, steps=tuple(self._lane_steps(plan, p)))
        with np.errstate(all="ignore"):
            q, _ = known_joints(mechanism, lanes, given, self.rows.t)
            self._couple(q, p)
            q, shorts, _ = by_dyads(mechanism, lanes, q, scene_branches(mechanism))
        missed = np.zeros((*q.shape[:2], len(self._conditions)))
        first = len(plan.coupled)
        for g, short in enumerate(shorts[: len(plan.steps)]):
            missed[..., first + g] = short
        if plan.rest:
            rest = list(plan.later)
            q[..., rest] = self._own[:, rest]
            missed[..., -1] = self._newton(q, p)
        return q, missed

    def _couple(self, q: Array, p: Array) -> None:
        """Take joints to where changed couplings have them, in place: q_j less what it is off."""
        rows, named = self.mechanism.rows, self.formulas.named.rows
        first = len(rows) - len(self.mechanism.description.couplings)
        if self.plan is None or named[first:] == rows[first:]:
            return
        x = np.zeros((*q.shape[:2], len(self.formulas.inputs)))
        x[..., 3 * self.n] = self.rows.t
        x[..., x.shape[-1] - self.k :] = p[:, None]
        for joint, c in self.plan.coupled:
            x[..., : self.n] = q
            gap, Psi = self._code("gap")(x.reshape(-1, x.shape[-1]))
            off = gap[:, first + c] / Psi[:, first + c, joint]
            q[..., joint] -= off.reshape(q.shape[:2])

    @cached_property
    def _own(self) -> Array:
        """q (T, n) of the scene as it is."""
        return assemble(self.mechanism, self.rows.q, t=self.rows.t)

    def _lane_steps(self, plan: Plan, p: Array) -> list[Step]:
        """The steps with rows whose numbers are (S, 1)."""
        inputs = np.zeros((len(p), len(self.formulas.inputs)))
        inputs[:, inputs.shape[1] - self.k :] = p
        (numbers,) = self._code("rows")(inputs)
        columns = iter(numbers.T[..., None])
        made: list[ClosureRow] = []
        named = self.formulas.named.rows
        for row, own in zip(named, self.mechanism.rows, strict=True):
            P = tuple((k, next(columns) + 1j * next(columns)) for k, _ in row.P)
            ground, offset = next(columns) + 1j * next(columns), next(columns)
            angles = tuple((k, next(columns)) for k, _ in row.angles)
            made.append(own._replace(P=P, ground=ground, offset=offset, angles=angles))
        first = len(plan.coupled)
        return [
            replace(step, rows=tuple(made[r] for r in self._conditions[first + i][0]))
            for i, step in enumerate(plan.steps)
        ]

    def _newton(self, q: Array, p: Array) -> Array:
        """Closes what is left, in place, by steps of least squares; what is missing (S, T)."""
        rows, joints = (list(x) for x in self._conditions[-1])
        x = np.zeros((*q.shape[:2], len(self.formulas.inputs)))
        x[..., 3 * self.n] = self.rows.t
        x[..., x.shape[-1] - self.k :] = p[:, None]
        size = loop_size(self.mechanism)
        for _ in range(3 * PASSES):
            x[..., : self.n] = q
            gap, Psi = self._code("gap")(x.reshape(-1, x.shape[-1]))
            gap, own = gap[:, rows, None], Psi[:, rows][..., joints]
            if np.abs(gap).max(initial=0.0) <= ROUNDING * size:
                break
            step = np.linalg.pinv(own, rcond=1e-6) @ gap
            longest = np.abs(step).max(axis=(1, 2), keepdims=True)
            step *= np.minimum(1.0, 0.5 / np.maximum(longest, 0.5))
            if longest.max() < 1e-15:
                break
            q[..., joints] -= step[..., 0].reshape(*q.shape[:2], -1)
        missing = np.linalg.norm(gap[..., 0], axis=-1)
        return np.where(missing > MISSED * size, missing, 0.0).reshape(q.shape[:2])


def _numbers_of(row: Any) -> Iterator[Value]:
    """The numbers of a row of closures, one after the other."""
    for c in (*(c for _, c in row.P), row.ground):
        yield from (c.real, c.imag)
    yield row.offset
    yield from (c for _, c in row.angles)


def solved_lanes(A: Array, b: Array) -> Array:
    """x (N, n, m) of least length with A x = b as near as it goes; nan where A is not finite."""
    if A.shape[1] == A.shape[2]:
        try:
            return np.asarray(np.linalg.solve(A, b))
        except np.linalg.LinAlgError:
            pass
    sound = np.isfinite(A).all(axis=(1, 2))
    found = np.full((len(A), A.shape[2], b.shape[2]), np.nan)
    found[sound] = np.linalg.pinv(A[sound], rcond=RANK_CUT) @ b[sound]
    return found


def compiled(inputs: tuple[str, ...], parts: Outputs) -> Callable[[Array], list[Array]]:
    """A function of inputs (N, inputs) that returns arrays (N, *shape) of values, part by part."""
    formula = ArrayFormula(inputs, [x for _, values in parts for x in values])

    def run(x: Array) -> list[Array]:
        found = [np.empty((len(x), len(values))) for _, values in parts]
        formula.fill([x], found)
        return [y.reshape(len(x), *shape) for y, (shape, _) in zip(found, parts, strict=True)]

    return run
