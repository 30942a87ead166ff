"""Reference motions: through their points, continuous, closed, along one branch."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT
from each_case import each
from named_case import case

import oracles
import robodyn
from random_mechanisms import LOOPS, mechanism, seeded_scene, seeded_tree
from robodyn import load
from robodyn.errors import AssemblyError, InputError
from robodyn.loops.closures import closure_bias, closure_gap, closure_jacobian
from robodyn.mechanics.mechanism import Mechanism
from robodyn.trajectories import joint_paths
from robodyn.trajectories.joint_paths import (
    ConstantSpeed,
    Profile,
    Sweep,
    path_through,
    piece_at,
    profile,
)
from robodyn.trajectories.loop_path import LoopPath, TravelError, WholePath
from robodyn.trajectories.reference import (
    ReferenceMotion,
    all_joints,
    motion_along,
    reference_motion,
)

ARM = robodyn.load(ROOT / "robots/2r.yaml")
BAR = robodyn.load(ROOT / "robots/four-bar.yaml")
FIVE = robodyn.load(ROOT / "robots/five-bar.yaml")
PROFILES = ("cubic", "quintic", "trapezoidal", "cycloidal")
every_profile = pytest.mark.parametrize("profile", PROFILES)


def turning(mech: Mechanism, begin: float, turns: float = 1.0) -> ReferenceMotion:
    """A crank at constant speed, a turn a second."""
    path = ConstantSpeed(np.array([begin]), np.array([2 * np.pi * turns]))
    return motion_along(mech, path, all_joints(mech, [[begin]]), abs(turns))


def quadrature(motion: ReferenceMotion, piece: int) -> tuple[np.ndarray, np.ndarray]:
    """What q and qd gain over a piece of the path, and by the integrals of qd and qdd, (2, n)."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    ends = motion.path.path.breaks[piece : piece + 2]
    half, T = 0.5 * (ends[1] - ends[0]), motion.duration
    of = np.full(len(nodes), piece)
    _, rate, bend = motion.path.evaluate(ends[0] + half * (1 + nodes), of)
    q, q1, _ = motion.path.evaluate(ends, of[:2])
    gained = np.array([q[1] - q[0], (q1[1] - q1[0]) / T])
    return gained, np.array([half * weights @ rate, half * weights @ bend / T])


# Open chains


@every_profile
def test_rest_to_rest(profile: str) -> None:
    ends = np.array([[0.3, -1.1], [1.7, 0.4]])
    motion = reference_motion(ARM, ends, 2.5, profile=profile)
    q, qd, qdd = motion.states([0.0, 1.25, 2.5])
    assert np.array_equal(q[[0, 2]], ends)
    assert q[1] == pytest.approx(ends.mean(axis=0), rel=1e-15)
    assert not qd[[0, 2]].any()
    peak = {"cubic": 1.5, "quintic": 1.875, "trapezoidal": 1.5, "cycloidal": 2.0}[profile]
    assert qd[1] == pytest.approx(peak * (ends[1] - ends[0]) / 2.5, rel=1e-14)
    assert np.abs(qdd[1]).max() < 1e-14


@every_profile
@pytest.mark.parametrize("times", [None, [0.5, 1.0, 2.5, 2.75, 4.0]])
def test_through_points(profile: str, times: list[float] | None) -> None:
    points = np.random.default_rng(1).uniform(-2, 2, (5, 2))
    duration = 3.5 if times is None else None
    motion = reference_motion(ARM, points, duration, times=times, profile=profile)
    if times is None:
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        times = [0.0, *(3.5 * np.cumsum(steps) / steps.sum()).tolist()]
        times[-1] = 3.5
    assert (motion.begin, motion.end) == (times[0], times[-1])
    q, qd, qdd = motion.states(times)
    assert np.abs(q - points).max() < 1e-14
    assert np.array_equal(q[[0, -1]], points[[0, -1]])
    assert not qd[[0, -1]].any()
    if profile in ("trapezoidal", "cycloidal"):
        assert np.abs(qd).max() < 1e-13  # at rest at each point
    else:
        assert np.abs(qd[1:-1]).min() > 1e-3
    if profile == "quintic":
        assert not qdd[[0, -1]].any()


