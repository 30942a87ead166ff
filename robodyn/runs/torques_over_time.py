"""Torques over time: when expressions switch, and how narrow their features are.

A torque given by an expression is prepared for a run, in three steps.

- A part of time alone that jumps or bends (a comparison, abs, min, max, sign, floor, %) is a
  *switch*.  It changes at zeros of its arguments, the *kinks*: they are found to a few floats,
  steps land on them, and between two of them the switch is constant.
- Zeros and extremes of parts inside of other parts are *points*: at one of them the narrowest pulse
  shows, as exp(-((t - 5)/1e-6)**2) does at 5.
- Between kinks, time is divided into *leaves*, on each of which a polynomial of degree 16 meets
  the torque, at all points too.  No step may be longer than a leaf that it enters.

All zeros and extremes are those of leaves of the part itself, innermost parts first.

A part may have no value at the end of a piece, as sin(t)/t at 0, or exp(-1/(t - 4)) at 4.  There it
is held constant for so short a time that its impulse keeps all digits.

Loads of a scene by expressions in t are treated in the same way.  Rows of a table over t are kinks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import compress, pairwise
from typing import Any, NamedTuple

import numpy as np

from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import Held, switch
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.event_functions import WAYS, part_of, switches_of, values_of
from robodyn.runs.roots import DEGREE, DERIVATIVE, brackets, evaluated
from robodyn.scene.expressions import BENDS, SCOPE, changed, code_of, fold, names_of
from robodyn.scene.scene import Curve, Law, Table, signal_place
from robodyn.scene.syntax import Node
from robodyn.tables.arrays import Array

Function = Callable[[Array], Array]  # of times (k,), (k,)
Values = tuple[float, ...]  # of all switches, in a piece
Scalar = Callable[[float, Values], float]  # of a time in it

SWITCHING = {*WAYS, *BENDS, "if", "%"} - {"atan2"}
NEAR_END = 1e-15  # of the run: a kink nearer to its ends is none
NEAR = 8.0  # spacings of floats: nearer to a kink rounding decides what holds
SMOOTH = 1e-9  # part of the largest value by which a polynomial may miss a function
LEAVES = 32768  # beyond so many, the torque is left to the control of the steps' errors
FOLLOWED = 12_000  # leaves of a part, less half a leaf for each kink: some 24,000 kinks in all
ASIDE = 0.47  # where a leaf is split: where a root begins, no step should
ROUNDED = 1e-15  # of t, or of a value: less is rounding
NEWTON = 4  # steps towards an extreme: it was begun within 0.01 of a leaf
NARROWEST = 1e-10  # of the run, for a leaf
UNTOLD = 1e-7  # part of the impulse that the narrowest leaves may hide
STRETCHES = 10.0 ** -np.arange(3.0, 12.0)  # of the run; the longest that serves is held constant
MOST = 0.3  # of a piece
WITHIN = 0.4372  # of a piece, where switches are seen
SEEN = np.concatenate([[0.003, 0.01, 0.03], np.linspace(0.05, 1.0, 39)])  # of such a stretch
USUAL = np.linspace(0.02, 0.98, 49)  # of a piece, where it is seen how large a torque is
SPREAD = np.arange(1.0, 50.0) * 0.5 * (math.sqrt(5.0) - 1.0) % 1.0  # of a run, in no pattern
LOST = 1e-15  # part of a usual torque times the run that a constant may miss

_k = np.arange(DEGREE + 1)
_angles = np.pi * np.arange(2 * DEGREE + 2, -1, -1) / (2 * DEGREE + 2)
X: Array = np.cos(_angles)  # of a leaf: its ends and, in turn, Chebyshev nodes and places between
SERIES: Array = np.cos(np.outer(_k, _angles))  # T_k (rows) there
FIT: Array = SERIES[:, 1:-1:2].T * ((2.0 - (_k == 0)) / (DEGREE + 1))


def leaves_of(
    functions: Sequence[Function],
    edges: Array,
    points: Array,
    small: float = 0.0,
    most: int = LEAVES,
) -> tuple[tuple[Array, Array, Array] | None, Array, bool]:
    """Return leaves between increasing `edges` on which polynomials meet the functions.

    They meet each to SMOOTH of its largest value or to `small` (N m), at `points` too.  The first
    result is begin (m,), end (m,) and the Chebyshev series (m, DEGREE + 1) of the last function on
    each leaf, or None if `most` leaves do not serve.  Then come the ends of the leaves, in order,
    and whether the leaves resolve the functions.
    """
    a, b, ends, span = edges[:-1], edges[1:], edges, edges[-1] - edges[0]
    known = [f(points) for f in functions]
    largest = [np.abs(x[np.isfinite(x)]).max(initial=0.0) for x in known]
    impulse = missed = 0.0
    leaves: list[tuple[Array, Array, Array]] = []
    while len(a):
        middle, half = 0.5 * (a + b), 0.5 * (b - a)
        t = middle[:, None] + half[:, None] * X[1:-1]
        leaf = np.minimum(np.searchsorted(a, points, "right") - 1, len(a) - 1)
        inside = (points > a[leaf]) & (points < b[leaf])
        good, worst, level = np.ones(len(a), bool), np.zeros(len(a)), np.zeros(len(a))
        rounding = ROUNDED * np.maximum(np.abs(a), np.abs(b)) / (b - a)  # of t, part of a leaf
        for i, f in enumerate(functions):
            values = f(t.ravel()).reshape(t.shape)
            c = values[:, ::2] @ FIT
            size = np.abs(np.where(np.isfinite(values), values, 0.0)).max(axis=1)
            largest[i] = max(largest[i], size.max())
            least = np.maximum(max(SMOOTH * largest[i], small), np.ptp(values, axis=1) * rounding)
            miss = np.abs(c @ SERIES[:, 1:-1] - values).max(axis=1)
            undefined = np.asarray(~np.isfinite(values).any(axis=1))
            good &= (miss <= least) | undefined
            (k,) = np.nonzero(inside & good[leaf])
            at = leaf[k]
            off = np.abs(evaluated(c[at], (points[k] - middle[at]) / half[at]) - known[i][k])
            meets = (off <= least[at]) | (undefined[at] & ~np.isfinite(known[i][k]))
            good[at[~meets]] = False
            np.maximum.at(worst, at, np.where(np.isfinite(off), off, 0.0))
            worst = np.fmax(worst, np.where(np.isfinite(miss), miss, 0.0))
            level = np.maximum(level, size)
        split = ~good & (half > NARROWEST * span)
        leaves.append((a[~split], b[~split], c[~split]))
        missed += float((half * worst)[~good & ~split].sum())
        impulse += float((half * (level + worst))[~split].sum())
        if len(ends) + split.sum() > most:
            return None, np.sort(ends), False
        a, b = a[split], b[split]
        inner = a + ASIDE * (b - a)
        ends = np.append(ends, inner)
        a, b = np.stack([a, inner], axis=1).ravel(), np.stack([inner, b], axis=1).ravel()
    begin, end, c = map(np.concatenate, zip(*leaves, strict=True))
    return (begin, end, c), np.sort(ends), not missed > UNTOLD * impulse


def turns_of(
    f: Function, edges: Array, points: Array, whole: Function | None = None
) -> tuple[Array, Array, Array] | None:
    """Return where a function changes its sign, and its extremes (k,), between the edges.

    A function that becomes zero, or undefined, changes its sign.  The first result (m,) is the
    float beside a change at which the function is smaller, the second (2m,) are both its sides.
    With `whole`, a floor, its changes count too if the sign stays: jumps over two whole numbers.
    None if the function changes too fast.
    """
    leaves, _, _ = leaves_of([f], edges, points, most=FOLLOWED + len(edges) // 2)
    if leaves is None:
        return None
    begin, end, c = leaves
    half = 0.5 * (end - begin)
    varies = np.abs(c[:, 1:]).sum(axis=1) > ROUNDED * np.abs(c[:, 0])
    slopes = c @ DERIVATIVE * varies[:, None]
    rates = slopes @ SERIES
    j, k = np.nonzero(rates[:, :-1] * rates[:, 1:] < 0.0)
    low, high, both = X[k], X[k + 1], np.stack([slopes[j], slopes[j] @ DERIVATIVE])
    x = low - rates[j, k] * (high - low) / (rates[j, k + 1] - rates[j, k])
    for _ in range(NEWTON):
        rate, bend = evaluated(both, x)
        x = np.clip(np.where(bend == 0.0, x, x - rate / bend), low, high)
    extremes = begin[j] + half[j] * (1.0 + x)
    t = (begin + half)[:, None] + half[:, None] * X[1:-1]
    t = np.unique(np.concatenate([t.ravel(), extremes, points]))
    sign, piece = _sign(f(t)), np.searchsorted(edges, t)
    (k,) = np.nonzero((sign[1:] != sign[:-1]) & (piece[1:] == piece[:-1]))
    before, after, first, last = t[k], t[k + 1], sign[k], sign[k + 1]
    middle = before + 0.5 * (after - before)
    sides = brackets(f, lambda x, k: _sign(x) != first[k], before, after, middle)
    (k,) = np.nonzero(_sign(f(sides[1])) != last)  # it stays at zero, to rounding, for a while
    ends, to = (sides[1][k], after[k], middle[k]), last[k]
    later = brackets(f, lambda x, k: _sign(x) == to[k], *ends)
    changes = [sides, later]
    if whole is not None:
        number = _known(whole(t))
        jumps = (number[1:] != number[:-1]) & (sign[1:] == sign[:-1]) & (piece[1:] == piece[:-1])
        (k,) = np.nonzero(jumps)
        ends, level = (t[k], t[k + 1], 0.5 * (t[k] + t[k + 1])), number[k]
        changes.append(brackets(whole, lambda x, k: _known(x) != level[k], *ends))
    low, high, nearer = (np.concatenate(x) for x in zip(*changes, strict=True))
    return nearer, np.concatenate([low, high]), extremes


def _sign(values: Array) -> Array:
    return _known(np.sign(values))


def _known(values: Array) -> Array:
    """Return values with a number in place of nan, which is equal to nothing."""
    return np.where(np.isnan(values), 0.5, values)


def over_run(
    mechanism: Mechanism, actuation: Actuation, state: Array, t_end: float, atol: float = 0.0
) -> Actuation:
    """Prepare torques and loads for a run from `state` (2n,): see `over_a_run`.

    A torque that moves the lightest link by less than `atol` may be missed.  Raises InputError if
    the rows of a table do not cover the run, or if a torque switches too often.
    """
    if not t_end or not (actuation.lines or mechanism.timed):
        return actuation
    small = float(atol * min(mechanism.inertias.values(), default=0.0) / abs(t_end))
    if actuation.lines:
        actuation = over_a_run(actuation, state, t_end, small)
    if not mechanism.timed:
        return actuation
    first, last = min(0.0, t_end), max(0.0, t_end)
    times: set[float] = set()
    jumps = set(actuation.jumps)
    torques: list[Node] = []
    laws = (mechanism.rows[r].law for r in mechanism.driven)
    for signal in (*mechanism.signals, *filter(None, laws)):
        if isinstance(signal, Law) and "t" in signal.names:
            torques.append(signal.node)
        elif isinstance(signal, Curve) and signal.repeats and signal.over == "t":
            times.update(_repeated(signal.x, first, last))
        elif isinstance(signal, (Table, Curve)) and signal.over == "t":
            if signal.x[0] > first or signal.x[-1] < last:
                span = f"{signal.x[0]:g} to {signal.x[-1]:g} s"
                limit = f"the rows of {signal.file} must cover the simulation, {first:g} to "
                place = _place_of(mechanism, signal)
                raise InputError(
                    place, where=mechanism.source, value=span, limit=f"{limit}{last:g} s"
                )
            times.update(t for t in signal.x if first < t < last)
            if isinstance(signal, Table):
                jumps.update(t for t in signal.lines.jumps if first < t < last)
    loads = over_a_run(Actuation.of(torques), state, t_end, small)
    leaves = {*actuation.leaves, *loads.leaves}
    if actuation.control is not None:  # it takes kinks for samples
        leaves.update({abs(t) for t in times} | {0.0, abs(t_end)} if times else set())
        times = set()
    else:
        times.update(loads.kinks)
    return replace(
        actuation,
        kinks=tuple(sorted({*actuation.kinks, *times})) if times else actuation.kinks,
        jumps=tuple(sorted(jumps)),
        leaves=tuple(sorted(leaves)),
        resolved=actuation.resolved and loads.resolved,
    )


def _place_of(mechanism: Mechanism, signal: Table | Curve) -> str:
    """Return the place of a table in the scene."""
    if isinstance(signal, Table):
        return signal_place(mechanism.description, signal)
    laws = [x.law for x in mechanism.description.couplings]
    return f"couplings[{next(c for c, law in enumerate(laws) if law is signal)}]"


def _repeated(x: Sequence[float], first: float, last: float) -> Iterator[float]:
    """Yield the times of a repeating table's rows within a run."""
    span = x[-1] - x[0]
    for k in range(math.floor((first - x[0]) / span), math.ceil((last - x[0]) / span) + 1):
        yield from (t for row in x[:-1] if first < (t := row + k * span) < last)


