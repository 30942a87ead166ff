"""The equations of motion of a scene as rows: the only place where its mechanics is written.

With X_k = E_k, the directions of links that turn, and X_k = s_k E_d of those that slide on link d
(E_d = 1 on the ground), a_k and s_k'' their accelerations, P_k = X_k'', the constants of
`mechanism.py`, and mu_r = -lambda_r for each closure row:

    F_k = sum_j A_kj P_j - conj(weight_k) + sum_r conj(R_rk) mu_r - sum conj(c_k) f
    0 = A_dd a_d + Im(conj(E_d) (F_d + sum_{k on d} s_k F_k)) + sum_r angles_rd mu_r - moment_d
        - (T_d - sum of those of joints that turn against link d)
    0 = Re(conj(E_d) F_k) + sum_r angles_rk mu_r - T_k        of each k that slides
    0 = gap_r'',      gap_r = Re(sum_k R_rk X_k) + sum_k angles_rk x_k + offset_r

A_dd P_d is left out of F_d; as A_dd a_d it is exact.  For a line on link l, mu conj(R) of the gap
Re(conj(E_l) sum R X) is mu E_l conj(R), and link l feels the opposite about its own origin.  A
rotor on link d spins with s = w_d + N qd_k and adds J s' to the row of d (if d turns), and -N J s'
to T_k. f are forces at points with coefficients c_k, and T torques at joints, written by the kinds
in `elements`.  A new kind of either is added there, and every engine then has it.
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn.elements.base import Element
from robodyn.elements.builder import Builder, Name, PlanarTerm, Term
from robodyn.elements.program import (
    Coefficient,
    Derivative,
    Inner,
    Moment,
    PlanarCoefficient,
    PlanarSum,
    Product,
    Program,
    RealPart,
    Scaled,
    Slot,
    Unknown,
)
from robodyn.mechanics.expression_rows import Slotted
from robodyn.mechanics.planar_model import ClosureRow, Mechanism
from robodyn.scene.scene import Curve, Law, Signal, Table


class EquationsOfMotion(Builder):
    """Writes the program of a scene.

    `program.named` has the slots of x (n: E, or s), mu (r), gap (r), load (n: of coordinates,
    without joint torques), edges (of pieces of tables, see `signal_rows`), power, KE and PE.
    """

    mechanism: Mechanism

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__(mechanism)
        self.tables: list[tuple[Table, Slot]] = []  # and what they are over
        self.laws: list[tuple[Law, Slot]] = []  # and what they are

    def write(
        self,
        torques: Sequence[Slot | None],
        work: bool = False,
        steady: bool = False,
        chained: bool = False,
    ) -> Program:
        """Write the residuals, with joint torques tau (n; None for no torque).

        With `work`, `named` has the energies (PE without its constant), and the power of torques
        and of forces without potential.  The power of `steady` torques is left out, as their work
        is tau times the displacement.  With `chained`, sums over A run along the tree, which is
        cheaper in deep trees.
        """
        mechanism, program, n = self.mechanism, self.program, self.mechanism.n
        mechanism.check_masses()
        mechanism.check_rubbing("formulas")
        number = program.planar_number
        inertia: list[Coefficient] = [0.0] * n
        slides = set(mechanism.slides)
        chained = chained and not slides
        for j, k, value in mechanism.A:
            if j == k:
                inertia[j] = program.number(value.real)
                if j in slides:
                    self.F[j].append(((inertia[j], 0.0), self.P[j]))
            elif not chained:
                re, im = program.planar_number(value)
                self.F[j].append(((re, im), self.P[k]))
                self.F[k].append(((re, -im), self.P[j]))
        if chained:
            self._chain()
        self.work = work
        self._scene_forces()
        self._joints(torques, steady)
        self._spun()
        multipliers = self._closures()
        F = [
            program.add(PlanarSum(number(c), tuple(x)))
            for c, x in zip(self.constants, self.F, strict=True)
        ]
        turned: list[list[int]] = [[] for _ in F]  # joints that turn against each link's frame
        for k, above in enumerate(mechanism.above):
            if above is not None:
                turned[above].append(k)
        # those that slide first: their forces are kept in the frames that others read them in then
        loads = [-1] * n
        for k in (*mechanism.slides, *(k for k in range(n) if k not in slides)):
            loads[k] = self._load(k, F, inertia[k])
        for k in range(n):
            given = [(-1.0, self.torques[k]), *((1.0, self.torques[c]) for c in turned[k])]
            acting = [(sign, torque) for sign, torque in given if torque is not None]
            program.residuals.append(program.sum((1.0, loads[k]), *acting))
        program.residuals += self._rows
        program.named |= {"x": self.x, "mu": multipliers, "load": loads}
        if work:
            program.named["power"] = [program.sum(*self.power)] if self.power else []
            program.named |= {"KE": [self.kinetic()], "PE": [self.potential()]}
        return program

    def _load(self, k: int, F: Sequence[Slot], inertia: Coefficient) -> Slot:
        """Return the load that turns link k, or moves it along its axis.

        Torques at joints are not included.
        """
        program, mechanism = self.program, self.mechanism
        if k in mechanism.slides:
            d = mechanism.frames[k]
            along = RealPart(F[k]) if d is None else Inner(self.x[d], F[k])
            return program.sum((1.0, program.add(along)), *self.moments[k])
        carried = [
            program.add(Scaled(self.x[j], F[j]))
            for j in mechanism.slides
            if mechanism.frames[j] == k
        ]
        force = F[k]
        if carried:
            force = program.planar_sum(*(((1.0, 0.0), z) for z in (F[k], *carried)))
        turning = program.add(Moment(self.x[k], self.P[k], inertia, force))
        moment = program.number(-mechanism.moments[k])
        return program.sum((1.0, turning), *self.moments[k], constant=moment)

    def signal(self, signal: Signal, name: Name, x: Slot | None = None) -> Slot:
        """Return the value of a signal, at a spring's extension x."""
        from robodyn.mechanics.signal_rows import signal_rows  # only scenes with signals import it

        own = {} if x is None else {"x": x, "v": self.rate(x)}
        slot = signal_rows(self, signal, own)
        if isinstance(signal, Table):
            self.tables.append((signal, self.variable(signal.over) if x is None else x))
        if isinstance(signal, Law):
            self.laws.append((signal, slot))
        return slot

    def stored(self, law: Signal, x: Slot) -> Slot:
        """Return the energy of a spring at its extension x."""
        from robodyn.mechanics.signal_rows import stored_energy

        return stored_energy(self, law, x)

    def _scene_forces(self) -> None:
        on_links = (x for x in self.mechanism.elements if x.at is None and x.acts)
        for element in sorted(on_links, key=lambda x: x.rank):
            self.write_rows(element)

    def _joints(self, torques: Sequence[Slot | None], steady: bool) -> None:
        """Write torques at the joints; the parent link gets the opposite."""
        here: list[list[Element]] = [[] for _ in torques]
        for element in self.mechanism.elements:
            if element.at is not None:
                here[element.at].append(element)
        for j, tau in enumerate(torques):
            if tau is not None:
                self.torque(j, 1.0, tau, spends=not steady)
            if self.mechanism.damping[j]:
                self.torque(j, self.number(-self.mechanism.damping[j]), self.v(j))
            for element in sorted(here[j], key=lambda x: x.rank):
                self.write_rows(element)
            acting, constant = self._acting[j], self._constant[j]
            if acting or constant:
                self.torques[j] = self.sum(*acting, constant=self.number(constant))

    def _spun(self) -> None:
        """Write the effect of rotors."""
        for k, d, inertia, ratio, bend in self._rotors:
            before = self.torques[k]
            own: list[Term] = [] if before is None else [(1.0, before)]
            self.torques[k] = self.sum(*own, (self.number(-inertia * ratio), bend))
            if d is not None:
                self.moments[d].append((self.number(inertia), bend))

    def kinetic(self) -> Slot:
        """Return KE: A_jj w_j^2/2 or A_jj |X_j'|^2/2, Re(conj(X_j') A_jk X_k'), elements."""
        program = self.program
        terms: list[Term] = []
        for j, k, value in self.mechanism.A:
            if j == k and j not in self.mechanism.slides:
                half = program.number(0.5 * value.real)
                terms.append((half, program.add(Product(self.w(j), self.w(j)))))
                continue
            one, other = (self._moving(i) for i in (j, k))
            moved = program.planar_sum((program.planar_number(value), other))
            terms.append((1.0 if j != k else 0.5, program.add(Inner(one, moved))))
        for element in self.mechanism.elements:
            terms += element.kinetic(self)
        return program.sum(*terms)

    def _moving(self, k: int) -> Slot:
        """Return X_k' as a planar slot."""
        rate = self.program.add(Derivative(self.X[k]))
        if self.program.planar[rate]:
            return rate
        return self.program.planar_sum(((1.0, 0.0), rate))

    def potential(self) -> Slot:
        """Return PE of weights, constant moments, and springs."""
        program, number, mechanism = self.program, self.program.number, self.mechanism
        terms: list[Term] = []
        for k in range(mechanism.n):
            weight = program.planar_number(-mechanism.weights[k])
            if weight != (0.0, 0.0):
                down = program.planar_sum((weight, self.X[k]))
                terms.append((1.0, program.add(RealPart(down))))
            if mechanism.moments[k]:
                terms.append((number(-mechanism.moments[k]), self.coordinate(k)))
        for element in self.mechanism.elements:
            terms += element.energy(self)
        return program.sum(*terms)

    def _chain(self) -> None:
        """Write the sums over A in O(links).

        A_jk = conj(p_jk) B_k, with p_jk the point where the path leaves link j, turned by welds as
        the link's frame is.  So links above k act through the acceleration h_k of its joint, less
        gravity, and links below through sums s_c of B P.
        """
        program, mechanism = self.program, self.mechanism
        B = [program.planar_number(b) for b in mechanism.B]
        hung = (link.hangs_from for link in mechanism.description.links)
        places = (p.at if p.link is None else mechanism.tree.turned(p.link, p.at) for p in hung)
        at = [program.planar_number(place) for place in places]
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
        """Write the rows of the closures, and the forces of their multipliers."""
        program, number = self.program, self.program.planar_number
        multipliers: list[Slot] = []
        gaps = program.named["gap"] = []
        pins: dict[tuple[int | None, int], PlanarCoefficient] = {}
        self._rows: list[Slot] = []
        for r, row in enumerate(self.mechanism.rows):
            mu = program.add(Unknown(f"mu{r}"))
            multipliers.append(mu)
            total: list[Term] = []
            terms: list[PlanarTerm] = []
            line = None if row.line is None else self.x[row.line]
            pull = mu if line is None else program.add(Scaled(mu, line))
            for k, p in row.P:
                # the two rows of a pin share their numbers, turned by a right angle
                pin = pins.get((row.closure, k)) if row.direction == 1j else None
                re, im = number(p) if pin is None else (pin[1], -pin[0])
                if row.closure is not None and row.direction == 1.0:
                    pins[row.closure, k] = re, im
                terms.append(((re, im), self.X[k]))
                self.F[k].append(((re, -im), pull))
            if line is not None:
                across = program.add(PlanarSum(number(row.ground), tuple(terms)))
                total.append((1.0, program.add(Inner(line, across))))
                turned = program.planar_sum(((0.0, -1.0), across))  # d gap/d alpha of the line
                moment = program.add(Product(mu, program.add(Inner(line, turned))))
                assert row.line is not None
                self.moments[row.line].append((1.0, moment))
            elif terms:
                total.append((1.0, program.add(RealPart(program.planar_sum(*terms)))))
            for k, turn in row.angles:
                angle = program.number(turn)
                total.append((angle, self.coordinate(k)))
                self.moments[k].append((angle, mu))
            drift = program.sum() if self.mechanism.driven else -1
            if row.law is not None:
                term, drift = self._law(row, mu)
                total.append(term)
            gap = program.sum(*total, constant=program.number(row.offset))
            gaps.append(program.sum() if row.held else gap)
            if self.mechanism.driven:
                program.named.setdefault("drift", []).append(drift)
            self._rows.append(program.add(Derivative(program.add(Derivative(gap)))))
        return multipliers

    def _law(self, row: ClosureRow, mu: Slot) -> tuple[Term, Slot]:
        """Return what the law f of a coupling adds to its gap, -arm f; and -arm df/dt.

        mu acts on the joints of f by their derivatives, and does work by the derivative by t.
        """
        from robodyn.mechanics.law_rows import LawRows

        assert row.law is not None
        program, laws = self.program, LawRows(self.program, self.variable)
        value, drift = laws.value(row.law), program.sum()
        names = sorted(row.law.names)
        for name, slope in zip(names, laws.slopes(value, names), strict=True):
            if isinstance(slope, Slotted):
                c, pull = program.number(-row.arm), program.add(Product(int(slope), mu))
            else:
                c, pull = program.number(-row.arm * slope), mu
            if name == "t":
                drift = program.sum((program.number(-row.arm), laws.made.slot(slope)))
                if self.work:
                    self.works(c, pull)
                continue
            joint = int(name[1:])
            self.moments[joint].append((c, pull))
            if (above := self.mechanism.above[joint]) is not None:
                self.moments[above].append((-c, pull))
        slot = laws.made.slot(value)
        if isinstance(row.law, Curve):
            program.named.setdefault("edges", []).extend(laws.edges(row.law))
        return (program.number(-row.arm), slot), drift
