"""States from the command line: vectors in options, or rows of a CSV, completed and checked.

For a closed mechanism a vector holds all joints (checked: the loops must be closed) or the
actuated ones only (the rest is assembled).  An option stands for its columns in every row.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.cli.options import (
    AtTime,
    Differentiate,
    Q,
    Qd,
    Read,
    States,
    Unwrap,
    refuse,
    time_from,
)
from robodyn.cli.output import (
    RowOptions,
    Summary,
    names_in,
    note,
    numbers_overflow_in_silence,
)
from robodyn.dynamics.columns import FAMILIES, STATE, column_names, declared, names_of, scene_units
from robodyn.dynamics.joint_vectors import driver_of, full, vector_of_joints
from robodyn.dynamics.named_points import NamedPoint, named_points
from robodyn.dynamics.state import State, find
from robodyn.errors import (
    InputError,
    ResidualError,
    RobodynError,
    SignalError,
    SingularPoseError,
    at_place,
    overflow,
)
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.yaml_values import nearest
from robodyn.tables.csv_fields import shown

if TYPE_CHECKING:
    from robodyn.tables.arrays import Array
    from robodyn.tables.table import Chunk
    from robodyn.tables.table_writer import Writer


class Quantity(NamedTuple):
    """One vector of a state: its name, its option's value, and whether it may be left out."""

    name: str  # q, qd, qdd or tau
    option: str | None
    required: bool = False
    tabled: bool = False  # rows of a table may give it

    def columns(self, joints: Sequence[int]) -> list[str]:
        return [f"{self.name}{k + 1}" for k in joints]


@dataclass(eq=False, repr=False)
class StateOptions:
    """A state by options."""

    q: Q = None
    qd: Qd = None

    def quantities(self, **others: str | None) -> list[Quantity]:
        """q, which must be given, qd, and `others` by their options."""
        tabled = isinstance(self, TableOptions)
        own = [Quantity("q", self.q, True, tabled), Quantity("qd", self.qd)]
        return own + [Quantity(name, option) for name, option in others.items()]


@dataclass(eq=False, repr=False)
class TableOptions(StateOptions, RowOptions):
    """A state by options, or a table of states, and what becomes of its rows."""

    states: States = None
    read: Read = None
    differentiate: Differentiate = False
    unwrap: Unwrap = False
    at_time: AtTime = None

    @property
    def time(self) -> float:
        """The time of rows that do not tell theirs, s."""
        return time_from(self.at_time)

    def write_one(
        self,
        mechanism: Mechanism,
        columns: Sequence[str],
        row: Sequence[float | None],
        only: Sequence[str] | None = None,
    ) -> None:
        """Write the one row of a state by options, if all of it is finite or None."""
        if not all(x is None or math.isfinite(x) for x in row):
            raise overflow()
        with self.writer(columns, units=scene_units(mechanism), only=only) as writer:
            writer.write_row(row)


class Source(NamedTuple):
    """The source of a quantity: an option's values, or columns; of all or the actuated joints."""

    quantity: Quantity
    values: list[float]  # from the option
    columns: list[str]  # from the table; zero values where both are empty
    whole: bool  # all joints, or the actuated ones

    @property
    def given(self) -> bool:
        """Whether it is told at all."""
        return bool(self.columns) or self.quantity.option is not None

    def driven(self, mechanism: Mechanism) -> list[float]:
        """An option's values of the actuated joints."""
        few = driver_of(mechanism, self.quantity.name).actuated
        joints = range(mechanism.n) if self.whole else few
        return [self.values[joints.index(k)] for k in mechanism.actuated]


