"""Friction by the forces in pins and slides, against friction circles and Newton-Euler by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Outcome as Given
from contact_scenes import scene
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.optimize import brentq

import robodyn
from robodyn.dynamics.closed_form import energies, other_forces
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.friction_rounds import NotSettledError, forward_of_one, load_of
from robodyn.dynamics.identities import BALANCE, POWER, identities, sample_states
from robodyn.dynamics.reaction_forces import reactions
from robodyn.engines import rounds
from robodyn.engines.rounds import by_rounds
from robodyn.errors import DescriptionError, InputError
from robodyn.export.scene_text import scene_text
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.parts import without_rubbing
from robodyn.runs.motion_columns import as_actuation
from robodyn.runs.report import Outcome
from robodyn.runs.right_hand_side import right_hand_side
from robodyn.runs.simulation import simulate
from robodyn.scene.description import from_text
from robodyn.scene.plain_scene import plain_scene

Run = Callable[..., Given]
G = 9.81
CRANK, ROD = 0.1, 0.35
RADII = 0.02, 0.015, 0.012  # of the pins of the crank, the crank pin, the gudgeon pin
MASSES = (0.8, 0.5, 0.9), (0.002, 0.006)  # of crank, rod, piston; moments of inertia
OF_WAY = pytest.mark.parametrize("way", [1.0, -1.0])


def slider_crank(mu: float, load: float, massless: bool, guide: str, speed: float) -> Mechanism:
    """Friction at all three pins and along the guide: a joint that slides, or a closure."""
    (m1, m2, m3), (I1, I2) = (((0.0,) * 3, (0.0,) * 2)) if massless else MASSES
    pins = [f"{{coefficient: {mu}, radius: {r}, speed: {speed}}}" for r in RADII]
    along = f"{{coefficient: {mu}, speed: {speed}}}"
    text = f"""gravity: {0.0 if massless else G}
links:
  - {{name: crank, m: {m1}, l: {CRANK}, r: 0.04, I: {I1}, friction: {pins[0]}}}
  - {{name: rod, m: {m2}, l: {ROD}, r: 0.15, I: {I2}, friction: {pins[1]}}}
"""
    if guide == "joint":
        text += f"""  - {{name: piston, joint: prismatic, axis: [1, 0], m: {m3}, l: 0, r: 0, I: 0,
     from: [0, 0], friction: {along}}}
closures: [{{pins: [rod, piston], friction: {pins[2]}}}]
loads: [{{link: piston, at: [0, 0], force: [{load}, 0]}}]
actuated: [crank]
"""
    else:  # a block at the rod's end that does not turn, on a line of the ground
        text += f"""  - {{name: piston, from: rod, m: {m3}, l: 0, r: 0, I: 0, friction: {pins[2]}}}
closures:
  - {{point: piston, on: {{through: [0, 0], along: [1, 0]}}, aligned: 0, friction: {along}}}
loads: [{{link: piston, at: [0, 0], force: [{load}, 0]}}]
actuated: [crank]
"""
    return scene(text)


def cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def states(mechanism: Mechanism, angles: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    q = np.array([robodyn.assemble(mechanism, [x]) for x in angles])
    return q, np.array([robodyn.loop_velocities(mechanism, x, [rate]) for x in q])


def by_friction_circles(mu: float, load: float, angle: float, rate: float) -> float:
    """The torque at the crank: the rod's force is tangent to the circles of both of its pins."""
    a = CRANK * np.exp(1j * angle)
    d = math.sqrt(ROD**2 - a.imag**2) - 1j * a.imag  # from the crank pin to the gudgeon pin
    turning = -rate * a.real / d.real  # of the rod
    piston = rate * cross(a, d) / d.real  # its speed along the guide
    at_crank, at_gudgeon = (np.sign(x) for x in (turning - rate, turning))
    circles = mu * (RADII[1] * at_crank + RADII[2] * at_gudgeon)
    tilt = math.asin(-circles / ROD)
    for line in (np.angle(d) + tilt, np.angle(d) + math.pi - tilt):
        force = -load / (math.cos(line) - mu * np.sign(piston) * abs(math.sin(line)))
        if force > 0.0:  # on the piston, along the line
            pushed = force * np.exp(1j * line)
            pins = mu * force * (RADII[0] * np.sign(rate) - RADII[1] * at_crank)
            return cross(a, pushed) + pins
    raise AssertionError


