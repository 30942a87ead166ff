"""The path of all joints of a mechanism whose actuated joints follow a given path.

The passive joints are continued along the path of the actuated ones.  A step is predicted by its
Taylor series and corrected by Newton's method with the actuated joints held.  It is shortened if
the correction, or the change of the rates, suggests that it left the branch.  The accepted states
are nodes, between which states are interpolated and corrected by Newton's method.  Within STEP of a
change point that the path crosses, states are interpolated to order 12 from both sides.

A path at constant speed is followed until all joints stand as at its start, up to full turns; from
there on it repeats itself.

If det Psi_p (of the passive columns) changes sign between two nodes there is a change point, at
which two branches meet; the path goes straight on.  If two branches only come close, the sign
changes because of a leap: the step is shortened until it stays on its branch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.engines.factors import svd
from robodyn.errors import AssemblyError, InputError
from robodyn.loops.assembly import CLOSED
from robodyn.loops.change_points import OFFSETS, lagrange, miss_remark, nearest_singular
from robodyn.loops.closing import close_positions, loop_size
from robodyn.loops.closures import closure_bias, closure_drift, closure_gap, scaled_jacobian
from robodyn.loops.loop_rates import loop_accelerations, loop_velocities
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array, Truth
from robodyn.trajectories.joint_paths import ConstantSpeed, JointPath, Pieces, Values, travels

Watch = Callable[[float], object]  # how far a path is followed

TRAVEL = 0.1  # rad, the most that a joint moves between two nodes
CORRECTION = 0.01  # rad, the most that Newton's method may correct a prediction
FIRST_STEP = 1 / 64  # of a piece
LEAST_NODES = 7  # of a piece: steps grow from that by a factor of 1.7 at most
LEAST_STEP = 1e-11  # in u, below which the path has ended
MOST_NODES = 500_000
LARGE = 10.0  # m of a scene; in larger ones displacements are told in tenths of its size
FURTHEST = 1e9  # rad, beyond which a float's angle is known to 1e-7 at best
JUDGED = 300  # nodes after which it is foreseen how many a path takes
RETURNED = 1e-6  # rad, by which joints that stand as at the start may miss it
NEAR = 1e-3  # and below this part one is near
DEAD = 1e-5  # a least singular value below this part of the loop's size is at a singular point
TOGETHER = 1e-5  # rad, how far apart states on both sides of a change point may be, at 1e-8 in u
STUCK = {
    "change point": (
        "too near a change point to tell the branches apart: end before it, or run across"
    ),
    "dead centre": "that is as far as they can be closed on this branch",
}


class PathEndError(AssemblyError):
    """The loops cannot be closed beyond `u` of the path: a dead centre or change point."""

    def __init__(
        self, mechanism: Mechanism, u: float, q: Array, reason: str, kind: str = "dead centre"
    ) -> None:
        self.u, self.q, self.kind = u, q, kind

        def shown(k: int) -> str:
            slides = k in mechanism.slides
            return f"{q[k]:.6g} m" if slides else f"{q[k]:.6g} rad ({np.degrees(q[k]):.6g} deg)"

        named = ((f"q{k + 1} ({mechanism.link_names[k]})", k) for k in mechanism.actuated)
        at = ", ".join(f"{name} = {shown(k)}" for name, k in named)
        what = f"the loops cannot be followed beyond {at}"
        super().__init__(what, where=mechanism.source, limit=reason)


class TravelError(InputError):
    """A path is too long for a mechanism with loops."""

    def __init__(self, mechanism: Mechanism, value: str, limit: str) -> None:
        super().__init__("the path", where=mechanism.source, value=value, limit=limit)


class Clock(NamedTuple):
    """The times t = begin + u duration (s) of a path, at which laws of time are taken."""

    begin: float = 0.0
    duration: float = 1.0

    def at(self, u: Array | float) -> Array:
        """Return the times (...) at u (...)."""
        return np.asarray(self.begin + np.asarray(u) * self.duration)


@dataclass(frozen=True, slots=True)
class Nodes:
    """Closed states along a path: N intervals between N + 1 nodes, n joints.

    They cover 0 to `period`.  A longer path repeats itself, with its joints (n,) advanced by `rise`
    in each period.
    """

    u: Array  # (N + 1,)
    q: Array  # (N + 1, n)
    begins: Array  # (N, n), q' at the beginning of each interval
    ends: Array  # (N, n), and at its end
    pieces: Pieces  # (N,)
    crossings: tuple[tuple[float, float], ...]  # u of change points, and the largest |q'| there
    period: float
    rise: Array


class _Node(NamedTuple):
    u: float
    q: Array
    q1: Array
    q2: Array
    sign: float  # of det Psi_p; 0 where that is none


def corrected(mechanism: Mechanism, q: Array, t: ArrayLike) -> tuple[Array, Truth]:
    """Close q (T, n) by Newton's method at times t (T,) with the actuated joints held.

    Returns the states and which of them close (T,).
    """
    q = close_positions(mechanism, q, mechanism.actuated, t=t)
    gap = np.abs(closure_gap(mechanism, q, t)).max(axis=-1, initial=0.0)
    turns = np.abs(q).max(axis=-1, initial=1.0)  # couplings count them
    return q, gap <= 1e-3 * CLOSED * loop_size(mechanism) * turns


def hermite(x: Array, h: Array, begin: Array, begin1: Array, end: Array, end1: Array) -> Array:
    """Return the cubic at fractions x of intervals of length h, from end values and slopes."""
    y = 1.0 - x
    rise = (1.0 + 2.0 * x) * y * y * begin + x * x * (3.0 - 2.0 * x) * end
    return rise + x * y * h * (y * begin1 - x * end1)


class Follower:
    """Finds the nodes of one path; `watch` is called with its progress."""

    def __init__(
        self, mechanism: Mechanism, path: JointPath, watch: Watch, clock: Clock = Clock()
    ) -> None:
        self.mechanism, self.path, self.watch, self.clock = mechanism, path, watch, clock
        self._actuated, self._passive = list(mechanism.actuated), list(mechanism.passive)
        self._square = len(self._passive) == len(mechanism.rows)
        self._units = np.maximum(1.0, mechanism.arrays.units / LARGE)
        self._unit = float(self._units[self._actuated].max(initial=1.0))
        self._crossings: list[tuple[float, float]] = []
        # laws of the time need not repeat themselves
        self._returns: list[float] = [] if mechanism.driven else path.returns().tolist()
        self._least_nodes = np.zeros(1)  # up to each break, as the actuated joints move

    def nodes(self, start: Array) -> Nodes:
        """Return the nodes from the closed state `start` (n,) on.

        Raises PathEndError if the loops cannot be closed on the whole path or the actuated joints
        do not determine the others, and TravelError if the path needs too many nodes.
        """
        here, closed = corrected(self.mechanism, start[None], self.clock.begin)
        first, q, u = here[0], here[0], 0.0
        if not closed[0]:
            raise self._ends(u, q, "the start does not close")
        taken: list[tuple[_Node, _Node, int]] = []  # the ends of each interval, and its piece
        self._check_travel()
        stops = [(piece, end) for piece, end in enumerate(self.path.breaks[1:].tolist())]
        stops[:0] = [(0, at) for at in self._returns]
        least = LEAST_STEP * stops[0][1] if self._returns else LEAST_STEP
        rise = np.zeros_like(q)
        for piece, end in stops:
            node = self._node(u, q, piece, self._held(u, piece))
            if node is None or (self._square and not node.sign):
                kind = self._kind(u, q, DEAD)
                reason = f"a {kind}, from which the passive joints can go on in two ways"
                raise self._ends(u, q, reason)
            h, moved = FIRST_STEP * (end - u), 0.0
            while node.u < end:
                left = end - node.u
                step = left if left <= 1.001 * h else min(h, 0.5 * left)
                found = self._step(node, end if step == left else node.u + step, piece)
                if found is None:
                    h = 0.4 * step
                    if h < least:
                        raise self._ends(node.u, node.q, STUCK[self._kind(node.u, node.q, NEAR)])
                    continue
                easy, following = found
                taken.append((node, following, piece))
                fastest = self._largest(following.q1)
                longest = 0.9 * TRAVEL / fastest if fastest > 0.0 else np.inf
                h = min(1.7 * step if easy else step, max(longest, 0.1 * step))
                moved += self._largest(following.q - node.q, self._actuated)
                self._check_number(len(taken) + 1, following.u, piece, moved)
                node = following
                self.watch(node.u)
            u, q = node.u, node.q
            whole = 2 * np.pi * np.round((q - first) / (2 * np.pi))
            whole[list(self.mechanism.slides)] = 0.0
            if u in self._returns and self._largest(q - first - whole) < RETURNED:
                rise = whole
                break
        begins, ends, pieces = zip(*taken, strict=True)
        return Nodes(
            u=np.array([0.0, *(node.u for node in ends)]),
            q=np.array([first, *(node.q for node in ends)]),
            begins=np.array([node.q1 for node in begins]),
            ends=np.array([node.q1 for node in ends]),
            pieces=np.array(pieces),
            crossings=tuple(self._crossings),
            period=u,
            rise=rise,
        )

    def _check_travel(self) -> None:
        """Raise TravelError for a path that is too long, before following it."""
        travel, pieces = self.path.travel / self._unit, len(self.path.breaks) - 1
        if travel > FURTHEST:
            limit = f"must be at most {FURTHEST:g} rad: angles are not exact enough beyond"
            raise TravelError(self.mechanism, f"{self.path.travel:.6g} rad", limit)
        if pieces > MOST_NODES // LEAST_NODES:
            limit = f"must be at most {MOST_NODES // LEAST_NODES:,} from point to point"
            raise TravelError(self.mechanism, f"{pieces} pieces", limit)
        if self._returns:
            return
        if travel <= MOST_NODES * TRAVEL:
            moves = travels(self.path, self.path.breaks) / (self._unit * TRAVEL)
            self._least_nodes = np.append(0.0, np.cumsum(np.maximum(moves, LEAST_NODES)))
        if max(travel / TRAVEL, self._least_nodes[-1]) > MOST_NODES:
            raise self._too_many()

    def _check_number(self, nodes: int, u: float, piece: int, moved: float) -> None:
        """Raise TravelError for too many nodes, or if too many are foreseen.

        `moved` is the travel in the present piece, rad.
        """
        done, least = u, self._least_nodes
        if not self._returns:
            done = min(least[piece] + moved / TRAVEL, least[piece + 1]) / least[-1]
        # what is foreseen from few nodes is known less well
        judged = nodes >= JUDGED and u >= max(self._returns, default=0.0)
        if nodes > MOST_NODES or (
            judged and nodes > (1.0 + 0.5 * JUDGED / nodes) * MOST_NODES * done
        ):
            raise self._too_many()

    def _too_many(self) -> TravelError:
        text = f"takes more than the {MOST_NODES:,} closed states that are kept"
        if isinstance(self.path, ConstantSpeed):
            text += ", as it does not repeat itself after a few turns"
        return TravelError(self.mechanism, f"{self.path.travel:.6g} rad", text)

    def _step(self, node: _Node, there: float, piece: int) -> tuple[bool, _Node] | None:
        """Return whether the step to `there` was easy, and its node; None if it is too long."""
        h = there - node.u
        held = self._held(there, piece)
        guess = node.q + h * node.q1 + 0.5 * h**2 * node.q2
        guess[self._actuated] = held[0]
        if self._largest(guess - node.q) > TRAVEL:
            return None
        (q,), closed = corrected(self.mechanism, guess[None], self.clock.at(there))
        miss = self._largest(q - guess)
        if not closed[0] or miss > CORRECTION or self._largest(q - node.q) > TRAVEL:
            return None
        found = self._node(there, q, piece, held)
        if found is None:
            return None
        bend = h * self._largest(found.q1 - node.q1 - h * node.q2, self._passive)
        if bend > 3 * CORRECTION:
            return None
        if node.sign * found.sign < 0.0 and not self._crosses(node, found, piece):
            return None
        return max(miss, bend / 3) < 0.2 * CORRECTION, found

    def _node(self, u: float, q: Array, piece: int, held: Array) -> _Node | None:
        """Return the node of state q with q', q''; None if they are undetermined."""
        q1, q2 = np.zeros_like(q), np.zeros_like(q)
        q1[self._actuated], q2[self._actuated] = held[1], held[2]
        if not self._passive:
            return _Node(u, q, q1, q2, 0.0)
        t, T = float(self.clock.at(u)), self.clock.duration
        Psi = scaled_jacobian(self.mechanism, q, t)
        columns, driving = Psi[:, self._passive], Psi[:, self._actuated]
        units = self.mechanism.arrays.units
        driving = driving / units[self._actuated]
        U, s, Vt = svd(columns)
        if s[-1] <= DEAD * loop_size(self.mechanism) and not self._misses(q):
            return None
        inverse = units[self._passive, None] * ((Vt.T / s) @ U.T)
        opening = driving @ held[1]
        if self.mechanism.driven:
            opening += T * closure_drift(self.mechanism, q, t)
        q1[self._passive] = -inverse @ opening
        bias = T * T * closure_bias(self.mechanism, q, q1 / T, t)
        q2[self._passive] = -inverse @ (driving @ held[2] + bias)
        return _Node(u, q, q1, q2, self._sign(columns))

    def _crosses(self, one: _Node, other: _Node, piece: int) -> bool:
        """Return whether the path goes straight on where det Psi_p changes sign."""
        low, high = (one.u, one.q), (other.u, other.q)
        h = other.u - one.u
        while high[0] - low[0] > max(1e-8 * h, 4 * np.spacing(other.u)):
            middle = 0.5 * (low[0] + high[0])
            x, length = np.array((middle - one.u) / h), np.array(h)
            guess = hermite(x, length, one.q, one.q1, other.q, other.q1)
            guess[self._actuated] = self._held(middle, piece)[0]
            found, closed = corrected(self.mechanism, guess[None], self.clock.at(middle))
            if not closed[0]:
                return False
            t = float(self.clock.at(middle))
            columns = scaled_jacobian(self.mechanism, found[0], t)[:, self._passive]
            before = self._sign(columns) == one.sign
            low, high = ((middle, found[0]), high) if before else (low, (middle, found[0]))
        if self._largest(high[1] - low[1]) > TOGETHER or self._misses(low[1]):
            return False
        fastest = max(self._largest(node.q1) for node in (one, other))
        self._crossings.append((0.5 * (low[0] + high[0]), fastest))
        return True

    def _largest(self, way: Array, joints: Sequence[int] | slice = slice(None)) -> float:
        """Return the largest displacement, or rate, of the joints, rad."""
        return float(np.abs(way / self._units)[joints].max(initial=0.0))

    def _misses(self, q: Array) -> bool:
        """Return whether q is near a singular configuration that is no change point."""
        near = nearest_singular(self.mechanism, q)
        return near is not None and not near.crosses

    def _kind(self, u: float, q: Array, near: float) -> str:
        """Return what ends a path at q: "dead centre" or "change point".

        Psi counts as singular if s/L is below `near`.
        """
        t = float(self.clock.at(u))
        s = np.linalg.svd(scaled_jacobian(self.mechanism, q, t), compute_uv=False)
        return "dead centre" if s[-1] / loop_size(self.mechanism) > near else "change point"

    def _sign(self, columns: Array) -> float:
        return float(np.linalg.slogdet(columns)[0]) if self._square else 0.0

    def _held(self, u: float, piece: int) -> Array:
        """Return p, p', p'' of the actuated joints, (3, m)."""
        return np.array(self.path.evaluate(np.array([u]), np.array([piece])))[:, 0]

    def _ends(self, u: float, q: Array, reason: str) -> PathEndError:
        driven, freedoms = len(self._actuated), self.mechanism.n - len(self.mechanism.rows)
        if driven > freedoms:
            reason = f"{driven} joints are actuated, more than the freedoms ({freedoms}), so "
            reason += "their angles depend on one another"
        return PathEndError(self.mechanism, u, q, reason, self._kind(u, q, NEAR))


