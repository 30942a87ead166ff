"""What every term of a mechanism is at a state, to 30 digits, of its description alone.

M, C and G come from the Jacobians of the centres of gravity (`oracles.mp_terms`), closures from the
kinematics of points (`random_mechanisms.Pose`), springs, loads and friction from virtual power,
reactions from the balance of each body.
"""

import math
from functools import cached_property

import numpy as np
from mpmath import mp, mpf
from varied_scenes import conserves, stored, value

import oracles
from random_mechanisms import Pose, oracle_tree
from robodyn.elements.loads import Force, Moment
from robodyn.elements.springs import JointSpring
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Description, Point

DIGITS = 30


def real(values):
    """Real parts of complex numbers of any kind."""
    return np.array([x.real for x in values])


class Forces:
    """What acts on a description at a pose and rates, force by force, in numbers of any kind."""

    def __init__(
        self, description: Description, pose: Pose, qd: np.ndarray, tanh=math.tanh, t: float = 0.0
    ):
        self.description, self.pose, self.qd, self.tanh = description, pose, qd, tanh
        self.state = {"t": t, "q": pose.q, "qd": qd}

    def place(self, point: Point) -> tuple[int | None, complex]:
        return point.link, point.at

    def pull(self, spring):
        """Ends, distance d, d's rate of change with q, and that of its length, of a spring."""
        ends = [self.place(spring.first), self.place(spring.second)]
        d = self.pose.position(ends[0]) - self.pose.position(ends[1])
        slope = self.pose.slope(ends[0]) - self.pose.slope(ends[1])
        return ends, d, real(slope * d.conjugate()) / abs(d)

    def turned(self, item):
        """The force of a load along the axes of the ground."""
        force = item.force
        for unit, signal in zip((1, 1j), item.varying, strict=True):
            force += 0 if signal is None else unit * value(signal, **self.state)
        return force * (self.pose.turn(self.pose.alpha[item.point.link]) if item.turns else 1)

    def tension(self, spring, longer, rate):
        """What pulls the ends of a spring together."""
        if spring.law is None:
            return spring.stiffness * longer + spring.damping * rate
        return value(spring.law, x=longer, v=rate) + spring.damping * rate

    def torques(self):
        """-dPE/dq of springs and constant loads, Q of the others, PE of the former."""
        potential, other, PE = 0 * self.qd, 0 * self.qd, 0.0
        pose, qd = self.pose, self.qd
        for spring in self.description.springs:
            if isinstance(spring, JointSpring):
                stretched = pose.q[spring.joint] - spring.angle
                growth = 0 * qd
                growth[spring.joint] += 1
            else:
                _, d, growth = self.pull(spring)
                stretched = abs(d) - spring.length
            other = other - spring.damping * (growth @ qd) * growth
            if spring.law is None:
                potential = potential - spring.stiffness * stretched * growth
                PE += spring.stiffness * stretched**2 / 2
                continue
            pull = value(spring.law, x=stretched, v=growth @ qd) * growth
            if conserves(spring.law):
                potential = potential - pull
                PE += stored(spring.law, stretched)
            else:
                other = other - pull
        for item in self.description.loads:
            if isinstance(item, Moment):
                potential[pose.turning(item.link)] += item.torque
                PE -= item.torque * pose.alpha[item.link]
                if item.varying is not None:
                    other[pose.turning(item.link)] += value(item.varying, **self.state)
                continue
            place = self.place(item.point)
            torque = real(np.conj(pose.slope(place)) * self.turned(item))
            if item.turns or item.varied:
                other = other + torque
            else:
                potential = potential + torque
                PE -= (item.force.conjugate() * pose.position(place)).real
        for k, link in enumerate(self.description.links):
            if link.friction is not None:
                other[k] -= link.friction.torque * self.tanh(qd[k] / link.friction.speed)
        return potential, other, PE

    def on_links(self):
        """What springs between points and loads put on each link, as Fx + i Fy."""
        total = [0j] * len(self.qd)
        for spring in self.description.springs:
            if isinstance(spring, JointSpring):
                continue
            ends, d, growth = self.pull(spring)
            F = self.tension(spring, abs(d) - spring.length, growth @ self.qd)
            for (link, _), sign in zip(ends, (-1, 1), strict=True):
                if link is not None:
                    total[link] += sign * F * d / abs(d)
        for item in self.description.loads:
            if isinstance(item, Force):
                total[item.point.link] += self.turned(item)
        return np.array(total)


def solve(K, b):
    """x of K x = b by elimination, in numbers of any kind."""
    work = np.concatenate([K, b[:, None]], axis=1)
    for k in range(len(b)):
        pivot = k + int(np.argmax(np.abs(work[k:, k])))
        work[[k, pivot]] = work[[pivot, k]]
        work[k] = work[k] / work[k, k]
        others = np.arange(len(b)) != k
        work[others] -= work[others, k, None] * work[k]
    return work[:, -1]


