"""What is drawn: points where independent kinematics has them, outlines of the right width."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT
from each_case import each
from hypothesis import given, settings
from hypothesis import strategies as st

import oracles
import robodyn
from random_mechanisms import LOOPS, Pose, forced, oracle_tree, seeded_scene, seeded_tree
from robodyn.dynamics import dynamics
from robodyn.dynamics.named_points import named_points
from robodyn.elements.loads import Force as LoadForce
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.errors import AssemblyError, InputError
from robodyn.loops.assembly import first_pose
from robodyn.mechanics import mechanism
from robodyn.mechanics.mechanism import build
from robodyn.pictures.drawing import Drawing, drawing, link_points, rounded_hull, span, traced
from robodyn.pictures.force_arrows import (
    LONGEST,
    Force,
    arc,
    arrows,
    forces,
    forces_at,
    metres_a_newton,
    with_prefix,
)
from robodyn.pictures.mechanism_picture import (
    frame,
    free_place,
    head_places,
    label_places,
    scale_bar,
)
from robodyn.scene import description
from robodyn.scene.description import from_text

ROBOTS = sorted(ROOT.glob("robots/*.yaml"))


def centres(drawn: Drawing, kind: str, pose: int = 0) -> list[complex]:
    """The centres of all shapes of a kind, circles."""
    return [complex(z.mean()) for _, shape, z in drawn.placed(pose) if shape.kind == kind]


def assert_same_points(found: list[complex], expected: list[complex]) -> None:
    """The same points, in any order, each as often."""
    assert len(found) == len(expected)
    rest = list(found)
    for point in expected:
        nearest = min(rest, key=lambda z: abs(z - point))
        assert abs(nearest - point) < 1e-12 * (1 + abs(point))
        rest.remove(nearest)


def segment_distance(z: np.ndarray, a: complex, b: complex) -> np.ndarray:
    t = np.clip(((z - a) * np.conj(b - a)).real / abs(b - a) ** 2, 0, 1) if a != b else 0 * z.real
    return np.abs(z - (a + t * (b - a)))


# Where things are


@each("seed", range(10))
@each("shape", LOOPS)
def test_points_are_those_of_independent_kinematics(seed: int, shape: str) -> None:
    scene = seeded_scene(seed, LOOPS[shape])
    check_points(scene)


@each("seed", range(10))
def test_points_of_trees(seed: int) -> None:
    check_points(seeded_tree(seed, 5))


def check_points(scene) -> None:
    description = scene.mechanism.description
    tree = oracle_tree(description)
    pose = Pose(tree, scene.q)
    drawn = drawing(scene.mechanism, scene.q)
    n = len(tree)
    joints = list(pose.joints)
    for closure in description.closures:
        side = closure.first if closure.first.link is not None else closure.second
        joints.append(pose.position((side.link, side.at)))
    assert_same_points(centres(drawn, "joint"), joints)
    own = [pose.position((k, link.r)) for k, link in enumerate(description.links)]
    assert_same_points(centres(drawn, "centre"), own)
    grounded = [link.hangs_from.at for link in description.links if link.hangs_from.link is None]
    for closure in description.closures:
        if closure.along is None:
            grounded += [s.at for s in (closure.first, closure.second) if s.link is None]
    tops = [complex(z[0]) for _, shape, z in drawn.placed(0) if shape.kind == "support"]
    assert_same_points(tops, list(dict.fromkeys(grounded)))
    loads = [
        pose.position((k, complex(link.l)))
        for k, link in enumerate(description.links)
        if link.payload
    ]
    assert_same_points(centres(drawn, "payload"), loads)
    assert sum(shape.kind == "link" for body in drawn.bodies for shape in body.shapes) == n


def test_a_four_bar_through_a_turn() -> None:
    mech = robodyn.load(ROOT / "robots/four-bar.yaml")
    theta = np.linspace(0, 6, 7)
    drawn = drawing(mech, robodyn.assemble(mech, theta[:, None]))
    p = FOUR_BAR
    for pose, angle in enumerate(theta):
        q = oracles.four_bar_position(p, angle)
        A = p.l1 * np.exp(1j * q[0])
        P = A + p.l2 * np.exp(1j * (q[0] + q[1]))
        assert_same_points(centres(drawn, "joint", pose), [0j, A, complex(p.d, p.e), P])
        halves = [
            p.r1 * np.exp(1j * q[0]),
            A + p.r2 * np.exp(1j * (q[0] + q[1])),
            complex(p.d, p.e) + p.r3 * np.exp(1j * q[2]),
        ]
        assert_same_points(centres(drawn, "centre", pose), halves)


@each("seed", range(6))
def test_springs_end_where_they_are_hung(seed: int) -> None:
    """And dampers; stretched along themselves alone."""
    scene = forced(seed, seeded_scene(seed, LOOPS["four-bar"]))
    described = scene.mechanism.description
    pose = Pose(oracle_tree(described), scene.q)
    drawn = drawing(scene.mechanism, scene.q)
    bodies = [b for b, body in enumerate(drawn.bodies) if body.end is not None]
    springs = [s for s in described.springs if isinstance(s, PointSpring)]
    assert len(bodies) == len(springs)
    for b, spring in zip(bodies, springs, strict=True):
        first, second = (pose.position((p.link, p.at)) for p in (spring.first, spring.second))
        z = np.concatenate([z for body, _, z in drawn.placed(0) if body == b])
        along = (second - first) / abs(second - first)
        assert np.abs(z - first).min() < 1e-12
        assert np.abs(z - second).min() < 1e-12
        straight = (z - first) * np.conj(along)
        assert straight.real.min() > -1e-12
        assert straight.real.max() < abs(second - first) + 1e-12
        assert np.abs(straight.imag).max() == pytest.approx(drawn.half_width)
    coiled = sum(isinstance(s, JointSpring) for s in described.springs)
    whole = [body for body in drawn.bodies if body.turns and body.end is None]
    spirals = [s for body in whole for s in body.shapes if s.kind == "spring"]
    assert len([s for s in spirals if len(s.points) > 20]) == coiled


def test_a_damper_is_a_piston_and_ends_may_coincide() -> None:
    text = (
        "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0}]\n"
        "springs: [{between: [a, [1, 0]], stiffness: 0, length: 0, damping: 2}]\n"
    )
    mech = build(from_text(text, "x.yaml"))
    for angle in (0.0, 1.0):
        drawn = drawing(mech, [angle])
        parts = [z for _, shape, z in drawn.placed(0) if shape.kind == "spring"]
        assert len(parts) == 4
        assert np.isfinite(np.concatenate(parts)).all()
    assert np.isfinite(drawn.box()).all()


def test_a_sliders_block_lies_along_its_line() -> None:
    text = (ROOT / "robots/slider-crank.yaml").read_text()
    text = text.replace("through: [0, 0.02], along: [1, 0]", "through: [0, 0.02], along: [2, 1]")
    mech = build(from_text(text, "x.yaml"))
    drawn = drawing(mech, robodyn.assemble(mech, [[0.3], [2.0], [4.0]]))
    along = (2 + 1j) / abs(2 + 1j)
    travelled = []
    for pose in range(3):
        (block,) = [z for _, shape, z in drawn.placed(pose) if shape.kind == "block"]
        on_line = (block.mean() - 0.02j) * np.conj(along)
        assert abs(on_line.imag) < 1e-12
        travelled.append(on_line.real)
        sides = (np.roll(block, -1) - block) * np.conj(along)
        assert np.allclose(np.minimum(np.abs(sides.real), np.abs(sides.imag)), 0, atol=1e-14)
    walls = [z for _, shape, z in drawn.placed(0) if shape.kind == "axis"]
    reach = ((walls[0] - 0.02j) * np.conj(along)).real
    assert reach.min() < min(travelled)
    assert reach.max() > max(travelled)


# Joints that slide, slots

YOKE = """
links:
  - {name: crank, m: 1, l: 0.1, r: 0.03, I: 0.002}
  - {name: yoke, joint: prismatic, axis: [1, 0], m: 1, l: 0.2, r: 0.1, I: 0.01, from: [0.3, 0]}
