"""tau = Y pi on random scenes, the textbook's base parameters, and `robodyn regressor`."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome
from engine_cases import KINDS, ROBOTS, Case, random_case, robot_cases

import robodyn as rd
from robodyn.dynamics.free_joints import balanced_joints
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import build
from robodyn.parameters.base_parameters import (
    _symbols,
    base_parameters,
    dependence,
    random_states,
)
from robodyn.parameters.regression_matrix import _rows, linear_parameters
from robodyn.scene.description import from_text

Run = Callable[..., Outcome]


def check(case: Case) -> None:
    """Against the oracle of many digits."""
    mech, driven = case.mech, list(case.mech.actuated)
    found = rd.regressor(mech, case.q, case.qd, case.qdd, case.t)
    tau = found.Y @ found.values + found.known
    expected = case.expected["tau"][driven]
    parts = np.abs(found.Y * found.values).max(initial=0.0) + np.abs(found.known).max(initial=0.0)
    size = max(parts, np.abs(expected).max(initial=0.0))
    assert np.abs(tau - expected).max(initial=0.0) <= max(1e-13, case.rounding) * size
    many = [np.broadcast_to(x, (300, mech.n)) for x in (case.q, case.qd, case.qdd)]
    again = rd.regressor(mech, *many, case.t)
    assert np.abs(again.Y - found.Y).max(initial=0.0) <= 1e-12 * np.abs(found.Y).max(initial=1.0)


@pytest.mark.parametrize("acted", [False, True])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.thinned
def test_torques_are_linear_on_random_scenes(kind: str, acted: bool) -> None:
    check(random_case(kind, 1, acted=acted))


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_torques_are_linear_on_the_examples(path) -> None:
    check(robot_cases(path)[0])


def test_columns_of_a_2r_by_hand() -> None:
    """Of the textbook's torques, at q = (30, 45) degrees."""
    mech = rd.load(ROOT / "robots/2r.yaml")
    q, qd, qdd = np.radians([30, 45]), np.array([1.0, 0.5]), np.array([0.3, -0.2])
    found = rd.regressor(mech, q, qd, qdd)
    Y = dict(zip(found.names, found.Y.T, strict=True))
    g, l = 9.81, 0.8
    c1, c2, c12, s2 = np.cos(q[0]), np.cos(q[1]), np.cos(q.sum()), np.sin(q[1])
    a, b, w = qdd[0], qdd.sum(), qd.sum()
    assert np.allclose(Y["m1"], 0.0, atol=0.0)
    assert np.allclose(Y["mx1"], [g * c1, 0.0], rtol=1e-14)
    assert np.allclose(Y["J1"], [a, 0.0], rtol=1e-14)
    assert np.allclose(Y["m2"], [l * l * a + g * l * c1, 0.0], rtol=1e-14)
    assert np.allclose(Y["J2"], [b, b], rtol=1e-14)
    first = l * (c2 * (a + b) - s2 * (w**2 - qd[0] ** 2)) + g * c12
    assert np.allclose(Y["mx2"], [first, l * (c2 * a + s2 * qd[0] ** 2) + g * c12], rtol=1e-13)
    assert np.allclose(Y["d1"], [qd[0], 0.0])
    assert np.allclose(Y["d2"], [0.0, qd[1]])


def test_dry_friction_and_stops_have_their_modes() -> None:
    text = """
links:
  - {name: a, m: 1, l: 0.5, r: [0.2, 0.03], I: 0.1,
     friction: {torque: 0.5, static: 0.8, stribeck: 0.1}}
  - {name: b, m: 0.4, l: 0.3, r: 0.1, I: 0.02, limits: {max: 1.0, stiffness: 300, damping: 2}}
"""
    mech = build(from_text(text, "a.yaml"))
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.normal(size=(3, 40, 2))
    qd[:5, 0] = 0.0
    qd *= 0.2
    found = rd.regressor(mech, q, qd, qdd)
    tau = rd.inverse_dynamics(mech, q, qd, qdd)
    assert "fs1" in found.names
    assert np.abs(found.Y @ found.values + found.known - tau).max() < 1e-12


@pytest.mark.parametrize("name", ["2r", "four-bar", "spring-slider-crank", "watt-six-bar"])
def test_machine_code_has_the_same_columns(name: str) -> None:
    mech = rd.load(ROOT / f"robots/{name}.yaml")
    states = random_states(mech, 60)
    rows = _rows(mech, True) or _rows(mech, False)
    assert rows is not None
    function = rows.machine(2)
    assert function is not None
    found = [np.empty((60, width)) for width in rows.widths]
    assert not function(states, found).size
    for one, other in zip(found, rows.by_arrays(states, 2)[0], strict=True):
        assert np.abs(one - other).max() <= 1e-13 * max(1.0, np.abs(other).max())


