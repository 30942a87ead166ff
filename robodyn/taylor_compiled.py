"""The Taylor-series engine in compiled code: one function for all mechanisms, cached on disk.

With E_k = c_k + i s_k = exp(i alpha_k), w = d(alpha)/dt and a = dw/dt, the coefficients obey

    E' = i w E             (k+1) E_{k+1} = i sum_m w_m E_{k-m}
    P = E''                P_k = (k+1)(X_k + i Y_k) + i a_k E_0,  X_k + i Y_k = i sum w_m E_{k+1-m}
    F = A P - gamma conj(B) - P_closure^H lambda                  Re(conj(i E_j) F_j) = tau_j

so that (a_k, -lambda_k) solves [M Psi^T; Psi 0] of the step's start with a right side of two
convolutions a link; the factors serve all orders.  The mechanism enters as arrays only: nothing is
ever compiled for another one.  Series run along rows, E's backwards: convolutions are then products
of adjacent numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from robodyn.actuation import Actuation
from robodyn.assembly import loop_size
from robodyn.dense_dynamics import elimination_is_safe
from robodyn.mechanism import Mechanism
from robodyn.projection import CLOSED, regular_rank
from robodyn.taylor import Chunk, Status

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
F = TypeVar("F", bound=Callable[..., object])

PASSES = 3
SUSPECT = 1e-2  # quality of the closures below which no step may start
HOPELESS = 1e-8  # quality below which a projection would add more noise than it takes away
PARTS = (1.0, 0.85, 0.7, 0.55, 0.4)  # of a step, where it may land to avoid a suspect state
SMALL = 24  # links and rows up to which an ordering is not worth its search

REACHED, FULL = int(Status.REACHED), int(Status.FULL)
SINGULAR, STUCK, NOT_FINITE = int(Status.SINGULAR), int(Status.STUCK), int(Status.NOT_FINITE)


class Skyline(NamedTuple):
    """A symmetric matrix by rows of its lower triangle, each from its first entry to the diagonal.

    Entry (i, j) is at start[i] + j for first[i] <= j <= i.
    """

    first: Integers
    start: Integers
    size: int  # number of entries


class Model(NamedTuple):
    """A mechanism as arrays: n links, r closure rows; sparse rows as in CSR."""

    parent: Integers  # (n,), -1 for the ground
    order: Integers  # (n,), parents first
    inertia: Array  # (n,) A_jj, kg m^2
    A_start: Integers  # (n + 1,) A's entries beside the diagonal, both triangles
    A_link: Integers
    A_re: Array  # kg m^2
    A_im: Array
    A_spot: Integers  # where M_jl goes in the system; -1 for the upper triangle
    weight_re: Array  # (n,) gamma conj(B), N
    weight_im: Array
    damping: Array  # (n,) N m s/rad
    torque: Array  # (n,) N m
    P_start: Integers  # (r + 1,)
    P_link: Integers
    P_re: Array
    P_im: Array
    P_spot: Integers  # where Psi's entry goes in the system
    P_slot: Integers  # where it goes among the row's joints
    offset: Array  # (r,) m
    size: Array  # (r,) square of a row's sum of |P|, m^2
    joint_start: Integers  # (r + 1,) the joints that move a row's points, leaves first
    joint: Integers
    joint_above: Integers  # slot of the joint's parent, or -1
    place: Integers  # (n + r,) of links and rows in the system
    first: Integers  # the system [M Psi^T; Psi 0] as a skyline
    start: Integers
    normal_place: Integers  # (r,) of rows in Psi Psi^T
    normal_row: Integers  # (r,) the row at each place
    normal_first: Integers
    normal_start: Integers
    numbers: Array  # entries of the system, of Psi Psi^T; gap that is rounding, m


def _compiled(associative: bool = False) -> Callable[[F], F]:
    """A decorator that compiles; with the sums of `associative` functions in any order."""
    options = {"error_model": "numpy", "fastmath": {"reassoc", "contract"} if associative else {}}

    def decorate(function: F) -> F:
        compiled: F
        try:
            compiled = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no directory to write a cache to
            compiled = numba.njit(**options)(function)
        return compiled

    return decorate


# -- linear algebra ------------------------------------------------------------------------------


@_compiled(associative=True)
def _dot(a, b):
    total = 0.0
    for m in range(len(a)):
        total += a[m] * b[m]
    return total


@_compiled(associative=True)
def _turned(w, c, s):
    """Real and imaginary part of i sum w (c + i s)."""
    x = y = 0.0
    for m in range(len(w)):
        x -= w[m] * s[m]
        y += w[m] * c[m]
    return x, y


@_compiled(associative=True)
def _moment(c, s, fx, fy):
    """Sum of c fy - s fx."""
    total = 0.0
    for m in range(len(c)):
        total += c[m] * fy[m] - s[m] * fx[m]
    return total


@_compiled()
def _factorise(L, pivot, first, start):
    """L D L^T of a skyline, in place; `pivot` receives the inverse of D."""
    for i in range(len(first)):
        fi, si = first[i], start[i]
        for j in range(fi + 1, i):
            low = max(fi, first[j])
            if low < j:
                sj = start[j]
                L[si + j] -= _dot(L[si + low : si + j], L[sj + low : sj + j])
        d = L[si + i]
        for j in range(fi, i):
            value = L[si + j]
            L[si + j] = value * pivot[j]
            d -= value * L[si + j]
        L[si + i] = d
        pivot[i] = 1.0 / d


@_compiled()
def _solve(L, pivot, first, start, x):
    """x := (L D L^T)^-1 x."""
    for i in range(1, len(first)):
        fi, si = first[i], start[i]
        x[i] -= _dot(L[si + fi : si + i], x[fi:i])
    for i in range(len(first)):
        x[i] *= pivot[i]
    for i in range(len(first) - 1, 0, -1):
        si = start[i]
        for j in range(first[i], i):
            x[j] -= L[si + j] * x[i]


# -- closures ------------------------------------------------------------------------------------


@_compiled()
def _directions(model, q, c, s):
    """c and s (n,) of E."""
    alpha = np.empty(len(q))
    for k in model.order:
        above = model.parent[k]
        alpha[k] = q[k] if above < 0 else alpha[above] + q[k]
        c[k] = math.cos(alpha[k])
        s[k] = math.sin(alpha[k])


@_compiled()
def _normal(model, c, s, Psi, normal, pivot, dense):
    """Psi in joint coordinates, one value a `joint`, and Psi Psi^T factorised.

    Returns its least pivot, relative to the rows' sizes: about d^2 at a distance d from a
    configuration where Psi loses rank.
    """
    rows = len(model.offset)
    for r in range(rows):
        begin, end = model.joint_start[r], model.joint_start[r + 1]
        Psi[begin:end] = 0.0
        for e in range(model.P_start[r], model.P_start[r + 1]):
            k = model.P_link[e]
            Psi[model.P_slot[e]] = -(model.P_re[e] * s[k] + model.P_im[e] * c[k])
        for g in range(begin, end):
            if model.joint_above[g] >= 0:
                Psi[model.joint_above[g]] += Psi[g]
    for i in range(rows):
        r = model.normal_row[i]
        for g in range(model.joint_start[r], model.joint_start[r + 1]):
            dense[model.joint[g]] = Psi[g]
        for j in range(model.normal_first[i], i + 1):
            other = model.normal_row[j]
            total = 0.0
            for g in range(model.joint_start[other], model.joint_start[other + 1]):
                total += Psi[g] * dense[model.joint[g]]
            normal[model.normal_start[i] + j] = total
        for g in range(model.joint_start[r], model.joint_start[r + 1]):
            dense[model.joint[g]] = 0.0
    _factorise(normal, pivot, model.normal_first, model.normal_start)
    quality = math.inf
    for i in range(rows):
        relative = normal[model.normal_start[i] + i] / model.size[model.normal_row[i]]
        if not relative >= quality:  # nan is the worst
            quality = relative
    return quality


@_compiled()
def _subtract(model, Psi, normal, pivot, x, values):
    """values -= Psi^T (Psi Psi^T)^-1 x."""
    _solve(normal, pivot, model.normal_first, model.normal_start, x)
    for i in range(len(model.offset)):
        r = model.normal_row[i]
        for g in range(model.joint_start[r], model.joint_start[r + 1]):
            values[model.joint[g]] -= Psi[g] * x[i]


@_compiled()
def _close(model, q, qd, c, s, work):
    """Move q and qd to the nearest state that closes; c, s: E there.  Returns its quality."""
    _directions(model, q, c, s)
    rows = len(model.offset)
    if rows == 0:
        return math.inf
    Psi, normal, pivot, dense, x = work.Psi, work.normal, work.normal_pivot, work.dense, work.x
    before = math.inf
    for trial in range(PASSES + 1):
        largest = 0.0
        for r in range(rows):
            gap = model.offset[r]
            for e in range(model.P_start[r], model.P_start[r + 1]):
                k = model.P_link[e]
                gap += model.P_re[e] * c[k] - model.P_im[e] * s[k]
            x[model.normal_place[r]] = gap
            largest = max(largest, abs(gap))
        quality = _normal(model, c, s, Psi, normal, pivot, dense)
        if not quality > HOPELESS:
            return quality
        # what is closed to rounding stays: moving it would add noise
        if largest <= model.numbers[2] or largest > 0.5 * before or trial == PASSES:
            break
        before = largest
        _subtract(model, Psi, normal, pivot, x, q)
        _directions(model, q, c, s)
    for i in range(rows):
        r = model.normal_row[i]
        total = 0.0
        for g in range(model.joint_start[r], model.joint_start[r + 1]):
            total += Psi[g] * qd[model.joint[g]]
        x[i] = total
    _subtract(model, Psi, normal, pivot, x, qd)
    return quality


# -- series --------------------------------------------------------------------------------------


class Work(NamedTuple):
    """What a call works in; K = order + 2 coefficients a series."""

    W: Array  # (n, K) of w
    C: Array  # (n, K) of c, backwards: coefficient k at K - 1 - k
    S: Array  # (n, K) of s, backwards
    FX: Array  # (n, K)
    FY: Array
    X: Array  # (n,) at one order
    Y: Array
    Z_re: Array  # i A_jl E_l at the start, as A
    Z_im: Array
    power: Array  # (K,) of torques less dampers
    L: Array  # the system
    pivot: Array  # (n + r,)
    x: Array  # (n + r,)
    Psi: Array  # as model.joint
    normal: Array  # Psi Psi^T
    normal_pivot: Array  # (r,)
    dense: Array  # (n,), zero between uses
    h: Array  # (K,) powers of a time
    h_angle: Array


@_compiled()
def _work(model, order):
    n, r, K = len(model.parent), len(model.offset), order + 2
    return Work(
        np.zeros((n, K)),
        np.zeros((n, K)),
        np.zeros((n, K)),
        np.zeros((n, K)),
        np.zeros((n, K)),
        np.empty(n),
        np.empty(n),
        np.empty(len(model.A_link)),
        np.empty(len(model.A_link)),
        np.zeros(K),
        np.empty(int(model.numbers[0])),
        np.empty(n + r),
        np.empty(n + r),
        np.empty(len(model.joint)),
        np.empty(int(model.numbers[1])),
        np.empty(r),
        np.zeros(n),
        np.empty(K),
        np.empty(K),
    )


@_compiled()
def _system(model, c, s, work):
    """[M Psi^T; Psi 0] at the directions c, s, factorised; Z = i A E beside the diagonal."""
    n, L = len(model.parent), work.L
    L[:] = 0.0
    for j in range(n):
        i = model.place[j]
        L[model.start[i] + i] = model.inertia[j]
        for e in range(model.A_start[j], model.A_start[j + 1]):
            l = model.A_link[e]
            re = -(model.A_re[e] * s[l] + model.A_im[e] * c[l])
            im = model.A_re[e] * c[l] - model.A_im[e] * s[l]
            work.Z_re[e], work.Z_im[e] = re, im
            if model.A_spot[e] >= 0:
                L[model.A_spot[e]] = c[j] * im - s[j] * re
    for e in range(len(model.P_link)):
        l = model.P_link[e]
        L[model.P_spot[e]] = -(model.P_re[e] * s[l] + model.P_im[e] * c[l])
    _factorise(L, work.pivot, model.first, model.start)


@_compiled()
def _series(model, order, q, qd, c, s, work):
    """The coefficients of w up to `order`, from the state and its directions."""
    n, rows, top = len(model.parent), len(model.offset), order + 1
    W, C, S, FX, FY, X, Y, x = (work.W, work.C, work.S, work.FX, work.FY, work.X, work.Y, work.x)
    _system(model, c, s, work)
    for l in model.order:
        above = model.parent[l]
        W[l, 0] = qd[l] if above < 0 else W[above, 0] + qd[l]
        C[l, top], S[l, top] = c[l], s[l]
        C[l, top - 1], S[l, top - 1] = -W[l, 0] * s[l], W[l, 0] * c[l]
        FX[l, 0], FY[l, 0] = -model.weight_re[l], -model.weight_im[l]
        FX[l, 1:], FY[l, 1:] = 0.0, 0.0
    for k in range(order):
        for l in range(n):  # what is known of P_k
            re, im = _turned(W[l, : k + 1], C[l, top - k - 1 : top], S[l, top - k - 1 : top])
            X[l], Y[l] = (k + 1) * re, (k + 1) * im
        for j in range(n):
            fx, fy = FX[j, k], FY[j, k]
            for e in range(model.A_start[j], model.A_start[j + 1]):
                l = model.A_link[e]
                fx += model.A_re[e] * X[l] - model.A_im[e] * Y[l]
                fy += model.A_re[e] * Y[l] + model.A_im[e] * X[l]
            FX[j, k], FY[j, k] = fx, fy
            x[model.place[j]] = -_moment(
                C[j, top - k : top + 1], S[j, top - k : top + 1], FX[j, : k + 1], FY[j, : k + 1]
            )
        for j in range(n):  # a joint takes from the parent what it puts on its link
            above = model.parent[j]
            rate = W[j, k] if above < 0 else W[j, k] - W[above, k]
            torque = -model.damping[j] * rate
            if k == 0:
                torque += model.torque[j]
            x[model.place[j]] += torque
            if above >= 0:
                x[model.place[above]] -= torque
        for r in range(rows):
            total = 0.0
            for e in range(model.P_start[r], model.P_start[r + 1]):
                l = model.P_link[e]
                total += model.P_re[e] * X[l] - model.P_im[e] * Y[l]
            x[model.place[n + r]] = -total
        _solve(work.L, work.pivot, model.first, model.start, x)
        for l in range(n):
            w = x[model.place[l]] / (k + 1)
            W[l, k + 1] = w
            if k + 2 <= top:
                C[l, top - k - 2] = (X[l] / (k + 1) - w * s[l]) / (k + 2)
                S[l, top - k - 2] = (Y[l] / (k + 1) + w * c[l]) / (k + 2)
        for j in range(n):
            fx, fy = FX[j, k], FY[j, k]
            for e in range(model.A_start[j], model.A_start[j + 1]):
                a = x[model.place[model.A_link[e]]]
                fx += work.Z_re[e] * a
                fy += work.Z_im[e] * a
            FX[j, k], FY[j, k] = fx, fy
        for r in range(rows):
            minus_lambda = x[model.place[n + r]]
            for e in range(model.P_start[r], model.P_start[r + 1]):
                l = model.P_link[e]
                FX[l, k] += model.P_re[e] * minus_lambda
                FY[l, k] -= model.P_im[e] * minus_lambda


@_compiled()
def _power(model, order, work):
    """The coefficients of sum_j (tau_j - D_j qd_j) qd_j."""
    power, rate = work.power, np.empty(order + 1)
    power[:] = 0.0
    for j in range(len(model.parent)):
        above = model.parent[j]
        for k in range(order + 1):
            rate[k] = work.W[j, k] if above < 0 else work.W[j, k] - work.W[above, k]
            power[k] += model.torque[j] * rate[k]
        if model.damping[j] != 0.0:
            for k in range(order + 1):
                square = 0.0
                for m in range(k + 1):
                    square += rate[m] * rate[k - m]
                power[k] -= model.damping[j] * square


@_compiled()
def _longest(model, order, atol, rtol, W):
    """The step after which the last terms kept are within the tolerance, s; -1: not finite."""
    n = len(model.parent)
    speed = before = last = 0.0
    for l in range(n):
        if not math.isfinite(W[l, order] + W[l, order - 1]):
            return -1.0
        speed = max(speed, abs(W[l, 0]))
        before = max(before, abs(W[l, order - 1]))
        last = max(last, abs(W[l, order]))
    h = math.inf
    if before > 0.0:
        h = ((atol + rtol * speed) / before) ** (1.0 / (order - 1))
    if last > 0.0:
        h = min(h, ((atol + rtol * speed) / last) ** (1.0 / order))
        h = min(h, ((atol + rtol) * (order + 1) / last) ** (1.0 / (order + 1)))
    return h


@_compiled()
def _evaluate(model, order, h, y, new, work):
    """The series at h after the state y: `new` = (q, qd) and the work, where y has it."""
    n, W = len(model.parent), work.W
    power = 1.0
    for k in range(order + 1):
        work.h[k] = power
        power *= h
        work.h_angle[k] = power / (k + 1)
    h_rate, h_angle = work.h[1 : order + 1], work.h_angle[: order + 1]
    for l in model.order:  # the small terms first
        turn = _dot(W[l, : order + 1], h_angle)
        change = _dot(W[l, 1 : order + 1], h_rate)
        new[l], new[n + l] = turn, change
    for l in model.order[::-1]:
        above = model.parent[l]
        if above >= 0:
            new[l] -= new[above]
            new[n + l] -= new[n + above]
    for i in range(2 * n):
        new[i] += y[i]
    if len(y) > 2 * n:
        new[2 * n] = y[2 * n] + _dot(work.power[: order + 1], h_angle)


# -- steps ---------------------------------------------------------------------------------------


@_compiled()
def _advance(model, order, atol, rtol, fixed, t, y, bound, times, steps):
    """Up to `steps` steps; ends, states, how many, rows, how many, and a status."""
    n, N, work = len(model.parent), len(y), _work(model, order)
    c, s, c_best, s_best = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    ends, states = np.empty(steps), np.empty((steps, N))
    rows = np.empty((min(len(times), 64), N))
    taken = given = 0
    direction = 1.0 if bound >= t else -1.0
    now = y.copy()
    trial = y.copy()
    quality = _close(model, trial[:n], trial[n : 2 * n], c, s, work)
    _directions(model, now[:n], c, s)
    while True:
        if t == bound:
            return ends, states, taken, rows, given, REACHED
        if taken == steps:
            return ends, states, taken, rows, given, FULL
        if not quality >= SUSPECT:
            return ends, states, taken, rows, given, SINGULAR
        _series(model, order, now[:n], now[n : 2 * n], c, s, work)
        if 2 * n < N:
            _power(model, order, work)
        longest = _longest(model, order, atol, rtol, work.W)
        if longest < 0.0:
            return ends, states, taken, rows, given, NOT_FINITE
        if fixed > 0.0:
            longest = fixed
        best = -1.0
        end = t
        for part in PARTS:
            h = part * longest
            landing = bound if h >= abs(bound - t) else t + direction * h
            if landing == t:
                break
            _evaluate(model, order, landing - t, now, trial, work)
            found = _close(model, trial[:n], trial[n : 2 * n], c, s, work)
            if found > best:
                best, end = found, landing
                states[taken] = trial
                c_best[:], s_best[:] = c, s
            if found >= SUSPECT:
                break
        if end == t:
            return ends, states, taken, rows, given, STUCK
        ends[taken] = end
        while given < len(times) and direction * (end - times[given]) >= 0.0:
            if given == len(rows):
                longer = np.empty((min(len(times), 2 * given), N))
                longer[:given] = rows
                rows = longer
            if times[given] == end:
                rows[given] = states[taken]
            else:
                row = rows[given]
                _evaluate(model, order, times[given] - t, now, row, work)
                _close(model, row[:n], row[n : 2 * n], c, s, work)
            given += 1
        now[:] = states[taken]
        c[:], s[:], quality, t = c_best, s_best, best, end
        taken += 1


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
        self._n = mechanism.n
        self._model = _model(mechanism, actuation)
        self._tolerances = (float(atol), float(rtol), 0.0 if step is None else float(step))

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
        atol, rtol, step = self._tolerances
        ends, states, taken, rows, given, status = _advance(
            self._model, self.order, atol, rtol, step, float(t), y, float(bound), times, steps
        )
        return Chunk(ends[:taken], states[:taken], times[:given], rows[:given], Status(status))


def best_order(rtol: float) -> int:
    """The order at which a second of motion costs the least, whatever the mechanism."""
    return max(8, math.ceil(-math.log(max(rtol, 1e-16)) / 2) + 2)


# -- the mechanism as arrays ---------------------------------------------------------------------


def _model(mechanism: Mechanism, actuation: Actuation) -> Model:
    assert actuation.constants is not None
    n, r = mechanism.n, len(mechanism.rows)
    parent = [-1 if above is None else above for above in mechanism.parent]
    weight = mechanism.gamma * np.conj(np.array(mechanism.B, complex))

    beside: list[list[tuple[int, complex]]] = [[] for _ in range(n)]
    inertia = np.zeros(n)
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
    system = _skyline(n + r, pairs)
    A_spot = [
        system.start[place[j]] + place[l] if place[l] < place[j] else -1 for j, l, _ in A
    ]  # M_jl of the lower triangle
    P_spot = [system.start[place[n + i]] + place[l] for i, l, _ in P]

    joints = [_moving(mechanism, [l for l, _ in row.P]) for row in mechanism.rows]
    joint_start = np.concatenate([[0], np.cumsum([len(x) for x in joints])]).astype(np.int64)
    slots = [
        {k: int(joint_start[i]) + g for g, k in enumerate(found)} for i, found in enumerate(joints)
    ]
    joint_above = [slots[i].get(parent[k], -1) for i, found in enumerate(joints) for k in found]
    sharing: list[list[int]] = [[] for _ in range(n)]
    for i, found in enumerate(joints):
        for k in found:
            sharing[k].append(i)
    common = {(i, j) for group in sharing for i in group for j in group if j < i}
    normal_place = _narrow(r, common)
    normal = _skyline(r, [(normal_place[i], normal_place[j]) for i, j in common])

    return Model(
        parent=_integers(parent),
        order=_integers(mechanism.order),
        inertia=inertia,
        A_start=_row_starts(n, [j for j, _, _ in A]),
        A_link=_integers([l for _, l, _ in A]),
        A_re=_floats([value.real for _, _, value in A]),
        A_im=_floats([value.imag for _, _, value in A]),
        A_spot=_integers(A_spot),
        weight_re=_floats(weight.real),
        weight_im=_floats(weight.imag),
        damping=_floats(mechanism.damping),
        torque=_floats(actuation.constants),
        P_start=_row_starts(r, [i for i, _, _ in P]),
        P_link=_integers([l for _, l, _ in P]),
        P_re=_floats([value.real for _, _, value in P]),
        P_im=_floats([value.imag for _, _, value in P]),
        P_spot=_integers(P_spot),
        P_slot=_integers([slots[i][l] for i, l, _ in P]),
        offset=_floats([row.offset for row in mechanism.rows]),
        size=_floats([sum(abs(value) for _, value in row.P) ** 2 for row in mechanism.rows]),
        joint_start=joint_start,
        joint=_integers([k for found in joints for k in found]),
        joint_above=_integers(joint_above),
        place=_integers(place),
        first=system.first,
        start=system.start,
        normal_place=_integers(normal_place),
        normal_row=_integers(np.argsort(np.array(normal_place, int))),
        normal_first=normal.first,
        normal_start=normal.start,
        numbers=_floats([system.size, normal.size, CLOSED * loop_size(mechanism)]),
    )


def _integers(values: Sequence[int] | NDArray[np.signedinteger]) -> Integers:
    return np.array(values, np.int64)


def _floats(values: Sequence[float] | Array) -> Array:
    return np.array(values, np.float64)


def _row_starts(rows: int, row: Sequence[int]) -> Integers:
    """CSR's row pointers for entries sorted by row."""
    counts = np.bincount(_integers(row), minlength=rows)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


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
    plain = _skyline(n, list(pairs))
    moved = _skyline(n, [(place[a], place[b]) for a, b in pairs])
    return place if moved.size < plain.size else list(range(n))


def _skyline(n: int, pairs: Sequence[tuple[int, int]]) -> Skyline:
    """The skyline of a symmetric n by n matrix with these entries and its diagonal."""
    first = np.arange(n)
    for i, j in pairs:
        low, high = (i, j) if i < j else (j, i)
        first[high] = min(first[high], low)
    lengths = np.arange(n) - first + 1
    start = np.cumsum(lengths) - lengths - first
    return Skyline(first.astype(np.int64), start.astype(np.int64), int(lengths.sum()))
