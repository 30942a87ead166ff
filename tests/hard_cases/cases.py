"""The hard cases of issue 3, section 3: each function measures one and yields its findings."""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from mpmath import matrix, mp, mpf
from scipy.integrate import solve_ivp

import oracles
import robodyn
from hard_cases.runs import (
    FOUR_BAR,
    HERE,
    ROBOTS,
    ROOT,
    TWO_LINK,
    Case,
    Finding,
    Row,
    at_least,
    at_most,
    command,
    crank_motion,
    drift,
    finished,
    four_bar,
    four_bar_energy,
    is_so,
    n_four_bar,
    refused,
    serial_arm,
    sign_changes,
    simulate,
    swing,
    two_link_energy,
    vector,
)

__all__ = ["CASES", "Row"]

CASES: list[Case] = []
Measure = Callable[..., Iterator[Finding]]

RTOLS = (1e-6, 1e-9, 1e-12)


def case(name: str, hard: str, each: Iterable[object] = ()) -> Callable[[Measure], Measure]:
    """Register a measuring function; with `each`, one case for each of its values."""

    def register(measure: Measure) -> Measure:
        if each:
            CASES.extend(Case(name.format(x), hard, partial(measure, x)) for x in each)
        else:
            CASES.append(Case(name, hard, measure))
        return measure

    return register


# -- 1: N-four-bar -------------------------------------------------------------------------------

# The motion passes 9 level positions, where the closures lose rank.  At a distance d (rad) from one
# an acceleration has a rounding error near eps / d^2, and a step that must not come nearer than
# 1e-3 rad leaves 1e-16 / 1e-6 * h/10: some 1e-12 rad/s in each passing, which the rest of the
# motion enlarges by up to 1e4.  That is the floor under errors in proportion to rtol.
FACTOR, FLOOR = 2000.0, 1e-7
ENOUGH = 10_000  # evaluations; a run needs 4100 at the most unless it stalls


def n_four_bar_run(N: int, rtol: float) -> tuple[str, float, float, float]:
    """Outcome, error against the exact motion, distance of the verticals, gap."""
    mech = n_four_bar(N)
    vertical = np.array([name[0] == "v" for name in mech.link_names])
    q, qd = np.where(vertical, math.pi / 2, -math.pi / 2), np.where(vertical, -1.0, 1.0)
    times = np.linspace(0.0, 10.0, 21)
    motion = robodyn.simulate(
        mech, q, qd, 10.0, rtol=rtol, atol=rtol, t_eval=times, max_evals=ENOUGH
    )
    if motion.outcome.label != "finished":
        outcome = f"{motion.outcome.label} at t = {motion.report.t_reached:.4g} s"
        return outcome, math.inf, math.inf, math.inf
    exact = np.array([[float(x) for x in oracles.n_four_bar_exact(N, t)] for t in times])
    theta = motion.q[:, vertical]
    error = np.abs(theta - exact[:, :1]).max()
    apart = np.abs(theta - theta[:, :1]).max()
    return "finished", float(error), float(apart), motion.report.largest_gap


@case("1 N-four-bar, N = {}", "1 freedom becomes N + 1 when level", each=(1, 2, 5, 10))
def n_four_bar_passes(N: int) -> Iterator[Finding]:
    runs = {rtol: n_four_bar_run(N, rtol) for rtol in RTOLS}
    for rtol, (outcome, error, _, _) in runs.items():
        measure = f"error of all verticals over 10 s, rtol {rtol:g}, rad"
        if outcome == "finished":
            yield at_most(measure, error, FACTOR * rtol + FLOOR)
        else:
            yield is_so(measure, "finished", outcome)
    yield at_most("verticals apart (branch), rad", max(run[2] for run in runs.values()), 1e-9)
    yield at_most("largest gap, m", max(run[3] for run in runs.values()), 1e-12)


