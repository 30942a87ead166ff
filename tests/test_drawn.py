"""Scenes by the coordinates of their pins: the tree that they make, and where circles meet."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import Outcome

import robodyn
from robodyn.dynamics.closed_form import coriolis_matrix, gravity_vector, mass_matrix
from robodyn.dynamics.named_points import points
from robodyn.errors import DescriptionError
from robodyn.loops.assembly import assemble
from robodyn.loops.assembly_plan import with_independent
from robodyn.loops.closures import closure_gap, closure_jacobian
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene import yaml_tree
from robodyn.scene.description import _Reader, from_text
from robodyn.scene.drawn import Drawing
from robodyn.scene.scene_values import SceneValues, read_numbers

Run = Callable[..., Outcome]


def built(text: str) -> Mechanism:
    return build(from_text(text, "drawn.yaml"))


def start_of(mechanism: Mechanism) -> np.ndarray:
    return np.array(mechanism.description.start, float)


def text_of(
    pins: dict[str, complex],
    links: dict[str, str],
    ground: str,
    actuated: str,
    more: str = "",
) -> str:
    """A drawn scene whose links, by names, have these pins; their masses differ."""
    lines = [f"  {name}: [{z.real!r}, {z.imag!r}]" for name, z in pins.items()]
    rows = [
        f"  - {{name: {name}, pins: [{own}], m: {1 + 0.1 * k}, r: [{0.1 + 0.01 * k}, 0.02], "
        f"I: {0.01 + 0.003 * k}}}"
        for k, (name, own) in enumerate(links.items())
    ]
    ends = [f"ground: [{ground}]", f"actuated: [{actuated}]", more]
    return "\n".join(["gravity: [0.3, -9.7]", "pins:", *lines, "links:", *rows, *ends])


# A hundred random linkages, written both ways


class Linkage:
    """A crank or two, and dyads that hang from points of what is there, with random numbers.

    With `slides` there are pistons, cylinders, pins on lines of the ground and in slots too.
    """

    def __init__(self, seed: int, slides: bool = False) -> None:
        self.rng = random.Random(seed)
        self.pins: dict[str, complex] = {}
        self.links: list[dict] = []
        self.ground: list[str] = []
        self.lines: dict[str, float] = {}  # pins on lines of the ground, and their angles
        self.slots: list[tuple[str, int, float]] = []
        for _ in range(self.rng.randint(1, 2)):  # cranks
            self.add([self.on_ground(), self.new()])
        kinds = ["dyad"] if not slides else ["dyad", "piston", "cylinder", "line", "slot"]
        for k in range(self.rng.randint(1, 4)):
            self.close(kinds[seed % 5] if slides and not k else self.rng.choice(kinds))
        for _ in range(2):  # points of one link, and a pendulum from one of them
            link = self.rng.choice(self.links)
            link["pins"].append(self.new())
        self.add([self.links[0]["pins"][1], self.new()])
        used = {name for link in self.links for name in link["pins"]}
        self.pins = {name: z for name, z in self.pins.items() if name in used}
        self.ground = [name for name in self.ground if name in used]

    def close(self, kind: str) -> None:
        """Links that close a loop with what is there."""
        first, way = self.there(), self.rng.uniform(-3, 3)
        if kind == "dyad":
            second = self.there(self.rng.random() < 0.5)
            if first == second or self.same_link(first, second):
                second = self.on_ground()
            meeting = self.new()
            self.add([first, meeting])
            self.add([second, meeting])
        elif kind == "piston":
            meeting = self.on_ground()
            rod = [first, meeting]
            two = [meeting, self.new()] if self.rng.random() < 0.5 else [meeting]
            if self.rng.random() < 0.5:
                self.add(rod)
                self.add(two, way)
            else:
                self.add(two, way)
                self.add(rod)
        elif kind == "cylinder":
            while first in self.ground:
                first = self.there()
            inside = self.new()
            self.add([self.on_ground(), inside])
            self.add([inside, first], way)
        elif kind == "line":
            meeting = self.new()
            self.add([first, meeting])
            self.lines[meeting] = way
        else:
            while first in self.ground:
                first = self.there()
            self.add([self.on_ground(), self.new()])
            self.slots.append((first, len(self.links) - 1, way))

    def new(self) -> str:
        name = f"P{len(self.pins)}"
        self.pins[name] = complex(self.rng.uniform(-1, 1), self.rng.uniform(-1, 1))
        return name

    def on_ground(self) -> str:
        self.ground.append(self.new())
        return self.ground[-1]

    @property
    def sliding(self) -> dict[str, int]:
        """The pins that go along with a link that slides."""
        return {x["pins"][0]: k for k, x in enumerate(self.links) if x["along"] is not None}

    def there(self, ground: bool = False) -> str:
        """A pin that is there, or a new one of a link or the ground."""
        if ground:
            return self.on_ground()
        turning = [link for link in self.links if link["along"] is None]
        link = self.rng.choice(turning)
        if self.rng.random() < 0.5:
            link["pins"].append(self.new())
        return self.rng.choice([x for x in link["pins"] if x not in self.sliding])

    def same_link(self, first: str, second: str) -> bool:
        on_ground = {first, second} <= set(self.ground)
        return on_ground or any({first, second} <= set(link["pins"]) for link in self.links)

    def add(self, pins: list[str], along: float | None = None) -> None:
        x, y = (self.rng.uniform(-0.5, 0.5) for _ in range(2))
        numbers = {"m": self.rng.uniform(0.1, 2), "centre": (x, y), "I": self.rng.uniform(0.01, 1)}
        name = f"link {len(self.links)}"
        self.links.append({"name": name, "pins": pins, "along": along, **numbers})

    def drawn(self) -> str:
        lines = ["gravity: 9.81", "pins:"]
        lines += [f"  {name}: [{z.real!r}, {z.imag!r}]" for name, z in self.pins.items()]
        lines += ["links:"]
        for link in self.links:
            centre = ", ".join(map(repr, link["centre"]))
            along = "" if link["along"] is None else f"along: {vector(2.5, link['along'])}, "
            lines.append(
                f"  - {{name: {link['name']}, pins: [{', '.join(link['pins'])}], {along}"
                f"m: {link['m']!r}, centre: [{centre}], I: {link['I']!r}}}"
            )
        ground = self.ground + [
            f"{{pin: {pin}, along: {vector(0.3, way)}}}" for pin, way in self.lines.items()
        ]
        slots = [
            f"{{pin: {pin}, on: {self.links[k]['name']}, along: {vector(7.0, way)}}}"
            for pin, k, way in self.slots
        ]
        ends = [f"ground: [{', '.join(ground)}]", f"slots: [{', '.join(slots)}]"]
        return "\n".join([*lines, *ends])

    def explicit(self) -> tuple[str, list[float]]:
        """The same in lengths and closures, by angles, and the values of the joints."""
        lines, closures, joints = ["gravity: 9.81", "links:"], [], []
        directions: list[float] = []
        seen: dict[str, int] = {}
        fixed = set(self.ground) - set(self.sliding)

        def own(k: int, z: complex) -> str:
            apart = z - self.pins[self.links[k]["pins"][0]]
            return vector(abs(apart), math.atan2(apart.imag, apart.real) - directions[k])

        def place(k: int, pin: str) -> str:
            return f"{{link: {self.links[k]['name']}, at: {own(k, self.pins[pin])}}}"

        for k, link in enumerate(self.links):
            first, *further = link["pins"]
            a = self.pins[first]
            slides = link["along"] is not None
            b = self.pins[further[0]] if further else a
            way = link["along"] if slides else math.atan2((b - a).imag, (b - a).real)
            directions.append(way)
            above = None if first in self.ground and (slides or first in fixed) else seen[first]
            z = f"[{a.real!r}, {a.imag!r}]" if above is None else place(above, first)
            turned = way - (0.0 if above is None else directions[above])
            joints.append(0.0 if slides else turned)
            apart = complex(*link["centre"]) - a
            r = vector(abs(apart), math.atan2(apart.imag, apart.real) - way)
            J = link["I"] + link["m"] * abs(apart) ** 2
            kind = f", joint: prismatic, axis: {vector(1.0, turned)}" if slides else ""
            lines.append(
                f"  - {{name: {link['name']}, m: {link['m']!r}, r: {r}, J: {J!r}, from: {z}, "
                f"l: {0.0 if slides else abs(b - a)!r}{kind}}}"
            )
            for name in [first] * slides + further:
                c = self.pins[name]
                if name in fixed:
                    closures.append(f"  - [{place(k, name)}, [{c.real!r}, {c.imag!r}]]")
                elif name in seen and not (slides and name == first and seen[name] == above):
                    closures.append(f"  - [{place(seen[name], name)}, {place(k, name)}]")
                elif name in self.lines:
                    line = (
                        f"through: [{c.real!r}, {c.imag!r}], along: {vector(1, self.lines[name])}"
                    )
                    closures.append(f"  - {{point: {place(k, name)}, on: {{{line}}}}}")
            for name in link["pins"]:
                if name == first and slides:
                    seen[name] = seen[name] if name in seen and seen[name] != above else k
                else:
                    seen.setdefault(name, k)
        for pin, k, way in self.slots:
            line = f"through: {own(k, self.pins[pin])}, along: {vector(1, way - directions[k])}"
            line = f"link: {self.links[k]['name']}, {line}"
            closures.append(f"  - {{point: {place(seen[pin], pin)}, on: {{{line}}}}}")
        return "\n".join([*lines, *(["closures:"] if closures else []), *closures]), joints


def vector(length: float, angle: float) -> str:
    return f"[{length * math.cos(angle)!r}, {length * math.sin(angle)!r}]"


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("seed", range(100))
def test_a_random_linkage_is_the_same_in_both_forms(seed: int, slides: bool) -> None:
    linkage = Linkage(seed, slides)
    text, joints = linkage.explicit()
    drawn, explicit = built(linkage.drawn()), built(text)
    q = start_of(drawn)
    assert np.abs(np.exp(1j * q) - np.exp(1j * np.array(joints))).max() < 1e-14
    assert np.abs(closure_gap(drawn, q, t=0.0)).max(initial=0.0) < 1e-14
    assert drawn.actuated == explicit.actuated
    driver = with_independent(drawn)
    assembled = assemble(driver, q[list(driver.actuated)], t=0.0)
    turning = [k for k in range(drawn.n) if k not in drawn.slides]
    assert np.abs(np.exp(1j * assembled) - np.exp(1j * q))[turning].max() < 1e-6
    assert np.abs(assembled - q)[list(drawn.slides)].max(initial=0.0) < 1e-6
    qd = np.array([linkage.rng.uniform(-1, 1) for _ in q])
    for own, other in (
        (mass_matrix(drawn, q), mass_matrix(explicit, q)),
        (coriolis_matrix(drawn, q, qd), coriolis_matrix(explicit, q, qd)),
        (gravity_vector(drawn, q), gravity_vector(explicit, q)),
        (closure_jacobian(drawn, q, t=0.0), closure_jacobian(explicit, q, t=0.0)),
    ):
        assert own.shape == other.shape
        assert np.abs(own - other).max(initial=0.0) <= 1e-14 * max(1.0, np.abs(own).max(initial=0))


@pytest.mark.parametrize("seed", range(0, 100, 5))
def test_the_joints_that_are_actuated_by_default(seed: int) -> None:
    text = Linkage(seed, slides=True).drawn()
    for more in ("", "\ncouplings: [q2 = 0.5 q1]"):
        try:
            description = from_text(text + more, "drawn.yaml")
        except DescriptionError:  # a displacement by an angle
            continue
        root = yaml_tree.parse(text, "drawn.yaml")
        assert isinstance(root, yaml_tree.Mapping)
        drawing = Drawing(root, _Reader(None))
        assert tuple(drawing.actuated(description)) == build(description).actuated


# Known linkages, by circles


def third(a: complex, b: complex, ra: float, rb: float, side: float) -> complex:
    """The point ra from a and rb from b, to the left of the way from a to b where side > 0."""
    apart = b - a
    along = (ra * ra - rb * rb + abs(apart) ** 2) / (2 * abs(apart))
    across = math.sqrt(ra * ra - along * along)
    return a + apart / abs(apart) * complex(along, math.copysign(across, side))


def side_of(a: complex, b: complex, p: complex) -> float:
    return ((b - a).conjugate() * (p - a)).imag


class Drawn:
    """A drawing that is moved by circles: pins found one after another, each by two others."""

    def __init__(self, pins: dict[str, complex], crank: tuple[str, str], found: list[str]) -> None:
        self.pins, self.crank = pins, crank
        self.found = [name.split() for name in found]  # P by A and B

    def at(self, turn: float) -> dict[str, complex]:
        """Where the pins are when the crank has turned by this angle, rad."""
        z = dict(self.pins)
        centre, pin = self.crank
        moved = {pin: z[centre] + (z[pin] - z[centre]) * cmath.exp(1j * turn)}
        for name, a, b in self.found:
            A, B, P = (self.pins[x] for x in (a, b, name))
            now = [moved.get(x, self.pins[x]) for x in (a, b)]
            moved[name] = third(*now, abs(P - A), abs(P - B), side_of(A, B, P))
        return z | moved


def joint_angles(links: dict[str, str], ground: list[str], z: dict[str, complex]) -> list[float]:
    """q of links in the rule of the drawing, for pins at z."""
    directions: list[complex] = []
    seen: dict[str, int] = {}
    for k, text in enumerate(links.values()):
        first, second, *_ = text.split(", ")
        above = None if first in ground else seen[first]
        own = z[second] - z[first]
        directions.append(own / abs(own))
        for name in text.split(", "):
            seen.setdefault(name, k)
        yield cmath.phase(directions[k] / (1.0 if above is None else directions[above]))


def check_turns(
    drawn: Drawn, links: dict[str, str], ground: str, turns: np.ndarray, more: str = ""
) -> Mechanism:
    """Assembled at crank angles all joints are where circles have them."""
    first = next(iter(links))
    mechanism = built(text_of(drawn.pins, links, ground, first, more))
    q0 = start_of(mechanism)
    assert np.abs(closure_gap(mechanism, q0, t=0.0)).max() < 1e-14 * max(
        map(abs, drawn.pins.values())
    )
    q = assemble(mechanism, q0[0] + turns[:, None], t=0.0)
    for row, turn in zip(q, turns, strict=True):
        wanted = list(joint_angles(links, ground.split(", "), drawn.at(turn)))
        assert np.abs(np.exp(1j * row) - np.exp(1j * np.array(wanted))).max() < 1e-9
    return mechanism


def jansen(turn: float) -> tuple[Drawn, dict[str, str]]:
    """Theo Jansen's leg by his eleven numbers, with the crank at this angle, rad."""
    a, b, c, d, e, f, g, h, i, j, k, lower, m = (
        38.0, 41.5, 39.3, 40.1, 55.8, 39.4, 36.7, 65.7, 49.0, 50.0, 61.9, 7.8, 15.0,
    )  # fmt: skip
    pins = {"O": 0j, "Z": complex(-a, -lower), "A": m * cmath.exp(1j * turn)}
    pins["B"] = third(pins["Z"], pins["A"], b, j, 1.0)
    pins["C"] = third(pins["Z"], pins["A"], c, k, -1.0)
    pins["D"] = third(pins["Z"], pins["B"], d, e, 1.0)
    pins["E"] = third(pins["D"], pins["C"], f, g, -1.0)
    pins["F"] = third(pins["E"], pins["C"], h, i, -1.0)
    pins = {name: 0.01 * z for name, z in pins.items()}
    links = {
        "crank": "O, A",
        "upper rod": "A, B",
        "upper triangle": "Z, B, D",
        "lower rod": "A, C",
        "rocker": "Z, C",
        "strut": "D, E",
        "foot": "C, E, F",
    }
    found = ["B Z A", "D Z B", "C Z A", "E D C", "F E C"]
    return Drawn(pins, ("O", "A"), found), links


