"""Linkages that narrowly miss a change point: the table of `make hard`, in small, and more."""

import functools
import warnings

import mpmath as mp
import numpy as np
import pytest
from conftest import FRESH

import robodyn
from hard_cases import near_misses
from hard_cases.cases import n_four_bar
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.engines import machine
from robodyn.loops.change_points import nearest_singular
from robodyn.loops.closing import BITS, HALF_PI, _cos_sin, singular_size
from robodyn.runs.simulation import simulate
from robodyn.trajectories.reference import reference_motion

FAST = "taylor"


@functools.cache
def shorter(make, miss):
    """Half of the motion past a near miss, which lies in its middle."""
    case = make(miss)
    start = tuple((np.array(case.near) + case.start) / 2.0)
    return case._replace(make=functools.partial(shorter, make), start=start, time=case.time / 2.0)


def test_cosine_and_sine_in_integers():
    with mp.workprec(300):
        one = mp.mpf(2) ** BITS
        assert abs(HALF_PI / one - mp.pi / 2) < 2 / one
        for angle in (0.0, 1e-9, -0.7, 0.785398163397448, 3.0, -1000.1, 1e5):
            cosine, sine = _cos_sin(int(mp.mpf(angle) * one))
            assert abs(cosine / one - mp.cos(angle)) < 200_000 / one
            assert abs(sine / one - mp.sin(angle)) < 200_000 / one


def test_states():
    for case, worst in near_misses.states((1e-14,), ()):
        assert worst < 100.0, case


def test_commands(robodyn, tmp_path):
    def run(*arguments, stdin):
        done = robodyn(*arguments, stdin=stdin)
        return done.out, done.err

    for make, miss in zip(
        near_misses.MAKERS, (1e-14, 0.0, 1e-12, 1e-13, 1e-9, 1e-12), strict=False
    ):
        few = near_misses.COMMANDS[:3]
        for *name, found, bound in near_misses.by_commands(make(miss), tmp_path, run, few):
            assert found <= bound, (make, *name)


@pytest.mark.parametrize("make", [near_misses.generic, near_misses.slider_crank])
def test_states_at_a_change_point_missed_by_rounding(make):
    for case in near_misses.cases(make, ()):
        for beside in (0.01, 1e-3, 1e-5):
            assert near_misses.state_error(case, beside, batches=(1,)) < 100.0, beside


@pytest.mark.parametrize("make", near_misses.MAKERS[:-1], ids=lambda make: make.__name__)
def test_motions(make):
    turn = near_misses.MAKERS.index(make) % len(near_misses.SWEPT)
    case = make(1e-9) if FRESH else shorter(make, 1e-9)
    for way in (FAST, *(near_misses.SWEPT if FRESH else [near_misses.SWEPT[turn]])):
        found, bound = near_misses.motion_error(case, way, sure=False)
        assert found < bound, way


@pytest.mark.parametrize("way", [FAST, "DOP853", "Radau"])
@pytest.mark.parametrize("factor", [0.0, 2.0, None])
@pytest.mark.thinned
def test_motions_past_the_narrowest_misses(way, factor):
    """Squares of coefficients are beyond the floats there, and rates are coarse."""
    miss = 1e-14 if factor is None else factor * near_misses.EPS * 2.0
    case = near_misses.parallelogram(miss) if FRESH else shorter(near_misses.parallelogram, miss)
    found, bound = near_misses.motion_error(case, way, sure=False)
    assert found < bound


@pytest.mark.skipif(not machine.available(), reason="needs llvmlite")
@pytest.mark.parametrize("rate", [4.0, 7.0, 11.0])
def test_lanes_do_not_leap_at_loose_tolerances(rate):
    case = near_misses.slider_crank(1e-12)._replace(start=(0.6,), rates=(rate,), time=1.0)
    end = near_misses.run(case, method="taylor", rtol=1e-12, atol=1e-12)[0]
    assert np.abs(near_misses.swept(case, 1e-6) - end).max() < 0.01


