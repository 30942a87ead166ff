"""Random mechanisms, each at one instant: trees, and loops that are closed by construction.

A scene is drawn as the YAML text that a user would write, so that a failing one can be pasted into
a file.  Its closures are made to fit its configuration (the closing points are put where they
meet), and its rates lie in the null space of Psi, so nothing of robodyn is needed to close it.
The kinematics here are those of points and joints: d(point)/dq_j = i (point - joint_j).

Units are SI and radians; points of the plane are complex numbers.
"""

import cmath
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st
from mpmath import mp

from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text
from robodyn.scene.scene import Description


def exchanged(mechanism: Mechanism, new: dict) -> Mechanism:
    """The same with other elements, those of `new`, of these kinds: not what its scene says."""
    kept = [x for x in mechanism.elements if not isinstance(x, tuple(new))]
    elements = (*kept, *(x for entries in new.values() for x in entries))
    return replace(mechanism, elements=elements)


# ---------------------------------------------------------------------------------------------
# Where the numbers come from
# ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Numbers:
    """A source of random numbers: `real(low, high)` and `whole(low, high)`, both ends included."""

    real: Callable[[float, float], float]
    whole: Callable[[int, int], int]

    def point(self, reach: float) -> complex:
        """A point of the square [-reach, reach]^2, m."""
        return complex(self.real(-reach, reach), self.real(-reach, reach))

    def vector(self, size: float, n: int) -> np.ndarray:
        return np.array([self.real(-size, size) for _ in range(n)])


def seeded(seed: int) -> Numbers:
    """Numbers of numpy's generator: arbitrary floats."""
    rng = np.random.default_rng(seed)
    return Numbers(
        real=lambda low, high: float(rng.uniform(low, high)),
        whole=lambda low, high: int(rng.integers(low, high, endpoint=True)),
    )


def drawn(draw: Callable) -> Numbers:
    """Numbers of hypothesis: thousandths of the range, which shrink and often coincide."""

    def real(low: float, high: float) -> float:
        return low + (high - low) * draw(st.integers(0, 1000)) / 1000

    return Numbers(real, lambda low, high: draw(st.integers(low, high)))


# ---------------------------------------------------------------------------------------------
# A tree in motion, as the oracles see it
# ---------------------------------------------------------------------------------------------

Place = tuple[int | None, complex]  # a point of a link, or of the ground (None)


@dataclass(frozen=True)
class Pose:
    """A tree of links (the oracles' list of dicts) at the angles q: where its points are.

    `turn` is e^(i angle) in the numbers of q, such as mpmath's.
    """

    tree: list[dict]
    q: np.ndarray
    turn: Callable = lambda angle: complex(np.exp(1j * angle))

    @cached_property
    def alpha(self) -> list[float]:
        """Absolute angles."""
        angles: list[float] = []
        for link, own in zip(self.tree, self.q, strict=True):
            parent = link["parent"]
            if "axis" in link:
                own = cmath.phase(link["axis"]) if isinstance(own, float) else mp.arg(link["axis"])
            angles.append(own + (0.0 if parent is None else angles[parent]))
        return angles

    @cached_property
    def turns(self) -> list[complex]:
        """The direction of each link's frame."""
        return [self.turn(angle) for angle in self.alpha]

    @cached_property
    def joints(self) -> list[complex]:
        """Each link's own origin."""
        joints: list[complex] = []
        for k, link in enumerate(self.tree):
            parent, at = link["parent"], link["at"]
            joint = at if parent is None else joints[parent] + at * self.turns[parent]
            joints.append(joint + (self.q[k] * self.turns[k] if "axis" in link else 0))
        return joints

    def turning(self, link: int | None) -> list[int]:
        """The joints that turn a link."""
        return [k for k in self.path(link) if "axis" not in self.tree[k]]

    def path(self, link: int | None) -> list[int]:
        """The links from `link` down to the ground."""
        path = []
        while link is not None:
            path.append(link)
            link = self.tree[link]["parent"]
        return path

    def position(self, place: Place) -> complex:
        link, at = place
        return at if link is None else self.joints[link] + at * self.turns[link]

    def in_link(self, link: int | None, point: complex) -> complex:
        """A point of the plane in the frame of a link."""
        if link is None:
            return point
        return (point - self.joints[link]) * self.turns[link].conjugate()

    def slope(self, place: Place) -> np.ndarray:
        """d(point)/dq, (n,) complex: i (point - joint_j) for the joints j that turn it.

        Of those that slide their direction.
        """
        slope = np.zeros(len(self.tree), np.result_type(np.asarray(self.q), complex))
        for j in self.path(place[0]):
            slides = "axis" in self.tree[j]
            slope[j] = self.turns[j] if slides else 1j * (self.position(place) - self.joints[j])
        return slope

    def bias(self, place: Place, qd: np.ndarray) -> complex:
        """Acceleration of the point at qdd = 0: i (pointdot - jointdot_j) qd_j over the joints."""
        velocity = self.slope(place) @ qd
        total = 0j
        for j in self.path(place[0]):
            joint = self.slope((self.tree[j]["parent"], self.tree[j]["at"])) @ qd
            if "axis" in self.tree[j]:
                total += 1j * sum(qd[k] for k in self.turning(j)) * self.turns[j] * qd[j]
            else:
                total += 1j * (velocity - joint) * qd[j]
        return total