@pytest.mark.parametrize("turn", [0.0, 1.3, 2.6, 4.5])
def test_theo_jansens_leg(turn: float) -> None:
    drawn, links = jansen(turn)
    turns = np.linspace(0.0, 2 * np.pi, 73)
    mechanism = check_turns(drawn, links, "O, Z", turns)
    q = assemble(mechanism, start_of(mechanism)[0] + turns[:, None], t=0.0)
    foot = points(mechanism, q, of="F").position[:, 0]
    wanted = np.array([drawn.at(x)["F"] for x in turns])
    assert np.abs(foot @ [1, 1j] - wanted).max() < 1e-11
    assert points(mechanism, q).names == ("F",)
    height = np.sort(foot[:, 1] - foot[:, 1].min())
    assert height[25] < 0.05 * (foot[:, 0].max() - foot[:, 0].min())  # it walks on a flat third


def test_klanns_leg() -> None:
    """A crank, a connecting arm, two rockers and a leg, at each angle of the crank."""
    pins = {"O": 0j, "A": 0.12 * cmath.exp(0.6j), "R": -0.27 + 0.13j, "S": -0.24 - 0.13j}
    pins["B"] = third(pins["A"], pins["S"], 0.29, 0.17, -1.0)
    pins["C"] = pins["A"] + (pins["B"] - pins["A"]) * 1.9 * cmath.exp(-0.25j)
    pins["D"] = third(pins["C"], pins["R"], 0.23, 0.22, -1.0)
    pins["E"] = pins["D"] + (pins["D"] - pins["C"]) * 1.6 * cmath.exp(0.35j)
    links = {
        "crank": "O, A",
        "connecting arm": "A, B, C",
        "lower rocker": "S, B",
        "leg": "C, D, E",
        "upper rocker": "R, D",
    }
    found = ["B A S", "C A B", "D C R", "E C D"]
    check_turns(Drawn(pins, ("O", "A"), found), links, "O, R, S", np.linspace(0, 6.3, 64))


