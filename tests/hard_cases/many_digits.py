"""A motion by Taylor series in numbers of many digits: right past a change point itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mpmath as mp

from robodyn.engines.arithmetic import Arithmetic
from robodyn.engines.expansion import MotionProgram, horner, longest_step, turning
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism

DIGITS = 60  # a step may start next to a change point: 1e-20 of all were left at 1e-1 of its length
ORDER = 24
TOLERANCE = mp.mpf("1e-20")

MANY = Arithmetic(cos=mp.cos, sin=mp.sin, power=mp.power, room=lambda orders: [mp.mpf(0)] * orders)


def followed(mechanism: Mechanism, q: Sequence[Any], qd: Sequence[Any], time: float) -> list[Any]:
    """q and qd (n each) of a free motion, `time` after a state that is closed to all digits."""
    motion = MotionProgram(mechanism, Actuation((0.0,) * mechanism.n), False)
    numbers = [mp.mpf(x) for x in motion.program.numbers]
    y, left = [*q, *qd], mp.mpf(time)
    with mp.workdps(DIGITS):
        while left > 0:
            start = motion.state(MANY, mp.mpf(0), y, ((), ()))
            series = motion.expand(MANY, numbers, ORDER, start)
            h = min(left, longest_step(series, start.w, TOLERANCE, TOLERANCE, mp.power))
            y = _along(mechanism, series, y, h)
            left -= h
    return y


def _along(mechanism: Mechanism, series: Any, y: Sequence[Any], h: Any) -> list[Any]:
    n, ways, rates = mechanism.n, [], []
    for rho, theta in zip(series.rho, series.theta, strict=True):
        (r, dr), (t, dt) = horner(rho, h), horner(theta, h)
        ways.append(mp.atan2(t, r))
        rates.append(turning((r, t), (dr, dt)))
    above = mechanism.parent
    q = [y[j] + ways[j] - (0 if above[j] is None else ways[above[j]]) for j in range(n)]
    return q + [rates[j] - (0 if above[j] is None else rates[above[j]]) for j in range(n)]
