"""Motors and gears at joints: rotors that spin with the link that carries them.

Held against Lagrangians that sympy derives, closed forms of one driven link, and the balance of
angular momentum.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH, ROOT, Outcome
from lagrangian_terms import Terms, check_accelerations, exact_acceleration
from named_case import case
from reference_motions import moved_by_each
from sliding_trees import random_tree, text_of

import oracles
import robodyn
from random_mechanisms import LOOPS, Scene, mechanism, motored, seeded_scene, seeded_tree, sliding
from robodyn.dynamics import closed_form, dynamics, identities, reaction_forces
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.mechanism import load
from robodyn.runs.benchmark import reference
from robodyn.runs.motion_columns import as_actuation
from robodyn.scene.description import from_text
from robodyn.trajectories.time_scaling import LimitError

SEEDS = range(FIRST_SEED, FIRST_SEED + (200 if FRESH else 24))
METHODS = "DOP853", "Radau", "taylor"
Run = Callable[..., Outcome]

ARM = """
gravity: 9.81
links:
  - {name: upper, m: 1.5, l: 0.8, r: 0.36, I: 0.082, motor: {ratio: 50, inertia: 2e-5,
     damping: 1e-6, torque_max: 0.4, speed_max: 500, torque_constant: 0.03, resistance: 1.2}}
  - {name: fore, m: 0.9, l: 0.6, r: 0.25, I: 0.031, motor: {ratio: -30, inertia: 4e-5,
     torque_constant: 0.02, resistance: 2.5}}
"""
HUB = """
gravity: 0
links:
  - {name: wheel, m: 0.8, l: 0.2, r: 0.1, I: 0.02, motor: {ratio: -20, inertia: 1e-4,
     damping: 2e-5, torque_max: 0.5, speed_max: 300, torque_constant: 0.05, resistance: 2}}