STEPHENSON = (
    {
        "O": 0j, "A": 0.12 + 0.2j, "B": 0.75 + 0.42j, "Q": 0.82 + 0j, "C": 0.4 + 0.6j,
        "D": 1.3 + 0.7j, "G": 1.25 + 0.15j,
    },
    {"crank": "O, A", "coupler": "A, B, C", "rocker": "Q, B", "rod": "C, D", "output": "G, D"},
    "O, Q, G",
    ["B A Q", "C A B", "D C G"],
)  # fmt: skip
WATT = (
    {
        "O": 0j, "A": 0.1 + 0.21j, "B": 0.7 + 0.55j, "Q": 0.8 + 0j, "C": 1.05 + 0.5j,
        "D": 1.6 + 0.9j, "G": 1.7 + 0.1j,
    },
    {"crank": "O, A", "coupler": "A, B", "rocker": "Q, B, C", "rod": "C, D", "output": "G, D"},
    "O, Q, G",
    ["B A Q", "C Q B", "D C G"],
)  # fmt: skip


@pytest.mark.parametrize("six_bar", [STEPHENSON, WATT])
@pytest.mark.parametrize("mirrored", [False, True])
def test_six_bars(six_bar: tuple, mirrored: bool) -> None:
    pins, links, ground, found = six_bar
    if mirrored:
        pins = {name: z.conjugate() for name, z in pins.items()}
    check_turns(Drawn(pins, ("O", "A"), found), links, ground, np.linspace(-0.5, 0.5, 21))


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 2, 1, 3), (0, 1, 3, 2)])
def test_the_order_of_links_is_free(order: tuple[int, ...]) -> None:
    """The tree differs, the pose does not."""
    pins = {"O": 0j, "A": 0.2 + 0.3j, "B": 1 + 0.8j, "Q": 1.1 + 0j, "P": 0.6 + 0.9j}
    links = {"crank": "O, A", "coupler": "A, B, P", "rocker": "Q, B", "bob": "P, W"}
    pins["W"] = 0.7 + 0.2j
    names = list(links)
    links = {names[k]: links[names[k]] for k in order}
    mechanism = built(text_of(pins, links, "O, Q", "crank, bob"))
    assert np.abs(closure_gap(mechanism, start_of(mechanism), t=0.0)).max() < 1e-15


