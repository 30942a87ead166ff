"""When the torques of expressions switch, what narrow features they have, and what sees them."""

from __future__ import annotations

import json
import math
import re
import warnings
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from conftest import FRESH, ROOT
from each_case import each
from named_case import case
from scipy.integrate import quad
from scipy.special import expi, sici

from random_mechanisms import mechanism
from robodyn import load, simulate
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics import actuation
from robodyn.mechanics.kinks import NEAR, kink_at, next_kink, next_stop
from robodyn.runs.accuracy import AUTO, settings_for
from robodyn.runs.benchmark import reference
from robodyn.runs.readers import missed_work
from robodyn.runs.report import Outcome
from robodyn.runs.settings import METHODS, Settings
from robodyn.runs.torques_over_time import over_a_run

pytestmark = pytest.mark.filterwarnings("ignore:the torque changes too fast")
PENDULUM = load(ROOT / "robots/pendulum.yaml")
ARM = load(ROOT / "robots/2r.yaml")
START = ([-1.5], [0.0])
BOX = "(20 if t<5.02 else 0) if t>5 else 0"
BELL = "20*exp(-((t-5)/0.01)**2)"
TIGHT = {"rtol": 1e-12, "atol": 1e-12}


def over(text, t_end=10.0, mech=PENDULUM):
    source = actuation.expressions(mech, text, "--tau")
    return over_a_run(source, [0.3, -0.2, 0.5, 0.1][: 2 * mech.n], t_end)


@cache
def box():
    """The state after 10 s under BOX, each part of the run on its own."""
    q, qd = START
    for span, tau in ((5.0, 0.0), (0.02, 20.0), (4.98, 0.0)):
        motion = simulate(PENDULUM, q, qd, span, [tau], **TIGHT)
        q, qd = motion.q[-1], motion.qd[-1]
    return np.concatenate([q, qd])


@cache
def bell(text=BELL):
    motion = simulate(PENDULUM, *START, 10.0, text, max_step=1e-3, **TIGHT)
    return np.concatenate([motion.q[-1], motion.qd[-1]])


@each(
    ("text", "kinks"),
    [
        (BOX, (5.0, 5.02)),
        ("20 if t>=5 else 0", (5.0,)),
        ("20*(t>5)*(t<=5.02)", (5.0, 5.02)),
        ("1 if (t>1)*(t<2) else q1 if t<7 else 0", (1.0, 2.0, 7.0)),
        ("20 if abs(t-5)<1e-9 else 0", (4.999999999, 5.0, 5.000000001)),
        ("20 if exp(-((t-5)/1e-7)**2) > 0.5 else 0", None),
        ("20 if exp(-((t-5)/1e-3)**2) > 0 else 0", None),  # which is 0 but for 55 ms
        ("q1*sign(t-3)", (3.0,)),
        ("floor(t/4)", (4.0, 8.0)),
        ("t % 2.5", (2.5, 5.0, 7.5)),
        ("min(t, 3) + max(t, q1)", (3.0,)),
        ("abs(cos(t))", tuple((k + 0.5) * math.pi for k in range(3))),
        ("1 if sin(3*t) > 0.2 else 0", None),
        ("1 if cos(t) > 1 - 1e-12 else 0", None),
        ("(1 if sqrt(t-5) > 1 else 2) if t > 5 else 0", (5.0, 6.0)),
        ("1 if t > 0 else 2", ()),
        ("1 if t < 10 else 2", ()),
        ("1 if q1 > 0 else t", ()),
        ("abs(q1*t)", ()),
        ("min(0.1*t + 0.2*t, 0.3*t)", ()),  # which differ by rounding alone
        ("-0.5*qd1", ()),
    ],
)
def test_switching_times(text, kinks):
    found = over(text).kinks
    if kinks is not None:
        assert found == pytest.approx(kinks, rel=1e-15)
        return
    plain = actuation.expressions(PENDULUM, text, "").function(1)
    assert len(found) in (2, 3, 10)
    for t in found:
        before, after = (plain(t + d, [0.0, 0.0])[0] for d in (-1e-12, 1e-12))
        assert before != after


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_torques_are_those_of_the_expression(way):
    """Between switching times, whatever is nested in what."""
    rng = np.random.default_rng(5)

    def grow(depth):
        leaf = ["t", "q1", f"{rng.uniform(-3, 3):.2f}", f"sin({rng.uniform(1, 9):.2f}*t)"]
        kind = int(rng.integers(0, 9)) if depth else 9
        a, b, c = (grow(depth - 1) for _ in range(3)) if kind < 9 else ("", "", "")
        forms = [f"({a} + {b})", f"({a} - {b})", f"{a}*{b}", f"({a} if {b} > {c} else {c})"]
        forms += [f"abs({a})", f"min({a}, {b}, {c})", f"max({a}, {b})", f"sign({a})*{b}"]
        forms += [f"({a} % 0.7 + floor({b}) + ({a} < {c}))"]
        return forms[kind] if kind < 9 else leaf[rng.integers(0, 4)]

    for _ in range(60 if FRESH else 7):
        text = grow(3)
        plain = actuation.expressions(PENDULUM, f"0*t + {text}", "")
        found = over_a_run(plain, [0.3, 0.5], 2.0 * way)
        if found.listener is not None:
            found.listener.begin([], way)
        edges = [0.0, *sorted(found.kinks, key=abs), 2.0 * way]
        assert all(0.0 < way * t < 2.0 for t in found.kinks)
        torque, expected = found.function(1), plain.function(1)
        for before, after in pairwise(edges):
            if found.listener is not None:
                found.listener.reach(before, [])
            for part in (1e-6, 0.3, 1.0 - 1e-6):
                t = before + part * (after - before)
                known = expected(t, [0.7, 0.1])
                assert torque(t, [0.7, 0.1]) == pytest.approx(known, abs=1e-9), text


