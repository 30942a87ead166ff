"""The rows that `robodyn fit` works on: states of the actuated joints, times, and what to meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robodyn.cli.found_rates import tell_at_rest
from robodyn.cli.output import note
from robodyn.cli.row_files import read_columns
from robodyn.cli.states import Quantity, option_source
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.column_units import scene_units
from robodyn.tables.arrays import Array
from robodyn.tables.delimited import columns_told

if TYPE_CHECKING:
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


def _driven(mechanism: Mechanism, quantity: Quantity, whole: bool = False) -> Array:
    """An option's values of the actuated joints, or as they are if they may be `whole`."""
    source = option_source(mechanism, quantity)
    return np.array(source.values if whole else source.driven(mechanism))


def rows_given(
    mechanism: Mechanism,
    table: str | None,
    match: bool,
    wanted: list[str],
    chosen: list[str] | None,
    of: Sequence[str],
    options: Mapping[str, str | None],
    moving: bool,
) -> FitRows:
    """The rows of a table; of one to `match` the columns too, all that serve unless `chosen`.

    Without a table the one state that options give.  Of motions (`moving`) q and qd begin it, by
    options or by the first row.
    """
    from robodyn.parameters.column_formulas import ColumnFormulas

    formulas = ColumnFormulas(mechanism, [], of)
    free = moving and len(mechanism.passive) > len(mechanism.rows)
    joints = range(mechanism.n) if free else mechanism.actuated  # that a motion begins with
    driven = {kind: [f"{kind}{k + 1}" for k in joints] for kind in KINDS}
    states: dict[str, list[str]] = {}
    columns = wanted

    def choose(header: Sequence[str], name: str) -> Sequence[str]:
        nonlocal columns
        for kind, names in driven.items():
            there = [x for x in names if x in header]
            if options[kind] is not None:
                if there and not moving:
                    limit = f"{name} has the column {there[0]}; leave one of them out"
                    raise InputError(f"--{kind}", value=options[kind], limit=limit)
            elif len(there) == len(names):
                states[kind] = names
            elif there or kind == "q":
                missing = next(x for x in names if x not in there)
                limit = f"the header has {columns_told(header, missing)}"
                raise InputError(f"column {missing} is missing", where=name, limit=limit)
        if match:
            columns = chosen or fitted(header, name)
            for column in columns:
                if column not in header:
                    limit = f"the header has {columns_told(header, column)}"
                    what = f"column {column} of --columns is missing"
                    raise InputError(what, where=name, limit=limit)
        used = [x for names in states.values() for x in names]
        used += ["t"] if moving or "t" in header else []
        return list(dict.fromkeys([*used, *(columns if match else [])]))

    def fitted(header: Sequence[str], name: str) -> list[str]:
        """The columns of a table that can be fitted."""
        given = {"t", *(() if moving else (x for names in states.values() for x in names))}
        for kind in ("qdd", "tau") if moving else KINDS:
            whole = {f"{kind}{k + 1}" for k in range(mechanism.n)}
            # what follows in a table of whole states is the old scene's
            given |= whole if moving or whole <= set(header) else set()
        found = [x for x in header if x not in given and formulas.serves(x)]
        if not found:
            limit = "has no column that can be fitted besides; "
            limit += f"the header has {columns_told(header)}"
            raise InputError("--match", where=name, limit=limit)
        left = [x for x in header if x not in given and x not in found]
        if left:
            note(f"{name}: {', '.join(left)}: not fitted, as these are no columns of a state")
        return found

    names: Sequence[str] = []
    values, name = np.zeros((1, 0)), ""
    if table is not None:
        values, names, name = read_columns(table, choose, scene_units(mechanism))
    elif options["q"] is None:
        raise InputError("--minimize", limit="needs STATES, or --q: where columns are taken")
    place = {x: k for k, x in enumerate(names)}
    T = len(values)
    state: dict[str, Array] = {}
    for kind in KINDS:
        if kind in states:
            state[kind] = values[:, [place[x] for x in states[kind]]]
        else:
            own = _driven(mechanism, Quantity(kind, options[kind]), moving)
            state[kind] = np.tile(own, (T, 1)).reshape(T, len(own))
    t = values[:, place["t"]] if "t" in place else np.zeros(T)
    given = {*states, *(kind for kind in KINDS if options[kind] is not None)}
    if not moving and np.ptp(t) and given == {"q"} and _moves(formulas, columns):
        tell_at_rest(name, ("qd", "qdd"))
    target = values[:, [place[x] for x in columns]] if match else np.zeros((T, len(columns)))
    shown = [x for x in names if x not in columns or not match or x in ("t",)]
    known = values[:, [place[x] for x in shown]]
    if table is None:
        shown, known = driven["q"], state["q"]
    return FitRows(state["q"], state["qd"], state["qdd"], t, columns, target, shown, known, name)


def _moves(formulas: ColumnFormulas, columns: Sequence[str]) -> bool:
    """Whether any of the columns depends on rates, accelerations or forces."""
    from robodyn.engines.tangents import tangents

    nodes = [formulas.column(name) for name in columns]
    rates = [x for x in formulas.inputs[formulas.mechanism.n :] if x != "t"]
    return any(tangents(nodes, rates))