def option_source(mechanism: Mechanism, quantity: Quantity) -> Source:
    """The source that the quantity's option is; zero, or the scene's start, where there is none."""
    driver = driver_of(mechanism, quantity.name)
    if quantity.option is None:
        if quantity.required and not driver.actuated:  # laws give all joints
            return Source(quantity, [], [], False)
        begin = mechanism.description.begin(driver.actuated) if quantity.required else ()
        if begin:
            return Source(quantity, list(begin), [], False)
        if quantity.required:
            limit = "missing: give it"
            limit += ", or a CSV of states (- for stdin)" if quantity.tabled else ""
            raise InputError(f"--{quantity.name}", limit=limit)
        return Source(quantity, [0.0] * len(driver.actuated), [], False)
    kind = quantity.name if quantity.name in ("qd", "qdd", "tau") else "q"
    values = vector_of_joints(driver, quantity.option, kind, f"--{quantity.name}")
    return Source(quantity, values, [], len(values) == mechanism.n)


def table_source(
    mechanism: Mechanism, quantity: Quantity, header: Sequence[str], source: str
) -> Source:
    """The source in a table with this header, or in the option, which goes first."""
    everything = quantity.columns(range(mechanism.n))
    free = driver_of(mechanism, quantity.name).actuated
    if quantity.option is None and not free and not set(everything) <= set(header):
        return option_source(mechanism, quantity)
    driven = quantity.columns(driver_of(mechanism, quantity.name).actuated)
    present = [name for name in everything if name in header]
    if quantity.option is not None and present:
        limit = f"{source} has the column {present[0]}; leave one of them out"
        raise InputError(f"--{quantity.name}", value=quantity.option, limit=limit)
    if quantity.option is not None or not (present or quantity.required):
        return option_source(mechanism, quantity)
    if present == everything:
        return Source(quantity, [], everything, True)
    if driven and set(driven) == set(present):
        return Source(quantity, [], driven, False)
    missing = [name for name in everything if name not in present]
    from robodyn.tables.csv_fields import columns_told  # only an error pays for the import

    there = columns_told(header, missing[0])
    either = "" if everything == driven else f", or only the actuated joints' {', '.join(driven)}"
    raise InputError(
        f"column {missing[0]} is missing",
        where=source,
        limit=f"needs {', '.join(everything)}{either}; the header has {there}",
    )


def complete(
    mechanism: Mechanism,
    sources: Sequence[Source],
    values: Sequence[Array],
    branches: Sequence[str] | None = None,
    *,
    t: ArrayLike,
) -> list[Array]:
    """q, qd and what else there is for all joints (..., n), at times t (...): see `full`."""
    given = {
        source.quantity.name: (each, source.whole)
        for source, each in zip(sources, values, strict=True)
    }
    told = [x.quantity.name for x in sources if x.quantity.option is not None]
    places = {name: f"--{name}" for name in told}
    return list(full(mechanism, given, branches, places, t=t).values())


def single_state(
    mechanism: Mechanism,
    quantities: Sequence[Quantity],
    branches: Sequence[str] | None = None,
    *,
    t: float,
) -> list[Array]:
    """The one state that the options give at t, completed and checked: each vector (n,)."""
    sources = [option_source(mechanism, quantity) for quantity in quantities]
    found = complete(mechanism, sources, [np.array(x.values) for x in sources], branches, t=t)
    if branches is None:
        note_circuit(mechanism, sources, found[0])
    return found


def note_circuit(mechanism: Mechanism, sources: Sequence[Source], q: Array) -> None:
    """Note if no path of closed poses leads from the scene's start to the assembled pose q (n,)."""
    if mechanism.description.start is None or not mechanism.rows or sources[0].whole:
        return
    from robodyn.loops.circuits import blocked

    if told := blocked(driver_of(mechanism), q):
        note(f"Note: {told}")


class Task(NamedTuple):
    """What is computed of rows, from which quantities, and which columns are written.

    `compute` takes the quantities (T, n) by name, and where the scene's loads depend on the time t
    (T,): the column t of a table, else zero.  Of the quantities in `either` it takes those that are
    given, the first where none is.  Columns with `gaps` may be NaN, which is an empty field.
    """

    quantities: Sequence[Quantity]
    columns: Sequence[str]
    compute: Callable[..., Array]
    either: Sequence[Quantity] = ()
    gaps: Sequence[bool] = ()
    only: Sequence[str] | None = None  # written, in this order; else all, behind those of the table

    def taken(self, mechanism: Mechanism, header: Sequence[str]) -> list[Quantity]:
        """The quantities that options or the header give."""
        there, joints = set(header), range(mechanism.n)
        given = [x for x in self.either if x.option is not None or there & set(x.columns(joints))]
        return [*self.quantities, *(given or self.either[:1])]