# -- base parameters ------------------------------------------------------------------------------


def base_of(name: str) -> dict[str, float]:
    return {x.text: x.value for x in base_parameters(rd.load(ROOT / f"robots/{name}.yaml"))}


def test_base_parameters_of_the_textbooks_2r() -> None:
    """Khalil and Dombre: the forearm's mass is carried by the upper arm's moments."""
    m1, l1, r1, I1, m2, r2, I2 = 1.5, 0.8, 0.36, 0.082, 0.9, 0.25, 0.031
    expected = {
        "mx1 + l1 m2": m1 * r1 + l1 * m2,
        "my1": 0.0,
        "J1 + l1^2 m2": I1 + m1 * r1**2 + m2 * l1**2,
        "d1": 0.0,
        "mx2": m2 * r2,
        "my2": 0.0,
        "J2": I2 + m2 * r2**2,
        "d2": 0.0,
    }
    assert base_of("2r") == pytest.approx(expected, rel=1e-12)


def test_base_parameters_of_the_four_bar() -> None:
    """A point mass at the last pin belongs to the coupler or to the rocker."""
    found = base_of("four-bar")
    assert next(iter(found)) == "mx1 + l1 m2 + l1/l3 mx3"
    assert "J2 + l2^2/l3 mx3" in found
    assert "J3 - l3 mx3" in found
    assert len(found) == 11


@pytest.mark.parametrize(("name", "count"), [("3r", 12), ("watt-six-bar", 18), ("pendulum", 4)])
def test_how_many_base_parameters_there_are(name: str, count: int) -> None:
    assert len(base_of(name)) == count


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_base_parameters_give_the_torques(path) -> None:
    """At states that they were not found from."""
    mech = rd.load(path)
    q, qd, qdd = random_states(mech, 40, seed=7)  # more than it has base parameters
    found = rd.regressor(mech, q, qd, qdd)
    base = base_parameters(mech)
    columns = [found.names.index(x.name) for x in base]
    tau = found.Y[..., columns] @ [x.value for x in base] + found.known
    expected = rd.inverse_dynamics(mech, q, qd, qdd)[:, list(mech.actuated)]
    assert np.abs(tau - expected).max() <= 1e-11 * np.abs(expected).max()
    alike = dependence(found.Y.reshape(-1, len(found.names)), found.names)
    assert len(alike.kept) == len(base)


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_the_texts_of_base_parameters_are_their_values(path) -> None:
    scene = rd.load(path).description
    symbols = dict(_symbols(scene)) | {x.name: x.value for x in linear_parameters(scene)}
    for x in base_parameters(rd.load(path)):
        products = re.sub(r"(?<=[\w)]) (?=[\w(])", "*", x.text.replace("^", "**"))
        size = sum(abs(factor * symbols[name]) for name, factor in x.factors) + 1e-3
        assert eval(products, {}, symbols) == pytest.approx(x.value, rel=1e-8, abs=1e-8 * size)


def test_factors_of_a_six_bar_are_told_in_lengths() -> None:
    texts = "".join(base_of("watt-six-bar"))
    assert "(l1/l5 - l1 p5x/(l3 l5)) mx5" in texts
    assert not re.search(r"[0-9]\.", texts)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("parallelogram", "J1 + l1^2 m2 + l1 mx3"),
        ("balanced-arm", "mx1 + l1 m2 - e1x h1y/g k1"),
        ("elliptic-trammel", "mx2 - l2/2 m1 - l2/2 m2 + l2/2 m3"),
        ("rack-gripper", "J2 + 1/i1_1^2 m1 + l2^2 m3"),
        ("geared-five-bar", "i1_1^2 l3^2 m4 + (l1^2/l4 - i1_1^2 l3^2/l4) mx4"),
    ],
)
def test_factors_of_ratios_and_equal_lengths_are_told(name: str, text: str) -> None:
    texts = " ".join(base_of(name))
    assert text in texts
    assert not re.search(r"[0-9]\.", texts)


# -- the command ----------------------------------------------------------------------------------