@case("1 N-four-bar, N = {}, by luck?", "no stall at any tolerance near", each=(1, 2, 5))
def n_four_bar_without_luck(N: int) -> Iterator[Finding]:
    """Whether a step lands near the level position is chance: a few tolerances beside each."""
    for rtol in RTOLS:
        beside = [rtol * part for part in (0.54, 0.62, 0.78, 1.14, 1.25, 1.33)]
        runs = [n_four_bar_run(N, x) for x in beside]
        stalled = [f"{x:.3g}" for x, run in zip(beside, runs, strict=True) if run[0] != "finished"]
        measure = f"6 tolerances beside {rtol:g}"
        told = f"{len(beside) - len(stalled)} finished"
        if stalled:
            yield is_so(measure, "6 finished", f"{told}; stalled at {', '.join(stalled)}", False)
        else:
            worst = max(run[1] for run in runs)
            yield at_most(f"{measure}: worst error, rad", worst, FACTOR * rtol + FLOOR)


# -- 2: double pendulum --------------------------------------------------------------------------

POINT_MASSES = oracles.TwoLink(1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0)

# end time, absolute angles from the downward vertical, absolute rates (digits of the issue)
RELEASED = {
    45: (
        20.0,
        (-0.44722038984908774, -0.59055315896693302),
        (-1.6087337152480216, -1.13113062990175),
    ),
    90: (10.0, (-0.568474664015950, -0.526393727932405), (6.07838488576197, -9.68136068170888)),
}


@case("2 double pendulum from {} degrees", "long memory; chaos from 90 degrees", each=(45, 90))
def double_pendulum(degrees: int) -> Iterator[Finding]:
    mech = robodyn.load(HERE / "double-pendulum.yaml")
    t_end, angles, rates = RELEASED[degrees]
    start = np.array([math.radians(degrees) - math.pi / 2, 0.0])
    factor = 100.0 if degrees == 45 else 1000.0
    for rtol in RTOLS:
        motion = robodyn.simulate(mech, start, [0.0, 0.0], t_end, rtol=rtol, atol=rtol)
        q, qd = motion.q[-1], motion.qd[-1]
        turned = q.cumsum() + math.pi / 2 - angles
        wrong = [math.remainder(x, math.tau) for x in turned] + [*(qd.cumsum() - rates)]
        yield at_most(
            f"error at {t_end:g} s, rtol {rtol:g}, rad, rad/s", max(map(abs, wrong)), factor * rtol
        )
    times = np.linspace(0.0, 1000.0, 2001)
    motion = robodyn.simulate(mech, start, [0.0, 0.0], 1000.0, t_eval=times)
    energy = two_link_energy(POINT_MASSES, motion.q, motion.qd)
    moving = 9.81 * 3.0 * (1.0 - math.cos(math.radians(degrees)))  # all that can become kinetic
    yield is_so("1000 s at rtol 1e-9", "finished", motion.outcome.label)
    yield at_most("energy drift over 1000 s at rtol 1e-9", drift(energy, moving), 1e-5)


# -- 3: mass ratios ------------------------------------------------------------------------------


