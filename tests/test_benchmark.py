"""Speed against error: what is measured, what is marked, what is left out."""

import json
import os
from pathlib import Path
from timeit import repeat
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT
from mpmath import mp, mpf
from named_case import case

from random_mechanisms import LOOPS, mechanism, seeded_scene, seeded_tree
from robodyn import load
from robodyn.dynamics import dynamics, evaluators, identities
from robodyn.dynamics.evaluators import COLUMNS, measure_evaluators
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.runs import benchmark
from robodyn.runs.benchmark import ORDER, TOLERANCE, Measurement, _mark_front, followed, reference
from robodyn.runs.march import run
from robodyn.runs.motion_columns import as_actuation
from robodyn.runs.settings import Settings

TOLERANCES = (1e-4, 1e-8, 1e-13)
ARM = np.array([-1.3, -0.2, 0.5, 0.25])
EPS = float(np.finfo(float).eps)


ARM_2R = load(ROOT / "robots/2r.yaml")  # one for all: what is made of it once serves them all


def arm(tau="0, 0", t_end=0.1, **options):
    mech = ARM_2R
    torques = actuation.expressions(mech, tau, "tau") if tau else Actuation((0.0, 0.0))
    options = {"tolerances": TOLERANCES, "repeats": 1, **options}
    return benchmark.benchmark(mech, ARM, t_end, torques, **options)


def methods(result):
    return {x.method for x in result.measurements}


def assert_front(runs):
    """Marked are exactly those that none is as fast and as good as, ties aside."""
    runs = [x for x in runs if x.outcome == "finished"]
    marked = [x for x in runs if x.front]
    assert marked
    for one in marked:
        assert not any(
            other.least <= one.least and other.error <= one.error and other is not one
            for other in runs
            if (other.least, other.error) != (one.least, one.error)
        )
    for one in runs:
        if not one.front:
            assert any(x.least <= one.least and x.error <= one.error for x in marked)


def test_every_method_is_measured_and_the_front_is_right():
    parts = []
    result = arm(watch=parts.append, repeats=2)
    expected = {"DOP853", "RK45", "Radau", "taylor"}
    assert methods(result) == expected
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert_front(result.measurements)
    uncertainty = result.reference.uncertainty
    assert EPS <= uncertainty < 1e-13
    for x in result.measurements:
        assert x.outcome == "finished"
        assert uncertainty <= x.error_end <= x.error < 1000 * x.tolerance + 100 * uncertainty
        assert 0.0 <= x.drift < 10 * x.error + 1e-14
        assert x.gap == 0.0
        assert x.evaluations > 0
        assert x.steps > 0
        assert len(x.seconds) == 2
        assert 0.0 < x.least <= x.median


def test_a_loop_has_a_gap_and_errors_against_the_reference():
    mech = load(ROOT / "robots/four-bar.yaml")
    start = np.array([1.0, -0.44710007477867686704, 1.69919794503111621482, 0.0, 0.0, 0.0])
    torques = Actuation((0.0,) * 3)
    result = benchmark.benchmark(mech, start, 0.1, torques, tolerances=(1e-8,), repeats=1)
    assert all(0.0 < x.gap < 1e-14 for x in result.measurements)
    exact = reference(mech, start, np.linspace(0.0, 0.1, benchmark.TIMES + 1)[1:], torques)
    assert np.array_equal(exact.y, result.reference.y)
    assert {x.error < 1e-5 for x in result.measurements} == {True}


def test_the_front_of_random_runs():
    for seed in range(20):
        with case(seed):
            rng = np.random.default_rng(seed)
            runs = [
                Measurement("a", 1e-3, "finished", error=float(error), least=float(least))
                for error, least in rng.integers(1, 6, (12, 2))
            ]
            runs.append(Measurement("b", 1e-3, "stiff"))
            _mark_front(runs, 1.0)
            assert_front(runs)
            assert not runs[-1].front


def test_torques_that_switch_by_the_time_leave_nothing_out():
    result = arm("abs(sin(5*t)), 0", tolerances=(1e-4, 1e-8))
    assert {"DOP853", "taylor"} <= methods(result)
    assert told(result) == []
    best = min(x.error for x in result.measurements)
    assert result.reference.uncertainty <= best < 1e-6


def test_without_llvmlite(monkeypatch):
    monkeypatch.setattr("robodyn.engines.machine.available", lambda: False)
    result = arm(tolerances=(1e-8,))
    assert "taylor" not in methods(result)
    (reason,) = result.left_out
    assert ".[fast]" in reason


def told(result):
    """What was left out, but for an extra that is not installed."""
    return [line for line in result.left_out if ".[fast]" not in line]


