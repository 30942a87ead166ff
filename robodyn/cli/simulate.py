"""`robodyn simulate`: forward simulation to CSV."""

from __future__ import annotations

import json
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING, Annotated, Optional

import numpy as np
import typer

from robodyn import actuation, closed_form
from robodyn.actuation import Actuation
from robodyn.cli.options import Model, Out, Q, Qd, named
from robodyn.cli.output import note
from robodyn.cli.states import (
    Quantity,
    assembled_state,
    loop_columns,
    open_input,
    remarks,
    single_state,
)
from robodyn.cli.times import output_times
from robodyn.dynamics import forward_dynamics_and_forces, loop_forces
from robodyn.errors import InputError, RobodynError
from robodyn.mechanism import Mechanism, load
from robodyn.output_file import open_output, same_file
from robodyn.recording import Outcome, Report
from robodyn.simulation import MAX_EVALUATIONS, Settings, applied_torques, run
from robodyn.table import Reader
from robodyn.table_writer import Writer

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

SETTINGS = [
    "method",
    "rtol",
    "atol",
    "stabilize",
    "baumgarte_rate",
    "max_evals",
    "order",
    "engine",
    "accuracy",
]
DEFAULT_TOLERANCE = 1e-9
SILENT = 0.5  # s before a progress bar appears


class Method(StrEnum):
    """scipy's integrators, and the Taylor series."""

    DOP853 = "DOP853"
    RK45 = "RK45"
    RK23 = "RK23"
    Radau = "Radau"
    BDF = "BDF"
    LSODA = "LSODA"
    taylor = "taylor"


class Engine(StrEnum):
    """What makes the Taylor series."""

    auto = "auto"
    python = "python"
    compiled = "compiled"


class Stabilize(StrEnum):
    """How drift off the closures is kept away."""

    projection = "projection"
    baumgarte = "baumgarte"
    none = "none"


class UnfinishedError(RobodynError):
    """The run ended before its end time; its outcome is the message."""


