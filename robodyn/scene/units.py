"""Units of measure: the names that people write, their size in SI units and their dimension."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple, Self

# exponents of metre, kilogram, second, ampere, radian and cycle; none where a number is plain
Dimension = Mapping[str, float]
PLAIN: Dimension = {}


def _of(text: str) -> Dimension:
    """`m1 kg1 s-2` as exponents."""
    found: dict[str, float] = {}
    for part in text.split():
        base = part.rstrip("-0123456789")
        found[base] = float(part[len(base) :])
    return found


_LENGTH, _MASS, _TIME, _ANGLE = (_of(x) for x in ("m1", "kg1", "s1", "rad1"))
_FORCE, _WORK = _of("kg1 m1 s-2"), _of("kg1 m2 s-2")
_SIZES: tuple[tuple[Dimension, str, Mapping[str, float]], ...] = (
    (_LENGTH, "m km mm cm um", {"in": 0.0254, "ft": 0.3048}),
    (_MASS, "", {"kg": 1.0, "g": 1e-3, "lb": 0.45359237}),
    (_TIME, "s ms us", {"min": 60.0, "h": 3600.0}),
    (_ANGLE, "rad mrad", {"deg": math.pi / 180, "°": math.pi / 180}),
    (_of("rad1 s-1"), "", {"rpm": math.pi / 30}),
    (_of("cycle1 s-1"), "Hz kHz", {}),
    (_FORCE, "N mN kN", {"lbf": 4.4482216152605}),
    (_WORK, "J kJ Nm", {}),
    (_of("kg1 m2 s-3"), "W kW", {}),
    (_of("A1"), "A mA", {}),
    (_of("kg1 m2 s-3 A-1"), "V mV", {}),
    (_of("kg1 m2 s-3 A-2"), "ohm mohm", {}),
)
_PREFIXES = {"k": 3, "c": -2, "m": -3, "u": -6}


class Named(float):
    """The value of a constant of a scene, in SI units; arithmetic makes plain floats of it."""

    __slots__ = ("name",)
    name: str

    def __new__(cls, value: float, name: str) -> Self:
        made = super().__new__(cls, value)
        made.name = name
        return made

    def __getnewargs__(self) -> tuple[float, str]:  # type: ignore[override]
        return float(self), self.name


class Quantity(NamedTuple):
    """number 10^ten in SI units; ten apart, so that `350 mm` is the float 0.35."""

    number: float
    ten: int
    of: Dimension
    unit: bool = False  # whether it is a unit without a number
    name: str = ""  # of a constant of the scene

    @property
    def total(self) -> float:
        """The number in SI units; of a constant with its name."""
        number = scaled(self.number, self.ten)
        return Named(number, self.name) if self.name else number


def scaled(number: float, ten: int) -> float:
    """number 10^ten; OverflowError where it is too large."""
    return number * 10.0**ten if ten >= 0 else number / 10.0**-ten


def joined(a: Quantity, b: Quantity, sign: int) -> Quantity:
    """a b, or a/b where `sign` is -1."""
    number = a.number * b.number if sign > 0 else a.number / b.number
    return Quantity(number, a.ten + sign * b.ten, times(a.of, b.of, sign))


def raised(unit: Quantity, power: float) -> Quantity:
    """A unit to a whole power, which is one."""
    number = math.pow(unit.number, power)
    return Quantity(number, int(unit.ten * power), times(PLAIN, unit.of, power), True)


def _units() -> Iterator[tuple[str, Quantity]]:
    for of, prefixed, sizes in _SIZES:
        names = prefixed.split()
        for name in names:
            ten = _PREFIXES[name[0]] if name[1:] in names else 0
            yield name, Quantity(1.0, ten, of, True)
        for name, size in sizes.items():
            small = size == 1e-3
            yield name, Quantity(1.0 if small else size, -3 * small, of, True)


UNITS = dict(_units())
# other letters for the same: ohm twice, micro twice
ALIASES = {"\u03a9": "ohm", "\u2126": "ohm", "\u00b5": "u", "\u03bc": "u"}
_FREE = ("rad", "cycle")  # a radian is 1: `N m/rad` may be written `N m`


def times(a: Dimension, b: Dimension, power: float = 1.0) -> Dimension:
    """The dimension of a product of one of dimension a and one of b to a power."""
    if not b:
        return a
    both = {base: a.get(base, 0.0) + power * b.get(base, 0.0) for base in {**a, **b}}
    return {base: exponent for base, exponent in both.items() if exponent}


def fits(found: Dimension, place: Dimension) -> bool:
    """Whether a value of this dimension may stand in a place of that one.

    A plain number is in the place's own unit; radians may be left out, and an angle where a rate
    is due is that angle a second.
    """
    if not found:
        return True
    per_second = place.get("rad") == 1.0 and set(place) == {"rad", "s"} and place["s"] < 0.0
    if per_second and found == _ANGLE:
        return True
    return all(
        found.get(base, 0.0) == place.get(base, 0.0) or (base in _FREE and base not in found)
        for base in {**found, **place}
    )


def shown_dimension(dimension: Dimension) -> str:
    """A dimension in words: its unit in SI, `kg m^2`."""
    named = {"m": _LENGTH, "kg": _MASS, "s": _TIME, "rad": _ANGLE, "N": _FORCE, "N m": _WORK}
    named |= {"V": UNITS["V"].of, "ohm": UNITS["ohm"].of, "W": UNITS["W"].of, "Hz": UNITS["Hz"].of}
    for name, own in named.items():
        if own == dimension:
            return name

    def powers(sign: float) -> list[str]:
        some = [(base, e * sign) for base, e in dimension.items() if e * sign > 0.0]
        return [base if e == 1.0 else f"{base}^{e:g}" for base, e in some]

    above, below = " ".join(powers(1.0)), powers(-1.0)
    return "/".join([above or "1", *below])
