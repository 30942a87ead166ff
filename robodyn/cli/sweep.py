"""`robodyn sweep`: the same simulation or torque at many points."""

from __future__ import annotations

import io
import re
import time
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import MISSING, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from robodyn.cli.files import named as not_empty
from robodyn.cli.files import output_file
from robodyn.cli.large_angles import tell_large_angles
from robodyn.cli.options import Model, Number, Quiet, Text, option, refuse
from robodyn.cli.output import chosen_names, names_in, note, told
from robodyn.cli.progress import progress
from robodyn.cli.simulate import (
    EVENT,
    ControlOptions,
    check_no_control,
    controlled,
    given_of,
    named,
    reference_from,
)
from robodyn.cli.states import remarks, tell_unknown_contacts
from robodyn.control.laws import controller
from robodyn.dynamics.columns import declared, scene_units
from robodyn.dynamics.state import find
from robodyn.errors import InputError, named_options
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.motion_columns import check_span
from robodyn.runs.settings import DEFAULT_POINTS
from robodyn.sweeps import sweep_request
from robodyn.sweeps.resumable_file import ResumableFile
from robodyn.sweeps.row_results import TAKEN
from robodyn.sweeps.sweep_chunks import Rows
from robodyn.sweeps.sweep_plan import EVENTS, RESULTS, Axis, Plan, check
from robodyn.sweeps.sweep_request import Acting, Kind, SweepRequest, lacks_machine_code
from robodyn.sweeps.sweep_workers import PATIENCE, results, without_remarks
from robodyn.tables.csv_fields import shown
from robodyn.tables.output_file import on_terminal, open_output
from robodyn.tables.summaries import correlations
from robodyn.tables.table_writer import Writer

_Q = "Angles of the joints that determine all others, rad. Default: a whole `start`, or zero."
_QDD = "Accelerations of these joints, rad/s^2, for torques. Default: zero."
_TIME = "End time, s; negative runs backwards. Default: 10, or the end of --track."
_OF = "The points of such columns, as `points` has them; repeatable."
_ROWS = f"Even rows of a motion that columns are taken of. Default: {DEFAULT_POINTS}."
_NO_ENGINE = "is no option any more: motions go by machine code where the extra `fast` is"
_STEPS = "A motion gives up after so many."


@dataclass(frozen=True)
class SweepOptions(SweepRequest):
    """Options for what is computed, and at which points."""

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
    engine: Text = option("", hidden=True)


def plan_of(model: Model, given: SweepOptions, control: ControlOptions) -> Plan:
    """Return the plan of a sweep from its options; InputError names a wrong option."""
    refuse(_NO_ENGINE, engine=given.engine)
    scene, acts = model.values(), partial(_acting, given, control)
    return sweep_request.plan_of(scene, model.given, given, acts)


def _acting(
    given: SweepRequest, options: ControlOptions, mechanism: Mechanism, axes: tuple[Axis, ...]
) -> Acting:
    """The reference of torques, or the controller of motions, and the end time."""
    if options.track is None:
        refuse("is for --track", read=options.read)
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
        track = reference_from(mechanism, options)
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


Compute = Callable[[int, Callable[[Rows], object]], object]  # from a chunk on, into what writes
_SCHEDULER = "A Dask scheduler whose workers compute the chunks (the extra `cluster`)."
_LOST = f"How long to wait for a silent scheduler, or one without workers. Default: {PATIENCE:g}."
_COLUMNS = "Exactly these of the columns, in this order, such as q1,tau1."
MOST = 100_000  # points of a sample of which it is told
SHOWN = 3  # numbers that are named
MANY = 1000  # motions, from which on machine code is worth an installation
_OUT = "Write here, by way of FILE.partial, from which a sweep cut off goes on."


