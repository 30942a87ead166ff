"""Dry friction and stops in loops, and beside couplings, motors, tables and controllers."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from conftest import FRESH
from contact_scenes import FIVE_BAR, FOUR_BAR, SLIDER_CRANK, dry, kkt, scene
from scipy.linalg import null_space
from scipy.optimize import linprog

import robodyn
from robodyn.dynamics import closed_form
from robodyn.dynamics.sticking import mode_at
from robodyn.elements.joints import CompliantStop
from robodyn.loops import closures
from robodyn.mechanics import actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs import roots
from robodyn.runs.motion_columns import as_actuation
from robodyn.runs.phases import DOUBTS, Phases
from robodyn.runs.report import Outcome
from robodyn.runs.simulation import Motion, simulate

# -- which joints of a loop stick ------------------------------------------------------------------


def choices(
    mechanism: Mechanism, plain: Mechanism, q: np.ndarray, tau: np.ndarray
) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """All choices of stick (0) and slip (1, -1) that agree with themselves, and their qdd.

    From rest, by virtual power: qdd = N z with Psi N = 0, forces of friction at most `static`.
    """
    joints, n = mechanism.dry, mechanism.n
    N = null_space(closures.closure_jacobian(mechanism, q, t=0.0))
    M = closed_form.mass_matrix(mechanism, q)
    load = N.T @ M @ robodyn.forward_dynamics(plain, q, 0 * q, tau)
    found = []
    for ways in product((0, 1, -1), repeat=len(joints)):
        slip = dict(zip(joints, ways, strict=True))
        stuck = [j for j, way in slip.items() if not way]
        force = np.array(
            [-slip.get(j, 0) * joints[j].static if j in joints else 0 for j in range(n)]
        )
        A = np.block([[N.T @ M @ N, -N[stuck].T], [N[stuck], np.zeros((len(stuck),) * 2)]])
        right = np.r_[load + N.T @ force, np.zeros(len(stuck))]
        starts = [[-way * x for x in N[j]] + [0.0] * len(stuck) for j, way in slip.items() if way]
        bounds = [(None, None)] * N.shape[1] + [
            (-joints[j].static, joints[j].static) for j in stuck
        ]
        solved = linprog(
            np.zeros(A.shape[1]), starts or None, [-1e-4] * len(starts) or None, A, right, bounds
        )
        if solved.status == 0:
            found.append((ways, N @ solved.x[: N.shape[1]]))
    return found


def in_loop(text: str, joints: int, numbers: random.Random) -> tuple[Mechanism, Mechanism]:
    """A loop with dry friction of random size at its joints, and without."""
    statics = [numbers.choice([0.2, 2.0, 8.0]) for _ in range(joints)]
    slides = text is SLIDER_CRANK
    frictions = [
        dry(0.5 * x, x, 0.1, "force" if slides and k == joints - 1 else "torque")
        for k, x in enumerate(statics)
    ]
    for name in ("{each}", "{crank}", "{coupler}", "{rocker}", "{piston}"):
        text = text.replace(name, "{}")
    return scene(text.format(*frictions)), scene(text.format(*[""] * joints))


@pytest.mark.parametrize(
    ("text", "joints", "driven"), [(FOUR_BAR, 3, 1), (SLIDER_CRANK, 2, 1), (FIVE_BAR, 4, 2)]
)
def test_which_joints_of_a_loop_stick_against_all_choices(
    text: str, joints: int, driven: int
) -> None:
    numbers = random.Random(joints)
    seen = set()
    for _ in range(5):
        mechanism, plain = in_loop(text, joints, numbers)
        angles = [2.0 + numbers.uniform(-0.2, 0.0), 1.0 + numbers.uniform(-0.2, 0.2)]
        q = robodyn.assemble(mechanism, angles[:driven])
        tau = np.zeros(mechanism.n)
        tau[list(mechanism.actuated)] = [numbers.uniform(-10, 10) for _ in mechanism.actuated]
        ((ways, qdd),) = choices(mechanism, plain, q, tau)
        found = robodyn.forward_dynamics(mechanism, q, 0 * q, tau)
        np.testing.assert_allclose(found, qdd, atol=1e-9 * max(1.0, np.abs(qdd).max()))
        rests = list(mechanism.dry)
        standing = mode_at(mechanism, q, 0 * q, tau, rests, t=0.0)
        slips = dict(zip(rests, ways, strict=True))
        assert dict(standing.mode.slips) == {j: way for j, way in slips.items() if way}
        assert standing.still == tuple(j for j, way in slips.items() if not way)
        seen.add(sum(map(abs, ways)))
    assert len(seen) > 1  # some of them start, or all, or none


# -- energy, booked here ---------------------------------------------------------------------------


def losses(mechanism: Mechanism, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """What dampers, dry friction and compliant stops take (T,), W."""
    taken = (np.array(mechanism.damping) * qd**2).sum(axis=1)
    for joint, law in mechanism.dry.items():
        v = np.abs(qd[:, joint])
        bell = 0.0 if law.stribeck is None else np.exp(-((v / law.stribeck) ** 2))
        taken += (law.torque + (law.static - law.torque) * bell) * v
    for joint, side, end, stiffness, damping in mechanism.of(CompliantStop):
        beyond = side * (q[:, joint] - end) > 0.0
        push = side * (stiffness * (q[:, joint] - end) + damping * qd[:, joint])
        taken += np.where(beyond & (push > 0.0), damping * qd[:, joint] ** 2, 0.0)
    return taken


def missing_energy(
    mechanism: Mechanism,
    run: Motion,
    again: Callable[[np.ndarray], Motion],
    tau: Callable[[Motion], np.ndarray],
    breaks: Sequence[float] = (),
) -> float:
    """What the balance from start to end lacks, J: by Gauss' nodes between events.

    `again(t_eval)` is the run at other times, tau(motion) its torques (T, n).
    """
    n, lost = mechanism.n, 0.0
    for event in run.events:
        if "hits" in event.name:
            was = run.qd[int(np.searchsorted(run.t, event.t - 1e-13))]
            after, mass = event.y[n:], closed_form.mass_matrix(mechanism, event.y[:n])
            lost += 0.5 * (was @ mass @ was - after @ mass @ after)
        # a stop that gives holds energy while it is pressed
        for joint, side, end, stiffness, _ in mechanism.of(CompliantStop):
            for word, way in (("leaves", 1.0), ("meets", -1.0)):
                name = f"{mechanism.link_names[joint]} {word} its {'max' if side > 0 else 'min'}"
                if event.name == name:
                    lost += 0.5 * way * stiffness * (event.y[joint] - end) ** 2
    x, w = np.polynomial.legendre.leggauss(12)
    ends = np.unique([*run.t[[0, -1]], *(event.t for event in run.events), *breaks])
    ends = ends[np.diff(ends, prepend=-1.0) > 1e-9]
    ends = np.concatenate([np.linspace(a, b, 5)[:-1] for a, b in pairwise(ends)] + [ends[-1:]])
    half = 0.5 * np.diff(ends)[:, None]
    middle = 0.5 * (ends[1:] + ends[:-1])[:, None]
    nodes = again((middle + half * x).ravel())
    power = (tau(nodes) * nodes.qd).sum(axis=1) - losses(mechanism, nodes.q, nodes.qd)
    given = float(((half * w).ravel() * power).sum())
    states = [(run.q[i], run.qd[i]) for i in (0, -1)]
    first, last = (sum(closed_form.energies(mechanism, *state)) for state in states)
    return float(last - first + lost - given)


RATES = {"first": "qd1", "last": "qd3"}  # friction bends where a rate passes zero
MACHINE = """gravity: 9.81
links:
  - {name: pinion, m: 1.2, l: 0.3, r: [0.1, 0.05], I: 0.05,
     friction: {torque: 0.4, static: 0.7, stribeck: 0.2}}
  - {name: rack, joint: prismatic, axis: [1, 0.3], from: [0, 0], m: 2, l: 0, r: 0, I: 0,
     limits: {max: 0.078, restitution: 0.5}}
  - {name: arm, m: 0.7, l: 0.4, r: 0.2, I: 0.02, from: pinion, payload: 0.3,
     motor: {ratio: 12, inertia: 2.0e-4, damping: 1.0e-5},
     friction: {torque: 0.2, static: 0.35, stribeck: 0.3},
     limits: {max: 0.6, stiffness: 300, damping: 4}}
