"""Scales of colours: order, ticks, the palette against matplotlib's, colours of words."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robodyn.pictures.colour_scale import (
    COLOURS,
    LEVELS,
    NONE,
    ColourScale,
    angle_ticks,
    colour_scale,
    log_ticks,
    painted,
    rgb,
    viridis,
    word_colours,
)

POSITIVE = st.floats(1e-300, 1e300)


def lightness(colours: np.ndarray) -> np.ndarray:
    """L* of CIELAB of colours (..., 3), 0 to 255, by its definition."""
    c = np.asarray(colours, float) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)


# Scales


@given(st.lists(st.floats(-1e300, 1e300), min_size=2, max_size=9))
def test_a_linear_scale_spans_its_values(given_values: list[float]) -> None:
    values = np.array(given_values)
    scale = colour_scale(values, False)
    assert scale is not None
    assert not scale.log
    far = scale.fraction(values)
    assert ((far >= 0) & (far <= 1)).all()
    order = np.argsort(values, kind="stable")
    assert (np.diff(far[order]) >= 0).all()
    if np.ptp(values) > 1e-9 * np.abs(values).max():
        assert (far.min(), far.max()) == (0, 1)


@given(st.lists(POSITIVE, min_size=1, max_size=9), st.floats(0.1, 10))
def test_a_logarithmic_scale_has_equal_ratios(given_values: list[float], ratio: float) -> None:
    scale = colour_scale(np.array([*given_values, math.nan]), True)
    assert scale is not None
    assert scale.low < scale.high
    assert scale.low <= min(given_values)
    assert scale.high >= max(given_values)
    middle = math.exp(0.5 * (math.log(scale.low) + math.log(scale.high)))
    low, half, high = scale.fraction(np.array([scale.low, middle, scale.high]))
    assert (low, high) == (0, 1)
    assert half == pytest.approx(0.5, abs=1e-4 if scale.high / scale.low < 1.001 else 1e-9)


def test_equal_values_and_none() -> None:
    for log in (False, True):
        scale = colour_scale(np.array([3.0, 3.0]), log)
        assert scale is not None
        assert scale.low < 3 < scale.high
        assert 0.3 < scale.fraction(np.array([3.0]))[0] < 0.7
        assert colour_scale(np.array([math.nan]), log) is None
        assert colour_scale(np.zeros(0), log) is None
    assert np.isnan(ColourScale(0, 1, False).fraction(np.array([math.nan]))).all()


# Ticks


@given(st.floats(1e-12, 1e12), st.floats(0.0, 30), st.integers(3, 9))
def test_logarithmic_ticks_are_round_few_and_inside(low: float, decades: float, most: int) -> None:
    high = low * 10.0**decades
    found = log_ticks(low, high, most)
    assert len(found) <= most
    assert all(low * (1 - 1e-8) <= value <= high * (1 + 1e-8) for value in found)
    assert all(
        f"{value:e}"[:8] in ("1.000000", "2.000000", "3.000000", "5.000000") for value in found
    )
    if decades > 1:
        assert len(found) >= 1
    ratios = [b / a for a, b in itertools.pairwise(found)]
    assert all(ratio > 1.6 for ratio in ratios)
    assert not ratios or max(ratios) / min(ratios) < 2


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [
        (0.6, 100, 9, [1, 2, 5, 10, 20, 50, 100]),
        (0.6, 100, 5, [1, 3, 10, 30, 100]),
        (0.6, 100, 4, [1, 10, 100]),
        (1e-6, 1e6, 5, [1e-6, 1e-3, 1, 1e3, 1e6]),
        (1.2, 1.9, 5, []),
    ],
)
def test_logarithmic_ticks(low: float, high: float, most: int, expected: list[float]) -> None:
    assert log_ticks(low, high, most) == expected


def test_a_short_logarithmic_scale_has_even_ticks() -> None:
    values, texts = ColourScale(1.2, 1.9, True).ticks(5)
    assert values == pytest.approx([1.2, 1.4, 1.6, 1.8])
    assert texts == ["1.2", "1.4", "1.6", "1.8"]
    assert ColourScale(0.6, 100, True).ticks(4)[1] == ["1", "10", "100"]


@given(st.floats(-100, 100), st.floats(0.1, 200), st.integers(3, 9))
def test_ticks_of_angles_say_where_they_are(low: float, width: float, most: int) -> None:
    values, texts = angle_ticks(low, low + width, most)
    assert 2 <= len(values) <= most
    assert len(set(texts)) == len(texts)
    for value, text in zip(values, texts, strict=True):
        if "π" in text:
            factor, _, parts = text.partition("π")
            number = int({"": "1", "-": "-1"}.get(factor, factor))
            assert value == pytest.approx(math.pi * Fraction(number, int(parts[1:] or 1)))
        else:
            assert value == pytest.approx(float(text))


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [
        (-math.pi, math.pi, 9, "-π -3π/4 -π/2 -π/4 0 π/4 π/2 3π/4 π"),
        (-math.pi, math.pi, 5, "-π -π/2 0 π/2 π"),
        (-math.pi, math.pi, 3, "-π 0 π"),
        (0, 4 * math.pi, 5, "0 π 2π 3π 4π"),
        (0, 1, 5, "0 0.5 1"),
    ],
)
def test_ticks_of_angles(low: float, high: float, most: int, expected: str) -> None:
    assert " ".join(angle_ticks(low, high, most)[1]) == expected


# Colours


def test_the_palette_is_viridis() -> None:
    matplotlib = pytest.importorskip("matplotlib", reason="the extra `plot`")
    fractions = np.linspace(0, 1, 256)
    theirs = matplotlib.colormaps["viridis"](fractions)[:, :3] * 255
    assert np.abs(viridis(fractions) - theirs).max() < 7


def test_the_palette_grows_lighter_evenly() -> None:
    steps = np.diff(lightness(viridis(np.linspace(0, 1, 9))))
    assert (steps > 0).all()
    assert steps.max() < 1.4 * steps.min()


def test_words_have_different_colours() -> None:
    for count in (1, 2, 7, 8, 20):
        colours = word_colours(count)
        assert len(set(colours)) == count
        assert rgb(NONE) not in colours
    assert word_colours(2) == [rgb(colour) for colour in COLOURS[:2]]
    assert rgb("#0a10ff") == (10, 16, 255)


def test_painted() -> None:
    values = np.array([[1.0, 10], [100, math.nan]])
    shades = painted(values, ColourScale(1, 100, True), ())
    ends = viridis(np.array([0, round(0.5 * (LEVELS - 1)) / (LEVELS - 1), 1]))
    assert shades.tolist() == [ends[:2].tolist(), [ends[2].tolist(), list(rgb(NONE))]]
    words = painted(np.array([1.0, math.nan, 0]), None, ("a", "b"))
    assert [tuple(c) for c in words.tolist()] == [rgb(COLOURS[1]), rgb(NONE), rgb(COLOURS[0])]
    assert (painted(np.full(3, math.nan), None, ()) == rgb(NONE)).all()