@every_profile
def test_qd_and_qdd_are_the_derivatives(profile: str) -> None:
    points = np.random.default_rng(2).uniform(-2, 2, (4, 2))
    motion = reference_motion(ARM, points, 2.0, profile=profile)
    for piece in range(len(motion.path.path.breaks) - 1):
        gained, integral = quadrature(motion, piece)
        assert np.abs(gained - integral).max() < 1e-12


@every_profile
def test_what_is_continuous_at_the_breaks(profile: str) -> None:
    """q and qd; and qdd but for a trapezoid's, and a cubic's at its ends."""
    points = np.random.default_rng(3).uniform(-2, 2, (4, 2))
    motion = reference_motion(ARM, points, 2.0, profile=profile)
    inner = motion.path.path.breaks[1:-1]
    k = np.arange(len(inner))
    before, after = (motion.path.evaluate(inner, piece) for piece in (k, k + 1))
    for order, (one, other) in enumerate(zip(before, after, strict=True)):
        if order < 2 or profile != "trapezoidal":
            assert np.abs(one - other).max() < 1e-12 * max(1.0, np.abs(one).max())


def test_a_dwell_between_equal_points_needs_times() -> None:
    points = [[0.0, 0.0], [1.0, 1.0], [1.0, 1.0], [0.0, 0.5]]
    with pytest.raises(InputError, match="points 2 and 3: are the same"):
        reference_motion(ARM, points, 1.0)
    motion = reference_motion(ARM, points, times=[0, 1, 2, 3], profile="cycloidal")
    q, qd, qdd = motion.states(np.linspace(1, 2, 11))
    assert (q == 1.0).all()
    assert np.abs(qd).max() == 0.0
    assert np.abs(qdd[:-1]).max() < 1e-13


def test_a_sweep_is_a_chirp_with_its_derivatives() -> None:
    """In place of the formula: its phase by quadrature of the frequency, and finite differences."""
    pose, amplitude, T = np.array([0.4, -0.7]), np.array([0.1, 0.25]), 3.0
    path = Sweep(pose, amplitude, 0.5, 4.0, T)
    motion = motion_along(ARM, path, pose[None], T)
    t = np.linspace(0, T, 2001)
    q, qd, qdd = motion.states(t)
    phase = 2 * np.pi * (0.5 * t + 3.5 * t**2 / (2 * T))
    assert np.abs(q - pose - amplitude * np.sin(phase)[:, None]).max() < 1e-13
    h = 1e-4
    inner = t[1:-1]
    sides = [motion.states(inner + k * h) for k in (-2, -1, 1, 2)]
    for low, values in ((0, qd), (1, qdd)):
        a, b, c, d = (side[low] for side in sides)
        slope = (a - 8 * b + 8 * c - d) / (12 * h)
        assert np.abs(slope - values[1:-1]).max() < 1e-7 * np.abs(values).max()
    crossings = np.abs(np.sin(2 * np.pi * T * (0.5 + 1.75 * path.breaks[:-1]) * path.breaks[:-1]))
    assert crossings.max() < 1e-12


def test_constant_speed() -> None:
    motion = motion_along(
        ARM, ConstantSpeed(np.zeros(2), np.array([3.0, -1.0])), np.zeros((1, 2)), 2
    )
    q, qd, qdd = motion.states(np.linspace(0, 2, 5))
    assert np.abs(qd - [1.5, -0.5]).max() < 1e-15
    assert not qdd.any()
    assert np.array_equal(q[-1], [3.0, -1.0])


@pytest.mark.parametrize("seed", range(3))
def test_a_tree_needs_no_loop(seed: int) -> None:
    mech = mechanism(seeded_tree(seed, 4).text)
    points = np.random.default_rng(seed).uniform(-2, 2, (3, 4))
    motion = reference_motion(mech, points, 1.0)
    assert np.array_equal(motion.states(1.0)[0], points[-1])


def test_states_of_any_shape() -> None:
    motion = reference_motion(ARM, [[0, 0], [1, 2]], 2.0)
    t = np.linspace(0, 2, 6)
    flat, square = motion.states(t), motion.states(t.reshape(2, 3))
    for one, other in zip(flat, square, strict=True):
        assert np.array_equal(one, other.reshape(6, 2))
    assert motion.states(0.7)[0].shape == (2,)