couplings: ["q2 = 0.15 q1"]
"""


def test_a_machine_with_everything() -> None:
    """A coupling, a payload, a motor, friction, a hard stop and one that gives."""
    mechanism = scene(MACHINE)
    runs = {}
    for method in ("DOP853", "taylor"):
        run = partial(
            simulate, mechanism, [0.4, 0.06, 0.2], [3.0, 0.45, 0.5], 0.45, "0, 0, 4*t",
            method=method, rtol=1e-11, atol=1e-11, events=RATES,
        )  # fmt: skip
        runs[method] = motion = run()
        assert motion.outcome is Outcome.FINISHED
        missing = missing_energy(
            mechanism, motion, lambda t, run=run: run(t_eval=t), lambda nodes: nodes.tau
        )
        assert abs(missing) < 1e-8
        assert motion.report.energy_drift < 1e-9
        hits = [event for event in motion.events if "hits" in event.name]
        assert hits
        for hit in hits:
            was = motion.qd[int(np.searchsorted(motion.t, hit.t - 1e-13))]
            exact = kkt(mechanism, hit.y[:3], was, 1, 0.5)
            np.testing.assert_allclose(hit.y[3:], exact, atol=1e-11)
    one, other = (run.events for run in runs.values())
    names = [event.name for event in one]
    assert {"arm meets its max", "arm leaves its max", "arm stops", "arm starts"} <= set(names)
    jumps = [event.t for event in one if event.name == "first"]
    assert {event.t for event in one if "hits" in event.name} <= set(jumps)
    assert names == [event.name for event in other]
    times = [[event.t for event in events] for events in (one, other)]
    np.testing.assert_allclose(*times, atol=1e-8)
    ends = [run.q[-1] for run in runs.values()]
    np.testing.assert_allclose(*ends, atol=1e-8)


# -- controllers and tables ------------------------------------------------------------------------

ARM = scene(
    "gravity: 9.81\nlinks:\n"
    f"  - {{name: upper, m: 1, l: 0.5, r: 0.25, I: 0.02, {dry(0.5, 0.9, 0.2)}}}\n"
    f"  - {{name: fore, m: 0.6, l: 0.4, r: 0.2, I: 0.01, {dry(0.3, 0.5, 0.2)}}}\n"
)
POINTS = np.linspace(0.0, 0.4, 9)
BOTH = {"first": "qd1", "last": "qd2"}


def table() -> robodyn.ReferenceTable:
    """Rests, then moves by a parabola."""
    way = np.maximum(POINTS - 0.1, 0.0)[:, None] * np.array([1.0, -2.0])
    rates = (POINTS > 0.1)[:, None] * np.array([1.0, -2.0])
    return robodyn.ReferenceTable(POINTS, 0.2 + way, 1.0 * rates)


@pytest.mark.parametrize(("method", "rate"), [("DOP853", None), ("taylor", 50.0)])
def test_energy_under_a_controller_while_joints_stick(method: str, rate: float | None) -> None:
    kp, kd = np.array([30.0, 15.0]), np.array([2.0, 1.0])
    tau = robodyn.controller(ARM, table(), "pd+g", kp.tolist(), kd.tolist(), control_rate=rate)
    run = partial(
        simulate, ARM, [0.2, 0.2], [0.0, 0.0], 0.4, tau,
        method=method, rtol=1e-10, atol=1e-10, events=BOTH,
    )  # fmt: skip
    motion = run()
    assert motion.outcome is Outcome.FINISHED
    names = {event.name for event in motion.events}
    assert {"upper starts", "fore starts"} <= names
    samples = np.arange(20) / 50.0 if rate else POINTS

    def law(nodes: Motion) -> np.ndarray:
        """By the law itself, of the states at the samples."""
        at = run(t_eval=samples) if rate else nodes
        q, qd = table().at(at.t)
        g = robodyn.gravity_vector(ARM, at.q)
        told = kp * (q - at.q) + kd * (qd - at.qd) + g
        return told[np.searchsorted(samples, nodes.t, side="right") - 1] if rate else told

    missing = missing_energy(ARM, motion, lambda t: run(t_eval=t), law, samples)
    assert abs(missing) < 1e-8
    assert motion.report.energy_drift < 1e-8


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_energy_under_torques_of_a_table_while_joints_stick(method: str) -> None:
    times = np.linspace(0.0, 0.4, 5)
    hold = robodyn.gravity_vector(ARM, [0.2, 0.2])
    torques = hold + np.array([[0, 0], [2, 0.3], [-1, 1], [-2, -1], [0, 0]])
    run = partial(
        simulate, ARM, [0.2, 0.2], [0.0, 0.0], 0.4, actuation.table(ARM, times, torques),
        method=method, rtol=1e-10, atol=1e-10, events=BOTH,
    )  # fmt: skip
    motion = run()
    assert motion.outcome is Outcome.FINISHED
    assert {"upper starts", "fore starts"} <= {event.name for event in motion.events}

    def between(nodes: Motion) -> np.ndarray:
        return np.stack([np.interp(nodes.t, times, tau) for tau in torques.T], axis=1)

    missing = missing_energy(ARM, motion, lambda t: run(t_eval=t), between, times)
    assert abs(missing) < 1e-8
    assert motion.report.energy_drift < 1e-8


# -- at one instant --------------------------------------------------------------------------------


BLOCKS = """gravity: 0
links:
  - {name: a, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0,
     limits: {max: 1, restitution: 0.5}}
  - {name: b, joint: prismatic, axis: [0, 1], m: 2, l: 0, r: 0, I: 0, from: [0, 0],
     limits: {min: -2, restitution: 0}}
  - {name: c, joint: prismatic, axis: [0, 1], m: 2, l: 0, r: 0, I: 0, from: [3, 0],
     friction: {force: 1, static: 1}}
  - {name: d, joint: prismatic, axis: [0, 1], m: 2, l: 0, r: 0, I: 0, from: [3, 0],
     limits: {max: 3, stiffness: 50}}