def over_a_run(
    actuation: Actuation, state: Sequence[float] | Array, t_end: float, small: float = 0.0
) -> Actuation:
    """Return the torques with kinks and leaves from 0 to `t_end`.

    `state` (2n,) is that at the start; parts that depend on time and state are followed with it
    fixed.  A torque below `small` (N m) may be missed.  Torques that are no expressions of time are
    returned unchanged.  Raises InputError for torques that switch too often.
    """
    if actuation.pieces is not None or actuation.leaves or not math.isfinite(t_end) or not t_end:
        return actuation
    try:
        prepared = _prepared(actuation.torques, tuple(map(float, state)), float(t_end), small)
    except (RecursionError, MemoryError):  # too deep an expression: as it is
        return actuation
    if prepared is None:
        return actuation
    over = replace(
        actuation, leaves=prepared.leaves, resolved=prepared.resolved, original=actuation
    )
    if not prepared.values[0]:  # no switch
        return over
    pieces, held = Held(prepared.kinks, prepared.values), Actuation.of(prepared.torques)
    return replace(
        over,
        lines=("_s = _piece(t)", *held.lines),
        torques=held.torques,
        scope={**_SCOPE, "_piece": pieces.at},
        kinks=prepared.kinks,
        pieces=pieces,
    )


class _Prepared(NamedTuple):
    """Torques with switches held, kinks, switch values per piece, and leaves."""

    torques: tuple[Node, ...]
    kinks: tuple[float, ...]
    values: list[Values]
    leaves: tuple[float, ...]
    resolved: bool  # by the leaves


