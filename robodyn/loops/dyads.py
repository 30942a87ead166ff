"""Dyads: how one or two unknown joints close a loop in closed form.

Couplings are resolved first, then dyads one after another; other loops need Newton's method.  The
gap of a pin is K + sum_r c_r e^(i theta_r) + sum_k s_k u_k over unknown angles theta and
displacements u.  A line takes one component of it; the line of an unknown link turns with the link.

    RRR   K + c1 e^(i theta1) + c2 e^(i theta2) = 0       two circles
    RRP   K + c e^(i theta) + s u = 0                     a circle and a line
    RPR   K + (c + s e) e^(i theta) = 0                   a circle and a line that turns
    PRP   K + s u + t v = 0                               two lines
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.engines.coupling_laws import law_values
from robodyn.loops.assembly_plan import Plan, Step, root_of
from robodyn.loops.closing import half_turn
from robodyn.mechanics.parts import NOTHING
from robodyn.mechanics.planar_model import Mechanism
from robodyn.tables.arrays import Array, Complex

CLOSED = 1e-9  # a gap below this part of the loop's lengths counts as rounding
PARALLEL = 1e-12  # sine between two lines that do not meet

OWN = -1  # in place of a joint: what is constant in the frame of a line that turns


def known_joints(
    mechanism: Mechanism, plan: Plan, given: Array, t: ArrayLike
) -> tuple[Array, list[Array]]:
    """Return q (..., n) with actuated joints and joints given by couplings at t (...).

    The second result has the deviation (...) from each coupling, rad or m; 0 for a coupling of
    unknown joints.
    """
    q = np.zeros((*given.shape[:-1], mechanism.n))
    q[..., list(mechanism.actuated)] = given
    couplings = mechanism.description.couplings
    for joint, c in plan.coupled:
        q[..., joint] = coupled_angle(mechanism, c, joint, q, t)
    found = []
    for c, coupling in enumerate(couplings):
        wanted = coupled_angle(mechanism, c, coupling.joint, q, t)
        off = np.abs(q[..., coupling.joint] - wanted)
        kept = off <= CLOSED * (1.0 + np.abs(wanted))
        found.append(np.where(kept | (not coupling.joints <= plan.known), 0.0, off))
    return q, found


def by_dyads(
    mechanism: Mechanism, plan: Plan, q: Array, branches: Sequence[str]
) -> tuple[Array, list[Array], list[Array]]:
    """Return q (..., n) with the joints of the plan's steps, and per step the missing distance.

    The distances (...) are in m; the third result has sines as in `solve_dyad`.  The joints in
    `plan.known` are read from q (..., n).  Numbers of the plan's rows may be arrays that broadcast
    to (...), one mechanism per lane.
    """
    q, shorts, sines = q.copy(), [], []
    alpha = np.zeros_like(q)  # of unknown links, what they turn ahead of the first of them
    for k in mechanism.order:
        if k in plan.known:
            above = mechanism.above[k]
            alpha[..., k] = q[..., k] + (0.0 if above is None else alpha[..., above])
    for step in plan.steps:
        side = 1.0 if branches[step.closure] == "open" else -1.0
        angles, short, sine = solve_dyad(mechanism, plan, step, alpha, side)
        shorts.append(short)
        sines.append(sine)
        for link, angle in zip(step.unknown, angles, strict=True):
            if link in mechanism.slides:
                alpha[..., link] = angle
            for k, root in enumerate(plan.turns_with):
                if root == link:
                    alpha[..., k] += angle
    free = {x.at: x.free for x in mechanism.elements if x.free is not None}
    for k in {k for step in plan.steps for k in step.unknown}:
        above, middle = mechanism.above[k], free.get(k, 0.0)
        relative = alpha[..., k] - (0.0 if above is None else alpha[..., above])
        slides = k in mechanism.slides
        q[..., k] = relative if slides else half_turn(relative - middle) + middle
    return q, shorts, sines


# the unknowns by their joints, the distance missing (below zero where it closes), a sine, and the
# length whose direction is taken: zero if the unknowns may be anything
Solved = tuple[dict[int, Array], Array, Array, Array]


def solve_dyad(
    mechanism: Mechanism, plan: Plan, step: Step, x: Array, side: float
) -> tuple[list[Array], Array, Array]:
    """Solve a step: return its unknowns, the missing distance (0 if it closes), and a sine.

    `x` (..., n) are absolute positions of known links, and for unknown links their angle ahead of
    the unknown joint.  The sine is that of the angle between the unknown links, or between a link
    and the normal of its line.  If any value closes, as at a slot's own pivot, unknowns and
    distance are nan.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # directions of nothing
        found, missing, sine, length = _Dyad(mechanism, plan, step, x, side).solved()
    size = step.rows[0].size + abs(step.rows[0].offset)
    missing = np.where(missing > CLOSED * size, missing, 0.0)
    free = (length <= NOTHING * size) & (missing <= 0.0)
    unknowns = [np.where(free, np.nan, found[u]) for u in step.unknown]
    return unknowns, np.where(free, np.nan, missing), sine


