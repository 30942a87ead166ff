"""Derivatives of the dynamics by differences of the oracle of 30 digits."""

import numpy as np
from engine_cases import Case
from known_terms import DIGITS, Known
from mpmath import mp, mpf

STEP = mpf(10) ** -9  # of the oracle's 30 digits: its differences are right to 1e-18


def along(case: Case, kind: str, by: str, v: np.ndarray) -> np.ndarray:
    """The oracle's derivative of qdd or tau, by q, qd and what is given, along v (n,)."""
    found = []
    with mp.workdps(DIGITS):
        for sign in (1, -1):
            given = {"q": case.q, "qd": case.qd, "x": case.tau if kind == "forward" else case.qdd}
            exact = {name: [mpf(float(x)) for x in values] for name, values in given.items()}
            exact[by] = [x + sign * STEP * mpf(float(d)) for x, d in zip(exact[by], v, strict=True)]
            at = Known(case.mech, exact["q"], exact["qd"], case.t)
            solve = at.accelerations if kind == "forward" else at.torques
            found.append(solve(np.array(exact["x"]))[0])
        return np.array([float(x / (2 * STEP)) for x in found[0] - found[1]])
