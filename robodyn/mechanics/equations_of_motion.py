"""The equations of motion of a scene as rows: the one place where its mechanics stands.

With E_k the links' directions, a_k their angular accelerations, P_k = E_k'', the constants of
`mechanism.py`, and mu_r = -lambda_r for each closure row:

    F_k = sum_{j != k} A_kj P_j - conj(weight_k) + sum_r conj(R_rk) mu_r - sum conj(c_k) f
    0 = A_kk a_k + Im(conj(E_k) F_k) + sum_r angles_rk mu_r - moment_k - (T_k - sum of children's T)
    0 = gap_r'',      gap_r = Re(sum_k R_rk E_k) + sum_k angles_rk alpha_k + offset_r

where f are the forces at points with the coefficients c_k, and T the torques at joints, as
`force_rows.py` has them: the place of a new kind of either.  Every engine then has it.
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn.mechanics.force_rows import ForceRows, PlanarTerm, Term
from robodyn.mechanics.program import (
    Coefficient,
    Derivative,
    Inner,
    Moment,
    PlanarCoefficient,
    PlanarSum,
    Product,
    Program,
    RealPart,
    Slot,
    Unknown,
)


class EquationsOfMotion(ForceRows):
    """Writes the program of a scene.

    `program.named` tells the slots of E (n), mu (r), gap (r), load (n: what turns each link,
    without the torques at joints), bends (what a series may not tell), power, KE and PE.
    """

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
        inertia: list[Coefficient] = [0.0] * n
        for j, k, value in mechanism.A:
            if j == k:
                inertia[j] = program.number(value.real)
            elif not chained:
                re, im = program.planar_number(value)
                self.F[j].append(((re, im), self.P[k]))
                self.F[k].append(((re, -im), self.P[j]))
        if chained:
            self._chain()
        program.named["bends"] = []
        self._scene_forces(work)
        self._joints(torques, work, steady)
        multipliers = self._closures()
        loads: list[Slot] = []
        for k in range(n):
            F = program.add(PlanarSum(program.planar_number(self.constants[k]), tuple(self.F[k])))
            turning = program.add(Moment(self.E[k], self.P[k], inertia[k], F))
            moment = program.number(-mechanism.moments[k])
            load = program.sum((1.0, turning), *self.moments[k], constant=moment)
            loads.append(load)
            given = [(-1.0, self.torques[k]), *((1.0, self.torques[c]) for c in self.children[k])]
            acting = [(sign, torque) for sign, torque in given if torque is not None]
            program.residuals.append(program.sum((1.0, load), *acting))
        program.residuals += self._rows
        program.named |= {"E": self.E, "mu": multipliers, "load": loads}
        if work:
            program.named["power"] = [program.sum(*self.power)] if self.power else []
            program.named |= {"KE": [self.kinetic()], "PE": [self.potential()]}
        return program

    def kinetic(self) -> Slot:
        """1/2 sum of A_jj w_j^2, and of Re(conj(E_j') A_jk E_k')."""
        program = self.program
        terms: list[Term] = []
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
        terms: list[Term] = []
        for k in range(mechanism.n):
            weight = program.planar_number(-mechanism.weights[k])
            if weight != (0.0, 0.0):
                down = program.planar_sum((weight, self.E[k]))
                terms.append((1.0, program.add(RealPart(down))))
            if mechanism.moments[k]:
                terms.append((number(-mechanism.moments[k]), self.alpha(k)))
        terms += self._spring_energies()
        return program.sum(*terms)

    def _chain(self) -> None:
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
            self.F[k].append(((re, -im), h[k]))
            self.constants[k] += mechanism.gamma * mechanism.B[k].conjugate()
        s: list[Slot] = [-1] * mechanism.n
        for k in reversed(mechanism.order):
            below: list[PlanarTerm] = [((1.0, 0.0), s[c]) for c in self.children[k]]
            for c, (re, im) in ((c, at[c]) for c in self.children[k]):
                self.F[k].append(((re, -im), s[c]))
            s[k] = program.planar_sum((B[k], self.P[k]), *below)

    def _closures(self) -> list[Slot]:
        """The rows of the closures, and what their multipliers do."""
        program = self.program
        multipliers: list[Slot] = []
        gaps = program.named["gap"] = []
        pins: dict[tuple[int | None, int], PlanarCoefficient] = {}
        self._rows: list[Slot] = []
        for r, row in enumerate(self.mechanism.rows):
            mu = program.add(Unknown(f"mu{r}"))
            multipliers.append(mu)
            total: list[Term] = []
            terms: list[PlanarTerm] = []
            for k, p in row.P:
                # the two rows of a pin share their numbers, turned by a right angle
                pin = pins.get((row.closure, k))
                re, im = program.planar_number(p) if pin is None else (pin[1], -pin[0])
                if row.closure is not None and row.direction == 1.0:
                    pins[row.closure, k] = re, im
                terms.append(((re, im), self.E[k]))
                self.F[k].append(((re, -im), mu))
            if terms:
                total.append((1.0, program.add(RealPart(program.planar_sum(*terms)))))
            for k, turn in row.angles:
                angle = program.number(turn)
                total.append((angle, self.alpha(k)))
                self.moments[k].append((angle, mu))
            gap = program.sum(*total, constant=program.number(row.offset))
            gaps.append(gap)
            self._rows.append(program.add(Derivative(program.add(Derivative(gap)))))
        return multipliers
