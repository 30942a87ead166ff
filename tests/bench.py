"""Speed, measured: `make bench`.  Each figure is a ratio to a yardstick timed in the same run.

Ours and the yardstick take turns; the ratio of their medians counts, that of their minima stands
beside it.  Prints one table, writes the same to bench/speed.json, and exits 1 where a bound is
missed.  Each function of `MEASURES` makes a row or two.  MB are 10^6 bytes.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from timeit import timeit
from typing import Any

import numpy as np
from bench_derivatives import derivatives
from bench_frontier import frontier, taylor_process, what_acts
from bench_identify import identification
from bench_long import long_chains, nearly_locked
from bench_motions import (
    code_of_many_loops,
    many_loops,
    motions,
    sliding_joints,
    watched_runs,
)
from bench_sweep import flip_map, sweeps, sweeps_beside_ode
from numpy.typing import NDArray

import robodyn
from robodyn.engines import batches, machine
from robodyn.engines.formulas import inverse_formula
from robodyn.engines.straightline import compile_floats
from robodyn.loops.loop_rates import loop_accelerations, loop_velocities
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import build
from robodyn.runs.right_hand_side import right_hand_side
from robodyn.scene.description import from_text
from yardsticks import four_bar_rates, two_link_rates

Array = NDArray[np.float64]
Command = tuple[str | Path, ...]
Pair = tuple[float, float]
Limits = dict[str, float]  # bound and aim of a row
Times = list[Pair]  # seconds of ours and of the yardstick, taken in turn

ROOT = Path(__file__).resolve().parent.parent
BIN = Path(sys.executable).parent
ARM = "robots/2r.yaml"

# A process of its own, and a small one: a child's peak memory begins with that of its parent.
LAUNCHER = """
import os, sys, time
out = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
start = time.perf_counter()
stdout = (os.POSIX_SPAWN_DUP2, out, 1)
child = os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ, file_actions=[stdout])
_, status, usage = os.wait4(child, 0)
print(time.perf_counter() - start, usage.ru_maxrss, os.waitstatus_to_exitcode(status))
"""
LOADTXT_SAVETXT = """
import sys, numpy as np
rows = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1)
np.savetxt(sys.stdout, np.column_stack([rows, np.load(sys.argv[2])]), delimiter=",")
"""
WITHOUT_FAST = """
import sys
sys.modules.update(llvmlite=None, orjson=None)
from robodyn.__main__ import main
main()
"""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; without a bound it is reported only."""

    what: str
    value: float  # a ratio, or MB
    least: float | None = None  # the ratio of minima
    bound: float | None = None
    aim: float | None = None
    yardstick: str = ""
    ours: str = ""

    @property
    def ok(self) -> bool:
        return self.bound is None or self.value <= self.bound


