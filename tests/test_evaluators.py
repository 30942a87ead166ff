"""Rounding errors and costs of the evaluators of single states and of batches."""

from timeit import repeat

import numpy as np
import pytest
from conftest import ROOT

from random_mechanisms import mechanism
from robodyn import load
from robodyn.dynamics import dynamics, evaluators, identities
from robodyn.dynamics.evaluators import COLUMNS, measure_evaluators
from robodyn.errors import RobodynError

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
    none = identities.Sample(np.zeros((0, 2)), np.zeros((0, 2)), 0.0)
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
