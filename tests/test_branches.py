"""Which way loops close: by words in the order of closures, by a start, against own circles."""

from __future__ import annotations

import cmath
import json
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH

import robodyn as api
from random_mechanisms import mechanism
from robodyn.loops.branches import all_branches, scene_branches, scene_start
from robodyn.loops.circuits import leads_there

THREE = """\
links:
  - {name: a, m: 1, l: 1, r: 0.5, I: 1}
  - {name: b1, m: 1, l: 2.3, r: 1, I: 1}
  - {name: c1, m: 1, l: 1.7, r: 1, I: 1, from: [2, 0]}
  - {name: b2, m: 1, l: 3.2, r: 1, I: 1, from: c1}
  - {name: c2, m: 1, l: 3.2, r: 1, I: 1, from: [4, 0]}
  - {name: b3, m: 1, l: 2.4, r: 1, I: 1, from: c2}
  - {name: c3, m: 1, l: 2.4, r: 1, I: 1, from: [6, 0]}
closures: [[b1, c1], [b2, c2], [b3, c3]]
start: {a: 1, b1: -2.3515, c1: -2.1704, b2: 1.5797, c2: -1.6652, b3: -3.0614, c3: -2.8079}
"""
# the second closure is solved first: its dyad hangs from the crank
IN_REVERSE = """\
links:
  - {name: crank, m: 1, l: 0.35, r: 0.1, I: 0.1}
  - {name: coupler, m: 1, l: 0.95, r: 0.4, I: 0.1}
  - {name: rocker, m: 1, l: 0.8, r: 0.3, I: 0.1, from: [1.1, 0]}
  - {name: rod, m: 1, l: 0.9, r: 0.4, I: 0.1, from: rocker}
  - {name: output, m: 1, l: 0.8, r: 0.3, I: 0.1, from: [2.2, 0]}
closures: [[rod, output], [coupler, rocker]]
actuated: [crank]
"""


def row(
    rng: np.random.Generator,
    count: int,
    lengths: tuple[float, float] = (0.8, 3.5),
    digits: int = 1,
) -> tuple[str, list[float], list[int]] | None:
    """A crank and `count` dyads, a pose by circles of its own, and the side each pin lies on."""
    angle = rng.uniform(-math.pi, math.pi)
    tip, turn = cmath.rect(1.0, angle), angle
    links, closures = ["  - {name: a, m: 1, l: 1, r: 0.5, I: 1}"], []
    q, above, sides = [angle], "a", []
    for i in range(1, count + 1):
        ground, b, c = complex(2 * i, 0), *np.round(rng.uniform(*lengths, 2), digits).tolist()
        way = ground - tip
        d = abs(way)
        along = (d * d + b * b - c * c) / (2 * d)
        height = b * b - along * along
        if height < 0.02 * b * c:
            return None
        side = int(rng.choice([-1, 1]))
        pin = tip + way / d * complex(along, side * math.sqrt(height))
        up, down = cmath.phase(pin - tip), cmath.phase(pin - ground)
        q += [math.remainder(up - turn, math.tau), down]
        links.append(f"  - {{name: b{i}, m: 1, l: {b}, r: 1, I: 1, from: {above}}}")
        links.append(f"  - {{name: c{i}, m: 1, l: {c}, r: 1, I: 1, from: [{2 * i}, 0]}}")
        closures.append(f"[b{i}, c{i}]")
        above, tip, turn = f"c{i}", pin, down
        sides.append(side)
    text = "links:\n" + "\n".join(links) + f"\nclosures: [{', '.join(closures)}]\n"
    return text, q, sides


def rows(seed: int, count: int) -> list[tuple[str, list[float], list[int]]]:
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        if (each := row(rng, int(rng.integers(1, 6)))) is not None:
            found.append(each)
    return found


def names(count: int) -> list[str]:
    return ["a", *(f"{x}{i}" for i in range(1, count + 1) for x in "bc")]


