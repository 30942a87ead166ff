"""Mechanism -> URDF: the robot description of ROS, which Pinocchio and others read.

    https://wiki.ros.org/urdf/XML

URDF describes trees, without gravity and without a choice of driven joints; both are told in the
comment of the file.  A coupled joint is one that mimics another.  A joint has the name of its link,
a link that name and `_link`, as is the custom: some readers want all names of a model to differ.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from robodyn.errors import InputError, printable
from robodyn.export.model_xml import (
    INERTIA_REMARKS,
    Names,
    comment,
    document,
    link_names,
    number,
    refuse_unsaid,
    vector,
)
from robodyn.mechanics.mechanism import Mechanism

REASONS = {
    "closures": "URDF describes trees, it has no closed loops; MJCF has",
    "springs": "URDF has no springs; MJCF has",
    "loads": "URDF has no loads; MJCF has",
    "friction": "URDF has no friction by tanh(qd/speed), only the bare torque",
}
REMARKS = (
    "URDF has no gravity: set it where this file is loaded.  Pinocchio stores the angle of an",
    "unlimited (continuous) joint as its cosine and sine.",
    *INERTIA_REMARKS,
)
MIMIC_REMARKS = (
    "A joint with `mimic` follows another.  Pinocchio leaves it free without mimic=True, and",
    "counts the angle that it follows from -pi to pi.",
)
PAYLOAD_REMARKS = ("A payload is a point mass on a fixed joint.",)


def urdf(mechanism: Mechanism) -> str:
    """The mechanism as URDF text.

    Joint i, named after link i, has the coordinate q_i.  Raises InputError for what URDF
    cannot say: closures, springs, loads, friction, and couplings of more than two joints.
    """
    refuse_unsaid(mechanism.description, "URDF", REASONS, ["couplings"])
    couplings = {coupling.joint: coupling for coupling in mechanism.description.couplings}
    for c, coupling in enumerate(mechanism.description.couplings):
        if len(coupling.terms) != 1 or coupling.terms[0][0] in couplings:
            limit = "URDF's joints follow one joint (`mimic`) that follows none; MJCF has others"
            raise InputError(f"couplings[{c}]", where=mechanism.source, limit=limit)
    names = Names()
    joints = link_names(mechanism, names)
    ground = names.new("ground")
    bodies = [names.new(f"{joint}_link") for joint in joints]
    root = Element("robot", name=printable(mechanism.name))
    SubElement(root, "link", name=ground)
    for k in mechanism.order:
        link = mechanism.description.links[k]
        above = link.hangs_from.link
        parent = ground if above is None else bodies[above]
        _link(root, bodies[k], link.m, link.r, link.I)
        joint = _joint(root, joints[k], "continuous", (parent, bodies[k]), link.hangs_from.at)
        SubElement(joint, "axis", xyz="0 0 1")
        if link.damping:
            SubElement(joint, "dynamics", damping=number(link.damping), friction="0.0")
        if k in couplings:
            ((other, ratio),) = couplings[k].terms
            mimic = {"multiplier": number(ratio), "offset": number(couplings[k].angle)}
            SubElement(joint, "mimic", {"joint": joints[other]} | mimic)
        if link.payload:
            payload = names.new(f"{joints[k]}_payload")
            body = names.new(f"{payload}_link")
            _link(root, body, link.payload, 0j, 0.0)
            _joint(root, payload, "fixed", (bodies[k], body), complex(link.l))
    remarks = [*REMARKS]
    if couplings:
        remarks += MIMIC_REMARKS
    if any(link.payload for link in mechanism.description.links):
        remarks += PAYLOAD_REMARKS
    return document(root, comment(mechanism, joints, remarks))


def _joint(root: Element, name: str, kind: str, ends: tuple[str, str], at: complex) -> Element:
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=ends[0])
    SubElement(joint, "child", link=ends[1])
    SubElement(joint, "origin", xyz=vector(at), rpy="0 0 0")
    return joint


def _link(root: Element, name: str, m: float, r: complex, I: float) -> None:
    link = SubElement(root, "link", name=name)
    if m == 0.0 and I == 0.0:
        return  # a link without `inertial` has no mass
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=vector(r), rpy="0 0 0")
    SubElement(inertial, "mass", value=number(m))
    moment, none = number(I), number(0.0)
    SubElement(
        inertial, "inertia", ixx=moment, ixy=none, ixz=none, iyy=moment, iyz=none, izz=moment
    )
