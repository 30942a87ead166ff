"""What each name of a derivation is, from the positions of points, by sympy."""

from __future__ import annotations

import cmath
import json
import math
import re
from functools import cached_property

import numpy as np
import sympy as sp

from robodyn.elements.joints import DryFriction, SmoothFriction
from robodyn.elements.loads import Force, Moment
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.equations.derivation import Derivation
from robodyn.equations.derivation_text import derivation_json
from robodyn.equations.written import equations
from robodyn.mechanics.mechanism import Mechanism

TAKEN = re.compile(
    r"[HTFBY]\d+[xy]?|[cz]\d+[xy]"
)  # laws that vary: what their names stand for is as given
NAMED = re.compile(  # what is left of an equal sign, but for the first side of a closure
    r"(omega|vC|vP|v|KE|PEs|PEl|PE|rF|tau|Q|D_qd|f|lambda|[bcu]|gap|Psidot_qd|d/dt gap|dL/dqd?"
    r"|d/dt dL/dqd)\d+|(Psi|N|W|d)\d\d|[SVKP]\d+[xy]?|KE|PE|L|dW|(centripetal|Coriolis) \(C qd\)\d+"
)
FUNCTIONS = {name: getattr(math, name) for name in ("sin", "cos", "tan", "tanh", "exp", "sqrt")}
FUNCTIONS |= {
    "sign": lambda x: math.copysign(1.0, x) if x else 0.0,
    "step": lambda x: float(x > 0),
    "max": max,
    "min": min,
    "abs": abs,
    "log": math.log,
    "hypot": math.hypot,
}


def turned(angle, x, y):
    """A vector turned counter-clockwise."""
    return sp.Matrix([sp.cos(angle) * x - sp.sin(angle) * y, sp.sin(angle) * x + sp.cos(angle) * y])


