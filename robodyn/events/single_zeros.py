"""Where a function of time changes sign within a step, with proof that it does so nowhere else.

On a box of times f is the polynomial of degree 16 through its values at Chebyshev's points, but for
an error that its last coefficients and rounding tell.  With f = sum c_k T_k and |T_k| <= 1,
|T_k'| <= k^2, |T_k''| <= k^2 (k^2 - 1)/3 on the box,

    |c_0| > sum_{k>0} |c_k|                              f has one sign,
    |c_1| > sum_{k>1} k^2 |c_k|                          f is monotone,
    4 |c_2| > sum_{k>2} k^2 (k^2 - 1)/3 |c_k|            f has one extremum at most,

each with the error added.  A box where none of them holds is halved.  So a pair of roots, however
close, costs one box, and a double root is told from two roots as far as rounding permits.

Most functions pass zero once in a step.  One that is monotone on it, or bends once, and has for
certain not the same sign at its ends, passes zero there once: Newton's method finds where on the
polynomial, and on the states themselves to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.events.functions import EventFunction, Part
from robodyn.tables.arrays import Array

Function = Callable[[Array], Array]  # of times (k,), (k,)
Sampled = Callable[[Array], tuple[Array, Array]]  # the same, and bounds of its rounding

DEGREE = 16
ROUNDING = 16.0 * float(np.finfo(float).eps)  # of the sum of |c_k|
SPREAD = np.array([0.0, 1e-14, 1e-12, 1e-9, 1e-5])  # of a bracket, about a guess of the root
CLOSE = np.array([-1.0, 0.0, 1.0])  # mostly a guess is right to rounding
MISSED = 4.0  # of what a step misses at its end, where it is brought back onto closures
FLAT = 0.05  # of the first coefficients, the last ones of what no polynomial follows
SCATTER = 1e6  # of rounding: that of states near a change point
MOST_BOXES = 20_000  # of one look at a function along a step

_k = np.arange(DEGREE + 1.0)
NODES: Array = 0.5 - 0.5 * np.cos(math.pi * _k / DEGREE)  # on [0, 1], upwards
SLOPES, BENDS = _k**2, _k**2 * (_k**2 - 1.0) / 3.0  # most of |T_k'| and |T_k''|


def _coefficients() -> Array:
    """What makes the c_k (rows) of the values at the nodes (columns)."""
    values = np.cos(math.pi * np.outer(_k, DEGREE - _k) / DEGREE) * (2.0 / DEGREE)
    values[:, [0, -1]] *= 0.5
    values[[0, -1]] *= 0.5
    return values


FROM_VALUES: Array = _coefficients()
TO_COEFFICIENTS: Array = np.ascontiguousarray(FROM_VALUES.T)


class Stretch(NamedTuple):
    """Times over which a function has one sign: 1 or -1; 0 where rounding hides it.

    `sure` is a time at which it has the sign for certain, `blur` how far its begin may be off, s.
    Where it `stays` it is zero, or not defined.
    """

    begin: float
    end: float
    sign: int
    sure: float
    blur: float = 0.0
    stays: bool = False
    defined: bool = True


class Box(NamedTuple):
    """A function on a box of times: its coefficients, how far they may be off, and rounding's."""

    begin: float
    end: float
    c: list[float]
    error: float
    noise: float


@dataclass
class Budget:
    """How many boxes may still be looked at, none shorter than `least` (s).

    `spent` where they did not suffice.
    """

    least: float
    left: int = MOST_BOXES
    spent: bool = False


def node_times(begin: Array, end: Array) -> Array:
    """The times (m, nodes) of Chebyshev's points of m steps."""
    at: Array = begin[:, None] + (end - begin)[:, None] * NODES
    return at


