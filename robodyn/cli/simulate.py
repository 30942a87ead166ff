"""`robodyn simulate`: forward simulation to CSV."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, partial
from typing import Annotated, Any, BinaryIO, Literal, get_args

import numpy as np

from robodyn.cli.files import input_file, load_scene, model_file, output_file
from robodyn.cli.motion_files import without_jumps
from robodyn.cli.options import (
    EACH,
    Columns,
    Force,
    Model,
    Number,
    Out,
    Quiet,
    Read,
    Text,
    Unwrap,
    load_with,
    option,
    refuse,
    switch,
    with_forces,
)
from robodyn.cli.output import maker, note, opened, told
from robodyn.cli.progress import watching
from robodyn.cli.row_files import read_columns, read_file
from robodyn.cli.states import (
    Quantity,
    Source,
    StateOptions,
    chosen_columns,
    complete,
    option_source,
    remarks,
    single_state,
)
from robodyn.cli.times import Points, output_times
from robodyn.control.laws import controller
from robodyn.control.state_feedback import StateFeedback, read_feedback
from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics.columns import column_names, result_names, scene_units, unit_of
from robodyn.dynamics.joint_vectors import joint_values
from robodyn.dynamics.named_points import named_points
from robodyn.dynamics.state import State
from robodyn.errors import AssemblyError, InputError, RobodynError, at_place, named_options
from robodyn.loops import assembly, loop_rates
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.mechanics.voltages import voltages
from robodyn.runs.event_functions import named_events
from robodyn.runs.march import run
from robodyn.runs.motion_columns import (
    applied_torques,
    motion_columns,
)
from robodyn.runs.report import Outcome, Report
from robodyn.runs.settings import (
    DEFAULT_DURATION,
    MAX_EVALUATIONS,
    NO_ENGINE,
    Method,
    Settings,
    Stabilize,
)
from robodyn.runs.simulation import UNTIL, watched_events
from robodyn.runs.torques_over_time import over_run
from robodyn.runs.watch import Event, EventWatch
from robodyn.scene.constants import check_apart
from robodyn.scene.quantities import parse_vector, value_from
from robodyn.tables.csv_fields import quoted, shown
from robodyn.tables.output_file import on_terminal, open_output
from robodyn.tables.table_writer import Writer

Law = Literal["pd", "pd+g", "computed-torque", "pid", "state-feedback"]

_TAU = "Torques of the actuated joints, N m: numbers, or expressions in t, q1.., qd1.."
_TAU_FROM = "CSV with t,tau1,.. (- for stdin), interpolated between its rows."
_TRACK = "The reference: CSV with t,q1,.. and perhaps qd1,.., qdd1,.. (- for stdin), then held."
_HOLD = "A set-point in place of it: rad, 90deg, m of the actuated joints."
_KI = f"Gain of its integral, N m/(rad s), of pid and perhaps pd+g: {EACH}."
_GAIN = "JSON with coordinates, q, tau, gain, of state-feedback (- for stdin)."
_AT = "Pose of state-feedback, as --q, with what holds it there. Default: those of --gain."
_MODEL = "Scene that the controller believes. Default: MODEL."


@dataclass(eq=False, repr=False)
class TorqueOptions:
    """Options for the source of torques."""

    tau: Text = option(_TAU, "TORQUES")
    tau_from: Annotated[Text, input_file("--tau-from", _TAU_FROM)] = None
    tau_hold: bool = switch("A row of --tau-from holds until the next one, as samples do.")
    volt: Text = option("Voltages of the motors of the actuated joints, V: as --tau.", "VOLTS")


@dataclass(eq=False, repr=False)
class ControlOptions:
    """Options for a controller that tracks a reference."""

    control: Law | None = option("Makes the torques track a reference, or keep to a pose.")
    track: Annotated[Text, input_file("--track", _TRACK)] = None
    unwrap: Unwrap = False
    read: Read = None
    hold: Text = option(_HOLD, "VECTOR")
    kp: Text = option(f"Gain of the error, N m/rad (computed torque 1/s^2): {EACH}.", "VECTOR")
    kd: Text = option(f"Gain of its rate, N m s/rad (computed torque 1/s): {EACH}.", "VECTOR")
    ki: Text = option(_KI, "VECTOR")
    gain: Annotated[Text, input_file("--gain", _GAIN)] = None
    at: Text = option(_AT, "VECTOR")
    tau_max: Text = option(f"Where the controller's torques are cut off, N m: {EACH}.", "VECTOR")
    control_rate: Text = option("Samples a second, each torque held. Default: continuous.", "HZ")
    control_model: Annotated[Text, model_file("--control-model", _MODEL)] = None


def given_of(options: object, *names: str) -> list[str]:
    """The options among these that are given."""
    found = [name for name in names if getattr(options, name) is not None]
    return ["--" + name.replace("_", "-") for name in found]


def check_no_control(options: ControlOptions, *but: str) -> None:
    """Raise InputError for an option of a controller where there is none."""
    _check_unwrap(options)
    names = {x.name for x in fields(options)} - {"unwrap", "read", *but}
    given = {x.name: getattr(options, x.name) for x in fields(options) if x.name in names}
    refuse(f"needs --control: one of {', '.join(get_args(Law))}", **given)


def _check_unwrap(options: ControlOptions) -> None:
    if options.unwrap and options.track is None:
        raise InputError("--unwrap", limit="goes with --track")


_STEP = "No step is longer, s. Default: none."
_ACCURACY = "Largest error of q and qd over the whole run; chooses method and tolerance."
_SENSITIVITY = "Adds dq1/NAME.., dqd1/NAME..: derivatives by numbers of the scene, start values."


@dataclass(eq=False, repr=False)
class RunOptions:
    """Options for start and integration."""

    method: Method | None = option("Integrator. Default: DOP853; with --accuracy the best.")
    rtol: Number = option("Relative tolerance of a step. Default: 1e-9.")
    atol: Number = option("Absolute tolerance, rad, rad/s. Default: 1e-9.")
    max_step: float = option(_STEP, "S", default=math.inf, show_default=False)
    accuracy: Number = option(_ACCURACY, "RAD")
    estimate_error: bool = switch("Run again, 100 times as tight: the error's size.")
    order: int | None = option("Order of the Taylor series. Default: by the tolerance.", "N")
    engine: Text = option("", hidden=True)
    stabilize: Stabilize = option("What keeps loops closed.", default="projection")
    baumgarte_rate: float = option("Decay rate of a gap.", "1/S", default=20.0)
    assemble: bool = switch("Correct a start that does not close.")
    sensitivity: Text = option(_SENSITIVITY, "NAME,..")
    max_evals: int = option("Give up after so many evaluations.", "N", default=MAX_EVALUATIONS)

    def settings(self) -> Settings:
        """The settings of the run; InputError naming the option that is none."""
        if self.accuracy is not None and (self.rtol is not None or self.atol is not None):
            raise InputError("--accuracy and --rtol, --atol", limit="exclude each other")
        refuse(NO_ENGINE, engine=self.engine)
        chosen = {name: getattr(self, name) for name in ("method", "rtol", "atol", "order")}
        settings = Settings(
            **{name: value for name, value in chosen.items() if value is not None},
            stabilize=self.stabilize,
            baumgarte=self.baumgarte_rate,
            max_evaluations=self.max_evals,
            max_step=self.max_step,
        )
        with named():
            settings.check()
        return settings


_UNTIL = "Ends the run when this becomes true, as q1 > 90deg, or passes zero."
EVENT = "Tells when EXPR passes zero, or becomes true; may be repeated."
_EVENTS = "Writes event,t,q1..,qd1.. of each event as CSV."


@dataclass(eq=False, repr=False)
class EventOptions:
    """Options for events."""

    until: Text = option(_UNTIL, "EXPR")
    event: list[str] | None = option(EVENT, "NAME=EXPR")
    events: Annotated[Text, output_file("--events", help=_EVENTS)] = None

    def watch(self, mechanism: Mechanism, t_end: float) -> EventWatch | None:
        """Return the watch for events of a run; InputError names a wrong option."""
        given: dict[str, str] = {}
        if self.event:
            given = named_events(mechanism, self.event, UNTIL)
        try:
            watch = watched_events(mechanism, given, self.until, t_end)
        except InputError as error:
            if error.where:
                error.where = f"--{error.where}"
            raise
        if watch is None and self.events is not None:
            if not mechanism.switches:
                raise InputError("--events", limit="there are none: give --event or --until")
            watch = EventWatch([], t_end)
        return watch


_GROUPS = (TorqueOptions, ControlOptions, RunOptions)


def named() -> AbstractContextManager[None]:
    """An argument of the numerics that is refused is named as its option."""
    return named_options([field.name for x in _GROUPS for field in fields(x)])


def torque_source(
    mechanism: Mechanism, options: TorqueOptions, control: ControlOptions, duration: float | None
) -> tuple[Actuation, float]:
    """The torques, and the end time: that of the reference where none is given."""
    if options.tau_hold and options.tau_from is None:
        raise InputError("--tau-hold", limit="is for --tau-from")
    if options.tau_from is None and control.track is None:
        refuse("is for --track and --tau-from", read=control.read)
    sources = [*given_of(options, "tau", "tau_from", "volt"), *given_of(control, "control")]
    if len(sources) > 1:
        raise InputError(" and ".join(sources), limit="exclude each other")
    if control.control is not None:
        arguments, end = controlled(mechanism, control, duration)
        with named():
            return controller(mechanism, **arguments), end
    check_no_control(control)
    end = DEFAULT_DURATION if duration is None else duration
    if options.tau is not None:
        return actuation.expressions(mechanism, options.tau, "--tau"), end
    if options.volt is not None:
        return voltages(mechanism, options.volt, "--volt"), end
    if options.tau_from is None:
        return Actuation((0.0,) * mechanism.n), end
    names = column_names(mechanism, ["t", "tau"])
    values, _, name, _ = read_columns(options.tau_from, lambda *_: names, read=control.read)
    times, torques = values[:, 0].tolist(), values[:, 1:].tolist()
    made = actuation.table(mechanism, times, torques, where=name, until=end, hold=options.tau_hold)
    return made, end


def controlled(
    mechanism: Mechanism, options: ControlOptions, duration: float | None
) -> tuple[dict[str, Any], float]:
    """The arguments of `controller` by name, and the end time."""
    law, rate = options.control, None
    assert law is not None
    _check_unwrap(options)
    tracks, feeds = ["track", "hold"], ["gain", "at"]
    aims, others = (feeds[:1], tracks) if law == "state-feedback" else (tracks, feeds)
    refuse(f"is not for --control {law}", **{name: getattr(options, name) for name in others})
    given = given_of(options, *aims)
    if len(given) > 1:
        raise InputError(" and ".join(given), limit="exclude each other")
    if not given:
        limit = f"missing: --control {law} needs it"
        raise InputError(" or ".join(f"--{aim}" for aim in aims), limit=limit)
    believed = None if options.control_model is None else load_scene(options.control_model)
    for x in (mechanism, believed or mechanism):
        refuse_driven(x, f"--control {law}")
    if not mechanism.actuated:
        raise InputError("--control", where=mechanism.source, limit="no joint is actuated")
    gains: dict[str, Any] = {
        name: (
            joint_values(mechanism, text, "tau", "--tau-max")
            if name == "tau_max"
            else parse_vector(text, where=f"--{name}", unit=partial(_units, mechanism, law, name))
        )
        for name in ("kp", "kd", "ki", "tau_max")
        if (text := getattr(options, name)) is not None
    }
    if options.control_rate is not None:
        rate = value_from(options.control_rate, "Hz", "--control-rate")
    end = DEFAULT_DURATION if duration is None else duration
    if options.track is not None:
        reference = reference_from(mechanism, options)
        end = reference.times[-1] if duration is None else duration
        reference = reference.until(end)
    else:
        if options.gain is not None:
            gains["gain"] = _feedback(mechanism, options.gain, options.at)
            source = Source(Quantity("q", None), gains["gain"].q, [], True)
        else:
            source = option_source(mechanism, Quantity("hold", options.hold))
        reference = ReferenceTable.set_point(source.driven(mechanism), end)
    how = {"control_rate": rate, "control_model": believed}
    return {"reference": reference, "control": law, **how, **gains}, end


def _units(mechanism: Mechanism, law: str, name: str, count: int) -> list[str]:
    """The units of so many gains: of each actuated joint, or of the first."""
    accelerates = {"kp": "1/s^2", "kd": "1/s", "ki": "1/s^3"}
    turns = {"kp": "N m/rad", "kd": "N m s/rad", "ki": "N m/(rad s)"}
    slides = {"kp": "N/m", "kd": "N s/m", "ki": "N/(m s)"}
    each = [slides if k in mechanism.slides else turns for k in mechanism.actuated]
    units = [(accelerates if law == "computed-torque" else own)[name] for own in each]
    return [*units, *[""] * count][:count]


def _feedback(mechanism: Mechanism, file: str, at: str | None) -> StateFeedback:
    """Return the feedback in a file, moved to the pose of --at and its holding torques.

    The pose must close.
    """
    text, name = read_file(file)
    found = read_feedback(mechanism, text, name)
    source = Source(Quantity("q", None), found.q, [], True)
    if at is not None:
        given, name = option_source(mechanism, Quantity("at", at)), "--at"
        source = given._replace(quantity=source.quantity)
    with at_place(name):
        (pose,) = complete(mechanism, [source], [np.array(source.values)], t=0.0)
        if at is None:
            return found
        from robodyn.rest.linear_model import linearize

        with remarks():
            model = linearize(mechanism, pose)
            tau = model.tau[list(mechanism.actuated)].tolist()
    pairs = zip(mechanism.actuated, tau, strict=True)
    torques = ", ".join(f"tau{k + 1} = {x:.9g}" for k, x in pairs)
    if model.remark:
        note(f"Note: no torque of the actuated joints holds it at --at: {torques} come nearest")
    elif not np.allclose(tau, found.tau, rtol=1e-9, atol=1e-9):
        note(f"Note: at --at it is held by {torques}")
    return replace(found, q=pose.tolist(), tau=tau)


def reference_from(mechanism: Mechanism, options: ControlOptions) -> ReferenceTable:
    """Return the reference of the actuated joints in --track; InputError for jumps of angles.

    With --unwrap whole turns are taken off these.
    """
    assert options.track is not None
    joints = len(mechanism.actuated)

    def columns(header: Sequence[str], where: str) -> list[str]:
        found = ["t"]
        for name in ("q", "qd", "qdd"):
            wanted = [f"{name}{k + 1}" for k in mechanism.actuated]
            if name == "q" or set(wanted) & set(header):
                found += wanted
            elif name == "qd" and any(f"qdd{k + 1}" in header for k in mechanism.actuated):
                limit = f"qdd{mechanism.actuated[0] + 1} needs it beside itself"
                raise InputError(f"column {wanted[0]} is missing", where=where, limit=limit)
        return found

    values, names, name, lines = read_columns(
        options.track, columns, scene_units(mechanism), options.read
    )
    column = dict(zip(names, values.T, strict=True))
    column = without_jumps(mechanism, column, lines, name, options.unwrap, names)
    t, *rest = column.values()
    parts = [np.array(rest[k : k + joints]).T for k in range(0, len(rest), joints)]
    given = dict(zip(("q", "qd", "qdd"), parts, strict=False))  # the last may not be there
    return ReferenceTable(t, **given, where=name)


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
    """Options for reports."""

    quiet: Quiet = False
    report: Annotated[Text, output_file("--report", help="Write the summary as JSON.")] = None
    columns: Columns = None
    out: Out = None


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
      robodyn simulate disc-cam --q 0 --qd 120 --until "contact1 < 0"
      robodyn simulate 2r --q 0,0 --quiet | robodyn torque 2r - | tail -1
      robodyn simulate 2r --q 0,0 --force forearm=0,-20 | robodyn summary
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
        texts = {"--tau": sources.tau, "--volt": sources.volt, "--until": events.until}
        texts["--event"] = ", ".join(events.event or ())
        constants = mechanism.description.constants
        check_apart(constants, how.sensitivity.split(","), {x: y or "" for x, y in texts.items()})
        slopes = _Slopes(how.sensitivity, mechanism, begin, partial(with_forces, forces=force))
    among_rows = on_terminal(results.out)  # a bar would be in their lines
    with (
        watching(duration, results.quiet or among_rows) as watch,
        opened(results.out or "-", "what was computed is in") as stream,
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
        q, qd = given, rates = single_state(mechanism, start, t=0.0)
    else:
        given, rates = (np.array(source.values) for source in sources)
        q = assembly.close_positions(mechanism, given, t=0.0)
        if (fault := loop_rates.check_closed(mechanism, q, t=0.0)) is not None:
            raise AssemblyError(f"no closed configuration found near the start: {fault[1].what}")
        if sources[1].whole:
            qd = loop_rates.nearest_velocities(mechanism, q, rates, 0.0)
            complete(mechanism, sources, [q, qd], t=0.0)  # no motion may have them
        else:
            rates = qd = complete(mechanism, sources, [q, rates], t=0.0)[1]
    if assemble:
        units = ("rad or m", "rad/s or m/s") if mechanism.slides else ("rad", "rad/s")
        ways = (np.abs(q - given).max(), np.abs(qd - rates).max())
        far, fast = (f"{x:.3g} {unit}" for x, unit in zip(ways, units, strict=True))
        note(f"assembled: joints moved by up to {far} and {fast}")
    return np.concatenate([q, qd])


def _only_rounding_moves(mechanism: Mechanism, begin: np.ndarray, torques: Actuation) -> bool:
    """Return whether a run starts at an unstable rest, where all that acts is constant."""
    q, qd = begin[None, : mechanism.n], begin[None, mechanism.n :]
    if qd.any() or torques.constants is None or torques.states or mechanism.driven:
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
        from robodyn.runs.accuracy import AUTO, settings_for

        wanted = replace(settings, method=how.method or AUTO)
        with named(), remarks():
            return settings_for(mechanism, begin, duration, torques, wanted, how.accuracy)
    if how.estimate_error:
        from robodyn.runs.accuracy import error_estimate

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
        from robodyn.runs.differences import Numbers

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
        from robodyn.runs.differences import sensitivities, tell

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
    """Writes the rows of a run."""

    mechanism: Mechanism
    torques: Actuation
    slopes: _Slopes | None
    results: ResultOptions
    stream: BinaryIO

    def __post_init__(self) -> None:
        """Choose the columns; InputError, before the run, for a name that is none."""
        control, mechanism = self.torques.control, self.mechanism
        # columns that no state tells: errors of a controller, derivatives
        self.given = [] if control is None else column_names(mechanism, ["errors"])
        if self.slopes is not None:
            from robodyn.runs.differences import columns

            self.given += columns(mechanism.n, self.slopes.names)
        self.points = named_points(mechanism)
        self.names = [*motion_columns(mechanism, tracked=False), *self.given]
        if self.results.columns is not None:
            chosen = self.results.columns
            self.names, _ = chosen_columns(mechanism, chosen, self.names, [], self.points)

    @cached_property
    def writer(self) -> Writer:
        """Made with the first row: a run that cannot start writes no header."""
        units = scene_units(self.mechanism)
        return told(maker(self.stream, "csv", self.results.out, units), self.names, units=units)

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
        q, qd, of = y[:, :n], y[:, n : 2 * n], self.points
        state = State(self.mechanism, q, qd, tau=tau, t=t, of=of, moving=moving)
        errors = [] if control is None else [control.errors(t, y)]
        others = [name for name in self.names if name not in self.given]
        each = dict(zip(others, state.columns(others).T, strict=True))
        known = np.where(np.isfinite(slopes), slopes, np.nan)
        each |= dict(zip(self.given, np.concatenate([*errors, known], axis=-1).T, strict=True))
        self.writer.write_columns(np.stack([each[name] for name in self.names], axis=-1))


def _told(
    given: tuple[Any, ...],
    rows: _Rows,
    estimate: float | None,
    results: ResultOptions,
    table: BinaryIO | None,
) -> tuple[Outcome, Report]:
    """Run, and return outcome and report; write the table of events."""
    mechanism, watched = rows.mechanism, given[-1]
    with nullcontext() if results.report is None else open_output(results.report) as report:
        with named(), remarks():
            outcome, record = run(*given)
            facts = record.settle()
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
            found = sorted([*watched.events, *record.contacts], key=lambda x: abs(x.t))
            _write_events(table, mechanism, found)
    return outcome, facts


def _write_events(stream: BinaryIO, mechanism: Mechanism, found: Sequence[Event]) -> None:
    """Each event: its name, its time and the state there."""
    n = mechanism.n
    columns = column_names(mechanism, ["t", "q", "qd"])
    writer = Writer(stream, columns, result_names("event"))
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