def state_rows(
    mechanism: Mechanism,
    options: TableOptions,
    quantities: Sequence[Quantity],
    columns: Sequence[str],
    *,
    either: Sequence[Quantity] = (),
    of: Sequence[NamedPoint] = (),
    adds: bool = False,
    summary: Summary | None = None,
    advice: str = "",
) -> None:
    """Write `columns`, or those of --columns, of a state or of each row of a table: see `evaluate`.

    `of` are the points that the columns are of.  `advice` ends the error for a motion that the
    mechanism does not make.
    """

    def task(header: Sequence[str]) -> Task:
        points, computed, only, acting = list(of), list(columns), None, list(either)
        if options.columns is not None:
            points = points or named_points(mechanism)
            only, computed = chosen_columns(mechanism, options.columns, columns, header, points)
            points = [x for x in points if any(name.startswith(f"{x.name}_") for name in computed)]
        else:
            tell_unknown_contacts(mechanism, computed)
        families = [find(mechanism, name, points) for name in computed]
        needs = {need for family in families if family for need in family.needs.split()}
        if not needs.isdisjoint(("qdd", "tau")) and not {"qdd", "tau"} & {
            x.name for x in [*quantities, *either]
        }:
            acting = [Quantity("qdd", None), Quantity("tau", None)]
        forces = FAMILIES["reactions"] in families
        compute = _of_states(mechanism, computed, points, advice, forces)
        gaps = [family is not None and family.gaps for family in families]
        return Task(quantities, computed, compute, acting, gaps, only)

    evaluate(mechanism, options, task, adds, summary)


def _of_states(
    mechanism: Mechanism,
    columns: Sequence[str],
    points: Sequence[NamedPoint],
    advice: str,
    forces: bool,
) -> Callable[..., Array]:
    """A function of motions that gives the columns; of `forces` it tells which are not unique."""
    named = False

    def compute(**motion: Any) -> Array:
        nonlocal named
        state = State(mechanism, **motion, of=points)
        with warnings.catch_warnings(record=True) as told:
            try:
                values: Array = state.columns(columns)
            except ResidualError as error:
                error.limit += advice
                raise
        for warning in told:
            warnings.warn(warning.message, stacklevel=2)
        if told and forces and mechanism.rows and not named:
            from robodyn.dynamics.dynamics import RobodynWarning
            from robodyn.dynamics.reaction_forces import names_not_unique

            if names := names_not_unique(mechanism, state.q, state.t):
                named = True
                warnings.warn(f"not unique: {names}", RobodynWarning, stacklevel=2)
        return values

    return compute


def tell_unknown_contacts(mechanism: Mechanism, columns: Iterable[str]) -> None:
    """Note which laws between links lack the place of their contact, if columns are reactions."""
    lacking = [
        (c, coupling.law)
        for c, coupling in enumerate(mechanism.description.couplings)
        if coupling.law is not None and coupling.others and coupling.cam is None
    ]
    if not lacking:
        return
    words = re.findall(r"\w+", " ".join(columns))  # as a target is an expression of columns
    if {*column_names(mechanism, ["reactions", "slide_moments"])}.isdisjoint(words):
        return
    for c, law in lacking:
        told = f"couplings[{c}] = {law.text} has no `cam`, so that the force of its contact on"
        note(f"Note: {told} bearings is not known: reactions lack it")


