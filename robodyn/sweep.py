"""A sweep: the same simulation or torque at every point of a variation, chunk by chunk.

A chunk is CHUNK points, whatever computes it: its rows depend on the plan and its number alone, so
that any number of workers on any machine of the same kind writes the same digits.  The motions of
a chunk advance together, in compiled loops or in numpy; the few that these do not serve are
simulated one by one.  A point without a result is a row with its outcome, not an error.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn import __version__, assembly, lanes, loop_rates
from robodyn.actuation import Actuation
from robodyn.dense_dynamics import elimination_is_safe
from robodyn.dynamics import RobodynWarning, inverse_dynamics_and_forces, loop_forces
from robodyn.errors import DescriptionError, InputError, RobodynError, SingularError
from robodyn.lane_forces import LaneForces
from robodyn.lane_single import single
from robodyn.lanes import Aims, Ends
from robodyn.mechanism import Mechanism, build
from robodyn.projection import regular_rank, suspect_quality
from robodyn.recording import Outcome
from robodyn.scene_values import SceneValues
from robodyn.taylor import Status, best_order
from robodyn.taylor_layout import Layout, numbers
from robodyn.variation import Axis, Variation

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CHUNK = 2000  # points
RESULTS = ("final", "extremes", "drift", "flip")
CANNOT_ASSEMBLE = "cannot assemble"
FINISHED = Outcome.FINISHED.label
_OUTCOMES = {
    Status.REACHED: Outcome.FINISHED,
    Status.FULL: Outcome.TOO_MANY_EVALUATIONS,
    Status.SINGULAR: Outcome.SINGULAR,
    Status.STUCK: Outcome.STEP_TOO_SMALL,
    Status.NOT_FINITE: Outcome.STEP_TOO_SMALL,
}


@dataclass(frozen=True, slots=True)
class Plan:
    """All that the rows of a sweep depend on: plain values, which go to other processes.

    `q`, `qd`, `qdd` and `tau` are those of the actuated joints, which axes named q1, tau2, ...
    replace; every other axis names a number of the scene.
    """

    scene: str  # its text
    source: str
    variation: Variation
    q: tuple[float, ...]
    qd: tuple[float, ...]
    tau: tuple[float, ...] = ()
    qdd: tuple[float, ...] = ()
    kind: str = "motion"  # or torque
    t_end: float = 10.0
    results: tuple[str, ...] = RESULTS
    link: int = -1  # whose flip is told; -1: the last
    rtol: float = 1e-9
    atol: float = 1e-9
    most: int = 100_000  # steps of a motion
    engine: str = "python"  # or compiled
    version: str = __version__
    chunk: int = CHUNK

    @property
    def chunks(self) -> int:
        return -(-self.variation.size // self.chunk)

    @property
    def scene_axes(self) -> tuple[int, ...]:
        """Which axes change the scene."""
        values = SceneValues(self.scene, self.source)
        return tuple(k for k, axis in enumerate(self.variation.axes) if axis.name in values)

    def columns(self) -> list[str]:
        """The names of the columns; the last, `outcome`, is text."""
        mechanism = _base(self.scene, self.source)
        joints = range(1, mechanism.n + 1)
        names = [axis.name for axis in self.variation.axes]
        if self.kind == "torque":
            names += [f"tau{k + 1}" for k in mechanism.actuated]
            described = mechanism.description
            names += [f"f{x}{c + 1}" for c in range(len(described.closures)) for x in "xy"]
            names += [f"tc{c + 1}" for c in range(len(described.couplings))]
            return [*names, "outcome"]
        if "final" in self.results:
            names += ["t_end", *(f"{x}{k}_end" for x in ("q", "qd") for k in joints)]
        if "extremes" in self.results:
            names += [f"{x}{k}_{end}" for x in ("q", "qd") for k in joints for end in _ENDS]
            names += [f"energy_{end}" for end in _ENDS]
        names += [name for name in ("drift", "flip") if name in self.results]
        return [*names, "outcome"]

    def facts(self) -> dict[str, object]:
        """Everything that the rows depend on, as JSON has it."""
        facts = asdict(self)
        facts["variation"] = [asdict(axis) for axis in self.variation.axes]
        facts |= {"sample": self.variation.sample, "seed": self.variation.seed}
        return facts


_ENDS = ("min", "max")


class Rows(NamedTuple):
    """The rows of a chunk: numbers (k, columns - 1), nan where there is none, and outcomes (k,)."""

    values: Array
    outcomes: list[str]


class _Group(NamedTuple):
    """Points of a chunk that share a mechanism, and their start."""

    mechanism: Mechanism
    points: Indices
    q: Array  # (k, n)
    qd: Array
    tau: Array  # (k, n)


def best_engine(wanted: str, points: int, mechanism: Mechanism) -> str:
    """The engine that `wanted` names; auto: compiled with the extra `fast` for many points.

    Raises InputError where the compiled one is wanted and not installed.
    """
    there = find_spec("numba") is not None
    if wanted == "compiled" and not there:
        limit = "needs the extra `fast` (pip install 'robodyn[fast]'): take auto or python"
        raise InputError("engine", value=wanted, limit=limit)
    if wanted != "auto":
        return wanted
    plain = not mechanism.has_forces and not mechanism.description.couplings
    return "compiled" if there and plain and points >= WORTH_LOADING else "python"


WORTH_LOADING = 1000  # points whose time is that of loading numba


def check(plan: Plan) -> Mechanism:
    """The scene's mechanism; raises InputError for what no point could have.

    Each axis is tried at both of its ends, the others at the scene's own values.
    """
    mechanism = _base(plan.scene, plan.source)
    for k in plan.scene_axes:
        axis = plan.variation.axes[k]
        for value in axis.ends:
            build(SceneValues(plan.scene, plan.source).replaced({axis.name: value}))
    assembly.assembly_plan(mechanism)
    return mechanism


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
        groups = list(_groups(plan, points, outcomes))
        if plan.kind == "torque":
            for group in groups:
                _torques(plan, group, points, values, outcomes)
        else:
            _motions(plan, groups, values, outcomes)
    return Rows(values, outcomes)


@lru_cache(maxsize=8)
def _base(scene: str, source: str) -> Mechanism:
    return build(SceneValues(scene, source).base)


def _groups(plan: Plan, points: Array, outcomes: list[str]) -> Iterator[_Group]:
    """The points, a group for each mechanism, less those that cannot be assembled."""
    axes = plan.variation.axes
    changed = list(plan.scene_axes)
    scene = SceneValues(plan.scene, plan.source)
    members: dict[tuple[float, ...], list[int]] = {}
    for k, key in enumerate(map(tuple, points[:, changed].tolist())):
        members.setdefault(key, []).append(k)
    for key, indices in members.items():
        mechanism = _base(plan.scene, plan.source)
        if changed:
            names = [axes[k].name for k in changed]
            try:
                mechanism = build(scene.replaced(dict(zip(names, key, strict=True))))
            except DescriptionError as error:  # which no process can hand to another
                raise InputError("the scene with these values", limit=str(error)) from None
        chosen = np.array(indices)
        q, qd, tau = (
            _given(mechanism, name, base, axes, points[chosen])
            for name, base in (("q", plan.q), ("qd", plan.qd), ("tau", plan.tau))
        )
        full_q, missing = assembly.attempt(mechanism, q)
        closes = np.isfinite(full_q).all(axis=1) & (missing <= 0.0)
        chosen, full_q, qd, tau = chosen[closes], full_q[closes], qd[closes], tau[closes]
        full_qd, kept = _velocities(mechanism, full_q, qd)
        for k in chosen[~kept]:
            outcomes[k] = Outcome.SINGULAR.label
        torques = np.zeros((len(chosen), mechanism.n))
        torques[:, list(mechanism.actuated)] = tau
        if not kept.any():
            continue
        yield _Group(mechanism, chosen[kept], full_q[kept], full_qd[kept], torques[kept])


def _given(
    mechanism: Mechanism, name: str, base: Sequence[float], axes: Sequence[Axis], points: Array
) -> Array:
    """A quantity of the actuated joints at points, (k, actuated)."""
    actuated = mechanism.actuated
    values = np.tile(np.array(base or [0.0] * len(actuated)), (len(points), 1))
    names = [f"{name}{k + 1}" for k in actuated]
    for k, axis in enumerate(axes):
        if axis.name in names:
            values[:, names.index(axis.name)] = points[:, k]
    return values


def _velocities(mechanism: Mechanism, q: Array, qd: Array) -> tuple[Array, NDArray[np.bool_]]:
    """All rates (k, n) from the actuated joints', and which states have them."""
    kept = np.ones(len(q), bool)
    try:
        return loop_rates.loop_velocities(mechanism, q, qd), kept
    except SingularError:
        full = np.zeros_like(q)
        for k in range(len(q)):
            try:
                full[k] = loop_rates.loop_velocities(mechanism, q[k], qd[k])
            except SingularError:
                kept[k] = False
        return full, kept


