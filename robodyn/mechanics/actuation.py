"""Sources of joint torques in a simulation: constants, expressions of t, q, qd, or a table.

Each source becomes lines of Python in the generated right-hand side; constants are folded into it.
`scene/syntax.py` describes expressions.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

from robodyn.elements.values import lines_of
from robodyn.errors import InputError, at_place
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene import quantities
from robodyn.scene.constants import numbers_of
from robodyn.scene.dimensions import misfit
from robodyn.scene.expressions import SCOPE, code_of, names_of
from robodyn.scene.quantities import state_variables
from robodyn.scene.syntax import CONSTANTS, LONGEST, Node, NotAllowedError
from robodyn.tables.short_repr import short_repr

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from robodyn.mechanics.kinks import Held
    from robodyn.mechanics.run_control import Control, Steps

T = TypeVar("T")
Change = Callable[[list[Node]], list[Node]]  # of expressions into others


class CallerError(Exception):
    """Carries an exception of a caller's function past handlers of numerical errors."""

    def __init__(self, error: Exception) -> None:
        super().__init__(error)
        self.error = error


@short_repr
@dataclass(frozen=True, eq=False, repr=False)
class Actuation:
    """Joint torques over time: constants (n), or lines that set tau0.. from t, q0.., qd0...

    `kinks` are increasing times at which torques bend or jump; an integrator must step onto them.
    It calls `listener`, if there is one, at the start and at each kink.  `jumps` are increasing
    times at which tables over time (of torques or of loads) jump; their value there is the later
    one.  `leaves` are ends of intervals, counted from the start: a step may not be longer than an
    interval that it enters.  Torques may have `states` of their own, z0.., integrated with q and qd
    by rates zd0.. that the lines set.
    """

    constants: tuple[float, ...] | None
    lines: tuple[str, ...] = ()
    torques: tuple[Node, ...] = ()  # of expressions: the trees of the lines
    scope: Mapping[str, object] = field(default_factory=dict)
    kinks: tuple[float, ...] = ()
    linear: bool = False  # in time between kinks, whatever the state is
    span: tuple[str, float, float] | None = None  # what is defined from when to when, s
    control: Control | None = None
    pieces: Held | None = None  # of an expression over a run; see `runs/torques_over_time.py`
    leaves: tuple[float, ...] = ()
    resolved: bool = True  # by its leaves; else it changes too fast for them
    original: Actuation | None = None  # of which this was made for a run
    states: int = 0
    # the same torques on a mechanism with other numbers, where they depend on these or on the run
    remade: Callable[[Mechanism], Actuation] | None = None
    where: str = ""  # the argument that had the expressions
    jumps: tuple[float, ...] = ()

    @classmethod
    def of(cls, torques: Sequence[Node], where: str = "") -> Actuation:
        """Return torques from expressions, one per joint; `where` is the name of the argument."""
        lines = tuple(f"tau{k} = {code_of(node)}" for k, node in enumerate(torques))
        return cls(None, lines, tuple(torques), dict(SCOPE), where=where)

    @property
    def listener(self) -> Steps | None:
        """The object that follows the steps of a run, if any."""
        return self.control or self.pieces

    @cached_property
    def stops(self) -> tuple[float, ...]:
        """The increasing times onto which an integrator must step."""
        if set(self.jumps) <= set(self.kinks):
            return self.kinks
        return tuple(sorted({*self.kinks, *self.jumps}))

    @property
    def active(self) -> bool:
        """Whether any torque can act."""
        return self.constants is None or any(self.constants)

    def own(self, name: str) -> list[str]:
        """Return the names of its states, or of their rates."""
        return [f"{name}{k}" for k in range(self.states)]

    def function(self, n: int) -> Callable[[float, Sequence[float]], list[float]]:
        """Return the torques (n), and rates of their states, as a function of t and y.

        y is (q, qd, z, ...).
        """
        if self.constants is not None and not self.states:
            constants = list(self.constants)
            return lambda t, y: constants
        z, zd = self.own("z"), self.own("zd")
        names = [*(f"{name}{k}" for name in ("q", "qd") for k in range(n)), *z]
        result = ", ".join([*(f"tau{k}" for k in range(n)), *zd])
        body = [f"{', '.join(names)}, = y[:{len(names)}]", *self.lines, f"return [{result}]"]
        scope: dict[str, object] = {"__builtins__": {}, **self.scope}
        source = "def torques(t, y):\n    " + "\n    ".join(body) + "\n"
        exec(compile(source, "<robodyn torque>", "exec"), scope)
        function: Callable[[float, Sequence[float]], list[float]] = scope["torques"]  # type: ignore[assignment]
        return function


