"""The Taylor-series engine in compiled code: one function for all mechanisms, cached on disk.

With E_k = c_k + i s_k = exp(i alpha_k), w = d(alpha)/dt and a = dw/dt, the coefficients obey

    E' = i w E             (k+1) E_{k+1} = i sum_m w_m E_{k-m}
    P = E''                P_k = (k+1)(X_k + i Y_k) + i a_k E_0,  X_k + i Y_k = i sum w_m E_{k+1-m}
    F = A P - gamma conj(B) - P_closure^H lambda                  Re(conj(i E_j) F_j) = tau_j

so that (a_k, -lambda_k) solves [M Psi^T; Psi 0] of the step's start with a right side of two
convolutions a link; the factors serve all orders.

The mechanism enters as numbers only: nothing is ever compiled for another one.  They lie in two
arrays, `whole` and `real`, what is computed lies in a third, `work`, and a Layout tells where:
compiled code pays for every array that a function is handed.  Series run along rows, those of E
backwards: convolutions are then products of adjacent numbers.
"""

# compiled functions are not annotated: types are numba's to infer
# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from robodyn.actuation import Actuation
from robodyn.assembly import loop_size
from robodyn.dense_dynamics import elimination_is_safe
from robodyn.mechanism import Mechanism
from robodyn.projection import CLOSED, regular_rank, suspect_quality
from robodyn.taylor import Chunk, Status

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
F = TypeVar("F", bound=Callable[..., object])

PASSES = 3
HOPELESS = 1e-8  # quality below which a projection would add more noise than it takes away
PARTS = (1.0, 0.85, 0.7, 0.55, 0.4)  # of a step, where it may land to avoid a suspect state
SMALL = 24  # links, or rows, up to which an ordering is not worth its search

REACHED, FULL = int(Status.REACHED), int(Status.FULL)
SINGULAR, STUCK, NOT_FINITE = int(Status.SINGULAR), int(Status.STUCK), int(Status.NOT_FINITE)


class Layout(NamedTuple):
    """Sizes, and where things begin in `whole`, `real` and `work`.

    Sparse matrices are rows of entries as in CSR.  Symmetric ones are skylines: rows of the lower
    triangle from their first entry to the diagonal, (i, j) at start[i] + j for first[i] <= j <= i.
    """

    n: int  # links
    rows: int  # r, of closures
    entries: int  # of all rows of P
    order: int  # the last coefficient of w
    K: int  # coefficients that a series has room for

    # whole
    parent: int  # (n,), -1 for the ground
    outward: int  # (n,) the links, parents first
    A_start: int  # (n + 1,) A's entries beside the diagonal, both triangles
    A_link: int
    A_spot: int  # where M_jl goes in the system; -1 in the upper triangle
    P_start: int  # (r + 1,)
    P_link: int
    P_spot: int  # where Psi's entry goes in the system
    P_slot: int  # its place among the row's joints
    joint_start: int  # (r + 1,) the joints that move what a row closes, leaves first
    joint: int
    joint_above: int  # place of the joint's parent among them, or -1
    place: int  # (n + r,) of links and rows in the system [M Psi^T; Psi 0]
    first: int  # (n + r,)
    start: int
    normal_place: int  # (r,) of rows in Psi Psi^T
    normal_row: int  # (r,) the row at each place
    normal_first: int  # (r,)
    normal_start: int

    # real
    inertia: int  # (n,) A_jj, kg m^2
    A_re: int  # kg m^2
    A_im: int
    weight_re: int  # (n,) gamma conj(B), N
    weight_im: int
    damping: int  # (n,) N m s/rad
    torque: int  # (n,) N m
    P_re: int
    P_im: int
    offset: int  # (r,) m
    size: int  # (r,) square of the row's sum of |P|, m^2
    closed: int  # gap that is rounding, m

    # work
    W: int  # (n, K) of w
    C: int  # (n, K) of c, coefficient k at K - 1 - k
    S: int  # (n, K) of s, likewise
    FX: int  # (n, K)
    FY: int
    X: int  # (n,) of P's known part, one order
    Y: int
    Z_re: int  # i A_jl E_l at the step's start, as A
    Z_im: int
    power: int  # (K,) of torques less dampers
    system: int  # factors of [M Psi^T; Psi 0], and their pivots' inverses (n + r,)
    pivot: int
    x: int  # (n + r,)
    Psi: int  # in joint coordinates, as `joint`
    normal: int  # factors of Psi Psi^T, and their pivots' inverses (r,)
    normal_pivot: int
    dense: int  # (n,), zero between uses
    h: int  # (K,) powers of a time
    h_angle: int  # (K,) and their integrals
    alpha: int  # (n,)
    c: int  # (n,) of the state that was closed last
    s: int
    c0: int  # (n,) of the step's start
    s0: int
    size_of_work: int