@lru_cache(maxsize=16)
@np.errstate(all="ignore")
def _prepared(
    torques: tuple[Node, ...], state: tuple[float, ...], t_end: float, small: float
) -> _Prepared | None:
    """Return switches and leaves of torques from 0 to `t_end`; None if they do not depend on time.

    Raises InputError for torques that switch too often.
    """
    parts = _TimeParts()
    written = [parts.write(torque) for torque in torques]
    if not parts.timed:
        return None
    n, y = len(state) // 2, np.array(state)

    def function(tree: Node) -> Function:
        values = values_of(tree, n)
        return lambda t: values(t, np.broadcast_to(y, (len(t), 2 * n)))

    edges, points = np.array([min(0.0, t_end), max(0.0, t_end)]), np.zeros(0)
    spread = edges[0] + np.ptp(edges) * SPREAD
    for part, switch_of in parts.sought.items():
        decides, own = switch_of is not None, part_of(part, n)
        whole = function(switch_of) if switch_of is not None and switch_of[0] == "floor" else None
        t = np.concatenate([spread, points])  # and where narrow features are
        at = np.broadcast_to(y, (len(t), 2 * n))
        off = own.noise(t[None], at[None], np.abs(y)[None])
        if whole is None and off.any() and (np.abs(own.values(t, at)) <= off).all():
            continue  # what is zero but for rounding, as the difference of 0.1 t + 0.2 t and 0.3 t
        turns = turns_of(function(part), edges, _inside(points, edges), whole)
        if turns is None and decides:
            limit = f"switches too often, over some 20,000 times from 0 to {t_end:g} s"
            raise InputError("tau", limit=f"{limit}; take a slower torque or a shorter time")
        if turns is None:  # what is smooth is left to the control of the steps' errors
            continue
        changes, *others = turns
        if decides:
            edges = _with_kinks(edges, changes)
        else:
            points = np.unique(np.concatenate([points, *others]))
    functions, near = [function(x) for x in parts.functions], NEAR * np.spacing(np.abs(points))
    holes = np.zeros(len(points), bool)
    for f in functions:  # undefined at a point, but not beside it
        here, before, after = (np.isfinite(f(t)) for t in (points, points - near, points + near))
        holes |= ~here & before & after
    hole, points = points[holes], _inside(points, edges)
    switches = [_scalar(x) for x in parts.switches]
    values = [tuple(f(t, ()) for f in switches) for t in _within(edges)]
    switched = [a != b for a, b in pairwise(values)]
    values = [values[0], *compress(values[1:], switched)]
    edges = edges[[True, *switched, True]]
    edges, values = _finer(edges, values, _with_kinks(edges, hole))
    constants: dict[Node, Node] = {}
    for held in parts.held:
        stretches = list(_undefined(_scalar(held), edges, values, points))
        if stretches:
            k = len(values[0])
            constants[held] = "if", ("int", switch(k)), switch(k + 1), held
            sides = [t for low, high, _ in stretches for t in (low, high)]
            edges, values = _finer(edges, values, np.unique([*edges, *sides]))
            each = [
                next(((1.0, x) for a, b, x in stretches if a < t < b), (0.0, 0.0))
                for t in _within(edges)
            ]
            values = [(*x, *one) for x, one in zip(values, each, strict=True)]
    _, ends, resolved = leaves_of(functions, edges, _inside(points, edges), small)
    made = tuple(changed(torque, lambda x: constants.get(x, x)) for torque in written)
    leaves = tuple(np.sort(np.abs(ends)).tolist())
    return _Prepared(made, tuple(edges[1:-1].tolist()), values, leaves, resolved)