# -- torques -------------------------------------------------------------------------------------


def _torques(plan: Plan, group: _Group, points: Array, values: Array, outcomes: list[str]) -> None:
    """The torques and loop forces of a group, or of each of its points where one has none."""
    mechanism = group.mechanism
    given = _given(mechanism, "qdd", plan.qdd, plan.variation.axes, points[group.points])

    def compute(chosen: slice) -> Array:
        q, qd = group.q[chosen], group.qd[chosen]
        qdd = loop_rates.loop_accelerations(mechanism, q, qd, given[chosen])
        found = inverse_dynamics_and_forces(mechanism, q, qd, qdd)
        forces = loop_forces(mechanism, found.multipliers)
        return np.concatenate([found.tau[:, list(mechanism.actuated)], forces], axis=1)

    first = points.shape[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobodynWarning)
        try:
            values[group.points, first:] = compute(slice(None))
            for k in group.points:
                outcomes[k] = FINISHED
        except SingularError:
            for i, k in enumerate(group.points):
                outcomes[k] = Outcome.SINGULAR.label
                try:
                    values[k, first:] = compute(slice(i, i + 1))[0]
                    outcomes[k] = FINISHED
                except SingularError:
                    pass


# -- motions -------------------------------------------------------------------------------------


def _motions(plan: Plan, groups: list[_Group], values: Array, outcomes: list[str]) -> None:
    """The motions of all groups: together where lanes serve them, one by one elsewhere."""
    base = _base(plan.scene, plan.source)
    n, P = base.n, len(outcomes)
    link = -1
    if "flip" in plan.results:
        link = plan.link % n
    regular = not base.rows or regular_rank(base) == len(base.rows)
    aims = Aims(
        rtol=plan.rtol,
        atol=plan.atol,
        most=plan.most,
        suspect=suspect_quality(base) if base.rows else 0.0,
        extremes="extremes" in plan.results,
        link=link,
        work=any(g.mechanism.dissipates or g.tau.any() for g in groups),
    )
    ends = Ends.room(P, n)
    offset = np.zeros(P)
    angle = np.zeros(P)
    alone: list[tuple[_Group, int]] = []
    together: list[_Group] = []
    for group in groups:
        offset[group.points] = group.mechanism.energy_offset
        if link >= 0:
            angle[group.points] = _from_hanging(group.mechanism, group.q, link)
        if regular and _served(group.mechanism):
            together.append(group)
        else:
            alone += [(group, i) for i in range(len(group.points))]
    for chosen, found in _integrated(plan, together, angle, aims):
        for name in Ends.__slots__:
            getattr(ends, name)[chosen] = getattr(found, name)
        for lane, status in zip(chosen, found.status.tolist(), strict=True):
            outcomes[lane] = _OUTCOMES[Status(status)].label
    poor = {Status.SINGULAR, Status.STUCK} if base.rows else set()
    for group in together:
        alone += [(group, i) for i, k in enumerate(group.points) if ends.status[k] in poor]
    for group, i in alone:
        k = int(group.points[i])
        y = np.concatenate([group.q[i], group.qd[i]])
        outcomes[k] = single(
            group.mechanism, y, group.tau[i], plan.t_end, float(angle[k]), aims, ends, k
        )
    _columns(plan, ends, offset, values)


