"""One motion of a sweep by a single simulation, for what lanes do not serve.

Motions that pass change points, closures that depend on one another, forces whose series end on the
way, and controllers go so: by DOP853 where the scene has forces of its own or a controller (what is
stiff by Radau there), else by the Taylor series.  Between the quarter points of its steps q is the
polynomial of degree 5 that has q, qd and qdd of both: extremes and crossings are those of these.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from robodyn.control.laws import controller
from robodyn.dynamics import closed_form
from robodyn.errors import RobodynError, SingularError
from robodyn.mechanics.actuation import Actuation
from robodyn.simulation.report import Outcome, Report
from robodyn.simulation.settings import SCIPY_RTOL
from robodyn.simulation.simulation import Motion, simulate
from robodyn.sweeps.lanes import Aims, Ends, Motions
from robodyn.sweeps.row_results import of_motion
from robodyn.sweeps.step_extremes import QUARTERS, crossings, derivative, extremes
from robodyn.sweeps.sweep_plan import Plan
from robodyn.tables.arrays import Array
from robodyn.trajectories.splines import hermite

CANNOT_START = "cannot start"


def single(
    plan: Plan, given: Motions, k: int, aims: Aims, ends: Ends, lane: int, told: Array
) -> tuple[str, str]:
    """Motion k of those given, into lane `lane` of `ends`; its outcome, and the miss it passed.

    `told` has, for each event of the plan, how often it happened, and when first; then the results
    of columns.
    """
    mechanism, y, n = given.mechanism, given.y[k], given.mechanism.n
    plain = not (mechanism.has_state_forces or plan.control)
    methods = ["taylor"] if plain else ["DOP853", *(["Radau"] if plan.control else [])]
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
                engine="python" if plain else "auto",
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
            parts = np.arange(QUARTERS) / QUARTERS
            finer = np.append((t[:-1, None] + np.diff(t)[:, None] * parts).ravel(), t[-1])
            between = run(finer[np.append(True, np.diff(finer) != 0.0)])
            if len(between.t) and between.t[-1] == t[-1]:  # else it did not get as far
                motion = between
    except SingularError:
        return Outcome.SINGULAR.label, ""
    except RobodynError:
        return CANNOT_START, ""
    if len(motion.t):
        _fill(ends, lane, motion, report, inner, aims.link, given.angle[k])
    return motion.outcome.label, report.missed


def _fill(
    ends: Ends, lane: int, motion: Motion, report: Report, inner: bool, link: int, angle: float
) -> None:
    """What the run of this report left; `inner`: of a motion at the quarters of its steps."""
    mechanism, t = motion.mechanism, motion.t
    states = np.concatenate([motion.q, motion.qd], axis=1)
    energy = np.sum(closed_form.energies(mechanism, motion.q, motion.qd), axis=0)
    energy -= mechanism.energy_offset
    ends.t[lane], ends.y[lane], ends.steps[lane] = t[-1], states[-1], report.steps
    ends.energy[lane] = energy.min(), energy.max()
    ends.drift[lane], ends.flip[lane] = report.energy_drift, math.nan
    if inner:
        h, begin = np.diff(motion.t), motion.q[:-1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # remarks belong to single motions
            pieces = hermite(motion.t, motion.q, motion.qd, motion.qdd)
        rates = derivative(pieces.swapaxes(0, 1)).swapaxes(1, 2)
        low, high, rate_low, rate_high = (x.T for x in extremes(rates, h))
        beyond = [[begin + low, rate_low], [begin + high, rate_high]]
        states = np.concatenate([states, *(np.hstack(pair) for pair in beyond)])
    ends.low[lane], ends.high[lane] = states.min(axis=0), states.max(axis=0)
    if inner and link >= 0:
        path = mechanism.arrays.J[link]
        angles = angle + (begin - begin[0]) @ path
        x = crossings(angles, np.einsum("kjb,j->kb", rates, path), h, math.pi)
        flips = motion.t[:-1] + x
        ends.flip[lane] = min(flips[~np.isnan(x)], key=abs, default=math.nan)


def _torques(plan: Plan, given: Motions, k: int) -> Actuation | list[float]:
    """What drives motion k: constant torques, or a controller of its own."""
    if not plan.control:
        constants: list[float] = given.tau[k].tolist()
        return constants
    return controller(given.mechanism, **dict(plan.control))
