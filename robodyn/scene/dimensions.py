"""What expressions are in: their trees folded over dimensions.

A number without a unit may be in any as a factor, and is a plain number as a part of a sum; what
has a unit must fit all that it is added to, compared with, or given to.  Radians are 1: they may be
left out beside variables, as `20 N m*q1 + 3 N m*q1^2` does; what is written in numbers and units
alone, and what is nothing but an angle, must have them right.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from robodyn.scene.expressions import COMPARISONS, ExpressionError, fold, number_of
from robodyn.scene.syntax import Node, parsed
from robodyn.scene.units import PLAIN, Dimension, Quantity, fits, shown_dimension, times

ANGULAR = ("sin", "cos", "tan")  # of an angle
ALIKE = ("abs", "min", "max", "hypot", "floor")  # of what they are of
_TAKE_ALL = ("sign",)
_RAD: Dimension = {"rad": 1.0}

Dimensions = Callable[[str], Dimension | None]  # of variables; None: it is not known


class Measure(NamedTuple):
    """The dimension of an expression, whether a unit fixes it, and whether it has a variable."""

    of: Dimension
    sure: bool = False
    varies: bool = False


Measured = Measure | None  # None: numbers without units leave it open


def measured(node: Node, dimensions: Dimensions = lambda name: None) -> Measured:
    """Return the dimension of an expression; ExpressionError if units do not fit."""

    def leaf(x: float | str | Quantity) -> Measured:
        if isinstance(x, Quantity):
            return Measure(x.of, sure=True)
        if isinstance(x, float):
            return Measure(PLAIN)
        of = dimensions(x)
        return None if of is None else Measure(of, varies=True)

    return fold(node, leaf, _measured)


def _measured(node: tuple[Any, ...], parts: list[Measured]) -> Measured:
    operation, first, varies = node[0], parts[0], any(x is None or x.varies for x in parts)
    match operation:
        case "neg":
            return first
        case "*" | "/":
            return _product(first, parts[1], -1.0 if operation == "/" else 1.0)
        case "**" | "pow":
            return _power(node, first, parts[1])
        case "+" | "-":
            return _same(node, "a sum", *parts)
        case "%":
            return _same(node, "a remainder", *parts)
        case "if":
            return _same(node, "a choice", *parts[1:])
    if operation in COMPARISONS or operation in (*ALIKE, "atan2"):
        alike = first
        for other in parts[1:]:
            alike = _same(
                node, "a comparison" if operation in COMPARISONS else operation, alike, other
            )
        return alike if operation in ALIKE else Measure(PLAIN, varies=varies)
    if operation == "sqrt":
        return first and first._replace(of=times(PLAIN, first.of, 0.5))
    for x in parts if operation not in _TAKE_ALL else ():
        angle = operation in ANGULAR and x and (x.of == _RAD or (x.varies and not _bare(x.of)))
        if x and x.sure and x.of and not angle:
            raise ExpressionError(f"{operation} of {shown_dimension(x.of)}", node)
    return Measure(PLAIN, varies=varies)


def _product(a: Measured, b: Measured, power: float) -> Measured:
    if a is None or b is None:
        return None
    alone = [x == Measure(PLAIN) for x in (a, b)]
    if any(alone) and not all(alone) and not (a.sure or b.sure):
        return None  # the number may have any unit
    return Measure(times(a.of, b.of, power), a.sure or b.sure, a.varies or b.varies)


def _power(node: tuple[Any, ...], base: Measured, exponent: Measured) -> Measured:
    if exponent and exponent.sure and _bare(exponent.of):
        raise ExpressionError(f"a power in {shown_dimension(exponent.of)}", node)
    if base is None:
        return None
    if not base.of:
        return base._replace(varies=base.varies or exponent is None or exponent.varies)
    power = number_of(node[2])
    if power is not None:
        return base._replace(of=times(PLAIN, base.of, power))
    if base.sure and _bare(base.of):
        raise ExpressionError(f"a varying power of {shown_dimension(base.of)}", node)
    return None


def _same(node: Node, what: str, a: Measured, b: Measured) -> Measured:
    """Return the common dimension of two parts; ExpressionError if there is none."""
    if a is None or b is None or not (a.sure or b.sure):
        sure = next((x for x in (a, b) if x and x.sure), None)
        return a if a == b else sure and sure._replace(varies=True)
    sure, other = (a, b) if a.sure else (b, a)
    exact, both = not (a.varies or b.varies), {**a.of, **b.of}
    if exact:
        alike = a.of == b.of or (both == _RAD and {} in (a.of, b.of))  # a number is an angle
    elif a.of and b.of and not _bare(both):
        alike = a.of == b.of  # no angle is its square
    else:
        alike = _bare(a.of) == _bare(b.of)
    # an angle where a rate is due
    if not alike and (exact or not (other.of and sure.of and fits(sure.of, other.of))):
        told = " and ".join(_told(x.of, not exact) for x in (a, b))
        raise ExpressionError(f"{what} of {told}", node)
    return Measure(both if exact else sure.of, sure=True, varies=not exact)


def _bare(of: Dimension) -> Dimension:
    """Without radians, which are 1."""
    return {base: power for base, power in of.items() if base != "rad"}


def _told(of: Dimension, varies: bool) -> str:
    return shown_dimension((varies and _bare(of)) or of) if of else "a plain number"


def misfit(found: Measured, unit: str) -> str:
    """Why an expression cannot stand in a place of this unit; nothing where it can."""
    place = dimension_of(unit)
    if found is None or not found.sure or fits(found.of, place):
        return ""
    angles = found.of and place and not _bare({**found.of, **place})
    if found.varies and not angles and _bare(found.of) == _bare(place):
        return ""
    wanted = f"in {unit}" if unit else "a plain number"
    return f"must be {wanted}, not in {_told(found.of, found.varies)}"


@lru_cache
def dimension_of(unit: str) -> Dimension:
    """The dimension of a unit in words."""
    found = measured(parsed(unit).nodes[0]) if unit else None
    return found.of if found else PLAIN