# ---------------------------------------------------------------------------------------------
# Scenes
# ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shape:
    """Which link hangs from which, which pairs the closures join, and which joints are driven.

    A closure (first, second) joins points of two links, or of a link and the ground (None); a
    slider holds a point of its link on a line of the ground.
    """

    parents: tuple[int | None, ...]
    closures: tuple[tuple[int, int | None], ...] = ()
    sliders: tuple[int, ...] = ()
    actuated: tuple[int, ...] | None = None  # None: the scene does not say
    start: bool = False  # whether the loops are no chain of dyads and need a start


LOOPS = {
    "four-bar": Shape((None, 0, None), ((1, 2),), actuated=(0,)),
    "four-bar driven by its rocker": Shape((None, 0, None), ((1, 2),), actuated=(2,)),
    "four-bar driven by its coupler joint": Shape((None, 0, None), ((1, 2),), actuated=(1,)),
    "chain closed to the ground": Shape((None, 0, 1), ((2, None),), actuated=(0,)),
    "slider-crank": Shape((None, 0), sliders=(1,), actuated=(0,)),
    "five-bar": Shape((None, 0, None, 2), ((1, 3),), actuated=(0, 2)),
    "six-bar, dyad on the coupler": Shape(
        (None, 0, None, 1, None), ((1, 2), (3, 4)), actuated=(0,)
    ),
    "six-bar, dyad on the rocker": Shape((None, 0, None, 2, None), ((1, 2), (3, 4)), actuated=(0,)),
    "six-bar with a piston": Shape((None, 0, None, 2), ((1, 2),), sliders=(3,), actuated=(0,)),
    "loop in a tree": Shape((None, 0, 0, 1, None), ((1, 4),), actuated=(0, 2, 3)),
    "six-bar driven from its far link": Shape(
        (None, 0, None, 1, None), ((1, 2), (3, 4)), actuated=(4,), start=True
    ),
}
DYADIC = {name: shape for name, shape in LOOPS.items() if not shape.start}


NEAR_SINGULAR = 0.1  # m, least singular value of Psi's passive columns; links are about 1 m


@dataclass(frozen=True)
class Scene:
    """A mechanism as YAML text, with a state and accelerations that keep its closures."""

    text: str
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray

    @cached_property
    def mechanism(self) -> Mechanism:
        return mechanism(self.text)

    @property
    def n(self) -> int:
        return len(self.q)

    @property
    def states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.q, self.qd, self.qdd


def mechanism(text: str) -> Mechanism:
    """The mechanism that YAML text describes."""
    return build(from_text(text, "scene.yaml"))