closures:
  - {point: crank, on: {link: yoke, through: [-0.3, 0], along: [0, 1]}}
actuated: [crank]
"""
CYLINDER = """
links:
  - {name: cylinder, m: 1, l: 0.6, r: 0.3, I: 0.4}
  - {name: rod, joint: prismatic, axis: [1, 0], m: 5, l: 0.1, r: 0, I: 0.3, from: %s}
"""


def scene(text: str):
    return build(from_text(text, "x.yaml"))


def shapes_of(drawn: Drawing, kind: str, pose: int = 0) -> list[np.ndarray]:
    return [z for _, shape, z in drawn.placed(pose) if shape.kind == kind]


def test_a_yoke_slides_on_the_ground_and_holds_its_pin_in_a_slot() -> None:
    mech = scene(YOKE)
    for angles in ([0.4], [0.4, 1.2, 2.9]):
        drawn = drawing(mech, robodyn.assemble(mech, np.array(angles)[:, None]))
        for pose, angle in enumerate(angles):
            pin = 0.1 * np.exp(1j * angle)
            assert_same_points(centres(drawn, "joint", pose), [0j, pin])  # none where it slides
            (block,) = shapes_of(drawn, "slider", pose)
            origin = complex(0.1 * np.cos(angle) + 0.3)
            assert block.mean() == pytest.approx(origin)
            (slot,) = shapes_of(drawn, "slot", pose)
            assert np.ptp(slot.real) < 2 * drawn.half_width
            assert 0.5 * (slot.real.min() + slot.real.max()) == pytest.approx(pin.real)
            assert slot.imag.min() < pin.imag < slot.imag.max()
        assert len(shapes_of(drawn, "support")) == 1  # of the crank
        walls = np.concatenate(shapes_of(drawn, "guide"))[2:]
        if len(angles) == 1:  # as far as the crank goes in a turn, where one pose tells little
            assert slot.imag.min() < -0.1
            assert slot.imag.max() > 0.1
            assert walls.real.min() < 0.2
            assert walls.real.max() > 0.4


def test_a_rail_reaches_from_zero_to_where_its_link_goes() -> None:
    text = (
        "links: [{name: a, joint: prismatic, axis: [3, 4], m: 1, l: 0, r: 0, I: 0, from: [1, 2]}]"
    )
    mech = scene(text)
    drawn = drawing(mech, [[0.5], [0.8], [-0.1]])
    along = 0.6 + 0.8j
    walls = (np.concatenate(shapes_of(drawn, "guide")) - (1 + 2j)) * np.conj(along)
    margin = 4 * drawn.half_width
    assert walls.real.min() == pytest.approx(-0.1 - margin)
    assert walls.real.max() == pytest.approx(0.8 + margin)
    assert np.abs(walls.imag) == pytest.approx(1.7 * drawn.half_width)
    for pose, s in enumerate((0.5, 0.8, -0.1)):
        (block,) = shapes_of(drawn, "slider", pose)
        assert block.mean() == pytest.approx(1 + 2j + s * along)
        sides = (np.roll(block, -1) - block) * np.conj(along)
        assert np.minimum(np.abs(sides.real), np.abs(sides.imag)).max() < 1e-12
    assert not shapes_of(drawn, "support")
    assert not shapes_of(drawn, "joint")


def test_a_block_slides_on_a_link_and_a_rod_out_of_one() -> None:
    poses = [[0.3, 0.2], [1.1, 0.45]]
    for at, sliding in ((0.0, True), (0.6, False)):
        mech = scene(CYLINDER % f"{{link: cylinder, at: [{at}, 0]}}")
        drawn = drawing(mech, poses)
        w = drawn.half_width
        for pose, (angle, s) in enumerate(poses):
            along = np.exp(1j * angle)
            link = [z for _, shape, z in drawn.placed(pose) if shape.kind == "link"][1]
            origin = (s if sliding else 0.6 + s) * along
            straight = (link - origin) * np.conj(along)
            assert straight.real.min() == pytest.approx(-w, rel=1e-3)
            assert straight.real.max() == pytest.approx(0.1 + w, rel=1e-3)
            (rail,) = shapes_of(drawn, "rail", pose)
            rail = rail * np.conj(along)
            if sliding:
                (block,) = shapes_of(drawn, "slider", pose)
                assert block.mean() == pytest.approx(origin)
                assert rail.real.min() < 0 < 0.45 < rail.real.max()
                assert not shapes_of(drawn, "rod", pose)
                continue
            (rod,) = shapes_of(drawn, "rod", pose)
            rod = rod * np.conj(along)
            assert rod.real.max() == pytest.approx(0.6 + s)
            assert rod.real.min() == pytest.approx(0.6 + s - 0.45 - 2 * w)
            assert rail.real.min() < 0.6 < rail.real.max()  # it leaves the cylinder there
            assert not shapes_of(drawn, "slider", pose)


def test_a_rod_may_come_out_backwards() -> None:
    mech = scene(CYLINDER % "{link: cylinder, at: [0, 0]}")
    drawn = drawing(mech, [0.0, -0.5])
    (rod,), (rail,) = shapes_of(drawn, "rod"), shapes_of(drawn, "rail")
    assert rod.real.min() == pytest.approx(-0.5)
    assert rod.real.max() == pytest.approx(2 * drawn.half_width)
    assert rail.real.min() < 0 < rail.real.max()


def test_a_block_that_keeps_its_angle_turns_with_its_line() -> None:
    text = """