def exact_acceleration(p: oracles.TwoLink, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """qdd (2,) of the 2R arm without torques, at 30 digits, as mpf."""
    tree = oracles.two_link_tree(p)
    with mp.workdps(30):
        M, C, G = oracles.mp_terms(tree, complex(0.0, -p.g), q, qd)
        f = -(C @ np.array([mpf(x) for x in qd])) - G
        return np.array(list(mp.lu_solve(matrix(M.tolist()), matrix(f.tolist()))), dtype=object)


@case("3 mass ratio {} in a 2R arm", "a nearly singular M", each=(1e-6, 1e-3, 1e3, 1e6))
def mass_ratio(ratio: float) -> Iterator[Finding]:
    p = TWO_LINK._replace(m2=TWO_LINK.m1 * ratio, I2=TWO_LINK.I2 * ratio)
    mech = serial_arm(p)
    rng = np.random.default_rng(8)
    q, qd = rng.uniform(-3.0, 3.0, (2, 300, 2))
    generated = robodyn.forward_dynamics(mech, q, qd, np.zeros(2))
    worst = 0.0
    for k in range(30):
        exact = exact_acceleration(p, q[k], qd[k])
        one = robodyn.forward_dynamics(mech, q[k], qd[k], np.zeros(2))
        for found in (one, generated[k]):
            worst = max(worst, float(abs(found - exact).max() / abs(exact).max()))
    yield at_most("accelerations against 30 digits, relative", worst, 1e-13)
    motion = robodyn.simulate(mech, [0.5, 0.8], [0.0, 0.0], 10.0)
    energy = two_link_energy(p, motion.q, motion.qd)
    yield is_so("10 s", "finished", motion.outcome.label)
    yield at_most("energy drift", drift(energy, motion.report.energy_in_motion), 1e-7)


@case("3 coupler {} times its mass", "a nearly singular M in a loop", each=(1e-6, 1e6))
def coupler_ratio(ratio: float) -> Iterator[Finding]:
    yield from against_reduction(
        FOUR_BAR._replace(m2=FOUR_BAR.m2 * ratio, I2=FOUR_BAR.I2 * ratio), 1e-5
    )


@case("3 massless coupler", "M alone is singular")
def massless_coupler() -> Iterator[Finding]:
    scene = HERE / "massless-coupler.yaml"
    p = FOUR_BAR._replace(m2=0.0, I2=0.0)
    run = simulate(scene, "--q", "60deg", "--qd", 5, "--time", 5, "--every", 0.05)
    yield finished(run)
    times, crank = run.columns("t")[:, 0], run.columns("q1", "qd1")
    wrong = np.abs(crank - crank_motion(p, math.pi / 3, 5.0, times)).max()
    yield at_most("error against one coordinate, rad, rad/s", wrong, 1e-5)
    yield at_most("largest gap, m", run.report["largest_gap"], 1e-12)


def against_reduction(p: oracles.FourBar, bound: float) -> Iterator[Finding]:
    """A four-bar's motion from 60 degrees at 5 rad/s against its one-coordinate reduction."""
    mech = four_bar(p)
    q = robodyn.assemble(mech, [math.pi / 3])
    times = np.linspace(0.0, 5.0, 101)
    motion = robodyn.simulate(mech, q, robodyn.loop_velocities(mech, q, [5.0]), 5.0, t_eval=times)
    yield is_so("5 s", "finished", motion.outcome.label)
    if motion.outcome.label == "finished":
        crank = np.stack([motion.q[:, 0], motion.qd[:, 0]], axis=-1)
        wrong = np.abs(crank - crank_motion(p, math.pi / 3, 5.0, times)).max()
        yield at_most("error against one coordinate, rad, rad/s", wrong, bound)


@case("3 massless last link", "its acceleration is undefined")
def massless_last_link() -> Iterator[Finding]:
    scene = HERE / "massless-last-link.yaml"
    for name in ("simulate", "accel"):
        run = command(name, scene, "--q", "30deg,45deg")
        yield refused(f"`{name}`: an error, not a NaN", run, 1, "forearm", "inertia")
    yield is_so("`torque` needs no inertia", "exit 0", torque_exit(scene, "30deg,45deg"))


def torque_exit(scene: Path, q: str) -> str:
    return f"exit {command('torque', scene, '--q', q).code}"


# -- 4: toggle and dead centre -------------------------------------------------------------------


def dead_centre(stretched: bool) -> np.ndarray:
    """q (3,) of the four-bar with crank and coupler in line, open branch."""
    p = FOUR_BAR
    reach = p.l2 + p.l1 if stretched else p.l2 - p.l1
    towards = math.acos((reach**2 + p.d**2 - p.l3**2) / (2 * reach * p.d))
    rocker = math.atan2(reach * math.sin(towards), reach * math.cos(towards) - p.d)
    if stretched:
        return np.array([towards, 0.0, rocker])
    return np.array([towards - math.pi, math.pi, rocker])


@case(
    "4 four-bar from its {} dead centre",
    "the rocker cannot move the crank",
    ("stretched", "folded"),
)
def toggle(kind: str) -> Iterator[Finding]:
    scene, q = HERE / "rocker-driven.yaml", dead_centre(kind == "stretched")
    times = ("--time", 5, "--every", 0.05)
    for torque in (0.0, 2.0):
        run = simulate(scene, f"--q={vector(q)}", "--tau", torque, *times)
        yield finished(run, f"starts there, rocker torque {torque:g} N m")
        t, crank = run.columns("t")[:, 0], run.columns("q1", "qd1")
        wrong = np.abs(crank - crank_motion(FOUR_BAR, q[0], 0.0, t, torque)).max()
        yield at_most("error against one coordinate, rad, rad/s", wrong, 1e-5)
        passed = sign_changes(np.sin(run.columns("q2")[1:, 0]))
        if torque == 0.0:
            yield at_least("dead centres passed", passed, 3)
    run = command("torque", scene, f"--q={vector(q)}")
    yield refused("`torque` there", run, 1, "dead centre", "is free here")
    run = command("torque", scene, f"--q={vector(q)}", "--qd", 0, "--qdd", 1)
    yield refused("`torque` there, the rocker's qdd given", run, 1, "dead centre")


@case("4 slider-crank through dead centre", "the piston stands still, the crank turns")
def slider_crank() -> Iterator[Finding]:
    scene = HERE / "inline-slider-crank.yaml"
    l1, r1, m1 = 0.12, 0.045, 0.8
    l2, r2, m2, piston = 0.32, 0.14, 0.5, 0.7
    start = ("--q", "0,0", "--qd", vector([20.0, -20.0 * (1 + l1 / l2)]))
    run = simulate(scene, *start, "--tau", 1, "--time", 2, "--points", 201)
    yield finished(run, "starts there, crank torque 1 N m")
    q, qd = run.joints("q", 2), run.joints("qd", 2)
    yield at_least("dead centres passed", math.floor(q[-1, 0] / math.pi), 20)
    a1, a2 = q[:, 0], q.sum(axis=-1)
    w1, w2 = qd[:, 0], qd.sum(axis=-1)
    vx = -l1 * np.sin(a1) * w1 - r2 * np.sin(a2) * w2
    vy = l1 * np.cos(a1) * w1 + r2 * np.cos(a2) * w2
    v = -l1 * np.sin(a1) * w1 - l2 * np.sin(a2) * w2  # of the piston
    KE = (m1 * r1**2 + 0.0009) * w1**2 + m2 * (vx**2 + vy**2) + 0.0048 * w2**2 + piston * v**2
    PE = 9.81 * (m1 * r1 * np.sin(a1) + m2 * (l1 * np.sin(a1) + r2 * np.sin(a2)))
    work = KE / 2 + PE - (KE[0] / 2 + PE[0]) - 1.0 * (a1 - a1[0])
    yield at_most("energy less work of the torque, relative", abs(work).max() / KE.max(), 1e-7)
    # at the dead centre, at a steady rate, the crank carries its weight and its share of the rod's
    by_hand = 9.81 * (m1 * r1 + m2 * (1 - r2 / l2) * l1)
    run = command("torque", scene, *start)
    wrong = abs(run.columns("tau1")[0, 0] - by_hand)
    yield at_most("`torque` of the crank there, N m", wrong, 1e-12)


@case("4 slider-crank, short rod, dead centre", "the crank cannot move the piston")
def short_rod() -> Iterator[Finding]:
    scene = HERE / "short-rod.yaml"
    crank = math.asin(2 / 3)
    at = f"--q={vector([crank, -math.pi / 2 - crank])}"
    run = simulate(scene, at, "--qd", "0,10", "--points", 1001)
    yield finished(run, "starts there, the rod swinging")
    yield at_most("energy drift", run.report["energy_drift"], 1e-6)
    rod = run.joints("q", 2).sum(axis=-1)
    yield at_least("dead centres passed", sign_changes(np.cos(rod[1:])), 20)
    closing = 10.0**2 * 0.2 / (0.3 * math.cos(crank))  # the slider's line keeps the tip's height
    for qd, qdd in (((0.0, 0.0), (0.0, 1.0)), ((0.0, 10.0), (-closing, 0.0))):
        run = command("torque", scene, at, f"--qd={vector(qd)}", f"--qdd={vector(qdd)}")
        yield refused(f"`torque` there, qd {qd[1]:g}, qdd {qdd[1]:g}", run, 1, "dead centre")


@case("4 parallelogram from its change point", "two branches meet, the rates choose one")
def change_point() -> Iterator[Finding]:
    scene, level = ROBOTS / "parallelogram.yaml", ("--q", "0,0,0")
    start = (*level, "--qd", "3,-3,3")
    inertia = 0.45 * 0.14**2 + 0.0041 + 0.55 * 0.16**2 + 0.0052 + 1.1 * 0.3**2
    kappa = 9.81 * (0.45 * 0.14 + 0.55 * 0.16 + 1.1 * 0.3) / inertia
    few = ("--max-evals", ENOUGH, "--time", 5, "--every", 0.1)
    for rtol in RTOLS:
        run = simulate(scene, *start, "--rtol", rtol, "--atol", rtol, *few)
        yield finished(run, f"starts there, rtol {rtol:g}")
        if run.code:
            continue
        q = run.joints("q", 3)
        exact = swing(kappa, 0.0, 3.0, run.columns("t")[:, 0])
        apart = np.abs(q - q[:, :1] * [1, -1, 1]).max()
        yield at_most("off the parallelogram, rad", apart, 1e-6)
        wrong = np.abs(q[:, 0] - exact[:, 0]).max()
        yield at_most("error against one coordinate, rad", wrong, FACTOR * rtol + FLOOR)
    run = simulate(scene, *start, "--time", 0)
    if run.code:
        yield refused("accelerations there, or a refusal", run, 1, "change point")
    else:
        wrong = np.abs(run.joints("qdd", 3) + np.array([1, -1, 1]) * kappa).max()
        yield at_most("accelerations there, or a refusal, rad/s^2", wrong, 1e-6)
    run = command("torque", scene, *start)
    yield refused("`torque` there", run, 1, "change point")


# -- 5: redundant closures -----------------------------------------------------------------------


@case("5 third parallel crank", "the closures depend on one another")
def redundant() -> Iterator[Finding]:
    scene = HERE / "three-cranks.yaml"
    run = simulate(scene, "--q", "60deg,-60deg,60deg,60deg", "--qd", "2,-2,2,2", "--points", 201)
    yield finished(run)
    yield is_so("note on stderr of `simulate`", "not unique", said(run.err, "not unique"))
    moment = 0.45 * 0.14 + 0.55 * 0.16 + 0.35 * 0.13 + 1.1 * 0.3
    inertia = 0.45 * 0.14**2 + 0.0041 + 0.55 * 0.16**2 + 0.0052 + 0.35 * 0.13**2 + 0.0033
    kappa = 9.81 * moment / (inertia + 1.1 * 0.3**2)
    exact = swing(kappa, math.pi / 3, 2.0, run.columns("t")[:, 0])
    q = run.joints("q", 4)
    yield at_most("cranks apart, rad", np.abs(q - q[:, :1] * [1, -1, 1, 1]).max(), 1e-9)
    yield at_most("error against one coordinate, rad", np.abs(q[:, 0] - exact[:, 0]).max(), 1e-5)
    run = command("torque", scene, "--q", "60deg", "--qd", 2)
    yield is_so("note on stderr of `torque`", "not unique", said(run.err, "not unique"))
    wrong = abs(run.columns("tau1")[0, 0] - 9.81 * moment / 2)
    yield at_most("`torque` against one coordinate, N m", wrong, 1e-12)


def said(text: str, part: str) -> str:
    return part if part in text else "nothing"


# -- 6: inconsistent start -----------------------------------------------------------------------


@case("6 inconsistent start", "the loop is open, or its rates tear it")
def inconsistent() -> Iterator[Finding]:
    scene, open_, rates = ROBOTS / "four-bar.yaml", (math.pi / 3, -0.7, 1.68), (5.0, 1.0, 1.0)
    terms = oracles.four_bar_terms(FOUR_BAR, open_, rates)
    run = simulate(scene, "--q", vector(open_))
    gap = f"{np.linalg.norm(terms.gap):.6g} m"
    yield refused("open in position", run, 2, f"gap in position = {gap}")
    yield is_so("writes no row", "", run.out)

    closed = oracles.four_bar_position(FOUR_BAR, math.pi / 3)
    terms = oracles.four_bar_terms(FOUR_BAR, closed, rates)
    run = simulate(scene, "--q", vector(closed), "--qd", vector(rates))
    gap = f"{np.linalg.norm(terms.Psi @ rates):.6g} m/s"
    yield refused("open in velocity", run, 2, f"gap in velocity = {gap}")

    start = ("--q", vector(open_), "--qd", vector(rates), "--assemble", "--time", 2)
    run = simulate(scene, *start)
    yield finished(run, "with --assemble")
    q, qd = run.joints("q", 3)[0], run.joints("qd", 3)[0]
    terms = oracles.four_bar_terms(FOUR_BAR, q, qd)
    yield at_most("gap of the first row, m", np.linalg.norm(terms.gap), 1e-14)
    yield at_most("its rate, m/s", np.linalg.norm(terms.Psi @ qd), 1e-14)
    moved = np.abs(q - open_).max()
    turned = np.linalg.lstsq(terms.Psi, terms.Psi @ rates, rcond=None)[0]
    yield at_most("its rates are the nearest that close", np.abs(rates - turned - qd).max(), 1e-13)
    told = f"by up to {moved:.3g} rad and {np.abs(turned).max():.3g} rad/s"
    yield is_so("says by how much", told, said(run.err, told))


# -- 7: stiff ------------------------------------------------------------------------------------


@case("7 stiff joint damper", "1e6 times too strong: decays in 1e-6 s")
def stiff() -> Iterator[Finding]:
    scene, start = HERE / "stiff-damper.yaml", ("--q", "30deg,45deg", "--points", 2)
    for name in ("DOP853", "RK45"):
        run = simulate(scene, *start, "--method", name)
        yield is_so(f"outcome of {name}", "stiff", run.report.get("outcome", run.last_line))
        if name == "DOP853":
            yield refused("says so, and what to take", run, 1, "stiff", "--method Radau")
    exact = damped_arm(1e5, np.array([math.radians(30), math.radians(45), 0.0, 0.0]), 10.0)
    for name in ("Radau", "BDF", "LSODA"):
        run = simulate(scene, *start, "--method", name)
        if run.code:
            yield finished(run, f"--method {name}")
            continue
        state = np.concatenate([run.joints("q", 2)[-1], run.joints("qd", 2)[-1]])
        measure = f"--method {name}: error at 10 s, rad, rad/s"
        yield at_most(measure, np.abs(state - exact).max(), 1e-4)


def damped_arm(damping: float, y0: np.ndarray, t_end: float) -> np.ndarray:
    """State (4,) of the 2R arm with a damper in its elbow, from the lecture's equations."""

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        tau = np.array([0.0, -damping * y[3]])
        qdd = oracles.two_link_acceleration(TWO_LINK, y[:2], y[2:], tau)
        return np.concatenate([y[2:], qdd])

    options = {"method": "Radau", "rtol": 1e-9, "atol": 1e-12}
    return solve_ivp(rates, (0.0, t_end), y0, **options).y[:, -1]


# -- 8: long -------------------------------------------------------------------------------------

# A process's peak of resident memory, kB on Linux; VmHWM begins anew with the program, where
# ru_maxrss keeps what its parent had.
MEASURED_RUN = """
import sys
from robodyn import cli
code = cli.run(sys.argv[1:])
try:
    with open("/proc/self/status") as status:
        peak = next(line.split()[1] for line in status if line.startswith("VmHWM"))
except OSError:
    import resource
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
print(code, peak)
"""


@case("8 four-bar for 1000 s", "drift; memory")
def long_run() -> Iterator[Finding]:
    peaks = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "motion.csv"
        for seconds in (100, 1000):
            words = ["simulate", "robots/four-bar.yaml", "--q", "60deg", "--qd", "5"]
            words += ["--time", str(seconds), "--every", "0.05", "--quiet", "--out", str(out)]
            done = subprocess.run(
                [sys.executable, "-c", MEASURED_RUN, *words],
                capture_output=True,
                text=True,
                timeout=600,
                cwd=ROOT,
                check=True,
            )
            code, peak = map(int, done.stdout.split())
            yield is_so(f"{seconds} s at rtol 1e-9", "exit 0", f"exit {code}")
            peaks[seconds] = peak / 1000.0
        names = out.read_text().split("\n", 1)[0].split(",")
        table = dict(zip(names, np.loadtxt(out, delimiter=",", skiprows=1).T, strict=True))
    yield is_so("rows", "20001", str(len(table["t"])))
    yield at_most("largest gap of the rows, m", table["gap"].max(), 1e-10)
    q, qd = (np.stack([table[f"{x}{k}"] for k in (1, 2, 3)], axis=-1)[::10] for x in ("q", "qd"))
    apart = max(np.linalg.norm(oracles.four_bar_terms(FOUR_BAR, x, x).gap) for x in q)
    yield at_most("largest gap by the oracle, m", apart, 1e-10)
    energy = four_bar_energy(FOUR_BAR, q, qd)
    moving = energy[0] - min(four_bar_energy(FOUR_BAR, q, 0.0 * qd))
    yield at_most("energy drift over 1000 s at rtol 1e-9", drift(energy, moving), 1e-5)
    yield at_most("peak memory beyond that of 100 s, MB", peaks[1000] - peaks[100], 20.0)


# -- 9: spin, scale, time ------------------------------------------------------------------------


@case("9 spin at 1000 rad/s", "160 turns a second")
def spin() -> Iterator[Finding]:
    p = TWO_LINK._replace(g=0.0)
    motion = robodyn.simulate(serial_arm(p), [0.3, 0.7], [1000.0, -400.0], 1.0)
    yield is_so("2R arm, no gravity, 1 s", "finished", motion.outcome.label)
    energy = two_link_energy(p, motion.q, motion.qd)
    yield at_most("its energy drift", drift(energy, energy[0]), 1e-6)
    states = zip(motion.q, motion.qd, strict=True)
    spun = np.array([(oracles.two_link_terms(p, q, qd)[0] @ qd)[0] for q, qd in states])
    yield at_most("drift of its angular momentum", drift(spun, spun[0]), 1e-6)

    mech = four_bar(FOUR_BAR)
    q = robodyn.assemble(mech, [math.pi / 3])
    qd, times = robodyn.loop_velocities(mech, q, [1000.0]), np.linspace(0.0, 0.2, 41)
    motion = robodyn.simulate(mech, q, qd, 0.2, t_eval=times)
    yield is_so("four-bar, 0.2 s", "finished", motion.outcome.label)
    crank = crank_motion(FOUR_BAR, math.pi / 3, 1000.0, times)
    yield at_most(
        "error against one coordinate, rad", np.abs(motion.q[:, 0] - crank[:, 0]).max(), 1e-5
    )
    yield at_most("largest gap, m", motion.report.largest_gap, 1e-12)


@case("9 a mechanism of {:g} m", "absolute thresholds would show", each=(1e-6, 1e6))
def scale(s: float) -> Iterator[Finding]:
    """Lengths s, masses 3, times sqrt(s): gravity stays, and so does the motion."""
    root, m = math.sqrt(s), 3.0
    p = FOUR_BAR
    big = p._replace(
        **{name: getattr(p, name) * s for name in ("l1", "r1", "l2", "r2", "l3", "r3", "d")},
        **{name: getattr(p, name) * m for name in ("m1", "m2", "m3")},
        **{name: getattr(p, name) * m * s**2 for name in ("I1", "I2", "I3")},
    )
    arm = TWO_LINK._replace(
        **{name: getattr(TWO_LINK, name) * s for name in ("l1", "r1", "l2", "r2")},
        **{name: getattr(TWO_LINK, name) * m for name in ("m1", "m2")},
        **{name: getattr(TWO_LINK, name) * m * s**2 for name in ("I1", "I2")},
    )
    for name, pair in (
        ("2R arm", (serial_arm(TWO_LINK), serial_arm(arm))),
        ("four-bar", (four_bar(p), four_bar(big))),
    ):
        found = []
        for mech, unit in zip(pair, (1.0, root), strict=True):
            if mech.rows:
                q = robodyn.assemble(mech, [math.pi / 3])
                qd = robodyn.loop_velocities(mech, q, [5.0 / unit])
            else:
                q, qd = np.array([0.5, 0.8]), np.array([1.0, -0.5]) / unit
            times = np.linspace(0.0, 2.0, 21) * unit
            # atol is in rad and rad/s at once: next to nothing, so that rtol alone chooses steps
            motion = robodyn.simulate(mech, q, qd, times[-1], atol=1e-200, t_eval=times)
            yield is_so(f"{name}, {times[-1]:g} s", "finished", motion.outcome.label)
            found.append(np.concatenate([motion.q, motion.qd * unit], axis=-1))
        yield at_most(f"{name}: motion in scaled units", np.abs(found[1] - found[0]).max(), 1e-10)
        motion = robodyn.simulate(pair[1], q, qd, times[-1], t_eval=times)
        state = np.concatenate([motion.q, motion.qd * root], axis=-1)
        yield at_most(f"{name}: at default tolerances", np.abs(state - found[0]).max(), 1e-5)


@case("9 time zero, one point, backwards", "ends of the range")
def times() -> Iterator[Finding]:
    scene, start = ROBOTS / "four-bar.yaml", ("--q", "60deg", "--qd", 5)
    whole = simulate(scene, *start, "--time", 3)
    run = simulate(scene, *start, "--time", 0)
    yield finished(run, "--time 0")
    row = run.out.splitlines()[1:]
    yield is_so("its one row", "the first of the run", told_same(row, whole.out.splitlines()[1:2]))
    run = simulate(scene, *start, "--time", 3, "--points", 1)
    yield finished(run, "--points 1")
    row = run.out.splitlines()[1:]
    yield is_so("its one row", "the last of the run", told_same(row, whole.out.splitlines()[-1:]))

    back = simulate(scene, *start, "--time=-3")
    yield finished(back, "--time -3")
    mirror = simulate(scene, "--q", "60deg", "--qd", -5, "--time", 3)
    q = np.abs(back.joints("q", 3) - mirror.joints("q", 3)).max()
    qd = np.abs(back.joints("qd", 3) + mirror.joints("qd", 3)).max()
    t = np.abs(back.columns("t") + mirror.columns("t")).max()
    yield at_most("backwards less forward with -qd", max(q, qd, t), 1e-12)
    q, qd = whole.joints("q", 3), whole.joints("qd", 3)
    end = (f"--q={vector(q[-1])}", f"--qd={vector(qd[-1])}")
    home = simulate(scene, *end, "--time=-3")
    wrong = max(
        np.abs(home.joints("q", 3)[-1] - q[0]).max(), np.abs(home.joints("qd", 3)[-1] - qd[0]).max()
    )
    yield at_most("there and back, rad, rad/s", wrong, 1e-6)


def told_same(found: list[str], wanted: list[str]) -> str:
    return "the first of the run" if found == wanted else f"{found} for {wanted}"