def _within(edges: Array) -> list[float]:
    """Return a time in each piece; not the middle, where an extreme may be."""
    within: list[float] = (edges[:-1] + WITHIN * np.diff(edges)).tolist()
    return within


def _finer(edges: Array, values: list[Values], finer: Array) -> tuple[Array, list[Values]]:
    """Return finer edges, and for the pieces between them the values of those that hold them."""
    at = np.searchsorted(edges, _within(finer)) - 1
    return finer, [values[k] for k in at.tolist()]


def _inside(points: Array, edges: Array) -> Array:
    """Return both sides of each edge, and the points that are not as near to one of them."""
    near = NEAR * np.spacing(np.abs(edges).max())
    t = np.unique(np.concatenate([points, edges[:-1] + near, edges[1:] - near]))
    clear = np.searchsorted(edges + 0.5 * near, t) == np.searchsorted(edges - 0.5 * near, t)
    return np.asarray(t[clear])


def _with_kinks(edges: Array, times: Array) -> Array:
    """Return the edges with kinks at times (k,), one where rounding does not tell them apart.

    If rounding does not tell it from a short decimal, that is the kink.
    """
    first, last = edges[0], edges[-1]
    far = NEAR_END * (last - first)
    t = np.unique(np.concatenate([edges, times]))
    t = t[(t > first + far) & (t < last - far)]
    t = t[np.diff(t, prepend=-np.inf) > NEAR * np.spacing(np.abs(t))]
    short = np.array([float(f"{x:.13g}") for x in t.tolist()])
    kinks = np.where(np.abs(short - t) <= 2.0 * np.spacing(np.abs(t)), short, t)
    return np.concatenate([[first], kinks, [last]])


