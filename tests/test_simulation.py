"""Forward simulation against reference digits, exact motions, balances and its own mirror image.

The digits in `references/` were made by `references/make_references.py`, which shares nothing with
the program: one equation a freedom, extended precision.
"""

import json
import math
import os
import time
import tracemalloc
from contextlib import suppress
from functools import cache

import mpmath
import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, TWO_LINK
from each_case import each
from mpmath import mp, mpf
from reference_motions import (
    DAMPED,
    DAMPED_ARM,
    REFERENCES,
    SENSITIVITY,
    START,
    arm_energy,
    four_bar_energy,
    reference,
    scene,
    slope,
)
from scipy.integrate import solve_ivp
from unwritten import MASSLESS

import oracles
from random_mechanisms import mechanism
from robodyn import assemble, closure_gap, closure_jacobian, load, simulate, voltages
from robodyn.errors import InputError, RobodynError, SingularError
from robodyn.loops.loop_rates import loop_velocities
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.runs.march import run
from robodyn.runs.report import Outcome
from robodyn.runs.right_hand_side import right_hand_side
from robodyn.runs.segments import kept_step, solver_segment
from robodyn.runs.settings import Settings
from robodyn.runs.solvers import METHODS, projected

pytestmark = pytest.mark.filterwarnings("ignore:the torque changes too fast")

FRESH = bool(os.environ.get("FRESH"))  # as `make hard` has it
EXPLICIT = ("RK45", "DOP853")
EACH_METHOD = pytest.mark.parametrize("method", METHODS)


SLIDING = ("rp-arm", "elliptic-trammel", "whitworth")
# Without torques and springs: the heights tell the potential energy.
UNFORCED = [
    name
    for name in SENSITIVITY
    if not any(x in name for x in ("driven", "spring", "balanced", *SLIDING, "hoeken"))
]
# What each method makes of that, and a tolerance at which it is exact and still quick.
METHOD_ERROR = {"DOP853": 1, "RK45": 2, "Radau": 0.1}
TIGHT = {"DOP853": 1e-12, "RK45": 1e-11, "Radau": 1e-7}


def wrapped(angles):
    """The same angles in [-pi, pi]."""
    return np.angle(np.exp(1j * np.asarray(angles)))


class TestReferenceDigits:
    """The digits themselves, against the oracles' mpmath."""

    def test_every_example_scene_has_some(self):
        scenes = {json.loads(path.read_text())["scene"] for path in REFERENCES.glob("*.json")}
        examples = {f"robots/{path.name}" for path in (ROOT / "robots").glob("*.yaml")}
        # a hard case, and scenes whose mechanics others of their kind have
        others = {"parallelogram", "cart-pole", "scotch-yoke", "hydraulic-boom", "toggle-press"}
        others |= {"rack-gripper", "jansen-leg", "drawn-six-bar", "bell-crank", "weather-vane"}
        others |= {"disc-cam", "shaper", "shaken-pendulum", "recovery-truck", "lift", *MASSLESS}
        assert examples - scenes == {f"robots/{x}.yaml" for x in others}
        assert set(SENSITIVITY) == {path.stem for path in REFERENCES.glob("*.json")}

    @each("name", SENSITIVITY)
    def test_18_digits_agree_and_are_written(self, name):
        found = reference(name)
        assert found.digits >= 18
        for row in (*found.q, *found.qd):
            size = max(1.0, *(abs(float(x)) for x in row))
            for text in row:
                last = 10.0 ** -len(text.partition(".")[2])  # what the last digit is worth
                assert last <= 1e-17 * size or float(text) == 0.0, text

    def test_pendulum_by_elliptic_functions(self):
        found = reference("pendulum")
        with mp.workdps(45):
            amplitude = mpf(float(found.q[0][0])) + mp.pi / 2
            omega = oracles.pendulum_frequency(0.4, 0.26, 0.0088)
            for t, q, qd in zip(found.t, found.q, found.qd, strict=True):
                theta, rate = oracles.pendulum_exact(omega, amplitude, mpf(t))
                assert abs(theta - mp.pi / 2 - mpf(q[0])) < mpf("1e-19")
                assert abs(rate - mpf(qd[0])) < mpf("1e-19")

    @pytest.mark.parametrize("name", UNFORCED)
    def test_energy_and_closures_hold(self, name):
        """The energy of the oracles' mass matrix and of the heights, to 1e-16; closed to 1e-17."""
        found = reference(name)
        links, pins = TREES[found.scene]
        with mp.workdps(30):
            energies = []
            for q, qd in zip(found.q, found.qd, strict=True):
                state = [np.array([mpf(x) for x in part], dtype=object) for part in (q, qd)]
                M, _, _ = oracles.mp_terms(links, -9.81j, *state)
                tips, height = points(links, state[0])
                energies.append(state[1] @ M @ state[1] / 2 + mpf(9.81) * height)
                for gap in pins(tips):
                    assert abs(gap) < mpf("1e-17")
            assert max(abs(E - energies[0]) for E in energies) < mpf("1e-16") * abs(energies[0])


def points(links, q):
    """The tips of all links as mpc, and sum of m y of their centres of gravity."""
    tips, moment, origins, angles = [], mpf(0), [], []
    for link, angle in zip(links, q, strict=True):
        parent = link["parent"]
        angles.append(angle + (0 if parent is None else angles[parent]))
        e = mp.expj(angles[-1])
        at = mpmath.mpc(link["at"])
        origins.append(at if parent is None else origins[parent] + at * mp.expj(angles[parent]))
        tips.append(origins[-1] + mpf(link["l"]) * e)
        moment += mpf(link["m"]) * (origins[-1] + mpmath.mpc(link["r"]) * e).imag
    return tips, moment


def link(m, l, r, I, parent=None, at=0j):
    return {"m": m, "l": l, "r": r, "I": I, "parent": parent, "at": complex(at)}


def slider_rod(m, l, r, I, payload):
    """The rod with the piston at its tip as one body, without a rounding error."""
    with mp.workdps(30):
        m, l, r, I, payload = map(mpf, (m, l, r, I, payload))
        centre = (m * r + payload * l) / (m + payload)
        inertia = I + m * (r - centre) ** 2 + payload * (l - centre) ** 2
        return {"m": m + payload, "l": l, "r": centre, "I": inertia, "parent": 0, "at": 0.10 + 0j}