def chosen_columns(
    mechanism: Mechanism,
    text: str,
    computed: Sequence[str],
    header: Sequence[str],
    points: list[NamedPoint],
) -> tuple[list[str], list[str]]:
    """The columns that --columns names, and those among them that are to be computed.

    A name is that of a column which the command computes, of the input, of any other that the
    scene has, or of a family, which stands for its columns, of the `points`.  Others that are named
    so are added to these.  Raises InputError with the nearest names for another.
    """
    only: list[str] = []
    own: list[str] = []
    of_families = tuple(points)
    for name in names_in(text):
        family = FAMILIES.get(name)
        if name in computed or (name not in header and find(mechanism, name, points)):
            names = [name]
        elif name in header:
            only.append(name)
            continue
        elif family is not None and family.values is not None:
            names = column_names(mechanism, [name], of_families)
            if not names:
                where = mechanism.source
                raise InputError("--columns", where=where, value=name, limit=family.lacking)
        else:
            likely = declared(name)
            if likely and likely[0].values and not names_of(likely[0], mechanism, points):
                limit = likely[0].lacking
                raise InputError("--columns", where=mechanism.source, value=name, limit=limit)
            known = [*header, *computed, *column_names(mechanism, STATE, points), *STATE]
            there = [x for x in STATE if names_of(FAMILIES[x], mechanism, points)]
            limit = f"is no column{nearest(name, list(dict.fromkeys(known)))}"
            limit += f" (this scene has the families {', '.join(there)})"
            raise InputError("--columns", value=shown(name), limit=limit)
        only += names
        own += names
    tell_unknown_contacts(mechanism, own)
    return list(dict.fromkeys(only)), list(dict.fromkeys(own))


def evaluate(
    mechanism: Mechanism,
    options: TableOptions,
    task: Callable[[Sequence[str]], Task],
    adds: bool = False,
    summary: Summary | None = None,
) -> None:
    """Do the task at the state of the options, or at each row of its table, whose header it takes.

    Where it `adds` columns, none of the table is replaced, and a table without rows is refused, as
    it is where there is a `summary` in place of the rows.
    """
    if options.unwrap and not options.differentiate:
        raise InputError("--unwrap", limit="goes with --differentiate")
    if options.states is None:
        if options.differentiate:
            raise InputError("--differentiate", limit="needs STATES with t: rows to go through")
        if options.read is not None:
            raise InputError("--read", value=shown(options.read), limit="needs STATES")
        work = task([])
        with remarks():
            used = work.taken(mechanism, [])
            sources = [option_source(mechanism, quantity) for quantity in used]
            computed = _Computed(mechanism, sources, work, options.time)
            row = computed.at([[]])[0].tolist()
            note_circuit(mechanism, sources, computed.q[0])
            row = [None if math.isnan(x) else x for x in row]
        options.write_one(mechanism, work.columns, row, work.only)
        return

    from robodyn.cli.motion_files import found_rates, taken_at_rest
    from robodyn.cli.row_files import open_rows

    units = scene_units(mechanism)
    with open_rows(options.states, units, options.read) as reader:
        name = reader.source
        work = task(reader.header)
        of_points = (x for x in work.columns if (known := declared(x)) and "P" in known[0].kinds)
        there = next((x for x in of_points if adds and x in reader.header), None)
        if there is not None:
            limit = "is in the table already; give the point another name, --of NAME=POINT"
            raise InputError(f"column {there}", where=name, limit=limit)
        used = work.taken(mechanism, reader.names)
        sources = [table_source(mechanism, x, reader.names, name) for x in used]
        timed = mechanism.timed and "t" in reader.names
        if summary is None:
            stays = ["t", *(x for source in sources for x in source.columns)]
            lost = [x for x in work.columns if x in reader.header and x not in stays]
            note_replaced(lost if work.only is None else [x for x in lost if x in work.only])
        if options.differentiate:
            sources, chunks = found_rates(mechanism, reader, sources, timed, options.unwrap)
        else:
            taken = [x for source in sources for x in source.columns] + ["t"] * timed
            chunks = taken_at_rest(reader, sources, reader.chunks(taken))
        if timed:
            refuse("the rows have a column t", at_time=options.at_time)
        computed = _Computed(mechanism, sources, work, options.time)
        told = options.writer(work.columns, reader.header, units, summary, work.only)
        with remarks(), told as writer:
            if not computed.write(chunks, writer, name) and (adds or writer.needs_rows):
                raise InputError("no rows", where=name, limit="the header is followed by no state")
            if computed.lost and summary is not None:
                raise computed.lost[0]
        if computed.lost:
            raise computed.lost[0]


