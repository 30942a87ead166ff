"""What a scene consists of, as its file says it: links, closures, springs, loads, couplings.

Names are resolved to indices, points of the plane are complex numbers; SI units and radians.
`description.py` reads it, `mechanism.py` makes numbers of it.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

BRANCHES = ("open", "crossed")
FRAMES = ("ground", "link")  # in which a load's force stays
JOINTS = ("revolute", "prismatic")


class Point(NamedTuple):
    """A point of a link (its index; `at` in the link's frame) or of the ground (link None), m."""

    link: int | None
    at: complex


class Friction(NamedTuple):
    """Coulomb friction of a joint, -torque tanh(qd/speed): N m, and rad/s that smooth it.

    Of a prismatic joint N and m/s.
    """

    torque: float
    speed: float


class DryFriction(NamedTuple):
    """Coulomb friction with true sticking: N m, and rad/s; of a prismatic joint N and m/s.

    A joint at rest holds up to `static`; one that moves at the rate v is held back by
    torque + (static - torque) exp(-(v/stribeck)^2), without `stribeck` by the torque alone.
    """

    torque: float
    static: float
    stribeck: float | None = None


class Limits(NamedTuple):
    """Where a joint ends, rad or m: at compliant stops, at hard ones, or at no more than a limit.

    A compliant stop, of a stiffness (N m/rad) and a damping (N m s/rad), pushes and never pulls;
    a hard one throws back at `restitution` times the speed.
    """

    low: float | None
    high: float | None
    stiffness: float | None = None
    damping: float = 0.0
    restitution: float | None = None

    @property
    def ends(self) -> list[tuple[int, float]]:
        """The sides, -1 and 1, that have an end, and where."""
        sides = ((-1, self.low), (1, self.high))
        return [(side, end) for side, end in sides if end is not None]


class Motor(NamedTuple):
    """A motor and its gear at a joint: the rotor turns `ratio` times as far as the joint.

    It sits on the link that carries the joint, and turns relative to it.  Of the rotor: inertia
    kg m^2, damping N m s/rad, N m, rad/s, N m/A, ohm; the ratio of a prismatic joint is in rad/m.
    """

    ratio: float
    inertia: float
    damping: float = 0.0
    torque_max: float | None = None
    speed_max: float | None = None
    torque_constant: float | None = None
    resistance: float | None = None


class Link(NamedTuple):
    """One link: mass kg, length m, centre of gravity m, inertia kg m^2 about it, where it hangs.

    A link on a prismatic joint has an `axis`: the unit vector along which it slides, and along
    which its own x axis lies, in the frame of what it hangs from.
    """

    name: str
    m: float
    l: float
    r: complex
    I: float
    hangs_from: Point
    payload: float = 0.0
    damping: float = 0.0
    friction: Friction | DryFriction | None = None
    axis: complex | None = None
    limits: Limits | None = None
    motor: Motor | None = None

    @property
    def slides(self) -> bool:
        """Whether its joint is prismatic."""
        return self.axis is not None


class Law(NamedTuple):
    """A smooth expression: as its file has it, as code over `names`, and these."""

    text: str
    code: str
    names: frozenset[str]  # t, q0.., qd0..; of a spring x, its extension, and v, its rate


class Table(NamedTuple):
    """A function of one variable that is linear between its rows, x increasing."""

    file: str
    column: str
    over: str  # t or q0..; of a spring x
    x: tuple[float, ...]
    F: tuple[float, ...]
    repeats: bool = False  # after its span; else it ends there

    @property
    def names(self) -> frozenset[str]:
        """The variable, as a law has its own."""
        return frozenset((self.over,))


Signal = Law | Table

# of files that a scene names: x and value of each row, by file, both columns' names, and whether
# x is an angle that turns
Tables = dict[tuple[str, str, str, bool], tuple[tuple[float, ...], tuple[float, ...]]]


class Spring(NamedTuple):
    """A spring (N/m, free length m) and damper (N s/m) between two points.

    A `law` in place of the stiffness gives its pull, N, by the extension, m, and its rate.
    """

    first: Point
    second: Point
    stiffness: float
    length: float
    damping: float = 0.0
    law: Signal | None = None


class JointSpring(NamedTuple):
    """A spring (N m/rad, free angle rad) and damper (N m s/rad) at a joint.

    At a prismatic one N/m, its free displacement m, and N s/m.  For a `law` see `Spring`.
    """

    joint: int
    stiffness: float
    angle: float
    damping: float = 0.0
    law: Signal | None = None


class Load(NamedTuple):
    """A force, N, at a point of a link, in the ground's frame or turning with the link.

    Where x or y is a signal it is in `varying`, and zero in `force`.
    """

    point: Point
    force: complex
    turns: bool = False
    varying: tuple[Signal | None, Signal | None] = (None, None)

    @property
    def varies(self) -> bool:
        """Whether it is not constant."""
        return self.varying != (None, None)


class Moment(NamedTuple):
    """A torque on a link, N m; where it varies zero, and `varying`."""

    link: int
    torque: float
    varying: Signal | None = None


class Closure(NamedTuple):
    """Two points that coincide, or, with `along`, a point held on the line through `second`.

    `along` is a unit vector in the frame of the link of `second`, which carries the line.  With
    `aligned` the first point's link keeps this angle to that link, rad.
    """

    first: Point
    second: Point
    along: complex | None = None
    aligned: float | None = None


class Coupling(NamedTuple):
    """A gear, rack or belt between joints: q_joint = sum of ratio q_k over `terms`, plus `angle`.

    All in rad, or in m where a joint slides.
    """

    joint: int
    terms: tuple[tuple[int, float], ...]
    angle: float


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


class Description(NamedTuple):
    """What a scene file says; `source` is the file's name for messages.

    `branches` has a word for each closure, or none where the `start` picks them.
    """

    source: str
    name: str
    gravity: complex
    links: tuple[Link, ...]
    closures: tuple[Closure, ...]
    branches: tuple[str, ...]
    actuated: tuple[int, ...] | None
    start: tuple[float | None, ...] | None
    springs: tuple[Spring | JointSpring, ...] = ()
    loads: tuple[Load | Moment, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    points: tuple[tuple[str, Point], ...] = ()  # by their names
    written: Written = Written()

    def begin(self, joints: Sequence[int]) -> tuple[float, ...]:
        """The values of joints in the `start`, rad or m; empty unless it tells all joints."""
        whole = [x for x in self.start or () if x is not None]
        return tuple(whole[k] for k in joints) if len(whole) == len(self.links) else ()


def signals_of(description: Description) -> Iterator[tuple[str, Signal]]:
    """Everything that varies, each with its place in the file."""
    for i, spring in enumerate(description.springs):
        if spring.law is not None:
            key = "table" if isinstance(spring.law, Table) else "law"
            yield f"springs[{i}].{key}", spring.law
    for i, load in enumerate(description.loads):
        if isinstance(load, Moment):
            places = {f"loads[{i}].torque": load.varying}
        else:
            places = {f"loads[{i}].force[{k}]": part for k, part in enumerate(load.varying)}
        yield from ((place, part) for place, part in places.items() if part is not None)


def signal_place(description: Description, signal: Signal) -> str:
    """Where the file has a signal, by its identity."""
    return next(place for place, other in signals_of(description) if other is signal)


def told(signal: Signal) -> str:
    """An expression as its file has it, or the file of a table."""
    return signal.text if isinstance(signal, Law) else signal.file