class Oracle:
    """A scene at one state: q, qd, qdd, the torques of driven joints, and t."""

    def __init__(self, mechanism: Mechanism, state, torques, t=0.3) -> None:
        self.mechanism, self.scene, self.n = mechanism, mechanism.description, mechanism.n
        self.q, self.qd, self.qdd = (sp.symbols(f"{x}1:{self.n + 1}") for x in ("q", "qd", "qdd"))
        symbols = (*self.q, *self.qd, *self.qdd)
        self.numbers = [float(x) for part in state for x in part]
        self.values = dict(zip(map(str, symbols), self.numbers, strict=True)) | {"t": t}
        self._symbols, self.torques = symbols, torques
        self.angles, self.origins, self.axes = [], [], []
        for k, link in enumerate(self.scene.links):
            above = link.hangs_from.link
            origin = self.place(above, link.hangs_from.at)
            angle = 0 if above is None else self.angles[above]
            if link.slides:
                angle = angle + math.atan2(link.axis.imag, link.axis.real)
                origin = origin + turned(angle, self.q[k], 0)
            else:
                angle = angle + self.q[k] + cmath.phase(link.turn)
            self.angles.append(angle)
            self.origins.append(origin)

    def value(self, expression) -> float:
        """An expression at the state."""
        found = sp.lambdify(self._symbols, expression, "math")(*self.numbers)
        return float(found)

    def vector(self, expression) -> list[float]:
        return [self.value(x) for x in expression]

    def place(self, k, at):
        """A point of link k on the ground."""
        at = complex(at)
        if k is None:
            return sp.Matrix([at.real, at.imag])
        return self.origins[k] + turned(self.angles[k], at.real, at.imag)

    def rate(self, expression):
        """d/dt."""
        pairs = zip((*self.q, *self.qd), (*self.qd, *self.qdd), strict=True)
        if isinstance(expression, sp.Matrix):
            return expression.applyfunc(self.rate)
        return sum((sp.diff(expression, x) * xd for x, xd in pairs), sp.Integer(0))

    def seen(self, k, at):
        """The velocity of a point in its link's own frame."""
        velocity = self.rate(self.place(k, at))
        return turned(-self.angles[k], *velocity)

    # -- energies ----------------------------------------------------------------------------------

    @cached_property
    def KE(self) -> list:
        found = []
        for k, link in enumerate(self.scene.links):
            energy = sp.Rational(1, 2) * link.I * self.rate(self.angles[k]) ** 2
            for m, at in ((link.m, link.r), (link.payload, link.l)):
                v = self.rate(self.place(k, at))
                energy += sp.Rational(1, 2) * m * (v[0] ** 2 + v[1] ** 2)
            if link.motor is not None:
                above = link.hangs_from.link
                spin = link.motor.ratio * self.qd[k]
                spin += 0 if above is None else self.rate(self.angles[above])
                energy += sp.Rational(1, 2) * link.motor.inertia * spin**2
            found.append(energy)
        return found

    @cached_property
    def PE(self) -> dict:
        g, found = self.scene.gravity, {}
        for k, link in enumerate(self.scene.links):
            found[f"PE{k + 1}"] = sum(
                (
                    -m * (g.real * self.place(k, at)[0] + g.imag * self.place(k, at)[1])
                    for m, at in ((link.m, link.r), (link.payload, link.l))
                ),
                sp.Integer(0),
            )
        for i, spring in enumerate(self.scene.springs):
            if spring.stiffness and spring.law is None:
                if isinstance(spring, JointSpring):
                    stretch = self.q[spring.joint] - spring.angle
                else:
                    S = self.between(spring)
                    stretch = sp.sqrt(S[0] ** 2 + S[1] ** 2) - spring.length
                found[f"PEs{i + 1}"] = sp.Rational(1, 2) * spring.stiffness * stretch**2
        for i, load in enumerate(self.scene.loads):
            if isinstance(load, Moment) and load.varying is None:
                found[f"PEl{i + 1}"] = -load.torque * self.turn(load.link)
            elif isinstance(load, Force) and self.steady(load):
                force = self.force(load)
                found[f"PEl{i + 1}"] = -(force.T * self.place(load.point.link, load.point.at))[0]
        return found

    def turn(self, k):
        """How far link k is turned by joints."""
        return sum((x for x in self.angles[k].free_symbols), sp.Integer(0)) if k is not None else 0

    def steady(self, load) -> bool:
        turns = load.turns and self.angle_moves(load.point.link)
        return not load.varied and not load.moves and not turns

    def acting_at(self, load):
        """Where a load acts on the ground; what varies along its link by its name."""
        at, i = load.point.at, self.scene.loads.index(load) + 1
        still = at.real, at.imag
        for axis, law, way, beside in zip("xy", load.moving, (1, 1j), still, strict=True):
            if law is not None:
                at += self.values[f"{'z' if beside else 'c'}{i}{axis}"] * way * load.turn
        return self.place(load.point.link, at)

    def angle_moves(self, k) -> bool:
        return bool(sp.sympify(self.angles[k]).free_symbols)

    def force(self, load):
        """The force of a load on the ground; what varies by its name."""
        x, y = load.force.real, load.force.imag
        i = self.scene.loads.index(load) + 1
        if load.varied:
            x, y = (
                given if law is None else self.values[f"F{i}{axis}"]
                for given, law, axis in zip((x, y), load.varying, "xy", strict=True)
            )
        way = self.angles[load.point.link] + cmath.phase(load.turn)
        return turned(way, x, y) if load.turns else sp.Matrix([x, y])

    def between(self, spring):
        ends = (self.place(x.link, x.at) for x in (spring.first, spring.second))
        one, two = ends
        return one - two

    @cached_property
    def L(self):
        return sum(self.KE) - sum(self.PE.values(), sp.Integer(0))

    def momentum(self, i):
        return sp.diff(self.L, self.qd[i])

    def convective(self, i, qd=None):
        """(C qd)_i, from KE alone, at the rates of the state or at others."""
        KE = sum(self.KE)
        p = sp.diff(KE, self.qd[i])
        moving = sum((sp.diff(p, x) * xd for x, xd in zip(self.q, self.qd, strict=True)), 0)
        whole = moving - sp.diff(KE, self.q[i])
        numbers = list(self.numbers)
        if qd is not None:
            numbers[self.n : 2 * self.n] = qd
        return float(sp.lambdify(self._symbols, whole, "math")(*numbers))

    def centripetal(self, i):
        rates = self.numbers[self.n : 2 * self.n]
        alone = ([x if j == k else 0.0 for k in range(self.n)] for j, x in enumerate(rates))
        return sum(self.convective(i, each) for each in alone)

    # -- what acts beside --------------------------------------------------------------------------

    def damping(self, i):
        """(D qd)_i: dampers of the joint, of springs there, and of the rotor."""
        link = self.scene.links[i]
        d = link.damping
        d += sum(
            x.damping for x in self.scene.springs if isinstance(x, JointSpring) and x.joint == i
        )
        d += link.motor.damping * link.motor.ratio**2 if link.motor is not None else 0.0
        return d * self.values[f"qd{i + 1}"]

    def other(self, i):
        """Q_i by virtual work."""
        total = 0.0
        for j, spring in enumerate(self.scene.springs):
            if isinstance(spring, PointSpring) and spring.damping:
                S = self.between(spring)
                size = sp.sqrt(S[0] ** 2 + S[1] ** 2)
                total += self.value(-spring.damping * self.rate(size) * sp.diff(size, self.q[i]))
            if spring.law is not None and spring.law.names - {"x"}:
                reach = self.q[spring.joint] if isinstance(spring, JointSpring) else None
                if reach is None:
                    S = self.between(spring)
                    reach = sp.sqrt(S[0] ** 2 + S[1] ** 2)
                total -= self.values[f"H{j + 1}"] * self.value(sp.diff(reach, self.q[i]))
        for j, load in enumerate(self.scene.loads):
            if isinstance(load, Force) and not self.steady(load):
                arm = self.acting_at(load).diff(self.q[i])
                total += self.value((self.force(load).T * arm)[0])
            elif isinstance(load, Moment) and load.varying is not None:
                slope = self.value(sp.diff(self.angles[load.link], self.q[i]))
                total += self.values[f"T{j + 1}"] * slope
        friction, rate = self.scene.links[i].friction, self.values[f"qd{i + 1}"]
        if isinstance(friction, SmoothFriction):
            total -= friction.torque * math.tanh(rate / friction.speed)
        elif isinstance(friction, DryFriction):
            total -= self.values.get(f"B{i + 1}", 0.0)
        return total + self.values.get(f"Y{i + 1}", 0.0)

    # -- loops -------------------------------------------------------------------------------------

    @cached_property
    def gaps(self) -> list:
        found = []
        for c, closure in enumerate(self.scene.closures):
            first, second = closure.first, closure.second
            way = self.place(first.link, first.at) - self.place(second.link, second.at)
            carrier = 0 if second.link is None else self.angles[second.link]
            if closure.along is None:
                found += list(way)
            else:
                along = turned(carrier, closure.along.real, closure.along.imag)
                found.append(-along[1] * way[0] + along[0] * way[1])
            if closure.aligned is not None:
                off = self.angles[first.link] - carrier - closure.aligned
                found.append(self.values[f"L{c + 1}"] * sp.sin(off))
        for c, coupling in enumerate(self.scene.couplings):
            size = self.values.get(f"R{c + 1}", 1.0)
            told = sum((ratio * self.q[k] for k, ratio in coupling.terms), sp.Integer(0))
            found.append(size * (self.q[coupling.joint] - told - coupling.angle))
        return found

    @cached_property
    def Psi(self) -> np.ndarray:
        rows = [[self.value(sp.diff(gap, x)) for x in self.q] for gap in self.gaps]
        return np.array(rows).reshape(-1, self.n)

    @cached_property
    def bias(self) -> np.ndarray:
        """Psidot qd."""

        def twice(gap):
            once = sum((sp.diff(gap, x) * xd for x, xd in zip(self.q, self.qd, strict=True)), 0)
            return sum((sp.diff(once, x) * xd for x, xd in zip(self.q, self.qd, strict=True)), 0)

        return np.array([self.value(twice(gap)) for gap in self.gaps])

    @cached_property
    def M(self) -> np.ndarray:
        KE = sum(self.KE)
        return np.array([[self.value(sp.diff(KE, a, b)) for b in self.qd] for a in self.qd], float)

    @cached_property
    def G(self) -> np.ndarray:
        PE = sum(self.PE.values(), sp.Integer(0))
        found = [self.value(sp.diff(PE, x)) for x in self.q]
        for j, spring in enumerate(self.scene.springs):  # laws with a potential
            if spring.law is not None and spring.law.names <= {"x"}:
                if isinstance(spring, JointSpring):
                    found[spring.joint] += self.values[f"H{j + 1}"]
                else:
                    S = self.between(spring)
                    size = sp.sqrt(S[0] ** 2 + S[1] ** 2)
                    pull = self.values[f"H{j + 1}"]
                    found = [
                        x + pull * self.value(sp.diff(size, q))
                        for x, q in zip(found, self.q, strict=True)
                    ]
        return np.array(found)

    @cached_property
    def f(self) -> np.ndarray:
        found = [self.other(i) - self.convective(i) - self.damping(i) for i in range(self.n)]
        found = np.array(found) - self.G
        found[list(self.mechanism.actuated)] += self.torques
        return found

    @cached_property
    def N(self) -> np.ndarray:
        return np.linalg.inv(self.M)

    @cached_property
    def solved(self) -> tuple:
        """W, b and lambda."""
        W = self.Psi @ self.N @ self.Psi.T
        b = self.Psi @ self.N @ self.f + self.bias
        return W, b, -np.linalg.solve(W, b)

    # -- names -------------------------------------------------------------------------------------

    def of(self, name: str):
        """What a name stands for: a number, or a list of two."""
        links, springs = self.scene.links, self.scene.springs
        letters, _, digits = name.rpartition(" ") if " " in name else ("", "", name)
        match = re.fullmatch(r"(.*?)(\d*)([xy]?)", digits)
        kind, number, axis = match.groups()
        k = int(number) - 1 if number else -1
        match (letters, kind):
            case ("", "omega"):
                return self.value(self.rate(sp.sympify(self.angles[k])))
            case ("", "v"):
                return self.vector(self.seen(k, 0))
            case ("", "vC"):
                return self.vector(self.seen(k, links[k].r))
            case ("", "vP"):
                return self.vector(self.seen(k, links[k].l))
            case ("", "KE"):
                return self.value(self.KE[k] if number else sum(self.KE))
            case ("", "PE") if not number:
                return self.value(sum(self.PE.values()))
            case ("", "PE" | "PEs" | "PEl"):
                return self.value(self.PE[name])
            case ("", "L") if not number:
                return self.value(self.L)
            case ("", "dL/dq"):
                return self.value(sp.diff(self.L, self.q[k])) - self.pulled(k)
            case ("", "dL/dqd"):
                return self.value(self.momentum(k))
            case ("d/dt", "dL/dqd"):
                return self.value(self.rate(self.momentum(k)))
            case ("", "tau"):
                turned_ = self.value(self.rate(self.momentum(k)) - sp.diff(self.L, self.q[k]))
                return turned_ + self.pulled(k) + self.damping(k) - self.other(k)
            case ("centripetal (C", _):
                return self.centripetal(int(name[-1]) - 1)
            case ("Coriolis (C", _):
                k = int(name[-1]) - 1
                return self.convective(k) - self.centripetal(k)
            case ("", "Q"):
                return self.other(k)
            case ("", "D_qd"):
                return self.damping(k)
            case ("", "rF"):
                return self.vector(self.acting_at(self.scene.loads[k]))
            case ("", "gap"):
                return self.value(self.gaps[k])
            case ("d/dt", "gap"):
                return float(self.Psi[k] @ self.numbers[self.n : 2 * self.n])
            case ("", "Psi"):
                return self.Psi[int(number[0]) - 1, int(number[1]) - 1]
            case ("", "Psidot_qd"):
                return self.bias[k]
            case ("", "f"):
                return self.f[k]
            case ("", "d" | "N" | "W"):
                i, j = (int(x) - 1 for x in number) if len(number) == 2 else (0, 1)
                if kind == "N":
                    return self.N[i, j]
                if kind == "W":
                    return self.solved[0][i, j]
                return self.M[i, i] * self.M[j, j] - self.M[i, j] ** 2
            case ("", "dW"):
                W = self.solved[0]
                return W[0, 0] * W[1, 1] - W[0, 1] ** 2
            case ("", "b" | "c" | "u"):
                return self.solved[1][k]
            case ("", "lambda"):
                return self.solved[2][k]
            case ("", "S" | "V" | "K" | "P"):
                S = self.between(springs[k])
                size = sp.sqrt(S[0] ** 2 + S[1] ** 2)
                if kind == "K" and springs[k].law is not None:
                    return self.values[f"H{k + 1}"] / self.value(size)
                each = {
                    "S": S[0 if axis == "x" else 1] if axis else size,
                    "V": self.rate(S[0 if axis == "x" else 1] if axis else size),
                    "K": springs[k].stiffness * (1 - springs[k].length / size),
                    "P": springs[k].damping * self.rate(size) / size,
                }
                return self.value(each[kind])
        raise AssertionError(f"{name}: what is it?")

    def pulled(self, i) -> float:
        """What springs by laws that have a potential take, which is not in L."""
        return self.G[i] - self.value(sp.diff(sum(self.PE.values(), sp.Integer(0)), self.q[i]))


