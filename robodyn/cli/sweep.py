"""`robodyn sweep`: the same simulation or torque at many points."""

from __future__ import annotations

import math
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from robodyn.cli.options import Model, named
from robodyn.cli.output import note
from robodyn.csv_fields import quoted, shown
from robodyn.errors import InputError
from robodyn.mechanism import Mechanism
from robodyn.quantities import parse_angle, parse_number, parse_vector
from robodyn.resumable_file import ResumableFile
from robodyn.scene_values import SceneValues, is_angle
from robodyn.sweep import RESULTS, Plan, Rows, best_engine, check
from robodyn.sweep_workers import results
from robodyn.variation import Axis, Variation, spaced, stepped
from robodyn.yaml_tree import read_text
from robodyn.yaml_values import nearest

MOST_VALUES = 10_000_000  # of one --vary
MOST_POINTS = 10**12
MOST_NAMED = 60  # names that a message lists


class Kind(StrEnum):
    """What is computed at each point."""

    motion = "motion"
    torque = "torque"


class Engine(StrEnum):
    """What computes many motions at once."""

    auto = "auto"
    python = "python"
    compiled = "compiled"


def _vector(flag: str, text: str) -> object:
    return typer.Option(flag, metavar="VECTOR", help=f"{text} Default: zero.", show_default=False)


def sweep(
    model: Model,
    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="NAME=VALUES",
            help="What varies: NAME=first:last:count, first:last:step (with a unit or a decimal "
            "point), a,b,c, or with --sample low:high. Once for each NAME.",
        ),
    ],
    sample: Annotated[
        Optional[int],  # noqa: UP045 (typer reads the annotation at run time)
        typer.Option("--sample", metavar="N", help="Draw N points at random; no grid."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="S", help="Of the random sample.")] = 0,
    kind: Annotated[Kind, typer.Option("--kind", help="Motions, or torques at states.")] = (
        Kind.motion
    ),
    q: Annotated[
        Optional[str],  # noqa: UP045
        _vector("--q", "Angles of the actuated joints, rad, or 30deg (the rest is assembled)."),
    ] = None,
    qd: Annotated[
        Optional[str],  # noqa: UP045
        _vector("--qd", "Rates of the actuated joints, rad/s or 30deg."),
    ] = None,
    qdd: Annotated[
        Optional[str],  # noqa: UP045
        _vector("--qdd", "Accelerations of the actuated joints, rad/s^2, for torques."),
    ] = None,
    tau: Annotated[
        Optional[str],  # noqa: UP045
        _vector("--tau", "Constant torques of the actuated joints, N m."),
    ] = None,
    duration: Annotated[
        float, typer.Option("--time", metavar="S", help="End time, s; negative runs backwards.")
    ] = 10.0,
    result: Annotated[
        str, typer.Option("--result", metavar="NAMES", help="Columns of a motion.")
    ] = ",".join(RESULTS),
    flip: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--flip", metavar="LINK", help="The link whose flip is told. Default: the last."
        ),
    ] = None,
    rtol: Annotated[float, typer.Option("--rtol", help="Relative tolerance of a step.")] = 1e-9,
    atol: Annotated[float, typer.Option("--atol", help="Absolute one, rad, rad/s.")] = 1e-9,
    max_steps: Annotated[
        int, typer.Option("--max-steps", metavar="N", help="A motion gives up after so many.")
    ] = 100_000,
    engine: Annotated[
        Engine, typer.Option("--engine", help="auto: compiled, where numba is, for 1000 points on.")
    ] = Engine.auto,
    workers: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--workers", metavar="N", help="Threads or processes. Default: processors."),
    ] = None,
    scheduler: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="A Dask scheduler whose workers compute the chunks (the extra `cluster`).",
            callback=named,
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no summary.")] = False,
    out: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Write here, by way of FILE.partial, from which a sweep cut off goes on.",
            show_default=False,
            callback=named,
        ),
    ] = None,
) -> None:
    """The same simulation, or torque, over a grid or a random sample, as one CSV.

    NAME is a joint's start (q1, qd2), constant torque (tau1) or, for torques, acceleration (qdd1),
    or a number of the scene: links.forearm.m, gravity, springs[0].stiffness, ... (an unknown name
    lists them).  The last --vary of a grid changes fastest.  A row has what varies, the results,
    and the outcome; a point without a result has empty fields.  With --out the same command goes
    on with a sweep that was cut off.

    \b
    Examples:
      robodyn sweep robots/2r.yaml --vary q1=0:360deg:10deg --vary q2=0:360deg:10deg -o flips.csv
      robodyn sweep robots/2r.yaml --vary links.forearm.m=0.5:1.5 --sample 10000 --seed 1 --time 5
      robodyn sweep robots/four-bar.yaml --vary q1=0:350deg:36 --kind torque --qd 5
      robodyn sweep robots/2r.yaml --vary qd1=0:10:1001 --scheduler tcp://10.0.0.1:8786 -o far.csv
    """
    text = read_text(Path(model))
    scene = SceneValues(text, model)
    plan = _plan(
        text, model, kind, duration, rtol, atol, max_steps,
        Variation(_axes(scene, vary, sample, kind), sample, _seed(seed, sample)),
        {"q": q, "qd": qd, "qdd": qdd, "tau": tau}, result, flip, scene, engine,
    )  # fmt: skip
    if workers is not None and workers < 1:
        raise InputError("--workers", value=workers, limit="must be >= 1")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler", limit="exclude each other")
    check(plan)
    header = (",".join(map(quoted, plan.columns())) + "\n").encode()
    outcomes: Counter[str] = Counter()
    begun = time.perf_counter()
    resumable = out is not None and out != "-" and _is_file(out)
    if not resumable:
        from robodyn.output_file import open_output

        with open_output(out) as stream, _progress(plan, 0, quiet) as advance:
            stream.write(header)
            with closing(_results(plan, 0, workers, scheduler)) as chunks:
                for rows in chunks:
                    stream.write(_lines(rows))
                    stream.flush()
                    outcomes.update(rows.outcomes)
                    advance(len(rows.outcomes))
    else:
        assert out is not None
        size = plan.variation.size
        with ResumableFile(out, header, plan.facts(), size, plan.chunk) as file:
            done = min(file.done * plan.chunk, size)
            if done and not quiet:
                note(f"{file.partial} has {done} of {size} points: going on from there")
            try:
                with (
                    _progress(plan, done, quiet) as advance,
                    closing(_results(plan, file.done, workers, scheduler)) as chunks,
                ):
                    for rows in chunks:
                        file.append(_lines(rows))
                        done += len(rows.outcomes)
                        outcomes.update(rows.outcomes)
                        advance(len(rows.outcomes))
            except BaseException:
                text = f"{done} of {size} points are in {file.partial}: the same command goes on"
                note(text)
                raise
            file.finish()
    if not quiet:
        _summary(plan, outcomes, time.perf_counter() - begun)


