"""PMKS+ texts, written by an encoder of these tests, become scenes as drawn."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from conftest import Outcome

from robodyn.dynamics.closed_form import kinetic_energy
from robodyn.errors import InputError
from robodyn.export.pmks import scene_from, text_from
from robodyn.loops.assembly import assemble
from robodyn.loops.closures import closure_gap
from robodyn.loops.loop_rates import loop_velocities
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text

Run = Callable[..., Outcome]
LETTERS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_-"


def base64(value: int) -> str:
    """An integer in digits of base 64, most significant first, 0 before a negative one."""
    digits, rest = "", abs(value)
    while rest or not digits:
        rest, digit = divmod(rest, 64)
        digits = LETTERS[digit] + digits
    return "0" * (value < 0) + digits


def thousandths(value: float) -> str:
    return base64(round(value * 1000))


@dataclass
class Linkage:
    """A mechanism in the units of PMKS+, as its user sees it."""

    joints: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    forces: list[str] = field(default_factory=list)
    flags: int = 0b00000011  # clockwise, gravity
    units: str = "2012"  # m, degrees, N, SI
    ending: tuple[str, ...] = ("N",)

    def joint(self, name: str, z: complex, kinds: str = "", angle: float = 0.0, more="") -> None:
        """A joint; the kinds are slides, input, grounded, welded, curve, sealed by first letter."""
        bits = sum(1 << k for k, letter in enumerate("sigwcS") if letter in kinds)
        x, y, way = map(thousandths, (z.real, z.imag, angle))
        self.joints.append(f"{LETTERS[bits]}{name},{name},{x},{y},{way}{more}")

    def link(
        self, joints: str, centre: complex, mass=1.0, inertia=1.0, kind="YR", parts=""
    ) -> None:
        """A link of joints of one letter, which are its name."""
        numbers = ",".join(map(thousandths, (mass, inertia, centre.real, centre.imag)))
        ids = ",".join(joints)
        self.links.append(f"{kind}{joints},{joints},{numbers},c5cae9,{ids},,{parts}")

    def force(self, name: str, link: str, begin: complex, end: complex, size: float, local=False):
        numbers = ",".join(map(thousandths, (begin.real, begin.imag, end.real, end.imag, size)))
        self.forces.append(f"{2 + local}{name},{link},{name},{numbers}")

    @property
    def text(self) -> str:
        flags = "0" * (self.flags < 64) + base64(self.flags)
        parts = [flags, thousandths(1.9), f"{base64(20)},{base64(0)}", self.units]
        for section in (self.joints, self.links, self.forces):
            parts.append("".join(f"{record}." for record in section))
        whole = ".".join([*parts, *self.ending])
        return whole + LETTERS[len(whole) % 62]


def made(mechanism: Linkage) -> Mechanism:
    text, notes = scene_from(mechanism.text)
    assert notes == []
    return build(from_text(text, "pmks.yaml"))


def four_bar() -> Linkage:
    found = Linkage()
    found.joint("A", 0j, "ig")
    found.joint("B", 0.5 + 1j)
    found.joint("C", 3 + 2.2j, "c")
    found.joint("D", 3.5 - 0.25j, "g")
    found.joint("E", 1.6 + 2.5j, "c")
    found.link("AB", 0.2 + 0.5j, 1.5, 0.3)
    found.link("BCE", 1.7 + 1.9j, 2.5, 0.7)
    found.link("CD", 3.2 + 1j, 1.25, 0.4)
    return found


@pytest.mark.parametrize("value", [0, 1, -1, 63, 64, -64, 4095, 123456789, -987654321])
def test_integers(value: int) -> None:
    from robodyn.export.pmks import _integer

    assert _integer(base64(value)) == value


def test_a_four_bar_with_a_tracer_point() -> None:
    mechanism = made(four_bar())
    scene = mechanism.description
    assert scene.gravity == -9.81j
    assert [link.name for link in scene.links] == ["AB", "BCE", "CD"]
    assert [link.m for link in scene.links] == [1.5, 2.5, 1.25]
    assert [link.I for link in scene.links] == [0.3, 0.7, 0.4]
    assert mechanism.actuated == (0,)
    assert scene.links[0].l == abs(0.5 + 1j)
    assert scene.links[2].hangs_from.at == 3.5 - 0.25j
    ((name, point),) = scene.points
    assert (name, point.link) == ("E", 1)
    q = np.array(scene.start, float)
    assert np.abs(closure_gap(mechanism, q, t=0.0)).max() < 1e-15
    assert np.abs(assemble(mechanism, q[:1], t=0.0) - q).max() < 1e-12


@pytest.mark.parametrize(
    ("units", "metre", "kilogram", "moment"),
    [
        ("2012", 1.0, 1.0, 1.0),
        ("1011", 0.01, 0.001, 0.0001),
        ("101", 0.01, 0.001, 0.0001),  # older, without the last
        ("0000", 0.0254, 0.45359237, 0.45359237 * 0.0254**2),
    ],
)
def test_units(units: str, metre: float, kilogram: float, moment: float) -> None:
    plain, other = four_bar(), four_bar()
    other.units = units
    other.flags = 1
    scene, base = made(other).description, made(plain).description
    assert scene.gravity == 0.0
    for link, own in zip(scene.links, base.links, strict=True):
        assert link.l == pytest.approx(metre * own.l, rel=1e-14)
        assert link.m == pytest.approx(kilogram * own.m, rel=1e-14)
        assert pytest.approx(moment * own.I, rel=1e-12) == link.I
        assert link.r == pytest.approx(metre * own.r, rel=1e-12)


def test_forces_become_loads() -> None:
    mechanism = four_bar()
    mechanism.force("F1", "BCE", 1 + 1.5j, 1 + 2.5j, 10)
    mechanism.force("F2", "CD", 3.2 + 1j, 4.2 + 1j, 3, local=True)
    found = made(mechanism)
    q = np.array(found.description.start, float)
    still, turning = found.description.loads
    assert still.force == pytest.approx(10j, abs=1e-14)
    assert (still.turns, turning.turns) == (False, True)
    ways = [cmath.exp(1j * (q[0] + q[1])), cmath.exp(1j * q[2])]
    assert turning.force * ways[1] == pytest.approx(3.0, abs=1e-14)
    origins = [0.5 + 1j, 3.5 - 0.25j]
    for load, origin, way, place in zip(
        (still, turning), origins, ways, (1 + 1.5j, 3.2 + 1j), strict=True
    ):
        assert origin + load.point.at * way == pytest.approx(place, abs=1e-14)
    mechanism.units = "0000"
    pounds = made(mechanism).description.loads[0]
    assert pounds.force == pytest.approx(44.482216152605j, abs=1e-12)


def slider_crank(crank: str, slide: str, mass: float, angle: float = 0.0) -> Linkage:
    """A piston of this mass, and the kinds of the joints of the crank and of the slide."""
    mechanism = Linkage()
    mechanism.joint("A", 0j, crank)
    mechanism.joint("B", 0.5 + 1j)
    mechanism.joint("C", 3 + 0.2j)
    mechanism.joint("D", 3 + 0.2j, slide, angle)
    mechanism.link("AB", 0.2 + 0.5j)
    mechanism.link("BC", 1.7 + 0.6j)
    mechanism.link("CD", 0j, mass, 0.0, "YP")
    return mechanism


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2])
def test_a_piston(angle: float) -> None:
    found = made(slider_crank("ig", "sg", 0.75, angle))
    piston = found.description.links[2]
    assert (piston.slides, piston.m, piston.I) == (True, 0.75, 0.0)
    assert piston.axis == pytest.approx(cmath.exp(1j * angle), abs=1e-3)  # three decimals
    assert abs(abs(piston.axis or 0) - 1) < 1e-15
    q = assemble(found, [found.description.start[0] + 0.3], t=0.0)  # type: ignore[index]
    B = abs(0.5 + 1j) * cmath.exp(1j * q[0])
    C = 3 + 0.2j + q[2] * (piston.axis or 0)
    assert abs(C - B) == pytest.approx(abs(2.5 - 0.8j), rel=1e-12)


def test_a_block_without_mass_is_a_line_of_the_ground() -> None:
    found = made(slider_crank("ig", "sg", 0.0))
    assert found.link_names == ("AB", "BC")
    (closure,) = found.description.closures
    assert (closure.along, closure.second.at) == (1.0, 3 + 0.2j)


def test_a_driven_piston() -> None:
    found = made(slider_crank("g", "sgi", 0.75))
    assert [found.link_names[k] for k in found.actuated] == ["CD"]


def test_a_rod_that_is_welded_to_its_block() -> None:
    """A Scotch yoke: the yoke slides and does not turn; a pin of the crank is in its slot."""
    mechanism = Linkage()
    mechanism.joint("A", 0j, "ig")
    mechanism.joint("B", 0.5 + 0.5j)
    mechanism.joint("C", 0.5 - 1j)
    mechanism.joint("E", 0.5 + 1j)
    mechanism.joint("F", 2 + 0j, "w")
    mechanism.joint("G", 2 + 0j, "sg")
    mechanism.joint("H", 0.5 + 0.5j, "s", more=",CEF,C,E")
    mechanism.link("AB", 0.2 + 0.2j, 1.0, 0.5)
    mechanism.link("CEF", 1 + 0j, 3.0, 0.25)
    mechanism.link("FG", 0j, 0.5, 0.0, "YP")
    mechanism.link("BH", 0j, 0.125, 0.0, "YP")
    found = made(mechanism)
    yoke = found.description.links[found.link_names.index("CEF")]
    assert yoke.slides
    assert yoke.m == 3.5
    assert yoke.r.real == pytest.approx((3.0 * 1 + 0.5 * 2) / 3.5 - 2)
    q0 = np.array(found.description.start, float)
    assert np.abs(closure_gap(found, q0, t=0.0)).max() < 1e-15
    turn = q0[0] + 0.4
    q = assemble(found, [turn], t=0.0)
    moved = abs(0.5 + 0.5j) * math.cos(turn) - 0.5
    slide = found.link_names.index("CEF")
    assert q[slide] == pytest.approx(moved, rel=1e-12)
    # the block is a mass at the crank's pin, the yoke has its own and its block's
    qd = loop_velocities(found, q, [1.0], t=0.0)
    speed = abs(0.5 + 0.5j) * math.sin(turn)
    crank = 0.5 + 1.0 * abs(0.2 + 0.2j) ** 2 + 0.125 * abs(0.5 + 0.5j) ** 2
    assert kinetic_energy(found, q, qd) == pytest.approx(0.5 * crank + 0.5 * 3.5 * speed**2)


def test_a_cylinder() -> None:
    """A barrel, and a rod that slides in it, which is the input."""
    mechanism = Linkage()
    way = cmath.exp(0.6j)
    D = round(2.5 * way.real, 3) + 1j * round(2.5 * way.imag, 3)
    mechanism.joint("A", 0j, "g")
    mechanism.joint("B", 1.2 * way)
    mechanism.joint("C", 1.0 * way, "w")
    mechanism.joint("D", D)
    mechanism.joint("E", 3 + 0j, "g")
    mechanism.joint("P", 1.0 * way, "siS", more=",AB,A,B")
    mechanism.link("AB", 0.5 * way, 1.5)
    mechanism.link("CD", 1.7 * way, 0.5)
    mechanism.link("DE", 2.7 + 0.7j, 2.0)
    mechanism.link("CP", 0j, 0.0, 0.0, "YP")
    found = made(mechanism)
    rod = found.link_names.index("CD")
    barrel = found.link_names.index("AB")
    assert found.actuated == (rod,)
    assert found.description.links[rod].hangs_from.link == barrel
    q = assemble(found, [0.2], t=0.0)
    far = abs(3 - D)  # of the lever
    longer = abs(D) + 0.2
    cosine = (9 + longer**2 - far**2) / (6 * longer)
    q0 = np.array(found.description.start, float)
    assert np.abs(closure_gap(found, q0, t=0.0)).max() < 1e-14
    # the barrel points along B, which three decimals leave a little off D
    assert abs(q[barrel]) == pytest.approx(math.acos(cosine), abs=2e-3)


def test_welded_links() -> None:
    """As one link of parts, or apart: the same body."""
    whole, apart = Linkage(), Linkage()
    for each in (whole, apart):
        each.joint("A", 0j, "ig")
        each.joint("B", 1 + 0j, "w")
        each.joint("C", 2 + 1j)
        each.joint("D", 2 - 1j)
    AB, BC, mass, moments = 0.5 + 0j, 1.5 + 0.5j, (2.0, 1.0), (3.0, 4.0)
    centre = (mass[0] * AB + mass[1] * BC) / 3.0
    inertia = sum(moments) + mass[0] * abs(AB - centre) ** 2 + mass[1] * abs(BC - centre) ** 2
    whole.link("ABC", centre, 3.0, inertia, parts="AB,BC")
    for each, kind in ((whole, "NR"), (apart, "YR")):
        each.link("AB", AB, mass[0], moments[0], kind)
        each.link("BC", BC, mass[1], moments[1], kind)
        each.link("CD", 2 + 0j)
        each.force("F1", "BC", 1.5 + 0.5j, 2.5 + 0.5j, 10)  # on a part
    one, other = made(whole), made(apart)
    assert one.n == other.n == 2
    assert one.description.links[0].m == other.description.links[0].m == 3.0
    assert one.description.links[0].r == pytest.approx(other.description.links[0].r, abs=1e-3)
    assert pytest.approx(inertia, rel=1e-12) == other.description.links[0].I
    assert [load.point.link for load in one.description.loads] == [0]  # type: ignore[union-attr]
    assert [load.point.link for load in other.description.loads] == [0]  # type: ignore[union-attr]


def test_an_input_between_two_links() -> None:
    mechanism = four_bar()
    mechanism.joints[0] = mechanism.joints[0].replace(LETTERS[0b110], LETTERS[0b100], 1)
    mechanism.joints[1] = LETTERS[0b10] + mechanism.joints[1][1:]
    found = made(mechanism)
    assert [found.link_names[k] for k in found.actuated] == ["BCE"]


def test_a_disc_of_one_pin() -> None:
    mechanism = four_bar()
    mechanism.link("E", 1.6 + 2.5j, 0.5, 0.01, "0R")
    found = made(mechanism)
    disc = found.description.links[3]
    assert (disc.name, disc.r, disc.l, disc.hangs_from.link) == ("E", 0j, 1.0, 1)


def test_random_chains_of_dyads() -> None:
    for seed in range(40):
        rng = random.Random(seed)
        mechanism = Linkage()
        mechanism.units = rng.choice(["1011", "2012", "0000"])
        there = ["A", "B"]
        z = {"A": 0j, "B": complex(rng.uniform(1, 3), rng.uniform(1, 3))}
        mechanism.joint("A", 0j, "ig")
        mechanism.joint("B", z["B"])
        mechanism.link("AB", z["B"] / 2)
        for k in range(rng.randint(1, 4)):
            P, Q = LETTERS[12 + 2 * k], LETTERS[13 + 2 * k]  # C, D, ..
            first = rng.choice(there[1:])
            z |= {x: complex(rng.uniform(-9, 9), rng.uniform(-9, 9)) for x in (P, Q)}
            mechanism.joint(P, z[P])
            mechanism.joint(Q, z[Q], "g")
            mechanism.link(first + P, z[P], rng.uniform(0.1, 2), rng.uniform(0.1, 2))
            mechanism.link(P + Q, z[Q], rng.uniform(0.1, 2), rng.uniform(0.1, 2))
            there.append(P)
        found = made(mechanism)
        metre = {"1011": 0.01, "2012": 1.0, "0000": 0.0254}[mechanism.units]
        assert found.actuated == (0,)
        q0 = np.array(found.description.start, float)
        assert np.abs(closure_gap(found, q0, t=0.0)).max() < 1e-13
        assert np.abs(assemble(found, q0[:1], t=0.0) - q0).max() < 1e-6
        for link in found.description.links:
            first, second = link.name
            length = abs(z[first] - z[second])
            assert link.l == pytest.approx(metre * length, abs=1e-3 * metre * 1.5)


# Older texts, newer ones, and what is none


def test_the_oldest_texts() -> None:
    """Without names, parts and a check; they end at a point."""
    text = "P.TY.K,0.101.6A,0,0,0.0B,fk,1Jz,0.0C,2o7,1sD,0.4D,3Qm,0,0.."
    text += "RAB,Fe,Fe,Kt,f-,A,B.RBC,Fe,Fe,1jw,1b5,B,C.RCD,Fe,Fe,36S,x7,C,D.."
    found = build(from_text(scene_from(text)[0], "x"))
    assert found.link_names == ("AB", "BC", "CD")
    assert found.actuated == (0,)
    forced = scene_from(text + "1F1,BC,1AR,1SH,1AR,JF,Fe.")[0]
    assert len(from_text(forced, "x").loads) == 1


def test_a_text_without_what_is_selected() -> None:
    mechanism = four_bar()
    mechanism.ending = ()
    assert made(mechanism).n == 3


def test_what_is_not_known_is_named() -> None:
    mechanism = four_bar()
    mechanism.ending = ("JA", "LAB,CJAB~A,KJA~red,XAB")
    text, notes = scene_from(mechanism.text)
    assert notes == ["the entry XAB"]
    assert "# Left out: the entry XAB." in text
    mechanism.ending = ("JA", "LAB", "more")
    assert scene_from(mechanism.text)[1] == ["the part more"]
    mechanism = four_bar()
    mechanism.joints[1] += ",,,,5,new"
    assert scene_from(mechanism.text)[1] == ["part new of joint B"]


def refused(mechanism: Linkage, words: str) -> None:
    with pytest.raises(InputError, match=words):
        made(mechanism)


def test_what_is_refused() -> None:
    mechanism = four_bar()
    with pytest.raises(InputError, match="a part of it is missing"):
        scene_from(mechanism.text[:40] + mechanism.text[41:])
    mechanism.links[0] = "Z" + mechanism.links[0][1:]
    refused(mechanism, "is of a kind that is not known")
    mechanism = four_bar()
    mechanism.links[0] = mechanism.links[0].replace(",A,B,", ",A,X,")
    refused(mechanism, "has joints that are not there")
    mechanism = four_bar()
    mechanism.joints.append(mechanism.joints[0])
    refused(mechanism, "two joints of one name")
    mechanism = four_bar()
    mechanism.joint("F", 9 + 9j)
    mechanism.joint("G", 8 + 9j)
    mechanism.link("FG", 9 + 9j)
    refused(mechanism, "links FG = .*|hang on nothing")
    mechanism = four_bar()
    mechanism.links *= 200
    refused(mechanism, "has 600 links; scenes are made of up to 500")
    mechanism = four_bar()
    mechanism.joints[1] = mechanism.joints[1].replace(thousandths(0.5), "1" * 5000)
    refused(mechanism, "has too long a number")
    mechanism = four_bar()
    mechanism.units = "9011"
    refused(mechanism, "has a unit that is not known")
    mechanism = four_bar()
    mechanism.joint("P", 0.5 + 1j, "si", more=",CD,C,D")
    mechanism.link("BP", 0j, 0.5, 0.0, "YP")
    refused(mechanism, "drives a block in a slot of CD")


def test_where_a_text_is_found(tmp_path: Path) -> None:
    text = four_bar().text
    for given in (text, f"https://app.pmksplus.com/?{text}", f"?{text}#x", f'"{text}"'):
        assert text_from(given) == text
    quoted = text.replace(",", "%2C")
    assert text_from(f"https://app.pmksplus.com/?{quoted}") == text
    path = tmp_path / "mine.txt"
    path.write_text(f"My linkage:\n  <https://app.pmksplus.com/?{text}>\nends here.\n")
    assert text_from(str(path)) == text
    for given in ("", "https://example.org", "?j=1,2&l=3", "\x00", "a" * 5000):
        with pytest.raises(InputError, match="is no address of a PMKS"):
            text_from(given)


def test_the_command_writes_a_scene(robodyn: Run, tmp_path: Path) -> None:
    out = tmp_path / "mine.yaml"
    address = f"https://app.pmksplus.com/?{four_bar().text}"
    told = robodyn("init", "--from-pmks", address, "-o", out)
    assert (told.code, told.out) == (0, "")
    assert robodyn("torque", out, "--qd", "1").succeeds().rows
    assert robodyn("init", "--from-pmks", address, "-o", "-").out == out.read_text()
    robodyn("init", "--from-pmks", address, "-o", out).fails(2, "exists already")
    robodyn("init", "four-bar", "--from-pmks", address).fails(2, "--from-pmks", "goes without NAME")
