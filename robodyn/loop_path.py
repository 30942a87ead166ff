"""The path of all joints of a mechanism when its actuated joints follow a path of their own.

The passive joints are continued along u from the start: a step is predicted by its Taylor series,
corrected by Newton's method with the actuated joints held, and halved where the correction, or
the change of the rates, shows that it may have left the branch.  The states found are the nodes;
a state between two nodes is interpolated and corrected.

Where det Psi_p (of the passive columns) changes its sign between two nodes there is a change
point: two branches meet.  A path that runs straight across it is smooth, so within STEP of it
the passive joints are interpolated, to order 12, from states on both sides.  Where the branches
only come near to one another the step is halved, so that none is leapt to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn.assembly import CLOSED, loop_size
from robodyn.change_points import OFFSETS
from robodyn.closed_form import closure_gap, closure_jacobian
from robodyn.errors import AssemblyError, SingularError
from robodyn.joint_paths import JointPath, Pieces, Values, piece_at
from robodyn.loop_rates import loop_accelerations, loop_velocities
from robodyn.mechanism import Mechanism

Array = NDArray[np.float64]

TRAVEL = 0.1  # rad, the most that a joint moves between two nodes
CORRECTION = 0.01  # rad, the most that Newton's method may correct a prediction
FIRST_STEP = 1 / 64  # of a piece
LEAST_STEP = 1e-11  # in u, below which the path has ended
NEWTON_STEPS = 8
STEP = 0.03  # rad of the fastest joint, between the states that lead across a change point
MOST_NODES = 200_000
TOGETHER = 1e-5  # rad, how far apart states on both sides of a change point may be, at 1e-8 in u
DEAD = 1e-5  # a least singular value below this part of the loop's size is at a singular point
FEWEST = 64  # samples of a path of few pieces


class PathEndError(AssemblyError):
    """The loops cannot be closed beyond a part `u` of the path."""

    def __init__(self, mechanism: Mechanism, u: float, q: Array, reason: str) -> None:
        self.u = u
        at = ", ".join(
            f"q{k + 1} ({mechanism.link_names[k]}) = {q[k]:.6g} rad ({np.degrees(q[k]):.6g} deg)"
            for k in mechanism.actuated
        )
        what = f"the loops cannot be followed beyond {at}"
        super().__init__(what, where=mechanism.source, limit=reason)


class OpenPath:
    """A path of a mechanism of which every joint is actuated and no loop is to be kept."""

    def __init__(self, path: JointPath) -> None:
        self.path = path

    def evaluate(self, u: Array, piece: Pieces | None = None) -> Values:
        """q, q', q'' of all joints at u (T,), each (T, n)."""
        return self.path.evaluate(u, piece)

    def grid(self) -> tuple[Array, Pieces]:
        """Samples (u, piece) close enough to follow the path, the ends of each piece included."""
        edges = self.path.breaks
        pieces = len(edges) - 1
        part = np.linspace(0.0, 1.0, 9)
        u = (edges[:-1, None] + np.diff(edges)[:, None] * part).reshape(-1)
        p = self.path.evaluate(u, np.repeat(np.arange(pieces), 9))[0].reshape(pieces, 9, -1)
        travel = np.abs(np.diff(p, axis=1)).sum(axis=1).max(axis=1)
        least = max(8, FEWEST // pieces)
        counts = np.clip(np.ceil(travel / (0.5 * TRAVEL)), least, 20_000).astype(int)
        return _samples(edges, np.arange(pieces), counts)


class LoopPath:
    """The path of all joints of a mechanism with passive joints, from the closed state `start`.

    Raises PathEndError where the loops cannot be closed all the way, SingularError where the
    actuated joints do not determine the others.
    """

    def __init__(self, mechanism: Mechanism, path: JointPath, start: Array) -> None:
        self.mechanism, self.path = mechanism, path
        self._actuated, self._passive = list(mechanism.actuated), list(mechanism.passive)
        self._square = len(self._passive) == len(mechanism.rows)
        self._size = loop_size(mechanism)
        self._crossings: list[tuple[float, float]] = []  # u of change points, and the step there
        self._nodes: list[float] = []
        self._q: list[Array] = []
        self._slopes: list[tuple[Array, Array]] = []  # at each node, into the piece beside it
        self._node_pieces: list[int] = []
        self._follow(start)
        # an interval between nodes: its piece, and its ends' q and q'
        self._u = np.array(self._nodes)
        self._angles = np.array(self._q)[:, self._passive]
        self._begins = np.array([begin for begin, _ in self._slopes])[:, self._passive]
        self._ends = np.array([end for _, end in self._slopes])[:, self._passive]

    def evaluate(self, u: Array, piece: Pieces | None = None) -> Values:
        """q, q', q'' of all joints at u (T,), each (T, n).

        Raises SingularError at a configuration where the actuated joints do not determine them.
        """
        if piece is None:
            piece = piece_at(self.path.breaks, u)
        q, q1, q2 = (np.zeros((len(u), self.mechanism.n)) for _ in range(3))
        direct = np.ones(len(u), bool)
        for at, step in self._crossings:
            near = np.flatnonzero(direct & (np.abs(u - at) < 0.5 * step))
            around = at + step * OFFSETS
            inside = self.path.breaks[piece[near]] <= around[0]
            inside &= around[-1] <= self.path.breaks[piece[near] + 1]
            near = near[inside]
            if len(near):
                beside = self._closed(around, np.repeat(piece[near[:1]], len(around)))
                weights = _lagrange(OFFSETS.astype(float), (u[near] - at) / step)
                for values, known in zip((q, q1, q2), beside, strict=True):
                    values[near] = weights @ known
                held = self.path.evaluate(u[near], piece[near])
                for values, given in zip((q, q1, q2), held, strict=True):
                    values[np.ix_(near, self._actuated)] = given
                direct[near] = False
        if direct.any():
            for values, found in zip(
                (q, q1, q2), self._closed(u[direct], piece[direct]), strict=True
            ):
                values[direct] = found
        return q, q1, q2

    def grid(self) -> tuple[Array, Pieces]:
        """Samples (u, piece) close enough to follow the path, the ends of each piece included."""
        per_piece = np.bincount(self._node_pieces, minlength=len(self.path.breaks) - 1)
        least = max(8, FEWEST // len(per_piece))
        share = np.maximum(4, np.ceil(least / np.maximum(per_piece, 1))).astype(int)
        pieces = np.array(self._node_pieces)
        return _samples(self._u, pieces, share[pieces])

    def _closed(self, u: Array, piece: Pieces) -> Values:
        p, p1, p2 = self.path.evaluate(u, piece)
        k = np.clip(np.searchsorted(self._u, u, side="right") - 1, 0, len(self._u) - 2)
        h = (self._u[k + 1] - self._u[k])[:, None]
        x = (u - self._u[k])[:, None] / h
        q = np.empty((len(u), self.mechanism.n))
        q[:, self._actuated] = p
        # the Hermite polynomial of the interval's ends
        q[:, self._passive] = (
            (1 + 2 * x) * (1 - x) ** 2 * self._angles[k]
            + x * (1 - x) ** 2 * h * self._begins[k]
            + x * x * (3 - 2 * x) * self._angles[k + 1]
            - x * x * (1 - x) * h * self._ends[k]
        )
        q, closed = self._corrected(q)
        if not closed.all():
            worst = int(np.argmin(closed))
            reason = f"they are open at u = {u[worst]:.9g} between two closed states"
            raise PathEndError(self.mechanism, float(u[worst]), q[worst], reason)
        q1 = loop_velocities(self.mechanism, q, p1)
        return q, q1, loop_accelerations(self.mechanism, q, q1, p2)

    # -- continuation ----------------------------------------------------------------------------

    def _follow(self, start: Array) -> None:
        """The nodes, from the start on."""
        here, closed = self._corrected(start[None])
        if not closed.all():
            raise PathEndError(self.mechanism, 0.0, start, self._reason("the start does not close"))
        kind = self._singular(here[0])
        if kind:
            reason = f"a {kind}, from which the passive joints can go on in two ways"
            raise PathEndError(self.mechanism, 0.0, start, reason)
        q = here[0]
        u = 0.0
        self._nodes.append(u)
        self._q.append(q)
        breaks = self.path.breaks
        for piece, end in enumerate(breaks[1:].tolist()):
            h = FIRST_STEP * (end - u)
            try:
                q1, q2 = self._slope(u, q, piece)
            except SingularError as error:
                raise PathEndError(self.mechanism, u, q, f"{error.what}: {error.limit}") from error
            while u < end:
                there = end if end - u <= 1.001 * h else u + h
                if end - u < 2 * h and there != end:
                    there = u + 0.5 * (end - u)
                found = self._step(u, q, q1, q2, there, piece)
                if found is None:
                    h = 0.4 * (there - u)
                    if h < LEAST_STEP or len(self._nodes) > MOST_NODES:
                        reason = self._reason("that is as far as they can be closed on this branch")
                        raise PathEndError(self.mechanism, u, q, reason)
                    continue
                easy, q_there, q1_there, q2_there = found
                self._slopes.append((q1, q1_there))
                self._node_pieces.append(piece)
                h = (1.7 if easy else 1.0) * (there - u)
                u, q, q1, q2 = there, q_there, q1_there, q2_there
                self._nodes.append(u)
                self._q.append(q)

    def _step(
        self, u: float, q: Array, q1: Array, q2: Array, there: float, piece: int
    ) -> tuple[bool, Array, Array, Array] | None:
        """Whether it was easy, q, q', q'' a step further; None where the step is too long."""
        h = there - u
        guess = q + h * q1 + 0.5 * h**2 * q2
        guess[self._actuated] = self._held(there, piece)[0]
        if np.abs(guess - q).max() > TRAVEL:
            return None
        corrected, closed = self._corrected(guess[None])
        found = corrected[0]
        miss = float(np.abs(found - guess).max())
        if not closed[0] or miss > CORRECTION or np.abs(found - q).max() > TRAVEL:
            return None
        if self._singular(found) == "dead centre":
            return None
        try:
            first, second = self._slope(there, found, piece)
        except SingularError:
            return None
        bend = h * float(np.abs(first - q1 - h * q2)[self._passive].max())
        if bend > 3 * CORRECTION:
            return None
        if self._square and not self._one_branch(u, q, there, found, (q1, first), piece):
            return None
        return max(miss, bend / 3) < 0.2 * CORRECTION, found, first, second

    def _one_branch(
        self,
        u: float,
        q: Array,
        there: float,
        found: Array,
        slopes: tuple[Array, Array],
        piece: int,
    ) -> bool:
        """Whether two nodes have the same sign of det Psi_p, or a change point between them."""
        before, after = (self._sign(state) for state in (q, found))
        if before == after:
            return True
        low, high = (u, q), (there, found)
        h = there - u
        while high[0] - low[0] > max(1e-8 * h, 4 * np.spacing(there)):
            middle = 0.5 * (low[0] + high[0])
            x = (middle - u) / h
            guess = (
                (1 + 2 * x) * (1 - x) ** 2 * q
                + x * (1 - x) ** 2 * h * slopes[0]
                + x * x * (3 - 2 * x) * found
                - x * x * (1 - x) * h * slopes[1]
            )
            guess[self._actuated] = self._held(middle, piece)[0]
            corrected, closed = self._corrected(guess[None])
            if not closed[0]:
                return False
            if self._sign(corrected[0]) == before:
                low = middle, corrected[0]
            else:
                high = middle, corrected[0]
        if np.abs(high[1] - low[1]).max() > TOGETHER:
            return False
        fastest = max(float(np.abs(slope).max()) for slope in slopes)
        if fastest > 0.0:
            self._crossings.append((0.5 * (low[0] + high[0]), STEP / fastest))
        return True

    def _reason(self, reason: str) -> str:
        driven, freedoms = len(self._actuated), self.mechanism.n - len(self.mechanism.rows)
        if driven <= freedoms:
            return reason
        return (
            f"{driven} joints are actuated, more than the freedoms ({freedoms}), so their angles "
            "depend on one another"
        )

    def _singular(self, q: Array) -> str:
        """ "dead centre" or "change point" next to one, else ""."""
        Psi = closure_jacobian(self.mechanism, q)
        least = DEAD * self._size
        if not self._passive or np.linalg.svd(Psi[:, self._passive], compute_uv=False)[-1] > least:
            return ""
        return "dead centre" if np.linalg.svd(Psi, compute_uv=False)[-1] > least else "change point"

    def _sign(self, q: Array) -> float:
        return float(np.linalg.slogdet(closure_jacobian(self.mechanism, q)[:, self._passive])[0])

    def _held(self, u: float, piece: int) -> Array:
        """p, p', p'' of the actuated joints, (3, m)."""
        return np.array(self.path.evaluate(np.array([u]), np.array([piece])))[:, 0]

    def _slope(self, u: float, q: Array, piece: int) -> tuple[Array, Array]:
        _, p1, p2 = self._held(u, piece)
        q1 = loop_velocities(self.mechanism, q, p1)
        return q1, loop_accelerations(self.mechanism, q, q1, p2)

    def _corrected(self, q: Array) -> tuple[Array, NDArray[np.bool_]]:
        """q (T, n) closed by Newton's method with the actuated joints held, and which close."""
        q = q.copy()
        last = np.inf
        for _ in range(NEWTON_STEPS):
            gap = closure_gap(self.mechanism, q)
            columns = closure_jacobian(self.mechanism, q)[..., self._passive]
            inverse = np.linalg.pinv(columns, rcond=1e-9)
            step = np.einsum("...ij,...j->...i", inverse, gap)
            longest = np.abs(step).max(axis=-1, keepdims=True, initial=1e-300)
            q[..., self._passive] -= step * np.minimum(1.0, 0.5 / longest)
            most = float(longest.max())
            if most < 1e-13 or (most < 1e-9 and most > 0.3 * last):
                break
            last = most
        gap = np.abs(closure_gap(self.mechanism, q)).max(axis=-1, initial=0.0)
        turns = np.abs(q).max(axis=-1, initial=1.0)  # couplings count them
        return q, gap <= 1e-3 * CLOSED * self._size * turns


def _samples(edges: Array, pieces: Pieces, counts: NDArray[np.int_]) -> tuple[Array, Pieces]:
    """count + 1 samples of each interval, both ends included, each with the interval's piece."""
    us, of = [], []
    for begin, end, piece, count in zip(edges[:-1], edges[1:], pieces, counts, strict=True):
        us.append(np.append(begin + (end - begin) / count * np.arange(count), end))
        of.append(np.full(count + 1, piece))
    return np.concatenate(us), np.concatenate(of)


def _lagrange(nodes: Array, x: Array) -> Array:
    """Weights (T, nodes) of the polynomial through the nodes, at x (T,)."""
    weights = np.ones((len(x), len(nodes)))
    for i, node in enumerate(nodes):
        for other in np.delete(nodes, i):
            weights[:, i] *= (x - other) / (node - other)
    return weights
