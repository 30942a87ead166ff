"""Chains of dyads: in which order loops are closed, and how one or two unknowns close one.

What follows from couplings comes first, then dyads by turns; what is left is closed by Newton's
method.  The gap of a pin is K + sum_r c_r e^(i theta_r) + sum_k s_k u_k over unknown angles and
displacements; a line takes one part of it, and a line of an unknown link turns with that.

    RRR   K + c1 e^(i theta1) + c2 e^(i theta2) = 0       two circles
    RRP   K + c e^(i theta) + s u = 0                     a circle and a line
    RPR   K + (c + s e) e^(i theta) = 0                   a circle and a line that turns
    PRP   K + s u + t v = 0                               two lines
"""

from __future__ import annotations

import numpy as np

from robodyn.loops.assembly_plan import Plan, Step, root_of
from robodyn.mechanics.planar_model import ClosureRow, Mechanism
from robodyn.scene.scene import Coupling
from robodyn.tables.arrays import Array, Complex

CLOSED = 1e-9  # a gap below this part of the loop's lengths counts as rounding
PARALLEL = 1e-12  # sine between two lines that do not meet


def solve_dyad(
    mechanism: Mechanism, plan: Plan, step: Step, x: Array, side: float
) -> tuple[list[Array], Array, Array]:
    """The unknowns of a step, the distance missing (0 where it closes), a sine.

    `x` (..., n) has what unknown links turn ahead of the first of them.  The sine is that of the
    angle between the unknown links, or of a link to its line's normal.
    """
    row, K, c = _gap_of(mechanism, plan, step, x)
    size = row.size + abs(row.offset)
    turning = [u for u in step.unknown if u not in mechanism.slides]
    sliding = [u for u in step.unknown if u in mechanism.slides]
    sine: Array = np.ones(K.shape)
    found: dict[int, Array] = {}
    pin = len(step.rows) == 2
    if not step.unknown:
        missing = np.abs(K) if pin else np.abs(K.imag)
        if row.arm:
            missing = np.where(K.real > 0.0, missing, row.arm)
    elif row.arm:
        (u,) = turning
        z: Complex = K if u == _line_root(plan, row) else c[u].conj()
        found[u], missing = np.angle(z), np.zeros(K.shape)
    elif not pin and sliding:
        (u,) = sliding
        sine = _ratio(np.abs(c[u].imag), np.abs(c[u]))
        meets = sine > PARALLEL
        found[u] = -K.imag / np.where(meets, c[u].imag, 1.0) * meets
        missing = np.where(meets, 0.0, np.abs(K.imag))
    elif not pin:
        (u,) = turning
        own = c.get(OWN)
        length, across = (np.abs(c[u]), -K.imag) if own is None else (np.abs(K), -own.imag)
        along, missing, sine = _second_side(length, across, side)
        there = along + 1j * across
        found[u] = np.angle(there / c[u]) if own is None else np.angle(K / there)
    elif len(step.unknown) == 1:
        (u,) = step.unknown
        if turning:
            missing, found[u] = np.abs(np.abs(K) - np.abs(c[u])), np.angle(-K / c[u])
        else:
            ahead = -K / c[u]
            missing, found[u] = np.abs(ahead.imag * c[u]), ahead.real
    elif len(turning) == 2:
        one, two = turning
        first, second = c[one], c[two]
        ra, rb, d = np.abs(first), np.abs(second), np.abs(K)
        missing = np.maximum(d - (ra + rb), np.abs(ra - rb) - d)
        # P - A = (x + i y) along the unit vector from A to D; Heron's product keeps y exact
        with np.errstate(invalid="ignore", divide="ignore"):
            unit = np.where(d > 0.0, -K / np.where(d > 0.0, d, 1.0), 1.0)
            along = np.where(d > 0.0, ((ra - rb) * (ra + rb) / d + d) / 2.0, 0.0)
            heron = ((ra + rb) + d) * ((ra + rb) - d) * (d - (ra - rb)) * (d + (ra - rb))
            y = np.where(d > 0.0, np.sqrt(np.maximum(heron, 0.0)) / (2.0 * d), ra)
        arm = unit * (along + 1j * side * y)
        found[one], found[two] = np.angle(arm / first), np.angle((-K - arm) / second)
        sine = _ratio(np.abs(d * y), ra * rb)
    elif turning and root_of(mechanism, plan.turns_with, sliding[0]) == turning[0]:  # RPR
        (u,), (s,) = turning, sliding
        ahead = c[u] * c[s].conj()
        along, missing, sine = _second_side(np.abs(K), ahead.imag, side)
        found[s] = along - ahead.real
        found[u] = np.angle(-K / (c[s] * (along + 1j * ahead.imag)))
    elif turning:  # RRP
        (u,), (s,) = turning, sliding
        across = -(c[s].conj() * K).imag
        same = 1.0 if _first_side(mechanism, step, u) == _first_side(mechanism, step, s) else -1.0
        along, missing, sine = _second_side(np.abs(c[u]), across, side * same)
        found[u] = np.angle(c[s] * (along + 1j * across) / c[u])
        found[s] = -(c[s].conj() * K).real - along
    else:  # PRP
        one, two = sliding
        cross = (c[one].conj() * c[two]).imag
        sine = np.abs(cross) + np.zeros(K.shape)
        meets = sine > PARALLEL
        missing = np.where(meets, 0.0, np.abs((c[one].conj() * K).imag))
        cross = np.where(meets, cross, np.inf)
        found[one], found[two] = (c[two].conj() * K).imag / cross, -(c[one].conj() * K).imag / cross
    missing = np.where(missing > CLOSED * size, missing, 0.0)
    return [found[u] for u in step.unknown], missing, sine


