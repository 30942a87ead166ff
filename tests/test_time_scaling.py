"""Limits, and shortest durations: reached, kept everywhere, and exceeded a little faster."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, TWO_LINK

import oracles
import robodyn
from random_mechanisms import LOOPS, mechanism, seeded_scene, seeded_tree
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.trajectories.joint_paths import ConstantSpeed, Sweep, path_through
from robodyn.trajectories.loop_path import TravelError
from robodyn.trajectories.reference import (
    ReferenceMotion,
    all_joints,
    motion_along,
    reference_motion,
)
from robodyn.trajectories.time_scaling import (
    LimitError,
    check_limits,
    limits_of,
    shortest_along,
    shortest_motion,
)

ARM = robodyn.load(ROOT / "robots/2r.yaml")
CHAIN = robodyn.load(ROOT / "robots/3r.yaml")
BAR = robodyn.load(ROOT / "robots/four-bar.yaml")
PROFILES = ("cubic", "quintic", "trapezoidal", "cycloidal")
PEAKS = {  # of s' and s''
    "cubic": (1.5, 6.0),
    "quintic": (1.875, 10 / math.sqrt(3)),
    "trapezoidal": (1.5, 4.5),
    "cycloidal": (2.0, 2 * math.pi),
}
every_profile = pytest.mark.parametrize("profile", PROFILES)


def dense(motion: ReferenceMotion, count: int = 10_001) -> list[tuple[np.ndarray, ...]]:
    """q, qd, qdd on a dense grid of each piece, both sides of each break."""
    T, found = motion.duration, []
    ends = motion.path.path.breaks
    for k in range(len(ends) - 1):
        u = np.linspace(ends[k], ends[k + 1], count)
        q, q1, q2 = motion.path.evaluate(u, np.full(count, k))
        found.append((q, q1 / T, q2 / T**2))
    return found


def largest_torques(motion: ReferenceMotion) -> np.ndarray:
    """The largest |tau| of each actuated joint on a dense grid."""
    mech = motion.mechanism
    driven = list(mech.actuated)
    tau = [robodyn.inverse_dynamics(mech, *piece)[:, driven] for piece in dense(motion)]
    return np.abs(np.concatenate(tau)).max(axis=0)


def assert_shortest(motion: ReferenceMotion, limit: np.ndarray) -> None:
    """A torque reaches its limit to 1e-6, none exceeds it, and at 0.999 of the time one does."""
    reached = (largest_torques(motion) / limit).max()
    assert 1 - 1e-6 < reached <= 1 + 1e-12
    limits = limits_of(motion.mechanism, tau=limit)
    check_limits(motion, limits)
    check_limits(replace(motion, duration=motion.duration * 1.01), limits)
    faster = replace(motion, duration=motion.duration * 0.999)
    assert (largest_torques(faster) / limit).max() > 1
    with pytest.raises(LimitError):
        check_limits(faster, limits)


def holding(mech: Mechanism, motion: ReferenceMotion) -> np.ndarray:
    """The largest torques of the poses of a motion, held."""
    q = np.concatenate([piece[0] for piece in dense(motion, 301)])
    tau = robodyn.inverse_dynamics(mech, q, 0 * q, 0 * q)
    return np.abs(tau[:, list(mech.actuated)]).max(axis=0)


# Rates and accelerations, in closed form


@every_profile
def test_rates_and_accelerations_bound_in_closed_form(profile: str) -> None:
    ends, (rate, bend) = [[0.2, -1.0], [1.5, 1.1]], PEAKS[profile]
    way = np.array([1.3, 2.1])
    for max_qd, max_qdd in (([1.0, 2.0], None), (None, [4.0, 3.0]), (1.5, 2.5), (9.0, 2.0)):
        motion = shortest_motion(ARM, ends, max_qd=max_qd, max_qdd=max_qdd, profile=profile)
        bounds = [0.0]
        if max_qd is not None:
            bounds += (rate * way / max_qd).tolist()
        if max_qdd is not None:
            bounds += np.sqrt(bend * way / max_qdd).tolist()
        assert motion.duration == pytest.approx(max(bounds), rel=1e-14)
        limits = limits_of(ARM, qd=max_qd, qdd=max_qdd)
        check_limits(motion, limits)
        with pytest.raises(LimitError):
            check_limits(replace(motion, duration=motion.duration * (1 - 1e-9)), limits)


@every_profile
def test_through_points_rates_and_accelerations_are_reached(profile: str) -> None:
    points = np.random.default_rng(5).uniform(-2, 2, (6, 2))
    max_qd, max_qdd = np.array([2.0, 3.0]), np.array([9.0, 7.0])
    motion = shortest_motion(ARM, points, max_qd=max_qd, max_qdd=max_qdd, profile=profile)
    pieces = dense(motion)
    reached = max(
        max((np.abs(qd) / max_qd).max(), (np.abs(qdd) / max_qdd).max()) for _, qd, qdd in pieces
    )
    assert 1 - 1e-6 < reached <= 1 + 1e-12


def test_each_leg_that_stops_takes_its_own_shortest_time() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.5], [-0.5, 0.7], [0.0, 2.0]])
    motion = shortest_motion(ARM, points, max_qd=[1.0, 2.0], profile="cycloidal")
    legs = 2.0 * (np.abs(np.diff(points, axis=0)) / [1.0, 2.0]).max(axis=1)
    assert motion.duration == pytest.approx(legs.sum(), rel=1e-14)
    q, qd, _ = motion.states(np.cumsum([0.0, *legs.tolist()])[:-1])
    assert np.abs(q - points[:-1]).max() < 1e-14
    assert np.abs(qd).max() < 1e-12
    kept = shortest_motion(ARM, points, max_qd=[1.0, 2.0], times=[0, 1, 2, 3], profile="cycloidal")
    assert kept.duration == pytest.approx(3 * legs.max(), rel=1e-14)


# Torques


@every_profile
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.thinned
def test_torques_of_the_2r_arm(profile: str, seed: int) -> None:
    """The limits are checked with the textbook's torques, not with robodyn's."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-2, 2, (2, 2))
    limit = np.array([14.6, 2.3]) * rng.uniform(1.0, 3.0, 2)  # stretched it weighs 14.57, 2.21
    motion = shortest_motion(ARM, ends, max_tau=limit, profile=profile)
    states = zip(*(np.concatenate(x) for x in zip(*dense(motion, 601), strict=True)), strict=True)
    tau = np.array([oracles.two_link_torque(TWO_LINK, *state) for state in states])
    reached = (np.abs(tau) / limit).max()
    assert 1 - 1e-5 < reached <= 1 + 1e-12
    assert_shortest(motion, limit)