links:
  - {name: crank, m: 0.8, l: 0.1, r: 0.03, I: 0.002}
  - {name: block, m: 0.3, l: 0, r: 0, I: 0.0005}
  - {name: lever, m: 1.5, l: 0.5, r: 0.25, I: 0.03, from: [0, -0.25]}
closures:
  - {point: {link: block, at: [0, 0]}, on: {link: lever, through: [0, 0], along: [1, 0]},
     aligned: 30deg}
actuated: [crank]
start: {crank: 0.3, lever: 70deg, block: 50deg}
"""
    mech = scene(text)
    drawn = drawing(mech, robodyn.assemble(mech, [[0.3], [1.7]]))
    for pose, angle in enumerate((0.3, 1.7)):
        pin = 0.1 * np.exp(1j * angle)
        along = (pin + 0.25j) / abs(pin + 0.25j)
        (block,), (slot,) = shapes_of(drawn, "slider", pose), shapes_of(drawn, "slot", pose)
        assert block.mean() == pytest.approx(pin)
        for shape in (block, slot):
            sides = (np.roll(shape, -1) - shape) * np.conj(along)
            assert np.minimum(np.abs(sides.real), np.abs(sides.imag)).max() < 1e-9
        inside = (slot - pin) * np.conj(along)
        around = (block - pin) * np.conj(along)
        assert inside.real.min() < around.real.min() < around.real.max() < inside.real.max()


def test_a_spring_at_a_joint_that_slides_is_a_coil_along_it() -> None:
    text = (
        "links: [{name: a, joint: prismatic, axis: [0, 1], m: 1, l: 1, r: 0, I: 0, from: [2, 0]}]\n"
        "springs: [{joint: a, stiffness: 30, length: 0.1}]\n"
    )
    drawn = drawing(scene(text), [0.7])
    (coil,) = shapes_of(drawn, "spring")
    assert (coil[0], coil[-1]) == (pytest.approx(2), pytest.approx(2 + 0.7j))
    assert np.abs(coil.real - 2).max() == pytest.approx(drawn.half_width)


def posed(mech, angles: np.ndarray) -> np.ndarray:
    """The free joints at the first of these angles; those that slide near the first pose."""
    free = list(mech.actuated) if mech.rows else list(range(mech.n))
    q = np.array(angles[: len(free)])
    for place, k in enumerate(free):
        if k in mech.slides:
            q[place] = first_pose(mech, t=0.0)[k] + 0.1 * mech.unit * q[place]
    return robodyn.assemble(mech, q) if mech.rows else q


@each("path", ROBOTS)
def test_links_keep_their_shape_from_pose_to_pose(path) -> None:
    mech = robodyn.load(path)
    pose = first_pose(mech, t=0.0)
    free = list(mech.actuated) if mech.rows else list(range(mech.n))
    q = np.array([pose, posed(mech, pose[free] + 0.7)])
    drawn = drawing(mech, q)
    for (_, shape, a), (_, _, b) in zip(drawn.placed(0), drawn.placed(1), strict=True):
        if shape.kind == "link":
            assert np.allclose(np.abs(a - a[0]), np.abs(b - b[0]), rtol=1e-12)
            gaps = np.abs(a[:, None] - a[None, :])
            k, closures = drawn_link(drawn, shape), mech.description.closures
            slots = [x.second.at for x in closures if x.along is not None and x.second.link == k]
            ends = np.append(link_points(mech, k), slots)
            length = np.abs(ends[:, None] - ends[None, :]).max()
            assert gaps.max() == pytest.approx(length + 2 * drawn.half_width, rel=1e-3)


def drawn_link(drawn: Drawing, shape) -> int:
    (link,) = [body.link for body in drawn.bodies if any(s is shape for s in body.shapes)]
    return link


def test_ground_pivots_of_hanging_links_hang_from_above() -> None:
    mech = robodyn.load(ROOT / "robots/pendulum.yaml")
    for angle, side in ((-1.2, 1), (1.2, -1), (0.0, -1)):
        drawn = drawing(mech, [angle])
        hatches = [z for _, shape, z in drawn.placed(0) if shape.kind == "hatch"]
        assert all((np.sign(z.imag) == side).all() for z in hatches)


def test_what_holds_a_spring_alone_is_smaller() -> None:
    """Two ground pivots, and where a spring hangs from the ground."""
    links = "".join(
        f"  - {{name: {k}, m: 1, l: 1, r: 0.5, I: 0.1, from: [{x}, 0]}}\n"
        for k, x in (("a", 0), ("b", 3))
    )
    spring = "springs: [{between: [a, [1, 2]], stiffness: 9, length: 1}]\n"
    drawn = drawing(build(from_text(f"links:\n{links}{spring}", "held")), [0.3, 0.3])
    found = {z[0]: np.ptp(z.real) for _, s, z in drawn.placed(0) if s.kind == "support"}
    assert set(found) == {0, 3, 1 + 2j}
    assert found[0] == pytest.approx(found[3])
    assert found[1 + 2j] == pytest.approx(0.6 * found[0])


# Outlines


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_an_outline_runs_at_its_distance_around_the_hull(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=count) + 1j * rng.normal(size=count)
    outline = rounded_hull(points, 0.3)
    pairs = [(a, b) for a in points for b in points]
    near = np.min([segment_distance(outline, a, b) for a, b in pairs], axis=0)
    assert np.allclose(near, 0.3, rtol=1e-9)  # from the hull's edge, which is one of the segments
    for point in points:
        assert np.abs(outline - point).min() >= 0.3 * (1 - 1e-9)
    # counter-clockwise and convex
    steps = np.roll(outline, -1) - outline
    steps = steps[np.abs(steps) > 1e-12]
    turns = (np.conj(steps) * np.roll(steps, -1)).imag
    assert turns.min() > -1e-9
    area = 0.5 * (np.conj(outline) * np.roll(outline, -1)).imag.sum()
    assert area > 0


def test_a_bar_and_a_ternary_link() -> None:
    bar = rounded_hull(np.array([0j, 2, 1]), 0.5)
    area = 0.5 * (np.conj(bar) * np.roll(bar, -1)).imag.sum()
    assert area == pytest.approx(2 + np.pi / 4, rel=0.01)
    text = (
        "links:\n"
        "  - {name: plate, m: 1, l: 1, r: 0.5, I: 0}\n"
        "  - {name: a, m: 1, l: 1, r: 0.5, I: 0, from: {link: plate, at: [0.4, 0.3]}}\n"
        "points: {blade: {link: a, at: [2, -1]}}\n"
    )
    mech = build(from_text(text, "x.yaml"))
    assert set(link_points(mech, 0).tolist()) == {0, 1, 0.4 + 0.3j}
    assert set(link_points(mech, 1).tolist()) == {0, 1, 2 - 1j}


def test_span_and_size() -> None:
    mech = robodyn.load(ROOT / "robots/2r.yaml")
    assert span(mech, np.zeros((1, 2))) == pytest.approx(1.4)
    assert span(mech, np.array([[0, 0], [np.pi / 2, 0], [np.pi, 0]])) == pytest.approx(2.8)
    dot = build(from_text("links: [{name: a, m: 1, l: 0, r: 0, I: 1}]", "x.yaml"))
    assert span(dot, np.zeros((1, 1))) == 1.0
    assert drawing(dot, [0.3]).box()[2] > 0


# The pose without --q


@each("path", ROBOTS)
def test_the_first_pose_closes(path) -> None:
    mech = robodyn.load(path)
    assert np.abs(robodyn.closure_gap(mech, first_pose(mech, t=0.0))).max(initial=0.0) < 1e-9


def test_the_first_pose_goes_by_the_start_and_takes_what_closes() -> None:
    arm = "links:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0}\n"
    assert first_pose(build(from_text(arm, "x.yaml")), t=0.0) == 0.0
    assert first_pose(build(from_text(arm + "start: {a: 0.4}\n", "x.yaml")), t=0.0) == 0.4
    slider = "{point: b, on: {through: [0, 1.9], along: [1, 0]}}"
    loop = arm + f"  - {{name: b, m: 1, l: 1, r: 0.5, I: 0}}\nclosures: [{slider}]\n"
    pose = first_pose(build(from_text(loop, "x.yaml")), t=0.0)
    assert pose[0] == pytest.approx(np.pi / 2)  # the one twelfth at which the crank is above 0.9
    with pytest.raises(AssemblyError, match="give --q"):
        first_pose(build(from_text(loop.replace("1.9", "2.9"), "x.yaml")), t=0.0)


def test_the_first_pose_where_actuated_joints_do_not_decide_it() -> None:
    link = "{{name: {0}, m: 1, l: 1, r: 0.5, I: 0.1, from: {1}}}"
    links = ", ".join(link.format(*x) for x in (("a", "[0, 0]"), ("b", "a"), ("c", "b")))
    text = f"links: [{links}]\nactuated: []\ncouplings: [q3 = -2 q2 %s]\n%s"
    assert first_pose(build(from_text(text % ("", ""), "x.yaml")), t=0.0).tolist() == [0, 0, 0]
    started = build(from_text(text % ("+ 1", "start: {a: 0.4, b: 0.2, c: 0.6}\n"), "x.yaml"))
    assert first_pose(started, t=0.0).tolist() == [0.4, 0.2, 0.6]
    with pytest.raises(InputError, match="give all 3 joint angles"):
        first_pose(build(from_text(text % ("+ 1", ""), "x.yaml")), t=0.0)


def test_the_first_pose_tries_displacements() -> None:
    """In both directions, by quarters of the longest length."""
    text = """