def scene(numbers: Numbers, shape: Shape, massless: tuple[int, ...] = ()) -> Scene | None:
    """A random scene of this shape, or None where the draw is near a singular configuration.

    Gravity is a vector; centres of gravity lie off the links' axes; links hang from, and close at,
    points off the tips; some carry a payload and some joints are damped.
    """
    n = len(shape.parents)
    gravity = numbers.point(12.0)
    links, tree = [], []
    for k, parent in enumerate(shape.parents):
        at = numbers.point(1.0)
        l = numbers.real(0.3, 1.2)
        tip = parent is not None and numbers.whole(0, 1) == 1
        if tip:
            at = complex(tree[parent]["l"])
        heavy = k not in massless
        r = numbers.point(0.5)
        entry = {
            "name": f"link{k}",
            "m": heavy * numbers.real(0.2, 2.0),
            "l": l,
            "r": _pair(r) if numbers.whole(0, 3) else abs(r),
            "I": heavy * numbers.real(0.005, 0.3),
            "from": f"link{parent}" if tip else _point(parent, at),
        }
        if heavy and numbers.whole(0, 1):
            entry["payload"] = numbers.real(0.1, 1.0)
        if numbers.whole(0, 1):
            entry["damping"] = numbers.real(0.05, 0.8)
        links.append(entry)
        tree.append({"parent": parent, "at": at, "l": l})

    pose = Pose(tree, numbers.vector(np.pi, n))
    closures, rows, bend = [], [], []
    qd, qdd = numbers.vector(4.0, n), numbers.vector(15.0, n)
    for first, second in shape.closures:
        side = first, numbers.point(1.0)
        other = second, pose.in_link(second, pose.position(side))
        closures.append([_point(*side), _point(*other)])
        slope = pose.slope(side) - pose.slope(other)
        rows += [slope.real, slope.imag]
        bend.append((side, other, (1, 1j)))
    for link in shape.sliders:
        side = link, numbers.point(1.0)
        along = np.exp(1j * numbers.real(-np.pi, np.pi))
        through = pose.position(side) + numbers.real(-1.0, 1.0) * along
        line = {"through": _pair(through), "along": _pair(2.5 * along)}
        closures.append({"point": _point(*side), "on": line})
        rows.append((np.conj(1j * along) * pose.slope(side)).real)
        bend.append((side, (None, through), (1j * along,)))

    if rows:
        Psi = np.array(rows)
        driven = shape.actuated or ()
        passive = [k for k in range(n) if k not in driven]
        if _least(Psi[:, passive]) < NEAR_SINGULAR:
            return None
        keep = np.eye(n) - np.linalg.pinv(Psi) @ Psi
        qd = keep @ qd
        bias = [
            (np.conj(direction) * (pose.bias(side, qd) - pose.bias(other, qd))).real
            for side, other, directions in bend
            for direction in directions
        ]
        qdd = keep @ qdd - np.linalg.pinv(Psi) @ bias

    text = [f"gravity: {_pair(gravity)}", "links:"]
    text += [f"  - {_flow(entry)}" for entry in links]
    if closures:
        text += ["closures:"] + [f"  - {_flow(closure)}" for closure in closures]
    if shape.actuated is not None:
        text.append(f"actuated: {_flow([f'link{k}' for k in shape.actuated])}")
    if shape.start:
        text.append("start: " + _flow({f"link{k}": float(x) for k, x in enumerate(pose.q)}))
    return Scene("\n".join(text) + "\n", pose.q, qd, qdd)


