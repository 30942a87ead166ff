"""`robodyn bench` on known motions, and cost against the number of loops, for `make bench`."""

from __future__ import annotations

import csv
import ctypes
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from time import process_time
from timeit import timeit
from typing import Any

import numpy as np
from bench_frontier import ROOT, case
from scipy.integrate import ode
from sliding_trees import random_tree, text_of

import robodyn
from hard_cases.cases import n_four_bar
from oracles import n_four_bar_exact
from random_mechanisms import mechanism as read
from robodyn.engines import machine
from robodyn.mechanics.actuation import Actuation
from robodyn.runs import machine_motion
from robodyn.runs.benchmark import benchmark
from robodyn.runs.machine_steps import Scene
from robodyn.runs.right_hand_side import right_hand_side
from robodyn.runs.series_engine import SeriesEngine

TIME = 0.5  # s, of the N-four-bar falling from the vertical: before the horizontal
LOOPS = (1, 2, 5, 10, 20, 40)
MOTIONS = (("2r-regular", 10.0), ("2r-chaotic", 10.0), ("four-bar", 5.0))


def motions(bench: Any) -> list[Any]:
    """Every method on three motions; tables and figures go to bench/."""
    from bench import Row

    rows = []
    folder = ROOT / "bench"
    folder.mkdir(exist_ok=True)
    tolerances = (1e-3, 1e-6, 1e-9) if bench.quick else tuple(10.0**-k for k in range(3, 14))
    for name, time in MOTIONS[: 1 if bench.quick else 3]:
        problem = case(name, time)
        still = Actuation((0.0,) * problem.mechanism.n)
        result = benchmark(
            problem.mechanism, problem.start, time, still, tolerances=tolerances, repeats=3
        )
        with (folder / f"{name}.csv").open("w", newline="") as stream:
            table = [asdict(each) for each in result.measurements]
            writer = csv.DictWriter(stream, table[0].keys())
            writer.writeheader()
            writer.writerows(table)
        if find_spec("matplotlib") is not None:
            from robodyn.pictures.chart_figure import work_precision

            work_precision(result, problem.name, str(folder / f"{name}.png"))
        for target in (1e-6, 1e-9):
            able = [x for x in result.measurements if x.error <= target]
            best = {
                method: min((x.least for x in able if x.method == method), default=np.inf)
                for method in ("DOP853", "taylor")
            }
            rows.append(
                Row(
                    f"{problem.name}, simulate to {target:g}, taylor",
                    best["taylor"] / best["DOP853"],
                    yardstick=f"DOP853: {1e3 * best['DOP853']:.4g} ms",
                    ours=f"{1e3 * best['taylor']:.4g} ms",
                )
            )
        noise = result.reference.uncertainty
        rows.append(Row(f"{problem.name}, uncertainty of the reference", noise, bound=1e-10))
    return rows


def many_loops(bench: Any) -> list[Any]:
    """Cost of a motion against the number of loops, and its exponent from 10 loops on."""
    from bench import Row, compared, in_turn

    rows = []
    counts = LOOPS[:3] if bench.quick else LOOPS
    costs: dict[str, list[float]] = {}
    for n in counts:
        mechanism = n_four_bar(n)
        m = mechanism.n
        y = np.concatenate([np.full(n + 1, np.pi / 2), np.full(n, -np.pi / 2)])
        y = np.concatenate([y, np.full(n + 1, -1.0), np.full(n, 1.0)])
        exact = float(n_four_bar_exact(n, TIME)[0])
        still = Actuation((0.0,) * m)
        engine = SeriesEngine(mechanism, still)
        run = partial(engine.advance, 0.0, y, TIME, np.zeros(0), 10**6)
        assert abs(run().y[-1][0] - exact) < 1e-7
        costs.setdefault("taylor", []).append(min(timeit(run, number=1) for _ in range(9)))
        simulate = partial(
            robodyn.simulate, mechanism, y[:m], y[m:], TIME, rtol=1e-9, atol=1e-9, t_eval=[TIME]
        )
        costs.setdefault("DOP853", []).append(min(timeit(simulate, number=1) for _ in range(3)))
    for name, seconds in costs.items():
        large = np.array(counts) >= min(10, counts[-2])
        exponent = np.polyfit(np.log(np.array(counts)[large]), np.log(np.array(seconds)[large]), 1)[
            0
        ]
        shown = ", ".join(f"{n}: {1e3 * x:.3g} ms" for n, x in zip(counts, seconds, strict=True))
        rows.append(Row(f"N-four-bar, exponent of N, {name}", float(exponent), ours=shown))
    rates = right_hand_side(mechanism, still).rates

    def dop853() -> None:
        solver = ode(rates).set_integrator("dop853", rtol=1e-9, atol=1e-9, nsteps=10**6)
        solver.set_initial_value(y, 0.0)
        solver.integrate(TIME)

    times = in_turn(run, dop853, 5)
    what = f"{counts[-1]}-four-bar, {TIME:g} s at 1e-9, taylor"
    rows.append(compared(what, times, 1, "scipy ode, generated", bound=0.1))
    return rows