def test_rows_pass_through(robodyn: Run) -> None:
    rows = "t,q1,q2,note\n0,0.1,0.2,a\n1,0.3,0.1,b\n"
    done = robodyn("regressor", "robots/2r.yaml", "-", stdin=rows)
    lines = done.out.splitlines()
    names = [x.name for x in linear_parameters(rd.load("robots/2r.yaml").description)]
    wanted = [f"Y{j}_{name}" for j in (1, 2) for name in names]
    assert lines[0].split(",") == ["t", "q1", "q2", "note", *wanted]
    assert [line.split(",")[3] for line in lines[1:]] == ["a", "b"]
    base = robodyn("regressor", "robots/2r.yaml", "-", "--base", stdin=rows).out.splitlines()
    assert len(base[0].split(",")) == 4 + 16


def test_base_and_condition_are_told(robodyn: Run, tmp_path) -> None:
    refused = robodyn("regressor", "robots/2r.yaml", "--base", "--format", "csv")
    assert refused.code == 2
    assert "--format = csv: must be table or json" in refused.err
    told = json.loads(robodyn("regressor", "robots/2r.yaml", "--base").out)["base"]
    assert told[0]["text"] == "mx1 + l1 m2"
    assert (
        "J1 + l1^2 m2" in robodyn("regressor", "robots/2r.yaml", "--base", "--format", "table").out
    )
    rows = "t,q1,q2,qd1,qd2,qdd1,qdd2\n" + "".join(f"{k},{0.3 * k},0.2,0,0,0,0\n" for k in range(8))
    found = json.loads(robodyn("regressor", "robots/2r.yaml", "-", "--condition", stdin=rows).out)
    assert found["rows"] == 8
    assert {"J1 + l1^2 m2", "d1", "J2", "d2"} <= set(found["not_excited"])


def test_a_free_joint_of_an_open_chain_has_a_row() -> None:
    """The cart-pole, f on the cart: (M + m) x'' - m l cos .. = f, and 0 of the pole."""
    mech = rd.load("robots/cart-pole.yaml")
    rng = np.random.default_rng(0)
    q, qd = rng.normal(size=(2, 20, 2))
    force = np.stack([rng.normal(size=20), np.zeros(20)], axis=-1)
    found = rd.regressor(mech, q, qd, rd.forward_dynamics(mech, q, qd, force))
    tau = found.Y @ found.values + found.known
    assert np.abs(tau - force).max() < 1e-13 * np.abs(found.Y * found.values).max()


@pytest.mark.parametrize("driven", ["left crank", "right rod"])
def test_free_freedoms_of_closed_mechanisms_have_rows(driven: str, robodyn: Run, tmp_path) -> None:
    """N^T Y pi = N^T tau of forward dynamics, whose actuators are fewer than the freedoms."""
    path = tmp_path / "free.yaml"
    text = Path("robots/five-bar.yaml").read_text()
    path.write_text(re.sub(r"actuated: .*", f"actuated: [{driven}]", text))
    mech, true = rd.load(path), rd.load("robots/five-bar.yaml")
    joints, n = balanced_joints(mech), mech.n
    assert len(joints) == 2
    assert set(mech.actuated) <= set(joints)
    q, qd, _ = random_states(true, 60)
    force = np.zeros((60, n))
    force[:, list(mech.actuated)] = np.random.default_rng(1).normal(size=(60, len(mech.actuated)))
    qdd = rd.forward_dynamics(mech, q, qd, force)
    found = rd.regressor(mech, q, qd, qdd)
    terms = found.Y * found.values
    tau = found.Y @ found.values + found.known
    size = np.abs(terms).max(axis=(1, 2))
    assert (np.abs(tau - force[:, joints]).max(axis=1) < 1e-12 * size).all()
    assert len(base_parameters(mech)) == len(base_parameters(true))
    columns = [f"{x}{k + 1}" for x in ("q", "qd", "qdd") for k in range(n)]
    columns += [f"tau{k + 1}" for k in mech.actuated]
    rows = np.column_stack([q, qd, qdd, force[:, list(mech.actuated)]])
    data = tmp_path / "data.csv"
    np.savetxt(data, rows, delimiter=",", header=",".join(columns), comments="")
    given = ("--set", "links.left rod.m=1", "--of", "links.left rod.m")
    done = robodyn("identify", path, data, *given).succeeds()
    assert json.loads(done.out)["parameters"][0]["value"] == pytest.approx(0.85, rel=1e-9)
    robodyn("regressor", path, data, "--condition").succeeds()


def test_what_has_no_regressor_is_refused(robodyn: Run) -> None:
    with pytest.raises(InputError, match="must broadcast"):
        rd.regressor(rd.load("robots/2r.yaml"), np.zeros((3, 2)), np.zeros((2, 2)), [0, 0])
    done = robodyn("regressor", "robots/2r.yaml", "--condition")
    assert (done.code, done.err.startswith("Error: --condition: ")) == (2, True)
