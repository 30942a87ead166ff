"""Impacts where several joints meet or stand on their ends, against all choices of impulses."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH, Outcome
from contact_scenes import FIVE_BAR, FOUR_BAR, SLIDER_CRANK, scene
from scipy.linalg import null_space

import robodyn
from robodyn.dynamics import closed_form
from robodyn.elements.joints import HardStop
from robodyn.loops import closures
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs import report
from robodyn.runs.simulation import Motion, simulate

Run = Callable[..., Outcome]
Array = np.ndarray
METHODS = ("DOP853", "taylor", "RK45", "Radau")
NEAR = 1e-12  # so near to its end a joint is on it; part of the fastest rate that is none


def rates_by_choices(
    mechanism: Mechanism, q: Array, qd: Array, ends: list[tuple[int, int]], e: Array
) -> list[Array]:
    """Return the rates after an impact of each choice of ends that push, if it obeys the law.

    With v the rates at which ends are left: v+ + e v >= 0, p >= 0, and p is zero or v+ + e v is.
    """
    N = np.eye(mechanism.n)
    if mechanism.rows:
        N = null_space(closures.closure_jacobian(mechanism, q, t=0.0), rcond=1e-9)
    R = np.array([-side * np.eye(mechanism.n)[joint] for joint, side in ends]).reshape(-1, len(qd))
    J = N @ np.linalg.solve(N.T @ closed_form.mass_matrix(mechanism, q) @ N, (R @ N).T)
    W, v, size = R @ J, R @ qd, 1e-9 * np.abs(qd).max()
    found = []
    for count in range(len(ends) + 1):
        for push in map(list, combinations(range(len(ends)), count)):
            p, own = np.zeros(len(ends)), W[np.ix_(push, push)]
            if count and np.linalg.cond(own) > 1e10:
                continue  # ends that are tied to one another: one of them pushes for all
            p[push] = np.linalg.solve(own, -(1.0 + e[push]) * v[push])
            if (p >= -size).all() and (W @ p + (1.0 + e) * v >= -size).all():
                found.append(qd + J @ p)
    return found


def impacts(
    mechanism: Mechanism, motion: Motion, qd: Array
) -> Iterator[tuple[Array, Array, Array, list[set[tuple[int, int]]]]]:
    """Yield q, and qd before and after each impact of a motion that starts with qd.

    Last, the ends met at the same instant by the impacts before it.
    """
    n, hits = mechanism.n, [x for x in motion.events if " hits its " in x.name]
    told = {f"{mechanism.link_names[j]} hits its {'max' if s > 0 else 'min'}": (j, s)
            for j, s, *_ in mechanism.of(HardStop)}  # fmt: skip
    time, turns, state = math.nan, list[set[tuple[int, int]]](), np.zeros(0)
    for hit in hits:
        if hit.t != time:
            row = int(np.searchsorted(motion.t, hit.t))
            before, turns = qd if hit.t == 0.0 else motion.qd[row], []
        elif (hit.y == state).all():
            turns[-1].add(told[hit.name])
            continue
        else:
            before = state[n:]
        time, state = hit.t, hit.y
        yield hit.y[:n], before, hit.y[n:], list(turns)
        turns.append({told[hit.name]})


def check_impacts(mechanism: Mechanism, motion: Motion, qd: Array) -> int:
    """Hold each impact of a motion that starts with qd against the law, and return their number.

    Those of joints that come to rest are left out: the lowest bounces, and those without end.
    """
    count = 0
    for q, before, after, turns in impacts(mechanism, motion, qd):
        least, met = NEAR * np.abs(before).max(), set().union(*turns)
        ends, doubtful = [], []
        for joint, side, end, _ in mechanism.of(HardStop):
            if abs(q[joint] - end) <= NEAR * max(1.0, abs(end)):
                # one met at this instant by another impact may have left it, or rest on it
                stands = abs(before[joint]) <= least and (joint, side) in met
                if stands or side * before[joint] >= -least:
                    (doubtful if stands else ends).append((joint, side))
        M = closed_form.mass_matrix(mechanism, q)
        assert after @ M @ after <= (1.0 + 1e-9) * (before @ M @ before)
        e = {stop.joint: stop.restitution for stop in mechanism.of(HardStop)}
        if max(e[joint] * abs(before[joint]) for joint, _ in ends) < 3e-3 or len(turns) >= 30:
            continue
        errors = []
        for some in range(len(doubtful) + 1):
            for more in combinations(doubtful, some):
                own = [*ends, *more]
                found = rates_by_choices(
                    mechanism, q, before, own, np.array([e[j] for j, _ in own])
                )
                assert found
                errors.append(max(np.abs(after - each).max() for each in found))
        assert min(errors) < 1e-8 * np.abs(before).max()
        count += 1
    return count


# -- random scenes ---------------------------------------------------------------------------------


def chain(numbers: random.Random) -> tuple[str, list[int], list[int]]:
    """A scene of links in a chain or a tree with a %s for each, its free joints, and all."""
    n = numbers.randint(2, 4)
    links = []
    for k in range(n):
        kind = f"joint: prismatic, axis: [{numbers.uniform(-1, 1):.3f}, 1], "
        kind = kind if numbers.random() < 0.25 else ""
        kind += f"from: a{numbers.randrange(k)}, " if k and numbers.random() < 0.3 else ""
        links.append(f"{{name: a{k}, {kind}{bar(numbers)}, %s}}")
    return f"links: [{', '.join(links)}]\n", list(range(n)), list(range(n))


def geared(numbers: random.Random) -> tuple[str, list[int], list[int]]:
    """The same of links beside one another, the first of which are coupled."""
    n = numbers.randint(2, 4)
    links = [f"{{name: a{k}, from: [{0.5 * k}, 0], {bar(numbers)}, %s}}" for k in range(n)]
    coupled = numbers.randint(1, n - 1)
    ratios = [f"'q{k + 2} = {numbers.choice([-1, 1, -2.3, 0.7])} q{k + 1}'" for k in range(coupled)]
    free = [0, *range(coupled + 1, n)]
    driven = ", ".join(f"a{k}" for k in free)
    text = f"links: [{', '.join(links)}]\ncouplings: [{', '.join(ratios)}]\nactuated: [{driven}]\n"
    return text, free, list(range(n))


def bar(numbers: random.Random) -> str:
    ranges = {"m": (0.5, 2), "l": (0.3, 1), "r": (0.1, 0.5), "I": (0.02, 0.2)}
    return ", ".join(f"{x}: {numbers.uniform(*ends):.3f}" for x, ends in ranges.items())


def loop(numbers: random.Random) -> tuple[str, list[int], list[int]]:
    """The same of a closed mechanism."""
    text, free, joints = numbers.choice(
        [(FOUR_BAR, [0], [0, 1, 2]), (SLIDER_CRANK, [0], [0, 2]), (FIVE_BAR, [0, 2], [0, 1, 2, 3])]
    )
    for name in ("crank", "coupler", "rocker", "piston", "each"):
        text = text.replace(f"{{{name}}}", "%s")
    return text.replace("gravity: 9.81\n", "").format(), free, joints


def drawn(seed: int) -> tuple[Mechanism, Array, Array, str, float]:
    """Return a scene with two to four stops, a start, torques and how long.

    Its joints are on their ends at once, reach them at one instant, or nearly so, or are apart.
    """
    numbers = random.Random(seed)
    text, free, joints = numbers.choice([chain, geared, loop])(numbers)
    text = f"gravity: {numbers.choice([0, 9.81])}\n{text}"
    plain = scene(text.replace(", %s", ""))
    near = [1.8, 1.1] if len(free) == 2 and "closures" in text else [0.0] * 4
    reach = 0.2 if any(near) else 1.5
    angles = [x + numbers.uniform(-reach, reach) for x, _ in zip(near, free, strict=False)]
    rates = [numbers.choice([0.0, numbers.uniform(-3, 3), numbers.uniform(-3, 3)]) for _ in free]
    rates = rates if any(rates) else [1.0, *rates[1:]]
    if plain.rows:
        q = robodyn.assemble(plain, angles)
        qd = robodyn.loop_velocities(plain, q, rates)
    else:
        q, qd = np.array(angles), np.array(rates)
    loads = [numbers.uniform(-3, 3) * (numbers.random() < 0.5) for _ in plain.actuated]
    tau, how = (
        ", ".join(f"{x:.4f}" for x in loads),
        numbers.choice(["on", "on", "reached", "apart"]),
    )
    at = q
    if how == "reached":  # by the motion that comes from there
        back = simulate(plain, q, -qd, numbers.uniform(0.02, 0.2), tau, rtol=1e-12, atol=1e-12)
        at, q, qd = q, back.q[-1], -back.qd[-1]
    chosen = numbers.sample(joints, min(numbers.randint(2, 4), len(joints)))
    keys = dict.fromkeys(range(plain.n), "damping: 0")
    for joint in chosen:
        side = 1 if qd[joint] > 0.0 or (not qd[joint] and numbers.random() < 0.5) else -1
        if how == "on" and not plain.rows and numbers.random() < 0.25:
            side = -side  # it leaves its end
        if how == "reached" and side * (q[joint] - at[joint]) > 0.0:
            side = -side
        end = float(at[joint]) + (side * numbers.uniform(0.0, 0.3) if how == "apart" else 0.0)
        e = numbers.choice([0.0, 0.0, 0.2, 0.4, 0.6, 0.9, 1.0, round(numbers.random(), 3)])
        word = "max" if side > 0 else "min"
        keys[joint] = f"limits: {{{word}: {end!r}, restitution: {e}}}"
    if numbers.random() < 0.25:
        for joint in set(joints) - set(plain.slides):
            keys[joint] += ", friction: {torque: 0.2, static: 0.3}"
    shown = [keys[k] for k in (range(plain.n) if len(joints) == plain.n else joints)]
    return scene(text % tuple(shown)), q, qd, tau, numbers.choice([0.2, 0.6])


SEEDS = range(FIRST_SEED, FIRST_SEED + 2000) if FRESH else range(20)


@pytest.mark.parametrize("tens", range(len(SEEDS) // 10))
def test_impacts_of_random_scenes(tens: int) -> None:
    for seed in SEEDS[10 * tens : 10 * tens + 10]:
        mechanism, q, qd, tau, end = drawn(seed)
        method = METHODS[seed % len(METHODS)]
        motion = simulate(mechanism, q, qd, end, tau, method=method, rtol=1e-9, atol=1e-9)
        assert motion.outcome is report.Outcome.FINISHED, seed
        assert motion.report.energy_drift < 1e-5, seed
        for joint, side, limit, _ in mechanism.of(HardStop):
            assert (side * (motion.q[:, joint] - limit)).max() < 1e-9, seed
        check_impacts(mechanism, motion, qd)


@pytest.mark.parametrize("method", METHODS)
def test_a_joint_that_turned_back_just_beyond_its_end_goes_on(method: str) -> None:
    """Impacts in turn throw it 4e-12 rad beyond: less than steps tell, more than rounding."""
    mechanism, q, qd, tau, end = drawn(765700)
    motion = simulate(mechanism, q, qd, end, tau, method=method, rtol=1e-9, atol=1e-9)
    assert motion.outcome is report.Outcome.FINISHED
    assert motion.report.energy_drift < 1e-7
    check_impacts(mechanism, motion, qd)


# -- ends that are tied to one another -------------------------------------------------------------

FINGER = "m: 0.1, l: 0.08, r: 0.04, I: 5.0e-5"
FINGERS = f"""gravity: 0
links:
  - {{{{name: left, {FINGER}, from: [0, 0.03], limits: {{{{max: 40deg, restitution: {{}}}}}}}}}}
  - {{{{name: right, {FINGER}, from: [0, -0.03], limits: {{{{min: -40deg, restitution: {{}}}}}}}}}}