def code_of_many_loops(bench: Any) -> list[Any]:
    """Machine code of N-four-bars: the cost of a step against N, and s of processor to make it."""
    from bench import Row

    counts, made, costs = (5, 10, 20) if bench.quick else (5, 10, 20, 40, 80), [], []
    usual, machine.folder = machine.folder, lambda: None
    try:
        for n in (2, *counts) if machine.available() else ():  # the first loads LLVM
            mechanism = n_four_bar(n)
            begin = process_time()
            engine = SeriesEngine(mechanism, Actuation((0.0,) * mechanism.n))
            made.append(process_time() - begin)
            q = robodyn.assemble(mechanism, [1.0])
            y = np.concatenate([q, robodyn.loop_velocities(mechanism, q, [1.0])])
            run = partial(engine.advance, 0.0, y, 0.3, np.zeros(0), 10**5)
            steps = len(run().t)
            costs.append(min(timeit(run, timer=process_time, number=1) for _ in range(9)) / steps)
    finally:
        machine.folder = usual
    if not made:
        return []
    exponent = float(np.polyfit(np.log(counts), np.log(costs[1:]), 1)[0])
    steps = ", ".join(f"{n}: {1e6 * x:.3g} us" for n, x in zip(counts, costs[1:], strict=True))
    code = ", ".join(f"{n}: {x:.3g} s" for n, x in zip(counts, made[1:], strict=True))
    return [
        Row("N-four-bar, exponent of N of a step, compiled", exponent, bound=1.1, ours=steps),
        Row(f"{counts[-1]}-four-bar, code made, s", made[-1], bound=2.0, ours=code),
    ]


def watched_runs(bench: Any) -> list[Any]:
    """A run that is watched for an event, against DOP853's without.

    It does not happen, or comes with each swing; each is told.
    """
    from bench import compared, in_turn

    rows = []
    ways = ("DOP853", 1.8), ("taylor", 0.15)
    events = {"high": "q1 > 2000deg"}, {"turns": "qd1"}, {"passes": "q1"}
    for scene, start in (("2r", [0.5, 0.8]), ("four-bar", [1.0]), ("pendulum", [1.0])):
        mechanism = robodyn.load(ROOT / f"robots/{scene}.yaml")
        q, rest = robodyn.assemble(mechanism, np.array(start)), np.zeros(mechanism.n)
        without = partial(robodyn.simulate, mechanism, q, rest, 10.0)
        for method, bound in ways:
            for given in events:
                ((name, text),) = given.items()

                def watched(given: Any = given, run: Any = partial(without, method=method)) -> Any:
                    return run(events=given).events

                count = len(watched())
                assert count == 0 if name == "high" else count > 5
                times = in_turn(watched, without, 3 if bench.quick else 21)
                what = f"{count} events {text}, {scene}, 10 s, {method}"
                rows.append(compared(what, times, 1, "DOP853 without", bound=bound))
    return rows


def series_of_joints(joints: str, lanes: int, orders: int = 20) -> Any:
    """Makes the series of a chain of such joints, as RPR, in machine code."""
    n = len(joints)
    chain = read(text_of(random_tree(1, joints, (None, *range(n - 1))), -9.81j))
    scene = Scene(chain, Actuation((0.0,) * n), orders, work=False, closes=False)
    code = machine_motion.compile(scene, machine_motion.Observer(), lanes)
    assert code is not None
    room = code.block()
    block, address = room.reshape(-1, lanes), room.ctypes.data
    scene.fill(block, 1e-12, 1e-12)
    block[: 2 * n] = np.random.default_rng(0).normal(size=(2 * n, 1))
    expand = code.code.function("expand", ctypes.c_void_p, result=None)
    return lambda room=room: [expand(address) for _ in range(1000)]


def sliding_joints(bench: Any) -> list[Any]:
    """A series of joints that slide against one of as many that turn, by lanes."""
    from bench import compared, in_turn

    rows = []
    chains = ("RP", "PR", "RPR", "RPP", "PRP", "RRP", "RPRP")
    for lanes, bound in ((1, 1.8), (8, 1.5)) if machine.available() else ():
        for joints in chains[:: 3 if bench.quick else 1]:
            turning = "R" * len(joints)
            ours, yardstick = (series_of_joints(x, lanes) for x in (joints, turning))
            times = in_turn(ours, yardstick, 3 * bench.repeats)
            rows.append(
                compared(f"series of {joints}, {lanes} lanes", times, 1000, turning, bound=bound)
            )
    return rows