# Closed mechanisms


def assert_closed(motion: ReferenceMotion, t: np.ndarray, size: float = 1.0) -> None:
    """gap, Psi qd and Psi qdd + Psidot qd are zero to rounding."""
    mech = motion.mechanism
    q, qd, qdd = motion.states(t)
    Psi = closure_jacobian(mech, q, t=0.0)
    assert np.abs(closure_gap(mech, q, t=0.0)).max() < 1e-14 * size
    rates, turns = np.abs(qd).max(), np.abs(qdd).max()
    assert np.abs(np.einsum("tij,tj->ti", Psi, qd)).max() <= 1e-12 * size * rates
    bend = np.einsum("tij,tj->ti", Psi, qdd) + closure_bias(mech, q, qd, t=0.0)
    assert np.abs(bend).max() <= 1e-12 * size * (turns + rates**2)


@pytest.mark.parametrize("assembly", ["open", "crossed"])
@pytest.mark.parametrize("whole", [False, True])
def test_a_four_bar_turns_on_its_branch(assembly: str, whole: bool) -> None:
    """Against the triangles of trigonometry, at every angle of two turns."""
    text = (ROOT / "robots/four-bar.yaml").read_text()
    mech = BAR if whole else mechanism(text.replace("assembly: open", f"assembly: {assembly}"))
    start = oracles.four_bar_position(FOUR_BAR, 1.0, assembly)
    path = ConstantSpeed(np.array([1.0]), np.array([-4 * np.pi]))
    points = start[None] if whole else all_joints(mech, [[1.0]])
    motion = motion_along(mech, path, points, 2.0)
    t = np.linspace(0, 2, 501)
    q, qd, qdd = motion.states(t)
    known = [oracles.four_bar_position(FOUR_BAR, angle, assembly) for angle in q[:, 0]]
    assert np.abs(np.exp(1j * q) - np.exp(1j * np.array(known))).max() < 1e-13
    assert np.abs(np.diff(q, axis=0)).max() < 0.2
    for k in range(0, 501, 50):
        K, _ = oracles.four_bar_coefficients(FOUR_BAR, q[k])[:2]
        assert qd[k] == pytest.approx(K * qd[k, 0], rel=1e-12)
    assert not qdd[:, 0].any()
    assert_closed(motion, t, 2.0)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.thinned
def test_random_loops_stay_closed(name: str, seed: int) -> None:
    found = seeded_scene(seed, LOOPS[name])
    mech = mechanism(found.text)
    driven = list(mech.actuated)
    for way in (1.0, 0.3, 0.1, 0.03):
        points = np.array([found.q, np.full(mech.n, np.nan)])
        points[1, driven] = found.q[driven] + way
        try:
            path = path_through(points[:, driven], None, "trapezoidal")
            motion = motion_along(mech, path, points, 1.0)
        except AssemblyError:
            continue  # the branch ends before
        assert_closed(motion, np.linspace(0, 1, 301), 10.0)
        assert motion.states(0.0)[0] == pytest.approx(found.q, abs=1e-12)
        for piece in range(3):
            gained, integral = quadrature(motion, piece)
            assert np.abs(gained - integral).max() < 1e-7 * max(1.0, np.abs(gained).max())
        return
    pytest.fail("no way was short enough")


def test_angles_go_on_beyond_a_turn() -> None:
    q = turning(BAR, 0.0, 3.0).states(np.linspace(0, 3, 4))[0]
    assert q[:, 0] == pytest.approx(2 * np.pi * np.arange(4))
    assert q[:, 1] == pytest.approx(q[0, 1] - 2 * np.pi * np.arange(4))
    assert q[:, 2] == pytest.approx(np.full(4, q[0, 2]))


