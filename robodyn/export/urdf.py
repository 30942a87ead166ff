"""Mechanism -> URDF: the robot description of ROS, which Pinocchio and others read.

    https://wiki.ros.org/urdf/XML

URDF describes trees, without gravity and without a choice of driven joints; both are told in the
comment of the file.  A coupled joint is one that mimics another.  A joint has the name of its link,
a link that name and `_link`, as is the custom: some readers want all names of a model to differ.
"""

from __future__ import annotations

from cmath import phase
from collections.abc import Iterator
from xml.etree.ElementTree import Element, SubElement

from robodyn.errors import InputError, printable
from robodyn.export.model_xml import (
    FAR,
    Names,
    comment,
    document,
    dry_friction,
    link_names,
    number,
    refuse_unsaid,
    vector,
)
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Link
from robodyn.scene.welds import Welded

REASONS = {
    "closures": "URDF describes trees, it has no closed loops; MJCF has",
    "springs": "URDF has no springs; MJCF has",
    "loads": "URDF has no loads; MJCF has",
    "friction": "URDF has no friction by tanh(qd/speed) or Stribeck's, only the bare torque",
    "motor": "URDF has no inertia of rotors; MJCF has",
}


def urdf(mechanism: Mechanism) -> str:
    """The mechanism as URDF text.

    Joint i, named after link i, has the coordinate q_i.  Raises InputError for what URDF
    cannot say: closures, springs, loads, smooth friction, rotors, and couplings of more than two
    joints.
    """
    mechanism.check_masses(still=True)
    plain = [] if mechanism.spins else ["motor"]  # a gear alone is no matter of dynamics
    refuse_unsaid(mechanism, "URDF", REASONS, ["couplings", "limits", *plain])
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
        turns = "revolute" if link.limits is not None else "continuous"
        kind, ends = "prismatic" if link.slides else turns, (parent, bodies[k])
        joint = _joint(root, joints[k], kind, ends, link.hangs_from.at, link.axis or link.turn)
        SubElement(joint, "axis", xyz="1 0 0" if link.slides else "0 0 1")
        if limits := _limits(link):
            SubElement(joint, "limit", {name: number(x) for name, x in limits.items()})
        damping, (friction, _) = mechanism.damping[k], dry_friction(link)
        if damping or friction:
            dynamics = {"damping": number(damping), "friction": number(friction)}
            SubElement(joint, "dynamics", dynamics)
        if k in couplings:
            ((other, ratio),) = couplings[k].terms
            mimic = {"multiplier": number(ratio), "offset": number(couplings[k].angle)}
            SubElement(joint, "mimic", {"joint": joints[other]} | mimic)
        if link.payload:
            payload = names.new(f"{joints[k]}_payload")
            body = names.new(f"{payload}_link")
            _link(root, body, link.payload, 0j, 0.0)
            _joint(root, payload, "fixed", (bodies[k], body), complex(link.l))
    welded = Welded(mechanism.description)
    for w, weld in enumerate(mechanism.description.welds):  # its mass is that of its carrier
        (above, at), turn = welded.frame(mechanism.n + w)
        own = names.new(weld.name)
        body = names.new(f"{own}_link")
        _link(root, body, 0.0, 0j, 0.0)
        _joint(root, own, "fixed", (ground if above is None else bodies[above], body), at, turn)
    return document(root, comment(mechanism, joints))


def urdf_notes(mechanism: Mechanism) -> Iterator[str]:
    """Yield what URDF does not hold of stops and dry friction."""
    for link in mechanism.description.links:
        if link.limits is not None:
            told = "URDF says where it ends; what happens there is left to who reads it"
            yield f"joint {link.name}: {told}"
        moving, static = dry_friction(link)
        if static > moving:
            told = f"URDF's friction is {moving:g}"
            yield f"joint {link.name}: {told} at rest too, not {static:g}"


def _limits(link: Link) -> dict[str, float]:
    """Return a joint's limits: its ends, and the largest effort and speed of its motor."""
    motor, stop = link.motor, link.limits
    most = motor is not None and bool(motor.torque_max or motor.speed_max)
    if stop is None and not link.slides and not most:
        return {}
    low, high = (None, None) if stop is None else (stop.low, stop.high)
    effort = speed = FAR
    if motor is not None:
        effort = motor.torque_max * abs(motor.ratio) if motor.torque_max else FAR
        speed = motor.speed_max / abs(motor.ratio) if motor.speed_max else FAR
    ends = {"lower": -FAR if low is None else low, "upper": FAR if high is None else high}
    return (ends if link.slides or stop is not None else {}) | {"effort": effort, "velocity": speed}


def _joint(
    root: Element, name: str, kind: str, ends: tuple[str, str], at: complex, axis: complex = 1.0
) -> Element:
    """A joint at this place of its parent, its x axis along `axis` there."""
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=ends[0])
    SubElement(joint, "child", link=ends[1])
    turned = f"0 0 {number(phase(axis))}" if axis != 1.0 else "0 0 0"
    SubElement(joint, "origin", xyz=vector(at), rpy=turned)
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