@dataclass(frozen=True)
class WorkOptions:
    """Who computes."""

    workers: int | None = option("Threads or processes. Default: processors.", "N")
    scheduler: Text = option(_SCHEDULER, "ADDRESS", callback=not_empty)
    patience: Number = option(_LOST, "S")

    def check(self) -> None:
        """InputError naming the option that is wrong."""
        if self.workers is not None and self.workers < 1:
            raise InputError("--workers", value=self.workers, limit="must be >= 1")
        if self.workers is not None and self.scheduler is not None:
            raise InputError("--workers and --scheduler", limit="exclude each other")
        if self.scheduler is None:
            refuse("is for --scheduler", patience=self.patience)
        if self.patience is not None and not self.patience >= 0.0:
            raise InputError("--patience", value=self.patience, limit="must be >= 0, s")

    def results(self, plan: Plan, begin: int) -> Generator[Rows]:
        """The chunks of the plan from the one that begins; a note tells of the first near miss."""
        patience = PATIENCE if self.patience is None else self.patience
        said = ""
        with closing(results(plan, begin, self.workers, self.scheduler, patience, note)) as chunks:
            for rows in chunks:
                if rows.remark and not said:
                    note(f"Warning: {(said := rows.remark)}")
                yield rows


def sweep(
    model: Model,
    given: SweepOptions,
    control: ControlOptions = ControlOptions(),
    work: WorkOptions = WorkOptions(),
    columns: Text = option(_COLUMNS, "NAMES"),
    quiet: Quiet = False,
    out: Annotated[Text, output_file("--out", "-o", help=_OUT)] = None,
) -> None:
    """The same simulation, or torque, over a grid or a random sample, as one CSV.

    NAME is a joint's start (q1, qd2), constant torque (tau1) or, for torques, acceleration (qdd1),
    or a number of the scene: links.forearm.m, gravity, springs[0].stiffness, ... (an unknown name
    lists them).  The last --vary of a grid changes fastest.  A row has what varies, the results,
    and the outcome; a point without a result has empty fields.  With --out the same command goes
    on with a sweep that was cut off.

    --kind torque --track FILE computes torques along a reference, --control makes motions track
    one, as in `simulate` (its model is MODEL, whatever varies); results are then taken of columns
    of torque, reactions and points, and of the errors e1..: max(tau1), rms(e1).

    \b
    Examples:
      robodyn sweep 2r --vary q1=0:360deg:10deg --vary q2=0:360deg:10deg
      robodyn sweep 2r --vary links.forearm.m=0.5:1.5 --sample 10000 --time 5
      robodyn sweep four-bar --vary q1=0:350deg:36 --kind torque --qd 5
      robodyn sweep four-bar --kind torque --track turn.csv --sample 1000 \\
        --vary "links.coupler.m=normal(1.3,0.02)" \\
        --result "max(tau1),rms(shake_fx)" | \\
        robodyn summary --correlations links.coupler.m
      robodyn sweep 2r --vary qd1=0:10:1001 --scheduler tcp://10.0.0.1:8786
    """
    plan = plan_of(model, given, control)
    work.check()
    with remarks():
        check(plan)
    tell_large_angles(plan.mechanism, model.values)
    if plan.variation.size >= MANY and lacks_machine_code(plan) and not quiet:
        note("Note: the extra `fast` (pip install '.[fast]') makes this hundreds of times faster")
    units, values = dict(scene_units(plan.mechanism)), model.values()
    units |= {x.name: values.unit(x.name) for x in plan.variation.axes if x.name in values}
    only = None if columns is None else _chosen(plan, columns)
    tell_unknown_contacts(plan.mechanism, plan.columns())
    lines = _Lines(plan.columns(), units, only)
    outcomes: Counter[str] = Counter()
    size = plan.variation.size
    what = bool(plan.told) and plan.variation.sample is not None and not quiet and size <= MOST
    seen: list[Any] = []  # the rows, where it is to be told what matters most
    begun = time.perf_counter()
    among_rows = on_terminal(out)  # a bar would be in their lines

    def compute(begin: int, write: Callable[[Rows], object]) -> None:
        first = begin * plan.chunk
        with (
            named_options(("scheduler",)),
            progress("sweeping", quiet or among_rows, 0.0) as show,
            without_remarks(),
            closing(work.results(plan, begin)) as chunks,
        ):
            for rows in chunks:
                write(rows)
                outcomes.update(rows.outcomes)
                seen.extend([rows.values] if what else [])
                show((first + outcomes.total()) / size)

    # devices and pipes are written as they come
    if out in (None, "-") or (Path(out).exists() and not Path(out).is_file()):
        with open_output(out) as stream:
            stream.write(lines.header)
            compute(0, lambda rows: (stream.write(lines.of(rows)), stream.flush()))
    else:
        with ResumableFile(out, lines.header, plan.facts(), size, plan.chunk) as file:
            _go_on(file, plan, compute, lines, outcomes, quiet)
    if not quiet:
        _summary(plan, outcomes, time.perf_counter() - begun)
    if seen and outcomes.total() == size:
        _tell_what_matters(plan, seen)