couplings: ["q2 = -q1"]
actuated: [left]
"""
PAIRS = [(0.2, 0.2), (0.2, 0.6), (0.6, 0.2), (0.0, 1.0)]
EACH = pytest.mark.parametrize("method", METHODS)


@EACH
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.thinned
def test_geared_fingers_meet_their_ends_at_once(pair: tuple[float, float], method: str) -> None:
    """Under a constant torque, and the larger restitution is that of both."""
    mechanism, way = scene(FINGERS.format(*pair)), math.radians(20.0)
    given = {"method": method, "rtol": 1e-10, "atol": 1e-10}
    motion = simulate(mechanism, [way, -way], [0.0, 0.0], 0.5, "0.01", **given)
    assert motion.outcome is report.Outcome.FINISHED
    speed_up, e = 0.01 / (2.0 * (5.0e-5 + 0.1 * 0.04**2)), max(pair)
    first, v = math.sqrt(2.0 * way / speed_up), math.sqrt(2.0 * way * speed_up)
    hits, exact = [x for x in motion.events if x.name == "left hits its max"], first
    assert [x.name for x in motion.events] == ["left hits its max", "right hits its min"] * len(
        hits
    )
    for hit in hits[:5]:
        v *= e
        assert abs(hit.t - exact) < 1e-6
        np.testing.assert_allclose(hit.y[2:], [-v, v], atol=2e-6)
        exact += 2.0 * v / speed_up
    if e < 0.5:  # the bounces have come to their end
        np.testing.assert_array_equal(motion.qd[-1], 0.0)
        np.testing.assert_allclose(motion.q[-1], [2.0 * way, -2.0 * way], atol=1e-14)


def test_a_sweep_goes_on_over_ends_met_at_once(robodyn: Run, tmp_path: Path) -> None:
    path = tmp_path / "fingers.yaml"
    path.write_text(FINGERS.format(0.2, 0.2))
    given = robodyn(
        "sweep", path, "--vary", "links.left.limits.restitution=0,0.2,0.6", "--q", "20deg",
        "--tau", 0.01, "--time", 0.2, "--result", "final",
    )  # fmt: skip
    assert given.code == 0, given.err
    assert [row["outcome"] for row in given.rows] == ["finished"] * 3
    found = [float(row["qd1_end"]) for row in given.rows]
    a, begun = 0.01 / 4.2e-4, math.sqrt(2.0 * math.radians(20.0) / (0.01 / 4.2e-4))
    exact = [a * (0.2 - begun) - e * a * begun for e in (0.2, 0.2, 0.6)]
    np.testing.assert_allclose(found, exact, atol=1e-8)


CRANK = """gravity: 0
links:
  - {{name: crank, m: 0.8, l: 0.2, r: 0.09, I: 0.003, limits: {{max: 60deg, restitution: {}}}}}
  - {{name: rod, m: 0.5, l: 0.2, r: 0.11, I: 0.0022, limits: {{min: -120deg, restitution: {}}}}}