links:
  - {name: boom, m: 1, l: 2, r: 0.9, I: 1}
  - {name: cylinder, m: 1, l: 0.6, r: 0.3, I: 1, from: [0.3, -0.4]}
  - {name: rod, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 1,
     from: {link: cylinder, at: [%s, 0]}}
closures: [[rod, {link: boom, at: [0.9, 0]}]]
actuated: [rod]
"""
    for begin, expected in ((0.0, 0.5), (1.9, -0.5), (0.6, 0.0)):
        mech = scene(text % begin)
        pose = first_pose(mech, t=0.0)
        assert pose[2] == pytest.approx(expected)
        assert np.abs(robodyn.closure_gap(mech, pose)).max() < 1e-9
    with pytest.raises(AssemblyError, match="give --q"):
        first_pose(scene(text % 50.0), t=0.0)


# Frames, scale bars and labels


def test_a_frame_is_to_scale_and_holds_its_box() -> None:
    for size in (None, (8.0, 3.0), (3.0, 8.0)):
        for box in ((0, 0, 2, 1), (-1, -3, 0, 4), (0, 0, 5, 0.01)):
            shown = frame(box, 6.0, size, 0.3)
            across = (shown.right - shown.left) / shown.width
            up = (shown.top - shown.bottom) / shown.height
            assert across == pytest.approx(up)
            assert shown.left < box[0] < box[2] < shown.right
            assert shown.bottom + 0.29 * up < box[1] < box[3] < shown.top
            if size is None:
                assert max(shown.width, shown.height - 0.3) == pytest.approx(6.0)
            else:
                assert (shown.width, shown.height) == size


@pytest.mark.parametrize(
    ("width", "expected"),
    [(1.0, (0.2, "0.2 m")), (5.0, (1.0, "1 m")), (0.1, (0.02, "20 mm")), (500, (100.0, "100 m"))],
)
def test_scale_bar(width: float, expected: tuple[float, str]) -> None:
    length, text = scale_bar(frame((0, 0, width / 1.1, width / 1.1), 6.0))
    assert (length, text) == (pytest.approx(expected[0]), expected[1])


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_labels_hide_no_link_and_no_label(path) -> None:
    mech = robodyn.load(path)
    drawn = drawing(mech, posed(mech, 1.0 + 0.9 * np.arange(mech.n)))
    shown = frame(drawn.box(), 6.0, None, 0.3)
    boxes = [complex(0.6 * len(name), 1) * 9 / 72 * shown.scale for name in mech.link_names]
    places = label_places(drawn, 0, boxes, shown, np.zeros(0, complex))
    for k, (place, box) in enumerate(zip(places, boxes, strict=True)):
        assert shown.left < place.real - box.real / 2 < place.real + box.real / 2 < shown.right
        assert shown.bottom < place.imag - box.imag / 2 < place.imag + box.imag / 2 < shown.top
        for _, shape, z in drawn.placed(0):
            if shape.kind in ("link", "block", "support"):
                ends = zip(z, np.roll(z, -1), strict=True)
                dense = np.concatenate([np.linspace(a, b, 60) for a, b in ends])
                hidden = (np.abs(dense.real - place.real) < box.real / 2) & (
                    np.abs(dense.imag - place.imag) < box.imag / 2
                )
                assert not hidden.any()
        for other, wide in list(zip(places, boxes, strict=True))[:k]:
            apart, sizes = place - other, (box + wide) / 2
            assert abs(apart.real) >= sizes.real or abs(apart.imag) >= sizes.imag


def test_texts_of_arrows_stand_at_their_heads() -> None:
    shown = frame((0, 0, 10, 10), 6.0)
    arrows = [(5 + 5j, 7 + 5j), (5 + 5j, 5 + 7j), (5 + 5j, 7 + 5.1j)]
    boxes = [complex(1.5, 0.4)] * 3
    places = head_places(arrows, boxes, np.zeros(0, complex), shown)
    assert abs(places[0] - 7.91 - 5j) < 0.01
    for (_, head), place in zip(arrows, places, strict=True):
        assert abs(place - head) < 2.2
    for k, place in enumerate(places):
        for other in places[:k]:
            assert abs((place - other).real) >= 1.5 or abs((place - other).imag) >= 0.4


def test_the_first_free_place_is_taken() -> None:
    shown = frame((0, 0, 10, 10), 6.0)
    candidates = [2 + 2j, 5 + 5j, 8 + 8j, 20 + 20j]
    points = np.array([2.1 + 2j])
    assert free_place(candidates, 1 + 1j, points, [], shown) == 5 + 5j
    assert free_place(candidates, 1 + 1j, points, [(5.2 + 5j, 1 + 1j)], shown) == 8 + 8j
    assert free_place(candidates[3:] + candidates[:1], 1 + 1j, points, [], shown) == 2 + 2j


@pytest.mark.parametrize("length", [0.3, 1.0, 5.0])
def test_the_zigzag_of_a_spring_is_even_and_steep(length: float) -> None:
    text = (
        "links: [{name: a, joint: prismatic, axis: [1, 0], m: 1, l: 0.1, r: 0, I: 0}]\n"
        "springs: [{joint: a, stiffness: 30, length: 0.1}]\n"
    )
    drawn = drawing(scene(text), [length])
    (coil,) = shapes_of(drawn, "spring")
    teeth = coil[np.abs(coil.imag) > 0.5 * drawn.half_width]
    assert np.allclose(np.abs(teeth.imag), drawn.half_width)
    assert (np.diff(np.sign(teeth.imag)) != 0).all()
    apart = np.diff(teeth.real)
    assert np.allclose(apart, apart[0])
    assert apart[0] < 1.2 * drawn.half_width or len(teeth) == 8
    assert coil[1] - coil[0] == pytest.approx(coil[-1] - coil[-2])


def test_no_centre_line_runs_along_a_spring() -> None:
    mech = robodyn.load(ROOT / "robots/spring-slider-crank.yaml")
    assert not shapes_of(drawing(mech, first_pose(mech, t=0.0)), "axis")
    mech = robodyn.load(ROOT / "robots/slider-crank.yaml")
    assert shapes_of(drawing(mech, first_pose(mech, t=0.0)), "axis")


@pytest.mark.parametrize("at", [[0.44, -0.14], [0.3, 0.3], [-0.2, 0.1]])
def test_the_name_of_a_point_stands_within_the_picture(at: list[float]) -> None:
    mech = scene(
        "links: [{name: arm, m: 1, l: 0.3, r: 0.1, I: 0.01}]\n"
        f"points: {{the-far-point: {{link: arm, at: {at}}}}}\n"
    )
    figure = robodyn.draw(mech, [0.0], of=["the-far-point"])
    (text,) = [x for x in figure.axes[0].texts if x.get_text() == "the-far-point"]
    shown, whole = text.get_window_extent(), figure.bbox
    assert (shown.min >= whole.min).all()
    assert (shown.max <= whole.max).all()


# Couplings, and points that are marked


@pytest.mark.parametrize(
    ("name", "coupling", "expected"),
    [
        # gears touch: 0.62 m apart, 2 : 1; pulleys are half as large together
        ("geared-five-bar", None, {0.0: 0.62 * 2 / 3, 0.62: 0.62 / 3}),
        ("geared-five-bar", "q3 = 2 q1 + 110deg", {0.0: 0.62 / 3, 0.62: 0.62 / 6}),
        ("geared-five-bar", "q3 = 110deg", {}),
        ("rack-gripper", None, {0.0: 0.02}),  # 50 rad/m
        ("rack-gripper", "q1 = 0.02 q2", {0.0: 0.02}),
        ("rack-gripper", "q1 = 20 q2", {}),  # 20 m, which would dwarf the gripper
        ("rack-gripper", "q3 = -q2", {}),  # of which one joint is on a link
    ],
)
def test_wheels_of_couplings_between_joints_of_the_ground(
    name: str, coupling: str | None, expected: dict[float, float]
) -> None:
    text = (ROOT / f"robots/{name}.yaml").read_text()
    if coupling is not None:
        text = re.sub(r"couplings:.*\n(  - .*\n)*", f'couplings: ["{coupling}"]\n', text)
        text = re.sub("actuated:.*", "", text)
    mech = build(from_text(text, "x.yaml"))
    pose = np.zeros(mech.n)
    found = {}
    for z in shapes_of(drawing(mech, pose), "wheel"):
        centre = z.mean()
        assert np.abs(z - centre) == pytest.approx(abs(z[0] - centre))
        found[round(centre.real, 9)] = abs(z[0] - centre)
    assert found == pytest.approx(expected)


def test_a_marked_point_is_joined_to_its_link() -> None:
    """The coupler's outline holds it, as it does a point with a name in the scene."""
    mech = robodyn.load(ROOT / "robots/four-bar.yaml")
    pose = robodyn.assemble(mech, [1.0])
    named = named_points(mech, ["P=coupler@0.5,0.2", "tip1"])
    plain, joined = (shapes_of(drawing(mech, pose, x), "link") for x in ((), named))
    text = (ROOT / "robots/four-bar.yaml").read_text() + 'points: {P: "coupler@0.5,0.2"}\n'
    same = shapes_of(drawing(build(from_text(text, "x.yaml")), pose), "link")
    assert all(map(np.array_equal, joined, same))
    (k,) = (k for k in range(3) if not np.array_equal(plain[k], joined[k]))
    place = traced(mech, named, pose[None])[0].path[0]
    w = drawing(mech, pose).half_width
    assert np.abs(joined[k] - place).min() == pytest.approx(w, rel=1e-6)
    assert np.abs(plain[k] - place).min() > 2.0 * w