def wrong(mechanism: Mechanism, seed: int = 0, numeric: bool = False, change=None) -> list[str]:
    """The lines of the derivation's JSON of which a right side is another number than it should be.

    `change` may alter the steps before.
    """
    rng = np.random.default_rng(seed)
    state = [rng.uniform(-2.0, 2.0, mechanism.n) for _ in range(3)]
    content = json.loads(derivation_json(Derivation(equations(mechanism, numeric))))
    steps = content["steps"]
    if change is not None:
        change(steps)
    oracle = Oracle(mechanism, state, rng.normal(size=len(mechanism.actuated)))
    known = {name: x["value"] for name, x in content["symbols"].items()}
    known |= {x.name: x.value for x in equations(mechanism).known.known.values()}
    driven = zip(mechanism.actuated, oracle.torques, strict=True)
    oracle.values |= known
    names = dict(oracle.values) | {f"tau{k + 1}": x for k, x in driven}
    names |= {f"omega{k + 1}": oracle.of(f"omega{k + 1}") for k in range(mechanism.n)}
    for i in range(mechanism.n):
        names |= {f"M{i + 1}{j + 1}": oracle.M[i, j] for j in range(mechanism.n)}
    for name, text in content.get("definitions", {}).items():
        names[name] = oracle.values[name] = evaluated(text, names)
    names |= {f"Q{i + 1}": oracle.other(i) for i in range(mechanism.n)}
    bad, row, final = [], 0, False
    for line in (line for step in steps for line in step["lines"] if "left" in line):
        left, right = line["left"], line["right"]
        if left in ("PE", "L") and any(x.law is not None for x in oracle.scene.springs):
            continue  # they hold an integral
        final |= left == "f1"
        if TAKEN.fullmatch(left):
            wanted = names[left]
        elif NAMED.fullmatch(left):
            wanted = oracle.of(left)
            row += left.startswith("gap")
        elif final:  # a row of the equation of motion with lambda
            qdd = oracle.N @ (oracle.f + oracle.Psi.T @ oracle.solved[2])
            wanted = evaluated(left, names | {f"qdd{k + 1}": x for k, x in enumerate(qdd)})
        else:  # what the second side is, where the first side is left
            wanted = evaluated(left, names) - oracle.value(oracle.gaps[row])
            row += 1
        size = 1.0 + np.abs(wanted).max()
        for each in right:
            if "gap" in left and each == "0":
                continue  # it is zero where the loops are closed
            if isinstance(each, list):
                value = [evaluated(x, names) for x in each]
            else:
                value = evaluated(each, names)
            if not np.abs(np.subtract(value, wanted)).max() <= 1e-12 * size:
                bad.append(f"{left} = {each}: {value} for {wanted}")
        if NAMED.fullmatch(left) and not isinstance(right[-1], list):
            names.setdefault(left, wanted)
    return bad


def evaluated(text: str, names: dict) -> float:
    return float(eval(text, {"__builtins__": {}}, {**FUNCTIONS, **names}))