OWN = -1  # in place of a joint: what is constant in the frame of a line that turns


def _gap_of(
    mechanism: Mechanism, plan: Plan, step: Step, x: Array
) -> tuple[ClosureRow, Complex, dict[int, Complex]]:
    """K and c_u of the gap K + sum_u c_u E_u; that of a line turned onto it, its imaginary part.

    A line that turns with the unknown is not: what does not turn with it is K, the rest c[OWN].
    """
    row, slides = step.rows[0], mechanism.slides
    shape, turn = x.shape[:-1], 1.0 if len(step.rows) == 2 else 1j
    K: Complex = np.full(shape, turn * row.ground, complex)
    own: Complex = np.full(shape, turn * row.offset, complex)
    if len(step.rows) == 2:
        own = own + 1j * step.rows[1].offset
    c: dict[int, Complex] = {u: np.zeros(shape, complex) for u in step.unknown}
    for k, p in row.P:
        d = mechanism.frames[k]
        term = turn * p * (np.ones(shape) if d is None else np.exp(1j * x[..., d]))
        if k in slides and k in c:
            c[k] = c[k] + term
            continue
        if k in slides:
            term = term * x[..., k]
        root = root_of(mechanism, plan.turns_with, k)
        if root in c:
            assert root is not None
            c[root] = c[root] + term
        else:
            K = K + term
    for k, a in row.angles:
        if k in c:
            c[k] = c[k] + turn * a
        else:
            own = own + turn * a * x[..., k]
    if row.line is None:
        return row, K + own, c
    back = np.exp(-1j * x[..., row.line])
    K = K * back
    if _line_root(plan, row) in c:
        return row, K, c | {OWN: own}
    on_line = {k for k, _ in row.angles}
    c = {u: z if u in on_line else z * back for u, z in c.items()}
    return row, K + own, c


def _second_side(length: Array, across: Array, side: float) -> tuple[Array, Array, Array]:
    """The other side of a right triangle, what its first is too short by, and its sine."""
    across = np.abs(across)
    along = side * np.sqrt(np.maximum((length - across) * (length + across), 0.0))
    return along, across - length, _ratio(np.abs(along), length)


def _ratio(a: Array, b: Array) -> Array:
    return np.asarray(a / np.where(b > 0.0, b, 1.0))


def _line_root(plan: Plan, row: ClosureRow) -> int | None:
    return None if row.line is None else plan.turns_with[row.line]


def _first_side(mechanism: Mechanism, step: Step, joint: int) -> bool:
    """Whether a joint is on the side of the closure that is named first."""
    return joint in mechanism.path(mechanism.description.closures[step.closure].first.link)


def coupled_angle(coupling: Coupling, joint: int, q: Array) -> Array:
    """q_joint (...) by a coupling whose other joints are known."""
    ratios = {coupling.joint: -1.0, **dict(coupling.terms)}  # sum of ratio q = -angle
    total = np.full(q.shape[:-1], coupling.angle)
    for k, ratio in ratios.items():
        if k != joint:
            total = total + ratio * q[..., k]
    return -total / ratios[joint]