def test_where_the_loop_ends() -> None:
    """With the rocker's pivot at 1.9 m the crank ends where crank, coupler and rocker stretch."""
    text = (ROOT / "robots/four-bar.yaml").read_text().replace("[1.1, 0.0]", "[1.9, 0.0]")
    limit = math.acos((0.35**2 + 1.9**2 - 1.75**2) / (2 * 0.35 * 1.9))
    mech = mechanism(text)
    with pytest.raises(AssemblyError) as error:
        reference_motion(mech, [[0.0], [2.0]], 4.0, profile="cubic")
    told = str(error.value)
    s = limit / 2.0
    t = float(np.roots([-2, 3, 0, -s])[1].real) * 4.0  # s = 3 u^2 - 2 u^3
    assert f"t = {t:.6g} s" in told
    assert f"q1 (crank) = {limit:.6g} rad" in told
    reference_motion(mech, [[0.0], [limit - 1e-6]], 4.0, profile="cubic").states(4.0)


CHANGING = """\
links:
  - {{name: crank,   m: 0.45, l: {crank!r}, r: 0.14, I: 0.0041}}
  - {{name: coupler, m: 1.1,  l: 0.7, r: 0.36, I: 0.049}}
  - {{name: rocker,  m: 0.55, l: 0.3, r: 0.16, I: 0.0052, from: [0.7, 0.0]}}
closures: [[coupler, rocker]]
"""


def test_straight_across_a_change_point() -> None:
    """A parallelogram stays one: exact at every angle, the change points included."""
    motion = turning(mechanism(CHANGING.format(crank=0.3)), 0.3)
    # the crank is at pi, and at and about 2 pi
    t = [(np.pi - 0.3) / (2 * np.pi), 1 - 0.3 / (2 * np.pi), *np.linspace(0.9, 1.0, 501)]
    q, qd, qdd = motion.states(t)
    assert np.abs(q - q[:, :1] * [1, -1, 1]).max() < 1e-12
    assert np.abs(qd - 2 * np.pi * np.array([1, -1, 1])).max() < 1e-8
    assert np.abs(qdd).max() < 1e-5


@pytest.mark.parametrize("short", [1e-2, 1e-4, 1e-6, 1e-8])
def test_no_leap_to_a_branch_that_comes_near(short: float) -> None:
    """A crank that is a little shorter makes no change point: the branch folds sharply there."""
    mech = mechanism(CHANGING.format(crank=0.3 - short))
    motion = turning(mech, 0.3)
    t = np.linspace(0, 1, 2001)
    q, qd, _ = motion.states(t)
    known = robodyn.assemble(mech, q[:, :1])  # each closed by its own triangle, on the left
    assert np.abs(np.exp(1j * q) - np.exp(1j * known)).max() < 1e-7
    assert np.abs(qd).max() > 13
    assert np.abs(closure_gap(mech, q, t=0.0)).max() < 1e-14


def test_points_off_the_branch_are_refused() -> None:
    q = np.array([oracles.four_bar_position(FOUR_BAR, angle) for angle in (0.5, 1.0, 2.0)])
    motion = reference_motion(BAR, q, 1.0)
    assert np.abs(motion.states(1.0)[0] - q[-1]).max() < 1e-12
    q[1] = oracles.four_bar_position(FOUR_BAR, 1.0, "crossed")
    with pytest.raises(InputError, match=r"point 2: q2 \(coupler\) = -2\.1783.*on the branch of"):
        reference_motion(BAR, q, 1.0)
    q[0, 1] += 0.1
    with pytest.raises(InputError, match="loops are open"):
        reference_motion(BAR, q, 1.0)


def test_geared_joints_count_turns() -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    mech = mechanism(text + '\ncouplings: ["q2 = -20/37 q1"]\nactuated: [upper arm]\n')
    motion = motion_along(
        mech, ConstantSpeed(np.zeros(1), np.array([74 * np.pi])), all_joints(mech, [[0.0]]), 1.0
    )
    q, qd, _ = motion.states([0.0, 0.5, 1.0])
    assert q[:, 1] == pytest.approx([0.0, -20 * np.pi, -40 * np.pi], rel=1e-14)
    assert qd[:, 1] == pytest.approx(np.full(3, -40 * np.pi), rel=1e-14)


# Many turns


GEARS = (ROOT / "robots/geared-five-bar.yaml").read_text()


