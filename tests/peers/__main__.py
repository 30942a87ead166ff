"""Compares robodyn with other engines: `make peers`.

Parts of one table, the same in bench/peers.json:

agreement  the largest difference over random states, relative to the size of the terms that are
           added up in what is compared (at most ROUNDING)
export     the same of the models that `robodyn export` writes, and of the constraints that close
           loops there; what these allow, as the README tells it
batch      inverse dynamics of the same states, closures opened; states a second, medians, in turn
ready      milliseconds before the first motion
motion     milliseconds for an error at the end, read off curves over tolerances as in `make bench`;
           the compiled Taylor engine must take at most BOUND times what heyoka's takes

An engine that cannot be imported is named, with the reason, and left out.  Exits 1 where a bound
is missed.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from importlib import import_module
from importlib.metadata import version
from statistics import median
from time import perf_counter
from timeit import timeit
from types import ModuleType
from typing import Any

import numpy as np
from bench_frontier import ROOT, Array, Curve, case, taylor
from rich.console import Console
from rich.progress import track
from rich.table import Table

import robodyn
from peers.agreement import Row, agreement, motion_states
from peers.exported import exports
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text

PEERS = {  # and their names on PyPI
    "mujoco": "mujoco",
    "pinocchio": "pin",
    "heyoka": "heyoka",
    "sympy": "sympy",
    "scipy": "scipy",
}
BOUND = 1.0
WIDTH = 10_000  # as wide as its content: nothing is cut
BATCH, TURNS, REPEATS = 100_000, 5, 9
TOLERANCES = (10.0 ** -np.arange(3.0, 15.01, 0.5)).tolist()
MOTIONS = (("2r-regular", 10.0), ("2r-chaotic", 10.0), ("four-bar", 5.0))
TARGETS = (1e-6, 1e-9, 1e-12)


def opened(mechanism: Mechanism) -> Mechanism:
    """The tree of a mechanism, every joint actuated."""
    parts = mechanism.description._replace(closures=(), branches=(), actuated=None)
    return build(parts)


def batch(engines: dict[str, ModuleType]) -> Iterator[Row]:
    from bench import chain_text

    scenes = {
        "2R": robodyn.load(ROOT / "robots/2r.yaml"),
        "four-bar, opened": opened(robodyn.load(ROOT / "robots/four-bar.yaml")),
        "6R chain": build(from_text(chain_text(6), "6R")),
    }
    for what, tree in scenes.items():
        states = motion_states(tree, BATCH)
        ways: dict[str, Callable[[], Array]] = {
            "robodyn": partial(robodyn.inverse_dynamics, tree, *states)
        }
        for name, engine in engines.items():
            if hasattr(engine, "batches"):
                found = engine.batches(tree, *states)
                ways |= {f"{name} {how}": run for how, run in found.items()}
        tau = ways["robodyn"]()
        for run in ways.values():
            np.testing.assert_allclose(run(), tau, rtol=1e-10, atol=1e-10)
        turns = [[timeit(run, number=1) for run in ways.values()] for _ in range(TURNS)]
        ours, *theirs = (median(times) for times in zip(*turns, strict=True))
        for how, seconds in zip(list(ways)[1:], theirs, strict=True):
            rates = BATCH / seconds, "states/s", BATCH / ours
            yield Row("batch", f"inverse dynamics, {what}", how, *rates, ratio=ours / seconds)


def making_ready(engines: dict[str, ModuleType]) -> Iterator[Row]:
    """Before the first motion: heyoka compiles for a mechanism and a tolerance, robodyn loads."""
    for reference, time in MOTIONS[::2]:
        problem = case(reference, time)
        if reference == MOTIONS[0][0]:
            start = perf_counter()
            taylor(problem, 1e-9)()
            what = "series in machine code, the first in a process"
            yield Row("ready", what, "robodyn", math.nan, "ms", milliseconds(start))
        if "heyoka" in engines:
            for tolerance in (1e-6, 1e-15):
                anew, cached = engines["heyoka"].ready_seconds(problem, tolerance)
                start = perf_counter()
                taylor(problem, tolerance)
                ours = milliseconds(start)
                what = f"{reference}, ready for {tolerance:g}"
                yield Row("ready", what, "heyoka, compiled anew", 1e3 * anew, "ms", ours)
                yield Row("ready", what, "heyoka, from its cache", 1e3 * cached, "ms", ours)


def milliseconds(start: float) -> float:
    return 1e3 * (perf_counter() - start)


def motions(engines: dict[str, ModuleType]) -> Iterator[Row]:
    for reference, time in MOTIONS:
        problem = case(reference, time)
        curves = {"robodyn": Curve(problem, [taylor(problem, x) for x in TOLERANCES])}
        for name, engine in engines.items():
            try:
                found = engine.runs(problem, TOLERANCES) if hasattr(engine, "runs") else {}
            except NotImplementedError:
                continue
            curves |= {f"{name} {how}": Curve(problem, runs) for how, runs in found.items()}
        for curve in curves.values():
            curve.measure()
        for _ in range(REPEATS):
            for curve in curves.values():
                curve.turn()
        own = curves.pop("robodyn")
        for target in TARGETS:
            ours = 1e3 * own.time(target)
            for name, curve in curves.items():
                theirs = 1e3 * curve.time(target)
                reached = np.isfinite(theirs)
                yield Row(
                    "motion",
                    f"{problem.name}, to {target:g}",
                    name,
                    theirs,
                    "ms",
                    ours,
                    ratio=ours / theirs if reached else None,
                    bound=BOUND if reached and name.startswith("heyoka") else None,
                )
        for name, curve in curves.items():
            best, ours = float(np.nanmin(curve.errors)), float(np.nanmin(own.errors))
            yield Row("motion", f"{problem.name}, error reached", name, best, "", ours)


def drawn(rows: list[Row], versions: dict[str, str]) -> Table:
    title = "robodyn beside " + ", ".join(f"{name} {text}" for name, text in versions.items())
    table = Table(title=title, caption="ratio: seconds of robodyn / seconds of theirs")
    for column in ("what", "engine"):
        table.add_column(column, no_wrap=True)
    for column in ("theirs", "robodyn", "", "ratio", "bound", "ok"):
        table.add_column(column, justify="right", no_wrap=True)
    before = rows[0]
    for row in rows:
        if row.part != before.part or row.what.split(", ")[0] != before.what.split(", ")[0]:
            table.add_section()
        before = row
        numbers = [row.theirs, row.ours, row.ratio, row.bound]
        shown = ["" if x is None else f"{x:.3g}" if np.isfinite(x) else "-" for x in numbers]
        verdict = {None: "", True: "yes", False: "MISSED"}[row.ok]
        table.add_row(row.what, row.engine, *shown[:2], row.unit, *shown[2:], verdict)
    return table


def finite(content: dict[str, Any]) -> dict[str, Any]:
    """With null for what is not reached, which JSON has no number for."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in content.items()
    }


def main() -> int:
    engines, versions, absent = {}, {}, {}
    for name, package in PEERS.items():
        try:
            engine, number = import_module(f"peers.{name}_peer"), version(package)
        except (ImportError, OSError) as error:
            absent[name] = f"{type(error).__name__}: {error}"
        else:
            engines[name], versions[name] = engine, number
    rows: list[Row] = []
    console = Console(stderr=True)
    parts = agreement, exports, batch, making_ready, motions
    for part in track(parts, "comparing", console=console, transient=True):
        rows += part(engines)
    Console(width=WIDTH).print(drawn(rows, versions))
    for name, reason in absent.items():
        print(f"absent: {name}, {reason}")
    target = ROOT / "bench" / "peers.json"
    target.parent.mkdir(exist_ok=True)
    content = {
        "cores": os.cpu_count(),
        "versions": versions,
        "absent": absent,
        "rows": [finite(asdict(row)) | {"ok": row.ok} for row in rows],
    }
    target.write_text(json.dumps(content, indent=2) + "\n")
    missed = [row for row in rows if row.ok is False]
    print(f"{len(missed)} of {sum(row.ok is not None for row in rows)} bounds missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
