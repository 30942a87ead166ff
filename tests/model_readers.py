"""Reads URDF and MJCF in three dimensions, by what their references say, and nothing of robodyn.

A model is a tree of bodies, each fixed to its parent, turning about an axis or sliding along it.
From frames alone,

    M = sum_b m Jv^T Jv + Jw^T I Jw        G = -sum_b m Jv^T g

with the columns Jv_j = a_j x (c_b - p_j), Jw_j = a_j of the joints j below body b; where j slides
Jv_j = a_j, Jw_j = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

Array = np.ndarray
Powers = tuple[float, ...]


@dataclass
class Body:
    """A body: where its joint's frame stands in its parent's, its joint, its mass."""

    name: str
    parent: str
    place: Array  # (3,)
    turn: Array  # (3, 3)
    joint: str | None = None  # None: fixed
    axis: Array | None = None
    slides: bool = False
    damping: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    springref: float = 0.0
    friction: float = 0.0
    range: tuple[float, float] | None = None
    ref: float = 0.0  # its coordinate where the frames are those of the file
    mass: float = 0.0
    centre: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))  # about the centre


@dataclass
class Model:
    """What a file says; the bodies stand after their parents."""

    name: str
    root: str
    bodies: list[Body]
    gravity: Array | None = None
    sites: dict[str, tuple[str, Array]] = field(default_factory=dict)
    connects: list[tuple[str, str]] = field(default_factory=list)
    # pairs of tendons, each a pair of sites, and y - y0 = a0 + a1 (x - x0) + ...
    equal_tendons: list[tuple[tuple[str, str], tuple[str, str], list[float]]] = field(
        default_factory=list
    )
    # sums of joints that are constant: {joint: factor}, and the constant
    sums: list[tuple[dict[str, float], float]] = field(default_factory=list)
    # springs along tendons: the sites, or {joint: factor}; powers of stiffness, where it is
    # slack, powers of damping
    springs: list[tuple[tuple[str, str] | dict[str, float], Powers, Powers, Powers]] = field(
        default_factory=list
    )
    # constant wrenches on a site, in the frame of it or of another
    wrenches: list[tuple[str, str | None, Array]] = field(default_factory=list)
    motors: list[str] = field(default_factory=list)
    # inertias of sums of joints: the inertia, and {joint: factor}
    spun: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    keys: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def joints(self) -> list[str]:
        return [body.joint for body in self.bodies if body.joint is not None]

    @property
    def begin(self) -> dict[str, float]:
        """MuJoCo's qpos0, where it begins, and where equalities count from."""
        return {body.joint: body.ref for body in self.bodies if body.joint is not None}

    def frames(self, q: Mapping[str, float]) -> dict[str, tuple[Array, Array]]:
        """Position and orientation of each body."""
        found = {self.root: (np.zeros(3), np.eye(3))}
        for body in self.bodies:
            place, turn = found[body.parent]
            here, there = turn @ body.turn, place + turn @ body.place
            if body.slides:
                there = there + here @ body.axis * (q[body.joint] - body.ref)
            elif body.joint is not None:
                here = here @ rotation(body.axis, q[body.joint] - body.ref)
            found[body.name] = there, here
        return found

    def slopes(self, q: Mapping[str, float], name: str, at: Array) -> tuple[Array, Array, Array]:
        """A point of a body: where it is, Jv (3, n) and Jw (3, n) in the order of `joints`."""
        frames, bodies = self.frames(q), {body.name: body for body in self.bodies}
        place, turn = frames[name]
        point = place + turn @ at
        Jv, Jw = np.zeros((2, 3, len(self.joints)))
        while name != self.root:
            body = bodies[name]
            if body.joint is not None:
                pivot, turn = frames[name]
                axis = turn @ body.axis
                j = self.joints.index(body.joint)
                if body.slides:
                    Jv[:, j] = axis
                else:
                    Jv[:, j], Jw[:, j] = np.cross(axis, point - pivot), axis
            name = body.parent
        return point, Jv, Jw

    def site(self, q: Mapping[str, float], name: str) -> tuple[Array, Array]:
        """A site: where it is (3,), and its Jacobian (3, n)."""
        body, at = self.sites[name]
        return self.slopes(q, body, at)[:2]

    def length(self, q: Mapping[str, float], ends: tuple[str, str]) -> tuple[float, Array]:
        """A tendon between two sites: its length, and its gradient (n,)."""
        (a, Ja), (b, Jb) = (self.site(q, name) for name in ends)
        length = float(np.linalg.norm(a - b))
        return length, (a - b) @ (Ja - Jb) / length

    def terms(self, q: Mapping[str, float], gravity: Array) -> tuple[Array, Array]:
        """M (n, n) and G (n,), in the order of `joints`."""
        n, frames = len(self.joints), self.frames(q)
        M, G = np.zeros((n, n)), np.zeros(n)
        for body in self.bodies:
            _, Jv, Jw = self.slopes(q, body.name, body.centre)
            turn = frames[body.name][1]
            M += body.mass * Jv.T @ Jv + Jw.T @ turn @ body.inertia @ turn.T @ Jw
            G -= body.mass * Jv.T @ gravity
            if body.joint is not None:
                j = self.joints.index(body.joint)
                M[j, j] += body.armature
        for inertia, factors in self.spun:
            row = np.array([factors.get(joint, 0.0) for joint in self.joints])
            M += inertia * np.outer(row, row)
        return M, G

    def forces(self, q: Mapping[str, float], qd: Mapping[str, float]) -> Array:
        """Joint torques (n,) of springs, dampers and constant wrenches."""
        Q, frames = np.zeros(len(self.joints)), self.frames(q)
        rates = np.array([qd[name] for name in self.joints])
        for body in self.bodies:
            if body.joint is not None:
                j = self.joints.index(body.joint)
                Q[j] -= body.stiffness * (q[body.joint] - body.springref) + body.damping * rates[j]
        for ends, stiffness, slack, damping in self.springs:
            if isinstance(ends, dict):
                slope = np.array([ends.get(joint, 0.0) for joint in self.joints])
                stretched = slope @ [q[joint] for joint in self.joints]
            else:
                stretched, slope = self.length(q, ends)
            x, v = stretched - np.clip(stretched, *slack), slope @ rates
            pull = sum(c * x ** (k + 1) for k, c in enumerate(stiffness))
            drag = sum(c * np.abs(v) ** k for k, c in enumerate(damping)) * v
            Q -= (pull + drag) * slope
        for site, frame, wrench in self.wrenches:
            body, at = self.sites[site]
            _, Jv, Jw = self.slopes(q, body, at)
            turn = frames[body if frame is None else self.sites[frame][0]][1]
            assert frame is None or self.sites[frame][0] == "world"
            Q += Jv.T @ turn @ wrench[:3] + Jw.T @ turn @ wrench[3:]
        return Q


