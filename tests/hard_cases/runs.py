"""What the hard cases share: rows of the table, runs of the program, independent motions."""

from __future__ import annotations

import csv
import io
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import oracles
from robodyn.description import from_text
from robodyn.errors import RobodynError
from robodyn.mechanism import Mechanism, build

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
ROBOTS = ROOT / "robots"

TWO_LINK = oracles.TwoLink(1.5, 0.8, 0.36, 0.082, 0.9, 0.6, 0.25, 0.031)  # robots/2r.yaml
FOUR_BAR = oracles.FourBar(  # robots/four-bar.yaml
    *(0.6, 0.35, 0.15, 0.008), *(1.3, 0.95, 0.45, 0.102), *(1.0, 0.80, 0.36, 0.061), 1.1
)


# -- rows ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Finding:
    """One measured thing of a case, its bound, and whether it keeps it."""

    measure: str
    bound: str
    measured: str
    passed: bool


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    case: str
    hard: str
    measure: str
    bound: str
    measured: str
    passed: bool


@dataclass(frozen=True, slots=True)
class Case:
    """A hard case: its name, what is hard about it, and the function that measures."""

    name: str
    hard: str
    measure: Callable[[], Iterable[Finding]]

    def rows(self) -> list[Row]:
        """The case's rows; an error of robodyn's that nobody expected is a row that fails."""
        rows = []
        try:
            for x in self.measure():
                rows.append(Row(self.name, self.hard, x.measure, x.bound, x.measured, x.passed))
        except RobodynError as error:
            rows.append(Row(self.name, self.hard, "ran to here", "no error", str(error), False))
        return rows


def at_most(measure: str, value: float, bound: float) -> Finding:
    return Finding(measure, f"<= {bound:.3g}", f"{value:.2g}", bool(value <= bound))


def at_least(measure: str, value: float, bound: float) -> Finding:
    return Finding(measure, f">= {bound:g}", f"{value:g}", bool(value >= bound))


def is_so(measure: str, wanted: str, found: str, passed: bool | None = None) -> Finding:
    return Finding(measure, wanted, found, wanted == found if passed is None else passed)


# -- the program, by its command line ------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Run:
    """What one call of the command line left."""

    code: int
    out: str
    err: str
    report: dict = field(default_factory=dict)

    @property
    def last_line(self) -> str:
        return (self.err.strip().splitlines() or [""])[-1]

    def columns(self, *names: str) -> np.ndarray:
        """Columns of the CSV on stdout, (rows, names)."""
        if self.code:
            raise RobodynError(self.last_line)
        rows = list(csv.DictReader(io.StringIO(self.out)))
        values = [[float(row[name]) for name in names] for row in rows]
        return np.array(values).reshape(len(values), len(names))

    def joints(self, name: str, n: int) -> np.ndarray:
        return self.columns(*(f"{name}{k + 1}" for k in range(n)))


def command(*arguments: object) -> Run:
    """Run the command line as a process of its own, from the project's root."""
    words = [sys.executable, "-m", "robodyn", *map(str, arguments)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, cwd=ROOT)
    return Run(done.returncode, done.stdout, done.stderr)


