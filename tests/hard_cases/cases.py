"""The hard cases: each function runs one and returns rows of measure, bound and measurement."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from quick_robodyn import path_with_it
from scipy.integrate import solve_ivp

import oracles
import robodyn
from hard_cases import contacts, many_events, slopes
from hard_cases import near_misses as near_miss
from machine_sines import hard_angles, sine_and_cosine
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.report import Outcome
from robodyn.runs.simulation import simulate
from robodyn.scene.description import from_text

HERE = Path(__file__).resolve().parent
ROBOTS = HERE.parent.parent / "robots"


METHODS = ("DOP853", "taylor")


@dataclass(frozen=True)
class Row:
    """One line of the table; it passes where measured <= bound."""

    case: str
    hard: str
    measure: str
    bound: float
    measured: float

    @property
    def passed(self) -> bool:
        return bool(self.measured <= self.bound)


def scene(name: str) -> Mechanism:
    return robodyn.load(HERE / f"{name}.yaml")


def truth(holds: bool) -> float:
    """0 where what is claimed holds, 1 where it does not."""
    return 0.0 if holds else 1.0


def command(*arguments: object, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """`robodyn` in a process of its own, forked from one that has imported it."""
    line = ["robodyn", *map(str, arguments)]
    env = {**os.environ, "PATH": path_with_it()}
    return subprocess.run(line, env=env, input=stdin, capture_output=True, text=True, check=False)


# -- 1: N-four-bar -------------------------------------------------------------------------------


def n_four_bar(n: int) -> Mechanism:
    """n + 1 verticals from ground pivots 1 m apart, tips joined by n horizontals, uniform bars."""
    bar = "m: 1, l: 1, r: 0.5, I: 0.083333333333333333"
    links = [f"{{name: v{k}, {bar}, from: [{k}, 0]}}" for k in range(n + 1)]
    links += [f"{{name: h{k}, {bar}, from: v{k}}}" for k in range(n)]
    closures = ", ".join(f"[h{k}, v{k + 1}]" for k in range(n))
    text = f"gravity: 9.81\nlinks: [{', '.join(links)}]\nclosures: [{closures}]\n"
    return build(from_text(text, f"{n}-four-bar"))


# Error per rtol that the integration over 10 s makes: it passes near the unstable upright.
GROWTH = 1000.0


def swing(n: int, rtol: float, method: str) -> tuple[float, float, float]:
    """Error against the exact motion, spread of the verticals and largest gap, over 10 s."""
    q = np.concatenate([np.full(n + 1, np.pi / 2), np.full(n, -np.pi / 2)])
    qd = np.concatenate([np.full(n + 1, -1.0), np.full(n, 1.0)])
    motion = simulate(n_four_bar(n), q, qd, 10.0, method=method, rtol=rtol, atol=rtol)
    if motion.outcome is not Outcome.FINISHED:
        return np.inf, np.inf, np.inf
    verticals = motion.q[-1, : n + 1]
    exact = float(oracles.n_four_bar_exact(n, 10.0)[0])
    error = float(np.abs(verticals - exact).max())
    return error, float(np.ptp(verticals)), motion.report.largest_gap


def parallel_bars(largest: int = 100) -> Iterator[Row]:
    hard = "freedoms jump from 1 to N + 1"
    for method in METHODS:
        for n in (1, 2, 5, 10, 40, 100):
            if n > largest:
                break
            for rtol in (1e-6, 1e-9, 1e-12):
                if n == largest and rtol != 1e-9:
                    continue
                # how much the upright makes of a first error is chance at loose tolerances
                near = (0.8, 1.0, 1.25) if rtol > 1e-8 and n <= 10 else (1.0,)
                found = [swing(n, factor * rtol, method) for factor in near]
                growths = [error / factor for (error, *_), factor in zip(found, near, strict=True)]
                error = float(np.median(growths))
                spread, gap = (max(x[k] for x in found) for k in (1, 2))
                case = f"{n}-four-bar, {method} {rtol:g}"
                yield Row(case, hard, "error of the verticals, rad", GROWTH * rtol, error)
                yield Row(case, hard, "verticals not parallel, rad", 1e-9, spread)
                yield Row(case, hard, "largest gap, m", 1e-13, gap)


def parallel_bars_by_chance(part: int = 1) -> Iterator[Row]:
    """Where the steps land next to the horizontal is chance: many tolerances, the worst counts."""
    for method in METHODS:
        for n, count in ((1, 40), (2, 30), (5, 10)):
            count = count // part
            if not count:
                continue
            tolerances = (10.0 ** np.linspace(-12.7, -7.0, count)).tolist()
            found = [swing(n, rtol, method) for rtol in tolerances]
            worst = max(error / rtol for (error, _, _), rtol in zip(found, tolerances, strict=True))
            case = f"{n}-four-bar, {method}, {count} tolerances to 2e-13"
            hard = "steps land by chance"
            yield Row(case, hard, "worst error / rtol", GROWTH, worst)
            spread = max(spread for _, spread, _ in found)
            yield Row(case, hard, "verticals not parallel, rad", 1e-9, spread)


# -- 2: double pendulum --------------------------------------------------------------------------


def double_pendulum(part: int = 1) -> Iterator[Row]:
    mechanism = scene("double-pendulum")
    # absolute angles from the downward vertical, and their rates; published digits
    cases = (
        (
            45.0,
            20.0,
            [-0.44722038984908774, -0.59055315896693302],
            [-1.6087337152480216, -1.1311306299017572],
            30.0,
        ),
        (
            90.0,
            10.0,
            [-0.568474664015950, -0.526393727932405],
            [6.07838488576197, -9.68136068170888],
            1000.0,
        ),
    )
    for method, (degrees, time, angles, rates, growth) in product(METHODS, cases):
        hard = "chaotic" if degrees == 90.0 else "long"
        for rtol in (1e-6, 1e-9, 1e-12):
            start = [np.radians(degrees) - np.pi / 2, 0.0]
            motion = simulate(
                mechanism, start, [0, 0], time, method=method, rtol=rtol, atol=rtol, t_eval=[time]
            )
            absolute = np.cumsum(motion.q[-1]) + np.pi / 2
            off = np.abs(np.remainder(absolute - angles + np.pi, 2 * np.pi) - np.pi).max()
            error = max(float(off), float(np.abs(np.cumsum(motion.qd[-1]) - rates).max()))
            case = f"double pendulum {degrees:g} deg, {method} {rtol:g}"
            yield Row(case, hard, f"error at {time:g} s", growth * rtol, error)
    for method in METHODS:
        motion = simulate(
            mechanism,
            [-np.pi / 4, 0],
            [0, 0],
            1000.0 / part,
            method=method,
            rtol=1e-10,
            atol=1e-10,
            t_eval=[1000.0 / part],
        )
        drift = motion.report.energy_drift
        case = f"double pendulum 45 deg, {method}"
        yield Row(case, "1000 s", "energy drift, rtol 1e-10", 1e-7, drift)


# -- 3: mass ratios ------------------------------------------------------------------------------


def mass_ratios(part: int = 1) -> Iterator[Row]:
    long = 10.0 / part
    for ratio in (1e-6, 1e-3, 1e3, 1e6):
        text = (
            "gravity: 9.81\nlinks:\n"
            "  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}\n"
            f"  - {{name: b, m: {0.9 * ratio!r}, l: 0.6, r: 0.25, I: {0.031 * ratio!r}}}\n"
        )
        mechanism = build(from_text(text, "ratio"))
        tree = [
            {"m": 1.5, "l": 0.8, "r": 0.36, "I": 0.082, "parent": None, "at": 0},
            {"m": 0.9 * ratio, "l": 0.6, "r": 0.25, "I": 0.031 * ratio, "parent": 0, "at": 0.8},
        ]
        q, qd, qdd = [0.4, 1.1], [2.0, -3.0], [1.0, 0.5]
        tau = oracles.newton_euler_mp(tree, -9.81j, q, qd, qdd)
        found = robodyn.forward_dynamics(mechanism, q, qd, [float(x) for x in tau])
        case = f"2R, mass ratio {ratio:g}"
        error = float(np.abs(found - qdd).max())
        yield Row(case, "M ill-conditioned", "error of qdd", 1e-12, error)
        for method in METHODS:
            drift = simulate(mechanism, q, [0, 0], long, method=method).report.energy_drift
            what = f"energy drift, {long:g} s"
            yield Row(f"{case}, {method}", "M ill-conditioned", what, 1e-7, drift)
    mechanism = scene("massless-coupler")
    hard = "M alone is singular"
    motion = simulate(mechanism, robodyn.assemble(mechanism, [1.0]), [0, 0, 0], long)
    case, finished = "massless coupler, DOP853", motion.outcome is Outcome.FINISHED
    yield Row(case, hard, "not finished", 0, truth(finished))
    yield Row(case, hard, f"energy drift, {long:g} s", 1e-7, motion.report.energy_drift)
    for method in METHODS:
        arguments = ("--q", "0,0", "--time", "1", "--method", method)
        done = command("simulate", HERE / "massless-tip.yaml", *arguments)
        explained = done.returncode == 1 and "wire" in done.stderr and "nan" not in done.stdout
        case = f"massless last link, {method}"
        yield Row(case, "M is singular", "no explanation, exit 1", 0, truth(explained))


# -- 4: toggle and dead centre -------------------------------------------------------------------


def dead_centres() -> Iterator[Row]:
    hard = "the actuated joint cannot move the others"
    mechanism = robodyn.load(ROBOTS / "four-bar.yaml")
    # crank and coupler in line: the rocker as input cannot move the crank
    cosine = (1.1**2 + 1.3**2 - 0.8**2) / (2 * 1.1 * 1.3)
    crank = float(np.arccos(cosine))
    q = robodyn.assemble(mechanism, [crank])
    for method in METHODS:
        drift = simulate(mechanism, q, [0, 0, 0], 10.0, method=method).report.energy_drift
        case = f"four-bar, stretched, {method}"
        yield Row(case, hard, "energy drift from there, 10 s", 1e-7, drift)
    rocker = build(
        from_text(
            (ROBOTS / "four-bar.yaml")
            .read_text()
            .replace("actuated: [crank]", "actuated: [rocker]"),
            "rocker-driven",
        )
    )
    try:
        robodyn.inverse_dynamics(rocker, q, [0, 0, 0], [0, 0, 0])
        named = False
    except robodyn.SingularError as error:
        named = "dead centre" in str(error)
    yield Row("four-bar, stretched", hard, "torque there not named singular", 0, truth(named))
    toggle = scene("toggle")
    turn = np.linspace(0, 2 * np.pi, 721)[:, None]
    closed = robodyn.assemble(toggle, turn)
    qd = robodyn.loop_velocities(toggle, closed, np.full_like(turn, 5.0))
    qdd = robodyn.loop_accelerations(toggle, closed, qd, np.zeros_like(turn))
    tau = robodyn.inverse_dynamics(toggle, closed, qd, qdd)
    power = np.einsum("ij,ij->i", tau, qd)
    energy = robodyn.kinetic_energy(toggle, closed, qd) + robodyn.potential_energy(toggle, closed)
    step = 2 * np.pi / 720 / 5.0
    balance = float(np.abs(np.trapezoid(power, dx=step) - (energy[-1] - energy[0])))
    yield Row(
        "slider-crank through its dead centres",
        hard,
        "work of a turn against energy, J",
        1e-10,
        balance,
    )
    start = [0.0, 0.0]  # the outer dead centre
    for method in METHODS:
        motion = simulate(toggle, start, [5.0, -5.0 * 0.1 / 0.32 - 5.0], 5.0, method=method)
        case = f"slider-crank from its dead centre, {method}"
        yield Row(case, hard, "energy drift, 5 s", 1e-7, motion.report.energy_drift)


# a slot whose pin passes the lever's pivot: the lever turns on at half the crank's rate
SLOT = """links:
  - {name: crank, m: 1, l: 0.3, r: 0, I: 0.02}
  - {name: lever, m: 1, l: 1, r: 0, I: 0.1, from: [-0.3, 0]}
