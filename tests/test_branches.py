"""Which way loops close: by words in the order of closures, by a start, against own circles."""

from __future__ import annotations

import cmath
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH

import robodyn as api
from random_mechanisms import mechanism
from robodyn.loops.assembly import all_branches, scene_branches

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


def row(rng: np.random.Generator, count: int) -> tuple[str, list[float], list[int]] | None:
    """A crank and `count` dyads, a pose by circles of its own, and the side each pin lies on."""
    angle = rng.uniform(-math.pi, math.pi)
    tip, turn = cmath.rect(1.0, angle), angle
    links, closures = ["  - {name: a, m: 1, l: 1, r: 0.5, I: 1}"], []
    q, above, sides = [angle], "a", []
    for i in range(1, count + 1):
        ground, b, c = complex(2 * i, 0), *np.round(rng.uniform(0.8, 3.5, 2), 1).tolist()
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