# Forces as arrows, against statics by hand and the sums that must vanish.


def found_at(name: str, q, qd=None, qdd=None):
    mech = robodyn.load(ROOT / f"robots/{name}.yaml")
    q = robodyn.assemble(mech, q) if mech.rows else np.array(q)
    zero = np.zeros(mech.n)
    qd, qdd = zero if qd is None else np.array(qd), zero if qdd is None else np.array(qdd)
    solution = dynamics.inverse_dynamics_and_forces(mech, q, qd, qdd)
    return mech, forces(mech, q, qd, qdd, solution.multipliers)


def test_a_pendulum_at_rest() -> None:
    mech, found = found_at("pendulum", [-1.0])
    weight = mech.description.links[0].m * 9.81
    assert [(f.kind, f.name) for f in found] == [("gravity", "m1 g"), ("pin", "r1")]
    assert found[0].force == pytest.approx(-1j * weight)
    assert found[0].place == pytest.approx(0.26 * np.exp(-1j))
    assert found[1].force == pytest.approx(1j * weight)
    assert found[1].place == 0


def test_a_spinning_pendulum_is_held_towards_its_pivot() -> None:
    mech, found = found_at("pendulum", [0.5], [40.0])
    link = mech.description.links[0]
    pull = found[1].force + found[0].force  # with the weight: m times the acceleration
    assert pull == pytest.approx(-link.m * link.r.real * 40.0**2 * np.exp(0.5j))


