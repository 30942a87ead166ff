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
Located = tuple[Places, Array, Array, Array]  # see Zeros

ITERATIONS = 2  # of Newton's method between two nodes, from the secant on
NEAR = 1e-4  # of a step: a zero of the polynomial is as near to that of the states
ROUNDS = 4  # of Newton's method on these
UNITS = 4.0 * float(np.finfo(float).eps)  # of a time: no times nearer are told apart
MARGIN = 1e-9  # of a function's size along a step: asked of it in place of its rounding's bound
_K = np.arange(DEGREE + 1.0)
_DERIVATIVE: Array = 2.0 * _K[:, None] * ((_K[:, None] > _K) & ((_K[:, None] - _K) % 2.0 == 1.0))
_DERIVATIVE[:, 0] *= 0.5
BOTH: Array = np.concatenate([np.eye(DEGREE + 1), _DERIVATIVE], axis=1)  # and the slope's
X: Array = 2.0 * NODES - 1.0


def _margins() -> Array:
    """Of sizes of coefficients, what is left of a sign's, a slope's, and a bend's certainty.

    An error as large takes it away.  Then rounding's part, and with it what the last three tell.
    """
    tail = ROUNDING + 2.0 * (_K > DEGREE - 3)
    sign, slope, bend = -1.0 * (_K > 0), -SLOPES * (_K > 1), -BENDS * (_K > 2)
    sign[0], slope[1], bend[2] = 1.0, 1.0, 4.0
    sure = sign - tail, slope / SLOPES[-1] - tail, bend / BENDS[-1] - tail
    return np.stack([*sure, np.full(DEGREE + 1, ROUNDING), tail], axis=1)


MARGINS: Array = _margins()
NONE: Located = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)), np.zeros(0)
NOWHERE: tuple[Places, Array] = NONE[0], NONE[2]


class Steps(NamedTuple):
    """Steps that are looked at together, m of them.

    `nodes` (m, k, N) are states at Chebyshev's points, `other` (m, p, N) those at the last p of
    them known in another way, which tells how far they may be off; None where nothing but rounding
    does.  `states` has, of steps by their places, the states (k, 2n or more) at a time of each.
    """

    begin: Array
    end: Array
    nodes: Array
    other: Array | None
    states: Callable[[Places, Array], Array]


class Zeros(NamedTuple):
    """Of m steps: the signs (m,) at their begin and end, and when a function passes zero.

    Equal signs are kept all along; they are 0 where it is not known to pass once at most.  It
    passes at times t (k,) in the steps `at`, in the states y, `apart` being how far t may be off.
    """

    first: Array
    last: Array
    at: Places
    t: Array
    y: Array
    apart: Array


def _sampled(part: Part, steps: Steps, sharp: bool) -> tuple[Array, Array, Array]:
    """Values (m, k) at the nodes, how far they may be off (m,), and what rounding is of that."""
    m, k, width = steps.nodes.shape
    at, other = node_times(steps.begin, steps.end), steps.other
    values = part.values(at.ravel(), steps.nodes.reshape(-1, width)).reshape(m, k)
    if sharp:
        noise = np.maximum.reduce(part.noise(at, steps.nodes), axis=-1)
    else:
        noise = MARGIN * np.abs(values).max(axis=1)
    if other is None:
        return values, noise, noise
    p = other.shape[1]
    last = part.values(at[:, -p:].ravel(), other.reshape(-1, other.shape[2]))
    missed = np.abs(values[:, -p:] - last.reshape(m, p))
    return values, noise + MISSED * (missed[:, 0] if p == 1 else missed.max(axis=1)), noise


def single_zeros(function: EventFunction, steps: Steps, locates: bool = True) -> Zeros:
    """Of steps where a function may pass zero: whether it keeps its sign, or where it passes once.

    Only the first, and less sharply, where it `locates` no zeros.
    """
    values, off, noise = _sampled(function, steps, locates)
    off = off + noise
    c = values @ TO_COEFFICIENTS
    margins = np.abs(c) @ MARGINS
    kept, steady, bent = (margins[:, :3] > off[:, None]).T
    for switch in function.switches:
        inner, *missed = _sampled(switch, steps, locates)
        smooth = certain(inner, missed[0] + missed[1]) != 0
        kept, steady, bent = kept & smooth, steady & smooth, bent & smooth
    rounded, ends = margins[:, 3:], values[:, ::DEGREE]
    still = function.way and not rounded[:, 0].all()  # a comparison that stays at zero
    stays = (rounded[:, 0] == 0.0) & (off == 2.0 * noise) if still else None
    rounded[:, 0] += noise
    rounded[:, 1] += off
    seen = np.copysign(np.abs(ends) > rounded, ends)
    passes = seen[:, 0] * seen[:, 1]
    kept = kept | (steady & (passes > 0.0))
    signs = np.sign(values[:, -1:])
    if stays is not None:
        kept |= stays
        signs[stays] = -function.way if function.strict else function.way
    found = NONE
    if locates:
        known = (steady | bent) & (passes < 0.0)
        at = known.nonzero()[0]
        if len(at):
            found = _located(function, steps, at, c[at], values[at], rounded[at, 0])
            steady = steady & ~known
            steady[found[0]] = True
        seen *= steady[:, None]  # what may be 0 at the start stays 0 there, to rounding
    else:
        seen[:] = 0.0
    np.copyto(seen, signs, where=kept[:, None])
    return Zeros(seen[:, 0], seen[:, 1], *found)