def simulate(scene: Path, *arguments: object) -> Run:
    """`robodyn simulate`, with its report."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        run = command("simulate", scene, *arguments, "--report", report)
        facts = json.loads(report.read_text()) if report.exists() else {}
    return Run(run.code, run.out, run.err, facts)


def vector(values: Iterable[float]) -> str:
    return ",".join(repr(float(x)) for x in values)


def refused(measure: str, run: Run, code: int, *parts: str) -> Finding:
    """The run ended with this exit code and an error that says all of these parts, and no NaN."""
    wanted = f"exit {code}, says {' and '.join(repr(part) for part in parts)}"
    said = run.code == code and all(part in run.err for part in parts)
    clean = "nan" not in run.out.lower() and "Traceback" not in run.err
    found = f"exit {run.code}, says so" if said else f"exit {run.code}: {run.last_line or run.out}"
    return is_so(measure, wanted, found[:160], said and clean)


def finished(run: Run, measure: str = "outcome") -> Finding:
    """The simulation reached its end."""
    if run.code == 0:
        return is_so(measure, "finished", run.report["outcome"])
    return is_so(measure, "finished", run.last_line[:160])


# -- scenes --------------------------------------------------------------------------------------


def mechanism(text: str, name: str = "hard case") -> Mechanism:
    return build(from_text(text, name))


def n_four_bar(N: int) -> Mechanism:
    """The N-four-bar of `n-four-bar-2.yaml`, with N squares."""
    uniform = f"m: 1, l: 1, r: 0.5, I: {1 / 12!r}"
    links = []
    for k in range(N + 1):
        links.append(f"  - {{name: v{k}, {uniform}, from: [{k}, 0]}}\n")
        if k < N:
            links.append(f"  - {{name: h{k}, {uniform}, from: v{k}}}\n")
    closures = [f"  - [h{k}, v{k + 1}]\n" for k in range(N)]
    head = f"name: N-four-bar, N = {N}\ngravity: 9.81\n"
    text = head + "links:\n" + "".join(links) + "closures:\n" + "".join(closures)
    return mechanism(text + "actuated: [v0]\n", f"N = {N}")


def serial_arm(p: oracles.TwoLink) -> Mechanism:
    return mechanism(
        f"name: 2R arm\ngravity: {p.g!r}\nlinks:\n"
        f"  - {{name: upper arm, m: {p.m1!r}, l: {p.l1!r}, r: {p.r1!r}, I: {p.I1!r}}}\n"
        f"  - {{name: forearm, m: {p.m2!r}, l: {p.l2!r}, r: {p.r2!r}, I: {p.I2!r}}}\n"
    )


def four_bar(p: oracles.FourBar) -> Mechanism:
    return mechanism(
        f"name: four-bar\ngravity: {p.g!r}\nlinks:\n"
        f"  - {{name: crank, m: {p.m1!r}, l: {p.l1!r}, r: {p.r1!r}, I: {p.I1!r}}}\n"
        f"  - {{name: coupler, m: {p.m2!r}, l: {p.l2!r}, r: {p.r2!r}, I: {p.I2!r}}}\n"
        f"  - {{name: rocker, m: {p.m3!r}, l: {p.l3!r}, r: {p.r3!r}, I: {p.I3!r}, "
        f"from: [{p.d!r}, {p.e!r}]}}\n"
        "closures:\n  - [coupler, rocker]\nactuated: [crank]\n"
    )


# -- independent motions and energies ------------------------------------------------------------


def integrated(rates: Callable[..., list[float]], y0: Iterable[float], t: np.ndarray) -> np.ndarray:
    """The motion y (len(t), k) of an independent right-hand side, at rtol 1e-13."""
    times = np.asarray(t, float)
    solution = solve_ivp(rates, (0.0, times[-1]), list(y0), "DOP853", times, rtol=1e-13, atol=1e-13)
    return solution.y.T


def crank_motion(
    p: oracles.FourBar, theta: float, thetad: float, t: np.ndarray, rocker_torque: float = 0.0
) -> np.ndarray:
    """Crank angle and rate (len(t), 2) of the four-bar's one-coordinate reduction, open branch."""

    def rates(_: float, y: np.ndarray) -> list[float]:
        torque = 0.0
        if rocker_torque:
            k, _k = oracles.four_bar_coefficients(p, oracles.four_bar_position(p, y[0]))
            torque = rocker_torque * k[2]
        return [y[1], oracles.four_bar_reduced_acceleration(p, y[0], y[1], torque)]

    return integrated(rates, (theta, thetad), t)


def swing(kappa: float, theta: float, thetad: float, t: np.ndarray) -> np.ndarray:
    """Angle and rate (len(t), 2) of thetadd = -kappa cos theta."""
    return integrated(lambda _, y: [y[1], -kappa * math.cos(y[0])], (theta, thetad), t)


def two_link_energy(p: oracles.TwoLink, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """KE + PE of a 2R arm at states (T, 2), J."""
    energies = []
    for (q1, q2), rates in zip(q, qd, strict=True):
        M, _, _ = oracles.two_link_terms(p, (q1, q2), rates)
        y1, y2 = p.r1 * math.sin(q1), p.l1 * math.sin(q1) + p.r2 * math.sin(q1 + q2)
        energies.append(rates @ M @ rates / 2 + p.g * (p.m1 * y1 + p.m2 * y2))
    return np.array(energies)


def four_bar_energy(p: oracles.FourBar, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """KE + PE of a four-bar at states (T, 3), J."""
    energies = []
    for (q1, q2, q3), rates in zip(q, qd, strict=True):
        M = oracles.four_bar_terms(p, (q1, q2, q3), rates).M
        y1, y2 = p.r1 * math.sin(q1), p.l1 * math.sin(q1) + p.r2 * math.sin(q1 + q2)
        y3 = p.e + p.r3 * math.sin(q3)
        energies.append(rates @ M @ rates / 2 + p.g * (p.m1 * y1 + p.m2 * y2 + p.m3 * y3))
    return np.array(energies)


def drift(energy: np.ndarray, motion: float) -> float:
    """Largest change of an energy against the energy in motion."""
    return float(np.abs(energy - energy[0]).max() / motion)


def sign_changes(values: np.ndarray) -> int:
    signs = np.sign(values)
    signs = signs[signs != 0.0]
    return int((signs[1:] != signs[:-1]).sum())