@OF_WAY
@pytest.mark.parametrize("guide", ["joint", "line"])
@pytest.mark.parametrize("load", [-100.0, 60.0])
def test_the_force_of_a_rod_is_tangent_to_the_friction_circles(
    guide: str, load: float, way: float
) -> None:
    mechanism = slider_crank(0.15, load, True, guide, 1e-6)
    angles = np.linspace(-3.0, 3.0, 13)
    q, qd = states(mechanism, angles, 2.0 * way)
    tau = robodyn.inverse_dynamics(mechanism, q, qd, np.zeros_like(q))[:, 0]
    known = [by_friction_circles(0.15, load, x, 2.0 * way) for x in angles]
    assert np.abs(tau - known).max() < 1e-11 * np.abs(known).max()
    one = [robodyn.inverse_dynamics(mechanism, *x, np.zeros(3))[0] for x in zip(q, qd, strict=True)]
    assert np.abs(tau - one).max() < 1e-12 * np.abs(known).max()


def newton_euler(mu: float, load: float, speed: float, tau: float, y: np.ndarray) -> tuple:
    """The crank's acceleration, the forces in pins (3 complex, 1) and the power lost.

    The equations of the three bodies, with the friction of forces that are found again and again.
    """
    (m1, m2, m3), (I1, I2) = MASSES
    angle, rate = y[:2]
    a = CRANK * np.exp(1j * angle)
    d = math.sqrt(ROD**2 - a.imag**2) - 1j * a.imag
    w = -rate * a.real / d.real
    bend = (rate**2 * a.imag + w**2 * d.imag) / d.real  # of the rod, where the crank's is 0
    by = -a.real / d.real
    piston = -(rate * a.imag + w * d.imag)
    # accelerations: what the crank's adds, and what there is without
    first = 0.04 * np.exp(1j * angle)
    second = 0.15 / ROD * d
    moved = [(1j * first, -(rate**2) * first)]
    moved.append((1j * a + 1j * by * second, -(rate**2) * a + (1j * bend - w * w) * second))
    end = 1j * a + 1j * by * d, -(rate**2) * a + (1j * bend - w * w) * d
    smooth = [math.tanh(x / speed) for x in (rate, w - rate, w, piston)]
    found = np.zeros(8)  # acceleration; forces on the crank at O, on the rod at A and on the piston
    for _ in range(300):
        sizes = [math.hypot(*found[k : k + 2]) for k in (1, 3, 5)] + [abs(found[7])]
        rub = [-mu * r * N * s for r, N, s in zip((*RADII, 1.0), sizes, smooth, strict=True)]
        A, b = np.zeros((8, 8)), np.zeros(8)
        for row, (m, (one, none), on, off) in enumerate(
            ((m1, moved[0], 1, 3), (m2, moved[1], 3, 5))
        ):
            for k, part in enumerate(("real", "imag")):
                A[2 * row + k, 0] = m * getattr(one, part)
                A[2 * row + k, on + k], A[2 * row + k, off + k] = -1.0, 1.0
                b[2 * row + k] = -m * getattr(none, part) - (m * G if k else 0.0)
        # moments about the centres of gravity: friction at O and A on the crank, A and B on the rod
        A[4, 0], b[4] = I1, tau + rub[0] - rub[1]
        A[5, 0], b[5] = I2 * by, -I2 * bend + rub[1] + rub[2]
        for row, arms in ((4, ((1, -first, 1), (3, a - first, -1))),
                          (5, ((3, -second, 1), (5, d - second, -1)))):  # fmt: skip
            for k, arm, sign in arms:
                A[row, k], A[row, k + 1] = sign * arm.imag, -sign * arm.real
        A[6, 0], A[6, 5] = m3 * end[0].real, -1.0
        b[6] = -m3 * end[1].real + load + rub[3]
        A[7, 6], A[7, 7], b[7] = -1.0, -1.0, -m3 * G
        before, found = found, np.linalg.solve(A, b)
        if np.abs(found - before).max() < 1e-13 * np.abs(found).max():
            break
    lost = rub[0] * rate + rub[1] * (w - rate) + rub[2] * w + rub[3] * piston
    return found, lost


