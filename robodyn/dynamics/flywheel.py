"""The flywheel that keeps a machine's speed nearly constant over a period.

A crank needs the torque T(theta) over a turn, and its motor gives the mean T_m.  The flywheel
stores the excess: up to the angle theta

    E(theta) = integral of (T_m - T) dtheta,        dE = max E - min E.

Between the greatest and the least speed, whose mean is w_m, its kinetic energy changes by that,

    dE = I (w_max^2 - w_min^2) / 2 = I delta w_m^2,     delta = (w_max - w_min) / w_m,

so the inertia I = dE / (delta w_m^2) holds the fluctuation delta.  T already contains the inertia
of the machine itself.

The harmonics of a quantity are its Fourier series in the crank's angle.  With T values F_j at
angles theta_j that divide a turn evenly, the coefficients

    c_k = sum over j of F_j exp(-i k theta_j) / T,      k = 0, 1, .. below T/2,

are exact if there are no orders from T/2 on.  Then F = sum of A_k cos(k theta + phi_k), with the
amplitude A_k = 2 |c_k| (A_0 = |c_0|) and the phase phi_k = arg c_k.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.arrays import Array

TURN_OFF = 1e-6  # rad by which rows may miss whole turns
APART = math.radians(45.0)  # rad that rows may be apart, for a spline to tell a torque at all
TORQUE_OFF = 1e-3  # part of the torque's size by which its ends may differ


class Flywheel(NamedTuple):
    """What a period demands of a flywheel: N m, J, rad/s and kg m^2."""

    mean_torque: float
    energy_fluctuation: float
    mean_speed: float
    flywheel: float


def flywheel(angle: Array, torque: Array, seconds: float, delta: float) -> Flywheel:
    """Return the flywheel for torques (T,), N m, at angles (T,), rad, over whole turns.

    `seconds` is the duration of all rows.  Between rows the torque is a periodic cubic spline.
    Raises InputError if the rows are no period (angles must rise or fall over whole turns, and the
    torque must end as it began), and if they are more than 45 degrees apart.
    """
    from scipy.interpolate import CubicSpline

    x = np.abs(angle - angle[0])
    turns = round(x[-1] / math.tau)
    if turns < 1 or abs(x[-1] - math.tau * turns) > TURN_OFF:
        limit = f"from {angle[0]:.6g} to {angle[-1]:.6g} rad; must go over whole turns, 2 pi each"
        raise InputError("the angle of the rows", limit=limit)
    if not (np.diff(x) > 0.0).all():
        raise InputError("the angle of the rows", limit="must rise, or fall, from row to row")
    if (most := float(np.diff(x).max())) > APART + TURN_OFF:
        limit = f"up to {math.degrees(most):.6g} degrees apart; must be 45 or less, better 1"
        raise InputError("the angle of the rows", limit=limit)
    if abs(torque[-1] - torque[0]) > TORQUE_OFF * np.abs(torque).max():
        limit = f"from {torque[0]:.6g} to {torque[-1]:.6g} N m; must end as it began, of a period"
        raise InputError("the torque of the rows", limit=limit)
    spline = CubicSpline(x, np.append(torque[:-1], torque[0]), bc_type="periodic")
    work = spline.antiderivative()
    mean = float(work(x[-1]) / x[-1])
    crossings = spline.solve(mean, extrapolate=False)
    places = np.concatenate([x, crossings[np.isfinite(crossings)]])
    stored = mean * places - work(places)
    speed = float(x[-1] / seconds)
    dE = float(np.ptp(stored))
    return Flywheel(mean, dE, speed, dE / (delta * speed * speed))


OFF = 1e-6  # rad by which a row may miss its place on the grid
AGAIN = 1e-3  # part of the values' size by which the last row, a turn later, may differ
NOISE = 1e-13  # part of that size below which a part of c_k is rounding


def harmonics(angle: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Return amplitudes and phases (rad) of the orders 0 to `most`, (most + 1, k) each.

    angle (T,), rad, and values (T, k): one turn on an even grid, whose last row is its end or one
    step before it.  Raises InputError for other rows, and for more orders than they resolve.
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