def _undefined(
    value: Scalar, edges: Array, values: Sequence[Values], points: Array
) -> Iterator[tuple[float, float, float]]:
    """Yield stretches (begin, end) beside edges where an expression has no value, and a constant.

    The constant replaces the expression there, and no digit of its impulse changes.
    """
    span = edges[-1] - edges[0]
    for a, b, stand in zip(edges[:-1].tolist(), edges[1:].tolist(), values, strict=True):
        for edge, way in ((a, 1.0), (b, -1.0)):
            if math.isfinite(value(edge, stand)):
                continue
            usual = np.abs([value(t, stand) for t in edge + way * MOST * (b - a) * USUAL])
            least = LOST * span * np.quantile(np.where(np.isfinite(usual), usual, 0.0), 0.8)
            for stretch in span * STRETCHES[span * STRETCHES <= MOST * (b - a)]:
                low, high = sorted((edge, float(edge + way * stretch)))
                x = [value(t, stand) for t in (edge + way * stretch * SEEN).tolist()]
                within = points[(points > low) & (points < high)].tolist()
                x += [y for t in within if math.isfinite(y := value(t, stand))]
                if np.ptp(x) * stretch <= least:
                    yield low, high, x[len(SEEN) // 2]
                    break


def _scalar(tree: Node) -> Scalar:
    """Return an expression as a function of a time and of the values of switches."""
    function = eval(f"lambda t, _s: {code_of(tree)}", {"__builtins__": {}, **_SCOPE})

    def value(t: float, stand: Values) -> float:
        try:
            return float(function(t, stand))
        except (ArithmeticError, ValueError):
            return math.nan

    return value


_SCOPE: dict[str, object] = {
    **SCOPE,
    "_int": int,
    "_min_at": lambda *x: x.index(min(x)),
    "_max_at": lambda *x: x.index(max(x)),
    # no switch is asked: a kink is off by some floats, and abs(x) may not be negative there
    "_abs_of": lambda sign, x: abs(x),
    "_min_of": lambda k, *x: min(x),
    "_max_of": lambda k, *x: max(x),
}


class _TimeParts:
    """Collects parts that depend on time alone; writes them with switches held (`_s[k]`)."""

    def __init__(self) -> None:
        self.timed = False  # whether there are any
        # whose zeros and extremes matter, innermost first, and the switches that they decide
        self.sought: dict[Node, tuple[Any, ...] | None] = {}
        self.switches: list[Node] = []  # whose values are whole numbers
        self.functions: list[Node] = []  # that must be resolved: torques, and of time alone
        self.held: list[Node] = []  # the largest parts of time alone, as they are written

    def write(self, torque: Node) -> Node:
        """Return the torque with its switches held."""
        written, kind = fold(torque, _kind, self._write)
        if kind:
            self.functions.append(torque)
        if kind == 1:
            self.held.append(written)
        return written

    def _write(self, node: tuple[Any, ...], folded: list[tuple[Node, int]]) -> tuple[Node, int]:
        """Return the written operation, and what it depends on (`_kind`)."""
        operation, *parts = node
        written, kinds = [x for x, _ in folded], [kind for _, kind in folded]
        kind = max(kinds)
        decides: dict[Node, tuple[Any, ...]] = {}
        if operation in ("floor", "%"):
            x: Node = ("/", *parts) if operation == "%" else parts[0]
            decides[_whole(x)] = "floor", x
        elif operation in SWITCHING:
            decides = {x: ("sign", x) for x in switches_of(*node)}
        self.sought |= {x: switch for x, switch in decides.items() if names_of(x) == {"t"}}
        compares = type(parts[0]) is tuple and parts[0][0] in WAYS
        if operation == "if" and kinds[0] + compares < 2:
            written[0] = "int", self._switch(("abs", ("sign", parts[0])))
        if kind == 1:
            self.timed = True
            scaled = (operation == "*" and 0 in kinds) or (operation == "/" and not kinds[1])
            linear = scaled or operation in ("neg", "+", "-")
            if operation not in SWITCHING and not linear:
                for part in parts:
                    if type(part) is tuple and names_of(part):
                        self.sought.setdefault(part, None)
            return self._held(node, written), 1
        if kind == 2:
            for part, held, each in zip(parts, written, kinds, strict=True):
                if each == 1 and type(part) is tuple:
                    self.functions.append(part)
                    self.held.append(held)
        return (operation, *written), kind

    def _held(self, node: tuple[Any, ...], x: list[Node]) -> Node:
        """Return a node of time alone, from its written parts, between kinks."""
        operation, *parts = node
        match operation:
            case "<" | "<=" | ">" | ">=":
                return "int", self._switch(node)  # an error where it is undefined
            case "%":
                turns = "/", ("-", parts[0], node), parts[1]
                return "-", x[0], ("*", x[1], self._switch(("floor", ("+", turns, 0.5))))
            case "sign" | "floor":
                return self._switch(node)
            case "abs":
                return "abs_of", self._switch(("sign", *parts)), *x
            case "min" | "max":
                return f"{operation}_of", self._switch((f"{operation}_at", *parts)), *x
        return operation, *x

    def _switch(self, node: Node) -> str:
        self.switches.append(node)
        return switch(len(self.switches) - 1)


def _whole(x: Node) -> Node:
    """Return a tree that changes its sign at whole x, where it is 0: (-1)^n sin(pi (x - n))."""
    n = "floor", ("+", x, 0.5)
    return "*", ("cos", ("*", math.pi, n)), ("sin", ("*", math.pi, ("-", x, n)))


def _kind(leaf: float | str) -> tuple[Node, int]:
    """Return a leaf, and what it depends on: 0 nothing, 1 time alone, 2 the state."""
    return leaf, 0 if not isinstance(leaf, str) else 1 if leaf == "t" else 2
