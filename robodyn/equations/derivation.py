"""The derivation of the equations of motion, as one writes it on a board.

    velocities -> KE, PE -> L = KE - PE -> d/dt dL/dqd - dL/dq = tau + .. -> loops, lambda

A velocity is a sum of parts, each with the joints that it was turned through.  So squares are
formed part by part, and no identity of sines is needed.  KE is a sum of products; everything else
follows from it by the product rule, with a table of derivatives of its atoms.  M, G, Psi, Psidot qd
and gap are written as in the equations; M agrees with KE product by product.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

from robodyn.elements.loads import Force, Moment
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.equations.factoring import (
    as_one,
    by_angle,
    by_cosines,
    by_function,
    by_role,
    difference_of,
    in_writing_order,
    simplified,
    written,
)
from robodyn.equations.named_laws import Formula
from robodyn.equations.notation import PLAIN, one_line
from robodyn.equations.outline import Equations
from robodyn.equations.parameters import Parameter
from robodyn.equations.quadratic_forms import (
    Form,
    Linear,
    difference_of_squares,
    factored,
    forms_of,
    rate_of,
)
from robodyn.equations.symbolic import (
    ONE,
    ZERO,
    Atom,
    Monomial,
    Number,
    Planar,
    Role,
    Sum,
    expanded,
    of,
    slope,
    summed,
    total,
)
from robodyn.equations.written import in_place
from robodyn.errors import InputError, printable
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Closure, Point

MOST_LINKS = 8
LONG_ENTRY = 90  # letters of an entry of M, above which entries are called by their names
LONG_ENERGY = 500  # letters of KE and L, above which they are left as sums of names
SPRINGS = PointSpring, JointSpring
HALF = Fraction(1, 2)
BY_RATE = (by_role(Role.normal), by_role(Role.rate), by_function)
FORM = (as_one, by_angle, by_function)


class Name(NamedTuple):
    """A name in plain text, in LaTeX, and in the syntax of Python."""

    plain: str
    latex: str
    code: str = ""

    @property
    def identifier(self) -> str:
        """The name in Python."""
        return self.code or self.plain


class Vector(NamedTuple):
    """Components of a vector."""

    x: Sum
    y: Sum


class Carried(NamedTuple):
    """The velocity of the joint of link k from that of link `above` (None: the ground).

    R^T (v + omega x arm) [+ omega x (q, 0) + (qd, 0)]: R turns by the angle of joint k.  That angle
    is measured from `along`; for a sliding joint `along` is its axis.  None means the x axis.
    """

    k: int
    above: int
    arm: Vector
    slides: bool = False
    along: Vector | None = None
    turning: bool = True  # whether link `above` turns


class Turned(NamedTuple):
    """A vector of the frame above, expressed in the frame of link k: R^T times the vector."""

    k: int
    vector: Vector
    along: Vector | None = None


class Offset(NamedTuple):
    """The velocity of a point of link k from that of its joint, v + omega x arm."""

    k: int
    arm: Vector


class Groups(NamedTuple):
    """A sum in groups of terms; if it is too long for a line, each group begins a line.

    If a group is still too long, each of its terms begins a line.
    """

    parts: tuple[tuple[Sum, ...], ...]


Right = Sum | Formula | Vector | Carried | Turned | Offset | Groups


class Line(NamedTuple):
    """An equation left = right = ..; without `right`, a sentence or formulas."""

    left: Name | Sum | None = None
    right: tuple[Right, ...] = ()
    told: tuple[str | Vector, ...] = ()  # the words, and what stands between them
    latex: str = ""  # the same as mathematics; empty of a sentence


class Section(NamedTuple):
    """A heading with blocks of lines that belong together."""

    title: str
    blocks: tuple[tuple[Line, ...], ...]


class Part(NamedTuple):
    """A part c exp(-i turn) rate of a velocity in its link's frame, or c exp(i turn) of a place.

    `turn` lists the joints that turn it.
    """

    c: Planar
    turn: tuple[int, ...]
    rate: Sum = ONE


Parts = tuple[Part, ...]


def check_size(mechanism: Mechanism) -> None:
    """Raise InputError if a mechanism has too many links for a derivation, or no masses."""
    if mechanism.n > MOST_LINKS:
        limit = f"at most {MOST_LINKS} links; the equations without --steps have no limit"
        value = f"{mechanism.n} links"
        raise InputError("--steps", where=mechanism.source, value=value, limit=limit)
    mechanism.check_masses(still=True)


def check_potentials(mechanism: Mechanism) -> None:
    """Raise InputError for an element whose potential energy cannot be derived."""
    for place, element in mechanism.description.elements:
        parts = (x.stored() for x in element.placed(mechanism.tree))
        if not isinstance(element, SPRINGS) and any(x is not None for x in parts):
            limit = "has a potential energy that --steps cannot derive"
            raise InputError(place, where=mechanism.source, limit=limit)


def said(*told: str | Vector) -> Line:
    """Return a line that is a sentence of words and vectors."""
    return Line(told=told)


def shown(plain: str, latex: str) -> Line:
    """Return a line of formulas, as text and in LaTeX."""
    return Line(told=(plain,), latex=latex)


def entry_name(letter: str, *numbers: int, latex: str = "") -> Name:
    """Return the name of an entry, such as M12, Psi21, (Psidot qd)1; `numbers` count from 0."""
    index = "".join(str(k + 1) for k in numbers)
    plain = f"({letter}){index}" if " " in letter else f"{letter}{index}"
    return Name(plain, f"{latex or letter}_{{{index}}}", letter.replace(" ", "_") + index)


class Derivation:
    """The derivation of a scene's equations: its `sections`, and the `names` used in them.

    Raises InputError for more than MOST_LINKS links, and for an element with unknown potential
    energy.
    """

    def __init__(self, equations: Equations[Sum]) -> None:
        self.equations, self.mechanism = equations, equations.mechanism
        mechanism = self.mechanism
        check_size(mechanism)
        check_potentials(mechanism)
        self.names: dict[str, Name] = {}  # of the atoms that stand for formulas
        self.n, self.joints = mechanism.n, range(mechanism.n)
        self.scene: Any = equations.known.scene
        self.links = self.scene.links
        self.tree = Tree(self.links)
        self.blocks = {block.name: block for block in equations.blocks}
        self.paths: dict[int | None, tuple[int, ...]] = {None: ()}  # joints that turn each link
        self.units: dict[int | None, Planar] = {None: Planar(ONE, ZERO)}  # axes on the way there
        self.moved: dict[int, Parts] = {}
        self.places: dict[int, Parts] = {}
        for k in self.tree.order:
            self._place_link(k)
        M = self.blocks["M"].rows
        lengths = (len(one_line(PLAIN.text(entry))) for row in M for entry in row)
        self.folded = max(lengths) > LONG_ENTRY
        self.kinetic = [self._kinetic(k) for k in self.joints]
        self.KE = simplified(total(flat for flat, _ in self.kinetic))
        self.M = [[self._inertia(i, j) for j in self.joints] for i in self.joints]
        for i, row in enumerate(M):
            if any(by_cosines(expanded(x) - y) for x, y in zip(row, self.M[i], strict=True)):
                raise AssertionError(f"row {i + 1} of M is not that of the kinetic energy")
        self.potential = [*self._weights(), *self._springs(), *self._loads()]

    @cached_property
    def sections(self) -> list[Section]:
        """All sections that are not empty, numbered."""
        told: list[tuple[str, Iterator[list[Line]]]] = [
            ("Frames and angles", self._frames()),
            ("Velocities, each in its link's own frame", self._velocities()),
            ("Kinetic energy", self._kinetic_energy()),
            ("Potential energy", self._potential_energy()),
            ("Lagrangian", self._lagrangian()),
            ("Derivatives of the Lagrangian", self._derivatives()),
            ("Equations of motion, collected", self._motion()),
            ("What acts beside the joint torques", self._beside()),
            ("Loops", self._loops()),
        ]
        found: list[Section] = []
        for title, blocks in told:
            kept = tuple(tuple(block) for block in blocks if block)
            if kept:
                found.append(Section(f"{len(found) + 1}. {title}", kept))
        return found

    @property
    def further_symbols(self) -> list[Parameter]:
        """Symbols of the scene that occur in the steps but not in the equations."""
        used: set[str] = set()
        for section in self.sections:
            for line in (line for block in section.blocks for line in block):
                used |= {x.name for x in _atoms((line.left, *line.right, *line.told))}
        known = self.equations.known.known.values()
        return [x for x in known if x.name in used - self.equations.used]

    # -- numbers, names and sums -------------------------------------------------------------------

    def put(self, entry: Any) -> Any:
        """Return a sum, with the scene's numbers for its symbols if the derivation is numeric."""
        known = self.equations.known
        return entry.substituted(known.values) if self.equations.numeric else entry

    def atom(self, name: Name) -> Atom:
        """Return a name as a factor."""
        self.names[name.identifier] = name
        return Atom(Role.stretch, (0, name.identifier), name.identifier)

    def named(self, letter: str, *numbers: int, latex: str = "") -> Sum:
        """Return the name of an entry as a sum."""
        return of(self.atom(entry_name(letter, *numbers, latex=latex)))

    def vector(self, at: Any) -> Vector:
        """Return a point or direction as a vector."""
        return Vector(self.put(summed(at.real)), self.put(summed(at.imag)))

    def omega(self, k: int | None) -> Sum:
        """Return the angular velocity of a link; zero if it cannot turn."""
        path = self.paths[k]
        return of(Atom(Role.rate, path)) if path else ZERO

    def fold(self, entry: Sum) -> Sum:
        """Return a sum with omega_k for sums of rates, in scenes where M has named entries."""
        if not self.folded:
            return entry

        def renamed(x: Any) -> Any:
            if isinstance(x, Sum):
                return self.fold(x)
            return self._turning(x.place) if x.role == Role.rate else x

        terms = entry.terms.items()
        return Sum({tuple((renamed(x), power) for x, power in m): number for m, number in terms})

    def _turning(self, place: tuple[int, ...], least: int = 2) -> Atom:
        """Return the sum of rates of these joints; omega_k if link k turns so.

        Sums of fewer than `least` rates are written out.
        """
        k = next((k for k in self.joints if self.paths[k] == place), None)
        if len(place) < least or k is None:
            return Atom(Role.rate, place)
        name = entry_name("omega", k, latex=r"\omega")
        self.names[name.plain] = name
        return Atom(Role.rate, place, name.plain)

    # -- where links are, and how they move --------------------------------------------------------

    def _place_link(self, k: int) -> None:
        """Store path, axes, place and velocity of the joint of link k."""
        link = self.links[k]
        above, at = link.hangs_from.link, planar(link.hangs_from.at)
        path, unit = self.paths[above], self.units[above]
        place = self.places[above] if above is not None else ()
        place = (*place, Part(unit * at, path)) if at else place
        moved = self.point_velocity(above, at) if above is not None else ()
        if not link.slides:
            turn = planar(link.turn)
            self.paths[k], self.units[k] = tuple(sorted((*path, k))), unit * turn
            self.moved[k] = tuple(
                Part(c * turn.conjugate(), tuple(sorted((*x, k))), rate) for c, x, rate in moved
            )
        else:
            axis, q = planar(link.axis), of(Atom(Role.angle, (k,)))
            self.paths[k], self.units[k] = path, unit * axis
            place = (*place, Part(self.units[k] * Planar(q, ZERO), path))
            turned = [x._replace(c=x.c * axis.conjugate()) for x in moved]
            turned += [Part(Planar(ZERO, q), (), self.omega(above))] if path else []
            self.moved[k] = *turned, Part(Planar(ONE, ZERO), (), of(Atom(Role.rate, (k,))))
        self.places[k] = place

    def point_velocity(self, k: int, at: Planar) -> Parts:
        """Return the velocity of a point of link k in its frame."""
        if not at or not self.paths[k]:
            return self.moved[k]
        return *self.moved[k], Part(Planar(-at.imag, at.real), (), self.omega(k))

    def point_place(self, point: Point) -> Parts:
        """Return the place of a point in the ground's frame."""
        return self._place_on(point.link, planar(point.at))

    def _place_on(self, k: int | None, at: Planar) -> Parts:
        place = self.places[k] if k is not None else ()
        return (*place, Part(self.units[k] * at, self.paths[k])) if at else place

    def components(self, parts: Parts, sign: int) -> Vector:
        """Return the components of the sum of c exp(i sign turn) rate."""
        x, y = ZERO, ZERO
        for c, turn, rate in parts:
            cos, sin = cosine(turn), sine(turn)
            x = total((x, (c.real * cos - (c.imag * sin).times(sign)) * rate))
            y = total((y, ((c.real * sin).times(sign) + c.imag * cos) * rate))
        return Vector(*(self.put(simplified(each)) for each in (x, y)))

    def velocity(self, parts: Parts) -> Vector:
        """Return a velocity in the form in which it is written."""
        return Vector(*(written(each, BY_RATE) for each in self.components(parts, -1)))

    # -- kinetic energy ----------------------------------------------------------------------------

    def _kinetic(self, k: int) -> tuple[Sum, tuple[Sum, ...]]:
        """Return the kinetic energy of link k, with payload and rotor: expanded, and as written."""
        link, flat, pieces = self.links[k], [], []
        masses = [(summed(link.m), planar(link.r))]
        masses += [(summed(link.payload), Planar(summed(link.l), ZERO))]
        for m, at in masses:
            squares = [*squared(self.point_velocity(k, at))] if m else []
            if squares:
                flat += [(m * x).times(HALF) for x in squares]
                pieces.append(self._halved(m, squares))
            if at is masses[0][1] and link.I and self.paths[k]:
                spin = summed(link.I) * self.omega(k) ** 2
                flat.append(spin.times(HALF))
                pieces.append(self._halved(summed(link.I), [self.omega(k) ** 2]))
        if link.motor is not None and link.motor.inertia:
            carrier = link.hangs_from.link
            own = summed(link.motor.ratio) * of(Atom(Role.rate, (k,)))
            squares = [own**2]
            if self.paths[carrier]:
                squares = [self.omega(carrier) ** 2, own**2, (own * self.omega(carrier)).times(2)]
            inertia = summed(link.motor.inertia)
            flat += [(inertia * x).times(HALF) for x in squares]
            pieces.append(self._halved(inertia, squares))
        whole = self.put(simplified(total(flat)))
        if self.equations.numeric:
            pieces = [whole] if whole else []
        return whole, tuple(pieces)

    def _halved(self, mass: Sum, squares: Sequence[Sum]) -> Sum:
        """Return 1/2 m (..), with each square and each product of two parts as written."""
        terms: dict[Monomial, Number] = {}
        for each in squares:
            terms |= written(each, (as_one, by_function)).terms
        return bracketed(mass, Sum(terms), HALF)

    def _inertia(self, i: int, j: int) -> Sum:
        """Return M_ij, the second derivative of KE by the rates i and j."""

        def by_rate(k: int) -> Callable[[Atom], Sum]:
            return lambda x: ONE if x.role == Role.rate and k in x.place else ZERO

        return simplified(slope(slope(self.KE, by_rate(i)), by_rate(j)))

    # -- potential energy --------------------------------------------------------------------------

    def _weights(self) -> Iterator[tuple[Name, tuple[Sum, ...]]]:
        """Yield name and potential energy of each link's weight and payload."""
        gx, gy = planar(self.scene.gravity).real, planar(self.scene.gravity).imag
        for k, link in enumerate(self.links):
            pieces = []
            for m, at in ((link.m, link.r), (link.payload, Planar(summed(link.l), ZERO))):
                x, y = self.components(self._place_on(k, planar(at)), 1)
                height = -(self.put(summed(m)) * (self.put(gx) * x + self.put(gy) * y))
                pieces += [written(height, (as_one,))] if height else []
            yield entry_name("PE", k), tuple(pieces)

    def _springs(self) -> Iterator[tuple[Name, tuple[Sum, ...]]]:
        """Yield name and energy of each spring, expanded if G is, else by its length."""
        pulls = {x.name for x in self.blocks["G"].where} if "G" in self.blocks else set()
        for i, spring in enumerate(self.scene.springs):
            if not isinstance(spring, SPRINGS):
                continue
            name = Name(f"PEs{i + 1}", rf"PE_{{s{i + 1}}}")
            stiffness = summed(spring.stiffness or 0)
            if f"H{i + 1}" in pulls:
                yield name, (of(self.atom(name)),)
            elif not stiffness:
                continue
            elif isinstance(spring, JointSpring):
                stretch = of(Atom(Role.angle, (spring.joint,))) - summed(spring.angle)
                yield name, (bracketed(self.put(stiffness), self.put(stretch), HALF, 2),)
            elif f"K{i + 1}" in pulls:
                stretch = of(Atom(Role.stretch, (i, ""), f"S{i + 1}")) - summed(spring.length)
                yield name, (bracketed(self.put(stiffness), self.put(stretch), HALF, 2),)
            else:
                ends = self._between(spring)
                square = self.put(simplified(total(squared(ends, -1))))
                yield name, (bracketed(self.put(stiffness), written(square, FORM), HALF),)

    def _between(self, item: PointSpring | Closure) -> Parts:
        """Return the first end less the second, without parts that cancel."""
        found: dict[tuple[int, ...], Planar] = {}
        for sign, point in ((1, item.first), (-1, item.second)):
            for c, turn, _ in self.point_place(point):
                each = c if sign > 0 else -c
                found[turn] = found[turn] + each if turn in found else each
        return tuple(Part(c, turn) for turn, c in found.items() if c)

    def _loads(self) -> Iterator[tuple[Name, tuple[Sum, ...]]]:
        """Yield name and potential energy of constant loads."""
        for i, load in enumerate(self.scene.loads):
            name = Name(f"PEl{i + 1}", rf"PE_{{l{i + 1}}}")
            if isinstance(load, Moment):
                path = self.paths[load.link]
                if load.varying is None and load.torque and path:
                    turned = total(of(Atom(Role.angle, (k,))) for k in path)
                    yield name, (bracketed(self.put(summed(load.torque)), turned, -1),)
            elif isinstance(load, Force) and self._constant(load):
                force, k = planar(load.force), load.point.link
                force = force * planar(load.turn) * self.units[k] if load.turns else force
                x, y = self.components(self.point_place(load.point), 1)
                energy = -(self.put(force.real) * x + self.put(force.imag) * y)
                if energy:
                    yield name, (written(energy, (by_role(Role.force), by_angle)),)

    def _constant(self, load: Force) -> bool:
        """Return whether a force has a potential: it neither varies nor turns."""
        steady = not load.varied and not load.moves
        return steady and not (load.turns and self.paths[load.point.link])

    # -- slopes ------------------------------------------------------------------------------------

    def by_joint(self, joint: int) -> Callable[[Atom], Sum]:
        """Return a function that differentiates atoms by q of a joint."""

        def found(atom: Atom) -> Sum:
            if atom.role == Role.angle:
                return ONE if atom.place == (joint,) else ZERO
            if atom.role == Role.function and atom.speed is None:
                return derived(atom).times(rate_of(atom.place).get(joint, 0))
            return ZERO

        return found

    @staticmethod
    def by_time(atom: Atom) -> Sum:
        """Return the time derivative of an atom, with rates held."""
        if atom.role == Role.angle:
            return of(Atom(Role.rate, atom.place))
        if atom.role == Role.function and atom.speed is None:
            found: Sum = derived(atom) * of(Atom(Role.rate, atom.place))
            return found
        return ZERO

    @cached_property
    def bent(self) -> list[Sum]:
        """dKE/dq_i for each joint."""
        return [simplified(slope(self.KE, self.by_joint(i))) for i in self.joints]

    @cached_property
    def changing(self) -> list[Sum]:
        """(Mdot qd)_i for each joint: the part of d/dt dL/dqd_i without accelerations."""
        rates = [of(Atom(Role.rate, (j,))) for j in self.joints]
        rows = (
            (slope(entry, self.by_time) * rate for entry, rate in zip(row, rates, strict=True))
            for row in self.M
        )
        return [simplified(total(row)) for row in rows]

    @cached_property
    def coriolis(self) -> list[Sum]:
        """(C qd)_i = (Mdot qd)_i - dKE/dq_i for each joint."""
        pairs = zip(self.changing, self.bent, strict=True)
        return [simplified(moving - bent) for moving, bent in pairs]

    # -- how terms with two rates are written ------------------------------------------------------

    def forms(self, flat: Sum) -> list[Sum]:
        """Split a sum of terms with two rates into its quadratic forms."""
        found = []
        for form, before in forms_of(in_place(flat, "C")):
            rates, number = self._rates(form)
            coefficient = written(before.times(number), FORM)
            if len(coefficient.terms) == 1:
                ((factors, times),) = coefficient.terms.items()
            else:
                times = 1 if next(iter(coefficient.terms.values())) > 0 else -1
                factors = ((coefficient.times(times), 1),)
            found.append(Sum({in_writing_order((*factors, *rates)): times}))
        return found

    def _rates(self, form: Form) -> tuple[Monomial, Fraction]:
        """Return a quadratic form as factors, and the number before them."""
        turning = dict.fromkeys(path for path in self.paths.values() if path)
        if self.folded and (found := difference_of_squares(form, [*turning])) is not None:
            one, two, number = found
            if not two:
                return ((self._turning(one), 2),), number
            more, less = (of(self._turning(x, 1), 2) for x in (one, two))
            return ((more - less, 1),), number
        if (linear := factored(form)) is None:
            terms = {}
            for (j, k), x in form:
                pair = ((j, 2),) if j == k else ((j, 1), (k, 1))
                terms[tuple((Atom(Role.rate, (m,)), power) for m, power in pair)] = whole(x)
            return ((Sum(terms), 1),), Fraction(1)
        first, second, number = linear
        if first == second:
            return ((self._linear(first), 2),), number
        return ((self._linear(first), 1), (self._linear(second), 1)), number

    def _linear(self, form: Linear) -> Atom | Sum:
        """Return a sum of rates as one factor, by omega_k if the scene is folded."""
        joints = tuple(k for k, _ in form)
        if all(x == 1 for _, x in form):
            if len(form) == 1 or not self.folded or joints in self.paths.values():
                return self._turning(joints) if self.folded else Atom(Role.rate, joints)
            for one, two in combinations(self.paths.values(), 2):
                more, less = (one, two) if len(one) > len(two) else (two, one)
                if set(less) < set(more) and set(more) - set(less) == set(joints):
                    return of(self._turning(more, 1)) - of(self._turning(less, 1))
        return Sum({((Atom(Role.rate, (k,)), 1),): whole(x) for k, x in form})

    # -- sections ----------------------------------------------------------------------------------

    def _frames(self) -> Iterator[list[Line]]:
        lines = []
        for k, link in enumerate(self.links):
            above = link.hangs_from.link
            where = "the ground" if above is None else printable(self.links[above].name)
            at = self.vector(planar(link.hangs_from.at))
            told: list[str | Vector] = [f"{k + 1}  {printable(link.name)}, from ", at]
            told.append(f" of {where}: ")
            if link.slides:
                told += [f"slides by q{k + 1} along ", self.vector(link.axis)]
            else:
                turned = f"turned by q{k + 1}"
                if link.turn != 1.0:
                    told += [f"{turned} from ", self.vector(link.turn)]
                    turned = ""
                straight = self.units[k] == self.units[None]
                if len(self.paths[k]) > 1 and straight:
                    turned += f", by {' + '.join(f'q{j + 1}' for j in self.paths[k])} from +X"
                told.append(turned)
            lines.append(said(*told))
        yield lines

    def _velocities(self) -> Iterator[list[Line]]:
        for k, link in enumerate(self.links):
            above = link.hangs_from.link
            yield [self._angular(k), self._joint_velocity(k, above), *self._point_velocities(k)]

    def _angular(self, k: int) -> Line:
        """Return the line omega2 = omega1 + qd2 = qd1 + qd2."""
        above, path = self.links[k].hangs_from.link, self.paths[k]
        own = of(Atom(Role.rate, (k,)))
        rates = total(of(Atom(Role.rate, (j,))) for j in path)
        right: list[Right] = [rates]
        if above is not None and self.paths[above]:
            of_above = self.named("omega", above, latex=r"\omega")
            right.insert(0, of_above if self.links[k].slides else of_above + own)
        name = Name(f"omega{k + 1}", rf"{{}}^{{{k + 1}}}\omega_{{{k + 1}}}")
        return Line(name, tuple(right))

    def _joint_velocity(self, k: int, above: int | None) -> Line:
        """Return the line v2 = R(q2)^T (v1 + omega1 x (l1, 0)) = R(q2)^T (..) = (..)."""
        link, found = self.links[k], self.velocity(self.moved[k])
        right: list[Right] = []
        if above is not None and (self.moved[above] or self.paths[above] or link.slides):
            arm = self.vector(planar(link.hangs_from.at))
            from_x = self.vector(link.axis if link.slides else planar(link.turn))
            along = None if from_x == Vector(ONE, ZERO) else from_x
            right.append(Carried(k, above, arm, link.slides, along, bool(self.paths[above])))
            there = self.velocity(self.point_velocity(above, planar(link.hangs_from.at)))
            if not link.slides and there != Vector(ZERO, ZERO):
                right.append(Turned(k, there, along))
        name = Name(f"v{k + 1}", rf"{{}}^{{{k + 1}}}v_{{{k + 1}}}")
        return Line(name, (*right, found))

    def _point_velocities(self, k: int) -> Iterator[Line]:
        """Yield the velocities of the centre of gravity and of the payload."""
        link = self.links[k]
        points = [("C", link.m, planar(link.r)), ("P", link.payload, Planar(summed(link.l), ZERO))]
        for letter, m, at in points:
            if m:
                found = self.velocity(self.point_velocity(k, at))
                arm = self.vector(at) if self.paths[k] else Vector(ZERO, ZERO)
                name = Name(f"v{letter}{k + 1}", rf"{{}}^{{{k + 1}}}v_{{{letter}_{{{k + 1}}}}}")
                yield Line(name, (Offset(k, arm), found))

    def _kinetic_energy(self) -> Iterator[list[Line]]:
        lines, names = [], []
        for k, (flat, pieces) in enumerate(self.kinetic):
            name = entry_name("KE", k)
            lines.append(Line(name, (self.fold(joined(pieces)),)))
            names += [of(self.atom(name))] if flat else []
        whole = self.fold(joined(x for _, pieces in self.kinetic for x in pieces))
        yield [*lines, Line(Name("KE", "KE"), self._summed(names, whole))]

    def _summed(self, names: Sequence[Sum], whole: Sum) -> tuple[Right, ...]:
        """Return an energy as a sum of names, and written out if that is not too long."""
        right: list[Right] = [joined(names)]
        if len(one_line(PLAIN.text(whole))) <= LONG_ENERGY and (len(names) > 1 or not names):
            right.append(whole)
        return tuple(right)

    def _potential_energy(self) -> Iterator[list[Line]]:
        lines, names = [], []
        if "G" in self.blocks:
            lines += [Line(Name(x.name, ""), (x.value,)) for x in self.blocks["G"].where]
            for i, spring in enumerate(self.scene.springs):
                if any(x.name == f"H{i + 1}" for x in self.blocks["G"].where):
                    told = "stretch" if isinstance(spring, PointSpring) else "angle"
                    lines.append(said(f"PEs{i + 1} is the integral of H{i + 1} by its {told} x."))
        for name, pieces in self.potential:
            if pieces:
                energy = joined(pieces)
                if energy != of(self.atom(name)):
                    lines.append(Line(name, (energy,)))
                names.append(of(self.atom(name)))
        if names:
            lines.append(Line(Name("PE", "PE"), self._summed(names, self._whole_potential())))
            yield lines

    def _whole_potential(self) -> Sum:
        return joined(x for _, pieces in self.potential for x in pieces)

    def _lagrangian(self) -> Iterator[list[Line]]:
        KE, PE = (of(self.atom(Name(x, x))) for x in ("KE", "PE"))
        potential = self._whole_potential()
        whole = self.fold(joined(x for _, pieces in self.kinetic for x in pieces))
        whole = joined((whole, -potential))
        right: list[Right] = [joined((KE, -PE)) if potential else KE]
        if not self.folded and len(one_line(PLAIN.text(whole))) <= LONG_ENERGY:
            right.append(whole)
        yield [Line(Name("L", "L"), tuple(right))]

    def _inertial(self, i: int, letter: str) -> list[Sum]:
        """Return the terms of row i of M times rates or accelerations."""
        found, M = [], self.blocks["M"].rows
        for j in self.joints:
            if not M[i][j]:
                continue
            rate = Atom(Role.rate, (j,))
            if letter == "qdd":
                rate = self.atom(Name(f"qdd{j + 1}", rf"\ddot{{q}}_{{{j + 1}}}"))
            entry = M[i][j]
            if self.folded:
                entry = self.named("M", min(i, j), max(i, j))
            found.append(before_name(entry, rate))
        return [joined(found)] if self.folded and found else found

    def _gradient(self, i: int) -> list[Sum]:
        """Return G_i as written."""
        G = self.blocks["G"].rows[i][0] if "G" in self.blocks else ZERO
        return [G] if G else []

    def _derivatives(self) -> Iterator[list[Line]]:
        names = [
            Name(f"dL/dq{i + 1}", rf"\frac{{\partial L}}{{\partial q_{{{i + 1}}}}}")
            for i in self.joints
        ]
        yield [
            Line(name, (grouped(self.forms(self.bent[i]), [-x for x in self._gradient(i)]),))
            for i, name in enumerate(names)
        ]
        names = [
            Name(f"dL/dqd{i + 1}", rf"\frac{{\partial L}}{{\partial\dot{{q}}_{{{i + 1}}}}}")
            for i in self.joints
        ]
        yield [Line(name, (grouped(self._inertial(i, "qd")),)) for i, name in enumerate(names)]
        yield [
            Line(
                Name(f"d/dt {name.plain}", rf"\frac{{d}}{{dt}}{name.latex}"),
                (grouped(self._inertial(i, "qdd"), self.forms(self.changing[i])),),
            )
            for i, name in enumerate(names)
        ]

    def _motion(self) -> Iterator[list[Line]]:
        lines, passive = [], self.mechanism.passive
        for i in self.joints:
            parts = [self._inertial(i, "qdd"), self.forms(self.coriolis[i]), self._gradient(i)]
            parts += [self._damped(i), [-x for x in self._other(i)]]
            lines.append(Line(entry_name("tau", i, latex=r"\tau"), (grouped(*parts),)))
        if passive:
            undriven = " = ".join(f"tau{k + 1}" for k in passive)
            several = "these joints" if len(passive) > 1 else "this joint"
            lines.append(said(f"No motor drives {several}: {undriven} = 0."))
        yield lines
        split = [] if self.folded else [*self._split()]
        yield split
        told = ["What stands before qdd is M"]
        if any(self.coriolis):
            told.append("the terms with two rates are C qd")
            if split:
                told[-1] += " (of one rate squared: centripetal, of two: Coriolis)"
        if "D" in self.blocks:
            told.append("those with one are D qd")
        if "G" in self.blocks:
            told.append("those without are G")
        sentences = [said(f"{', '.join(told)}, as below.")]
        if self.mechanism.rows:
            sentences.append(said("The loops are not yet taken into account."))
        yield sentences

    def _split(self) -> Iterator[Line]:
        """Yield the centrifugal (squares) and Coriolis (products) parts of C qd."""
        for i in self.joints:
            squares: list[Sum] = []
            products: list[Sum] = []
            for form, before in forms_of(in_place(self.coriolis[i], "C")):
                for (j, k), x in form:
                    pair = of(Atom(Role.rate, (j,))) * of(Atom(Role.rate, (k,)))
                    (squares if j == k else products).append((before * pair).times(x))
            kinds = (("centripetal", squares), ("Coriolis", products))
            for kind, parts in kinds:
                if flat := simplified(total(parts)):
                    name = entry_name("C qd", i, latex=r"(C\dot{q})")
                    left = Name(
                        f"{kind} {name.plain}",
                        rf"\text{{{kind} }}{name.latex}",
                        f"{kind} {name.plain}",
                    )
                    yield Line(left, (grouped(self.forms(flat)),))

    def _damped(self, i: int) -> list[Sum]:
        """Return d_i qd_i."""
        D = self.blocks["D"].rows[i][i] if "D" in self.blocks else ZERO
        return [before_name(D, Atom(Role.rate, (i,)))] if D else []

    def _other(self, i: int) -> list[Sum]:
        """Return the name of Q_i if it is not zero."""
        Q = self.blocks["Q"].rows[i][0] if "Q" in self.blocks else ZERO
        return [self.named("Q", i)] if Q else []

    def _beside(self) -> Iterator[list[Line]]:
        lines = []
        if "Q" in self.blocks and not self.blocks["Q"].zero:
            told = "By virtual work Q is F . dr/dq of forces on points, and torques as they are."
            if any(isinstance(x, Force) and x.moves for x in self.scene.loads):
                told += " Where the place of a force along its link varies, r is the point there."
            lines.append(said(told))
            for i, load in enumerate(self.scene.loads):
                if isinstance(load, Force) and not self._constant(load):
                    at = planar(load.point.at)
                    for k, axis in enumerate("xy"):  # along the link, by a name
                        if load.moving[k] is not None:
                            letter = load.places[k].letter
                            c = of(Atom(Role.stretch, (i, axis), f"{letter}{i + 1}{axis}"))
                            way = Planar(ZERO, c) if k else Planar(c, ZERO)
                            at = at + planar(load.turn) * way
                    where = self.components(self._place_on(load.point.link, at), 1)
                    name = Name(f"r{i + 1}", rf"r_{{F_{{{i + 1}}}}}", f"rF{i + 1}")
                    lines.append(
                        Line(
                            name._replace(plain=f"rF{i + 1}"),
                            (Vector(*(written(x, BY_RATE) for x in where)),),
                        )
                    )
            for i, (Q,) in enumerate(self.blocks["Q"].rows):
                if Q:
                    lines.append(Line(entry_name("Q", i), (Q,)))
            lines += [Line(Name(x.name, ""), (x.value,)) for x in self.blocks["Q"].where]
        for i in self.joints:
            for damped in self._damped(i):
                lines.append(Line(entry_name("D qd", i, latex=r"(D\dot{q})"), (damped,)))
        yield lines

    # -- loops -------------------------------------------------------------------------------------

    def _loops(self) -> Iterator[list[Line]]:
        if not self.mechanism.rows:
            return
        yield [*self._cuts()]
        gaps = [row[0] for row in self.blocks["gap"].rows]
        flat = [expanded(gap) for gap in gaps]
        sides, rates = [], []
        for r, gap in enumerate(gaps):
            name = entry_name("gap", r, latex=r"\mathrm{gap}")
            if self._is_point(r):
                one = Sum({m: x for m, x in gap.terms.items() if x > 0})
                two = Sum({m: -x for m, x in gap.terms.items() if x < 0})
                sides.append(Line(one, (two,)))
            else:
                sides.append(Line(name, (gap, ZERO)))
            moved = slope(flat[r], self.by_time)
            if self.mechanism.rows[r].law is not None:
                moved = self._law_rate(r)
            moving = written(in_place(moved, "gap"), BY_RATE)
            left = Name(f"d/dt {name.plain}", rf"\frac{{d}}{{dt}}{name.latex}")
            rates.append(Line(left, (moving, ZERO)))
        yield sides
        yield rates
        entries = []
        for r, row in enumerate(self.blocks["Psi"].rows):
            for k, entry in enumerate(row):
                if entry:
                    entries.append(Line(entry_name("Psi", r, k, latex=r"\Psi"), (entry,)))
        for r, (entry,) in enumerate(self.blocks["Psidot_qd"].rows):
            if entry:
                name = entry_name("Psidot qd", r, latex=r"(\dot{\Psi}\dot{q})")
                entries.append(Line(name, (entry,)))
        yield entries
        yield from self._multipliers()

    def _law_rate(self, r: int) -> Sum:
        """Return the rate of a row with a law: Psi qd plus its partial time derivative."""
        entries = enumerate(self.blocks["Psi"].rows[r])
        parts = [expanded(x) * of(Atom(Role.rate, (k,))) for k, x in entries if x]
        if "gap_t" in self.blocks:
            parts.append(expanded(self.blocks["gap_t"].rows[r][0]))
        return total(parts)

    def _is_point(self, r: int) -> bool:
        """Return whether a row of the gap measures points along a fixed direction."""
        row = self.mechanism.rows[r]
        return row.closure is not None and row.line is None and row.arm == 0.0

    def _cuts(self) -> Iterator[Line]:
        """Yield where each loop was cut, and the meaning of further rows."""

        def body(point: Point) -> str:
            return "the ground" if point.link is None else printable(self.links[point.link].name)

        for c, closure in enumerate(self.mechanism.description.closures):
            one, two = body(closure.first), body(closure.second)
            if closure.along is None:
                told = f"at the pin of {one} and {two}: the two points coincide"
            else:
                told = f"where {one} touches a line on {two}: the point stays on it"
            if closure.aligned is not None:
                told += ", and the angle between the two links stays as it is"
            yield said(f"Loop {c + 1} is cut {told}.")
        for c, coupling in enumerate(self.mechanism.description.couplings):
            others = " and ".join(f"q{k + 1}" for k in sorted(coupling.others))
            told = f"q{coupling.joint + 1} to {others}" if others else f"q{coupling.joint + 1}"
            yield said(f"Coupling {c + 1} ties {told}: a further row of gap and Psi.")

    def _multipliers(self) -> Iterator[list[Line]]:
        """Yield lambda, f, and the equation of motion without lambda."""
        driven = self.equations.driven("tau{}")
        q = ", ".join(f"q{k + 1}" for k in self.joints)
        terms = [x for x in ("C", "D", "G") if x in self.blocks and not self.blocks[x].zero]
        plus = [x.name for x in self.equations.others]
        f = " ".join(
            ["tau", *(f"+ {x}" for x in plus), *(f"- {x}" + " qd" * (x in "CD") for x in terms)]
        )
        f_latex = f.replace("tau", r"\tau").replace(" qd", r"\dot{q}")
        q_latex = ", ".join(f"q_{{{k + 1}}}" for k in self.joints)
        tau_latex = ", ".join(self.equations.driven(r"\tau_{{{}}}"))
        yield [
            said("With the forces lambda at the cuts:"),
            shown(
                f"q = ({q})    tau = ({', '.join(driven)})    f = {f}",
                rf"q = ({q_latex})^T, \quad \tau = ({tau_latex})^T, \quad f = {f_latex}",
            ),
            shown(
                "M qdd = f + Psi^T lambda    Psi qdd + Psidot qd = 0",
                r"M\ddot{q} = f + \Psi^T\lambda, \quad \Psi\ddot{q} + \dot{\Psi}\dot{q} = 0",
            ),
            said(
                "The first gives qdd for the second, that lambda, and this the equation of motion:"
            ),
            shown(
                "qdd = M^-1 f + M^-1 Psi^T lambda",
                r"\ddot{q} = M^{-1}f + M^{-1}\Psi^T\lambda",
            ),
            shown(
                "Psi M^-1 Psi^T lambda = -(Psi M^-1 f + Psidot qd)",
                r"\Psi M^{-1}\Psi^T\lambda = -(\Psi M^{-1}f + \dot{\Psi}\dot{q})",
            ),
            shown(
                "M qdd = f - Psi^T (Psi M^-1 Psi^T)^-1 (Psi M^-1 f + Psidot qd)",
                r"M\ddot{q} = f - \Psi^T(\Psi M^{-1}\Psi^T)^{-1}(\Psi M^{-1}f + \dot{\Psi}\dot{q})",
            ),
        ]
        forces = [[x for x in self._acting(i) if x] for i in self.joints]
        yield [Line(entry_name("f", i), (grouped(*parts),)) for i, parts in enumerate(forces)]
        blocks = self._coupled_joints()
        if max(map(len, blocks)) <= 2 and len(self.mechanism.rows) <= 2:
            yield from self._eliminated(blocks, forces)

    def _acting(self, i: int) -> list[list[Sum]]:
        """Return the terms of f_i = tau_i + Q_i - (C qd)_i - (D qd)_i - G_i."""
        driven = i in self.mechanism.actuated
        taken = (self.forms(self.coriolis[i]), self._damped(i), self._gradient(i))
        return [
            [self.named("tau", i, latex=r"\tau")] if driven else [],
            self._other(i),
            *([-x for x in group] for group in taken),
        ]

    def _coupled_joints(self) -> list[list[int]]:
        """Return the blocks of joints that M couples."""
        M, left, found = self.blocks["M"].rows, set(self.joints), []
        while left:
            block = [left.pop()]
            for i in block:
                near = [j for j in left if M[i][j]]
                block += near
                left -= set(near)
            found.append(sorted(block))
        return sorted(found)

    def _eliminated(self, blocks: Sequence[Sequence[int]], forces: Any) -> Iterator[list[Line]]:
        """Yield N = M^-1, W = Psi N Psi^T, b, lambda, and their rows, in names."""
        known = self.equations.known.known  # of which a rotor's damping may be b1
        letter = next(x for x in "bcu" if not {f"{x}1", f"{x}2"} & known.keys())
        yield [
            shown(
                f"N = M^-1    W = Psi N Psi^T    {letter} = Psi N f + Psidot qd"
                f"    lambda = -W^-1 {letter}",
                rf"N = M^{{-1}}, \quad W = \Psi N\Psi^T, \quad {letter} = \Psi Nf"
                rf" + \dot{{\Psi}}\dot{{q}}, \quad \lambda = -W^{{-1}}{letter}",
            )
        ]
        lines, N = [], {}
        for block in blocks:
            if len(block) == 1:
                (i,) = block
                N[i, i] = self.named("N", i, i)
                right = over(ONE, self.named("M", i, i))
                lines.append(Line(entry_name("N", i, i), (right,)))
                continue
            i, j = block
            one, both, two = (self.named("M", *x) for x in ((i, i), (i, j), (j, j)))
            d = self.named("d", i, j)
            lines.append(Line(entry_name("d", i, j), (joined((one * two, -(both * both))),)))
            for place, value in (((i, i), two), ((i, j), -both), ((j, j), one)):
                N[place] = N[place[::-1]] = self.named("N", *place)
                lines.append(Line(entry_name("N", *place), (over(value, d),)))
        Psi = self.blocks["Psi"].rows
        rows = range(len(Psi))

        def entry(r: int, k: int) -> Sum:
            return self.named("Psi", r, k, latex=r"\Psi") if Psi[r][k] else ZERO

        W: dict[tuple[int, int], Sum] = {}
        pairs = sorted(N)
        for r in rows:
            for s in range(r, len(Psi)):
                value = in_line((N[i, j], entry(r, i), entry(s, j)) for i, j in pairs)
                W[r, s] = self.named("W", r, s) if value else ZERO
                if value:
                    lines.append(Line(entry_name("W", r, s), (value,)))
        b = []
        for r in rows:
            acting = ((N[i, j], entry(r, i), self.named("f", j)) for i, j in pairs if forces[j])
            parts = [in_line(acting)]
            if self.blocks["Psidot_qd"].rows[r][0]:
                parts.append(self.named("Psidot qd", r, latex=r"(\dot{\Psi}\dot{q})"))
            b.append(self.named(letter, r))
            lines.append(Line(entry_name(letter, r), (joined(parts),)))
        multipliers = [entry_name("lambda", r, latex=r"\lambda") for r in rows]
        if len(Psi) == 1:
            lines.append(Line(multipliers[0], (over(-b[0], W[0, 0]),)))
        elif not W[0, 1]:
            lines += [Line(multipliers[r], (over(-b[r], W[r, r]),)) for r in rows]
        else:
            d = of(self.atom(Name("dW", "d_{W}")))
            determinant = joined((W[0, 0] * W[1, 1], -(W[0, 1] * W[0, 1])))
            lines.append(Line(Name("dW", "d_{W}"), (determinant,)))
            for r, other in ((0, 1), (1, 0)):
                top = joined((W[0, 1] * b[other], -(W[other, other] * b[r])))
                lines.append(Line(multipliers[r], (over(top, d),)))
        yield lines
        final = []
        for i in self.joints:
            M = self.blocks["M"].rows[i]
            left = joined(
                before_name(
                    self.named("M", min(i, j), max(i, j)),
                    self.atom(Name(f"qdd{j + 1}", rf"\ddot{{q}}_{{{j + 1}}}")),
                )
                for j in self.joints
                if M[j]
            )
            acts = [self.named("f", i)] if forces[i] else []
            acts += [before_name(entry(r, i), self.atom(multipliers[r])) for r in rows if Psi[r][i]]
            final.append(Line(left, (joined(acts),)))
        yield final


