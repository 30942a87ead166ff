"""What the options of `robodyn sweep` say."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, Literal

from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.quantities import parse_angle, parse_number, parse_vector
from robodyn.scene.yaml_values import nearest
from robodyn.simulation.simulation import Engine, Settings
from robodyn.sweeps.scene_values import SceneValues, is_angle
from robodyn.sweeps.sweep_plan import CHUNKS, RESULTS, Plan, best_engine
from robodyn.sweeps.variation import Axis, Variation, spaced, stepped
from robodyn.tables.csv_fields import shown

MOST_VALUES = 10_000_000  # of one --vary
MOST_POINTS = 10**12
MOST_NAMED = 60  # names that a message lists


Kind = Literal["motion", "torque"]  # what is computed at each point


def new_plan(
    text: str,
    model: str,
    kind: Kind,
    duration: float,
    rtol: float,
    atol: float,
    max_steps: int,
    variation: Variation,
    vectors: dict[str, str | None],
    result: str,
    flip: str | None,
    scene: SceneValues,
    engine: Engine,
) -> Plan:
    mechanism = build(scene.base)
    if not (math.isfinite(duration) and duration != 0.0):
        raise InputError("--time", value=duration, limit="must be finite and not zero")
    try:
        Settings("taylor", rtol, atol, max_evaluations=max_steps).check()
    except InputError as error:
        error.what = {"max_evals": "--max-steps"}.get(error.what, f"--{error.what}")
        raise
    chosen = tuple(word.strip() for word in result.split(","))
    for word in chosen:
        if word not in RESULTS:
            raise InputError("--result", value=shown(word), limit=f"knows {', '.join(RESULTS)}")
    link = -1
    if flip is not None:
        if flip not in mechanism.link_names:
            limit = f"names no link{nearest(flip, list(mechanism.link_names))}"
            raise InputError("--flip", value=shown(flip), limit=limit)
        link = mechanism.link_names.index(flip)
    if kind == "torque" and vectors["tau"] is not None:
        raise InputError("--tau", limit="is what --kind torque computes")
    if kind == "motion" and vectors["qdd"] is not None:
        raise InputError("--qdd", limit="is for --kind torque")
    given: dict[str, Any] = {
        name: _values(mechanism, name, value) for name, value in vectors.items()
    }
    chosen_engine: str = engine
    if kind == "torque":
        chosen_engine = "python"
    else:
        try:
            chosen_engine = best_engine(chosen_engine, variation.size, mechanism)
        except InputError as error:
            error.what = "--engine"
            raise
    return Plan(
        scene=text,
        source=model,
        variation=variation,
        **given,
        kind=kind,
        t_end=duration,
        results=tuple(name for name in RESULTS if name in chosen),
        link=link,
        rtol=rtol,
        atol=atol,
        most=max_steps,
        engine=chosen_engine,
        chunk=CHUNKS[chosen_engine],
    )


def _values(mechanism: Mechanism, name: str, text: str | None) -> tuple[float, ...]:
    """The values of the actuated joints; zero where they are not given."""
    actuated = [mechanism.link_names[k] for k in mechanism.actuated]
    if text is None:
        return (0.0,) * len(actuated)
    values = parse_vector(text, where=f"--{name}", angles=name != "tau")
    if len(values) != len(actuated):
        limit = f"needs {len(actuated)} values, one an actuated joint ({', '.join(actuated)})"
        raise InputError(f"--{name}", value=f"{shown(text)} ({len(values)} values)", limit=limit)
    return tuple(values)


def seed_of(seed: int, sample: int | None) -> int:
    if seed < 0:
        raise InputError("--seed", value=seed, limit="must be >= 0")
    return seed if sample is not None else 0


def axes_of(
    scene: SceneValues, vary: Sequence[str], sample: int | None, kind: Kind
) -> tuple[Axis, ...]:
    """What the --vary options say."""
    if sample is not None and not 1 <= sample <= MOST_POINTS:
        raise InputError("--sample", value=sample, limit=f"must be in [1, {MOST_POINTS}]")
    mechanism = build(scene.base)
    last = "tau" if kind == "motion" else "qdd"
    joints = [f"{x}{k + 1}" for x in ("q", "qd", last) for k in mechanism.actuated]
    axes: list[Axis] = []
    for text in vary:
        name, equals, values = text.partition("=")
        name = name.strip()
        if not equals or not name or not values.strip():
            raise InputError("--vary", value=shown(text), limit="write NAME=VALUES")
        if name not in joints and name not in scene:
            raise InputError(
                "--vary", value=shown(name), limit=_unknown(mechanism, joints, scene, name)
            )
        if any(axis.name == name for axis in axes):
            raise InputError("--vary", value=shown(name), limit="is given twice")
        axes.append(_axis(name, values.strip(), sample is not None))
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


def _axis(name: str, text: str, drawn: bool) -> Axis:
    """One --vary: a list, a grid, or an interval to draw from."""
    where = f"--vary {name}"

    def number(part: str) -> float:
        try:
            return (parse_angle if is_angle(name) else parse_number)(part.strip())
        except ValueError as error:
            example = "-0.5, 30deg or pi/2" if is_angle(name) else "1.5 or -2e-3"
            limit = f"{error}; write {example}"
            raise InputError(where, value=shown(part), limit=limit) from None

    parts = text.split(":")
    if len(parts) == 1:
        return Axis(name, tuple(number(part) for part in text.split(",")))
    if len(parts) == 2:
        low, high = map(number, parts)
        if not drawn:
            limit = "write first:last:count or first:last:step; low:high is for --sample"
            raise InputError(where, value=shown(text), limit=limit)
        if not low < high:
            raise InputError(where, value=shown(text), limit="the first must be below the second")
        return Axis(name, low=low, high=high)
    if len(parts) != 3:
        limit = "write first:last:count, first:last:step or a,b,c"
        raise InputError(where, value=shown(text), limit=limit)
    first, last = map(number, parts[:2])
    if re.fullmatch(r"\+?[0-9]{1,18}", parts[2].strip(), re.ASCII):
        count = int(parts[2])
        if not 1 <= count <= MOST_VALUES:
            limit = f"the count must be in [1, {MOST_VALUES}]"
            raise InputError(where, value=shown(text), limit=limit)
        return Axis(name, spaced(first, last, count))
    step = number(parts[2])
    if step != 0.0 and abs((last - first) / step) > MOST_VALUES:
        limit = f"makes more than {MOST_VALUES} values"
        raise InputError(where, value=shown(text), limit=limit)
    try:
        return Axis(name, stepped(first, last, step))
    except ValueError as error:
        raise InputError(where, value=shown(text), limit=str(error)) from None