"""
METHODS = ("DOP853", "RK45", "Radau", "taylor")


@pytest.mark.parametrize("method", METHODS)
def test_events_at_one_instant_are_told_once_each(method: str) -> None:
    """Two joints hit, one stops, one meets its end, all at t = 1, where functions pass zero too."""
    events = {
        "half": "t - 1", "both": "q1 + q2 + 1", "back": "qd1 < 0", "past": "t > 1",
        "later": "t - 1.25",
    }  # fmt: skip
    small = 1e-8 if method == "Radau" else 1e-10
    run = partial(
        simulate, scene(BLOCKS), [0.0] * 4, [1.0, -2.0, 0.5, 3.0], 1.75,
        method=method, rtol=small, atol=small,
    )  # fmt: skip
    motion = run(events=events)
    found = {name: [x.t for x in motion.events if x.name == name] for name in events}
    stops = {"a hits its max", "b hits its min", "c stops", "d meets its max"}
    for name in ("half", "both", "back", "past", *stops):
        (t,) = [x.t for x in motion.events if x.name == name]
        assert abs(t - 1.0) < 1e-9
    (t,) = found["later"]  # not where the step ends that a stop cuts off
    assert abs(t - 1.25) < 1e-12
    times = [event.t for event in motion.events]
    assert times == sorted(times)
    last = [0.625, -2, 0.25, 3 - 3 * (0.75 - np.pi / 5)]
    np.testing.assert_allclose(motion.q[-1], last, atol=100.0 * small)
    ended = run(until="t > 1")
    assert ended.outcome is Outcome.EVENT
    assert abs(ended.t[-1] - 1.0) < 1e-9


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rate", [-0.5, -8.0, 0.0])
def test_what_jumps_through_zero_by_an_impact_is_told(method: str, rate: float) -> None:
    """Also where a function has one sign along the single step of the phase before."""
    ball = scene(
        "gravity: 9.81\nlinks:\n  - {name: ball, joint: prismatic, axis: [0, 1], m: 1, l: 0, "
        "r: 0, I: 0, limits: {min: 0, restitution: 0.5}}\n"
    )
    events = {"turns": "qd1", "up": "qd1 > 0", "shifted": "qd1 + t"}
    motion = simulate(ball, [0.1], [rate], 0.3, method=method, rtol=1e-6, atol=1e-9, events=events)
    hits = [event for event in motion.events if "hits" in event.name and event.y[1] > 1e-3]
    assert hits
    for name in events:
        found = [event.t for event in motion.events if event.name == name]
        for hit in hits:
            jumps = name != "shifted" or -hit.y[1] / 0.5 + hit.t < 0.0
            assert sum(abs(t - hit.t) < 1e-9 for t in found) == jumps


@pytest.mark.parametrize("method", ["DOP853", "Radau", "taylor"])
def test_what_rounding_hides_for_long_is_told_once(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Along its stop a joint follows this but for what the method misses: zero, or nearly."""
    boxes = 0
    times = roots.node_times

    def counted(begin: Any, end: Any) -> Any:
        nonlocal boxes
        boxes += len(begin)
        return times(begin, end)

    monkeypatch.setattr(roots, "node_times", counted)
    motion = simulate(
        scene(BLOCKS), [0.0] * 4, [1.0, -2.0, 0.5, 3.0], 1.3, method=method, rtol=1e-7,
        atol=1e-7, events={"same": "q4 - 3 - 3*sin(5*(t - 1))/5"},
    )  # fmt: skip
    assert 0 < boxes < 40 * (motion.report.steps + 5)  # 20,000 a step, if it were looked for
    told = [text for text in motion.report.remarks if "is zero to rounding" in text]
    assert len(told) == (method == "taylor") or method == "DOP853"