def _each_joint(
    mechanism: Mechanism, given: list[T], nothing: tuple[T, ...], what: str, where: str = ""
) -> list[T]:
    """Return one item per joint from items of all or of the actuated joints.

    Passive joints get `nothing`.
    """
    n, driven = mechanism.n, mechanism.actuated
    if len(given) not in (n, len(driven)):
        limit = f"must have {n} {what}, one a joint"
        if len(driven) != n:
            limit = f"must have {len(driven)} {what}, one an actuated joint, or {n}, one a joint"
        raise InputError("tau", where=where, value=f"{len(given)} {what}", limit=limit)
    if len(given) != n:
        places = dict(zip(driven, given, strict=True))
        return [places.get(k, nothing[0]) for k in range(n)]
    for k in mechanism.passive:
        if given[k] not in nothing:
            limit = f"joint {mechanism.link_names[k]} is passive; name it in `actuated`"
            raise InputError(f"tau{k + 1}", where=where, value=given[k], limit=limit)
    return given


def constant(mechanism: Mechanism, values: Sequence[float]) -> Actuation:
    """Return constant torques, N m, of all joints (passive ones zero) or of the actuated ones."""
    torques = _each_joint(mechanism, list(map(float, values)), (0.0,), "values")
    return Actuation(tuple(torques))


def expressions(
    mechanism: Mechanism,
    text: str,
    where: str,
    driving: Change | None = None,
    unit: str = "",
) -> Actuation:
    """Return torques from comma-separated expressions in t, q1.., qd1.., one per actuated joint.

    In N m, or N. `driving` converts expressions in another `unit` to torques.  Raises InputError
    for wrong units, and for anything but arithmetic, comparisons, `a if b else c`, known functions,
    pi and e.
    """
    variables = state_variables(mechanism.n, mechanism.slides)
    try:
        constants = {**CONSTANTS, **numbers_of(mechanism.description.constants)}
        found = quantities.expressions(text, variables, constants)
    except NotAllowedError as error:
        if len(text) > LONGEST:
            limit = f"is longer than {LONGEST} characters"
            raise InputError("expression", where=where, limit=limit) from None
        raise InputError(f"torque expression does not allow {error}", where=where) from None
    except ValueError as error:
        raise InputError(repr(text), where=where, limit=f"is no expression: {error}") from None
    nodes = [x.node for x in found]
    if driving is not None:
        nodes = driving(nodes)
    whole = len(nodes) == mechanism.n
    for k, one in enumerate(found):
        joint = k if whole or k >= len(mechanism.actuated) else mechanism.actuated[k]
        if limit := misfit(one.measure, unit or ("N" if joint in mechanism.slides else "N m")):
            raise InputError(f"entry {k + 1}", where=where, value=one.text, limit=limit)
    if not any(map(names_of, nodes)):
        values = [x.value for x in found]
        if not all(map(math.isfinite, values)):
            raise InputError(repr(text), where=where, limit="must be finite")
        with at_place(where):
            return constant(mechanism, values)
    each = _each_joint(mechanism, nodes, (0.0, ("neg", 0.0)), "expressions", where)
    return Actuation.of(each, where)