def test_at_a_switching_time_the_side_that_was_reached():
    found = over("20 if t>5 else 1")
    torque = found.function(1)
    found.listener.begin([], 10.0)
    assert [torque(t, [0, 0]) for t in (4.9, 5.0, 5.0000001)] == [[1.0]] * 3  # not reached
    found.listener.reach(5.0, [])
    assert [torque(t, [0, 0]) for t in (4.9, 5.0, 5.1)] == [[1.0], [20.0], [20.0]]
    found.listener.begin([], -10.0)


def test_what_touches_a_whole_number_holds_for_that_time_alone():
    """exp(-((t - 5)/0.1)**2) is 1 in the middle of the run, and cos(t) where floats round it up."""
    for text, before in (("floor(exp(-((t-5)/0.1)**2))", 0.0), ("floor(cos(t))", -1.0)):
        found = over(text)
        torque = found.function(1)
        for start in (0.0, *found.kinks):
            found.listener.reach(start, [])
        assert torque(9.0, [0, 0]) == [before]
        found.listener.begin([], 10.0)
        pieces = np.array([0.0, *found.kinks, 10.0])
        ones = [x == (1.0,) for x in found.pieces.values]
        assert np.diff(pieces)[ones].sum() < 1e-7


def test_what_cannot_be_told_stays_as_it_is():
    for text in ("0.5*q1", "2*t + q1", "1 if q1 > 0 else 0"):
        source = actuation.expressions(PENDULUM, text, "")
        found = over_a_run(source, [0.1, 0.2], 10.0)
        assert (found.lines, found.kinks) == (source.lines, ())
    source = actuation.callback(PENDULUM, lambda t, q, qd: [0.0])
    assert over_a_run(source, [0.1, 0.2], 10.0) is source


@pytest.mark.parametrize(
    "text", ["1 if sin(1e9*t) > 0 else 0", "1e-12*floor(2e5*t)", "20 if sin(2e5*t)>0.999999 else 0"]
)
def test_switches_that_no_samples_tell_are_refused(text):
    with pytest.raises(InputError, match="switches too often"):
        over_a_run(actuation.expressions(PENDULUM, text, ""), [0.1, 0.2], 10.0)


