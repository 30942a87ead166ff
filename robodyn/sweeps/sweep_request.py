"""The options of a sweep, and the plan that follows from them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics.columns import scene_units, unit_of
from robodyn.dynamics.joint_vectors import driver_of, full, vector_of_joints
from robodyn.engines import machine
from robodyn.errors import InputError, named_options, nearest_first
from robodyn.loops.assembly_plan import with_independent
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.event_functions import named_events
from robodyn.runs.settings import DEFAULT_DURATION, DEFAULT_POINTS, Settings
from robodyn.runs.simulation import UNTIL
from robodyn.scene.quantities import read_value, value_from
from robodyn.scene.scene_values import SceneValues
from robodyn.scene.yaml_values import nearest
from robodyn.sweeps.lanes import served
from robodyn.sweeps.row_results import check_results
from robodyn.sweeps.sweep_plan import (
    CHUNKS,
    EVENTS,
    RESULTS,
    STATES,
    Axis,
    Plan,
    Variation,
    spaced,
    stepped,
)
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown

MOST_VALUES = 10_000_000  # of one --vary
MOST_POINTS = 10**12
MOST_NAMED = 60  # names that a message lists
DRAWN = {"normal": "normal(mean, deviation)", "uniform": "uniform(low, high)"}

Kind = Literal["motion", "torque"]  # what is computed at each point


@dataclass(frozen=True)
class SweepRequest:
    """What is computed and at which points, as options of `robodyn sweep`."""

    vary: list[str]  # NAME=VALUES
    sample: int | None = None
    seed: int = 0
    kind: Kind = "motion"
    q: str | None = None
    qd: str | None = None
    qdd: str | None = None
    tau: str | None = None
    time: float | None = None
    result: str | None = None
    of: list[str] | None = None
    points: int | None = None
    event: list[str] | None = None
    flip: str | None = None
    rtol: float = 1e-9
    atol: float = 1e-9
    max_steps: int = 100_000

    @property
    def duration(self) -> float:
        """The end time, s."""
        return DEFAULT_DURATION if self.time is None else self.time


class Acting(NamedTuple):
    """The end time, and the reference of torques, or the arguments of the motions' controller.

    `follows` says that motions begin where the reference does.
    """

    end: float
    track: ReferenceTable | None = None
    control: tuple[tuple[str, Any], ...] = ()
    follows: bool = False


Acts = Callable[[Mechanism, tuple[Axis, ...]], Acting]


def plan_of(
    scene: SceneValues,
    numbers: tuple[tuple[str, str], ...],
    given: SweepRequest,
    acts: Acts | None = None,
) -> Plan:
    """The plan of a request, of a scene with `numbers` in place of those of its text.

    `scene` holds these already.  `acts` makes what acts of the mechanism and the axes.  Raises
    InputError naming the option that is wrong.
    """
    mechanism = build(scene.base)
    axes = _axes(scene, given)
    if given.seed < 0:
        raise InputError("--seed", value=given.seed, limit="must be >= 0")
    variation = Variation(axes, given.sample, given.seed if given.sample is not None else 0)
    if given.time is not None and not (math.isfinite(given.time) and given.time != 0.0):
        raise InputError("--time", value=given.time, limit="must be finite and not zero")
    with named_options(("rtol", "atol"), max_evals="max_steps"):
        Settings("taylor", given.rtol, given.atol, max_evaluations=given.max_steps).check()
    if given.kind == "torque" and given.tau is not None:
        raise InputError("--tau", limit="is what --kind torque computes")
    if given.kind == "motion" and given.qdd is not None:
        raise InputError("--qdd", limit="is for --kind torque")
    vectors: dict[str, Any] = {
        name: _values(mechanism, name, getattr(given, name)) for name in ("q", "qd", "qdd", "tau")
    }
    _check_whole(mechanism, given)
    acting = Acting(given.duration) if acts is None else acts(mechanism, axes)
    reference = acting.track or dict(acting.control).get("reference")
    if reference is not None and acting.follows:
        begin = reference.at(0.0 if acting.control else reference.times[0])
        for name, values in zip(("q", "qd"), begin, strict=True):
            if getattr(given, name) is None:
                led = dict(zip(mechanism.actuated, values.tolist(), strict=True))
                joints = with_independent(mechanism).actuated
                vectors[name] = tuple(led.get(k, 0.0) for k in joints)
    chosen, told = _results(mechanism, given, acting)
    events = _events(mechanism, given, EVENTS in chosen)
    together = _together(mechanism, events, told, acting.control)
    method = "taylor" if together and machine.available() else "DOP853"
    chunk = CHUNKS[method] if given.kind == "motion" else STATES
    names = list(mechanism.link_names)
    if given.flip is not None and given.flip not in names:
        limit = f"names no link{nearest(given.flip, names)}"
        raise InputError("--flip", value=shown(given.flip), limit=limit)
    return Plan(
        scene=scene.base.written.text,
        source=scene.source,
        numbers=numbers,
        tables=scene.tables,
        variation=variation,
        **vectors,
        track=acting.track,
        control=acting.control,
        kind=given.kind,
        t_end=acting.end,
        results=tuple(name for name in RESULTS if name in chosen),
        told=told,
        of=tuple(given.of or ()),
        rows=(given.points or DEFAULT_POINTS) if told and given.kind == "motion" else 0,
        link=-1 if given.flip is None else names.index(given.flip),
        rtol=given.rtol,
        atol=given.atol,
        most=given.max_steps,
        method=method,
        chunk=CHUNKS["DOP853"] if acting.track else chunk,
        events=events,
    )


def _together(mechanism: Mechanism, *alone: object) -> bool:
    """Whether motions could go in lanes; events, columns, controllers take one at a time."""
    return served(mechanism) and not any(alone)


def lacks_machine_code(plan: Plan) -> bool:
    """Whether the extra `fast` would make the motions of the plan far faster."""
    together = _together(plan.mechanism, plan.events, plan.told, plan.control)
    return plan.kind == "motion" and together and not machine.available()


def _results(
    mechanism: Mechanism, given: SweepRequest, acting: Acting
) -> tuple[list[str], tuple[str, ...]]:
    """The words of --result that are results of motions, and the columns."""
    known = (*RESULTS, EVENTS)
    words = [] if given.result is None else [word.strip() for word in given.result.split(",")]
    chosen = [word for word in words if word in known]
    told = tuple(word for word in words if word not in known)
    rows = given.kind == "motion" or acting.track is not None
    if given.points is not None and not (told and given.kind == "motion"):
        limit = "is for motions with --result of columns, such as max(tau1)"
        raise InputError("--points", value=given.points, limit=limit)
    if given.points is not None and not 2 <= given.points <= MOST_VALUES:
        raise InputError("--points", value=given.points, limit=f"must be in [2, {MOST_VALUES}]")
    if given.of and not told:
        raise InputError("--of", limit="is for --result with columns of points")
    if given.kind == "torque" and chosen:
        raise InputError("--result", value=chosen[0], limit="is for --kind motion")
    if acting.track is not None and not told:
        raise InputError("--result", limit="missing: --track needs it, such as max(tau1)")
    for word in (word for k, word in enumerate(words) if word in words[:k]):
        raise InputError("--result", value=shown(word), limit="is given twice")
    with named_options(("result", "of")):
        check_results(mechanism, told, given.of or (), bool(acting.control), rows, known)
    if given.result is None and given.kind == "motion":
        chosen = list(RESULTS)
    return chosen, told


def _events(mechanism: Mechanism, given: SweepRequest, wanted: bool) -> tuple[tuple[str, str], ...]:
    """The events of each motion, which go with --result events alone."""
    events = tuple(named_events(mechanism, given.event, UNTIL).items()) if given.event else ()
    if wanted != bool(events):
        missing = "--event NAME=EXPR" if wanted else f"--result {EVENTS}"
        option = "--result" if wanted else "--event"
        raise InputError(option, value=EVENTS if wanted else None, limit=f"needs {missing}")
    return events


def _check_whole(mechanism: Mechanism, given: SweepRequest) -> None:
    """Raise InputError for q, qd and qdd of all joints that do not keep the closures."""
    known: dict[str, tuple[Array, bool]] = {}
    for name in ("q", "qd", "qdd"):
        if (text := getattr(given, name)) is None:
            break
        values = np.array(vector_of_joints(driver_of(mechanism, name), text, name, f"--{name}"))
        known[name] = values, len(values) == mechanism.n
    if mechanism.rows and any(whole for _, whole in known.values()):
        full(mechanism, known, places={"q": "--q", "qd": "--qd"}, t=0.0)


def _values(mechanism: Mechanism, name: str, text: str | None) -> tuple[float, ...]:
    """The values of the independent joints, of torques of the actuated; zero if not given.

    A q that is not given is empty where each scene has a `start` of its own.
    """
    mechanism = mechanism if name == "tau" else with_independent(mechanism)
    if text is None:
        began = name == "q" and mechanism.description.begin(mechanism.actuated)
        return () if began else (0.0,) * len(mechanism.actuated)
    values = vector_of_joints(mechanism, text, name, f"--{name}")
    if len(values) == mechanism.n:
        for k in mechanism.passive if name == "tau" else ():
            if values[k]:
                limit = f"joint {mechanism.link_names[k]} is passive; name it in `actuated`"
                raise InputError(f"--tau: tau{k + 1}", value=values[k], limit=limit)
        values = [values[k] for k in mechanism.actuated]
    return tuple(values)


def _axes(scene: SceneValues, given: SweepRequest) -> tuple[Axis, ...]:
    """Return the axes of the --vary options."""
    sample = given.sample
    if sample is not None and not 1 <= sample <= MOST_POINTS:
        raise InputError("--sample", value=sample, limit=f"must be in [1, {MOST_POINTS}]")
    mechanism = build(scene.base)
    last = "tau" if given.kind == "motion" else "qdd"
    driver = with_independent(mechanism)
    varied = {"q": driver, "qd": driver, last: mechanism if last == "tau" else driver}
    joints = [f"{x}{k + 1}" for x, given_by in varied.items() for k in given_by.actuated]
    axes: list[Axis] = []
    units = scene_units(mechanism)
    for text in given.vary:
        name, equals, values = text.partition("=")
        name = name.strip()
        if not equals or not name or not values.strip():
            raise InputError("--vary", value=shown(text), limit="write NAME=VALUES")
        if name not in joints and name not in scene:
            limit = _unknown(mechanism, joints, scene, name)
            raise InputError("--vary", value=shown(name), limit=limit)
        if any(axis.name == name for axis in axes):
            raise InputError("--vary", value=shown(name), limit="is given twice")
        unit = unit_of(name, units) if name in joints else scene.unit(name)
        axes.append(_Values(name, values.strip(), sample is not None, unit).axis())
    clash = scene.clash(axis.name for axis in axes if axis.name in scene)
    if clash is not None:
        raise InputError("--vary", value=" and ".join(clash), limit="are one number of the scene")
    points = 1 if sample is not None else math.prod(len(axis.values) for axis in axes)
    if points > MOST_POINTS:
        raise InputError("--vary", value=f"{points} points", limit=f"at most {MOST_POINTS}")
    return tuple(axes)


def _unknown(mechanism: Mechanism, joints: list[str], scene: SceneValues, name: str) -> str:
    match = re.fullmatch(r"(q|qd|qdd|tau)([1-9][0-9]*)", name)
    others = [x for x in joints if match and re.fullmatch(f"{match[1]}[0-9]+", x)]
    if match and others and int(match[2]) <= mechanism.n:
        why = "is passive" if match[1] == "tau" else "follows from the others"
        link = mechanism.link_names[int(match[2]) - 1]
        return f"joint {link} {why}: vary {', '.join(others)}"
    known = [*joints, *scene.names]
    listed = ", ".join(nearest_first(name, known)[:MOST_NAMED]) + (
        ", ..." if len(known) > MOST_NAMED else ""
    )
    return (
        f"is nothing that can vary{nearest(name, known).partition('; known')[0]}; known: {listed}"
    )


def _count(text: str) -> int | None:
    """Return the number of values of a grid; None for a step, which has a unit or decimal point."""
    try:
        found = read_value(text)
    except ValueError:
        return None
    whole = found.plain and "." not in text and found.value.is_integer()
    return int(found.value) if whole and found.value >= 0.0 else None


@dataclass
class _Values:
    """The values of one --vary, as they are written: a list, a grid, or what to draw from."""

    name: str
    text: str
    drawn: bool  # whether they are drawn, for --sample
    unit: str

    def axis(self) -> Axis:
        """The axis that they make; InputError, naming --vary, for what is none."""
        called = re.match(r"(normal|uniform)\b", self.text)
        drawing = re.fullmatch(r"(normal|uniform)\(([^,()]+),([^,()]+)\)", self.text)
        if called and not drawing:
            raise self._wrong(f"needs two numbers: {DRAWN[called[1]]}")
        if drawing and not self.drawn:
            raise self._wrong(f"{drawing[1]} is for --sample")
        if drawing and drawing[1] == "normal":
            return self._normal(*drawing.groups()[1:])
        parts = drawing.groups()[1:] if drawing else self.text.split(":")
        ways: dict[int, Callable[..., Axis]] = {1: self._list, 2: self._between, 3: self._grid}
        if len(parts) not in ways:
            raise self._wrong("write first:last:count, first:last:step or a,b,c")
        return ways[len(parts)](*parts)

    def _number(self, part: str) -> float:
        return value_from(part, self.unit, f"--vary {self.name}")

    def _wrong(self, limit: str) -> InputError:
        return InputError(f"--vary {self.name}", value=shown(self.text), limit=limit)

    def _normal(self, *parts: str) -> Axis:
        mean, deviation = map(self._number, parts)
        if not deviation > 0.0:
            raise self._wrong("the deviation must be > 0")
        return Axis(self.name, low=mean, deviation=deviation)

    def _list(self, text: str) -> Axis:
        return Axis(self.name, tuple(map(self._number, text.split(","))))

    def _between(self, *ends: str) -> Axis:
        low, high = map(self._number, ends)
        if not self.drawn:
            raise self._wrong("write first:last:count or first:last:step; low:high is for --sample")
        if not low < high:
            raise self._wrong("the first must be below the second")
        return Axis(self.name, low=low, high=high)

    def _grid(self, begin: str, end: str, third: str) -> Axis:
        first, last = self._number(begin), self._number(end)
        if (count := _count(third)) is not None:
            if not 1 <= count <= MOST_VALUES:
                raise self._wrong(f"the count must be in [1, {MOST_VALUES}]")
            return Axis(self.name, spaced(first, last, count))
        step = self._number(third)
        if step != 0.0 and abs((last - first) / step) > MOST_VALUES:
            raise self._wrong(f"makes more than {MOST_VALUES} values")
        try:
            return Axis(self.name, stepped(first, last, step))
        except ValueError as error:
            raise self._wrong(str(error)) from None
