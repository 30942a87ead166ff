"""Functions along many steps together: signs that boxes tell, and where they pass zero once.

The last is most of what happens.  A function that is monotone on a step, or bends once
(`signs.py`), and has for certain not the same sign at its ends, passes zero there once: Newton's
method finds where on the polynomial, and on the states themselves to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.events.functions import EventFunction, Part
from robodyn.events.signs import (
    BENDS,
    DEGREE,
    MISSED,
    NODES,
    ROUNDING,
    SLOPES,
    TO_COEFFICIENTS,
    certain,
    node_times,
)
from robodyn.tables.arrays import Array

Places = NDArray[np.int64]

ITERATIONS = 3  # of Newton's method between two nodes, from the secant on
NEAR = 1e-4  # of a step: a zero of the polynomial is as near to that of the states
ROUNDS = 4  # of Newton's method on these
UNITS = 4.0 * float(np.finfo(float).eps)  # of a time: no times nearer are told apart
MARGIN = 1e-9  # of a function's size along a step: asked of it in place of its rounding's bound
_K = np.arange(DEGREE + 1.0)
# of sizes of coefficients: of all, of the last three, and what bounds the slope's and the bend's
SUMS: Array = np.stack([_K >= 0, _K > DEGREE - 3, SLOPES * (_K > 1), BENDS * (_K > 2)], axis=1)
DERIVATIVE: Array = 2.0 * _K[:, None] * ((_K[:, None] > _K) & ((_K[:, None] - _K) % 2.0 == 1.0))
DERIVATIVE[:, 0] *= 0.5
_X = 2.0 * NODES - 1.0


class Steps(NamedTuple):
    """Steps that are looked at together, m of them.

    `nodes` (m, k, N) are states at Chebyshev's points, `other` (m, p, N) those at the last p of
    them known in another way, which tells how far they may be off.  `states` has, of steps by their
    places, the states (k, 2n or more) at a time of each.
    """

    begin: Array
    end: Array
    nodes: Array
    other: Array
    states: Callable[[Places, Array], Array]


class Zeros(NamedTuple):
    """Of m steps: the signs (m,) at their begin and end, and when a function passes zero.

    Equal signs are kept all along; they are 0 where it is not known to pass once at most.
    """

    first: Places
    last: Places
    t: Array
    y: Array
    apart: Array


def _sampled(part: Part, steps: Steps, sharp: bool) -> tuple[Array, Array, Array]:
    """Values (m, k) at the nodes, how far they may be off (m,), and what rounding is of that."""
    m, k, _ = steps.nodes.shape
    at = node_times(steps.begin, steps.end).reshape(m, k)
    p = steps.other.shape[1]
    flat = (x.reshape(-1, x.shape[-1]) for x in (steps.nodes, steps.other))
    values, other = (
        part.values(t.ravel(), y).reshape(m, -1)
        for t, y in zip((at, at[:, -p:]), flat, strict=True)
    )
    if sharp:
        noise = np.maximum.reduce(np.atleast_1d(part.noise(at, steps.nodes)), axis=-1)
    else:
        noise = MARGIN * np.abs(values).max(axis=1)
    missed = MISSED * np.abs(values[:, -p:] - other).max(axis=1)
    return values, noise + missed, noise


@np.errstate(all="ignore")  # values may be huge, or none
def single_zeros(function: EventFunction, steps: Steps, locates: bool = True) -> Zeros:
    """Of steps where a function may pass zero: whether it keeps its sign, or where it passes once.

    Only the first, and less sharply, where it `locates` no zeros.
    """
    values, off, noise = _sampled(function, steps, locates)
    c = values @ TO_COEFFICIENTS
    size = np.abs(c)
    total, tail, slopes, bends = (size @ SUMS).T
    noise += ROUNDING * total
    error = off + noise + 2.0 * tail
    kept = 2.0 * size[:, 0] > total + error
    steady = size[:, 1] > slopes + SLOPES[-1] * error
    once = steady | (4.0 * size[:, 2] > bends + BENDS[-1] * error)
    for switch in function.switches:
        inner, *missed = _sampled(switch, steps, locates)
        smooth = certain(inner, missed[0] + missed[1]) != 0
        kept, once, steady = kept & smooth, once & smooth, steady & smooth
    begins, ends = values[:, 0], values[:, -1]
    first = np.sign(begins) * (np.abs(begins) > noise)
    last = np.sign(ends) * (np.abs(ends) > error)
    known = once & (first * last < 0.0)
    m, y = len(c), steps.nodes[:, 0].copy()
    t, apart = np.zeros((2, m))
    if locates and known.any():
        at = known.nonzero()[0]
        t[at], y[at], apart[at], known[at] = _located(
            function, steps, at, c[at], values[at], noise[at]
        )
        known |= steady & (first == 0.0)  # and 0 it stays there, to rounding
    else:
        known[:] = False
    kept |= steady & (first * last > 0.0)
    if function.way and not total.all():  # a comparison that stays at zero
        kept |= (total == 0.0) & (off == noise)
        ends = np.where(total, ends, -function.way if function.strict else function.way)
    both = np.where(kept, np.sign(ends), np.where(known, (first, last), 0.0)).astype(np.int64)
    return Zeros(both[0], both[1], t, y, apart)


def _located(
    function: EventFunction, steps: Steps, at: Places, c: Array, values: Array, noise: Array
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Zeros of steps: their times, the states there, how far they may be off, and whether so.

    Of `values` (k, DEGREE + 1) at the nodes, and of coefficients c, which change sign once.
    """
    rows = np.arange(len(at))
    after = np.argmax(values * np.sign(values[:, -1:]) > 0.0, axis=1)
    low, high = _X[after - 1], _X[after]
    below, above = values[rows, after - 1], values[rows, after]
    x = low + (high - low) * below / (below - above)
    both = np.stack([c, c @ DERIVATIVE])
    for _ in range(ITERATIONS):
        value, slope = (both * np.cos(np.arccos(x)[:, None] * _K)).sum(axis=-1)
        x = np.minimum(np.maximum(x - value / slope, low), high)
    h = steps.end[at] - steps.begin[at]
    t, speed = steps.begin[at] + 0.5 * h * (1.0 + x), 2.0 * slope / h
    y = steps.states(at, t)
    value = function.values(t, y)
    hidden = 2.0 * noise + UNITS * np.abs(t * speed)
    near, sharp = (np.abs(value) <= limit for limit in (NEAR * np.abs(2.0 * slope), hidden))
    for _ in range(ROUNDS):
        if sharp.all():
            break
        nearer = t - value / speed
        states = steps.states(at, nearer)
        found = function.values(nearer, states)
        better = np.abs(found) < np.abs(value)
        t, y = np.where(better, nearer, t), np.where(better[:, None], states, y)
        value = np.where(better, found, value)
        sharp = np.abs(value) <= hidden
    apart = np.minimum(np.abs(2.0 * noise / slope), 1.0) * 0.5 * np.abs(h)
    return t, y[:, : steps.nodes.shape[2]], apart, near & sharp