def _compiled(associative: bool = False) -> Callable[[F], F]:
    """A decorator that compiles; with the sums of `associative` functions in any order."""
    fastmath = {"reassoc", "contract"} if associative else False
    njit: Any = numba.njit  # annotated in some versions only

    def decorate(function: F) -> F:
        compiled: F
        try:
            compiled = njit(cache=True, error_model="numpy", fastmath=fastmath)(function)
        except RuntimeError:  # no directory to write a cache to
            compiled = njit(error_model="numpy", fastmath=fastmath)(function)
        return compiled

    return decorate


# -- linear algebra ------------------------------------------------------------------------------
# (unsigned indices: signed ones are checked for counting from the end, which no loop is fast with)


@_compiled(associative=True)
def _dot(work, a, b, count):
    """Sum of products of `count` numbers from a and from b."""
    a, b = np.uintp(a), np.uintp(b)
    total = 0.0
    for m in range(np.uintp(count)):
        total += work[a + m] * work[b + m]
    return total


@_compiled(associative=True)
def _turned(work, w, c, s, count):
    """Real and imaginary part of i sum w (c + i s)."""
    w, c, s = np.uintp(w), np.uintp(c), np.uintp(s)
    x = y = 0.0
    for m in range(np.uintp(count)):
        x -= work[w + m] * work[s + m]
        y += work[w + m] * work[c + m]
    return x, y


@_compiled(associative=True)
def _moment(work, c, s, fx, fy, count):
    """Sum of c fy - s fx."""
    c, s, fx, fy = np.uintp(c), np.uintp(s), np.uintp(fx), np.uintp(fy)
    total = 0.0
    for m in range(np.uintp(count)):
        total += work[c + m] * work[fy + m] - work[s + m] * work[fx + m]
    return total


@_compiled()
def _factorise(whole, work, L, pivot, first, start, size):
    """L D L^T of a skyline, in place; `pivot` receives the inverse of D."""
    for i in range(size):
        fi, si = whole[first + i], L + whole[start + i]
        for j in range(fi + 1, i):
            low = max(fi, whole[first + j])
            if low < j:
                work[si + j] -= _dot(work, si + low, L + whole[start + j] + low, j - low)
        d = work[si + i]
        for j in range(fi, i):
            value = work[si + j]
            work[si + j] = value * work[pivot + j]
            d -= value * work[si + j]
        work[si + i] = d
        work[pivot + i] = 1.0 / d


@_compiled()
def _solve(whole, work, L, pivot, first, start, size, x):
    """x := (L D L^T)^-1 x."""
    for i in range(1, size):
        fi = whole[first + i]
        if fi < i:
            work[x + i] -= _dot(work, L + whole[start + i] + fi, x + fi, i - fi)
    for i in range(size):
        work[x + i] *= work[pivot + i]
    for i in range(size - 1, 0, -1):
        si, value = L + whole[start + i], work[x + i]
        for j in range(whole[first + i], i):
            work[x + j] -= work[si + j] * value


# -- closures ------------------------------------------------------------------------------------


@_compiled()
def _directions(whole, work, at, y, q):
    """c and s of the angles from y[q]."""
    for i in range(at.n):
        k = whole[at.outward + i]
        above = whole[at.parent + k]
        alpha = y[q + k] if above < 0 else work[at.alpha + above] + y[q + k]
        work[at.alpha + k] = alpha
        work[at.c + k] = math.cos(alpha)
        work[at.s + k] = math.sin(alpha)