"""
INERTIA = 0.8 * 0.1**2 + 0.02 + 20**2 * 1e-4  # of the wheel with its rotor


def with_motors(seed: int, tree: list[dict], text: str) -> tuple[list[dict], str]:
    """The tree with a motor at every joint, and the scene."""
    rng, driven = np.random.default_rng(5000 + seed), []
    for link in tree:
        ratio = float(rng.uniform(2.0, 80.0) * rng.choice([-1, 1]))
        inertia = float(rng.uniform(1e-5, 1e-3))
        driven.append(link | {"rotor": (ratio, inertia)})
        own = f"name: {link['name']},"
        text = text.replace(own, f"{own} motor: {{ratio: {ratio!r}, inertia: {inertia!r}}},")
    return driven, text


OPEN = {
    "RR": (None, 0),
    "RRR": (None, 0, 1),
    "RP": (None, 0),
    "RPR": (None, 0, 1),
    "PRP": (None, 0, 1),
    "RRRR": (None, 0, 0, 2),
}


@pytest.mark.parametrize("joints", OPEN)
def test_open_trees_against_the_lagrangian(joints: str) -> None:
    """M, C, G, energies, and accelerations by every way of computing them."""
    for seed in range(3 if FRESH else 1):
        rng = np.random.default_rng(100 + seed)
        plain, gamma = random_tree(seed, joints, OPEN[joints]), complex(*rng.uniform(-10, 10, 2))
        tree, text = with_motors(seed, plain, text_of(plain, gamma))
        mech = mechanism(text)
        assert len(mech.spins) == mech.n
        q, qd, tau = rng.uniform(-2.0, 2.0, (3, mech.n))
        terms = Terms(oracles.sympy_terms(tree, gamma, backend="mpmath"), q, qd)
        for name, own in (
            ("M", closed_form.mass_matrix(mech, q)),
            ("C", closed_form.coriolis_matrix(mech, q, qd)),
            ("G", closed_form.gravity_vector(mech, q)),
        ):
            exact = np.array(getattr(terms, name), float)
            assert np.abs(own - exact).max() <= 4e-15 * (1.0 + np.abs(exact).max()), name
        assert closed_form.kinetic_energy(mech, q, qd) == pytest.approx(float(terms.KE), rel=1e-13)
        check_accelerations(mech, q, qd, tau, exact_acceleration(terms, tau), 10.0)


def random_motors(seed: int) -> Scene:
    """Trees, joints that slide, couplings, closures, with motors at all joints but the last."""
    kind = seed % 4
    if kind == 0:
        return motored(seed, seeded_tree(seed, 2 + seed % 5))
    if kind == 1:
        n = 2 + seed % 4
        return motored(seed, sliding(seed, seeded_tree(seed, n), seed % n))
    if kind == 2:
        scene = seeded_scene(seed, LOOPS["five-bar"])
        ratio = f'couplings: ["q3 = -0.5 q1 {scene.q[2] + 0.5 * scene.q[0]:+.17f}"]\n'
        text = scene.text.replace("actuated: [link0, link2]\n", "actuated: [link0]\n")
        return motored(seed, Scene(text + ratio, scene.q, scene.qd, scene.qdd))
    shapes = list(LOOPS.values())
    return motored(seed, seeded_scene(seed, shapes[(seed // 4) % len(shapes)]))


@pytest.mark.parametrize("seed", SEEDS)
def test_identities(seed: int) -> None:
    """KE, Mdot - 2C, power, forward of inverse and closures; by the model built anew."""
    mech = random_motors(seed).mechanism
    assert mech.spins
    sample = identities.sample_states(mech, 6, seed)
    for identity in identities.identities(mech, sample) if len(sample.q) else []:
        assert identity.residual is not None, identity
        assert identity.residual <= 1e-10, identity
    for q, qd in zip(sample.q, sample.qd, strict=True):
        tau = np.zeros(mech.n)
        tau[list(mech.actuated)] = 0.7
        if len(mech.actuated) == mech.n - len(mech.rows):
            qdd = robodyn.forward_dynamics(mech, q, qd, tau)
            back = robodyn.inverse_dynamics(mech, q, qd, qdd)
            size = 1.0 + np.abs(closed_form.mass_matrix(mech, q)).max() * np.abs(qdd).max()
            assert np.abs(back - tau).max() <= 1e-9 * size


@pytest.mark.parametrize("text", [ARM, HUB, random_motors(1).text, random_motors(2).text])
def test_every_method_moves_alike(text: str) -> None:
    mech = mechanism(text)
    start, tau, ends = moved_by_each(mech, METHODS, 0.6, 1e-7)
    assert np.abs(np.diff(ends, axis=0)).max() <= 1e-6
    assert np.abs(np.subtract(ends[0], ends[2:])).max() <= 1e-8
    exact = reference(mech, start, np.array([0.6]), as_actuation(mech, tau))
    assert exact.uncertainty <= 1e-12
    assert np.abs(exact.y[-1] - ends[2]).max() <= 1e-8


def test_a_motor_at_rest_changes_nothing() -> None:
    """Without inertia and damping; and one on the ground is inertia of its link alone."""
    plain = ARM[: ARM.index(", motor")] + "}\n" + ARM[ARM.index("  - {name: fore") :]
    plain = plain[: plain.rindex(", motor")] + "}\n"
    light = ARM.replace("2e-5,\n     damping: 1e-6", "0").replace("4e-5", "0")
    q, qd, qdd = np.array([[0.3, 0.8], [1.0, -2.0], [0.4, 3.0]])
    tau = robodyn.inverse_dynamics(mechanism(plain), q, qd, qdd)
    assert robodyn.inverse_dynamics(mechanism(light), q, qd, qdd) == pytest.approx(tau, abs=0)
    first = ARM[: ARM.rindex(", motor")] + "}\n"
    heavier = plain.replace("I: 0.082", f"I: {0.082 + 50**2 * 2e-5!r}, damping: {50**2 * 1e-6!r}")
    tau = robodyn.inverse_dynamics(mechanism(heavier), q, qd, qdd)
    assert robodyn.inverse_dynamics(mechanism(first), q, qd, qdd) == pytest.approx(tau, rel=1e-14)


def test_a_rotor_alone_has_inertia_enough() -> None:
    """Of a link that has neither mass nor inertia, by every way."""
    text = HUB.replace("m: 0.8", "m: 0").replace("I: 0.02,", "I: 0,").replace("damping: 2e-5,", "")
    mech = mechanism(text)
    qdd = 0.3 / (20**2 * 1e-4)
    found = robodyn.forward_dynamics(mech, np.zeros((300, 1)), np.zeros((300, 1)), [0.3])
    assert found == pytest.approx(qdd, rel=1e-14)
    for method in METHODS:
        motion = robodyn.simulate(mech, [0.0], [0.0], 1.0, [0.3], method=method)
        assert motion.q[-1] == pytest.approx(qdd / 2, rel=1e-8)


# ---------------------------------------------------------------------------------------------
# Reactions
# ---------------------------------------------------------------------------------------------


def momentum(mech: robodyn.Mechanism, q: np.ndarray, qd: np.ndarray) -> float:
    """Angular momentum of all bodies and rotors about the origin, kg m^2/s."""
    bodies = reaction_forces.bodies_of(mech)
    place, velocity, _ = closed_form.point_motion(mech, [*mech.centres, *mech.tips], q, qd)
    links = mech.description.links
    masses = [link.m for link in links] + [link.payload for link in links]
    assert sum(masses) == pytest.approx(bodies.mass.sum())
    total = sum(
        m * (x * v - y * u) for m, (x, y), (u, v) in zip(masses, place, velocity, strict=True)
    )
    turning: list[float] = []
    for k, link in enumerate(links):
        above = link.hangs_from.link
        carrier = 0.0 if above is None else turning[above]
        turning.append(carrier + (0.0 if link.slides else qd[k]))
        total += link.I * turning[k]
        if link.motor is not None:
            total += link.motor.inertia * (carrier + link.motor.ratio * qd[k])
    return float(total)


@pytest.mark.parametrize("seed", [0, 1, 4, 5, 8, 9])
def test_the_ground_feels_the_momentum_of_rotors(seed: int) -> None:
    """shake_m is the moment of the weights less the growth of the angular momentum."""
    scene = random_motors(seed)
    mech, (q, qd, qdd) = scene.mechanism, scene.states
    h = 1e-3

    def along(s: float) -> float:
        return momentum(mech, q + s * qd + s * s / 2 * qdd, qd + s * qdd)

    steps = [(along(k * h) - along(-k * h)) for k in (1, 2, 3)]
    growth = (45 * steps[0] - 9 * steps[1] + steps[2]) / (60 * h)
    bodies = reaction_forces.bodies_of(mech)
    place = closed_form.point_motion(mech, [*mech.centres, *mech.tips], q)[0]
    links = mech.description.links
    masses = [link.m for link in links] + [link.payload for link in links]
    weights = sum(
        m * (x * mech.gamma.imag - y * mech.gamma.real)
        for m, (x, y) in zip(masses, place, strict=True)
    )
    found = reaction_forces.shaking_force(mech, q, qd, qdd)[2]
    size = abs(weights) + np.abs(qdd).max() * (bodies.mass.sum() + 1.0)
    assert abs(found - (weights - growth)) <= 1e-8 * size


def test_the_moment_in_a_prismatic_joint_holds_rotors_too() -> None:
    """A slide at rest needs the moment that a revolute joint in its place needs to be held."""
    arm = """