@pytest.mark.parametrize("guide", ["joint", "line"])
def test_accelerations_and_reactions_are_those_of_newton_and_euler(guide: str) -> None:
    mechanism = slider_crank(0.2, -50.0, False, guide, 0.05)
    q, qd = states(mechanism, np.linspace(-3.0, 3.0, 7), 6.0)
    tau = np.array([4.0, 0.0, 0.0])
    found = robodyn.forward_dynamics_and_forces(mechanism, q, qd, tau)
    R = reactions(mechanism, q, qd, found.qdd, found.multipliers)
    for k in range(len(q)):
        known, _ = newton_euler(0.2, -50.0, 0.05, 4.0, np.array([q[k, 0], 6.0]))
        assert found.qdd[k, 0] == pytest.approx(known[0], rel=1e-10)
        size = np.abs(known[1:]).max()
        assert np.abs(R[k, 0] - known[1:3]).max() < 1e-10 * size
        assert np.abs(R[k, 1] - known[3:5]).max() < 1e-10 * size
        if guide == "line":  # else the gudgeon pin is the closure
            assert np.abs(R[k, 2] - known[5:7]).max() < 1e-10 * size
    again = robodyn.inverse_dynamics(mechanism, q, qd, found.qdd)
    assert np.abs(again - tau).max() < 1e-10


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau"])
def test_a_run_is_that_of_newton_and_euler(method: str) -> None:
    mechanism = slider_crank(0.2, -50.0, False, "joint", 0.5)
    (q,), (qd,) = states(mechanism, np.array([0.4]), 8.0)
    rows = np.linspace(0.0, 0.4, 5)
    tight = 1e-12 if method == "DOP853" else 1e-8
    run = simulate(mechanism, q, qd, 0.4, [4.0], method, tight, tight, t_eval=rows)

    def rate(t: float, y: np.ndarray) -> list[float]:
        found, lost = newton_euler(0.2, -50.0, 0.5, 4.0, y)
        return [y[1], found[0], 4.0 * y[1] + lost]

    known = solve_ivp(rate, (0.0, 0.4), [0.4, 8.0, 0.0], "DOP853", rows, rtol=1e-13, atol=1e-13)
    bound = 1e-8 if method == "DOP853" else 5e-5
    assert np.abs(run.q[:, 0] - known.y[0]).max() < bound
    assert np.abs(run.qd[:, 0] - known.y[1]).max() < 10.0 * bound
    assert run.report.work == pytest.approx(known.y[2, -1], abs=10.0 * bound)  # the lost part too
    energy = run.to_dict()["energy"]
    assert energy[-1] - energy[0] == pytest.approx(run.report.work, abs=10.0 * bound)


@OF_WAY
@pytest.mark.parametrize("slope", [0.3, 1.2])
def test_a_block_on_an_incline(slope: float, way: float) -> None:
    """g (sin - coefficient cos) as it slides down, of a joint and of a point on a line."""
    axis = f"[{-math.cos(slope)}, {-math.sin(slope)}]"  # downhill
    own = "friction: {coefficient: 0.25, speed: 1e-5}"
    block = scene(f"""gravity: {G}
links: [{{name: block, joint: prismatic, axis: {axis}, m: 3, l: 0.1, r: [0.02, 0.1], I: 1, {own}}}]
""")
    qdd = robodyn.forward_dynamics(block, [0.2], [way * 1.5], [0.0])
    known = G * (math.sin(slope) - way * 0.25 * math.cos(slope))
    assert qdd[0] == pytest.approx(known, rel=1e-13)
    on_line = scene(f"""gravity: {G}
links:
  - {{name: x, joint: prismatic, axis: [1, 0], m: 0, l: 0, r: 0, I: 0}}
  - {{name: y, joint: prismatic, axis: [0, 1], from: x, m: 3, l: 0, r: 0, I: 0}}
closures: [{{point: y, on: {{through: [0, 0], along: {axis}}}, {own}}}]
""")
    down = np.array([-math.cos(slope), -math.sin(slope)])
    qdd = robodyn.forward_dynamics(on_line, 0.2 * down, way * 1.5 * down, [0.0, 0.0])
    assert qdd @ down == pytest.approx(known, rel=1e-13)


@OF_WAY
def test_a_pendulum_on_a_thick_pin(way: float) -> None:
    """Its pin's force needs the acceleration, and that the force: one equation, by bisection."""
    text = "{coefficient: 0.3, radius: 0.1, speed: 1e-4}"
    rod = scene(
        f"gravity: {G}\nlinks: [{{name: rod, m: 2, l: 1, r: 0.4, I: 0.1, friction: {text}}}]"
    )
    for angle in (-2.0, 0.3, 1.0):
        rate = 3.0 * way
        r = 0.4 * np.exp(1j * angle)

        def left(a: float, r: complex = r, rate: float = rate) -> float:
            force = 2.0 * ((1j * a - rate**2) * r + 1j * G)
            return (0.1 + 2.0 * 0.16) * a + 2.0 * G * r.real + way * 0.03 * abs(force)

        known = brentq(left, -1e3, 1e3, xtol=1e-13, rtol=1e-15)
        qdd = robodyn.forward_dynamics(rod, [angle], [rate], [0.0])
        assert qdd[0] == pytest.approx(known, abs=1e-11)
        assert robodyn.inverse_dynamics(rod, [angle], [rate], qdd) == pytest.approx(0.0, abs=1e-12)


SLOT = """gravity: 9.81
links:
  - {name: crank, m: 1, l: 0.2, r: 0.1, I: 0.01,
     friction: {coefficient: 0.1, radius: 0.02, speed: 0.1}}
  - {name: lever, from: [0, -0.4], m: 2, l: 0.9, r: 0.45, I: 0.1,
     friction: {coefficient: 0.2, radius: 0.03, speed: 0.1}}
closures:
  - {point: crank, on: {link: lever, through: [0, 0], along: [1, 0]},
     friction: {coefficient: 0.15, speed: 0.1}}
assembly: open
actuated: [crank]
"""


