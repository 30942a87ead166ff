"""Samples of expressions over time: zeros, extremes, switching times, and leaves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.polynomial.chebyshev import chebval

from robodyn.mechanics.kinks import switch_number
from robodyn.scene.expressions import fold
from robodyn.scene.syntax import Node
from robodyn.tables.arrays import Array

Names = Mapping[str, Any]

SAMPLES = (1024, 16384)  # of a run: no fewer; no more but for a switch that is faster
WORK = 200_000  # samples times parts, between them
MOST = 1_100_000  # samples for what is fast
ROUNDS = 4  # each sees what the samples of the one before bring to light
DENSE = 8  # samples for each change of a part, below which it is faster than its samples
UNEVEN = 0.3  # of the time between samples, by which each is moved
CUTS = 16  # of a bracket at a time
FINEST = 1e-18  # of the run: no bracket is cut further
DEGREE = 16
SMOOTH = 1e-9  # part of the largest torque by which a polynomial may miss a sample
LEAVES = 32768  # beyond so many, the torque is left to the control of the steps' errors
ASIDE = 0.47  # where a leaf is split: where a root begins, no step should
ROUNDED = 1e-15
NARROWEST = 1e-10  # of the run, for a leaf
UNTOLD = 1e-7  # part of the impulse that the narrowest leaves may hide
ENTRIES = 4_000_000  # samples times parts, whatever is fast


def _defined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with nan where it goes to infinity, as Python raises: 1/0, log(0)."""

    def result(*x: Any) -> Any:
        y = function(*x)
        return np.where(np.isinf(y) & np.logical_and.reduce([np.isfinite(a) for a in x]), np.nan, y)

    return result


def _compared(compare: Callable[..., Any]) -> Callable[..., Any]:
    """Return the comparison with nan if one side is nan."""
    return lambda a, b: np.where(np.isnan(a) | np.isnan(b), np.nan, compare(a, b))


