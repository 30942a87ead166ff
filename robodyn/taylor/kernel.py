"""The compiled loops of the Taylor series, generic in the numeric model.

With E_k = c_k + i s_k = exp(i alpha_k), w = d(alpha)/dt and a = dw/dt, the coefficients obey

    E' = i w E             (k+1) E_{k+1} = i sum_m w_m E_{k-m}
    P = E''                P_k = (k+1)(X_k + i Y_k) + i a_k E_0,  X_k + i Y_k = i sum w_m E_{k+1-m}
    F = A P - conj(weight) - P_closure^H lambda                   Re(conj(i E_j) F_j) = tau_j

so that (a_k, -lambda_k) solves [M Psi^T; Psi 0] of the step's start with a right side of two
convolutions a link; the factors serve all orders.  Where the numbers lie, `layout.py` says.
Series run along rows, those of E backwards: convolutions are then products of adjacent numbers.
"""

# compiled functions are not annotated: types are numba's to infer
# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

from robodyn.taylor import HOPELESS, PARTS, PASSES, Status

F = TypeVar("F", bound=Callable[..., object])

REACHED, FULL = int(Status.REACHED), int(Status.FULL)
SINGULAR, STUCK, NOT_FINITE = int(Status.SINGULAR), int(Status.STUCK), int(Status.NOT_FINITE)


def compiled(associative: bool = False, parallel: bool = False) -> Callable[[F], F]:
    """A decorator that compiles; with the sums of `associative` functions in any order.

    `parallel` functions let other threads run.
    """
    fastmath = {"reassoc", "contract"} if associative else False
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": fastmath, "nogil": parallel}
    njit: Any = numba.njit  # annotated in some versions only

    def decorate(function: F) -> F:
        made: F
        try:
            made = njit(cache=True, **options)(function)
        except RuntimeError:  # no directory to write a cache to
            made = njit(**options)(function)
        return made

    return decorate


# -- linear algebra ------------------------------------------------------------------------------
# (unsigned indices: signed ones are checked for counting from the end, which no loop is fast with)


@compiled(associative=True)
def _dot(work, a, b, count):
    """Sum of products of `count` numbers from a and from b."""
    a, b = np.uintp(a), np.uintp(b)
    total = 0.0
    for m in range(np.uintp(count)):
        total += work[a + m] * work[b + m]
    return total


@compiled(associative=True)
def _turned(work, w, c, s, count):
    """Real and imaginary part of i sum w (c + i s)."""
    w, c, s = np.uintp(w), np.uintp(c), np.uintp(s)
    x = y = 0.0
    for m in range(np.uintp(count)):
        x -= work[w + m] * work[s + m]
        y += work[w + m] * work[c + m]
    return x, y


@compiled(associative=True)
def _moment(work, c, s, fx, fy, count):
    """Sum of c fy - s fx."""
    c, s, fx, fy = np.uintp(c), np.uintp(s), np.uintp(fx), np.uintp(fy)
    total = 0.0
    for m in range(np.uintp(count)):
        total += work[c + m] * work[fy + m] - work[s + m] * work[fx + m]
    return total


@compiled()
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


@compiled()
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


@compiled()
def _directions(whole, work, at, y, q):
    """c and s of the angles from y[q]."""
    for i in range(at.n):
        k = whole[at.outward + i]
        above = whole[at.parent + k]
        alpha = y[q + k] if above < 0 else work[at.alpha + above] + y[q + k]
        work[at.alpha + k] = alpha
        work[at.c + k] = math.cos(alpha)
        work[at.s + k] = math.sin(alpha)


@compiled()
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


@compiled()
def _subtract(whole, work, at, y, i):
    """y[i:] -= Psi^T (Psi Psi^T)^-1 x."""
    _solve(whole, work, at.normal, at.normal_pivot, at.normal_first, at.normal_start, at.rows, at.x)
    for r in range(at.rows):
        x = work[at.x + whole[at.normal_place + r]]
        for g in range(whole[at.joint_start + r], whole[at.joint_start + r + 1]):
            y[i + whole[at.joint + g]] -= work[at.Psi + g] * x


@compiled()
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


@compiled()
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


@compiled()
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
                work[at.x + whole[at.place + j]] += real[at.moment + j]
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


@compiled()
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


@compiled()
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


@compiled()
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


@compiled()
def _copy(values, to, i):
    """to[i:] = values."""
    for m in range(len(values)):
        to[i + m] = values[m]


# -- steps ---------------------------------------------------------------------------------------


@compiled()
def _land(whole, real, work, at, h, states, i, N):
    """The closed state at h after states[i:], into states[i + N:]; its quality."""
    _evaluate(whole, work, at, h, states, i, states, i + N, N)
    return _close(whole, real, work, at, states, i + N)


@compiled()
def advance(whole, real, at, atol, rtol, fixed, suspect, t, y, bound, times, steps):
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
        if taken == steps or (given > 0 and given == len(times)):
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
