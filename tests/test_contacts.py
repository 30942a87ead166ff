"""Stops and dry friction against closed forms, brute force, and integrations written here."""

from __future__ import annotations

import functools
import math
import random
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import FRESH
from contact_scenes import FIVE_BAR, FOUR_BAR, SLIDER_CRANK, dry, kkt, scene
from named_case import case
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import robodyn
from robodyn.dynamics import closed_form
from robodyn.dynamics.sticking import forces_between
from robodyn.elements.contacts import Mode
from robodyn.errors import DescriptionError, InputError
from robodyn.loops import closures
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import in_mode
from robodyn.runs.phases import Phases, rates_after
from robodyn.runs.report import Outcome
from robodyn.runs.simulation import Motion, simulate
from robodyn.scene.description import from_text

G = 9.81
METHODS = ("DOP853", "RK45", "Radau", "taylor")
EACH = pytest.mark.parametrize("method", METHODS)


def slide(
    keys: str, gravity: str = "0", axis: str = "[1, 0]", m: float = 1.0, rest: str = ""
) -> Mechanism:
    link = f"{{name: block, joint: prismatic, axis: {axis}, m: {m}, l: 0, r: 0, I: 0, {keys}}}"
    return scene(f"gravity: {gravity}\nlinks: [{link}]\n{rest}")


def ball(e: float) -> Mechanism:
    return slide(f"limits: {{min: 0, restitution: {e}}}", f"{G}", "[0, 1]")


def arm(friction: str = "", gravity: float = 0.0) -> Mechanism:
    return scene(
        f"gravity: {gravity}\nlinks: [{{name: arm, m: 1, l: 1, r: 0.5, I: 0.1, {friction}}}]\n"
    )


def four_bar(**keys: str) -> Mechanism:
    return scene(FOUR_BAR.format(**{"crank": "", "coupler": "", "rocker": ""} | keys))


def times_of(motion: Motion, what: str) -> np.ndarray:
    return np.array([event.t for event in motion.events if event.name == what])


# -- a bouncing ball -------------------------------------------------------------------------------


def bounces(e: float, count: int, height: float = 1.0) -> np.ndarray:
    first = math.sqrt(2.0 * height / G)
    return first * (1.0 + 2.0 * np.cumsum(np.r_[0.0, e ** np.arange(1, count)]))


@EACH
@pytest.mark.parametrize("e", [0.0, 0.5, 0.9])
@pytest.mark.thinned
def test_times_of_bounces_are_a_geometric_series(e: float, method: str) -> None:
    end = 3.0 if e < 0.8 else 10.0
    rows = np.linspace(0.0, end, 101)
    motion = simulate(
        ball(e),
        [1.0],
        [0.0],
        end,
        method=method,
        rtol=1e-10,
        atol=1e-10,
        t_eval=rows,
    )
    found = times_of(motion, "block hits its min")
    assert motion.outcome is Outcome.FINISHED
    assert np.abs(found - bounces(e, len(found))).max() < (1e-14 if e < 0.8 else 3e-12)
    limit = math.sqrt(2.0 / G) * (1.0 + 2.0 * e / (1.0 - e))
    assert limit - found[-1] < 2e-10 * end
    rests = rows > limit
    assert len(motion.t) == 101
    assert (motion.q[rests] == 0.0).all()
    assert (motion.qd[rests] == 0.0).all()
    assert np.abs(motion.qdd[rests]).max() < 1e-12
    hits = bounces(e, 400)
    for t, q in zip(rows[~rests], motion.q[~rests, 0], strict=True):
        k = int(np.searchsorted(hits, t))
        begun = hits[k - 1] if k else 0.0
        v = e**k * math.sqrt(2.0 * G)
        exact = (0.0 if k else 1.0) + (v if k else 0.0) * (t - begun) - 0.5 * G * (t - begun) ** 2
        assert abs(q - exact) < 1e-11


@pytest.mark.parametrize("method", METHODS)
def test_no_bounce_ends_beyond_the_end(method: str) -> None:
    """Not by the tolerance either, where bounces become lower than rounding."""
    for end, tolerance in product((0.7, 0.0046, -3.0), (1e-3, 1e-8)):
        block = slide(f"limits: {{min: {end}, restitution: 0.5}}", f"{G}", "[0, 1]")
        given = {"method": method, "rtol": tolerance, "atol": tolerance}
        for t_eval in (None, np.linspace(0.0, 1.0, 5001)):
            motion = simulate(block, [end + 0.1], [0.0], 1.0, t_eval=t_eval, **given)
            assert motion.q.min() > end - 1e-14 * max(abs(end), 0.1)  # it falls from 0.1 above
            assert motion.q[-1] == end


@pytest.mark.parametrize("method", ["DOP853", "RK45", "taylor"])
def test_energy_of_an_elastic_ball(method: str) -> None:
    motion = simulate(ball(1.0), [1.0], [0.0], 60.0, method=method, rtol=1e-10, atol=1e-10)
    found = times_of(motion, "block hits its min")
    assert len(found) == 66
    assert np.abs(found - bounces(1.0, 66)).max() < 2e-10
    energy = 0.5 * motion.qd[:, 0] ** 2 + G * motion.q[:, 0]
    assert np.abs(energy / G - 1.0).max() < 1e-10
    assert (np.diff(motion.t) > 0.0).all()


