"""Speed against error of integration, for `make bench`.

The yardstick is the fastest that scipy can do: its compiled dop853 and LSODA (`ode`, `odeint`) on
right-hand sides written by hand.  Ours is the Taylor integrator, projections included.  Both run
at the same tolerances, in turn; the time that an error takes is read off a line through the runs
whose errors, against references of 20 digits, are near it (log-log, least squares), for a single
run may be lucky.  Whole calls of `robodyn.simulate` stand in rows of their own.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from timeit import timeit
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import ode, odeint

import robodyn
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import build
from robodyn.runs.series_engine import SeriesEngine
from robodyn.scene.description import from_text
from yardsticks import four_bar_rates, two_link_rates

Array = NDArray[np.float64]
Run = Callable[[], Array]

ROOT = Path(__file__).resolve().parent.parent
NEARBY = 30.0  # factor of an error within which runs tell its time
TOLERANCES = 10.0 ** -np.arange(2.0, 15.51, 0.25)


@dataclass(frozen=True)
class Case:
    """A motion with its exact end, and dy/dt of it by hand."""

    name: str
    mechanism: robodyn.Mechanism
    start: Array
    time: float
    end: Array
    by_hand: Callable[[float, Array], list[float]]

    def error(self, run: Run) -> float:
        return float(np.abs(run() - self.end).max())


def case(reference: str, time: float) -> Case:
    content = json.loads((ROOT / f"tests/references/{reference}.json").read_text())
    states = {
        float(state["t"]): np.array([float(x) for x in state["q"] + state["qd"]])
        for state in content["states"]
    }
    mechanism = robodyn.load(ROOT / content["scene"])
    by_hand = (two_link_rates if mechanism.n == 2 else four_bar_rates)(mechanism)
    return Case(f"{reference}, {time:g} s", mechanism, states[0.0], time, states[time], by_hand)


def taylor(case: Case, tolerance: float) -> Run:
    """A run of the Taylor integrator, prepared."""
    still = Actuation((0.0,) * case.mechanism.n)
    made = SeriesEngine(case.mechanism, still, rtol=tolerance, atol=tolerance)
    none = np.zeros(0)

    def run() -> Array:
        return made.advance(0.0, case.start, case.time, none, 10**6).y[-1]

    return run


def call(case: Case, tolerance: float) -> Array:
    n = case.mechanism.n
    motion = robodyn.simulate(
        case.mechanism,
        case.start[:n],
        case.start[n:],
        case.time,
        method="taylor",
        rtol=tolerance,
        atol=tolerance,
        t_eval=[case.time],
    )
    return np.concatenate([motion.q[-1], motion.qd[-1]])


def dop853(case: Case, tolerance: float) -> Array:
    solver = ode(case.by_hand).set_integrator(
        "dop853", rtol=tolerance, atol=tolerance, nsteps=10**6
    )
    solver.set_initial_value(case.start, 0.0)
    return np.asarray(solver.integrate(case.time))


def lsoda(case: Case, tolerance: float) -> Array:
    return np.asarray(
        odeint(
            case.by_hand,
            case.start,
            [0.0, case.time],
            rtol=tolerance,
            atol=tolerance,
            tfirst=True,
            mxstep=10**6,
        )[-1]
    )


@dataclass
class Curve:
    """Seconds of the processor against error of one method over all tolerances."""

    problem: Case
    runs: list[Run]

    def measure(self) -> None:
        self.errors = np.array([self.problem.error(run) for run in self.runs])
        self.seconds = np.full(len(self.runs), np.inf)

    def turn(self) -> None:
        turns = [timeit(run, timer=process_time, number=1) for run in self.runs]
        self.seconds = np.minimum(self.seconds, turns)

    def time(self, target: float) -> float:
        """Seconds for an error, infinite where no run is as good."""
        near = (self.errors < NEARBY * target) & (self.errors > target / NEARBY)
        if not (self.errors <= target).any() or near.sum() < 3:
            return np.inf
        x, y = np.log(self.errors[near] / target), np.log(self.seconds[near])
        return float(np.exp(np.polyfit(x, y, 1)[1]))


def curves(problem: Case, repeats: int) -> dict[str, Curve]:
    loose = TOLERANCES.tolist()
    found = {
        "dop853": Curve(problem, [partial(dop853, problem, x) for x in loose if x > 0.9e-13]),
        "lsoda": Curve(problem, [partial(lsoda, problem, x) for x in loose if x > 0.9e-12]),
        "taylor": Curve(problem, [taylor(problem, x) for x in loose]),
    }
    # fewer than engines that are kept for the next call
    calls: list[Run] = [partial(call, problem, x) for x in loose[::2]]
    found["whole call, taylor"] = Curve(problem, calls)
    for curve in found.values():
        curve.measure()
    for _ in range(repeats):
        for curve in found.values():
            curve.turn()
    return found


def frontier(bench: Any) -> list[Any]:
    """Rows of `bench.py`."""
    from bench import Row

    rows = []
    repeats = 3 if bench.quick else 9
    for reference, time, targets, reach in (
        ("2r-regular", 10.0, (1e-3, 1e-6, 1e-9, 1e-12), 1e-13),
        ("2r-chaotic", 10.0, (1e-3, 1e-6), 1e-9),
        ("four-bar", 5.0, (1e-3, 1e-6, 1e-9), 1e-11),
    ):
        problem = case(reference, time)
        found = curves(problem, repeats)
        scipy = [found.pop("dop853"), found.pop("lsoda")]
        for what in [name for name in found if "call" in name]:
            curve = found.pop(what)
            for target in targets:
                bound = 0.1 if target < 1e-3 else 0.15  # of a few dozen steps, checks are half
                theirs, ours = scipy[0].time(target), curve.time(target)
                text = f"dop853, by hand: {1e3 * theirs:.4g} ms", f"{1e3 * ours:.4g} ms"
                name = f"{problem.name}, to {target:g}, {what}"
                rows.append(Row(name, ours / theirs, None, bound, None, *text))
        their_error = min(float(np.nanmin(curve.errors)) for curve in scipy)
        for engine, curve in found.items():
            for target in targets:
                yardstick = min(other.time(target) for other in scipy)
                seconds = curve.time(target)
                bound = 0.1 if target <= 1e-6 else None
                row = Row(
                    f"{problem.name}, to {target:g}, {engine}",
                    seconds / yardstick,
                    bound=bound,
                    yardstick=f"scipy, by hand: {1e3 * yardstick:.4g} ms",
                    ours=f"{1e3 * seconds:.4g} ms",
                )
                rows.append(row)
            reached = f"scipy reaches {their_error:.2g}"
            what, error = f"{problem.name}, error reached, {engine}", float(curve.errors.min())
            rows.append(Row(what, error, bound=reach, yardstick=reached))
        if problem.mechanism.rows:
            n = problem.mechanism.n
            start = problem.start[:n], problem.start[n:]
            motion = robodyn.simulate(
                problem.mechanism, *start, time, method="taylor", rtol=1e-14, atol=1e-14
            )
            gap = motion.report.largest_gap
            rows.append(Row(f"{problem.name}, largest gap, m", gap, bound=1e-13))
    return rows


PLAIN = """gravity: 9.81
links:
- {name: a, m: 1.2, l: 0.5, r: 0.2, I: 0.02}
- {name: b, m: 0.8, l: 0.4, r: 0.18, I: 0.011}
"""
SPRING = (
    "springs: [{between: [{link: b, at: [0.2, 0.05]}, [0.3, 0.4]], stiffness: 40, length: 0.3}]"
)
RUBBING = ", friction: {torque: 0.3, speed: 0.5}}"
SCENES = {"a spring": PLAIN + SPRING, "friction": PLAIN.replace("}", RUBBING)}


def what_acts(bench: Any) -> list[Any]:
    """Series of scenes in which something acts, beside the same scene without it."""
    from bench import compared, in_turn

    def run(text: str) -> Run:
        mechanism = build(from_text(text, "bench"))
        start = np.array([0.4, 0.8]), np.zeros(2)
        problem = Case("", mechanism, np.concatenate(start), 5.0, np.zeros(0), lambda t, y: [])
        return partial(call, problem, 1e-9)

    rows, plain = [], run(PLAIN)
    for name, text in SCENES.items():
        times = in_turn(run(text), plain, 5 if bench.quick else 15, process_time)
        rows.append(compared(f"{name} in series", times, 1, "without it", bound=3.0))
    return rows


def taylor_process(bench: Any) -> list[Any]:

    from bench import ARM, BIN, compared

    start = ("--q", "30deg,45deg", "--time", "10", "--points", "1000", "--quiet")
    command = (BIN / "robodyn", "simulate", ARM, *start, "--method", "taylor")
    numpy = (sys.executable, "-c", "import numpy")
    times, _ = bench.processes(command, numpy, 3 if bench.quick else 15)
    return [compared("simulate --method taylor, process", times, 1, "import numpy", bound=3.0)]
