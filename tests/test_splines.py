"""Splines against scipy's, against their conditions, and their largest values."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from named_case import case
from scipy.interpolate import CubicSpline, make_interp_spline

from robodyn.trajectories import splines


def draw(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Knots whose steps differ by a factor of up to 100, and points of three joints."""
    rng = np.random.default_rng(seed)
    return np.cumsum(10 ** rng.uniform(-2, 0, count)), rng.normal(size=(count, 3))


def at(coefficients: np.ndarray, knots: np.ndarray, t: np.ndarray, order: int) -> np.ndarray:
    piece = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
    return splines.evaluate(coefficients, piece, t - knots[piece], order)


def close(found: np.ndarray, known: np.ndarray, rtol: float) -> bool:
    return bool(np.abs(found - known).max() <= rtol * max(1.0, np.abs(known).max()))


def test_cubic_splines_are_those_of_scipy() -> None:
    for count in [2, 3, 4, 12, 40]:
        for natural in [False, True]:
            with case(count, natural):
                knots, points = draw(count, count)
                found = splines.spline(knots, points, 3, natural)
                known = CubicSpline(knots, points, bc_type="natural" if natural else "clamped")
                t = np.linspace(knots[0], knots[-1], 997)
                for order in range(3):
                    assert close(at(found, knots, t, order), known(t, order), 1e-11)


@pytest.mark.parametrize("count", [2, 3, 4, 12, 40])
def test_quintic_splines_are_those_of_scipy(count: int) -> None:
    knots, points = draw(count, count)
    rest = [(1, np.zeros(3)), (2, np.zeros(3))]
    known = make_interp_spline(knots, points, k=5, bc_type=(rest, rest))
    found = splines.spline(knots, points, 5)
    t = np.linspace(knots[0], knots[-1], 997)
    for order in range(5):
        assert close(at(found, knots, t, order), known(t, order), 1e-9)


def test_smoothness_and_ends() -> None:
    """It goes through the points, is C2 or C4 at the inner ones, and rests at its ends."""
    for kind in ["cubic", "quintic"]:
        for seed in range(4):
            with case(kind, seed):
                knots, points = draw(seed, 9)
                degree, highest = (3, 2) if kind == "cubic" else (5, 4)
                found = splines.spline(knots, points, degree)
                lengths, index = np.diff(knots), np.arange(8)
                for order in range(highest + 1):
                    begins = splines.evaluate(found, index, np.zeros(8), order)
                    ends = splines.evaluate(found, index, lengths, order)
                    assert close(begins[1:], ends[:-1], 1e-10)
                    if order == 0:
                        assert np.array_equal(begins, points[:-1])
                        assert close(ends, points[1:], 1e-11)
                    elif order <= highest // 2:
                        size = np.abs(begins).max()
                        assert np.abs(begins[0]).max() <= 1e-13 * size
                        assert np.abs(ends[-1]).max() <= 1e-10 * size


def test_between_two_points_they_are_the_profiles_of_rest_to_rest() -> None:
    knots, points = np.array([0.0, 1.0]), np.array([[0.0], [1.0]])
    assert splines.spline(knots, points, 3)[0, :, 0] == pytest.approx([0, 0, 3, -2])
    assert splines.spline(knots, points, 5)[0, :, 0] == pytest.approx([0, 0, 0, 10, -15, 6])


@pytest.mark.parametrize("kind", ["cubic", "quintic"])
@pytest.mark.parametrize("order", [1, 2])
def test_the_largest_value_of_a_derivative(kind: str, order: int) -> None:
    knots, points = draw(7, 10)
    coefficients = splines.spline(knots, points, 3 if kind == "cubic" else 5)
    found = splines.largest(coefficients, np.diff(knots), order)
    t = np.concatenate([np.linspace(a, b, 5001) for a, b in pairwise(knots)])
    sampled = np.abs(at(coefficients, knots, t, order)).max(axis=0)
    assert (found >= sampled * (1 - 1e-13)).all()
    assert found == pytest.approx(sampled, rel=1e-5)
