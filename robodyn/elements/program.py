"""A program of rows: equations of motion as a list of slots, each defined by earlier ones.

A slot holds a quantity that changes in time, real or planar (a complex number, as x and y); a row
defines it by other slots.  Rows do not know how they are evaluated: at one state or as power series
in time, on floats, recorded formulas, numpy arrays or numbers of many digits.  That is the task of
an engine (`engines/series.py`).

Unknowns (accelerations of links, forces of closures) enter linearly, and the residuals are zero for
the right unknowns.

Coefficients are either part of a program's shape (plain floats such as 1 and -1) or numbers of the
scene.  These are listed in `numbers`, and rows refer to them by index: programs of one shape differ
only in their numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, get_args

Slot = int


class Number(NamedTuple):
    """A number of the scene, by its index in `Program.numbers`, or its negative."""

    place: int
    sign: float = 1.0

    def __neg__(self) -> Number:
        return Number(self.place, -self.sign)


Coefficient = float | Number
PlanarCoefficient = tuple[Coefficient, Coefficient]  # real and imaginary part; 0.0: none


class Given(NamedTuple):
    """Real: an input: time, a torque, an angle at which a motion starts."""

    name: str


class Unknown(NamedTuple):
    """Real: an unknown that enters linearly, such as a closure's multiplier."""

    name: str


class Turn(NamedTuple):
    """Planar: the direction E = exp(i alpha) of a link; its angular acceleration is unknown."""

    link: int


class Slide(NamedTuple):
    """Real: the displacement s of a joint; its acceleration is unknown."""

    joint: int


class Rate(NamedTuple):
    """Real: w = Im(conj(E) E') of the direction `turn`."""

    turn: Slot


class Integral(NamedTuple):
    """Real: the integral of x over time, from the given value `start`."""

    x: Slot
    start: str


class Anchored(NamedTuple):
    """Real: x, but its first coefficient is the given value `start`, which is exact."""

    x: Slot
    start: str


class Derivative(NamedTuple):
    """Real or planar: dx/dt."""

    x: Slot


class Sum(NamedTuple):
    """Real: constant + sum c x."""

    constant: Coefficient
    terms: tuple[tuple[Coefficient, Slot], ...]


class PlanarSum(NamedTuple):
    """Planar: constant + sum c z, the coefficients complex, the slots planar or real."""

    constant: PlanarCoefficient
    terms: tuple[tuple[PlanarCoefficient, Slot], ...]


class RealPart(NamedTuple):
    """Real: Re z."""

    z: Slot


class Product(NamedTuple):
    """Real: x y."""

    x: Slot
    y: Slot


class Scaled(NamedTuple):
    """Planar: x z, x real and z planar."""

    x: Slot
    z: Slot


class Inner(NamedTuple):
    """Real: Re(conj(z) w)."""

    z: Slot
    w: Slot


class Moment(NamedTuple):
    """Real: inertia a + Im(conj(E) F), the moment on the link of `turn`; F without P.

    `bend` is the slot of P = E''. The link's own term is exact in this form: Im(conj(E) inertia P).
    """

    turn: Slot
    bend: Slot
    inertia: Coefficient
    F: Slot


class Quotient(NamedTuple):
    """Real: x / y."""

    x: Slot
    y: Slot


class Power(NamedTuple):
    """Real: x to a constant exponent."""

    x: Slot
    exponent: float


class Function(NamedTuple):
    """Real: exp, tanh, sin, cos, sinh or cosh of x."""

    name: str
    x: Slot


class Primitive(NamedTuple):
    """Real: the function of x whose slope is 1/density: log, atan, asin or acos."""

    name: str
    x: Slot
    density: Slot


class Step(NamedTuple):
    """Real: the value for the interval between increasing knots that contains x.

    With a period, x is reduced to the one from `first` on, and the value gains `rise` per period.
    """

    x: Slot
    knots: tuple[float, ...]
    values: tuple[float, ...]  # one more than knots
    first: float = 0.0
    period: float = 0.0
    rise: float = 0.0


Row = (
    Given | Unknown | Turn | Slide | Rate | Integral | Anchored | Derivative | Sum | PlanarSum
    | RealPart | Product | Scaled | Inner | Moment | Quotient | Power | Function | Primitive
    | Step
)  # fmt: skip

SLOTS: dict[type, list[str]] = {
    row: [name for name, kind in row.__annotations__.items() if kind.__forward_arg__ == "Slot"]
    for row in get_args(Row)
}
PLANAR = (Turn, PlanarSum, Scaled)
COORDINATES = (Turn, Slide)  # unknown in their second derivatives
SHIFT: dict[type, int] = {Derivative: 1, Rate: 1, Integral: -1}  # orders that a row looks ahead


