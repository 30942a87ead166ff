"""Sensitivities of motions, against differences of two runs and against closed forms."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome, relative_error

import robodyn as rd
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import build
from robodyn.scene.scene_values import numbers_of

Scene = Callable[[str], Path]
TIGHT = {"rtol": 1e-12, "atol": 1e-12, "t_eval": [0.0, 0.3, 0.7]}
END = 0.7


def differences(
    path: Path, name: str, driven: Sequence[float], rates: Sequence[float], tau: object
) -> np.ndarray:
    """d(q, qd)/d(name) (T, 2n) of the motion that actuated joints at `driven`, `rates` begin."""
    values = numbers_of(path.read_text(), str(path))

    def motion(change: float) -> np.ndarray:
        mech, start = rd.load(path), [np.array(driven, float), np.array(rates, float)]
        match = re.fullmatch(r"(qd?)(\d)", name)
        if match:
            start[match[1] == "qd"][int(match[2]) - 1] += change
        else:
            mech = build(values.replaced({name: values.number(name) + change}))
        q = rd.assemble(mech, start[0])
        run = rd.simulate(mech, q, rd.loop_velocities(mech, q, start[1]), END, tau, **TIGHT)
        return np.hstack([run.q, run.qd])

    h = 1e-3  # of order 4
    near, far = (motion(x) - motion(-x) for x in (0.5 * h, h))
    return (8.0 * near - far) / (6.0 * h)


def check(path: Path, names: Sequence[str], driven, rates, tau=None) -> None:
    mech = rd.load(path)
    q = rd.assemble(mech, driven)
    run = rd.simulate(
        mech, q, rd.loop_velocities(mech, q, rates), END, tau, sensitivity=names, **TIGHT
    )
    assert run.sensitivity is not None
    assert run.sensitivity.shape == (3, 2 * mech.n, len(names))
    for k, name in enumerate(names):
        expected = differences(path, name, driven, rates, tau)
        assert relative_error(run.sensitivity[..., k], expected) < 1e-6, name


@pytest.mark.parametrize("tau", [None, "2*sin(3*t)", "0.2*cos(q1)*t - 0.01*qd1**3", [0.3]])
def test_a_pendulum_under_torques(tau: object) -> None:
    check(ROOT / "robots/pendulum.yaml", ["links.rod.m", "links.rod.r", "q1"], [0.4], [0.7], tau)


def test_a_2r() -> None:
    names = ["links.forearm.m", "links.upper arm.l", "gravity", "q1", "qd2"]
    check(ROOT / "robots/2r.yaml", names, [0.5, 0.8], [0.3, -0.4])


def test_a_four_bar() -> None:
    names = ["q1", "qd1", "links.coupler.m", "links.rocker.l", "links.rocker.from[0]", "gravity"]
    check(ROOT / "robots/four-bar.yaml", names, [1.0], [2.0], "sin(2*t) - 0.3*qd1")


def test_a_slider_crank_and_gears() -> None:
    check(ROOT / "robots/slider-crank.yaml", ["q1", "links[1].l"], [0.8], [1.5])
    check(ROOT / "robots/geared-five-bar.yaml", ["q1", "links[1].l"], [0.8], [0.5])


def test_a_mass_on_a_spring(scene: Scene) -> None:
    """x = a cos(w t), w^2 = k/m."""
    k, m, a = 50.0, 2.0, 0.1
    path = scene(
        f"gravity: 0\nlinks:\n  - {{name: cart, joint: prismatic, axis: [1, 0], m: {m}, l: 0.1,"
        f" r: 0, I: 1}}\nsprings:\n  - {{joint: cart, stiffness: {k}, length: 0}}\n"
    )
    t = np.linspace(0.0, 5.0, 26)
    names = ["springs[0].stiffness", "links.cart.m", "q1"]
    run = rd.simulate(rd.load(path), [a], [0.0], 5.0, t_eval=t, sensitivity=names)
    w = np.sqrt(k / m)
    by_w = np.stack([-a * t * np.sin(w * t), -a * np.sin(w * t) - a * w * t * np.cos(w * t)], 1)
    by_a = np.stack([np.cos(w * t), -w * np.sin(w * t)], 1)
    expected = np.stack([by_w * 0.5 / np.sqrt(k * m), by_w * -0.5 * w / m, by_a], -1)
    found = run.sensitivity
    assert found is not None
    size = np.abs(expected).max(axis=(0, 1))
    assert (np.abs(found - expected).max(axis=(0, 1)) < 1e-7 * size).all()


def test_the_columns_and_a_run_that_stays_as_it_is(robodyn: Callable[..., Outcome]) -> None:
    run = ("simulate", "robots/2r.yaml", "--q", "0.5,0.8", "--time", "1", "--every", "0.5")
    plain = robodyn(*run)
    given = robodyn(*run, "--sensitivity", "links.forearm.m, q1")
    assert given.code == 0
    header = given.out.splitlines()[0].split(",")
    names = ["dq1", "dq2", "dqd1", "dqd2"]
    assert header[-8:] == [f"{x}/{by}" for by in ("links.forearm.m", "q1") for x in names]
    for name in header[:-8]:
        assert np.allclose(given.column(name), plain.column(name), atol=1e-7)
    assert given.column("dq1/q1")[0] == 1.0
    assert given.column("dq1/links.forearm.m")[0] == 0.0
    mech = rd.load(ROOT / "robots/2r.yaml")
    motion = rd.simulate(
        mech, [0.5, 0.8], [0, 0], 1.0, t_eval=[0, 0.5, 1], sensitivity=["links.forearm.m", "q1"]
    )
    assert motion.sensitivity is not None
    assert np.array_equal(motion.sensitivity[:, 2, 1], given.column("dqd1/q1"))


def test_what_has_no_sensitivities(robodyn: Callable[..., Outcome], scene: Scene) -> None:
    arm = ("simulate", "robots/2r.yaml", "--q", "0.5,0.8", "--time", "1", "--sensitivity")
    bar = ("simulate", "robots/four-bar.yaml", "--q", "1", "--time", "1", "--sensitivity")
    dry = scene(
        "links:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1, friction: {torque: 1, static: 1}}\n"
    )
    hold = ("--hold", "0,0", "--control", "pd", "--kp", "9", "--kd", "1")
    force = ("--force", "forearm=0,-20")
    for line, said in (
        ((*arm, "links.forarm.m"), "links.forarm.m: is no number of the scene"),
        ((*arm, "q3"), "q3: must be one of q1..q2"),
        ((*arm, "q1,q1"), "--sensitivity: needs names, each once"),
        ((*arm, ""), "is no number of the scene"),
        ((*arm, "q1", "--method", "taylor"), "--sensitivity: the Taylor series"),
        ((*arm, "q1", *hold), "--sensitivity: is not for controllers"),
        ((*arm, "q1", "--tau", "abs(q1) if q1 > 0 else 1, 0"), "tau1: has no derivative"),
        ((*arm, "links.forearm.m", *force), "--force"),
        ((*bar, "q2"), "q2: joint coupler follows"),
        (("simulate", dry, "--q", "0", "--sensitivity", "q1"), "is of smooth motions"),
    ):
        given = robodyn(*line)
        assert given.code == 2
        assert re.sub(r"\s+", " ", given.err).find(said) >= 0, given.err
    mech = rd.load(ROOT / "robots/2r.yaml")
    with pytest.raises(InputError, match="has no derivative"):
        rd.simulate(mech, [0, 0], [0, 0], 1.0, lambda t, q, qd: [q[0], 0.0], sensitivity=["q1"])
