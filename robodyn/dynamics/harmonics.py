"""What repeats with every turn of a crank, by order: its Fourier series in the crank's angle.

With T values F_j at angles theta_j that divide a turn evenly, the coefficients

    c_k = sum over j of F_j exp(-i k theta_j) / T,      k = 0, 1, .. below T/2,

are exact for what has no orders from T/2 on.  Then F = sum of A_k cos(k theta + phi_k), with the
amplitude A_k = 2 |c_k| (A_0 = |c_0|) and the phase phi_k = arg c_k.
"""

from __future__ import annotations

import math

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.arrays import Array

OFF = 1e-6  # rad by which a row may miss its place on the grid
AGAIN = 1e-3  # part of the values' size by which the last row, a turn later, may differ
NOISE = 1e-13  # part of that size below which a part of c_k is rounding


def harmonics(angle: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Amplitudes and phases (rad) of the orders 0 to `most`, (most + 1, k) each.

    angle (T,), rad, and values (T, k): one turn on an even grid, the last row a step before its
    end or at it.  Raises InputError for other rows, and for more orders than they tell.
    """
    step = (angle[-1] - angle[0]) / max(len(angle) - 1, 1)
    even = angle[0] + step * np.arange(len(angle))
    if not step or (off := float(np.abs(angle - even).max())) > OFF:
        limit = f"{off:.3g} rad off an even grid" if step else "does not turn"
        raise InputError("the angle of the rows", limit=f"{limit}; must go on by equal steps")
    size = np.abs(values).max(axis=0)
    if abs(abs(angle[-1] - angle[0]) - math.tau) <= OFF:
        if (np.abs(values[-1] - values[0]) > AGAIN * size.max()).any():
            limit = "must end as they began: speed and acceleration must be the same there"
            raise InputError("the forces", limit=limit)
        angle, values = angle[:-1], values[:-1]
    elif abs(abs(step) * len(angle) - math.tau) > OFF:
        limit = f"from {angle[0]:.6g} to {angle[-1]:.6g} rad; must go over one turn, 2 pi"
        raise InputError("the angle of the rows", limit=limit)
    if 2 * most >= len(angle):
        limit = f"needs more than {2 * most} rows in the turn; it has {len(angle)}"
        raise InputError("orders", value=most, limit=limit)
    waves = np.exp(-1j * np.arange(most + 1)[:, None] * angle)
    c = waves @ values / len(angle)
    for part in (c.real, c.imag):
        part[np.abs(part) <= NOISE * size] = 0.0
    return np.abs(c) * np.where(np.arange(most + 1) > 0, 2.0, 1.0)[:, None], np.angle(c)
