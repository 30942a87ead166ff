"""Global errors: what settings keep, what an estimate says, against references; the options."""

import json
import math
import re
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH, ROOT
from scipy.integrate import solve_ivp

from random_mechanisms import LOOPS, Shape, mechanism, seeded, seeded_scene, seeded_tree
from robodyn import forward_dynamics, load, simulate
from robodyn.engines import formulas
from robodyn.errors import InputError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.runs import accuracy, series_steps, solvers
from robodyn.runs.accuracy import (
    AUTO,
    AccuracyError,
    best_method,
    error_estimate,
    settings_for,
)
from robodyn.runs.march import run
from robodyn.runs.report import Outcome
from robodyn.runs.settings import METHODS, Settings

REFERENCES = Path(__file__).parent / "references"
ASKED = (1e-3, 1e-6, 1e-9)
SCENES = {
    **{f"tree of {n}": seeded_tree(10 + n, n) for n in (1, 3, 5)},
    **{name: seeded_scene(7, LOOPS[name]) for name in ("four-bar", "five-bar", "loop in a tree")},
    "six-bar with a piston": seeded_scene(9, LOOPS["six-bar with a piston"]),
}
ARM = ("simulate", "robots/2r.yaml", "--q=-1.3,-0.2", "--qd", "0.5,0.25", "--points", 3)
START = np.array([-1.3, -0.2, 0.5, 0.25])


