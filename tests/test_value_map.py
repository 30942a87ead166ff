"""Maps before they are drawn: grids found among points, what each dot of a raster shows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn.errors import InputError
from robodyn.pictures.value_map import ValueMap, find_grid, value_map

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