closures:
  - {point: crank, on: {link: lever, through: [0, 0], along: [1, 0]}}
"""


def slot_through_its_dead_centre() -> Iterator[Row]:
    mechanism, hard = build(from_text(SLOT, "slot")), "the pin passes the lever's pivot"
    for method in METHODS:
        motion = simulate(mechanism, [0.5, 0.25], [3.0, 1.5], 20.0, method=method)
        exact = np.array([0.5, 0.25]) + motion.t[:, None] * [3.0, 1.5]
        finished = motion.outcome is Outcome.FINISHED
        error = float(np.abs(motion.q - exact).max()) if finished else np.inf
        yield Row(f"slot, {method}", hard, "error over 20 s, rtol 1e-9, rad", 1e-6, error)


# -- 5, 6, 7 -------------------------------------------------------------------------------------


def redundant_closures(part: int = 1) -> Iterator[Row]:
    long = 3.0 / part
    mechanism, hard = scene("third-crank"), "closures depend on one another"
    done = command("simulate", HERE / "third-crank.yaml", "--q", "60deg", "--time", long)
    said = done.returncode == 0 and "not unique" in done.stderr
    yield Row("third crank", hard, "not said on stderr", 0, truth(said))
    q = robodyn.assemble(mechanism, [1.0])
    for method in METHODS:
        motion = simulate(mechanism, q, np.zeros(4), long, method=method)
        case = f"third crank, {method}"
        yield Row(case, hard, f"energy drift, {long:g} s", 1e-7, motion.report.energy_drift)
        spread = float(np.ptp(motion.q[:, [0, 2, 3]], axis=1).max())
        yield Row(case, hard, "cranks not parallel, rad", 1e-9, spread)


def inconsistent_start() -> Iterator[Row]:
    hard = "the loops are open"
    arguments = ("simulate", ROBOTS / "four-bar.yaml", "--q", "1,-0.44,1.7", "--time", "1")
    done = command(*arguments)
    refused = done.returncode == 2 and "gap" in done.stderr and not done.stdout
    yield Row("start with a gap", hard, "not refused with the gap", 0, truth(refused))
    done = command(*arguments, "--assemble")
    said = done.returncode == 0 and "moved by up to" in done.stderr
    yield Row("start with a gap, --assemble", hard, "not corrected", 0, truth(said))


def stiff() -> Iterator[Row]:
    mechanism, hard = scene("stiff"), "damper 1e6 times too strong"
    motion = simulate(mechanism, [0.5, 0.8], [0, 0], 2.0)
    named = motion.outcome is Outcome.STIFF and "Radau" in motion.outcome.advice
    yield Row("stiff, DOP853", hard, "does not say so", 0, truth(named))
    for method in ("Radau", "taylor"):  # the last by 330,000 short steps
        motion = simulate(mechanism, [0.5, 0.8], [0, 0], 2.0, method=method)
        works = motion.outcome is Outcome.FINISHED
        yield Row(f"stiff, {method}", hard, "not finished", 0, truth(works))
        yield Row(f"stiff, {method}", hard, "energy balance", 1e-6, motion.report.energy_drift)


# -- 8: long -------------------------------------------------------------------------------------

# the peak of this process alone: what getrusage tells survives an exec
PEAK = """
import sys
from robodyn.cli import run
code = run(sys.argv[1:])
for line in open("/proc/self/status"):
    if line.startswith("VmHWM"):
        sys.stderr.write(line.split()[1])