def test_a_pin_in_a_slot_of_a_lever_loses_the_power_that_the_equations_lack() -> None:
    """Power in less dE/dt is what pins and slot take, from their forces and slips by hand."""
    mechanism = scene(SLOT)
    q = robodyn.assemble(mechanism, [0.7])
    qd = robodyn.loop_velocities(mechanism, q, [5.0])
    found = robodyn.forward_dynamics_and_forces(mechanism, q, qd, [3.0, 0.0])
    h = 1e-6
    ends = [
        sum(energies(mechanism, q + s * (qd + s / 2 * found.qdd), qd + s * found.qdd))
        for s in (h, -h)
    ]
    lost = 3.0 * qd[0] - (ends[0] - ends[1]) / (2.0 * h)
    R = reactions(mechanism, q, qd, found.qdd, found.multipliers)
    pin = 0.2 * np.exp(1j * q[0])
    along = np.exp(1j * q[1])
    slip = (along.conjugate() * (1j * qd[0] * pin)).real
    normal = abs(found.multipliers[0])
    parts = [
        0.1 * 0.02 * np.hypot(*R[0]) * qd[0] * math.tanh(qd[0] / 0.1),
        0.2 * 0.03 * np.hypot(*R[1]) * qd[1] * math.tanh(qd[1] / 0.1),
        0.15 * normal * slip * math.tanh(slip / 0.1),
    ]
    assert lost == pytest.approx(sum(parts), rel=1e-7)
    assert min(parts) > 0.01
    # the lever's pin bears what its mass needs, and what the crank's pin does to the slot
    a = (1j * found.qdd[1] - qd[1] ** 2) * 0.45 * along
    on_pin = robodyn.pin_forces(mechanism, found.multipliers, q) @ [1.0, 1j]
    on_pin = on_pin[0] - 0.15 * normal * math.tanh(slip / 0.1) * along
    assert R[1] @ [1.0, 1j] == pytest.approx(2.0 * (a + 1j * G) + on_pin, rel=1e-12)


PIN = "friction: {coefficient: 0.15, radius: 0.03, speed: 0.3}"
ARM = f"""gravity: {G}
links:
  - {{name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082, {PIN}, motor: {{ratio: 5, inertia: 1e-3}}}}
  - {{name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031, {PIN}, payload: 0.4}}
  - {{name: c, joint: prismatic, axis: [0, 1], m: 0.5, l: 0.1, r: 0.05, I: 0.01,
     friction: {{coefficient: 0.2, speed: 0.2}}}}
springs:
  - {{between: [[0.3, 0.5], {{link: b, at: [0.2, 0.1]}}], stiffness: 40, length: 0.2, damping: 2}}
loads:
  - {{link: c, at: [0.1, 0], force: ["3 N sin(2 rad/s t)", -2]}}
  - {{link: b, at: [0.6, 0], force: [1, 2], frame: link}}
"""
FOUR = f"""gravity: {G}
links:
  - {{name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008, {PIN}}}
  - {{name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102, {PIN}}}
  - {{name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}}
closures: [{{pins: [coupler, rocker], {PIN}}}]
assembly: open
"""
CAM = f"""gravity: {G}
links:
  - {{name: disc, m: 1, l: 0, r: 0.01, I: 0.02, {PIN}}}
  - {{name: lift, joint: prismatic, axis: [0, 1], from: [0.01, 0.06], m: 0.5, l: 0.1, r: 0, I: 0.1,
     friction: {{coefficient: 0.1, speed: 0.01}}}}
couplings: [{{law: "q2 = 8 mm (1 - cos(q1))", cam: {{roller: 8 mm, at: [0, 0]}}}}]
"""


@pytest.mark.parametrize("count", [1, 500])
def test_forward_is_the_inverse_of_inverse_dynamics(count: int) -> None:
    """Of an arm, a four-bar and a lever with a slot, one state and many."""
    random = np.random.default_rng(7)
    for mechanism in (scene(ARM), scene(FOUR), scene(SLOT)):
        n = mechanism.n
        if mechanism.rows:
            q, _ = states(mechanism, random.uniform(0.2, 2.5, count), 0.0)
            rates = random.uniform(-4.0, 4.0, (count, 1))
            qd = robodyn.loop_velocities(mechanism, q, rates)
        else:
            q, qd = random.uniform(-1.0, 1.0, (2, count, n))
        tau = np.zeros((count, n))
        driven = list(mechanism.actuated)
        tau[:, driven] = random.uniform(-5.0, 5.0, (count, len(driven)))
        qdd = robodyn.forward_dynamics(mechanism, q, qd, tau)
        again = robodyn.inverse_dynamics(mechanism, q, qd, qdd)
        assert np.abs(again - tau).max() < 1e-9
        without = robodyn.forward_dynamics(without_rubbing(mechanism), q, qd, tau)
        assert np.abs(qdd - without).max() > 1e-3


