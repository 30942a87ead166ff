"""Reference motions in extended precision: against known digits, exact motions, and each other."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from mpmath import mp, mpf

from random_mechanisms import LOOPS, mechanism, seeded_scene, seeded_tree
from robodyn import load
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.simulation import extended
from robodyn.simulation.extended import ORDER, TOLERANCE, reference
from robodyn.simulation.run_torques import as_actuation
from robodyn.simulation.settings import Settings
from robodyn.simulation.simulation import run

EPS = float(np.finfo(float).eps)
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
    task = extended._Task(*given)
    return extended._followed(task, extended._Series(task, ORDER, TOLERANCE))


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
    monkeypatch.setattr(extended, "LONG", np.float64)
    monkeypatch.setattr(extended, "COMPLEX", np.complex128)
    found = reference(mech, states[0].astype(float), times[1:3], torques)
    error = float(np.abs(found.y - states[1:3].astype(float)).max())
    assert EPS <= found.uncertainty < 1e-11
    assert error <= 10.0 * found.uncertainty
