"""Torques that have no value, or no series, where a piece of them begins or ends.

`exp(-1/(t - 4)) if t > 4 else 0` is smooth, and yet 1/0 where it begins; so is sin(t)/t.  What is
held between two switching times is therefore asked at both ends.  Where it has no value there, a
straight line stands for it on a stretch so short that no digit of its impulse is lost.
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
    """first + slope t from `begin` to `end`, in the place of what is held there."""

    begin: float
    end: float
    first: float
    slope: float


def lines_at_edges(held: Node, edges: Array, switches: Array, samples: Array) -> list[Line]:
    """The lines beside those `edges` of pieces at which `held` has no value.

    `switches` (switches, pieces) tells how they stand; at the `samples` the run is looked at.
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
    """The longest line from an edge that misses nothing which counts; `most` is how far it may go.

    The samples are where what is narrow shows.
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
    """The edges and how the switches stand, with three more for each expression with `lines`.

    Those are 1 and the numbers of a line where it stands for the expression, zero elsewhere.
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
    """The tree with lines for those of its operations whose id has one: by which switch."""

    def leaf(x: Node) -> Node:
        return x

    def written(node: tuple[Any, ...], parts: list[Node]) -> Node:
        found = node[0], *parts
        k = lines.get(id(node))
        if k is None:
            return found
        return "if", ("int", switch(k)), ("+", switch(k + 1), ("*", switch(k + 2), "t")), found

    return fold(torque, leaf, written)