def test_patience_ends_a_method():
    result = arm(patience=0.0)
    assert {x.tolerance for x in result.measurements} == {TOLERANCES[0]}
    assert all(f"below {TOLERANCES[0]:g}: took" in line for line in told(result))
    assert len(told(result)) == len(methods(result))
    assert told(arm(patience=0.0, tolerances=(1e-4,))) == []


def test_loading_is_no_part_of_patience(monkeypatch):
    once, run, now = [], benchmark.run, 0.0

    def slow_at_first(mech, state, t_end, torques, settings, *rest):
        nonlocal now
        now += 0.1
        if settings.method not in once:
            once.append(settings.method)
            now += 0.3
        return run(mech, state, t_end, torques, settings, *rest)

    monkeypatch.setattr(benchmark, "run", slow_at_first)
    monkeypatch.setattr(benchmark, "time", SimpleNamespace(perf_counter=lambda: now))
    assert told(arm(t_end=0.05, tolerances=(1e-3, 1e-4), patience=0.3)) == []
    assert len(once) >= 4


def test_a_run_that_does_not_finish_is_told(monkeypatch):
    monkeypatch.setattr(benchmark, "MAX_EVALUATIONS", 100)
    result = arm(t_end=0.5)
    ended = [x for x in result.measurements if x.outcome != "finished"]
    assert {x.outcome for x in ended} == {"too many evaluations"}
    assert not any(x.front for x in ended)
    assert {np.isinf(x.error) for x in ended} == {True}
    assert {np.isnan(x.least) for x in ended} == {True}
    assert any("below 0.0001: too many evaluations there" in line for line in result.left_out)


def test_tolerances_that_a_method_does_not_take_are_passed_over():
    result = arm(tolerances=(1e-8, 1e-15))
    assert {x.method for x in result.measurements if x.tolerance == 1e-15} == {"taylor"}


def test_a_motion_without_a_reference_is_an_error():
    with pytest.raises(RobodynError, match=r"cannot be followed beyond t = 0\.3"):
        arm("sqrt(0.3 - t), 0", t_end=0.5)


# Reference motions in extended precision: against known digits, exact motions, and each other.


REFERENCES = Path(__file__).parent / "references"
FRESH = bool(os.environ.get("FRESH"))  # as `make hard` has it
LONGEST = 5.0 if FRESH else 0.5  # s
NAMES = sorted(path.stem for path in REFERENCES.glob("*.json"))
SLIDING = {"2r-chaotic": 2.0}  # s, where errors of the constants grow exponentially
DISC = "gravity: 0\nlinks: [{name: disc, m: 0, l: 1, r: 0, I: 0.7, damping: %s}]\n"


def at_rest(n):
    return Actuation((0.0,) * n)


def by_series(*given):
    """The rows (T, 2n) of the series, in extended precision."""
    return followed(*given, ORDER, TOLERANCE)


def known(name):
    """Scene, torques, times and states of a motion known to 18 digits."""
    data = json.loads((REFERENCES / f"{name}.json").read_text())
    mech = load(ROOT / data["scene"])
    states = [[np.longdouble(x) for x in s["q"] + s["qd"]] for s in data["states"]]
    times = np.array([s["t"] for s in data["states"]])
    keep = times <= min(LONGEST, SLIDING.get(name, LONGEST))
    torques = at_rest(mech.n)
    if data["tau"]:
        torques = actuation.expressions(mech, data["tau"], "tau")
    return mech, torques, times[keep], np.array(states)[keep]


def _by_floats(mech, start, times, torques):
    """Rows of the series in floats: near enough to tell how far a motion is moved by 1e-9."""
    rows, tightest = [], Settings("taylor", 1e-14, 1e-14)
    run(mech, start, times[-1], torques, tightest, lambda t, y, _: rows.append(y), times)
    return rows


@pytest.mark.parametrize("name", NAMES)
def test_the_known_digits_are_reached(name):
    mech, torques, times, states = known(name)
    start = states[0].astype(float)
    rows = by_series(mech, start, times[1:], torques)
    # the scene's numbers, rounded, are another mechanism's: this is how far its motion is off
    nearby = start.copy()
    nearby[: mech.n] *= 1.0 + 1e-9
    nearby[0] += 1e-9
    moved = np.concatenate(_by_floats(mech, nearby, times[1:], torques))
    sensitivity = float(np.abs(moved - rows).max()) / 1e-9
    assert float(np.abs(rows - states[1:]).max()) < 4e-15 * max(1.0, sensitivity)