def test_what_locks_is_refused_with_its_coefficient() -> None:
    mechanism = slider_crank(0.15, -100.0, True, "joint", 1e-6)
    q, qd = states(mechanism, np.array([1.5]), -2.0)
    assert robodyn.inverse_dynamics(mechanism, q, qd, np.zeros_like(q)).size
    mechanism = slider_crank(6.0, -100.0, True, "joint", 1e-6)
    with pytest.raises(NotSettledError) as error:
        robodyn.inverse_dynamics(mechanism, q, qd, np.zeros_like(q))
    assert "links[2] (piston).friction.coefficient = 6: friction has no solution" in str(
        error.value
    )


@pytest.mark.parametrize("text", [ARM, FOUR, SLOT, CAM])
@pytest.mark.parametrize("tau", [[1.5], "2*sin(3*t)"])
def test_written_out_rates_are_those_of_dense_algebra(text: str, tau: list[float] | str) -> None:
    mechanism = scene(text)
    actuated, random = len(mechanism.actuated), np.random.default_rng(3)
    torques = tau * actuated if isinstance(tau, list) else ",".join([tau] * actuated)
    actuation = as_actuation(mechanism, torques)
    both = [right_hand_side(mechanism, actuation, work=True, kind=kind) for kind in (None, "dense")]
    assert both[0].kind == "straight-line"
    for _ in range(20):
        q = robodyn.assemble(mechanism, random.uniform(0.3, 2.8, actuated))
        qd = robodyn.loop_velocities(mechanism, q, random.uniform(-5.0, 5.0, actuated))
        y = np.concatenate([q, qd, [0.0]])
        one, other = (np.array(side.rates(0.7, y)) for side in both)
        assert np.abs(one - other).max() < 1e-12 * np.abs(other).max()


@pytest.mark.parametrize("guide", ["joint", "line"])
def test_one_state_by_dense_algebra_is_one_of_many(guide: str) -> None:
    """Also if M is singular, as of a piston without inertia."""
    mechanism = slider_crank(0.3, -50.0, False, guide, 0.5)
    q, qd = states(mechanism, np.linspace(-3.0, 3.0, 9), 6.0)
    tau = np.tile([4.0, 0.0, 0.0], (9, 1))
    many = robodyn.forward_dynamics_and_forces(mechanism, q, qd, tau)
    for k in range(9):
        one = forward_of_one(mechanism, q[k], qd[k], tau[k], 0.0, 0.0)
        assert one.joints == pytest.approx(many.qdd[k], rel=1e-12)
        assert one.multipliers == pytest.approx(many.multipliers[k], rel=1e-11)


def test_runs_take_written_out_rates() -> None:
    mechanism = scene(SLOT)
    q = robodyn.assemble(mechanism, [0.7])
    run = simulate(mechanism, q, robodyn.loop_velocities(mechanism, q, [20.0]), 0.05)
    assert run.report.evaluator == "straight-line"


METHODS = pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau"])


@METHODS
@pytest.mark.parametrize("text", [ARM, FOUR, SLOT, CAM])
def test_the_energy_balance_counts_what_friction_takes(text: str, method: str) -> None:
    """To the tolerance; and the energy is less by the integral of forces times slips."""
    mechanism, tol = scene(text), 1e-9
    actuated = len(mechanism.actuated)
    q = robodyn.assemble(mechanism, [0.7] * actuated)
    qd = robodyn.loop_velocities(mechanism, q, [6.0, -3.0, 0.5][:actuated])
    tau = [0.3] * actuated
    run = simulate(mechanism, q, qd, 0.2, tau, method, tol, tol, t_eval=np.linspace(0, 0.2, 2001))
    assert run.outcome is Outcome.FINISHED
    assert run.report.energy_drift < 30.0 * tol
    motion = robodyn.forward_dynamics_and_forces(mechanism, run.q, run.qd, run.tau, run.t)
    load = load_of(mechanism, run.q, run.qd, motion.qdd, motion.multipliers, run.t)
    lost = (load * run.qd).sum(axis=-1)
    assert (lost <= 0.0).all()
    assert lost.min() < -0.1
    forces = other_forces(mechanism, run.q, run.qd, run.t)  # spring dampers, forces that turn
    power = ((run.tau + forces) * run.qd).sum(axis=-1) + lost
    work = cumulative_simpson(power, x=run.t, initial=0.0)
    energy = run.to_dict()["energy"]
    size = run.report.energy_in_motion
    assert np.abs(energy - energy[0] - work).max() < 1e-6 * size
    assert abs(run.report.work - work[-1]) < 1e-6 * size