TREES = {
    "robots/2r.yaml": (oracles.two_link_tree(TWO_LINK), lambda tips: []),
    "robots/3r.yaml": (
        [
            link(2.4, 0.70, 0.32, 0.112),
            link(1.4, 0.55, 0.26, 0.041, 0, 0.70),
            link(0.75, 0.30, 0.14, 0.0065, 1, 0.55),
        ],
        lambda tips: [],
    ),
    "robots/pendulum.yaml": ([link(0.4, 0.5, 0.26, 0.0088)], lambda tips: []),
    "robots/four-bar.yaml": (
        oracles.four_bar_tree(FOUR_BAR)[0],
        lambda tips: [tips[1] - tips[2]],
    ),
    "robots/slider-crank.yaml": (
        [link(0.8, 0.10, 0.045, 0.0009), slider_rod(0.5, 0.32, 0.14, 0.0048, 0.7)],
        lambda tips: [tips[1].imag - mpf(0.02)],
    ),
    "robots/five-bar.yaml": (
        [
            link(0.5, 0.30, 0.13, 0.0044),
            link(0.85, 0.68, 0.33, 0.037, 0, 0.30),
            link(0.4, 0.26, 0.12, 0.0028, None, 0.7),
            link(0.75, 0.64, 0.31, 0.029, 2, 0.26),
        ],
        lambda tips: [tips[1] - tips[3]],
    ),
    "robots/geared-five-bar.yaml": (
        [
            link(0.45, 0.22, 0.10, 0.0021),
            link(0.70, 0.55, 0.26, 0.0205, 0, 0.22),
            link(0.35, 0.18, 0.08, 0.00115, None, 0.62),
            link(0.65, 0.52, 0.25, 0.0165, 2, 0.18),
        ],
        lambda tips: [tips[1] - tips[3]],
    ),
    "robots/watt-six-bar.yaml": (
        [
            link(0.5, 0.22, 0.10, 0.0024),
            link(1.7, 0.72, 0.31 + 0.09j, 0.052, 0, 0.22),
            link(1.4, 0.58, 0.44 - 0.06j, 0.043, None, 0.85),
            link(0.8, 0.66, 0.32, 0.034, 1, 0.2 + 0.3j),
            link(0.6, 0.45, 0.21, 0.0115, 2, 0.75 - 0.2j),
        ],
        lambda tips: [tips[1] - tips[2], tips[3] - tips[4]],
    ),
    "robots/stephenson-six-bar.yaml": (
        [
            link(0.45, 0.24, 0.11, 0.0025),
            link(1.5, 0.66, 0.35 + 0.09j, 0.039, 0, 0.24),
            link(0.95, 0.58, 0.27, 0.0305, None, 0.82),
            link(1.1, 0.90, 0.43, 0.085, 1, 0.38 + 0.3j),
            link(0.7, 0.62, 0.30, 0.026, None, 1.25 + 0.15j),
        ],
        lambda tips: [tips[1] - tips[2], tips[3] - tips[4]],
    ),
}


class TestAgainstReferences:
    @pytest.mark.parametrize("name", SENSITIVITY)
    def test_every_method(self, name):
        """On an open chain and a driven loop all of them, on each other motion one in turn."""
        one = [list(METHODS)[list(SENSITIVITY).index(name) % len(METHODS)]]
        for method in METHODS if FRESH or name in ("2r-driven", "four-bar-driven") else one:
            tolerance = TIGHT[method]
            error = reference(name).run(method=method, rtol=tolerance, atol=tolerance)
            assert error[0] <= 1e-15 * max(1.0, np.abs(reference(name).states[0]).max())
            assert error.max() <= METHOD_ERROR[method] * SENSITIVITY[name] * tolerance, method

    @pytest.mark.parametrize("name", SENSITIVITY)
    def test_the_error_follows_the_tolerance(self, name):
        """The tightest is below; of these two, but with FRESH, one in turn."""
        turn = list(SENSITIVITY).index(name) % 2
        for tolerance in (1e-6, 1e-9) if FRESH else (1e-6, 1e-9)[turn:][:1]:
            error = reference(name).run(rtol=tolerance, atol=tolerance).max()
            assert error <= SENSITIVITY[name] * tolerance

    @pytest.mark.parametrize("name", SENSITIVITY)
    def test_as_exact_as_floats_can_be(self, name):
        """At the tightest tolerance rounding is all that is left."""
        error = reference(name).run(rtol=3e-14, atol=3e-14).max()
        assert error <= SENSITIVITY[name] * 3e-14

    def test_the_defaults(self):
        assert reference("four-bar").run().max() <= SENSITIVITY["four-bar"] * 1e-9

    @pytest.mark.parametrize("stabilize", ["baumgarte", "none"])
    @pytest.mark.parametrize("name", ["four-bar", "slider-crank", "five-bar", "four-bar-driven"])
    def test_without_projection(self, name, stabilize):
        error = reference(name).run(rtol=1e-11, atol=1e-11, stabilize=stabilize)
        assert error.max() <= SENSITIVITY[name] * 1e-11


class TestPendulum:
    """Exact by elliptic functions, at any amplitude."""

    OMEGA = oracles.pendulum_frequency(0.4, 0.26, 0.0088)

    @pytest.mark.parametrize("amplitude", [1e-3, 0.5, 2.0, 3.1])
    def test_swing(self, amplitude):
        times = np.linspace(0.0, 4.0, 9)
        start = amplitude - math.pi / 2
        motion = simulate(
            scene("pendulum"), [start], [0.0], 4.0, rtol=1e-12, atol=1e-14, t_eval=times
        )
        with mp.workdps(30):
            release = mpf(start) + mp.pi / 2  # as it came to be in floats
            exact = [oracles.pendulum_exact(self.OMEGA, release, t) for t in times]
        theta, rate = (np.array([float(x[k]) for x in exact]) for k in (0, 1))
        assert motion.q[:, 0] + math.pi / 2 == pytest.approx(theta, abs=1e-9 * amplitude)
        assert motion.qd[:, 0] == pytest.approx(rate, abs=5e-9 * amplitude)

    @EACH_METHOD
    def test_period(self, method):
        period = float(oracles.pendulum_period(self.OMEGA, 1.0))
        tolerance = TIGHT[method]
        motion = simulate(
            scene("pendulum"),
            [1.0 - math.pi / 2],
            [0.0],
            period,
            method=method,
            rtol=tolerance,
            atol=tolerance,
            t_eval=[period / 2, period],
        )
        there, back = motion.q[:, 0] + math.pi / 2
        assert there == pytest.approx(-1.0, abs=300 * tolerance)
        assert back == pytest.approx(1.0, abs=300 * tolerance)


# ---------------------------------------------------------------------------------------------
# Order of convergence
# ---------------------------------------------------------------------------------------------