def table(
    mechanism: Mechanism,
    times: Sequence[float],
    torques: Sequence[Sequence[float]],
    where: str = "table",
    until: float = 0.0,
    hold: bool = False,
) -> Actuation:
    """Return torques (rows, actuated), N m, at increasing times (s), linear between them.

    With `hold`, a row holds until the next.  Two rows at one time are a step.  Raises InputError
    unless there are two rows, with increasing times that cover 0 to `until`.
    """
    first, last = min(0.0, until), max(0.0, until)
    if len(times) < 2:
        limit = "a table of torques needs two rows or more"
        raise InputError("rows", where=where, value=len(times), limit=limit)
    several = 0  # rows before one at the same time
    for before, after in pairwise(times):
        several = several + 1 if after == before else 0
        if not after >= before or several > 1:
            limit = f"times must increase; the row before has {before:g}"
            limit += ", and that before it; two are a step" if several else ""
            raise InputError("t", where=where, value=f"{after:g}", limit=limit)
    if times[0] == times[-1]:
        limit = "a table of torques needs two times or more"
        raise InputError("t", where=where, value=f"{times[0]:g}", limit=limit)
    if times[0] > first or times[-1] < last:
        limit = f"must cover the simulation, {first:g} to {last:g} s"
        limit += ": the last row ends it" if hold else ""
        raise InputError("t", where=where, value=f"{times[0]:g} to {times[-1]:g} s", limit=limit)
    driven = mechanism.actuated
    stamps = [float(t) for t in times]
    columns = [lines_of(stamps, [float(x) for x in x], hold) for x in zip(*torques, strict=True)]
    knots = columns[0].x if columns else tuple(sorted(set(stamps)))
    pieces = range(len(knots) - 1)
    rows = [[(x.first[k], x.last[k]) for x in columns] for k in pieces]

    def interpolate(t: float) -> tuple[float, ...]:
        k = min(max(bisect_right(knots, t), 1), len(knots) - 1)
        part = (t - knots[k - 1]) / (knots[k] - knots[k - 1])
        return tuple(a + part * (b - a) for a, b in rows[k - 1])

    targets = "".join(f"tau{k}, " for k in driven)
    lines = [f"{targets}= _interpolate(t)"]
    lines += [f"tau{k} = 0.0" for k in mechanism.passive]
    span = ("table of torques", stamps[0], stamps[-1])
    scope = {"_interpolate": interpolate}
    jumps = tuple(sorted({t for x in columns for t in x.jumps}))
    made = Actuation(None, tuple(lines), (), scope, knots, True, span)
    return replace(made, jumps=jumps)


def callback(
    mechanism: Mechanism, function: Callable[[float, list[float], list[float]], Sequence[float]]
) -> Actuation:
    """Return torques from a Python function of t, q (n), qd (n), for all or the actuated joints.

    An exception of the function is raised as CallerError.
    """
    n = mechanism.n

    def torques(t: float, state: tuple[float, ...]) -> Sequence[float]:
        try:
            given = function(t, list(state[:n]), list(state[n:]))
        except Exception as error:
            raise CallerError(error) from None
        values = values_given(given, "tau(t, q, qd)")
        return _each_joint(mechanism, values, (0.0,), "values", "tau(t, q, qd)")

    targets = "".join(f"tau{k}, " for k in range(n))
    state = "".join(f"q{k}, " for k in range(n)) + "".join(f"qd{k}, " for k in range(n))
    return Actuation(None, (f"{targets}= _torques(t, ({state}))",), (), {"_torques": torques})


def values_given(given: Iterable[float], what: str) -> list[float]:
    """Return a caller's values as floats; InputError if they are no list of numbers."""
    try:
        return [float(x) for x in given]
    except (TypeError, ValueError):
        limit = "must be a list of numbers, one an actuated joint"
        raise InputError(what, value=repr(given), limit=limit) from None


def for_each_actuated(mechanism: Mechanism, given: ArrayLike, name: str) -> list[float]:
    """Return one value per actuated joint; InputError for another number of values."""
    import numpy as np

    count = len(mechanism.actuated)
    values = np.atleast_1d(np.asarray(given, float))
    if values.shape not in ((1,), (count,)):
        joints = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
        limit = f"needs 1 value, or {count}, one an actuated joint ({joints})"
        shown = "1 value" if values.size == 1 else f"{values.size} values"
        raise InputError(name, value=shown, limit=limit)
    each: list[float] = np.broadcast_to(values, count).tolist()
    return each