def test_the_uncertainty_bounds_the_error_of_an_exact_pendulum():
    mech = load(ROOT / "robots/pendulum.yaml")
    times = np.linspace(0.5, 5.0, 10)
    found = reference(mech, np.array([1.0, 0.0]), times, at_rest(1))
    with mp.workdps(30):
        weight = mpf(abs(mech.weights[0]))
        rate = mp.sqrt(weight / mpf(float(mech.arrays.A[0, 0].real)))
        k = mp.sin((1 + mp.pi / 2) / 2)
        exact = [2 * mp.asin(k * mp.ellipfun("cd", rate * t, k=k)) - mp.pi / 2 for t in times]
        errors = [abs(mpf(q) - x) for q, x in zip(found.y[:, 0].tolist(), exact, strict=True)]
    assert EPS <= found.uncertainty < 1e-13
    assert float(max(errors)) <= found.uncertainty + 2 * EPS  # half a unit of doubles around 4


def test_the_uncertainty_bounds_the_error_where_a_series_shows_nothing_of_a_force():
    """The series of x^39 from x = 0 has no term below the 39th; the energy tells of the force."""
    link = "{name: block, joint: prismatic, axis: [0, 1], m: 1, l: 0, r: 0, I: 0}"
    mech = load(f"gravity: 9.81\nlinks:\n  - {link}\n")
    found = reference(
        mech, np.array([0.0, 5.0]), np.array([10.0 / 9.81]), as_actuation(mech, "-q1**39")
    )
    ((x, v),) = found.y
    energy = 0.5 * v**2 + 9.81 * x + x**40 / 40.0
    assert abs(energy - 12.5) < 20.0 * max(found.uncertainty, 2.2e-16)


def test_damping_and_a_torque():
    mech = mechanism(DISC % 0.35)
    times = np.array([0.5, 2.0])
    found = reference(mech, np.array([0.2, 3.0]), times, Actuation((1.4,)))
    rate = 4.0 - np.exp(-0.5 * times)
    angle = 0.2 + 4.0 * times + 2.0 * np.expm1(-0.5 * times)
    assert found.y == pytest.approx(np.stack([angle, rate], axis=1), abs=4e-15)
    assert found.uncertainty < 4e-15


def test_kinks_of_a_table_are_stepped_onto():
    mech = mechanism(DISC % 0)
    stamps, torques = [0.0, 0.3, 0.7, 1.1], [0.0, 2.0, -1.0, 0.5]
    table = actuation.table(mech, stamps, [[x] for x in torques], where="table", until=1.1)
    q, qd, exact = 0.0, 0.0, []
    for k in range(3):
        h, a, b = stamps[k + 1] - stamps[k], torques[k] / 0.7, torques[k + 1] / 0.7
        q += h * qd + h * h * (2 * a + b) / 6
        qd += h * (a + b) / 2
        exact.append([q, qd])
    for times in (stamps[1:], [0.29, 0.55, 1.1]):  # on the kinks, and between them
        found = reference(mech, np.zeros(2), np.array(times), table)
        assert found.y[-1] == pytest.approx(exact[-1], abs=1e-15)
        assert found.uncertainty < 2e-15
    series = by_series(mech, np.zeros(2), np.array(stamps[1:]), table)
    assert series.astype(float) == pytest.approx(np.array(exact), abs=1e-15)


@pytest.mark.parametrize("shape", ["four-bar", "slider-crank", "six-bar with a piston"])
def test_loops_stay_closed(shape):
    scene = seeded_scene(2, LOOPS[shape])
    mech, arrays = scene.mechanism, scene.mechanism.arrays
    state = np.concatenate([scene.q, scene.qd])
    for y in by_series(mech, state, np.array([0.1, 0.2]), at_rest(scene.n)):
        turns = arrays.P * np.exp(1j * (arrays.J @ y[: scene.n]))
        gap = turns.sum(axis=1).real + np.asarray(arrays.offset, np.longdouble)
        rate = turns.imag @ (arrays.J @ y[scene.n :])
        assert float(np.abs(gap).max()) < 1e-17
        assert float(np.abs(rate).max()) < 1e-16


def test_a_large_mechanism():
    scene = seeded_tree(4, 13)
    state = np.concatenate([scene.q, scene.qd])
    found = reference(scene.mechanism, state, np.array([0.02]), at_rest(scene.n))
    assert EPS <= found.uncertainty < 1e-13


@pytest.mark.parametrize("tau", ["abs(sin(5*t)), 0", "1 if t < 0.3 else 0, 0"])
def test_torques_that_switch_by_the_time_have_a_series_between(tau):
    mech = load(ROOT / "robots/2r.yaml")
    torques = actuation.expressions(mech, tau, "tau")
    assert reference(mech, np.zeros(4), np.array([0.5]), torques).uncertainty < 1e-13


def test_torques_without_a_series_are_refused():
    mech = load(ROOT / "robots/2r.yaml")
    for tau, what in (("abs(q1), 0", "function abs"), (lambda t, q, qd: [t, 0.0], "Python")):
        with pytest.raises(InputError, match=f"{what} has no series: errors are measured"):
            reference(mech, np.zeros(4), np.array([0.5]), as_actuation(mech, tau))