def rotation(axis: Array, angle: float) -> Array:
    """Rodrigues' formula for a unit axis."""
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def numbers(text: str | None, count: int, missing: float = 0.0) -> Array:
    values = np.array([float(word) for word in (text or "").split()] or [missing] * count)
    assert values.shape == (count,), text
    return values


def unit(text: str | None) -> Array:
    axis = numbers(text, 3)
    assert abs(np.linalg.norm(axis) - 1.0) < 1e-15
    return axis


def one(parent: Element, tag: str) -> Element:
    (found,) = parent.findall(tag)
    return found


def read_urdf(text: str) -> Model:
    robot = ElementTree.fromstring(text)
    assert robot.tag == "robot"
    links = {link.get("name"): link for link in robot.findall("link")}
    assert len(links) == len(robot.findall("link"))
    joints = {one(joint, "child").get("link"): joint for joint in robot.findall("joint")}
    assert len(joints) == len({joint.get("name") for joint in robot.findall("joint")})
    (root,) = links.keys() - joints.keys()
    bodies: list[Body] = []
    sums: list[tuple[dict[str, float], float]] = []

    def add(parent: str) -> None:
        for name, joint in joints.items():
            if one(joint, "parent").get("link") != parent:
                continue
            place, turn = _urdf_origin(joint)
            body = Body(name, parent, place, turn)
            if joint.get("type") in ("continuous", "prismatic", "revolute"):
                body.joint, body.axis = joint.get("name"), unit(one(joint, "axis").get("xyz"))
                body.slides = joint.get("type") == "prismatic"
                if joint.get("type") != "continuous":
                    limit = one(joint, "limit").attrib
                    assert limit.keys() == {"lower", "upper", "effort", "velocity"}
                    body.range = float(limit["lower"]), float(limit["upper"])
            else:
                assert joint.get("type") == "fixed"
            for mimic in joint.findall("mimic"):
                ratios = {body.joint: 1.0, mimic.get("joint"): -float(mimic.get("multiplier"))}
                sums.append((ratios, float(mimic.get("offset"))))
            for dynamics in joint.findall("dynamics"):
                body.damping = float(dynamics.get("damping", "0"))
                body.friction = float(dynamics.get("friction", "0"))
            for inertial in links[name].findall("inertial"):
                body.centre, turn = _urdf_origin(inertial)
                body.mass = float(one(inertial, "mass").get("value"))
                moments = one(inertial, "inertia")
                body.inertia = turn @ _symmetric(moments) @ turn.T
            bodies.append(body)
            add(name)

    add(root)
    assert len(bodies) == len(joints)
    return Model(robot.get("name"), root, bodies, sums=sums)


def _urdf_origin(element: Element) -> tuple[Array, Array]:
    origin = one(element, "origin")
    roll, pitch, yaw = numbers(origin.get("rpy"), 3)
    x, y, z = np.eye(3)
    turn = rotation(z, yaw) @ rotation(y, pitch) @ rotation(x, roll)
    return numbers(origin.get("xyz"), 3), turn


def _symmetric(moments: Element) -> Array:
    def get(key: str) -> float:
        return float(moments.get(key))

    return np.array([[get("i" + "".join(sorted(a + b))) for b in "xyz"] for a in "xyz"])