@every_profile
@pytest.mark.parametrize("seed", range(2))
def test_torques_of_random_trees_with_dampers(profile: str, seed: int) -> None:
    mech = mechanism(seeded_tree(seed + 20, 3).text)
    ends = np.random.default_rng(seed).uniform(-2, 2, (2, 3))
    held = holding(mech, reference_motion(mech, ends, 1.0, profile=profile))
    limit = 1.3 * held + 0.1
    assert_shortest(shortest_motion(mech, ends, max_tau=limit, profile=profile), limit)


@pytest.mark.parametrize("profile", ["cubic", "quintic", "cycloidal"])
def test_torques_through_points(profile: str) -> None:
    points = np.random.default_rng(8).uniform(-2, 2, (5, 3))
    limit = np.array([90.0, 40.0, 12.0])
    assert_shortest(shortest_motion(CHAIN, points, max_tau=limit, profile=profile), limit)


@every_profile
def test_torque_of_the_four_bars_crank(profile: str) -> None:
    motion = shortest_motion(BAR, [[0.3], [5.0]], max_tau=12.0, profile=profile)
    assert_shortest(motion, np.array([12.0]))
    q, qd, qdd = dense(motion, 101)[0]
    tau = [oracles.four_bar_torque(FOUR_BAR, *state)[0] for state in zip(q, qd, qdd, strict=True)]
    assert np.abs(tau).max() <= 12.0


@pytest.mark.parametrize(
    ("name", "way"),
    [("five-bar", 0.2), ("slider-crank", -0.2), ("six-bar, dyad on the coupler", 0.2)],
)
def test_torques_of_random_loops(name: str, way: float) -> None:
    found = seeded_scene(1, LOOPS[name])
    mech = mechanism(found.text)
    driven = list(mech.actuated)
    points = np.array([found.q, np.full(mech.n, np.nan)])
    points[1, driven] = found.q[driven] + way
    path = path_through(points[:, driven], None, "quintic")
    limit = 1.2 * holding(mech, motion_along(mech, path, points, 1.0)) + 0.1
    limits = limits_of(mech, tau=limit)
    assert_shortest(shortest_along(mech, path, points, limits).motion, limit)


