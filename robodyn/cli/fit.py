"""`robodyn fit`: numbers of a scene such that columns follow a table, or vanish."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from typer import Option

from robodyn.cli.files import input_file, output_file, rows_argument
from robodyn.cli.motion_files import tell_at_rest, without_jumps
from robodyn.cli.options import (
    Model,
    OutputStructured,
    Q,
    Qd,
    Qdd,
    Quiet,
    Read,
    Text,
    Unwrap,
    option,
    refuse,
    switch,
)
from robodyn.cli.output import Grid, in_told_units, note, row_writer, write_structure
from robodyn.cli.points import OF, POINTS
from robodyn.cli.progress import progress
from robodyn.cli.row_files import read_columns
from robodyn.cli.states import Quantity, option_source, remarks, tell_unknown_contacts
from robodyn.dynamics.columns import column_names, result_names, scene_units, unit_of
from robodyn.engines.expression import tangents
from robodyn.errors import InputError, at_place, named_options
from robodyn.mechanics.actuation import expressions
from robodyn.mechanics.driven import check_times
from robodyn.mechanics.mechanism import Mechanism
from robodyn.parameters.column_formulas import ColumnFormulas
from robodyn.scene.constants import check_apart
from robodyn.scene.quantities import parse_quantity
from robodyn.scene.rewrite import write_scene
from robodyn.scene.scene_values import SceneValues
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import columns_told, shown

if TYPE_CHECKING:
    from robodyn.parameters.motion_fit import Fit


KINDS = ("q", "qd", "qdd")


class FitRows(NamedTuple):
    """T rows: q, qd, qdd (T, a) of the actuated joints, t (T,), columns (c) and target (T, c).

    `known` (T, k) are the columns `names` that say where rows are, of the file `source`.
    """

    q: Array
    qd: Array
    qdd: Array
    t: Array
    columns: list[str]
    target: Array
    names: list[str]
    known: Array
    source: str = ""


ENERGIES = ("KE", "PE", "energy")  # which are computed, of masses that may be those to find


class FitTable:
    """Reads the rows of a fit: states of the actuated joints, and, to `match`, what is to be met.

    Columns are those to minimize; to match the ones that are named, or all that can be fitted.  Of
    motions (`moving`) q and qd begin it, by options or by the first row.
    """

    def __init__(self, mechanism: Mechanism, options: FitOptions) -> None:
        self.mechanism, self.moving = mechanism, options.simulate
        self.unwrap, self.read = options.unwrap, options.read
        self.match, named = options.match is not None, options.columns
        self.columns = [x for text in options.minimize or () for x in _names(text, "--minimize")]
        self.chosen = None if named is None else _names(named, "--columns")
        tell_unknown_contacts(mechanism, [*self.columns, *(self.chosen or ())])
        self.options = {kind: getattr(options, kind) for kind in KINDS}
        self.formulas = ColumnFormulas(mechanism, [], options.of or ())
        free = self.moving and len(mechanism.passive) > len(mechanism.rows)
        joints = range(mechanism.n) if free else mechanism.actuated  # that a motion begins with
        self.driven = {kind: [f"{kind}{k + 1}" for k in joints] for kind in KINDS}
        self.states: dict[str, list[str]] = {}  # the columns of states that the table has

    def rows(self, table: str | None) -> FitRows:
        """The rows of a table, or the one state that options give."""
        names: Sequence[str] = []
        values, name, lines = np.zeros((1, 0)), "", [0]
        if table is not None:
            values, names, name, lines = read_columns(
                table, self._choose, scene_units(self.mechanism), self.read
            )
        elif self.options["q"] is None:
            raise InputError("--minimize", limit="needs STATES, or --q: where columns are taken")
        column = dict(zip(names, values.T, strict=True))
        if self.moving:
            to_meet = self.columns if self.match else ()
            column = without_jumps(self.mechanism, column, lines, name, self.unwrap, to_meet)

        def taken(names: Sequence[str]) -> Array:
            return np.array([column[x] for x in names]).reshape(len(names), len(values)).T

        state = {
            kind: taken(self.states[kind])
            if kind in self.states
            else np.tile(self._given(kind), (len(values), 1))
            for kind in KINDS
        }
        check_times(self.mechanism, "t" in column, name)
        t = column.get("t", np.zeros(len(values)))
        given = {*self.states, *(kind for kind in KINDS if self.options[kind] is not None)}
        at_rest = not self.moving and np.ptp(t) and given == {"q"}
        if at_rest and _moves(self.formulas, self.columns):
            tell_at_rest(name, ("qd", "qdd"))
        count = len(self.columns)
        target = taken(self.columns) if self.match else np.zeros((len(values), count))
        shown = [x for x in names if x not in self.columns or not self.match or x == "t"]
        known = taken(shown)
        if table is None:
            shown, known = self.driven["q"], state["q"]
        return FitRows(
            **state, t=t, columns=self.columns, target=target, names=shown, known=known, source=name
        )

    def _given(self, kind: str) -> Array:
        """An option's values, of the actuated joints alone unless a motion begins with them."""
        source = option_source(self.mechanism, Quantity(kind, self.options[kind]))
        return np.array(source.values if self.moving else source.driven(self.mechanism))

    def _choose(self, header: Sequence[str], name: str) -> Sequence[str]:
        """The columns that are read of a table."""
        for kind, names in self.driven.items():
            there = [x for x in names if x in header]
            if self.options[kind] is not None:
                if there and not self.moving:
                    limit = f"{name} has the column {there[0]}; leave one of them out"
                    raise InputError(f"--{kind}", value=self.options[kind], limit=limit)
            elif len(there) == len(names):
                self.states[kind] = names
            elif there or kind == "q":
                missing = next(x for x in names if x not in there)
                raise _missing(f"column {missing} is missing", header, missing, name)
        used = [x for names in self.states.values() for x in names]
        used += ["t"] if self.moving or "t" in header else []
        if self.match:
            self.columns = self.chosen or self._fitted(header, name)
            for column in self.columns:
                if column not in header:
                    what = f"column {column} of --columns is missing"
                    raise _missing(what, header, column, name)
            used += self.columns
        return list(dict.fromkeys(used))

    def _fitted(self, header: Sequence[str], name: str) -> list[str]:
        """The columns of a table that can be fitted."""
        states = (x for names in self.states.values() for x in names)
        given = {"t", *(() if self.moving else states)}
        for kind in ("qdd", "tau") if self.moving else KINDS:
            whole = {f"{kind}{k + 1}" for k in range(self.mechanism.n)}
            # what follows in a table of whole states is the old scene's
            given |= whole if self.moving or whole <= set(header) else set()
        energies = set(column_names(self.mechanism, ENERGIES)) - given
        found = [x for x in header if x not in given | energies and self.formulas.serves(x)]
        if not found:
            limit = "has no column that can be fitted besides; "
            limit += f"the header has {columns_told(header)}"
            raise InputError("--match", where=name, limit=limit)
        left = [x for x in header if x not in given | energies and x not in found]
        if left:
            note(f"{name}: {', '.join(left)}: not fitted, as these are no columns of a state")
        if told := [x for x in header if x in energies]:
            note(f"{name}: {', '.join(told)}: not fitted, unless --columns names them")
        return found