def _results(plan: Plan, begin: int, workers: int | None, scheduler: str | None) -> Generator[Rows]:
    try:
        yield from results(plan, begin, workers, scheduler)
    except InputError as error:
        if error.what == "scheduler":
            error.what = "--scheduler"
        raise


def _is_file(out: str) -> bool:
    """Whether --out names a file, or one to be; devices and pipes are written as they come."""
    path = Path(out)
    return path.is_file() or not path.exists()


def _lines(rows: Rows) -> bytes:
    """CSV lines; what is missing is empty."""
    parts = []
    for numbers, outcome in zip(rows.values.tolist(), rows.outcomes, strict=True):
        fields = [repr(x) if x == x else "" for x in numbers]
        parts.append(",".join([*fields, outcome]))
    return ("\n".join(parts) + "\n").encode()


# -- the plan ------------------------------------------------------------------------------------


def _plan(
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
    from robodyn.mechanism import build
    from robodyn.simulation import Settings

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
    if kind is Kind.torque and vectors["tau"] is not None:
        raise InputError("--tau", limit="is what --kind torque computes")
    if kind is Kind.motion and vectors["qdd"] is not None:
        raise InputError("--qdd", limit="is for --kind torque")
    given: dict[str, Any] = {
        name: _values(mechanism, name, value) for name, value in vectors.items()
    }
    chosen_engine = engine.value
    if kind is Kind.torque:
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
        kind=kind.value,
        t_end=duration,
        results=tuple(name for name in RESULTS if name in chosen),
        link=link,
        rtol=rtol,
        atol=atol,
        most=max_steps,
        engine=chosen_engine,
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


def _seed(seed: int, sample: int | None) -> int:
    if seed < 0:
        raise InputError("--seed", value=seed, limit="must be >= 0")
    return seed if sample is not None else 0


def _axes(
    scene: SceneValues, vary: Sequence[str], sample: int | None, kind: Kind
) -> tuple[Axis, ...]:
    """What the --vary options say."""
    from robodyn.mechanism import build

    if sample is not None and not 1 <= sample <= MOST_POINTS:
        raise InputError("--sample", value=sample, limit=f"must be in [1, {MOST_POINTS}]")
    mechanism = build(scene.base)
    last = "tau" if kind is Kind.motion else "qdd"
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
    if re.fullmatch(r"\+?[0-9]+", parts[2].strip(), re.ASCII):
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


# -- what is told --------------------------------------------------------------------------------


@contextmanager
def _progress(plan: Plan, done: int, quiet: bool) -> Iterator[Callable[[int], None]]:
    """A function that moves a bar on a terminal by so many points."""
    if quiet or not sys.stderr.isatty():
        yield lambda points: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("sweeping", total=plan.variation.size, completed=done)
        yield lambda points: progress.update(task, advance=points)


def _summary(plan: Plan, outcomes: Counter[str], seconds: float) -> None:
    points = sum(outcomes.values())
    counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())
    each = f", {seconds / points * 1e3:.3g} ms each" if points else ""
    engine = f" ({plan.engine})" if plan.kind == "motion" else ""
    note(f"{points} points in {seconds:.3g} s{each}{engine}: {counts or 'nothing was left to do'}")