@pytest.mark.parametrize(
    ("text", "begin", "after"),
    [
        ((ROOT / "robots/four-bar.yaml").read_text(), 0.0, 1),
        ((ROOT / "robots/watt-six-bar.yaml").read_text(), 0.0, 1),
        ((ROOT / "robots/slider-crank.yaml").read_text(), 0.5, 1),
        (GEARS, 1.3, 1),
        (GEARS.replace("-2 q1", "-5/3 q1"), 1.3, 3),
        (GEARS.replace("-2 q1", "-1.41421 q1"), 1.3, None),
    ],
)
@pytest.mark.parametrize("turns", [12.0, -12.3])
@pytest.mark.thinned
def test_a_turn_that_repeats_itself_is_followed_once(
    text: str, begin: float, after: int | None, turns: float
) -> None:
    mech = mechanism(text)
    motion = turning(mech, begin, turns)
    once = turning(mech, begin, math.copysign(after or 12.3, turns))
    assert isinstance(motion.path, LoopPath)
    assert isinstance(once.path, LoopPath)
    assert len(motion.path._nodes.u) < 1.1 * len(once.path._nodes.u) + 20
    t = np.linspace(0.0, abs(turns), 401)
    assert_closed(motion, t, abs(turns))
    if after:
        q, qd, qdd = motion.states(t)
        _, known, bend = once.states(np.clip(t % after, 0.0, after))
        assert qd == pytest.approx(known, abs=1e-9 * np.abs(known).max())
        assert qdd == pytest.approx(bend, abs=1e-9 * np.abs(bend).max())
        first = once.states(after)[0] - once.states(0.0)[0]
        assert motion.states(9.0)[0] - q[0] == pytest.approx(9 / after * first, rel=1e-12)
    assert np.abs(np.diff(q if after else motion.states(t)[0], axis=0)).max() < 2.0


@pytest.mark.parametrize("begin", [math.radians(60), math.radians(179.9), -1e-3, 1e-3])
@pytest.mark.parametrize("turns", [15.0, -15.25])
@pytest.mark.thinned
def test_a_parallelogram_stays_one_for_many_turns(begin: float, turns: float) -> None:
    """Through two change points a turn, near the turn's end too."""
    mech = mechanism((ROOT / "robots/parallelogram.yaml").read_text())
    start = np.array([begin, -begin, begin])
    path = ConstantSpeed(start[:1], np.array([2 * np.pi * turns]))
    motion = motion_along(mech, path, start[None], abs(turns))
    near = np.arange(0.0, abs(turns), 0.5) + np.linspace(-1e-3, 1e-3, 41)[:, None]
    t = np.clip(near + (-begin / (2 * np.pi * np.sign(turns))), 0.0, abs(turns)).reshape(-1)
    for times in (t, np.linspace(0.0, abs(turns), 1501)):
        q, qd, qdd = motion.states(times)
        assert np.abs(q[:, 2] - q[:, 0]).max() < 1e-9
        assert np.abs(qd[:, 2] - qd[:, 0]).max() < 1e-8 * 2 * np.pi
        assert np.abs(qdd[:, 2]).max() < 1e-7 * (2 * np.pi) ** 2


def test_two_cranks_repeat_themselves_after_their_common_turns() -> None:
    begin = np.radians([120, 60])
    points = all_joints(FIVE, begin[None])
    for ratio, after in ((0.5, 2), (-2 / 3, 3), (1 / math.sqrt(3), None)):
        path = ConstantSpeed(begin, 2 * np.pi * 12 * np.array([1.0, ratio]))
        motion = motion_along(FIVE, path, points, 12.0)
        assert isinstance(motion.path, LoopPath)
        assert motion.path._nodes.period == pytest.approx((after or 12) / 12)
        assert_closed(motion, np.linspace(0, 12, 201), 12.0)


@pytest.mark.parametrize(
    ("way", "told"),
    [
        ([2e9], "at most 1e.09 rad"),
        ([1e7, 1e7 / math.sqrt(3)], "more than the 500,000 closed states .* does not repeat"),
        ([45_000.0, 45_000.0 / math.sqrt(3)], "500,000 closed states .* does not repeat"),
    ],
)
def test_a_motion_that_is_too_long_is_refused_at_once(way: list[float], told: str) -> None:
    mech, begin = (BAR, [1.0]) if len(way) == 1 else (FIVE, np.radians([120, 60]))
    path = ConstantSpeed(np.array(begin), np.array(way))
    heard: list[float] = []
    with pytest.raises(TravelError, match=told):
        motion_along(mech, path, all_joints(mech, [begin]), 1.0, watch=heard.append)
    assert len(heard) < 5000
    assert heard == sorted(heard)