@each("seed", range(6))
@each("shape", ["four-bar", "slider-crank", "five-bar", "loop in a tree"])
def test_all_forces_on_a_link_make_its_acceleration(seed: int, shape: str) -> None:
    """Of a link that carries nothing but closures: gravity, its joint and its pins."""
    scene = seeded_scene(seed, LOOPS[shape])
    mech = scene.mechanism
    q, qd, qdd = scene.states
    multipliers = dynamics.inverse_dynamics_and_forces(mech, q, qd, qdd).multipliers
    found = {f.name: f for f in forces(mech, q, qd, qdd, multipliers)}
    links = mech.description.links
    pose = Pose(oracle_tree(mech.description), q)
    checked = 0
    for k, link in enumerate(links):
        if any(other.hangs_from.link == k for other in links):
            continue
        total = found[f"r{k + 1}"].force
        inertia = 0j
        for mass, at, name in (
            (link.m, link.r, f"m{k + 1} g"),
            (link.payload, complex(link.l), f"payload {k + 1} g"),
        ):
            if mass:
                place = (k, at)
                assert found[name].place == pytest.approx(pose.position(place))
                total += found[name].force
                inertia += mass * (pose.slope(place) @ qdd + pose.bias(place, qd))
        for c, closure in enumerate(mech.description.closures):
            if closure.first.link == k:
                total += found[f"f{c + 1}"].force
                at_pin = pose.position((k, closure.first.at))
                assert found[f"f{c + 1}"].place == pytest.approx(at_pin)
            elif closure.second.link == k:
                total -= found[f"f{c + 1}"].force
        assert abs(total - inertia) < 1e-9 * (1 + abs(inertia))
        checked += 1
    assert checked


