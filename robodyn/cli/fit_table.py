"""The rows that `robodyn fit` works on: states of the actuated joints, times, and what to meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robodyn.cli.motion_files import tell_at_rest, without_jumps
from robodyn.cli.output import note
from robodyn.cli.row_files import read_columns
from robodyn.cli.states import Quantity, option_source
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import scene_units
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.delimited import columns_told

if TYPE_CHECKING:
    from robodyn.cli.fit import FitOptions
    from robodyn.parameters.column_formulas import ColumnFormulas

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


class FitTable:
    """Reads the rows of a fit: states of the actuated joints, and, to `match`, what is to be met.

    Columns are those to minimize; to match the ones that are named, or all that can be fitted.  Of
    motions (`moving`) q and qd begin it, by options or by the first row.
    """

    def __init__(self, mechanism: Mechanism, options: FitOptions) -> None:
        from robodyn.parameters.column_formulas import ColumnFormulas

        self.mechanism, self.moving = mechanism, options.simulate
        self.unwrap = options.unwrap
        self.match, named = options.match is not None, options.columns
        self.columns = [x for text in options.minimize or () for x in _names(text, "--minimize")]
        self.chosen = None if named is None else _names(named, "--columns")
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
                table, self._choose, scene_units(self.mechanism)
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
        found = [x for x in header if x not in given and self.formulas.serves(x)]
        if not found:
            limit = "has no column that can be fitted besides; "
            limit += f"the header has {columns_told(header)}"
            raise InputError("--match", where=name, limit=limit)
        left = [x for x in header if x not in given and x not in found]
        if left:
            note(f"{name}: {', '.join(left)}: not fitted, as these are no columns of a state")
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
    from robodyn.engines.tangents import tangents

    nodes = [formulas.column(name) for name in columns]
    rates = [x for x in formulas.inputs[formulas.mechanism.n :] if x != "t"]
    return any(tangents(nodes, rates))
