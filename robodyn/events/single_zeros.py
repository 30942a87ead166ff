"""Where functions pass zero once along a step, of many steps together.

That is most of what happens.  A function that is monotone on a step, or bends once (`signs.py`),
and has for certain not the same sign at its ends, passes zero there once: Newton's method finds
where on the polynomial, and on the states themselves to rounding.
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
_K = np.arange(DEGREE + 1.0)
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

    The signs are 0 where it is not known to do so once at most.
    """

    first: Places
    last: Places
    t: Array
    y: Array
    apart: Array


def _sampled(part: Part, steps: Steps) -> tuple[Array, Array, Array]:
    """Values (m, k) at the nodes, how far they may be off (m,), and what rounding is of that."""
    m, k, _ = steps.nodes.shape
    at = node_times(steps.begin, steps.end).reshape(m, k)
    p = steps.other.shape[1]
    flat = (x.reshape(-1, x.shape[-1]) for x in (steps.nodes, steps.other))
    values, other = (
        part.values(t.ravel(), y).reshape(m, -1)
        for t, y in zip((at, at[:, -p:]), flat, strict=True)
    )
    noise = np.broadcast_to(part.noise(at, steps.nodes), at.shape).max(axis=1)
    missed = MISSED * np.abs(values[:, -p:] - other).max(axis=1)
    return values, noise + missed, noise


@np.errstate(all="ignore")  # values may be huge, or none
def single_zeros(function: EventFunction, steps: Steps) -> Zeros:
    """Where a function passes zero once, of steps where it may."""
    values, off, noise = _sampled(function, steps)
    c = values @ TO_COEFFICIENTS
    size = np.abs(c)
    noise += ROUNDING * size.sum(axis=1)
    error = off + noise + 2.0 * size[:, -3:].sum(axis=1)
    steady = size[:, 1] > size[:, 2:] @ SLOPES[2:] + SLOPES[-1] * error
    once = steady | (4.0 * size[:, 2] > size[:, 3:] @ BENDS[3:] + BENDS[-1] * error)
    for switch in function.switches:
        inner, *missed = _sampled(switch, steps)
        once &= certain(inner, missed[0] + missed[1]) != 0
    begins, ends = values[:, 0], values[:, -1]
    first = np.where(np.abs(begins) > noise, np.sign(begins), 0.0)
    last = np.where(np.abs(ends) > error, np.sign(ends), 0.0)
    known = once & (first * last < 0.0)
    t, apart, y = np.zeros(len(c)), np.zeros(len(c)), np.zeros((len(c), steps.nodes.shape[2]))
    if known.any():
        at = known.nonzero()[0]
        t[at], y[at], apart[at], known[at] = _located(
            function, steps, at, c[at], values[at], noise[at]
        )
    known |= steady & (first == 0.0)  # and 0 it stays there, to rounding
    first, last = (np.where(known, each, 0.0).astype(np.int64) for each in (first, last))
    return Zeros(first, last, t, y, apart)


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
    weighed = c * _K
    for _ in range(ITERATIONS):
        angle = np.arccos(x)
        turned = _K * angle[:, None]
        slope = (weighed * np.sin(turned)).sum(axis=1) / np.sin(angle)
        x = np.minimum(np.maximum(x - (c * np.cos(turned)).sum(axis=1) / slope, low), high)
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

    `last` (m,) are its signs at their ends, 0 where unknown; `slow` (m,) whether a step is to be
    looked at by itself.
    """

    last: Places
    slow: NDArray[np.bool_]
    singles: dict[int, Single]


def followed(
    i: int,
    function: EventFunction,
    known: Places,
    before: int,
    steps: Callable[[Places], Steps],
) -> Followed:
    """The i-th function, of the sign `before`, along steps; `known` (m,) is 0 where it may change.

    `steps` has some of them by their places.
    """
    at = np.flatnonzero(known == 0)
    zeros = single_zeros(function, steps(at))
    first, last = known.copy(), known.copy()
    first[at], last[at] = zeros.first, zeros.last
    slow = (last == 0) | (first != np.append(before, last[:-1]))
    if before == 0:  # what holds at the start is no event
        slow[0] = last[0] == 0
    passes = (zeros.first * zeros.last == -1) & ~slow[at]
    places, _, signs, times, states, apart = (x[passes] for x in (at, *zeros))
    singles = {
        j: Single(i, t, off, sign, y)
        for j, sign, t, y, off in zip(
            places.tolist(), signs.tolist(), times.tolist(), states, apart.tolist(), strict=True
        )
    }
    return Followed(last, slow, singles)
