"""Mechanism -> MJCF: the models of MuJoCo.

    https://mujoco.readthedocs.io/en/stable/XMLreference.html

A closure is an equality constraint, which MuJoCo keeps softly: its force is what brings the error
to nothing in a few time steps.  A pin is a `connect` of two sites (MuJoCo 3.2.3 or newer).  A
slider needs no body of its own: its line holds the points that are as far from one ground site as
from another, its mirror image in the line, so that two spatial tendons from these to the point are
held to equal lengths.  M, C and G stay those of the scene.  But MuJoCo leaves out Psidot qd of
tendons (and of connects before 3.7); the error that this makes in a motion falls with the square of
the time step.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

from robodyn.description import Closure, Description, Point
from robodyn.errors import InputError, printable
from robodyn.mechanism import Mechanism
from robodyn.model_xml import (
    INERTIA_REMARKS,
    Names,
    comment,
    document,
    link_names,
    number,
    refuse_unsaid,
    vector,
)

TIMESTEP = 1e-3  # s
MINIMUM = 1e-15  # kg and kg m^2: mjMINVAL, below which MuJoCo refuses what moves
DEEPEST = 495  # links in a row; its XML reader takes elements nested 500 deep
REASONS: dict[str, str] = {}
PAYLOAD_REMARKS = ("A payload is a point mass: a body without a joint and without inertia.",)
LOOP_REMARKS = (
    "Loops are closed by equality constraints, as stiff as the time step allows.  They are open",
    "where all joints are zero: start from a closed configuration, such as a keyframe.",
)
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
    refuse_unsaid(description, "MJCF", REASONS, more=["closures"])
    _refuse_massless(description)
    model = _Model(mechanism)
    root = Element("mujoco", model=printable(mechanism.name))
    SubElement(root, "compiler", angle="radian")
    option = SubElement(root, "option", timestep=number(timestep), integrator="RK4")
    option.set("gravity", vector(mechanism.gamma))
    SubElement(option, "flag", contact="disable")
    if description.closures:
        default = SubElement(root, "default")
        # the shortest time constant that is stable, and the least softness that MuJoCo takes
        stiff = {"solref": f"{number(2.0 * timestep)} 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
        SubElement(default, "equality", stiff)
    model.closures()
    root.append(model.world)
    model.hang(model.world, None, 0)
    root.extend(part for part in (model.tendon, model.equality) if len(part))
    if mechanism.actuated:
        actuator = SubElement(root, "actuator")
        for k in mechanism.actuated:
            name = model.names[k]
            SubElement(actuator, "motor", name=name, joint=name, gear="1")
    if q is not None:
        keys = SubElement(root, "keyframe")
        angles = " ".join(number(q[k]) for k in model.order)
        SubElement(keys, "key", name="start", qpos=angles)
    remarks = [*INERTIA_REMARKS]
    if any(link.payload for link in description.links):
        remarks += PAYLOAD_REMARKS
    if description.closures:
        remarks += LOOP_REMARKS
    if any(closure.along is not None for closure in description.closures):
        remarks += SLIDER_REMARKS
    return document(root, comment(mechanism, model.names, remarks))


def _refuse_massless(description: Description) -> None:
    for k, link in enumerate(description.links):
        for key, value in (("m", link.m), ("I", link.I)):
            if value < MINIMUM:
                limit = f"MuJoCo takes nothing that moves with less than {MINIMUM:g} of mass (kg)"
                limit += " or inertia (kg m^2): give it a little"
                place = f"links[{k}] ({link.name}).{key}"
                raise InputError(place, where=description.source, value=value, limit=limit)


class _Model:
    """The parts of a model as they grow: bodies in the world, sites in them, constraints."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.source = mechanism.source
        self.links = mechanism.description.links
        self.given = mechanism.description.closures
        names = Names()
        self.names = link_names(mechanism, names)
        self.payloads = [
            names.new(f"{name}_payload") if link.payload else ""
            for name, link in zip(self.names, self.links, strict=True)
        ]
        self.world = Element("worldbody")
        self.tendon = Element("tendon")
        self.equality = Element("equality")
        self.sites: dict[int | None, list[dict[str, str]]] = {}
        self.order: list[int] = []  # the links as MuJoCo orders their joints

    def hang(self, parent: Element, above: int | None, level: int) -> None:
        """Put the sites of a link (None: the ground) into its body, and what hangs from it."""
        if level > DEEPEST:
            limit = f"more than {DEEPEST} hang from one another: MuJoCo's XML nests no deeper"
            raise InputError("links", where=self.source, limit=limit)
        for site in self.sites.get(above, ()):
            SubElement(parent, "site", site)
        for k, link in enumerate(self.links):
            if link.hangs_from.link != above:
                continue
            self.order.append(k)
            name = self.names[k]
            body = SubElement(parent, "body", name=name, pos=vector(link.hangs_from.at))
            joint = SubElement(body, "joint", name=name, type="hinge", axis="0 0 1")
            if link.damping:
                joint.set("damping", number(link.damping))
            _inertial(body, link.m, link.r, link.I)
            if link.payload:
                tip = vector(complex(link.l))
                payload = SubElement(body, "body", name=self.payloads[k], pos=tip)
                _inertial(payload, link.payload, 0j, 0.0)
            self.hang(body, k, level + 1)

    def closures(self) -> None:
        """Sites and constraints of all closures."""
        for c, closure in enumerate(self.given):
            name = f"closure{c + 1}"
            if closure.along is None:
                first = self.site(f"{name}_first", closure.first)
                second = self.site(f"{name}_second", closure.second)
                SubElement(self.equality, "connect", name=name, site1=first, site2=second)
            else:
                self.slider(name, closure, closure.along)

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
        self.sites.setdefault(point.link, []).append({"name": name, "pos": vector(point.at)})
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
