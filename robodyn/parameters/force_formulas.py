"""Forces of a motion as formulas of its state and of a scene's numbers.

Inputs are q, qd, qdd, the forces f = (tau of actuated joints, lambda), the time, and the changes
p of named numbers; what a motion that obeys equation (1) makes of them is `lane_states.py`'s.
Points are linear in X, so with X' and X'' they move; reactions and what the ground feels are
equations (2) and (3) of `reaction_forces.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from robodyn.dynamics.named_numbers import with_variables
from robodyn.engines import expression
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import Recorded, balance, joint_jacobian
from robodyn.engines.planar_numbers import Planar
from robodyn.engines.row_values import RowValues
from robodyn.mechanics import parts
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.scene.scene import Moment, Point


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
    def loop_forces(self) -> list[Value]:
        a, rows = len(self.mechanism.actuated), self.mechanism.rows
        found = [x for pin in self._pins for x in (pin.real, pin.imag)]
        kept = [r for r, row in enumerate(rows) if row.closure is not None and row.arm]
        tied = [r for r, row in enumerate(rows) if row.closure is None]
        found += [self.forces[a + r] * rows[r].arm for r in (*kept, *tied)]
        return found

    def _acting(self, part: Callable[[Mechanism], Mechanism], name: str) -> list[Any]:
        """Forces of the scene, from the rows of its program."""
        found = RowValues(part(self.named), self.graph).nodes(name)
        return [Planar(x, y) for x, y in zip(found[::2], found[1::2], strict=True)]

    @cached_property
    def _acting_on(self) -> list[tuple[int, Any, Any]]:
        """What acts on links but at their own joints: the link, the place, the force."""
        mechanism, named = self.mechanism, self.named
        found = [(k, self.moved(point, 0), load) for k, point, load in self._bodies]
        if mechanism.springs or mechanism.forces:
            forces = iter(self._acting(parts.acting, "forces"))
            for spring, force in zip(named.springs, forces, strict=False):
                ends = zip((spring.first, spring.second), spring.ends, (force, -force), strict=True)
                found += [(k, self.moved(at, 0), f) for k, at, f in ends if k is not None]
            for load, force in zip(named.forces, forces, strict=True):
                found.append((load.link, self.moved(load.point, 0), force))
        tree = Tree(named.description.links)
        for closure, pin in zip(named.description.closures, self._pins, strict=True):
            at = self.moved(tree.point(closure.first), 0)
            for side, force in ((closure.first, pin), (closure.second, -pin)):
                if side.link is not None:
                    found.append((side.link, at, force))
        return found

    @cached_property
    def reactions(self) -> list[Any]:
        """Equation (2)."""
        on_links: list[Any] = [Planar(0.0, 0.0) for _ in range(self.mechanism.n)]
        for k, _, force in self._acting_on:
            on_links[k] = on_links[k] + force
        return [-x for x in self._carried(on_links)]

    def _carried(self, on_links: list[Any]) -> list[Any]:
        """The sums over all that each link carries."""
        for k in reversed(self.mechanism.order):
            above = self.mechanism.parent[k]
            if above is not None:
                on_links[above] = on_links[above] + on_links[k]
        return on_links

    @cached_property
    def slide_moments(self) -> dict[int, Value]:
        """What keeps the links that slide from turning, about their origins (`slide_moments`)."""
        mechanism, named, a = self.mechanism, self.named, len(self.mechanism.actuated)
        moments: list[Any] = self._turning()
        for rotor, back in self._spun():
            above = mechanism.parent[rotor]
            if above is not None:
                moments[above] = moments[above] + back
        for entry in named.description.loads:
            if isinstance(entry, Moment):
                moments[entry.link] = moments[entry.link] + entry.torque
        if mechanism.varying_moments:
            values = RowValues(parts.loaded(named), self.graph).nodes("moments")
            for varying, value in zip(named.varying_moments, values, strict=True):
                moments[varying.link] = moments[varying.link] + value
        for r, row in enumerate(mechanism.rows):
            if row.closure is None or not row.arm:
                continue
            closure = mechanism.description.closures[row.closure]
            for side, sign in ((closure.first, row.arm), (closure.second, -row.arm)):
                if side.link is not None:
                    moments[side.link] = moments[side.link] + self.forces[a + r] * sign
        acting, tree = self._acting_on, Tree(named.description.links)
        for k, place, force in acting:
            moments[k] = moments[k] + (place.conjugate() * force).imag
        total, forces = self._carried(moments), self.reactions
        origins = {k: self.moved(tree.point(Point(k, 0j)), 0) for k in mechanism.slides}
        return {k: -total[k] - (at.conjugate() * forces[k]).imag for k, at in origins.items()}

    def _turning(self) -> list[Any]:
        """- I alphadd of each link."""
        turning, links = self.state.absolute("qdd"), self.named.description.links
        frames = zip(self.mechanism.frames, links, strict=True)
        return [0.0 if d is None else -(link.I * turning[d]) for d, link in frames]

    def _spun(self) -> list[tuple[int, Any]]:
        """The joint of each rotor, and the moment of its spin on what carries it."""
        qdd = self.state.relative["qdd"]
        return [
            (x.joint, -x.inertia * sum((qdd[k] * c for k, c in self.named.spins(x).items()), 0.0))
            for x in self.named.rotors
        ]

    @cached_property
    def shaking(self) -> tuple[Value, Value, Value]:
        """Equation (3)."""
        mechanism, named = self.mechanism, self.named
        acting = [(self.moved(point, 0), load) for _, point, load in self._bodies]
        loads = named.description.loads
        moment: Any = sum((x.torque for x in loads if isinstance(x, Moment)), 0.0)
        for x in (*self._turning(), *(back for _, back in self._spun())):
            moment = moment + x
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