def forced(seed: int, plain: Scene) -> Scene:
    """The scene with springs, loads and friction of every kind at random links."""
    numbers, n = seeded(1000 + seed), plain.n

    def link() -> str:
        return f"link{numbers.whole(0, n - 1)}"

    def place() -> dict:
        return {"link": link(), "at": _pair(numbers.point(0.8))}

    first = place()
    second = _pair(numbers.point(2.0))
    others = [f"link{k}" for k in range(n) if f"link{k}" != first["link"]]
    if others:
        second = {"link": others[seed % len(others)], "at": second}
    springs = [
        {
            "between": [place(), _pair(numbers.point(2.0))],
            "stiffness": numbers.real(5.0, 40.0),
            "length": numbers.real(0.1, 1.0),
            "damping": numbers.real(0.1, 2.0),
        },
        {"between": [first, second], "stiffness": numbers.real(5.0, 40.0), "length": 0},
        {
            "joint": link(),
            "stiffness": numbers.real(1.0, 9.0),
            "angle": numbers.real(-2.0, 2.0),
            "damping": numbers.real(0.0, 0.5),
        },
    ]
    loads = [
        {**place(), "force": _pair(numbers.point(9.0))},
        {**place(), "force": _pair(numbers.point(9.0)), "frame": "link"},
        {"link": link(), "torque": numbers.real(-3.0, 3.0)},
    ]
    friction = {"torque": numbers.real(0.1, 2.0), "speed": numbers.real(0.5, 2.0)}
    rubbing = f"name: link{numbers.whole(0, n - 1)},"
    text = plain.text.replace(rubbing, f"{rubbing} friction: {_flow(friction)},")
    lists = {"springs": springs, "loads": loads}
    added = [f"{key}: {_flow(entries)}\n" for key, entries in lists.items()]
    return Scene(text + "".join(added), plain.q, plain.qd, plain.qdd)


def motored(seed: int, plain: Scene) -> Scene:
    """The scene with a motor at every joint but the last, or at its only one."""
    numbers, text = seeded(3000 + seed), plain.text
    for k in range(max(1, plain.n - 1)):
        motor = {
            "ratio": numbers.real(2.0, 40.0) * (-1) ** numbers.whole(0, 1),
            "inertia": numbers.real(1e-5, 1e-3),
            "damping": numbers.real(0.0, 1e-3),
        }
        text = text.replace(f"name: link{k},", f"name: link{k}, motor: {_flow(motor)},")
    return Scene(text, plain.q, plain.qd, plain.qdd)


def sliding(seed: int, plain: Scene, joint: int) -> Scene:
    """The open tree with a prismatic joint in place of one of its others."""
    axis = _flow(_pair(seeded(4000 + seed).point(1.0)))
    name = f"name: link{joint},"
    text = plain.text.replace(name, f"{name} joint: prismatic, axis: {axis},")
    return Scene(text, plain.q, plain.qd, plain.qdd)


def seeded_scene(seed: int, shape: Shape, massless: tuple[int, ...] = ()) -> Scene:
    """A random scene of this shape, always the same for the same seed."""
    numbers = seeded(seed)
    while (found := scene(numbers, shape, massless)) is None:
        pass
    return found


def seeded_tree(seed: int, n: int) -> Scene:
    """A random open tree of n links, always the same for the same seed."""
    return seeded_scene(seed, Shape(_parents(seeded(seed), n)))


@st.composite
def trees(draw, least: int = 1, most: int = 6) -> Scene:
    """Open trees of `least` to `most` links."""
    numbers = drawn(draw)
    return scene(numbers, Shape(_parents(numbers, numbers.whole(least, most))))


@st.composite
def loops(draw, shapes: dict[str, Shape] = LOOPS) -> Scene:
    """Closed mechanisms of one of the shapes, away from singular configurations."""
    shape = draw(st.sampled_from(list(shapes.values())))
    found = scene(drawn(draw), shape)
    if found is None:
        reject()
    return found


def _parents(numbers: Numbers, n: int) -> tuple[int | None, ...]:
    choices = [numbers.whole(-1, k - 1) for k in range(n)]
    return tuple(None if k < 0 else k for k in choices)


def _least(Psi: np.ndarray) -> float:
    """The least singular value, m; 0 for fewer columns than rows."""
    rows, columns = Psi.shape
    return np.linalg.svd(Psi, compute_uv=False)[-1] if columns >= rows else 0.0