@pytest.fixture(scope="module", autouse=True)
def _formulas_written_once():
    """The formulas of a mechanism serve all runs of it here: writing them costs more than a run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(formulas, "forward_formula", lru_cache(512)(formulas.forward_formula))
        yield


def at_rest(n):
    return Actuation((0.0,) * n)


def arm(tau="0, 0"):
    mech = load(ROOT / "robots/2r.yaml")
    return mech, actuation.expressions(mech, tau, "tau")


def error(mech, start, times, exact, torques, settings):
    """The largest error of a run at these times."""
    rows = []
    outcome, _ = run(
        mech, start, times[-1], torques, settings, lambda t, y, _: rows.append(y), np.array(times)
    )
    assert outcome is Outcome.FINISHED
    return float(np.abs(np.concatenate(rows) - exact).max())


@cache
def random_motion(name, tau):
    scene = SCENES[name]
    mech, start = scene.mechanism, np.concatenate([scene.q, scene.qd])
    torques = at_rest(scene.n)
    if tau:
        torques = actuation.constant(mech, [0.5] * len(mech.actuated))
    times = np.linspace(0.0, 0.2, 21)[1:]
    return mech, start, times, tightest(mech, start, times, torques), torques


def tightest(mech, start, times, torques):
    """States by the tightest series; test_engines.py holds series and motions against others."""
    rows = []
    settings = Settings("taylor", 1e-14, 1e-14)
    run(mech, start, times[-1], torques, settings, lambda t, y, _: rows.append(y), times)
    return np.concatenate(rows)


@pytest.mark.parametrize("name", sorted(path.stem for path in REFERENCES.glob("*.json")))
def test_the_accuracy_is_kept_on_known_motions(name):
    data = json.loads((REFERENCES / f"{name}.json").read_text())
    mech = load(ROOT / data["scene"])
    torques = actuation.expressions(mech, data["tau"], "tau") if data["tau"] else at_rest(mech.n)
    states = np.array([[float(x) for x in s["q"] + s["qd"]] for s in data["states"]])
    times = [s["t"] for s in data["states"]]
    for asked in ASKED if FRESH else [ASKED[len(name) % 3]]:  # each of them on some motions
        settings, estimate = settings_for(
            mech, states[0], times[-1], torques, Settings(AUTO), asked
        )
        assert settings.method == "taylor"
        assert estimate <= asked
        assert error(mech, states[0], times, states, torques, settings) <= asked


@pytest.mark.parametrize("name", SCENES)
def test_random_mechanisms(name):
    """The accuracy asked for is kept, and the estimate is near the error.

    Every second one is driven; looser estimates are the affair of the drawn runs below.
    """
    driven = list(SCENES).index(name) % 2 == 1
    for tau in (False, True) if FRESH else (driven,):
        mech, start, times, exact, torques = random_motion(name, tau)
        for k, method in enumerate((AUTO, "DOP853", "RK45")):
            for asked in ASKED if FRESH else [ASKED[(k + len(name)) % 3]]:
                settings, _ = settings_for(mech, start, times[-1], torques, Settings(method), asked)
                assert error(mech, start, times, exact, torques, settings) <= asked, (method, asked)
        for method in ("DOP853", "RK45", "taylor"):
            settings = Settings(method, 1e-9, 1e-9)
            true = error(mech, start, times, exact, torques, settings)
            estimate = error_estimate(mech, start, times[-1], torques, settings)
            assert true / 10 < estimate < 10 * true, method


@pytest.mark.parametrize("method", ["taylor", "DOP853"])
def test_an_estimate_is_at_least_half_the_error(method):
    """On 20 random scenes of four shapes, against a run at the tightest tolerances."""
    shapes = [Shape((None,)), Shape((None, 0)), LOOPS["four-bar"], LOOPS["five-bar"]]
    times = np.linspace(0.0, 1.0, 101)[1:]
    for seed in range(20):
        drawn = seeded_scene(seed, shapes[seed % 4])
        mech, start = drawn.mechanism, np.concatenate([drawn.q, drawn.qd])
        given = mech, start, 1.0, at_rest(mech.n), Settings(method, 1e-9, 1e-9)
        estimate = error_estimate(*given)
        exact = tightest(mech, start, times, at_rest(mech.n))
        assert estimate >= 0.5 * error(mech, start, times, exact, *given[3:]), seed


def test_the_estimate_is_of_the_run_that_is_written(robodyn, scene):
    """Of a run with many rows, by the same engine."""
    path = scene("gravity: 9.81\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.05, damping: 0.02}]")
    line = ("simulate", path, "--q", "0.3", "--time", 30, "--points", 2001, "--method", "taylor")
    run = robodyn(*line, "--rtol", 1e-9, "--atol", 1e-9, "--estimate-error")
    (estimate,) = re.findall("error of q and qd: about ([^,]+)", run.err)
    exact = tightest(load(path), np.array([0.3, 0.0]), np.array(run.column("t")), at_rest(1))
    true = np.abs(np.transpose([run.column("q1"), run.column("qd1")]) - exact).max()
    assert 0.5 * true <= float(estimate) <= 5.0 * true


def drawn_run(seed):
    """Some scene, its start, torques with and without pulses, a method and its tolerance."""
    numbers, scene = seeded(seed), seeded_tree(seed, 1 + seed % 4)
    if seed % 10 > 6:
        scene = seeded_scene(seed, LOOPS[sorted(LOOPS)[seed // 10 % len(LOOPS)]])
    mech, start = scene.mechanism, np.concatenate([scene.q, scene.qd])
    width, at = 10.0 ** numbers.real(-3, -1), numbers.real(0.1, 0.3)
    pulses = [f"2*exp(-((t-{at})/{width})**2)", f"(2 if t<{at + width} else 0) if t>{at} else t"]
    others = ["0*t", "0.5*sin(7*t)", f"2 if t>{at} else -1", "0.5*q1"]
    torque = [*pulses, *others][numbers.whole(0, 5)]
    text = ", ".join([torque, *["0"] * (len(mech.actuated) - 1)])
    method = METHODS[numbers.whole(0, len(METHODS) - 1)]
    tolerance = 10.0 ** numbers.real(-8, -4)
    torques = actuation.expressions(mech, text, "tau")
    return mech, start, torques, Settings(method, tolerance, tolerance)


@pytest.mark.parametrize("tens", range(12 if FRESH else 1))
def test_the_estimate_is_not_exceeded(tens):
    """By 120 random runs (10 of fixed seeds) at 1,001 times, against the tightest series."""
    times = np.linspace(0.0, 0.5, 1001)[1:]
    for seed in range(FIRST_SEED + 10 * tens, FIRST_SEED + 10 * tens + 10):
        mech, start, torques, settings = drawn_run(seed)
        exact = tightest(mech, start, times, torques)
        true = error(mech, start, times, exact, torques, settings)
        estimate = error_estimate(mech, start, 0.5, torques, settings)
        assert true <= estimate + 1e-12, seed
        assert estimate <= 3.0 * true + 1e-10, seed


WHEEL = "links: [{name: wheel, m: 1, l: 0.1, r: 0, I: 1}]"


def test_what_rounds_alike_in_two_runs_is_estimated():
    """Both take 9425 steps of 2 rad, and add the same numbers with the same rounding."""
    wheel, start = mechanism(WHEEL), np.array([0.0, 314.15])
    settings = Settings("taylor", 1e-12, 1e-12)
    estimate = error_estimate(wheel, start, 60.0, Actuation((0.0,)), settings)
    motion = simulate(wheel, [0.0], [314.15], 60.0, None, "taylor", 1e-12, 1e-12)
    assert 1e-9 < abs(motion.q[-1, 0] - 18849.0) < 2.0 * estimate < 1e-7


def test_where_a_step_a_turn_rounds_too_much_others_are_longer():
    """t^9 turns the wheel 70,000 times; DOP853 takes a hundred steps, and the series 222,000."""
    wheel = mechanism(WHEEL)
    torque = actuation.expressions(wheel, "t**9", "")
    given = wheel, np.zeros(2), 5.0, torque, Settings(AUTO)
    settings, estimate = settings_for(*given, 1e-6)
    assert settings.method == "DOP853"
    motion = simulate(
        wheel, [0.0], [0.0], 5.0, "t**9", "DOP853", settings.rtol, settings.atol,
        max_step=settings.max_step,
    )  # fmt: skip
    assert abs(motion.q[-1, 0] - 5.0**11 / 110.0) < estimate <= 1e-6
    with pytest.raises(accuracy.AccuracyError, match="rounding of its steps alone makes"):
        settings_for(*given, 1e-9)


def test_torques_without_a_series_take_dop853():
    mech, torques = arm("abs(q2), 0")
    assert best_method(mech, torques) == "DOP853"
    assert best_method(*arm("sin(t), -qd2")) == "taylor"
    start = np.array([-1.3, -0.01, 0.5, 0.25])  # q2 changes its sign at 0.04 s
    times = [0.05]

    def rates(t, y):
        return [*y[2:], *forward_dynamics(mech, y[:2], y[2:], [abs(y[1]), 0.0])]

    tight = {"rtol": 1e-12, "atol": 1e-12, "max_step": 1e-3}
    exact = solve_ivp(rates, (0.0, 0.05), start, "RK45", times, **tight).y.T
    assert (exact[:, 1] > 0.0).any()
    settings, _ = settings_for(mech, start, 0.1, torques, Settings(AUTO), 1e-8)
    assert settings.method == "DOP853"
    assert error(mech, start, times, exact, torques, settings) <= 1e-8


def test_baumgarte_takes_dop853():
    mech, start, times, exact, torques = random_motion("four-bar", False)
    wanted = Settings(AUTO, stabilize="baumgarte")
    settings, _ = settings_for(mech, start, times[-1], torques, wanted, 1e-6)
    assert (settings.method, settings.stabilize) == ("DOP853", "baumgarte")
    assert error(mech, start, times, exact, torques, settings) <= 1e-6


def test_a_motion_that_forgets_its_start():
    mech, torques = arm()
    start = np.array([0.5, 0.75, 1.0, 0.5])
    with pytest.raises(AccuracyError, match=r"1e-09: is not kept.*differ by.*forgets its start"):
        settings_for(mech, start, 60.0, torques, Settings(AUTO), 1e-9)


def test_an_accuracy_beyond_doubles_says_so():
    mech, torques = arm()
    with pytest.raises(AccuracyError, match=r"runs differ by [1-9.]+e-1[3-6]: "):
        settings_for(mech, START, 2.0, torques, Settings(AUTO), 1e-17)


def test_a_tighter_run_that_does_not_finish_is_told():
    mech, torques = arm()
    few = Settings("RK45", max_evaluations=500)
    with pytest.raises(AccuracyError, match="a run of rtol 1e-08 does not finish; ask for less"):
        settings_for(mech, START, 2.0, torques, few, 1e-4)
    assert math.isnan(error_estimate(mech, START, 2.0, torques, few))


@pytest.mark.parametrize("asked", [0.0, -1.0, 1.0, math.nan, math.inf])
def test_an_accuracy_that_is_none(asked):
    with pytest.raises(InputError, match="accuracy = "):
        settings_for(*arm()[:1], START, 1.0, arm()[1], Settings(AUTO), asked)


def test_backwards_and_no_time():
    mech, torques = arm("sin(3*t), 0")
    forth, back = (settings_for(mech, START, t, torques, Settings(AUTO), 1e-6) for t in (1.5, -1.5))
    assert 0.0 < back[1] <= 1e-6
    assert forth[0].method == back[0].method
    assert settings_for(mech, START, 0.0, torques, Settings(AUTO), 1e-6)[1] == 0.0
    assert error_estimate(mech, START, 0.0, torques, Settings()) == 0.0


def test_the_tightest_settings_have_no_tighter():
    assert accuracy.tighter(Settings("DOP853", 3e-14, 3e-14)) is None
    assert math.isnan(
        error_estimate(arm()[0], START, 1.0, arm()[1], Settings("RK45", 5e-14, 5e-14))
    )


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_an_estimate_takes_two_runs_and_an_accuracy_one_a_tolerance(method, monkeypatch):
    mech, torques = arm("sin(3*t), 0")
    tolerances = []

    def counted(*given, **options):
        tolerances.append(given[4].rtol)
        return run(*given, **options)

    monkeypatch.setattr(accuracy, "run", counted)
    assert 0.0 < error_estimate(mech, START, 1.0, torques, Settings(method)) < 1e-6
    assert tolerances == pytest.approx([1e-9, 1e-11])
    tolerances.clear()
    settings, _ = settings_for(mech, START, 1.0, torques, Settings(method), 1e-3)
    assert tolerances == pytest.approx([1e-5, 1e-7])
    assert tolerances[-1] == settings.rtol


@pytest.mark.parametrize("method", ["DOP853", "RK45", "taylor"])
@pytest.mark.parametrize("t_end", [6.0, -6.0])
def test_states_of_long_runs_are_thinned_out(method, t_end, monkeypatch):
    """States remain along all of the run, and tell of its error."""
    mech, torques = arm()
    of, settings = (mech, START, t_end, torques), Settings(method, 1e-6, 1e-6)
    monkeypatch.setattr(accuracy, "SAMPLES", 5)
    all_of_them, longest = accuracy.first_run(of, settings)
    estimate = error_estimate(*of, settings)
    monkeypatch.setattr(accuracy, "MOST", 400)
    monkeypatch.setattr(solvers, "MANY", 4)
    monkeypatch.setattr(series_steps, "MOST_LOOKED_AT", 2)
    few, same = accuracy.first_run(of, settings)
    assert same == longest
    assert few.y.shape == (len(few.t), 4)
    assert 50 < len(few.t) < 125 < len(all_of_them.t)
    assert few.t[-1] == t_end
    assert (np.diff(few.t) * t_end > 0.0).all()
    assert np.abs(np.diff(few.t, prepend=0.0)).max() < 0.5
    assert np.isin(few.t, all_of_them.t).all()
    assert 0.1 * estimate < error_estimate(*of, settings) <= estimate


# The options of simulate


def test_the_report_has_the_estimate(robodyn, tmp_path):
    path = tmp_path / "report.json"
    for options in (["--accuracy", "1e-8"], ["--estimate-error"]):
        given = robodyn(*ARM, "--time", 1, "--report", path, *options)
        assert given.code == 0
        report = json.loads(path.read_text())
        assert 0.0 < report["error_estimate"] <= 1e-8
        assert f"error of q and qd: about {report['error_estimate']:.2g}" in given.err
        assert report["method"] == ("taylor" if "--accuracy" in options else "DOP853")
    robodyn(*ARM, "--time", 1, "--report", path, "--quiet").succeeds()
    assert json.loads(path.read_text())["error_estimate"] is None


def test_an_error_that_is_not_estimated_is_told(robodyn):
    tightest = ("--rtol", "3e-14", "--atol", "3e-14", "--estimate-error")
    given = robodyn(*ARM, "--time", 1, *tightest)
    assert given.code == 0
    assert "not estimated" in given.err
    robodyn(*ARM, "--time", 1, *tightest, "--quiet").succeeds()


@pytest.mark.parametrize("time", [-1, 0])
def test_accuracy_backwards_and_at_once(robodyn, time):
    given = robodyn(*ARM, "--time", time, "--accuracy", "1e-6", "--quiet").succeeds()
    assert given.column("t")[-1] == time


def test_a_run_that_does_not_finish_ends_with_its_outcome(robodyn, tmp_path):
    path = tmp_path / "report.json"
    unfinished = ("--accuracy", "1e-6", "--max-evals", 5, "--quiet", "--report", path)
    robodyn(*ARM, *unfinished).fails(1, "too many evaluations at t = ")
    assert not path.exists() or json.loads(path.read_text())["error_estimate"] is None
    ends = robodyn(*ARM, "--tau", "sqrt(0.5 - t), 0", "--accuracy", "1e-6", "--quiet")
    ends.fails(1, "step too small at t = 0.5")


def test_a_chaotic_motion_ends_with_a_message(robodyn):
    given = robodyn("simulate", "robots/2r.yaml", "--q", "1,1", "--time", 60, "--accuracy", "1e-9")
    given.fails(1, "robots/2r.yaml: --accuracy = 1e-09: is not kept", "forgets its start")
    assert given.out == ""


# Hard stops, at which rates jump

BALL = """
gravity: 9.81
links:
  - {name: ball, joint: prismatic, axis: [0, 1], m: 1, l: 0, r: 0, I: 0,
     limits: {min: 0, restitution: 0.8}}