@_compiled()
def _normal(whole, real, work, at):
    """Psi in joint coordinates and Psi Psi^T factorised, at c, s.

    Returns its least pivot, relative to the rows' sizes: about d^2 at a distance d from a
    configuration where Psi loses rank.
    """
    for r in range(at.rows):
        begin, end = whole[at.joint_start + r], whole[at.joint_start + r + 1]
        for g in range(begin, end):
            work[at.Psi + g] = 0.0
        for e in range(whole[at.P_start + r], whole[at.P_start + r + 1]):
            k = whole[at.P_link + e]
            re, im = real[at.P_re + e], real[at.P_im + e]
            work[at.Psi + whole[at.P_slot + e]] = -(re * work[at.s + k] + im * work[at.c + k])
        for g in range(begin, end):
            above = whole[at.joint_above + g]
            if above >= 0:
                work[at.Psi + above] += work[at.Psi + g]
    for i in range(at.rows):
        r = whole[at.normal_row + i]
        begin, end = whole[at.joint_start + r], whole[at.joint_start + r + 1]
        for g in range(begin, end):
            work[at.dense + whole[at.joint + g]] = work[at.Psi + g]
        for j in range(whole[at.normal_first + i], i + 1):
            other = whole[at.normal_row + j]
            total = 0.0
            for g in range(whole[at.joint_start + other], whole[at.joint_start + other + 1]):
                total += work[at.Psi + g] * work[at.dense + whole[at.joint + g]]
            work[at.normal + whole[at.normal_start + i] + j] = total
        for g in range(begin, end):
            work[at.dense + whole[at.joint + g]] = 0.0
    _factorise(whole, work, at.normal, at.normal_pivot, at.normal_first, at.normal_start, at.rows)
    quality = math.inf
    for i in range(at.rows):
        pivot = work[at.normal + whole[at.normal_start + i] + i]
        relative = pivot / real[at.size + whole[at.normal_row + i]]
        if not relative >= quality:  # nan is the worst
            quality = relative
    return quality


@_compiled()
def _subtract(whole, work, at, y, i):
    """y[i:] -= Psi^T (Psi Psi^T)^-1 x."""
    _solve(whole, work, at.normal, at.normal_pivot, at.normal_first, at.normal_start, at.rows, at.x)
    for r in range(at.rows):
        x = work[at.x + whole[at.normal_place + r]]
        for g in range(whole[at.joint_start + r], whole[at.joint_start + r + 1]):
            y[i + whole[at.joint + g]] -= work[at.Psi + g] * x


@_compiled()
def _close(whole, real, work, at, y, q):
    """Move the state at y[q] to the nearest that closes, and leave its directions in c and s.

    Returns its quality; infinite without closures.
    """
    _directions(whole, work, at, y, q)
    if at.rows == 0:
        return math.inf
    before = math.inf
    for trial in range(PASSES + 1):
        largest = 0.0
        for r in range(at.rows):
            gap = real[at.offset + r]
            for e in range(whole[at.P_start + r], whole[at.P_start + r + 1]):
                k = whole[at.P_link + e]
                gap += real[at.P_re + e] * work[at.c + k] - real[at.P_im + e] * work[at.s + k]
            work[at.x + whole[at.normal_place + r]] = gap
            largest = max(largest, abs(gap))
        quality = _normal(whole, real, work, at)
        if not quality > HOPELESS:
            return quality
        # what is closed to rounding stays: moving it would add noise
        if largest <= real[at.closed] or largest > 0.5 * before or trial == PASSES:
            break
        before = largest
        _subtract(whole, work, at, y, q)
        _directions(whole, work, at, y, q)
    for r in range(at.rows):
        total = 0.0
        for g in range(whole[at.joint_start + r], whole[at.joint_start + r + 1]):
            total += work[at.Psi + g] * y[q + at.n + whole[at.joint + g]]
        work[at.x + whole[at.normal_place + r]] = total
    _subtract(whole, work, at, y, q + at.n)
    return quality


# -- series --------------------------------------------------------------------------------------


