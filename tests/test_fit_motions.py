"""Runs of a fit: scenes whose loads and torques vary, free joints, dependent closures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from named_case import case

import robodyn
from robodyn import load
from robodyn.errors import InputError
from robodyn.parameters import motion_fit

ROOT = Path(__file__).parents[1]
LOADED = """loads:
  - {link: coupler, at: [0.3, 0.1], force: ["2*cos(2*t)", "-3*q1"]}
  - {link: rocker, torque: "0.2*sin(3*t) - 0.1*qd3"}
springs: [{between: [rocker, coupler], stiffness: 1}]
"""
HANGING = """links:
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
  - {name: bob, m: 0.3, l: 0.3, r: 0.2, I: 0.01, from: coupler}
closures: [[coupler, rocker]]
actuated: [crank]
"""


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch):
    """The problem of a fit, which is not solved."""
    monkeypatch.setattr(motion_fit, "solved", lambda wanted, problem, *rest: problem)
    return robodyn.fit_motion


def test_runs_of_all_kinds(problem, tmp_path: Path) -> None:
    """Motions are those of `simulate`, derivatives differences of its motions."""
    four_bar = (ROOT / "robots/four-bar.yaml").read_text()
    texts = {"loaded": four_bar + LOADED.rsplit("springs", 1)[0], "hanging": HANGING}
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    third = ROOT / "tests/hard_cases/third-crank.yaml"
    cart = ROOT / "robots/cart-pole.yaml"
    closed = robodyn.assemble(load(ROOT / "robots/four-bar.yaml"), [1.0])
    t = np.linspace(0.0, 0.5, 6)
    for path, q, qd, tau, vary in (
        (tmp_path / "loaded.yaml", [1.0], [2.0], "2*sin(3*t) - 0.5*qd1", ["links.rocker.l", "q1"]),
        (cart, [0.1, 1.2], [0.2, 0.3], "3*sin(2*t) - q1*qd2", ["links.pole.r", "q2", "qd2"]),
        (tmp_path / "hanging.yaml", [*closed, 0.4], None, [0.5], ["links.bob.r", "q1", "q4"]),
        (third, [-1.0, 1.0, -1.0, -1.0], [0.5], None, ["links[1].m", "qd1"]),
    ):
        with case(path.name):
            mech = load(path)
            columns = [f"{x}{k + 1}" for x in ("q", "qd") for k in range(mech.n)]
            bounds = dict.fromkeys(vary, (-3.0, 9.0)) | {
                x: (0.1, 3.0) for x in vary if x.startswith("links")
            }
            states = problem(mech, bounds, columns, t, q, qd, tau).states
            found, slopes, *_ = states(np.zeros((1, len(vary))))
            start = np.array(q) if len(q) == mech.n else robodyn.assemble(mech, q)
            rates = np.zeros(mech.n) if qd is None else np.array(qd)
            if len(rates) < mech.n:
                rates = robodyn.loop_velocities(mech, start, rates)
            run = robodyn.simulate(mech, start, rates, 0.5, tau, rtol=1e-11, atol=1e-11, t_eval=t)
            assert np.abs(found[0] - np.hstack([run.q, run.qd])).max() < 2e-8
            h = 1e-3 * np.eye(len(vary))
            ends = [
                np.stack([states._columns(x) for x in (*(k * h), *(-k * h))]) for k in (1, 2)
            ]
            k = len(vary)
            one, two = ((x[:k] - x[k:]) / (2e-3 * i) for i, x in zip((1, 2), ends, strict=True))
            differences = np.moveaxis((4.0 * one - two) / 3.0, 0, -1)
            assert np.abs(slopes).max(axis=(0, 1, 2)).min() > 0.01
            assert np.abs(slopes[0] - differences).max() < 1e-6 * np.abs(slopes).max()


def test_conditions_on_motions() -> None:
    """Of numbers, and of columns at every row: the pendulum may swing no farther than 0.3 rad."""
    rod, t = load(ROOT / "robots/pendulum.yaml"), np.linspace(0.0, 1.0, 11)
    target = robodyn.simulate(rod, [0.0], [0.0], 1.0, t_eval=t).q
    vary = {"qd1": (-2.0, 2.0)}
    given = rod, vary, ["q1"], t, [-np.pi / 2]
    found = robodyn.fit_motion(
        *given, target=target, subject_to=["q1 <= 0.3 - pi/2", "rod_vx**2 <= 10"], starts=1
    )
    best = robodyn.simulate(
        rod, [-np.pi / 2], [found.numbers["qd1"]], 1.0, t_eval=t, rtol=1e-11, atol=1e-11
    )
    assert best.q.max() + np.pi / 2 == pytest.approx(0.3, abs=1e-9)
    assert found.conditions["q1 <= 0.3 - pi/2"] == pytest.approx(0.0, abs=1e-9)
    assert found.conditions["rod_vx**2 <= 10"] > 1.0
    masses = {"links.rod.m": (0.1, 3.0), "links.rod.r": (0.05, 0.3)}
    more = {"subject_to": ["links.rod.m*links.rod.r == 0.05"], "starts": 1}
    found = robodyn.fit_motion(rod, masses, ["q1"], [0.0, 0.1, 0.2], [0.0], **more)
    assert np.prod(list(found.numbers.values())) == pytest.approx(0.05, rel=1e-11)
    for text in ("tau1 <= 1", "qdd1 <= 2"):
        with pytest.raises(InputError, match=f"--subject-to = {text}: .*no column of a motion"):
            robodyn.fit_motion(*given, subject_to=[text])