closures: [{{point: rod, on: {{through: [0, 0], along: [1, 0]}}}}]
actuated: [crank]
"""


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.thinned
def test_a_crank_and_its_rod_meet_their_ends_at_once(
    pair: tuple[float, float], method: str
) -> None:
    """Of the work of the torque e^2 is left in the motion, as there is one freedom."""
    mechanism, begun = scene(CRANK.format(*pair)), math.radians(30.0)
    given = {"method": method, "rtol": 1e-10, "atol": 1e-10}
    motion = simulate(mechanism, [begun, -2.0 * begun], [0.0, 0.0], 0.5, "5", **given)
    assert motion.outcome is report.Outcome.FINISHED
    first, other = motion.events[:2]
    assert (first.name, other.name) == ("crank hits its max", "rod hits its min")
    assert first.t == other.t
    M = closed_form.mass_matrix(mechanism, first.y[:2])
    energy = 0.5 * first.y[2:] @ M @ first.y[2:]
    assert abs(energy - max(pair) ** 2 * 5.0 * begun) < 1e-7
    if 0.0 < max(pair) < 1.0:
        np.testing.assert_array_equal(motion.qd[-1], 0.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ends", [(0, 1), (0, 2), (1, 2), (0, 1, 2)])
@pytest.mark.thinned
def test_two_and_three_ends_of_a_loop_are_met_at_once(ends: tuple[int, ...], method: str) -> None:
    plain = scene(FOUR_BAR.format(crank="damping: 0", coupler="damping: 0", rocker="damping: 0"))
    q = robodyn.assemble(plain, [1.3])
    way = robodyn.loop_velocities(plain, q, [4.0])
    keys = dict.fromkeys(("crank", "coupler", "rocker"), "damping: 0")
    for joint, e in zip(ends, (0.1, 0.5, 0.3), strict=False):
        word = "max" if way[joint] > 0.0 else "min"
        keys[list(keys)[joint]] = f"limits: {{{word}: {float(q[joint])!r}, restitution: {e}}}"
    begun = robodyn.assemble(plain, [1.2])
    qd = robodyn.loop_velocities(plain, begun, [4.0])
    motion = simulate(scene(FOUR_BAR.format(**keys)), begun, qd, 0.1, method=method)
    assert motion.outcome is report.Outcome.FINISHED
    first = motion.events[0]
    assert sum(x.t == first.t for x in motion.events) == len(ends)
    before = motion.qd[int(np.searchsorted(motion.t, first.t))]
    np.testing.assert_allclose(first.y[3:], -0.5 * before, atol=1e-9)


# -- joints that stand on their ends ---------------------------------------------------------------

ARMS = """gravity: 0
links:
  - {{name: a, m: 1, l: 1, r: 0.5, I: 0.08, limits: {{max: 0.5, restitution: 0.4}}}}
  - {{name: b, m: 1, l: 1, r: 0.5, I: 0.08, limits: {{max: 0, restitution: {}}}}}
