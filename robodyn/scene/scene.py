"""What a scene consists of, as its file says it: links, closures, springs, loads, couplings.

Names are resolved to indices, points of the plane are complex numbers; SI units and radians.
`description.py` reads it, `mechanism.py` makes numbers of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Self

from robodyn.elements.base import Element
from robodyn.elements.gravity import GravityField
from robodyn.elements.joints import DryFriction, SmoothFriction, Stops
from robodyn.elements.keys import TOGETHER, Declared, Way, at_joints, key
from robodyn.elements.pin_friction import PinFriction
from robodyn.elements.values import Curve as Curve
from robodyn.elements.values import Law as Law
from robodyn.elements.values import Point as Point
from robodyn.elements.values import Signal as Signal
from robodyn.elements.values import Table as Table
from robodyn.elements.values import Tables as Tables
from robodyn.elements.values import told as told
from robodyn.scene.constants import Constants

BRANCHES = ("open", "crossed")
MASS = ("m", "r", "I")  # what a link has of its own, or has not, all three
ROUNDING = 4e-16  # part of J that m r^2 may miss it by in a point mass
SOME_SLOPE = 0.5773502691896258  # of a law, where a rank is asked for
JOINTS = ("revolute", "prismatic", "fixed")


class Motor(Declared):
    """A motor and its gear at a joint: the rotor turns `ratio` times as far as the joint.

    It sits on the link that carries the joint, and turns relative to it.
    """

    ratio: float = key(
        "nonzero",
        "the rotor's turn over the joint's, seen from the carrying link",
        unit=("", "rad/m"),
        symbol="N: ratio of the gear at the joint of {}",
    )
    inertia: float = key(
        "amount",
        "of the rotor; it is not in the I of the carrying link",
        unit="kg m²",
        symbol="J: inertia of the rotor of {}",
        linear="Jr",
    )
    damping: float = key(
        "amount",
        "viscous damping of the rotor",
        unit="N m s/rad",
        default=0.0,
        symbol="b: damping of the rotor of {}",
    )
    torque_max: float | None = key(
        "positive", "largest torque of the motor", unit="N m", default=None
    )
    speed_max: float | None = key(
        "positive", "largest speed of the rotor", unit="rad/s", default=None
    )
    torque_constant: float | None = key(
        "positive", "torque per current; resistance beside it", unit="N m/A", default=None
    )
    resistance: float | None = key(
        "positive", "of the winding; torque_constant beside it", unit="ohm", default=None
    )

    ways: ClassVar[tuple[Way, ...]] = at_joints(
        "motor",
        "motor",
        (
            "A motor and its gear at a revolute joint, with a rotor on the link that carries it.",
            "A motor and its gear at a prismatic joint, with a rotor on the link that carries it.",
        ),
    )

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        pair = {"torque_constant": self.torque_constant, "resistance": self.resistance}
        missing = [name for name, value in pair.items() if value is None]
        if len(missing) == 1:
            other = next(name for name in pair if name not in missing)
            yield missing[0], f"is missing: {other} needs it beside itself", None


class Body(Declared):
    """A rigid body and the point that it hangs from: a link, or a weld."""

    name: str = key("name", "any text; no two links share one")
    m: float = key(
        "amount",
        "mass; m, r and I may be left out of a link together",
        unit="kg",
        told=TOGETHER,
        symbol="m: mass of {}",
    )
    l: float = key(
        "amount",
        "length from the link's own joint to its tip",
        unit="m",
        symbol="l: length of {}",
    )
    r: complex = key(
        "centre",
        "centre of gravity: [x, y] of the link, or its distance along it",
        unit="m",
        told=TOGETHER,
        symbol="r: centre of gravity of {}",
        hint="; write [x, y] for a centre of gravity behind or beside the link",
    )
    I: float = key(
        "amount",
        "moment of inertia about the centre of gravity",
        unit="kg m²",
        absent=None,
        told="I or J",
        symbol="I: moment of inertia of {} about its centre of gravity",
    )
    J: ClassVar[Any] = key(
        "amount",
        "moment of inertia about the link's own joint",
        unit="kg m²",
        absent=None,
        told="I or J",
    )
    hangs_from: Point = key(
        "point", "the point that it hangs from", told="the tip of the link before", name="from"
    )
    payload: float = key(
        "amount",
        "point mass at the tip",
        unit="kg",
        default=0.0,
        symbol="mp: payload at the tip of {}",
    )

    has_mass: bool = True  # whether its file says m, r and I

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Self:
        values.pop("joint")
        J = values.pop("J")
        has_mass = J is not None or any(values[name] is not None for name in MASS)
        values |= {name: values[name] or 0.0 for name in MASS}
        values["r"] = r = complex(values["r"])
        if J is not None:
            least = values["m"] * (r.real * r.real + r.imag * r.imag)
            values["I"] = 0.0 if abs(J - least) <= ROUNDING * J else J - least
        return cls(**values, has_mass=has_mass)

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        if self.I < 0.0:  # of J less that of the mass
            least = self.m * (self.r.real * self.r.real + self.r.imag * self.r.imag)
            limit = f"must be at least m r^2 = {least:.6g} kg m^2: it is about the link's own joint"
            yield "J", limit, f"{self.I + least:g}"

    def to_keys(self) -> dict[str, Any]:
        return super().to_keys() | ({} if self.has_mass else dict.fromkeys(MASS))


class Link(Body):
    """A rigid link, how it hangs, and what stands at its own joint.

    A link on a prismatic joint has an `axis`: the unit vector along which it slides, and along
    which its own x axis lies, in the frame of what it hangs from.  A link that hangs from a weld
    has the `turn` of the weld's frame, once the weld is part of what carries it.
    """

    joint: ClassVar[Any] = key(
        "joint_kind", ("of its own joint", "prismatic"), told=(JOINTS[0], ""), only=JOINTS[:2]
    )
    axis: complex | None = key(
        "direction",
        "which way it slides, [dx, dy] in the frame of what it hangs from",
        default=None,
        ways=("prismatic_link",),
    )
    damping: float = key(
        "amount",
        "viscous damping at its own joint",
        unit=("N m s/rad", "N s/m"),
        default=0.0,
        symbol="d: damping at the joint of {}",
    )
    friction: SmoothFriction | DryFriction | PinFriction | None = key(
        ("friction", "slide_friction"), "Coulomb friction at its own joint", default=None
    )
    limits: Stops | None = key(("limits", "slide_limits"), "where its own joint ends", default=None)
    motor: Motor | None = key(
        ("motor", "slide_motor"), "motor and gear at its own joint", default=None
    )
    turn: complex = 1.0 + 0j

    ways: ClassVar[tuple[Way, ...]] = (
        Way(
            "prismatic_link",
            "link",
            "A link on a prismatic joint: its frame has x along the axis that it slides on.",
            ("axis",),
            True,
        ),
        Way(
            "revolute_link",
            "link",
            "A rigid link; its frame has x from its own joint to its tip.",
        ),
    )

    def to_keys(self) -> dict[str, Any]:
        return super().to_keys() | {"joint": JOINTS[self.slides]}

    @property
    def slides(self) -> bool:
        """Whether its joint is prismatic."""
        return self.axis is not None


class Weld(Body):
    """A link without a joint: it is part of what it hangs from.  It has no coordinate.

    `place` is its place among the links of the file.
    """

    joint: ClassVar[Any] = key("joint_kind", "fixed", told="", only=JOINTS[2])
    angle: float = key(
        "angle", "from the x axis of what it hangs from to its own", unit="rad", default=0.0
    )
    place: int = -1

    ways: ClassVar[tuple[Way, ...]] = (
        Way("weld", "weld", "A link without a joint, part of what it hangs from."),
    )

    def to_keys(self) -> dict[str, Any]:
        return super().to_keys() | {"joint": JOINTS[2]}


class Line(Declared):
    """A line of the ground or of a link, through a point along a unit vector."""

    link: int | None = key(
        "link_name", "the link that has the slot", absent=None, told="the ground"
    )
    through: complex = key("vector", "a point of the line", unit="m")
    along: complex = key("direction", "the line's direction, not [0, 0]")

    ways: ClassVar[tuple[Way, ...]] = (Way("line", "line", "A line of the ground or of a link."),)


class Closure(Declared):
    """Two points that coincide, or, with `along`, a point held on the line through `second`.

    `along` is a unit vector in the frame of the link of `second`, which carries the line.  With
    `aligned` the first point's link keeps this angle to that link, rad.
    """

    pins: ClassVar[Any] = key("pair", "the two points that coincide", ways=("joined",))
    first: Point = key(
        "point",
        "its name, {link, at}, or [x, y] of the ground for a line of a link",
        name="point",
        ways=("slider",),
    )
    second: Point
    along: complex | None = None
    on: ClassVar[Any] = key("line", "the line", ways=("slider",))
    aligned: float | None = key(
        "angle",
        "angle that the point's link keeps to the line's link (or to +X): "
        "a block that does not turn",
        unit="rad",
        default=None,
        symbol="beta: angle kept by closure {}",
        ways=("slider",),
    )
    friction: PinFriction | None = key(
        ("closure_friction", "slide_closure_friction"), "friction by the force there", default=None
    )

    ways: ClassVar[tuple[Way, ...]] = (
        Way("joined", "closure", "Two points that coincide, with friction in the pin.", ("pins",)),
        Way(
            "slider",
            "closure",
            "A point that stays on a line: a slider, a pin in a slot, a block on the ground.",
            slides=True,
        ),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Closure:
        if "pins" in values:
            first, second = values.pop("pins")
            return cls(first, second, friction=values["friction"])
        line = values.pop("on")
        return cls(**values, second=Point(line.link, line.through), along=line.along)

    def to_keys(self) -> dict[str, Any]:
        if self.along is None:
            return {"pins": (self.first, self.second), "friction": self.friction}
        line = Line(self.second.link, self.second.at, self.along)
        return super().to_keys() | {"on": line}

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        if self.along is None:
            return
        if self.second.link is not None and self.first.link == self.second.link:
            yield "on", "is a line of the point's own link; they must move apart", None
        elif self.first.link is None and self.second.link is None:
            yield "first", "must be a point of a link: the line is the ground's", None
        elif self.first.link is None and self.aligned is not None:
            yield "aligned", "is an angle of the point's link, and the point is the ground's", None


class Face(Declared):
    """The flat face of a cam's follower: a line of the follower's link, along a unit vector."""

    through: complex = key("vector", "a point of the face, in the follower's frame", unit="m")
    along: complex = key("direction", "the face's direction, not [0, 0]")

    ways: ClassVar[tuple[Way, ...]] = (
        Way("face", "face", "The flat face of a follower, in the follower's frame."),
    )


class Cam(Declared):
    """The geometry by which a cam drives the joint of a coupling: a roller, or a flat face.

    The roller's centre is at `at` in the follower's frame.
    """

    roller: float = key(
        "amount", "the roller's radius; 0 is a knife edge", unit="m", ways=("roller_cam",)
    )
    at: complex = key(
        "vector",
        "the roller's centre, in the follower's frame",
        unit="m",
        absent=None,
        told="[0, 0]",
        ways=("roller_cam",),
    )
    face: Face | None = key("face", "the follower's flat face", default=None, ways=("flat_cam",))

    ways: ClassVar[tuple[Way, ...]] = (
        Way("flat_cam", "cam", "A cam whose follower has a flat face.", ("face",)),
        Way("roller_cam", "cam", "A cam whose follower has a roller, or a knife edge."),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Cam:
        values["at"] = values.get("at") or 0j
        return cls(**({"roller": 0.0} | values))


class Coupling(Declared):
    """A gear, rack or belt between joints: q_joint = sum of ratio q_k over `terms`, plus `angle`.

    All in rad, or in m where a joint slides.  With a `law` it is q_joint = law, and `terms` and
    `angle` are empty.  A `cam` is the geometry by which the other joint drives this one.
    """

    joint: int
    terms: tuple[tuple[int, float], ...] = ()
    angle: float = 0.0
    law: Law | Curve | None = None
    cam: Cam | None = None

    @property
    def others(self) -> frozenset[int]:
        """The joints of the right side."""
        if self.law is None:
            return frozenset(k for k, _ in self.terms)
        return frozenset(int(name[1:]) for name in self.law.names if name != "t")

    @property
    def ratios(self) -> tuple[tuple[int, float], ...]:
        """`terms`; of a law its joints, each with a slope that the law may have somewhere."""
        return self.terms or tuple((k, SOME_SLOPE) for k in sorted(self.others))

    @property
    def timed(self) -> bool:
        """Whether it is a law of the time too."""
        return self.law is not None and "t" in self.law.names

    @property
    def joints(self) -> frozenset[int]:
        """All joints that it ties to one another."""
        return self.others | {self.joint}


class Written:
    """The tree that a description was read from, and what was put in place of its numbers since.

    It is no part of what a scene says: all are equal.  `SceneValues` reads it.
    """

    def __init__(
        self,
        tree: Any = None,
        put: tuple[Mapping[str, Any], ...] = (),
        text: str = "",
        tables: Tables | None = None,
    ) -> None:
        self.tree = tree  # a node of `yaml_tree.py`
        self.put = put  # in turn
        self.text = text  # that the tree was parsed from
        self.tables = tables or {}  # as they were when the scene was first read

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Written)

    def __hash__(self) -> int:
        return 0

    def __repr__(self) -> str:
        return "Written()"


class Description(Declared):
    """What a scene file says; `source` is the file's name for messages.

    `branches` has a word for each closure, or none where the `start` picks them.  Points of weld w
    have the link n + w, n the number of links that move.
    """

    source: str
    name: str = key("name", "text for titles", told="the file's name less .yaml")
    gravity: complex = key(
        "gravity",
        "a number g acts along -Y, or [gx, gy]; each may be an expression in t",
        unit="m/s²",
        absent=0j,
    )
    links: tuple[Link, ...] = key("link", "list of links, at least one", listed=True)
    closures: tuple[Closure, ...] = key(
        "closure", "list of pins and sliders that close loops", listed=True, absent=()
    )
    branches: tuple[str, ...] = key(
        "assembly",
        "open or crossed; or a list of these, one for each closure",
        told=BRANCHES[0],
        name="assembly",
    )
    actuated: tuple[int, ...] | None = key(
        "joints",
        "links whose joints carry torque",
        told="all outside of loops, the first of each loop",
    )
    start: tuple[float | None, ...] | None = key(
        "start",
        "where joints begin when larger loops are assembled, {crank: 30deg}",
        unit="rad or m",
        default=None,
    )
    springs: tuple[Element, ...] = key(
        "spring",
        "list of springs and dampers, between points or at joints",
        listed=True,
        default=(),
    )
    loads: tuple[Element, ...] = key(
        "load", "list of forces and torques on links", listed=True, default=()
    )
    couplings: tuple[Coupling, ...] = key(
        "couplings",
        "equations of gears, belts, cams: q3 = -2 q1 + 0.1, q2 = 20 mm sin(q1)",
        default=(),
    )
    points: tuple[tuple[str, Point], ...] = key(
        "points",
        "names of points of links, {P: {link: coupler, at: [0.5, 0.2]}, Q: rocker}",
        default=(),
    )
    constants: Constants = key(
        "constants",
        "names for numbers, which any expression may use, {A: 20 mm, w: 300 rad/s}",
        default=(),
    )
    field: GravityField | None = None  # what varies of gravity; the rest is in `gravity`
    pins: tuple[tuple[str, Point], ...] = ()  # of several links of a drawing, by their names
    welds: tuple[Weld, ...] = ()
    apart: Any = None  # the scene whose welds are parts of its links here
    written: Written = Written()

    ways: ClassVar[tuple[Way, ...]] = (
        Way("scene", "scene", "A planar mechanism: rigid links, pins and sliders. SI units."),
    )

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Description:
        gravity, field = values["gravity"], None
        if isinstance(gravity, tuple):
            x, y = (part if isinstance(part, float) else 0.0 for part in gravity)
            varying = [None if isinstance(part, float) else part for part in gravity]
            gravity, field = complex(x, y), GravityField((varying[0], varying[1]))
        elif not isinstance(gravity, complex):
            gravity = -1j * gravity
        each = values["links"]
        welds = [x._replace(place=i) for i, x in enumerate(each) if isinstance(x, Weld)]
        links = tuple(x for x in each if isinstance(x, Link))
        own = {"gravity": gravity, "field": field, "links": links, "welds": tuple(welds)}
        return cls(**values | own)

    def to_keys(self) -> dict[str, Any]:
        found = super().to_keys() | {"links": self.listed}
        if self.field is not None:
            numbers = self.gravity.real, self.gravity.imag
            parts = zip(self.field.varying, numbers, strict=True)
            found["gravity"] = tuple(x if signal is None else signal for signal, x in parts)
        return found

    @property
    def listed(self) -> tuple[Body, ...]:
        """Links and welds in the order of the file."""
        each: list[Body] = [*self.links]
        for weld in self.welds:
            each.insert(weld.place, weld)
        return tuple(each)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """Links, and behind them welds: what the link of a `Point` counts."""
        return (*self.links, *self.welds)

    def begin(self, joints: Sequence[int]) -> tuple[float, ...]:
        """The values of joints in the `start`, rad or m; empty unless it tells all joints."""
        whole = [x for x in self.start or () if x is not None]
        return tuple(whole[k] for k in joints) if len(whole) == len(self.links) else ()

    @property
    def elements(self) -> Iterator[tuple[str, Element]]:
        """All that acts, each with its place in the file."""
        for name in (field for field, declared in self.keys.items() if declared.listed):
            for i, entry in enumerate(getattr(self, name)):
                place = f"{name}[{i}]"
                if isinstance(entry, Element):
                    yield place, entry
                    continue
                fields = zip(entry._fields, entry, strict=True)
                yield from ((f"{place}.{at}", x) for at, x in fields if isinstance(x, Element))


def signals_of(description: Description) -> Iterator[tuple[str, Signal]]:
    """Everything that varies, each with its place in the file."""
    for at, signal in description.field.varies() if description.field else ():
        yield f"gravity{at}", signal
    for place, element in description.elements:
        yield from ((f"{place}.{at}", signal) for at, signal in element.varies())


def signal_place(description: Description, signal: Signal) -> str:
    """Return the place of a signal in the file, found by identity."""
    return next(place for place, other in signals_of(description) if other is signal)