def _atoms(item: Any) -> Iterator[Atom]:
    """Yield the atoms of all sums in parts of a line."""
    if isinstance(item, Sum | Formula):
        yield from item.atoms()
    elif isinstance(item, tuple):
        for each in item:
            yield from _atoms(each)


def planar(at: Any) -> Planar:
    """Return a point or direction of a scene in symbols."""
    return Planar(summed(at.real), summed(at.imag))


def cosine(turn: tuple[int, ...]) -> Sum:
    """Return the cosine of the sum of these joints' angles."""
    return of(Atom(Role.function, turn, "cos")) if turn else ONE


def sine(turn: tuple[int, ...]) -> Sum:
    """Return the sine of the sum of these joints' angles."""
    return of(Atom(Role.function, turn, "sin")) if turn else ZERO


def derived(atom: Atom) -> Sum:
    """Return the derivative of a sine or cosine by its angle."""
    if atom.name == "sin":
        return of(atom._replace(name="cos"))
    return -of(atom._replace(name="sin"))


def squared(parts: Parts, sign: int = 1) -> Iterator[Sum]:
    """Yield |sum of c exp(-i sign turn) rate|^2: squares, then twice the products of two parts."""
    for c, _, rate in parts:
        for part in (c.imag, c.real)[::sign]:
            if part:
                yield part * part * rate * rate
    for one, two in combinations(parts, 2):
        w = one.c.conjugate() * two.c
        place, way = difference_of(one.turn, two.turn) or ((), 1)
        sin = sine(place).times(way * sign)
        product = (w.real * cosine(place) - w.imag * sin) * one.rate * two.rate
        if product:
            yield product.times(2)