@_compiled()
def _system(whole, real, work, at):
    """[M Psi^T; Psi 0] at c0, s0, factorised; Z = i A E beside the diagonal."""
    for i in range(at.pivot - at.system):
        work[at.system + i] = 0.0
    for j in range(at.n):
        i = whole[at.place + j]
        work[at.system + whole[at.start + i] + i] = real[at.inertia + j]
        for e in range(whole[at.A_start + j], whole[at.A_start + j + 1]):
            l = whole[at.A_link + e]
            A_re, A_im = real[at.A_re + e], real[at.A_im + e]
            re = -(A_re * work[at.s0 + l] + A_im * work[at.c0 + l])
            im = A_re * work[at.c0 + l] - A_im * work[at.s0 + l]
            work[at.Z_re + e] = re
            work[at.Z_im + e] = im
            if whole[at.A_spot + e] >= 0:
                M = work[at.c0 + j] * im - work[at.s0 + j] * re
                work[at.system + whole[at.A_spot + e]] = M
    for e in range(at.entries):
        l = whole[at.P_link + e]
        Psi = -(real[at.P_re + e] * work[at.s0 + l] + real[at.P_im + e] * work[at.c0 + l])
        work[at.system + whole[at.P_spot + e]] = Psi
    _factorise(whole, work, at.system, at.pivot, at.first, at.start, at.n + at.rows)


@_compiled()
def _series(whole, real, work, at, y, q):
    """The coefficients of w, from the state at y[q] and its directions c0, s0."""
    _system(whole, real, work, at)
    K, top = at.K, at.K - 1
    for i in range(at.n):
        l = whole[at.outward + i]
        above = whole[at.parent + l]
        w = y[q + at.n + l]
        if above >= 0:
            w += work[at.W + above * K]
        c, s = work[at.c0 + l], work[at.s0 + l]
        work[at.W + l * K] = w
        work[at.C + l * K + top], work[at.S + l * K + top] = c, s
        work[at.C + l * K + top - 1], work[at.S + l * K + top - 1] = -w * s, w * c
    for k in range(at.order):
        for l in range(at.n):  # what is known of P_k
            i = l * K + top - k - 1
            re, im = _turned(work, at.W + l * K, at.C + i, at.S + i, k + 1)
            work[at.X + l], work[at.Y + l] = (k + 1) * re, (k + 1) * im
        for j in range(at.n):
            fx = fy = 0.0
            if k == 0:
                fx, fy = -real[at.weight_re + j], -real[at.weight_im + j]
            for e in range(whole[at.A_start + j], whole[at.A_start + j + 1]):
                l = whole[at.A_link + e]
                re, im = real[at.A_re + e], real[at.A_im + e]
                fx += re * work[at.X + l] - im * work[at.Y + l]
                fy += re * work[at.Y + l] + im * work[at.X + l]
            work[at.FX + j * K + k], work[at.FY + j * K + k] = fx, fy
            i = j * K + top - k
            load = _moment(work, at.C + i, at.S + i, at.FX + j * K, at.FY + j * K, k + 1)
            work[at.x + whole[at.place + j]] = -load
        for j in range(at.n):  # a joint takes from the parent what it puts on its link
            above = whole[at.parent + j]
            rate = work[at.W + j * K + k]
            if above >= 0:
                rate -= work[at.W + above * K + k]
            torque = -real[at.damping + j] * rate
            if k == 0:
                torque += real[at.torque + j]
            work[at.x + whole[at.place + j]] += torque
            if above >= 0:
                work[at.x + whole[at.place + above]] -= torque
        for r in range(at.rows):
            total = 0.0
            for e in range(whole[at.P_start + r], whole[at.P_start + r + 1]):
                l = whole[at.P_link + e]
                total += real[at.P_re + e] * work[at.X + l] - real[at.P_im + e] * work[at.Y + l]
            work[at.x + whole[at.place + at.n + r]] = -total
        size = at.n + at.rows
        _solve(whole, work, at.system, at.pivot, at.first, at.start, size, at.x)
        for l in range(at.n):
            w = work[at.x + whole[at.place + l]] / (k + 1)
            work[at.W + l * K + k + 1] = w
            i = l * K + top - k - 2
            c, s = work[at.c0 + l], work[at.s0 + l]
            work[at.C + i] = (work[at.X + l] / (k + 1) - w * s) / (k + 2)
            work[at.S + i] = (work[at.Y + l] / (k + 1) + w * c) / (k + 2)
        for j in range(at.n):  # F_k in full
            fx = fy = 0.0
            for e in range(whole[at.A_start + j], whole[at.A_start + j + 1]):
                a = work[at.x + whole[at.place + whole[at.A_link + e]]]
                fx += work[at.Z_re + e] * a
                fy += work[at.Z_im + e] * a
            work[at.FX + j * K + k] += fx
            work[at.FY + j * K + k] += fy
        for r in range(at.rows):
            minus_lambda = work[at.x + whole[at.place + at.n + r]]
            for e in range(whole[at.P_start + r], whole[at.P_start + r + 1]):
                i = whole[at.P_link + e] * K + k
                work[at.FX + i] += real[at.P_re + e] * minus_lambda
                work[at.FY + i] -= real[at.P_im + e] * minus_lambda