_SAME = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "sign", "floor")
FUNCTIONS: dict[str, Callable[..., Any]] = {  # of expressions, on arrays
    **{name: getattr(np, name) for name in _SAME},
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "abs": np.abs,
    "min": lambda *x: np.minimum.reduce(np.broadcast_arrays(*x)),
    "max": lambda *x: np.maximum.reduce(np.broadcast_arrays(*x)),
    "hypot": lambda *x: np.sqrt(sum(each**2 for each in x)),
    "log": lambda x, *base: np.log(x) / np.log(*base) if base else np.log(x),
}
_ARRAYS: dict[str, Callable[..., Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": _defined(np.divide),
    "%": np.mod,
    "**": _defined(np.power),
    "pow": _defined(np.power),
    "neg": np.negative,
    "<": _compared(np.less),
    "<=": _compared(np.less_equal),
    ">": _compared(np.greater),
    ">=": _compared(np.greater_equal),
    "if": lambda test, x, y: np.where(np.isnan(test), np.nan, np.where(test, x, y)),
    **FUNCTIONS,
    "log": _defined(FUNCTIONS["log"]),
    "min_at": lambda *x: _first(np.argmin, x),
    "max_at": lambda *x: _first(np.argmax, x),
    "turns": lambda a, b: np.rint((a - np.mod(a, b)) / b),
    "int": lambda x: x,
    "pick": lambda k, *x: np.select([k == i for i in range(len(x))], x, np.nan),
    "true": lambda x: np.where(np.isnan(x), np.nan, x != 0.0),
}


def _first(which: Callable[..., Any], x: Sequence[Array]) -> Array:
    """Return the index of the least or largest of some arrays; nan if one of them is nan."""
    values = np.stack(x)
    return np.where(np.isnan(values).any(axis=0), np.nan, which(values, axis=0))


def values_of(node: Node, names: Names, memo: dict[int, Any] | None = None) -> Array:
    """Return an expression's values (shape of t); nan where it is undefined."""
    t = names["t"]

    def leaf(x: float | str) -> Array:
        if not isinstance(x, str):
            return np.full_like(t, x)
        k = switch_number(x)
        return (names[x] if k is None else names["_s"][k]) + 0.0 * t  # type: ignore[no-any-return]

    def apply(node: tuple[Any, ...], parts: list[Array]) -> Array:
        return _ARRAYS[node[0]](*parts)  # type: ignore[no-any-return]

    return fold(node, leaf, apply, memo)


class Parts(Protocol):
    """Parts of expressions, `size` in all.

    `timely` parts may be faster than samples; `guards` decide the values of `switches`.
    """

    size: int
    timely: list[Node]
    guards: list[Node]
    switches: list[Node]


def samples_of(parts: Parts, t_end: float) -> Array | None:
    """Return increasing times of the run; None if a switch is too fast for samples.

    They include zeros and extremes of the parts, and both sides of every switching time.
    """
    size = parts.size
    count = first = int(np.clip(WORK // size, *SAMPLES))
    while count <= MOST and count * size <= max(ENTRIES, first * size):
        t = _sampled(parts, count, t_end, every=True)
        if t is not None:
            return t
        count *= DENSE
    # smooth parts that are too fast are left to the control of the steps' errors
    last = count // DENSE if parts.switches else first
    return _sampled(parts, last, t_end, every=False)


def _sampled(given: Parts, count: int, t_end: float, every: bool) -> Array | None:
    """Return samples, `count` at first; None if guards or switches are too fast for them.

    With `every`, also if any other part is too fast.
    """
    guards, switches = given.guards, given.switches
    parts = [*guards, *given.timely]
    strict = len(parts) if every else len(guards)
    t = np.linspace(0.0, t_end, count + 1)
    # uneven ones: what is as fast as even samples would look slow
    t[1:-1] += np.random.default_rng(0).uniform(-UNEVEN, UNEVEN, count - 1) * (t_end / count)
    t = np.sort(t)
    signs = [("sign", node) for node in parts]
    for turn in range(ROUNDS):
        memo: dict[int, Any] = {}
        found = [t]
        extremes = [_extremes(x, t, memo) for x in parts] if turn < 2 else []
        changes = [_changes(x, t, memo) for x in signs]
        switching = [_changes(x, t, memo) for x in switches]
        # an extreme may be one only beside what the first turn found
        slow = [*switching, *((*extremes[:strict], *changes[:strict]) if turn == 0 else ())]
        if not all(kept for _, kept in slow):
            return None
        found += [times for times, _ in (*extremes, *changes, *switching)]
        before, t = len(t), np.unique(np.concatenate(found))
        if len(t) == before:
            break
    return t


def _changes(node: Node, t: Array, memo: dict[int, Any]) -> tuple[Array, bool]:
    """Return pairs of neighbouring times between which the whole numbers of a node change.

    The second result tells whether they are few enough that no others can hide between samples.
    """
    code = _code(values_of(node, {"t": t}, memo))
    (k,) = np.nonzero(code[1:] != code[:-1])
    if DENSE * len(k) > len(t):
        return t[:0], False
    a, b, begun = t[k], t[k + 1], code[k]
    finest = FINEST * (t[-1] - t[0])
    cuts = np.linspace(0.0, 1.0, CUTS + 1)
    while (wide := (b - a > finest) & (np.nextafter(a, b) < b)).any():
        at = a[wide, None] + (b - a)[wide, None] * cuts
        at[:, 0], at[:, -1] = np.nextafter(a[wide], b[wide]), b[wide]
        later = _code(values_of(node, {"t": at})) != begun[wide, None]
        later[:, -1] = True
        row, first = np.arange(len(at)), later.argmax(axis=1)
        a[wide] = np.where(first > 0, at[row, first - 1], a[wide])
        b[wide] = at[row, first]
    return np.concatenate([a, b]), True


def _code(values: Array) -> Array:
    return np.where(np.isnan(values), 0.5, values)


def _extremes(node: Node, t: Array, memo: dict[int, Any]) -> tuple[Array, bool]:
    """Return times at which a node has an extreme, and whether they are few."""
    x = values_of(node, {"t": t}, memo)
    rise = np.diff(x)
    least = 1e-12 * np.abs(x[np.isfinite(x)]).max(initial=0.0)
    peak = (rise[:-1] * rise[1:] < 0.0) & (np.abs(rise[:-1]) + np.abs(rise[1:]) > least)
    (k,) = np.nonzero(peak)
    if DENSE * len(k) > len(t):
        return t[:0], False
    a, b, way = t[k], t[k + 2], np.sign(rise[k])
    cuts = np.linspace(0.0, 1.0, CUTS + 1)
    middle = t[k + 1]
    for _ in range(9 if len(k) else 0):
        at = a[:, None] + (b - a)[:, None] * cuts
        best = (way[:, None] * values_of(node, {"t": at})).argmax(axis=1)
        row = np.arange(len(at))
        middle = at[row, best]
        a, b = at[row, np.maximum(best - 1, 0)], at[row, np.minimum(best + 1, CUTS)]
    return middle, True


def switching_times(switches: Sequence[Node], t: Array) -> list[float]:
    """Return times at which a switch changes; of equal ones the shortest decimal."""
    memo: dict[int, Any] = {}
    finest = 2.0 * FINEST * (t[-1] - t[0])
    codes = [_code(values_of(switch, {"t": t}, memo)) for switch in switches]
    changes = sum((code[1:] != code[:-1] for code in codes), np.zeros(len(t) - 1, bool))
    (k,) = np.nonzero(changes)
    times = np.unique(np.concatenate([t[k], t[k + 1]])).tolist()
    groups: list[list[float]] = []
    for time in times:
        if groups and time - groups[-1][-1] <= max(4.0 * math.ulp(time), finest):
            groups[-1].append(time)
        else:
            groups.append([time])
    return [min(group, key=lambda x: len(repr(x))) for group in groups]


def holes(functions: Sequence[Node], names: Names) -> list[float]:
    """Return the times among names["t"] at which a function is undefined, but not beside them."""
    t, found = names["t"], set()
    for function in functions:
        known = np.isfinite(values_of(function, names))
        alone = ~known[1:-1] & known[:-2] & known[2:]
        found.update(t[1:-1][alone].tolist())
    return sorted(found)


def leaf_ends(
    functions: list[Node], names: Names, edges: Array, samples: Array, small: float
) -> tuple[Array, bool]:
    """Return the ends of the leaves, `edges` included, and whether they resolve the functions."""
    angles = (np.arange(DEGREE + 1) + 0.5) * (np.pi / (DEGREE + 1))
    orders = np.arange(DEGREE + 1)
    between = np.arange(1, DEGREE + 1) * (np.pi / (DEGREE + 1))
    fit = np.cos(np.outer(angles, orders)) * (2.0 - (orders == 0)) / (DEGREE + 1)
    probe = np.cos(np.outer(orders, between))
    places = np.cos(np.concatenate([angles, between]))
    memo: dict[int, Any] = {}
    sampled = [values_of(x, {**names, "t": samples}, memo) for x in functions]
    least = [max(SMOOTH * np.abs(x[np.isfinite(x)]).max(initial=0.0), small) for x in sampled]
    a, b, ends = edges[:-1], edges[1:], edges
    span = edges[-1] - edges[0]
    impulse = missed = 0.0
    while len(a):
        middle, half = 0.5 * (a + b), 0.5 * (b - a)
        t = middle[:, None] + half[:, None] * places
        leaf = np.minimum(np.searchsorted(a, samples, "right") - 1, len(a) - 1)
        inside = (samples > a[leaf]) & (samples < b[leaf])
        good, worst, largest = np.ones(len(a), bool), np.zeros(len(a)), np.zeros(len(a))
        rounding = ROUNDED * np.maximum(np.abs(a), np.abs(b)) / (b - a)  # of t, part of a leaf
        memo = {}
        for x, known, off_by in zip(functions, sampled, least, strict=True):
            values = values_of(x, {**names, "t": t}, memo)
            series = values[:, : DEGREE + 1] @ fit
            most = np.maximum(off_by, np.ptp(values, axis=1) * rounding)
            miss = np.abs(series @ probe - values[:, DEGREE + 1 :]).max(axis=1)
            undefined = np.asarray(~np.isfinite(values).any(axis=1))
            good &= (miss <= most) | undefined
            (k,) = np.nonzero(inside & good[leaf])
            at = leaf[k]
            u = (samples[k] - middle[at]) / half[at]
            off = np.abs(chebval(u, series[at].T, tensor=False) - known[k])
            good[at[~((off <= most[at]) | (undefined[at] & ~np.isfinite(known[k])))]] = False
            np.maximum.at(worst, at, np.where(np.isfinite(off), off, 0.0))
            worst = np.fmax(worst, np.where(np.isfinite(miss), miss, 0.0))
            largest = np.fmax(largest, np.nanmax(np.abs(values), axis=1, initial=0.0))
        split = ~good & (half > NARROWEST * span)
        missed += float((half * worst)[~good & ~split].sum())
        impulse += float((half * (largest + worst))[~split].sum())
        values_ahead = 2 * split.sum() * len(places) * len(memo)
        if len(ends) + split.sum() > LEAVES or values_ahead > 4 * ENTRIES:
            return ends, False
        a, b = a[split], b[split]
        inner = a + ASIDE * (b - a)
        ends = np.append(ends, inner)
        a, b = np.stack([a, inner], axis=1).ravel(), np.stack([inner, b], axis=1).ravel()
    return ends, not missed > UNTOLD * impulse