FREE = mechanism("links: [{name: a, m: 1, l: 1, r: 0, I: 1}]")  # its rate adds up the torque


@pytest.mark.parametrize(
    ("pulses", "rate", "level"),
    [(1000.0, 0.99, 20.0), (100.0, 0.99, -1.0)]
    + ([(900.0, 0.99, 20.0), (5147.2, 0.5, 20.0)] if FRESH else []),
)
def test_of_fast_switches_all_count(pulses, rate, level):
    """Of 1 where sin(w t) > c: as many arcs as w t passes, of 2 acos(c)/w each."""
    run = simulate(FREE, [0.0], [0.0], 10.0, f"{level} if sin({pulses}*t)>{rate} else 0")
    half, turn = math.acos(rate), 2 * math.pi
    whole, rest = divmod(pulses * 10.0, turn)
    arcs = whole * 2 * half + min(max(rest - (math.pi / 2 - half), 0.0), 2 * half)
    assert run.qd[-1, 0] == pytest.approx(level * arcs / pulses, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "end", "impulse"),
    [
        ("floor(0.3 + atan2(sin(t),cos(t))/pi)", 4.0 * math.pi, -0.8 * math.pi),  # jumps by 2
        ("(0.3 + atan2(sin(t),cos(t))/pi) % 1", 4.0 * math.pi, 2.0 * math.pi),
        ("floor(0.5 + 3*atan2(sin(t),cos(t))/pi)", 4.0 * math.pi, 0.0),  # by 6
        ("floor(0.5 + atan(1/(t-2)))", 4.0, 0.0),  # from -1.07 to 2.07
        ("floor(0.2 + atan(1/(t-2)))", 5.0, -2.0 - 1.0 / math.tan(1.2) + 1.0 / math.tan(0.8)),
    ],
)
@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_what_jumps_over_whole_numbers(text, end, impulse, method):
    """Over two at once too, where sin(pi x) has one sign on both sides."""
    run = simulate(FREE, [0.0], [0.0], end, text, method=method)
    assert run.qd[-1, 0] == pytest.approx(impulse, abs=1e-6)


@pytest.mark.parametrize(
    "text", ["sqrt(abs(cos(11*t)))", "sqrt(abs(sin(17*t)))", "abs(sin(3*t))**0.3"]
)
@pytest.mark.parametrize("method", ["DOP853", "RK45", "taylor"])
def test_a_root_of_what_touches_zero_at_a_kink(text, method):
    """A kink is off by some floats: what is held there may not become negative."""
    exact = quad(eval(f"lambda t: {text}", vars(np)), 0.0, 2.0, limit=500, points=TOUCHES[text])[0]
    run = simulate(FREE, [0.0], [0.0], 2.0, text, method=method)
    assert run.outcome is Outcome.FINISHED
    assert run.qd[-1, 0] == pytest.approx(exact, abs=1e-6)


TOUCHES = {
    "sqrt(abs(cos(11*t)))": [(k + 0.5) * math.pi / 11.0 for k in range(7)],
    "sqrt(abs(sin(17*t)))": [k * math.pi / 17.0 for k in range(1, 11)],
    "abs(sin(3*t))**0.3": [math.pi / 3.0],
}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("log(t) if t>0 else 0", "tau1 = log(t) if t > 0.0 else 0.0 is not finite next to t = 0 s"),
        ("1/t**2", "tau1 = 1.0 / t ** 2.0 is not finite at t = 0 s"),
    ],
)
def test_a_torque_without_a_value_is_told_as_it_was_written(text, told):
    with pytest.raises(RobodynError, match=re.escape(told)):
        simulate(FREE, [0.0], [0.0], 2.0, text)


def test_what_overflows_on_the_way_to_nothing():
    run = simulate(FREE, [0.0], [0.0], 5.0, "1e4/cosh(1e4*(t-2))**2")
    assert run.qd[-1, 0] == pytest.approx(2.0, rel=1e-8)


