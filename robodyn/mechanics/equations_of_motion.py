"""The equations of motion of a scene as rows: the one place where its mechanics stands.

With E_k the links' directions, a_k their angular accelerations, P_k = E_k'', the constants of
`mechanism.py`, and mu_r = -lambda_r for each closure row:

    F_k = sum_{j != k} A_kj P_j - conj(weight_k) + sum_r conj(R_rk) mu_r - sum conj(c_k) f
    0 = A_kk a_k + Im(conj(E_k) F_k) + sum_r angles_rk mu_r - moment_k - (T_k - sum of children's T)
    0 = gap_r'',      gap_r = Re(sum_k R_rk E_k) + sum_k angles_rk alpha_k + offset_r

where f are the forces of springs between points d = const + sum_k c_k E_k from end to end,

    f = (k L s^-1/2 - k - D (d.d')/s) d,        s = d.d,

and constant forces F that turn with their link, f = F E, at points with the coefficients c_k.  A
joint's torque is T = tau - D qd - friction tanh(qd/speed) - k (q - angle).

A new kind of force or joint is a few more rows here; every engine then has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from robodyn.mechanics.planar_model import Mechanism, PlanarPoint, PointSpring
from robodyn.mechanics.program import (
    Anchored,
    Coefficient,
    Derivative,
    Function,
    Given,
    Inner,
    Integral,
    Moment,
    PlanarCoefficient,
    PlanarSum,
    Power,
    Product,
    Program,
    Quotient,
    Rate,
    RealPart,
    Scaled,
    Slot,
    Turn,
    Unknown,
)

PlanarTerm = tuple[PlanarCoefficient, Slot]


@dataclass
class _Links:
    """What acts on each link while the rows are gathered: n lists each."""

    F: list[list[PlanarTerm]]
    moments: list[list[tuple[Coefficient, Slot]]]
    constants: list[complex]
    power: list[tuple[Coefficient, Slot]] = field(default_factory=list)


@dataclass
class EquationsOfMotion:
    """Writes the program of a scene.

    `program.named` tells the slots of E (n), mu (r), gap (r), load (n: what turns each link,
    without the torques at joints), bends (what a series may not tell), power, KE and PE; `torques`
    (n) all that acts at each joint, None where nothing does.
    """

    mechanism: Mechanism
    program: Program = field(default_factory=Program)

    def __post_init__(self) -> None:
        mechanism, program = self.mechanism, self.program
        n = mechanism.n
        self.E = [program.add(Turn(k)) for k in range(n)]
        self.P = [program.add(Derivative(program.add(Derivative(E)))) for E in self.E]
        self.torques: list[Slot | None] = [None] * n  # all that acts at each joint
        self.children: list[list[int]] = [[] for _ in range(n)]
        for k, above in enumerate(mechanism.parent):
            if above is not None:
                self.children[above].append(k)

    # -- kinematics --------------------------------------------------------------------------------

    def w(self, k: int) -> Slot:
        """The angular velocity of link k."""
        return self.program.add(Rate(self.E[k]))

    def alpha(self, k: int) -> Slot:
        """The angle of link k."""
        return self.program.add(Integral(self.w(k), f"alpha{k}"))

    def v(self, j: int) -> Slot:
        """The rate qd of joint j."""
        above = self.mechanism.parent[j]
        if above is None:
            return self.w(j)
        relative = self.program.sum((1.0, self.w(j)), (-1.0, self.w(above)))
        return self.program.add(Anchored(relative, f"qd{j}"))

    def q(self, j: int) -> Slot:
        """The angle of joint j."""
        return self.program.add(Integral(self.v(j), f"q{j}"))

    def t(self) -> Slot:
        """The time."""
        return self.program.add(Given("t"))

    def point(self, point: PlanarPoint) -> Slot:
        """A point of the mechanism."""
        number = self.program.planar_number
        terms = tuple((number(c), self.E[k]) for k, c in point.terms)
        return self.program.add(PlanarSum(number(point.constant), terms))

    # -- dynamics ----------------------------------------------------------------------------------

    def write(
        self,
        torques: Sequence[Slot | None],
        work: bool = False,
        steady: bool = False,
        chained: bool = False,
    ) -> Program:
        """The residuals, with the joint torques tau (n; None where there is none).

        With `work` the energies are among `named` (PE less its constant), and the power of torques
        and of what has no potential; that of `steady` torques is left out, as their work is tau
        times the way.  With `chained` the sums over A run along the tree: fewer in deep ones.
        """
        mechanism, program, n = self.mechanism, self.program, self.mechanism.n
        links = _Links(
            F=[[] for _ in range(n)],
            moments=[[] for _ in range(n)],
            constants=[-weight.conjugate() for weight in mechanism.weights],
        )
        inertia: list[Coefficient] = [0.0] * n
        for j, k, value in mechanism.A:
            if j == k:
                inertia[j] = program.number(value.real)
            elif not chained:
                re, im = program.planar_number(value)
                links.F[j].append(((re, im), self.P[k]))
                links.F[k].append(((re, -im), self.P[j]))
        if chained:
            self._chain(links)
        program.named["bends"] = []
        self._scene_forces(links, work)
        self._joints(links, torques, work, steady)
        multipliers = self._closures(links)
        loads: list[Slot] = []
        for k in range(n):
            F = program.add(PlanarSum(program.planar_number(links.constants[k]), tuple(links.F[k])))
            turning = program.add(Moment(self.E[k], self.P[k], inertia[k], F))
            moment = program.number(-mechanism.moments[k])
            load = program.sum((1.0, turning), *links.moments[k], constant=moment)
            loads.append(load)
            given = [(-1.0, self.torques[k]), *((1.0, self.torques[c]) for c in self.children[k])]
            acting = [(sign, torque) for sign, torque in given if torque is not None]
            program.residuals.append(program.sum((1.0, load), *acting))
        program.residuals += self._rows
        program.named |= {"E": self.E, "mu": multipliers, "load": loads}
        if work:
            program.named["power"] = [program.sum(*links.power)] if links.power else []
            program.named |= {"KE": [self.kinetic()], "PE": [self.potential()]}
        return program

    def kinetic(self) -> Slot:
        """1/2 sum of A_jj w_j^2, and of Re(conj(E_j') A_jk E_k')."""
        program = self.program
        terms: list[tuple[Coefficient, Slot]] = []
        for j, k, value in self.mechanism.A:
            if j == k:
                half = program.number(0.5 * value.real)
                terms.append((half, program.add(Product(self.w(j), self.w(j)))))
            else:
                one, other = (program.add(Derivative(self.E[i])) for i in (j, k))
                moved = program.planar_sum((program.planar_number(value), other))
                terms.append((1.0, program.add(Inner(one, moved))))
        return program.sum(*terms)

    def potential(self) -> Slot:
        """That of weights, of constant moments, and of springs."""
        program, number, mechanism = self.program, self.program.number, self.mechanism
        terms: list[tuple[Coefficient, Slot]] = []
        for k in range(mechanism.n):
            weight = program.planar_number(-mechanism.weights[k])
            if weight != (0.0, 0.0):
                down = program.planar_sum((weight, self.E[k]))
                terms.append((1.0, program.add(RealPart(down))))
            if mechanism.moments[k]:
                terms.append((number(-mechanism.moments[k]), self.alpha(k)))
        for spring in mechanism.springs:
            if spring.stiffness:
                d = self.point(spring.between)
                square = program.add(Inner(d, d))
                if spring.length:
                    reach = program.add(Power(square, 0.5))
                    longer = program.sum((1.0, reach), constant=number(-spring.length))
                    square = program.add(Product(longer, longer))
                terms.append((number(0.5 * spring.stiffness), square))
        for turned in mechanism.joint_springs:
            way = program.sum((1.0, self.q(turned.joint)), constant=number(-turned.angle))
            terms.append((number(0.5 * turned.stiffness), program.add(Product(way, way))))
        return program.sum(*terms)

    def _chain(self, links: _Links) -> None:
        """The sums over A in O(links): A_jk = conj(p_jk) B_k, with p_jk where the path leaves j.

        So what is above link k acts through the acceleration h_k of its joint, less gravity, and
        what is below through the sums s_c of B P.
        """
        program, mechanism = self.program, self.mechanism
        B = [program.planar_number(b) for b in mechanism.B]
        at = [program.planar_number(x.hangs_from.at) for x in mechanism.description.links]
        h: list[Slot] = [-1] * mechanism.n
        for k in mechanism.order:
            above, (re, im) = mechanism.parent[k], B[k]
            if above is None:
                h[k] = program.add(PlanarSum(program.planar_number(-mechanism.gamma), ()))
            else:
                h[k] = program.planar_sum(((1.0, 0.0), h[above]), (at[k], self.P[above]))
            links.F[k].append(((re, -im), h[k]))
            links.constants[k] += mechanism.gamma * mechanism.B[k].conjugate()
        s: list[Slot] = [-1] * mechanism.n
        for k in reversed(mechanism.order):
            below: list[PlanarTerm] = [((1.0, 0.0), s[c]) for c in self.children[k]]
            for c, (re, im) in ((c, at[c]) for c in self.children[k]):
                links.F[k].append(((re, -im), s[c]))
            s[k] = program.planar_sum((B[k], self.P[k]), *below)

    def _act(self, links: _Links, point: PlanarPoint, force: Slot, unit: complex = 1.0) -> None:
        """The force `unit` times a planar slot at a point: F_k -= conj(c_k) f."""
        for k, c in point.terms:
            number = self.program.planar_number(-c.conjugate() * unit)
            links.F[k].append((number, force))

    def _scene_forces(self, links: _Links, work: bool) -> None:
        program = self.program
        for spring in self.mechanism.springs:
            self._spring(links, spring, work)
        for force in self.mechanism.forces:
            if not force.turns:
                continue  # among the weights
            E = self.E[force.link]
            self._act(links, force.point, E, force.force)
            if work:
                unit = program.planar_number(force.force)
                turned = program.planar_sum((unit, E))
                moving = program.add(Derivative(self.point(force.point)))
                links.power.append((1.0, program.add(Inner(turned, moving))))

    def _spring(self, links: _Links, spring: PointSpring, work: bool) -> None:
        program, number = self.program, self.program.number
        if not spring.between.terms:  # its ends never move: it does nothing, but for a direction
            if not spring.between.constant and (spring.length or spring.damping):
                raise ZeroDivisionError("the ends of a spring coincide at every state")
            return
        d = self.point(spring.between)
        s = program.add(Inner(d, d)) if spring.length or spring.damping else None
        pull: list[tuple[Coefficient, Slot]] = []
        if s is not None and spring.length and spring.stiffness:
            pull.append((number(spring.stiffness * spring.length), program.add(Power(s, -0.5))))
        if s is not None and spring.damping:
            half = program.sum((0.5, program.add(Derivative(s))))  # d.d'
            ratio = program.add(Quotient(half, s))
            pull.append((number(-spring.damping), ratio))
            if work:
                squared = program.add(Product(half, ratio))
                links.power.append((number(-spring.damping), squared))
        if pull:
            place = spring.between
            reach = abs(place.constant) + sum(abs(c) for _, c in place.terms)
            factor = program.sum(*pull, constant=number(-spring.stiffness))
            force = program.add(Scaled(factor, d))
            for along in ((1.0, 0.0), (0.0, -1.0)):  # its parts stay finite where d passes 0
                part = program.add(RealPart(program.planar_sum((along, force))))
                self._bends(part, reach)
            self._act(links, spring.between, force)
        elif spring.stiffness:
            self._act(links, spring.between, d, -spring.stiffness)

    def _joints(
        self, links: _Links, torques: Sequence[Slot | None], work: bool, steady: bool
    ) -> None:
        """Torques at the joints: what a link gets its parent gives."""
        program, number, mechanism = self.program, self.program.number, self.mechanism
        friction = dict(mechanism.friction)
        springs: dict[int, list[tuple[float, float]]] = {}
        for spring in mechanism.joint_springs:
            springs.setdefault(spring.joint, []).append((spring.stiffness, spring.angle))
        for j, tau in enumerate(torques):
            acting: list[tuple[Coefficient, Slot]] = []  # all of this changes the energy
            if tau is not None:
                acting.append((1.0, tau))
                if not isinstance(program.rows[tau], Given):
                    self._bends(tau, 1.0)
            if mechanism.damping[j]:
                acting.append((number(-mechanism.damping[j]), self.v(j)))
            if j in friction:
                slow = program.sum((number(1.0 / friction[j].speed), self.v(j)))
                smooth = program.add(Function("tanh", slow))
                acting.append((number(-friction[j].torque), smooth))
                self._bends(smooth, friction[j].torque)
            if work:
                working = acting[1:] if steady and tau is not None else acting
                links.power += [(c, program.add(Product(x, self.v(j)))) for c, x in working]
            constant = 0.0
            for stiffness, angle in springs.get(j, []):
                acting.append((number(-stiffness), self.q(j)))
                constant += stiffness * angle
            if acting:
                self.torques[j] = program.sum(*acting, constant=number(constant))

    def _bends(self, slot: Slot, arm: float) -> None:
        """A slot whose series may hold only in part of a step, and what makes a torque of it."""
        self.program.named["bends"].append(slot)
        self.program.arms[slot] = arm

    def _closures(self, links: _Links) -> list[Slot]:
        """The rows of the closures, and what their multipliers do."""
        program = self.program
        multipliers: list[Slot] = []
        gaps = program.named["gap"] = []
        pins: dict[tuple[int | None, int], PlanarCoefficient] = {}
        self._rows: list[Slot] = []
        for r, row in enumerate(self.mechanism.rows):
            mu = program.add(Unknown(f"mu{r}"))
            multipliers.append(mu)
            total: list[tuple[Coefficient, Slot]] = []
            terms: list[PlanarTerm] = []
            for k, p in row.P:
                # the two rows of a pin share their numbers, turned by a right angle
                pin = pins.get((row.closure, k))
                re, im = program.planar_number(p) if pin is None else (pin[1], -pin[0])
                if row.closure is not None and row.direction == 1.0:
                    pins[row.closure, k] = re, im
                terms.append(((re, im), self.E[k]))
                links.F[k].append(((re, -im), mu))
            if terms:
                total.append((1.0, program.add(RealPart(program.planar_sum(*terms)))))
            for k, turn in row.angles:
                angle = program.number(turn)
                total.append((angle, self.alpha(k)))
                links.moments[k].append((angle, mu))
            gap = program.sum(*total, constant=program.number(row.offset))
            gaps.append(gap)
            self._rows.append(program.add(Derivative(program.add(Derivative(gap)))))
        return multipliers
