"""The options of `robodyn simulate`: where torque comes from, how to integrate, what to watch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np

from robodyn.cli.files import input_file, load_scene, model_file, output_file, rows_file
from robodyn.cli.options import EACH, Number, Text, Unwrap, option, refuse, switch
from robodyn.cli.output import note
from robodyn.cli.states import Quantity, Source, complete, option_source, remarks
from robodyn.errors import InputError, at_place, named_options
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import joint_values, scene_units
from robodyn.scene.quantities import parse_vector, value_from
from robodyn.simulation.even_times import DEFAULT_DURATION
from robodyn.simulation.settings import MAX_EVALUATIONS, NO_ENGINE, Method, Settings, Stabilize
from robodyn.simulation.simulation import UNTIL, watched_events

if TYPE_CHECKING:
    from robodyn.control.state_feedback import StateFeedback
    from robodyn.control.tracking import ReferenceTable
    from robodyn.events.watch import EventWatch

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
    """Where torque comes from."""

    tau: Text = option(_TAU, "TORQUES")
    tau_from: Annotated[Text, rows_file("--tau-from", _TAU_FROM)] = None
    volt: Text = option("Voltages of the motors of the actuated joints, V: as --tau.", "VOLTS")


@dataclass(eq=False, repr=False)
class ControlOptions:
    """What makes the torques track a reference."""

    control: Law | None = option("Makes the torques track a reference, or keep to a pose.")
    track: Annotated[Text, rows_file("--track", _TRACK)] = None
    unwrap: Unwrap = False
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
    names = {x.name for x in fields(options)} - {"unwrap", *but}
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
    """How to start and to integrate."""

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
    """What to look for on the way."""

    until: Text = option(_UNTIL, "EXPR")
    event: list[str] | None = option(EVENT, "NAME=EXPR")
    events: Annotated[Text, output_file("--events", help=_EVENTS)] = None

    def watch(self, mechanism: Mechanism, t_end: float) -> EventWatch | None:
        """What watches the run; InputError naming the option that is none."""
        given: dict[str, str] = {}
        if self.event:
            from robodyn.events.functions import named_events

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
            from robodyn.events.watch import EventWatch

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
    sources = [*given_of(options, "tau", "tau_from", "volt"), *given_of(control, "control")]
    if len(sources) > 1:
        raise InputError(" and ".join(sources), limit="exclude each other")
    if control.control is not None:
        from robodyn.control.laws import controller

        arguments, end = controlled(mechanism, control, duration)
        with named():
            return controller(mechanism, **arguments), end
    check_no_control(control)
    end = DEFAULT_DURATION if duration is None else duration
    if options.tau is not None:
        return actuation.expressions(mechanism, options.tau, "--tau"), end
    if options.volt is not None:
        from robodyn.mechanics.voltages import voltages

        return voltages(mechanism, options.volt, "--volt"), end
    if options.tau_from is None:
        return Actuation((0.0,) * mechanism.n), end
    from robodyn.cli.row_files import read_columns

    names = ["t", *(f"tau{k + 1}" for k in mechanism.actuated)]
    values, _, name, _ = read_columns(options.tau_from, lambda *_: names)
    times, torques = values[:, 0].tolist(), values[:, 1:].tolist()
    return actuation.table(mechanism, times, torques, where=name, until=end), end


def controlled(
    mechanism: Mechanism, options: ControlOptions, duration: float | None
) -> tuple[dict[str, Any], float]:
    """The arguments of `controller` by name, and the end time."""
    from robodyn.control.tracking import ReferenceTable

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
    if not mechanism.actuated:
        raise InputError("--control", where=mechanism.source, limit="no joint is actuated")
    believed = None if options.control_model is None else load_scene(options.control_model)
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
        reference = reference_from(mechanism, options.track, options.unwrap)
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
    """What the file tells, at the pose of --at with what holds it there if that is given.

    The pose must close.
    """
    from robodyn.cli.row_files import read_file
    from robodyn.control.state_feedback import read_feedback

    text, name = read_file(file)
    found = read_feedback(mechanism, text, name)
    source = Source(Quantity("q", None), found.q, [], True)
    if at is not None:
        given, name = option_source(mechanism, Quantity("at", at)), "--at"
        source = given._replace(quantity=source.quantity)
    with at_place(name):
        (pose,) = complete(mechanism, [source], [np.array(source.values)])
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


def reference_from(mechanism: Mechanism, file: str, unwrap: bool) -> ReferenceTable:
    """Return the reference of the actuated joints in a file; InputError for jumps of angles.

    With `unwrap` whole turns are taken off these.
    """
    from robodyn.cli.motion_files import without_jumps
    from robodyn.cli.row_files import read_columns
    from robodyn.control.tracking import ReferenceTable

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

    values, names, name, lines = read_columns(file, columns, scene_units(mechanism))
    column = dict(zip(names, values.T, strict=True))
    column = without_jumps(mechanism, column, lines, name, unwrap, names)
    t, *rest = column.values()
    parts = [np.array(rest[k : k + joints]).T for k in range(0, len(rest), joints)]
    given = dict(zip(("q", "qd", "qdd"), parts, strict=False))  # the last may not be there
    return ReferenceTable(t, **given, where=name)
