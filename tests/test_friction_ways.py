"""Friction that differs with the direction, and that which falls exponentially."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from contact_scenes import scene
from read_equations import evaluated, lines, module
from scipy.integrate import solve_ivp

import robodyn
from robodyn.equations.text import as_json, text
from robodyn.equations.written import equations
from robodyn.errors import DescriptionError, InputError
from robodyn.export.urdf import urdf
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.simulation import simulate

EACH = pytest.mark.parametrize("method", ["DOP853", "RK45", "Radau", "taylor"])
BLOCK = "links: [{{name: block, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 1, {}}}]"
DRY = "friction: {force: [3, 4], static: [5, 9], stribeck: 0.2, curve: exponential}"
SMOOTH = "friction: {force: [3, 5], speed: 0.1}"
TIGHT = {"rtol": 1e-11, "atol": 1e-12}


def block(friction: str) -> Mechanism:
    return scene(BLOCK.format(friction))


def slid(force: float, v: float, t: np.ndarray, kinetic: float, static: float) -> np.ndarray:
    """The speed of a block of 2 kg that slips against exponential friction, by its closed form."""
    a, b, width = (force - kinetic) / 2.0, -(static - kinetic) / 2.0, 0.2
    return width * np.log((math.exp(v / width) + b / a) * np.exp(a * t / width) - b / a)


@EACH
@pytest.mark.parametrize("way", [1, -1])
def test_a_block_that_slips_is_that_of_the_closed_form(method: str, way: int) -> None:
    kinetic, static = (3.0, 5.0) if way > 0 else (4.0, 9.0)
    rows = np.linspace(0.0, 1.0, 51)
    run = simulate(block(DRY), [0.0], [way * 0.05], 1.0, [way * 12.0], method, t_eval=rows, **TIGHT)
    exact = way * slid(12.0, 0.05, run.t, kinetic, static)
    assert np.abs(run.qd[:, 0] - exact).max() < 2e-9


@EACH
def test_a_block_that_comes_to_rest_does_so_in_time(method: str) -> None:
    """From 2 m/s it is braked by [3, 5] N alone, and holds up to 9 N against negative rates."""
    run = simulate(block(DRY), [0.0], [2.0], 1.0, [-8.0], method, **TIGHT)
    (stop,) = [x for x in run.events if "stops" in x.name]
    a, b, width = -11.0 / 2.0, -2.0 / 2.0, 0.2
    # u' = (a u + b)/width with u = exp(v/width), down to u = 1
    exact = width / a * math.log((1.0 + b / a) / (math.exp(2.0 / width) + b / a))
    assert abs(stop.t - exact) < 1e-8
    assert run.qd[-1, 0] == 0.0


@pytest.mark.parametrize(
    ("force", "starts"), [(4.9, 0), (5.1, 1), (-8.9, 0), (-9.1, -1), (-5.1, 0)]
)
def test_what_a_block_at_rest_holds_differs_with_the_direction(force: float, starts: int) -> None:
    qdd = robodyn.forward_dynamics(block(DRY), [0.0], [0.0], [force])
    assert np.sign(qdd[0]) == starts


@EACH
def test_smooth_friction_goes_from_one_amount_to_the_other(method: str) -> None:
    mechanism = block(SMOOTH)
    v = np.array([-3.0, -0.05, 0.0, 0.02, 3.0])
    needed = robodyn.inverse_dynamics(mechanism, np.zeros((5, 1)), v[:, None], np.zeros((5, 1)))
    part = 0.5 * (1.0 + np.tanh(v / 0.1))
    law = np.tanh(v / 0.1) * (3.0 * part + 5.0 * (1.0 - part))
    assert np.abs(needed[:, 0] - law).max() < 1e-14

    def rate(t: float, y: np.ndarray) -> list[float]:
        w = math.tanh(y[1] / 0.1)
        friction = w * (3.0 * (1.0 + w) + 5.0 * (1.0 - w)) / 2.0
        return [y[1], (6.0 * math.sin(4.0 * t) - friction) / 2.0]

    rows = np.linspace(0.0, 3.0, 31)
    run = simulate(mechanism, [0.0], [0.4], 3.0, "6 sin(4 t)", method, t_eval=rows, **TIGHT)
    other = solve_ivp(rate, (0.0, 3.0), [0.0, 0.4], "LSODA", run.t, rtol=1e-12, atol=1e-13)
    assert np.abs(run.q[:, 0] - other.y[0]).max() < 1e-8


def test_equal_amounts_are_one_amount() -> None:
    both = "friction: {force: [3, 3], static: [5, 5], stribeck: 0.2}"
    one = "friction: {force: 3, static: 5, stribeck: 0.2}"
    runs = [simulate(block(x), [0.0], [1.0], 5.0, "7 sin(3 t)") for x in (both, one)]
    assert runs[0].q.tolist() == runs[1].q.tolist()


def test_a_regressor_has_a_column_of_each_direction() -> None:
    found = robodyn.regressor(block(DRY), [0.0], [[0.3], [-0.3]], [[0.0], [0.0]])
    names = list(found.names)
    columns = found.Y[:, 0, [names.index(x) for x in ("fp1", "fn1", "fsp1", "fsn1")]]
    bell = math.exp(-0.3 / 0.2)
    assert np.abs(columns - [[1 - bell, 0, bell, 0], [0, bell - 1, 0, -bell]]).max() < 1e-15
    tau = robodyn.inverse_dynamics(block(DRY), [0.0], [[0.3], [-0.3]], [[0.0], [0.0]])
    assert np.abs(found.Y @ found.values + found.known - tau).max() < 1e-14


def test_identification_finds_both_directions() -> None:
    t = np.linspace(0.0, 4.0, 200)
    q, qd, qdd = (x[:, None] for x in (np.sin(t), np.cos(t), -np.sin(t)))
    tau = robodyn.inverse_dynamics(block(SMOOTH), q, qd, qdd)
    names = ["links.block.friction.force[0]", "links.block.friction.force[1]"]
    start = block("friction: {force: [1, 1], speed: 0.1}")
    found = robodyn.identify(start, q, qd, qdd, tau, of=names)
    assert np.abs(np.array([x.value for x in found.estimates]) - [3.0, 5.0]).max() < 1e-9


@pytest.mark.parametrize(
    ("friction", "told"),
    [
        ("{force: [1, 2, 3], speed: 1}", "friction.force = 3 values: must be a number, or two"),
        ("{force: [1, -2], speed: 1}", "friction.force[1] = -2: must be >= 0"),
        ("{force: [1, 2], static: 1.5}", "must be at least the force in motion, 2, at negative"),
        ("{force: 1, static: 2, curve: exponential}", "curve = exponential: needs the rate"),
        ("{force: 1, static: 2, curve: square}", "must be gaussian or exponential"),
    ],
)
def test_faults_are_named(friction: str, told: str) -> None:
    with pytest.raises(DescriptionError) as error:
        block(f"friction: {friction}")
    assert told in str(error.value)


def test_exports_refuse_what_has_one_friction() -> None:
    with pytest.raises(InputError, match="differs with the direction"):
        urdf(block("friction: {force: [1, 2], static: [2, 2]}"))


def test_fits_and_sensitivities_take_each_direction() -> None:
    mechanism, rows = block(DRY), np.linspace(0.0, 1.0, 21)
    name = "links.block.friction.static[1]"
    given = [0.0], [-0.05]
    run = simulate(mechanism, *given, 1.0, [-12.0], t_eval=rows, sensitivity=[name], **TIGHT)
    assert run.sensitivity is not None
    h = 1e-4
    ends = [
        slid(12.0, 0.05, rows, 4.0, 9.0 + change) for change in (h, -h)
    ]  # at negative rates, whose speed is -qd
    assert np.abs(run.sensitivity[:, 1, 0] + (ends[0] - ends[1]) / (2.0 * h)).max() < 1e-6
    problem = {name: (7.0, 9.5)}
    found = robodyn.fit_motion(
        mechanism, problem, ["qd1"], rows, *given, [-12.0], target=run.qd, starts=1
    )
    assert found.numbers[name] == pytest.approx(9.0, rel=1e-5)


PAIR = scene(f"""gravity: 9.81
links:
  - {{name: a, m: 1, l: 1, r: 0.5, I: 0.05, friction: {{torque: [0.4, 0.6], speed: 0.2}}}}
  - {{name: b, m: 1, l: 1, r: 0.5, I: 0.05, friction: {{torque: [0, 0.6], static: [0, 1]}}}}
  - {{name: c, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 1, {DRY}}}