def _names(text: str, where: str) -> list[str]:
    found = [name.strip() for name in text.split(",")]
    if not all(found) or len(set(found)) < len(found):
        raise InputError(where, value=shown(text), limit="needs names of columns, each once: A,B")
    return found


def _missing(what: str, header: Sequence[str], column: str, name: str) -> InputError:
    return InputError(what, where=name, limit=f"the header has {columns_told(header, column)}")


def _moves(formulas: ColumnFormulas, columns: Sequence[str]) -> bool:
    """Whether any of the columns depends on rates, accelerations or forces."""
    nodes = [formulas.column(name) for name in columns]
    rates = [x for x in formulas.inputs[formulas.mechanism.n :] if x != "t"]
    return any(tangents(nodes, rates))


Bounds = dict[str, tuple[float, float]]  # of each number by its name
Tell = Callable[[float], object]
_VARY = "A number and its bounds, NAME=LOW:HIGH, named as in `sweep`; repeatable."
_STATES = "CSV file of the rows of --minimize (q1.., qd1.., qdd1..), or - for stdin."
_MATCH = "CSV file whose columns are to be met, at its rows (q1.., t); - for stdin."
_COLUMNS = "Those columns of --match, A,B. Default: all that can be fitted."
_MINIMIZE = "Columns whose sum of squares is to be least at the rows given, A,B; repeatable."
_SUBJECT = "A condition, such as 'links.crank.l + links.rocker.l <= 1.2'; repeatable."
_SIMULATE = "The columns are those of a motion from --q, --qd or the first row, at the times t."
_TAU = "Torques of that motion, as those of `simulate`: numbers, or expressions. Default: zero."
_STARTS = "Where to search from, at random within the bounds. Default: 30, for motions 4."
_RESIDUALS = "In place of the summary, rows: the columns as they are now, and less the wanted."
_OUT = "Write the scene with these numbers here; comments and order stay."


