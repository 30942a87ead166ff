"""The kinds of elements that a scene has."""

from robodyn.elements.base import Element
from robodyn.elements.joints import (
    CompliantStop,
    DryFriction,
    HardStop,
    Rotor,
    Slipping,
    SmoothFriction,
)
from robodyn.elements.loads import Force, VaryingMoment
from robodyn.elements.springs import JointDamper, JointSpring, PointSpring

KINDS: tuple[type[Element], ...] = (
    PointSpring,
    JointSpring,
    Force,
    VaryingMoment,
    JointDamper,
    SmoothFriction,
    DryFriction,
    Slipping,
    HardStop,
    CompliantStop,
    Rotor,
)
