"""scipy: its compiled dop853 and LSODA on the textbook's equations, written by hand."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from bench_frontier import Array, Case, Run, dop853, lsoda

from robodyn import Mechanism
from yardsticks import four_bar_rates, two_link_rates


def terms(mechanism: Mechanism) -> dict[str, Callable[..., Array]]:
    kind = mechanism.n, len(mechanism.rows)
    if kind not in ((2, 0), (3, 2)):
        raise NotImplementedError("equations by hand: the 2R and the four-bar only")
    rates = (two_link_rates if mechanism.n == 2 else four_bar_rates)(mechanism)
    n = mechanism.n
    return {"qdd": lambda q, qd: np.array(rates(0.0, np.concatenate([q, qd]))[n:])}


def runs(case: Case, tolerances: list[float]) -> dict[str, list[Run]]:
    return {
        "ode dop853": [partial(dop853, case, x) for x in tolerances if x > 0.9e-13],
        "odeint": [partial(lsoda, case, x) for x in tolerances if x > 0.9e-12],
    }