def _located(
    function: EventFunction, steps: Steps, at: Places, c: Array, values: Array, noise: Array
) -> Located:
    """Zeros of steps `at` places: those it is so of, times, states, how far times may be off.

    Of `values` (k, DEGREE + 1) at the nodes, and of coefficients c, which change sign once.
    """
    above = values > 0.0
    after = (above == above[:, -1:]).argmax(axis=1)
    low, high = X.take(after - 1), X.take(after)
    after += np.arange(0, values.size, DEGREE + 1)
    below, beyond = values.take(after - 1), values.take(after)
    x = low + (high - low) * (below / (below - beyond))
    both = (c @ BOTH).reshape(-1, 2, DEGREE + 1)
    for _ in range(ITERATIONS):
        waves = np.cos(np.arccos(x)[:, None] * _K)
        value, slope = (both @ waves[:, :, None])[:, :, 0].T
        x = np.minimum(np.maximum(x - value / slope, low), high)
    begin = steps.begin[at]
    half = 0.5 * (steps.end[at] - begin)
    t, speed = begin + half * (1.0 + x), slope / half
    y = steps.states(at, t)
    value, blur = function.values(t, y), 2.0 * noise
    size, hidden = np.abs(value), blur + UNITS * np.abs(t * speed)
    near, sharp = size <= NEAR * np.abs(2.0 * slope), size <= hidden
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
    apart = np.minimum(np.abs(blur / speed), np.abs(half))
    y, good = y[:, : steps.nodes.shape[2]], near & sharp
    return (at, t, y, apart) if good.all() else (at[good], t[good], y[good], apart[good])


def by_boxes(function: EventFunction, *box: Array) -> Array:
    """The signs (m,) along m steps from begin (m,) to end, the states within dy (m, N) of y."""
    found: Array | None = None
    for part in (*function.switches, function):
        if part.around is None:
            return np.zeros(len(box[0]))
        value, reach = part.around(*box)
        signs = np.copysign(np.abs(value) > reach, value)
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

    `first` and `last` (m,) are its signs at their begin and end, 0 where unknown; equal ones are
    kept all along.  `slow` are the places of steps to be looked at by themselves.  `rows` are zeros
    passed in others, at these `places`: the function's own place, the time, how far that may be
    off, the sign after it, and the state.
    """

    first: Array
    last: Array
    slow: Places
    places: Places
    rows: Array


def followed(
    i: int,
    function: EventFunction,
    known: Array,
    before: int,
    steps: Callable[[Places], Steps],
    locates: bool,
) -> Followed:
    """The i-th function, of the sign `before`, along steps; `known` (m,) is 0 where it may change.

    `steps` has some of them by their places; where it `locates` zeros, those passed once are told.
    """
    first, last, (places, rows) = known, known, NOWHERE
    at = (known == 0.0).nonzero()[0]
    if len(at):
        zeros = single_zeros(function, steps(at), locates)
        first, last = known.copy(), known.copy()
        first[at], last[at] = zeros.first, zeros.last
        if len(zeros.at):
            places = at[zeros.at]
            rows = np.empty((len(places), 4 + zeros.y.shape[1]))
            rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = i, zeros.t, zeros.apart, last[places]
            rows[:, 4:] = zeros.y
    goes = np.empty(len(known))  # 1 where it goes on as before, to a sign that is known
    goes[0] = before in (0, first[0])  # what holds at the start is no event
    np.multiply(first[1:], last[:-1], out=goes[1:])
    goes *= last != 0.0
    slow = (goes != 1.0).nonzero()[0]
    if len(slow):
        told = goes[places] == 1.0
        places, rows = places[told], rows[told]
    return Followed(first, last, slow, places, rows)