@_compiled()
def _power(whole, real, work, at):
    """The coefficients of sum_j (tau_j - D_j qd_j) qd_j."""
    rate = np.empty(at.K)
    for k in range(at.K):
        work[at.power + k] = 0.0
    for j in range(at.n):
        above = whole[at.parent + j]
        for k in range(at.order + 1):
            rate[k] = work[at.W + j * at.K + k]
            if above >= 0:
                rate[k] -= work[at.W + above * at.K + k]
            work[at.power + k] += real[at.torque + j] * rate[k]
        if real[at.damping + j] != 0.0:
            for k in range(at.order + 1):
                square = 0.0
                for m in range(k + 1):
                    square += rate[m] * rate[k - m]
                work[at.power + k] -= real[at.damping + j] * square


@_compiled()
def _longest(work, at, atol, rtol):
    """The step whose last terms are within the tolerance, s; -1 where they are not finite."""
    speed = 0.0
    for l in range(at.n):
        speed = max(speed, abs(work[at.W + l * at.K]))
    h = math.inf
    # from rest every second coefficient vanishes, and from rest at right angles to gravity only
    # every fourth is left
    for order in range(at.order - 3, at.order + 1):
        largest = 0.0
        for l in range(at.n):
            value = work[at.W + l * at.K + order]
            if not math.isfinite(value):
                return -1.0
            largest = max(largest, abs(value))
        if largest > 0.0:
            h = min(h, ((atol + rtol * speed) / largest) ** (1.0 / order))
            h = min(h, ((atol + rtol) * (order + 1) / largest) ** (1.0 / (order + 1)))
    return h


@_compiled()
def _evaluate(whole, work, at, h, y, i, new, j, N):
    """The state at h after y[i:], into new[j:]; N numbers: q, qd, and the work if asked for."""
    power = 1.0
    for k in range(at.order + 1):
        work[at.h + k] = power
        power *= h
        work[at.h_angle + k] = power / (k + 1)
    for l in range(at.n):
        W = at.W + l * at.K
        work[at.X + l] = _dot(work, W, at.h_angle, at.order + 1)
        work[at.Y + l] = _dot(work, W + 1, at.h + 1, at.order)
    for l in range(at.n):  # changes are small, and exact to their own rounding
        above = whole[at.parent + l]
        turn, change = work[at.X + l], work[at.Y + l]
        if above >= 0:
            turn -= work[at.X + above]
            change -= work[at.Y + above]
        new[j + l] = y[i + l] + turn
        new[j + at.n + l] = y[i + at.n + l] + change
    if 2 * at.n < N:
        done = _dot(work, at.power, at.h_angle, at.order + 1)
        new[j + N - 1] = y[i + N - 1] + done


@_compiled()
def _copy(values, to, i):
    """to[i:] = values."""
    for m in range(len(values)):
        to[i + m] = values[m]


# -- steps ---------------------------------------------------------------------------------------


