"""`robodyn simulate`: forward simulation to CSV."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import cache
from typing import Annotated, BinaryIO

import numpy as np
from typer import Option

from robodyn.cli.event_options import EventOptions
from robodyn.cli.files import output_file
from robodyn.cli.loads import Force, load_with
from robodyn.cli.options import Degrees, Extremes, Model, Number, Q, Qd, Quiet, Text
from robodyn.cli.output import default_format, degrees_writer, extremes_writer, maker, note
from robodyn.cli.signals import watching
from robodyn.cli.simulate_options import (
    ControlOptions,
    RunOptions,
    TorqueOptions,
    named,
    torque_source,
)
from robodyn.cli.states import Quantity, assembled_state, remarks, single_state
from robodyn.cli.times import Points, output_times
from robodyn.errors import RobodynError
from robodyn.events.watch import Event
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import scene_units, unit_of
from robodyn.simulation.motion_columns import motion_columns, motion_values
from robodyn.simulation.report import Outcome, Report
from robodyn.simulation.run_torques import applied_torques, over_run
from robodyn.simulation.simulation import UNTIL, run
from robodyn.tables.output_file import open_output
from robodyn.tables.table_writer import Writer

AT_REST = 1e-13  # part of the energy at the start below which nothing moves
_TIME = "End time, s; negative runs backwards. Default: 10, or the end of --track."
_OUT = "Write here, all or nothing."


class UnfinishedError(RobodynError):
    """The run ended before its end time; its outcome is the message."""


def simulate(
    model: Model,
    q: Q = None,
    qd: Qd = None,
    duration: Annotated[Number, Option("--time", metavar="S", help=_TIME)] = None,
    every: Annotated[Number, Option("--every", metavar="S", help="Time between rows, s.")] = None,
    points: Points = None,
    force: Force = None,
    sources: TorqueOptions = TorqueOptions(),
    control: ControlOptions = ControlOptions(),
    events: EventOptions = EventOptions(),
    how: RunOptions = RunOptions(),
    quiet: Quiet = False,
    report: Annotated[Text, output_file("--report", help="Write the summary as JSON.")] = None,
    extremes: Extremes = False,
    degrees: Degrees = False,
    out: Annotated[Text, output_file("--out", "-o", help=_OUT, kept=True)] = None,
) -> None:
    """The motion that torques cause, as CSV.

    Columns: t, q1.., qd1.., qdd1.., tau1.. of the actuated joints, for each closure the pin force
    fx1,fy1 on the side named first, the energy (J), with loops the gap (m), with --control the
    tracking errors e1.. (rad).  Rows at 0, every so often, and always at the end.  A summary goes
    to stderr.  A run that does not finish writes what it computed and exits with 1.

    --sensitivity adds for each NAME, links.forearm.m or a start value q1 or qd1, the columns
    dq1/NAME.., dqd1/NAME..: d(state)/d(NAME), as exact as q and qd are, relatively.  What else
    actuated joints start with is held, the passive ones follow, and a controller believes the same.

    An event happens when a comparison becomes true, or a function of t, q1.., qd1.. passes zero;
    what holds at the start is none.  Its time is found to rounding.

    With e = q_ref - q and ed = qd_ref - qd the controllers are pd: tau = kp e + kd ed; pd+g: that
    and the torque that holds the control model at rest at q; computed-torque: the torque that
    accelerates the control model by qdd_ref + kd ed + kp e; pid: that of pd and ki z,
    zd = e - (what a limit cuts off)/kp; state-feedback: tau0 - gain [x - x0; xd], at a pose x0.

    \b
    Examples:
      robodyn simulate robots/2r.yaml --q 30deg,45deg --time 10 > motion.csv
      robodyn simulate robots/four-bar.yaml --q 60deg --tau "2*sin(3*t)" --every 0.01 -o run.csv
      robodyn simulate robots/2r.yaml --q 0,0 --until "q1 < -90deg" --event apex=qd1 > swing.csv
      robodyn simulate robots/2r.yaml --q 0,0 --quiet | robodyn torque robots/2r.yaml - | tail -1
      robodyn simulate robots/2r.yaml --q 0,0 --force forearm=0,-20 --extremes
      robodyn simulate robots/2r.yaml --q 0,0 --time 1 --sensitivity links.forearm.m,q1
      robodyn trajectory robots/2r.yaml --from 0,0 --to 90deg,45deg --time 2 > ref.csv
      robodyn simulate robots/2r.yaml --q 0,0 --track ref.csv --control pd+g --kp 200,100 \\
        --kd 30,10 --tau-max 40
      robodyn simulate robots/2r.yaml --q 0,0 --track ref.csv --control computed-torque \\
        --kp 100 --kd 20 --control-rate 100 --control-model believed.yaml
      robodyn simulate robots/2r.yaml --q 0,0 --hold 90deg,0 --control pid --kp 80,20 \\
        --kd 16,1 --ki 60,20
    """
    mechanism = load_with(model, force)
    settings = how.settings()
    torques, duration = torque_source(mechanism, sources, control, duration)
    watched = events.watch(mechanism, duration)
    times = output_times(duration, every, points)
    start = [Quantity("q", q, True), Quantity("qd", qd)]
    if how.assemble:
        state, moved = assembled_state(mechanism, start)
        each = ("rad or m", "rad/s or m/s") if mechanism.slides else ("rad", "rad/s")
        far, fast = (f"{x:.3g} {unit}" for x, unit in zip(moved, each, strict=True))
        note(f"assembled: joints moved by up to {far} and {fast}")
    else:
        state = single_state(mechanism, start)
    begin = np.concatenate(state)
    estimate: float | None = None
    if how.accuracy is not None:
        from robodyn.simulation.accuracy import AUTO, settings_for

        auto = AUTO if how.sensitivity is None else settings.method
        wanted = replace(settings, method=how.method or auto)
        with named(), remarks():
            settings, estimate = settings_for(
                mechanism, begin, duration, torques, wanted, how.accuracy
            )
    elif how.estimate_error:
        from robodyn.simulation.accuracy import error_estimate

        with remarks():
            estimate = error_estimate(mechanism, begin, duration, torques, settings)
    with named():
        torques = over_run(mechanism, torques, begin, duration, settings.atol)
        carried = None
        if how.sensitivity is not None:
            from robodyn.simulation.sensitivity import with_sensitivities

            wanted_by = [name.strip() for name in how.sensitivity.split(",")]
            carried = with_sensitivities(mechanism, torques, begin, wanted_by, settings.method)
    format = default_format(None, out) if extremes else "csv"
    units = scene_units(mechanism)

    def tell(name: str) -> None:
        note(f"what was computed is in {name}")

    kept = open_output(out, partial=tell, styled=format == "table")
    with watching(duration, quiet) as watch, kept as stream:

        @cache
        def writer() -> Writer:  # a run that cannot start writes no header
            make = maker(stream, format, out, units)
            names = motion_columns(mechanism, torques.control is not None)
            names += carried.columns if carried else []
            if degrees:
                return degrees_writer(units, extremes_writer if extremes else None)(make, names, ())
            return extremes_writer(make, names) if extremes else make(names)

        def sink(t: np.ndarray, y: np.ndarray, moving: Mechanism) -> None:
            rows = _rows(mechanism, moving, torques, t, y)
            if carried:
                rows = np.concatenate([rows, carried.flat(y)], axis=-1)
            writer().write_columns(rows)

        with ExitStack() as files:
            file = None if report is None else files.enter_context(open_output(report))
            table = (
                None if events.events is None else files.enter_context(open_output(events.events))
            )
            with named(), remarks():
                outcome, recorder = run(
                    mechanism,
                    begin,
                    duration,
                    carried.actuation if carried else torques,
                    settings,
                    sink,
                    times,
                    watch,
                    watched,
                )
                facts = recorder.settle()
            if estimate is not None and math.isfinite(estimate):
                facts.error_estimate = estimate
            writer().close()
            if file is not None:
                file.write((json.dumps(asdict(facts), indent=2) + "\n").encode())
            if table is not None and watched is not None:
                found = sorted([*watched.found, *recorder.contacts], key=lambda x: abs(x.t))
                _write_events(table, mechanism, found)
        if not quiet:
            _tell(mechanism, facts, events.until)
            if how.estimate_error and facts.error_estimate is None:
                note("error of q and qd: not estimated, as no tighter run finishes")
        if outcome not in (Outcome.FINISHED, Outcome.EVENT):
            stream.flush()
            what = facts.ended_by or facts.outcome
            where = f"{what} at t = {facts.t_reached:.6g} s of {duration:g} s"
            raise UnfinishedError(where, limit=facts.advice)


def _rows(
    mechanism: Mechanism, moving: Mechanism, torques: Actuation, t: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """The columns' values (T, columns) at times and states; `moving` is what moves there."""
    n = mechanism.n
    tau = applied_torques(mechanism, torques, t, y)
    values = motion_values(mechanism, moving, t, y[:, :n], y[:, n : 2 * n], tau)
    if torques.control is not None:
        values = np.concatenate([values, torques.control.errors(t, y)], axis=-1)
    return values


