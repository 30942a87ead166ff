"""G and Q of a scene's equations of motion in symbols: gravity, springs, loads and friction.

    G_a = sum_k Im((conj(gamma) B_k + conj(F) c_k) E_k) - T + k (q_a - phi) + K Re(conj(S) dS/dq_a)
    Q_a = Im(F conj(c_k) exp(i theta_kL)) - tf tanh(qd_a/wf) - P Re(conj(S) dS/dq_a)

where c_k are the coefficients of E of the point of a force F, which keeps its direction in G and
turns with its link L in Q; T is a torque on a link.  A spring from its second end to its first is
S = const + sum_k d_k E_k, V = dS/dt.  It pulls by K S and its damper by P S,

    K = k (1 - S0/|S|)        P = ds Re(conj(S) V)/|S|^2

which, with S and V, stand as names in the entries; without a free length K = k, and S is multiplied
out where its links hang from one another.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations
from typing import Any

from robodyn.equations.blocks import BY_GRAVITY, BY_LINE, Rows, column
from robodyn.equations.factoring import Product, Root, Written
from robodyn.equations.outline import Definition
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.equations.symbolic import (
    ONE,
    ZERO,
    Angle,
    Planar,
    Rates,
    Role,
    Smooth,
    Sum,
    Symbol,
    of,
    total,
)
from robodyn.scene.scene import JointSpring, Moment


def gravity_vector(scene: SymbolicScene) -> tuple[Rows, tuple[Definition, ...]]:
    """G, dPE/dq, and the names that it uses."""
    torques = [ZERO] * scene.n  # in alpha
    joints = [ZERO] * scene.n
    if scene.description.gravity != 0.0:
        pull = scene.symbols.gravity.conjugate()
        for body in chain.from_iterable(scene.bodies):
            for k, rho in body.rho.items():
                weight = (pull * rho.turned(scene.direction(k))).imag * body.mass
                torques[k] = torques[k] + weight
    for load in scene.symbols.loads:
        if isinstance(load, Moment):
            torque: Any = load.torque
            torques[load.link] = torques[load.link] - torque
        elif not load.turns:
            pull = load.force.conjugate()
            for k, c in scene.terms(load.point).items():
                torques[k] = torques[k] + (pull * c.turned(scene.direction(k))).imag
    where: list[Definition] = []
    for i, spring in enumerate(scene.symbols.springs):
        if not spring.stiffness:
            continue
        if isinstance(spring, JointSpring):
            angle: Any = spring.angle
            pulled = spring.stiffness * (of(Angle(spring.joint)) - angle)
            joints[spring.joint] = joints[spring.joint] + pulled
            continue
        found = _Spring(scene, i)
        where += [] if found.expanded else found.pull()
        for k, slope in (found.expanded or found.slopes).items():
            torques[k] = torques[k] + found.pulling * slope
    return _in_joints(scene, torques, joints), tuple(where)


def other_forces(scene: SymbolicScene) -> tuple[Rows, tuple[Definition, ...]]:
    """Q, what has no potential, and the names that it uses."""
    torques, joints = [ZERO] * scene.n, [ZERO] * scene.n
    where: list[Definition] = []
    for load in scene.symbols.loads:
        if isinstance(load, Moment) or not load.turns:
            continue
        for k, c in scene.terms(load.point).items():
            arm = load.force * c.conjugate()
            angle = scene.angle(k, load.point.link)
            torques[k] = torques[k] + (arm.turned(angle) if angle else arm).imag
    for k, link in enumerate(scene.symbols.links):
        if link.friction is not None:
            (speed,) = link.friction.speed.atoms()
            joints[k] = -(link.friction.torque * of(Smooth("tanh", k, speed)))
    for i, spring in enumerate(scene.symbols.springs):
        if isinstance(spring, JointSpring) or not spring.damping:
            continue
        found = _Spring(scene, i)
        where += found.damper()
        for k, slope in found.slopes.items():
            torques[k] = torques[k] - found.damping * slope
    return _in_joints(scene, torques, joints), tuple(where)


def _in_joints(scene: SymbolicScene, torques: list[Sum], joints: list[Sum]) -> Rows:
    """Torques in alpha, and those of joints, as the entries of a vector."""
    sums = (
        total([*(x for k, x in enumerate(torques) if a in scene.path[k]), joints[a]])
        for a in range(scene.n)
    )
    return column(scene, sums, BY_GRAVITY)


class _Spring:
    """A spring between points: S, its slopes in alpha, and the names in which it is told."""

    def __init__(self, scene: SymbolicScene, i: int) -> None:
        self.scene, self.i = scene, i
        self.spring = scene.symbols.springs[i]
        self.told = f"spring {i + 1}"
        self.free = bool(self.spring.length)
        constant, d = scene.spring(self.spring)
        self.d = {k: x.turned(scene.direction(k)) for k, x in d.items()}
        self.S = total_planar([*self.d.values(), constant])
        self.x, self.y = (self._name(f"S{i + 1}{axis}", Role.stretch) for axis in "xy")
        self.length = Symbol(f"S{i + 1}", Role.stretch, (i, ""))
        # Re(conj(S) i d_k E_k)
        self.slopes = {k: of(self.y) * x.real - of(self.x) * x.imag for k, x in self.d.items()}
        self.pulling = of(self._name(f"K{i + 1}", Role.force))
        self.damping = of(self._name(f"P{i + 1}", Role.force))
        self.expanded: dict[int, Sum] = {}
        if not self.free:
            self.pulling = self.spring.stiffness
            self.expanded = self._products(d, constant)

    def _products(self, d: dict[int, Planar], constant: Planar) -> dict[int, Sum]:
        """The slopes with S multiplied out; nothing where links of two branches would mix.

        Re(conj(S) i d_k E_k) holds conj(d_j) d_k exp(i theta_jk), and its opposite for d_j.
        """
        path = self.scene.path
        pairs = [(j, k) if j in path[k] else (k, j) for j, k in combinations(d, 2)]
        if any(j not in path[k] for j, k in pairs):
            return {}
        away = constant.conjugate().quarter_turn
        slopes = {k: (away * x).turned(self.scene.direction(k)).real for k, x in d.items()}
        for j, k in pairs:
            both = (d[j].conjugate() * d[k]).quarter_turn.turned(self.scene.angle(j, k)).real
            slopes[k], slopes[j] = slopes[k] + both, slopes[j] - both
        return slopes

    def _name(self, name: str, role: Role) -> Symbol:
        return Symbol(name, role, (self.i, name[-1] if name[-1] in "xy" else ""))

    def pull(self) -> Iterator[Definition]:
        """S and, if the spring has a free length, |S| and K."""
        yield from self._components()
        if self.free:
            yield self._length()
            pull = self.spring.stiffness * (ONE - self.spring.length * of(self.length, -1))
            value = self.scene.written(pull, ())
            yield Definition(f"K{self.i + 1}", value, "N/m", f"pull of {self.told} per length")

    def damper(self) -> Iterator[Definition]:
        """S, |S|, V and P."""
        yield from self._components()
        yield self._length()
        rates = {k: of(Rates(self.scene.direction(k))) for k in self.d}
        speeds = {
            "x": -total(x.imag * rates[k] for k, x in self.d.items()),
            "y": total(x.real * rates[k] for k, x in self.d.items()),
        }
        along = []
        for component, (axis, speed) in zip((self.x, self.y), speeds.items(), strict=True):
            name = f"V{self.i + 1}{axis}"
            value = self.scene.written(speed, BY_LINE)
            yield Definition(name, value, "m/s", f"rate of {component.name}")
            along.append(of(component) * of(Symbol(name, Role.stretch, (self.i, f"V{axis}"))))
        value = self.scene.written(self.spring.damping * total(along) * of(self.length, -2), ())
        meaning = f"pull of the damper of {self.told} per length"
        yield Definition(f"P{self.i + 1}", value, "N/m", meaning)

    def _components(self) -> Iterator[Definition]:
        for axis, name, value in (("X", self.x, self.S.real), ("Y", self.y, self.S.imag)):
            meaning = f"{self.told} from its second end to its first, along {axis}"
            yield Definition(name.name, self.scene.written(value, BY_LINE), "m", meaning)

    def _length(self) -> Definition:
        squares = tuple(Product(1, ((x, 2),)) for x in (self.x, self.y))
        value = Written((Product(1, ((Root(Written(squares)), 1),)),))
        return Definition(self.length.name, value, "m", f"length of {self.told}")


def total_planar(parts: list[Planar]) -> Planar:
    """The sum of vectors."""
    return Planar(total(x.real for x in parts), total(x.imag for x in parts))