@_compiled()
def _land(whole, real, work, at, h, states, i, N):
    """The closed state at h after states[i:], into states[i + N:]; its quality."""
    _evaluate(whole, work, at, h, states, i, states, i + N, N)
    return _close(whole, real, work, at, states, i + N)


@_compiled()
def _advance(whole, real, at, atol, rtol, fixed, suspect, t, y, bound, times, steps):
    """Up to `steps` steps: ends, states (the first is y), how many; rows, how many; a status."""
    N, work = len(y), np.zeros(at.size_of_work)
    ends, states = np.empty(steps), np.empty((steps + 1) * N)
    rows = np.empty(min(len(times), 64) * N)
    taken = given = 0
    direction = 1.0 if bound >= t else -1.0
    _copy(y, states, taken)
    quality = math.inf
    if at.rows > 0 and steps > 0:  # of the start, which itself stays as it is
        _copy(y, states, taken + N)
        quality = _close(whole, real, work, at, states, taken + N)
    _directions(whole, work, at, states, taken)
    for m in range(2 * at.n):
        work[at.c0 + m] = work[at.c + m]
    status = FULL
    while True:
        if t == bound:
            status = REACHED
            break
        if taken == steps:
            break
        if not quality >= suspect:
            status = SINGULAR
            break
        now = taken * N
        _series(whole, real, work, at, states, now)
        if 2 * at.n < N:
            _power(whole, real, work, at)
        longest = _longest(work, at, atol, rtol)
        if longest < 0.0:
            status = NOT_FINITE
            break
        if fixed > 0.0:
            longest = fixed
        best, end, landing = -1.0, t, t
        for part in PARTS:
            h = part * longest
            landing = bound if h >= abs(bound - t) else t + direction * h
            if landing == t:
                break
            quality = _land(whole, real, work, at, landing - t, states, now, N)
            if quality > best or end == t:
                best, end = quality, landing
            if quality >= suspect:
                break
        if end == t:
            status = STUCK
            break
        if landing != end:
            quality = _land(whole, real, work, at, end - t, states, now, N)
        for m in range(2 * at.n):  # c and s of the next start
            work[at.c0 + m] = work[at.c + m]
        while given < len(times) and direction * (end - times[given]) >= 0.0:
            i = given * N
            if i == len(rows):
                longer = np.empty(min(len(times), 2 * given) * N)
                for m in range(i):
                    longer[m] = rows[m]
                rows = longer
            _evaluate(whole, work, at, times[given] - t, states, now, rows, i, N)
            if at.rows > 0:
                _close(whole, real, work, at, rows, i)
            given += 1
        ends[taken] = t = end
        taken += 1
    return ends, states, taken, rows, given, status


# -- the engine ----------------------------------------------------------------------------------


class CompiledEngine:
    """Steps of the Taylor series for constant torques and dampers, compiled (`taylor.Engine`).

    Tolerances are those of angles (rad) and rates (rad/s) over one step.  `order` is the last
    coefficient of the rates that is kept; a `step` (s) replaces what the tolerance would choose.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        actuation: Actuation,
        *,
        rtol: float = 1e-9,
        atol: float = 1e-9,
        order: int | None = None,
        step: float | None = None,
    ) -> None:
        if not self.serves(mechanism, actuation):
            raise ValueError("the compiled series are for constant torques and a regular M and Psi")
        self.order = best_order(rtol) if order is None else order
        self._numbers = _numbers(mechanism, actuation, self.order)
        suspect = suspect_quality(mechanism) if mechanism.rows else 0.0
        self._limits = (float(atol), float(rtol), float(step or 0.0), suspect)

    @classmethod
    def serves(cls, mechanism: Mechanism, actuation: Actuation) -> bool:
        """Whether this engine can: constant torques, M and Psi regular but at single states."""
        if actuation.constants is None or not elimination_is_safe(mechanism):
            return False
        return not mechanism.rows or regular_rank(mechanism) == len(mechanism.rows)

    def advance(self, t: float, y: Array, bound: float, times: Array, steps: int) -> Chunk:
        """Up to `steps` steps from (t, y) towards `bound`; rows at `times` on the way.

        y is (q, qd) in joint coordinates, with the work done (J) appended where it is wanted.
        `times` lie strictly after t in the direction of `bound`, in that order, up to `bound`.
        """
        y, times = (np.require(array, float, ["C", "A", "W"]) for array in (y, times))
        ends, states, taken, rows, given, status = _advance(
            *self._numbers, *self._limits, float(t), y, float(bound), times, steps
        )
        N = len(y)
        states = states[N : (taken + 1) * N].reshape(taken, N)
        rows = rows[: given * N].reshape(given, N)
        return Chunk(ends[:taken], states, times[:given], rows, Status(status))


def best_order(rtol: float) -> int:
    """The order at which a second of motion costs the least, whatever the mechanism."""
    return max(8, math.ceil(6 - 0.7 * math.log(max(rtol, 1e-16))))


def _sizes(mechanism: Mechanism) -> list[float]:
    """What the rows' pivots are measured against, m^2."""
    return [sum(abs(value) for _, value in row.P) ** 2 for row in mechanism.rows]