def certain(values: Array, noise: Array) -> NDArray[np.int64]:
    """The signs of functions (...) that do not change on their box; 0 where they may.

    `values` (..., DEGREE + 1) are those at the nodes, each right but for `noise` (...).
    """
    c = values @ TO_COEFFICIENTS
    size = np.abs(c)
    total, tail = size.sum(axis=-1), size[..., -3:].sum(axis=-1)
    sure = 2.0 * size[..., 0] > total + noise + ROUNDING * total + 2.0 * tail
    return np.where(sure, np.sign(c[..., 0]), 0.0).astype(np.int64)


def stretches(f: Sampled, begin: float, end: float, budget: Budget) -> Iterator[Stretch]:
    """The signs of f from `begin` to `end`, in order."""
    budget.left -= 1
    times = begin + (end - begin) * NODES
    times[-1] = end
    middle = begin + 0.5 * (end - begin)
    values, noises = f(times)
    if not values.any():
        yield Stretch(begin, end, 0, middle, stays=True)
        return
    if np.isfinite(values).all():
        noise = float(noises.max())
        c = FROM_VALUES @ values
        size = np.abs(c)
        total = float(size.sum())
        error = noise + ROUNDING * total + 2.0 * float(size[-3:].sum())
        box = Box(begin, end, c.tolist(), error, noise + ROUNDING * total)
        if 2.0 * size[0] > total + error:
            yield Stretch(begin, end, int(np.sign(c[0])), middle)
            return
        if size[1] > SLOPES[2:] @ size[2:] + SLOPES[-1] * error:
            yield from _monotone(box, begin, end)
            return
        # its halves would tell no more; states brought onto closures scatter by more than rounding
        scatters = size[9:].max() > FLAT * size[1:9].max()
        scatters = scatters and float(np.abs(values).max()) <= SCATTER * float(noises.min())
        steady = scatters or size[1:].sum() <= noises.min()
        if steady or (np.abs(values) <= noises).all():
            yield Stretch(begin, end, 0, middle)
            return
        near = 2.0 * math.sqrt(error / size[2]) if size[2] else 1.0
        if near < 0.5 and 4.0 * size[2] > BENDS[3:] @ size[3:] + BENDS[-1] * error:
            yield from _bent(f, box, budget, near)
            return
    elif np.isnan(values).all():
        yield Stretch(begin, end, 0, middle, stays=True, defined=False)
        return
    elif np.isinf(values).all() and abs(np.sign(values).sum()) == len(values):
        yield Stretch(begin, end, int(np.sign(values[0])), middle)
        return
    if abs(end - begin) <= max(budget.least, 8.0 * math.ulp(max(abs(begin), abs(end)))):
        yield Stretch(begin, end, 0, middle)
    elif budget.left <= 0:
        budget.spent = True
        yield Stretch(begin, end, 0, middle)
    else:
        yield from stretches(f, begin, middle, budget)
        yield from stretches(f, middle, end, budget)


def _value(c: list[float], x: float) -> float:
    """At x in [-1, 1], by Clenshaw's recurrence."""
    last = before = 0.0
    for each in c[:0:-1]:
        last, before = each + 2.0 * x * last - before, last
    return c[0] + x * last - before


def _at(box: Box, t: float) -> float:
    return min(1.0, max(-1.0, 2.0 * (t - box.begin) / (box.end - box.begin) - 1.0))


def _slope(c: list[float]) -> list[float]:
    """The coefficients of the derivative by x in [-1, 1]."""
    found = [0.0] * (len(c) + 1)
    for k in range(len(c) - 1, 0, -1):
        found[k - 1] = found[k + 1] + 2.0 * k * c[k]
    found[0] *= 0.5
    return found[:-2]


def _sign(box: Box, t: float) -> int:
    value = _value(box.c, _at(box, t))
    return 0 if abs(value) <= box.error else int(math.copysign(1.0, value))


def _blur(box: Box, t: float) -> float:
    """How far the time of a root may be off by rounding: twice what its slope there tells."""
    slope = abs(_value(_slope(box.c), _at(box, t)))
    length = 0.5 * abs(box.end - box.begin)
    return min(2.0 * box.noise / slope, 1.0) * length if slope > 0.0 else length


