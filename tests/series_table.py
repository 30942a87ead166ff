"""Every engine that finds the Taylor series of a motion, as a function of a case and its torques.

A series is the links' turns rho + i theta (of what slides 1 + i s), (2, n, ORDER + 2), the
power, what torques watch, and the longest step of TOLERANCE.
"""

import ctypes
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from conftest import FRESH
from engine_cases import KINDS, ROBOTS, Case, plain_too, random_case, robot_cases
from engine_table import NUMBERS
from known_terms import DIGITS
from mpmath import mp, mpf

from robodyn.engines.expansion import Coefficients, MotionProgram, longest_step
from robodyn.mechanics.actuation import Actuation, expressions
from robodyn.runs import machine_motion
from robodyn.runs.machine_motion import Observer
from robodyn.runs.machine_steps import Scene
from robodyn.runs.series_engine import SeriesEngine

ORDER = 12 if FRESH else 8
TOLERANCE = 1e-12  # of a step
LANES = 8


def states(name) -> tuple[int, ...]:
    """Which cases of a kind there are, see `known`; of a file one is enough."""
    return (0, 1) if isinstance(name, str) and plain_too(name) else (1,)


class Found(NamedTuple):
    """Coefficients as longdoubles."""

    turns: np.ndarray  # (2, n, order + 2)
    power: np.ndarray  # (order + 1,), empty where the work is found otherwise
    longest: float

    @property
    def z(self) -> np.ndarray:
        return self.turns[0] + 1j * self.turns[1]


def longs(values) -> np.ndarray:
    """Any numbers as longdoubles."""
    return np.array(
        [np.longdouble(mp.nstr(x, 25) if isinstance(x, mpf) else x) for x in values], np.longdouble
    )


def torques(one: Case, changing: bool) -> Actuation:
    """Constant ones, or functions of time and state at the actuated joints."""
    if not changing:
        return Actuation(tuple(one.tau.tolist()))
    each = [f"exp(-t)*sin(3*t)*tanh(q{j + 1}) - 0.1*log(2 + qd{j + 1}**2) + {float(one.tau[j])!r}"
            for j in one.mech.actuated]  # fmt: skip
    return expressions(one.mech, ", ".join(each), "test")


@functools.cache
def known(name, which) -> tuple[Case, Actuation, Found]:
    """A case of a kind, its torques, and the series of 30 digits.

    The first is plain and its torques constant, the second with forces and torques that change;
    of a file all are as it is. In its first state a parallelogram is near singular.
    """
    if isinstance(name, str):
        one = random_case(name, 2, which == 1)
    else:
        one = robot_cases(name)[1 + which]
    actuation = torques(one, changing=which == 1)
    return one, actuation, by_program(one, actuation, "mpmath")


# ---------------------------------------------------------------------------------------------
# Engines
# ---------------------------------------------------------------------------------------------


@functools.cache
def compiled(name, which):
    """The engine of steps; it is made once for all that is asked of it."""
    one, actuation, _ = known(name, which)
    options = {"rtol": TOLERANCE, "atol": TOLERANCE, "order": ORDER, "work": True}
    return SeriesEngine(one.mech, actuation, **options)


def by_program(one, actuation, kind, order=ORDER):
    """By the rows of the program, in numbers of a kind."""
    arithmetic, number = NUMBERS[kind]
    with mp.workdps(DIGITS):
        motion = MotionProgram(one.mech, actuation, True)
        y = [number(x) for x in (*one.q, *one.qd)]
        start = motion.state(arithmetic, number(one.t), y, ((), ()))
        numbers = [number(x) for x in motion.program.numbers]
        found = motion.expand(arithmetic, numbers, order, start)
        turns = np.array([[longs(c) for c in part] for part in (found.rho, found.theta)])
        power, (rho, theta) = longs(found.power or ()), turns.astype(float)
        floats = Coefficients(rho, theta, power.astype(float))
        w, slides = [float(x) for x in start.w], one.mech.slides
        longest = longest_step(floats, w, TOLERANCE, TOLERANCE, slides=slides)
    return Found(turns, power, longest)


def by_rows(name, which, kind):
    one, actuation, _ = known(name, which)
    return by_program(one, actuation, kind)


def by_machine_code(name, which, lanes=1):
    """By the code of steps; of one lane it is that which `SeriesEngine` runs."""
    one, actuation, _ = known(name, which)
    if lanes == 1:
        (made, code, *_), _ = compiled(name, which)._made(None)
    else:
        made = Scene(one.mech, actuation, ORDER, work=True, closes=False)
        code = machine_motion.compile(made, Observer(), lanes)
    block = np.zeros((code.items, lanes))
    made.fill(block, TOLERANCE, TOLERANCE)
    block[made.place["t"]] = one.t
    block[: 2 * one.mech.n + 1] = np.concatenate([one.q, one.qd, [0.25]])[:, None]
    code.code.function("expand", ctypes.c_void_p, result=None)(block.ctypes.data)
    assert (block == block[:, :1]).all()
    wide, first, n = len(made.loop.columns), made.whole["rows"], one.mech.n
    columns = block[first : first + (ORDER + 2) * wide, 0].reshape(ORDER + 2, wide).T
    turns = columns[: 2 * n].reshape(n, 2, -1).swapaxes(0, 1)  # rho and theta link by link
    power = columns[2 * n : 2 * n + bool(made.motion.power), : ORDER + 1]
    longest = block[made.place["longest"], 0]
    return Found(turns, power.ravel(), longest)


class Engine(NamedTuple):
    """What finds a series; how far its rounding and its longest step may be off, relatively."""

    find: Callable[..., Found]
    unit: float = 1.0
    step: float = 1e-6
    scenes: Sequence[str | Path] = (*KINDS, *ROBOTS)
    compiles: bool = False


FINE = float(np.finfo(np.longdouble).eps) * 2.0**52
ROUGH = 0.1  # machine code takes rough roots
ENGINES = {
    "rows in floats": Engine(lambda *scene: by_rows(*scene, "floats")),
    "rows in longdouble": Engine(lambda *scene: by_rows(*scene, "longdouble"), FINE),
    "machine code": Engine(by_machine_code, step=ROUGH, compiles=True),
    "machine code, side by side": Engine(
        lambda *scene: by_machine_code(*scene, LANES),
        step=ROUGH, scenes=(*KINDS[::6], *ROBOTS[::3]), compiles=True,
    ),
}  # fmt: skip
