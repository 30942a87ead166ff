"""Maps before they are drawn: grids found among points, what each dot of a raster shows."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robodyn.errors import InputError
from robodyn.pictures.value_map import (
    COLOURS,
    LEVELS,
    MOST_WORDS,
    NONE,
    ColourScale,
    ValueMap,
    angle_ticks,
    colour_scale,
    colour_values,
    find_grid,
    log_ticks,
    painted,
    rgb,
    value_map,
    viridis,
    word_colours,
)
from robodyn.tables.csv_fields import unquoted

NAMES = ("q1", "q2", "flip")


def mesh(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return tuple(part.ravel() for part in np.meshgrid(x, y))  # type: ignore[return-value]


def small(x: list[float], y: list[float], values: list[float]) -> ValueMap:
    return value_map(NAMES, np.array(x, float), np.array(y, float), np.array(values, float))


# Grids


@pytest.mark.parametrize("seed", range(6))
def test_a_grid_is_found_in_any_order_of_rows(seed: int) -> None:
    """Each point is in its cell, and in no other, however few are left out."""
    rng = np.random.default_rng(seed)
    x_lines = np.sort(rng.uniform(-9, 9, rng.integers(2, 30)))
    y_lines = np.linspace(*sorted(rng.uniform(-9, 9, 2)), rng.integers(4, 30))
    x, y = mesh(x_lines, y_lines)
    x, y = x + rng.uniform(-1, 1, len(x)) * 1e-13, y + rng.uniform(-1, 1, len(y)) * 1e-13
    kept = rng.permutation(len(x))[: int(0.8 * len(x)) + 1]
    grid = find_grid(x[kept], y[kept])
    assert grid is not None
    assert grid.hidden == 0
    assert sorted(grid.row[grid.row >= 0].tolist()) == list(range(len(kept)))
    for row, column in np.argwhere(grid.row >= 0):
        k = kept[grid.row[row, column]]
        assert grid.x_edges[column] < x[k] < grid.x_edges[column + 1]
        assert grid.y_edges[row] < y[k] < grid.y_edges[row + 1]
    assert (np.diff(grid.x_edges) > 0).all()
    assert (np.diff(grid.y_edges) > 0).all()


def test_cells_of_an_even_grid_are_as_wide_as_its_steps() -> None:
    grid = find_grid(*mesh(np.linspace(-2, 2, 5), np.array([0.0, 10, 20])))
    assert grid is not None
    assert grid.x_edges == pytest.approx([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
    assert grid.y_edges == pytest.approx([-5, 5, 15, 25])
    assert grid.row.tolist() == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9], [10, 11, 12, 13, 14]]


def test_lines_without_any_point_are_part_of_an_even_grid() -> None:
    grid = find_grid(*mesh(np.array([0.0, 1, 2, 4, 5]), np.arange(3.0)))
    assert grid is not None
    assert grid.x_edges == pytest.approx(np.arange(7) - 0.5)
    assert (grid.row[:, 3] == -1).all()
    assert (np.delete(grid.row, 3, axis=1) >= 0).all()


def test_an_uneven_grid_keeps_its_lines() -> None:
    lines = np.array([0.1, 1, 10, 100])
    grid = find_grid(*mesh(lines, np.arange(3.0)))
    assert grid is not None
    assert grid.x_edges == pytest.approx([-0.35, 0.55, 5.5, 55, 145])


@pytest.mark.parametrize("count", [1, 2, 3, 50, 2000])
def test_points_at_random_are_no_grid(count: int) -> None:
    x, y = np.random.default_rng(count).uniform(size=(2, count))
    assert find_grid(x, y) is None


def test_a_line_of_points_is_no_grid() -> None:
    t = np.arange(9.0)
    for x, y in ((t, t), (t, 0 * t), (0 * t, t), (0 * t, 0 * t), (t, -t)):
        assert find_grid(x, y) is None


def test_more_than_half_of_the_cells_make_a_grid() -> None:
    x, y = mesh(np.arange(10.0), np.arange(10.0))
    x, y = np.append(x[x <= y], [9.0]), np.append(y[x <= y], [0.0])
    assert find_grid(x, y) is not None
    below = find_grid(x[x < y], y[x < y])
    assert below is not None  # 45 points of 9 times 9 lines
    assert below.row.shape == (9, 9)
    assert find_grid(x[::2], y[::2]) is None


def test_of_rows_at_one_point_the_last_is_shown() -> None:
    x, y = mesh(np.arange(3.0), np.arange(2.0))
    grid = find_grid(np.tile(x, 3), np.tile(y, 3))
    assert grid is not None
    assert grid.row.tolist() == [[12, 13, 14], [15, 16, 17]]
    assert grid.hidden == 12


# Rasters


def test_each_dot_shows_the_cell_that_holds_its_centre() -> None:
    x, y = mesh(np.array([0.0, 1, 3]), np.array([0.0, 1]))
    content = value_map(NAMES, x, y, np.arange(6.0))
    assert content.box == (-0.5, 4, -0.5, 1.5)
    assert content.rows_at(9, 4).tolist() == [
        *[[0, 0, 1, 1, 1, 2, 2, 2, 2]] * 2,
        *[[3, 3, 4, 4, 4, 5, 5, 5, 5]] * 2,
    ]
    assert content.rows_at(1, 1).tolist() == [[1]]


def test_each_dot_shows_a_point_that_it_holds() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-3, 5, (2, 400))
    values = np.where(rng.uniform(size=400) < 0.5, math.nan, x)
    content = value_map(NAMES, x, y, values)
    found = content.rows_at(20, 10)
    left, right, bottom, top = content.box
    column = np.minimum(19, (x - left) / (right - left) * 20 // 1)
    row = np.minimum(9, (y - bottom) / (top - bottom) * 10 // 1)
    for (r, c), k in np.ndenumerate(found):
        held = np.flatnonzero((row == r) & (column == c))
        assert (k in held) if len(held) else k == -1
        if len(held) and np.isfinite(values[held]).any():
            assert math.isfinite(values[k])


# Facts


def test_to_scale() -> None:
    x, y = mesh(np.linspace(0, 3, 4), np.linspace(0, 1, 3))
    values = np.zeros(12)
    assert value_map(("q1", "q2", "flip"), x, y, values).to_scale
    assert value_map(("tip_x1", "tip_y2", "flip"), x, y, values).to_scale
    assert not value_map(("q1", "qd1", "flip"), x, y, values).to_scale
    assert not value_map(("a", "b", "flip"), x, y, values).to_scale
    assert not value_map(("q1", "q2", "flip"), 9 * x, y, values).to_scale


def test_none_and_no_rows() -> None:
    assert not small([1, 2], [1, 2], [1, 2]).has_none
    content = small([1, 2], [1, 2], [math.nan, math.nan])
    assert content.has_none
    assert content.scale is None
    with pytest.raises(InputError, match=r"no rows: .* nothing to draw"):
        small([], [], [])


def test_numbers_at_the_ends_of_the_range() -> None:
    for place in range(3):
        columns = [[0.0, 1], [0.0, 1], [0.0, 1]]
        columns[place] = [0.0, -1e300]
        with pytest.raises(InputError, match=rf"{NAMES[place]} = -1e\+300: beyond 1e\+290"):
            small(*columns)
    content = small([0, 5e-324], [0, 1e290], [-1e290, 1e290])
    assert content.rows_at(3, 3).max() == 1
    assert content.scale is not None
    assert content.scale.fraction(content.values).tolist() == [0, 1]


# Scales of colours: order, ticks, the palette against matplotlib's, colours of words.


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


# The column that colours a map: numbers, words, empty fields, faults and their lines.


class Column(NamedTuple):
    values: np.ndarray
    words: tuple[str, ...]


def read(fields: list[str], *, positive: bool = False) -> Column:
    """The column `c` with these fields, in lines 2, 3, ..."""
    texts = [unquoted(field).strip() for field in fields]
    places = [f"x.csv: line {k}" for k in range(2, len(texts) + 2)]
    return Column(*colour_values("c", list(zip(texts, places, strict=True)), positive))


def test_numbers_and_empty_fields() -> None:
    texts = ["", "1", " ", "-2.5e-3", '"7"', '""', " 0.1 ", "NaN"]
    column = read(texts)
    expected = [math.nan, 1, math.nan, -2.5e-3, 7, math.nan, 0.1, math.nan]
    assert np.array_equal(column.values, expected, equal_nan=True)
    assert column.words == ()


def test_words_are_places_in_their_order() -> None:
    texts = ["", "open", "crossed", '"a, b"', "open", "7", "", "crossed"]
    column = read(texts)
    assert column.words == ("7", "a, b", "crossed", "open")
    found = ["" if math.isnan(v) else column.words[int(v)] for v in column.values]
    assert found == [text.strip('"') for text in texts]


def test_only_empty_fields_and_none_at_all() -> None:
    assert np.isnan(read(["", ""]).values).all()
    assert read(["", ""]).words == ()
    assert len(read([]).values) == 0


@pytest.mark.parametrize("bad", ["x", "inf", "1_0", "1e999", "0x1", "1;2"])
def test_what_is_no_number_is_told_with_its_line(bad: str) -> None:
    with pytest.raises(InputError) as caught:
        read(["1", "", bad, "y"])
    assert str(caught.value) == f"x.csv: line 4: c = {bad}: must be a finite number or empty"


@pytest.mark.parametrize("first", ["inf", "-Infinity", "1_0"])
def test_a_column_that_begins_with_a_bad_number_holds_no_words(first: str) -> None:
    with pytest.raises(InputError, match="line 2: c = "):
        read([first, "open"])


@pytest.mark.parametrize("bad", ["0", "-1e-300", "-5"])
def test_a_logarithm_needs_positive_numbers(bad: str) -> None:
    with pytest.raises(InputError) as caught:
        read(["", "1e-300", bad], positive=True)
    assert str(caught.value) == f"x.csv: line 4: c = {bad}: must be > 0 for --log"
    assert len(read(["", "1e-300", bad]).values) == 3


@pytest.mark.parametrize("text", ["\u0661\u0662", "\uff11", "1_0"])
def test_digits_of_other_scripts_are_no_numbers(text: str) -> None:
    with pytest.raises(InputError, match="must be a finite number or empty"):
        read(["1", text])


def test_too_many_words() -> None:
    words = [f"w{k}" for k in range(MOST_WORDS)]
    assert len(read(words).words) == MOST_WORDS
    with pytest.raises(InputError, match="--colour = c: has more than 20 different words"):
        read([*words, "one more"])