gravity: 9.81
links:
  - {name: upper, m: 1.5, l: 0.3, r: 0.2, I: 0.05, motor: {ratio: 30, inertia: 1e-4}}
  - {name: boom, %s m: 0.9, l: 0.5, r: [0.2, 0.03], I: 0.03}
  - {name: hand, m: 0.4, l: 0.2, r: 0.1, I: 0.003, motor: {ratio: -70, inertia: 3e-4}}
  - {name: finger, m: 0.1, l: 0.1, r: 0.1, I: 0.003, motor: {ratio: 9, inertia: 3e-4}}
"""
    slide = mechanism(arm % "joint: prismatic, axis: [1, 1],")
    hinge = mechanism(arm % "")
    q, qd, qdd = np.array([[0.3, 0.0, 0.5, 1.0], [1.2, 0.0, -0.7, 2.0], [3.0, 0.0, 2.0, -5.0]])
    p = np.add(q, [0.0, math.pi / 4, 0.0, 0.0])
    held = robodyn.slide_moments(slide, q, qd, qdd, np.zeros(0))
    tau = dynamics.inverse_dynamics(hinge, p, qd, qdd)
    assert held == pytest.approx(tau[1:2], rel=1e-12)
    assert dynamics.inverse_dynamics(slide, q, qd, qdd)[[0, 2, 3]] == pytest.approx(
        tau[[0, 2, 3]], rel=1e-12
    )


# ---------------------------------------------------------------------------------------------
# What scenes may say
# ---------------------------------------------------------------------------------------------

GOOD = {"ratio": "50", "inertia": "2e-5", "damping": "1e-6", "torque_max": "0.3"}
GOOD |= {"speed_max": "500", "torque_constant": "0.03", "resistance": "1.2"}
WRONG = ("-1", "x", "'3'", ".nan", ".inf", "yes", "[1]", "{a: 1}", "30deg", "1e999", "", "1 2")


def driven(motor: dict[str, str], slides: bool = False) -> str:
    axis = "joint: prismatic, axis: [1, 0], " if slides else ""
    keys = ", ".join(f"{key}: {value}" for key, value in motor.items())
    return f"links:\n  - {{name: a, {axis}m: 1, l: 1, r: 0, I: 1, motor: {{{keys}}}}}\n"


def test_mutated_motors_are_refused() -> None:
    """By file, line, field and limit."""
    for seed in range(100):
        with case(FIRST_SEED + seed):
            refuse_a_mutated_motor(seed)


def refuse_a_mutated_motor(seed: int) -> None:
    rng = random.Random(FIRST_SEED + seed)
    key, motor, place = rng.choice(list(GOOD)), dict(GOOD), ".motor"
    kind = seed % 4
    if kind == 0:
        motor[key] = "0" if key not in ("inertia", "damping") else "-0.001"
    elif kind == 1:
        good = {"ratio": "-1", "speed_max": "30deg"}.get(key)  # a rate may be told in degrees
        motor[key] = rng.choice([value for value in WRONG if value != good])
    elif kind == 2:
        motor[key + rng.choice("sx_")] = motor.pop(key)
    else:
        key = rng.choice(["ratio", "inertia", "torque_constant", "resistance"])
        del motor[key]
    text = driven(motor, slides=rng.random() < 0.5)
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "my.yaml")
    told = str(caught.value)
    assert told.startswith("my.yaml:2: links[0] (a)" + place)
    assert key in told


def test_what_a_motor_may_be() -> None:
    for motor in (GOOD, {"ratio": "-3", "inertia": "0"}):
        for slides in (False, True):
            from_text(driven(motor, slides), "my.yaml")
    with pytest.raises(InputError, match="too large"):
        mechanism(driven({"ratio": "1e200", "inertia": "1"}))
    for motor in ("3", "[1]", "none"):
        with pytest.raises(DescriptionError, match=r"motor.*must be a mapping with ratio, inertia"):
            from_text(
                driven(GOOD).replace(driven(GOOD)[driven(GOOD).index("{ratio") :], motor + "}\n"),
                "x",
            )
    with pytest.raises(DescriptionError, match="resistance: is missing: torque_constant needs it"):
        from_text(driven({"ratio": "3", "inertia": "1", "torque_constant": "1"}), "x")


# ---------------------------------------------------------------------------------------------
# What commands tell, and do
# ---------------------------------------------------------------------------------------------


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.yaml"
    path.write_text(ARM)
    return path


COLUMNS = "tau1,tau2,motor1,motor2,motor_speed1,motor_speed2,volt1,volt2,amp1,amp2,watt1,watt2"


def expected_columns(row: dict[str, float], qd: tuple[float, float]) -> None:
    """The gear is ideal, and the motors obey volt = R amp + kt speed."""
    motors = ((50, 0.03, 1.2), (-30, 0.02, 2.5))
    for k, ((ratio, kt, R), rate) in enumerate(zip(motors, qd, strict=True), start=1):
        torque, speed = row[f"tau{k}"] / ratio, ratio * rate
        amp = torque / kt
        volt = R * amp + kt * speed
        found = [row[f"{x}{k}"] for x in ("motor", "motor_speed", "amp", "volt", "watt")]
        assert found == pytest.approx([torque, speed, amp, volt, volt * amp], rel=1e-15)


def test_torque_tells_of_motors(robodyn: Run, arm: Path, tmp_path: Path) -> None:
    """Of one state, and of rows."""
    done = robodyn("torque", arm, "--q", "0.3,0.4", "--qd", "1,2", "--qdd", "3,4").succeeds()
    assert done.out.splitlines()[0] == COLUMNS
    expected_columns(done.row, (1.0, 2.0))
    states = tmp_path / "states.csv"
    states.write_text("q1,q2,qd1,qd2\n0.3,0.4,1,2\n-1,0.4,0.5,0\n")
    done = robodyn("torque", arm, states).succeeds()
    assert done.out.splitlines()[0] == "q1,q2,qd1,qd2," + COLUMNS
    for row, qd in zip(done.rows, ((1.0, 2.0), (0.5, 0.0)), strict=True):
        expected_columns({name: float(x) for name, x in row.items()}, qd)
    assert "-0.0" not in robodyn("torque", arm, "--q", "90deg,0").succeeds().out
    table = robodyn("torque", arm, "--q", "0,0", "--format", "table").succeeds().out
    for head in ("motor1 [N m]", "motor_speed1 [rad/s]", "volt1 [V]", "amp1 [A]", "watt1 [W]"):
        assert head in table


def test_torque_tells_of_motors_of_loops(robodyn: Run, scene: Callable[[str], Path]) -> None:
    """After the forces; a motor of a passive joint spins, but is not told of."""
    text = (ROOT / "robots/four-bar.yaml").read_text()
    text = text.replace("I: 0.008", "I: 0.008, motor: {ratio: 5, inertia: 1e-3}")
    text = text.replace("I: 0.061", "I: 0.061, motor: {ratio: 7, inertia: 1e-3}")
    path = scene(text)
    row = robodyn("torque", path, "--q", "60deg", "--qd", 5).succeeds().row
    assert list(row) == ["tau1", "fx1", "fy1", "motor1", "motor_speed1"]
    assert (row["motor1"], row["motor_speed1"]) == pytest.approx((row["tau1"] / 5, 25.0))
    sweep = robodyn(
        *("sweep", path, "--kind", "torque", "--vary", "links.crank.motor.ratio=5,6"),
        *("--q", "60deg", "--qd", 5, "--quiet"),
    ).succeeds()
    rows = sweep.rows
    names = [name for name in rows[0] if name not in ("links.crank.motor.ratio", "outcome")]
    assert [float(rows[0][name]) for name in names] == pytest.approx(list(row.values()), rel=1e-12)


def test_python_tells_of_motors() -> None:
    mech = mechanism(ARM)
    tau, qd = np.random.default_rng(1).normal(size=(2, 4, 3, 2))
    found = robodyn.motor_loads(mech, tau, qd)
    assert list(found) == COLUMNS.split(",")[2:]
    assert found["motor2"] == pytest.approx(tau[..., 1] / -30)
    assert found["watt1"] == pytest.approx(found["volt1"] * found["amp1"])
    assert robodyn.motor_loads(mech, tau, qd[0, 0])["motor_speed1"].shape == (4, 3)


def test_equations_have_motors(robodyn: Run, arm: Path, tmp_path: Path) -> None:
    text = robodyn("equations", arm).succeeds().out
    assert "M11       = m1 r1² + I1 + J1 N1² + m2 (l1² + r2² + 2 l1 r2 cos(q2)) + I2 + J2\n" in text
    assert "M12 = M21 = m2 (r2² + l1 r2 cos(q2)) + I2 + J2 N2\n" in text
    assert "D = diag(b1 N1², 0)" in text
    for options in ((), ("--numeric",)):
        code = robodyn("equations", arm, "--format", "python", *options).succeeds().out
        scope: dict[str, Callable[..., list[float]]] = {}
        exec(code, scope)
        state = [0.5, 0.8], [1.0, 0.5], [2.0, -1.0]
        tau = robodyn_tau(mechanism(ARM), *state)
        assert scope["inverse_dynamics"](*state) == pytest.approx(tau, rel=1e-13)
    for format in ("latex", "c", "json"):
        robodyn("equations", arm, "--format", format).succeeds()


def robodyn_tau(mech: robodyn.Mechanism, *state: list[float]) -> list[float]:
    tau: list[float] = robodyn.inverse_dynamics(mech, *state).tolist()
    return tau


def test_equations_of_loops_and_slides_have_motors() -> None:
    from robodyn.equations.code import python
    from robodyn.equations.recorded import recorded
    from robodyn.equations.text import text as as_text
    from robodyn.equations.written import equations

    for seed in (1, 3, 5):
        scene = random_motors(seed)
        mech, scope = scene.mechanism, {}
        exec(python(recorded(mech)), scope)
        found = np.array(scope["M"](scene.q))
        M = closed_form.mass_matrix(mech, scene.q)
        assert np.abs(found - M).max() <= 1e-13 * np.abs(M).max()
        assert "J1 N1²" in as_text(equations(mech))


# -- voltages --------------------------------------------------------------------------------------


def wheel_at(t: float, volt: float) -> tuple[float, float]:
    """Angle and rate of the wheel from rest: INERTIA qdd = a volt - (a b + d) qd."""
    a, b, d = -20 * 0.05 / 2, -20 * 0.05, 20**2 * 2e-5
    drag = (a * b + d) / INERTIA
    end = a * volt / INERTIA / drag
    return end * (t - (1 - math.exp(-drag * t)) / drag), end * (1 - math.exp(-drag * t))


@pytest.mark.parametrize("method", METHODS)
def test_voltages_drive_a_wheel(method: str) -> None:
    mech = mechanism(HUB)
    for volt in ("6", [6.0], lambda t, q, qd: [6.0]):
        if callable(volt) and method == "taylor":
            continue
        motion = robodyn.simulate(
            mech, [0.0], [0.0], 0.8, robodyn.voltages(mech, volt),
            method=method, rtol=1e-10, atol=1e-10,
        )  # fmt: skip
        expected = wheel_at(0.8, 6.0)
        assert (motion.q[-1, 0], motion.qd[-1, 0]) == pytest.approx(expected, rel=2e-7)
        assert robodyn.motor_loads(mech, motion.tau, motion.qd)["volt1"] == pytest.approx(6.0)


def test_simulate_by_voltages(robodyn: Run, arm: Path) -> None:
    """`torque` finds them again; they may switch and depend on the state."""
    run = "simulate", arm, "--q", "0,0", "--time", 0.5, "--points", 6, "--quiet"
    motion = robodyn(*run, "--volt", "12 if t < 0.2 else 3, sin(3*t) - 0.1*qd1").succeeds()
    rows = robodyn("torque", arm, "-", stdin=motion.out).replaces().rows
    for row in rows:
        t, rate = float(row["t"]), float(row["qd1"])
        assert float(row["volt1"]) == pytest.approx(12.0 if t < 0.2 - 1e-12 else 3.0, abs=1e-9)
        assert float(row["volt2"]) == pytest.approx(math.sin(3 * t) - 0.1 * rate, abs=1e-9)


# -- limits ----------------------------------------------------------------------------------------


def test_limits_bound_the_shortest_motion() -> None:
    """By the quintic's peaks: 10/sqrt(3) of acceleration, 15/8 of speed."""
    still = mechanism(HUB.replace("damping: 2e-5", "damping: 0"))
    by_torque = math.sqrt(INERTIA * (10 / math.sqrt(3)) * 1.0 / (20 * 0.5))
    by_speed = 15 / 8 * 4.0 / (300 / 20)
    for far, limits, expected in (
        (1.0, {}, by_torque),
        (4.0, {}, by_speed),
        (1.0, {"max_tau": 30.0}, by_torque),
        (1.0, {"max_tau": 2.5}, 2 * by_torque),
        (4.0, {"max_qd": 20.0}, by_speed),
        (4.0, {"max_qd": 7.5}, 2 * by_speed),
    ):
        motion = robodyn.shortest_motion(still, [[0.0], [far]], **limits)
        assert motion.duration == pytest.approx(expected, rel=1e-7), (far, limits)
    with pytest.raises(LimitError, match=r"limit of 20 N m of its motor"):
        robodyn.shortest_motion(
            mechanism(ARM.replace("I: 0.082", "payload: 1, I: 0.082")), [[0, 0], [1, 1]]
        )