@pytest.mark.parametrize(("factor", "crosses"), [(0.0, True), (3.0, True), (30.0, False)])
def test_what_is_a_change_point(factor, crosses):
    mechanism = near_misses.parallelogram(factor * near_misses.EPS * 2.0).mechanism
    found = nearest_singular(mechanism, robodyn.assemble(mechanism, [0.02]))
    assert found is not None
    assert found.crosses is crosses
    qd = robodyn.loop_velocities(mechanism, robodyn.assemble(mechanism, [0.5]), [-5.0])
    q = robodyn.assemble(mechanism, [0.5])
    motion = simulate(mechanism, q, qd, 0.2, method="taylor")
    assert bool(abs(motion.q[-1, 0] - motion.q[-1, 2]) < 1e-6) is crosses


@pytest.mark.parametrize("make", [near_misses.parallelogram, near_misses.slider_crank])
def test_what_is_too_short_by_rounding_alone_is_at_a_dead_centre(make):
    """Newton's method wanders off where nothing closes: the nearest pose is the straight one."""
    case = make(-1e-12)
    for beside in (1e-7, 3e-7, 1e-6):
        at = np.array(case.near) + beside * np.array(case.aside)
        q = robodyn.assemble(case.mechanism, at)
        assert np.abs(robodyn.closure_gap(case.mechanism, q)).max() < 2e-12, beside
        with pytest.raises(robodyn.SingularError, match="dead centre"):
            robodyn.loop_velocities(case.mechanism, q, case.rates)


def test_two_freedoms_are_never_interpolated():
    mechanism = near_misses.five_bar(0.0).mechanism
    found = nearest_singular(mechanism, np.array([0.01, -0.012, 0.008, np.pi - 0.01]))
    assert found is not None
    assert not found.crosses


def test_many_loops_in_a_row_are_no_singularity():
    """The least singular value of N loops falls as 1/N, and so does what it is measured by."""
    for loops in (1, 2, 3, 6, 12, 20):
        bars = n_four_bar(loops)
        q = np.concatenate([np.full(loops + 1, 1.1), np.full(loops, -1.1)])
        least = np.linalg.svd(robodyn.closure_jacobian(bars, q), compute_uv=False)[-1]
        assert 0.1 < least / singular_size(bars) < 0.3, loops


def test_it_is_said():
    mechanism = near_misses.parallelogram(1e-12).mechanism
    q = robodyn.assemble(mechanism, [0.01])
    with pytest.warns(RobodynWarning, match="misses a change point by 1e-12 m"):
        robodyn.forward_dynamics(mechanism, q, np.zeros(3), np.zeros(3))
    with pytest.warns(RobodynWarning, match="misses a change point by 1e-12 m"):
        reference_motion(mechanism, [[0.1], [-0.1]], 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wide = near_misses.parallelogram(1e-9).mechanism
        robodyn.forward_dynamics(wide, robodyn.assemble(wide, [0.01]), np.zeros(3), np.zeros(3))
        reference_motion(wide, [[0.1], [-0.1]], 1.0)


def test_sweeps_say_it(robodyn, tmp_path):
    path = tmp_path / "near.yaml"
    path.write_text(near_misses.parallelogram(1e-12).scene)
    axes = "--vary", "q1=0.1,1", "--qd=-5", "--time", 0.03
    for kind in (axes, ("--vary", "q1=0.01,1", "--kind", "torque")):
        said = robodyn("sweep", path, *kind).err
        assert said.count("Warning: misses a change point by 1e-12 m") == 1, said
    away = robodyn("sweep", path, "--vary", "q1=1,1.2", "--time", 0.01).err
    assert "misses" not in away
    varied = "links.b.l=0.7,0.699999999999", "q1=0.1"
    vary = [word for each in varied for word in ("--vary", each)]
    said = robodyn("sweep", path, *vary, "--qd=-5", "--time", 0.03).err
    assert said.count("misses a change point by 1e-12 m") == 1, said