def test_samples_where_joints_stop_or_are_thrown_back() -> None:
    """A step of scipy's that overruns an event must not leave the sample that it took behind it."""
    reference = robodyn.ReferenceTable.set_point([1.2, 0.6], 2.0)
    gains = {"kp": [40, 20], "kd": [3, 1], "ki": [6, 3], "control_rate": 100}
    for end in ("friction: {torque: 4.5, static: 4.8}", "limits: {max: 1.2, restitution: 0.4}"):
        mechanism = scene(
            "gravity: 9.81\nlinks:\n"
            f"  - {{name: arm, m: 1.5, l: 0.3, r: 0.2, I: 0.05, {end}}}\n"
            "  - {name: rod, m: 0.9, l: 0.5, r: [0.2, 0.1], I: 0.03}\n"
        )
        tau = robodyn.controller(mechanism, reference, "pid", **gains)
        given = {"t_eval": [0.2, 0.4], "rtol": 1e-11, "atol": 1e-11}
        one, other = (
            simulate(mechanism, [0.6, 0.1], [3.0, 0.2], 0.4, tau, method=method, **given)
            for method in ("DOP853", "taylor")
        )
        assert one.events
        assert np.abs(one.q - other.q).max() < 1e-9


# -- bounces without end -----------------------------------------------------------------------