@pytest.mark.parametrize("seed", range(20 if FRESH else 2))
def test_a_start_of_all_joints_is_the_pose_that_was_meant(seed: int) -> None:
    for text, q, sides in rows(FIRST_SEED + seed, 100):
        angles = {name: round(x, 4) for name, x in zip(names(len(sides)), q, strict=True)}
        start = ", ".join(f"{name}: {x}" for name, x in angles.items())
        mech = mechanism(f"{text}start: {{{start}}}\n")
        found = api.assemble(mech, [q[0]])
        assert np.abs(np.remainder(found - q + np.pi, 2 * np.pi) - np.pi).max() < 1e-9, text
        assert scene_branches(mech) == tuple("open" if x > 0 else "crossed" for x in sides)


def test_words_are_those_of_the_pins() -> None:
    for text, q, sides in rows(5, 100):
        words = ["open" if x > 0 else "crossed" for x in sides]
        mech = mechanism(f"{text}assembly: [{', '.join(words)}]\n")
        found = api.assemble(mech, [q[0]])
        assert np.abs(np.remainder(found - q + np.pi, 2 * np.pi) - np.pi).max() < 1e-9


def test_three_dyads_with_a_start() -> None:
    mech = mechanism(THREE)
    q = api.assemble(mech, [1.0])
    qd = api.loop_velocities(mech, q, [1.0])
    qdd = api.loop_accelerations(mech, q, qd, [0.0])
    assert abs(api.inverse_dynamics(mech, q, qd, qdd)[0] + 4.640055364697353) < 1e-9


def test_words_stand_in_the_order_of_the_closures(robodyn, tmp_path: Path) -> None:
    """Each row that `assemble` prints is the pose of its words, copied back."""
    file = tmp_path / "six.yaml"
    file.write_text(IN_REVERSE + "assembly: [crossed, open]\n", encoding="utf-8")
    shown = robodyn("assemble", str(file), "--q", "60deg").out.split("\n")
    assert shown[1].startswith("crossed open,")
    lines = [line.split(",") for line in shown[1:] if line]
    assert len(lines) == len({line[0] for line in lines}) > 1
    for words, *values in lines:
        one, two = words.split()
        file.write_text(IN_REVERSE + f"assembly: [{one}, {two}]\n", encoding="utf-8")
        again = robodyn("assemble", str(file), "--q", "60deg").out.split("\n")[1].split(",")
        assert again == [words, *values]


def test_branches_of_a_scene_are_each_told_once() -> None:
    mech = mechanism(IN_REVERSE)
    assert [*all_branches(mech)] == [
        ("open", "open"),
        ("open", "crossed"),
        ("crossed", "open"),
        ("crossed", "crossed"),
    ]


# -- loops that are no dyads, with dyads before and behind them ------------------------------------

PLATE = """\
links:
  - {name: crank, m: 1, l: 0.1, r: 0.05, I: 0.01}
  - {name: coupler, m: 1, l: 0.3, r: 0.15, I: 0.01}
  - {name: rocker, m: 1, l: 0.25, r: 0.1, I: 0.01, from: [0.3, 0]}
  - {name: leg1, m: 1, l: 0.6, r: 0.3, I: 0.01, from: {link: coupler, at: [0.15, 0]}}
  - {name: plate, m: 1, l: 0.3, r: 0.15, I: 0.01}
  - {name: leg2, m: 1, l: 0.6, r: 0.3, I: 0.01, from: {link: rocker, at: [0.1, 0]}}
  - {name: leg3, m: 1, l: 0.6, r: 0.3, I: 0.01, from: [0.6, 0]}
closures:
  - [coupler, rocker]
  - [leg2, {link: plate, at: [0.15, 0.1]}]
  - [leg3, plate]
start: {crank: 60deg, coupler: -27deg, rocker: 98deg, leg1: 60deg, plate: -90deg, leg2: -10deg,
  leg3: 90deg}
"""


def meet(
    a: complex, ra: float, d: complex, rd: float, side: int, least: float = 0.02
) -> complex | None:
    """Where circles about a and d meet: to the left of the line from a to d for +1."""
    way = d - a
    far = abs(way)
    along = (far * far + ra * ra - rd * rd) / (2 * far)
    height = ra * ra - along * along
    if height < least * ra * rd:
        return None
    return a + way / far * complex(along, side * math.sqrt(height))


