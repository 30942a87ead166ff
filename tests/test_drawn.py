"""Scenes by the coordinates of their pins: the tree that they make, and where circles meet."""

from __future__ import annotations

import cmath
import math
import random
from itertools import pairwise

import numpy as np
import pytest

from robodyn.dynamics.closed_form import (
    closure_gap,
    closure_jacobian,
    coriolis_matrix,
    gravity_vector,
    mass_matrix,
)
from robodyn.dynamics.named_points import points
from robodyn.loops.assembly import assemble
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text


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
    """A crank or two, and dyads that hang from points of what is there, with random numbers."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.pins: dict[str, complex] = {}
        self.links: list[dict] = []
        self.ground: list[str] = []
        for _ in range(self.rng.randint(1, 2)):  # cranks
            self.add([self.on_ground(), self.new()])
        for _ in range(self.rng.randint(1, 4)):  # dyads
            first, second = self.there(), self.there(self.rng.random() < 0.5)
            if first == second or self.same_link(first, second):
                second = self.on_ground()
            meeting = self.new()
            self.add([first, meeting])
            self.add([second, meeting])
        for _ in range(2):  # points of one link, and a pendulum from one of them
            link = self.rng.choice(self.links)
            link["pins"].append(self.new())
        self.add([self.links[0]["pins"][1], self.new()])
        used = {name for link in self.links for name in link["pins"]}
        self.pins = {name: z for name, z in self.pins.items() if name in used}
        self.ground = [name for name in self.ground if name in used]

    def new(self) -> str:
        name = f"P{len(self.pins)}"
        self.pins[name] = complex(self.rng.uniform(-1, 1), self.rng.uniform(-1, 1))
        return name

    def on_ground(self) -> str:
        self.ground.append(self.new())
        return self.ground[-1]

    def there(self, ground: bool = False) -> str:
        """A pin that is there, or a new one of a link or the ground."""
        if ground:
            return self.on_ground()
        link = self.rng.choice(self.links)
        if self.rng.random() < 0.5:
            link["pins"].append(self.new())
        return self.rng.choice(link["pins"])

    def same_link(self, first: str, second: str) -> bool:
        on_ground = {first, second} <= set(self.ground)
        return on_ground or any({first, second} <= set(link["pins"]) for link in self.links)

    def add(self, pins: list[str]) -> None:
        x, y = (self.rng.uniform(-0.5, 0.5) for _ in range(2))
        numbers = {"m": self.rng.uniform(0.1, 2), "centre": (x, y), "I": self.rng.uniform(0.01, 1)}
        self.links.append({"name": f"link {len(self.links)}", "pins": pins, **numbers})

    def drawn(self) -> str:
        lines = ["gravity: 9.81", "pins:"]
        lines += [f"  {name}: [{z.real!r}, {z.imag!r}]" for name, z in self.pins.items()]
        lines += ["links:"]
        for link in self.links:
            centre = ", ".join(map(repr, link["centre"]))
            lines.append(
                f"  - {{name: {link['name']}, pins: [{', '.join(link['pins'])}], "
                f"m: {link['m']!r}, centre: [{centre}], I: {link['I']!r}}}"
            )
        return "\n".join([*lines, f"ground: [{', '.join(self.ground)}]"])

    def explicit(self) -> tuple[str, list[float]]:
        """The same in lengths and closures, by angles, and the angles of the joints."""
        lines, closures, angles = ["gravity: 9.81", "links:"], [], []
        directions: list[float] = []
        seen: dict[str, int] = {}

        def place(k: int, z: complex) -> str:
            apart = z - self.pins[self.links[k]["pins"][0]]
            far, angle = abs(apart), math.atan2(apart.imag, apart.real) - directions[k]
            at = f"[{far * math.cos(angle)!r}, {far * math.sin(angle)!r}]"
            return f"{{link: {self.links[k]['name']}, at: {at}}}"

        for k, link in enumerate(self.links):
            first, second, *_ = link["pins"]
            a, b = self.pins[first], self.pins[second]
            directions.append(math.atan2((b - a).imag, (b - a).real))
            above = None if first in self.ground else seen[first]
            z = f"[{a.real!r}, {a.imag!r}]" if above is None else place(above, a)
            q = directions[k] - (0.0 if above is None else directions[above])
            angles.append(math.remainder(q, 2 * math.pi))
            apart = complex(*link["centre"]) - a
            far, angle = abs(apart), math.atan2(apart.imag, apart.real) - directions[k]
            r = f"[{far * math.cos(angle)!r}, {far * math.sin(angle)!r}]"
            J = link["I"] + link["m"] * far * far
            lines.append(
                f"  - {{name: {link['name']}, m: {link['m']!r}, l: {abs(b - a)!r}, r: {r}, "
                f"J: {J!r}, from: {z}}}"
            )
            for name in link["pins"][1:]:
                c = self.pins[name]
                if name in self.ground:
                    closures.append(f"  - [{place(k, c)}, [{c.real!r}, {c.imag!r}]]")
                elif name in seen:
                    closures.append(f"  - [{place(seen[name], c)}, {place(k, c)}]")
            for name in link["pins"]:
                seen.setdefault(name, k)
        return "\n".join([*lines, *(["closures:"] if closures else []), *closures]), angles


@pytest.mark.parametrize("seed", range(100))
def test_a_random_linkage_is_the_same_in_both_forms(seed: int) -> None:
    linkage = Linkage(seed)
    text, angles = linkage.explicit()
    drawn, explicit = built(linkage.drawn()), built(text)
    q = start_of(drawn)
    assert np.abs(np.exp(1j * q) - np.exp(1j * np.array(angles))).max() < 1e-14
    assert np.abs(closure_gap(drawn, q)).max(initial=0.0) < 1e-14
    assert drawn.actuated == explicit.actuated
    qd = np.array([linkage.rng.uniform(-1, 1) for _ in q])
    for own, other in (
        (mass_matrix(drawn, q), mass_matrix(explicit, q)),
        (coriolis_matrix(drawn, q, qd), coriolis_matrix(explicit, q, qd)),
        (gravity_vector(drawn, q), gravity_vector(explicit, q)),
        (closure_jacobian(drawn, q), closure_jacobian(explicit, q)),
    ):
        assert own.shape == other.shape
        assert np.abs(own - other).max(initial=0.0) <= 1e-14 * max(1.0, np.abs(own).max(initial=0))


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
    assert np.abs(closure_gap(mechanism, q0)).max() < 1e-14 * max(map(abs, drawn.pins.values()))
    q = assemble(mechanism, q0[0] + turns[:, None])
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
    q = assemble(mechanism, start_of(mechanism)[0] + turns[:, None])
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
    assert np.abs(closure_gap(mechanism, start_of(mechanism))).max() < 1e-15


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
    assert np.abs(closure_gap(mechanism, q0)).max() < 1e-15
    for turn in (-0.3, -0.1, 0.2):
        q = assemble(mechanism, [q0[0] + turn])
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
    assert np.abs(closure_gap(mechanism, q0)).max() < 1e-15
    driven = q0[list(mechanism.actuated)] + [0.15, -0.1, 0.05]
    q = assemble(mechanism, driven)
    names = [f"tip{mechanism.link_names.index(f'arm {k}') + 1}" for k in range(3)]
    names += [f"B{k}=tip{mechanism.link_names.index(f'rod {k}') + 1}" for k in range(3)]
    *arms, B0, B1, B2 = points(mechanism, q, of=names).position @ [1, 1j]
    for k, (arm, B) in enumerate(zip(arms, (B0, B1, B2), strict=True)):
        assert abs(abs(B - arm) - abs(pins[f"B{k}"] - pins[f"A{k}"])) < 1e-12
    for first, second in pairwise((B0, B1, B2, B0)):
        assert abs(abs(first - second) - 0.1 * math.sqrt(3)) < 1e-12
    assert ((B1 - B0).conjugate() * (B2 - B0)).imag > 0.0
