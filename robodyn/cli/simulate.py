"""`robodyn simulate`: forward simulation to CSV."""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import cache
from typing import Annotated, Optional

import numpy as np
import typer

from robodyn.cli.files import output_file
from robodyn.cli.integrator_options import (
    Accuracy,
    Atol,
    BaumgarteRate,
    EstimateError,
    Integrator,
    MaxEvals,
    MaxStep,
    Order,
    Rtol,
    SeriesEngine,
    Stabilizer,
    named_options,
)
from robodyn.cli.options import Model, Q, Qd
from robodyn.cli.output import note
from robodyn.cli.run_summary import tell
from robodyn.cli.states import Quantity, assembled_state, loop_columns, remarks, single_state
from robodyn.cli.times import output_times
from robodyn.cli.torque_options import (
    Control,
    ControlModel,
    ControlRate,
    Kd,
    Kp,
    Tau,
    TauFrom,
    TauMax,
    TorqueOptions,
    Track,
    torque_source,
)
from robodyn.cli.watching import watching
from robodyn.dynamics import closed_form
from robodyn.dynamics.dynamics import forward_dynamics_and_forces, loop_forces
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.simulation.recording import Outcome
from robodyn.simulation.simulation import MAX_EVALUATIONS, Settings, applied_torques, run
from robodyn.tables.output_file import open_output
from robodyn.tables.table_writer import Writer

DEFAULT_TOLERANCE = 1e-9


class UnfinishedError(RobodynError):
    """The run ended before its end time; its outcome is the message."""