class Schedule(NamedTuple):
    """Slots in order; by how many orders each is ahead of the unknowns; slots that they change.

    `live` maps a slot whose coefficient depends on the unknowns of its order to the slots through
    which it does.
    """

    slots: tuple[Slot, ...]
    ahead: dict[Slot, int]
    live: dict[Slot, tuple[Slot, ...]]


class Program:
    """Rows in the order of their slots, residuals, and outputs by name."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.numbers: list[float] = []
        self.residuals: list[Slot] = []
        self.unknowns: list[Slot] = []  # Turns, Slides and Unknowns
        self.named: dict[str, list[Slot]] = {}
        self.planar: list[bool] = []
        self._known: dict[tuple[type, Row], Slot] = {}
        self._schedules: dict[tuple[int, ...], Schedule] = {}

    # -- building ----------------------------------------------------------------------------------

    def number(self, value: float) -> Coefficient:
        """Return a coefficient of the scene; zero is part of the program's shape.

        Numbers are kept unchanged: they may be formulas of parameters.
        """
        if value == 0.0:
            return 0.0
        self.numbers.append(value)
        return Number(len(self.numbers) - 1)

    def planar_number(self, value: complex) -> PlanarCoefficient:
        """Return a complex coefficient of the scene."""
        return self.number(value.real), self.number(value.imag)

    def add(self, row: Row) -> Slot:
        """Return the slot of a row; equal rows share one."""
        key = type(row), row  # rows of two types may hold the same
        if (known := self._known.get(key)) is not None:
            return known
        slot = self._known[key] = len(self.rows)
        self.rows.append(row)
        z = row.x if isinstance(row, Derivative) else None
        self.planar.append(isinstance(row, PLANAR) or (z is not None and self.planar[z]))
        if isinstance(row, (*COORDINATES, Unknown)):
            self.unknowns.append(slot)
        return slot

    def sum(self, *terms: tuple[Coefficient, Slot], constant: Coefficient = 0.0) -> Slot:
        """Return the slot of a `Sum`, or of its only term."""
        kept = tuple((c, x) for c, x in terms if c != 0.0)
        if constant == 0.0 and len(kept) == 1 and kept[0][0] == 1.0:
            return kept[0][1]
        return self.add(Sum(constant, kept))

    def planar_sum(self, *terms: tuple[PlanarCoefficient, Slot]) -> Slot:
        """Return the slot of a `PlanarSum` without a constant."""
        return self.add(PlanarSum((0.0, 0.0), terms))

    # -- reading -----------------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[object, ...]:
        """A hashable key, equal for programs that differ only in their numbers."""
        named = tuple((name, tuple(slots)) for name, slots in self.named.items())
        return tuple((type(row), row) for row in self.rows), tuple(self.residuals), named

    def schedule(self, wanted: Sequence[Slot] = ()) -> Schedule:
        """Return the order of slots, and how many orders they are ahead of the unknowns."""
        key = (len(self.rows), len(self.residuals), *self.residuals, *wanted)
        if key not in self._schedules:
            self._schedules[key] = self._scheduled(wanted)
        return self._schedules[key]

    def _scheduled(self, wanted: Sequence[Slot]) -> Schedule:
        ahead = dict.fromkeys([*self.residuals, *wanted], 0)
        for slot in self.unknowns:
            ahead[slot] = 2 if isinstance(self.rows[slot], COORDINATES) else 0
        for slot in reversed(range(len(self.rows))):
            if slot not in ahead:
                continue
            row = self.rows[slot]
            level = ahead[slot] + SHIFT.get(type(row), 0)
            for x in arguments(row):
                ahead[x] = max(ahead.get(x, 0), level)
        live: dict[Slot, tuple[Slot, ...]] = {}
        for slot in sorted(ahead):
            row = self.rows[slot]
            level = ahead[slot] + SHIFT.get(type(row), 0)
            changing = tuple(x for x in arguments(row) if x in live and ahead[x] == level)
            if changing or isinstance(row, (*COORDINATES, Unknown)):
                live[slot] = changing
        return Schedule(tuple(sorted(ahead)), ahead, live)


def arguments(row: Row) -> Iterator[Slot]:
    """Return the slots that a row reads."""
    if isinstance(row, (Sum, PlanarSum)):
        return (x for _, x in row.terms)
    return (getattr(row, name) for name in SLOTS[type(row)])


def finite(numbers: list[float]) -> bool:
    """Return whether all numbers are finite."""
    return all(map(math.isfinite, numbers))