def test_a_scissor() -> None:
    """Crossed arms, level by level; the lower right pin runs on the ground."""
    pins = {"L0": 0j, "R0": 0.8 + 0j}
    for k in range(2):
        y = 0.6j * (k + 1)
        pins |= {f"L{k + 1}": y, f"R{k + 1}": 0.8 + y, f"M{k}": 0.4 + y - 0.3j}
    links = {
        "rise 0": "L0, R1, M0",
        "fall 0": "M0, L1, R0",
        "rise 1": "L1, R2, M1",
        "fall 1": "R1, L2, M1",
    }
    text = text_of(pins, links, "L0, {pin: R0, along: [1, 0]}", "rise 0")
    mechanism = built(text)
    q0 = start_of(mechanism)
    assert np.abs(closure_gap(mechanism, q0, t=0.0)).max() < 1e-15
    for turn in (-0.3, -0.1, 0.2):
        q = assemble(mechanism, [q0[0] + turn], t=0.0)
        z = cmath.rect(1.0, q0[0] + turn)
        of = ("R0=fall 0@" + ",".join(map(str, _at(mechanism, 1, "R0", pins))), "tip3", "tip4")
        R0, R2, L2 = points(mechanism, q, of=of).position @ [1, 1j]
        assert abs(R0 - z.real) < 1e-12
        assert abs(R2 - complex(z.real, 2 * z.imag)) < 1e-12
        assert abs(L2 - 2j * z.imag) < 1e-12


def _at(mechanism: Mechanism, link: int, pin: str, pins: dict[str, complex]) -> list[float]:
    """Where a pin is in the frame of `fall 0`, whose first pins are M0 and L1."""
    axis = pins["L1"] - pins["M0"]
    own = (pins[pin] - pins["M0"]) * axis.conjugate() / abs(axis)
    return [own.real, own.imag]


