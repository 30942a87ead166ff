"""Feedback of displacements and rates from a pose, with a gain K such as `linearize --lqr` finds.

    tau = tau0 - K [xi - xi0; xid]

xi are the coordinates named by K, of any joints.  Angles differ from the pose's by at most half a
turn: a joint after a full turn is where it was. tau0 holds the mechanism at the pose.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from robodyn.dynamics.columns import column_names
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.short_repr import short_repr


@short_repr
@dataclass(frozen=True)
class StateFeedback:
    """A gain and its pose.

    `gain` is (actuated, 2f): f `coordinates` (joints from 0), then their rates. q (n,) in rad and
    m; tau of the actuated joints or of all, in N m, or N for sliding joints.
    """

    coordinates: tuple[int, ...]
    q: list[float]
    tau: list[float]
    gain: list[list[float]]


def read_feedback(mechanism: Mechanism, text: bytes, where: str) -> StateFeedback:
    """Read a feedback from JSON with `coordinates`, `q`, `tau` and `gain`.

    `coordinates` are columns such as "q1". Raises InputError if something is wrong.
    """
    try:
        given = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON", where=where, limit=str(error)) from None
    keys = ("coordinates", "q", "tau", "gain")
    if not isinstance(given, dict):
        raise InputError("the file", where=where, limit=f"must have {', '.join(keys)}")
    for key in keys:
        if key not in given:
            raise InputError(key, where=where, limit=f"is missing; needed are {', '.join(keys)}")
    names = _list(given["coordinates"], "coordinates", None, where)
    columns = column_names(mechanism, ["q"])
    for k, name in enumerate(names):
        if name not in columns or name in names[:k]:
            limit = f"must be of {', '.join(columns)}, each once"
            raise InputError("coordinates", where=where, value=name, limit=limit)
    driven = len(mechanism.actuated)
    rows = _list(given["gain"], "gain", (driven, "rows", "one an actuated joint"), where)
    wide = 2 * len(names), "values", "coordinates, then their rates"
    return StateFeedback(
        tuple(map(columns.index, names)),
        _numbers(given["q"], "q", (mechanism.n, "values", "one a joint"), where),
        _numbers(given["tau"], "tau", (driven, "values", "one an actuated joint"), where),
        [_numbers(row, f"gain[{k}]", wide, where) for k, row in enumerate(rows)],
    )


def _list(given: Any, key: str, wanted: tuple[int, str, str] | None, where: str) -> list[Any]:
    if not isinstance(given, list):
        raise InputError(key, where=where, value=json.dumps(given), limit="must be a list")
    if wanted is not None and len(given) != wanted[0]:
        count, of, which = wanted
        limit = f"must have {count}: {which}"
        raise InputError(key, where=where, value=f"{len(given)} {of}", limit=limit)
    return given


def _numbers(given: Any, key: str, wanted: tuple[int, str, str], where: str) -> list[float]:
    found = []
    for x in _list(given, key, wanted, where):
        try:
            value = float(x) if isinstance(x, int | float) and x is not True else math.nan
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            limit = "must be finite numbers"
            raise InputError(key, where=where, value=json.dumps(x), limit=limit)
        found.append(value)
    return found