def plates(seed: int, count: int) -> list[tuple[str, dict[str, float], list[int]]]:
    """A plate on three legs on a four-bar, and a dyad on the plate: scenes, poses, sides."""
    rng, found = np.random.default_rng(seed), []

    def phase(tip: complex, base: complex) -> float:
        return cmath.phase(tip - base)

    while len(found) < count:
        crank, b, c = rng.uniform([0.1, 0.3, 0.25], [0.2, 0.45, 0.4]).round(2).tolist()
        theta, turn, leg, on = rng.uniform(-math.pi, math.pi, 4)
        sides = [int(x) for x in rng.choice([-1, 1], 2)]
        A = cmath.rect(crank, theta)
        P = meet(A, b, 0.4 + 0j, c, sides[0])
        if P is None:
            continue
        coupler, rocker = phase(P, A), phase(P, 0.4)
        foot1 = A + cmath.rect(0.15, coupler)
        foot2 = 0.4 + cmath.rect(0.1, rocker)
        foot3 = complex(*rng.uniform(-0.8, 0.8, 2).round(2))
        plate = foot1 + cmath.rect(0.5, leg)
        end = cmath.rect(1.0, on)
        pin2, pin3, hang = plate + (0.15 + 0.1j) * end, plate + 0.3 * end, plate + 0.12j * end
        foot4 = hang + cmath.rect(0.6, turn)
        Q = meet(hang, 0.4, foot4, 0.5, sides[1])
        assert Q is not None
        # the three legs must hold the plate: their lines may not meet in one point
        lines = [(pin2, pin2 - foot2), (pin3, pin3 - foot3), (plate, plate - foot1)]
        units = [(p, w / abs(w)) for p, w in lines]
        rows = [[u.real, u.imag, (p.conjugate() * u).imag / 0.3] for p, u in units]
        if abs(np.linalg.det(rows)) < 0.3:
            continue
        q = {
            "crank": theta,
            "coupler": coupler - theta,
            "rocker": rocker,
            "leg1": leg - coupler,
            "plate": on - leg,
            "leg2": phase(pin2, foot2) - rocker,
            "leg3": phase(pin3, foot3),
            "rod": phase(Q, hang) - on,
            "lever": phase(Q, foot4),
        }
        mass = "m: 1, r: 0.1, I: 0.01"
        text = f"""\
links:
  - {{name: crank, l: {crank}, {mass}}}
  - {{name: coupler, l: {b}, {mass}}}
  - {{name: rocker, l: {c}, {mass}, from: [0.4, 0]}}
  - {{name: leg1, l: 0.5, {mass}, from: {{link: coupler, at: [0.15, 0]}}}}
  - {{name: plate, l: 0.3, {mass}}}
  - {{name: leg2, l: {abs(pin2 - foot2)!r}, {mass}, from: {{link: rocker, at: [0.1, 0]}}}}
  - {{name: leg3, l: {abs(pin3 - foot3)!r}, {mass}, from: [{foot3.real!r}, {foot3.imag!r}]}}
  - {{name: rod, l: 0.4, {mass}, from: {{link: plate, at: [0, 0.12]}}}}
  - {{name: lever, l: 0.5, {mass}, from: [{foot4.real!r}, {foot4.imag!r}]}}
closures:
  - [leg3, plate]
  - [rod, lever]
  - [leg2, {{link: plate, at: [0.15, 0.1]}}]
  - [coupler, rocker]
"""
        found.append((text, q, sides))
    return found


def started(text: str, q: dict[str, float], digits: int = 4) -> str:
    angles = ", ".join(f"{name}: {round(x, digits)}" for name, x in q.items())
    return f"{text}start: {{{angles}}}\n"


def off_by(found: np.ndarray, q: dict[str, float]) -> float:
    way = found - np.array([*q.values()])
    return float(np.abs(np.remainder(way + np.pi, 2 * np.pi) - np.pi).max())


WORDS = {1: "open", -1: "crossed"}


@pytest.mark.parametrize("seed", range(10 if FRESH else 1))
def test_a_start_decides_dyads_before_and_behind_other_loops(seed: int) -> None:
    for text, q, (before, behind) in plates(FIRST_SEED + seed, 40):
        mech = mechanism(started(text, q))
        assert off_by(api.assemble(mech, [q["crank"]]), q) < 1e-7, text
        words = scene_branches(mech)
        assert (words[3], words[1]) == (WORDS[before], WORDS[behind])