@dataclass(frozen=True)
class FitOptions:
    """Options for targets, objective, and search."""

    match: Annotated[Text, input_file("--match", _MATCH)] = None
    columns: Text = option(_COLUMNS, "NAMES")
    minimize: list[str] | None = option(_MINIMIZE, "COLUMNS")
    subject_to: list[str] | None = option(_SUBJECT, "EXPR")
    of: list[str] | None = option(OF, POINTS)
    q: Q = None
    qd: Qd = None
    qdd: Qdd = None
    simulate: bool = switch(_SIMULATE)
    unwrap: Unwrap = False
    read: Read = None
    tau: Text = option(_TAU, "TORQUES")
    starts: int | None = option(_STARTS, "N")
    seed: int = option("Of the random starts.", "S", default=0)

    def check(self, states: str | None) -> None:
        """InputError for options that do not go together."""
        if (self.match is None) == (not self.minimize):
            limit = "give one of them: columns follow a file, or become least"
            raise InputError("--match and --minimize", limit=limit)
        if self.match is not None and states is not None:
            limit = "is for --minimize; --match has rows itself"
            raise InputError("STATES", value=states, limit=limit)
        if self.match is None:
            refuse("is for --match", columns=self.columns)
            if states is None:
                refuse("needs STATES or --match", read=self.read)
        if self.simulate and self.match is None and states is None:
            raise InputError("--simulate", limit="needs --match or STATES, for its times")
        if not self.simulate:
            refuse("is for --simulate", tau=self.tau)
            if self.unwrap:
                raise InputError("--unwrap", limit="goes with --simulate")

    def rows(self, mechanism: Mechanism, states: str | None) -> FitRows:
        """The rows at which columns are met, or become least."""
        return FitTable(mechanism, self).rows(states if self.match is None else self.match)

    def found(self, mechanism: Mechanism, bounds: Bounds, rows: FitRows, tell: Tell) -> Fit:
        """The numbers within their bounds."""
        common: dict[str, Any] = {
            "target": rows.target,
            "of": self.of or (),
            "subject_to": self.subject_to or (),
            "seed": self.seed,
            "tell": tell,
        }
        if self.starts is not None:
            common["starts"] = self.starts
        if self.simulate:
            from robodyn.parameters.motion_fit import fit_motion

            constants = mechanism.description.constants
            check_apart(constants, bounds, {"--tau": self.tau or ""})
            torques = expressions(mechanism, self.tau, "--tau") if self.tau else None
            motion = rows.columns, rows.t, rows.q[0], rows.qd[0], torques
            return fit_motion(mechanism, bounds, *motion, **common)
        from robodyn.parameters.motion_fit import fit as fitted

        states = rows.columns, rows.q, rows.qd, rows.qdd, rows.t
        return fitted(mechanism, bounds, *states, **common)


def fit(
    model: Model,
    vary: Annotated[list[str], Option("--vary", metavar="NAME=LOW:HIGH", help=_VARY)],
    states: Annotated[Text, rows_argument("STATES", _STATES)] = None,
    given: FitOptions = FitOptions(),
    residuals: bool = switch(_RESIDUALS),
    quiet: Quiet = False,
    format: OutputStructured = None,
    out: Annotated[Text, output_file("--out", "-o", help=_OUT)] = None,
) -> None:
    """Numbers of a scene for which columns follow a table, or are as small as they can be.

    Columns are those of `points` (P_x, P_vy, P_Jx1, w3, transmission1, rocker/crank), `torque`
    (tau1, power1, fx1, volt1) and `reactions` (rx1, shake_fx), and q3, qd3, qdd3 of joints that
    follow.  Rows give the actuated joints' q1.., qd1.., qdd1.. (rates that are left out are zero)
    and t; the other joints are assembled anew for each trial.  The sum of squares of all columns,
    as they are in SI units, becomes least.

    Many starts are searched at once by derivatives, the best are finished by scipy's
    least_squares.  Where loops do not close on the way, what is missing counts ten times; results
    that do not close are thrown away.  Conditions of --subject-to may have numbers of the scene
    and columns, which then keep them at every row; they hold to 1e-12 of their size, by the
    augmented Lagrangian.

    \b
    Examples:
      robodyn fit hoeken --match line.csv --vary links.coupler.l=0.3:0.7 \\
        --vary links.rocker.l=0.15:0.4 --of P=coupler -o straight.yaml
      robodyn fit 2r --simulate --match run.csv --vary links.forearm.m=0.5:1.5
      robodyn trajectory four-bar --speed 60rpm --turns 1 --points 73 | \\
        robodyn fit four-bar - --vary links.rocker.r=0:0.8 --minimize shake_fx
    """
    given.check(states)
    values = model.values()
    mechanism = model.load()
    bounds = _bounds(mechanism, values, vary)
    rows = given.rows(mechanism, states)
    renamed = named_options((), **({"column": "minimize"} if given.minimize else {}))
    there = at_place(rows.source, "rows", "t") if rows.source else nullcontext()
    with remarks(), there, renamed, progress("fitting", quiet) as tell:
        found = given.found(mechanism, bounds, rows, tell)
    if found.untold:
        text = "the columns do not tell, alone or beside the others"
        note(f"Note: {text}: {', '.join(found.untold)}")
    if out is not None:
        write_scene(model.model, _scene_numbers(model, values, found), out)
    units = {**scene_units(mechanism), **{x: values.unit(x) for x in bounds if x in values}}
    if residuals:
        _write_rows(rows, found, units)
    elif out != "-":
        content = in_told_units(_content(found), units)
        write_structure(format, None, content, lambda: _tables(found, bounds, content, units))


