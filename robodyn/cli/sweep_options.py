"""What the options of `robodyn sweep` say."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from typer import Option

from robodyn.cli.event_options import EVENT, named_events
from robodyn.cli.options import Model, Text, named_options, vector
from robodyn.cli.states import check_displacements
from robodyn.cli.times import value_from
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.quantities import parse_angle, parse_number, parse_vector
from robodyn.scene.scene_values import SceneValues, is_angle
from robodyn.scene.yaml_values import nearest
from robodyn.simulation.settings import Engine, Settings
from robodyn.sweeps.sweep_plan import CHUNKS, EVENTS, ONE_BY_ONE, RESULTS, Plan, best_engine
from robodyn.sweeps.variation import Axis, Variation, spaced, stepped
from robodyn.tables.csv_fields import shown

MOST_VALUES = 10_000_000  # of one --vary
MOST_POINTS = 10**12
MOST_NAMED = 60  # names that a message lists

Kind = Literal["motion", "torque"]  # what is computed at each point
_VARY = (
    "What varies: NAME=first:last:count, first:last:step (with a unit or a decimal point), a,b,c, "
    "or with --sample low:high. Once for each NAME."
)
_Q = "Angles of the actuated joints, rad, or 30deg (the rest is assembled). Default: zero."
_QD = "Rates of the actuated joints, rad/s or 30deg. Default: zero."
_QDD = "Accelerations of the actuated joints, rad/s^2, for torques. Default: zero."
_TAU = "Constant torques of the actuated joints, N m. Default: zero."
_TIME = "End time, s; negative runs backwards."
_RESULT = f"Columns of a motion: {', '.join(RESULTS)}, and {EVENTS} with --event."
_FLIP = "The link whose flip is told. Default: the last."
_STEPS = "A motion gives up after so many."
_ENGINE = "auto: compiled, with the extra `fast`, from 200 points on."


@dataclass(frozen=True)
class SweepOptions:
    """What is computed, and at which points."""

    vary: Annotated[list[str], Option("--vary", metavar="NAME=VALUES", help=_VARY)]
    sample: Annotated[
        int | None, Option("--sample", metavar="N", help="Draw N points at random; no grid.")
    ] = None
    seed: Annotated[int, Option("--seed", metavar="S", help="Of the random sample.")] = 0
    kind: Annotated[Kind, Option("--kind", help="Motions, or torques at states.")] = "motion"
    q: Annotated[Text, vector("--q", _Q)] = None
    qd: Annotated[Text, vector("--qd", _QD)] = None
    qdd: Annotated[Text, vector("--qdd", _QDD)] = None
    tau: Annotated[Text, vector("--tau", _TAU)] = None
    time: Annotated[float, Option("--time", metavar="S", help=_TIME)] = 10.0
    result: Annotated[str, Option("--result", metavar="NAMES", help=_RESULT)] = ",".join(RESULTS)
    event: Annotated[list[str] | None, Option("--event", metavar="NAME=EXPR", help=EVENT)] = None
    flip: Annotated[Text, Option("--flip", metavar="LINK", help=_FLIP)] = None
    rtol: Annotated[float, Option("--rtol", help="Relative tolerance of a step.")] = 1e-9
    atol: Annotated[float, Option("--atol", help="Absolute one, rad, rad/s.")] = 1e-9
    max_steps: Annotated[int, Option("--max-steps", metavar="N", help=_STEPS)] = 100_000
    engine: Annotated[Engine, Option("--engine", help=_ENGINE)] = "auto"


def plan_of(model: Model, given: SweepOptions) -> Plan:
    """What the options say; InputError naming the option that is wrong."""
    scene = model.values()
    axes = _axes(scene, given)
    if given.seed < 0:
        raise InputError("--seed", value=given.seed, limit="must be >= 0")
    variation = Variation(axes, given.sample, given.seed if given.sample is not None else 0)
    mechanism = build(scene.base)
    if not (math.isfinite(given.time) and given.time != 0.0):
        raise InputError("--time", value=given.time, limit="must be finite and not zero")
    with named_options(("rtol", "atol"), max_evals="max_steps"):
        Settings("taylor", given.rtol, given.atol, max_evaluations=given.max_steps).check()
    chosen = tuple(word.strip() for word in given.result.split(","))
    for word in chosen:
        if word not in (*RESULTS, EVENTS):
            limit = f"knows {', '.join((*RESULTS, EVENTS))}"
            raise InputError("--result", value=shown(word), limit=limit)
    events = _events(mechanism, given, EVENTS in chosen)
    names = list(mechanism.link_names)
    if given.flip is not None and given.flip not in names:
        limit = f"names no link{nearest(given.flip, names)}"
        raise InputError("--flip", value=shown(given.flip), limit=limit)
    if given.kind == "torque" and given.tau is not None:
        raise InputError("--tau", limit="is what --kind torque computes")
    if given.kind == "motion" and given.qdd is not None:
        raise InputError("--qdd", limit="is for --kind torque")
    vectors: dict[str, Any] = {
        name: _values(mechanism, name, getattr(given, name)) for name in ("q", "qd", "qdd", "tau")
    }
    engine: str = "python"
    if given.kind == "motion" and not events:
        with named_options(("engine",)):
            engine = best_engine(given.engine, variation.size, mechanism)
    return Plan(
        scene=model.text(),
        source=model.model,
        numbers=model.given,
        variation=variation,
        **vectors,
        kind=given.kind,
        t_end=given.time,
        results=tuple(name for name in RESULTS if name in chosen),
        link=-1 if given.flip is None else names.index(given.flip),
        rtol=given.rtol,
        atol=given.atol,
        most=given.max_steps,
        engine=engine,
        chunk=ONE_BY_ONE if events else CHUNKS[engine],
        events=events,
    )


def _events(mechanism: Mechanism, given: SweepOptions, wanted: bool) -> tuple[tuple[str, str], ...]:
    """The events of each motion, which go with --result events alone."""
    events = tuple(named_events(mechanism, given.event or []).items())
    if wanted and given.kind == "torque":
        raise InputError("--result", value=EVENTS, limit="is for --kind motion")
    if wanted != bool(events):
        missing = "--event NAME=EXPR" if wanted else f"--result {EVENTS}"
        option = "--result" if wanted else "--event"
        raise InputError(option, value=EVENTS if wanted else None, limit=f"needs {missing}")
    if events and given.engine == "compiled":
        limit = "events are looked for by one motion at a time, in Python: take auto or python"
        raise InputError("--engine", value=given.engine, limit=limit)
    return events


def _values(mechanism: Mechanism, name: str, text: str | None) -> tuple[float, ...]:
    """The values of the actuated joints; zero where they are not given."""
    actuated = [mechanism.link_names[k] for k in mechanism.actuated]
    if text is None:
        return (0.0,) * len(actuated)
    values = parse_vector(text, where=f"--{name}", angles=name != "tau")
    if name != "tau":
        check_displacements(mechanism, text, None, f"--{name}")
    if len(values) != len(actuated):
        limit = f"needs {len(actuated)} values, one an actuated joint ({', '.join(actuated)})"
        raise InputError(f"--{name}", value=f"{shown(text)} ({len(values)} values)", limit=limit)
    return tuple(values)


def _axes(scene: SceneValues, given: SweepOptions) -> tuple[Axis, ...]:
    """What the --vary options say."""
    sample = given.sample
    if sample is not None and not 1 <= sample <= MOST_POINTS:
        raise InputError("--sample", value=sample, limit=f"must be in [1, {MOST_POINTS}]")
    mechanism = build(scene.base)
    last = "tau" if given.kind == "motion" else "qdd"
    joints = [f"{x}{k + 1}" for x in ("q", "qd", last) for k in mechanism.actuated]
    axes: list[Axis] = []
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
        slides = [f"{x}{k + 1}" for x in ("q", "qd", "qdd") for k in mechanism.slides]
        slides += [f"start.{mechanism.link_names[k]}" for k in mechanism.slides]
        angle = is_angle(name) and name not in slides
        axes.append(_axis(name, values.strip(), sample is not None, angle))
    clash = scene.clash(axis.name for axis in axes if axis.name in scene)
    if clash is not None:
        raise InputError("--vary", value=" and ".join(clash), limit="are one number of the scene")
    points = 1 if sample is not None else math.prod(len(axis.values) for axis in axes)
    if points > MOST_POINTS:
        raise InputError("--vary", value=f"{points} points", limit=f"at most {MOST_POINTS}")
    return tuple(axes)


def _unknown(mechanism: Mechanism, joints: list[str], scene: SceneValues, name: str) -> str:
    passive = re.fullmatch(r"(?:q|qd|qdd|tau)([1-9][0-9]*)", name)
    if passive and int(passive[1]) - 1 in mechanism.passive:
        link = mechanism.link_names[int(passive[1]) - 1]
        return f"joint {link} is passive: it follows from the actuated ones"
    known = [*joints, *scene.names]
    listed = ", ".join(known[:MOST_NAMED]) + (", ..." if len(known) > MOST_NAMED else "")
    return (
        f"is nothing that can vary{nearest(name, known).partition('; known')[0]}; known: {listed}"
    )


def _axis(name: str, text: str, drawn: bool, angle: bool) -> Axis:
    """One --vary: a list, a grid, or an interval to draw from."""
    where = f"--vary {name}"

    def number(part: str) -> float:
        if angle:
            return value_from(part.strip(), parse_angle, where, "-0.5, 30deg or pi/2")
        return value_from(part.strip(), parse_number, where, "1.5 or -2e-3")

    def wrong(limit: str) -> InputError:
        return InputError(where, value=shown(text), limit=limit)

    parts = text.split(":")
    if len(parts) == 1:
        return Axis(name, tuple(number(part) for part in text.split(",")))
    if len(parts) == 2:
        low, high = map(number, parts)
        if not drawn:
            raise wrong("write first:last:count or first:last:step; low:high is for --sample")
        if not low < high:
            raise wrong("the first must be below the second")
        return Axis(name, low=low, high=high)
    if len(parts) != 3:
        raise wrong("write first:last:count, first:last:step or a,b,c")
    first, last = map(number, parts[:2])
    if re.fullmatch(r"\+?[0-9]{1,18}", parts[2].strip(), re.ASCII):
        count = int(parts[2])
        if not 1 <= count <= MOST_VALUES:
            raise wrong(f"the count must be in [1, {MOST_VALUES}]")
        return Axis(name, spaced(first, last, count))
    step = number(parts[2])
    if step != 0.0 and abs((last - first) / step) > MOST_VALUES:
        raise wrong(f"makes more than {MOST_VALUES} values")
    try:
        return Axis(name, stepped(first, last, step))
    except ValueError as error:
        raise wrong(str(error)) from None