def note_replaced(names: Sequence[str]) -> None:
    """Note which columns of the input are replaced by computed ones, if any are."""
    if names:
        told = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
        note(f"Note: replaced in the rows: {told}; --read NAME={names[0]} keeps the old")


class _Computed:
    """Computes rows from rows that hold the columns of the sources, and perhaps t at the end."""

    def __init__(
        self,
        mechanism: Mechanism,
        sources: Sequence[Source],
        task: Task,
        time: float,
    ) -> None:
        self.time = time  # of rows without a column t
        self.mechanism, self.sources, self.compute = mechanism, sources, task.compute
        self.whole = np.logical_not(task.gaps) if task.gaps else slice(None)  # without gaps
        self.lost: list[RobodynError] = []  # of the first row without results
        self.q: Array = np.zeros((0, mechanism.n))  # the poses of the rows computed last

    def at(self, rows: Sequence[Sequence[float]] | Array) -> Array:
        """The results (T, k) at rows (T, columns)."""
        values, parts, begin = np.asarray(rows, float), [], 0
        for source in self.sources:
            end = begin + len(source.columns)
            own = values[:, begin:end]
            parts.append(own if source.columns else np.tile(source.values, (len(values), 1)))
            begin = end
        t = np.full(len(values), self.time)
        if self.mechanism.timed and values.shape[1] > begin:
            t = values[:, begin]
        motion = complete(self.mechanism, self.sources, parts, t=t)
        self.q = motion[0]
        given = {x.quantity.name: each for x, each in zip(self.sources, motion, strict=True)}
        if self.mechanism.timed:
            given["t"] = t
        with np.errstate(all="ignore"):
            found = self.compute(**given)
        if not np.isfinite(found[:, self.whole]).all() or np.isinf(found).any():
            if self.mechanism.laws:
                from robodyn.engines.coupling_laws import check_laws

                check_laws(self.mechanism, given["q"], given.get("qd", 0.0 * given["q"]), t)
            if self.mechanism.signals:
                from robodyn.engines.row_values import rows_of
                from robodyn.mechanics.parts import acting

                named = rows_of(acting, self.mechanism)
                named.check_signals(given["q"], given["qd"], given.get("t", 0.0))
            raise overflow()
        return found

    def write(self, chunks: Iterable[Chunk], writer: Writer, name: str) -> int:
        """Write the results behind the rows of a table, and return how many rows there are.

        The results of a row at a singular configuration, or where a load has no value, are empty.
        They do not depend on how the rows are cut into chunks.
        """
        rows = 0
        for chunk in chunks:
            rows += len(chunk.lines)
            try:
                writer.write_rows(chunk.lines, self._streamed(chunk.values))
            except RobodynError:
                # find the row, with those before it written: again, one by one
                for k, line in enumerate(chunk.lines):
                    try:
                        with at_place(f"{name}: line {chunk.line_numbers[k]}"):
                            computed = self._streamed(chunk.values[k : k + 1])
                    except (SingularPoseError, SignalError) as error:
                        self.lost = self.lost or [error]
                        writer.write_empty(line)
                    else:
                        writer.write_rows([line], computed)
        return rows

    def _streamed(self, rows: Array) -> Array:
        """The results (T, k) at rows (T, columns) of a stream, each as if it came alone."""
        from robodyn.engines.formulas import streams

        token = streams.set(True)
        try:
            if len(rows) > 1:
                return self.at(rows)
            return self.at(np.repeat(rows, 2, axis=0))[:1]  # BLAS adds up one in another order
        finally:
            streams.reset(token)


@contextmanager
def remarks() -> Iterator[None]:
    """Warnings of the numerics as notes on stderr, each once."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if str(message) not in seen:
            seen.add(str(message))
            note(f"Warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        numbers_overflow_in_silence()
        warnings.simplefilter("ignore", ResourceWarning)  # of an import that a signal broke off
        warnings.showwarning = show
        yield
