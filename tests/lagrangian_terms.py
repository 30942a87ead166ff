"""Accelerations by the terms of a Lagrangian, and by every way that the package computes them."""

from __future__ import annotations

import numpy as np
from mpmath import mp

from robodyn.dynamics import dynamics
from robodyn.engines.arithmetic import FLOATS
from robodyn.engines.expansion import MotionProgram
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.placed import relative_matrix


def exact_acceleration(terms, tau, digits=30):
    """qdd of the constrained equation of motion, in as many digits."""
    n, rows = len(tau), len(terms.gap)
    with mp.workdps(digits):
        system = mp.zeros(n + rows)
        right = mp.zeros(n + rows, 1)
        for i in range(n):
            right[i] = mp.mpf(tau[i]) - terms.G[i]
            for j in range(n):
                system[i, j] = terms.M[i, j]
                right[i] -= terms.C[i, j] * terms.qd[j]
            for r in range(rows):
                system[i, n + r] = -terms.Psi[r, i]
                system[n + r, i] = terms.Psi[r, i]
        for r in range(rows):
            right[n + r] = -terms.Psidot_qd[r]
        found = mp.lu_solve(system, right)
        return np.array([float(found[i]) for i in range(n)])


class Terms:
    """What the oracle says of one state."""

    def __init__(self, terms, q, qd):
        self.__dict__ |= terms(q, qd)._asdict()
        self.qd = [mp.mpf(float(x)) for x in qd]


def check_accelerations(mech, q, qd, tau, exact, size=1.0):
    """Dense algebra, arrays over states, and the series' rows give the exact accelerations."""
    allowed = 2e-13 * size * (1.0 + np.abs(exact).max())
    many = [np.repeat(x[None], dynamics.BATCH + 1, axis=0) for x in (q, qd, tau)]
    motion = MotionProgram(mech, Actuation(tuple(tau)), False)
    start = motion.state(FLOATS, 0.0, [*q, *qd], ((), ()))
    theta = motion.expand(FLOATS, motion.program.numbers, 1, start).theta
    x = np.array([2.0 * each[2] for each in theta])
    found = {
        "dense": dynamics.forward_dynamics(mech, q, qd, tau),
        "arrays": dynamics.forward_dynamics(mech, *many)[-1],
        "rows": relative_matrix(mech) @ x,
    }
    for name, own in found.items():
        assert np.abs(own - exact).max() <= allowed, name
    if len(mech.actuated) == mech.n - len(mech.rows):
        needed = dynamics.inverse_dynamics(mech, q, qd, exact)
        assert np.abs(needed - tau).max() <= 10.0 * allowed
        batch = dynamics.inverse_dynamics(
            mech, *(np.repeat(v[None], 300, 0) for v in (q, qd, exact))
        )
        assert np.abs(batch[-1] - needed).max() <= 10.0 * allowed
