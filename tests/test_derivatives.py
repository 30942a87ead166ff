"""Derivatives of the dynamics, against differences of the oracle of 30 digits and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sympy
from conftest import ROOT, relative_error
from engine_cases import KINDS, ROBOTS, Case, case, random_case, robot_cases
from known_slopes import along
from mpmath import mp, mpf
from sliding_trees import random_tree, text_of

import robodyn as rd
from random_mechanisms import Scene, forced
from robodyn.dynamics import derivatives, identities
from robodyn.engines import expression, formulas
from robodyn.engines.expression import Graph, substituted, tangents
from robodyn.engines.formulas import forward_derivatives_formula
from robodyn.engines.straightline import compile_floats
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.mechanism import build
from robodyn.scene.scene_values import read_numbers


def check(at: Case, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mech, n = at.mech, len(at.q)
    allowed = 1e-13 * (1.0 + at.at.condition / 100.0)
    forward = rd.forward_dynamics_derivatives(mech, at.q, at.qd, at.tau, at.t)
    inverse = rd.inverse_dynamics_derivatives(mech, at.q, at.qd, at.qdd, at.t)
    assert relative_error(forward.qdd, at.expected["qdd"]) < at.rounding
    assert relative_error(inverse.tau, at.expected["tau"]) < at.rounding
    for kind, found in (("forward", forward[1:4]), ("inverse", inverse[1:4])):
        for by, matrix in zip(("q", "qd", "x"), found, strict=True):
            v = rng.normal(size=n)
            expected = along(at, kind, by, v)
            size = np.abs(matrix).max() + np.abs(expected).max() + 1.0
            assert np.abs(matrix @ v - expected).max() < allowed * size, (kind, by)


@pytest.mark.parametrize("kind", KINDS)
def test_random_scenes(kind: str) -> None:
    check(random_case(kind, 2, acted=True), 2)


@pytest.mark.parametrize("seed", range(3))
def test_slots_of_moving_links(seed: int) -> None:
    """A pin of one link in a slot of another that hangs from a third, under forces."""
    tree, rng = random_tree(seed, "RRR", (None, None, 1)), np.random.default_rng(seed)
    q, (pin, along) = rng.uniform(-3, 3, 3), (rng.normal(size=(2, 2)) @ (1, 1j)).tolist()
    E = np.exp(1j * np.array([q[0], q[1], q[1] + q[2]]))
    there = tree[0]["at"] + E[0] * pin - (tree[1]["at"] + E[1] * tree[2]["at"])
    slot = complex(there / E[2] + rng.normal() * along)
    plain = text_of(tree, 1.0 - 9.0j, (), [((0, pin), (2, slot), along)], (0, 1))
    acted = forced(seed, Scene(plain, q, q, q))
    check(case(acted.mechanism, q, rng.normal(size=3), seed), seed)


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_the_examples(path) -> None:
    case = robot_cases(path)[0]
    if case.at.condition < 1e12:  # what depends on one another is not as the oracle solves it
        check(case, 3)


def test_a_2r_by_its_lagrangian() -> None:
    """M^-1 (tau - C qd - G) of the textbook, differentiated by sympy."""
    q1, q2, w1, w2, t1, t2 = sympy.symbols("q1 q2 w1 w2 t1 t2")
    mech = rd.load(ROOT / "robots/2r.yaml")
    one, two = mech.description.links
    g = -mech.gamma.imag
    m1, l1, r1, I1 = one.m, one.l, one.r.real, one.I
    m2, r2, I2 = two.m, two.r.real, two.I
    extra = [(link.payload, link.l) for link in (one, two)]
    a = m1 * r1**2 + I1 + m2 * l1**2 + extra[0][0] * l1**2 + extra[1][0] * l1**2
    b, c = m2 * l1 * r2 + extra[1][0] * l1 * two.l, m2 * r2**2 + I2 + extra[1][0] * two.l**2
    M = sympy.Matrix([[a + c + 2 * b * sympy.cos(q2), c + b * sympy.cos(q2)], [0, c]])
    M[1, 0] = M[0, 1]
    h = b * sympy.sin(q2)
    first = (m1 * r1 + m2 * l1 + sum(x[0] for x in extra) * l1) * g
    second = (m2 * r2 + extra[1][0] * two.l) * g
    load = sympy.Matrix(
        [
            -h * (2 * w1 * w2 + w2**2) + first * sympy.cos(q1) + second * sympy.cos(q1 + q2),
            h * w1**2 + second * sympy.cos(q1 + q2),
        ]
    )
    damping = sympy.Matrix([d * w for d, w in zip(mech.damping, (w1, w2), strict=True)])
    qdd = M.LUsolve(sympy.Matrix([t1, t2]) - load - damping)
    values = dict(zip((q1, q2, w1, w2, t1, t2), (0.3, -0.8, 1.2, -0.7, 2.0, 0.4), strict=True))
    found = rd.forward_dynamics_derivatives(mech, [0.3, -0.8], [1.2, -0.7], [2.0, 0.4])
    for pair, matrix in zip(((q1, q2), (w1, w2), (t1, t2)), found[1:4], strict=True):
        expected = np.array(qdd.jacobian(pair).subs(values).evalf(20).tolist(), float)
        assert relative_error(matrix, expected) < 1e-13


def test_batches_and_single_states_agree() -> None:
    mech = rd.load(ROOT / "robots/watt-six-bar.yaml")
    rng = np.random.default_rng(2)
    q = rd.assemble(mech, rng.normal(size=(7, 1)))
    qd = rd.loop_velocities(mech, q, rng.normal(size=(7, 1)))
    tau = np.zeros_like(q)
    tau[:, 0] = 1.5
    every = rd.forward_dynamics_derivatives(mech, q, qd, tau)
    assert [x.shape for x in every] == [(7, 5), (7, 5, 5), (7, 5, 5), (7, 5, 5), (7, 5, 0)]
    dense = derivatives._forward(mech, [q, qd, tau], np.zeros(7))
    for one, many in zip(dense[:4], every[:4], strict=True):
        assert relative_error(one, many.reshape(7, -1)) < 1e-12


def test_states_that_elimination_does_not_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    """By residuals and the pseudo-inverse, as near singular states and large scenes are done."""
    for kind in ("tree", "five-bar", "geared five-bar", "sliding tree with motors"):
        case = random_case(kind, 1, False)
        state = case.mech, case.q, case.qd, case.tau
        expected = rd.forward_dynamics_derivatives(*state)
        with monkeypatch.context() as patch:
            patch.setattr(derivatives, "_generated", lambda _: None)
            found = rd.forward_dynamics_derivatives(*state)
        for one, other in zip(found[:4], expected[:4], strict=True):
            assert relative_error(one, other) < 1e3 * case.rounding


def test_what_sticks_has_no_part_in_it(scene) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    dry = text.replace("name: forearm", "name: forearm, friction: {torque: 3, static: 4}")
    mech = rd.load(scene(dry))
    found = rd.forward_dynamics_derivatives(mech, [0.3, -1.2], [0.5, 0.0], [9.0, 3.0])
    held = rd.forward_dynamics(mech, [0.3, -1.2], [0.5, 0.0], [9.0, 3.0])
    assert held[1] == 0.0
    assert np.abs(found.by_q[1]).max() < 1e-12
    h = 1e-6
    ahead, behind = (rd.forward_dynamics(mech, [0.3 + x, -1.2], [0.5, 0], [9, 3]) for x in (h, -h))
    assert found.by_q[0, 0] == pytest.approx((ahead - behind)[0] / (2 * h), rel=1e-7)
    state, number = ([0.3, -1.2], [0.5, 0.0], [9.0, 3.0]), "links.upper arm.l"
    expected = by_differences(read_numbers(dry, mech.source), number, state)
    found = rd.forward_dynamics_derivatives(mech, *state, numbers=[number])
    assert relative_error(found.by_numbers[:, 0], expected) < 1e-8


@pytest.mark.parametrize(("name", "bound"), [("2r", 5.0), ("four-bar", 5.0), ("watt-six-bar", 8.0)])
def test_all_derivatives_cost_a_few_evaluations(name: str, bound: float) -> None:
    """In additions; `bench` has it in time."""
    mech = rd.load(ROOT / f"robots/{name}.yaml")
    one, all_of_them = formulas.forward_formula(mech), forward_derivatives_formula(mech)
    assert one is not None
    assert all_of_them is not None
    costs = [expression.cost(x.outputs + x.pivots) for x in (all_of_them, one)]
    assert costs[0] < bound * costs[1]


# -- numbers of the scene --------------------------------------------------------------------------


def by_differences(values, name: str, state: tuple, solve=rd.forward_dynamics) -> np.ndarray:
    """Of qdd, or of what else is solved for, to the fourth order."""
    p = values.number(name)
    h = 1e-4 * max(abs(p), 0.1)
    found = [solve(build(values.replaced({name: p + k * h})), *state) for k in (-2, -1, 1, 2)]
    return np.array((found[0] - 8 * found[1] + 8 * found[2] - found[3]) / (12 * h))


@pytest.mark.parametrize("name", ["2r", "four-bar", "rp-arm", "spring-slider-crank", "whitworth"])
def test_every_number_of_a_scene(name: str) -> None:
    mech = rd.load(ROOT / f"robots/{name}.yaml")
    values = read_numbers((ROOT / f"robots/{name}.yaml").read_text(), mech.source)
    sample = identities.sample_states(mech, 1)
    state = sample.q[0], sample.qd[0], np.eye(mech.n)[mech.actuated[0]]
    known = 0
    for number in values.names:
        found = rd.forward_dynamics_derivatives(mech, *state, numbers=[number])
        moving = *state[:2], found.qdd
        inverse = rd.inverse_dynamics_derivatives(mech, *moving, numbers=[number])
        try:
            expected = by_differences(values, number, state)
        except DescriptionError:  # what may not be negative and is zero
            continue
        known += 1
        assert relative_error(found.by_numbers[:, 0], expected) < 1e-8, number
        expected = by_differences(values, number, moving, rd.inverse_dynamics)
        assert relative_error(inverse.by_numbers[:, 0], expected) < 1e-7, number
    assert known >= 9


def test_numbers_that_are_closed_forms() -> None:
    """tau of a pendulum: (I + m r^2) qdd + m g r cos q + d qd."""
    mech = rd.load(ROOT / "robots/pendulum.yaml")
    (link,) = mech.description.links
    g, r = -mech.gamma.imag, link.r.real
    names = ["gravity", f"links.{link.name}.m", f"links.{link.name}.r", f"links.{link.name}.I"]
    found = rd.inverse_dynamics_derivatives(mech, [0.4], [0.3], [2.0], numbers=names)
    held = link.m * r * np.cos(0.4)
    expected = [held, r * r * 2 + g * r * np.cos(0.4), 2 * link.m * r * 2 + held * g / r, 2.0]
    if link.payload:
        expected[0] += link.payload * link.l * np.cos(0.4)
    assert relative_error(found.by_numbers[0], expected) < 1e-14


def test_numbers_that_are_none() -> None:
    mech = rd.load(ROOT / "robots/2r.yaml")
    with pytest.raises(InputError, match=r"links.forarm.m: is no number .* did you mean"):
        rd.forward_dynamics_derivatives(mech, [0, 0], [0, 0], [0, 0], numbers=["links.forarm.m"])
    six = rd.load(ROOT / "robots/watt-six-bar.yaml")
    with pytest.raises(InputError, match=r"coupler.r: is two numbers there: take .*coupler.r\[0\]"):
        rd.forward_dynamics_derivatives(six, *[[0] * 5] * 3, numbers=["links.coupler.r"])


# -- tangents --------------------------------------------------------------------------------------

UNARY = ["sin", "cos", "tan", "sqrt", "exp", "log", "tanh", "sinh", "cosh", "atan", "asin", "acos"]


@pytest.mark.parametrize("name", UNARY)
def test_functions(name: str) -> None:
    graph = Graph()
    x = graph.variable("x")
    f = expression.call(name, 0.3 * x + 0.2) * x
    (slope,) = tangents([f], ["x"])
    formula = formulas.Formula(("x",), (slope["x"],), ())
    with mp.workdps(30):
        expected = mp.diff(lambda x: getattr(mp, name)(mpf(0.3) * x + mpf(0.2)) * x, mpf(0.7))
    assert compile_floats(formula, "f")(0.7)[0] == pytest.approx(float(expected), rel=1e-14)


def test_other_nodes() -> None:
    graph = Graph()
    x, y = graph.variable("x"), graph.variable("y")
    outputs = [
        (x / y - y) ** 3,
        expression.arctangent(x, y),
        expression.choose(x, y, x * x, y),
        abs(x - y) * x,
        expression.call("floor", x) * y,
        expression.keep(x * y) - 2.0,
        3.0,
    ]
    slopes = tangents(outputs, ["x", "y"])
    u, v = 0.4, 1.3
    expected = [
        [3 * (u / v - v) ** 2 / v, 3 * (u / v - v) ** 2 * (-u / v**2 - 1)],
        [v / (u * u + v * v), -u / (u * u + v * v)],
        [2 * u, 0.0],
        [v - 2 * u, u],
        [0.0, 0.0],
        [v, u],
        [0.0, 0.0],
    ]
    flat = tuple(slope.get(name, 0.0) for slope in slopes for name in "xy")
    found = compile_floats(formulas.Formula(("x", "y"), flat, ()), "f")(u, v)
    assert np.reshape(found, (-1, 2)) == pytest.approx(np.array(expected), rel=1e-14)
    there = substituted(outputs[:3], {"x": x + y, "y": 2.0})
    found = compile_floats(formulas.Formula(("x", "y"), tuple(there), ()), "f")(0.1, 0.4)
    assert found == pytest.approx(((0.25 - 2.0) ** 3, np.arctan2(0.5, 2.0), 0.25))


def test_a_stop_that_is_pressed(scene: Callable[[str], Path]) -> None:
    path = scene(
        "links:\n  - {name: arm, m: 1.5, l: 0.3, r: 0.2, I: 0.05,"
        " limits: {min: -0.5, max: 2, stiffness: 300, damping: 2}}\n"
    )
    mech, values = rd.load(path), read_numbers(path.read_text(), str(path))
    state = np.array([-0.6]), np.array([0.2]), np.array([0.0])
    for name in ("min", "stiffness", "damping"):
        number = f"links.arm.limits.{name}"
        found = rd.forward_dynamics_derivatives(mech, *state, numbers=[number])
        expected = by_differences(values, number, state)
        assert abs(expected).max() > 0.0
        assert relative_error(found.by_numbers[:, 0], expected) < 1e-8, number
