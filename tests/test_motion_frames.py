"""Frames of a motion in time: where they lie, between rows, and what is traced."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT

import oracles
import robodyn
from robodyn.errors import InputError
from robodyn.pictures.motion_frames import FINER, frames

ARM = robodyn.load(ROOT / "robots/2r.yaml")
FOUR = robodyn.load(ROOT / "robots/four-bar.yaml")


def cubic(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q and qd that are polynomials of degree 3: Hermite's cubic must meet them exactly."""
    q = np.stack([1 - t + t**3, 0.5 * t**2 - 0.2 * t**3], axis=-1)
    return q, np.stack([-1 + 3 * t**2, t - 0.6 * t**2], axis=-1)


@pytest.mark.parametrize("speed", [1.0, 0.25, 3.0])
@pytest.mark.parametrize("rate", [25.0, 30.0, 7.5])
def test_frames_lie_in_real_time(rate: float, speed: float) -> None:
    t = np.array([0.5, 0.7, 1.6, 2.5])
    found = frames(ARM, t, *cubic(t), rate, speed)
    assert found.t[0] == 0.5
    assert np.allclose(np.diff(found.t), speed / rate)
    assert 0 <= 2.5 - found.t[-1] < speed / rate + 1e-9
    assert found.q.shape == (len(found.t), 2)


def test_between_rows_q_is_a_cubic_by_qd() -> None:
    t = np.array([0.0, 0.3, 1.1, 2.0])
    found = frames(ARM, t, *cubic(t), 40.0, 1.0)
    assert np.allclose(found.q, cubic(found.t)[0], atol=1e-13)
    fine = np.arange(len(found.fine)) / 40.0 / FINER
    assert np.allclose(found.fine, cubic(fine)[0], atol=1e-13)
    assert np.array_equal(found.fine[::FINER], found.q)


def test_without_qd_it_is_a_line() -> None:
    t, q = np.array([0.0, 1.0, 3.0]), np.array([[0.0, 0], [1, -2], [5, 0]])
    found = frames(ARM, t, q, None, 2.0, 1.0)
    assert np.allclose(found.q[:, 0], [0, 0.5, 1, 2, 3, 4, 5])
    assert np.allclose(found.q[:, 1], [0, -1, -2, -1.5, -1, -0.5, 0])


def test_a_motion_that_runs_backwards_is_shown_forwards() -> None:
    t = np.linspace(0, -2, 9)
    found = frames(ARM, t, *cubic(t), 10.0, 1.0)
    assert (found.t[0], found.t[-1]) == (-2.0, pytest.approx(0.0))
    assert np.allclose(found.q, cubic(found.t)[0], atol=1e-13)


def test_loops_are_closed_between_rows() -> None:
    theta = np.linspace(0, 6, 13)
    q = np.unwrap(robodyn.assemble(FOUR, theta[:, None]), axis=0)
    assert np.abs(np.diff(q, axis=0)).max() < np.pi
    found = frames(FOUR, theta, q, None, 20.0, 1.0)
    assert np.abs(robodyn.closure_gap(FOUR, found.fine)).max() < 1e-12
    for pose in found.q[::7]:
        expected = oracles.four_bar_position(FOUR_BAR, pose[0])
        assert np.allclose(np.exp(1j * pose), np.exp(1j * np.array(expected)), atol=1e-9)


@pytest.mark.parametrize(
    ("t", "parts"),
    [
        ([0.0], ("rows = 1", "two or more")),
        ([0.0, 1, 1], ("t = 1", "differ from 1")),
        ([0.0, 1, 0.5, 2], ("t = 0.5",)),
        ([2.0, 1, 1.5, 0], ("t = 1",)),
        ([0.0, 1e9], ("frames", "at most")),
    ],
)
def test_what_has_no_frames(t: list[float], parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        frames(ARM, np.array(t), np.zeros((len(t), 2)), None, 25.0, 1.0)
    for part in parts:
        assert part in str(caught.value)


# Traced points