def test_beside_a_part_that_is_too_fast_a_pulse_is_sampled():
    """sin(1e7 t) has more extremes than a million samples tell; 20 exp(-((t-5)/1e-4)^2) has one."""
    for text in ("20*exp(-((t-5)/1e-4)**2)", "20*exp(-((t-5)/1e-4)**2) + 1e-12*t*sin(1e7*t)"):
        leaves = np.array(over(text).leaves)
        assert np.diff(leaves)[np.searchsorted(leaves, 5.0) - 1] < 1e-3


def test_a_torque_too_fast_for_samples_is_told():
    assert simulate(FREE, [0.0], [0.0], 1e-4, "sin(1e7*t)").report.hint == ""
    with pytest.warns(RobodynWarning, match="too fast to be sampled"):
        told = simulate(FREE, [0.0], [0.0], 1.0, "sin(1e7*t)", max_evals=1000).report.hint
    assert "too fast to be sampled" in told


@pytest.mark.parametrize("text", ["sin(1e9*t)", "sin(1/(t-0.01))"])
def test_a_torque_too_fast_for_samples_is_told_before_the_first_step(text, monkeypatch):
    def stepping(*_, **__):
        raise AssertionError("a step was taken first")

    monkeypatch.setattr("robodyn.runs.march.Run._leg", stepping)
    warnings.simplefilter("error")  # until the end of this test
    with pytest.raises(RobodynWarning, match="too fast to be sampled"):
        simulate(FREE, [0.0], [0.0], 1.0, text)


@pytest.mark.parametrize("method", ["Radau", "DOP853", "taylor"])
@pytest.mark.parametrize("width", [1e-2, 1e-5])
@pytest.mark.parametrize("impulse", [1e-4, 1.0])
def test_pulses_that_begin_and_end_at_zero(method, width, impulse):
    a, b = 3.3, 3.3 + width
    text = f"{6 * impulse / width**3}*(t-{a})*({b!r}-t) if (t-{a})*({b!r}-t)>0 else 0"
    run = simulate(FREE, [0.0], [0.0], 10.0, text, method=method)
    assert run.qd[-1, 0] == pytest.approx(impulse, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("sqrt(max(0,1-(t-5)**2))", math.pi / 2),
        ("asin(min(1,max(-1,t-5)))", 0.0),
        ("acos(max(-1,min(1,(t-5)/0.3)))", 5 * math.pi),
        ("20/cosh(min(800,1000*abs(t-5)))", 20 * math.pi / 1000),
    ],
)
@pytest.mark.parametrize("method", ["taylor", "DOP853"])
def test_clipped_roots(text, rate, method):
    run = simulate(FREE, [0.0], [0.0], 10.0, text, method=method)
    assert run.qd[-1, 0] == pytest.approx(rate, abs=1e-6)


SQRT_PI = math.sqrt(math.pi)


def risen(t):
    """The integral of exp(-1/t) from 0."""
    return t * math.exp(-1 / t) + expi(-1 / t)


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("exp(-1/(1-(t-5)**2)) if abs(t-5)<1 else 0", 0.4439938161680794),
        ("exp(-1/t) if t>0 else 0", risen(10)),
        ("7 + exp(-1/(t-4)) if t>4 else 0", 42 + risen(6)),
        ("sin(t-3)/(t-3) if abs(t-3)>0 else 1", sici(7)[0] + sici(3)[0]),
        ("sin(t)/t", sici(10)[0]),
        ("sin(t-3)/(t-3)", sici(7)[0] + sici(3)[0]),
        ("-log(t-2)*(t-2) if t>2 else 0", 16 - 32 * math.log(8)),
        ("exp(-1/abs(t-2)) if abs(t-2)>0 else 0", risen(2) + risen(8)),
    ],
)
@pytest.mark.parametrize("method", ["taylor", "DOP853", "Radau"])
@pytest.mark.thinned
def test_torques_without_a_value_where_a_piece_begins(text, rate, method):
    """1/0 where a condition begins to hold is not met: what leads there has a limit."""
    rows = [0.0, 3.0, 4.0, 10.0]
    run = simulate(FREE, [0.0], [0.0], 10.0, text, method=method, t_eval=rows)
    assert run.qd[-1, 0] == pytest.approx(rate, rel=2e-7)
    assert np.isfinite(run.tau).all()


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("exp(-1/(t-4)) + 1e5*exp(-((t-4.0013)/1e-5)**2) if t>4 else 0", risen(6) + SQRT_PI),
        ("sin(t)/t + 1e5*exp(-((t-0.00014)/1e-6)**2)", sici(10)[0] + 0.1 * SQRT_PI),
        ("1000*exp(-0.02/(t-4))*cos(0*q1) if t>4 else 0", 20 * risen(300)),
        ("(1-cos(t))/t**2", sici(10)[0] - (1 - math.cos(10)) / 10),
    ],
)
@pytest.mark.thinned
def test_what_is_narrow_beside_an_edge_is_not_lost(text, rate, method):
    run = simulate(FREE, [0.0], [0.0], 10.0, text, method=method)
    assert run.qd[-1, 0] == pytest.approx(rate, rel=3e-7)
    assert np.isfinite(run.tau).all()