def test_an_event_on_a_rate_happens_in_the_impact() -> None:
    motion = simulate(ball(0.5), [1.0], [0.0], 3.0, until="qd1 > 1", events={"up": "qd1"})
    assert motion.outcome is Outcome.EVENT
    assert abs(motion.t[-1] - math.sqrt(2.0 / G)) < 1e-14
    assert len(times_of(motion, "up")) == 1


@EACH
def test_an_event_where_a_joint_stops_is_told_at_that_very_time(method: str) -> None:
    block = slide(dry(1.0, 1.5, 0.3, "force"))
    for rate in np.linspace(0.5, 2.0, 12):
        motion = simulate(
            block, [0.0], [rate], 3.0, "0.2*sin(t)", method=method, rtol=1e-6,
            atol=1e-6, events={"rest": "qd1 <= 0"},
        )  # fmt: skip
        assert [event.name for event in motion.events] == ["rest", "block stops"]
        assert motion.events[0].t == motion.events[1].t


@EACH
def test_events_where_a_motion_turns_back_or_stays_at_zero(method: str) -> None:
    """What touches its end is never beyond it, and a rate passes zero where it leaves it."""
    given = {"method": method}
    for end in (0.0, 0.3):
        signs = {"at": "-", "below": "<", "above": ">", "on": "<="}
        events = {name: f"q1 {sign} {end}" for name, sign in signs.items()}
        block = slide(f"limits: {{min: {end}, restitution: 0.5}}", f"{G}", "[0, 1]")
        motion = simulate(block, [end + 0.1], [0.0], 0.36, events=events, **given)
        assert [event.name for event in motion.events] == ["on", "block hits its min"] * 3
    block = slide(dry(1.0, 1.5, 0.3, "force"))
    events = {"turns": "qd1", "up": "qd1 > 0", "down": "qd1 < 0", "rests": "qd1 >= 0"}
    motion = simulate(block, [0.0], [-1.0], 4.0, "t", events=events, **given)
    first, others = ["rests", "block stops"], {"turns", "up", "block starts"}
    assert [event.name for event in motion.events[:2]] == first
    assert {event.name for event in motion.events[2:]} == others
    assert len(motion.events) == 5
    assert np.ptp([event.t for event in motion.events[2:]]) < 1e-6
    for until in ("q1 < 0", "q1 <= 0"):
        motion = simulate(ball(0.5), [0.1], [0.0], 0.3, until=until, **given)
        assert motion.outcome is (Outcome.EVENT if "=" in until else Outcome.FINISHED)


def test_starts_and_ends() -> None:
    with pytest.raises(InputError, match="is beyond the joint's min, 0"):
        simulate(ball(0.5), [-1e-6], [0.0], 1.0)
    with pytest.raises(InputError, match="must not be negative"):
        simulate(ball(0.5), [1.0], [0.0], -1.0)
    motion = simulate(ball(0.5), [1.0], [0.0], 0.0)
    assert motion.outcome is Outcome.FINISHED
    motion = simulate(ball(0.5), [0.0], [-1.0], 0.01)  # an impact at once
    assert abs(motion.qd[-1, 0] - (0.5 - 0.01 * G)) < 1e-12
    motion = simulate(ball(0.5), [0.0], [0.0], 1.0, events={"leaves": "q1 > 1e-9"})
    assert not motion.events
    assert (motion.q == 0.0).all()


def test_limits_alone_end_a_run_by_name() -> None:
    mechanism = slide("limits: {min: -0.5, max: 3}", f"{G}", "[0, 1]")
    for method in METHODS:
        motion = simulate(mechanism, [1.0], [0.0], 3.0, method=method, rtol=1e-10, atol=1e-10)
        assert motion.outcome is Outcome.LIMIT
        assert abs(motion.t[-1] - math.sqrt(2.0 * 1.5 / G)) < 1e-10
        assert motion.report.ended_by == "q1 (block) passes its min, -0.5"


# -- impacts through M and the closures ------------------------------------------------------------


STOPPED = [
    (four_bar(rocker="limits: {max: 100deg, restitution: 0.4}"), [1.0], [2.0], 2, 1),
    (
        scene(SLIDER_CRANK.format(crank="", piston="limits: {min: 0.7, restitution: 0.4}")),
        [0.5],
        [4.0],
        2,
        -1,
    ),
    (
        scene(
            "gravity: 9.81\nlinks:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}\n"
            "  - {name: b, m: 1, l: 1, r: 0.5, I: 0.1, limits: {max: 60deg, restitution: 0.4}}\n"
        ),
        [0.3, 0.2],
        [0.0, 3.0],
        1,
        1,
    ),
]


@pytest.mark.parametrize(("mechanism", "q", "qd", "joint", "side"), STOPPED)
@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
@pytest.mark.thinned
def test_an_impact_goes_through_mass_and_closures(
    mechanism: Mechanism, q: Any, qd: Any, joint: int, side: int, method: str
) -> None:
    if mechanism.rows:
        q = robodyn.assemble(mechanism, q)
        qd = robodyn.loop_velocities(mechanism, q, qd)
    motion = simulate(mechanism, q, qd, 1.0, method=method, rtol=1e-11, atol=1e-11)
    hit = next(event for event in motion.events if "hits" in event.name)
    n = mechanism.n
    end = next(x.ends[0][1] for x in mechanism.ranges if x.joint == joint)
    before = int(np.searchsorted(motion.t, hit.t))
    assert abs(motion.t[before] - hit.t) < 1e-12
    was, after = motion.qd[before], hit.y[n:]
    np.testing.assert_allclose(
        after, kkt(mechanism, hit.y[:n], was, joint, 0.4), atol=1e-12 * np.abs(after).max()
    )
    assert abs(hit.y[joint] - end) < 1e-14
    assert after[joint] == pytest.approx(-0.4 * was[joint], rel=1e-12)
    assert side * was[joint] > 0.0
    if mechanism.rows:
        Psi = closures.closure_jacobian(mechanism, hit.y[:n], t=0.0)
        assert np.abs(Psi @ after).max() < 1e-13
        assert motion.report.largest_gap < 1e-12
        assert motion.report.largest_gap_rate < 1e-11
    # the energy in the direction of the impact keeps e^2 of itself, the rest all of it
    M = closed_form.mass_matrix(mechanism, hit.y[:n])
    still = kkt(mechanism, hit.y[:n], was, joint, 0.0)
    normal = [(x - still) @ M @ (x - still) for x in (was, after)]
    assert normal[1] == pytest.approx(0.16 * normal[0], rel=1e-10)
    assert motion.report.energy_drift < 1e-8


