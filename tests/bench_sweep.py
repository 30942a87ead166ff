"""A motion within a sweep of 10,000 against single ones, at equal error, for `make bench`."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from timeit import timeit
from typing import Any

import numpy as np
from bench_frontier import ROOT, Case, dop853
from numpy.typing import NDArray

import robodyn
from robodyn.engines import machine
from robodyn.sweeps.sweep_plan import CHUNKS, Axis, Plan, Variation
from robodyn.sweeps.sweep_workers import results
from yardsticks import four_bar_rates, two_link_rates

Array = NDArray[np.float64]

TIME = 2.0  # s
TARGET = 1e-8  # median error at the end, rad and rad/s
TOLERANCES = tuple(10.0 ** -(0.5 * k) for k in range(10, 25))
SINGLES = 100  # calls whose time stands for all


def sweeps(bench: Any) -> list[Any]:
    """Starts of the 2R anywhere: a motion's time within a sweep, and memory against its size."""
    from bench import Row, compared, in_turn

    points, singles = (2000, 20) if bench.quick else (10_000, SINGLES)
    axes = (Axis("q1", low=-np.pi, high=np.pi), Axis("q2", low=-np.pi, high=np.pi))
    scene = (ROOT / "robots/2r.yaml").read_text()
    plan = Plan(scene, "2r", Variation(axes, points, 1), (0.0, 0.0), (0.0, 0.0), t_end=TIME)
    starts = plan.variation.points(0, singles)
    exact = np.array([single(bench.arm, q, "taylor", 1e-15) for q in starts])

    def loosest(run: Callable[[float], Array]) -> float:
        """The first tolerance that reaches the target at every second point."""
        for tolerance in TOLERANCES:
            if np.median(np.abs(run(tolerance) - exact).max(axis=1)) <= TARGET:
                return tolerance
        raise RuntimeError("no tolerance reaches the error")

    def calls(method: str, tolerance: float) -> Array:
        return np.array([single(bench.arm, q, method, tolerance) for q in starts])

    if not machine.available():
        return []
    plan, rows = replace(plan, method="taylor", chunk=CHUNKS["taylor"]), []
    first, place = replace(plan, chunk=singles), slice(len(axes) + 1, len(axes) + 5)

    def at(tolerance: float) -> Array:
        part = replace(first, rtol=tolerance, atol=tolerance)
        return next(results(part, workers=1)).values[:, place]

    tolerance = loosest(at)
    ours = partial(sweep, replace(plan, rtol=tolerance, atol=tolerance))
    for method in ("DOP853", "taylor"):
        yardstick = partial(calls, method, loosest(partial(calls, method)))
        pairs = in_turn(ours, yardstick, 1 if bench.quick else 5)
        times = [(a, b * points / singles) for a, b in pairs]
        limits = {"bound": 1 / 20} if method == "DOP853" else {}
        what = f"sweep of {points}, 2R, {TIME:g} s"
        rows.append(compared(what, times, points, f"simulate, {method}", **limits))
    few = replace(plan, variation=Variation(axes, plan.chunk, 1))
    many, one = peak(plan), peak(few)
    text = f"of one chunk: {one:.3g} MB"
    rows.append(Row("its memory", many / one, None, 1.5, None, text))
    return rows