def _columns(plan: Plan, ends: Ends, offset: Array, values: Array) -> None:
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
    if parts:
        values[:, len(plan.variation.axes) :] = np.concatenate(parts, axis=1)


def _served(mechanism: Mechanism) -> bool:
    """Whether lanes serve it: no friction, which no series sees coming, no couplings; regular M."""
    smooth = not mechanism.friction and not mechanism.description.couplings
    return smooth and elimination_is_safe(mechanism)


def _from_hanging(mechanism: Mechanism, q: Array, link: int) -> Array:
    """The angle of a link at q (k, n) from where it hangs along gravity, in [-pi, pi).

    Without gravity it counts from the start.
    """
    if mechanism.gamma == 0:
        return np.zeros(len(q))
    hanging = math.atan2(mechanism.gamma.imag, mechanism.gamma.real)
    alpha: Array = q @ mechanism.arrays.J[link]
    return np.asarray(np.remainder(alpha - hanging + math.pi, 2.0 * math.pi) - math.pi)


def _integrated(
    plan: Plan, groups: list[_Group], angle: Array, aims: Aims
) -> Iterator[tuple[Indices, Ends]]:
    """Points whose mechanisms have the same structure, and what their motions leave behind."""
    compiled: Callable[..., Ends] = lanes.integrate
    if plan.engine == "compiled":
        from robodyn.lanes_compiled import integrate as compiled
    order = best_order(plan.rtol)
    alike: dict[tuple[object, ...], list[tuple[_Group, Array]]] = {}
    structures: dict[tuple[object, ...], tuple[NDArray[np.int64], Layout]] = {}
    for group in groups:
        if len(group.points):
            whole, real, at = numbers(group.mechanism, Actuation((0.0,) * group.q.shape[1]), order)
            key = (at, whole.tobytes(), *_forces_of(group.mechanism))
            alike.setdefault(key, []).append((group, real))
            structures[key] = whole, at
    for key, members in alike.items():
        whole, at = structures[key]
        chosen = np.concatenate([group.points for group, _ in members])
        tau = np.concatenate([group.tau for group, _ in members])
        y = np.concatenate([np.concatenate([g.q, g.qd], axis=1) for g, _ in members])
        shared = len(members) == 1 and (tau == tau[0]).all()
        if shared:
            reals = members[0][1][None]
            reals[0, at.torque : at.torque + at.n] = tau[0]
        else:
            reals = np.concatenate([np.tile(real, (len(g.points), 1)) for g, real in members])
            reals[:, at.torque : at.torque + at.n] = tau
        given = (whole, reals, at, y, plan.t_end, angle[chosen], aims)
        if not members[0][0].mechanism.has_forces:
            yield chosen, compiled(*given)
            continue
        which = np.repeat(np.arange(len(members)), [len(group.points) for group, _ in members])
        forces = LaneForces([group.mechanism for group, _ in members], which)
        yield chosen, lanes.integrate(*given, forces)


def _forces_of(mechanism: Mechanism) -> tuple[object, ...]:
    """What must agree where lanes share the structure of their forces."""
    return (
        len(mechanism.springs),
        tuple(spring.joint for spring in mechanism.joint_springs),
        tuple((force.link, force.turns) for force in mechanism.forces),
    )