SCENE = (ROOT / "robots/2r.yaml").read_text()


@pytest.mark.parametrize("speed", [0.02, 0.5, 20.0])
@pytest.mark.parametrize("limit", [(25.0, 8.0), (15.5, 2.9)])
@pytest.mark.thinned
def test_torques_with_friction_springs_and_loads(speed: float, limit: tuple[float, float]) -> None:
    """The tighter limit is met where the friction is smoothed, if that is at a low speed."""
    friction = f"I: 0.082, friction: {{torque: 2.0, speed: {speed}}}"
    text = SCENE.replace("I: 0.082", friction)
    text += "\nsprings: [{joint: forearm, stiffness: 0.5, angle: 0.3, damping: 0.1}]"
    text += "\nloads: [{link: forearm, at: [0.2, 0.1], force: [0.5, -0.3], frame: link}]\n"
    mech = mechanism(text)
    for profile in ("cubic", "quintic"):
        motion = shortest_motion(mech, [[0, 0], [1.5, 0.7]], max_tau=limit, profile=profile)
        assert_shortest(motion, np.array(limit))


def test_torques_of_geared_joints() -> None:
    mech = mechanism(SCENE + '\ncouplings: ["q2 = -3/2 q1 + 0.25"]\nactuated: [upper arm]\n')
    motion = shortest_motion(mech, [[0.0], [2.0]], max_tau=20.0)
    q, qd, qdd = motion.states(np.linspace(0, motion.duration, 101))
    assert np.abs(q[:, 1] - (0.25 - 1.5 * q[:, 0])).max() < 1e-15
    assert np.abs(qd[:, 1] + 1.5 * qd[:, 0]).max() < 1e-13
    assert np.abs(qdd[:, 1] + 1.5 * qdd[:, 0]).max() < 1e-12
    assert_shortest(motion, np.array([20.0]))
    # the power of the arm's own torques is that of the one actuator
    tau = [oracles.two_link_torque(TWO_LINK, *x) @ [1, -1.5] for x in zip(q, qd, qdd, strict=True)]
    assert np.abs(tau).max() == pytest.approx(20.0, rel=1e-2)
    assert np.abs(tau).max() <= 20.0


def test_the_fastest_constant_speed() -> None:
    path = ConstantSpeed(np.zeros(1), np.array([2 * np.pi]))
    found = shortest_along(BAR, path, all_joints(BAR, [[0.0]]), limits_of(BAR, tau=20.0))
    assert found.bound.startswith("tau1 (crank) at t = ")
    assert_shortest(found.motion, np.array([20.0]))


def test_the_tightest_of_several_limits_counts() -> None:
    ends = [[0.0, 0.0], [1.5, 0.7]]
    each = [
        {"max_qd": 1.5, "max_qdd": None, "max_tau": None},
        {"max_qd": None, "max_qdd": 5.0, "max_tau": None},
        {"max_qd": None, "max_qdd": None, "max_tau": [20.0, 6.0]},
    ]
    alone = [shortest_motion(ARM, ends, **limit).duration for limit in each]
    together = shortest_motion(ARM, ends, max_qd=1.5, max_qdd=5.0, max_tau=[20.0, 6.0])
    assert together.duration == max(alone)
    assert len(set(alone)) == 3


def test_a_torque_that_does_not_hold_the_arm_is_named_with_its_pose() -> None:
    """At rest the arm weighs most where it lies stretched: on the way, not at its ends."""
    with pytest.raises(LimitError) as error:
        shortest_motion(ARM, [[-1.0, 0.0], [0.5, 0.0]], max_tau=[14.0, 8.0])
    told = str(error.value)
    assert "tau1 (upper arm) at q = " in told
    assert "holding this pose takes that, more than the limit of 14 N m" in told
    pose = [float(x) for x in told.split("q = ")[1].split(" = ")[0].split(",")]
    assert np.abs(pose).max() < 1e-4
    assert float(told.split(" = ")[2].split()[0]) == pytest.approx(14.56785, rel=1e-8)


# Static friction

