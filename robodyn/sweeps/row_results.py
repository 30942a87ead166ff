"""Results of a point of a sweep from its rows: columns of commands, and their extremes and means.

A result is written as the column's name, tau1, where the point has one row, and with what is taken
of its rows, max(tau1), where it has many.  Means are over time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics.columns import STATE, column_names
from robodyn.dynamics.named_points import named_points
from robodyn.dynamics.state import State
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs.simulation import Motion
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array


def _mean(x: Array, t: Array) -> float:
    """The mean over t of a column x (T,): its trapezoidal integral, so that ends count half."""
    if t[0] == t[-1]:
        return float(np.mean(x))
    return float(np.dot(np.diff(t), x[1:] + x[:-1]) / (2.0 * (t[-1] - t[0])))


TAKEN: dict[str, Callable[[Array, Array], float]] = {  # of the rows of a column, at times t
    "min": lambda x, _: np.min(x),
    "max": lambda x, _: np.max(x),
    "range": lambda x, _: np.ptp(x),
    "mean": _mean,
    "rms": lambda x, t: math.sqrt(_mean(np.square(x), t)),
    "first": lambda x, _: x[0],
    "last": lambda x, _: x[-1],
}
_TEXT = re.compile(rf"(?:({'|'.join(TAKEN)})\()?(.*?)(?(1)\))")


class RowResult(NamedTuple):
    """A result taken of a column; none for a single row."""

    taken: str
    column: str


def parsed(text: str) -> RowResult:
    """The result that `text` writes; as a column of that name where it is none."""
    match = _TEXT.fullmatch(text)
    return RowResult("", text) if match is None else RowResult(match[1] or "", match[2].strip())


def check_results(
    mechanism: Mechanism,
    texts: Sequence[str],
    of: Sequence[str],
    tracks: bool,
    rows: bool,
    others: Sequence[str] = (),
) -> None:
    """Raise InputError, naming `result`, for what is no result of this mechanism.

    `of` are the points; `tracks` tells whether a controller's errors are there, `rows` whether a
    point has many; `others` are results besides, which a message names.
    """
    families = [*STATE, *(["errors"] if tracks else [])]
    known = column_names(mechanism, families, named_points(mechanism, of))
    for text in texts:
        taken, column = parsed(text)
        if column not in known:
            limit = f"is no result{nearest(column, [*others, *known])}"
            raise InputError("result", value=text, limit=limit)
        if rows and not taken:
            ways = ", ".join(f"{name}({column})" for name in TAKEN)
            raise InputError("result", value=text, limit=f"is a column of many rows: take {ways}")
        if taken and not rows:
            limit = f"there is one row: write {column}, or give --track"
            raise InputError("result", value=text, limit=limit)


def of_states(texts: Sequence[str], state: State) -> Array:
    """The columns that the texts name, (T, results)."""
    return state.columns([parsed(text).column for text in texts])


def of_rows(texts: Sequence[str], t: Array, columns: Array) -> Array:
    """Return the results of the texts from their columns (T, results) at times t (T,)."""
    return np.array(
        [TAKEN[parsed(text).taken](x, t) for text, x in zip(texts, columns.T, strict=True)]
    )


def of_motion(
    motion: Motion, texts: Sequence[str], of: Sequence[str], reference: ReferenceTable | None
) -> Array:
    """Return the results of the texts from a motion's rows, (results,)."""
    mechanism, wanted = motion.mechanism, [parsed(text).column for text in texts]
    named, found = named_points(mechanism, of), []
    errors = column_names(mechanism, ["errors"] if reference else [])
    for moving, t, q, qd, tau in motion.in_phases(motion.t, motion.q, motion.qd, motion.tau):
        state = State(mechanism, q, qd, tau=tau, t=t, of=named, moving=moving)
        given = {}
        if reference is not None:
            away = reference.at(t)[0] - q[:, list(mechanism.actuated)]
            given = dict(zip(errors, away.T, strict=True))
        others = [name for name in wanted if name not in given]
        given |= dict(zip(others, state.columns(others).T, strict=True))
        found.append(np.stack([given[name] for name in wanted], axis=-1))
    return of_rows(texts, motion.t, np.concatenate(found))