"""


@EACH
@pytest.mark.parametrize("e", [0.0, 0.7])
@pytest.mark.thinned
def test_a_joint_on_its_end_takes_part_in_an_impact_unpressed(e: float, method: str) -> None:
    """No force holds it there: what rounding makes of zero must not let it go.

    Of the law p = (3.724, 1.162) and rates of -0.4, 0 are the only solution.
    """
    mechanism, given = scene(ARMS.format(e)), {"method": method}
    for begun in (0.4, 0.5):  # at the start too
        end = 0.2 + (0.5 - begun)
        motion = simulate(mechanism, [begun, 0.0], [1.0, 0.0], end, **given)
        assert [x.name for x in motion.events] == ["a hits its max"]
        np.testing.assert_allclose(motion.q[-1], [0.42, 0.0], atol=1e-12)
        np.testing.assert_allclose(motion.qd[-1], [-0.4, 0.0], atol=1e-12)
        assert not motion.report.remarks
        assert motion.report.steps < 20


BALANCED = """gravity: 9.81
links:
  - {name: beam, m: 2, l: 0.6, r: 0, I: 0.07, payload: 0.7}
  - {name: weight, joint: prismatic, axis: [1, 0], m: 1.4, l: 0, r: 0, I: 0, from: "beam@-0.3,0",
     limits: {max: 0, restitution: 0.5}}
  - {name: other, m: 1, l: 0.3, r: 0.1, I: 0.01, from: [3, 0], limits: {max: 0.2, restitution: 0.5}}