CART = "joint: prismatic, axis: {}, m: 2, l: 0, r: 0, I: 0, friction: {{force: 3, static: 4}}"


def cart(axis: str = "[1, 0]", more: str = "") -> Mechanism:
    scene = f"gravity: 9.81\nlinks: [{{name: c, {CART.format(axis)}}}]\n{more}"
    return mechanism(scene)


def assert_needs(mech: Mechanism, points: list[list[float]], force: float, at: float) -> None:
    """More than this force, at this part of the motion, is what it takes, in any time."""
    slow = reference_motion(mech, points, 100.0)
    for motion in (
        lambda f: shortest_motion(mech, points, max_tau=f),
        lambda f: check_limits(slow, limits_of(mech, tau=f)),
    ):
        motion(force * (1 + 1e-9))
        with pytest.raises(LimitError, match="against its static friction, more than") as error:
            motion(force * (1 - 1e-9))
        told = str(error.value)
        assert abs(float(told.split(" = ")[2].split()[0])) == pytest.approx(force, rel=1e-8)
        assert error.value.quantity == "tau"
    assert float(told.split("t = ")[1].split(" s")[0]) == pytest.approx(100.0 * at, rel=1e-5)


@pytest.mark.filterwarnings("ignore:a joint with dry friction is at rest")
def test_static_friction_must_be_overcome() -> None:
    """At the start, after a turn back, and by the crank that a rocker holds."""
    assert_needs(cart(), [[0.0], [1.0]], 4.0, 0.0)
    up = math.sqrt(0.5)
    assert_needs(cart(f"[{up}, {up}]"), [[0.0], [1.0]], 4.0 + 2.0 * 9.81 * up, 0.0)
    # down it starts by its weight; up again, at the lowest point, it must be lifted
    path = path_through(np.array([[1.0], [0.0], [0.6]]), None, "quintic", 0.3, False)
    u = np.linspace(0.2, 0.9, 100_001)
    lowest = float(u[np.argmin(path.evaluate(u)[0][:, 0])])
    assert_needs(cart("[0, 1]"), [[1.0], [0.0], [0.6]], 4.0 + 2.0 * 9.81, lowest)
    text = (ROOT / "robots/four-bar.yaml").read_text()
    bar = mechanism(
        text.replace("name: rocker,", "name: rocker, friction: {torque: 8, static: 12},")
    )
    k3 = oracles.four_bar_coefficients(FOUR_BAR, oracles.four_bar_position(FOUR_BAR, 1.0))[0][2]
    slope = oracles.four_bar_reduction(FOUR_BAR, 1.0)[2]
    assert_needs(bar, [[1.0], [1.2]], slope + 12.0 * abs(k3), 0.0)


@pytest.mark.filterwarnings("ignore:a joint with dry friction is at rest")
def test_static_friction_that_is_felt_in_no_other_joint() -> None:
    """The arm's other joint needs its load alone; one that stays at rest may be held."""
    text = SCENE.replace("I: 0.082", "I: 0.082, friction: {torque: 1.0, static: 20.0}")
    mech = mechanism(text.replace("gravity: 9.81", "gravity: 0"))
    shortest_motion(mech, [[0.0, 0.0], [0.0, 1.0]], max_tau=5.0)
    with pytest.raises(LimitError, match=r"tau1 .* t = 0 s = -20 N m: starts it"):
        shortest_motion(mech, [[0.0, 0.0], [-0.1, 1.0]], max_tau=5.0)


# Checks of a given duration


def test_a_violation_between_rows_is_named() -> None:
    """The peak of a quintic's speed at T/2, which no sample need hit."""
    motion = reference_motion(ARM, [[0.0, 0.0], [1.0, -3.0]], times=[1.0, 3.0])
    peak = 1.875 * 3.0 / 2.0
    check_limits(motion, limits_of(ARM, qd=peak))
    with pytest.raises(LimitError) as error:
        check_limits(motion, limits_of(ARM, qd=peak * (1 - 1e-9)))
    assert error.value.quantity == "qd"
    assert "qd2 (forearm) at t = 2 s = -2.8125 rad/s: exceeds" in str(error.value)