@METHODS
def test_the_energy_balance_of_the_example_holds_until_it_locks(method: str) -> None:
    mechanism = robodyn.load("robots/shaper.yaml")
    q = robodyn.assemble(mechanism, [0.4])
    qd = robodyn.loop_velocities(mechanism, q, [20.0])
    tol = 1e-6 if method == "Radau" else 1e-8
    run = simulate(mechanism, q, qd, 0.5, None, method, tol, tol)
    assert run.outcome is Outcome.FRICTION
    assert run.report.energy_drift < 30.0 * tol
    assert run.report.t_reached == pytest.approx(0.127237, abs=1e-5)


def rod_on_a_line(mu: float, speed: float) -> Mechanism:
    """A uniform rod of 1 m whose end is kept on a rough line."""
    return scene(f"""gravity: {G}
links:
  - {{name: x, joint: prismatic, axis: [1, 0], m: 0, l: 0, r: 0, I: 0}}
  - {{name: y, joint: prismatic, axis: [0, 1], from: x, m: 0, l: 0, r: 0, I: 0}}
  - {{name: rod, from: y, m: 1.2, l: 0.5, r: 0, I: 0.1}}
closures: [{{point: {{link: rod, at: [-0.5, 0]}}, on: {{through: [0, 0], along: [1, 0]}},
            friction: {{coefficient: {mu}, speed: {speed}}}}}]
""")


def thrown(angle: float, slip: float, turning: float) -> tuple[np.ndarray, np.ndarray]:
    """A state of the rod, whose angle is told from that of link y, which points upwards."""
    q = np.array([0.5 * math.cos(angle), 0.5 * math.sin(angle), angle - 0.5 * math.pi])
    qd = np.array(
        [slip - 0.5 * math.sin(angle) * turning, 0.5 * math.cos(angle) * turning, turning]
    )
    return q, qd


@METHODS
@OF_WAY
def test_a_run_ends_where_friction_has_no_solution(method: str, way: float) -> None:
    """Painleve: of a uniform rod mu sin cos reaches 1/3 + cos^2 (k^2 = a^2/3)."""
    mu = 1.8
    q, qd = thrown(0.3, 6.0 * way, 6.0)
    run = simulate(rod_on_a_line(mu, 0.05), q, qd, 1.0, None, method, 1e-9, 1e-9)
    assert run.outcome is Outcome.FRICTION
    angle = math.atan(brentq(lambda tan: tan**2 - 3.0 * mu * tan + 4.0, 0.0, 1.5, xtol=1e-15))
    assert run.q[-1, 2] + 0.5 * math.pi == pytest.approx(angle, abs=1e-6)
    assert run.report.outcome == "friction"
    assert "closures[0].friction.coefficient = 1.8: friction has no solution" in run.report.advice
    assert run.report.t_reached == run.t[-1] > 0.06


def test_a_run_by_dense_algebra_ends_there_too() -> None:
    text = plain_scene(rod_on_a_line(1.8, 0.05).description)
    text["links"][2]["I"] = 1e-9  # and a payload at each end: M is not eliminated first
    dense = robodyn.load(text)
    q, qd = thrown(0.3, 6.0, 6.0)
    for method in ("DOP853", "Radau"):
        run = simulate(dense, q, qd, 1.0, None, method, 1e-8, 1e-8)
        assert run.outcome is Outcome.FRICTION, (run.outcome, run.report.evaluator)


def test_a_run_that_cannot_start_names_the_coefficient() -> None:
    q, qd = thrown(1.0, 6.0, 6.0)
    for call in (
        lambda: simulate(rod_on_a_line(1.8, 0.05), q, qd, 1.0),
        lambda: robodyn.forward_dynamics(rod_on_a_line(1.8, 0.05), q, qd, np.zeros(3)),
        lambda: robodyn.forward_dynamics(rod_on_a_line(80.0, 0.05), q, qd, np.zeros(3)),
    ):
        with pytest.raises(NotSettledError, match=r"closures\[0\]\.friction\.coefficient = \d"):
            call()


def test_rounds_that_are_slow_are_finished_by_newton() -> None:
    """f = part |N + f B| of real numbers, on either side of part B = 1."""
    slow = np.array([[0.999], [-0.999], [1.001], [0.3], [np.nan], [1e300]])
    f, left = by_rounds(slow, np.full((6, 1), 2.0 + 0j), np.ones((6, 1, 1), complex))
    assert left.tolist() == [False, False, True, False, False, True]
    known = [2.0 * x / (1.0 - x) for x in (0.999, 0.3)] + [-0.999 * 2.0 / 1.999]
    assert f[[0, 3, 1], 0] == pytest.approx(known, rel=1e-12)
    assert np.isnan(f[[2, 4, 5]]).all()


