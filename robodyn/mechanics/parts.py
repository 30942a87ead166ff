"""A mechanism with a part of what acts on it: what makes one term of its equation of motion.

Massless, weightless, without closures or dampers of joints.  Numbers may be symbols too.
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
    """The links alone, and these elements."""
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
    """The springs with a potential, whose torques are part of G."""
    return bare(mechanism, (x.stored() for x in mechanism.elements))


def loaded(mechanism: Mechanism) -> Mechanism:
    """The loads at points: without weights only those act that turn with a link."""
    return bare(mechanism, (x for x in mechanism.elements if x.is_load))


def spent(mechanism: Mechanism) -> Mechanism:
    """What makes Q: dampers of springs, forces that turn with a link or vary, friction."""
    return bare(mechanism, (x.spent() for x in mechanism.elements))


def check_lasting_gravity(mechanism: Mechanism, what: str) -> None:
    """Raise InputError, naming gravity, if it varies with the time, which `what` does not know."""
    if mechanism.description.field is not None:
        limit = f"varies with the time, which {what} does not know"
        raise InputError("gravity", where=mechanism.source, limit=limit)


def untimed(mechanism: Mechanism) -> Mechanism:
    """All that a model of a controller knows.

    Those are neither loads that depend on the time nor friction by the forces in pins.  Raises
    InputError if gravity varies.
    """
    check_lasting_gravity(mechanism, "the model of a controller")
    if not (mechanism.timed or mechanism.rubbing):
        return mechanism
    left = (x.untimed() for x in mechanism.elements)
    return replace(mechanism, elements=tuple(x for x in left if x is not None))


@lru_cache(maxsize=64)
def without_rubbing(mechanism: Mechanism) -> Mechanism:
    """All but friction by the forces in pins and slides."""
    if not mechanism.rubbing:
        return mechanism
    kept = tuple(x for x in mechanism.elements if not isinstance(x, PinFriction))
    return replace(mechanism, elements=kept)


def acting(mechanism: Mechanism) -> Mechanism:
    """Both of what is stored and what is spent."""
    return bare(mechanism, (x for x in mechanism.elements if x.acts))


def met_ends(mechanism: Mechanism, q: Sequence[Any], exp: Callable[[Any], Any]) -> dict[int, Any]:
    """Return whether the ends of each element that needs a direction meet within rounding.

    Keys are places among the elements.  The n values of `q` are floats or arrays, and `exp` is the
    complex exponential of them.  Ends that are apart by less than NOTHING of the lengths which lead
    from one to the other meet.
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
    """The error of the element of this name (`Mechanism.name_of`), whose ends coincide."""
    return SingularPoseError(
        f"the ends of {name} between two points coincide",
        where=mechanism.source,
        limit="its force has no direction there; only length 0 without damping allows that",
    )
