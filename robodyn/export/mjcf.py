"""Mechanism -> MJCF: the models of MuJoCo.

    https://mujoco.readthedocs.io/en/stable/XMLreference.html

A closure or coupling is an equality constraint, which MuJoCo keeps softly: its force is what brings
the error to nothing in a few time steps.  A pin is a `connect` of two sites (MuJoCo 3.2.3 or
newer).  A slider needs no body of its own: its line holds the points that are as far from one
ground site as from another, its mirror image in the line, so that two spatial tendons from these to
the point are held to equal lengths.  On the line of a link the sites are that link's; an angle that
a closure keeps is a sum of joints, which counts from turn to turn.  M and C stay those of the
scene.  But MuJoCo leaves out Psidot qd of tendons (and of connects before 3.7); the error that this
makes in a motion falls with the square of the time step.
"""

from __future__ import annotations

from cmath import phase, rect
from collections.abc import Iterable, Mapping, Sequence
from math import nextafter, pi
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from robodyn.elements.joints import DryFriction, SmoothFriction, Stops
from robodyn.elements.loads import Force, Moment
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.errors import InputError, printable
from robodyn.export.model_xml import (
    LIMIT,
    Names,
    comment,
    document,
    is_slack,
    joint_contacts,
    joint_range,
    link_names,
    number,
    polynomial,
    refuse_unsaid,
    vector,
)
from robodyn.loops.assembly import first_pose
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import placed
from robodyn.scene.scene import Closure, Coupling, Point, Signal

TIMESTEP = 1e-3  # s
MINIMUM = 1e-15  # kg and kg m^2: mjMINVAL, below which MuJoCo refuses what moves
DEEPEST = 495  # links in a row; MuJoCo's XML reader takes elements nested 500 deep
REASONS = {
    "friction": "MuJoCo has no friction by tanh(qd/speed), nor Stribeck's: its own is another"
}
KINDS = (PointSpring, JointSpring, Force, Moment, SmoothFriction, DryFriction, Stops)
SAID = ("closures", "springs", "loads", "couplings", "motor", "limits")


def mjcf(mechanism: Mechanism, timestep: float = TIMESTEP, q: Sequence[float] | None = None) -> str:
    """The mechanism as MJCF text, in which MuJoCo begins at the closed configuration q (n,).

    That is the keyframe `start` too.  Without q a mechanism with closures or couplings begins where
    it closes (`first_pose`); another begins at zero, without a keyframe.

    Joint i, named after link i as its body, has the coordinate q_i; each actuated joint has a
    motor of that name, its control the torque, N m, or the force, N.  Angles that closures keep
    are in the turn nearest to q.  Raises InputError for what MJCF cannot say, and for links without
    mass or inertia, which MuJoCo refuses; AssemblyError where no pose is found that closes.
    """
    check_mjcf(mechanism)
    if q is None and mechanism.rows:
        q = first_pose(mechanism, t=0.0).tolist()
    model = _Elements(mechanism, timestep, q)
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
    return document(root, comment(mechanism, model.names))


def check_mjcf(mechanism: Mechanism) -> None:
    """Raise InputError for what MJCF cannot say, and for links without mass or inertia."""
    mechanism.check_masses(still=True)
    description = mechanism.description
    refuse_unsaid(mechanism, "MJCF", REASONS, SAID, _unsaid, KINDS)
    for k, link in enumerate(description.links):
        for key, value in (("m", link.m), ("I", link.I)):
            if value < MINIMUM and (key == "m" or mechanism.frames[k] is not None):
                limit = f"MuJoCo takes nothing that moves with less than {MINIMUM:g} of mass (kg)"
                limit += " or inertia (kg m^2): give it a little"
                place = f"links[{k}] ({link.name}).{key}"
                raise InputError(place, where=description.source, value=value, limit=limit)


