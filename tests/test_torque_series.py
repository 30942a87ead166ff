"""The series of torques along a motion, against mpmath's differentiation of the composed function.

The motion itself is given: q and qd as known functions of time.
"""

import itertools
import re

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf
from reference_motions import START, scene

from robodyn import simulate
from robodyn.engines.series import FLOATS, Series, State
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import callback, expressions, table
from robodyn.mechanics.program import Given, Program
from robodyn.mechanics.torque_rows import linear_piece, torque_slots
from robodyn.scene.expressions import FUNCTIONS
from robodyn.simulation.report import Outcome

pytestmark = pytest.mark.filterwarnings("ignore:the torque changes too fast")

ORDER = 10
T0 = 0.3
# the angles of a motion as mpmath takes them: q1(t), q2(t), and their rates
WAYS = (lambda t: mp.sin(2 * t) / 2 + mpf("0.4"), lambda t: mp.exp(-t) - t**2 / 3)
RATES = (lambda t: mp.cos(2 * t), lambda t: -mp.exp(-t) - 2 * t / 3)

SMOOTH = """
1.5 + 0*t | t | q1 | qd2 | q1 + qd1 | q1 - 2*qd2 | -q2 + +t | q1*qd2 | q1/(2 + qd1) | 3/(1 + t)
sin(q1) | cos(3*t - q2) | tan(q1) | sinh(qd1) | cosh(q2) | tanh(3*q2) | exp(-q1*qd1) | log(2 + q1)
log(2 + q1, 3) | log(3, 2 + q1) | sqrt(1 + q1**2) | hypot(q1, qd2) | hypot(1 + q1) | hypot(t, q1, 2)
atan(2*q1) | asin(q1/2) | acos(q2/2) | q1**2 | q1**0 | (1 - t)**3 | (2 + q1)**-3 | q1**1 | t**7
(2 + q1)**0.5 | (2 + q1)**-1.5 | (1 + t)**2.25 | (1 + q1)**q2 | 2**t | (1 + t)**(2 + sin(q1))
sin(q1)*exp(-t)*qd2**2 | pi*q1 + e*t | 1/(1/(1 + q1) + qd1**2) | exp(sin(cos(q1*q2)))
""".replace("\n", "|").split("|")
SMOOTH = [text.strip() for text in SMOOTH if text.strip()]
NAMES = {name: getattr(mpmath, name) for name in ("sin", "cos", "tan", "sinh", "cosh")}
NAMES |= {"log": mpmath.log, "sqrt": mpmath.sqrt, "atan": mpmath.atan, "asin": mpmath.asin}
NAMES |= {"tanh": mpmath.tanh, "exp": mpmath.exp, "acos": mpmath.acos, "pi": mp.pi, "e": mp.e}
NAMES["hypot"] = lambda *x: mpmath.sqrt(sum(a * a for a in x))


def coefficients(function, count=ORDER + 1):
    with mp.workdps(50):
        return [float(c) for c in mpmath.taylor(function, mpf(T0), count - 1)]


class Along:
    """In place of the equations of motion: angles and rates of the joints are given."""

    def __init__(self, mech):
        self.mechanism, self.program = mech, Program()

    def variable(self, name):
        return self.program.add(Given(name))


def torque_series(text, t, q, qd):
    """The coefficients (order + 1, 2) of torques, given those of q and qd."""
    along = Along(scene("2r"))
    slots = torque_slots(along, expressions(along.mechanism, text, "test"))
    given = {"t": (t, 1.0)} | {f"q{j}": x for j, x in enumerate(q)}
    given |= {f"qd{j}": x for j, x in enumerate(qd)}
    program = along.program
    wanted = [slot for slot in slots if slot is not None]
    series = Series(program, FLOATS, program.numbers, ORDER, State([], [], given), slots=wanted)
    for k in range(ORDER + 1):
        series.residuals(k)
    rows = [[0.0] * (ORDER + 1) if x is None else series.real[x][: ORDER + 1] for x in slots]
    return np.array(rows).T


def series(text):
    """Those along the motion above."""
    return torque_series(text, T0, *(list(map(coefficients, part)) for part in (WAYS, RATES)))