def test_a_3rrr_robot() -> None:
    """Its platform keeps the lengths of the legs, and three freedoms."""
    pins: dict[str, complex] = {}
    links: dict[str, str] = {}
    for k in range(3):
        turn = cmath.exp(2j * math.pi * k / 3)
        pins |= {f"O{k}": 0.5 * turn, f"A{k}": 0.5 * turn + 0.3 * turn * cmath.exp(2.1j)}
        pins[f"B{k}"] = 0.03 + 0.02j + 0.1 * turn * cmath.exp(0.4j)
        links[f"arm {k}"] = f"O{k}, A{k}"
        links[f"rod {k}"] = f"A{k}, B{k}"
    links["plate"] = "B0, B1, B2"
    text = text_of(pins, links, "O0, O1, O2", "arm 0, arm 1, arm 2")
    mechanism = built(text)
    q0 = start_of(mechanism)
    assert np.abs(closure_gap(mechanism, q0, t=0.0)).max() < 1e-15
    driven = q0[list(mechanism.actuated)] + [0.15, -0.1, 0.05]
    q = assemble(mechanism, driven, t=0.0)
    names = [f"tip{mechanism.link_names.index(f'arm {k}') + 1}" for k in range(3)]
    names += [f"B{k}=tip{mechanism.link_names.index(f'rod {k}') + 1}" for k in range(3)]
    *arms, B0, B1, B2 = points(mechanism, q, of=names).position @ [1, 1j]
    for k, (arm, B) in enumerate(zip(arms, (B0, B1, B2), strict=True)):
        assert abs(abs(B - arm) - abs(pins[f"B{k}"] - pins[f"A{k}"])) < 1e-12
    for first, second in pairwise((B0, B1, B2, B0)):
        assert abs(abs(first - second) - 0.1 * math.sqrt(3)) < 1e-12
    assert ((B1 - B0).conjugate() * (B2 - B0)).imag > 0.0


# What a drawing may be


FOUR_BAR = """\
gravity: 9.81
pins: {O2: [0, 0], A: [0.175, 0.303], B: [1.046, 0.798], O4: [1.1, 0], P: [0.62, 0.85], S: [1, 1]}
links:
  - {name: crank, pins: [O2, A], m: 0.6, r: 0.15, I: 0.008}
  - {name: coupler, pins: [A, B, P], m: 1.3, centre: [0.6, 0.6], I: 0.102}
  - {name: rocker, pins: [O4, B], m: 1.0, r: 0.36, I: 0.061}
ground: [O2, O4, S]
springs:
  - {between: [S, B], stiffness: 400, length: 0.3}
loads:
  - {point: P, force: [10, 0]}
  - {point: B, force: [0, 3]}
points: {Q: B, G: centre3}
"""


def test_pins_are_ends_of_springs_points_of_loads_and_points() -> None:
    description = from_text(FOUR_BAR, "x.yaml")
    named = dict(description.points)
    assert list(named) == ["P", "Q", "G"]
    mechanism = build(description)
    q = start_of(mechanism)
    assert points(mechanism, q).names == ("P", "Q", "G")
    of = ["O=joint1", "B", "P", "Q", "R=rocker"]
    places = points(mechanism, q, of=of).position @ [1, 1j]
    wanted = [0, 1.046 + 0.798j, 0.62 + 0.85j, 1.046 + 0.798j, 1.046 + 0.798j]
    assert np.abs(places - wanted).max() < 1e-15
    (spring,) = description.springs
    assert (spring.first.link, spring.first.at) == (None, 1 + 1j)
    assert spring.second.link == 1  # the first link that has B
    assert [load.point for load in description.loads] == [named["P"], named["Q"]]