def sweeps_beside_ode(bench: Any) -> list[Any]:
    """Sweeps of the 2R and the four-bar, on all cores, against dop853 on equations by hand."""
    from bench import compared, in_turn

    if not machine.available():
        return []
    rows = []
    points, singles = (2000, 20) if bench.quick else (10_000, SINGLES)
    whole = (-np.pi, np.pi)
    scenes = ("2r", (whole, whole), two_link_rates), ("four-bar", ((0.2, 6.0),), four_bar_rates)
    for name, ranges, by_hand in scenes:
        axes = tuple(Axis(f"q{j}", low=low, high=high) for j, (low, high) in enumerate(ranges, 1))
        text, rest = (ROOT / f"robots/{name}.yaml").read_text(), (0.0,) * len(axes)
        plan = Plan(text, name, Variation(axes, points, 1), rest, rest, t_end=TIME)
        mechanism = robodyn.load(ROOT / f"robots/{name}.yaml")
        n, rates = mechanism.n, by_hand(mechanism)
        starts = robodyn.assemble(mechanism, plan.variation.points(0, singles))
        starts = np.hstack([starts, np.zeros_like(starts)])
        cases = [Case(name, mechanism, start, TIME, start, rates) for start in starts]

        def theirs(tolerance: float, cases: list[Case] = cases) -> Array:
            return np.array([dop853(case, tolerance) for case in cases])

        exact = theirs(1e-13)

        def loosest(run: Callable[[float], Array], exact: Array = exact) -> float:
            errors = (np.median(np.abs(run(x) - exact).max(axis=1)) for x in TOLERANCES)
            return next(x for x, e in zip(TOLERANCES, errors, strict=True) if e <= TARGET)

        yardstick = partial(theirs, loosest(theirs))
        here = replace(plan, method="taylor", chunk=CHUNKS["taylor"])
        place = slice(len(axes) + 1, len(axes) + 1 + 2 * n)

        def at(x: float, here: Plan = here, place: slice = place) -> Array:
            part = replace(here, rtol=x, atol=x, chunk=singles)
            return next(results(part, workers=1)).values[:, place]

        tolerance = loosest(at)
        ours = partial(sweep, replace(here, rtol=tolerance, atol=tolerance))
        pairs = in_turn(ours, yardstick, 1 if bench.quick else 5)
        times = [(a, b * points / singles) for a, b in pairs]
        limits = {"bound": 0.006, "aim": 0.003}
        what = f"sweep of {points}, {name}, {TIME:g} s"
        rows.append(compared(what, times, points, "ode dop853, by hand", **limits))
    return rows


def flip_map(bench: Any) -> list[Any]:
    """The README's map of flips, a whole process, against as many motions by dop853."""
    from bench import ARM, BIN, Row

    side, still = 24 if bench.quick else 240, np.zeros(2)
    vary = ("--vary", f"q1=-269.25deg:89.25deg:{side}", "--vary", f"q2=-179deg:179.5deg:{side}")
    options = ("--rtol", "1e-6", "--atol", "1e-6", "--result", "flip", "--quiet")
    command = (BIN / "robodyn", "sweep", ARM, *vary, *options)
    starts = np.radians(np.random.default_rng(0).uniform([-269.25, -179], [89.25, 179.5], (40, 2)))
    rates = two_link_rates(bench.arm)
    cases = [Case("2r", bench.arm, np.r_[q, still], 10.0, q, rates) for q in starts]
    theirs = timeit(lambda: [dop853(case, 1e-6) for case in cases], number=1) / len(cases)
    ours = min(bench.process(command)[0] for _ in range(1 if bench.quick else 3))
    text = f"one motion by dop853: {1e3 * theirs:.4g} ms", f"{ours:.3g} s"
    what = f"map of {side} x {side} flips, whole process"
    return [Row(what, ours / (theirs * side**2), None, 0.010, None, *text)]


def single(arm: robodyn.Mechanism, q: Array, method: str, tolerance: float) -> Array:
    """The state at the end, by one call."""
    motion = robodyn.simulate(
        arm,
        q,
        np.zeros(2),
        TIME,
        method=method,
        rtol=max(tolerance, 3e-14) if method != "taylor" else tolerance,
        atol=tolerance,
        t_eval=[TIME],
    )
    return np.concatenate([motion.q[-1], motion.qd[-1]])


def sweep(plan: Plan, workers: int | None = None) -> None:
    """All rows, none kept."""
    for _ in results(plan, workers=workers):
        pass


def peak(plan: Plan) -> float:
    """The largest memory of Python's and numpy's own, MB, with one worker."""
    sweep(replace(plan, variation=replace(plan.variation, sample=10)), 1)
    tracemalloc.start()
    sweep(plan, 1)
    found = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return found