def test_one_limited_motor_among_others() -> None:
    """No torque of the other joint bounds the motion."""
    mech = mechanism(ARM)
    motion = robodyn.shortest_motion(mech, [[0.0, 0.0], [1.5, 0.7]])
    t = np.linspace(0.0, motion.duration, 4001)
    q, qd, qdd = motion.states(t)
    tau = robodyn.inverse_dynamics(mech, q, qd, qdd)
    assert np.abs(tau[:, 0]).max() == pytest.approx(50 * 0.4, rel=1e-5)
    assert np.abs(tau[:, 0]).max() <= 50 * 0.4


def test_trajectory_tells_what_a_motor_cannot(robodyn: Run, arm: Path) -> None:
    way = "trajectory", arm, "--from", "0,0", "--to", "90deg,45deg", "--points", 2
    done = robodyn(*way, "--time", 1)
    assert done.code == 0
    assert "Note: tau1 (upper) at t = " in done.err
    assert "exceeds the limit of 20 N m of its motor" in done.err
    robodyn(*way, "--time", 20).succeeds()
    robodyn(*way, "--time", "min", "--max-tau", 1).fails(1, "--max-tau: tau1 (upper) at q = 0, 0")
    done = robodyn(*way, "--time", "min")
    assert done.code == 0
    assert "bounded by tau1 (upper)" in done.err