def test_several_stops_hit_at_one_instant() -> None:
    """Against all subsets of impulses, of random trees with stops at every joint."""
    numbers = random.Random(5)
    for _ in range(30):
        n = numbers.randint(2, 4)
        links = "\n".join(
            f"  - {{name: a{k}, m: 1, l: {numbers.uniform(0.3, 1)}, r: 0.2, I: 0.1, "
            "limits: {min: -1, max: 1, restitution: 0.5}}"
            for k in range(n)
        )
        mechanism = scene(f"links:\n{links}\n")
        q = np.array([numbers.choice([-1.0, 1.0]) for _ in range(n)])
        qd = np.array([numbers.uniform(-1, 1) for _ in range(n)])
        ends = [(k, int(q[k])) for k in range(n) if q[k] * qd[k] >= 0.0]
        e = [numbers.choice([0.0, 0.3, 0.9]) for _ in ends]
        after, _ = rates_after(mechanism, q, qd, ends, e, 0.0)
        M = closed_form.mass_matrix(mechanism, q)
        impulses = M @ (after - qd)
        for k in range(n):
            if k not in dict(ends):
                assert abs(impulses[k]) < 1e-12
        for (k, side), part in zip(ends, e, strict=True):
            left, push = side * (after[k] + part * qd[k]), side * impulses[k]
            assert left < 1e-10  # thrown back at least so fast
            assert push < 1e-10  # and never pulled
            assert abs(left * push) < 1e-10


