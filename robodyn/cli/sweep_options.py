"""The options of `robodyn sweep`."""

from __future__ import annotations

import re
from dataclasses import MISSING, dataclass
from functools import partial

from robodyn.cli.options import Model, Number, Text, option
from robodyn.cli.simulate_options import (
    EVENT,
    ControlOptions,
    check_no_control,
    controlled,
    given_of,
    named,
    reference_from,
)
from robodyn.control.laws import controller
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.even_times import DEFAULT_POINTS
from robodyn.simulation.run_torques import check_span
from robodyn.simulation.settings import Engine
from robodyn.sweeps import sweep_request
from robodyn.sweeps.row_results import TAKEN
from robodyn.sweeps.sweep_plan import EVENTS, RESULTS, Plan
from robodyn.sweeps.sweep_request import Acting, Kind, SweepRequest
from robodyn.sweeps.variation import Axis

_Q = "Angles, rad, or 30deg, of the joints that determine all others. Default: zero."
_QDD = "Accelerations of these joints, rad/s^2, for torques. Default: zero."
_TIME = "End time, s; negative runs backwards. Default: 10, or the end of --track."
_OF = "The points of such columns, as `points` has them; repeatable."
_ROWS = f"Even rows of a motion that columns are taken of. Default: {DEFAULT_POINTS}."
_ENGINE = "auto: compiled, with the extra `fast`, from 200 points on."
_STEPS = "A motion gives up after so many."


@dataclass(frozen=True)
class SweepOptions(SweepRequest):
    """What is computed, and at which points."""

    vary: list[str] = option(
        "What varies: NAME=first:last:count, first:last:step (with a unit or a decimal point), "
        "a,b,c, or with --sample low:high, uniform(low,high), normal(mean,deviation). Once for "
        "each NAME.",
        "NAME=VALUES",
        default=MISSING,
    )
    sample: int | None = option("Draw N points at random; no grid.", "N")
    seed: int = option("Of the random sample.", "S", default=SweepRequest.seed)
    kind: Kind = option("Motions, or torques at states.", default=SweepRequest.kind)
    q: Text = option(_Q, "VECTOR")
    qd: Text = option("Rates of these joints, rad/s or 30deg. Default: zero.", "VECTOR")
    qdd: Text = option(_QDD, "VECTOR")
    tau: Text = option("Constant torques of the actuated joints, N m. Default: zero.", "VECTOR")
    time: Number = option(_TIME, "S")
    result: Text = option(
        f"Of motions {', '.join(RESULTS)}, and {EVENTS} with --event. Of torques at a state "
        "columns of torque, reactions, points; of many rows what is taken of one: "
        f"{', '.join(TAKEN)}, max(tau1).",
        "NAMES",
    )
    of: list[str] | None = option(_OF, "[NAME=]POINT")
    points: int | None = option(_ROWS, "N")
    event: list[str] | None = option(EVENT, "NAME=EXPR")
    flip: Text = option("The link whose flip is told. Default: the last.", "LINK")
    rtol: float = option("Relative tolerance of a step.", default=SweepRequest.rtol)
    atol: float = option("Absolute one, rad, rad/s.", default=SweepRequest.atol)
    max_steps: int = option(_STEPS, "N", default=SweepRequest.max_steps)
    engine: Engine = option(_ENGINE, default=SweepRequest.engine)


def plan_of(model: Model, given: SweepRequest, control: ControlOptions) -> Plan:
    """What the options say; InputError naming the option that is wrong."""
    scene, acts = model.values(), partial(_acting, given, control)
    return sweep_request.plan_of(scene, model.given, given, acts)


def _acting(
    given: SweepRequest, options: ControlOptions, mechanism: Mechanism, axes: tuple[Axis, ...]
) -> Acting:
    """The reference of torques, or the controller of motions, and the end time."""
    if options.control is None:
        check_no_control(options, "track")
        if options.track is None:
            return Acting(given.duration)
        if given.kind == "motion":
            raise InputError("--track", limit="needs --control, or --kind torque")
        for flag in given_of(given, "time", "q", "qd", "qdd"):
            raise InputError(f"{flag} and --track", limit="exclude each other")
        joints = [f"{x}{k + 1}" for x in ("q", "qd", "qdd") for k in range(mechanism.n)]
        for axis in (axis for axis in axes if axis.name in joints):
            raise InputError("--vary", value=axis.name, limit="is told by --track")
        track = reference_from(mechanism, options.track, options.unwrap)
        return Acting(given.duration, track, follows=True)
    if given.kind == "torque":
        raise InputError("--control", limit="is for --kind motion")
    if given.tau is not None:
        raise InputError("--tau and --control", limit="exclude each other")
    for axis in (axis for axis in axes if re.fullmatch("tau[0-9]+", axis.name)):
        raise InputError("--vary", value=axis.name, limit="is what --control gives")
    arguments, end = controlled(mechanism, options, given.time)
    if options.control != "state-feedback" and arguments["control_model"] is None:
        arguments["control_model"] = mechanism  # which does not vary
    with named():
        check_span(controller(mechanism, **arguments), end)
    return Acting(end, control=tuple(arguments.items()), follows=options.track is not None)