def simulate(
    model: Model,
    q: Q = None,
    qd: Qd = None,
    duration: Annotated[
        float, typer.Option("--time", metavar="S", help="End time, s; negative runs backwards.")
    ] = 10.0,
    every: Annotated[
        Optional[float],  # noqa: UP045 (typer reads the annotation at run time)
        typer.Option("--every", metavar="S", help="Time between rows, s.", show_default=False),
    ] = None,
    points: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--points", metavar="N", help="Number of rows. Default: 1001."),
    ] = None,
    tau: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--tau",
            metavar="TORQUES",
            help="Torques of the actuated joints, N m: numbers, or expressions in t, q1.., qd1..",
            show_default=False,
        ),
    ] = None,
    tau_from: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--tau-from",
            metavar="FILE",
            help="CSV with t,tau1,.. (- for stdin), interpolated between its rows.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        Optional[Method],  # noqa: UP045
        typer.Option("--method", help="Integrator. Default: DOP853; with --accuracy the best."),
    ] = None,
    rtol: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--rtol", help="Relative tolerance of a step. Default: 1e-9."),
    ] = None,
    atol: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--atol", help="Absolute tolerance, rad, rad/s. Default: 1e-9."),
    ] = None,
    accuracy: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--accuracy",
            metavar="RAD",
            help="Largest error of q and qd over the whole run; chooses method and tolerance.",
        ),
    ] = None,
    estimate_error: Annotated[
        bool,
        typer.Option("--estimate-error", help="Run again, 100 times as tight: the error's size."),
    ] = False,
    order: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--order", metavar="N", help="Order of the Taylor series. Default: by the tolerance."
        ),
    ] = None,
    engine: Annotated[
        Engine,
        typer.Option("--engine", help="Of the Taylor series; auto compiles runs of over a second."),
    ] = Engine.auto,
    stabilize: Annotated[
        Stabilize, typer.Option("--stabilize", help="What keeps loops closed.")
    ] = Stabilize.projection,
    baumgarte_rate: Annotated[
        float, typer.Option("--baumgarte-rate", metavar="1/S", help="Decay rate of a gap.")
    ] = 20.0,
    assemble: Annotated[
        bool, typer.Option("--assemble", help="Correct a start that does not close.")
    ] = False,
    max_evals: Annotated[
        int, typer.Option("--max-evals", metavar="N", help="Give up after so many evaluations.")
    ] = MAX_EVALUATIONS,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no summary.")] = False,
    report: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--report", metavar="FILE", help="Write the summary as JSON.", callback=named),
    ] = None,
    out: Out = None,
) -> None:
    """The motion that torques cause, as CSV.

    Columns: t, q1.., qd1.., qdd1.., tau1.. of the actuated joints, for each closure the pin force
    fx1,fy1 on the side named first, the energy (J) and, with loops, the gap (m).  Rows at 0, every
    so often, and always at the end.  A summary goes to stderr.  A run that does not finish writes
    what it computed and exits with 1.

    \b
    Examples:
      robodyn simulate robots/2r.yaml --q 30deg,45deg --time 10 > motion.csv
      robodyn simulate robots/four-bar.yaml --q 60deg --tau "2*sin(3*t)" --every 0.01 -o run.csv
      robodyn simulate robots/2r.yaml --q 0,0 --quiet | robodyn torque robots/2r.yaml - | tail -1
    """
    mechanism = load(model)
    if accuracy is not None and (rtol is not None or atol is not None):
        raise InputError("--accuracy and --rtol, --atol", limit="exclude each other")
    settings = Settings(
        Method.DOP853.value if method is None else method.value,
        DEFAULT_TOLERANCE if rtol is None else rtol,
        DEFAULT_TOLERANCE if atol is None else atol,
        stabilize.value,
        baumgarte_rate,
        max_evaluations=max_evals,
        order=order,
        engine=engine.value,
    )
    with _named_options():
        settings.check()
    times = output_times(duration, every, points)
    torques = _torques(mechanism, tau, tau_from, duration)
    start = [Quantity("q", q, True), Quantity("qd", qd)]
    if assemble:
        state, moved = assembled_state(mechanism, start)
        note(f"assembled: joints moved by up to {moved[0]:.3g} rad and {moved[1]:.3g} rad/s")
    else:
        state = single_state(mechanism, start)
    begin = np.concatenate(state)
    estimate: float | None = None
    if accuracy is not None:
        from robodyn.accuracy import AUTO, settings_for

        wanted = replace(settings, method=AUTO) if method is None else settings
        with _named_options(), remarks():
            settings, estimate = settings_for(mechanism, begin, duration, torques, wanted, accuracy)
    elif estimate_error:
        from robodyn.accuracy import error_estimate

        with remarks():
            estimate = error_estimate(mechanism, begin, duration, torques, settings)
    if report is not None and same_file(report, out):
        raise InputError("--report", value=report, limit="must not be where the rows go (--out)")

    with open_output(out, partial=lambda name: note(f"what was computed is in {name}")) as stream:

        @cache
        def writer() -> Writer:  # a run that cannot start writes no header
            return Writer(stream, _columns(mechanism))

        def sink(t: np.ndarray, y: np.ndarray) -> None:
            writer().write_columns(_rows(mechanism, torques, t, y))

        with nullcontext() if report is None else open_output(report) as file:
            with _named_options(), remarks(), _watching(duration, quiet) as watch:
                outcome, facts = run(
                    mechanism, begin, duration, torques, settings, sink, times, watch
                )
            if estimate is not None and math.isfinite(estimate):
                facts.error_estimate = estimate
            writer()
            if file is not None:
                file.write((json.dumps(asdict(facts), indent=2) + "\n").encode())
        if not quiet:
            _summary(mechanism, facts)
            if estimate_error and facts.error_estimate is None:
                note("error of q and qd: not estimated, as no tighter run finishes")
        if outcome is not Outcome.FINISHED:
            stream.flush()
            where = f"{facts.outcome} at t = {facts.t_reached:.6g} s of {duration:g} s"
            raise UnfinishedError(where, limit=outcome.advice)


@contextmanager
def _named_options() -> Iterator[None]:
    """A setting that is refused is named as its option."""
    try:
        yield
    except InputError as error:
        if error.what in SETTINGS:
            error.what = "--" + error.what.replace("_", "-").replace(" ", "-")
        raise


def _columns(mechanism: Mechanism) -> list[str]:
    joints = range(1, mechanism.n + 1)
    names = ["t", *(f"{name}{k}" for name in ("q", "qd", "qdd") for k in joints)]
    names += [f"tau{k + 1}" for k in mechanism.actuated]
    names += loop_columns(mechanism)
    return [*names, "energy", *(["gap"] if mechanism.rows else [])]