""")


@pytest.mark.parametrize("numeric", [False, True])
def test_written_equations_have_both_directions(numeric: bool) -> None:
    """As text, and as code and JSON that give the torques."""
    written = lines(text(equations(PAIR)))
    bell = "exp(-abs(qd3)/ws3)"
    ahead = f"step(qd3) (ffp3 + (fsp3 - ffp3) {bell})"
    assert f"B3 = {ahead} - step(-qd3) (ffn3 + (fsn3 - ffn3) {bell})" in written
    assert "B2 = -tfn2 step(-qd2)" in written
    code = module(PAIR, numeric)["inverse_dynamics"]
    content = json.loads(as_json(equations(PAIR, numeric)))
    for q, qd, qdd in np.random.default_rng(3).uniform(-1.0, 1.0, (6, 3, 3)):
        tau = robodyn.inverse_dynamics(PAIR, q, qd, qdd)
        assert np.abs(code(q, qd, qdd) - tau).max() < 1e-12
        read = evaluated(content, q, qd)
        left = read["M"] @ qdd + read["C"] @ qd + read["G"][:, 0] - read["Q"][:, 0]
        assert np.abs(left - tau).max() < 1e-12


def test_linear_models_have_the_slope_of_smooth_friction() -> None:
    """At rest it is the mean of both amounts over the speed."""
    found = robodyn.linearize(block(SMOOTH), [0.0])
    assert found.A[1, 1] == pytest.approx(-4.0 / 0.1 / 2.0, rel=1e-12)