def _unsaid(place: str, signal: Signal) -> str:
    """Why MJCF does not have what varies; empty where it has."""
    if place.startswith("gravity"):
        return "MJCF has constant gravity alone"
    if not place.startswith("springs"):
        return "MJCF has constant loads alone"
    return "" if polynomial(signal) is not None else LIMIT


class _Elements:
    """The elements of a mechanism's model, made as it is created.

    `world` holds the bodies, `names` of the links; `order` has the links as MuJoCo orders joints.
    """

    def __init__(self, mechanism: Mechanism, timestep: float, q: Sequence[float] | None) -> None:
        self.mechanism, description = mechanism, mechanism.description
        self.timestep = timestep
        self.tree, self.q = Tree(description.links), q or [0.0] * mechanism.n
        self.links, names = description.links, Names()
        self.names = link_names(mechanism, names)
        self.payloads = [
            names.new(f"{name}_payload") if link.payload else ""
            for name, link in zip(self.names, self.links, strict=True)
        ]
        self.world, self.tendon = Element("worldbody"), Element("tendon")
        self.equality, self.actuator = Element("equality"), Element("actuator")
        self.order: list[int] = []
        self._sites: dict[int | None, list[dict[str, str]]] = {}
        for c, closure in enumerate(description.closures):
            self._close(f"closure{c + 1}", closure)
        for c, coupling in enumerate(description.couplings):
            self._couple(f"coupling{c + 1}", coupling)
        for p, spring in enumerate(description.springs):
            if isinstance(spring, (PointSpring, JointSpring)):
                self._spring(f"spring{p + 1}", spring)
        for k, stop in enumerate(link.limits for link in self.links):
            if stop is not None and is_slack(stop):
                pushes = {
                    "springlength": joint_range(stop),
                    "stiffness": number(stop.stiffness or 0.0),
                }
                self._fixed(f"stop{k + 1}", [(k, 1.0)], pushes)
        for spin in mechanism.spins:
            *_, k = spin.rates
            if len(spin.rates) > 1:  # else it is the armature of its joint
                has = {"armature": number(spin.inertia)}
                self._fixed(f"rotor{k + 1}", spin.rates.items(), has)
        for k in mechanism.actuated:
            joint = self.names[k]
            SubElement(self.actuator, "motor", name=joint, joint=joint, gear="1")
        for f, load in enumerate(description.loads):
            if isinstance(load, (Force, Moment)):
                self._load(names.new(f"load{f + 1}"), load)
        self._hang(self.world, None, 0)  # last, when all sites are known

    def _hang(self, parent: Element, above: int | None, level: int) -> None:
        """Put the sites of a link (None: the ground) into its body, and what hangs from it."""
        if level > DEEPEST:
            limit = f"more than {DEEPEST} hang from one another: MuJoCo's XML nests no deeper"
            raise InputError("links", where=self.mechanism.source, limit=limit)
        for site in self._sites.get(above, ()):
            SubElement(parent, "site", site)
        for k, link in enumerate(self.links):
            if link.hangs_from.link != above:
                continue
            self.order.append(k)
            name, place, begin = self.names[k], link.hangs_from.at, self.q[k]
            if link.axis is None:
                kind, axis, along = "hinge", "0 0 1", link.turn * rect(1.0, begin)
            else:
                kind, axis, along = "slide", "1 0 0", link.axis
                place += begin * along
            body = SubElement(parent, "body", name=name, pos=vector(place))
            if along != 1.0:
                body.set("xyaxes", f"{vector(along)} {vector(1j * along)}")
            joint = SubElement(body, "joint", name=name, type=kind, axis=axis)
            if begin:  # the coordinate of the pose that the bodies are written in
                joint.set("ref", number(begin))
            joint.attrib |= self._turning(k) | joint_contacts(self.mechanism, k, self.timestep)
            # of what never turns no inertia counts, but MuJoCo wants some
            I = link.I if self.mechanism.frames[k] is not None else max(link.I, MINIMUM)
            _inertial(body, link.m, link.r, I)
            if link.payload:
                tip = vector(complex(link.l))
                payload = SubElement(body, "body", name=self.payloads[k], pos=tip)
                _inertial(payload, link.payload, 0j, 0.0)
            self._hang(body, k, level + 1)

    def _turning(self, joint: int) -> dict[str, str]:
        """The dampers and springs of a joint; springs beside one another act as one."""
        found = {}
        for spin in self.mechanism.spins:
            if spin.rates.keys() == {joint}:
                found["armature"] = number(spin.inertia * spin.rates[joint] ** 2)
        if self.mechanism.damping[joint]:
            found["damping"] = number(self.mechanism.damping[joint])
        known = self.mechanism.of(JointSpring)
        springs = [spring for spring in known if spring.joint == joint and spring.law is None]
        if springs:
            stiffness = sum(spring.stiffness for spring in springs)
            angle = springs[0].angle
            if len(springs) > 1:
                angle = sum(spring.stiffness * spring.angle for spring in springs) / stiffness
            found |= {"stiffness": number(stiffness), "springref": number(angle)}
        return found

    def _spring(self, name: str, spring: PointSpring | JointSpring) -> None:
        """A spring and damper between two points, or a law at a joint: a tendon."""
        law = polynomial(spring.law) or {}
        if isinstance(spring, PointSpring):
            tendon = self._spatial(name, *self._ends(name, spring))
            tendon.set("stiffness", number(spring.stiffness))
            tendon.set("springlength", number(spring.length))
            tendon.attrib |= {"damping": number(spring.damping)} | law
        elif spring.law is not None:
            free = spring.angle if spring.angle != -1.0 else nextafter(-1.0, 0.0)  # -1: of its own
            self._fixed(name, [(spring.joint, 1.0)], {"springlength": number(free)} | law)

    def _fixed(
        self, name: str, terms: Iterable[tuple[int, float]], has: Mapping[str, str] = {}
    ) -> None:
        """A tendon as long as a sum of joint coordinates, each times a factor."""
        tendon = SubElement(self.tendon, "fixed", {"name": name, **has})
        for k, factor in terms:
            SubElement(tendon, "joint", joint=self.names[k], coef=number(factor))

    def _ends(self, name: str, pair: PointSpring | Closure) -> list[str]:
        """The sites of the two points that a spring or a closure joins."""
        ends = ("first", pair.first), ("second", pair.second)
        return [self._site(f"{name}_{end}", point) for end, point in ends]

    def _spatial(self, name: str, *sites: str) -> Element:
        """A tendon along these sites."""
        tendon = SubElement(self.tendon, "spatial", name=name)
        for site in sites:
            SubElement(tendon, "site", site=site)
        return tendon

    def _load(self, name: str, load: Force | Moment) -> None:
        """A constant force or torque: an actuator at a site whose force is its bias, 1.

        Its gear is the wrench in the frame of the site, or of a site of the ground.
        """
        if isinstance(load, Moment):
            point, gear = Point(load.link, 0j), f"0 0 0 0 0 {number(load.torque)}"
        else:
            point, gear = load.point, f"{vector(load.force)} 0 0 0"
        site = self._site(name, point)
        constant = SubElement(self.actuator, "general", name=name, site=site, gear=gear)
        if isinstance(load, Force) and not load.turns:
            constant.set("refsite", self._site(f"{name}_frame", Point(None, 0j)))
        constant.attrib |= {"gainprm": "0", "biastype": "affine", "biasprm": "1 0 0"}

    def _close(self, name: str, closure: Closure) -> None:
        """The sites of a closure and its constraint.

        A slider has two tendons to the point, from sites on both sides of the line on what carries
        it; gap > 0: left.  MuJoCo counts lengths from those where it begins:
        y - y0 = a0 + a1 (x - x0).
        """
        if closure.along is None:
            first, second = self._ends(name, closure)
            SubElement(self.equality, "connect", name=name, site1=first, site2=second)
            return
        along, line, carrier = closure.along, closure.second.at, closure.second.link
        point = self._site(f"{name}_point", closure.first)
        pivot, arms, begin = self._beginning(closure)
        foot = line + along * ((pivot - line) * along.conjugate()).real
        # so far that the point cannot get there
        away = 2.0 * (sum(map(abs, arms)) + abs(pivot - foot)) or 1.0
        lengths = []
        for side, way in (("right", -1j), ("left", 1j)):
            at = foot + away * way * along
            self._spatial(f"{name}_{side}", self._site(f"{name}_{side}", Point(carrier, at)), point)
            lengths.append(abs(begin - at))
        held = SubElement(self.equality, "tendon", name=name, tendon1=f"{name}_right")
        held.set("tendon2", f"{name}_left")
        held.set("polycoef", f"{number(lengths[1] - lengths[0])} 1 0 0 0")
        if closure.aligned is not None:
            self._align(f"{name}_angle", closure, closure.aligned)

    def _beginning(self, closure: Closure) -> tuple[complex, list[complex], complex]:
        """A slider's point in the frame of its line: pivot, arms to the point, where it begins."""
        slides, carrier = self.mechanism.slides, closure.second.link
        here, turned, turns = placed(self.mechanism, np.array(self.q)), 1.0 + 0j, 1.0 + 0j
        if carrier is None:
            place = self.tree.point(closure.first)
            pivot, arms, begin = place.constant, [], place.constant
        else:
            place = self.tree.difference(closure.first, closure.second)
            turned = self.tree.phases[carrier].conjugate()
            turns = turned * complex(here.E[carrier]).conjugate()
            pivot, arms = closure.second.at, [turned * place.constant]
            begin = pivot + turns * place.constant
        begin += turns * sum(c * complex(here.X[k]) for k, c in place.terms)
        # what slides is taken to get as far as the mechanism is long
        sizes = [(self.tree.unit if k in slides else turned) * c for k, c in place.terms]
        return pivot, arms + sizes, begin

    def _align(self, name: str, closure: Closure, angle: float) -> None:
        """Keep the angle of a point's link to the line's link, by an equation between joints."""
        counts: dict[int, float] = {}
        for sign, link in ((1.0, closure.first.link), (-1.0, closure.second.link)):
            if link is not None:
                angle -= sign * phase(self.tree.phases[link])
                for k in self.mechanism.turns_by(link):
                    counts[k] = counts.get(k, 0.0) + sign
        (joint, sign), *others = ((k, count) for k, count in counts.items() if count)
        turned = sum(count * self.q[k] for k, count in counts.items())
        angle += 2.0 * pi * round((turned - angle) / (2.0 * pi))
        terms = tuple((k, -sign * count) for k, count in others)
        self._couple(name, Coupling(joint, terms, sign * angle))

    def _couple(self, name: str, coupling: Coupling) -> None:
        """An equation between joints; of more than two the sum of all is a tendon's length."""
        terms, ratio = coupling.terms, 0.0
        # MuJoCo counts coordinates from those where it begins
        apart = coupling.angle - self.q[coupling.joint]
        apart += sum(ratio * self.q[k] for k, ratio in terms)
        if len(terms) < 2:
            found = SubElement(self.equality, "joint", name=name, joint1=self.names[coupling.joint])
            if terms:
                found.set("joint2", self.names[terms[0][0]])
                ratio = terms[0][1]
        else:
            self._fixed(name, [(coupling.joint, 1.0), *((k, -ratio) for k, ratio in terms)])
            found = SubElement(self.equality, "tendon", name=name, tendon1=name)
        found.set("polycoef", f"{number(apart)} {number(ratio)} 0 0 0")

    def _site(self, name: str, point: Point) -> str:
        """Note a site for the body of the point's link; its name."""
        self._sites.setdefault(point.link, []).append({"name": name, "pos": vector(point.at)})
        return name


def _inertial(body: Element, m: float, r: complex, I: float) -> None:
    moments = " ".join([number(I)] * 3)
    SubElement(body, "inertial", pos=vector(r), mass=number(m), diaginertia=moments)
