"""Extremes and crossings of polynomials, against numpy's roots."""

import math

import numpy as np
import pytest

from robodyn.sweeps.step_extremes import crossings, extremes


def series(seed: int, B: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Rates (9, 3, B) whose terms fall off over a step, and the steps."""
    rng = np.random.default_rng(seed)
    rates = (
        rng.normal(size=(9, 3, B)) / np.array([math.factorial(k) for k in range(9)])[:, None, None]
    )
    return rates, rng.uniform(0.2, 1.0, B) * rng.choice([-1, 1], B)


def exact(coefficients: np.ndarray, h: float) -> tuple[float, float]:
    """The least and largest value over a step, by the roots of the derivative."""
    p = np.polynomial.Polynomial(coefficients)
    roots = p.deriv().roots()
    inner = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real / h >= 0) & (roots.real / h <= 1)]
    found = p(np.concatenate([[0.0, h], inner]))
    return float(found.min()), float(found.max())


@pytest.mark.parametrize("seed", range(3))
def test_extremes(seed: int) -> None:
    rates, h = series(seed)
    found = extremes(rates, h)
    for i in range(3):
        for b in range(len(h)):
            rate = rates[:, i, b]
            turn = np.polynomial.Polynomial(rate).integ().coef
            expected = [*exact(turn, h[b]), *exact(rate, h[b])]
            assert [x[i, b] for x in found] == pytest.approx(expected, abs=1e-13)


def test_crossings() -> None:
    rates, h = series(11, 2000)
    angle = np.random.default_rng(1).uniform(-1, 1, 2000)
    found = crossings(angle, rates[:, 0], h, 1.0)
    crossed = 0
    for b in range(2000):
        p = np.polynomial.Polynomial(rates[:, 0, b]).integ() + angle[b]
        roots = np.concatenate([(p - 1.0).roots(), (p + 1.0).roots()])
        within = (np.abs(roots.imag) < 1e-9) & (roots.real / h[b] > 0) & (roots.real / h[b] <= 1)
        first = min(roots.real[within], key=abs, default=math.nan)
        assert found[b] == pytest.approx(first, abs=1e-12, nan_ok=True)
        crossed += not math.isnan(found[b])
    assert 300 < crossed < 1700


def test_crossing_that_turns_back_at_once() -> None:
    """1 + x - 5 x^2 less 1 is beyond 1 from 0 to 0.2 alone, within the first quarter."""
    rates = np.array([[1.0], [-10.0]])
    x = crossings(np.array([0.96]), rates, np.array([1.0]), 1.0)
    assert x == pytest.approx([(1 - math.sqrt(0.2)) / 10], abs=1e-14)


def test_what_is_beyond_at_once_crosses_at_once() -> None:
    assert crossings(np.array([1.5]), np.array([[1.0], [0.0]]), np.ones(1), 1.0) == [0.0]