@pytest.mark.parametrize("tau", ["sqrt(0.3 - t), 0", "1/(t - 0.3), 0", "log(t - 1), 0"])
def test_a_motion_that_ends_is_an_error(tau):
    mech = load(ROOT / "robots/2r.yaml")
    torques = actuation.expressions(mech, tau, "tau")
    with pytest.raises(RobodynError, match=r"the motion: (cannot be followed|is not defined)"):
        reference(mech, np.zeros(4), np.array([0.5]), torques)


@pytest.mark.parametrize("name", ["2r-regular", "four-bar"])
def test_where_the_long_double_is_a_double(monkeypatch, name):
    mech, torques, times, states = known(name)
    monkeypatch.setattr(benchmark, "LONG", np.float64)
    monkeypatch.setattr(benchmark, "COMPLEX", np.complex128)
    found = reference(mech, states[0].astype(float), times[1:3], torques)
    error = float(np.abs(found.y - states[1:3].astype(float)).max())
    assert EPS <= found.uncertainty < 1e-11
    assert error <= 10.0 * found.uncertainty


# Rounding errors and costs of the evaluators of single states and of batches.


RUN = repeat
BATCHES = (1, 7, 50)  # fewer and more than the states that are checked


def brief(share):
    """As timeit's `repeat`, with a share of the calls."""
    return lambda call, number, repeat: RUN(call, number=-(-number // share), repeat=repeat)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Every evaluator is called for its time, but not as often as a user's figures need."""
    monkeypatch.setattr(evaluators, "BATCHES", BATCHES)
    monkeypatch.setattr(evaluators, "repeat", brief(2000))


def measured(mech):
    return [dict(zip(COLUMNS, row, strict=True)) for row in measure_evaluators(mech)]


@pytest.mark.parametrize("scene", ["2r", "four-bar", "slider-crank", "five-bar"])
def test_rounding_errors_and_rows(scene):
    rows = measured(load(ROOT / f"robots/{scene}.yaml"))
    for kind in ("forward", "inverse"):
        of = [row for row in rows if row["dynamics"] == kind]
        assert [row["states"] for row in of if row["evaluator"] == "arrays"] == list(BATCHES)
        if scene == "2r":
            assert [row["states"] for row in of if row["evaluator"] == "straight-line"] == [1.0]
    for row in rows:
        assert 0.0 < row["median_error"] <= row["largest_error"] < 1e-12
        assert 0.0 < row["ns_per_state"] < 1e9


def test_a_batch_is_cheaper_by_the_state(monkeypatch):
    monkeypatch.setattr(evaluators, "repeat", brief(20))
    rows = measured(load(ROOT / "robots/2r.yaml"))
    costs = [
        row["ns_per_state"]
        for row in rows
        if (row["dynamics"], row["evaluator"]) == ("inverse", "arrays")
    ]
    assert costs[-1] < costs[0]


def test_a_wrong_evaluator_shows(monkeypatch):
    right = dynamics.inverse_dynamics
    monkeypatch.setattr(dynamics, "inverse_dynamics", lambda *given: 1.000001 * right(*given))
    rows = measured(load(ROOT / "robots/2r.yaml"))
    wrong = [row for row in rows if row["largest_error"] > 1e-12]
    assert {(row["dynamics"], row["evaluator"]) for row in wrong} == {("inverse", "arrays")}
    assert [row["largest_error"] for row in wrong] == pytest.approx([1e-6] * 3, rel=1e-6)


def test_fewer_closed_states_than_are_checked(monkeypatch):
    sample = identities.sample_states

    def few(mech, count):
        return sample(mech, 5)

    monkeypatch.setattr(identities, "sample_states", few)
    rows = measured(load(ROOT / "robots/four-bar.yaml"))
    assert max(row["largest_error"] for row in rows) < 1e-12


def test_no_closed_states_is_an_error(monkeypatch):
    none = identities.Sample(np.zeros((0, 2)), np.zeros((0, 2)), 0.0, np.zeros(0))
    monkeypatch.setattr(identities, "sample_states", lambda *given: none)
    with pytest.raises(RobodynError, match=r"2r\.yaml: bench --evaluators: no closed states"):
        measured(load(ROOT / "robots/2r.yaml"))


def test_a_freedom_without_inertia_is_an_error():
    mech = mechanism("links: [{name: rod, m: 0, l: 1, r: 0, I: 0}]\n")
    with pytest.raises(RobodynError, match="not unique"):
        measured(mech)


def test_without_mpmath(monkeypatch):
    monkeypatch.setattr(evaluators, "find_spec", lambda name: None)
    with pytest.raises(RobodynError, match=r"needs mpmath.*pip install"):
        measured(load(ROOT / "robots/2r.yaml"))