@pytest.mark.parametrize("text", ["1/sqrt(t)", "1/t**0.9 if t>0 else 0", "1/t if t>0 else 0",
                                  "1/(t-4)**2 if t>4 else 0", "abs(t-4)**-0.5",
                                  "1/(t-4)"])  # fmt: skip
@pytest.mark.parametrize("method", ["taylor", "DOP853"])
def test_a_torque_that_goes_to_infinity_at_an_edge_has_no_line_there(text, method):
    def outcome():
        return simulate(FREE, [0.0], [0.0], 10.0, text, method=method).outcome

    if "-" in text:
        assert outcome() is not Outcome.FINISHED
    else:
        with pytest.raises(RobodynError, match="not finite"):
            outcome()


@pytest.mark.parametrize(
    ("text", "told", "methods"),
    [
        ("1,t/(t-t)", "tau: tau2 = t / (t - t)", ("taylor", "DOP853")),
        ("log(t),1", "tau: tau1 = log(t)", ("taylor", "DOP853")),
        ("1,qd2+q1/(t-t)", "tau: tau2 = qd2 + q1 /", ("DOP853",)),
    ],
)
def test_a_torque_without_a_value_where_the_run_begins_is_named(text, told, methods):
    for method in methods:
        with pytest.raises(RobodynError, match=re.escape(told) + ".* is not finite at t = 0"):
            simulate(ARM, [0.0, 0.0], [0.0, 0.0], 1.0, text, method=method)


@pytest.mark.parametrize("method", ["taylor", "DOP853"])
def test_a_torque_that_swings_ever_faster_towards_the_start(method):
    run = simulate(FREE, [0.0], [0.0], 10.0, "t*sin(1/t)", method=method, max_evals=20_000)
    assert np.isfinite(run.tau).all()


@pytest.mark.parametrize("width", [1e-11, 1e-12])
def test_a_pulse_that_no_step_can_see_is_told(width):
    told = simulate(FREE, [0.0], [0.0], 10.0, f"{1 / width}*exp(-((t-5)/{width})**2)")
    assert told.qd[-1, 0] == pytest.approx(SQRT_PI, rel=1e-3) or "too fast" in told.report.hint


def test_a_torque_without_a_limit_where_a_piece_begins_stays_as_it_is():
    """exp(-1/(t - 1)) grows beyond all bounds before t = 1."""
    run = simulate(FREE, [0.0], [0.0], 10.0, "exp(-1/(t-1)) if t<1 else 0")
    assert run.outcome == Outcome.STEP_TOO_SMALL
    assert run.t[-1] < 1.0


def test_a_run_ends_where_no_method_has_a_first_step():
    """sqrt(max(0, sin(t))) has no value in floats where sin(2 pi) is rounded below 0."""
    run = simulate(FREE, [0.0], [0.0], 10.0, "sqrt(max(0,sin(t)))", method="taylor")
    assert run.outcome in (Outcome.STEP_TOO_SMALL, Outcome.FINISHED)


