"""States so near a change point that nothing may be solved there, taken from the branch beside it.

At a distance d from a configuration where Psi loses rank, rounding errs by eps/d^2 in the
accelerations, and a state that strays from the closures by delta errs by delta/d.  A motion that
runs straight across is smooth all the same.  So a state that near is replaced, and its
accelerations are found, by interpolation along the branch: K states before and K behind, at
q + k step qd/max|qd|, are closed where Psi is regular, and a polynomial of degree 2K - 1 leads
across.  The wide step serves where two orders of it agree; where they do not (an inertia, or a
spring's pull, that changes much on the way) the narrow one does.

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
STEPS = (0.1, 0.03)  # rad of the fastest joint; the first serves up to d = 0.046
SMOOTH = 1e-9  # part of the largest value by which two orders may differ
K = 6
OFFSETS = np.array([k for k in range(-K, K + 1) if k])


def _weights(reach: int) -> Array:
    """Of the values at -reach .. reach for the one in the middle."""
    offsets = np.array([k for k in range(-reach, reach + 1) if k])
    binomials = np.array([comb(2 * reach, reach + k) for k in offsets])
    weights: Array = -((-1.0) ** offsets) * binomials / comb(2 * reach, reach)
    return weights


WEIGHTS = _weights(K)
LOWER = np.concatenate([[0.0], _weights(K - 1), [0.0]])  # two orders less


def lead_across(
    mechanism: Mechanism,
    closing: Closing,
    y: Array,
    quality: float,
    evaluate: Callable[[Array], Array],
) -> Array | None:
    """What `evaluate` gives on the branch at y, from states beside it; None where y is near none.

    `evaluate` takes states (2K, len(y)) to values (2K, m).  `quality` is that of y = (q, qd, ...);
    what follows the rates is repeated as it is.
    """
    n = mechanism.n
    fastest = float(np.abs(y[n : 2 * n]).max())
    if quality > SUSPECT or not 0.0 < fastest < np.inf:
        return None
    for step in STEPS:
        around = _beside(mechanism, closing, y, quality, step / fastest)
        if around is None:
            continue
        values = evaluate(around)
        middle: Array = WEIGHTS @ values
        differ = np.abs(middle - LOWER @ values)
        if step == STEPS[-1] or (differ <= SMOOTH * np.abs(values).max()).all():
            return middle
    return None


def _beside(
    mechanism: Mechanism, closing: Closing, y: Array, quality: float, step: float
) -> Array | None:
    """Closed states (2K, len(y)) on both sides, `step` s apart; None where y is near none."""
    n = mechanism.n
    rows = np.repeat(y[None, :], len(OFFSETS), axis=0)
    rows[:, :n] += step * OFFSETS[:, None] * y[n : 2 * n]
    ends = [closing(rows[k]) for k in (0, -1)]
    if quality > NEAR * max(found for _, found in ends):
        return None
    rows[0], rows[-1] = (closed for closed, _ in ends)
    for k in range(1, len(rows) - 1):
        rows[k], _ = closing(rows[k])
    gap = closed_form.closure_gap(mechanism, (WEIGHTS @ rows)[:n])
    return rows if np.abs(gap).max() <= STRAIGHT * loop_size(mechanism) else None