def test_without_q_it_is_as_drawn(robodyn: Run, tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(FOUR_BAR)
    angle = repr(cmath.phase(0.175 + 0.303j))
    for command in ("torque", "points", "assemble", "terms", "energy", "check"):
        told = robodyn(command, scene).succeeds()
        if command != "check":
            assert told.out == robodyn(command, scene, "--q", angle).succeeds().out
    short = ("simulate", scene, "--time", "0.1", "--points", "3")
    assert robodyn(*short).out == robodyn(*short, "--q", angle).out


def test_a_sweep_of_a_pin_begins_as_drawn(robodyn: Run, tmp_path: Path) -> None:
    """Each with its own drawing: the crank's angle follows A."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(FOUR_BAR)
    given = robodyn("sweep", scene, "--vary", "pins.A[0]=0.15,0.2", "--kind", "torque", "--quiet")
    for row, x in zip(given.succeeds().rows, (0.15, 0.2), strict=True):
        one = robodyn("torque", scene, "--set", f"pins.A=[{x}, 0.303]").rows[0]
        assert float(row["tau1"]) == pytest.approx(float(one["tau1"]), rel=1e-12)


def test_a_pin_that_moves_takes_its_links_along() -> None:
    values = SceneValues(FOUR_BAR, "x.yaml")
    assert {"pins.B[0]", "pins.B[1]", "links.coupler.centre[0]", "links.rocker.r"} <= {
        *values.names
    }
    moved = values.replaced({"pins.B[0]": 1.2}).links
    assert moved[1].l == abs(1.2 + 0.798j - (0.175 + 0.303j))
    assert moved[2].l == abs(0.1 + 0.798j)
    whole = read_numbers(FOUR_BAR, "x.yaml", (("pins.B", "[1.2, 0.798]"),)).base
    assert whole.links == moved
    both = values.replaced({"links.coupler.centre[0]": 0.5, "links.coupler.centre[1]": 0.7}).links
    whole = read_numbers(FOUR_BAR, "x.yaml", (("links.coupler.centre", "[0.5, 0.7]"),)).base
    assert whole.links == both


def test_three_pins_on_a_line_are_no_fault() -> None:
    text = FOUR_BAR.replace("P: [0.62, 0.85]", "P: [0.6105, 0.5505]")
    point = dict(from_text(text, "x.yaml").points)["P"]
    assert point.at.imag == 0.0  # rounding is none


def test_a_branch_that_cannot_be_read() -> None:
    """B on the line from A to O4, or as far from it as digits go."""
    for off, refused in ((0.0, True), (1e-9, True), (1e-5, False), (-1e-5, False)):
        A, O4 = 0.175 + 0.303j, 1.1 + 0j
        B = A + 0.6 * (O4 - A) + off * 1j
        text = FOUR_BAR.replace("B: [1.046, 0.798]", f"B: [{B.real!r}, {B.imag!r}]")
        if not refused:
            mechanism = built(text)
            q = assemble(mechanism, start_of(mechanism)[:1], t=0.0)
            assert np.abs(q - start_of(mechanism)).max() < 1e-9
            continue
        with pytest.raises(DescriptionError, match="coupler and rocker are drawn in line"):
            built(text)
        driven = built(text + "actuated: [rocker]\n")  # of which it is none
        assert driven.actuated == (2,)


def test_a_later_loop_that_cannot_be_read() -> None:
    pins, links, ground, _ = STEPHENSON
    apart = pins["G"] - pins["C"]
    pins = pins | {"D": pins["C"] + 0.4 * apart}
    with pytest.raises(DescriptionError, match=r"rod and output are drawn in line, at a dead"):
        built(text_of(pins, links, ground, "crank"))


PARALLELOGRAM = {"O": 0j, "A": 0.2 + 0.3j, "Q": 1 + 0j, "B": 1.2 + 0.3j, "R": 0.5 + 0j}


@pytest.mark.parametrize("off", [0.0, 1e-3])
def test_a_third_crank_of_a_parallelogram(off: float) -> None:
    """It moves by its proportions alone."""
    pins = {**PARALLELOGRAM, "C": 0.7 + off + 0.3j}
    links = {"crank": "O, A", "coupler": "A, B, C", "rocker": "Q, B", "third": "R, C"}
    text = text_of(pins, links, "O, Q, R", "crank")
    if off:
        with pytest.raises(DescriptionError, match="cannot move as drawn: 4 joints"):
            built(text)
    else:
        mechanism = built(text)
        assert np.abs(closure_gap(mechanism, start_of(mechanism), t=0.0)).max() < 1e-15


def test_freedoms_that_no_joint_drives_are_no_fault() -> None:
    """A five-bar with one actuated crank; a pole on a cart."""
    pins = {"O": 0j, "A": 0.1 + 0.3j, "B": 0.5 + 0.6j, "C": 0.9 + 0.4j, "Q": 1 + 0j}
    links = {"left": "O, A", "rod": "A, B", "other rod": "C, B", "right": "Q, C"}
    with pytest.raises(DescriptionError, match="begins with C, which is on nothing above"):
        built(text_of(pins, links, "O, Q", "left"))
    links = {"left": "O, A", "rod": "A, B", "right": "Q, C", "other rod": "C, B"}
    assert built(text_of(pins, links, "O, Q", "left")).n == 4
    cart = """\
gravity: 9.81
pins: {O: [0, 0], P: [0, 0.5]}
links:
  - {name: cart, pins: [O], along: [1, 0], m: 1, r: 0, I: 0.1}
  - {name: pole, pins: [O, P], m: 0.2, r: 0.3, J: 0.02}
ground: [O]
actuated: [cart]
"""
    mechanism = built(cart)
    assert mechanism.description.links[1].hangs_from.link == 0
    assert list(start_of(mechanism)) == [0.0, math.pi / 2]


def test_a_piston_in_the_slot_of_a_lever() -> None:
    """The pin goes along with the piston, though the ground has it as drawn."""
    text = """\
gravity: 9.81
pins: {Q: [0, 0], T: [0.2, 0.6], C: [0.15, 0.45]}
links:
  - {name: lever, pins: [Q, T], m: 1, r: 0.3, I: 0.05}
  - {name: piston, pins: [C], along: [1, 0], m: 0.5, r: 0, I: 0.01}
ground: [Q, C]
slots: [{pin: C, on: lever, along: [1, 3]}]
"""
    mechanism = built(text)
    q = assemble(mechanism, [math.radians(80)], t=0.0)
    assert q[1] == pytest.approx(0.45 / math.tan(math.radians(80)) - 0.15, rel=1e-12)


SWINGING = """\
gravity: 9.81
pins: {O: [0, 0], A: [0.1, 0.02], B: [0.6, 0.25], G: [0.3, 0.15]}
links:
  - {name: crank, pins: [O, A], m: 0.5, r: 0.05, I: 0.001}
  - {name: rod, pins: [A, B], m: 1, r: 0.3, I: 0.03}
ground: [O, G]
slots: [{pin: G, on: rod, along: [2, 1]}]
"""


def test_a_slot_over_a_pin_of_the_ground() -> None:
    """A swinging block: by the right triangle of A, the slot and G, and by the centres' heights."""
    mechanism = built(SWINGING)
    A, B, G = 0.1 + 0.02j, 0.6 + 0.25j, 0.3 + 0.15j
    off = ((G - A) * (2 - 1j)).imag / math.sqrt(5)  # of the slot's line from A, as drawn
    own = cmath.phase(2 + 1j) - cmath.phase(B - A)

    def pose(theta: float) -> tuple[float, float]:
        way = G - cmath.rect(abs(A), theta)
        turn = cmath.phase(way / complex(math.sqrt(abs(way) ** 2 - off**2), off)) - own
        height = 0.5 * 0.05 * math.sin(theta) + abs(A) * math.sin(theta) + 0.3 * math.sin(turn)
        return turn - theta, 9.81 * height

    assert start_of(mechanism) == pytest.approx([cmath.phase(A), pose(cmath.phase(A))[0]])
    for theta in np.linspace(0.0, 6.0, 9):
        q = assemble(mechanism, [theta], t=0.0)
        assert np.exp(1j * q[1]) == pytest.approx(np.exp(1j * pose(theta)[0]), abs=1e-12)
        h = 1e-6
        slope = (pose(theta + h)[1] - pose(theta - h)[1]) / (2 * h)
        tau = robodyn.inverse_dynamics(mechanism, q, np.zeros(2), np.zeros(2))
        assert tau[0] == pytest.approx(slope, abs=1e-6)


def test_a_direction_along_a_link_has_no_rounding() -> None:
    """Slots and slides along a link: what is rounding would be terms of the equations."""
    for seed in range(20):
        rng = random.Random(seed)
        Q, B, A = (complex(rng.uniform(-9, 9), rng.uniform(-9, 9)) for _ in range(3))
        way, turn = B - Q, 1j * (B - Q)
        text = f"""\
pins: {{Q: [{Q.real}, {Q.imag}], B: [{B.real}, {B.imag}], A: [{A.real}, {A.imag}], O: [0, 0]}}
links:
  - {{name: lever, pins: [Q, B]}}
  - {{name: rod, pins: [B], along: [{way.real}, {way.imag}]}}
  - {{name: crank, pins: [O, A]}}
ground: [Q, O]
slots: [{{pin: A, on: lever, along: [{turn.real}, {turn.imag}]}}]
"""
        scene = built(text).description
        assert scene.links[1].axis == 1
        assert scene.closures[0].along == 1j


def test_a_pin_that_goes_along_with_a_link_further_down() -> None:
    text = """\
pins: {Q: [0, 0], C: [0.3, -0.2], B: [0.6, 0.18]}
links:
  - {name: boom, pins: [Q, B]}
  - {name: tube, pins: [C, B]}
  - {name: rod, pins: [C, B], along: [0.3, 0.38]}
ground: [Q, C]
"""
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "x.yaml")
    told = (
        "links[1] (tube).pins: begins with C, which goes along with rod, though the ground has it"
    )
    assert told in str(caught.value)


