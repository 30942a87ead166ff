"""The rows of elements on symbols, with names for quantities that elements name.

A slot that an element names holds an atom.  Its contents become the definition of the name: lengths
of springs, pulls, laws, varying loads.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from fractions import Fraction
from typing import Any, NamedTuple

from robodyn.elements.base import Element, whole
from robodyn.elements.builder import Name
from robodyn.elements.link_rows import PlanarPoint
from robodyn.elements.program import Derivative, Function, Given, Power, RealPart, Slot
from robodyn.elements.values import Law, Signal
from robodyn.engines.series import Series
from robodyn.equations.named_laws import Formula, formula_of
from robodyn.equations.symbolic import Atom, Monomial, Role, Sum, of, summed
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Description, Point

Places = Mapping[Element, tuple[str, int]]  # the list of the scene that has an element, and where
LENGTHS, RATES, OTHERS = 0, 1, 2  # in which order the names of an element are told
METRES = ("m", "m/s")


class Named(NamedTuple):
    """A name in a program; `make` returns its meaning from the series."""

    atom: Atom
    unit: str
    meaning: str
    make: Callable[[Series], Sum | Formula]
    kind: int
    element: int  # counted as they are written

    @property
    def is_root(self) -> bool:
        """Whether it is a length, the root of two squared names."""
        return self.kind == LENGTHS and self.atom.place[-1] == ""

    @property
    def is_component(self) -> bool:
        """Whether it is a component of a span, or of its rate."""
        return self.kind != OTHERS and self.atom.place[-1][-1:] in ("x", "y")


def places_of(scene: Description, tree: Tree) -> Places:
    """Return for each element, and its parts, the list of the scene it is in and its index."""
    found: dict[Element, tuple[str, int]] = {}
    for place, element in scene.elements:
        name, _, rest = place.partition("[")
        number = int(rest.partition("]")[0])
        for acting in whole(element.placed(tree)):
            for part in (acting, acting.stored(), acting.spent()):
                if part is not None:
                    found.setdefault(part, (name, number))
    return found


class NamedRows(EquationsOfMotion):
    """Writes the rows of a mechanism of symbols; `given` holds the values of its names."""

    def __init__(self, mechanism: Mechanism, places: Places) -> None:
        super().__init__(mechanism)
        self.places = places
        self.given: dict[str, tuple[Sum, ...]] = {}
        self.names: list[Named] = []
        self.program.named["names"] = []  # slots that definitions are made of
        self._roots: dict[Slot, Slot] = {}
        self._laws: dict[Slot, tuple[Name, Callable[[Series], Formula]]] = {}
        self._place, self._count = ("", 0), 0

    # what elements call

    def write_rows(self, element: Element) -> None:
        self._place = self.places.get(element, ("", 0))
        self._count += 1
        super().write_rows(element)

    def named(self, name: Name, slot: Slot, sign: float = 1.0) -> Slot:
        def make(series: Series) -> Sum:
            return summed(series.real[slot][0]).times(sign)

        def make_call(series: Series) -> Formula:
            return Formula((function, "x"), {"x": _positive_first(series.real[of_slot][0])})

        row = self.program.rows[slot]
        if isinstance(row, Function) and sign == 1.0:  # of what is no symbol
            function, of_slot = row.name, row.x
            return self._stands(name, make_call, [of_slot], OTHERS)
        found = self._stands(name, make, [slot], OTHERS)
        return found if sign == 1.0 else self.sum((sign, found))

    def span(self, name: Name, place: PlanarPoint, always: bool) -> Slot:
        whole = self.point(place)
        if not (always or self._across(place)) or not place.terms:
            return whole
        parts = []
        for axis, by in (("x", (1.0, 0.0)), ("y", (0.0, -1.0))):
            along = self.program.add(RealPart(self.planar_sum((by, whole))))
            told = f"{name.meaning}, along {axis.upper()}"
            own = name._replace(axis=axis, meaning=told)
            parts.append(self._stands(own, _value_of(along), [along], LENGTHS, "V"))
        x, y = parts
        return self.planar_sum(((1.0, 0.0), x), ((0.0, 1.0), y))

    def root(self, name: Name, square: Slot) -> None:
        def make(series: Series) -> Sum:
            return of(summed(series.real[square][0]), 0.5)

        def rate(series: Series) -> Sum:
            half = summed(series.real[change][0]).times(Fraction(1, 2))
            along: Sum = half * of(length, -1)
            return along

        length = self._atom(name)
        change = self.program.add(Derivative(square))
        self._roots[square] = self._stands(name, make, [square, change], LENGTHS, "V", rate)

    def signal(self, signal: Signal, name: Name, x: Slot | None = None) -> Slot:
        assert isinstance(signal, Law)
        slots = []
        if x is not None:
            slots = [x, self.rate(x)] if "v" in signal.names else [x]

        def make(series: Series) -> Formula:
            own = zip("xv", slots, strict=False)
            values = {name: _positive_first(series.real[slot][0]) for name, slot in own}
            return formula_of(signal, values)

        return self._stands(name, make, slots, OTHERS)

    def power_of(self, x: Slot, exponent: float) -> Slot:
        if x not in self._roots:
            return super().power_of(x, exponent)
        root = self._roots[x]
        return root if exponent == 0.5 else self.program.add(Power(root, 2.0 * exponent))

    def quotient(self, x: Slot, y: Slot) -> Slot:
        if y in self._roots:
            return self.product(x, self.power_of(y, -1.0))
        return super().quotient(x, y)

    # names

    def _atom(self, name: Name) -> Atom:
        kind, i = self._place
        if not kind:  # of the scene itself
            return Atom(Role.gravity, (i, name.axis), name.letter + name.axis)
        if name.unit in METRES:
            return Atom(Role.stretch, (i, name.axis), f"{name.letter}{i + 1}{name.axis}")
        letters = name.letter + name.axis if kind == "loads" else ""
        place = i if name.link is None else name.link
        return Atom(Role.force, (place, letters), f"{name.letter}{i + 1}{name.axis}")

    def _stands(
        self,
        name: Name,
        make: Callable[[Series], Sum | Formula],
        slots: list[Slot],
        kind: int,
        rate: str = "",
        rate_of: Callable[[Series], Sum] | None = None,
    ) -> Slot:
        """Return a slot with the name in place of `make`; its rate has the letter `rate`."""
        atom, (place, i) = self._atom(name), self._place
        told = f"{place.removesuffix('s')} {i + 1}"
        if place == "links":
            told = f"the joint of {self.mechanism.link_names[i]}"
        meaning = name.meaning.replace("{}", told)
        self.names.append(Named(atom, name.unit, meaning, make, kind, self._count))
        self.program.named["names"] += slots
        values = [of(atom)]
        if rate:
            if rate_of is None:
                change = self.program.add(Derivative(slots[0]))
                self.program.named["names"].append(change)
                rate_of = _value_of(change)
            changing = Atom(Role.stretch, (i, f"{rate}{name.axis}"), f"{rate}{i + 1}{name.axis}")
            told = f"rate of {atom.name}"
            self.names.append(Named(changing, "m/s", told, rate_of, RATES, self._count))
            values.append(of(changing))
        key = f"name {atom.name}"
        self.given[key] = tuple(values)
        return self.program.add(Given(key))

    def _across(self, place: PlanarPoint) -> bool:
        """Return whether a difference of points joins links of two branches."""
        tree = self.mechanism.tree
        paths = [{j for j, _ in tree.point(Point(k, 1.0)).terms} for k, _ in place.terms]
        return any(not (a <= b or b <= a) for a in paths for b in paths)

    def used(
        self, series: Series, atoms: Collection[Atom]
    ) -> Iterator[tuple[Named, Sum | Formula]]:
        """Yield the names among the atoms and their meaning, in the order of the legend."""
        wanted, values = set(atoms), {}
        for name in reversed(self.names):
            if name.atom in wanted:
                value = values[name.atom] = name.make(series)
                wanted.update(value.atoms())
        told = [name for name in self.names if name.atom in values]
        for name in sorted(told, key=lambda name: (name.element, name.kind)):
            yield name, values[name.atom]


def _positive_first(value: Any) -> Sum:
    """Return a sum with negative terms last."""
    terms = summed(value).terms.items()
    return Sum(dict(sorted(terms, key=lambda term: term[1] < 0)))


def _value_of(slot: Slot) -> Callable[[Series], Sum]:
    return lambda series: summed(series.real[slot][0])


# -- powers of symbols -----------------------------------------------------------------------------


def power(a: Any, exponent: float) -> Sum:
    """Return a power of a sum: factor by factor for a product, else with the sum in brackets."""
    base = summed(a)
    if exponent in range(9):
        return base ** int(exponent)
    if len(base.terms) == 1:
        ((monomial, number),) = base.terms.items()
        if number == 1:
            powers: Monomial = tuple((x, p * _whole(exponent)) for x, p in monomial)
            return Sum({powers: 1})
    return of(base, _whole(exponent))


def _whole(exponent: float) -> float:
    return int(exponent) if exponent == int(exponent) else exponent


def divide(a: Any, b: Any) -> Sum:
    """Return a quotient of sums."""
    found: Sum = summed(a) * power(b, -1.0)
    return found