def test_a_joint_at_its_stop_is_hit_through_another() -> None:
    text = (
        "gravity: 0\nlinks:\n"
        "  - {name: a, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0, "
        "limits: {max: 0, restitution: 0.5}}\n"
        "  - {name: b, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0, from: a, "
        "limits: {max: 1, min: -1, restitution: 1}}\n"
    )
    motion = simulate(scene(text), [0.0, 0.0], [0.0, 1.0], 2.0)
    assert motion.outcome is Outcome.FINISHED
    # b hits its stop on a at t = 1 and would drive a on, but a is at its own: b comes back
    np.testing.assert_allclose(motion.qd[-1], [0.0, -1.0], atol=1e-12)
    motion = simulate(scene(text), [0.0, 0.0], [0.0, -1.0], 1.5)  # a is drawn away from it
    np.testing.assert_allclose(motion.qd[-1], [-1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(motion.q[-1], [-0.5, -0.5], atol=1e-12)


# -- compliant stops -------------------------------------------------------------------------------


@pytest.mark.parametrize("stiffness", [1e2, 1e8])
@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
@pytest.mark.thinned
def test_half_a_period_on_a_compliant_stop(stiffness: float, method: str) -> None:
    mechanism = slide(f"limits: {{max: 0.5, stiffness: {stiffness}}}", m=4.0)
    motion = simulate(mechanism, [0.0], [1.0], 2.0, method=method, rtol=1e-11, atol=1e-11)
    meets, leaves = (times_of(motion, f"block {x} its max") for x in ("meets", "leaves"))
    assert len(meets) == len(leaves) == 1
    assert abs(meets[0] - 0.5) < 1e-12
    assert abs(leaves[0] - 0.5 - math.pi * math.sqrt(4.0 / stiffness)) < 1e-9
    assert abs(motion.qd[-1, 0] + 1.0) < 1e-8
    assert motion.report.energy_drift < 1e-8


@pytest.mark.parametrize("method", METHODS)
def test_a_damped_stop_never_pulls(method: str) -> None:
    k, c = 100.0, 6.0
    mechanism = slide(f"limits: {{max: 0.5, stiffness: {k}, damping: {c}}}")
    motion = simulate(mechanism, [0.0], [1.0], 2.0, method=method, rtol=1e-11, atol=1e-11)
    # x = exp(-d t) sin(w t)/w beyond it; k x + c x' = 0 where it is left
    d = c / 2.0
    w = math.sqrt(k - d * d)
    t = (math.pi - math.atan2(c * w, k - c * d)) / w
    v = math.exp(-d * t) * (math.cos(w * t) - d / w * math.sin(w * t))
    (left,) = times_of(motion, "block leaves its max")
    assert abs(left - 0.5 - t) < 1e-8
    assert abs(motion.qd[-1, 0] - v) < 1e-8
    assert motion.report.energy_drift < 1e-7


# -- friction --------------------------------------------------------------------------------------


def incline(mu: float, angle: float, moving: float = 1.0) -> Mechanism:
    static = mu * G * math.cos(angle)
    friction = dry(moving * static, static, None if moving == 1.0 else 0.1, "force")
    return slide(friction, f"[{G * math.sin(angle)!r}, {-G * math.cos(angle)!r}]")


@pytest.mark.parametrize("mu", [0.1, 0.6, 2.0])
@pytest.mark.parametrize("moving", [1.0, 0.5])
def test_a_block_on_an_incline_slips_from_the_angle_of_friction_on(
    mu: float, moving: float
) -> None:
    for part, slips in ((1.0 - 1e-12, False), (1.0 + 1e-12, True)):
        mechanism = incline(mu, math.atan(mu) * part, moving)
        qdd = robodyn.forward_dynamics(mechanism, [0.0], [0.0], [0.0])
        assert bool(abs(qdd[0]) > 1e-13) is slips
        motion = simulate(mechanism, [0.0], [0.0], 1e4 if moving == 1.0 else 100.0)
        assert motion.outcome is Outcome.FINISHED
        assert bool(motion.q[-1, 0] > 1e-9) is slips
        if not slips:
            assert (motion.q == 0.0).all()


@pytest.mark.parametrize("method", METHODS)
def test_how_far_and_how_long_a_block_slides(method: str) -> None:
    mechanism = slide(dry(3.0, 3.0, name="force"), m=2.0)
    motion = simulate(mechanism, [0.0], [2.0], 5.0, method=method, rtol=1e-10, atol=1e-10)
    (stop,) = times_of(motion, "block stops")
    assert abs(stop - 2.0 * 2.0 / 3.0) < 1e-9
    assert abs(motion.q[-1, 0] - 4.0 / 3.0) < 1e-9
    assert motion.qd[-1, 0] == 0.0


@functools.cache
def stick_slip(end: float) -> tuple[list[float], float]:
    """Times of slips and sticks of a block that a spring pulls at a steady rate."""
    k, force, static, width, v = 3.0, 1.0, 2.0, 0.5, 0.1
    t, x, found = 0.0, 0.0, []
    while (start := (static / k + x) / v) < end:
        found.append(start)

        def rates(t: float, y: np.ndarray) -> list[float]:
            bell = math.exp(-((y[1] / width) ** 2))
            return [y[1], k * (v * t - y[0]) - force - (static - force) * bell]

        def rests(t: float, y: np.ndarray) -> float:
            return float(y[1])

        rests.terminal, rests.direction = True, -1  # type: ignore[attr-defined]
        ran = solve_ivp(
            rates, (start, end), [x, 1e-300], "DOP853", rtol=1e-13, atol=1e-15, events=rests,
            max_step=0.01,
        )  # fmt: skip
        t, x = float(ran.t[-1]), float(ran.y[0, -1])
        if ran.status != 1:
            break
        found.append(t)
    return found, x


@pytest.mark.parametrize(("method", "off"), [("DOP853", 1e-7), ("Radau", 1e-8), ("taylor", 1e-8)])
def test_stick_slip_of_a_pulled_block(method: str, off: float) -> None:
    exact, x = stick_slip(60.0)
    mechanism = slide(dry(1.0, 2.0, 0.5, "force"))
    motion = simulate(
        mechanism, [0.0], [0.0], 60.0, "3*(0.1*t - q1)", method=method, rtol=1e-10, atol=1e-10
    )
    names = [event.name for event in motion.events]
    assert names == ["block starts", "block stops"] * (len(exact) // 2) + ["block starts"]
    assert np.abs(np.array([event.t for event in motion.events]) - exact).max() < off
    assert abs(motion.q[-1, 0] - x) < off


@pytest.mark.parametrize("method", METHODS)
def test_no_method_leaps_over_the_bell_of_stribeck(method: str) -> None:
    """Under a square wave an arm comes from far above the rate `stribeck` to rest, and turns."""
    motion = simulate(
        arm(dry(1.0, 2.0, 0.1)), [0.0], [0.0], 6.0, "3 if sin(2*t) > 0 else -3",
        method=method, rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    assert motion.outcome is Outcome.FINISHED
    # by DOP853 with steps of 1 ms, cut at each switch and each zero of the rate
    np.testing.assert_allclose(
        [motion.q[-1, 0], motion.qd[-1, 0]], [12.28807336, -3.95422079], atol=3e-7
    )


@EACH
def test_a_rate_that_turns_round_within_a_step_goes_through_the_bell(method: str) -> None:
    """As it does by short steps, where both ends of a step are far above the rate `stribeck`."""
    block = slide(dry(0.1, 2.0, 0.01, "force"))
    for rate in (0.15, 0.18):
        run = functools.partial(
            simulate, block, [0.0], [rate], 0.0135, "-60 + 9000*t", rtol=1e-9, atol=1e-9
        )
        exact = run(max_step=2e-5)
        motion = run(method=method)
        assert [x.name for x in motion.events] == [x.name for x in exact.events]
        assert abs(motion.qd[-1, 0] - exact.qd[-1, 0]) < 1e-6


def test_a_joint_that_left_its_stop_meets_it_where_it_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However little a method sees of how it leaves: the impact is no tolerance beyond."""
    met, follow = [], Phases.next

    def following(phases: Phases, t: float, y: Any, place: int) -> Any:
        if phases.guards[place].kind == "inside" and t - phases.begun > 0.1:
            met.append((t, y[0]))
        return follow(phases, t, y, place)

    monkeypatch.setattr(Phases, "next", following)
    off = math.asin(G / 20.0) / 6.0  # where 20 sin(6 t) lifts the weight of 1 kg
    rise = lambda t: 20.0 / 6.0 * math.cos(6.0 * off) * (t - off)  # noqa: E731
    fall = lambda t: 20.0 / 36.0 * (math.sin(6.0 * t) - math.sin(6.0 * off))  # noqa: E731
    back = brentq(lambda t: rise(t) - fall(t) - 0.5 * G * (t - off) ** 2, 0.6, 1.2)
    for method in METHODS:
        for tolerance in (1e-3, 1e-6):
            met.clear()
            simulate(
                ball(0.0), [0.0], [0.0], 1.0, "20*sin(6*t)", method=method,
                rtol=tolerance, atol=tolerance,
            )  # fmt: skip
            with case(method, tolerance):
                ((t, height),) = met
                assert abs(height) < 1e-14
                assert abs(t - back) < tolerance


def test_the_energy_in_motion_where_steps_end_at_rest() -> None:
    """v = t - t^2 from rest to rest, of 1 kg: at most 1/32 J, by its mean rate 1/72 J."""
    for method in ("taylor", "DOP853"):
        motion = simulate(
            slide(dry(1.0, 1.0, name="force")), [0.0], [0.0], 1.4, "2 - 2*t", method=method
        )
        assert motion.q[-1, 0] == pytest.approx(1.0 / 6.0, abs=1e-9)
        assert 0.99 / 72.0 < motion.report.energy_in_motion < 1.01 / 32.0


FAST = 9000.0, -60.0, 0.15, 0.03
DIPS = [  # a scene, the torque besides a t + b, then a, b, the first rate and the end; F(x, v)
    (dry(0.1, 2.0, 0.01, "force"), "", "", FAST,
     lambda x, v: math.copysign(0.1 + 1.9 * math.exp(-((v / 0.01) ** 2)), -v)),
    ("friction: {force: 2, speed: 0.001}", "", "", FAST, lambda x, v: -2.0 * math.tanh(v / 0.001)),
    ("", "", " - 2*exp(-(qd1/0.01)**2)", FAST, lambda x, v: -2.0 * math.exp(-((v / 0.01) ** 2))),
    ("", "", " + 20*exp(-((q1-0.0004)/5e-5)**2)", FAST,
     lambda x, v: 20.0 * math.exp(-(((x - 0.0004) / 5e-5) ** 2))),
    ("", "springs: [{joint: block, length: 0, law: '20*exp(-((x-0.0004)/5e-5)**2)'}]", "", FAST,
     lambda x, v: -20.0 * math.exp(-(((x - 0.0004) / 5e-5) ** 2))),
    ("", "", " - 2*qd1/sqrt(qd1**2+1e-12)", FAST, lambda x, v: -2.0 * v / math.hypot(v, 1e-6)),
    ("", "", " - 2*atan(qd1/1e-6)", FAST, lambda x, v: -2.0 * math.atan(v / 1e-6)),
    ("", "", " + 20/(1+((q1-0.0004)/5e-7)**2)", FAST,
     lambda x, v: 20.0 / (1.0 + ((x - 0.0004) / 5e-7) ** 2)),
    ("", "", " - 5*sqrt((q1-0.0004)**2+1e-20)", FAST, lambda x, v: -5.0 * abs(x - 0.0004)),
    ("", "", " - 2/(1+exp(-qd1/1e-4))", FAST, lambda x, v: -1.0 - math.tanh(0.5e4 * v)),
    ("", "springs: [{joint: block, length: 0, table: F.csv}]", "", (600.0, -85.0, 0.6, 0.05),
     lambda x, v: 20.0 * float(np.interp(x, [0.0018, 0.0022], [0.0, 1.0]))),
]  # fmt: skip


def test_what_a_motion_meets_and_leaves_within_a_step_acts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a series begins it is flat, or another line, and a step's end and middle are there too.

    Against DOP853 of v' = a t + b + F(x, v) in short steps.
    """
    monkeypatch.chdir(tmp_path)
    Path("F.csv").write_text("x,F\n-1,0\n0.0018,0\n0.0022,-20\n1,-20\n")
    given = {"method": "taylor", "rtol": 1e-9, "atol": 1e-9}
    for keys, rest, more, (a, b, rate, end), force in DIPS:
        exact = solve_ivp(
            lambda t, y, a=a, b=b, force=force: (y[1], a * t + b + force(*y)),
            (0.0, end), [0.0, rate], "DOP853", rtol=1e-12, atol=1e-14, max_step=2e-5,
        )  # fmt: skip
        motion = simulate(slide(keys, rest=rest), [0.0], [rate], end, f"{a}*t + {b}{more}", **given)
        with case(keys, rest, more):
            assert abs(motion.qd[-1, 0] - exact.y[1, -1]) < 1e-7


def test_machine_code_holds_steps_at_the_bell_of_stribeck() -> None:
    pytest.importorskip("llvmlite", reason="the extra `fast`")
    for stribeck in (0.1, 0.03, 0.1):  # one code for both
        found = []
        for method in ("DOP853", "taylor"):
            motion = simulate(
                arm(dry(1.0, 2.0, stribeck)), [0.0], [0.0], 4.0, "3 if sin(2*t) > 0 else -3",
                method=method, rtol=1e-10, atol=1e-10,
            )  # fmt: skip
            assert motion.outcome is Outcome.FINISHED
            found.append([motion.q[-1, 0], motion.qd[-1, 0]])
        np.testing.assert_allclose(*found, atol=1e-7)


def test_a_torque_that_jumps_lets_a_joint_go_at_once() -> None:
    mechanism = arm(dry(1.0, 2.0))
    for method in METHODS:
        motion = simulate(
            mechanism,
            [0.0],
            [0.0],
            3.0,
            "3 if t >= 1 else 0",
            method=method,
            rtol=1e-10,
            atol=1e-10,
        )
        (start,) = times_of(motion, "arm starts")
        assert abs(start - 1.0) < 1e-14
        assert motion.q[-1, 0] == pytest.approx(2.0**2 / (2.0 * 0.35) * 2.0, rel=1e-9)


def test_friction_that_falls_at_once() -> None:
    """torque below static without stribeck: it jumps as the joint starts."""
    mechanism = arm(dry(1.0, 2.0))
    motion = simulate(mechanism, [0.0], [0.0], 5.0, "2.5*sin(t)", rtol=1e-11, atol=1e-11)
    start, stop = (times_of(motion, f"arm {x}")[0] for x in ("starts", "stops"))
    assert abs(start - math.asin(0.8)) < 1e-12

    def rate(t: float) -> float:
        return 2.5 * (math.cos(start) - math.cos(t)) - (t - start)

    assert abs(rate(stop)) < 1e-9


@pytest.mark.parametrize(("held", "start"), [(0.7, 5.0), (1.0, 6.25), (1.2, 7.25)])
def test_what_stands_on_what_starts_is_taken_along(held: float, start: float) -> None:
    """A block starts at 2 N: friction falls to 0.5 N, and it jumps to (2 - 0.5)/(1 + 1) m/s^2.

    The block on it starts with it if that is more than its friction can give 1 kg, or when it is.
    """
    slides = "joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0"
    mechanism = scene(
        "gravity: 0\nlinks:\n"
        f"  - {{name: lower, {slides}, {dry(0.5, 2.0, name='force')}}}\n"
        f"  - {{name: upper, {slides}, from: lower, {dry(0.3, held, name='force')}}}\n"
    )
    motion = simulate(mechanism, [0.0, 0.0], [0.0, 0.0], 8.0, "0.4*t, 0", rtol=1e-11, atol=1e-11)
    assert times_of(motion, "lower starts") == pytest.approx([5.0], abs=1e-9)
    assert times_of(motion, "upper starts") == pytest.approx([start], abs=1e-9)
    assert not times_of(motion, "upper stops").size


@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
def test_a_loop_with_friction_at_every_joint_stops_and_stays(method: str) -> None:
    each = dry(0.4, 0.7, 0.1)
    mechanism = four_bar(crank=each, coupler=each, rocker=each)
    q = robodyn.assemble(mechanism, [1.0])
    qd = robodyn.loop_velocities(mechanism, q, [2.0])
    motion = simulate(mechanism, q, qd, 4.0, method=method, rtol=1e-10, atol=1e-10)
    assert motion.outcome is Outcome.FINISHED
    assert [event.name for event in motion.events[-3:]] == [
        f"{name} stops" for name in ("crank", "coupler", "rocker")
    ]
    assert not motion.qd[-1].any()


@EACH
def test_what_stands_does_not_move_in_any_time(method: str) -> None:
    """To the last bit, what is tied to held joints too."""
    each = "m: 0.7, l: 0.4, r: 0.2, I: 0.03"
    geared = scene(
        f"gravity: 9.81\nlinks:\n  - {{name: a, {each}, {dry(50.0, 60.0)}}}\n"
        f"  - {{name: b, {each}}}\n  - {{name: c, {each}, {dry(50.0, 60.0)}}}\n"
        'couplings: ["q2 = -2.3 q1"]\nactuated: [a]\n'
    )
    closed = four_bar(coupler=dry(50.0, 60.0), rocker="limits: {min: 0, max: 2, restitution: 0.3}")
    for mechanism, q in ((geared, [0.3, -0.69, 0.4]), (closed, robodyn.assemble(closed, [1.0]))):
        given = {"method": method, "events": {"first": "qd1", "other": "qd2"}}
        for end, tau in product((1e5, 3.0), ("2", "3*sin(t)")):
            if end < 10.0 or tau == "2":
                times = np.linspace(0.0, end, 7)
                run = functools.partial(simulate, mechanism, q, [0.0] * 3, end, tau, t_eval=times)
                motion = run(**given)
                assert motion.outcome is Outcome.FINISHED
                assert (motion.q == q).all()
                assert not motion.qd.any()
                assert not motion.qdd.any()
                assert not motion.events
                assert motion.report.energy_drift == 0.0


def test_what_holds_a_loop_by_virtual_power() -> None:
    """It starts where the power of the loads exceeds what friction at all joints takes."""
    each = dry(0.3, 0.5, 0.1)
    mechanism = four_bar(crank=each, coupler=each, rocker=each)
    plain = four_bar()
    for angle in (0.5, 1.0, 2.5, 4.0):
        q = robodyn.assemble(mechanism, [angle])
        rates = robodyn.loop_velocities(mechanism, q, [1.0])
        held = 0.5 * float(np.abs(rates).sum())
        needed = float(robodyn.inverse_dynamics(plain, q, 0 * q, 0 * q)[0])
        for way, part, slips in product((1, -1), (1.0 - 1e-9, 1.0 + 1e-9), (None,)):
            tau = np.zeros(3)
            tau[0] = needed + way * held * part
            qdd = robodyn.forward_dynamics(mechanism, q, 0 * q, tau)
            slips = part > 1.0
            assert bool(np.abs(qdd).max() > 1e-12) is slips, (angle, way, part)
            if slips:
                assert way * qdd[0] > 0.0


@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
def test_a_driven_loop_starts_with_all_its_joints(method: str) -> None:
    each = dry(2.0, 4.0, 0.1)
    mechanism = four_bar(crank=each, coupler=each, rocker=each)
    q = robodyn.assemble(mechanism, [1.0])
    motion = simulate(mechanism, q, [0, 0, 0], 0.5, "40*t", method=method, rtol=1e-10, atol=1e-10)
    assert motion.outcome is Outcome.FINISHED
    names = [event.name for event in motion.events]
    assert names[:3] == [f"{name} starts" for name in ("crank", "coupler", "rocker")]
    assert motion.report.energy_drift < 1e-7


@pytest.mark.parametrize("seed", range(3 if FRESH else 1))
def test_two_freedoms_with_friction_at_four_joints(seed: int) -> None:
    """All methods agree on which joints stick and when."""
    mechanism = scene(FIVE_BAR.format(each=dry(0.3, 0.5, 0.2)))
    q = robodyn.assemble(mechanism, [2.0, 1.0])
    rates = random.Random(seed)
    qd = robodyn.loop_velocities(mechanism, q, [rates.uniform(-1, 1), rates.uniform(-1, 1)])
    runs = [
        simulate(mechanism, q, qd, 0.6, method=method, rtol=1e-10, atol=1e-10)
        for method in ("DOP853", "taylor")
    ]
    assert all(run.outcome is Outcome.FINISHED for run in runs)
    names = [[event.name for event in run.events] for run in runs]
    assert names[0] == names[1]
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], atol=1e-6)
    assert max(run.report.energy_drift for run in runs) < 1e-7


# -- which joints stick: accel ---------------------------------------------------------------------


def brute_force(mechanism: Mechanism, q: np.ndarray, tau: np.ndarray) -> list[np.ndarray]:
    """Accelerations from rest, of all choices of stick and slip that agree with themselves."""
    joints, found = list(mechanism.dry), []
    for ways in product((0, 1, -1), repeat=len(joints)):
        slips = tuple((j, way) for j, way in zip(joints, ways, strict=True) if way)
        moving = in_mode(mechanism, Mode((), slips))
        still = [j for j, way in zip(joints, ways, strict=True) if not way]
        M = closed_form.mass_matrix(mechanism, q)
        free = robodyn.forward_dynamics(moving, q, 0 * q, tau)
        load = M @ free
        qdd, forces = free, np.zeros(len(still))
        if still:
            K = np.block(
                [
                    [M, -np.eye(len(q))[:, still]],
                    [np.eye(len(q))[still], np.zeros((len(still),) * 2)],
                ]
            )
            solved = np.linalg.solve(K, np.r_[load, np.zeros(len(still))])
            qdd, forces = solved[: len(q)], solved[len(q) :]
        most = np.array([mechanism.dry[j].static for j in still])
        if (np.abs(forces) <= most + 1e-12).all() and all(
            way * qdd[j] >= -1e-12 for j, way in slips
        ):
            found.append(qdd)
    return found


STATES = 6 if FRESH else 3


@pytest.mark.parametrize("seed", range(12 if FRESH else 6))
def test_accelerations_from_rest_against_all_choices(seed: int) -> None:
    numbers = random.Random(seed)
    n = numbers.randint(1, 4)
    links = []
    for k in range(n):
        slides = numbers.random() < 0.4
        static = numbers.uniform(0.0, 8.0)
        friction = dry(0.5 * static, static, 0.1, "force" if slides else "torque")
        kind = "joint: prismatic, axis: [1, 0.5], " if slides else ""
        links.append(f"  - {{name: a{k}, {kind}m: 1, l: 0.5, r: 0.2, I: 0.1, {friction}}}")
    mechanism = scene("gravity: 9.81\nlinks:\n" + "\n".join(links) + "\n")
    q = np.array([[numbers.uniform(-2, 2) for _ in range(n)] for _ in range(STATES)])
    tau = np.array([[numbers.uniform(-15, 15) for _ in range(n)] for _ in range(STATES)])
    qdd = robodyn.forward_dynamics(mechanism, q, 0 * q, tau)  # a batch
    for each in range(STATES):
        exact = brute_force(mechanism, q[each], tau[each])
        assert exact
        for one in exact:  # they are the same motion
            np.testing.assert_allclose(qdd[each], one, atol=1e-10 * max(1.0, np.abs(one).max()))


def test_many_joints_start_at_once() -> None:
    """A chain of 12 that hangs level: more starts than can be tried."""
    links = "\n".join(
        f"  - {{name: a{k}, m: 1, l: 0.3, r: 0.15, I: 0.01, {dry(0.02, 0.03, 0.1)}}}"
        for k in range(12)
    )
    mechanism = scene(f"gravity: 9.81\nlinks:\n{links}\n")
    q = np.linspace(0.1, 0.6, 12)
    qdd = robodyn.forward_dynamics(mechanism, q, 0 * q, 0 * q)
    with pytest.warns(match="at rest"):
        tau = robodyn.inverse_dynamics(mechanism, q, 0 * q, qdd)
    for joint, load in enumerate(tau):  # inverse knows the friction of those that start
        assert abs(load) < 1e-11 or (qdd[joint] == 0.0 and abs(load) <= 0.03)


def test_forces_between_bounds_solve_their_problem() -> None:
    numbers = np.random.default_rng(3)
    for _ in range(300):
        n = int(numbers.integers(1, 8))
        A = numbers.normal(size=(int(numbers.integers(1, n + 1)), n))
        W, a0 = A.T @ A, A.T @ numbers.normal(size=len(A)) * 3.0
        low, high = -numbers.uniform(0, 1, n), numbers.uniform(0, 1, n)
        endless = numbers.random(n) < 0.2
        if numbers.random() < 0.5:  # what no forces stop, were they not between bounds
            a0, endless[1:] = a0 + numbers.normal(size=n), False
        low[endless] = -np.inf
        f = forces_between(a0, W, low, high)
        a = a0 + W @ f
        assert ((f >= low) & (f <= high)).all()
        free, tight = (f > low) & (f < high), 1e-9 * (1.0 + np.abs(a0).max())
        assert np.abs(a[free]).max(initial=0.0) < tight
        assert (a[f == low] > -tight).all()
        assert (a[f == high] < tight).all()


def test_forward_undoes_inverse_while_joints_slip() -> None:
    numbers = np.random.default_rng(1)
    mechanism = scene(
        "gravity: 9.81\nlinks:\n"
        f"  - {{name: a, m: 1, l: 1, r: 0.5, I: 0.1, {dry(1, 2, 0.1)}, "
        "limits: {max: 1, stiffness: 100, damping: 3}}\n"
        f"  - {{name: b, m: 1, l: 1, r: 0.5, I: 0.1, {dry(1, 2)}}}\n"
    )
    q, qd, qdd = (numbers.normal(size=(200, 2)) for _ in range(3))
    tau = robodyn.inverse_dynamics(mechanism, q, qd, qdd)
    found = robodyn.forward_dynamics(mechanism, q, qd, tau)
    np.testing.assert_allclose(found, qdd, atol=1e-11)


def test_other_forces_hold_friction_in_motion_and_compliant_stops() -> None:
    """-(torque + (static - torque) e^(-(v/stribeck)^2)) sign(v), and k (q - end) + d v outward."""
    mechanism = scene(
        "gravity: 9.81\nlinks:\n"
        f"  - {{name: a, m: 1, l: 1, r: 0.5, I: 0.1, {dry(1, 1.5)}}}\n"
        f"  - {{name: b, m: 1, l: 1, r: 0.5, I: 0.1, {dry(1, 2, 0.5)}, "
        "limits: {max: 1, stiffness: 100, damping: 3}}\n"
    )
    q = np.array([[[0.3, 0.2]], [[0.3, 1.1]]])
    qd = np.array([[1.0, 0.5], [-1.0, 0.0], [0.0, -20.0], [0.0, -0.5]])
    bell = 1.0 + math.exp(-1.0)
    free = [[-1.0, -bell], [1.0, 0.0], [0.0, 1.0], [0.0, bell]]
    pushed = [[-1.0, -bell - 11.5], [1.0, -10.0], [0.0, 1.0], [0.0, bell - 8.5]]
    Q = robodyn.other_forces(mechanism, q, qd)
    np.testing.assert_allclose(Q, [free, pushed], atol=1e-12)
    # where no joint with friction rests, these are the forces of the equation of motion
    moving, qdd = np.array([2.0, -0.3]), np.array([0.7, -1.1])
    terms = [
        closed_form.mass_matrix(mechanism, q) @ qdd,
        closed_form.coriolis_matrix(mechanism, q, moving) @ moving,
        closed_form.gravity_vector(mechanism, q),
        -robodyn.other_forces(mechanism, q, moving),
    ]
    tau = robodyn.inverse_dynamics(mechanism, q, moving, qdd)
    np.testing.assert_allclose(tau, sum(terms), atol=1e-11)


# -- wrong values ----------------------------------------------------------------------------------


GOOD = {
    "friction": {"torque": 1.0, "static": 2.0, "stribeck": 0.1},
    "stops": {"min": -1.0, "max": 1.0, "stiffness": 100.0, "damping": 1.0},
    "hard": {"min": -1.0, "max": 1.0, "restitution": 0.5},
}
WRONG: dict[str, list[Any]] = {
    "torque": [-1, "nan", "inf", "text", "[1]", "null"],
    "static": [-1, 0.5, ".inf", "text", "{}"],
    "stribeck": [0, -0.1, "nan", "text"],
    "min": ["text", ".nan", 1.0, 2.0, "[0]"],
    "max": ["text", ".inf", -1.0, -3.0],
    "stiffness": [0, -5, ".nan", "text", "true"],
    "damping": [-1, ".inf", "text"],
    "restitution": [-0.1, 1.1, ".nan", "text", "[]"],
    "unknown": [1],
}


def test_wrong_values_are_refused() -> None:
    numbers = random.Random(14)
    for _ in range(100):
        what = numbers.choice(list(GOOD))
        keys = dict(GOOD[what])
        name = numbers.choice([*keys, "unknown"])
        value = keys[name] = numbers.choice(WRONG[name])
        key = "friction" if what == "friction" else "limits"
        inner = ", ".join(f"{x}: {v}" for x, v in keys.items())
        text = f"links:\n  - {{name: a, m: 1, l: 1, r: 0, I: 1, {key}: {{{inner}}}}}\n"
        with pytest.raises(DescriptionError) as caught:
            from_text(text, "bad.yaml")
        told = str(caught.value)
        assert told.startswith("bad.yaml:2: links[0] (a)"), (text, told)
        assert key in told
        where = {"min": ("min", "max")}.get(name, (name, "torque", "static"))
        assert any(f"{key}.{x}" in told for x in where), (text, told, value)