def test_words_decide_dyads_before_and_behind_other_loops() -> None:
    """Their words go before the start, in full or for those alone that have two ways."""
    for text, q, (before, behind) in plates(3, 20):
        start = started(text, q | {"rod": q["rod"] + 2.0, "lever": q["lever"] - 2.0})
        full = ["open", WORDS[behind], "open", WORDS[before]]
        for words in (full, [WORDS[behind], WORDS[before]]):
            mech = mechanism(f"{start}assembly: [{', '.join(words)}]\n")
            assert off_by(api.assemble(mech, [q["crank"]]), q) < 1e-7, text


def side(q: np.ndarray, crank: float, b: float, ground: complex) -> float:
    """Which side of the line from the coupler's joint to the rocker's their pin is on."""
    A = cmath.rect(crank, q[0])
    P = A + cmath.rect(b, q[0] + q[1])
    return float(((ground - A).conjugate() * (P - A)).imag)


def test_each_pose_of_a_plate_on_three_legs_has_its_own_words(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "plate.yaml"
    file.write_text(PLATE, encoding="utf-8")
    _, *lines = robodyn("assemble", str(file), "--q", "60deg").out.splitlines()
    shown = {line.split(",")[0]: np.array(line.split(",")[1:8], float) for line in lines}
    assert list(shown) == ["open", "crossed"]
    assert side(shown["open"], 0.1, 0.3, 0.3 + 0j) > 0.0 > side(shown["crossed"], 0.1, 0.3, 0.3)
    for word, q in shown.items():
        file.write_text(PLATE + f"assembly: {word}\n", encoding="utf-8")
        again = robodyn("assemble", str(file), "--q", "60deg").out.splitlines()[1]
        assert again == next(line for line in lines if line.startswith(word))
        mech = api.load(file)
        assert np.abs(api.closure_gap(mech, q)).max() < 1e-15
        told = robodyn("torque", str(file), "--q", "60deg", "--qd", "1").out
        whole = ",".join(map(repr, q.tolist()))
        qd = ",".join(map(repr, api.loop_velocities(mech, q, [1.0]).tolist()))
        assert np.allclose(
            np.array(told.splitlines()[1].split(","), float),
            np.array(
                robodyn("torque", str(file), f"--q={whole}", f"--qd={qd}")
                .out.splitlines()[1]
                .split(","),
                float,
            ),
            rtol=1e-9,
        )


def test_a_word_of_a_loop_with_one_way_is_refused(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "plate.yaml"
    for words, told in (
        ("[open, crossed, open]", "assembly[1] = crossed: closures[1] is no dyad"),
        ("[open, open]", "assembly = 2 words: must be one word, or one for each of the 3"),
    ):
        file.write_text(PLATE + f"assembly: {words}\n", encoding="utf-8")
        result = robodyn("torque", str(file), "--q", "60deg")
        assert result.code == 2
        assert told in result.err
    assert mechanism(PLATE + "assembly: crossed\n").n == 7


# -- starts that do not close ----------------------------------------------------------------------

GEAR = """\
gravity: 9.81
links:
  - {name: leg, m: 60, l: 1.6, r: 1.0, I: 14, payload: 45, from: [0, 0]}
  - {name: upper, m: 6, l: 0.65, r: 0.32, I: 0.2, from: [0.9, 0.1]}
  - {name: lower, m: 6, l: 0.7, r: 0.35, I: 0.25}
  - {name: barrel, m: 4, l: 0.5, r: 0.2, I: 0.1, from: [-0.5, 0.15]}
  - {name: rod, from: {link: barrel, at: [0, 0]}, joint: prismatic, axis: [1, 0], m: 3, l: 0,
     r: [-0.2, 0], I: 0.05}
closures:
  - [lower, {link: leg, at: [0.8, 0]}]
  - [rod, {link: leg, at: [0.35, 0.1]}]
actuated: [rod]
start: {leg: -90deg, upper: -150deg, lower: 20deg, barrel: -40deg, rod: 0.75}
"""


def test_a_start_whose_rod_is_a_hair_too_short(robodyn, tmp_path: Path) -> None:
    """At 0.75 m nothing closes; the pose at 0.8 m is beside the start and not 109 degrees away."""
    file = tmp_path / "gear.yaml"
    file.write_text(GEAR, encoding="utf-8")
    result = robodyn("torque", str(file), "--q", "0.8")
    assert abs(float(result.out.splitlines()[1].split(",")[0]) - 826.6698307636682) < 1e-6
    assert result.err == ""
    q = api.assemble(api.load(file), [0.8])
    assert abs(q[0] + math.pi / 2) < 0.2
    # the pose by circles: about the leg's joint and the barrel's, and about its hinges
    pin = meet(0j, abs(0.35 + 0.1j), -0.5 + 0.15j, 0.8, 1)
    assert pin is not None
    leg = cmath.phase(pin / (0.35 + 0.1j))
    assert abs(q[0] - leg) < 1e-12
    knee = cmath.rect(0.8, leg)
    hinge = meet(0.9 + 0.1j, 0.65, knee, 0.7, -1)
    assert hinge is not None
    assert abs(math.remainder(q[1] - cmath.phase(hinge - (0.9 + 0.1j)), math.tau)) < 1e-12
    shown = json.loads(robodyn("check", str(file), "--format", "json").out)["start"]
    assert shown["closed"]
    assert shown["joint"] == "leg"
    assert 0.05 < shown["change"] < 0.2
    other = robodyn("torque", str(file), "--q=-0.8")
    assert other.code == 0
    assert "no path of closed poses leads" in other.err


@pytest.mark.parametrize("seed", range(10 if FRESH else 1))
def test_a_rough_start_is_on_the_branch_of_the_pose_beside_it(seed: int) -> None:
    """All joints of a start are off by up to 2 degrees, the crank perhaps beyond its range."""
    rng = np.random.default_rng(seed)
    for text, q, sides in rows(FIRST_SEED + seed, 100):
        rough = np.array(q) + rng.uniform(-0.035, 0.035, len(q))
        start = ", ".join(
            f"{name}: {x:.3f}" for name, x in zip(names(len(sides)), rough, strict=True)
        )
        mech = mechanism(f"{text}start: {{{start}}}\n")
        assert scene_branches(mech) == tuple("open" if x > 0 else "crossed" for x in sides), text
        pose = scene_start(mech)
        assert pose is not None
        assert pose.closed
        assert np.abs(api.closure_gap(mech, pose.q)).max() < 1e-13
        assert abs(pose.q[pose.joint] - rough[pose.joint]) < 0.5


def four_bar(
    a: float, b: float, c: float, theta: float, side: int, least: float = 0.02
) -> tuple[str, dict[str, float]] | None:
    """A crank a, a coupler b and a rocker c on a ground of 1, and the pose at a crank angle."""
    A = cmath.rect(a, theta)
    P = meet(A, b, 1 + 0j, c, side, least)
    if P is None:
        return None
    mass = "m: 1, r: 0.1, I: 0.01"
    text = f"""\
links:
  - {{name: crank, l: {a}, {mass}}}
  - {{name: coupler, l: {b}, {mass}}}
  - {{name: rocker, l: {c}, {mass}, from: [1, 0]}}
closures: [[coupler, rocker]]
"""
    coupler, rocker = cmath.phase(P - A) - theta, cmath.phase(P - 1)
    return text, {"crank": theta, "coupler": coupler, "rocker": rocker}


def test_a_start_beyond_the_end_of_a_range_is_on_the_branch_of_its_other_joints() -> None:
    """The crank stands 0.01 rad beyond where the loop closes, its pose is 0.01 rad before that."""
    rng, count = np.random.default_rng(8), 0
    while count < 60:
        a, b, c = rng.uniform(0.4, 1.5, 3).round(2).tolist()
        cosine = (1 + a * a - (b + c) ** 2) / (2 * a)
        if abs(cosine) > 0.9 or abs(b - c) > abs(1 - a):
            continue
        end, sign, side = math.acos(cosine), *rng.choice([-1, 1], 2)
        theta = sign * (end - 0.01)
        made = four_bar(a, b, c, theta, int(side), least=0.0)
        assert made is not None
        text, q = made
        mech = mechanism(started(text, q | {"crank": sign * (end + 0.01)}, 6))
        with pytest.raises(api.AssemblyError):
            api.assemble(mech, [sign * (end + 0.01)])
        assert off_by(api.assemble(mech, [theta]), q) < 1e-8, text
        count += 1


def slider(rng: np.random.Generator) -> tuple[str, dict[str, float], str] | None:
    """A crank, a rod and a pin that slides on a line, of the ground or of a link that turns."""
    r, b, theta, slope = 0.3, rng.uniform(0.5, 0.9), *rng.uniform(-math.pi, math.pi, 2)
    crank, u = cmath.rect(r, theta), cmath.rect(1.0, slope)
    through = complex(*rng.uniform(-0.3, 0.3, 2))
    across = ((crank - through) * u.conjugate()).imag
    if abs(across) > 0.97 * b:
        return None
    ahead = int(rng.choice([-1, 1]))
    pin = crank + u * complex(ahead * math.sqrt(b * b - across * across), -across)
    mass = "m: 1, r: 0.1, I: 0.01"
    text = f"""\
links:
  - {{name: crank, l: {r}, {mass}}}
  - {{name: rod, l: {b!r}, {mass}}}
closures:
  - {{point: rod, on: {{through: [{through.real!r}, {through.imag!r}], along: [{u.real!r},
      {u.imag!r}]}}}}
"""
    q = {"crank": theta, "rod": cmath.phase(pin - crank) - theta}
    return text, q, "open" if ahead > 0 else "crossed"


def slot(rng: np.random.Generator) -> tuple[str, dict[str, float], str] | None:
    """A crank whose tip slides in a slot of a lever, off the lever's own joint."""
    theta, r, off = rng.uniform(-math.pi, math.pi), rng.uniform(0.2, 0.5), rng.uniform(-0.15, 0.15)
    tip, ground = cmath.rect(r, theta), complex(*rng.uniform(-1, 1, 2))
    far = abs(tip - ground)
    if far < 1.1 * abs(off):
        return None
    ahead = int(rng.choice([-1, 1]))
    along = ahead * math.sqrt(far * far - off * off)
    lever = cmath.phase((tip - ground) / complex(along, off))
    mass = "m: 1, r: 0.1, I: 0.01"
    text = f"""\
links:
  - {{name: crank, l: {r!r}, {mass}}}
  - {{name: lever, l: 1, {mass}, from: [{ground.real!r}, {ground.imag!r}]}}
closures:
  - {{point: crank, on: {{link: lever, through: [0, {off!r}], along: [1, 0]}}}}
"""
    return text, {"crank": theta, "lever": lever}, "open" if ahead > 0 else "crossed"


@pytest.mark.parametrize("kind", [slider, slot])
def test_starts_and_words_of_sliders_and_slots(kind) -> None:
    rng, count = np.random.default_rng(11), 0
    while count < 60:
        made = kind(rng)
        if made is None:
            continue
        text, q, word = made
        count += 1
        for more in (started(text, q), text + f"assembly: {word}\n"):
            assert off_by(api.assemble(mechanism(more), [q["crank"]]), q) < 1e-7, more
        assert scene_branches(mechanism(started(text, q, 2))) == (word,), text


# -- circuits --------------------------------------------------------------------------------------


def test_circuits_of_four_bars_are_those_of_their_ranges() -> None:
    """Two poses with one word are of one circuit if one of the two ways between them closes."""
    rng, told = np.random.default_rng(2), {True: 0, False: 0}
    while min(told.values()) < 12:
        a, b, c = rng.uniform(0.3, 1.6, 3).round(2).tolist()
        first, last = rng.uniform(-math.pi, math.pi, 2)

        def closes(theta, least=0.0, a=a, b=b, c=c):
            far = np.abs(1.0 - a * np.exp(1j * theta))
            return (far < b + c - least) & (far > abs(b - c) + least)

        if not (closes(first) and closes(last)):
            continue
        way = math.remainder(last - first, math.tau)
        ways = [first + np.linspace(0, w, 2001) for w in (way, way - math.copysign(math.tau, way))]
        same, nearly = (any(closes(w, x).all() for w in ways) for x in (1e-3, -1e-3))
        if same != nearly:  # a range whose ends nearly meet
            continue
        word = str(rng.choice(["open", "crossed"]))
        made = four_bar(a, b, c, first, 1 if word == "open" else -1)
        if made is None:
            continue
        text, start = made
        mech = mechanism(started(text, start))
        assert leads_there(mech, api.assemble(mech, [last])) is same, (text, first, last)
        told[same] += 1


def traced(mech: api.Mechanism, q: np.ndarray, sign: float) -> np.ndarray:
    """The closed poses of a linkage of one freedom, from a pose on, by tangent and projection."""
    found, before = [q], None
    for _ in range(600):
        Psi = api.closure_jacobian(mech, q)
        tangent = np.linalg.svd(Psi)[2][-1]
        if before is None:
            tangent *= sign * math.copysign(1.0, tangent[0])
        elif tangent @ before < 0:
            tangent = -tangent
        before, q = tangent, q + 0.03 * tangent
        for _ in range(3):
            q = q - np.linalg.pinv(api.closure_jacobian(mech, q)) @ api.closure_gap(mech, q)
        found.append(q)
    return np.array(found)


def test_circuits_of_two_dyads_are_those_that_a_path_traces() -> None:
    """Paths run through dead centres, where the words of a dyad change, and perhaps come back."""
    rng, told = np.random.default_rng(4), {True: 0, False: 0}
    while told[False] < 2:
        made = row(rng, 2, (0.6, 1.7), 6)
        if made is None:
            continue
        text, q, _ = made
        start = dict(zip(names(2), q, strict=True))
        mech = mechanism(started(text, start, 12))
        theta = float(rng.uniform(-math.pi, math.pi))
        try:
            pose = api.assemble(mech, [theta])
        except api.AssemblyError:
            continue
        leads = leads_there(mech, pose)
        if leads and told[True] > 20:  # those of two circuits are few
            continue
        paths = [traced(mech, np.array(q), sign) for sign in (1.0, -1.0)]
        if any(np.abs(np.diff(path, axis=0)).max() > 0.1 for path in paths):
            continue  # it leapt beside a change point
        path = np.concatenate(paths)
        way = np.abs(np.remainder(path - pose + np.pi, 2 * np.pi) - np.pi).max(axis=1)
        same = bool(way.min() < 0.03)
        assert leads is same, (text, q, theta, way.min())
        told[same] += 1


# -- branches that were not asked for --------------------------------------------------------------

IN_LINE = """\
links:
  - {name: a, m: 1, l: 1, r: 0.5, I: 1}
  - {name: b1, m: 1, l: 1.25, r: 1, I: 1}
  - {name: c1, m: 1, l: 1.25, r: 1, I: 1, from: [2, 1]}
  - {name: b2, m: 1, l: 1, r: 1, I: 1, from: c1}
  - {name: c2, m: 1, l: 1, r: 1, I: 1, from: [1, 2.25]}
closures: [[b1, c1], [b2, c2]]
"""


@pytest.mark.parametrize("more", [["--qd", "1"], ["--qd", "1", "--qdd", "2"], ["--range"], []])
def test_a_singular_branch_that_was_not_asked_for_is_left_out(robodyn, tmp_path, more) -> None:
    """With the first dyad crossed the second one is at a dead centre."""
    file = tmp_path / "in_line.yaml"
    file.write_text(IN_LINE, encoding="utf-8")
    result = robodyn("assemble", str(file), "--q", "90deg", *more)
    assert result.code == 0
    words = [line.split(",")[0] for line in result.out.splitlines()[1:]]
    assert words[:2] == ["open open", "open crossed"]
    assert ("crossed open" in words) is (not more or more == ["--range"])
    for command in ("torque", "terms"):
        assert robodyn(command, str(file), "--q", "90deg", "--qd", "1").code == 0


# -- rows of dyads of all kinds --------------------------------------------------------------------


def mixed(rng: np.random.Generator, count: int) -> tuple[str, dict[str, float], list[str]] | None:
    """A crank, then pairs of links, or levers with slots, in a row; at last a slider perhaps."""
    mass = "m: 1, r: 0.1, I: 0.01"
    q = {"a": float(rng.uniform(-math.pi, math.pi))}
    links, closures, words = [f"  - {{name: a, l: 1, {mass}}}"], [], []
    above, tip, turn = "a", cmath.rect(1.0, q["a"]), q["a"]
    for i in range(1, count + 1):
        ground, kind = complex(2 * i, 0), str(rng.choice(["pin", "slot", "slide"]))
        if kind == "slide" and i < count:
            kind = "pin"
        side = int(rng.choice([-1, 1]))
        if kind == "pin":
            b, c = rng.uniform(0.8, 3.5, 2).round(2).tolist()
            pin = meet(tip, b, ground, c, side)
            if pin is None:
                return None
            q |= {f"b{i}": cmath.phase(pin - tip) - turn, f"c{i}": cmath.phase(pin - ground)}
            links.append(f"  - {{name: b{i}, l: {b}, {mass}, from: {above}}}")
            links.append(f"  - {{name: c{i}, l: {c}, {mass}, from: [{2 * i}, 0]}}")
            closures.append(f"  - [b{i}, c{i}]")
            above, tip, turn = f"c{i}", pin, q[f"c{i}"]
        elif kind == "slot":
            off, long = rng.uniform([-0.3, 0.8], [0.3, 1.6]).round(2).tolist()
            far = abs(tip - ground)
            if far < 1.2 * abs(off):
                return None
            along = side * math.sqrt(far * far - off * off)
            q[f"c{i}"] = turn = cmath.phase((tip - ground) / complex(along, off))
            links.append(f"  - {{name: c{i}, l: {long}, {mass}, from: [{2 * i}, 0]}}")
            line = f"{{link: c{i}, through: [0, {off}], along: [1, 0]}}"
            closures.append(f"  - {{point: {above}, on: {line}}}")
            above, tip = f"c{i}", ground + cmath.rect(long, turn)
        else:
            b, slope = float(rng.uniform(2.0, 4.0)), float(rng.uniform(-math.pi, math.pi))
            u = cmath.rect(1.0, slope)
            across = ((tip - ground) * u.conjugate()).imag
            if abs(across) > 0.97 * b:
                return None
            pin = tip + u * complex(side * math.sqrt(b * b - across * across), -across)
            q[f"b{i}"] = cmath.phase(pin - tip) - turn
            links.append(f"  - {{name: b{i}, l: {b!r}, {mass}, from: {above}}}")
            line = f"{{through: [{2 * i}, 0], along: [{u.real!r}, {u.imag!r}]}}"
            closures.append(f"  - {{point: b{i}, on: {line}}}")
        words.append(WORDS[side])
    text = "links:\n" + "\n".join(links) + "\nclosures:\n" + "\n".join(closures) + "\n"
    return text, q, words


@pytest.mark.parametrize("seed", range(20 if FRESH else 2))
def test_rows_of_pins_slots_and_a_slider(seed: int) -> None:
    rng, count = np.random.default_rng(FIRST_SEED + 100 + seed), 0
    while count < 100:
        made = mixed(rng, int(rng.integers(1, 6)))
        if made is None:
            continue
        text, q, words = made
        count += 1
        mech = mechanism(started(text, q))
        assert scene_branches(mech) == tuple(words), text
        assert off_by(api.assemble(mech, [q["a"]]), q) < 1e-7, text
        said = mechanism(f"{text}assembly: [{', '.join(words)}]\n")
        assert off_by(api.assemble(said, [q["a"]]), q) < 1e-7, text


def test_three_actuated_joints_whose_straight_way_does_not_close(robodyn, tmp_path: Path) -> None:
    """A four-bar that an arm carries closes only where the crank is 66 degrees or more from it."""
    text = """\
links:
  - {name: base, m: 1, l: 1, r: 0.5, I: 0.1}
  - {name: arm, m: 1, l: 1, r: 0.5, I: 0.1}
  - {name: crank, m: 1, l: 0.8, r: 0.1, I: 0.01}
  - {name: coupler, m: 1, l: 1.5, r: 0.1, I: 0.01}
  - {name: rocker, m: 1, l: 0.5, r: 0.1, I: 0.01, from: {link: arm, at: [2, 0]}}
closures: [[coupler, rocker]]
actuated: [base, arm, crank]
start: {base: 0, arm: 0, crank: 80deg, coupler: -120deg, rocker: -60deg}
"""
    file = tmp_path / "carried.yaml"
    file.write_text(text, encoding="utf-8")
    for angle, closes in (("120deg", True), ("-80deg", False)):
        result = robodyn("assemble", str(file), f"--q=0.2,0.1,{angle}")
        assert result.code == 0
        assert ("the straight way of the actuated joints" in result.err) is not closes