class TestFunctions:
    @pytest.mark.parametrize("text", SMOOTH)
    def test_against_mpmath(self, text):
        def composed(t):
            q = [way(t) for way in WAYS]
            qd = [rate(t) for rate in RATES]
            names = {"t": t, "q1": q[0], "q2": q[1], "qd1": qd[0], "qd2": qd[1], **NAMES}
            return mpf(1) * eval(text, {}, names)

        found = series(f"{text}, t")
        known = np.array(coefficients(composed))
        scale = max((abs(c) ** (1 / k) for k, c in enumerate(known) if k), default=1.0) or 1.0
        scale = max(scale, 1.0)
        bound = 1e-12 * max(1.0, abs(known[0])) * scale ** np.arange(ORDER + 1)
        assert (np.abs(found[:, 0] - known) <= bound).all()
        assert found[:, 1].tolist() == [T0, 1.0, *[0.0] * (ORDER - 1)]

    def test_every_function_of_the_list_is_here_or_refused(self):
        has = set(re.findall(r"(\w+)\(", " ".join(SMOOTH)))
        without = {found[1] for text in ROUGH if (found := re.match(r"(\w+)\(", text))}
        assert has | without == set(FUNCTIONS)
        assert not has & without

    def test_flat_ends_of_tanh(self):
        """Where sinh and cosh are beyond the floats."""
        found = series("tanh(1e4*(t - 10)), tanh(1e3 + q1)")
        assert found[0].tolist() == [-1.0, 1.0]
        assert not found[1:].any()


ROUGH = """
abs(q1) | min(q1, q2) | max(q1, t) | floor(q1) | sign(qd1) | q1 % 2 | 1 if q1 < 2 else 0 | q1 > 0
atan2(q1, q2) | 2 + sin(abs(qd1))
""".replace("\n", "|").split("|")
ROUGH = [text.strip() for text in ROUGH if text.strip()]


class TestRefused:
    @pytest.mark.parametrize("text", ROUGH)
    def test_what_has_no_series(self, text):
        with pytest.raises(InputError, match=r"no series.*DOP853"):
            simulate(scene("2r"), *START, 1.0, tau=f"{text}, t", method="taylor")

    def test_a_function_of_python(self):
        law = callback(scene("2r"), lambda t, q, qd: [0.0, 0.0])
        with pytest.raises(InputError, match=r"function of Python has no series.*DOP853"):
            simulate(scene("2r"), *START, 1.0, tau=law, method="taylor")


TIMES, ROWS = [-1.0, 0.0, 0.5, 2.0], [[0.0, 1.0], [4.0, 1.0], [2.0, -1.0], [2.0, 0.5]]


class TestTable:
    @pytest.mark.parametrize(
        ("t", "direction", "piece"),
        [
            (0.0, 1.0, 1),
            (0.2, 1.0, 1),
            (0.5, 1.0, 2),
            (0.5, -1.0, 1),
            (0.2, -1.0, 1),
            (0.0, -1.0, 0),
            (2.0, -1.0, 2),
            (-1.0, 1.0, 0),
        ],
    )
    def test_value_and_slope_of_the_piece_ahead(self, t, direction, piece):
        torques = table(scene("2r"), TIMES, ROWS)
        y = [0.1, 0.2, 0.3, 0.4]
        found = linear_piece(torques, torques.function(2), t, y, direction)
        begin, end = (np.array(ROWS[k]) for k in (piece, piece + 1))
        slope = (end - begin) / (TIMES[piece + 1] - TIMES[piece])
        assert found[0] == pytest.approx(begin + slope * (t - TIMES[piece]), abs=1e-14)
        assert found[1] == pytest.approx(slope, abs=1e-13)

    @pytest.mark.parametrize("way", [1.0, -1.0])
    def test_steps_end_on_kinks_and_the_motion_is_dop853s(self, way):
        times = sorted(way * t for t in (0.0, 0.125, 0.3, 0.1 + 0.2, 0.7, 1.0))
        mech, rows = scene("2r"), [[k % 2, -k] for k in range(len(times))]
        tau = table(mech, times, rows, until=way)
        found = simulate(mech, *START, way, tau=tau, method="taylor", rtol=1e-13, atol=1e-13)
        assert set(times) <= set(found.t.tolist())
        known = simulate(mech, *START, way, tau=tau, rtol=1e-13, atol=1e-13, t_eval=[way])
        assert found.q[-1] == pytest.approx(known.q[-1], abs=1e-11)
        assert found.report.work == pytest.approx(known.report.work, rel=1e-10)
        assert found.report.energy_drift < 1e-12