def _monotone(box: Box, begin: float, end: float) -> Iterator[Stretch]:
    """Of a part of a box in which f is monotone."""
    first, last = _sign(box, begin), _sign(box, end)
    if first and last and first != last:
        middle = _root(box.c, box, begin, end)
        yield Stretch(begin, middle, first, begin)
        yield Stretch(middle, end, last, end, _blur(box, middle))
    elif first:  # one that is hidden at an end has the sign of the other until there
        yield Stretch(begin, end, first, begin)
    else:
        yield Stretch(begin, end, last, end, _blur(box, begin))


def _bent(f: Sampled, box: Box, budget: Budget, near: float) -> Iterator[Stretch]:
    """Of a box in which f bends one way alone; rounding may hide it `near` its extremum."""
    slope = _slope(box.c)
    if _value(slope, -1.0) * _value(slope, 1.0) >= 0.0:
        yield from _monotone(box, box.begin, box.end)
        return
    top = _root(slope, box, box.begin, box.end)
    if _sign(box, top):
        yield from _monotone(box, box.begin, top)
        yield from _monotone(box, top, box.end)
        return
    # rounding along the box hides it: a narrow one sees more
    half = 0.5 * (box.end - box.begin) * near
    forward = 1.0 if half > 0.0 else -1.0
    low = max(box.begin * forward, (top - half) * forward) * forward
    high = min(box.end * forward, (top + half) * forward) * forward
    if low != box.begin:
        yield from _monotone(box, box.begin, low)
    yield from stretches(f, low, high, budget)
    if high != box.end:
        yield from _monotone(box, high, box.end)


def _root(c: list[float], box: Box, begin: float, end: float) -> float:
    """Of a polynomial that changes sign once between two times: Newton's, kept in the bracket."""
    low, high = _at(box, begin), _at(box, end)
    rising = _value(c, high) > 0.0
    slope = _slope(c)
    x, moved = 0.5 * (low + high), high - low
    for _ in range(80):
        value, rate = _value(c, x), _value(slope, x)
        if value == 0.0:
            break
        if (value > 0.0) == rising:
            high = x
        else:
            low = x
        before, last = x, moved
        x = before - value / rate if rate else low
        if abs(x - before) < 2e-16:
            break
        if not low <= x <= high or abs(x - before) > 0.5 * abs(last):
            x = 0.5 * (low + high)
        moved = x - before
    return box.begin + 0.5 * (box.end - box.begin) * (1.0 + x)


def bracket(
    f: Function, met: Callable[[Array], Any], low: float, high: float, guess: float
) -> tuple[float, float, float]:
    """Neighbours, to rounding, between which f comes to meet a condition: `met` of its values.

    It is not met at `low` and is at `high`, and comes to be once between.  The third is that of the
    two where f is nearer to zero.
    """
    first = last = math.nan  # values at the ends, where they are known
    points = guess + math.copysign(2.0 * _unit(low, high), high - low) * CLOSE
    for _ in range(80):
        t = points[(points - low) * (high - points) > 0.0]
        if len(t):
            values = f(t)
            there = np.append(met(values), True)
            after = int(np.argmax(there))
            ends, sizes = [low, *t.tolist(), high], [first, *values.tolist(), last]
            low, high, first, last = *ends[after : after + 2], *sizes[after : after + 2]
        width, known = high - low, not (math.isnan(first) or math.isnan(last))
        if not known:
            first, last = f(np.array([low, high])).tolist()
        if abs(width) <= 4.0 * _unit(low, high) or (known and not len(t)):
            break
        part = first / (first - last) if math.isfinite(first - last) and first != last else 0.5
        guess = low + min(1.0, max(0.0, part)) * width
        points = np.concatenate([guess - width * SPREAD, guess + width * SPREAD])
        points = np.sort(np.append(points, low + 0.5 * width))
        points = points if width > 0.0 else points[::-1]
    return low, high, low if abs(first) < abs(last) else high


def _unit(low: float, high: float) -> float:
    return math.ulp(max(abs(low), abs(high)))


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
