"""The torques that hold a model at rest, and those that drive it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from named_case import case

import random_mechanisms
from robodyn import (
    InputError,
    RobodynError,
    SingularError,
    assemble,
    gravity_vector,
    inverse_dynamics,
    load,
    loop_accelerations,
    other_forces,
)
from robodyn.control import driven_torques
from robodyn.control.driven_torques import driving_torques, rest_torques
from robodyn.mechanics.mechanism import Mechanism

ROBOTS = Path(__file__).resolve().parent.parent / "robots"


def scenes() -> list[random_mechanisms.Scene]:
    trees = [random_mechanisms.seeded_tree(seed, n) for seed, n in enumerate((1, 2, 4, 6))]
    loops = [
        random_mechanisms.seeded_scene(seed, shape)
        for seed, shape in enumerate(random_mechanisms.LOOPS.values())
    ]
    forced = [random_mechanisms.forced(k, scene) for k, scene in enumerate(trees + loops)]
    return trees + loops + forced


def test_the_inverse_dynamics_of_what_the_actuated_joints_do() -> None:
    for scene in scenes():
        with case(scene):
            mech = scene.mechanism
            driven = list(mech.actuated)
            v = scene.qdd[driven]
            qdd = loop_accelerations(mech, scene.q, scene.qd, v)
            known = inverse_dynamics(mech, scene.q, scene.qd, qdd)[driven]
            found = driving_torques(mech)(*scene.q, *scene.qd, *v)
            assert found == pytest.approx(known, abs=1e-9 * max(1.0, np.abs(known).max()))
            still = inverse_dynamics(mech, scene.q, 0 * scene.q, 0 * scene.q)[driven]
            found = rest_torques(mech)(*scene.q)
            assert found == pytest.approx(still, abs=1e-9 * max(1.0, np.abs(still).max()))


def test_at_rest_an_open_chain_needs_its_gravity_vector() -> None:
    for seed in range(4):
        scene = random_mechanisms.forced(seed, random_mechanisms.seeded_tree(seed, 4))
        mech = scene.mechanism
        known = gravity_vector(mech, scene.q) - other_forces(mech, scene.q, 0 * scene.q)
        assert rest_torques(mech)(*scene.q) == pytest.approx(known, abs=1e-10)


def underactuated(text: str) -> Mechanism:
    return random_mechanisms.mechanism(text + "actuated: [upper arm]\n")


def test_fewer_actuators_than_freedoms() -> None:
    arm = underactuated((ROBOTS / "2r.yaml").read_text())
    q = [0.4, -0.9]
    assert rest_torques(arm)(*q) == pytest.approx(gravity_vector(arm, q)[:1], abs=1e-12)
    with pytest.raises(RobodynError, match=r"q2.*free"):
        driving_torques(arm)


def test_more_actuators_than_freedoms() -> None:
    text = (ROBOTS / "four-bar.yaml").read_text().replace("[crank]", "[crank, rocker]")
    mech = random_mechanisms.mechanism(text)
    with pytest.raises(InputError, match="2 actuators for a mobility of 1"):
        driving_torques(mech)
    q = assemble(load(ROBOTS / "four-bar.yaml"), [1.0])
    with pytest.warns(UserWarning, match="least norm"):
        found = rest_torques(mech)(*q)
    with pytest.warns(UserWarning, match="least norm"):
        known = inverse_dynamics(mech, q, 0 * q, 0 * q)
    assert found == pytest.approx(known[[0, 2]])


def test_many_links_go_without_code(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = random_mechanisms.seeded_tree(3, 4)
    q, qd, v = scene.q, scene.qd, scene.qdd
    known = driving_torques(scene.mechanism)(*q, *qd, *v), rest_torques(scene.mechanism)(*q)
    monkeypatch.setattr(driven_torques.formulas, "MAX_GENERATED", 3)
    assert driving_torques(scene.mechanism)(*q, *qd, *v) == pytest.approx(known[0], abs=1e-11)
    assert rest_torques(scene.mechanism)(*q) == pytest.approx(known[1], abs=1e-11)


def test_a_dead_centre() -> None:
    """The rocker cannot drive the four-bar where crank and coupler are in line."""
    text = (ROBOTS / "four-bar.yaml").read_text().replace("[crank]", "[rocker]")
    mech = random_mechanisms.mechanism(text)
    a, b, c, d = 0.35, 0.95, 0.8, 1.1  # crank and coupler in line: rocker at its limit
    crank = np.arccos(((a + b) ** 2 + d**2 - c**2) / (2 * (a + b) * d))
    tip = (a + b) * np.exp(1j * crank)
    q = np.array([crank, 0.0, np.angle(tip - d)])
    with pytest.raises(SingularError, match="dead centre"):
        driving_torques(mech)(*q, 0.0, 0.0, 0.0, 1.0)
