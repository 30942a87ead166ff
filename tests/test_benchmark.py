"""Speed against error: what is measured, what is marked, what is left out."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT
from named_case import case

from robodyn import load
from robodyn.errors import RobodynError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.simulation import benchmark
from robodyn.simulation.benchmark import Measurement, _mark_front
from robodyn.simulation.extended import reference

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
