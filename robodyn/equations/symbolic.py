"""Sums of products of symbols, sines and cosines: the algebra of equations of motion.

    2 m2 l1 r2 (qd1 + qd2) sin(q2)

is a number times powers of atoms.  An atom is a parameter (m2), a function of a sum of coordinates
(sin(q2), cos(q1 + q2)), or a sum of rates (qd1 + qd2).  A sum of rates is never expanded: it is the
angular velocity of a link, or of one link relative to another.

Sums take the place of floats in the rows of the equations of motion.  Their numbers are exact: ints
and Fractions, also for decimal numbers that `substituted` inserts.  So terms that cancel on paper
cancel here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from math import prod
from typing import Any, NamedTuple

from robodyn.engines.planar_numbers import Planar as Planar

Number = int | Fraction


class Role:
    """Kind of an atom, in the order in which the factors of a product are written."""

    mass, inertia, damping = 0, 1, 2
    force = 3  # stiffness too
    gravity, normal = 4, 5
    direction = 6  # cosines of axes, and of angles that are kept
    length = 7
    stretch = 8  # components of a spring
    angle, rate, function = 9, 10, 11


class Atom(NamedTuple):
    """A factor of products; the fields define the sort order.

    `place` orders parameters of one role by (link, letters).  For other roles it lists the joints
    (from 0) whose angles or rates are summed, ~k if that of joint k is subtracted.  `speed` is the
    scale of a rate, as in tanh(qd2/wf2).
    """

    role: int
    place: tuple[Any, ...]
    name: str = ""  # of a parameter or a function
    speed: Atom | Fraction | None = None

    @property
    def parameter(self) -> bool:
        """Whether it is a parameter of the scene, or a defined name."""
        return self.role < Role.angle


# Atoms with their powers, sorted; as they are written, sums in brackets too, under a root by 1/2.
Monomial = tuple[tuple[Any, Any], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Sum:
    """A sum of products: the nonzero number of each monomial."""

    terms: Mapping[Monomial, Number]

    def __bool__(self) -> bool:
        return bool(self.terms)

    def __eq__(self, other: object) -> bool:
        return self.terms == other.terms if isinstance(other, Sum) else other == 0 and not self

    def __hash__(self) -> int:
        return hash(tuple(self.terms.items()))

    @property
    def real(self) -> Sum:
        """The sum itself: all symbols are real."""
        return self

    @property
    def imag(self) -> Sum:
        return ZERO

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Planar):
            return NotImplemented
        found = dict(self.terms)  # a long sum is copied, not added term by term
        for monomial, number in summed(other).terms.items():
            found[monomial] = found.get(monomial, 0) + number
            if not found[monomial]:
                del found[monomial]
        return Sum(found)

    __radd__ = __add__

    def __neg__(self) -> Sum:
        return self.times(-1)

    def __sub__(self, other: Sum | float) -> Sum:
        return total((self, -summed(other)))

    def __rsub__(self, other: float) -> Sum:
        return summed(other) - self

    def __mul__(self, other: Any) -> Any:
        if not isinstance(other, Sum):
            return NotImplemented if isinstance(other, Planar) else self.times(other)
        pairs = product(self.terms.items(), other.terms.items())
        return collected((merged(a, b), x * y) for (a, x), (b, y) in pairs)

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> Sum:
        return NotImplemented if isinstance(number, Sum) else self.times(1 / Fraction(number))

    def __pow__(self, power: float) -> Sum:
        return prod([self] * int(power), start=ONE) if power in range(9) else NotImplemented

    def __rtruediv__(self, one: float) -> Sum:
        """Return a number divided by a symbol."""
        (((((atom, power),), number)),) = self.terms.items()
        return of(atom, -power).times(one / Fraction(number))

    def times(self, number: Number | float) -> Sum:
        """Return every term times a number."""
        exact = Fraction(number)
        by = exact.numerator if exact.denominator == 1 else exact
        found = {monomial: by * x for monomial, x in self.terms.items()} if by else {}
        return Sum({monomial: int(x) if x == int(x) else x for monomial, x in found.items()})

    def atoms(self) -> Iterator[Atom]:
        """Yield every atom of every term, also within brackets."""
        for monomial in self.terms:
            for factor, _ in monomial:
                yield from factor.atoms() if isinstance(factor, Sum) else [factor]

    def half_slopes(self) -> dict[Atom, Sum]:
        """Return half of the derivative by each rate in the sum."""
        found: dict[Atom, list[tuple[Monomial, Number]]] = {}
        for term, number in self.terms.items():
            for atom, power in term:
                if atom.role == Role.rate:
                    slope = number * power
                    half = slope // 2 if slope % 2 == 0 else Fraction(slope, 2)
                    found.setdefault(atom, []).append((merged(term, ((atom, -1),)), half))
        return {atom: collected(terms) for atom, terms in found.items()}

    def substituted(self, values: Mapping[str, Fraction]) -> Sum:
        """Return the sum with numbers for the symbols in `values`."""

        def put_in(monomial: Monomial, number: Number) -> tuple[Monomial, Number]:
            left: list[tuple[Any, Any]] = []
            for atom, power in monomial:
                if isinstance(atom, Sum):
                    left.append((atom.substituted(values), power))
                    continue
                if atom.parameter and atom.name in values:
                    number = number * values[atom.name] ** power
                    continue
                if isinstance(atom.speed, Atom):
                    atom = atom._replace(speed=values[atom.speed.name])
                left.append((atom, power))
            return tuple(left), number

        return collected(put_in(*term) for term in self.terms.items())


ZERO = Sum({})
ONE = Sum({(): 1})


def of(atom: Atom | Sum, power: float = 1) -> Sum:
    """Return a power of an atom as a sum with one term."""
    return Sum({((atom, power),): 1})


def summed(number: Any) -> Sum:
    """Return a number as a sum; sums stay as they are."""
    return number if isinstance(number, Sum) else ONE.times(number)


def total(parts: Iterable[Sum]) -> Sum:
    """Return the sum of the parts, in their order."""
    return collected(term for part in parts for term in part.terms.items())


def collected(terms: Iterable[tuple[Monomial, Number]]) -> Sum:
    """Return the sum of terms, with equal monomials added."""
    found: dict[Monomial, Number] = {}
    for monomial, number in terms:
        found[monomial] = found.get(monomial, 0) + number
    return Sum({monomial: x for monomial, x in found.items() if x})


def expanded(sum_: Sum) -> Sum:
    """Return the sum without brackets."""
    terms: list[tuple[Monomial, Number]] = []
    for monomial, number in sum_.terms.items():
        brackets = [x for x in monomial if isinstance(x[0], Sum) and x[1] in range(1, 9)]
        plain = merged((), tuple(x for x in monomial if x not in brackets))
        product_ = Sum({plain: number})
        for factor, power in brackets:
            product_ = product_ * expanded(factor) ** power
        terms += product_.terms.items()
    return collected(terms)


def slope(sum_: Sum, of_atom: Callable[[Atom], Sum]) -> Sum:
    """Return the derivative of a sum without brackets; `of_atom` gives those of its atoms."""
    found: list[tuple[Monomial, Number]] = []
    for monomial, number in sum_.terms.items():
        for atom, power in monomial:
            if by := of_atom(atom):
                rest = Sum({merged(monomial, ((atom, -1),)): number * power})
                found += (rest * by).terms.items()
    return collected(found)


def merged(a: Monomial, b: Monomial) -> Monomial:
    """Return the product of two monomials."""
    powers = dict(a)
    for atom, power in b:
        powers[atom] = powers.get(atom, 0) + power
    return tuple(sorted(x for x in powers.items() if x[1]))


NOWHERE = Planar(ZERO, ZERO)