def test_a_slot_over_a_pin_that_nothing_has() -> None:
    text = SWINGING.replace("ground: [O, G]", "ground: [O]")
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "x.yaml")
    assert "must be a pin of a link, or of the ground" in str(caught.value)


def test_a_moment_of_inertia_about_the_own_joint() -> None:
    plain = "gravity: 9.81\nlinks:\n  - {name: a, m: 2, l: 1, r: [0.3, 0.4], I: 0.25}\n"
    own = built(plain.replace("I: 0.25", "J: 0.75"))
    assert own.description.links == built(plain).description.links
    point = built(plain.replace("[0.3, 0.4], I: 0.25", "0.7, J: 0.98"))
    assert point.description.links[0].I == 0.0  # not rounding


def test_equations_have_I_where_a_scene_has_J(robodyn: Run, tmp_path: Path) -> None:
    scene = tmp_path / "arm.yaml"
    scene.write_text("links:\n  - {name: a, m: 2, l: 1, r: [0.3, 0.4], J: 0.75}\n")
    told = robodyn("equations", scene).succeeds().out
    assert "M11 = m1 (r1x² + r1y²) + I1" in told
    assert "0.25" in told
    assert "J1" not in told


def test_faults_of_the_drawing_and_of_what_else_there_is_are_told_together() -> None:
    text = FOUR_BAR.replace("O4, B]", "O4, Z]").replace("stiffness: 400", "stiffness: -1")
    text = text.replace("m: 0.6", "m: much").replace("gravity", "gravty")
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "x.yaml")
    places = [fault.place for fault in caught.value.faults]
    assert places == [
        "gravty",
        "links[0] (crank).m",
        "links[2] (rocker).pins",
        "springs[0].stiffness",
    ]


# Welds


PARTS = {  # pins, mass, centre in the drawing, I
    "coupler": [("A, B", 1.3, 0.6 + 0.6j, 0.1)],
    "coupler arm": [("B, P", 0.5, 0.9 + 0.82j, 0.02)],
    "coupler tip": [("P, U", 0.2, 0.7 + 1.1j, 0.01)],
    "rocker": [("O4, B", 1.0, 1.08 + 0.3j, 0.06)],
    "rocker arm": [("O4, R", 0.5, 1.2 + 0.5j, 0.02)],
    "rocker ear": [("R, T", 0.1, 1.5 + 1.1j, 0.003)],
}


def mass_of(*names: str) -> str:
    """The mass, centre and moment of inertia of parts together."""
    parts = [PARTS[name][0][1:] for name in names]
    mass = sum(m for m, _, _ in parts)
    centre = sum(m * z for m, z, _ in parts) / mass
    about = sum(I + m * abs(z - centre) ** 2 for m, z, I in parts)
    return f"m: {mass!r}, centre: [{centre.real!r}, {centre.imag!r}], I: {about!r}"


def part(name: str, welded: bool = True) -> str:
    pins, *_ = PARTS[name][0]
    return f"  - {{name: {name}, pins: [{pins}], {mass_of(name)}{', joint: fixed' * welded}}}"