def bracketed(first: Sum, second: Sum, number: Number, power: int = 1) -> Sum:
    """Return number first second^power, with sums of several terms in brackets."""
    factors: list[tuple[Any, Any]] = []
    for each, times in ((first, 1), (second, power)):
        own, before = as_factors(each)
        number = number * before**times
        factors += [(factor, p * times) for factor, p in own]
    return Sum({in_writing_order(tuple(factors)): number})


def before_name(entry: Sum, name: Atom) -> Sum:
    """Return a matrix entry times what follows it: a rate, acceleration or multiplier."""
    factors, number = as_factors(entry)
    factors = (*factors, (name, 1))
    if len(entry.terms) == 1 and name.role == Role.rate:  # a rate among symbols has its place there
        factors = in_writing_order(factors)
    return Sum({factors: number})


def as_factors(entry: Sum) -> tuple[Monomial, Number]:
    """Return a sum as factors and a number; a sum of several terms is one bracket."""
    if len(entry.terms) != 1:
        return ((entry, 1),), 1
    ((factors, number),) = entry.terms.items()
    return factors, number


def joined(parts: Iterable[Sum]) -> Sum:
    """Return the terms of all parts, in the order in which they are written."""
    terms: dict[Monomial, Number] = {}
    for part in parts:
        for monomial, number in part.terms.items():
            terms[monomial] = terms.get(monomial, 0) + number
    return Sum({monomial: x for monomial, x in terms.items() if x})


def grouped(*groups: Sequence[Sum]) -> Right:
    """Return a sum in groups of terms, each of which may begin a line."""
    return Groups(tuple(tuple(x) for x in groups if x)) if any(groups) else ZERO


def over(above: Sum, below: Sum) -> Sum:
    """Return a quotient by a name."""
    (((factor, _),),) = below.terms
    if len(above.terms) == 1:
        ((monomial, number),) = above.terms.items()
        return Sum({(*monomial, (factor, -1)): number})
    return Sum({((above, 1), (factor, -1)): 1})


def in_line(products: Iterable[tuple[Sum, Sum, Sum]]) -> Sum:
    """Return a sum of products of names, with equal products added."""
    terms: dict[Monomial, Number] = {}
    for three in products:
        if all(three):
            powers: dict[Atom, int] = {}
            for each in three:
                (((atom, _),),) = each.terms
                powers[atom] = powers.get(atom, 0) + 1
            first, *others = powers.items()
            monomial = (first, *sorted(others, key=lambda x: (x[0].name[0] == "f", x[0].name)))
            terms[monomial] = terms.get(monomial, 0) + 1
    return Sum(terms)


def whole(number: Fraction) -> Number:
    """Return a number as an int if it is one."""
    return int(number) if number == int(number) else number