def read_mjcf(text: str) -> Model:
    root = ElementTree.fromstring(text)
    assert root.tag == "mujoco"
    assert one(root, "compiler").attrib == {"angle": "radian"}
    model = Model(root.get("model"), "world", [])
    model.gravity = numbers(one(root, "option").get("gravity"), 3)

    def add(element: Element, name: str) -> None:
        for site in element.findall("site"):
            assert site.get("name") not in model.sites
            model.sites[site.get("name")] = name, numbers(site.get("pos"), 3)
        for child in element.findall("body"):
            assert {"name", "pos"} <= set(child.keys()) <= {"name", "pos", "xyaxes"}
            turn = np.eye(3)
            if "xyaxes" in child.attrib:
                turn[:2] = numbers(child.get("xyaxes"), 6).reshape(2, 3)
                assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-15
            body = Body(child.get("name"), name, numbers(child.get("pos"), 3), turn.T)
            for joint in child.findall("joint"):
                assert joint.get("type") in ("hinge", "slide")
                body.slides = joint.get("type") == "slide"
                assert "pos" not in joint.attrib
                body.ref = float(joint.get("ref", "0"))
                assert ("range" in joint.attrib) == ("limited" in joint.attrib)
                if "range" in joint.attrib:
                    body.range = tuple(numbers(joint.get("range"), 2).tolist())
                body.friction = float(joint.get("frictionloss", "0"))
                body.armature = float(joint.get("armature", "0"))
                body.joint, body.axis = joint.get("name"), unit(joint.get("axis"))
                body.damping, body.stiffness, body.springref = (
                    float(joint.get(key, "0")) for key in ("damping", "stiffness", "springref")
                )
            inertial = one(child, "inertial")
            body.mass = float(inertial.get("mass"))
            body.centre = numbers(inertial.get("pos"), 3)
            body.inertia = np.diag(numbers(inertial.get("diaginertia"), 3))
            model.bodies.append(body)
            add(child, body.name)

    add(one(root, "worldbody"), "world")
    names = [body.name for body in model.bodies]
    assert len(set(names)) == len(names)
    assert len(set(model.joints)) == len(model.joints)
    tendons = {
        tendon.get("name"): tuple(site.get("site") for site in tendon.findall("site"))
        for tendon in root.findall("tendon/spatial")
    }
    for connect in root.findall("equality/connect"):
        model.connects.append((connect.get("site1"), connect.get("site2")))
    fixed = {
        tendon.get("name"): {x.get("joint"): float(x.get("coef")) for x in tendon.findall("joint")}
        for tendon in root.findall("tendon/fixed")
    }
    for tendon in root.findall("tendon/fixed"):
        if "armature" in tendon.attrib:
            model.spun.append((float(tendon.get("armature")), fixed[tendon.get("name")]))

    def counted(ratios: Mapping[str, float]) -> float:
        return sum(ratio * model.begin[joint] for joint, ratio in ratios.items())

    for equal in root.findall("equality/joint"):
        a0, a1, *others = numbers(equal.get("polycoef"), 5).tolist()
        assert others == [0, 0, 0]
        ratios = {equal.get("joint1"): 1.0}
        if "joint2" in equal.attrib:
            ratios[equal.get("joint2")] = -a1
        model.sums.append((ratios, a0 + counted(ratios)))
    for equal in root.findall("equality/tendon"):
        if "tendon2" not in equal.attrib:
            a0, *others = numbers(equal.get("polycoef"), 5).tolist()
            assert others == [0, 0, 0, 0]
            ratios = fixed[equal.get("tendon1")]
            model.sums.append((ratios, a0 + counted(ratios)))
            continue
        pair = (tendons[equal.get(key)] for key in ("tendon1", "tendon2"))
        model.equal_tendons.append((*pair, numbers(equal.get("polycoef"), 5).tolist()))
    for tendon in root.findall("tendon/*"):
        if "stiffness" in tendon.attrib or "damping" in tendon.attrib:
            stiffness, slack, damping = (
                tuple(float(word) for word in tendon.get(key, "0").split())
                for key in ("stiffness", "springlength", "damping")
            )
            assert max(len(stiffness), len(damping)) <= 3
            name = tendon.get("name")
            ends = tendons[name] if tendon.tag == "spatial" else fixed[name]
            model.springs.append((ends, stiffness, (slack[0], slack[-1]), damping))
    for general in root.findall("actuator/general"):
        constant = {"gainprm": "0", "biastype": "affine", "biasprm": "1 0 0"}
        assert constant.items() <= general.attrib.items()
        wrench = numbers(general.get("gear"), 6)
        model.wrenches.append((general.get("site"), general.get("refsite"), wrench))
    actuators = [actuator.get("name") for actuator in root.findall("actuator/*")]
    assert len(set(actuators)) == len(actuators)
    for motor in root.findall("actuator/motor"):
        assert motor.get("gear") == "1"
        model.motors.append(motor.get("joint"))
    for key in root.findall("keyframe/key"):
        values = numbers(key.get("qpos"), len(model.joints)).tolist()
        model.keys[key.get("name")] = dict(zip(model.joints, values, strict=True))
    return model
