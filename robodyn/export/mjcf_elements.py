"""The elements of MJCF that say what a scene has: bodies, joints, constraints, tendons, actuators.

A pin is a `connect` of two sites (MuJoCo 3.2.3 or newer).  A slider needs no body of its own: its
line holds the points that are as far from one ground site as from another, its mirror image in the
line, so that two spatial tendons from these to the point are held to equal lengths.  M and C stay
those of the scene.  But MuJoCo leaves out Psidot qd of tendons (and of connects before 3.7); the
error that this makes in a motion falls with the square of the time step.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from robodyn.errors import InputError
from robodyn.export.model_xml import Names, link_names, number, vector
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Closure, Coupling, Load, Moment, Point, Spring

DEEPEST = 495  # links in a row; MuJoCo's XML reader takes elements nested 500 deep


class Elements:
    """The elements of a mechanism's model, made as it is created.

    `world` holds the bodies, `names` of the links; `order` has the links as MuJoCo orders joints.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.links = mechanism.description.links
        names = Names()
        self.names = link_names(mechanism, names)
        self.payloads = [
            names.new(f"{name}_payload") if link.payload else ""
            for name, link in zip(self.names, self.links, strict=True)
        ]
        self.world = Element("worldbody")
        self.tendon = Element("tendon")
        self.equality = Element("equality")
        self.actuator = Element("actuator")
        self.order: list[int] = []
        self._sites: dict[int | None, list[dict[str, str]]] = {}
        for c, closure in enumerate(mechanism.description.closures):
            self.close(f"closure{c + 1}", closure)
        for c, coupling in enumerate(mechanism.description.couplings):
            self.couple(f"coupling{c + 1}", coupling)
        for p, spring in enumerate(mechanism.description.springs):
            if isinstance(spring, Spring):
                self.stretch(f"spring{p + 1}", spring)
        for k in mechanism.actuated:
            joint = self.names[k]
            SubElement(self.actuator, "motor", name=joint, joint=joint, gear="1")
        for f, load in enumerate(mechanism.description.loads):
            self.load(names.new(f"load{f + 1}"), load)
        self.hang(self.world, None, 0)  # last, when all sites are known

    def hang(self, parent: Element, above: int | None, level: int) -> None:
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
            name = self.names[k]
            body = SubElement(parent, "body", name=name, pos=vector(link.hangs_from.at))
            SubElement(
                body, "joint", {"name": name, "type": "hinge", "axis": "0 0 1"} | self.turning(k)
            )
            _inertial(body, link.m, link.r, link.I)
            if link.payload:
                tip = vector(complex(link.l))
                payload = SubElement(body, "body", name=self.payloads[k], pos=tip)
                _inertial(payload, link.payload, 0j, 0.0)
            self.hang(body, k, level + 1)

    def turning(self, joint: int) -> dict[str, str]:
        """The dampers and springs of a joint; springs beside one another act as one."""
        found = {}
        if self.mechanism.damping[joint]:
            found["damping"] = number(self.mechanism.damping[joint])
        springs = [spring for spring in self.mechanism.joint_springs if spring.joint == joint]
        if springs:
            stiffness = sum(spring.stiffness for spring in springs)
            angle = springs[0].angle
            if len(springs) > 1:
                angle = sum(spring.stiffness * spring.angle for spring in springs) / stiffness
            found |= {"stiffness": number(stiffness), "springref": number(angle)}
        return found

    def stretch(self, name: str, spring: Spring) -> None:
        """A spring and damper between two points: a tendon."""
        tendon = SubElement(
            self.tendon,
            "spatial",
            name=name,
            stiffness=number(spring.stiffness),
            springlength=number(spring.length),
            damping=number(spring.damping),
        )
        for side, point in (("first", spring.first), ("second", spring.second)):
            SubElement(tendon, "site", site=self.site(f"{name}_{side}", point))

    def load(self, name: str, load: Load | Moment) -> None:
        """A constant force or torque: an actuator at a site whose force is its bias, 1.

        Its gear is the wrench in the frame of the site, or of a site of the ground.
        """
        if isinstance(load, Moment):
            point, gear = Point(load.link, 0j), f"0 0 0 0 0 {number(load.torque)}"
        else:
            point, gear = load.point, f"{vector(load.force)} 0 0 0"
        constant = SubElement(
            self.actuator, "general", name=name, site=self.site(name, point), gear=gear
        )
        if isinstance(load, Load) and not load.turns:
            constant.set("refsite", self.site(f"{name}_frame", Point(None, 0j)))
        constant.attrib |= {"gainprm": "0", "biastype": "affine", "biasprm": "1 0 0"}

    def close(self, name: str, closure: Closure) -> None:
        """The sites of a closure and its constraint."""
        if closure.along is not None:
            self.slider(name, closure, closure.along)
            return
        first = self.site(f"{name}_first", closure.first)
        second = self.site(f"{name}_second", closure.second)
        SubElement(self.equality, "connect", name=name, site1=first, site2=second)

    def couple(self, name: str, coupling: Coupling) -> None:
        """An equation between joints; of more than two the sum of all is a tendon's length."""
        terms, ratio = coupling.terms, 0.0
        if len(terms) < 2:
            found = SubElement(self.equality, "joint", name=name, joint1=self.names[coupling.joint])
            if terms:
                found.set("joint2", self.names[terms[0][0]])
                ratio = terms[0][1]
        else:
            tendon = SubElement(self.tendon, "fixed", name=name)
            for k, factor in ((coupling.joint, 1.0), *((k, -ratio) for k, ratio in terms)):
                SubElement(tendon, "joint", joint=self.names[k], coef=number(factor))
            found = SubElement(self.equality, "tendon", name=name, tendon1=name)
        found.set("polycoef", f"{number(coupling.angle)} {number(ratio)} 0 0 0")

    def slider(self, name: str, closure: Closure, along: complex) -> None:
        """Two tendons to the point, from ground sites on both sides of the line; gap > 0: left.

        MuJoCo counts lengths from those at zero angles: y - y0 = a0 + a1 (x - x0).
        """
        point = self.site(f"{name}_point", closure.first)
        pivot, reach = self.reach(closure.first)
        foot = closure.second.at + along * ((pivot - closure.second.at) * along.conjugate()).real
        away = 2.0 * (reach + abs(pivot - foot)) or 1.0  # so far that the point cannot get there
        resting = self.at_zero(closure.first)
        lengths = []
        for side, way in (("right", -1j), ("left", 1j)):
            place = foot + away * way * along
            tendon = SubElement(self.tendon, "spatial", name=f"{name}_{side}")
            SubElement(tendon, "site", site=self.site(f"{name}_{side}", Point(None, place)))
            SubElement(tendon, "site", site=point)
            lengths.append(abs(resting - place))
        SubElement(
            self.equality,
            "tendon",
            name=name,
            tendon1=f"{name}_right",
            tendon2=f"{name}_left",
            polycoef=f"{number(lengths[1] - lengths[0])} 1 0 0 0",
        )

    def site(self, name: str, point: Point) -> str:
        """Note a site for the body of the point's link; its name."""
        self._sites.setdefault(point.link, []).append({"name": name, "pos": vector(point.at)})
        return name

    def reach(self, point: Point) -> tuple[complex, float]:
        """The ground pivot below a point, and how far from it the point can be, m."""
        reach = 0.0
        while point.link is not None:
            reach += abs(point.at)
            point = self.links[point.link].hangs_from
        return point.at, reach

    def at_zero(self, point: Point) -> complex:
        """Where the point is when all joints are zero."""
        place = point.at
        while point.link is not None:
            point = self.links[point.link].hangs_from
            place += point.at
        return place


def _inertial(body: Element, m: float, r: complex, I: float) -> None:
    moments = " ".join([number(I)] * 3)
    SubElement(body, "inertial", pos=vector(r), mass=number(m), diaginertia=moments)