sys.exit(code)
"""


def long_run(part: int = 1) -> Iterator[Row]:
    long = 1000 // part
    mechanism = robodyn.load(ROBOTS / "four-bar.yaml")
    q = robodyn.assemble(mechanism, [1.0])
    for method in METHODS:
        motion = simulate(
            mechanism, q, [0, 0, 0], long, method=method, rtol=1e-8, atol=1e-8, t_eval=[long]
        )
        case, report = f"four-bar, {long} s, {method}", motion.report
        yield Row(case, "long", "largest gap, m", 1e-10, report.largest_gap)
        yield Row(case, "long", "energy drift, rtol 1e-8", 1e-5, report.energy_drift)
    peaks, short = [], max(long // 10, 10)  # by then what is kept for writing is full
    for seconds in (short, 10 * short) if Path("/proc/self/status").exists() else ():
        arguments = ["simulate", str(ROBOTS / "four-bar.yaml"), "--q", "1", "--time", str(seconds)]
        arguments += [
            "--every",
            "0.02",
            "--rtol",
            "1e-6",
            "--atol",
            "1e-6",
            "--quiet",
            "-o",
            os.devnull,
        ]
        line = [sys.executable, "-c", PEAK, *arguments]
        done = subprocess.run(line, capture_output=True, text=True, check=True)
        peaks.append(int(done.stderr.split()[-1]) / 1024)
    if peaks:
        case = f"four-bar, {10 * short} s against {short} s"
        yield Row(case, "long", "memory grows, MB", 3.0, peaks[1] - peaks[0])


# -- 9: scales, edges ----------------------------------------------------------------------------


def scaled(size: float, gravity: float = 9.81) -> Mechanism:
    """The four-bar `size` times as long, of the same masses."""
    text = (ROBOTS / "four-bar.yaml").read_text().replace("9.81", repr(gravity))
    lengths = {
        "l: 0.35, r: 0.15, I: 0.008": (0.35, 0.15, 0.008),
        "l: 0.95, r: 0.45, I: 0.102": (0.95, 0.45, 0.102),
        "l: 0.80, r: 0.36, I: 0.061": (0.80, 0.36, 0.061),
    }
    for old, (l, r, inertia) in lengths.items():
        text = text.replace(old, f"l: {l * size!r}, r: {r * size!r}, I: {inertia * size**2!r}")
    text = text.replace("[1.1, 0.0]", f"[{1.1 * size!r}, 0.0]")
    return build(from_text(text, f"four-bar times {size:g}"))


def scales_and_edges() -> Iterator[Row]:
    plain = robodyn.load(ROBOTS / "2r.yaml")
    for method in METHODS:
        motion = simulate(plain, [0.3, 0.2], [1000.0, 0.0], 0.1, method=method)
        case, drift = f"2R at 1000 rad/s, {method}", motion.report.energy_drift
        yield Row(case, "fast", "energy drift, 0.1 s", 1e-7, drift)
    unit = scaled(1.0)
    q = robodyn.assemble(unit, [1.0])
    times = np.linspace(0.0, 1.0, 5)
    reference = simulate(unit, q, [0, 0, 0], 1.0, t_eval=times, rtol=1e-10, atol=1e-10)
    for size, method in product(
        (2.0**-20, 2.0**20), METHODS
    ):  # 1e-6 m and 1e6 m, in powers of two: scaling is exact
        # times go with the root of lengths; angles are the same, rates go with the inverse
        slow = np.sqrt(size)
        motion = simulate(
            scaled(size),
            q,
            [0, 0, 0],
            slow,
            t_eval=times * slow,
            method=method,
            rtol=1e-10,
            atol=1e-10 / max(slow, 1.0),
        )
        error = float(np.abs(motion.q - reference.q).max())
        case = f"four-bar times {size:.3g}, {method}"
        yield Row(case, "scale", "angles differ, rad", 1e-8, error)
        again = robodyn.inverse_dynamics(scaled(size), q, [0, 0, 0], [0, 0, 0]) / size
        once = robodyn.inverse_dynamics(unit, q, [0, 0, 0], [0, 0, 0])
        error = float(np.abs(again - once).max())
        yield Row(f"four-bar times {size:.3g}", "scale", "torque differs, relative", 1e-13, error)
        # another unit of length: gravity changes too, and times stay
        runs = [
            simulate(scaled(unit, 9.81 * unit), q, [0, 0, 0], 1.0, t_eval=times, method=method)
            for unit in (1.0, size)
        ]
        error = float(np.abs(runs[0].q - runs[1].q).max())
        case = f"four-bar in units of {1 / size:.3g} m, {method}"
        yield Row(case, "scale", "angles differ, rad", 1e-14, error)
    motion = simulate(plain, [0.3, 0.2], [0, 0], 0.0)
    right = motion.t.tolist() == [0.0] and motion.q.tolist() == [[0.3, 0.2]]
    yield Row("time zero", "edge", "not the start alone", 0, truth(right))
    motion = simulate(plain, [0.3, 0.2], [0, 0], 1.0, t_eval=[1.0])
    yield Row("one output point", "edge", "not the end alone", 0, truth(motion.t.tolist() == [1.0]))
    for method in METHODS:
        tight = {"method": method, "rtol": 1e-12, "atol": 1e-12}
        there = simulate(plain, [0.3, 0.2], [0.5, 0], 2.0, **tight)
        back = simulate(plain, there.q[-1], there.qd[-1], -2.0, **tight)
        error = float(np.abs(back.q[-1] - [0.3, 0.2]).max())
        yield Row(f"backwards, {method}", "edge", "start not regained, rad", 1e-8, error)


# -- 10: seven bodies ----------------------------------------------------------------------------


def seven_body(part: int = 1) -> Iterator[Row]:
    """Against the book's own equations, integrated by scipy to the last digits it gives."""
    mechanism = scene("seven-body")
    start = np.concatenate([oracles.SEVEN_BODY_START, np.zeros(7)])
    tight = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-13}
    exact = solve_ivp(oracles.seven_body_rates, (0.0, 0.03), start, **tight).y[:, -1]
    hard = "1e-6 kg m^2, three loops"
    for method, rtol in [*product(METHODS, (1e-6, 1e-9, 1e-12))][::part]:
        motion = simulate(
            mechanism, start[:7], start[7:], 0.03, [0.033], method, rtol, rtol, t_eval=[0.03]
        )
        case = f"seven bodies, {method} {rtol:g}"
        error = float(np.abs(motion.q[-1] - exact[:7]).max())
        yield Row(case, hard, "error of angles after 30 ms", max(100.0 * rtol, 1e-10), error)
        yield Row(case, hard, "largest gap, m", 1e-15, motion.report.largest_gap)
        yield Row(case, hard, "energy balance", 10.0 * rtol, motion.report.energy_drift)