"""
BUMPED = """
gravity: 9.81
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082,
     limits: {min: -150deg, max: -30deg, restitution: 0.6}}
  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031,
     limits: {min: -60deg, max: 60deg, restitution: 0.8}, friction: {torque: 0.2, static: 0.3}}
"""


def ball_at(t, height=1.0, e=0.8, g=9.81):
    """Height and rate of a ball that falls from rest."""
    fall = math.sqrt(2.0 * height / g)
    begin, v = -fall, math.sqrt(2.0 * g * height)
    while t >= begin + 2.0 * v / g and v > 1e-9:
        begin, v = begin + 2.0 * v / g, v * e
    return (
        (v * (t - begin) - 0.5 * g * (t - begin) ** 2, v - g * (t - begin)) if v > 1e-9 else (0, 0)
    )


@pytest.mark.parametrize("T", [2.0, 6.0])
def test_a_bouncing_ball_is_as_near_as_is_told(T):
    mech = mechanism(BALL)
    settings = Settings(method="RK45", rtol=1e-7, atol=1e-7)
    given = mech, np.array([1.0, 0.0]), T, at_rest(1)
    estimate = error_estimate(*given, settings)
    times = np.linspace(0.0, T, 501)
    motion = simulate(mech, [1.0], [0.0], T, method="RK45", rtol=1e-7, atol=1e-7, t_eval=times)
    exact = np.array([ball_at(t) for t in times])
    hits = np.array([event.t for event in motion.events])
    apart = np.abs(times[:, None] - hits).min(axis=1)
    far = apart > max(estimate, 1e-9)
    assert np.abs(motion.q[:, 0] - exact[:, 0]).max() <= 1.5 * estimate + 1e-9
    assert np.abs(motion.qd[far, 0] - exact[far, 1]).max() <= 1.5 * estimate + 1e-9
    assert estimate < 1e-5


@pytest.mark.parametrize("asked", ASKED)
def test_an_accuracy_is_kept_past_hard_stops(asked):
    mech, y, T = mechanism(BUMPED), np.array([-0.6, 0.0, -6.0, 3.0]), 2.0
    settings, estimate = settings_for(mech, y, T, at_rest(2), Settings(method=AUTO), asked)
    assert estimate <= asked
    times = np.linspace(0.0, T, 301)
    tight = {"method": "taylor", "rtol": 1e-13, "atol": 1e-13, "t_eval": times}
    exact = simulate(mech, y[:2], y[2:], T, **tight)
    how = {"method": settings.method, "rtol": settings.rtol, "atol": settings.atol}
    found = simulate(mech, y[:2], y[2:], T, t_eval=times, **how)
    hits = [event.t for event in exact.events if " hits its " in event.name]
    assert len(hits) > 3
    far = np.abs(times[:, None] - np.array(hits)).min(axis=1) > asked
    assert np.abs(found.q - exact.q).max() <= asked
    assert np.abs((found.qd - exact.qd)[far]).max() <= asked


def test_how_far_times_are_from_the_nearest_contact():
    times = np.array([0.0, 0.9, 1.2, 2.5, 9.0])
    found = accuracy.apart(times, np.array([1.0, 2.0]))
    assert found == pytest.approx([1.0, 0.1, 0.2, 0.5, 7.0])
    assert np.isinf(accuracy.apart(times, np.zeros(0))).all()