# -- the mechanism as arrays ---------------------------------------------------------------------


def _numbers(
    mechanism: Mechanism, actuation: Actuation, order: int
) -> tuple[Integers, Array, Layout]:
    """`whole`, `real` and where things are in them and in `work`."""
    assert actuation.constants is not None
    n, r = mechanism.n, len(mechanism.rows)
    parent = [-1 if above is None else above for above in mechanism.parent]
    weight = mechanism.gamma * np.conj(np.array(mechanism.B, complex))
    beside: list[list[tuple[int, complex]]] = [[] for _ in range(n)]
    inertia = [0.0] * n
    for j, k, value in mechanism.A:
        if j == k:
            inertia[j] = value.real
        else:
            beside[j].append((k, value))
            beside[k].append((j, value.conjugate()))
    A = [(j, l, value) for j, entries in enumerate(beside) for l, value in entries]
    P = [(row, l, value) for row, entry in enumerate(mechanism.rows) for l, value in entry.P]

    place = _places(n, A, P)
    pairs = [(place[j], place[l]) for j, l, _ in A] + [(place[n + i], place[l]) for i, l, _ in P]
    first, start, system = _skyline(n + r, pairs)

    joints = [_moving(mechanism, [l for l, _ in row.P]) for row in mechanism.rows]
    joint_start = [0, *itertools.accumulate(len(found) for found in joints)]
    slots = [{k: joint_start[i] + g for g, k in enumerate(found)} for i, found in enumerate(joints)]
    moved: list[list[int]] = [[] for _ in range(n)]  # the rows that each joint moves
    for i, found in enumerate(joints):
        for k in found:
            moved[k].append(i)
    common = {(i, j) for group in moved for i in group for j in group if j < i}
    normal_place = _narrow(r, common)
    normal_first, normal_start, normal = _skyline(
        r, [(normal_place[i], normal_place[j]) for i, j in common]
    )

    whole = {
        "parent": parent,
        "outward": mechanism.order,
        "A_start": _row_starts(n, [j for j, _, _ in A]),
        "A_link": [l for _, l, _ in A],
        "A_spot": [start[place[j]] + place[l] if place[l] < place[j] else -1 for j, l, _ in A],
        "P_start": _row_starts(r, [i for i, _, _ in P]),
        "P_link": [l for _, l, _ in P],
        "P_spot": [start[place[n + i]] + place[l] for i, l, _ in P],
        "P_slot": [slots[i][l] for i, l, _ in P],
        "joint_start": joint_start,
        "joint": [k for found in joints for k in found],
        "joint_above": [
            slots[i].get(parent[k], -1) for i, found in enumerate(joints) for k in found
        ],
        "place": place,
        "first": first,
        "start": start,
        "normal_place": normal_place,
        "normal_row": sorted(range(r), key=normal_place.__getitem__),
        "normal_first": normal_first,
        "normal_start": normal_start,
    }
    real = {
        "inertia": inertia,
        "A_re": [value.real for _, _, value in A],
        "A_im": [value.imag for _, _, value in A],
        "weight_re": weight.real,
        "weight_im": weight.imag,
        "damping": mechanism.damping,
        "torque": actuation.constants,
        "P_re": [value.real for _, _, value in P],
        "P_im": [value.imag for _, _, value in P],
        "offset": [row.offset for row in mechanism.rows],
        "size": _sizes(mechanism),
        "closed": [CLOSED * loop_size(mechanism)],
    }
    K = order + 2
    work = dict.fromkeys(("W", "C", "S", "FX", "FY"), n * K)
    work |= {"X": n, "Y": n, "Z_re": len(A), "Z_im": len(A), "power": K}
    work |= {"system": system, "pivot": n + r, "x": n + r}
    work |= {"Psi": joint_start[-1], "normal": normal, "normal_pivot": r, "dense": n}
    work |= {"h": K, "h_angle": K, "alpha": n, "c": n, "s": n, "c0": n, "s0": n}
    at: dict[str, int] = {}
    for lengths in (
        {name: len(values) for name, values in whole.items()},
        {name: len(values) for name, values in real.items()},
        work,
    ):
        begins = itertools.accumulate(lengths.values(), initial=0)
        at |= dict(zip(lengths, begins, strict=False))
    sizes = {"n": n, "rows": r, "entries": len(P), "order": order, "K": K}
    return (
        np.concatenate([np.array(values, np.int64) for values in whole.values()]),
        np.concatenate([np.array(values, np.float64) for values in real.values()]),
        Layout(**sizes, **at, size_of_work=sum(work.values())),
    )