def welded_scenes() -> tuple[str, str]:
    """A scene whose links have parts that are welded, and the same whose links have all pins."""
    pins = """\
pins: {O2: [0, 0], A: [0.175, 0.303], B: [1.046, 0.798], O4: [1.1, 0], P: [0.62, 0.85],
  R: [1.4, 0.9], S: [1.9, 0.2], T: [1.6, 1.2], U: [0.9, 1.3], V: [0.7, 1.5]}"""
    rest = """\
  - {name: push, pins: [R, S], m: 0.4, r: 0.3, I: 0.01}
  - {name: lever, pins: [U, V], m: 0.2, r: 0.1, I: 0.004}
springs: [{between: [T, P], stiffness: 30, length: 0.2}]
loads: [{point: U, force: [2, -1]}, {point: T, force: [0, 3]}]
ground: [O2, O4, {pin: S, along: [1, 0]}]
actuated: [crank]"""
    crank = "  - {name: crank, pins: [O2, A], m: 0.6, r: 0.15, I: 0.008}"
    top = f"gravity: [0.3, -9.7]\n{pins}\nlinks:\n{crank}\n"
    coupler = ["coupler", "coupler arm", "coupler tip"]
    rocker = ["rocker", "rocker arm", "rocker ear"]
    one = [part(x, x not in ("coupler", "rocker")) for x in (*coupler, *rocker)]
    two = [f"  - {{name: coupler, pins: [A, B, P, U], {mass_of(*coupler)}}}"]
    two += [f"  - {{name: rocker, pins: [O4, B, R, T], {mass_of(*rocker)}}}"]
    return top + "\n".join([*one, rest]), top + "\n".join([*two, rest])


def test_welds_are_parts_of_the_link_above() -> None:
    one, two = map(built, welded_scenes())
    assert one.link_names == two.link_names == ("crank", "coupler", "rocker", "push", "lever")
    assert [weld.name for weld in one.description.welds] == [
        "coupler arm",
        "coupler tip",
        "rocker arm",
        "rocker ear",
    ]
    shift = start_of(two) - start_of(one)  # the zero of what hangs from a weld is its x axis
    for k in (0, 1, 2):
        assert shift[k] == 0.0
    for turned in (0.0, 0.4, -0.7):
        given = [start_of(one)[0] + turned, 0.3 + turned]
        q = assemble(with_independent(one), given, t=0.0)
        other, qd = q + shift, np.array([0.3, -1.2, 0.7, 0.5, -0.4])
        for function in (mass_matrix, gravity_vector):
            assert np.abs(function(one, q) - function(two, other)).max() < 2e-14
        assert np.abs(coriolis_matrix(one, q, qd) - coriolis_matrix(two, other, qd)).max() < 2e-14
        Psi = closure_jacobian(one, q, 0.0) - closure_jacobian(two, other, 0.0)
        assert np.abs(Psi).max() < 1e-14
        assert np.abs(closure_gap(one, start_of(one), 0.0)).max() < 1e-14
    for pin in "PTURB":
        places = (points(x, start_of(x), 0 * qd, 0 * qd, of=pin)[1] for x in (one, two))
        assert np.abs(next(places) - next(places)).max() < 1e-14


def test_what_a_weld_is_part_of() -> None:
    """The nearest link above that has its first pin; the ground if none has; a frame on a slide."""
    text = """\
pins: {O: [0, 0], A: [1, 0], B: [1, 1], C: [2, 1], D: [-1, 1], E: [2, 2], F: [-1, 0]}
links:
  - {name: bracket, pins: [O, D], joint: fixed}
  - {name: slide, pins: [A], along: [0, 1]}
  - {name: post, pins: [A, B], joint: fixed}
  - {name: arm, pins: [B, C]}
  - {name: hook, pins: [B, E], joint: fixed}
  - {name: pendulum, pins: [D, F]}
ground: [O, A]
"""
    scene = from_text(text, "drawn.yaml")
    assert [link.name for link in scene.links] == ["slide", "arm", "pendulum"]
    carried = {weld.name: weld.hangs_from.link for weld in scene.welds}
    assert carried == {"bracket": None, "post": 0, "hook": 1}
    assert scene.links[1].hangs_from.link == 3 + 1  # the post, the second of the welds
    mech = built(text)
    assert mech.parent == (None, 0, None)
    assert not scene.closures
    assert points(mech, [0.3, 0.0, 0.0], [1.0, 0, 0], [0.0] * 3, of="B")[1].tolist() == [[1.0, 1.3]]


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("joint: revolute", "links[1] (arm).joint: follows from the pins: leave it out"),
        ("joint: fixed, angle: 3", "links[1] (arm).angle: follows from the pins"),
        ("joint: fixed, along: [1, 0]", "links[1] (arm).along: is an unknown key"),
        ("joint: fixed, damping: 1", "links[1] (arm).damping: is an unknown key"),
        ("joint: fixed, pins: [B]", "links[1] (arm).pins: needs two pins"),
        ("joint: fixed, pins: [D, C]", "begins with D, which nothing holds"),
    ],
)
def test_what_a_weld_may_not_have(wrong: str, told: str) -> None:
    pins = "" if "pins" in wrong else "pins: [B, C], "
    text = f"""\
pins: {{O: [0, 0], B: [1, 1], C: [2, 1], D: [3, 1]}}
links:
  - {{name: crank, pins: [O, B]}}
  - {{name: arm, {pins}{wrong}}}
ground: [O]
"""
    with pytest.raises(DescriptionError) as error:
        from_text(text, "drawn.yaml")
    assert told in str(error.value)


def test_a_four_bar_all_in_line_has_no_branch() -> None:
    """Then Psi has rank 1, and the crank's own freedom is no reason."""
    text = text_of(
        {"O": 0j, "A": 1 + 1j, "B": 3 + 3j, "Q": 4 + 4j},
        {"crank": "O, A", "coupler": "A, B", "rocker": "Q, B"},
        "O, Q",
        "crank",
    )
    with pytest.raises(DescriptionError, match="coupler and rocker are drawn in line"):
        from_text(text, "drawn.yaml")