@pytest.mark.parametrize("width", [1.0, 1e-2, 1e-4, 1e-7])
@pytest.mark.parametrize("form", ["exp(-(({t}-7.1)/{w})**2)", "1/(1 + (({t}-7.1)/{w})**2)",
                                  "tanh(({t}-7.1)/{w})", "q1*exp(-abs({t}-7.1)/{w})",
                                  "exp(q1 - (({t}-7.1)/{w})**2)"])  # fmt: skip
@pytest.mark.thinned
def test_leaves_are_as_narrow_as_the_torque(form, width):
    for way in (1.0, -1.0):
        text = form.format(t="t" if way > 0 else "(-t)", w=width)
        leaves = np.array(over(text, 10.0 * way).leaves)
        assert (np.diff(leaves) > 0.0).all()
        assert leaves[[0, -1]].tolist() == [0.0, 10.0]
        near = np.abs(leaves - 7.1).min()
        narrow = np.diff(leaves)[np.searchsorted(leaves, 7.1 + 1e-12) - 1]
        assert narrow < 30.0 * width or near < 1e-15
        assert len(leaves) < 200


def test_a_smooth_torque_has_wide_leaves():
    assert np.diff(over("2*sin(3*t)").leaves).min() > 1.0
    assert len(over("t**3 + 5").leaves) == 2


def test_the_next_stop():
    leaves = (0.0, 4.0, 5.0, 5.1, 5.2, 7.0, 10.0)
    for way in (1.0, -1.0):
        for t, stop in ((0.0, 4.0), (3.0, 4.0), (3.95, 4.95), (4.5, 5.0), (5.0, 5.1), (7.0, 10.0)):
            assert next_stop((), leaves, way * t, way * 10.0) == pytest.approx(way * stop)
    assert next_stop((3.5,), leaves, 3.0, 10.0) == 3.5
    assert next_stop((), (), 3.0, 10.0) == 10.0


@pytest.mark.parametrize("method", METHODS)
def test_short_pulses_are_seen_by_every_method(method):
    loose = {"method": method, "rtol": 1e-7, "atol": 1e-7}
    for tau, known in ((BOX, box()), (BELL, bell())):
        motion = simulate(PENDULUM, *START, 10.0, tau, **loose)
        assert motion.outcome is Outcome.FINISHED
        error = np.abs(np.concatenate([motion.q[-1], motion.qd[-1]]) - known).max()
        assert error < 2e-3
        assert motion.report.energy_drift < 1e-4


@pytest.mark.parametrize("method", ["DOP853", "Radau"])
def test_a_pulse_that_begins_and_ends_at_zero_is_not_leapt_over(method):
    """It turns a disc at rest by 1/2 rad/s; loose tolerances make first steps long."""
    disc = mechanism("gravity: 0\nlinks: [{name: disc, m: 0, l: 1, r: 0, I: 1}]\n")
    for long in (0.0003, 0.02, 0.3):
        tau = f"(sin(pi*(t-1)/{long})**2/{long} if t < {1 + long} else 0) if t > 1 else 0"
        for loose in (1e-2, 1e-4):
            motion = simulate(disc, [0], [0], 6.0, tau, method=method, rtol=loose, atol=loose)
            assert abs(motion.qd[-1, 0] - 0.5) < 10.0 * loose, (long, loose)


@pytest.mark.parametrize(
    ("turn", "tau"), [(0, BOX), (1, "20*(t>5)*(t<5.02)"), (2, "20*(abs(t-5.01)<0.01)")]
)
def test_steps_end_where_an_expression_jumps(turn, tau):
    """By each method; of each text, but with FRESH, every third."""
    for method in METHODS if FRESH else METHODS[turn::3]:
        t = simulate(PENDULUM, *START, 6.0, tau, method=method).t
        assert np.abs(t - 5.0).min() < 1e-14
        assert np.abs(t - 5.02).min() < 1e-14
    motion = simulate(PENDULUM, *START, 10.0, tau, method="taylor", **TIGHT)
    assert np.abs([motion.q[-1, 0], motion.qd[-1, 0]] - box()).max() < 1e-8


