"""The least value of quantities along a path, found between its samples too.

Samples follow the path (`grid`).  Around each that may lead to the least value nine points are
taken, then nine between the two next to the best of them, a quarter of the interval each time,
until nothing is left to be gained in floating point.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn.trajectories.joint_paths import Pieces
from robodyn.trajectories.loop_path import LoopPath, OpenPath

Array = NDArray[np.float64]
Columns = Callable[[Array, Pieces], Array]  # values (T, columns) at u (T,) of these pieces

ROUNDS = 13  # of the search between samples: each makes the interval four times shorter
MOST_PLACES = 64  # of one column, at which to search
BLOCK = 20_000  # samples evaluated at once


def least_along(columns: Columns, path: OpenPath | LoopPath) -> tuple[float, float, int, int]:
    """The least value of any column along a path, with its u, piece and column."""
    u, piece = path.grid()
    blocks = range(0, len(u), BLOCK)
    values = np.concatenate([columns(u[k : k + BLOCK], piece[k : k + BLOCK]) for k in blocks])
    before, after = np.full_like(values, np.inf), np.full_like(values, np.inf)
    joined = (piece[1:] == piece[:-1])[:, None]
    before[1:] = np.where(joined, values[:-1], np.inf)
    after[:-1] = np.where(joined, values[1:], np.inf)
    lowest = (values <= before) & (values <= after) & np.isfinite(values)
    lowest &= (values != before) | (values != after)  # of a level stretch its ends will do
    if not lowest.any():
        return math.inf, 0.0, 0, 0
    # a parabola through three samples lies below the lowest by less than the rise from it
    with np.errstate(invalid="ignore"):  # infinite where x is
        floor = values - (np.maximum(before, after) - values)
    lowest &= floor <= values[lowest].min()
    each = [np.flatnonzero(column) for column in lowest.T]
    each = [at[np.argsort(values[at, j], kind="stable")[:MOST_PLACES]] for j, at in enumerate(each)]
    rows = np.concatenate(each)
    places = np.repeat(np.arange(len(each)), [len(at) for at in each])
    first = np.where((rows > 0) & (piece[np.maximum(rows - 1, 0)] == piece[rows]), rows - 1, rows)
    following = np.minimum(rows + 1, len(u) - 1)
    last = np.where(piece[following] == piece[rows], following, rows)
    low, high = u[first], u[last]
    best, at = values[rows, places], u[rows]
    part = np.linspace(0.0, 1.0, 9)
    index = np.arange(len(rows))
    for _ in range(ROUNDS):
        trial = low[:, None] + (high - low)[:, None] * part
        tried = columns(trial.reshape(-1), np.repeat(piece[rows], 9)).reshape(*trial.shape, -1)
        found = tried[index[:, None], np.arange(9), places[:, None]]
        k = np.argmin(found, axis=1)
        better = found[index, k] < best - 1e-14 * np.abs(best)
        best = np.where(better, found[index, k], best)
        at = np.where(better, trial[index, k], at)
        low, high = trial[index, np.maximum(k - 1, 0)], trial[index, np.minimum(k + 1, 8)]
    winner = int(np.argmin(best))
    return float(best[winner]), float(at[winner]), int(piece[rows[winner]]), int(places[winner])
