"""Statistics of a run: nearness to singular configurations, energies, accelerations on demand."""

import numpy as np
import pytest
from conftest import ROOT

from random_mechanisms import LOOPS, seeded_scene, seeded_tree
from robodyn import closed_form, dynamics, load, simulate
from robodyn.assembly import loop_size
from robodyn.recording import Recorder, Report


def least_singular(mech, q):
    """The recorder's values, and those of numpy's decomposition."""
    Psi = closed_form.closure_jacobian(mech, q)
    recorder = Recorder(mech, Report(), lambda t, y: None, None, 10**6, None)
    s = np.linalg.svd(Psi, compute_uv=False)[:, -1]
    return recorder._least_singular(Psi), s / loop_size(mech)


@pytest.mark.parametrize("name", ["four-bar", "slider-crank", "five-bar", "loop in a tree"])
def test_the_least_singular_value(name):
    scene = seeded_scene(3, LOOPS[name])
    q = np.random.default_rng(1).uniform(-3, 3, (300, scene.n))
    found, known = least_singular(scene.mechanism, q)
    assert found == pytest.approx(known, rel=1e-9, abs=1e-12)
    at = int(np.argmin(known))
    assert int(np.argmin(found)) == at
    assert found[at] == known[at]
    assert found[-1] == known[-1]


@pytest.mark.parametrize("order", [1, -1])
def test_the_least_singular_value_beside_change_points(order):
    mech = load(ROOT / "robots/parallelogram.yaml")
    crank = np.array([0.3, 1e-3, 1e-6, 1e-9, 3e-11, 1e-11, 1e-10, 0.2])[::order]
    found, known = least_singular(mech, np.stack([crank, -crank, crank], axis=1))
    at = int(np.argmin(known))
    assert int(np.argmin(found)) == at
    assert found[at] == known[at] > 1e-13
    assert found == pytest.approx(known, abs=1e-8)


@pytest.mark.parametrize(
    "scene", [seeded_tree(2, 4), seeded_scene(5, LOOPS["six-bar with a piston"])]
)
def test_energies_are_the_kinetic_and_the_potential_one(scene):
    rng = np.random.default_rng(2)
    q, qd = rng.normal(size=(2, 5, 7, scene.n))
    KE, PE = closed_form.energies(scene.mechanism, q, qd)
    assert KE.shape == PE.shape == (5, 7)
    assert pytest.approx(closed_form.kinetic_energy(scene.mechanism, q, qd), rel=1e-13) == KE
    potential = closed_form.potential_energy(scene.mechanism, q)
    assert pytest.approx(potential, abs=1e-13 * np.abs(potential).max()) == PE


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_accelerations_are_computed_when_they_are_asked_for(monkeypatch, method):
    mech = load(ROOT / "robots/2r.yaml")
    calls, right = [], dynamics.forward_dynamics
    monkeypatch.setattr(dynamics, "forward_dynamics", lambda *x: calls.append(1) or right(*x))
    motion = simulate(mech, [0.3, 0.1], [1.0, 0.0], 1.0, "sin(t), 0", method=method)
    assert calls == []
    assert motion.qdd.shape == motion.q.shape
    assert motion.qdd is motion.qdd
    assert calls == [1]
    assert np.array_equal(motion.qdd, right(mech, motion.q, motion.qd, motion.tau))


def test_a_motion_without_rows_has_no_accelerations():
    mech = load(ROOT / "robots/2r.yaml")
    assert simulate(mech, [0.3, 0.1], [1.0, 0.0], 1.0, t_eval=[]).qdd.shape == (0, 2)