ARMS = """gravity: 9.81
links:
  - {{name: arm, m: 1.5, l: 0.3, r: 0.2, I: 0.05, limits: {{min: -0.5, max: 2, restitution: {}}}{}}}
  - {{name: rod, m: 0.9, l: 0.5, r: [0.2, 0.1], I: 0.03{}}}
"""
BOUNCING = {  # the scene, its start, gains and pose of a controller, how long, and what rests
    "one that slips": (
        ARMS.format(0.3, ", friction: {torque: 0.5, static: 0.6}", ""),
        ([-0.3, 0.1], [-1.0, 0.2], ([40, 20], [4, 2], [-0.7, 0.3])),
        0.2,
        [0],
    ),
    "one on another": (
        ARMS.format(0.7, "", ", limits: {min: -0.6, max: 0.9, restitution: 0.1}"),
        ([-0.06, 0.1], [-1.85, 0.97], None),
        0.5,
        [0, 1],
    ),
    "two that throw one another": (
        ARMS.format(
            0.27,
            "",
            "}\n  - {name: tip, m: 0.6, l: 0.4, r: 0.2, I: 0.03, "
            "limits: {min: -0.5, max: 0.7, restitution: 0.72}",
        ).replace("r: [0.2, 0.1]", "r: 0.2"),
        ([-0.02, 0.1, -0.15], [-1.29, 1.09, -0.7], ([40, 20, 10], [4, 2, 1], [-0.77, 0.88, -0.97])),
        0.3,
        [0],
    ),
}


@pytest.mark.parametrize("name", BOUNCING)
def test_bounces_end_in_rest_at_any_tolerance(name: str) -> None:
    """At each of four beside 1e-10 by some scene, and by all of them with FRESH=1."""
    text, (q, qd, law), end, rests = BOUNCING[name]
    mechanism, tau, ends = scene(text), None, []
    if law is not None:
        kp, kd, pose = law
        reference = robodyn.ReferenceTable.set_point(pose, 1.0)
        tau = robodyn.controller(mechanism, reference, "pd", kp=kp, kd=kd)
    turn, others = list(BOUNCING).index(name), (1e-4, 1e-6, 1e-12, 1e-13)
    chosen = others if FRESH else (others[turn], others[(turn + 2) % 4])
    for tolerance in (1e-10, *chosen):
        given = {"rtol": tolerance, "atol": tolerance, "max_evals": 20_000}
        motion = simulate(mechanism, q, qd, end, tau, **given)
        assert motion.outcome is Outcome.FINISHED, tolerance
        ends.append(np.r_[motion.q[-1], motion.qd[-1]])
        assert np.abs(ends[-1] - ends[0]).max() < 1e-8 + 100.0 * tolerance, tolerance
        assert not motion.qd[-1, rests].any()