def test_two_cranks_of_a_five_bar() -> None:
    motion = reference_motion(FIVE, np.radians([[120, 60], [200, 10], [80, 100]]), 2.0)
    assert_closed(motion, np.linspace(0, 2, 401), 2.0)
    assert np.degrees(motion.states(2.0)[0][[0, 2]]) == pytest.approx([80, 100])


# Errors


def test_joints_that_nothing_drives_are_named(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text((ROOT / "robots/2r.yaml").read_text() + "\nactuated: [upper arm]\n")
    with pytest.raises(InputError, match=r"do not determine q2 \(forearm\).*2 freedoms"):
        reference_motion(robodyn.load(scene), [[0.0], [1.0]], 1.0)


def test_more_actuators_than_freedoms_are_told() -> None:
    text = (ROOT / "robots/four-bar.yaml").read_text()
    mech = mechanism(text.replace("actuated: [crank]", "actuated: [crank, rocker]"))
    q = oracles.four_bar_position(FOUR_BAR, 1.0)
    points = np.array([q, [1.5, np.nan, q[2]]])
    path = path_through(points[:, [0, 2]], None, "quintic")
    with pytest.raises(AssemblyError, match="depend on one another"):
        motion_along(mech, path, points, 1.0)


def test_a_start_at_a_change_point_is_singular() -> None:
    mech = mechanism(CHANGING.format(crank=0.3))
    with pytest.raises(AssemblyError, match=r"t = 0 s.*change point.*two ways"):
        turning(mech, 0.0)


def test_neither_to_nor_from_a_dead_centre() -> None:
    """Where crank and coupler are in line the rocker cannot drive them: infinitely fast before."""
    text = (ROOT / "robots/four-bar.yaml").read_text()
    mech = mechanism(text.replace("actuated: [crank]", "actuated: [rocker]"))
    # crank and coupler stretched: the rocker's angle by the cosine rule
    end = math.pi - math.acos((1.1**2 + 0.8**2 - 1.3**2) / (2 * 1.1 * 0.8))
    with pytest.raises(AssemblyError, match=r"t = 0\.99.* q3 \(rocker\) = 1\.66183 rad"):
        reference_motion(mech, [[end + 0.4], [end]], 1.0)
    with pytest.raises(AssemblyError, match=r"t = 0 s.*dead centre.*two ways"):
        reference_motion(mech, [[end], [end + 0.4]], 1.0)


@each(
    ("arguments", "told"),
    [
        ({"points": [[0, 0], [1, 1]]}, "duration and times"),
        ({"points": [[0, 0], [1, 1]], "duration": 1.0, "times": [0, 1]}, "duration and times"),
        ({"points": [[0, 0], [1, 1]], "duration": 0.0}, "duration = 0"),
        ({"points": [[0, 0], [1, 1]], "duration": math.nan}, "duration = nan"),
        ({"points": [[0, 0]], "duration": 1.0}, "two points"),
        ({"points": [[0, 0, 0], [1, 1, 1]], "duration": 1.0}, r"points\.shape"),
        ({"points": [[0, math.nan], [1, 1]], "duration": 1.0}, "points: must be finite"),
        ({"points": [[0, 0], [1, 1]], "times": [1, 1]}, "times = 1, 1: must be finite and inc"),
        ({"points": [[0, 0], [1, 1]], "duration": 1.0, "profile": "x"}, "profile = x"),
        ({"points": [[0, 0], [1, 1]], "duration": 1.0, "natural": True}, "ends = natural"),
    ],
)
def test_arguments_that_do_not_fit(arguments: dict, told: str) -> None:
    with pytest.raises(InputError, match=told):
        reference_motion(ARM, **arguments)


def test_times_outside_of_the_motion_are_refused() -> None:
    motion = reference_motion(ARM, [[0, 0], [1, 1]], times=[1.0, 2.0])
    for t in (0.99, 2.01, math.nan):
        with pytest.raises(InputError, match="from 1 to 2 s"):
            motion.states(t)


def test_a_break_belongs_to_the_piece_after_it() -> None:
    breaks = np.array([0.0, 0.25, 0.5, 1.0])
    assert piece_at(breaks, np.array([0.0, 0.25, 0.3, 0.5, 1.0])).tolist() == [0, 1, 1, 2, 2]
    assert isinstance(turning(BAR, 0.0).path, LoopPath)


@each("times", [[0, 1], [0, 1, 2, 3], [], [[0, 1, 2]]])
@each("name", ["cubic", "quintic", "trapezoidal", "cycloidal"])
def test_times_are_one_a_point(times: list, name: str) -> None:
    with pytest.raises(InputError, match=r"times\.shape"):
        reference_motion(ARM, [[0, 0], [1, 0], [1, 1]], times=times, profile=name)


@pytest.mark.parametrize("before", [0.1, 0.03, 0.01, 1e-3])
def test_a_start_just_before_a_change_point(before: float) -> None:
    """A parallelogram stays one, however little room there is on one side."""
    mech = robodyn.load(ROOT / "robots/parallelogram.yaml")
    motion = reference_motion(mech, [[np.pi - before], [4.0]], duration=2.0)
    q, _, qdd = motion.states(np.linspace(0.0, 2.0, 401))
    assert np.abs(q[:, 2] - q[:, 0]).max() < 1e-10
    assert np.abs(qdd[:, 2] - qdd[:, 0]).max() < 1e-9 * np.abs(qdd).max()


# Profiles of rest-to-rest motions: their ends, integrals, symmetry and peaks.


PARTS = (0.05, 0.25, 1 / 3, 0.5)
AT_REST = [
    *(profile(name) for name in ("cubic", "quintic", "cycloidal")),
    *(profile("trapezoidal", part) for part in PARTS),
]
each_profile = pytest.mark.parametrize(
    "shape", AT_REST, ids=lambda shape: f"{shape.name}-{len(shape.breaks)}"
)


def values(shape: Profile, piece: int, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """s, s', s'' at u of one piece."""
    late, s, rate, acceleration = shape.evaluate(u, 1 - u, np.full(len(u), piece))
    return np.where(late, 1 - s, s), rate, acceleration


def pieces(shape: Profile, count: int) -> list[tuple[int, np.ndarray]]:
    ends = zip(shape.breaks[:-1], shape.breaks[1:], strict=True)
    return [(k, np.linspace(a, b, count)) for k, (a, b) in enumerate(ends)]


@each_profile
def test_it_goes_from_rest_at_0_to_rest_at_1_exactly(shape: Profile) -> None:
    last = len(shape.breaks) - 2
    s, rate, acceleration = values(shape, 0, np.zeros(1))
    assert (s[0], rate[0]) == (0.0, 0.0)
    s, rate, final = values(shape, last, np.ones(1))
    assert (s[0], rate[0]) == (1.0, 0.0)
    assert final[0] == -acceleration[0]
    if shape.name in ("quintic", "cycloidal"):
        assert acceleration[0] == final[0] == 0.0


@each_profile
def test_rate_and_acceleration_are_the_derivatives(shape: Profile) -> None:
    """By Gauss's quadrature from each piece's beginning."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for k, u in pieces(shape, 17):
        s, rate, _ = values(shape, k, u)
        for end in range(1, len(u)):
            half = 0.5 * (u[end] - u[0])
            _, rates, accelerations = values(shape, k, u[0] + half * (1 + nodes))
            assert s[end] - s[0] == pytest.approx(half * weights @ rates, abs=1e-15, rel=1e-14)
            gained = half * weights @ accelerations
            assert rate[end] - rate[0] == pytest.approx(gained, abs=1e-14, rel=1e-13)


@each_profile
def test_s_and_its_rate_are_continuous(shape: Profile) -> None:
    for k, at in enumerate(shape.breaks[1:-1]):
        u = np.array([at])
        before, after = values(shape, k, u), values(shape, k + 1, u)
        assert before[0] == pytest.approx(after[0], rel=1e-15)
        assert before[1] == pytest.approx(after[1], rel=1e-15)
        assert before[2] != after[2]  # the corner of a trapezoid


@each_profile
def test_it_is_symmetric_and_rises(shape: Profile) -> None:
    for k, u in pieces(shape, 101):
        s, rate, acceleration = values(shape, k, u)
        mirrored = values(shape, len(shape.breaks) - 2 - k, 1 - u)
        assert np.allclose(s, 1 - mirrored[0], rtol=0, atol=1e-15)
        assert np.allclose(rate, mirrored[1], rtol=0, atol=1e-14)
        assert np.allclose(acceleration, -mirrored[2], rtol=0, atol=1e-13 * 40)
        assert (np.diff(s) > 0).all()
        assert (rate >= 0).all()


def test_peaks_of_the_textbooks() -> None:
    mechanism = load("robots/pendulum.yaml")
    for name, part, rate, acceleration in (
        ("cubic", 1 / 3, 1.5, 6.0),
        ("quintic", 1 / 3, 1.875, 10 / math.sqrt(3)),
        ("cycloidal", 1 / 3, 2.0, 2 * math.pi),
        ("trapezoidal", 0.25, 4 / 3, 16 / 3),
        ("trapezoidal", 0.5, 2.0, 4.0),
        ("trapezoidal", 1 / 3, 1.5, 4.5),
        ("constant", 1 / 3, 1.0, 0.0),
    ):
        with case(name, part):
            path = path_through(np.array([[0.0], [1.0]]), None, name, part)
            peaks = WholePath(mechanism, path).peaks()
            assert peaks[:, 0] == pytest.approx([rate, acceleration], rel=1e-14)


@pytest.mark.parametrize("part", [0.0, -0.1, 0.51, math.nan, math.inf])
def test_a_part_that_is_none_is_refused(part: float) -> None:
    with pytest.raises(InputError, match=r"acceleration = .*> 0 and <= 0\.5"):
        profile("trapezoidal", part)


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="must be one of cubic, quintic"):
        profile("linear")


# Splines against their conditions, and the largest values of paths.


def draw(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Knots whose steps differ by a factor of up to 100, and points of three joints."""
    rng = np.random.default_rng(seed)
    return np.cumsum(10 ** rng.uniform(-2, 0, count)), rng.normal(size=(count, 3))


def close(found: np.ndarray, known: np.ndarray, rtol: float) -> bool:
    return bool(np.abs(found - known).max() <= rtol * max(1.0, np.abs(known).max()))


def test_smoothness_and_ends() -> None:
    """It goes through the points, is C2 or C4 at the inner ones, and rests at its ends."""
    for kind in ["cubic", "quintic"]:
        for seed in range(4):
            with case(kind, seed):
                knots, points = draw(seed, 9)
                highest = 2 if kind == "cubic" else 4
                found = joint_paths.spline(knots, points, kind)
                beside = np.stack([knots[1:-1] - 1e-12, knots[1:-1] + 1e-12])
                for order in range(highest + 1):
                    before, after = (found(x, order) for x in beside)
                    assert close(before, after, 1e-6)
                assert close(found(knots, 0), points, 1e-11)
                for order in range(1, 1 + highest // 2):
                    size = np.abs(found(np.linspace(knots[0], knots[-1], 999), order)).max()
                    assert np.abs(found(knots[[0, -1]], order)).max() <= 1e-10 * size


def test_between_two_points_they_are_the_profiles_of_rest_to_rest() -> None:
    knots, points, u = np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.linspace(0.0, 1.0, 9)
    for kind, known in (
        ("cubic", u**2 * (3 - 2 * u)),
        ("quintic", u**3 * (10 - 15 * u + 6 * u**2)),
    ):
        with case(kind):
            assert joint_paths.spline(knots, points, kind)(u, 0)[:, 0] == pytest.approx(known)


def test_the_largest_values_of_the_derivatives_of_a_path() -> None:
    mechanism = load("robots/3r.yaml")
    for kind in ("cubic", "quintic", "trapezoidal", "cycloidal"):
        with case(kind):
            knots, points = draw(7, 10)
            path = path_through(points, knots, kind)
            found = WholePath(mechanism, path).peaks()
            u = np.concatenate([np.linspace(a, b, 5001)[:-1] for a, b in pairwise(path.breaks)])
            sampled = [np.abs(x).max(axis=0) for x in path.evaluate(u)[1:]]
            assert (found >= np.array(sampled) * (1 - 1e-13)).all()
            assert found == pytest.approx(np.array(sampled), rel=1e-5)