def test_backwards():
    for method in ("DOP853", "Radau", "taylor"):
        forth = simulate(PENDULUM, *START, 6.0, BOX, method=method, **TIGHT)
        tau = BOX.replace("t", "(6+t)")
        back = simulate(PENDULUM, forth.q[-1], forth.qd[-1], -6.0, tau, method=method, **TIGHT)
        assert np.abs(back.q[-1] - START[0]).max() < 1e-6


def test_the_reference_steps_onto_jumps():
    times = np.array([4.0, 5.0, 5.01, 6.0])
    exact = reference(PENDULUM, np.concatenate(START), times, over(BOX))
    assert exact.uncertainty < 1e-13
    found = simulate(PENDULUM, *START, 6.0, BOX, method="taylor", t_eval=times, **TIGHT)
    assert np.abs(found.q[:, 0] - exact.y[:, 0]).max() < 1e-9


@pytest.mark.parametrize("tau", [BOX, BELL, "20*exp(-((t-5)/0.01)**2)*cos(q1)"])
@pytest.mark.parametrize("method", [AUTO, "DOP853", "Radau"])
@pytest.mark.thinned
def test_an_accuracy_is_kept_on_short_pulses(tau, method):
    torques = actuation.expressions(PENDULUM, tau, "")
    start = np.concatenate(START)
    settings, estimate = settings_for(PENDULUM, start, 10.0, torques, Settings(method), 1e-6)
    assert estimate <= 1e-6
    options = {"method": settings.method, "rtol": settings.rtol, "atol": settings.atol}
    motion = simulate(PENDULUM, *START, 10.0, tau, **options)
    known = box() if tau is BOX else bell(tau)
    assert np.abs([motion.q[-1, 0], motion.qd[-1, 0]] - known).max() <= 1e-6


def test_a_root_that_begins_is_passed_with_the_accuracy_asked_for():
    text = "sqrt(abs(t-0.5))"
    torques = actuation.expressions(PENDULUM, text, "")
    start = np.concatenate(START)
    settings, _ = settings_for(PENDULUM, start, 1.0, torques, Settings(AUTO), 1e-6)
    tight = simulate(PENDULUM, *START, 1.0, text, "DOP853", 1e-12, 1e-12)
    found = simulate(PENDULUM, *START, 1.0, text, settings.method, settings.rtol, settings.atol)
    assert found.outcome is tight.outcome
    assert np.abs(found.q[-1] - tight.q[-1]).max() <= 1e-6


@pytest.mark.parametrize("method", METHODS)
def test_no_step_is_longer_than_the_longest(method):
    for way in (1.0, -1.0):
        t = simulate(PENDULUM, *START, way, None, method, 1e-5, 1e-5, max_step=0.004).t
        assert np.abs(np.diff(t)).max() <= 0.004 * (1 + 1e-9)
        assert len(t) < 600
    free = simulate(PENDULUM, *START, 1.0, method=method)
    same = simulate(PENDULUM, *START, 1.0, method=method, max_step=math.inf)
    assert free.t.tolist() == same.t.tolist()


@pytest.mark.parametrize("given", [0.0, -1.0, math.nan])
def test_a_longest_step_that_is_none(given):
    with pytest.raises(InputError, match="max_step"):
        simulate(PENDULUM, *START, 1.0, max_step=given)


def test_a_longest_step_that_no_run_comes_to_the_end_with():
    for method in ("DOP853", "taylor"):
        with pytest.raises(InputError, match=r"max_step = 1e-09: 1 s .*2000000"):
            simulate(PENDULUM, *START, 1.0, max_step=1e-9, method=method)