ORDER = {"RK45": 5, "DOP853": 8, "Radau": 5}
STEPS = {  # in 0.5 s of the four-bar: small enough to converge, large enough for errors to show
    "RK45": (60, 80, 110, 150, 200),
    "DOP853": (36, 44, 54, 66),
    "Radau": (30, 45, 70, 100, 150),
}
PROJECTION = pytest.mark.parametrize("projection", [True, False], ids=["projected", "plain"])


@cache
def four_bar_errors(method, projection, fraction=1.0):
    """Step sizes and errors at 0.5 s, which lies at this fraction of the last of equal steps."""
    known = reference("four-bar")
    side = right_hand_side(known.mechanism, Actuation((0.0,) * 3))
    t, exact, sizes, errors = known.t[1], known.states[1], [], []
    for count in STEPS[method]:
        h = t / (count - 1 + fraction)
        solver = projected(method)(
            side.rates,
            0.0,
            known.states[0],
            math.inf,
            projection=side.projection if projection else None,
            first_step=h,
            max_step=h,
            rtol=0.5,
            atol=1e6,  # every step is accepted
        )
        for _ in range(count):
            before = solver.y
            solver.step()
        assert solver.t == pytest.approx(t + (1 - fraction) * h, rel=1e-12)
        segment = solver_segment(before, [kept_step(solver)])
        y = solver.y if fraction == 1.0 else segment.at(np.array([t]))[0]
        sizes.append(h)
        errors.append(np.linalg.norm(y - exact))
    return np.array(sizes), np.array(errors)


class TestOrder:
    """The projection moves a state by no more than the step's error, so the order stays."""

    @PROJECTION
    @pytest.mark.parametrize("method", ORDER)
    def test_of_the_method(self, method, projection):
        found = slope(*four_bar_errors(method, projection))
        assert ORDER[method] - 0.4 <= found <= ORDER[method] + 0.8

    @pytest.mark.parametrize("method", ORDER)
    def test_projection_does_not_cost_digits(self, method):
        (_, with_it), (_, without) = (four_bar_errors(method, x) for x in (True, False))
        assert np.exp(np.mean(np.log(with_it / without))) <= 1.2

    @PROJECTION
    @pytest.mark.parametrize("method", ORDER)
    def test_of_the_dense_output(self, method, projection):
        """Between steps: RK45 keeps order 5, DOP853 7 or more; Radau's collocation 3."""
        least = {"RK45": 5, "DOP853": 7, "Radau": 3}[method]
        parts = [four_bar_errors(method, projection, x) for x in (0.25, 0.6)]
        sizes = np.exp(np.mean([np.log(sizes) for sizes, _ in parts], axis=0))
        errors = np.sqrt(np.mean([errors**2 for _, errors in parts], axis=0))
        assert slope(sizes, errors) >= least - 0.4


class TestDenseOutput:
    def steps(self, method, name="four-bar", tolerance=1e-5):
        """The state at both ends and the dense output of each step of a run."""
        known = reference(name)
        side = right_hand_side(known.mechanism, Actuation((0.0,) * known.mechanism.n))
        solver = projected(method)(
            side.rates,
            0.0,
            known.states[0],
            0.6,
            projection=side.projection,
            rtol=tolerance,
            atol=tolerance,
        )
        while solver.status == "running":
            before = solver.y.copy()
            assert solver.step() is None
            yield solver_segment(before, [kept_step(solver)])

    @EACH_METHOD
    @pytest.mark.parametrize("name", ["four-bar", "slider-crank", "five-bar"])
    @pytest.mark.thinned
    def test_closes(self, name, method):
        mech = reference(name).mechanism
        n = mech.n
        for segment in self.steps(method, name):
            times = np.linspace(segment.begin, segment.end, 5)
            y = segment.at(times)
            assert np.abs(closure_gap(mech, y[:, :n])).max() < 1e-14
            rates = np.einsum("tij,tj->ti", closure_jacobian(mech, y[:, :n]), y[:, n:])
            assert np.abs(rates).max() < 1e-12
            one = segment.at(times[2:3])
            assert one[0] == pytest.approx(y[2], abs=1e-12)  # one time or many

    @EACH_METHOD
    def test_meets_the_state_at_the_end_of_its_step(self, method):
        for segment in self.steps(method):
            almost = np.nextafter(segment.t[1:], segment.begin)
            assert segment.at(almost)[0] == pytest.approx(segment.y[1], abs=1e-11)

    @pytest.mark.parametrize("method", EXPLICIT)
    def test_meets_the_state_at_the_beginning_of_its_step(self, method):
        for segment in self.steps(method):
            almost = np.nextafter(segment.t[:1], segment.end)
            assert segment.at(almost)[0] == pytest.approx(segment.y[0], abs=1e-11)


# ---------------------------------------------------------------------------------------------
# Mirror images and balances
# ---------------------------------------------------------------------------------------------


class TestReversal:
    @pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau"])
    @pytest.mark.parametrize("name", ["2r-regular", "3r", "four-bar", "five-bar"])
    @pytest.mark.thinned
    def test_there_and_back(self, name, method):
        """From the end, with the rates turned round, back to the start."""
        known = reference(name)
        n, tolerance = known.mechanism.n, max(TIGHT[method], 1e-11)
        options = {"method": method, "rtol": tolerance, "atol": tolerance}
        start = known.states[0]
        there = simulate(known.mechanism, start[:n], start[n:], 1.0, **options)
        back = simulate(known.mechanism, there.q[-1], -there.qd[-1], 1.0, **options)
        bound = METHOD_ERROR[method] * SENSITIVITY[name] * tolerance
        assert back.q[-1] == pytest.approx(start[:n], abs=bound)
        assert -back.qd[-1] == pytest.approx(start[n:], abs=bound)

    @EACH_METHOD
    def test_a_negative_end_runs_backwards(self, method):
        """y(-t) from (q, qd) is y(t) from (q, -qd); the torque mirrored too."""
        known, tolerance = reference("four-bar-driven"), TIGHT[method]
        q, qd = known.states[-1][:3], known.states[-1][3:]
        motion = simulate(
            known.mechanism,
            q,
            qd,
            -known.t[-1],
            tau=f"sin(2*({known.t[-1]} + t)) - 0.125*qd1",
            method=method,
            rtol=tolerance,
            atol=tolerance,
            t_eval=known.t[::-1] - known.t[-1],
        )
        assert motion.outcome is Outcome.FINISHED
        found = np.concatenate([motion.q, motion.qd], axis=1)[::-1]
        bound = METHOD_ERROR[method] * SENSITIVITY["four-bar"] * tolerance
        assert np.abs(found - known.states).max() <= bound

    def test_backwards_is_the_mirror_of_forwards(self):
        q, qd = np.array([0.3, -0.4]), np.array([1.0, -2.0])
        times = np.linspace(0.0, 1.0, 6)
        forth = simulate(scene("2r"), q, qd, 1.0, t_eval=times)
        back = simulate(scene("2r"), q, -qd, -1.0, t_eval=-times)
        assert np.array_equal(back.t, -times)
        assert back.q == pytest.approx(forth.q, abs=1e-12)
        assert back.qd == pytest.approx(-forth.qd, abs=1e-12)
        assert back.qdd == pytest.approx(forth.qdd, abs=1e-11)


