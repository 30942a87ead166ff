"""`robodyn simulate`: forward simulation to CSV."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import numpy as np

from robodyn.cli.files import output_file
from robodyn.cli.options import (
    Extremes,
    Force,
    Format,
    Model,
    Number,
    Out,
    Quiet,
    Text,
    load_with,
    option,
    with_forces,
)
from robodyn.cli.output import default_format, extremes_writer, maker, note, opened, told
from robodyn.cli.signals import watching
from robodyn.cli.simulate_options import (
    ControlOptions,
    EventOptions,
    RunOptions,
    TorqueOptions,
    named,
    torque_source,
)
from robodyn.cli.states import (
    Quantity,
    StateOptions,
    complete,
    option_source,
    remarks,
    single_state,
)
from robodyn.cli.times import Points, output_times
from robodyn.errors import AssemblyError, InputError, RobodynError, at_place
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.pictures.column_units import scene_units, unit_of
from robodyn.simulation.motion_columns import motion_columns, motion_values
from robodyn.simulation.report import Outcome, Report
from robodyn.simulation.run_torques import applied_torques, over_run
from robodyn.simulation.settings import Settings
from robodyn.simulation.simulation import UNTIL, run
from robodyn.tables.csv_fields import quoted, shown
from robodyn.tables.output_file import on_terminal, open_output
from robodyn.tables.table_writer import Writer

if TYPE_CHECKING:
    from robodyn.events.told import Event

_TIME = "End time, s; negative runs backwards. Default: 10, or the end of --track."
EVENTS_AT_ONCE = 1 << 14  # that are written together
AT_REST = 1e-13  # part of the energy at the start below which nothing moves


class UnfinishedError(RobodynError):
    """The run ended before its end time; its outcome is the message."""


@dataclass(eq=False, repr=False)
class TimeOptions:
    """When it ends, and where the rows are."""

    duration: Number = option(_TIME, "S", flag="--time")
    every: Number = option("Time between rows, s.", "S")
    points: Points = None


@dataclass(eq=False, repr=False)
class ResultOptions:
    """What is told, and where."""

    quiet: Quiet = False
    report: Annotated[Text, output_file("--report", help="Write the summary as JSON.")] = None
    extremes: Extremes = False
    out: Out = None

    @property
    def format(self) -> Format:
        return default_format(None, self.out) if self.extremes else "csv"


def simulate(
    model: Model,
    state: StateOptions = StateOptions(),
    when: TimeOptions = TimeOptions(),
    force: Force = None,
    sources: TorqueOptions = TorqueOptions(),
    control: ControlOptions = ControlOptions(),
    events: EventOptions = EventOptions(),
    how: RunOptions = RunOptions(),
    results: ResultOptions = ResultOptions(),
) -> None:
    """The motion that torques cause, as CSV.

    Columns: t, q1.., qd1.., qdd1.., tau1.. of the actuated joints, for each closure the pin force
    fx1,fy1 on the side named first, the energy (J), with loops the gap (m), with --control the
    tracking errors e1.. (rad).  Rows at 0, every so often, and always at the end.  A summary goes
    to stderr.  A run that does not finish writes what it computed and exits with 1.

    --sensitivity adds for each NAME, links.forearm.m or a start value q1 or qd1, the columns
    dq1/NAME.., dqd1/NAME..: d(state)/d(NAME) at a fixed time, by differences of 7 runs at most.
    Start values of other actuated joints are held, passive joints follow, and a controller keeps
    its model.  The summary has their errors; cells are empty from where no derivative is found.

    An event happens when a comparison becomes true, or a function of t, q1.., qd1.. passes zero;
    what holds at the start is none.  Its time is found to rounding.

    With e = q_ref - q and ed = qd_ref - qd the controllers are pd: tau = kp e + kd ed; pd+g: that
    and the torque that holds the control model at rest at q; computed-torque: the torque that
    accelerates the control model by qdd_ref + kd ed + kp e; pid: that of pd and ki z,
    zd = e - (what a limit cuts off)/kp; state-feedback: tau0 - gain [x - x0; xd], at a pose x0.

    \b
    Examples:
      robodyn simulate 2r --q 30deg,45deg --time 10 > motion.csv
      robodyn simulate four-bar --q 60deg --tau "2*sin(3*t)" -o run.csv
      robodyn simulate 2r --q 0,0 --until "q1 < -90deg" --event apex=qd1
      robodyn simulate 2r --q 0,0 --quiet | robodyn torque 2r - | tail -1
      robodyn simulate 2r --q 0,0 --force forearm=0,-20 --extremes
      robodyn simulate 2r --q 0,0 --time 1 --sensitivity links.forearm.m,q1
      robodyn trajectory 2r --from 0,0 --to 90deg,45deg --time 2 > ref.csv
      robodyn simulate 2r --q 0,0 --track ref.csv --control pd+g --kp 200,100 \\
        --kd 30,10 --tau-max 40
      robodyn simulate 2r --q 0,0 --track ref.csv --control computed-torque \\
        --kp 100 --kd 20 --control-rate 100 --control-model believed.yaml
      robodyn simulate 2r --q 0,0 --hold 90deg,0 --control pid --kp 80,20 \\
        --kd 16,1 --ki 60,20
    """
    mechanism = load_with(model, force)
    settings = how.settings()
    torques, duration = torque_source(mechanism, sources, control, when.duration)
    watched = events.watch(mechanism, duration)
    times = output_times(duration, when.every, when.points)
    begin = _start(mechanism, state.quantities(), how.assemble)
    settings, estimate = _accurate(mechanism, begin, duration, torques, settings, how)
    with named():
        torques = over_run(mechanism, torques, begin, duration, settings.atol)
    slopes = None
    if how.sensitivity is not None:
        slopes = _Slopes(how.sensitivity, mechanism, begin, partial(with_forces, forces=force))
    among_rows = on_terminal(results.out) and not results.extremes  # a bar would be in their lines
    with (
        watching(duration, results.quiet or among_rows) as watch,
        opened(results.out or "-", "what was computed is in", results.format) as stream,
        opened(events.events, "the events up to there are in") as table,
    ):
        rows = _Rows(mechanism, torques, slopes, results, stream)
        given = mechanism, begin, duration, torques, settings, rows.write, times, watch, watched
        with named():
            outcome, facts = _told(given, rows, estimate, results, table)
        if not results.quiet:
            _summary(mechanism, facts, events.until)
            if _only_rounding_moves(mechanism, begin, torques):
                note("it starts at rest, and unstable: only rounding moves it")
            if how.estimate_error and facts.error_estimate is None:
                note("error of q and qd: not estimated, as no tighter run finishes")
        elif slopes is not None:
            for line in slopes.withheld:
                note(line)
        if outcome not in (Outcome.FINISHED, Outcome.EVENT, Outcome.LIMIT):
            stream.flush()
            where = f"{facts.ended_by or facts.outcome} at t = {facts.t_reached:.6g} s"
            raise UnfinishedError(f"{where} of {duration:g} s", limit=facts.advice)


def _start(mechanism: Mechanism, start: Sequence[Quantity], assemble: bool) -> np.ndarray:
    """q and qd (2n,) at the start, or of the nearest closed state, which is told.

    Raises AssemblyError where the loops do not close near the given angles.
    """
    sources = [option_source(mechanism, quantity) for quantity in start]
    if not (assemble and sources[0].whole and mechanism.rows):
        q, qd = given, rates = single_state(mechanism, start)
    else:
        from robodyn.loops import assembly, loop_rates

        given, rates = (np.array(source.values) for source in sources)
        q = assembly.close_positions(mechanism, given)
        if (fault := loop_rates.check_closed(mechanism, q)) is not None:
            raise AssemblyError(f"no closed configuration found near the start: {fault[1].what}")
        if sources[1].whole:
            qd = loop_rates.nearest_velocities(mechanism, q, rates)
            complete(mechanism, sources, [q, qd])  # no motion may have them
        else:
            rates = qd = complete(mechanism, sources, [q, rates])[1]
    if assemble:
        units = ("rad or m", "rad/s or m/s") if mechanism.slides else ("rad", "rad/s")
        ways = (np.abs(q - given).max(), np.abs(qd - rates).max())
        far, fast = (f"{x:.3g} {unit}" for x, unit in zip(ways, units, strict=True))
        note(f"assembled: joints moved by up to {far} and {fast}")
    return np.concatenate([q, qd])


def _only_rounding_moves(mechanism: Mechanism, begin: np.ndarray, torques: Actuation) -> bool:
    """Return whether a run starts at an unstable rest, where all that acts is constant."""
    q, qd = begin[None, : mechanism.n], begin[None, mechanism.n :]
    if qd.any() or torques.constants is None or torques.states:
        return False
    from robodyn.rest.balance import rests

    tau = np.array([torques.constants])
    try:
        if not rests(mechanism, q, qd, tau)[0]:
            return False
    except RobodynError:  # beyond a table nothing rests
        return False
    from robodyn.rest.poses_at_rest import unstable

    return unstable(mechanism, q[0], tau[0])


def _accurate(
    mechanism: Mechanism,
    begin: np.ndarray,
    duration: float,
    torques: Actuation,
    settings: Settings,
    how: RunOptions,
) -> tuple[Settings, float | None]:
    """The settings that are accurate as asked for, and the estimate of the error."""
    if how.accuracy is not None:
        from robodyn.simulation.accuracy import AUTO, settings_for

        wanted = replace(settings, method=how.method or AUTO)
        with named(), remarks():
            return settings_for(mechanism, begin, duration, torques, wanted, how.accuracy)
    if how.estimate_error:
        from robodyn.simulation.accuracy import error_estimate

        with remarks():
            return settings, error_estimate(mechanism, begin, duration, torques, settings)
    return settings, None


class _Slopes:
    """The derivatives of --sensitivity; rows wait for them until the run has ended."""

    def __init__(
        self,
        text: str,
        mechanism: Mechanism,
        begin: np.ndarray,
        forced: Callable[[Mechanism], Mechanism],
    ) -> None:
        from robodyn.simulation.differences import Numbers

        self.names = [name.strip() for name in text.split(",")]
        if not all(self.names) or len(set(self.names)) < len(self.names):
            raise InputError(
                "--sensitivity", value=shown(text) or "''", limit="needs names, each once"
            )
        self.withheld: tuple[str, ...] = ()
        self.kept: list[tuple[np.ndarray, np.ndarray, Mechanism]] = []
        with named(), at_place("--sensitivity", *self.names):
            self.numbers = Numbers(mechanism, self.names, begin, lambda scene: forced(build(scene)))

    def write(self, rows: _Rows, facts: Report, given: tuple[Any, ...]) -> bool:
        """Write the rows with the derivatives; tells whether a signal broke off the runs."""
        from robodyn.simulation.differences import sensitivities, tell

        if not self.kept:
            return False
        settings, watch, events = given[4], *given[-2:]
        t = np.concatenate([t for t, _, _ in self.kept])
        with named(), at_place("--sensitivity", *self.names):
            found = sensitivities(self.numbers, rows.torques, settings, t, watch)
        self.withheld, first = found.withheld, 0
        for t, y, moving in self.kept:
            rows.tell(t, y, moving, found.flat[first : first + len(t)])
            first += len(t)
        tau = applied_torques(rows.mechanism, rows.torques, t[-1:], y[-1:])
        tell(facts, found, events, moving, t, y, tau)
        return found.interrupted


@dataclass(eq=False, repr=False)
class _Rows:
    """Writes the rows of a run, or what is asked for in their place."""

    mechanism: Mechanism
    torques: Actuation
    slopes: _Slopes | None
    results: ResultOptions
    stream: BinaryIO

    @cached_property
    def writer(self) -> Writer:
        """Made with the first row: a run that cannot start writes no header."""
        results, units = self.results, scene_units(self.mechanism)
        make = maker(self.stream, results.format, results.out, units)
        names = motion_columns(self.mechanism, self.torques.control is not None)
        if self.slopes is not None:
            from robodyn.simulation.differences import columns

            names += columns(self.mechanism.n, self.slopes.names)
        return told(make, names, units=units, summary=extremes_writer if results.extremes else None)

    def write(self, t: np.ndarray, y: np.ndarray, moving: Mechanism) -> None:
        """The rows at times t (T,) and states y; `moving` is what moves there."""
        if self.slopes is not None:
            self.slopes.kept.append((t, y, moving))
        else:
            self.tell(t, y, moving, np.zeros((len(t), 0)))

    def tell(self, t: np.ndarray, y: np.ndarray, moving: Mechanism, slopes: np.ndarray) -> None:
        """Write rows with derivatives (T, k), of which those that are nan are empty."""
        n, control = self.mechanism.n, self.torques.control
        tau = applied_torques(self.mechanism, self.torques, t, y)
        rows = [motion_values(self.mechanism, moving, t, y[:, :n], y[:, n : 2 * n], tau)]
        rows += [] if control is None else [control.errors(t, y)]
        values, known = np.concatenate([*rows, slopes], axis=-1), np.isfinite(slopes).all(axis=1)
        first = len(known) if known.all() else int(np.argmin(known))
        self.writer.write_columns(values[:first])
        for row, empty in zip(values[first:].tolist(), ~np.isfinite(slopes[first:]), strict=True):
            row[-len(empty) :] = [
                None if x else y for x, y in zip(empty, row[-len(empty) :], strict=True)
            ]
            self.writer.write_row(row)


def _told(
    given: tuple[Any, ...],
    rows: _Rows,
    estimate: float | None,
    results: ResultOptions,
    table: BinaryIO | None,
) -> tuple[Outcome, Report]:
    """How the run ended and what is told of it, in its report and the table of its events too."""
    mechanism, watched = rows.mechanism, given[-1]
    with nullcontext() if results.report is None else open_output(results.report) as report:
        with named(), remarks():
            outcome, recorder = run(*given)
            facts = recorder.settle()
            if rows.slopes is not None and rows.slopes.write(rows, facts, given):
                outcome = Outcome.INTERRUPTED
                facts.outcome, facts.advice = outcome.label, outcome.advice
        if estimate is not None and math.isfinite(estimate):
            facts.error_estimate = estimate
        rows.writer.close()
        if report is not None:
            import json

            report.write((json.dumps(asdict(facts), indent=2) + "\n").encode())
        if table is not None and watched is not None:
            found = sorted([*watched.found, *recorder.contacts], key=lambda x: abs(x.t))
            _write_events(table, mechanism, found)
    return outcome, facts


def _write_events(stream: BinaryIO, mechanism: Mechanism, found: Sequence[Event]) -> None:
    """Each event: its name, its time and the state there."""
    n = mechanism.n
    columns = ["t", *(f"{name}{k}" for name in ("q", "qd") for k in range(1, n + 1))]
    writer = Writer(stream, columns, ["event"])
    for i in range(0, len(found), EVENTS_AT_ONCE):
        some = found[i : i + EVENTS_AT_ONCE]
        t, y = np.array([x.t for x in some]), np.array([x.y[: 2 * n] for x in some])
        writer.write_rows([quoted(x.name) for x in some], np.column_stack([t, y]))


def _summary(mechanism: Mechanism, facts: Report, until: str | None) -> None:
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
    if facts.outcome == Outcome.LIMIT.label:
        lines.append(f"{facts.ended_by}: {facts.advice}")
    counts = {name: count for name, count in facts.events.items() if name != UNTIL}
    if counts:
        lines.append(f"events: {', '.join(f'{name} {count}' for name, count in counts.items())}")
    for name, error in facts.sensitivity_errors.items():
        lines.append(f"error of derivatives by {name}: about {error:.2g} of the largest")
    for name, slope in facts.until_sensitivity.items():
        lines.append(f"derivative of the time of --until by {name}: {slope:.6g}")
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