class Bench:
    """Sizes, a folder for files, and what several rows share."""

    def __init__(self, quick: bool, folder: Path) -> None:
        self.quick, self.folder = quick, folder
        self.states, self.repeats = (40_000, 3) if quick else (1_000_000, 15)
        self.arm = robodyn.load(ROOT / ARM)
        self.motion = self.random_motion(2)
        np.testing.assert_allclose(self.torques(), self.torques_by_numpy(), rtol=1e-11, atol=1e-11)

    def random_motion(self, n: int) -> list[Array]:
        rng = np.random.default_rng(n)
        q = rng.uniform(-np.pi, np.pi, (self.states, n))
        return [q, rng.normal(size=q.shape), rng.normal(size=q.shape)]

    def torques(self) -> Array:
        return robodyn.inverse_dynamics(self.arm, *self.motion)

    def torques_by_numpy(self) -> Array:
        q, qd, qdd = self.motion
        tau = np.empty_like(q)
        tau[:, 0], tau[:, 1] = equation_27(self.arm, np.cos, np.sin)(*q.T, *qd.T, *qdd.T)
        return tau

    def processes(self, ours: Command, yardstick: Command, repeats: int) -> tuple[Times, Pair]:
        """Run two commands in turn, stdout to a file: seconds, and the peak MB of each."""
        runs = [(self.process(ours), self.process(yardstick)) for _ in range(1 + repeats)]
        peaks = (max(first[1] for first, _ in runs), max(second[1] for _, second in runs))
        return [(first[0], second[0]) for first, second in runs[1:]], peaks

    def process(self, command: Command) -> Pair:
        """Run a command in the root of the repository: seconds and peak MB."""
        launch = [sys.executable, "-I", "-S", "-c", LAUNCHER, self.folder / "out", *command]
        done = subprocess.run(launch, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
        seconds, peak, code = done.stdout.split()
        if int(code) != 0:
            raise RuntimeError(f"exit code {code}: {command}")
        return float(seconds), int(peak) * (1 if sys.platform == "darwin" else 1024) / 1e6


def equation_27(arm: robodyn.Mechanism, cos: Any, sin: Any) -> Callable[..., tuple[Any, Any]]:
    """tau = M qdd + C qd + G of a 2R arm by hand, for floats or whole arrays."""
    upper, fore = arm.description.links
    g, r1, r2 = -arm.gamma.imag, upper.r.real, fore.r.real
    b = fore.m * upper.l * r2
    M22 = fore.m * r2**2 + fore.I
    M11 = upper.m * r1**2 + upper.I + fore.m * upper.l**2 + M22  # at q2 = 90 deg
    w1, w2 = (upper.m * r1 + fore.m * upper.l) * g, fore.m * r2 * g

    def torque(q1: Any, q2: Any, qd1: Any, qd2: Any, qdd1: Any, qdd2: Any) -> tuple[Any, Any]:
        bc, h = b * cos(q2), b * sin(q2)
        M12, G2 = bc + M22, w2 * cos(q1 + q2)
        return (
            (M11 + 2 * bc) * qdd1 + M12 * qdd2 - h * qd2 * (2 * qd1 + qd2) + w1 * cos(q1) + G2,
            M12 * qdd1 + M22 * qdd2 + h * (qd1 * qd1) + G2,
        )

    return torque


def in_turn(
    ours: Callable[[], object],
    yardstick: Callable[[], object],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> Times:
    """Seconds that `clock` tells, after one run each that does not count."""
    timed = partial(timeit, timer=clock, number=1)
    return [(timed(ours), timed(yardstick)) for _ in range(1 + repeats)][1:]


def compared(what: str, times: Times, items: int, yardstick: str, **limits: float) -> Row:
    """The row of these seconds, each the time of so many items (states, rows, calls)."""
    ours, theirs = zip(*times, strict=True)
    ratio, least = median(ours) / median(theirs), min(ours) / min(theirs)
    unit, scale = ("ms", 1e3) if items == 1 else ("ns", 1e9 / items)
    yardstick += f": {median(theirs) * scale:.4g} {unit}"
    shown = f"{median(ours) * scale:.4g} {unit}, {items / median(ours):.3g}/s"
    return Row(what, ratio, least, yardstick=yardstick, ours=shown, **limits)


def one_process(bench: Bench) -> list[Row]:
    command = (BIN / "robodyn", "torque", ARM, "--q", "0.1,0.2", "--qd", "1,2", "--qdd", "0,0")
    numpy = (sys.executable, "-c", "import numpy")
    times, _ = bench.processes(command, numpy, 3 if bench.quick else 31)
    return [compared("torque, whole process", times, 1, "import numpy", bound=2.2)]


def batch(
    bench: Bench, what: str, function: Callable[[], object], extra: Limits, without: Limits
) -> list[Row]:
    """A batch of states against equation (27) in numpy for as many states of the 2R.

    With the extra `fast`, whose machine code is made before, and without it.
    """
    rows = []
    for name, limits, worth in (("machine code", extra, 0.0), ("numpy", without, math.inf)):
        if not worth and not machine.available():
            continue
        usual, batches.WORTH = batches.WORTH, worth
        times = in_turn(function, bench.torques_by_numpy, bench.repeats)
        batches.WORTH = usual
        found = compared(f"{what}, {name}", times, bench.states, "numpy (27)", **limits)
        rows.append(found)
    return rows


def two_link_batch(bench: Bench) -> list[Row]:
    tracemalloc.start()
    output = bench.torques().nbytes
    extra = (tracemalloc.get_traced_memory()[1] - output) / 1e6
    tracemalloc.stop()
    limits = {"bound": 0.1, "aim": 0.05}, {"bound": 0.8, "aim": 0.5}
    rows = batch(bench, "inverse dynamics, 2R", bench.torques, *limits)
    return [*rows, Row("inverse dynamics, 2R, extra MB", extra, bound=64.0)]


def table(bench: Bench) -> list[Row]:
    states, torques = bench.folder / "states.csv", bench.folder / "torques.npy"
    np.save(torques, bench.torques())
    rows = np.column_stack([np.arange(bench.states) * 1e-3, *bench.motion])
    with states.open("w") as stream:
        stream.write("t,q1,q2,qd1,qd2,qdd1,qdd2\n")
        stream.writelines(",".join(map(repr, row.tolist())) + "\n" for row in rows)
    command = (BIN / "robodyn", "torque", ARM, states)
    numpy = (sys.executable, "-c", LOADTXT_SAVETXT, states, torques)
    repeats = 1 if bench.quick else 3
    times, (peak, numpy_peak) = bench.processes(command, numpy, repeats)
    alone, _ = bench.processes((sys.executable, "-c", WITHOUT_FAST, *command[1:]), numpy, repeats)
    return [
        compared("torque of a CSV", times, bench.states, "loadtxt, savetxt", bound=0.3),
        compared("the same without `fast`", alone, bench.states, "loadtxt, savetxt", bound=0.8),
        Row("torque of a CSV, peak MB", peak, None, 60.0, None, f"numpy: {numpy_peak:.0f} MB"),
    ]


def four_bar_batch(bench: Bench) -> list[Row]:
    mechanism = robodyn.load(ROOT / "robots/four-bar.yaml")
    crank, rate, acceleration = bench.random_motion(1)
    q = robodyn.assemble(mechanism, crank)
    qd = loop_velocities(mechanism, q, rate, t=0.0)
    qdd = loop_accelerations(mechanism, q, qd, acceleration, t=0.0)
    states = (mechanism, q, qd)
    inverse = batch(
        bench,
        "inverse dynamics, four-bar",
        lambda: robodyn.inverse_dynamics(*states, qdd),
        {"bound": 0.3, "aim": 0.15},
        {},
    )
    tau = np.cos(qd) * [1.0, 0.0, 0.0]
    forward = batch(
        bench,
        "forward dynamics, four-bar",
        lambda: robodyn.forward_dynamics(*states, tau),
        {"bound": 0.4, "aim": 0.2},
        {},
    )
    return inverse + forward


def chain_text(n: int) -> str:
    """The scene of a chain of n links, all parameters distinct."""
    form = "{{name: {}, m: {}, l: {}, r: {}, I: {}}}"
    sizes = [(4 / 1.1**k, 0.5 / 1.05**k, 0.2 / 1.06**k, 0.1 / 1.2**k) for k in range(n)]
    links = [form.format(k, *size) for k, size in enumerate(sizes)]
    return f"gravity: 9.81\nlinks: [{', '.join(links)}]\n"


def n_four_bar_text(n: int) -> str:
    """The scene of n + 1 verticals from ground pivots, joined by n horizontals."""
    bar = "m: 1, l: 1, r: 0.5, I: 0.08333333333333333"
    links = [f"{{name: v{k}, {bar}, from: [{k}, 0]}}" for k in range(n + 1)]
    links += [f"{{name: h{k}, {bar}, from: v{k}}}" for k in range(n)]
    closures = ", ".join(f"[h{k}, v{k + 1}]" for k in range(n))
    return f"gravity: 9.81\nlinks: [{', '.join(links)}]\nclosures: [{closures}]\n"


def chain_batch(bench: Bench) -> list[Row]:
    chain, motion = build(from_text(chain_text(6), "6R")), bench.random_motion(6)
    ours = partial(robodyn.inverse_dynamics, chain, *motion)
    return batch(bench, "inverse dynamics, 6R chain", ours, {"bound": 0.35, "aim": 0.2}, {})


def one_call(bench: Bench) -> list[Row]:
    formula = inverse_formula(bench.arm)
    assert formula is not None
    ours, hand = compile_floats(formula, "torque"), equation_27(bench.arm, math.cos, math.sin)
    x = np.hstack(bench.motion)[:20_000].T.tolist()
    times = in_turn(lambda: list(map(ours, *x)), lambda: list(map(hand, *x)), bench.repeats)
    return [compared("generated floats, 2R", times, len(x[0]), "by hand")]


def simulation_process(bench: Bench) -> list[Row]:
    start = ("--q", "30deg,45deg", "--time", "10", "--points", "1000", "--quiet")
    command = (BIN / "robodyn", "simulate", ARM, *start)
    scipy = (sys.executable, "-c", "from scipy.integrate import solve_ivp")
    times, _ = bench.processes(command, scipy, 3 if bench.quick else 15)
    return [compared("simulate, whole process", times, 1, "import solve_ivp", bound=1.35)]


def right_hand_sides(bench: Bench) -> list[Row]:
    """The generated dy/dt against the same equations written by hand."""
    rows = []
    for what, scene, by_hand, bound in (
        ("dy/dt, 2R", ARM, two_link_rates, 1.3),
        ("dy/dt, four-bar (33)", "robots/four-bar.yaml", four_bar_rates, 1.5),
    ):
        mechanism = robodyn.load(ROOT / scene)
        unforced = Actuation((0.0,) * mechanism.n)
        ours, hand = right_hand_side(mechanism, unforced).rates, by_hand(mechanism)
        crank = np.random.default_rng(1).uniform(-np.pi, np.pi, (2000, len(mechanism.actuated)))
        q = robodyn.assemble(mechanism, crank)
        states = list(np.hstack([q, loop_velocities(mechanism, q, np.ones_like(crank), t=0.0)]))
        for y in states:
            np.testing.assert_allclose(ours(0.0, y), hand(0.0, y), rtol=1e-9, atol=1e-9)
        times = in_turn(
            lambda ours=ours, states=states: [ours(0.0, y) for y in states],
            lambda hand=hand, states=states: [hand(0.0, y) for y in states],
            4 * bench.repeats,
        )
        rows.append(compared(what, times, len(states), "by hand", bound=bound))
    return rows


def evaluators(bench: Bench) -> list[Row]:
    """Where straight-line code and dense algebra cross: ratio of their times."""
    rows = []
    scenes = [(f"{n}R chain", chain_text(n)) for n in (10, 20, 40)]
    scenes += [(f"{n}-four-bar", n_four_bar_text(n)) for n in (10, 40, 80)]
    for what, text in scenes[:: 3 if bench.quick else 1]:
        mechanism = build(from_text(text, what))
        unforced = Actuation((0.0,) * mechanism.n)
        kinds = [right_hand_side(mechanism, unforced, kind=k) for k in ("straight-line", "dense")]
        q = np.full(mechanism.n, 1.0)
        if mechanism.rows:
            q[mechanism.n // 2 + 1 :] = -1.0
        y = np.concatenate([q, np.zeros(mechanism.n)])
        times = in_turn(
            lambda kinds=kinds, y=y: [kinds[0].rates(0.0, y) for _ in range(20)],
            lambda kinds=kinds, y=y: [kinds[1].rates(0.0, y) for _ in range(20)],
            bench.repeats,
        )
        rows.append(compared(f"dy/dt straight-line, {what}", times, 20, "dense"))
    return rows


MEASURES = [
    one_process,
    two_link_batch,
    table,
    four_bar_batch,
    chain_batch,
    one_call,
    simulation_process,
    right_hand_sides,
    evaluators,
    taylor_process,
    what_acts,
    frontier,
    sliding_joints,
    derivatives,
    identification,
    many_loops,
    code_of_many_loops,
    motions,
    watched_runs,
    sweeps,
    sweeps_beside_ode,
    flip_map,
    long_chains,
    nearly_locked,
]


def as_text(rows: list[Row]) -> str:
    lines = [["what", "ratio", "least", "bound", "aim", "yardstick", "ours", "ok"]]
    for row in rows:
        values = (row.value, row.least, row.bound, row.aim)
        shown = ["" if x is None else f"{x:.3g}" for x in values]
        verdict = "" if row.bound is None else "yes" if row.ok else "MISSED"
        lines.append([row.what, *shown, row.yardstick, row.ours, verdict])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure speed against yardsticks.")
    parser.add_argument("--only", default="", help="measure what has this in its name")
    parser.add_argument("--quick", action="store_true", help="small sizes, bounds do not count")
    arguments = parser.parse_args()
    quick = arguments.quick
    chosen = [measure for measure in MEASURES if arguments.only in measure.__name__]
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(quick, Path(folder))
        rows = [row for measure in chosen for row in measure(bench)]
    print(as_text(rows))
    target = ROOT / "bench" / "speed.json"
    target.parent.mkdir(exist_ok=True)
    content = [asdict(row) | {"ok": row.ok} for row in rows]
    target.write_text(json.dumps({"cores": os.cpu_count(), "rows": content}, indent=2) + "\n")
    return 0 if quick or all(row.ok for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