# -- 11: machine code ----------------------------------------------------------------------------


def sines() -> Iterator[Row]:
    """10^7 angles to 1e5 rad beside numpy's long doubles, which have 11 bits more."""
    angles = hard_angles(10_000_000)
    worst = [0.0, 0.0]
    for x in np.array_split(angles, 100):
        exact = x.astype(np.longdouble)
        for i, (found, known) in enumerate(
            zip(sine_and_cosine(x), (np.sin(exact), np.cos(exact)), strict=True)
        ):
            error = np.abs(found - known) / np.spacing(np.abs(found))
            worst[i] = max(worst[i], float(error.max()))
    for name, error in zip(("sine", "cosine"), worst, strict=True):
        yield Row(f"{name} of machine code", "10^7 angles to 1e5 rad", "error, ulp", 1.0, error)


# -- 12: near misses of change points -------------------------------------------------------------


NEAR_MISS = "branches all but meet"


def near_miss_states() -> Iterator[Row]:
    for case, worst in near_miss.states():
        yield Row(case, NEAR_MISS, near_miss.UNITS, 100.0, worst)


def near_miss_commands() -> Iterator[Row]:
    def run(*arguments: object, stdin: str = "") -> tuple[str, str]:
        done = command(*arguments, stdin=stdin)
        return done.stdout, done.stderr

    for case, measure, found, bound in near_miss.commands(run):
        yield Row(case, NEAR_MISS, measure, bound, found)


