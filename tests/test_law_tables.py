"""Couplings by tables: cubic splines over a joint or over t."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from robodyn import (
    assemble,
    coupling_torques,
    forward_dynamics_and_forces,
    load,
    loop_velocities,
    simulate,
)
from robodyn.dynamics import identities
from robodyn.engines.coupling_laws import law_derivatives
from robodyn.errors import InputError, LawError
from robodyn.runs.report import Outcome

METHODS = ["DOP853", "RK45", "Radau", "taylor"]
CAM = """
gravity: 9.81
links:
  - {name: cam, m: 2, l: 0.1, r: 0.01, I: 0.02}
  - {name: lift, joint: prismatic, axis: [0, 1], m: 0.5, l: 0, r: 0, I: 0, from: [0.3, 0]}
couplings: {joint: lift, table: lift.csv, over: q1, column: lift, period: 360deg}
"""
CART = """
gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0}
  - {name: pole, m: 0.5, l: 0.6, r: 0.3, I: 0.015, from: cart}
couplings: [{joint: cart, table: cart.csv, over: t, column: x}]
"""


def rows(header, x, y, told=repr):
    lines = (f"{a!r},{told(b)}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    return "\n".join([header, *lines, ""])


@pytest.fixture
def cam(tmp_path):
    """A scene of a cam whose lift is this function of its angle."""

    def write(lift, count=73, text=CAM, told=repr):
        x = np.linspace(0, 2 * np.pi, count)
        (tmp_path / "lift.csv").write_text(rows("q1,lift", x, lift(x), told))
        (tmp_path / "cam.yaml").write_text(text)
        return tmp_path / "cam.yaml"

    return write


@pytest.fixture
def cart(tmp_path):
    t = np.linspace(0, 4, 41)
    (tmp_path / "cart.csv").write_text(rows("t,x", t, 0.3 * np.sin(2 * t)))
    (tmp_path / "cart.yaml").write_text(CART)
    return tmp_path / "cart.yaml"


def test_a_periodic_table_keeps_its_rise(cam):
    mech = load(cam(lambda x: 0.02 * (1 - np.cos(x)) + 0.003 * x))
    q = np.zeros((99, 2))
    q[:, 0] = np.linspace(-20, 30, 99)
    found = law_derivatives(mech, 0, 0, q, 0.0)
    x = q[:, 0]
    exact = 0.02 * (1 - np.cos(x)) + 0.003 * x, 0.02 * np.sin(x) + 0.003, 0.02 * np.cos(x)
    for value, known, near in zip(found, exact, (4e-9, 2e-7, 2e-5), strict=True):
        np.testing.assert_allclose(value, known, rtol=0, atol=near)
    knots = np.linspace(0, 2 * np.pi, 73)
    values = 0.02 * (1 - np.cos(knots))
    values[-1] = values[0]
    spline = CubicSpline(knots, values, bc_type="periodic")
    np.testing.assert_allclose(found[2], spline(np.mod(x, 2 * np.pi), 2), atol=1e-11)


@pytest.mark.parametrize("method", METHODS)
def test_a_cam_by_its_table_keeps_its_energy(cam, method):
    mech = load(cam(lambda x: 0.02 * (1 - np.cos(x))))
    q = assemble(mech, [0.2])
    motion = simulate(
        mech, q, loop_velocities(mech, q, [9.0]), 1.0, method=method, rtol=1e-10, atol=1e-10
    )
    assert motion.outcome is Outcome.FINISHED
    assert motion.report.energy_drift < 1e-7
    np.testing.assert_allclose(motion.q[:, 1], 0.02 * (1 - np.cos(motion.q[:, 0])), atol=4e-9)


@pytest.mark.parametrize("rows", [37, 361])
def test_steps_of_a_series_end_at_the_rows_of_a_table_over_a_joint(cam, rows):
    """One step a row, a little beyond it; forth and back, and backwards in time."""
    mech = load(cam(lambda x: 0.02 * (1 - np.cos(x)), rows))
    q = assemble(mech, [0.2])
    for rate, end in ((9.0, 2.0), (-9.0, -2.0), (2.0, 2.0)):  # the last one swings about the rest
        motion = simulate(mech, q, loop_velocities(mech, q, [rate]), end, method="taylor")
        at = motion.q[:, 0] * (rows - 1) / (2 * np.pi)
        passed = int(np.abs(np.diff(np.floor(at))).sum())
        assert passed > 10
        assert len(at) - 1 <= 1.2 * passed + 20
        assert motion.report.energy_drift < 1e-11
        inner = at[1:-1]
        landed = np.abs(inner - np.round(inner)) < 1e-4
        assert landed.sum() >= 0.9 * passed


@pytest.mark.parametrize("method", METHODS)
def test_a_cart_follows_a_table(cart, method):
    """The steps land on the rows: the series are exact between them."""
    mech = load(cart)
    q = assemble(mech, [0.2])
    qd = loop_velocities(mech, q, [0.0])
    motion = simulate(mech, q, qd, 4.0, method=method, rtol=1e-10, atol=1e-10)
    assert motion.report.energy_drift < 1e-7
    t = np.linspace(0, 4, 41)
    spline = CubicSpline(t, 0.3 * np.sin(2 * t), bc_type="not-a-knot")
    np.testing.assert_allclose(motion.q[:, 0], spline(motion.t), atol=1e-13)
    # the pole, I a'' = m r (x'' sin a - g cos a), from row to row
    m, r, inertia, y = 0.5, 0.3, 0.015 + 0.5 * 0.3**2, np.array([q[1], 0.0])

    def turned(at, y):
        return m * r * (spline(at, 2) * np.sin(y[0]) - 9.81 * np.cos(y[0])) / inertia

    for begin, end in pairwise(t.tolist()):
        step = solve_ivp(
            lambda at, y: [y[1], turned(at, y)], (begin, end), y, "DOP853", rtol=1e-12, atol=1e-12
        )
        y = step.y[:, -1]
    near = 1e-6 if method == "Radau" else 1e-7
    np.testing.assert_allclose([motion.q[-1, 1], motion.qd[-1, 1]], y, atol=near)
    _, lam, _ = forward_dynamics_and_forces(mech, motion.q, motion.qd, 0 * motion.q, motion.t)
    a, w = motion.q[:, 1], motion.qd[:, 1]
    pull = (turned(motion.t, [a]) * np.sin(a) + w * w * np.cos(a)) * m * r
    force = 2.5 * spline(motion.t, 2) - pull
    np.testing.assert_allclose(coupling_torques(mech, lam)[:, 0], force, atol=1e-8)
    assert np.isin(np.round(t, 12), np.round(motion.t, 12)).all()
    with pytest.raises(InputError, match=r"rows of cart\.csv must cover the simulation, 0 to 5 s"):
        simulate(mech, q, qd, 5.0)


def test_the_identities_hold(cam, cart):
    for path in (cam(lambda x: 0.02 * (1 - np.cos(x))), cart):
        mech = load(path)
        for x in identities.identities(mech, identities.sample_states(mech, 20)):
            assert x.residual is not None, x
            assert x.residual < 1e-9 or x.name.startswith("Psi"), x


def test_a_state_beyond_the_table_is_refused(cam):
    mech = load(cam(lambda x: 0.02 * x, text=CAM.replace(", period: 360deg", "")))
    with pytest.raises(LawError, match=r"lift over q1 in lift\.csv: has no value at q1 = 7"):
        simulate(mech, [7.0, 0.1], [0.0, 0.0], 1.0)
    motion = simulate(mech, assemble(mech, [6.0]), [5.0, 0.1], 1.0)
    assert motion.outcome is not Outcome.FINISHED
    assert "lift over q1 in lift.csv" in motion.report.advice


def test_check_tells_what_digits_make_of_it(robodyn, cam):
    def lift(x):
        return 0.02 * (1 - np.cos(x))

    good = robodyn("check", cam(lift), "--format", "json")
    (told,) = json.loads(good.out)["tables"]
    assert told["bend"] == pytest.approx(0.02, rel=1e-2)
    assert "Warning" not in good.err
    poor = robodyn("check", cam(lift, 361, told=lambda y: f"{y:.5f}"), "--format", "json")
    assert "second derivative may be off by" in poor.err


def test_a_scene_with_a_table_is_written_back(cam):
    mech = load(cam(lambda x: 0.02 * (1 - np.cos(x))))
    (coupling,) = mech.to_dict()["couplings"]
    assert coupling.pop("period") == pytest.approx(2 * math.pi)
    assert coupling == {"joint": "lift", "table": "lift.csv", "over": "q1", "column": "lift"}


@pytest.mark.parametrize(
    ("old", "new", "limit"),
    [
        ("joint: lift", "joint: nobody", "names no link"),
        ("over: q1", "over: q2", "must be t, or another joint"),
        ("over: q1", "over: qd1", "must be t, or another joint"),
        ("period: 360deg", "period: 180deg", "goes from 0 to 6.28319, not over 3.14159"),
        ("table: lift.csv", "table: none.csv", "cannot be read"),
        ("column: lift, ", "", "column: is missing"),
    ],
)
def test_what_is_no_table_is_refused(cam, old, new, limit):
    with pytest.raises(InputError, match=limit):
        load(cam(lambda x: 0.02 * x, text=CAM.replace(old, new)))


def test_few_rows_are_no_law(cam):
    with pytest.raises(InputError, match="a law needs 4"):
        load(cam(lambda x: 0.02 * x, 3))