def _chosen(plan: Plan, text: str) -> list[str]:
    """The names of --columns among the sweep's own; one of a state must be a result first."""
    own = plan.columns()
    for name in (x for x in names_in(text) if x not in own and declared(x)):
        if find(plan.mechanism, name, []):
            result = f"max({name})" if plan.rows or plan.kind == "motion" else name
            limit = f"is a column of states: compute it, --result {result}"
            raise InputError("--columns", value=shown(name), limit=limit)
    return chosen_names(text, own)


def _tell_what_matters(plan: Plan, seen: list[Any]) -> None:
    """The numbers that each result of a sample goes with most, by rank correlations."""
    names = [axis.name for axis in plan.variation.axes]
    for column, row in correlations(plan.columns()[:-1], len(names), seen).items():
        pairs = [(x, name) for x, name in zip(row, names, strict=True) if x is not None]
        pairs.sort(key=lambda pair: -abs(pair[0]))
        parts = ", ".join(f"{name} {x:.2f}" for x, name in pairs[:SHOWN])
        note(f"{column} goes with {parts or 'nothing'} (rank correlation)")


def _go_on(
    file: ResumableFile,
    plan: Plan,
    compute: Compute,
    lines: _Lines,
    outcomes: Counter[str],
    quiet: bool,
) -> None:
    """Compute what the file has not yet; notes tell where it begins, and where it is cut off."""
    size = plan.variation.size
    done = min(file.done * plan.chunk, size)
    if file.doubted:
        text = f"what follows the first {done} points in {file.partial}"
        note(f"Warning: {text} does not match its digests: computed again")
    if done and not quiet:
        note(f"{file.partial} has {done} of {size} points: going on from there")
    try:
        compute(file.done, lambda rows: file.append(lines.of(rows)))
    except BaseException:
        done += outcomes.total()
        note(f"{done} of {size} points are in {file.partial}: the same command goes on")
        raise
    file.finish()


class _Lines:
    """CSV lines as bytes, the header's first; what is missing is empty."""

    def __init__(
        self, columns: Sequence[str], units: Mapping[str, str], only: Sequence[str] | None
    ) -> None:
        self._stream = io.BytesIO()
        self._writer = told(partial(Writer, self._stream), columns, units=units, only=only)
        self.header = self._stream.getvalue()

    def of(self, rows: Rows) -> bytes:
        self._stream.seek(0)
        self._stream.truncate()
        self._writer.write_ended(rows.values, rows.outcomes)
        return self._stream.getvalue()


def _summary(plan: Plan, outcomes: Counter[str], seconds: float) -> None:
    points = outcomes.total()
    counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())
    each = f", {seconds / points * 1e3:.3g} ms each" if points else ""
    engine = f" ({plan.method})" if plan.kind == "motion" else ""
    note(f"{points} points in {seconds:.3g} s{each}{engine}: {counts or 'nothing was left to do'}")