def _write_events(stream: BinaryIO, mechanism: Mechanism, found: Sequence[Event]) -> None:
    """Each event: its name, its time and the state there."""
    joints = range(1, mechanism.n + 1)
    writer = Writer(stream, ["event", "t", *(f"{name}{k}" for name in ("q", "qd") for k in joints)])
    for event in found:
        writer.write_row([event.name, event.t, *event.y[: 2 * mechanism.n].tolist()])


def _tell(mechanism: Mechanism, facts: Report, until: str | None) -> None:
    """The summary on stderr."""
    moving = facts.energy_in_motion
    drift = f"{facts.energy_drift:.2g} of the {moving:.4g} J in motion"
    if moving <= AT_REST * max(abs(facts.energy_start), moving):
        drift = f"{facts.energy_drift * moving:.2g} J, at rest"
    drift = f"energy {'balance' if facts.work else 'drift'}: {drift}"
    lines = [
        f"{facts.outcome}: t = {facts.t_reached:.6g} s, {facts.method} (rtol {facts.rtol:g}, "
        f"atol {facts.atol:g}), {facts.steps} steps, {facts.evaluations} evaluations, "
        f"{facts.seconds:.3g} s",
        drift + (f"; work done {facts.work:.6g} J" if facts.work else ""),
    ]
    if mechanism.rows:
        lines.append(
            f"largest gap: {facts.largest_gap:.2g} m, {facts.largest_gap_rate:.2g} m/s "
            f"({facts.stabilize})"
        )
    if until is not None:
        way = "ended by" if facts.ended_by == UNTIL else "not met up to the end:"
        lines.append(f"{way} --until {until}")
    counts = {name: count for name, count in facts.events.items() if name != UNTIL}
    if counts:
        lines.append(f"events: {', '.join(f'{name} {count}' for name, count in counts.items())}")
    lines += facts.remarks
    if facts.error_estimate is not None:
        lines.append(f"error of q and qd: about {facts.error_estimate:.2g}, by a tighter run")
    if facts.tracking:
        errors, torques, units = [], [], scene_units(mechanism)
        for k, x in zip(mechanism.actuated, facts.tracking, strict=True):
            unit, of_torque = (unit_of(f"{name}{k + 1}", units) for name in ("e", "tau"))
            size = f"{x.rms:.3g} {unit} rms, {x.largest:.3g} {unit} at most"
            errors.append(f"{x.joint} {size}, at t = {x.at:.6g} s")
            torques.append(f"{x.joint} {x.largest_torque:.6g} {of_torque}")
        lines.append(f"tracking error: {'; '.join(errors)}")
        lines.append(f"largest torque: {', '.join(torques)}")
    if facts.hint:
        lines.append(facts.hint)
    if (
        mechanism.rows
        and facts.nearest_singular is not None
        and facts.nearest_singular_time is not None
    ):
        lines.append(
            f"nearest to singular: {facts.nearest_singular:.3g} at "
            f"t = {facts.nearest_singular_time:.6g} s (least singular value of Psi, relative)"
        )
    if facts.missed:
        lines.append(facts.missed)
    note("\n".join(lines))