class TestEnergy:
    """E(t) - E(0) is the work of torques less dampers, by the oracles and by quadrature."""

    @pytest.mark.parametrize("driven", [False, True])
    @pytest.mark.parametrize("name", DAMPED)
    def test_balance(self, name, driven):
        text, q, qd, energy, damping = DAMPED[name]
        mech = mechanism(text)
        if q is None:
            q = assemble(mech, [1.0])
            qd = loop_velocities(mech, q, qd, t=0.0)
        tau = {"arm": "2*sin(3*t), 1 - 0.5*q2", "four-bar": "1.5*sin(2*t) + 0.2*q3"}[name]
        nodes, weights = np.polynomial.legendre.leggauss(6)
        edges = np.linspace(0.0, 3.0, 301)
        half = np.diff(edges) / 2
        times = (edges[:-1, None] + half[:, None] * (1 + nodes)).ravel()
        motion = simulate(
            mech,
            q,
            qd,
            3.0,
            tau=tau if driven else None,
            rtol=1e-12,
            atol=1e-12,
            t_eval=[*times, 3.0],
        )
        power = (motion.tau * motion.qd).sum(axis=1) - motion.qd**2 @ damping
        work = (np.outer(half, weights).ravel() * power[:-1]).sum()
        change = energy(motion.q[-1], motion.qd[-1]) - energy(np.array(q), np.array(qd))
        assert abs(work) > 0.5
        assert change == pytest.approx(work, abs=1e-9)
        assert motion.report.work == pytest.approx(work, abs=1e-9)
        assert motion.report.energy_drift < 1e-10
        assert np.any(motion.tau) == driven

    @pytest.mark.parametrize(
        ("name", "energy"), [("2r-chaotic", arm_energy), ("four-bar", four_bar_energy)]
    )
    def test_conserved(self, name, energy):
        known = reference(name)
        n = known.mechanism.n
        start = known.states[0]
        motion = simulate(known.mechanism, start[:n], start[n:], 10.0, rtol=1e-11, atol=1e-11)
        E = np.array([energy(q, qd) for q, qd in zip(motion.q, motion.qd, strict=True)])
        drift = np.abs(E - E[0]).max()
        assert 0.0 < drift < 1e-8
        report = motion.report
        assert report.energy_start == pytest.approx(E[0], rel=1e-12)
        assert report.energy_drift * report.energy_in_motion == pytest.approx(drift, rel=1e-2)
        assert report.work == 0.0

    def test_a_wrong_mass_would_show(self):
        """The balance is that of this mechanism, not of any."""
        text = DAMPED_ARM.replace("m: 0.9", "m: 0.91")
        motion = simulate(mechanism(text), [0.3, -0.5], [1.0, 2.0], 1.0, t_eval=[0.5, 1.0])
        right = arm_energy(motion.q[-1], motion.qd[-1]) - arm_energy(motion.q[0], motion.qd[0])
        assert abs(right - motion.report.work) > 1e-3

    def test_a_damped_arm_comes_to_hang(self):
        motion = simulate(mechanism(DAMPED_ARM), [0.3, -0.5], [0.0, 0.0], 40.0)
        assert wrapped(motion.q[-1] + [math.pi / 2, 0.0]) == pytest.approx([0, 0], abs=0.02)
        E = np.array([arm_energy(q, qd) for q, qd in zip(motion.q, motion.qd, strict=True)])
        assert (np.diff(E) < 1e-9).all()
        assert E[-1] < E[0] - 10.0


class TestOneCoordinate:
    """The four-bar against the oracle's reduction to its crank."""

    @pytest.mark.parametrize("assembly", ["open", "crossed"])
    @pytest.mark.parametrize("stabilize", ["projection", "baumgarte", "none"])
    def test_four_bar(self, four_bar_text, assembly, stabilize):
        mech = mechanism(four_bar_text.replace("assembly: open", f"assembly: {assembly}"))
        times = np.linspace(0.0, 3.0, 13)

        def reduced(t, y):
            tau = 0.5 * math.sin(3 * t) - 0.1 * y[1]
            return [
                y[1],
                oracles.four_bar_reduced_acceleration(FOUR_BAR, y[0], y[1], tau, assembly),
            ]

        known = solve_ivp(reduced, (0, 3), [0.7, 2.0], "DOP853", times, rtol=1e-12, atol=1e-12).y
        q = assemble(mech, [0.7])
        motion = simulate(
            mech,
            q,
            loop_velocities(mech, q, [2.0], t=0.0),
            3.0,
            tau=lambda t, q, qd: [0.5 * math.sin(3 * t) - 0.1 * qd[0]],
            rtol=1e-11,
            atol=1e-11,
            t_eval=times,
            stabilize=stabilize,
        )
        assert motion.q[:, 0] == pytest.approx(known[0], abs=1e-8)
        assert motion.qd[:, 0] == pytest.approx(known[1], abs=1e-7)
        for theta, rate, q, qd in zip(*known, motion.q, motion.qd, strict=True):
            closed = oracles.four_bar_position(FOUR_BAR, theta, assembly)
            assert wrapped(q - closed) == pytest.approx([0, 0, 0], abs=1e-8)
            k, _ = oracles.four_bar_coefficients(FOUR_BAR, closed)
            assert qd == pytest.approx(k * rate, abs=1e-7)

    def test_accelerations_are_the_oracles(self):
        known = reference("four-bar")
        start = known.states[0]
        motion = simulate(scene("four-bar"), start[:3], start[3:], 1.0, tau=[0.7])
        for q, qd, qdd in zip(motion.q, motion.qd, motion.qdd, strict=True):
            expected, _ = oracles.four_bar_acceleration(FOUR_BAR, q, qd, np.array([0.7, 0, 0]))
            assert qdd == pytest.approx(expected, rel=1e-10)
        assert np.array_equal(motion.tau, np.tile([0.7, 0.0, 0.0], (len(motion.t), 1)))