def _row_starts(rows: int, row: Sequence[int]) -> list[int]:
    """Where the rows of entries sorted by row begin, and where the last ends."""
    counts = [0] * rows
    for i in row:
        counts[i] += 1
    return [0, *itertools.accumulate(counts)]


def _moving(mechanism: Mechanism, links: Sequence[int]) -> list[int]:
    """The joints that move any of these links, leaves first."""
    moving = set()
    for link in links:
        above: int | None = link
        while above is not None and above not in moving:
            moving.add(above)
            above = mechanism.parent[above]
    return [k for k in reversed(mechanism.order) if k in moving]


def _places(
    n: int, A: Sequence[tuple[int, int, complex]], P: Sequence[tuple[int, int, complex]]
) -> list[int]:
    """Where links and rows stand in the system: a row after its links, so that no pivot is zero.

    (The links before it have a positive definite M of their own, and the rows full rank on them.)
    """
    members: dict[int, list[int]] = {}
    for row, l, _ in P:
        members.setdefault(row, []).append(l)
    pairs = {(j, l) for j, l, _ in A if l < j}
    pairs |= {(j, l) for links in members.values() for j in links for l in links if l < j}
    narrow = _narrow(n, pairs)
    keys = [(float(narrow[l]), 0) for l in range(n)]
    keys += [(float(max(narrow[l] for l in members[row])), 1 + row) for row in sorted(members)]
    place = [0] * len(keys)
    for i, which in enumerate(sorted(range(len(keys)), key=keys.__getitem__)):
        place[which] = i
    return place


def _narrow(n: int, pairs: set[tuple[int, int]]) -> list[int]:
    """The place of each of n unknowns that keeps coupled pairs together, for large systems."""
    if n <= SMALL or len(pairs) > n * n // 4:
        return list(range(n))
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    i, j = np.array(sorted(pairs)).T
    graph = csr_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(n, n))
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    place: list[int] = np.argsort(order).tolist()
    size, plain = (_skyline(n, [(to[a], to[b]) for a, b in pairs])[2] for to in (place, range(n)))
    return place if size < plain else list(range(n))


def _skyline(n: int, pairs: Iterable[tuple[int, int]]) -> tuple[list[int], list[int], int]:
    """`first` and `start` (n) of a matrix with these entries, and how many numbers it takes."""
    first = list(range(n))
    for i, j in pairs:
        first[max(i, j)] = min(first[max(i, j)], i, j)
    ends = list(itertools.accumulate(i - first[i] + 1 for i in range(n)))
    start = [ends[i] - 1 - i for i in range(n)]
    return first, start, ends[-1] if ends else 0
