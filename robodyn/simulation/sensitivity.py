"""How a motion changes with a number of its scene, or a start value: its variational equations.

Along the motion s = (s_q, s_qd) = d(q, qd)/dp follows, with the residuals R of `residuals`, from

    s_q' = s_qd        s_qd' = -K^-1 (R_q s_q + R_qd s_qd + R_tau dtau/dp + R_p)

Such s are integrated beside the motion as states of the torques' own; times the size of p, so that
a tolerance is the same angle for them.  What a controller feeds back of them, u' = U s, z' = Z s of
s = d(q, qd, z)/dp with the integrals z of its law, goes into the torques.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from robodyn.dynamics.closed_form import scaled_jacobian
from robodyn.dynamics.dense_dynamics import elimination_is_safe
from robodyn.dynamics.named_numbers import size_of, with_variable
from robodyn.engines.expression import Graph, Value
from robodyn.engines.formulas import Formula, cheapest
from robodyn.engines.frames import relative
from robodyn.engines.straightline import FloatFunction, compile_floats
from robodyn.engines.tangents import slopes_by, substituted, tangents
from robodyn.errors import InputError
from robodyn.loops.change_points import rank, rank_beside
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import Mode, in_mode
from robodyn.mechanics.program import Program
from robodyn.simulation.varied_motion import (
    CHANGE,
    Varied,
    changes,
    is_start,
    start_slopes,
    torque_lines,
    torque_nodes,
)
from robodyn.tables.arrays import Array
from robodyn.taylor.variations import Number


@dataclass(frozen=True)
class Sensitivities:
    """By what a motion is differentiated, and the torques that carry it."""

    names: tuple[str, ...]
    sizes: Array  # (k,)
    actuation: Actuation
    n: int
    own: int = 0  # states of the torques themselves, which come before

    @property
    def columns(self) -> list[str]:
        """The names of its columns: d q1/d NAME is dq1/NAME."""
        state = [f"d{kind}{i + 1}" for kind in ("q", "qd") for i in range(self.n)]
        return [f"{x}/{name}" for name in self.names for x in state]

    def of(self, y: Array) -> Array:
        """d(q, qd)/d(each name) (T, 2n, k) in states y (T, 2n + own + 2n k or more)."""
        wide, count, first = 2 * self.n, len(self.names), 2 * self.n + self.own
        s = y[:, first : first + wide * count].reshape(-1, count, wide)
        return np.swapaxes(s / self.sizes[:, None], 1, 2)

    @staticmethod
    def flat(found: Array) -> Array:
        """The values of its columns (T, 2n k), of what `of` gives."""
        return found.swapaxes(1, 2).reshape(len(found), -1)


def _dependent(mechanism: Mechanism, q: Array) -> bool:
    """Whether closures depend on one another on the branch of q (n,), not just at q."""
    rows = len(mechanism.rows)
    if not rows or rank(mechanism, scaled_jacobian(mechanism, q)) == rows:
        return False
    return rank_beside(mechanism, q, 1e-2, 8) < rows


def with_sensitivities(
    mechanism: Mechanism, actuation: Actuation, state: Array, names: Sequence[str], method: str
) -> Sensitivities:
    """The torques of a run from `state` (2n), as `over_run` gives them, with sensitivities.

    The names are those of numbers of the scene, `links.forearm.m`, or of start values, `q1`, `qd1`.
    Raises InputError for a name that is none, and for what has no derivative.
    """
    where = mechanism.source
    limit, (q, qd) = "", np.split(state, 2)
    if not elimination_is_safe(mechanism) or _dependent(mechanism, q):
        limit = "links without inertia of their own, or closures that depend on one another"
    if limit or not names or len(set(names)) < len(names):
        raise InputError("sensitivity", where=where, limit=limit or "needs names, each once")
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        limit = 'must be a list of names, such as ["q1"]'
        raise InputError("sensitivity", value=repr(names), limit=limit)
    n, sizes, starts = mechanism.n, [], []
    for name in names:
        sizes.append(1.0 if is_start(mechanism, name) else size_of(mechanism, name))
        starts.append(sizes[-1] * start_slopes(mechanism, name, q, qd))
    first, count = actuation.states, len(names)

    fed = Fed(actuation, n, count)

    def modes(of: Callable[[Mode], Callable[..., Any]]) -> Any:
        if not mechanism.switches:
            return None
        from robodyn.simulation.sensitivity_jumps import Modes

        return Modes(mechanism, of, tuple(names), tuple(sizes), fed.control, first)

    if method == "taylor":
        flat = tuple((np.concatenate(starts) / np.repeat(sizes, 2 * n)).tolist())
        sizes = [1.0] * count
        carried = replace(
            actuation,
            control=fed.control,
            modes=modes(lambda mode: tuple),
            states=len(flat),
            start=flat,
            alone=actuation,
            by=lambda mode: tuple(_number(mechanism, name, mode) for name in names),
        )
        return Sensitivities(tuple(names), np.ones(count), carried, n)

    torques = actuation.constants, torque_lines(actuation), actuation.control is not None, first
    make = partial(_slopes, mechanism, *torques, tuple(names), tuple(sizes))
    inputs, slopes = make(Mode() if mechanism.switches else None)
    still = (0.0,) * (n * count)
    by_modes = modes(lambda mode: (lambda *_: still) if mode.stands else make(mode)[1])
    z = [range(first + 2 * n * k, first + 2 * n * (k + 1)) for k in range(count)]
    rates = [f"zd{i}" for each in z for i in each[n:]]
    moved = [f"zd{i} = z{i + n}" for each in z for i in each[:n]]
    lines = [*fed.lines(mechanism), *moved]
    lines.append(f"{', '.join(rates)}, = _slopes({', '.join(inputs)})")
    start = [0.0] * first + np.concatenate(starts).tolist() + [0.0] * (first * count)
    carried = replace(
        actuation,
        lines=tuple(lines),
        scope={**actuation.scope, **fed.scope, "_slopes": by_modes or slopes},
        modes=by_modes,
        states=len(start),
        start=tuple(start),
        alone=actuation,
        control=fed.control,
    )
    return Sensitivities(tuple(names), np.array(sizes), carried, n, first)


@lru_cache(maxsize=256)
def _number(mechanism: Mechanism, name: str, mode: Mode | None) -> Number:
    """What the Taylor series is differentiated by."""
    if is_start(mechanism, name) or (mode is not None and mode.stands):
        mechanism = mechanism if mode is None else in_mode(mechanism, mode)
        return Number(mechanism, lambda program: (program.numbers, [0.0] * len(program.numbers)))
    named = with_variable(mechanism, name, Graph().variable(CHANGE), mode)

    def numbers(program: Program) -> tuple[list[float], list[float]]:
        slopes = slopes_by(program.numbers, [CHANGE])
        both = substituted([*program.numbers, *slopes], {CHANGE: 0.0})
        values = [float(x) for x in both]  # type: ignore[arg-type]  # nothing varies any more
        return values[: len(slopes)], values[len(slopes) :]

    return Number(named, numbers)


@lru_cache(maxsize=64)
def _slopes(mechanism: Mechanism, *given: Any) -> tuple[tuple[str, ...], FloatFunction]:
    """`_formula` as code, and its inputs."""
    formula = cheapest(lambda way: _formula(way, mechanism, *given))
    if formula is None:
        limit = "its equation divides by zero"
        raise InputError("sensitivity", where=mechanism.source, limit=limit)
    return formula.inputs, compile_floats(formula, "slopes")


def _formula(
    way: bool,
    mechanism: Mechanism,
    constants: Sequence[float] | None,
    lines: Sequence[str],
    controlled: bool,
    states: int,
    names: Sequence[str],
    sizes: Sequence[float],
    mode: Mode | None,
) -> Formula:
    """The rates of all s_qd (k n) from q, qd, tau, all s and t."""
    n, varied = mechanism.n, Varied(mechanism, mode, way, Graph())
    graph, state = varied.state.graph, varied.state
    torques = torque_nodes(mechanism, lines, graph)
    z = [f"z{states + i}" for i in range(2 * n * len(names))]
    fed: list[str] = []  # d tau of what controls
    outputs: list[Value] = []
    for k, (name, size) in enumerate(zip(names, sizes, strict=True)):
        own = z[2 * n * k : 2 * n * (k + 1)]
        by = changes(graph, state.inputs[: 2 * n], own)
        if ".motor." in name and any(tangents(torques, list(by))):
            limit = "no derivative is known by it where torques depend on q or qd"
            raise InputError(name, where=mechanism.source, limit=limit)
        if not controlled:
            by |= {f"tau{j}": x for j, x in enumerate(tangents(torques, by))}
        else:
            by |= {f"tau{j}": {CHANGE: graph.variable(f"f{k}_{j}")} for j in mechanism.actuated}
            fed += [f"f{k}_{j}" for j in mechanism.actuated]
        outputs += relative(mechanism, varied.by(name, size, by)[:n])
    steady: Mapping[str, Value] = {f"tau{j}": x for j, x in enumerate(constants or ())}
    return Formula((*state.inputs, *z, *fed, "t"), tuple(substituted(outputs, steady)), ())


class Fed:
    """The lines of torques, with d tau of `count` names, f0_0 .., and the rates of dz/dp.

    States are z, then d(q, qd) of each name, then dz of each.
    """

    def __init__(self, actuation: Actuation, n: int, count: int) -> None:
        self.actuation, self.n, self.count = actuation, n, count
        self.control: Any = actuation.control
        self.scope: dict[str, object] = {}
        if actuation.control is not None and actuation.linear:
            self.control = SampledSlopes(actuation.control, n, count)
            self.scope["_fed"] = self.control.slopes_at
        elif actuation.control is not None:
            self.scope["_fed"] = actuation.control.along(count)

    def lines(self, mechanism: Mechanism) -> list[str]:
        """Those of the torques and what follows them."""
        if self.actuation.constants is not None:
            return [f"tau{j} = {x!r}" for j, x in enumerate(self.actuation.constants)]
        if self.control is None:
            return [*self.actuation.lines]
        m, joints = self.actuation.states, mechanism.actuated
        last = m + 2 * self.n * self.count
        fed = [f"f{k}_{j}" for k in range(self.count) for j in joints]
        if self.actuation.linear:
            return [*self.actuation.lines, f"{', '.join(fed)}, = _fed(t)"]
        fed = [f"tau{j}" for j in joints] + self.actuation.own("zd") + fed
        fed += [f"zd{last + i}" for i in range(m * self.count)]
        names = [f"{name}{j}" for name in ("q", "qd") for j in range(self.n)]
        names += [f"z{i}" for i in range(last + m * self.count)]
        zeros = [f"tau{j} = 0.0" for j in mechanism.passive]
        return [f"{', '.join(fed)}, = _fed(t, {', '.join(names)})", *zeros]


class SampledSlopes:
    """A controller that is sampled, and what its torques change by: held as they are."""

    def __init__(self, control: Any, n: int, count: int) -> None:
        self.control, self.n, self.count = control, n, count
        self.law, self.joints = control.along(count), control.reference.joints

    def __getattr__(self, name: str) -> Any:
        return getattr(self.control, name)

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """See `run_control.Steps`."""
        self.control.begin(y, t_end)
        self.values: list[tuple[float, ...]] = []
        self.z = self.before = [0.0] * (self.count * self.control.states)
        self._sample(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        """See `run_control.Steps`."""
        self.control.reach(t, y)
        if t < self.control.times[-1]:
            return
        if len(self.values) == len(self.control.times):  # that sample was taken again
            self.values.pop()
            self.z = self.before
        self._sample(t, y)

    def _sample(self, t: float, y: Sequence[float]) -> None:
        wide, control = 2 * self.n, self.control
        self.before = self.z
        s = y[wide : wide * (1 + self.count)]
        found = self.law(t, *y[:wide], *control.before, *s, *self.z)
        first = self.joints + control.states
        last = first + self.joints * self.count
        self.values.append(found[first:last])
        rates = found[last:]
        self.z = [z + zd / control.rate for z, zd in zip(self.z, rates, strict=True)]

    def slopes_at(self, t: float) -> tuple[float, ...]:
        """d tau (names times joints) of what is held at t."""
        place: int = self.control.sample(t)
        return self.values[place]
