"""The kinds of elements that a scene has."""

from robodyn.elements.base import Element
from robodyn.elements.gravity import GravityField
from robodyn.elements.joints import (
    CompliantStop,
    DryFriction,
    HardStop,
    Rotor,
    Slipping,
    SmoothFriction,
    Stops,
)
from robodyn.elements.loads import Force, Moment
from robodyn.elements.pin_friction import PinFriction
from robodyn.elements.springs import JointDamper, JointSpring, PointSpring

KINDS: tuple[type[Element], ...] = (
    PointSpring,
    JointSpring,
    Force,
    Moment,
    JointDamper,
    SmoothFriction,
    DryFriction,
    PinFriction,
    Slipping,
    Stops,
    HardStop,
    CompliantStop,
    Rotor,
    GravityField,
)


def place_of(element: Element) -> int:
    """Return the order of an element's kind; unknown kinds come last."""
    return KINDS.index(type(element)) if type(element) in KINDS else len(KINDS)