@pytest.mark.parametrize(("most", "limit"), [(None, 10.0), (4.0, 4.0), (30.0, 10.0)])
@pytest.mark.parametrize("rate", [None, 50.0])
def test_control_is_cut_off(most: float | None, limit: float, rate: float | None) -> None:
    mech = mechanism(HUB)
    table = robodyn.ReferenceTable([0.0, 1.0], [[2.0], [2.0]])
    law = robodyn.controller(mech, table, "pd", 200.0, 2.0, tau_max=most, control_rate=rate)
    motion = robodyn.simulate(mech, [0.0], [0.0], 0.5, law)
    assert np.abs(motion.tau).max() == pytest.approx(limit, abs=1e-12)


@pytest.mark.parametrize("ratio", [4.0, -4.0])
def test_a_motor_speeds_up_no_further_than_it_can(ratio: float) -> None:
    """The torque fades over the last 5 % of the speed, as an exponential approach shows."""
    wheel = f"motor: {{ratio: {ratio}, inertia: 1e-3, torque_max: 0.3, speed_max: 20}}"
    mech = mechanism(f"links: [{{name: wheel, m: 0, l: 1, r: 0, I: 0.1, {wheel}}}]\n")
    times = np.linspace(0.0, 2.0, 21)
    far = robodyn.ReferenceTable([0.0, 2.0], [[1e3], [1e3]])
    law = robodyn.controller(mech, far, "pd", kp=1e3, kd=0.0)
    found = robodyn.simulate(mech, [0.0], [0.0], 2.0, law, t_eval=times)
    w, growth = 5.0, 1.2 / (0.1 + 1e-3 * 16)
    begin = 0.95 * w / growth
    late = w - 0.05 * w * np.exp(-growth * (times - begin) / (0.05 * w))
    assert found.qd[:, 0] == pytest.approx(np.where(times < begin, growth * times, late), abs=1e-6)
    # what slows down is not cut off, however fast the rotor is
    law = robodyn.controller(mech, far, "pd", kp=0.0, kd=1e3)
    slowed = robodyn.simulate(mech, [0.0], [8.0], 0.1, law)
    assert slowed.qd[-1, 0] == pytest.approx(8.0 - growth * 0.1, abs=1e-6)


