"""A mechanism with only a part of its forces, for single terms of its equation of motion.

It has no masses, weights, closures or joint dampers.  Numbers may be symbols.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from robodyn.elements.base import Element
from robodyn.elements.pin_friction import PinFriction
from robodyn.errors import InputError, SingularPoseError
from robodyn.mechanics.planar_model import Mechanism

NOTHING = 8 * sys.float_info.epsilon  # part of the lengths to a distance that is rounding


def bare(mechanism: Mechanism, elements: Iterable[Element | None] = ()) -> Mechanism:
    """Return the links alone, with these elements."""
    zero = (0.0,) * mechanism.n
    return replace(
        mechanism,
        A=(),
        rows=(),
        weights=zero,
        moments=zero,
        energy_offset=0.0,
        ranges=(),
        elements=tuple(x for x in elements if x is not None),
    )


def stored(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with only the springs that have a potential, which are part of G."""
    return bare(mechanism, (x.stored() for x in mechanism.elements))


def loaded(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with only its loads at points."""
    return bare(mechanism, (x for x in mechanism.elements if x.is_load))


def spent(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with only the forces of Q: dampers, varying loads, friction."""
    return bare(mechanism, (x.spent() for x in mechanism.elements))


def check_lasting_gravity(mechanism: Mechanism, what: str) -> None:
    """Raise InputError if gravity varies in time, which `what` does not support."""
    if mechanism.description.field is not None:
        limit = f"varies with the time, which {what} does not know"
        raise InputError("gravity", where=mechanism.source, limit=limit)


def untimed(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism as a controller's model knows it.

    Loads that depend on time and friction by the forces in pins are left out.  Raises InputError if
    gravity varies.
    """
    check_lasting_gravity(mechanism, "the model of a controller")
    if not (mechanism.timed or mechanism.rubbing):
        return mechanism
    left = (x.untimed() for x in mechanism.elements)
    return replace(mechanism, elements=tuple(x for x in left if x is not None))


@lru_cache(maxsize=64)
def without_rubbing(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism without friction by the forces in pins and slides."""
    if not mechanism.rubbing:
        return mechanism
    kept = tuple(x for x in mechanism.elements if not isinstance(x, PinFriction))
    return replace(mechanism, elements=kept)


def acting(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with its springs, loads and friction only."""
    return bare(mechanism, (x for x in mechanism.elements if x.acts))


def met_ends(mechanism: Mechanism, q: Sequence[Any], exp: Callable[[Any], Any]) -> dict[int, Any]:
    """Return whether the ends of each element that needs a direction coincide.

    Keys are indices of elements.  The n values of `q` are floats or arrays, and `exp` is their
    complex exponential.  Ends closer than NOTHING times the lengths between them count as
    coincident.
    """
    x, met = list(q), {}
    for k in mechanism.order if mechanism.parted else ():
        if (above := mechanism.above[k]) is not None:
            x[k] = x[k] + x[above]
    for place, between in mechanism.parted:
        apart, lengths = between.constant, abs(between.constant)
        for k, c in between.terms:
            turned = mechanism.frames[k]
            part = c * (x[k] if k in mechanism.slides else 1.0)
            part = part if turned is None else part * exp(1j * x[turned])
            apart, lengths = apart + part, lengths + abs(part)
        met[place] = abs(apart) <= NOTHING * lengths
    return met


def no_direction(mechanism: Mechanism, name: str) -> SingularPoseError:
    """Return the error for the element `name`, whose ends coincide."""
    return SingularPoseError(
        f"the ends of {name} between two points coincide",
        where=mechanism.source,
        limit="its force has no direction there; only length 0 without damping allows that",
    )