def near_miss_motions() -> Iterator[Row]:
    for case, error, bound in near_miss.motions():
        yield Row(case, NEAR_MISS, "error of q, qd", bound, error)


# -- 13: events ----------------------------------------------------------------------------------


def events_at_one_instant(part: int = 1) -> Iterator[Row]:
    hard, time = "five events at one instant", 100.0 / part
    for method, missing, apart, unordered in many_events.at_one_instant(time):
        case = f"wheel, {time:g} s, {method}"
        yield Row(case, hard, "events missing or invented", 0.0, missing)
        yield Row(case, hard, "farthest apart, s", 1e-10, apart)
        yield Row(case, hard, "out of order", 0.0, unordered)


def grazes(part: int = 1) -> Iterator[Row]:
    hard, time = "passes or misses by 1e-10", 1000.0 / part
    for method, wrong, invented in many_events.long_grazes(time):
        case = f"wheel, {time:g} s, {method}"
        yield Row(case, hard, "crossings missing or invented", 0.0, wrong)
        yield Row(case, hard, "crossings where there are none", 0.0, invented)


def bounces_without_end() -> Iterator[Row]:
    yield from (Row(*found) for found in contacts.zeno())


def long_stick_slip(part: int = 1) -> Iterator[Row]:
    yield from (Row(*found) for found in contacts.stick_slip(1000.0 / part))


def derivatives() -> Iterator[Row]:
    bar = robodyn.load(ROBOTS / "parallelogram.yaml")
    yield from (Row(*found) for found in slopes.near_change_points(bar))
    yield from (Row(*found) for found in slopes.far_apart())


CASES: list[Callable[[], Iterator[Row]]] = [
    parallel_bars,
    parallel_bars_by_chance,
    double_pendulum,
    mass_ratios,
    dead_centres,
    slot_through_its_dead_centre,
    redundant_closures,
    inconsistent_start,
    stiff,
    long_run,
    scales_and_edges,
    seven_body,
    sines,
    near_miss_states,
    near_miss_commands,
    near_miss_motions,
    events_at_one_instant,
    grazes,
    bounces_without_end,
    long_stick_slip,
    derivatives,
]
