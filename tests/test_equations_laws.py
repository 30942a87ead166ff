"""Laws of springs, loads that vary, dry friction and stops in equations, against the numbers."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from c_library import compiled, needs_compiler
from read_equations import lines, module

from random_mechanisms import assert_close, mechanism
from robodyn.dynamics import dynamics
from robodyn.equations.code import c99
from robodyn.equations.latex import latex
from robodyn.equations.recorded import recorded
from robodyn.equations.text import as_json, text
from robodyn.equations.written import equations
from robodyn.errors import InputError

SCENE = """
name: laws
gravity: 9.81
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082, limits: {min: -30deg, max: 60deg, stiffness: 500},
     friction: {torque: 0.5, static: 0.8, stribeck: 1.5}}
  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031, limits: {max: 0, stiffness: 50, damping: 20},
     damping: 0.2}
  - {name: c, joint: prismatic, axis: [1, 0], m: 0.9, l: 0.6, r: 0.25, I: 0.031,
     friction: {force: 2, static: 2}, limits: {min: -0.5, stiffness: 70, damping: 3}}
  - {name: d, m: 0.9, l: 0.6, r: 0.25, I: 0.031, friction: {torque: 0, static: 1, stribeck: 0.7}}
springs:
  - {joint: c, law: "100*x + 3*x**2 - x**3/2 + 2*v", length: 0.1}
  - {joint: a, law: "sin(x)*(4 + x)**2.5 - -x", angle: -1}
  - {between: [c, [1, 1]], law: "100*x + 3*v**3", length: 0.1}
  - {between: [a, [1, -1]], law: "100*x + 20*tanh(x/0.1)", length: 0}
loads:
  - {link: a, torque: "sin(2*pi*t)*q1"}
  - {link: b, at: [0.1, 0], force: [3, "cos(t) - 2*qd1**2"]}
  - {link: b, at: [0.1, 0], force: ["exp(-t)", 1], frame: link}
  - {link: c, torque: 0.3}
"""
T = 0.37


def states(mech, count=6):
    for seed in range(count):
        yield np.random.default_rng(seed).uniform(-1.5, 1.5, (3, mech.n))


@pytest.mark.parametrize("numeric", [False, True])
def test_python_gives_the_torques(numeric: bool) -> None:
    mech = mechanism(SCENE)
    found = module(mech, numeric)
    for q, qd, qdd in states(mech):
        tau = dynamics.inverse_dynamics(mech, q, qd, qdd, t=T)
        written = found["inverse_dynamics"](q, qd, qdd, T)
        assert_close(written, tau, np.abs(tau).max(), 1e-12)
        assert len(found["Q"](q, qd, T)) == mech.n


@needs_compiler
def test_c_gives_the_torques(tmp_path) -> None:
    import ctypes

    mech = mechanism(SCENE)
    call = compiled(c99(recorded(mech)), tmp_path).inverse_dynamics
    call.restype = None
    for q, qd, qdd in states(mech):
        out = np.zeros(mech.n)
        q, qd, qdd, out = (np.ascontiguousarray(x) for x in (q, qd, qdd, out))
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (q, qd, qdd, out)]
        call(*pointers[:3], ctypes.c_double(T), pointers[3])
        tau = dynamics.inverse_dynamics(mech, q, qd, qdd, t=T)
        assert_close(out, tau, np.abs(tau).max(), 1e-12)


def evaluated(content, q, qd):
    """The blocks of equations as JSON, by Python."""
    scope = {name: getattr(math, name) for name in ("sin", "cos", "tanh", "exp", "sqrt")}
    scope |= {"max": max, "sign": np.sign, "step": lambda x: float(x > 0), "t": T}
    scope |= {name: entry["value"] for name, entry in content["symbols"].items()}
    for k, (x, v) in enumerate(zip(q, qd, strict=True)):
        scope |= {f"q{k + 1}": x, f"qd{k + 1}": v}
    for name, formula in content["definitions"].items():
        scope[name] = eval(formula, scope)
    blocks = ("M", "C", "D", "G", "Q")
    return {
        name: np.array([[eval(x, scope) for x in np.atleast_1d(row)] for row in content[name]])
        for name in blocks
    }


@pytest.mark.parametrize("numeric", [False, True])
def test_what_is_read_gives_the_torques(numeric: bool) -> None:
    mech = mechanism(SCENE)
    content = json.loads(as_json(equations(mech, numeric)))
    for q, qd, qdd in states(mech):
        found = evaluated(content, q, qd)
        left = found["M"] @ qdd + (found["C"] + found["D"]) @ qd
        left += found["G"][:, 0] - found["Q"][:, 0]
        tau = dynamics.inverse_dynamics(mech, q, qd, qdd, t=T)
        assert_close(left, tau, np.abs(tau).max(), 1e-12)


@pytest.mark.parametrize("load", ["at: [1, 0.2], force: [3, 1]", "torque: 2"])
def test_a_constant_load_alone_is_in_G(load: str) -> None:
    """Where nothing else has a potential; and there is no Q."""
    mech = mechanism(
        "links:\n  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}\n"
        f"loads:\n  - {{link: a, {load}}}\n"
    )
    content = json.loads(as_json(equations(mech)))
    assert "Q" not in content
    scope = {name: entry["value"] for name, entry in content["symbols"].items()}
    q, zero = [0.7], [0.0]
    G = eval(content["G"][0], {**scope, "sin": math.sin, "cos": math.cos, "q1": q[0]})
    assert pytest.approx(dynamics.inverse_dynamics(mech, q, zero, zero)[0], rel=1e-12) == G
    assert module(mech)["G"](q)[0] == pytest.approx(G, rel=1e-12)


def test_how_they_are_written() -> None:
    found = lines(text(equations(mechanism(SCENE))))
    for formula in (
        "H1 = 100 (q3 - phi1) + 3 (q3 - phi1)\u00b2 - (q3 - phi1)\u00b3/2 + 2 qd3",
        "H3 = 100 (S3 - S03) + 3 V3\u00b3",
        "K3 = H3/S3",
        "H4 = 100 S4 + 20 tanh(S4/0.1)",
        "T1 = sin(6.28319 t) q1",
        "F2y = cos(t) - 2 qd1\u00b2",
        "B1 = sign(qd1) (tf1 + (ts1 - tf1) exp(-(qd1/ws1)\u00b2))",
        "B3 = ff3 sign(qd3)",
        "B4 = ts4 sign(qd4) exp(-(qd4/ws4)\u00b2)",
        "Y1 = max(0, ke1 (qmin1 - q1)) - max(0, ke1 (q1 - qmax1))",
        "Y2 = -step(q2) max(0, ke2 q2 + de2 qd2)",
        "Y3 = step(qmin3 - q3) max(0, ke3 (qmin3 - q3) - de3 qd3)",
    ):
        assert formula in found
    assert "step(x) is 1 for x > 0" in text(equations(mechanism(SCENE)))
    assert r"\operatorname{sign}(\dot{q}_{3})" in latex(equations(mechanism(SCENE)))


def test_tables_are_refused(tmp_path) -> None:
    (tmp_path / "rope.csv").write_text("x,F\n-1,0\n0,0\n1,5\n")
    table = tmp_path / "rope.csv"
    scene = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
    mech = mechanism(f"{scene}springs: [{{joint: a, table: {table}, angle: 0}}]\n")
    for write in (equations, recorded):
        with pytest.raises(InputError, match=r"springs\[0\]\.table = .*no tables"):
            write(mech)
