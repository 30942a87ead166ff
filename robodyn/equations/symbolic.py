"""Sums of products of symbols, sines and cosines: the algebra that equations of motion need.

    2 m2 l1 r2 (qd1 + qd2) sin(q2)

is a number times powers of atoms.  An atom is a parameter (m2), a function of a sum of coordinates
(sin(q2), cos(q1 + q2)), or a sum of rates (qd1 + qd2), which is never multiplied out: it is the
angular velocity of one link, or of a link relative to another.

Numbers are int as long as parameters stand as symbols; `substituted` makes them Fractions of the
scene's decimal numbers, so that what cancels on paper cancels here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Union

if TYPE_CHECKING:
    from fractions import Fraction

Number = Union[int, "Fraction"]


class Role(IntEnum):
    """What an atom stands for, in the order in which the factors of a product are written."""

    mass = 0
    inertia = 1
    damping = 2
    force = 3  # stiffness too
    gravity = 4
    normal = 5
    length = 6
    stretch = 7  # components of a spring
    angle = 8
    rate = 9
    function = 10


@dataclass(frozen=True, slots=True)
class Symbol:
    """A parameter of the scene; `place` orders those of one role, (link, letter)."""

    name: str
    role: Role
    place: tuple[int, str]

    @property
    def key(self) -> tuple[object, ...]:
        return self.role, *self.place, self.name


@dataclass(frozen=True, slots=True)
class Rates:
    """A sum of joint rates (indices of joints, from 0), rad/s: qd1 + qd2."""

    joints: tuple[int, ...]

    @property
    def role(self) -> Role:
        return Role.rate

    @property
    def key(self) -> tuple[object, ...]:
        return self.role, len(self.joints), self.joints


@dataclass(frozen=True, slots=True)
class Call:
    """A function of a sum of joint angles: cos(q1 + q2)."""

    function: str
    joints: tuple[int, ...]

    @property
    def role(self) -> Role:
        return Role.function

    @property
    def key(self) -> tuple[object, ...]:
        return self.role, self.joints, self.function


@dataclass(frozen=True, slots=True)
class Angle:
    """The angle of one joint, rad: q2."""

    joint: int

    @property
    def role(self) -> Role:
        return Role.angle

    @property
    def key(self) -> tuple[object, ...]:
        return self.role, self.joint


@dataclass(frozen=True, slots=True)
class Smooth:
    """A function of a joint's rate against a speed: tanh(qd2/wf2)."""

    function: str
    joint: int
    speed: Symbol | Fraction

    @property
    def role(self) -> Role:
        return Role.function

    @property
    def key(self) -> tuple[object, ...]:
        return self.role, (self.joint,), self.function


Atom = Symbol | Angle | Rates | Call | Smooth
Monomial = tuple[tuple[Atom, int], ...]  # atoms with their powers, sorted by key


@dataclass(frozen=True, slots=True)
class Sum:
    """A sum of products: the number of each monomial, none of them zero, in order of writing."""

    terms: Mapping[Monomial, Number]

    def __bool__(self) -> bool:
        return bool(self.terms)

    def __add__(self, other: Sum) -> Sum:
        return total((self, other))

    def __neg__(self) -> Sum:
        return self.times(-1)

    def __sub__(self, other: Sum) -> Sum:
        return total((self, -other))

    def __mul__(self, other: Sum) -> Sum:
        found: dict[Monomial, Number] = {}
        for a, x in self.terms.items():
            for b, y in other.terms.items():
                product = _merged(a, b)
                found[product] = found.get(product, 0) + x * y
        return Sum({monomial: x for monomial, x in found.items() if x})

    def times(self, number: Number) -> Sum:
        """Every term times a number that is not zero."""
        return Sum({monomial: number * x for monomial, x in self.terms.items()})

    def atoms(self) -> Iterator[Atom]:
        """Every atom of every term."""
        return (atom for monomial in self.terms for atom, _ in monomial)

    def substituted(self, values: Mapping[str, Fraction]) -> Sum:
        """The sum with numbers for the symbols that `values` names."""
        found: dict[Monomial, Number] = {}
        for monomial, number in self.terms.items():
            left: list[tuple[Atom, int]] = []
            for atom, power in monomial:
                if isinstance(atom, Symbol) and atom.name in values:
                    number = number * values[atom.name] ** power
                elif isinstance(atom, Smooth) and isinstance(atom.speed, Symbol):
                    speed = values[atom.speed.name]
                    left.append((Smooth(atom.function, atom.joint, speed), power))
                else:
                    left.append((atom, power))
            key = tuple(left)
            found[key] = found.get(key, 0) + number
        return Sum({monomial: x for monomial, x in found.items() if x})


ZERO = Sum({})
ONE = Sum({(): 1})


def of(atom: Atom, power: int = 1) -> Sum:
    """A power of the atom as a sum of one term."""
    return Sum({((atom, power),): 1})


def total(parts: Iterable[Sum]) -> Sum:
    """The sum of the parts, in their order."""
    found: dict[Monomial, Number] = {}
    for part in parts:
        for monomial, number in part.terms.items():
            found[monomial] = found.get(monomial, 0) + number
    return Sum({monomial: x for monomial, x in found.items() if x})


def _merged(a: Monomial, b: Monomial) -> Monomial:
    powers = dict(a)
    for atom, power in b:
        powers[atom] = powers.get(atom, 0) + power
    return tuple(sorted(powers.items(), key=lambda factor: factor[0].key))


@dataclass(frozen=True, slots=True)
class Planar:
    """A point or vector of the plane as a complex number, x + i y."""

    real: Sum
    imag: Sum

    def __bool__(self) -> bool:
        return bool(self.real or self.imag)

    def __add__(self, other: Planar) -> Planar:
        return Planar(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: Planar) -> Planar:
        return Planar(self.real - other.real, self.imag - other.imag)

    def __rsub__(self, zero: complex) -> Planar:
        return -self

    def __neg__(self) -> Planar:
        return Planar(-self.real, -self.imag)

    def __mul__(self, other: Planar | Sum | complex) -> Planar:
        if isinstance(other, Sum):
            return Planar(self.real * other, self.imag * other)
        if isinstance(other, complex):  # 1, i and their opposites
            other = Planar(*(ONE.times(int(x)) if x else ZERO for x in (other.real, other.imag)))
        return Planar(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    __rmul__ = __mul__

    def conjugate(self) -> Planar:
        """x - i y."""
        return Planar(self.real, -self.imag)

    @property
    def quarter_turn(self) -> Planar:
        """The vector times i."""
        return Planar(-self.imag, self.real)

    def turned(self, joints: tuple[int, ...]) -> Planar:
        """The vector turned by the sum of these joints' angles."""
        return self * Planar(of(Call("cos", joints)), of(Call("sin", joints)))


NOWHERE = Planar(ZERO, ZERO)
