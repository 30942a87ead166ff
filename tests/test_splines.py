"""Splines against their conditions, and the largest values of paths."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from named_case import case

from robodyn import load
from robodyn.trajectories import splines
from robodyn.trajectories.joint_paths import path_through
from robodyn.trajectories.loop_path import WholePath


def draw(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Knots whose steps differ by a factor of up to 100, and points of three joints."""
    rng = np.random.default_rng(seed)
    return np.cumsum(10 ** rng.uniform(-2, 0, count)), rng.normal(size=(count, 3))


def close(found: np.ndarray, known: np.ndarray, rtol: float) -> bool:
    return bool(np.abs(found - known).max() <= rtol * max(1.0, np.abs(known).max()))


def test_smoothness_and_ends() -> None:
    """It goes through the points, is C2 or C4 at the inner ones, and rests at its ends."""
    for kind in ["cubic", "quintic"]:
        for seed in range(4):
            with case(kind, seed):
                knots, points = draw(seed, 9)
                highest = 2 if kind == "cubic" else 4
                found = splines.spline(knots, points, kind)
                beside = np.stack([knots[1:-1] - 1e-12, knots[1:-1] + 1e-12])
                for order in range(highest + 1):
                    before, after = (found(x, order) for x in beside)
                    assert close(before, after, 1e-6)
                assert close(found(knots, 0), points, 1e-11)
                for order in range(1, 1 + highest // 2):
                    size = np.abs(found(np.linspace(knots[0], knots[-1], 999), order)).max()
                    assert np.abs(found(knots[[0, -1]], order)).max() <= 1e-10 * size


def test_between_two_points_they_are_the_profiles_of_rest_to_rest() -> None:
    knots, points, u = np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.linspace(0.0, 1.0, 9)
    for kind, known in (
        ("cubic", u**2 * (3 - 2 * u)),
        ("quintic", u**3 * (10 - 15 * u + 6 * u**2)),
    ):
        with case(kind):
            assert splines.spline(knots, points, kind)(u, 0)[:, 0] == pytest.approx(known)


def test_the_largest_values_of_the_derivatives_of_a_path() -> None:
    mechanism = load("robots/3r.yaml")
    for kind in ("cubic", "quintic", "trapezoidal", "cycloidal"):
        with case(kind):
            knots, points = draw(7, 10)
            path = path_through(points, knots, kind)
            found = WholePath(mechanism, path).peaks()
            u = np.concatenate([np.linspace(a, b, 5001)[:-1] for a, b in pairwise(path.breaks)])
            sampled = [np.abs(x).max(axis=0) for x in path.evaluate(u)[1:]]
            assert (found >= np.array(sampled) * (1 - 1e-13)).all()
            assert found == pytest.approx(np.array(sampled), rel=1e-5)
