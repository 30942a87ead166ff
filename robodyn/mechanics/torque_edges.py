"""Torques that have no value, or no series, at the begin or end of a piece.

`exp(-1/(t - 4)) if t > 4 else 0` is smooth, and yet 1/0 where it begins; so is sin(t)/t.  So each
part between two switching times is evaluated at both ends.  If it has no value there, a straight
line replaces it on a stretch so short that its impulse keeps all digits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robodyn.mechanics.kinks import switch
from robodyn.mechanics.time_samples import values_of
from robodyn.scene.expressions import fold
from robodyn.scene.syntax import Node
from robodyn.tables.arrays import Array

ULPS = np.array([0.0, 1.0, 2.0, 4.0, 16.0, 64.0, 256.0])  # an end is asked at and beside
STRETCHES = 10.0 ** -np.arange(3.0, 12.0)  # of the run; the longest that is a line is taken
MOST = 0.3  # of a piece
ENDS = np.array([1.0, 2.0]) / 3.0  # of a stretch: the line goes through what stands there
CHECKED = np.concatenate([[0.003, 0.01, 0.03], np.linspace(0.05, 1.0, 39)])
USUAL = np.linspace(0.02, 0.98, 49)  # of a piece, where it is seen how large a torque is
LOST = 1e-15  # part of a usual torque times the run that a line may miss


class Line(NamedTuple):
    """first + slope t from `begin` to `end`, in place of a part without value."""

    begin: float
    end: float
    first: float
    slope: float


def lines_at_edges(held: Node, edges: Array, switches: Array, samples: Array) -> list[Line]:
    """Return lines beside those `edges` of pieces at which `held` has no value.

    `switches` (switches, pieces) are their values; `samples` are the times at which the run is
    sampled.
    """
    span = edges[-1] - edges[0]
    ends = np.stack([edges[:-1], edges[1:]], axis=1)
    inward = np.array([1.0, -1.0]) * MOST * np.diff(edges)[:, None]
    near = ULPS * np.spacing(np.abs(edges).max())
    beside = ends[..., None] + np.sign(inward)[..., None] * np.minimum(
        near, np.abs(inward)[..., None]
    )
    stand = switches[:, :, None, None]
    undefined = ~np.isfinite(values_of(held, {"t": beside, "_s": stand})).all(axis=-1)
    if not undefined.any():
        return []
    lines = []
    for piece, side in np.argwhere(undefined).tolist():

        def torque(t: Array, stands: Array = switches[:, piece, None]) -> Array:
            return values_of(held, {"t": t, "_s": stands})

        line = _line(torque, ends[piece, side], inward[piece, side], span, samples)
        lines += [] if line is None else [line]
    return lines


def _line(
    torque: Callable[[Array], Array], edge: float, most: float, span: float, samples: Array
) -> Line | None:
    """Return the longest line from an edge that changes no digit; `most` bounds its length.

    The samples show narrow features.
    """
    usual = np.abs(torque(edge + most / MOST * USUAL))
    least = LOST * span * np.quantile(np.where(np.isfinite(usual), usual, 0.0), 0.8)
    for stretch in np.sign(most) * span * STRETCHES:
        if abs(stretch) > abs(most):
            continue
        low, high = sorted((float(edge), float(edge + stretch)))
        within = samples[np.searchsorted(samples, low, "right") : np.searchsorted(samples, high)]
        t = np.concatenate([edge + stretch * ENDS, edge + stretch * CHECKED, within])
        x = torque(t)
        slope = (x[1] - x[0]) / (t[1] - t[0])
        first = x[0] - slope * t[0]
        off = np.abs(first + slope * t - x)
        off[len(t) - len(within) :][np.isnan(x[len(t) - len(within) :])] = 0.0  # at the edge itself
        if off.max() * abs(stretch) <= least:
            return Line(low, high, float(first), float(slope))
    return None


def cut(edges: Array, switches: Array, lines: Sequence[Sequence[Line]]) -> tuple[Array, Array]:
    """Return edges and switch values with three more switches per expression with `lines`.

    They are 1 and the line's two numbers where it replaces the expression, else zero.
    """
    ends = [x for each in lines for line in each for x in (line.begin, line.end)]
    finer = np.unique(np.concatenate([edges, ends]))
    middles = 0.5 * (finer[1:] + finer[:-1])
    columns = list(switches[:, np.searchsorted(edges, middles) - 1])
    for each in lines:
        added = np.zeros((3, len(middles)))
        for line in each:
            at = (line.begin < middles) & (middles < line.end)
            added[:, at] = np.array([[1.0], [line.first], [line.slope]])
        columns += list(added)
    return finer, np.array(columns)


def with_lines(torque: Node, lines: Mapping[int, int]) -> Node:
    """Return the tree with lines for operations in `lines`, by id, with the switch's number."""

    def leaf(x: Node) -> Node:
        return x

    def written(node: tuple[Any, ...], parts: list[Node]) -> Node:
        found = node[0], *parts
        k = lines.get(id(node))
        if k is None:
            return found
        return "if", ("int", switch(k)), ("+", switch(k + 1), ("*", switch(k + 2), "t")), found

    return fold(torque, leaf, written)
