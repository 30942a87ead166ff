"""Reference tables: what lies between their rows, and where its derivatives jump."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicSpline

from robodyn import InputError, ReferenceTable

TIMES = np.array([-0.3, 0.0, 0.4, 0.5, 1.1, 1.7])
BETWEEN = np.linspace(-0.3, 1.7, 201)


def rows(motion, times=TIMES, given=3):
    """q, qd, qdd (or the first of them) of a list of polynomials at times."""
    return [np.stack([p.deriv(d)(times) for p in motion], axis=1) for d in range(given)]


@pytest.mark.parametrize(("given", "degree"), [(3, 5), (2, 3), (1, 3)])
def test_a_polynomial_that_the_rows_determine_is_kept(given: int, degree: int) -> None:
    rng = np.random.default_rng(given)
    motion = [Polynomial(rng.normal(size=degree + 1)) for _ in range(2)]
    found = ReferenceTable(TIMES, *rows(motion, given=given))
    known = rows(motion, BETWEEN)
    for values, expected in zip(found.at(BETWEEN), known, strict=False):
        assert values == pytest.approx(expected, abs=1e-12)
    assert found.kinks == []
    assert not found.jumps


def test_rows_are_kept_with_their_derivatives() -> None:
    rng = np.random.default_rng(7)
    q, qd, qdd = rng.normal(size=(3, len(TIMES), 3))
    found = ReferenceTable(TIMES, q, qd, qdd)
    side = 1e-5  # a step for differences of qd
    for t, *known in zip(TIMES[1:-1], q[1:-1], qd[1:-1], qdd[1:-1], strict=True):
        assert found.at(t)[0] == pytest.approx(known[0], abs=1e-14)
        assert found.at(t)[1] == pytest.approx(known[1], abs=1e-13)
        for way in (-side, side):
            slope = (found.at(t + way)[1] - found.at(t)[1]) / way
            assert slope == pytest.approx(known[2], abs=0.5)
    assert found.kinks == TIMES[1:-1].tolist()  # of the third derivative
    assert not found.jumps


def test_angles_alone_make_scipys_spline() -> None:
    q = np.random.default_rng(3).normal(size=(len(TIMES), 2))
    found, known = ReferenceTable(TIMES, q), CubicSpline(TIMES, q)
    assert found.at(BETWEEN)[0] == pytest.approx(known(BETWEEN), abs=1e-12)
    assert found.at(BETWEEN)[1] == pytest.approx(known(BETWEEN, 1), abs=1e-11)
    assert found.kinks == TIMES[2:-2].tolist()  # not-a-knot at the second and the last but one
    assert not found.jumps


def test_rates_without_accelerations_make_these_jump() -> None:
    q, qd = np.random.default_rng(4).normal(size=(2, len(TIMES), 2))
    found = ReferenceTable(TIMES, q, qd)
    assert found.kinks == TIMES[1:-1].tolist()
    assert found.jumps


def test_close_rows_of_a_smooth_motion_are_no_kinks() -> None:
    t = np.linspace(0.0, 2.0, 2001)[:, None]
    smooth = ReferenceTable(t[:, 0], np.sin(t), np.cos(t), -np.sin(t))
    assert smooth.kinks == []
    bent = np.where(t < 1.0, 0.0, (t - 1.0) ** 2)
    slope = np.where(t < 1.0, 0.0, 2.0 * (t - 1.0))
    one = ReferenceTable(t[:, 0], bent, slope)
    assert one.kinks == [1.0]
    assert one.jumps


def test_two_rows_are_enough() -> None:
    line = ReferenceTable([0.0, 2.0], [[1.0], [3.0]])
    assert line.at([0.5, 2.0])[0].tolist() == [[1.5], [3.0]]
    assert line.at(0.5)[1].tolist() == [1.0]
    still = ReferenceTable([0.0, 2.0], [[1.0], [1.0]], [[0.0], [0.0]])
    assert still.at(1.3)[0].tolist() == [1.0]


def test_some_of_the_joints() -> None:
    q, qd = np.random.default_rng(5).normal(size=(2, len(TIMES), 3))
    chosen = ReferenceTable(TIMES, q, qd).of([2, 0])
    assert chosen.at(0.7)[0] == pytest.approx(ReferenceTable(TIMES, q, qd).at(0.7)[0][[2, 0]])


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (([0.0], [[1.0]]), ("rows = 1", "two or more")),
        (([0.0, 1.0, 1.0], np.ones((3, 1))), ("t = 1", "increase", "before has 1")),
        (([0.0, np.nan], np.ones((2, 1))), ("t", "finite")),
        (([0.0, 1.0], [[1.0], [np.inf]]), ("q", "finite")),
        (([0.0, 1.0], np.ones((3, 1))), ("shape of q", "(3, 1)", "(2, joints)")),
        (([0.0, 1.0], np.ones((2, 2)), np.ones((2, 1))), ("shape of qd", "(2, 1)")),
        (([0.0, 1.0], np.ones((2, 1)), None, np.ones((2, 1))), ("qdd", "needs qd")),
    ],
)
def test_what_is_no_reference(arguments: tuple, parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        ReferenceTable(*arguments, where="ref.csv")
    for part in ("ref.csv", *parts):
        assert part in str(caught.value)
