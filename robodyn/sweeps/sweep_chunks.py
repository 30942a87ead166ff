"""A sweep: the same simulation or torque at every point of a variation, chunk by chunk.

A chunk has as many points wherever it is computed: its rows depend on the plan and its number
alone, so that any number of workers on any machine of the same kind writes the same digits.  A
point without a result is a row with its outcome, not an error.

What lanes do not serve goes by a single simulation (`single`).  Motions that pass change points,
closures that depend on one another, forces whose series end on the way, and controllers go by
DOP853; what is stiff with a controller by Radau.  Between the quarter points of its steps q is the
polynomial of degree 5 that has q, qd and qdd of both: extremes and crossings are those of these.
"""

from __future__ import annotations

import cmath
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn import __version__
from robodyn.control.laws import controller
from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics import closed_form
from robodyn.dynamics.columns import TORQUE, column_names
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.joint_vectors import driver_of, each_regular, full
from robodyn.dynamics.state import State
from robodyn.engines import machine
from robodyn.errors import DescriptionError, InputError, RobodynError, SingularError
from robodyn.loops.change_points import MISSES, suspect_quality
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.rest.balance import rests
from robodyn.runs.machine_motion import Status
from robodyn.runs.report import Outcome, Report
from robodyn.runs.settings import SCIPY_RTOL
from robodyn.runs.simulation import Motion, simulate
from robodyn.runs.watch import Event
from robodyn.scene.scene_values import read_numbers
from robodyn.sweeps.lane_observer import QUARTERS, crossings, derivative, extremes
from robodyn.sweeps.lanes import Aims, Ends, Motions, integrate
from robodyn.sweeps.row_results import of_motion, of_rows, of_states
from robodyn.sweeps.sweep_plan import Axis, Plan
from robodyn.tables.arrays import Array
from robodyn.trajectories.joint_paths import hermite

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
    events, control = dict(plan.events), dict(plan.control)
    reference = control.get("reference")
    even = np.linspace(0.0, plan.t_end, plan.rows) if plan.told else None

    def run(times: Array | None, events: dict[str, str] | None = None) -> Motion:
        for method in methods:
            motion = simulate(
                mechanism,
                y[:n],
                y[n:],
                plan.t_end,
                tau=controller(mechanism, **control) if control else given.tau[k].tolist(),
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
        _leave(ends, lane, motion, report, inner, aims.link, given.angle[k])
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


def _leave(
    ends: Ends, lane: int, motion: Motion, report: Report, inner: bool, link: int, angle: float
) -> None:
    """Store the results of a run in `ends`; `inner`: of a motion at the quarters of its steps."""
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


Indices = NDArray[np.intp]

CANNOT_ASSEMBLE = "cannot assemble"
NO_SCENE = "not a scene"  # with what was drawn
FINISHED = Outcome.FINISHED.label


_OUTCOMES = {
    int(Status.REACHED): Outcome.FINISHED.label,
    int(Status.FULL): Outcome.TOO_MANY_EVALUATIONS.label,
    int(Status.SINGULAR): Outcome.SINGULAR.label,
    int(Status.STUCK): Outcome.STEP_TOO_SMALL.label,
    int(Status.NOT_FINITE): Outcome.STEP_TOO_SMALL.label,
}


class Rows(NamedTuple):
    """The rows of a chunk: numbers (k, columns - 1), nan where there is none, and outcomes (k,).

    And what is said of a change point that one of them just misses.
    """

    values: Array
    outcomes: list[str]
    remark: str = ""


class Group(NamedTuple):
    """Points of a chunk that share a mechanism, and their start: each (k, n)."""

    mechanism: Mechanism
    points: Indices
    q: Array
    qd: Array
    acting: Array  # tau of motions, qdd of torques


def run_chunk(plan: Plan, number: int) -> Rows:
    """The rows of chunk `number`, from 0."""
    if plan.version != __version__:
        limit = f"the sweep is of version {plan.version}: a worker must have the same"
        raise RobodynError("robodyn", value=__version__, limit=limit)
    begin = number * plan.chunk
    points = plan.variation.points(begin, min(begin + plan.chunk, plan.variation.size))
    outcomes = [CANNOT_ASSEMBLE] * len(points)
    values = np.full((len(points), len(plan.columns()) - 1), math.nan)
    values[:, : points.shape[1]] = points
    with np.errstate(all="ignore"):
        with _misses() as said:
            groups = list(_groups(plan, points, outcomes))
        if plan.kind == "torque":
            said += [_torques(plan, group, points, values, outcomes) for group in groups]
        else:
            said += _motions(plan, groups, values, outcomes)
    return Rows(values, outcomes, next(filter(None, said), ""))


def _groups(plan: Plan, points: Array, outcomes: list[str]) -> Iterator[Group]:
    """The points, a group for each mechanism, less those that cannot be assembled."""
    axes = plan.variation.axes
    changed = list(plan.scene_axes)
    scene, last = None, "qdd" if plan.kind == "torque" else "tau"
    if changed:
        scene = read_numbers(plan.scene, plan.source, plan.numbers, plan.tables)
    members: dict[tuple[float, ...], list[int]] = {}
    if not changed:
        members[()] = list(range(len(points)))
    else:
        for k, key in enumerate(map(tuple, points[:, changed].tolist())):
            members.setdefault(key, []).append(k)
    for key, indices in members.items():
        mechanism = plan.mechanism
        if scene is not None:
            names = [axes[k].name for k in changed]
            try:
                mechanism = build(scene.replaced(dict(zip(names, key, strict=True))))
            except DescriptionError as error:
                if any(axis.deviation for axis in axes):  # one may be drawn that is out of limits
                    for k in indices:
                        outcomes[k] = NO_SCENE
                    continue
                raise InputError("the scene with these values", limit=str(error)) from None
        chosen = np.array(indices)
        q, qd, acting = (
            _given(driver_of(mechanism, name), name, getattr(plan, name), axes, points[chosen])
            for name in ("q", "qd", last)
        )
        missing, given = np.zeros(len(chosen)), {"q": q, "qd": qd, last: acting}
        few = {name: (values, False) for name, values in given.items()}
        motion = full(mechanism, few, t=0.0, missing=missing)
        for k in chosen[np.isnan(missing)]:
            outcomes[k] = Outcome.SINGULAR.label
        closes = missing == 0.0
        if closes.any():
            yield Group(mechanism, chosen[closes], *(x[closes] for x in motion.values()))


def _given(
    mechanism: Mechanism, name: str, base: Sequence[float], axes: Sequence[Axis], points: Array
) -> Array:
    """A quantity of the actuated joints at points, (k, actuated)."""
    actuated = mechanism.actuated
    if name == "q":
        base = base or mechanism.description.begin(actuated)
    values = np.tile(np.array(base or [0.0] * len(actuated)), (len(points), 1))
    names = [f"{name}{k + 1}" for k in actuated]
    for k, axis in enumerate(axes):
        if axis.name in names:
            values[:, names.index(axis.name)] = points[:, k]
    return values


def _torques(plan: Plan, group: Group, points: Array, values: Array, outcomes: list[str]) -> str:
    """The columns of a group, or of each of its points where one has none; the remark."""
    mechanism, first = group.mechanism, points.shape[1]
    texts = plan.told or column_names(mechanism, TORQUE)

    def compute(chosen: slice) -> Array:
        q, qd, qdd = (x[chosen] for x in (group.q, group.qd, group.acting))
        return of_states(texts, State(mechanism, q, qd, qdd, of=plan.of))

    if plan.track is not None:  # which all points of a mechanism share
        with _misses() as said:
            found, outcome = _along(plan, mechanism, plan.track)
        values[group.points, first:] = found
        for k in group.points:
            outcomes[k] = outcome
        return next(iter(said), "")
    with _misses() as said:
        found, kept = each_regular(compute, (len(group.points), len(texts)))
    values[group.points[kept], first:] = found[kept]
    for k, regular in zip(group.points, kept, strict=True):
        outcomes[k] = FINISHED if regular else Outcome.SINGULAR.label
    return next(iter(said), "")


@contextmanager
def _misses() -> Iterator[list[str]]:
    """Collect remarks on change points that are just missed; drop those on single states."""
    said: list[str] = []
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always", RobodynWarning)
        yield said
    for x in remarks:
        if not issubclass(x.category, RobodynWarning):
            warnings.warn_explicit(x.message, x.category, x.filename, x.lineno)
    parts = "; ".join(str(x.message) for x in remarks).split("; ")
    said += [part for part in parts if part.startswith(MISSES)]


def _along(plan: Plan, mechanism: Mechanism, track: ReferenceTable) -> tuple[Array, str]:
    """The results of torques along a reference, nan where there are none, and the outcome."""
    nothing, t = np.full(len(plan.told), math.nan), np.array(track.times)
    pairs = zip(("q", "qd", "qdd"), (*track.at(t), track.accelerations(t)), strict=True)
    missing = np.zeros(len(t))
    motion = full(mechanism, {x: (values, False) for x, values in pairs}, t=t, missing=missing)
    if np.isnan(missing).any():
        return nothing, Outcome.SINGULAR.label
    if missing.any():
        return nothing, CANNOT_ASSEMBLE
    try:
        q, qd, qdd = motion.values()
        columns = of_states(plan.told, State(mechanism, q, qd, qdd, t=t, of=plan.of))
    except SingularError:
        return nothing, Outcome.SINGULAR.label
    return of_rows(plan.told, t, columns), FINISHED


def _motions(plan: Plan, groups: list[Group], values: Array, outcomes: list[str]) -> list[str]:
    """The motions of all groups: together where lanes serve them, one by one elsewhere.

    Returns the remarks; near a change point motions go one by one.
    """
    base = plan.mechanism
    n, P = base.n, len(outcomes)
    # the plan alone decides what is computed, so that digits do not depend on the chunk
    named = {axis.name for axis in plan.variation.axes}
    given = dict(zip(base.actuated, plan.tau, strict=False))
    driven = [f"tau{j + 1}" in named or bool(given.get(j)) for j in range(n)]
    aims = Aims(
        rtol=plan.rtol,
        atol=plan.atol,
        most=plan.most,
        suspect=suspect_quality(base) if base.rows else 0.0,
        extremes="extremes" in plan.results,
        link=_turning(base, plan.link % n) if "flip" in plan.results else -1,
        work=any(driven) or base.changes_energy or bool(plan.scene_axes),
    )
    ends, offset = Ends.room(P, n), np.zeros(P)
    members, said = [], []
    for group in groups:
        offset[group.points] = group.mechanism.energy_offset
        angle = _from_hanging(group.mechanism, group.q, aims.link)
        y = np.hstack([group.q, group.qd])
        members.append(Motions(group.mechanism, y, group.acting, angle))
    told = np.full((P, 2 * len(plan.events) + len(plan.told)), math.nan)
    together: list[Ends | None] = [None] * len(members)
    if plan.method == "taylor":
        if not machine.available():
            limit = "the sweep goes by machine code: a worker must have the extra `fast`, too"
            raise RobodynError("llvmlite", limit=limit)
        together = integrate(members, plan.t_end, aims, driven)
    for group, member, found in zip(groups, members, together, strict=True):
        alone = list(_OUTCOMES)
        if found is not None:
            for name in Ends.__slots__:
                getattr(ends, name)[group.points] = getattr(found, name)
            for k, status in zip(group.points.tolist(), found.status.tolist(), strict=True):
                outcomes[k] = _OUTCOMES[status]
            alone = [Status.SINGULAR, Status.STUCK] if base.rows else []
            if group.mechanism.has_state_forces:  # a series may not get beyond where they bend
                alone.append(Status.STUCK)
        for i in np.flatnonzero(np.isin(ends.status[group.points], alone)).tolist():
            k = int(group.points[i])
            outcomes[k], remark = single(plan, member, i, aims, ends, k, told[k])
            said.append(remark)
    if "flip" in plan.results and not plan.control:
        for group in groups:
            flipped = ~np.isnan(ends.flip[group.points])
            if not flipped.any():
                continue
            start = (x[flipped] for x in (group.q, group.qd, group.acting))
            with suppress(RobodynError):  # beyond a table nothing rests
                at_rest = rests(group.mechanism, *start)
                ends.flip[group.points[flipped][at_rest]] = math.nan  # only rounding moves it
    _fill(plan, ends, offset, told, values)
    return said


def _fill(plan: Plan, ends: Ends, offset: Array, told: Array, values: Array) -> None:
    """The results into their columns."""
    parts = []
    if "final" in plan.results:
        parts += [np.where(np.isnan(ends.y[:, 0]), math.nan, ends.t)[:, None], ends.y]
    if "extremes" in plan.results:
        both = np.stack([ends.low, ends.high], axis=-1)
        parts += [both.reshape(len(both), -1), ends.energy + offset[:, None]]
    if "drift" in plan.results:
        parts.append(ends.drift[:, None])
    if "flip" in plan.results:
        parts.append(ends.flip[:, None])
    parts.append(told)
    values[:, len(plan.variation.axes) :] = np.concatenate(parts, axis=1)


def _turning(mechanism: Mechanism, link: int) -> int:
    """The link whose direction a link has; -1 where it is the ground's."""
    frame = mechanism.frames[link]
    return -1 if frame is None else frame


def _from_hanging(mechanism: Mechanism, q: Array, link: int) -> Array:
    """The angle of a link at q (k, n) from where it hangs along gravity, in [-pi, pi).

    Without gravity it counts from the start; of no link (-1) it is 0.
    """
    if link < 0 or mechanism.gamma == 0:
        return np.zeros(len(q))
    hanging = math.atan2(mechanism.gamma.imag, mechanism.gamma.real)
    alpha: Array = q @ mechanism.arrays.J[link]
    alpha = alpha + cmath.phase(Tree(mechanism.description.links).phases[link])
    return np.asarray(np.remainder(alpha - hanging + math.pi, 2.0 * math.pi) - math.pi)