@pytest.mark.parametrize("text", [ARM, FOUR, SLOT, CAM])
def test_identities_include_it(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mechanism = scene(text)
    sample = sample_states(mechanism, 30)
    found = {x.name: x for x in identities(mechanism, sample)}
    assert all(x.holds for x in found.values())
    monkeypatch.setattr(
        rounds, "by_rounds", lambda *given: (0.999 * by_rounds(*given)[0], by_rounds(*given)[1])
    )
    wrong = {x.name for x in identities(mechanism, sample) if not x.holds}
    assert wrong == {BALANCE, POWER}


def test_identities_leave_out_states_without_a_solution() -> None:
    mechanism = rod_on_a_line(1.8, 0.05)
    sample = sample_states(mechanism, 50)
    with pytest.warns(RobodynWarning, match="no solution at .* of 50 random states"):
        found = identities(mechanism, sample)
    assert all(x.holds for x in found)
    assert {BALANCE, POWER} <= {x.name for x in found}
    with pytest.warns(RobodynWarning, match="no solution at 50 of 50"):
        found = identities(rod_on_a_line(1e9, 1e-9), sample)
    assert not {BALANCE, POWER} & {x.name for x in found}


def test_friction_by_forces_that_are_not_unique_says_so() -> None:
    """A parallelogram with a third crank."""
    mechanism = scene(f"""gravity: {G}
links:
  - {{name: a, m: 0.6, l: 0.35, r: 0.15, I: 0.008, {PIN}}}
  - {{name: b, m: 1.3, l: 1.0, r: 0.45, I: 0.102}}
  - {{name: c, m: 0.6, l: 0.35, r: 0.15, I: 0.008, from: [1.0, 0]}}
  - {{name: d, m: 0.6, l: 0.35, r: 0.15, I: 0.008, from: [0.5, 0]}}
closures: [[b, c], [{{link: b, at: [0.5, 0]}}, d]]
start: {{a: 0.7, b: -0.7, c: 0.7, d: 0.7}}
actuated: [a]
""")
    q, qd = np.array([0.7, -0.7, 0.7, 0.7]), np.array([4.0, -4.0, 4.0, 4.0])
    with pytest.warns(RobodynWarning, match="not unique .*; friction by them is not either"):
        robodyn.forward_dynamics(mechanism, q, qd, np.zeros(4))


# -- what does not serve ---------------------------------------------------------------------------


def test_what_has_no_such_friction_refuses_it_by_name() -> None:
    mechanism = scene(SLOT)
    q = robodyn.assemble(mechanism, [0.7])
    zero = np.zeros(2)
    place = r"links\[0\] \(crank\)\.friction\.coefficient = 0\.1"
    for what, call in (
        ("linear models", lambda: robodyn.linearize(mechanism, q)),
        ("regressors", lambda: robodyn.regressor(mechanism, q, zero, zero)),
        ("derivatives", lambda: robodyn.forward_dynamics_derivatives(mechanism, q, zero, zero)),
    ):
        with pytest.raises(InputError, match=f"{place}: .* {what} have no such friction"):
            call()
    with pytest.raises(InputError, match=r"as links\[0\] \(crank\)\.friction is, has no"):
        simulate(mechanism, q, zero, 1.0, method="taylor")


SHAPER = "robots/shaper.yaml"


@pytest.mark.parametrize(
    ("command", "what"),
    [
        ("linearize SHAPER --q 60deg", "linear models"),
        ("equations SHAPER", "equations"),
        ("regressor SHAPER --q 60deg --qd 3 --qdd 0", "regressors"),
        ("terms SHAPER --q 60deg --qd 3 --derivatives", "derivatives"),
        ("bench SHAPER --q 60deg --qd 3", "series of many digits"),
        ("bench SHAPER --evaluators", "evaluators of many digits"),
        ("fit SHAPER --match TABLE --vary links.lever.m=1:3", "fits"),
        ("fit SHAPER --simulate --match TABLE --tau 3 --vary links.lever.m=1:3", "fits"),
        ("identify SHAPER TABLE --of links.crank.m", "regressors"),
        ("identify SHAPER TABLE", "regressors"),
        ("trajectory SHAPER --from 0 --to 1 --time min --max-tau 40", "shortest times by torque"),
    ],
)
def test_commands_that_lack_it_refuse_it_by_name(
    robodyn: Run, tmp_path: Path, command: str, what: str
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("t,q1,qd1,qdd1,tau1\n0,0,1,0,1\n0.1,0.1,1,0,1\n0.2,0.2,1,0,1\n")
    given = robodyn(*command.replace("SHAPER", SHAPER).replace("TABLE", str(table)).split())
    assert given.code == 2
    told = f"{SHAPER}: links[0] (crank).friction.coefficient = 0.08: is of the force in a pin or"
    assert told in given.err
    assert f"{what}" in given.err
    assert "have no such friction" in given.err


def test_sweeps_control_and_trajectories_have_it(robodyn: Run, tmp_path: Path) -> None:
    """As single commands have it for the same numbers."""
    alone = robodyn("torque", SHAPER, "--q", "1", "--qd", "5", "--qdd", "0").rows[0]
    swept = robodyn("sweep", SHAPER, "--kind", "torque", "--qd", "5", "--vary", "q1=1,2").rows[0]
    assert swept["tau1"] == alone["tau1"]
    ref = tmp_path / "ref.csv"
    led = robodyn("trajectory", SHAPER, "--speed", "5", "--time", "0.1", "--from", "1",
                  "--points", "3", "--columns", "t,q,qd,qdd,tau1")  # fmt: skip
    assert float(led.rows[0]["tau1"]) == pytest.approx(float(alone["tau1"]), rel=1e-12)
    ref.write_text(led.out)
    start = SHAPER, "--q", "1", "--qd", "5", "--time", "0.05"
    pd = "--track", ref, "--control", "pd", "--kp", "200", "--kd", "20"
    run = robodyn("simulate", *start, *pd, "--points", "3")
    assert run.code == 0
    assert run.rows[-1]["tau1"] != run.rows[0]["tau1"]
    again = robodyn("accel", SHAPER, "-", "--columns", "qdd1", stdin=run.out)
    for one, other in zip(run.rows, again.rows, strict=True):
        assert float(one["qdd1"]) == pytest.approx(float(other["qdd1"]), rel=1e-10)
    swept = robodyn("sweep", *start[:1], "--vary", "q1=1,1.2", *start[3:], *pd)
    assert float(swept.rows[0]["q1_end"]) == pytest.approx(float(run.rows[-1]["q1"]), abs=1e-8)


def test_derivatives_of_runs_have_it() -> None:
    q = robodyn.assemble(scene(SLOT), [0.7])
    qd = robodyn.loop_velocities(scene(SLOT), q, [5.0])
    ends = [
        simulate(
            scene(SLOT.replace("0.1, radius: 0.02", f"{x}, radius: 0.02")),
            q,
            qd,
            0.1,
            [3.0],
            "DOP853",
            1e-12,
            1e-12,
        ).q[-1]
        for x in (0.1 - 1e-4, 0.1 + 1e-4)
    ]
    name = "links.crank.friction.coefficient"
    run = simulate(scene(SLOT), q, qd, 0.1, [3.0], sensitivity=[name])
    assert run.sensitivity[-1, :2, 0] == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("radius: 0.02, ", "", "friction.radius: is missing"),
        ("radius: 0.02", "radius: 0", "friction.radius = 0: must be > 0"),
        ("coefficient: 0.1,", "coefficient: -0.1,", "friction.coefficient = -0.1: must be >= 0"),
        ("radius: 0.02, speed: 0.1", "radius: 0.02", "friction.speed: is missing"),
        ("{coefficient: 0.15,", "{coefficient: 0.15, radius: 1,", "friction.radius: is an unknown"),
        ("0.15, speed: 0.1", "0.15, speed: 0.1 rad/s", "must be in m/s"),
        ("{coefficient: 0.1, ", "{coefficient: 0.1, static: 1, ", "exclude each other"),
    ],
)
def test_faults_are_named(old: str, new: str, told: str) -> None:
    with pytest.raises(DescriptionError) as error:
        scene(SLOT.replace(old, new, 1))
    assert told in str(error.value)


def test_a_pin_needs_its_radius_and_sticks_stand_not_beside() -> None:
    text = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 1}, {name: b, m: 1, l: 1, r: 0.5, I: 1}]\n"
    pin = "closures: [{pins: [b, [1.2, 0]], friction: {coefficient: 0.1, speed: 1}}]"
    with pytest.raises(DescriptionError, match=r"closures\[0\]\.friction\.radius: is missing"):
        scene(text + pin)
    own = "friction: {coefficient: 0.1, radius: 1, speed: 1}"
    stops = "limits: {min: 0, max: 1, restitution: 0.5}"
    with pytest.raises(InputError, match=r"coefficient: stands beside .* restitution"):
        scene(f"links: [{{name: a, m: 1, l: 1, r: 0.5, I: 1, {own}, {stops}}}]")


def test_scenes_are_written_back() -> None:
    for mechanism in (scene(SLOT), slider_crank(0.1, 1.0, False, "joint", 0.1)):
        again = from_text(scene_text(mechanism), mechanism.source)
        assert plain_scene(again) == plain_scene(mechanism.description)
