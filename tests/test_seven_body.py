"""The seven-body mechanism against the equations of the book that it comes from."""

import numpy as np
import pytest
from conftest import ROOT

import oracles
from robodyn import assemble, closure_gap, closure_jacobian, forward_dynamics, load, mass_matrix
from robodyn.dynamics.closed_form import closure_bias, coriolis_matrix, gravity_vector

MECH = load(ROOT / "tests/hard_cases/seven-body.yaml")
START = np.array(oracles.SEVEN_BODY_START)


def test_the_start_is_closed():
    assert np.abs(closure_gap(MECH, START)).max() < 1e-16
    assert assemble(MECH, START[:1]) == pytest.approx(START, abs=1e-12)


def test_the_accelerations_at_the_start():
    qdd = forward_dynamics(MECH, START, np.zeros(7), [0.033, *[0.0] * 6])
    assert qdd[:2] == pytest.approx(oracles.SEVEN_BODY_ACCELERATIONS, rel=1e-13)
    assert np.abs(qdd[2:]).max() < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_the_terms_of_the_book(seed):
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(-np.pi, np.pi, 7), rng.normal(size=7) * 100.0
    M, f, Psi, bend = oracles.seven_body_terms(q, qd, torque=0.0)
    assert mass_matrix(MECH, q) == pytest.approx(M, rel=1e-12, abs=1e-18)
    forces = -coriolis_matrix(MECH, q, qd) @ qd - gravity_vector(MECH, q)
    assert forces == pytest.approx(f, rel=1e-10, abs=1e-12)
    assert closure_jacobian(MECH, q) == pytest.approx(Psi, abs=1e-16)
    assert -closure_bias(MECH, q, qd) == pytest.approx(bend, rel=1e-12, abs=1e-10)
