"""Events may name whatever can be computed of a state: forces, powers, points, accelerations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

import robodyn

METHODS = ["DOP853", "RK45", "Radau", "taylor"]
ARM = robodyn.load("2r")
LOOP = robodyn.load("four-bar")
STICKING = robodyn.load(
    {
        "gravity": 9.81,
        "links": [
            {"name": "a", "m": 1, "l": 0.8, "r": 0.4, "I": 0.05},
            {
                "name": "b",
                "m": 0.5,
                "l": 0.5,
                "r": 0.25,
                "I": 0.01,
                "friction": {"torque": 0.4, "static": 0.6},
            },
        ],
    }
)


def state_at(motion: robodyn.Motion, event: str) -> tuple[float, NDArray[np.float64]]:
    (found,) = [x for x in motion.events if x.name == event][:1]
    return found.t, found.y


@pytest.mark.parametrize("method", METHODS)
def test_a_pin_force_and_a_power_end_a_run(method: str) -> None:
    q = robodyn.assemble(LOOP, [1.0])
    qd = robodyn.loop_velocities(LOOP, q, [5.0])
    tau = "0.5*sin(4*t)"
    for text, of in (("fy1 < -4 N", "fy1"), ("power1 > 1 W", "power1"), ("w3 > 2", "w3")):
        motion = robodyn.simulate(
            LOOP, q, qd, 2.0, tau, until=text, method=method, rtol=1e-10, atol=1e-10
        )
        t, y = state_at(motion, "until")
        acting = [0.5 * np.sin(4.0 * t), 0.0, 0.0]
        state = robodyn.State(LOOP, y[:3], y[3:], tau=acting, t=t)
        limit = {"fy1": -4.0, "power1": 1.0, "w3": 2.0}[of]
        assert state.columns([of])[0] == pytest.approx(limit, abs=1e-7)
        # nowhere before, on rows between
        times = np.linspace(0.0, t, 400)[:-1]
        rows = robodyn.simulate(LOOP, q, qd, t, tau, t_eval=times, rtol=1e-10, atol=1e-10)
        torques = np.zeros((len(times), 3))
        torques[:, 0] = 0.5 * np.sin(4.0 * times)
        before = robodyn.State(LOOP, rows.q, rows.qd, tau=torques, t=times).columns([of])[:, 0]
        assert ((before > limit) == (before[0] > limit)).all()
    assert not (before > limit).any()


@pytest.mark.parametrize("method", METHODS)
def test_the_height_of_a_pendulums_tip_passes_when_its_angle_does(method: str) -> None:
    pendulum = robodyn.load(
        {"gravity": 9.81, "links": [{"name": "a", "m": 1, "l": 2, "r": 1, "I": 0.3}]}
    )
    run = robodyn.simulate(
        pendulum,
        [0.0],
        [0.0],
        2.0,
        method=method,
        rtol=1e-11,
        atol=1e-11,
        events={"low": "tip1_y < -1", "angle": "q1 < -30deg", "slow": "KE - 9.81 J"},
    )
    times = {x.name: x.t for x in run.events if x.t < 1.0}
    assert times["low"] == pytest.approx(times["angle"], abs=1e-10)
    # KE = m g r sin 90deg only at the bottom; 9.81 J is the most there is: it is touched there
    assert "slow" not in times or times["slow"] > times["low"]


def test_forces_of_a_mode_are_those_of_its_motion() -> None:
    """A joint of dry friction that sticks moves as one body with its carrier."""
    run = robodyn.simulate(STICKING, [0.3, 0.4], [0.0, 0.0], 2.0, until="ry1 > 16")
    t, y = state_at(run, "until")
    rows = robodyn.simulate(STICKING, [0.3, 0.4], [0.0, 0.0], t, t_eval=np.linspace(0.0, t, 500))
    moving = rows.phases[-1][1]
    state = robodyn.State(STICKING, y[:2], y[2:], tau=[0.0, 0.0], moving=moving)
    assert state.columns(["ry1"])[0] == pytest.approx(16.0, abs=1e-6)


def test_an_acceleration_is_found_where_rows_between_have_it() -> None:
    start = [1.0, 0.5], [0.0, 0.0]
    run = robodyn.simulate(ARM, *start, 1.5, events={"turn": "qdd1"}, rtol=1e-11, atol=1e-11)
    times = [x.t for x in run.events]
    assert len(times) >= 2

    def acceleration(t: float) -> float:
        rows = robodyn.simulate(ARM, *start, t, t_eval=[t], rtol=1e-12, atol=1e-12)
        return float(rows.qdd[0, 0])

    for t in times:
        assert brentq(acceleration, t - 1e-3, t + 1e-3, xtol=1e-12) == pytest.approx(t, abs=1e-8)


def test_what_no_column_has_is_refused() -> None:
    start = [0.0, 0.0], [0.0, 0.0]
    for text in ("tip9_y > 0", "fx1 > 1", "power1 > 1 N", "ratio > 1"):
        with pytest.raises(robodyn.InputError, match="event"):
            robodyn.simulate(ARM, *start, 1.0, events={"x": text})


def test_a_sweep_counts_events_of_columns() -> None:
    table = robodyn.sweep(
        ARM,
        {"q1": [0.5, 1.0]},
        time=1.0,
        event=["low=tip2_y - 0.5"],
        result="events",
    )
    single = [
        robodyn.simulate(ARM, [q, 0.0], [0.0, 0.0], 1.0, events={"low": "tip2_y - 0.5"})
        for q in (0.5, 1.0)
    ]
    first = [run.events[0].t for run in single]
    np.testing.assert_allclose(table["low_first"], first, atol=1e-9)


HANGING: dict[str, Any] = {
    "gravity": 9.81,
    "links": [{"name": x, "m": 1, "l": 1, "r": 0.5, "I": 0.1} for x in "ab"],
    "points": {"P": {"link": "b", "at": [1, 0]}},
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_a_column_that_is_undefined_at_rest_makes_no_events(method: str) -> None:
    """The path of a point that stands has no curvature: rounding alone would give it one."""
    rest = [-np.pi / 2, 0.0], [0.0, 0.0]
    events = {"straight": "P_kappa", "bent": "P_kappa - 1"}
    run = robodyn.simulate(
        robodyn.load(HANGING), *rest, 1.0, events=events, until="P_kappa > 1", method=method
    )
    assert run.t[-1] == 1.0
    assert not run.events
    assert any("undefined to rounding from t = 0" in x for x in run.report.remarks)