def _rows(mechanism: Mechanism, torques: Actuation, t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The columns' values (T, columns) at times and states."""
    n = mechanism.n
    q, qd = y[:, :n], y[:, n:]
    tau = applied_torques(mechanism, torques, t, y)
    solution = forward_dynamics_and_forces(mechanism, q, qd, tau)
    forces = loop_forces(mechanism, solution.multipliers)
    energy = closed_form.kinetic_energy(mechanism, q, qd)
    energy = energy + closed_form.potential_energy(mechanism, q)
    parts = [t[:, None], y, solution.qdd, tau[:, list(mechanism.actuated)], forces, energy[:, None]]
    if mechanism.rows:
        gap = np.linalg.norm(closed_form.closure_gap(mechanism, q), axis=-1)
        parts.append(gap[:, None])
    return np.concatenate(parts, axis=-1)


def _torques(
    mechanism: Mechanism, tau: str | None, tau_from: str | None, duration: float
) -> Actuation:
    if tau is not None and tau_from is not None:
        raise InputError("--tau and --tau-from", limit="exclude each other")
    if tau is not None:
        return actuation.expressions(mechanism, tau, "--tau")
    if tau_from is None:
        return Actuation((0.0,) * mechanism.n)
    names = ["t", *(f"tau{k + 1}" for k in mechanism.actuated)]
    with open_input(tau_from) as (stream, name):
        blocks = [chunk.values for chunk in Reader(stream, name).chunks(names)]
    values = np.concatenate(blocks) if blocks else np.zeros((0, len(names)))
    return actuation.table(
        mechanism, values[:, 0].tolist(), values[:, 1:].tolist(), where=name, until=duration
    )


@contextmanager
def _watching(duration: float, quiet: bool) -> Iterator[Callable[[float], bool]]:
    """A watch for the run: moves a progress bar, and asks it to stop after Ctrl-C."""
    stopped: list[int] = []

    def stop(number: int, _: object) -> None:
        if stopped:  # a second Ctrl-C does not wait for the step to end
            raise KeyboardInterrupt
        stopped.append(number)

    begun = time.monotonic()
    shows = sys.stderr.isatty() and not quiet and duration != 0.0
    bar: list[tuple[Progress, TaskID]] = []

    def watch(t: float) -> bool:
        if shows and time.monotonic() - begun > SILENT:
            if not bar:
                bar.append(_progress_bar())
            bar[0][0].update(bar[0][1], completed=t / duration)
        return bool(stopped)

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield watch
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if bar:
            bar[0][0].stop()


def _progress_bar() -> tuple[Progress, TaskID]:
    from rich.console import Console
    from rich.progress import Progress

    progress = Progress(console=Console(stderr=True), transient=True)
    task = progress.add_task("simulating", total=1.0)
    progress.start()
    return progress, task


def _summary(mechanism: Mechanism, facts: Report) -> None:
    drift = "energy balance" if facts.work else "energy drift"
    lines = [
        f"{facts.outcome}: t = {facts.t_reached:.6g} s, {facts.method} (rtol {facts.rtol:g}, "
        f"atol {facts.atol:g}), {facts.steps} steps, {facts.evaluations} evaluations, "
        f"{facts.seconds:.3g} s",
        f"{drift}: {facts.energy_drift:.2g} of the {facts.energy_in_motion:.4g} J in motion"
        + (f"; work done {facts.work:.6g} J" if facts.work else ""),
    ]
    if mechanism.rows:
        lines.append(
            f"largest gap: {facts.largest_gap:.2g} m, {facts.largest_gap_rate:.2g} m/s "
            f"({facts.stabilize})"
        )
    if facts.error_estimate is not None:
        lines.append(f"error of q and qd: {facts.error_estimate:.2g} at most, by a tighter run")
    if facts.hint:
        lines.append(facts.hint)
    if facts.nearest_singular is not None and facts.nearest_singular_time is not None:
        lines.append(
            f"nearest to singular: {facts.nearest_singular:.3g} at "
            f"t = {facts.nearest_singular_time:.6g} s (least singular value of Psi, relative)"
        )
    note("\n".join(lines))