Columns = Callable[[Array, Pieces], Array]  # values (T, columns) at u (T,) of these pieces
Samples = tuple[Array, Pieces]  # u (T,) and the piece of each

STEP = 0.03  # rad of the fastest joint, between the states that lead across a change point
FEWEST = 64  # samples of a path of few pieces
MOST_SAMPLES = 1_000_000
ROUNDS = 13  # of the search between samples: each makes the interval four times shorter
MOST_PLACES = 64  # of one column, at which to search
BLOCK = 20_000  # samples evaluated at once


class WholePath(JointPath):
    """The path of all joints of a mechanism that follows a path of its actuated joints.

    This class serves a mechanism without loops in which every joint is actuated.
    """

    def __init__(self, mechanism: Mechanism, path: JointPath) -> None:
        self.mechanism, self.path, self.breaks = mechanism, path, path.breaks

    def within(self, u: Array, piece: Pieces) -> Values:
        """Return q, q', q'' of all joints at u (T,), each (T, n), from the given pieces."""
        return self.path.within(u, piece)

    def driven(self, u: Array, piece: Pieces) -> Values:
        """Return p, p', p'' of the actuated joints, (T, m) each."""
        return self.path.evaluate(u, piece)

    def peaks(self) -> Array:
        """Return the largest |q'| and |q''| of each actuated joint, (2, m)."""
        pieces = len(self.breaks) - 1
        counts = np.full(pieces, max(8, FEWEST // pieces))
        return self.largest(samples(self.breaks, np.arange(pieces), counts))

    def largest(self, grid: Samples) -> Array:
        """Return the largest |q'| and |q''| of each actuated joint between samples, (2, m)."""

        def of(order: int, joint: int) -> float:
            return largest(lambda *at: self.driven(*at)[order][:, [joint]], grid)

        joints = range(len(self.mechanism.actuated))
        return np.array([[of(order, joint) for joint in joints] for order in (1, 2)])

    def grid(self) -> Samples:
        """Return samples (u, piece) close enough to follow the path, with all ends of pieces."""
        edges = self.path.breaks
        if len(returns := self.path.returns()):
            edges = np.array([0.0, returns[0]])
        pieces = len(edges) - 1
        counts = np.full(pieces, max(8.0, FEWEST // pieces))
        if counts.sum() <= MOST_SAMPLES:
            counts = np.maximum(np.ceil(travels(self.path, edges) / (0.5 * TRAVEL)), counts)
        if not counts.sum() <= MOST_SAMPLES:
            limit = f"takes more than the {MOST_SAMPLES:,} samples in which limits are looked for"
            raise TravelError(self.mechanism, f"{self.path.travel:.6g} rad", limit)
        found = samples(edges, np.arange(pieces), counts.astype(int))
        return _repeated(*found, float(edges[-1]))


class LoopPath(WholePath):
    """The path of all joints of a mechanism with passive joints, from the closed state `start`.

    Raises PathEndError if the loops cannot be closed on the whole path, or if the actuated joints
    do not determine the others.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        path: JointPath,
        start: Array,
        watch: Watch = lambda u: None,
        clock: Clock = Clock(),
    ) -> None:
        super().__init__(mechanism, path)
        self.clock = clock
        self._nodes = Follower(mechanism, path, watch, clock).nodes(start)

    @property
    def remark(self) -> str:
        """A remark if the loops nearly miss a change point on the way, else ""."""
        return miss_remark(self.mechanism, self._nodes.q)

    def within(self, u: Array, piece: Pieces) -> Values:
        """Return q, q', q''; raise SingularError if the actuated joints are not sufficient."""
        result = [np.zeros((len(u), self.mechanism.n)) for _ in range(3)]
        direct = np.ones(len(u), bool)
        period = self._nodes.period
        for at, fastest in self._nodes.crossings:
            of = int(np.flatnonzero((self.breaks[:-1] <= at) & (at <= self.breaks[1:]))[0])
            begin, end = self.breaks[of : of + 2].tolist()
            if at + period <= end:  # of a path that repeats itself: there is room on both sides
                at += period
            offsets, step = _beside(at, STEP / fastest, begin, end)
            turn = np.round((u - at) / period) * (period < 1.0)
            off = u - at - turn * period
            near = np.flatnonzero(direct & (piece == of) & (np.abs(off) < 0.5 * step))
            if len(near):
                beside = self._closed(at + step * offsets, np.full(len(offsets), of))
                weights = lagrange(offsets, off[near] / step)
                held = self.path.evaluate(u[near], piece[near])
                for values, known, given in zip(result, beside, held, strict=True):
                    values[near] = weights @ known
                    if known is beside[0]:
                        values[near] += turn[near, None] * self._nodes.rise
                    values[near[:, None], list(self.mechanism.actuated)] = given
                direct[near] = False
        if direct.any():
            closed = self._closed(u[direct], piece[direct])
            for values, found in zip(result, closed, strict=True):
                values[direct] = found
        return result[0], result[1], result[2]

    def grid(self) -> Samples:
        pieces = self._nodes.pieces
        per_piece = np.bincount(pieces, minlength=len(self.path.breaks) - 1)
        least = max(8, FEWEST // len(per_piece))
        share = np.maximum(4, np.ceil(least / np.maximum(per_piece, 1))).astype(int)
        found = samples(self._nodes.u, pieces, share[pieces])
        return _repeated(*found, self._nodes.period)

    def _closed(self, u: Array, piece: Pieces) -> Values:
        nodes = self._nodes
        p, p1, p2 = self.path.evaluate(u, piece)
        turn = np.clip(np.floor(u / nodes.period), 0, _last_turn(nodes.period))
        v = u - turn * nodes.period
        k = np.clip(np.searchsorted(nodes.u, v, side="right") - 1, 0, len(nodes.u) - 2)
        h = (nodes.u[k + 1] - nodes.u[k])[:, None]
        x = (v - nodes.u[k])[:, None] / h
        q = hermite(x, h, nodes.q[k], nodes.begins[k], nodes.q[k + 1], nodes.ends[k])
        q += turn[:, None] * nodes.rise
        q[:, self.mechanism.actuated] = p
        t, T = self.clock.at(u), self.clock.duration
        q, closed = corrected(self.mechanism, q, t)
        if not closed.all():
            worst = int(np.argmin(closed))
            reason = f"they are open at u = {u[worst]:.9g} between two closed states"
            raise PathEndError(self.mechanism, float(u[worst]), q[worst], reason)
        qd = loop_velocities(self.mechanism, q, p1 / T, t)
        return q, T * qd, T * T * loop_accelerations(self.mechanism, q, qd, p2 / (T * T), t)


def _beside(at: float, step: float, begin: float, end: float) -> tuple[Array, float]:
    """Return offsets around `at`, in units of the returned step, within [begin, end].

    They lie on both sides if there is room, else more of them on one side.
    """
    count = len(OFFSETS)
    step = min(step, (end - begin) / (count + 3))
    first = max(-int((at - begin) / step), -count)
    last = min(int((end - at) / step), count)
    whole = np.array([k for k in range(first, last + 1) if k], float)
    return whole[np.sort(np.argsort(np.abs(whole), kind="stable")[:count])], step


def _last_turn(period: float) -> int:
    """Return the number of the last period of a path; the first is 0."""
    return math.ceil((1.0 - 1e-9 * period) / period) - 1


def _repeated(u: Array, pieces: Pieces, period: float) -> Samples:
    """Return samples of the first period, repeated in the first and the last two.

    Values that grow from turn to turn (a spring at a joint) have their extremes there.
    """
    last = _last_turn(period)
    turns = sorted({0, max(last - 1, 0), last})
    each = [np.minimum(u + turn * period, 1.0) for turn in turns]
    return np.concatenate(each), np.tile(pieces, len(turns))


def samples(edges: Array, pieces: Pieces, counts: NDArray[np.int_]) -> Samples:
    """Return count + 1 samples of each interval, ends included, with the interval's piece."""
    each = zip(edges[:-1], edges[1:], counts, strict=True)
    us = [np.append(a + (b - a) / count * np.arange(count), b) for a, b, count in each]
    return np.concatenate(us), np.repeat(pieces, counts + 1)


def least_along(columns: Columns, grid: Samples) -> tuple[float, float, int, int]:
    """Return the least value of all columns along a path, with its u, piece and column.

    Around promising samples nine points are taken, then nine between the neighbours of the best
    one, with a quarter of the interval each time.
    """
    u, piece = grid
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


def largest(columns: Columns, grid: Samples) -> float:
    """Return the largest absolute value of all columns along samples of a path."""
    return -least_along(lambda u, piece: -np.abs(columns(u, piece)), grid)[0]