class _Dyad:
    """The gap K + sum_u c_u E_u over the unknowns u of a step, and the ways to close it.

    For a line the gap is turned so that its imaginary part is the distance from the line.  If the
    line turns with the unknown, K is the part that does not turn with it and c[OWN] the rest.
    """

    def __init__(self, mechanism: Mechanism, plan: Plan, step: Step, x: Array, side: float) -> None:
        self.mechanism, self.plan, self.step, self.side = mechanism, plan, step, side
        self.row, self.pin = step.rows[0], len(step.rows) == 2
        self.turning = [u for u in step.unknown if u not in mechanism.slides]
        self.sliding = [u for u in step.unknown if u in mechanism.slides]
        self.line = None if self.row.line is None else plan.turns_with[self.row.line]
        self.K, self.c = self._gap(x)
        self.one: Array = np.ones(self.K.shape)
        self.always: Array = np.full(self.K.shape, np.inf)  # a length of what has a direction

    def _gap(self, x: Array) -> tuple[Complex, dict[int, Complex]]:
        row, step, mechanism = self.row, self.step, self.mechanism
        shape, turn = x.shape[:-1], 1.0 if self.pin else 1j
        K: Complex = np.full(shape, turn * row.ground, complex)
        own: Complex = np.full(shape, turn * row.offset, complex)
        if self.pin:
            own = own + 1j * step.rows[1].offset
        c: dict[int, Complex] = {u: np.zeros(shape, complex) for u in step.unknown}
        for k, p in row.P:
            d = mechanism.frames[k]
            term = turn * p * (np.ones(shape) if d is None else np.exp(1j * x[..., d]))
            to: int | None = k
            if k not in self.sliding:
                if k in mechanism.slides:
                    term = term * x[..., k]
                to = root_of(mechanism, self.plan.turns_with, k)
            if to is not None and to in c:
                c[to] = c[to] + term
            else:
                K = K + term
        for k, a in row.angles:
            if k in c:
                c[k] = c[k] + turn * a
            else:
                own = own + turn * a * x[..., k]
        if row.line is None:
            return K + own, c
        back = np.exp(-1j * x[..., row.line])
        K = K * back
        if self.line in c:
            return K, c | {OWN: own}
        on_line = {k for k, _ in row.angles}
        return K + own, {u: z if u in on_line else z * back for u, z in c.items()}

    def solved(self) -> Solved:
        """Solve the dyad in the way that fits its unknowns."""
        if not self.step.unknown:
            return self._closed()
        if self.row.arm:
            return self._line_angle()
        ways: dict[tuple[bool, int, int], Callable[[], Solved]] = {
            (False, 0, 1): self._slide_on_line,
            (False, 1, 0): self._turn_on_line,
            (True, 0, 1): self._slide_to_pin,
            (True, 1, 0): self._turn_to_pin,
            (True, 2, 0): self._circles,
            (True, 1, 1): self._circle_and_line,
            (True, 0, 2): self._lines,
        }
        return ways[self.pin, len(self.turning), len(self.sliding)]()

    def _closed(self) -> Solved:
        missing = np.abs(self.K) if self.pin else np.abs(self.K.imag)
        if self.row.arm:
            missing = np.where(self.K.real > 0.0, missing, self.row.arm)
        return {}, missing, self.one, self.always

    def _line_angle(self) -> Solved:
        (u,) = self.turning
        z: Complex = self.K if u == self.line else self.c[u].conj()
        return {u: np.angle(z)}, np.zeros(self.K.shape), self.one, self.always

    def _slide_on_line(self) -> Solved:
        (u,), c = self.sliding, self.c
        sine = _ratio(np.abs(c[u].imag), np.abs(c[u]))
        meets = sine > PARALLEL
        way = -self.K.imag / np.where(meets, c[u].imag, 1.0) * meets
        return {u: way}, np.where(meets, 0.0, np.abs(self.K.imag)), sine, self._where(meets)

    def _turn_on_line(self) -> Solved:
        (u,), K, c = self.turning, self.K, self.c
        own = c.get(OWN)
        length, across = (np.abs(c[u]), -K.imag) if own is None else (np.abs(K), -own.imag)
        along, missing, sine = _second_side(length, across, self.side)
        there = along + 1j * across
        turn = np.angle(there / c[u]) if own is None else np.angle(K / there)
        return {u: turn}, missing, sine, length

    def _slide_to_pin(self) -> Solved:
        (u,) = self.sliding
        ahead = -self.K / self.c[u]
        return {u: ahead.real}, np.abs(ahead.imag * self.c[u]), self.one, self.always

    def _turn_to_pin(self) -> Solved:
        (u,), K, c = self.turning, self.K, self.c
        far, length = np.abs(K), np.abs(c[u])
        return {u: np.angle(-K / c[u])}, np.abs(far - length), self.one, np.minimum(far, length)

    def _circles(self) -> Solved:
        """Solve RRR."""
        (one, two), K = self.turning, self.K
        first, second = self.c[one], self.c[two]
        ra, rb, d = np.abs(first), np.abs(second), np.abs(K)
        missing = np.maximum(d - (ra + rb), np.abs(ra - rb) - d)
        # P - A = (x + i y) along the unit vector from A to D; Heron's product keeps y exact
        along = ((ra - rb) * (ra + rb) / d + d) / 2.0
        heron = ((ra + rb) + d) * ((ra + rb) - d) * (d - (ra - rb)) * (d + (ra - rb))
        y = np.sqrt(np.maximum(heron, 0.0)) / (2.0 * d)
        arm = -K / d * (along + 1j * self.side * y)
        found = {one: np.angle(arm / first), two: np.angle((-K - arm) / second)}
        return found, missing, _ratio(np.abs(d * y), ra * rb), np.minimum(d, np.minimum(ra, rb))

    def _circle_and_line(self) -> Solved:
        """Solve RPR if the line turns with the unknown link, else RRP."""
        (u,), (s,), K, c = self.turning, self.sliding, self.K, self.c
        if root_of(self.mechanism, self.plan.turns_with, s) == u:
            ahead = c[u] * c[s].conj()
            along, missing, sine = _second_side(np.abs(K), ahead.imag, self.side)
            turn = np.angle(-K / (c[s] * (along + 1j * ahead.imag)))
            return {s: along - ahead.real, u: turn}, missing, sine, np.abs(K)
        back = c[s].conj() * K
        across = -back.imag
        side = self.side if self._first_side(u) == self._first_side(s) else -self.side
        length = np.abs(c[u])
        along, missing, sine = _second_side(length, across, side)
        turn = np.angle(c[s] * (along + 1j * across) / c[u])
        return {s: -back.real - along, u: turn}, missing, sine, length

    def _lines(self) -> Solved:
        """Solve PRP."""
        (one, two), K, c = self.sliding, self.K, self.c
        cross = (c[one].conj() * c[two]).imag
        sine = np.abs(cross) + np.zeros(K.shape)
        meets = sine > PARALLEL
        missing = np.where(meets, 0.0, np.abs((c[one].conj() * K).imag))
        cross = np.where(meets, cross, np.inf)
        ways = {one: (c[two].conj() * K).imag / cross, two: -(c[one].conj() * K).imag / cross}
        return ways, missing, sine, self._where(meets)

    def _where(self, determined: NDArray[np.bool_]) -> Array:
        return np.where(determined, np.inf, 0.0)

    def _first_side(self, joint: int) -> bool:
        """Return whether a joint is on the closure's first side."""
        first = self.mechanism.description.closures[self.step.closure].first
        return joint in self.mechanism.path(first.link)


def _second_side(length: Array, across: Array, side: float) -> tuple[Array, Array, Array]:
    """Return the second leg of a right triangle, the missing length, and its sine."""
    across = np.abs(across)
    along = side * np.sqrt(np.maximum((length - across) * (length + across), 0.0))
    return along, across - length, _ratio(np.abs(along), length)


def _ratio(a: Array, b: Array) -> Array:
    return np.asarray(a / np.where(b > 0.0, b, 1.0))


def coupled_angle(mechanism: Mechanism, c: int, joint: int, q: Array, t: ArrayLike) -> Array:
    """Return q_joint (...) at t from coupling c, whose other joints are known in q (..., n)."""
    coupling = mechanism.description.couplings[c]
    if coupling.law is not None:
        return law_values(mechanism, c, q, t)
    ratios = {coupling.joint: -1.0, **dict(coupling.terms)}  # sum of ratio q = -angle
    total = np.full(q.shape[:-1], coupling.angle)
    for k, ratio in ratios.items():
        if k != joint:
            total = total + ratio * q[..., k]
    return -total / ratios[joint]