def test_the_worst_of_all_violations_is_named() -> None:
    motion = reference_motion(ARM, [[0.0, 0.0], [1.0, 1.0]], 0.5, profile="trapezoidal")
    with pytest.raises(LimitError, match=r"qdd1 \(upper arm\) at t = .* s = -?18 rad/s\^2"):
        check_limits(motion, limits_of(ARM, qd=2.9, qdd=[3.0, 17.0], tau=1000.0))


def test_a_sweep_is_checked_cycle_by_cycle() -> None:
    pose, amplitude = np.array([0.3, 0.4]), np.array([0.02, 0.05])
    motion = motion_along(ARM, Sweep(pose, amplitude, 1.0, 40.0, 10.0), pose[None], 10.0)
    t = np.linspace(9.9, 10.0, 100_001)
    worst = np.abs(motion.states(t)[2][:, 1]).max()
    check_limits(motion, limits_of(ARM, qdd=[1e9, worst * (1 + 1e-6)]))
    with pytest.raises(LimitError, match=r"qdd2 \(forearm\)"):
        check_limits(motion, limits_of(ARM, qdd=[1e9, worst * (1 - 1e-6)]))


# Arguments


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({}, "duration = min: needs a limit"),
        ({"max_qd": [1.0, 2.0, 3.0]}, r"max_qd = 3 values: needs 1 value, or 2"),
        ({"max_tau": 0.0}, "max_tau = 0: must be > 0"),
        ({"max_qdd": [1.0, math.nan]}, "max_qdd = nan: must be > 0"),
        ({"points": [[1.0, 1.0], [1.0, 1.0]], "max_qd": 1.0}, "nothing moves"),
    ],
)
def test_arguments_that_do_not_fit(arguments: dict, told: str) -> None:
    points = arguments.pop("points", [[0.0, 0.0], [1.0, 1.0]])
    with pytest.raises(InputError, match=told):
        shortest_motion(ARM, points, **arguments)


def test_a_sweep_has_no_shortest_duration() -> None:
    sweep = Sweep(np.zeros(2), np.ones(2), 1.0, 2.0, 3.0)
    with pytest.raises(InputError, match="another path"):
        shortest_along(ARM, sweep, np.zeros((1, 2)), limits_of(ARM, qd=1.0))


# Many turns


@pytest.mark.parametrize("turns", [30.0, 30.3, -29.75])
def test_limits_hold_in_every_turn(turns: float) -> None:
    """A spring at the crank takes the more torque the further it is wound."""
    spring = "\nsprings:\n  - {joint: crank, stiffness: 0.5, angle: 20}\n"
    for text in ("", spring):
        mech = mechanism((ROOT / "robots/four-bar.yaml").read_text() + text)
        path = ConstantSpeed(np.array([1.0]), np.array([2 * np.pi * turns]))
        motion = motion_along(mech, path, all_joints(mech, [[1.0]]), 20.0)
        t, step = np.linspace(0.0, 20.0, 6_001, retstep=True)
        for _ in range(2):  # once more around the largest
            tau = np.abs(robodyn.inverse_dynamics(mech, *motion.states(t))[:, 0])
            most = t[np.argmax(tau)]
            t = np.linspace(max(0.0, most - step), min(20.0, most + step), 1_001)
        largest = tau.max()
        check_limits(motion, limits_of(mech, tau=1.00001 * largest))
        with pytest.raises(LimitError):
            check_limits(motion, limits_of(mech, tau=0.99999 * largest))


def test_limits_of_an_open_chain_hold_in_every_turn() -> None:
    """Also where a limit is met in one turn of thousands alone."""
    way = 2 * np.pi * 3000 * np.array([1.0, 1.0])
    motion = motion_along(ARM, ConstantSpeed(np.zeros(2), way), np.zeros((1, 2)), 1e5)
    largest = np.abs(robodyn.inverse_dynamics(ARM, np.zeros(2), way / 1e5, np.zeros(2)))
    check_limits(motion, limits_of(ARM, tau=1.01 * largest))
    with pytest.raises(LimitError):
        check_limits(motion, limits_of(ARM, tau=[0.9999 * largest[0], 1e3]))
    path = ConstantSpeed(np.zeros(2), 1e6 * np.array([1.0, 1 / math.sqrt(3)]))
    motion = motion_along(ARM, path, np.zeros((1, 2)), 1e5)
    with pytest.raises(TravelError, match=r"1e.06 rad.*more than the 1,000,000 samples"):
        check_limits(motion, limits_of(ARM, tau=100.0))