def test_phases_of_one_step_count_as_evaluations() -> None:
    """However soon one phase follows another."""
    ends = "limits: {min: 0, restitution: 1}"
    block = f"{{name: block, joint: prismatic, axis: [0, 1], m: 1, l: 0, r: 0, I: 0, {ends}}}"
    given = {"rtol": 1e-4, "atol": 1e-4, "max_evals": 300}
    motion = simulate(scene(f"gravity: 10\nlinks: [{block}]\n"), [1e-8], [0.0], 0.02, **given)
    assert motion.outcome is Outcome.TOO_MANY_EVALUATIONS
    assert motion.report.evaluations <= 300 + 13  # those of one step


def test_a_loop_without_load_that_stops_stays() -> None:
    """What rounding leaves of its rates starts no joint."""
    keys = {"coupler": dry(0.171, 0.205), "rocker": dry(0.14, 0.14)}
    text = FOUR_BAR.replace("9.81", "0").format(crank="", **keys)
    mechanism = scene(text)
    for start in (0.5, 0.8, 1.1):
        q = robodyn.assemble(mechanism, [start])
        qd = robodyn.loop_velocities(mechanism, q, [1.5])
        motion = simulate(mechanism, q, qd, 2.0, rtol=1e-9, atol=1e-9, max_evals=5000)
        assert motion.outcome is Outcome.FINISHED
        assert not motion.qd[-1].any()


def test_a_joint_without_ends_rests_at_none() -> None:
    """Where rounding hides whether a joint starts, it is no stop that holds it."""
    friction = "friction: {force: 1, static: 1}"
    block = "{name: block, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0"
    mechanism = scene(f"links:\n  - {block}, {friction}}}\n")
    phases = Phases(mechanism, as_actuation(mechanism, [2.0]), np.zeros(3), 1.0, 1e-9)
    assert phases.guards[0].kind == "slips"
    phases.idle, phases.doubts = 1, DOUBTS - 1
    phases.next(0.0, phases.y, 0)
    assert phases.mode.slips == ((0, 1),)


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_a_joint_that_starts_again_does_not_touch_zero(method: str) -> None:
    """Its rate was zero to rounding while it was held, and is so for a moment after."""
    block = "{name: block, joint: prismatic, axis: [1, 0], m: 1.3, l: 0, r: 0, I: 0"
    mechanism = scene(f"links:\n  - {block}, friction: {{force: 1, static: 1}}}}\n")
    given = {"tau": "0.9 + 0.5*sin(20*t)", "events": {"v": "qd1"}}
    for tol in (1e-6, 1e-9, 1e-12):
        motion = simulate(mechanism, [0.7], [0.0], 4.0, method=method, rtol=tol, atol=tol, **given)
        assert motion.report.events["block starts"] > 10
        assert not [x for x in motion.report.remarks if "touches zero" in x]


@pytest.mark.parametrize("method", ["DOP853", "taylor", "Radau"])
def test_a_loop_on_a_cart_that_sticks_moves_as_on_the_ground(method: str) -> None:
    links = """
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: %s}
closures: [[coupler, rocker]]
actuated: [crank]
"""
    cart = "{name: cart, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0"
    cart += ", friction: {force: 8e3, static: 9e3}}"
    ground = scene("gravity: 9.81\nlinks:" + links % "[1.1, 0]")
    carried = scene(f"gravity: 9.81\nlinks:\n  - {cart}" + links % "'cart@1.1,0'")
    q = robodyn.assemble(ground, [1.0])
    given = {"method": method, "rtol": 1e-8, "atol": 1e-8}
    alone = simulate(ground, q, np.zeros(3), 0.6, **given)
    held = simulate(carried, [0.0, *q], np.zeros(4), 0.6, **given)
    assert held.q[-1] == pytest.approx([0.0, *alone.q[-1]], abs=1e-6)
    assert held.qd[-1] == pytest.approx([0.0, *alone.qd[-1]], abs=1e-6)