class TestAgrees:
    """The torque at the end of a step is that of the series, or it bent on the way."""

    @pytest.mark.parametrize("text", ["sqrt((t - 0.5)**2), 0", "0, ((q1 - 0.25)**2)**0.5"])
    def test_a_kink_is_found(self, text):
        """|x| has the series of x or -x, which nothing ends."""
        tau = text.replace("sqrt((t - 0.5)**2)", "abs(t - 0.5)")
        tau = tau.replace("((q1 - 0.25)**2)**0.5", "abs(q1 - 0.25)")
        options = {"rtol": 1e-10, "atol": 1e-10, "t_eval": [1.0]}
        start = ([0.1, 0.2], [3.0, 0.0])
        found = simulate(scene("2r"), *start, 1.0, tau=text, method="taylor", **options)
        known = simulate(scene("2r"), *start, 1.0, tau=tau, **options)
        assert np.abs(found.q - known.q).max() < 1e-7

    @pytest.mark.parametrize(
        "tau", ["sqrt(0.5 - t), 0", "1/(0.5 - t), 0", "log(0.5 - t), 0", "1/(t - 0.5)**2, 0",
                "0, acos(2*t)", "tan(pi*t), 0", "(0.5 - t)**2.5, 0"]
    )  # fmt: skip
    def test_no_step_leaps_beyond_the_domain(self, tau):
        for way in (1.0, -1.0):
            given = tau if way > 0 else tau.replace("t", "(-t)").replace("sqr(-t)", "sqrt")
            given = given.replace("(-t)an", "tan")
            motion = simulate(scene("2r"), *START, way, tau=given, method="taylor")
            assert motion.outcome is Outcome.STEP_TOO_SMALL
            assert "torque is undefined" in motion.outcome.advice
            assert motion.t[-1] == motion.report.t_reached
            assert 0.4999 < way * motion.t[-1] <= 0.5
            assert np.isfinite(motion.q).all()

    @pytest.mark.parametrize("tau", ["log(t - 1), 0", "1/t, 0", "0, log(t)"])
    def test_a_start_without_a_torque_is_an_error(self, tau):
        with pytest.raises(RobodynError, match="cannot start"):
            simulate(scene("2r"), *START, 1.0, tau=tau, method="taylor")

    def test_a_start_without_a_series_is_an_outcome(self):
        motion = simulate(scene("2r"), *START, 1.0, tau=[1e200, 0], method="taylor")
        assert motion.outcome is Outcome.STEP_TOO_SMALL
        assert motion.t.tolist() == [0.0]
        options = {"tau": "1e200*exp(0*t), 0", "method": "taylor", "max_evals": 3000}
        motion = simulate(scene("2r"), *START, 1.0, **options)
        assert motion.outcome in (Outcome.STEP_TOO_SMALL, Outcome.TOO_MANY_EVALUATIONS)

    def test_from_a_start_without_a_series_dop853_leads_on(self):
        for tau in ("sqrt(t), 0", "t**1.5, 0"):
            motion = simulate(scene("2r"), *START, 1.0, tau=tau, method="taylor")
            known = simulate(scene("2r"), *START, 1.0, tau=tau, rtol=1e-12, atol=1e-12)
            assert motion.outcome is Outcome.FINISHED
            assert motion.q[-1] == pytest.approx(known.q[-1], abs=1e-7)

    def test_what_is_smooth_costs_no_steps(self):
        """A torque too small to matter may have a series that does not serve."""
        steps = [
            simulate(scene("2r"), *START, 1.0, tau=tau, method="taylor").report.steps
            for tau in ("0*t, 0", "1e-14*sin(300*t), 0", "t**64*1e-9, 0")
        ]
        for first, second in itertools.pairwise(steps):
            assert abs(first - second) <= 3
