"""Profiles of rest-to-rest motions: their ends, integrals, symmetry and peaks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from named_case import case

from robodyn import load
from robodyn.errors import InputError
from robodyn.trajectories.joint_paths import path_through
from robodyn.trajectories.loop_path import WholePath
from robodyn.trajectories.profiles import Profile, profile

PARTS = (0.05, 0.25, 1 / 3, 0.5)
PROFILES = [
    *(profile(name) for name in ("cubic", "quintic", "cycloidal")),
    *(profile("trapezoidal", part) for part in PARTS),
]
every_profile = pytest.mark.parametrize(
    "shape", PROFILES, ids=lambda shape: f"{shape.name}-{len(shape.breaks)}"
)


def values(shape: Profile, piece: int, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """s, s', s'' at u of one piece."""
    late, s, rate, acceleration = shape.evaluate(u, 1 - u, np.full(len(u), piece))
    return np.where(late, 1 - s, s), rate, acceleration


def pieces(shape: Profile, count: int) -> list[tuple[int, np.ndarray]]:
    ends = zip(shape.breaks[:-1], shape.breaks[1:], strict=True)
    return [(k, np.linspace(a, b, count)) for k, (a, b) in enumerate(ends)]


@every_profile
def test_it_goes_from_rest_at_0_to_rest_at_1_exactly(shape: Profile) -> None:
    last = len(shape.breaks) - 2
    s, rate, acceleration = values(shape, 0, np.zeros(1))
    assert (s[0], rate[0]) == (0.0, 0.0)
    s, rate, final = values(shape, last, np.ones(1))
    assert (s[0], rate[0]) == (1.0, 0.0)
    assert final[0] == -acceleration[0]
    if shape.name in ("quintic", "cycloidal"):
        assert acceleration[0] == final[0] == 0.0


@every_profile
def test_rate_and_acceleration_are_the_derivatives(shape: Profile) -> None:
    """By Gauss's quadrature from each piece's beginning."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for k, u in pieces(shape, 17):
        s, rate, _ = values(shape, k, u)
        for end in range(1, len(u)):
            half = 0.5 * (u[end] - u[0])
            _, rates, accelerations = values(shape, k, u[0] + half * (1 + nodes))
            assert s[end] - s[0] == pytest.approx(half * weights @ rates, abs=1e-15, rel=1e-14)
            gained = half * weights @ accelerations
            assert rate[end] - rate[0] == pytest.approx(gained, abs=1e-14, rel=1e-13)


@every_profile
def test_s_and_its_rate_are_continuous(shape: Profile) -> None:
    for k, at in enumerate(shape.breaks[1:-1]):
        u = np.array([at])
        before, after = values(shape, k, u), values(shape, k + 1, u)
        assert before[0] == pytest.approx(after[0], rel=1e-15)
        assert before[1] == pytest.approx(after[1], rel=1e-15)
        assert before[2] != after[2]  # the corner of a trapezoid


@every_profile
def test_it_is_symmetric_and_rises(shape: Profile) -> None:
    for k, u in pieces(shape, 101):
        s, rate, acceleration = values(shape, k, u)
        mirrored = values(shape, len(shape.breaks) - 2 - k, 1 - u)
        assert np.allclose(s, 1 - mirrored[0], rtol=0, atol=1e-15)
        assert np.allclose(rate, mirrored[1], rtol=0, atol=1e-14)
        assert np.allclose(acceleration, -mirrored[2], rtol=0, atol=1e-13 * 40)
        assert (np.diff(s) > 0).all()
        assert (rate >= 0).all()


def test_peaks_of_the_textbooks() -> None:
    mechanism = load("robots/pendulum.yaml")
    for name, part, rate, acceleration in (
        ("cubic", 1 / 3, 1.5, 6.0),
        ("quintic", 1 / 3, 1.875, 10 / math.sqrt(3)),
        ("cycloidal", 1 / 3, 2.0, 2 * math.pi),
        ("trapezoidal", 0.25, 4 / 3, 16 / 3),
        ("trapezoidal", 0.5, 2.0, 4.0),
        ("trapezoidal", 1 / 3, 1.5, 4.5),
        ("constant", 1 / 3, 1.0, 0.0),
    ):
        with case(name, part):
            path = path_through(np.array([[0.0], [1.0]]), None, name, part)
            peaks = WholePath(mechanism, path).peaks()
            assert peaks[:, 0] == pytest.approx([rate, acceleration], rel=1e-14)


@pytest.mark.parametrize("part", [0.0, -0.1, 0.51, math.nan, math.inf])
def test_a_part_that_is_none_is_refused(part: float) -> None:
    with pytest.raises(InputError, match=r"acceleration = .*> 0 and <= 0\.5"):
        profile("trapezoidal", part)


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="must be one of cubic, quintic"):
        profile("linear")
