"""Mechanism -> MJCF: the models of MuJoCo.

    https://mujoco.readthedocs.io/en/stable/XMLreference.html

A closure or coupling is an equality constraint, which MuJoCo keeps softly: its force is what brings
the error to nothing in a few time steps.  The elements of a model are in `mjcf_elements.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

from robodyn.errors import InputError, printable
from robodyn.export.mjcf_elements import Elements
from robodyn.export.model_xml import (
    INERTIA_REMARKS,
    comment,
    document,
    number,
    refuse_unsaid,
    vector,
)
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Description

TIMESTEP = 1e-3  # s
MINIMUM = 1e-15  # kg and kg m^2: mjMINVAL, below which MuJoCo refuses what moves
REASONS = {"friction": "MuJoCo has no friction by tanh(qd/speed); its frictionloss is another law"}
SAID = ("closures", "springs", "loads", "couplings")
PAYLOAD_REMARKS = ("A payload is a point mass: a body without a joint and without inertia.",)
SOFT_REMARKS = (
    "Loops and couplings are held by equality constraints, as stiff as the time step allows.  They",
    "are open where all joints are zero: start where they hold, such as from a keyframe.",
)
LOAD_REMARKS = ("A load is an actuator of constant force: its control does nothing.",)
SLIDER_REMARKS = (
    "A slider's line holds the points as far from one site of the ground as from another: two",
    "tendons of equal length.  MuJoCo leaves out the centripetal acceleration along tendons, so",
    "that fast motions need a short time step.",
)


def mjcf(mechanism: Mechanism, timestep: float = TIMESTEP, q: Sequence[float] | None = None) -> str:
    """The mechanism as MJCF text, with the keyframe `start` at the joint angles q (n,), rad.

    Joint i, named after link i as its body, has the coordinate q_i; each actuated joint has a
    motor of that name, its control the torque, N m.  Raises InputError for what MJCF cannot
    say, and for links without mass or inertia, which MuJoCo refuses.
    """
    description = mechanism.description
    refuse_unsaid(description, "MJCF", REASONS, SAID)
    _refuse_massless(description)
    model = Elements(mechanism)
    root = Element("mujoco", model=printable(mechanism.name))
    SubElement(root, "compiler", angle="radian")
    option = SubElement(root, "option", timestep=number(timestep), integrator="RK4")
    option.set("gravity", vector(mechanism.gamma))
    SubElement(option, "flag", contact="disable")
    if len(model.equality):
        default = SubElement(root, "default")
        # the shortest time constant that is stable, and the least softness that MuJoCo takes
        stiff = {"solref": f"{number(2.0 * timestep)} 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
        SubElement(default, "equality", stiff)
    parts = model.world, model.tendon, model.equality, model.actuator
    root.extend(part for part in parts if len(part))
    if q is not None:
        keys = SubElement(root, "keyframe")
        angles = " ".join(number(q[k]) for k in model.order)
        SubElement(keys, "key", name="start", qpos=angles)
    return document(root, comment(mechanism, model.names, _remarks(description)))


def _remarks(description: Description) -> list[str]:
    remarks = [*INERTIA_REMARKS]
    for there, more in (
        (any(link.payload for link in description.links), PAYLOAD_REMARKS),
        (description.loads, LOAD_REMARKS),
        (description.closures or description.couplings, SOFT_REMARKS),
        (any(closure.along is not None for closure in description.closures), SLIDER_REMARKS),
    ):
        remarks += more if there else ()
    return remarks


def _refuse_massless(description: Description) -> None:
    for k, link in enumerate(description.links):
        for key, value in (("m", link.m), ("I", link.I)):
            if value < MINIMUM:
                limit = f"MuJoCo takes nothing that moves with less than {MINIMUM:g} of mass (kg)"
                limit += " or inertia (kg m^2): give it a little"
                place = f"links[{k}] ({link.name}).{key}"
                raise InputError(place, where=description.source, value=value, limit=limit)
