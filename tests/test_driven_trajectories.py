"""Trajectories beside laws of the time: each row closes at its own time."""

import csv

import numpy as np
import pytest
from test_driven_data import DRIVEN, MIXED, ROD, SHAKEN

from random_mechanisms import mechanism
from robodyn import assemble, loop_accelerations, loop_velocities
from robodyn.errors import InputError
from robodyn.trajectories.reference import reference_motion
from robodyn.trajectories.time_scaling import shortest_motion

SCENES = {"rod": ROD, "shaken": SHAKEN, "mixed": MIXED}
TRIPS = {
    "rod": [[0.1], [0.3], [0.2]],
    "shaken": [[0.4], [1.9], [3.0]],
    "mixed": [[0.3, -0.4], [0.8, 0.2], [0.1, 0.5]],
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("times", [[0.5, 1.2, 2.5], [0.0, 1.0, 2.0]])
class TestJoints:
    def test_states_close_at_their_times(self, name, times):
        """The actuated joints go as without the law, and the others as it tells at each time."""
        mech = mechanism(SCENES[name])
        own = list(mech.actuated)
        motion = reference_motion(mech, TRIPS[name], times=times)
        t = np.linspace(times[0], times[-1], 41)
        q, qd, qdd = motion.states(t)
        bare = mechanism(LINE)
        alone = [
            reference_motion(bare, np.array(TRIPS[name])[:, [k]], times=times).states(t)
            for k in range(len(own))
        ]
        for found, wanted in zip((q, qd, qdd), zip(*alone, strict=True), strict=True):
            np.testing.assert_allclose(found[:, own], np.hstack(wanted), atol=1e-9)
        turned = np.exp(1j * (q - assemble(mech, q[:, own], t=t)))  # a branch winds on
        np.testing.assert_allclose(turned, 1.0, atol=1e-12)
        np.testing.assert_allclose(qd, loop_velocities(mech, q, qd[:, own], t=t), atol=1e-11)
        bent = loop_accelerations(mech, q, qd, qdd[:, own], t=t)
        np.testing.assert_allclose(qdd, bent, atol=1e-9)

    def test_rates_are_slopes_of_the_rows(self, name, times):
        mech = mechanism(SCENES[name])
        motion = reference_motion(mech, TRIPS[name], times=times)
        t, h = np.linspace(times[0] + 0.1, times[-1] - 0.1, 15), 1e-5
        (q0, qd0, _), (_, qd, qdd), (q1, qd1, _) = (motion.states(t + x) for x in (-h, 0.0, h))
        np.testing.assert_allclose((q1 - q0) / (2 * h), qd, atol=2e-7)
        np.testing.assert_allclose((qd1 - qd0) / (2 * h), qdd, atol=2e-6)


LINE = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]"


def test_columns_are_those_of_torque(robodyn, scene):
    path = scene(SHAKEN)
    trip = ["--from", "0.4", "--to", "1.9", "--time", "1", "--points", "4"]
    out = robodyn("trajectory", path, *trip, "--columns", "t,q,qd,qdd,tau,tc1,gap").out
    plain = robodyn("trajectory", path, *trip).out
    torques = robodyn("torque", path, "-", stdin=plain).out
    one, other = ([*csv.DictReader(x.splitlines())] for x in (out, torques))
    assert len(one) == 4
    for row, right in zip(one, other, strict=True):
        for column in ("tau2", "tc1"):
            assert float(row[column]) == pytest.approx(float(right[column]), rel=1e-12)
        assert float(row["gap"]) < 1e-14


def test_a_limit_on_torque_is_told_at_its_time(robodyn, scene):
    path = scene(ROD)
    trip = ["--from", "0.1", "--to", "0.3", "--time", "1"]
    fine = robodyn("trajectory", path, *trip, "--columns", "t,tau2", "--points", "2001").out
    rows = [*csv.DictReader(fine.splitlines())]
    t, most = max(((float(x["t"]), abs(float(x["tau2"]))) for x in rows), key=lambda x: x[1])
    assert robodyn("trajectory", path, *trip, "--max-tau", repr(1.001 * most)).code == 0
    told = robodyn("trajectory", path, *trip, "--max-tau", repr(0.9 * most))
    assert told.code == 1
    at = float(told.err.split(" at t = ")[1].split(" s")[0])
    assert at == pytest.approx(t, abs=1e-3)


def test_what_is_refused_names_the_law(robodyn, scene):
    path, trip = scene(ROD), ["--from", "0.1", "--to", "0.3"]
    led = ["--from", "0.1", "--of", "bead"]
    aims, kept = ["--track", "-"], ["--q", "0.1", "--kp", "1", "--kd", "1"]
    for option, command, *rest in (
        ("--time min", "trajectory", *trip, "--time", "min", "--max-qd", "1"),
        ("--to-xy", "trajectory", *led, "--to-xy", "0.2,0.1", "--time", "1"),
        ("--arc", "trajectory", *led, "--arc", "0,0:30deg", "--time", "min", "--max-qd", "1"),
        ("--path", "trajectory", *led, "--path", "-", "--time", "1"),
        ("--control pd", "simulate", "--control", "pd", *aims, *kept),
        ("--control pid", "simulate", "--control", "pid", "--hold", "1", *kept),
        ("--control pd", "sweep", "--vary", "q2=1,2", "--control", "pd", *aims, *kept[2:]),
        ("linearize", "linearize", "--q", "0.1"),
        ("equilibrium", "equilibrium"),
        ("--range and --to-xy", "assemble", "--range"),
        ("--range and --to-xy", "assemble", "--of", "bead", "--to-xy", "0.2,0.1"),
    ):
        given = robodyn(command, path, *rest, stdin="t,q2\n0,0.1\n1,0.2\n")
        assert given.code == 2
        told = "couplings[0] = 3 rad/s t + 0.2 sin(t): is a law of the time"
        assert f"{told}, which {option} cannot take" in given.err
    with pytest.raises(InputError, match="law of the time"):
        shortest_motion(mechanism(ROD), [[0.1], [0.3]], max_qd=1.0)
    with pytest.raises(InputError, match="law of the time"):
        reference_motion(mechanism(DRIVEN), np.zeros((2, 0)), 1.0)
