"""States so near a change point that nothing may be solved there, taken from the branch beside it.

At a distance d from a configuration where Psi loses rank, rounding errs by eps/d^2 in the
accelerations, and a state that strays from the closures by delta errs by delta/d.  A motion that
runs straight across is smooth all the same.  So a state that near is replaced, and its
accelerations are found, by interpolation along the branch: 2K states before and behind, at
q + k STEP qd/|qd|, are closed where Psi is regular, and a polynomial of degree 2K - 1 leads across.

Where the loop does not run straight across (lengths that nearly make a change point, but do not)
the interpolated position is open by more than rounding, and the state is solved as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb

import numpy as np
from numpy.typing import NDArray

from robodyn import closed_form
from robodyn.assembly import loop_size
from robodyn.mechanism import Mechanism

Array = NDArray[np.float64]
# the nearest closed state, and how regular Psi is there: about d^2 at a distance d
Closing = Callable[[Array], tuple[Array, float]]

SUSPECT = 1e-2  # quality below which a state is looked at
NEAR = 6e-3  # part of the quality beside it below which a state is near a change point
STRAIGHT = 1e-9  # part of the loop's size that an interpolated position may be open by
K = 6
STEP = 0.03  # rad of the fastest joint
OFFSETS = np.array([k for k in range(-K, K + 1) if k])
WEIGHTS = np.array([-((-1.0) ** k) * comb(2 * K, K + k) for k in OFFSETS]) / comb(2 * K, K)


def beside(mechanism: Mechanism, closing: Closing, y: Array, quality: float) -> Array | None:
    """Closed states (2K, len(y)) on both sides of a change point, or None where y is near none.

    `quality` is that of y = (q, qd, ...); what follows the rates is repeated as it is.
    """
    n = mechanism.n
    rates = y[n : 2 * n]
    fastest = float(np.abs(rates).max())
    if quality > SUSPECT or not 0.0 < fastest < np.inf:
        return None
    rows = np.repeat(y[None, :], len(OFFSETS), axis=0)
    rows[:, :n] += STEP / fastest * OFFSETS[:, None] * rates
    ends = [closing(rows[k]) for k in (0, -1)]
    if quality > NEAR * max(found for _, found in ends):
        return None
    rows[0], rows[-1] = (closed for closed, _ in ends)
    for k in range(1, len(rows) - 1):
        rows[k], _ = closing(rows[k])
    gap = closed_form.closure_gap(mechanism, (WEIGHTS @ rows)[:n])
    return rows if np.abs(gap).max() <= STRAIGHT * loop_size(mechanism) else None


def across(values: Array) -> Array:
    """The value at the middle of those at the states of `beside`, (2K, ...)."""
    middle: Array = WEIGHTS @ values
    return middle