def _bounds(mechanism: Mechanism, values: SceneValues, vary: Sequence[str]) -> Bounds:
    """The bounds of each number by its name."""
    found: Bounds = {}
    for text in vary:
        name, _, ends = (part.strip() for part in text.rpartition("="))
        low, colon, high = ends.partition(":")
        if not name or not colon:
            limit = "write NAME=LOW:HIGH, such as links.coupler.l=0.3:0.7"
            raise InputError("--vary", value=shown(text), limit=limit)
        if name in found:
            raise InputError("--vary", value=shown(text), limit=f"{name} is named twice")
        unit = values.unit(name) if name in values else unit_of(name, scene_units(mechanism))
        try:
            found[name] = parse_quantity(low, unit), parse_quantity(high, unit)
        except ValueError as error:
            raise InputError("--vary", value=shown(text), limit=str(error)) from None
    return found


def _scene_numbers(
    model: Model, values: SceneValues, found: Fit
) -> dict[str, float | Sequence[float]]:
    """Return the numbers that the output file gets: those of --set, and those fitted."""
    made: dict[str, float | Sequence[float]] = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in model.put().items()
    }
    for name, value in found.numbers.items():
        vector = made.get(name[:-3]) if name.endswith(("[0]", "[1]")) else None
        if isinstance(vector, list):
            vector[int(name[-2])] = value
        elif name in values:
            made[name] = value
        else:
            note(f"{name} = {value!r} is a start value, and in no scene")
    return made


def _content(found: Fit) -> dict[str, object]:
    def by_column(values: np.ndarray) -> dict[str, float | None]:
        numbers = (x if math.isfinite(x) else None for x in values.tolist())
        return dict(zip(found.columns, numbers, strict=True))

    return {
        "numbers": dict(found.numbers),
        "before": dict(found.before),
        "rms": by_column(found.rms),
        "rms_before": by_column(found.rms_before),
        "at_bounds": dict(found.bounds),
        "conditions": dict(found.conditions),
        "untold": list(found.untold),
        "starts": found.starts,
        "reached": found.reached,
    }


def _tables(
    found: Fit, bounds: Bounds, told: Mapping[str, Any], units: Mapping[str, str]
) -> list[Grid]:
    ends = [{name: bounds[name][k] for name in found.numbers} for k in range(2)]
    parts = [told["before"], told["numbers"], *(in_told_units(end, units) for end in ends)]
    numbers = [
        (name, *(part[name] for part in parts), found.bounds.get(own, ""))
        for own, name in zip(found.numbers, told["numbers"], strict=True)
    ]
    nothing = math.nan  # as null is shown
    columns = [
        (name, *(nothing if x is None else x for x in (told["rms_before"][name], rms)))
        for name, rms in told["rms"].items()
    ]
    grids = [
        Grid(["number", "before", "found", "low", "high", "at bound"], numbers),
        Grid(["column", "rms before", "rms"], columns),
    ]
    if found.conditions:
        grids.append(Grid(["condition", "room"], list(found.conditions.items())))
    reached = f"{found.reached} of {found.starts} starts reached it"
    return [grids[0]._replace(title=reached), *grids[1:]]


def _write_rows(rows: FitRows, found: Fit, units: Mapping[str, str]) -> None:
    names = [x for name in found.columns for x in (name, *result_names("missed", [name]))]
    both = np.stack([found.residuals + rows.target, found.residuals], axis=-1)
    with row_writer(None, None, [*rows.names, *names], units=units) as writer:
        for known, values in zip(rows.known.tolist(), both.tolist(), strict=True):
            writer.write_row([*known, *(x for pair in values for x in pair)])
