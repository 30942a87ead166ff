"""A mechanism whose numbers are named: variables m1, l2, ... of a graph, or exact fractions.

The formulas of robodyn, run on it, record the equations of motion in the scene's parameters.  Its
constants are those of `mechanism.py`; with fractions, what cancels on paper cancels in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

from robodyn.engines import expression
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.equations.symbolic import Planar, Sum, Symbol, of
from robodyn.mechanics.planar_model import (
    ClosureRow,
    Force,
    Mechanism,
    PlanarPoint,
    PointSpring,
    Terms,
)
from robodyn.scene.scene import Friction, JointSpring, Moment


class Pair:
    """A complex number of two values; it can what formulas do with complex constants."""

    __slots__ = ("imag", "real")

    def __init__(self, real: Value, imag: Value) -> None:
        self.real, self.imag = real, imag

    def __bool__(self) -> bool:
        return not (self.real == 0.0 and self.imag == 0.0)

    def __add__(self, other: Pair) -> Pair:
        return Pair(self.real + other.real, self.imag + other.imag)

    def __mul__(self, other: Pair | complex | Expression) -> Pair:
        x, y = (other, 0.0) if isinstance(other, Expression) else (other.real, other.imag)
        return Pair(self.real * x - self.imag * y, self.real * y + self.imag * x)

    def __neg__(self) -> Pair:
        return Pair(-self.real, -self.imag)

    def __abs__(self) -> Value:
        return expression.sqrt(self.real * self.real + self.imag * self.imag)

    def conjugate(self) -> Pair:
        return Pair(self.real, -self.imag)


class Numbers:
    """Sums of products of parameters: in variables of the graph, fractions if the scene is numeric.

    Their types say float and complex, as which formulas take them.
    """

    def __init__(self, scene: SymbolicScene, graph: Graph) -> None:
        self.scene, self.graph = scene, graph

    def real(self, sum_: Sum) -> float:
        if self.scene.numeric:
            sum_ = sum_.substituted(self.scene.parameters.values)
        total: Value = 0
        for monomial, number in sum_.terms.items():
            term = cast(Value, number)
            for atom, power in monomial:
                assert isinstance(atom, Symbol)
                for _ in range(power):
                    term = term * self.graph.variable(atom.name)
            total = total + term
        return cast(float, total)

    def pair(self, planar: Planar) -> complex:
        return cast(complex, Pair(self.real(planar.x), self.real(planar.y)))

    def terms(self, planars: Mapping[int, Planar]) -> Terms:
        return tuple((k, self.pair(x)) for k, x in planars.items())

    def coupling(self, offset: Sum, turns: Mapping[int, Sum]) -> tuple[float, dict[int, float]]:
        return self.real(offset), {k: self.real(turn) for k, turn in turns.items()}


def named_mechanism(scene: SymbolicScene, numbers: Numbers) -> Mechanism:
    """The mechanism of the scene, its couplings left out."""
    parameters, given = scene.parameters, scene.mechanism
    real, pair, terms = numbers.real, numbers.pair, numbers.terms
    carried, B, inertia = [], [], []
    for k in range(given.n):
        m, r = real(parameters.mass(k)), pair(parameters.centre(k))
        payload, tip = real(parameters.payload(k)), pair(parameters.tip(k))
        carried.append(m + payload)
        B.append(r * m + tip * payload)
        inertia.append(real(parameters.inertia(k)) + m * _square(r) + payload * _square(tip))
    pivots = []
    for k, above in enumerate(given.parent):
        constant = pair(parameters.hanging(scene.path[k][0]))
        arms = {} if above is None else scene.terms(above, parameters.hanging(k))
        pivots.append(PlanarPoint(constant, terms(arms)))
    for k in reversed(given.order):  # what link k carries acts on its parent at k's own joint
        above = given.parent[k]
        if above is not None:
            p = pair(parameters.hanging(k))
            carried[above] = carried[above] + carried[k]
            B[above] = B[above] + p * carried[k]
            inertia[above] = inertia[above] + carried[k] * _square(p)
    A = [(k, k, cast(complex, Pair(inertia[k], 0.0))) for k in range(given.n)]
    A += [(j, k, p.conjugate() * B[k]) for k in given.order for j, p in pivots[k].terms]
    gamma = pair(parameters.gravity())
    weights, moments, forces = [gamma.conjugate() * b for b in B], [0.0] * given.n, []
    for i, load in enumerate(scene.description.loads):
        if isinstance(load, Moment):
            moments[load.link] = moments[load.link] + real(parameters.torque(i))
            continue
        assert load.point.link is not None
        force, point = pair(parameters.force(i)), PlanarPoint(0j, terms(scene.load(i)))
        forces.append(Force(load.point.link, point, force, load.turns))
        for k, c in () if load.turns else point.terms:
            weights[k] = weights[k] + force.conjugate() * c
    springs, joint_springs = _springs(scene, numbers)
    return replace(
        given,
        A=tuple(entry for entry in A if entry[2]),
        B=tuple(B),
        gamma=gamma,
        damping=tuple(map(real, scene.damping())),
        rows=tuple(ClosureRow(0, 0j, terms(P), real(offset)) for offset, P in scene.closure_rows()),
        pivots=tuple(pivots),
        weights=tuple(weights),
        moments=tuple(moments),
        springs=springs,
        joint_springs=joint_springs,
        forces=tuple(forces),
        friction=_friction(scene, numbers),
    )


def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


def _springs(
    scene: SymbolicScene, numbers: Numbers
) -> tuple[tuple[PointSpring, ...], tuple[JointSpring, ...]]:
    """Those between points, and those at joints."""
    between: list[PointSpring] = []
    joint_springs: list[JointSpring] = []
    for i, spring in enumerate(scene.description.springs):
        stiffness = numbers.real(scene.parameters.stiffness(i))
        damping = numbers.real(scene.parameters.spring_damping(i))
        if isinstance(spring, JointSpring):
            angle = numbers.real(scene.parameters.free_angle(i))
            joint_springs.append(JointSpring(spring.joint, stiffness, angle, damping))
            continue
        constant, terms = scene.spring(i)
        given = scene.mechanism.springs[len(between)]
        entry = replace(
            given,
            between=PlanarPoint(numbers.pair(constant), numbers.terms(terms)),
            stiffness=stiffness,
            length=numbers.real(scene.parameters.free_length(i)),
            damping=damping,
        )
        between.append(entry)
    return tuple(between), tuple(joint_springs)


def _friction(scene: SymbolicScene, numbers: Numbers) -> tuple[tuple[int, Friction], ...]:
    found = []
    for k in range(scene.n):
        friction = scene.parameters.friction(k)
        if friction is not None:
            torque, speed = friction
            found.append((k, Friction(numbers.real(torque), numbers.real(of(speed)))))
    return tuple(found)
