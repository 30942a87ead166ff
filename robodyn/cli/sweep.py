"""`robodyn sweep`: the same simulation or torque at many points."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import closing
from pathlib import Path
from typing import Annotated, Optional

import typer

from robodyn.cli.files import named, output_file
from robodyn.cli.options import Model
from robodyn.cli.output import note
from robodyn.cli.progress import progress
from robodyn.cli.sweep_options import Kind, axes_of, new_plan, seed_of
from robodyn.errors import InputError, RobodynError
from robodyn.scene.yaml_tree import read_text
from robodyn.simulation.simulation import Engine
from robodyn.sweeps.resumable_file import ResumableFile
from robodyn.sweeps.scene_values import numbers_of
from robodyn.sweeps.sweep_chunks import Rows
from robodyn.sweeps.sweep_plan import RESULTS, Plan, check
from robodyn.sweeps.sweep_workers import PATIENCE, results
from robodyn.sweeps.variation import Variation
from robodyn.tables.csv_fields import quoted


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
        "motion"
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
        Engine,
        typer.Option("--engine", help="auto: compiled, with the extra `fast`, from 200 points on."),
    ] = "auto",
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
    patience: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--patience",
            metavar="S",
            help="How long to wait for a worker where the scheduler has lost all. "
            f"Default: {PATIENCE:g}.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no summary.")] = False,
    out: Annotated[
        Optional[str],  # noqa: UP045
        output_file(
            "--out",
            "-o",
            help="Write here, by way of FILE.partial, from which a sweep cut off goes on.",
            kept=True,
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
    scene = numbers_of(text, model)
    plan = new_plan(
        text, model, kind, duration, rtol, atol, max_steps,
        Variation(axes_of(scene, vary, sample, kind), sample, seed_of(seed, sample)),
        {"q": q, "qd": qd, "qdd": qdd, "tau": tau}, result, flip, scene, engine,
    )  # fmt: skip
    if workers is not None and workers < 1:
        raise InputError("--workers", value=workers, limit="must be >= 1")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler", limit="exclude each other")
    if patience is not None and scheduler is None:
        raise InputError("--patience", value=patience, limit="is for --scheduler")
    if patience is not None and not patience >= 0.0:
        raise InputError("--patience", value=patience, limit="must be >= 0, s")
    check(plan)
    place = workers, scheduler, PATIENCE if patience is None else patience, note
    header = (",".join(map(quoted, plan.columns())) + "\n").encode()
    outcomes: Counter[str] = Counter()
    size = plan.variation.size
    begun = time.perf_counter()
    resumable = out is not None and out != "-" and _is_file(out)
    if not resumable:
        from robodyn.tables.output_file import open_output

        with open_output(out) as stream, progress("sweeping", quiet, 0.0) as show:
            stream.write(header)
            with closing(_results(plan, 0, *place)) as chunks:
                for rows in chunks:
                    stream.write(_lines(rows))
                    stream.flush()
                    outcomes.update(rows.outcomes)
                    show(sum(outcomes.values()) / size)
    else:
        assert out is not None
        with ResumableFile(out, header, plan.facts(), size, plan.chunk) as file:
            done = min(file.done * plan.chunk, size)
            if file.doubted:
                text = f"what follows the first {done} points in {file.partial}"
                note(f"Warning: {text} does not match its digests: computed again")
            if done and not quiet:
                note(f"{file.partial} has {done} of {size} points: going on from there")
            try:
                with (
                    progress("sweeping", quiet, 0.0) as show,
                    closing(_results(plan, file.done, *place)) as chunks,
                ):
                    for rows in chunks:
                        file.append(_lines(rows))
                        done += len(rows.outcomes)
                        outcomes.update(rows.outcomes)
                        show(done / size)
            except BaseException:
                text = f"{done} of {size} points are in {file.partial}: the same command goes on"
                note(text)
                raise
            file.finish()
    if not quiet:
        _summary(plan, outcomes, time.perf_counter() - begun)


def _results(
    plan: Plan,
    begin: int,
    workers: int | None,
    scheduler: str | None,
    patience: float,
    tell: Callable[[str], object],
) -> Generator[Rows]:
    try:
        yield from results(plan, begin, workers, scheduler, patience, tell)
    except RobodynError as error:
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


# -- what is told --------------------------------------------------------------------------------


def _summary(plan: Plan, outcomes: Counter[str], seconds: float) -> None:
    points = sum(outcomes.values())
    counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())
    each = f", {seconds / points * 1e3:.3g} ms each" if points else ""
    engine = f" ({plan.engine})" if plan.kind == "motion" else ""
    note(f"{points} points in {seconds:.3g} s{each}{engine}: {counts or 'nothing was left to do'}")
