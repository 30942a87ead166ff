"""Points of a sweep: grids against itertools, samples against one long draw."""

import itertools
import math

import numpy as np
import pytest

from robodyn.sweeps.variation import Axis, Variation, spaced, stepped

GRID = Variation((Axis("a", (1.0, 2.0, 3.0)), Axis("b", (5.0, 6.0)), Axis("c", (0.0, -1.0))))


def test_a_grid_is_the_product_the_last_fastest() -> None:
    points = [*itertools.product((1.0, 2.0, 3.0), (5.0, 6.0), (0.0, -1.0))]
    assert GRID.size == len(points)
    assert GRID.points(0, GRID.size).tolist() == [list(point) for point in points]
    for begin, end in itertools.combinations(range(GRID.size + 1), 2):
        assert (GRID.points(begin, end) == np.array(points)[begin:end]).all()


def test_a_sample_is_one_long_draw_wherever_it_is_cut() -> None:
    axes = Axis("a", low=-1.0, high=3.0), Axis("b", (7.0, 8.0, 9.0))
    sample = Variation(axes, 1000, seed=5)
    u = np.random.Generator(np.random.PCG64(5)).random((1000, 2))
    whole = sample.points(0, 1000)
    assert (whole[:, 0] == -1.0 + u[:, 0] * 4.0).all()
    assert (whole[:, 1] == 7.0 + np.floor(u[:, 1] * 3)).all()
    cuts = [0, 1, 7, 500, 1000]
    parts = [sample.points(a, b) for a, b in itertools.pairwise(cuts)]
    assert (np.concatenate(parts) == whole).all()


def test_a_sample_is_uniform() -> None:
    axes = Axis("a", low=2.0, high=4.0), Axis("b", (0.0, 1.0, 2.0, 3.0))
    points = Variation(axes, 20_000, seed=1).points(0, 20_000)
    within, _ = np.histogram(points[:, 0], bins=10, range=(2.0, 4.0))
    assert within.sum() == 20_000
    assert np.abs(within - 2000).max() < 5 * math.sqrt(2000)
    assert np.abs(np.bincount(points[:, 1].astype(int)) - 5000).max() < 5 * math.sqrt(5000)
    assert abs(np.corrcoef(points.T)[0, 1]) < 0.03


def test_another_seed_is_another_sample() -> None:
    axis = (Axis("a", low=0.0, high=1.0),)
    first, second = (Variation(axis, 10, seed).points(0, 10) for seed in (1, 2))
    assert (first != second).all()


def test_steps_meet_the_end_exactly() -> None:
    turn = stepped(0.0, math.radians(360), math.radians(1))
    assert len(turn) == 361
    assert turn[-1] == math.radians(360)
    assert stepped(0.0, 1.0, 0.3) == (0.0, 0.3, 0.6, 0.8999999999999999)
    assert stepped(2.0, 1.0, -0.5) == (2.0, 1.5, 1.0)
    assert stepped(1.0, 1.0, 0.5) == (1.0,)


@pytest.mark.parametrize("step", [0.0, -0.1])
def test_a_step_that_leads_nowhere_is_refused(step: float) -> None:
    with pytest.raises(ValueError, match="nowhere"):
        stepped(0.0, 1.0, step)


def test_spaced_values_have_both_ends() -> None:
    assert spaced(0.5, 1.5, 3) == (0.5, 1.0, 1.5)
    assert spaced(2.0, 5.0, 1) == (2.0,)


def test_ends() -> None:
    assert Axis("a", (3.0, 1.0, 2.0)).ends == (1.0, 3.0)
    assert Axis("a", low=-1.0, high=4.0).ends == (-1.0, 4.0)
