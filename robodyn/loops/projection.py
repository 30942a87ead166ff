"""Projection onto the closures: Newton steps of least norm to the nearest closed state.

    q - Psi^T (Psi Psi^T)^-1 gap(q)    and    qd - Psi^T (Psi Psi^T)^-1 Psi qd

Small mechanisms use generated straight-line code.  Singular values serve if Psi is nearly singular,
if its rows are dependent, or if the code would be long.  Each solver also returns the quality of
Psi, about d^2 at distance d from a configuration where it loses rank.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from robodyn.engines import straightline
from robodyn.engines.coupling_laws import check_laws, laws_of
from robodyn.engines.factors import svd
from robodyn.engines.formulas import projection_formula
from robodyn.errors import LawError
from robodyn.loops import closures
from robodyn.loops.change_points import (
    EXACT,
    SUSPECT,
    Closing,
    lead_across,
    nearest_singular,
    nearness,
    suspect_quality,
)
from robodyn.loops.closing import (
    CLOSED,
    CUT,
    close_positions,
    loop_size,
    loop_terms,
    regular_rank,
    singular_size,
)
from robodyn.loops.misses import Misses
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

FloatClosing = Callable[[float, list[float]], tuple[list[float], float]]

CONVERGED = 1e-15  # a gap that a Newton step from here closes to rounding, and the rates too
# Entries of A and P up to which straight-line code is the fastest, with closures and without them.
# Beyond, a link may have FEW: code grows as the number of loops does, dense algebra as its cube.
STRAIGHT, STRAIGHT_OPEN, FEW = 800, 300, 8
PASSES = 4
KEPT = 1e-9  # part of the loop's size by which laws of the time may be missed
LOST = 1e-4  # s/L below which a law of the time leads to a singular configuration
STEEP = 0.1 / LOST  # times the loop's size: larger derivatives of a law are why a state is near one


def dense_closing(mechanism: Mechanism) -> Closing:
    """Return a projection by singular values; directions hardly held are left alone."""
    n, size, units = mechanism.n, singular_size(mechanism), mechanism.arrays.units
    rank = regular_rank(mechanism)

    def nearest(t: float, y: Array) -> tuple[Array, float]:
        closed = y.copy()
        closed[:n] = close_positions(mechanism, y[:n], t=t)
        qd = closed[n : 2 * n] / units
        Psi = closures.scaled_jacobian(mechanism, closed[:n], t)
        if not np.isfinite(Psi).all():  # outside the domain of a law
            return np.full(len(y), np.nan), 0.0
        U, s, Vt = svd(Psi)
        held = s > CUT * s[0]
        opening = Psi @ qd
        if mechanism.driven:
            opening = opening + closures.closure_drift(mechanism, closed[:n], t)
        qd -= Vt[held].T @ ((U[:, held].T @ opening) / s[held])
        closed[n : 2 * n] = qd * units
        return closed, float((s[rank - 1] / size) ** 2)

    return nearest


def best_closing(mechanism: Mechanism) -> Closing:
    """Return the fastest projection for the mechanism's size."""
    if not written_out(mechanism):
        return dense_closing(mechanism)
    close = float_closing(mechanism)

    def nearest(t: float, y: Array) -> tuple[Array, float]:
        closed, quality = close(t, y.tolist())
        return np.array(closed), quality

    return nearest


@lru_cache(maxsize=64)
def float_closing(mechanism: Mechanism) -> FloatClosing:
    """Return `best_closing` for lists, for steps that never leave plain floats.

    States with small pivots are passed from straight-line code to `dense_closing`.
    """
    otherwise = dense_closing(mechanism)
    formula = projection_formula(mechanism) if written_out(mechanism) else None
    close = None
    if formula is not None:
        least, size = EXACT * suspect_quality(mechanism), loop_size(mechanism)
        limits = least, CLOSED * size, CONVERGED * size
        close = straightline.compile_closing(formula, PASSES, *limits)

    def nearest(t: float, y: list[float]) -> tuple[list[float], float]:
        try:
            found = close(t, y) if close is not None else None
        except (ZeroDivisionError, ValueError):  # a lost pivot, an infinite angle
            found = None
        if found is None:
            if not math.isfinite(sum(y)):
                return y, 0.0
            closed, quality = otherwise(t, np.array(y))
            found = closed.tolist(), quality
        return found

    return nearest


def written_out(mechanism: Mechanism) -> bool:
    """Return whether straight-line code is the fastest for a mechanism."""
    most = STRAIGHT if mechanism.rows else STRAIGHT_OPEN
    return loop_terms(mechanism) <= max(most, FEW * mechanism.n)