"""


@pytest.mark.parametrize("method", METHODS)
def test_forces_that_cancel_hold_nothing_and_let_nothing_go(method: str) -> None:
    """A level beam in balance, on its end by springs that cancel, while another link swings."""
    text = BALANCED.replace("payload: 0.7}", "payload: 0.7, limits: {min: 0, restitution: 0}}")
    text += "springs: [{joint: beam, stiffness: 3, angle: 0.3}, "
    mechanism = scene(text + "{joint: beam, stiffness: 3, angle: -0.3}]")
    motion = simulate(mechanism, [0.0, 0.0, 0.1], [0.0, 0.0, 5.0], 0.5, method=method)
    assert motion.outcome is report.Outcome.FINISHED
    assert {x.name for x in motion.events} == {"other hits its max"}
    assert (motion.q[:, :2] == 0.0).all()
    assert motion.report.steps < 300


def test_an_impact_at_the_start_drives_a_joint_into_another_end() -> None:
    """It leaves its end as the run starts, and is thrown into it by the impact of the other."""
    text = ARMS.format(0.0).replace("restitution: 0.4", "restitution: 1")
    mechanism, begun = scene(text), np.array([1.0, -0.5])
    motion = simulate(mechanism, [0.5, 0.0], begun, 0.5, "0, 3")  # a torque that presses it
    M = closed_form.mass_matrix(mechanism, np.array([0.5, 0.0]))
    jump = np.linalg.inv(M)[:, 0]
    thrown = begun - jump * 2.0 * begun[0] / jump[0]
    assert thrown[1] > 0.0
    assert [x.name for x in motion.events[:2]] == ["a hits its max", "b hits its max"]
    np.testing.assert_allclose(motion.events[0].y[2:], thrown, atol=1e-12)
    assert motion.q[:, 1].max() < 1e-12
    assert motion.report.energy_drift < 1e-9


# -- ends met in turn ------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_impacts_in_turn_without_end_leave_joints_at_rest(method: str) -> None:
    """Two joints throw one another back ever sooner: each pair of impacts leaves 0.97 of rates."""
    rubs = "friction: {torque: 0.2, static: 0.3}, limits: {min: %s, max: %s, restitution: %s}"
    crank = rubs % (1.8663895028260415, 2.1726604454720193, 0.4)
    rod = rubs % (-1.3953039716172293, -1.2769058231739883, 0)
    text = (Path(__file__).parent.parent / "robots" / "five-bar.yaml").read_text()
    text = text.replace("I: 0.0044", f"I: 0.0044, {crank}").replace("I: 0.037", f"I: 0.037, {rod}")
    q = [2.0, -1.334760563333253, 1.0, 1.3082084117315835]
    qd = [2.0, -0.417311089297775, 5.0, -4.755210163820487]
    mechanism = scene(text)
    motion = simulate(mechanism, q, qd, 0.6, "0, 1", method=method)
    assert motion.outcome is report.Outcome.FINISHED
    assert abs(motion.events[-1].t - 0.1624462) < 1e-7
    ends = [2.17266045, -1.27690582, 1.94876048, 0.19871222]
    np.testing.assert_allclose(motion.q[-1], ends, atol=5e-9)
    np.testing.assert_array_equal(motion.qd[-1], 0.0)
    after = simulate(mechanism, motion.q[-1], motion.qd[-1], 0.1, "0, 1", method=method)
    np.testing.assert_array_equal(after.q[-1], motion.q[-1])