def simulate(
    model: Model,
    q: Q = None,
    qd: Qd = None,
    duration: Annotated[
        Optional[float],  # noqa: UP045 (typer reads the annotation at run time)
        typer.Option(
            "--time",
            metavar="S",
            help="End time, s; negative runs backwards. Default: 10, or the end of --track.",
        ),
    ] = None,
    every: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--every", metavar="S", help="Time between rows, s.", show_default=False),
    ] = None,
    points: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--points", metavar="N", help="Number of rows. Default: 1001."),
    ] = None,
    tau: Tau = None,
    tau_from: TauFrom = None,
    control: Control = None,
    track: Track = None,
    kp: Kp = None,
    kd: Kd = None,
    tau_max: TauMax = None,
    control_rate: ControlRate = None,
    control_model: ControlModel = None,
    method: Integrator = None,
    rtol: Rtol = None,
    atol: Atol = None,
    max_step: MaxStep = math.inf,
    accuracy: Accuracy = None,
    estimate_error: EstimateError = False,
    order: Order = None,
    engine: SeriesEngine = "auto",
    stabilize: Stabilizer = "projection",
    baumgarte_rate: BaumgarteRate = 20.0,
    assemble: Annotated[
        bool, typer.Option("--assemble", help="Correct a start that does not close.")
    ] = False,
    max_evals: MaxEvals = MAX_EVALUATIONS,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no summary.")] = False,
    report: Annotated[
        Optional[str],  # noqa: UP045
        output_file("--report", help="Write the summary as JSON."),
    ] = None,
    out: Annotated[
        Optional[str],  # noqa: UP045
        output_file("--out", "-o", help="Write here, all or nothing.", kept=True),
    ] = None,
) -> None:
    """The motion that torques cause, as CSV.

    Columns: t, q1.., qd1.., qdd1.., tau1.. of the actuated joints, for each closure the pin force
    fx1,fy1 on the side named first, the energy (J), with loops the gap (m), with --control the
    tracking errors e1.. (rad).  Rows at 0, every so often, and always at the end.  A summary goes
    to stderr.  A run that does not finish writes what it computed and exits with 1.

    With e = q_ref - q and ed = qd_ref - qd the controllers are pd: tau = kp e + kd ed; pd+g: that
    and the torque that holds the control model at rest at q; computed-torque: the torque that
    accelerates the control model by qdd_ref + kd ed + kp e.

    \b
    Examples:
      robodyn simulate robots/2r.yaml --q 30deg,45deg --time 10 > motion.csv
      robodyn simulate robots/four-bar.yaml --q 60deg --tau "2*sin(3*t)" --every 0.01 -o run.csv
      robodyn simulate robots/2r.yaml --q 0,0 --quiet | robodyn torque robots/2r.yaml - | tail -1
      robodyn trajectory robots/2r.yaml --from 0,0 --to 90deg,45deg --time 2 > ref.csv
      robodyn simulate robots/2r.yaml --q 0,0 --track ref.csv --control pd+g --kp 200,100 \\
        --kd 30,10 --tau-max 40
      robodyn simulate robots/2r.yaml --q 0,0 --track ref.csv --control computed-torque \\
        --kp 100 --kd 20 --control-rate 100 --control-model believed.yaml
    """
    mechanism = load(model)
    if accuracy is not None and (rtol is not None or atol is not None):
        raise InputError("--accuracy and --rtol, --atol", limit="exclude each other")
    settings = Settings(
        "DOP853" if method is None else method,
        DEFAULT_TOLERANCE if rtol is None else rtol,
        DEFAULT_TOLERANCE if atol is None else atol,
        stabilize,
        baumgarte_rate,
        max_evaluations=max_evals,
        order=order,
        engine=engine,
        max_step=max_step,
    )
    with named_options():
        settings.check()
    given = TorqueOptions(
        tau, tau_from, control, track, kp, kd, tau_max, control_model, control_rate
    )
    torques, duration = torque_source(mechanism, given, duration)
    times = output_times(duration, every, points)
    start = [Quantity("q", q, True), Quantity("qd", qd)]
    if assemble:
        state, moved = assembled_state(mechanism, start)
        note(f"assembled: joints moved by up to {moved[0]:.3g} rad and {moved[1]:.3g} rad/s")
    else:
        state = single_state(mechanism, start)
    begin = np.concatenate(state)
    estimate: float | None = None
    if accuracy is not None:
        from robodyn.simulation.accuracy import AUTO, settings_for

        wanted = replace(settings, method=AUTO) if method is None else settings
        with named_options(), remarks():
            settings, estimate = settings_for(mechanism, begin, duration, torques, wanted, accuracy)
    elif estimate_error:
        from robodyn.simulation.accuracy import error_estimate

        with remarks():
            estimate = error_estimate(mechanism, begin, duration, torques, settings)
    kept = open_output(out, partial=lambda name: note(f"what was computed is in {name}"))
    with watching(duration, quiet) as watch, kept as stream:

        @cache
        def writer() -> Writer:  # a run that cannot start writes no header
            return Writer(stream, _columns(mechanism, torques))

        def sink(t: np.ndarray, y: np.ndarray) -> None:
            writer().write_columns(_rows(mechanism, torques, t, y))

        with nullcontext() if report is None else open_output(report) as file:
            with named_options(), remarks():
                outcome, facts = run(
                    mechanism, begin, duration, torques, settings, sink, times, watch
                )
            if estimate is not None and math.isfinite(estimate):
                facts.error_estimate = estimate
            writer()
            if file is not None:
                file.write((json.dumps(asdict(facts), indent=2) + "\n").encode())
        if not quiet:
            tell(mechanism, facts)
            if estimate_error and facts.error_estimate is None:
                note("error of q and qd: not estimated, as no tighter run finishes")
        if outcome is not Outcome.FINISHED:
            stream.flush()
            where = f"{facts.outcome} at t = {facts.t_reached:.6g} s of {duration:g} s"
            raise UnfinishedError(where, limit=outcome.advice)


def _columns(mechanism: Mechanism, torques: Actuation) -> list[str]:
    joints = range(1, mechanism.n + 1)
    names = ["t", *(f"{name}{k}" for name in ("q", "qd", "qdd") for k in joints)]
    names += [f"tau{k + 1}" for k in mechanism.actuated]
    names += loop_columns(mechanism)
    names += ["energy", *(["gap"] if mechanism.rows else [])]
    return names + [f"e{k + 1}" for k in mechanism.actuated if torques.control is not None]


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
    if torques.control is not None:
        parts.append(torques.control.errors(t, y))
    return np.concatenate(parts, axis=-1)
