"""Time per state against rounding error of the evaluators of inverse and forward dynamics.

Rounding errors are measured with mpmath at 30 digits on the model's own constants, relative to the
largest torque or acceleration of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from timeit import repeat
from typing import Any

import numpy as np

from robodyn.dynamics import dynamics, identities
from robodyn.engines import formulas, straightline
from robodyn.engines.arithmetic import FLOATS, Arithmetic
from robodyn.engines.expansion import MotionProgram
from robodyn.engines.series import relative
from robodyn.errors import RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

COLUMNS = ("dynamics", "evaluator", "states", "ns_per_state", "largest_error", "median_error")
BATCHES = (1, 1000, 1_000_000)
CHECKED = 20  # states whose rounding errors are measured
DIGITS = 30


def measure_evaluators(mechanism: Mechanism) -> Iterator[list[float | str]]:
    """Yield rows of COLUMNS for straight-line floats and for batches.

    Raises RobodynError without mpmath, or if the mechanism has no closed states to sample.
    """
    if find_spec("mpmath") is None:
        limit = "needs mpmath, of the extra `dev`: pip install mpmath"
        raise RobodynError("bench --evaluators", limit=limit)
    mechanism.check_rubbing("evaluators of many digits")
    sample = identities.sample_states(mechanism, CHECKED)
    q, qd = sample.q, sample.qd
    if not len(q):
        raise RobodynError("bench --evaluators", where=mechanism.source, limit="no closed states")
    rng = np.random.default_rng(5)
    tau = np.zeros_like(q)
    driven = list(mechanism.actuated)
    tau[:, driven] = rng.normal(size=(len(q), len(driven)))
    try:
        qdd = np.array([_accelerations(mechanism, *each) for each in zip(q, qd, tau, strict=True)])
    except ZeroDivisionError:
        limit = "the accelerations are not unique: closures depend on one another"
        raise RobodynError("bench --evaluators", where=mechanism.source, limit=limit) from None
    exact: dict[str, Array] = {"forward": qdd.astype(float)}
    given = {"forward": (q, qd, tau), "inverse": (q, qd, qdd.astype(float))}
    if len(driven) == mechanism.n - len(mechanism.rows):
        exact["inverse"] = tau
    calls: dict[str, Callable[..., Array]] = {
        "inverse": dynamics.inverse_dynamics,
        "forward": dynamics.forward_dynamics,
    }
    for kind, known in exact.items():
        formula = getattr(formulas, f"{kind}_formula")(mechanism)
        if formula is not None and len(formula.inputs) == 3 * mechanism.n:
            function = straightline.compile_floats(formula, kind)
            states = np.hstack(given[kind]).tolist()
            found = np.array([function(*state)[: mechanism.n] for state in states])
            seconds = min(repeat(lambda: [function(*x) for x in states], number=200, repeat=5))  # noqa: B023
            yield [kind, "straight-line", 1.0, *_figures(found, known, seconds / 200 / len(states))]
        for count in BATCHES:
            many = [np.resize(x, (count, mechanism.n)) for x in given[kind]]
            number = max(1, 2000 // count)
            call = calls[kind]
            seconds = min(repeat(lambda: call(*[mechanism, *many]), number=number, repeat=3))  # noqa: B023
            if count == 1:
                found = np.array([call(mechanism, *x) for x in zip(*given[kind], strict=True)])
            else:
                found = call(mechanism, *many)[: len(known)]
            figures = _figures(found, known, seconds / number / count)
            yield [kind, "arrays", float(count), *figures]


def _figures(found: Array, known: Array, seconds: float) -> list[float | str]:
    known = known[: len(found)]
    size = np.abs(known).max(axis=1)
    error = np.abs(found - known).max(axis=1) / np.where(size > 0.0, size, 1.0)
    return [1e9 * seconds, float(error.max()), float(np.median(error))]


def _accelerations(mechanism: Mechanism, q: Array, qd: Array, tau: Array) -> list[Any]:
    """Return qdd of the equation of motion, with numbers of DIGITS digits."""
    from mpmath import mp

    numbers = Arithmetic(
        cos=mp.cos,
        sin=mp.sin,
        power=lambda x, exponent: x**exponent,
        functions={name: getattr(mp, name) for name in FLOATS.functions},
    )
    with mp.workdps(DIGITS):
        motion = MotionProgram(mechanism, Actuation(tuple(map(float, tau))), False)
        y = [mp.mpf(float(x)) for x in (*q, *qd)]
        start = motion.state(numbers, mp.mpf(0), y, ((), ()))
        constants = [mp.mpf(x) for x in motion.program.numbers]
        theta = motion.expand(numbers, constants, 1, start).theta
        return [+x for x in relative(mechanism, [2 * each[2] for each in theta])]