@pytest.mark.parametrize("seed", range(4))
def test_springs_and_loads(seed: int) -> None:
    scene = forced(seed, seeded_tree(seed, 3))
    mech, (q, qd, qdd) = scene.mechanism, scene.states
    found = {f.name: f for f in forces(mech, q, qd, qdd, np.zeros(0))}
    pose = Pose(oracle_tree(mech.description), q)
    shown = 0
    for k, spring in enumerate(mech.description.springs, start=1):
        if not isinstance(spring, PointSpring):
            assert f"s{k}" not in found
            continue
        ends = [(p.link, p.at) for p in (spring.first, spring.second)]
        d = pose.position(ends[0]) - pose.position(ends[1])
        rate = (np.conj(d) * ((pose.slope(ends[0]) - pose.slope(ends[1])) @ qd)).real / abs(d)
        pull = spring.stiffness * (abs(d) - spring.length) + spring.damping * rate
        assert found[f"s{k}"].force == pytest.approx(-pull * d / abs(d))
        assert found[f"s{k}"].place == pytest.approx(pose.position(ends[0]))
        shown += 1
    for k, item in enumerate(mech.description.loads, start=1):
        if not isinstance(item, LoadForce):
            assert f"load {k}" not in found
            continue
        turned = np.exp(1j * pose.alpha[item.point.link]) if item.turns else 1.0
        assert found[f"load {k}"].force == pytest.approx(item.force * turned)
        place = pose.position((item.point.link, item.point.at))
        assert found[f"load {k}"].place == pytest.approx(place)
        shown += 1
    assert shown >= 2