def test_sweeps_vary_motors(robodyn: Run, arm: Path) -> None:
    """In lanes as one by one."""
    named = ("links.upper.motor.ratio=20,50,1", "links.fore.motor.inertia=0,1e-4")
    done = robodyn(
        *("sweep", arm, "--vary", named[0], "--vary", named[1], "--q", "0.1,0.2"),
        *("--time", 0.5, "--result", "final,drift", "--quiet"),
    ).succeeds()
    for one in done.rows:
        end = [float(one[f"q{k}_end"]) for k in (1, 2)]
        text = ARM.replace("ratio: 50", f"ratio: {one['links.upper.motor.ratio']}")
        text = text.replace("4e-5", one["links.fore.motor.inertia"])
        motion = robodyn_simulate(mechanism(text), [0.1, 0.2], 0.5)
        assert end == pytest.approx(motion, abs=1e-7)


def robodyn_simulate(mech: robodyn.Mechanism, q: list[float], t: float) -> list[float]:
    end: list[float] = robodyn.simulate(mech, q, [0.0, 0.0], t).q[-1].tolist()
    return end


def test_scenes_without_motors_keep_their_rows() -> None:
    from robodyn.mechanics.equations_of_motion import EquationsOfMotion

    for path in sorted((ROOT / "robots").glob("*.yaml")):
        mech = load(path)
        assert not mech.spins
        assert mech.arrays.spins.shape == (0, mech.n)
    plain = ARM[: ARM.rindex(", motor")] + "}\n"
    sizes = []
    for text in (plain, ARM):
        equations = EquationsOfMotion(mechanism(text))
        sizes.append(len(equations.write([None, None]).rows))
    for before, after in pairwise(sizes):
        assert after - before <= 8
