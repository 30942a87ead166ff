"""Statistics of a run: nearness to singular configurations, energies, accelerations on demand."""

import pickle
import tracemalloc

import numpy as np
import pytest
from conftest import ROOT

from random_mechanisms import LOOPS, seeded_scene, seeded_tree
from robodyn import load, simulate
from robodyn.dynamics import closed_form, dynamics
from robodyn.loops import assembly, closures
from robodyn.loops.assembly import loop_size
from robodyn.mechanics.actuation import Actuation
from robodyn.runs.march import run
from robodyn.runs.readers import ROWS_AT_ONCE, RunStatistics
from robodyn.runs.report import Outcome, Report
from robodyn.runs.settings import METHODS, EvenTimes, Settings


def least_singular(mech, q):
    """The statistics' values, and those of numpy's decomposition."""
    Psi = closures.closure_jacobian(mech, q, t=0.0)
    idle = Actuation((0.0,) * mech.n)
    statistics = RunStatistics(Report(), idle, mech.n, True)
    s = np.linalg.svd(Psi, compute_uv=False)[:, -1]
    return statistics.least_singular(mech, Psi), s / loop_size(mech)


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
    calls, right = [], dynamics.motion_dynamics
    monkeypatch.setattr(dynamics, "motion_dynamics", lambda *x: calls.append(1) or right(*x))
    motion = simulate(mech, [0.3, 0.1], [1.0, 0.0], 1.0, "sin(t), 0", method=method)
    assert calls == []
    assert motion.qdd.shape == motion.q.shape
    assert motion.qdd is motion.qdd
    assert calls == [1]
    right_qdd = right(mech, motion.q, motion.qd, motion.tau).qdd
    assert np.array_equal(motion.qdd, right_qdd)


def test_a_motion_without_rows_has_no_accelerations():
    mech = load(ROOT / "robots/2r.yaml")
    assert simulate(mech, [0.3, 0.1], [1.0, 0.0], 1.0, t_eval=[]).qdd.shape == (0, 2)


# Rows


EACH = pytest.mark.parametrize("method", METHODS)


def rows_of(name, q, t_end, times, settings, watch=None):
    """The blocks (t, y) in which rows leave a run, its outcome and its report."""
    mech = load(ROOT / f"robots/{name}.yaml")
    start = np.concatenate([q, np.zeros(mech.n)])
    blocks = []

    def sink(t, y, _):
        blocks.append((t, y))

    torques = Actuation((0.0,) * mech.n)
    outcome, recorder = run(mech, start, t_end, torques, settings, sink, times, watch)
    return blocks, outcome, recorder.settle()


@EACH
@pytest.mark.parametrize("t_end", [0.5, -0.5])
@pytest.mark.thinned
def test_many_rows_of_one_step_leave_in_blocks(method, t_end):
    settings = Settings(method, 1e-6, 1e-6)
    count = 6001
    blocks, outcome, report = rows_of("2r", [1.0, 0.3], t_end, even(t_end, count), settings)
    assert outcome is Outcome.FINISHED
    assert max(len(t) for t, _ in blocks) <= 2 * ROWS_AT_ONCE
    t, y = (np.concatenate(part) for part in zip(*blocks, strict=True))
    assert np.array_equal(t, np.linspace(0.0, t_end, count))
    few, _, other = rows_of("2r", [1.0, 0.3], t_end, t[::1000].copy(), settings)
    assert (other.steps, other.t_reached) == (report.steps, report.t_reached)
    known = np.concatenate([y for _, y in few])
    assert y[::1000] == pytest.approx(known, rel=1e-13, abs=1e-13)
    assert np.abs(np.diff(y, axis=0)).max() < 0.01  # no row is from elsewhere


@EACH
def test_many_rows_of_a_loop_close(method):
    mech = load(ROOT / "robots/four-bar.yaml")
    q = assembly.assemble(mech, [1.0], t=0.0)
    settings = Settings(method, 1e-6, 1e-6)
    blocks, outcome, _ = rows_of("four-bar", q, 0.1, even(0.1, 2001), settings)
    assert outcome is Outcome.FINISHED
    t, y = (np.concatenate(part) for part in zip(*blocks, strict=True))
    assert np.array_equal(t, np.linspace(0.0, 0.1, 2001))
    assert np.abs(closures.closure_gap(mech, y[:, :3], t=0.0)).max() < 1e-12
    assert np.abs(np.diff(y, axis=0)).max() < 0.01


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_memory_does_not_grow_with_the_rows(method):
    def peak(count):
        mech = load(ROOT / "robots/2r.yaml")
        settings = Settings(method, 1e-6, 1e-6)
        start = np.array([1.0, 0.3, 0.0, 0.0])
        tracemalloc.start()
        rows = []
        run(
            mech, start, 0.5, Actuation((0.0, 0.0)), settings,
            lambda t, y, _: rows.append(len(t)), even(0.5, count),
        )  # fmt: skip
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert sum(rows) == count
        return most

    peak(1001)
    assert peak(100_001) < peak(10_001) + 200_000


@EACH
def test_a_run_ends_between_the_rows_of_a_step(method):
    settings = Settings(method, 1e-6, 1e-6)
    blocks, outcome, report = rows_of(
        "pendulum", [-np.pi / 2], 10.0, even(10.0, 1_000_001), settings, lambda t: t > 0.1
    )
    assert outcome is Outcome.INTERRUPTED
    t = np.concatenate([t for t, _ in blocks])
    assert t == pytest.approx(np.arange(len(t)) * 1e-5, rel=1e-12)
    assert t[-1] == report.t_reached < 0.2 + 2 * ROWS_AT_ONCE * 1e-5


def even(t_end, count):
    return EvenTimes(t_end / (count - 1), count, t_end)


def test_even_times_are_a_sequence():
    times = EvenTimes(0.3, 4, 1.0)
    assert list(times) == [0.0, 0.3, 0.6, 1.0]
    assert len(times) == 4
    assert times[-1] == 1.0
    for part in (slice(0, 2), slice(1, 9), slice(3, 4), slice(4, 5), slice(2, 1)):
        assert times[part].tolist() == [0.0, 0.3, 0.6, 1.0][part]
    with pytest.raises(IndexError):
        times[4]


def test_a_motion_is_pickled_with_its_report():
    arm = load(ROOT / "robots/2r.yaml")
    motion = simulate(arm, [0.3, -0.2], [0.5, 0.1], 0.1)
    again = pickle.loads(pickle.dumps(motion))
    assert again.report == motion.report
    assert np.array_equal(again.q, motion.q)
    assert again.report.steps > 0