def test_forces_that_vanish_have_no_arrow() -> None:
    _, found = found_at("pendulum", [0.3])
    floating = mechanism.build(
        description.from_text("links: [{name: a, m: 1, l: 1, r: 0.5, I: 1}]", "x.yaml")
    )
    zero = np.zeros(1)
    assert forces(floating, zero, zero, zero, np.zeros(0)) == []
    scale = metres_a_newton(found, 0.5)
    assert max(abs(f.force) for f in found) * scale == pytest.approx(LONGEST * 0.5)


def test_an_arrow_that_would_lie_on_another_ends_where_it_acts() -> None:
    mech = robodyn.load(ROOT / "robots/four-bar.yaml")
    q = robodyn.assemble(mech, [np.pi / 3])
    qd = robodyn.loop_velocities(mech, q, [5.0])
    _, found = found_at("four-bar", [np.pi / 3], qd, robodyn.loop_accelerations(mech, q, qd, [0.0]))
    placed = dict(zip([f.name for f in found], arrows(found, 0.02), strict=True))
    force = {f.name: f for f in found}
    assert placed["m3 g"][0] == force["m3 g"].place
    assert placed["r3"][1] == force["r3"].place
    for name, (tail, head) in placed.items():
        assert head - tail == pytest.approx(0.02 * force[name].force)
        assert force[name].place in (tail, head)


def test_driving_torques() -> None:
    """Of a joint that turns an arc; of one that slides a force along it, of its weight here."""
    mech = robodyn.load(ROOT / "robots/rp-arm.yaml")
    q, rest = np.array([0.5, 0.3]), np.zeros(2)
    found = {f.name: f for f in forces_at(mech, q, rest, t=0.0)}
    weights = found["m1 g"], found["m2 g"]
    moment = -sum((f.place.conjugate() * f.force).imag for f in weights)
    assert (found["tau1"].kind, found["tau1"].force, found["tau1"].place) == ("drive", 0, 0)
    assert found["tau1"].torque == pytest.approx(moment)
    along = np.exp(0.5j)
    assert found["tau2"].torque == 0.0
    expected = -(found["m2 g"].force * along.conjugate()).real * along
    assert found["tau2"].force == pytest.approx(expected)
    given = {f.name: f for f in forces_at(mech, q, rest, tau=np.array([-3.0, 0.0]), t=0.0)}
    assert (given["tau1"].torque, "tau2" in given) == (-3.0, False)


def test_an_arc_turns_as_its_torque() -> None:
    for torque in (2.0, -2.0):
        z = arc(Force("drive", "tau1", 1 + 2j, 0j, torque), 0.5) - (1 + 2j)
        assert np.abs(z) == pytest.approx(0.5)
        assert (np.sign(torque) * np.angle(z[1:] / z[:-1]) > 0.0).all()


def test_no_force_at_all() -> None:
    text = "gravity: 0\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
    mech = mechanism.build(description.from_text(text, "x.yaml"))
    assert forces_at(mech, np.ones(1), np.zeros(1), t=0.0) == []


def test_prefixes() -> None:
    for value, text in (
        *((1149.6, "1.15 kN"), (999.4, "999 N"), (999.6, "1 kN"), (1e3, "1 kN"), (12.34, "12.3 N")),
        *((0.1, "0.1 N"), (0.0996, "99.6 mN"), (2.5e-5, "25 µN"), (3.21e7, "32.1 MN")),
        *((1e-3, "1 mN"), (1e6, "1 MN"), (4e15, "4e+15 N"), (4e-12, "4e-12 N")),
    ):
        assert with_prefix(value, "N") == text