class Known:
    """All terms at a state, of the description alone (of a coupling's row only its scale `arm`).

    M qdd + C qd + D qd + G - Q = tau + Psi^T lambda, Psi qdd + bias = 0, and the gap.
    """

    def __init__(self, mech: Mechanism, q, qd, t: float = 0.0) -> None:
        description = self.description = mech.description
        self.mech = mech
        with mp.workdps(DIGITS):
            q, qd = (
                np.array([x if isinstance(x, mpf) else mpf(float(x)) for x in values])
                for values in (q, qd)
            )
            self.q, self.qd = q, qd
            self.tree = oracle_tree(description)
            self.pose = Pose(self.tree, q, mp.expj)
            self.forces = Forces(description, self.pose, qd, mp.tanh, mpf(t))
        self._close()

    @cached_property
    def _moving(self):
        """M, C and what weights put into G."""
        gravity = self.description.gravity
        return oracles.mp_terms(self.tree, gravity, self.q, self.qd, DIGITS)

    @cached_property
    def _acting(self):
        """-dPE/dq of springs and constant loads, Q of the others, PE of the former."""
        with mp.workdps(DIGITS):
            return self.forces.torques()

    @property
    def M(self):
        return self._moving[0]

    @property
    def C(self):
        return self._moving[1]

    @cached_property
    def G(self):
        with mp.workdps(DIGITS):
            return self._moving[2] - self._acting[0]

    @cached_property
    def Q(self):
        with mp.workdps(DIGITS):
            damping = [mpf(link.damping) for link in self.description.links]
            for k, link in enumerate(self.description.links):
                if link.motor is not None:
                    damping[k] += mpf(link.motor.damping) * mpf(link.motor.ratio) ** 2
            return self._acting[1] - np.array(damping) * self.qd

    @cached_property
    def PE(self):
        with mp.workdps(DIGITS):
            gravity = self.description.gravity.conjugate()
            return self._acting[2] - sum(
                link["m"] * (gravity * self.pose.position((k, link["r"]))).real
                for k, link in enumerate(self.tree)
            )

    @cached_property
    def KE(self):
        with mp.workdps(DIGITS):
            return self.qd @ self.M @ self.qd / 2

    @cached_property
    def h(self):
        with mp.workdps(DIGITS):
            return self.C @ self.qd + self.G - self.Q

    def _close(self) -> None:
        """Psi, bias and gap."""
        with mp.workdps(DIGITS):
            q, qd, pose, n = self.q, self.qd, self.pose, len(self.q)
            description = self.description
            Psi, bias, gap = [], [], []
            arms = iter([row.arm for row in self.mech.rows if row.arm])
            for closure in description.closures:
                sides = [self.forces.place(x) for x in (closure.first, closure.second)]
                d, slope, bend = (
                    a - b
                    for a, b in (
                        [pose.position(side) for side in sides],
                        [pose.slope(side) for side in sides],
                        [pose.bias(side, qd) for side in sides],
                    )
                )
                turning = self.turned_by(closure.second.link if closure.along else None)
                w = turning @ qd
                for direction in self.directions(closure):
                    back = direction.conjugate()
                    gap.append((back * d).real)
                    Psi.append(real(back * slope) + (back * d).imag * turning)
                    bias.append((back * (bend - 2j * w * (slope @ qd) - w * w * d)).real)
                if closure.aligned is not None:
                    first, second, arm = closure.first.link, closure.second.link, next(arms)
                    off = self.turned_by(first) - self.turned_by(second)
                    carrier = 0 if second is None else pose.alpha[second]
                    angle = pose.alpha[first] - carrier - mpf(closure.aligned)
                    gap.append(arm * mp.sin(angle))
                    Psi.append(arm * mp.cos(angle) * off)
                    bias.append(-arm * mp.sin(angle) * (off @ qd) ** 2)
            for coupling, arm in zip(description.couplings, arms, strict=True):
                row = 0 * q
                row[coupling.joint] += 1
                for k, ratio in coupling.terms:
                    row[k] -= ratio
                Psi.append(arm * row)
                bias.append(mpf(0))
                gap.append(arm * (row @ q - coupling.angle))
            r = self.r = len(gap)
            self.Psi = np.array(Psi, object).reshape(r, n)
            self.bias, self.gap = np.array(bias, object), np.array(gap, object)

    def turned_by(self, link):
        """d(angle of a link)/dq."""
        found = 0 * self.q
        found[self.pose.turning(link)] += 1
        return found

    def directions(self, closure):
        """Unit vectors along which a closure holds."""
        if closure.along is None:
            return (1, 1j)
        carrier = closure.second.link
        turn = 1 if carrier is None else self.pose.turns[carrier]
        return (1j * closure.along / abs(closure.along) * turn,)

    @cached_property
    def condition(self) -> float:
        K = self.system.astype(float)
        return float(np.linalg.cond(K))

    @cached_property
    def system(self):
        r = self.r
        return np.block([[self.M, -self.Psi.T], [self.Psi, np.zeros((r, r), object)]])

    def accelerations(self, tau):
        """qdd and lambda."""
        with mp.workdps(DIGITS):
            right = np.concatenate([tau - self.h, -self.bias])
            return np.split(solve(self.system, right), [len(self.h)])

    def torques(self, qdd):
        """tau and lambda."""
        with mp.workdps(DIGITS):
            n = len(self.h)
            driven = np.eye(n)[:, list(self.mech.actuated)]
            solution = solve(np.hstack([driven, self.Psi.T]), self.M @ qdd + self.h)
            tau, multipliers = np.split(solution, [n - self.r])
            return driven @ tau, multipliers

    def reactions(self, qdd, multipliers):
        """The force of each joint on its link, Fx + i Fy: what else acts, and m a, balance it."""
        with mp.workdps(DIGITS):
            left = [-x for x in self.forces.on_links()]
            rows = iter(multipliers)
            for closure in self.description.closures:
                F = sum(direction * next(rows) for direction in self.directions(closure))
                if closure.aligned is not None:
                    next(rows)  # a moment
                for point, sign in ((closure.first, -1), (closure.second, 1)):
                    if point.link is not None:
                        left[point.link] += sign * F
            for k, link in enumerate(self.tree):
                place = k, link["r"]
                a = self.pose.slope(place) @ qdd + self.pose.bias(place, self.qd)
                left[k] += link["m"] * (a - self.description.gravity)
            for k in reversed(range(len(left))):
                if (parent := self.tree[k]["parent"]) is not None:
                    left[parent] += left[k]
            return np.array([[x.real, x.imag] for x in left])