def _pair(z: complex) -> list[float]:
    return [float(z.real), float(z.imag)]


def _point(link: int | None, at: complex):
    """A point as a scene writes it."""
    return _pair(at) if link is None else {"link": f"link{link}", "at": _pair(at)}


def _flow(value) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return value if isinstance(value, str) else repr(value)


# ---------------------------------------------------------------------------------------------
# The oracles' form of a scene, and the sizes that rounding is measured against
# ---------------------------------------------------------------------------------------------


def oracle_tree(description: Description) -> list[dict]:
    """The links as the oracles take them; a payload is merged into its link's mass and inertia.

    Every link must stand after the one that it hangs from.
    """
    tree = []
    for link in description.links:
        m = link.m + link.payload
        r = (link.m * link.r + link.payload * link.l) / m if m else 0j
        I = link.I + link.m * abs(link.r - r) ** 2 + link.payload * abs(link.l - r) ** 2
        at, parent = link.hangs_from.at, link.hangs_from.link
        tree.append({"m": m, "l": link.l, "r": r, "I": I, "parent": parent, "at": at})
        if link.axis is not None:
            tree[-1]["axis"] = link.axis
        if link.motor is not None:
            tree[-1]["rotor"] = link.motor.ratio, link.motor.inertia
    return tree


def oracle_closures(description: Description) -> list[tuple[Place, Place]]:
    """The closures as pairs of points; a slider's second point is one of its line."""
    return [
        ((closure.first.link, closure.first.at), (closure.second.link, closure.second.at))
        for closure in description.closures
    ]


@dataclass(frozen=True)
class Sizes:
    """Sizes of the terms of a mechanism: what they would be if nothing cancelled."""

    inertia: float  # kg m^2
    gravity: float  # N m
    damping: float  # N m s
    loop: float  # m

    def coriolis(self, qd: np.ndarray) -> float:
        """Of C, N m s."""
        return self.inertia * float(np.abs(qd).sum())

    def torque(self, qd: np.ndarray, qdd: np.ndarray) -> float:
        """Of M qdd + C qd + D qd + G, N m."""
        w = float(np.abs(qd).sum())
        return self.inertia * (float(np.abs(qdd).sum()) + w**2) + self.gravity + self.damping * w


def sizes(description: Description) -> Sizes:
    """Sum over the bodies of mass times the way from the ground, and its square."""
    tree = oracle_tree(description)
    reach: list[float] = []  # the way from the ground to each link's joint
    most = max(max(link["l"], abs(link["at"]), abs(link["r"])) for link in tree)
    for link in tree:
        parent = link["parent"]
        reach.append(0.0 if parent is None else reach[parent] + abs(link["at"]))
        reach[-1] += 2.0 * most if "axis" in link else 0.0
    inertia = sum(
        link["m"] * ((way + abs(link["r"])) ** 2 + ("axis" in link)) + link["I"]
        for link, way in zip(tree, reach, strict=True)
    )
    moment = sum(link["m"] * (way + abs(link["r"])) for link, way in zip(tree, reach, strict=True))
    loops = [
        abs(at) + (0.0 if link is None else reach[link])
        for pair in oracle_closures(description)
        for link, at in pair
    ]
    for link in tree:
        ratio, rotor = link.get("rotor", (0.0, 0.0))
        inertia += rotor * (1.0 + abs(ratio)) ** 2
    motors = [link.motor for link in description.links if link.motor is not None]
    damping = max(link.damping for link in description.links)
    damping += max((x.damping * x.ratio**2 for x in motors), default=0.0)
    return Sizes(inertia, abs(description.gravity) * moment, damping, max(loops, default=0.0))


def assert_close(actual, expected, size: float, rtol: float = 1e-13) -> None:
    """Equal to within rtol of `size`, the size of the terms that the values are sums of."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    worst = np.max(np.abs(actual - expected), initial=0.0)
    assert worst <= rtol * size, f"off by {float(worst):.3g}, terms of {size:.3g}"