class TestStabilize:
    def run(self, stabilize, tolerance=1e-7, **options):
        start = reference("four-bar").states[0]
        return simulate(
            scene("four-bar"),
            start[:3],
            start[3:],
            20.0,
            rtol=tolerance,
            atol=tolerance,
            stabilize=stabilize,
            **options,
        )

    def test_projection_closes_to_rounding(self):
        times = np.linspace(0.0, 20.0, 777)
        for t_eval in (None, times):
            motion = self.run("projection", t_eval=t_eval)
            assert np.abs(closure_gap(scene("four-bar"), motion.q)).max() < 3e-14
            assert motion.report.largest_gap < 3e-14
            assert motion.report.largest_gap_rate < 3e-13

    def test_none_drifts_away_and_baumgarte_does_not(self):
        gaps = {}
        for stabilize in ("baumgarte", "none"):
            motion = self.run(stabilize)
            gap = np.abs(closure_gap(scene("four-bar"), motion.q)).max(axis=1)
            gaps[stabilize] = gap
            assert motion.report.largest_gap == pytest.approx(gap.max(), rel=1e-12)
            assert motion.report.stabilize == stabilize
        drift = gaps["none"]
        assert drift[-1] > 3 * drift[len(drift) // 4] > 0.0  # it grows
        assert drift.max() > 1e-6
        assert gaps["baumgarte"].max() < 0.05 * drift.max()
        assert gaps["baumgarte"].max() > 1e-12  # kept small, not closed

    def test_baumgarte_pulls_a_gap_shut_at_its_rate(self):
        """gap'' + 2 b gap' + b^2 gap = 0 from gap(0) = d, gap'(0) = 0: d (1 + b t) exp(-b t)."""
        mech = scene("four-bar")
        start = reference("four-bar").states[0]
        b, d = 5.0, 1e-6  # m; the gap is linear in the angles then
        Psi = closure_jacobian(mech, start[:3])
        q = start[:3] + np.linalg.pinv(Psi) @ [d, 0.0]
        qd = start[3:] - np.linalg.pinv(closure_jacobian(mech, q)) @ (
            closure_jacobian(mech, q) @ start[3:]
        )
        rows = []
        times = np.linspace(0.0, 1.0, 11)
        outcome, _ = run(
            mech,
            np.concatenate([q, qd]),
            1.0,
            Actuation((0.0,) * 3),
            Settings(rtol=1e-12, atol=1e-12, stabilize="baumgarte", baumgarte=b),
            lambda t, y, _: rows.append(y),
            times,
        )
        assert outcome is Outcome.FINISHED
        gap = closure_gap(mech, np.concatenate(rows)[:, :3])
        decay = d * (1 + b * times) * np.exp(-b * times)
        assert gap[:, 0] == pytest.approx(decay, abs=1e-4 * d)
        assert gap[:, 1] == pytest.approx(np.zeros(11), abs=1e-4 * d)

    def test_an_open_chain_needs_none(self):
        for stabilize in ("projection", "baumgarte", "none"):
            report = simulate(scene("2r"), [0, 0], [0, 0], 0.1, stabilize=stabilize).report
            assert report.stabilize == "none"
            assert report.largest_gap == 0.0
            assert report.nearest_singular is None

    def test_how_near_to_singular_it_came(self):
        """The least singular value of Psi over the steps, against the loop's size, and when."""
        mech = scene("four-bar")
        start = reference("four-bar").states[0]
        motion = simulate(mech, start[:3], start[3:], 2.0)
        least = np.linalg.svd(closure_jacobian(mech, motion.q), compute_uv=False)[:, -1]
        report = motion.report
        assert report.nearest_singular_time == motion.t[np.argmin(least)]
        assert 0.1 < report.nearest_singular < 0.5


# ---------------------------------------------------------------------------------------------
# Times, torques, outcomes
# ---------------------------------------------------------------------------------------------


class TestTimes:
    def test_accepted_steps_where_none_are_given(self):
        motion = simulate(scene("2r"), *START, 1.0)
        assert motion.t[0] == 0.0
        assert motion.t[-1] == 1.0
        assert (np.diff(motion.t) > 0).all()
        assert len(motion.t) == motion.report.steps + 1
        assert np.array_equal(motion.q[0], START[0])

    def test_shapes(self):
        motion = simulate(scene("four-bar"), assemble(scene("four-bar"), [1.0]), [0, 0, 0], 0.5)
        for values in (motion.q, motion.qd, motion.qdd, motion.tau):
            assert values.shape == (len(motion.t), 3)

    @pytest.mark.parametrize(
        "times", [[0, 0.25, 1], [0.3], [1.0], [0.0], [], (0.1, 0.2, 0.30000000000000004)]
    )
    def test_exactly_those_that_are_given(self, times):
        motion = simulate(scene("2r"), *START, 1.0, t_eval=times)
        assert motion.t.tolist() == list(times)
        assert motion.q.shape == motion.qdd.shape == (len(times), 2)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.t_reached == 1.0

    @EACH_METHOD
    def test_a_row_does_not_depend_on_the_others(self, method):
        """Rows take from the run, they do not steer it."""
        start = reference("four-bar").states[0]
        options = {"method": method, "rtol": 1e-6, "atol": 1e-6}
        states = {}
        for count in (3, 21, 301):
            times = np.linspace(0.0, 1.0, count)
            motion = simulate(scene("four-bar"), start[:3], start[3:], 1.0, t_eval=times, **options)
            states[count] = np.concatenate([motion.q, motion.qd], axis=1)
        assert states[301][::150] == pytest.approx(states[3], abs=1e-13)
        assert states[301][::15] == pytest.approx(states[21], abs=1e-13)
        steps = simulate(scene("four-bar"), start[:3], start[3:], 1.0, **options)
        assert states[3][-1] == pytest.approx([*steps.q[-1], *steps.qd[-1]], abs=1e-13)

    def test_the_start_is_given_as_it_came(self):
        q, qd = [0.1, 1e-17], [-0.0, 3.0000000000000004]
        motion = simulate(scene("2r"), q, qd, 1.0, t_eval=[0.0, 1.0])
        assert motion.q[0].tolist() == q
        assert motion.qd[0].tolist() == qd

    @pytest.mark.parametrize("t_eval", [None, [0.0], [0]])
    def test_no_time_at_all(self, t_eval):
        for t_end in (0, 0.0, -0.0):
            motion = simulate(scene("2r"), *START, t_end, t_eval=t_eval)
            assert motion.t.tolist() == [0.0]
            assert np.array_equal(motion.q, [START[0]])
            assert motion.outcome is Outcome.FINISHED
            assert motion.report.steps == 0

    @EACH_METHOD
    def test_a_very_short_time(self, method):
        motion = simulate(scene("2r"), *START, 1e-12, method=method)
        M, _, G = oracles.two_link_terms(TWO_LINK, *START)
        assert motion.t[-1] == 1e-12
        assert motion.qd[-1] == pytest.approx(-1e-12 * np.linalg.solve(M, G), rel=1e-9)

    @each(
        ("t_end", "t_eval"),
        [
            (1.0, [0.0, 1.5]),
            (1.0, [-0.5, 0.5]),
            (1.0, [0.5, 0.25]),
            (1.0, [0.5, 0.5]),
            (1.0, [0.5, math.nan]),
            (1.0, [0.5, math.inf]),
            (1.0, [[0.0, 0.5]]),
            (-1.0, [0.0, 0.5]),
            (-1.0, [-1.0, 0.0]),
            (0.0, [0.0, 0.1]),
        ],
    )
    def test_times_that_do_not_fit_are_refused(self, t_end, t_eval):
        with pytest.raises(InputError, match="t_eval"):
            simulate(scene("2r"), *START, t_end, t_eval=t_eval)

    @pytest.mark.parametrize("t_end", [math.nan, math.inf, -math.inf])
    def test_an_end_must_be_finite(self, t_end):
        with pytest.raises(InputError, match=r"time = .*finite"):
            simulate(scene("2r"), *START, t_end)


class TestTorques:
    def end(self, tau, name="2r", **options):
        mech = scene(name)
        q = START[0] if name == "2r" else assemble(mech, [1.0])
        motion = simulate(mech, q, np.zeros(mech.n), 1.0, tau=tau, **options)
        return motion, np.concatenate([motion.q[-1], motion.qd[-1]])

    @pytest.mark.parametrize(
        "tau",
        [
            (1.5, -0.25),
            np.array([1.5, -0.25]),
            "1.5, -0.25",
            "3/2, -1/4 + 0*t",
            lambda t, q, qd: (1.5, -0.25),
            lambda t, q, qd: np.array([1.5, -0.25]),
            Actuation((1.5, -0.25)),
            actuation.table(mechanism(DAMPED_ARM), [0, 1], [[1.5, -0.25], [1.5, -0.25]]),
        ],
    )
    def test_the_same_torque_in_every_form(self, tau):
        motion, found = self.end(tau)
        _, expected = self.end([1.5, -0.25])
        assert found == pytest.approx(expected, abs=1e-11)
        assert np.abs(motion.tau - [1.5, -0.25]).max() < 1e-15
        assert abs(motion.report.work) > 0.1

    def test_no_torque_is_zero_torque(self):
        _, free = self.end(None)
        assert np.array_equal(free, self.end([0.0, 0.0])[1])
        assert np.abs(free - self.end([0.1, 0.0])[1]).max() > 1e-3

    def test_a_state_feedback_as_expression_and_as_function(self):
        def law(t, q, qd):
            return [2 * math.sin(3 * t) - qd[0] * abs(q[1]), -0.5 * qd[1]]

        motion, found = self.end("2*sin(3*t) - qd1*abs(q2), -0.5*qd2")
        assert found == pytest.approx(self.end(law)[1], abs=1e-12)
        rows = zip(motion.t, motion.q, motion.qd, motion.tau, strict=True)
        for t, q, qd, tau in rows:
            assert tau == pytest.approx(law(t, q, qd), abs=1e-13)

    def test_the_actuated_joints_or_all(self):
        _, expected = self.end([0.8], "four-bar")
        for tau in ([0.8, 0, 0], "0.8", "0.8, 0, 0", lambda *_: [0.8], lambda *_: [0.8, 0, 0]):
            motion, found = self.end(tau, "four-bar")
            assert found == pytest.approx(expected, abs=1e-12)
            assert np.array_equal(motion.tau[-1], [0.8, 0.0, 0.0])

    @pytest.mark.parametrize(
        "tau",
        [
            [0.8, 0.1, 0],
            "0.8, 0.1, 0",
            "t, 0, t",
            lambda t, q, qd: [0.8, 0.1, 0.0],
        ],
    )
    def test_a_passive_joint_takes_no_torque(self, tau):
        with pytest.raises(InputError, match="passive"):
            self.end(tau, "four-bar")

    @pytest.mark.parametrize(
        "tau", [[1.0], [1.0, 2.0, 3.0], "1", "t", "t, t, t", lambda *_: [1], lambda *_: [1, 2, 3]]
    )
    def test_the_wrong_number_is_refused(self, tau):
        with pytest.raises(InputError, match=r"values|expressions"):
            self.end(tau)

    def test_a_table_must_reach_the_end(self):
        """It is not continued beyond its last row."""
        short = actuation.table(scene("2r"), [0.0, 0.5], [[1.0, 0.0], [2.0, 0.0]])
        with pytest.raises(InputError, match="cover"):
            self.end(short)


class TestOutcomes:
    def test_finished(self):
        motion = simulate(scene("2r"), *START, 1.0)
        report = motion.report
        assert motion.outcome is Outcome.FINISHED
        assert (report.outcome, report.advice) == ("finished", "")
        assert (report.method, report.rtol, report.atol) == ("DOP853", 1e-9, 1e-9)
        assert (report.t_end, report.t_reached) == (1.0, 1.0)
        assert report.evaluator == "straight-line"
        assert report.evaluations >= 11 * report.steps
        assert report.seconds > 0.0

    @pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau"])
    @pytest.mark.parametrize("tau", ["sqrt(0.5 - t), 0", "1/(0.5 - t), 0", "log(0.5 - t), 0"])
    def test_step_too_small_where_the_torque_ends(self, method, tau):
        motion = simulate(
            scene("2r"), *START, 1.0, tau=tau, method=method, rtol=1e-6, atol=1e-6, max_evals=20_000
        )
        assert motion.outcome is Outcome.STEP_TOO_SMALL
        assert "torque is undefined" in motion.outcome.advice
        assert motion.report.t_reached == pytest.approx(0.5, abs=1e-3)
        assert motion.t[-1] == motion.report.t_reached < 0.5 + 1e-12
        assert np.isfinite(motion.q).all()

    @EACH_METHOD
    def test_a_torque_beyond_all_bounds(self, method):
        """Whatever it is called: an outcome, and no more than the evaluations allowed."""
        motion = simulate(scene("2r"), *START, 1.0, tau=[1e200, 0], method=method, max_evals=5000)
        assert motion.outcome in (Outcome.STEP_TOO_SMALL, Outcome.TOO_MANY_EVALUATIONS)
        assert motion.report.evaluations < 5100

    def test_what_was_computed_is_kept(self):
        times = np.linspace(0.0, 1.0, 101)
        whole = simulate(scene("2r"), *START, 1.0, tau="1, t", t_eval=times)
        part = simulate(scene("2r"), *START, 1.0, tau="1, t + 0*sqrt(0.505 - t)", t_eval=times)
        assert part.outcome is Outcome.STEP_TOO_SMALL
        assert part.t.tolist() == times[:51].tolist()
        assert part.q == pytest.approx(whole.q[:51], abs=1e-8)

    @EACH_METHOD
    def test_too_many_evaluations(self, method):
        motion = simulate(scene("2r"), *START, 100.0, method=method, max_evals=500)
        assert motion.outcome is Outcome.TOO_MANY_EVALUATIONS
        assert "--max-evals" in motion.outcome.advice
        assert 500 < motion.report.evaluations < 600
        assert 0.0 < motion.t[-1] < 100.0

    def test_a_run_that_reached_its_end_is_finished(self):
        """However many evaluations the last step took."""
        needed = simulate(scene("2r"), *START, 1.0).report.evaluations
        motion = simulate(scene("2r"), *START, 1.0, max_evals=needed - 1)
        assert motion.report.t_reached == 1.0
        assert motion.outcome is Outcome.FINISHED

    @pytest.mark.parametrize("method", EXPLICIT)
    @pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
    @pytest.mark.parametrize("damping", ["0.3", "0.12"])
    @pytest.mark.thinned
    def test_stiff(self, method, tolerance, damping):
        """A joint damper 1e6 times too strong: the explicit methods say which one to take."""
        mech = mechanism(DAMPED_ARM.replace(f"damping: {damping}", f"damping: {damping}e+6"))
        options = {"rtol": tolerance, "atol": tolerance}
        motion = simulate(mech, *START, 5.0, method=method, max_evals=60_000, **options)
        assert motion.outcome is Outcome.STIFF
        assert "Radau" in motion.outcome.advice

    @pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
    @pytest.mark.parametrize("damping", ["0.3", "0.12"])
    def test_what_is_advised_for_stiff_runs_works(self, tolerance, damping):
        mech = mechanism(DAMPED_ARM.replace(f"damping: {damping}", f"damping: {damping}e+6"))
        options = {"rtol": tolerance, "atol": tolerance}
        motion = simulate(mech, *START, 5.0, method="Radau", **options)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.steps < 2000

    @pytest.mark.parametrize("method", EXPLICIT)
    def test_fast_is_not_stiff(self, method):
        """Many revolutions, few digits: steps are large, but it is accuracy that holds them."""
        start = reference("slider-crank").states[0]
        motion = simulate(
            scene("slider-crank"), start[:2], start[2:] * 100, 0.5, method=method, rtol=1e-4
        )
        assert motion.outcome is Outcome.FINISHED

    def test_interrupted(self):
        seen = []

        def watch(t):
            seen.append(t)
            return t > 0.5

        rows = []
        state = np.concatenate(START)
        outcome, recorder = run(
            scene("2r"),
            state,
            1.0,
            Actuation((0.0, 0.0)),
            Settings(),
            lambda t, y, _: rows.append((t, y)),
            np.linspace(0.0, 1.0, 101),
            watch,
        )
        assert outcome is Outcome.INTERRUPTED
        report = recorder.settle()
        assert report.outcome == "interrupted"
        assert "kept" in report.advice
        times = np.concatenate([t for t, _ in rows])
        assert seen[-2] <= 0.5 < seen[-1] == report.t_reached
        assert times.tolist() == np.linspace(0.0, 1.0, 101)[: len(times)].tolist()
        assert times[-1] <= report.t_reached < times[-1] + 0.01

    @pytest.mark.parametrize("name", ["four-bar", "spring-slider-crank", "rack-gripper"])
    def test_rates_that_leave_the_floats(self, name):
        """Their squares do: the outcome tells, and no warning of numpy's."""
        mech = load(ROOT / f"robots/{name}.yaml")
        q = assemble(mech, [1.0])
        for rate in (1e155, 1e300):
            qd = loop_velocities(mech, q, [rate], t=0.0)
            for how in ({"method": "DOP853"}, {"method": "taylor"}):
                with suppress(RobodynError):
                    motion = simulate(mech, q, qd, 1.0, events={"e": "q1"}, **how)
                    assert motion.report.outcome == "step too small"

    def test_singular(self):
        """Where the equations have no unique solution, said by whatever computes them."""

        def law(t):
            if t > 0.5:
                raise SingularError("no way on")
            return [0.0, 0.0]

        tau = Actuation(None, ("tau0, tau1, = _law(t)",), (), {"_law": law})
        motion = simulate(scene("2r"), *START, 1.0, tau=tau)
        assert motion.outcome is Outcome.SINGULAR
        assert "singular" in motion.outcome.advice
        assert motion.t[-1] <= 0.5
        assert np.isfinite(motion.q).all()

    @pytest.mark.parametrize("name", ["2r", "four-bar"])
    @EACH_METHOD
    def test_an_exception_of_a_torque_function_comes_as_itself(self, method, name):
        """At the start, in a trial stage, and far along; whatever handles numerical errors."""
        mech = scene(name)
        q = np.zeros(2) if name == "2r" else assemble(mech, [1.0])
        for error in (ValueError("v"), ZeroDivisionError("z"), SingularError("s"), OSError("o")):
            for last in (1, 2, 30):
                calls = iter(range(last))
                raised = error.with_traceback(None)

                def law(t, q, qd, calls=calls, raised=raised):
                    if next(calls, None) is None:
                        raise raised
                    return [0.1 * t] * len(mech.actuated)

                with pytest.raises(type(error)) as caught:
                    simulate(mech, q, 0 * q, 1.0, law, method)
                assert caught.value is error
                assert error.__cause__ is None

    def test_an_exception_of_a_voltage_function_comes_as_itself(self):
        mech = mechanism(
            "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, motor: "
            "{ratio: 10, inertia: 1e-5, torque_constant: 0.1, resistance: 1}}]"
        )

        def volt(t, q, qd):
            return [math.sqrt(0.3 - t)]

        with pytest.raises(ValueError, match=r"math domain error|nonnegative input"):
            simulate(mech, [0.0], [0.0], 1.0, voltages(mech, volt))

    @pytest.mark.parametrize("method", EXPLICIT)
    def test_a_torque_function_asks_for_a_shorter_step_by_nan(self, method):
        def law(t, q, qd):
            return [1.0, math.nan if t > 0.5 else 0.0]

        motion = simulate(scene("2r"), *START, 1.0, law, method, rtol=1e-6, atol=1e-6)
        assert motion.outcome is Outcome.STEP_TOO_SMALL
        assert motion.report.t_reached == pytest.approx(0.5, abs=1e-3)

    @pytest.mark.parametrize("method", EXPLICIT)
    def test_a_motion_that_cannot_go_on(self, method):
        """All mass in the piston: at the dead centre the crank has no inertia."""
        mech = mechanism(
            """
links:
  - {name: crank, m: 0, l: 0.1, r: 0, I: 0}
  - {name: rod, m: 0, l: 0.32, r: 0, I: 0, payload: 0.7}
closures: [{point: rod, on: {through: [0, 0], along: [1, 0]}}]
actuated: [crank]
"""
        )
        q = assemble(mech, [1.0])
        qd = loop_velocities(mech, q, [-3.0], t=0.0)
        motion = simulate(mech, q, qd, 2.0, method=method, rtol=1e-6, atol=1e-6, max_evals=20_000)
        assert motion.outcome in (Outcome.SINGULAR, Outcome.STEP_TOO_SMALL)
        # the piston runs at a constant rate until it is at its farthest, the crank ever faster
        speed = 0.1 * 3.0 * (math.sin(1.0) + math.cos(1.0) * math.tan(-q[0] - q[1]))
        way = 0.42 - 0.1 * math.cos(1.0) - 0.32 * math.cos(q[0] + q[1])
        assert motion.report.t_reached == pytest.approx(way / speed, rel=1e-4)

    @pytest.mark.parametrize(
        ("tau", "told"),
        [
            ([math.nan, 0.0], r"tau\[0\] = nan: must be finite"),
            ([math.inf, 0.0], r"tau\[0\] = inf: must be finite"),
            ("1/t, 0", "cannot start"),
            ("log(t), 0", "cannot start"),
        ],
    )
    def test_a_start_without_a_finite_acceleration_is_an_error(self, tau, told):
        with pytest.raises(RobodynError, match=told):
            simulate(scene("2r"), *START, 1.0, tau=tau)

    def test_every_outcome_but_finished_has_advice(self):
        for outcome in Outcome:
            assert bool(outcome.advice) == (outcome is not Outcome.FINISHED)
        assert len({outcome.label for outcome in Outcome}) == len(Outcome)


class TestArguments:
    @each(
        ("option", "value", "match"),
        [
            ("method", "rk45", "method = rk45.*DOP853"),
            ("rtol", 0.0, "rtol = 0"),
            ("rtol", -1e-9, "rtol = -1e-09"),
            ("rtol", 1.0, "rtol = 1"),
            ("rtol", 1e-15, "rtol = 1e-15.*3e-14"),
            ("rtol", math.nan, "rtol = nan"),
            ("atol", 0.0, "atol = 0"),
            ("atol", -1.0, "atol = -1"),
            ("atol", math.inf, "atol = inf"),
            ("atol", math.nan, "atol = nan"),
            ("stabilize", "all", "stabilize = all.*projection"),
            ("max_evals", 0, "max_evals = 0"),
        ],
    )
    def test_a_setting_that_is_none(self, option, value, match):
        with pytest.raises(InputError, match=match):
            simulate(scene("2r"), *START, 1.0, **{option: value})

    @pytest.mark.parametrize(
        ("q", "qd"),
        [
            ([0.1], [0.0, 0.0]),
            ([0.1, 0.2, 0.3], [0.0, 0.0]),
            ([0.1, 0.2], [0.0]),
            ([math.nan, 0.2], [0.0, 0.0]),
            ([0.1, 0.2], [math.inf, 0.0]),
            ([[0.1, 0.2], [0.3, 0.4]], [[0.0, 0.0], [0.0, 0.0]]),
            ([[0.1, 0.2], [0.3, 0.4]], [0.0, 0.0]),
        ],
    )
    def test_a_state_that_is_none(self, q, qd):
        """One state, not many."""
        with pytest.raises(InputError, match="q"):
            simulate(scene("2r"), q, qd, 1.0)

    def test_a_start_that_does_not_close(self):
        q = assemble(scene("four-bar"), [1.0])
        with pytest.raises(InputError, match=r"gap in position = .* m"):
            simulate(scene("four-bar"), q + np.array([0, 0.1, 0]), [0, 0, 0], 1.0)
        with pytest.raises(InputError, match=r"gap in velocity = .* m/s"):
            simulate(scene("four-bar"), q, [1, 0, 0], 1.0)

    def test_the_start_is_not_changed(self):
        q, qd = assemble(scene("four-bar"), [1.0]), np.zeros(3)
        before = q.copy()
        simulate(scene("four-bar"), q, qd, 0.1)
        assert np.array_equal(q, before)
        assert not qd.any()


class TestManyRows:
    def test_a_step_costs_the_same_however_many_rows_lie_ahead(self):
        """Processor time of 200 steps with three million rows ahead, against ten."""
        start = reference("2r-chaotic").states[0]

        def cost(rows):
            clock = []

            def watch(t):
                clock.append(time.process_time())
                return len(clock) == 220

            times = np.linspace(0.0, 3e6, rows)
            free = Actuation((0.0, 0.0))
            run(scene("2r"), start, 3e6, free, Settings(), lambda t, y, _: None, times, watch)
            return clock[-1] - clock[20]

        few = min(cost(11) for _ in range(3))
        assert cost(3_000_001) < 10 * few


class TestMemory:
    """Rows and statistics leave the run as they come."""

    @pytest.mark.parametrize(
        ("name", "method", "rate", "duration"),
        [
            ("2r", "DOP853", 2000, 3.0),
            ("2r", "RK45", None, 16.0),
        ],
    )
    def test_does_not_grow_with_the_run(self, name, method, rate, duration):
        mech = scene(name)
        q = START[0] if name == "2r" else assemble(mech, [1.0])
        state = np.concatenate([q, np.zeros(mech.n)])
        settings = Settings(method=method, rtol=1e-6, atol=1e-6)
        free = Actuation((0.0,) * mech.n)

        def peak(duration):
            taken = []
            times = None if rate is None else np.linspace(0.0, duration, int(rate * duration))
            tracemalloc.start()
            base = tracemalloc.get_traced_memory()[0]
            run(mech, state, duration, free, settings, lambda t, y, _: taken.append(len(t)), times)
            found = tracemalloc.get_traced_memory()[1] - base
            tracemalloc.stop()
            return found, sum(taken)

        peak(1.0)  # what is compiled and imported once
        short, few = peak(duration)
        long, many = peak(8 * duration)
        assert many > 6 * few
        states = 8 * (2 * mech.n + 1) * many  # bytes
        assert states > 80_000  # far above what one batch takes
        assert long - short < 0.5 * states