def test_missed_work_shows_in_the_drift():
    """A function of Python hides what it does between the steps."""

    def law(t, q, qd):
        return [20.0 if 5.0 < t < 5.02 else 0.0]

    q, qd = [-1.57], [0.1]
    for method in ("DOP853", "RK45"):
        missed = simulate(PENDULUM, q, qd, 10.0, law, method=method, rtol=1e-5, atol=1e-5)
        assert missed.report.energy_drift > 1e-2
        assert missed.report.work_missed > 1e-2
        seen = simulate(PENDULUM, q, qd, 10.0, law, method=method, max_step=0.005)
        assert seen.report.energy_drift < 1e-3
        assert seen.report.work_missed == 0.0
    narrow = "20*exp(-((q1+1.55)/1e-3)**2)*(qd1>0)"
    missed = simulate(PENDULUM, q, qd, 2.0, narrow, "RK45").report
    assert missed.energy_drift > 1e-2  # at 1e-9 as well
    assert simulate(PENDULUM, q, qd, 2.0, narrow, "RK45", max_step=5e-4).report.energy_drift < 1e-6


def test_the_work_that_steps_miss_is_taken_along_their_cubics():
    """By one rule of eight points less the whole, of a motion that is a cubic in each step."""
    q = np.polynomial.Polynomial([0.2, 1.0, -0.7, 0.4])
    qd = q.deriv()
    t = np.array([0.0, 0.5, 1.2])

    def law(t, y):
        return [math.sin(60.0 * t) * math.cos(3.0 * y[0]) + y[1]]

    def power(t):
        return (np.sin(60.0 * t) * np.cos(3.0 * q(t)) + qd(t)) * qd(t)

    found = missed_work(law, 1.2e-3, t, q(t)[:, None], qd(t)[:, None])
    nodes, weights = np.polynomial.legendre.leggauss(8)
    missed = []
    for a, b in pairwise(t):
        one_rule = 0.5 * (b - a) * weights @ power(a + 0.5 * (b - a) * (nodes + 1.0))
        missed.append(quad(power, a, b, epsabs=1e-13, limit=500)[0] - one_rule)
    assert found == pytest.approx(missed, abs=1e-10)
    assert abs(found[0]) > 1e-3


@pytest.mark.parametrize("tau", ["2*sin(3*t)", "0.5*sin(7*q1)*cos(t)", "-0.3*qd1", BOX])
@pytest.mark.parametrize("method", ["DOP853", "taylor", "RK45"])
@pytest.mark.thinned
def test_nothing_is_missed_of_a_smooth_torque(tau, method):
    for tolerance in (1e-4, 1e-10):
        motion = simulate(PENDULUM, *START, 3.0, tau, method, tolerance, tolerance)
        assert motion.report.work_missed <= 10.0 * tolerance


def test_the_options_in_a_process(robodyn, tmp_path):
    path = tmp_path / "report.json"
    given = robodyn(
        *("simulate", "robots/pendulum.yaml", "--q=-1.5", "--tau", BOX, "--time", 6),
        *("--points", 13, "--max-step", 0.01, "--quiet", "--report", path),
    ).succeeds()
    assert json.loads(path.read_text())["steps"] >= 600
    assert set(given.column("tau1")) == {0.0}  # at 5 s the comparison is not yet true


# The next kink of a torque, and whether a time is one.


KINKS = (-1.0, 0.0, 0.5, 2.0)


NEXT = [
    (0.0, 3.0, 0.5),
    (0.1, 3.0, 0.5),
    (0.1, 0.4, 0.4),
    (2.0, 3.0, 3.0),
    (0.0, -3.0, -1.0),
    (0.6, -3.0, 0.5),
    (-1.0, -3.0, -3.0),
    (0.5, 0.5, 0.5),
]


def test_next() -> None:
    for t, end, expected in NEXT:
        with case(t, end, expected):
            assert next_kink(KINKS, t, end) == expected
            assert next_kink((), t, end) == end


def test_one_that_is_missed_by_rounding() -> None:
    before, after = math.nextafter(0.5, 0.0), math.nextafter(0.5, 1.0)
    assert next_kink(KINKS, before, 3.0) == 0.5
    assert next_kink(KINKS, before, 3.0, NEAR) == 2.0
    assert next_kink(KINKS, after, -3.0, NEAR) == 0.0
    for t in (before, 0.5, after):
        assert kink_at(KINKS, t) == 0.5
    for t in (0.3, 0.5 + 1e-14, 3.0, -2.0):
        assert kink_at(KINKS, t) is None