def by_boxes(function: EventFunction, *box: Array) -> Places:
    """The signs (m,) along m steps from begin (m,) to end, the states within dy (m, N) of y."""
    found: Places | None = None
    for part in (*function.switches, function):
        if part.around is None:
            return np.zeros(len(box[0]), np.int64)
        value, reach = part.around(*box)
        signs = np.subtract(value > reach, value < -reach, dtype=np.int64)
        found = signs if found is None else signs * np.abs(found)
    assert found is not None
    return found


class Single(NamedTuple):
    """Where the function at a place passes zero, and to which sign.

    Its time may be off by `apart`, s.
    """

    place: int
    t: float
    apart: float
    sign: int
    y: Any = None


class Followed(NamedTuple):
    """A function along m steps: what it does in which of them.

    `kept` (m,) are the signs that it has all along a step, `last` (m,) those at their ends, 0 where
    unknown; `slow` (m,) whether a step is to be looked at by itself.  `rows` are zeros passed in
    others, at these `places`: the function's own place, the time, how far that may be off, the sign
    after it, and the state.
    """

    kept: Places
    last: Places
    slow: NDArray[np.bool_]
    places: Places
    rows: Array


def followed(
    i: int,
    function: EventFunction,
    known: Places,
    before: int,
    steps: Callable[[Places], Steps],
    locates: bool,
) -> Followed:
    """The i-th function, of the sign `before`, along steps; `known` (m,) is 0 where it may change.

    `steps` has some of them by their places; where it `locates` zeros, those passed once are told.
    """
    kept, first, last = known, known, known
    at = places = np.flatnonzero(known == 0)
    rows = np.zeros((0, 0))
    if len(at):
        zeros = single_zeros(function, steps(at), locates)
        kept, first, last = known.copy(), known.copy(), known.copy()
        first[at], last[at] = zeros.first, zeros.last
        kept[at] = np.where(zeros.first == zeros.last, zeros.last, 0)
    slow = last == 0
    slow[1:] |= first[1:] != last[:-1]
    slow[0] |= before not in (0, first[0])  # what holds at the start is no event
    if len(at):
        passes = (zeros.first * zeros.last == -1) & ~slow[at]
        places = at[passes]
        told = (zeros.t, zeros.apart, zeros.last, *zeros.y.T)
        rows = np.array([np.full(len(at), float(i)), *told]).T[passes]
    return Followed(kept, last, slow, places, rows)
