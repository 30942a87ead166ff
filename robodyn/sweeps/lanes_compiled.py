"""Many motions of one structure in compiled loops, one lane after another, without the GIL.

What `lanes.py` does in numpy, with the loops of `taylor/kernel.py`: threads may share the lanes.
"""

# compiled functions are not annotated: types are numba's to infer
# mypy: disable-error-code="no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.sweeps.lanes import Aims, Ends
from robodyn.sweeps.step_extremes_compiled import crossing, widen
from robodyn.taylor import PARTS
from robodyn.taylor.kernel import (
    FULL,
    NOT_FINITE,
    REACHED,
    SINGULAR,
    STUCK,
    _close,
    _land,
    _longest,
    _power,
    _series,
    compiled,
)
from robodyn.taylor.layout import Layout

Array = NDArray[np.float64]


def integrate(
    whole: NDArray[np.int64],
    reals: Array,
    at: Layout,
    y: Array,
    t_end: float,
    angle: Array,
    aims: Aims,
) -> Ends:
    """See `lanes.integrate`."""
    ends = Ends.room(len(y), at.n)
    arrays = [np.require(x, float, ["C"]) for x in (reals, y, angle)]
    left = [getattr(ends, name) for name in Ends.__slots__]
    advance: Any = advance_lanes
    advance(whole, at, *arrays, float(t_end), aims, *left)
    return ends


@compiled(parallel=True)
def advance_lanes(
    whole,
    at,
    reals,
    y,
    angle,
    t_end,
    aims,
    ends,
    ys,
    lows,
    highs,
    energies,
    drifts,
    flips,
    statuses,
    counts,
):
    """Each lane from its state to t_end; what it leaves behind, into the arrays after `aims`."""
    n = at.n
    N = 2 * n + 1 if aims.work else 2 * n
    work = np.zeros(at.size_of_work)
    states, series = np.empty(2 * N), np.empty((2, at.order + 1))
    direction = 1.0 if t_end >= 0.0 else -1.0
    for lane in range(len(y)):
        real = reals[lane if len(reals) > 1 else 0]
        t, taken = 0.0, 0
        for m in range(2 * n):
            states[m] = y[lane, m]
        for m in range(2 * n, N):
            states[m] = 0.0
        quality = _close(whole, real, work, at, states, 0)
        for m in range(2 * n):
            work[at.c0 + m] = work[at.c + m]
        low, high = lows[lane], highs[lane]
        for m in range(2 * n):
            low[m] = high[m] = states[m]
        phi = angle[lane]
        begun = _angle(whole, states, 0, aims.link)
        KE, PE = _energies(whole, real, work, at, states, 0)
        start, off, moving, PE_low, PE_high = KE + PE, 0.0, KE, PE, PE
        E_low = E_high = start
        flip = math.nan
        status = FULL
        while True:
            if t == t_end:
                status = REACHED
                break
            if taken == aims.most:
                break
            if not quality >= aims.suspect:
                status = SINGULAR
                break
            _series(whole, real, work, at, states, 0)
            if aims.work:
                _power(whole, real, work, at)
            longest = _longest(work, at, aims.atol, aims.rtol)
            if longest < 0.0:
                status = NOT_FINITE
                break
            best, end, landing = -1.0, t, t
            for part in PARTS:
                h = part * longest
                landing = t_end if h >= abs(t_end - t) else t + direction * h
                if landing == t:
                    break
                quality = _land(whole, real, work, at, landing - t, states, 0, N)
                if quality > best or end == t:
                    best, end = quality, landing
                if quality >= aims.suspect:
                    break
            if end == t:
                status = STUCK
                break
            if landing != end:
                quality = _land(whole, real, work, at, end - t, states, 0, N)
            if aims.extremes:
                for j in range(n):
                    widen(whole, work, at, states, j, end - t, low, high, series)
            if aims.link >= 0 and math.isnan(flip):
                now = phi + _angle(whole, states, 0, aims.link) - begun
                flip = t + crossing(whole, work, at, aims.link, now, end - t, series)
            for m in range(N):
                states[m] = states[N + m]
            for m in range(2 * n):  # c and s of the next start
                work[at.c0 + m] = work[at.c + m]
            t = end
            taken += 1
            KE, PE = _energies(whole, real, work, at, states, 0)
            E = KE + PE
            done = states[N - 1] if aims.work else 0.0
            off, moving = max(off, abs(E - done - start)), max(moving, KE)
            PE_low, PE_high = min(PE_low, PE), max(PE_high, PE)
            E_low, E_high = min(E_low, E), max(E_high, E)
            if aims.extremes:  # the states at the ends are closed, the series to the tolerance
                for m in range(2 * n):
                    low[m], high[m] = min(low[m], states[m]), max(high[m], states[m])
        ends[lane], statuses[lane], counts[lane], flips[lane] = t, status, taken, flip
        energies[lane, 0], energies[lane, 1] = E_low, E_high
        moving = max(moving, PE_high - PE_low)
        drifts[lane] = off / moving if moving > 0.0 else 0.0
        for m in range(2 * n):
            ys[lane, m] = states[m]


@compiled()
def _angle(whole, y, q, link):
    """The absolute angle of a link at y[q:]; `parent` stands first in `whole`."""
    total = 0.0
    while link >= 0:
        total += y[q + link]
        link = whole[link]
    return total


@compiled()
def _energies(whole, real, work, at, y, q):
    """KE and PE less its constant, J, at y[q:], whose directions are in c and s."""
    KE = PE = 0.0
    for i in range(at.n):
        l = whole[at.outward + i]
        above = whole[at.parent + l]
        w = y[q + at.n + l]
        if above >= 0:
            w += work[at.X + above]
        work[at.X + l] = w
        c, s = work[at.c + l], work[at.s + l]
        KE += real[at.inertia + l] * w * w
        PE -= real[at.weight_re + l] * c + real[at.weight_im + l] * s
        PE -= real[at.moment + l] * work[at.alpha + l]
    for j in range(at.n):
        for e in range(whole[at.A_start + j], whole[at.A_start + j + 1]):
            l = whole[at.A_link + e]
            x = work[at.c + j] * work[at.c + l] + work[at.s + j] * work[at.s + l]
            y_ = work[at.c + j] * work[at.s + l] - work[at.s + j] * work[at.c + l]
            A = real[at.A_re + e] * x - real[at.A_im + e] * y_
            KE += A * work[at.X + j] * work[at.X + l]
    return 0.5 * KE, PE
