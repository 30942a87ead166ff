"""One motion of a sweep by a single simulation, for what lanes do not serve.

Friction, couplings, and motions that pass change points go this way: by DOP853 where the scene has
forces of its own (friction that sets in sharply shows in no series ahead of it), else by the Taylor
series.  Between the quarter points of its steps q is the polynomial of degree 5 that
has q, qd and qdd of both: extremes and crossings are those of these polynomials.
"""

from __future__ import annotations

import math
import warnings

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics import closed_form
from robodyn.errors import RobodynError, SingularError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.recording import Outcome
from robodyn.simulation.simulation import SCIPY_RTOL, Motion, simulate
from robodyn.sweeps.lanes import Aims, Ends
from robodyn.sweeps.step_extremes import QUARTERS, crossings, extremes

Array = NDArray[np.float64]

CANNOT_START = "cannot start"


def single(
    mechanism: Mechanism,
    y: Array,
    tau: Array,
    t_end: float,
    angle: float,
    aims: Aims,
    ends: Ends,
    lane: int,
) -> str:
    """The motion from y (2n,) under torques tau (n,), into lane `lane` of `ends`; its outcome."""
    n = mechanism.n

    def run(times: Array | None) -> Motion:
        return simulate(
            mechanism,
            y[:n],
            y[n:],
            t_end,
            tau=tau.tolist(),
            method="DOP853" if mechanism.has_state_forces else "taylor",
            engine="auto" if mechanism.has_state_forces else "python",
            rtol=max(aims.rtol, SCIPY_RTOL),
            atol=aims.atol,
            max_evals=aims.most,
            t_eval=times,
        )

    try:
        motion = run(None)
        report, outcome = motion.report, motion.outcome.label
        t = motion.t
        if len(t) > 1 and (aims.extremes or aims.link >= 0):
            parts = np.arange(QUARTERS) / QUARTERS
            finer = np.append((t[:-1, None] + np.diff(t)[:, None] * parts).ravel(), t[-1])
            finer = finer[np.append(True, np.diff(finer) != 0.0)]
            motion = _between(run(finer), motion)
    except SingularError:
        return Outcome.SINGULAR.label
    except RobodynError:
        return CANNOT_START
    state = np.concatenate([motion.q, motion.qd], axis=1)
    energy = np.sum(closed_form.energies(mechanism, motion.q, motion.qd), axis=0)
    energy -= mechanism.energy_offset
    ends.t[lane], ends.y[lane], ends.steps[lane] = motion.t[-1], state[-1], report.steps
    ends.energy[lane] = energy.min(), energy.max()
    ends.drift[lane], ends.flip[lane] = report.energy_drift, math.nan
    ends.low[lane], ends.high[lane] = state.min(axis=0), state.max(axis=0)
    if len(motion.t) > 1 and (aims.extremes or aims.link >= 0):
        _inner(mechanism, motion, angle, aims, ends, lane)
    return outcome


def _between(finer: Motion, whole: Motion) -> Motion:
    """The finer motion; where it did not get as far as the whole one, that."""
    return finer if len(finer.t) and finer.t[-1] == whole.t[-1] else whole


def _inner(
    mechanism: Mechanism, motion: Motion, angle: float, aims: Aims, ends: Ends, lane: int
) -> None:
    """What q does between the rows of a motion."""
    n, h = mechanism.n, np.diff(motion.t)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # remarks belong to single motions
        rates = _pieces(motion.q, motion.qd, motion.qdd, h)
    low, high, rate_low, rate_high = extremes(rates, h)
    begin = motion.q[:-1].T
    for to, inner, choose in (
        (ends.low, np.concatenate([begin + low, rate_low]), np.minimum),
        (ends.high, np.concatenate([begin + high, rate_high]), np.maximum),
    ):
        ends_of = inner.min(axis=1) if choose is np.minimum else inner.max(axis=1)
        to[lane] = choose(to[lane, : 2 * n], ends_of)
    if aims.link < 0:
        return
    path = mechanism.arrays.J[aims.link]
    alpha = motion.q @ path
    x = crossings(angle + alpha[:-1] - alpha[0], np.einsum("kjb,j->kb", rates, path), h, math.pi)
    (found,) = np.nonzero(~np.isnan(x))
    if len(found):
        ends.flip[lane] = motion.t[found[0]] + x[found[0]]


def _pieces(q: Array, v: Array, a: Array, h: Array) -> Array:
    """The coefficients (5, n, B) of qd between rows (B + 1, n) h (B,) apart."""
    h = h[:, None]
    d = q[1:] - q[:-1] - h * (v[:-1] + 0.5 * h * a[:-1])
    e = v[1:] - v[:-1] - h * a[:-1]
    f = a[1:] - a[:-1]
    third = (10.0 * d - 4.0 * e * h + 0.5 * f * h**2) / h**3
    fourth = (-15.0 * d + 7.0 * e * h - f * h**2) / h**4
    fifth = (6.0 * d - 3.0 * e * h + 0.5 * f * h**2) / h**5
    parts = [v[:-1], a[:-1], 3.0 * third, 4.0 * fourth, 5.0 * fifth]
    return np.stack([part.T for part in parts])
