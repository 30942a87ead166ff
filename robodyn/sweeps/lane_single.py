"""One motion of a sweep by a single simulation, for what lanes do not serve.

Motions that pass change points, closures that depend on one another, forces whose series end on the
way, and controllers go so, by DOP853; what is stiff with a controller by Radau.  Between the
quarter points of its steps q is the polynomial of degree 5 that has q, qd and qdd of both: extremes
and crossings are those of these.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np

from robodyn.control.laws import controller
from robodyn.dynamics import closed_form
from robodyn.errors import RobodynError, SingularError
from robodyn.events.told import Event
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.report import Outcome, Report
from robodyn.simulation.settings import SCIPY_RTOL
from robodyn.simulation.simulation import Motion, simulate
from robodyn.sweeps.lanes import Aims, Ends, Motions
from robodyn.sweeps.row_results import of_motion
from robodyn.sweeps.step_extremes import QUARTERS, crossings, derivative, extremes
from robodyn.sweeps.sweep_plan import Plan
from robodyn.tables.arrays import Array
from robodyn.trajectories.splines import hermite

SHORT = 1e-8  # part of a motion: rounding hides the rates within shorter steps
CANNOT_START = "cannot start"


def single(
    plan: Plan, given: Motions, k: int, aims: Aims, ends: Ends, lane: int, told: Array
) -> tuple[str, str]:
    """Put motion k of `given` into lane `lane` of `ends`; return its outcome and a remark.

    The remark is of the miss that it passed, or of an event that cannot be followed.

    `told` has, for each event of the plan, how often it happened, and when first; then the results
    of columns.
    """
    mechanism, y, n = given.mechanism, given.y[k], given.mechanism.n
    methods = ["DOP853", *(["Radau"] if plan.control else [])]
    events, reference = dict(plan.events), dict(plan.control).get("reference")
    even = np.linspace(0.0, plan.t_end, plan.rows) if plan.told else None

    def run(times: Array | None, events: dict[str, str] | None = None) -> Motion:
        for method in methods:
            motion = simulate(
                mechanism,
                y[:n],
                y[n:],
                plan.t_end,
                tau=_torques(plan, given, k),
                method=method,
                rtol=max(aims.rtol, SCIPY_RTOL),
                atol=aims.atol,
                max_evals=aims.most,
                t_eval=times,
                events=events,
            )
            if motion.outcome is not Outcome.STIFF:
                break
        return motion

    inner = aims.extremes or aims.link >= 0
    try:
        motion = run(None if inner else even, events)
        if even is not None and motion.outcome is not Outcome.FINISHED:
            motion = run(None, events)  # which tells where it ended
        report, t = motion.report, motion.t
        counts, times = (told[i : 2 * len(events) : 2] for i in (0, 1))
        counts[:] = [report.events.get(name, 0) for name in events]
        first = {event.name: event.t for event in reversed(motion.events)}  # contacts among them
        times[:] = [first.get(name, math.nan) for name in events]
        if even is not None and motion.outcome is Outcome.FINISHED:
            rows = run(even) if inner else motion
            told[2 * len(events) :] = of_motion(rows, plan.told, plan.of, reference)
        inner &= len(t) > 1
        if inner:
            parts = np.arange(1, QUARTERS) / QUARTERS
            within = t[:-1, None] + np.diff(t)[:, None] * parts
            within = within[np.abs(np.diff(t)) > SHORT * abs(t[-1])].ravel()
            contacts = [event for event in motion.events if event.name not in events]
            motion = _joined(motion, run(within), contacts)
    except SingularError:
        return Outcome.SINGULAR.label, ""
    except RobodynError:
        return CANNOT_START, ""
    if len(motion.t):
        _fill(ends, lane, motion, report, inner, aims.link, given.angle[k])
    lost = (x for x in report.remarks if "too often" in x)
    return motion.outcome.label, report.missed or next(lost, "")


def _joined(motion: Motion, between: Motion, contacts: list[Event]) -> Motion:
    """The rows of both in their order, and one more where a phase begins.

    That has the state after an impact; the row of the motion at its time ends the phase before.
    """
    after = {event.t: event.y for event in contacts}  # the last one of an instant
    rows = sorted([*_rows(motion), *_rows(between)], key=lambda row: abs(row[0]))
    found = []
    for row, following in pairwise(rows):
        (at, y, tau, moving), next_moving = row, following[3]
        found.append(row)
        if at in after or moving is not next_moving:
            found.append((at, after.get(at, y), tau, next_moving))
    found.append(rows[-1])
    t, states, torques = (np.array([row[part] for row in found]) for part in range(3))
    q, qd = np.split(states, 2, axis=1)
    alike = ([*each] for _, each in groupby((moving for *_, moving in found), id))
    phases = [(len(same), same[0]) for same in alike]
    return replace(motion, t=t, q=q, qd=qd, tau=torques, phases=phases)


def _rows(motion: Motion) -> Iterator[tuple[float, Array, Array, Mechanism]]:
    """The times, states and torques of a motion, and what moves there."""
    moving = (what for count, what in motion.phases for _ in range(count))
    states = np.hstack([motion.q, motion.qd])
    return zip(motion.t.tolist(), states, motion.tau, moving, strict=True)


def _fill(
    ends: Ends, lane: int, motion: Motion, report: Report, inner: bool, link: int, angle: float
) -> None:
    """What the run of this report left; `inner`: of a motion at the quarters of its steps."""
    mechanism, t = motion.mechanism, motion.t
    states = np.concatenate([motion.q, motion.qd], axis=1)
    parts = motion.in_phases(motion.q, motion.qd)
    energy = np.concatenate([np.sum(closed_form.energies(*part), axis=0) for part in parts])
    energy -= mechanism.energy_offset
    ends.t[lane], ends.y[lane], ends.steps[lane] = t[-1], states[-1], report.steps
    ends.energy[lane] = energy.min(), energy.max()
    ends.drift[lane], ends.flip[lane] = report.energy_drift, math.nan
    if inner:
        lasts = np.abs(np.diff(t)) > SHORT * abs(t[-1])  # and is no jump
        h, begin, start = np.diff(t)[lasts], motion.q[:-1][lasts], t[:-1][lasts]
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # remarks belong to single motions
            pieces = hermite(t, motion.q, motion.qd, motion.qdd)[lasts]
        rates = derivative(pieces.swapaxes(0, 1)).swapaxes(1, 2)
        low, high, rate_low, rate_high = (x.T for x in extremes(rates, h))
        beyond = [[begin + low, rate_low], [begin + high, rate_high]]
        states = np.concatenate([states, *(np.hstack(pair) for pair in beyond)])
    ends.low[lane], ends.high[lane] = states.min(axis=0), states.max(axis=0)
    if inner and link >= 0:
        path = mechanism.arrays.J[link]
        angles = angle + (begin - begin[0]) @ path
        x = crossings(angles, np.einsum("kjb,j->kb", rates, path), h, math.pi)
        flips = start + x
        ends.flip[lane] = min(flips[~np.isnan(x)], key=abs, default=math.nan)


def _torques(plan: Plan, given: Motions, k: int) -> Actuation | list[float]:
    """What drives motion k: constant torques, or a controller of its own."""
    if not plan.control:
        constants: list[float] = given.tau[k].tolist()
        return constants
    return controller(given.mechanism, **dict(plan.control))