def state_led_across(
    mechanism: Mechanism, q: Array, qd: Array, evaluate: Callable[[Array, Array], Array]
) -> Array | None:
    """Apply `lead_across` to a function of q and qd (k, n); None if no change point is near."""
    near = nearest_singular(mechanism, q)
    if near is None or not near.crosses:
        return None
    closing, y = dense_closing(mechanism), np.concatenate([q, qd])
    return lead_across(
        mechanism, closing, y, near, lambda states: evaluate(*np.split(states, 2, axis=1))
    )


def check_kept(mechanism: Mechanism, q: Array, t: float) -> None:
    """Raise LawError, with the law and the time, if q (n,) does not keep a law of time.

    This happens if laws contradict one another, lead a loop beyond its reach, or lead it close to a
    singular configuration.
    """
    if not np.isfinite(q).all():
        there = np.where(np.isfinite(q), q, 0.0)
        check_laws(mechanism, there, np.zeros(len(q)), t)
        return  # something else is not finite: the method tells
    gap = np.abs(closures.closure_gap(mechanism, q, t))
    size = loop_size(mechanism)
    Psi = closures.scaled_jacobian(mechanism, q, t)
    why = ""
    if not np.isfinite(gap).all():
        check_laws(mechanism, q, np.zeros(len(q)), t)
    if not gap.max() <= KEPT * size:
        why = f"{gap.max():.3g} m are missing"
    elif nearness(mechanism, Psi) <= LOST:
        _check_steep(mechanism, q, t, Psi)
        why = "the loops are at a singular configuration there, or laws repeat one another"
    if why:
        worst = max(mechanism.driven, key=lambda r: gap[r])
        raise law_error(mechanism, worst, f"cannot be kept at t = {t:.9g} s: {why}")


def law_error(mechanism: Mechanism, row: int, limit: str) -> LawError:
    """Return the error for the law in a row, with its name."""
    law = mechanism.rows[row].law
    assert law is not None
    what = f"couplings[{row - mechanism.first_coupling}]"
    return LawError(what, where=mechanism.source, value=law.text, limit=limit)


def _check_steep(mechanism: Mechanism, q: Array, t: float, Psi: Array) -> None:
    """Raise LawError if a law's derivative by a joint is too large at q (n,).

    Psi is (r, n), scaled.
    """
    laws = laws_of(mechanism)
    if laws is None:
        return
    steepest = max(range(laws.count), key=lambda i: np.abs(Psi[laws.places[i]]).max())
    row = laws.places[steepest]
    if np.abs(Psi[row]).max() <= STEEP * loop_size(mechanism):
        return
    slopes = laws.slopes(q, t)[steepest]
    joint = int(np.argmax(np.abs(slopes)))
    at = f"q{joint + 1} = {q[joint]:.9g}, t = {t:.9g} s"
    limit = f"has the derivative {slopes[joint]:.3g} by q{joint + 1} at {at}: too steep to follow"
    raise law_error(mechanism, row, limit)


def _check_domain(mechanism: Mechanism, q: Array, qd: Array, t: float) -> None:
    """Raise LawError: no closed state near (q, qd) is within the domain of the laws."""
    check_laws(mechanism, q, qd, t)
    gap = np.abs(closures.closure_gap(mechanism, q, t))
    rows = [r for r, row in enumerate(mechanism.rows) if row.law is not None]
    worst = max(rows, key=lambda r: gap[r])
    why = "no state within its domain is near enough"
    raise law_error(mechanism, worst, f"cannot be kept at t = {t:.9g} s: {why}")


class Projection:
    """Projects to the nearest closed state; next to a change point, along the crossing branch.

    `misses` records the singular configurations that the run meets; near misses bound its steps.
    """

    def __init__(
        self, mechanism: Mechanism, closing: Closing, misses: Misses | None = None
    ) -> None:
        self.mechanism, self.closing = mechanism, closing
        self.misses = misses or Misses(mechanism)

    def __call__(self, t: float, y: Array) -> Array:
        closed, quality = self.closing(t, y)
        if self.mechanism.driven:
            check_kept(self.mechanism, closed[: self.mechanism.n], t)
            return closed
        if quality > SUSPECT:
            return closed
        if self.mechanism.laws and not np.isfinite(closed).all() and np.isfinite(y).all():
            n = self.mechanism.n
            _check_domain(self.mechanism, y[:n], y[n : 2 * n], t)
        q = y[: self.mechanism.n]
        if self.misses.near(q):
            return closed
        near = self.misses.nearest(q)
        if near is None or not near.crosses:
            return closed
        led = lead_across(self.mechanism, self.closing, y, near, lambda states: states)
        return closed if led is None else led
