"""Values and derivatives of coupling laws at states, by numpy or, for one state, by floats.

The rows are those of the equations of motion (`mechanics/law_rows.py`), recorded once per
mechanism, with joint positions as independent numbers.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.elements.program import Derivative, Given, Program, Slot
from robodyn.engines import straightline
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.expression import FUNCTIONS, Graph, Value
from robodyn.engines.formulas import RECORDED, Formula
from robodyn.engines.series import Series, State
from robodyn.errors import LawError
from robodyn.mechanics.law_rows import LawRows
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Curve, Law
from robodyn.tables.arrays import Array

NUMPY = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}  # what numpy calls them
LONG = {name: getattr(np, NUMPY.get(name, name)) for name in FUNCTIONS}
LONG["pow"] = np.power


class CouplingLaws:
    """The laws in a mechanism's rows `places`, with lever arms `arms` (L,), m.

    `ties` lists (law, joint) for each derivative that is not zero.  Times t broadcast to the
    states.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        rows = [(r, row) for r, row in enumerate(mechanism.rows) if row.law is not None]
        self.n, self.count = mechanism.n, len(rows)
        self.places = [r for r, _ in rows]
        self.arms = np.array([row.arm for _, row in rows])
        self.above = mechanism.above
        laws = [row.law for _, row in rows if row.law is not None]
        self.ties, self._values, self._bends = _codes(laws, self.n)

    def values(self, q: NDArray[Any], t: ArrayLike) -> Array:
        """Return the laws at q (..., n), as (..., L), rad or m."""
        return self._values(t, q)[..., : self.count]

    def slopes(self, q: NDArray[Any], t: ArrayLike) -> Array:
        """Return the derivatives of the laws by joints at q (..., n), (..., L, n)."""
        each = self._values(t, q)[..., 2 * self.count :]
        found = np.zeros((*each.shape[:-1], self.count, self.n), each.dtype)
        for i, (law, joint) in enumerate(self.ties):
            found[..., law, joint] = each[..., i]
        return found

    def drifts(self, q: NDArray[Any], t: ArrayLike) -> Array:
        """Return the partial derivatives of the laws by time at q (..., n), (..., L)."""
        return self._values(t, q)[..., self.count : 2 * self.count]

    def bends(self, q: NDArray[Any], qd: NDArray[Any], t: ArrayLike, rate: float = 1.0) -> Array:
        """Return the laws' second time derivatives for zero joint accelerations, (..., L).

        Time itself advances at `rate`.
        """
        q, qd = np.broadcast_arrays(q, qd)
        return self._bends(t, q, qd, np.full((*q.shape[:-1], 1), rate))

    def relative(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return joint values (..., n) from coordinates x = J q."""
        q = np.array(x)
        for k, above in enumerate(self.above):
            if above is not None:
                q[..., k] -= x[..., above]
        return q

    def add_gap(self, x: NDArray[Any], t: ArrayLike, gap: NDArray[Any]) -> None:
        """Subtract the laws from the gap (..., r) at coordinates x (..., n)."""
        gap[..., self.places] -= self.arms * self.values(self.relative(x), t)

    def add_jacobian(self, x: NDArray[Any], t: ArrayLike, Psi: NDArray[Any]) -> None:
        """Subtract the laws' slopes from d gap/dx (..., r, n) at x (..., n)."""
        slopes = self.slopes(self.relative(x), t) * self.arms[:, None]
        Psi[..., self.places, :] -= slopes
        for k, above in enumerate(self.above):
            if above is not None:
                Psi[..., self.places, above] += slopes[..., k]

    def add_drift(self, x: NDArray[Any], t: ArrayLike, drift: NDArray[Any]) -> None:
        """Subtract the laws' partial time derivatives from d gap/dt (..., r)."""
        drift[..., self.places] -= self.arms * self.drifts(self.relative(x), t)

    def add_bias(self, x: NDArray[Any], xd: NDArray[Any], t: ArrayLike, bias: NDArray[Any]) -> None:
        """Subtract the laws' second derivatives from the gap's acceleration (..., r)."""
        bias[..., self.places] -= self.arms * self.bends(self.relative(x), self.relative(xd), t)


class _Code:
    """A formula of t and states: by numpy for many states, by floats for one."""

    def __init__(self, formula: Formula) -> None:
        self.width = len(formula.outputs)
        self._floats = straightline.compile_floats(formula, "laws")
        self._long = straightline.compile_floats(formula, "laws", LONG)
        self._arrays = ArrayFormula(formula.inputs, formula.outputs)

    def __call__(self, t: ArrayLike, *states: NDArray[Any]) -> Array:
        """Return the outputs (..., width) at times t (...) and states (..., k)."""
        shape = states[0].shape[:-1]
        times = np.broadcast_to(np.asarray(t)[..., None], (*shape, 1))
        each = [x.reshape(-1, x.shape[-1]) for x in (times, *states)]
        if np.result_type(*each) == np.longdouble:
            exact: Any = [self._long(*np.concatenate(x)) for x in zip(*each, strict=True)]
            return np.array(exact, np.longdouble).reshape(*shape, self.width)  # type: ignore[return-value]
        if len(each[0]) == 1:
            try:
                found = self._floats(*(x for state in each for x in state.ravel().tolist()))
                return np.array(found).reshape(*shape, self.width)
            except (ArithmeticError, ValueError):
                pass  # numpy makes nan of it
        values = np.empty((len(each[0]), self.width))
        with np.errstate(all="ignore"):
            self._arrays.fill([np.ascontiguousarray(x, dtype=float) for x in each], (values,))
        return values.reshape(*shape, self.width)


def _codes(laws: list[Law | Curve], n: int) -> tuple[list[tuple[int, int]], _Code, _Code]:
    """Return the ties of the laws, the code of values and slopes, and that of second derivatives.

    Slopes by time come first, one per law, then one per pair of law and joint.
    """
    program, graph = Program(), Graph()

    def variable(name: str) -> Slot:
        return program.add(Given(name))

    rows = LawRows(program, variable)
    values: list[Slot] = []
    drifts: list[Slot] = []
    slopes: list[Slot] = []
    ties: list[tuple[int, int]] = []
    for i, law in enumerate(laws):
        value = rows.value(law)
        values.append(rows.made.slot(value))
        drifts.append(rows.made.slot(*rows.slopes(value, ["t"])))
        names = sorted(law.names - {"t"})
        ties += [(i, int(name[1:])) for name in names]
        slopes += [rows.made.slot(x) for x in rows.slopes(value, names)]
    bends = [program.add(Derivative(program.add(Derivative(x)))) for x in values]
    q, qd = (tuple(f"{name}{k}" for k in range(n)) for name in ("q", "qd"))
    given: dict[str, Any] = {
        x: (graph.variable(x), graph.variable(xd)) for x, xd in zip(q, qd, strict=True)
    }
    given["t"] = graph.variable("t"), graph.variable("td")
    wanted = [*values, *drifts, *slopes, *bends]
    numbers: list[Value] = list(program.numbers)
    series = Series(program, RECORDED, numbers, 1, State((), (), given), slots=wanted)
    series.residuals(0)
    first = [series.real[x][0] for x in wanted]
    own = len(wanted) - len(bends)
    at, moving = ("t", *q), ("t", *q, *qd, "td")
    both = Formula(at, tuple(first[:own]), ()), Formula(moving, tuple(first[own:]), ())
    return ties, _Code(both[0]), _Code(both[1])


@lru_cache(maxsize=64)
def laws_of(mechanism: Mechanism) -> CouplingLaws | None:
    """Return the laws of a mechanism, or None if it has none."""
    return CouplingLaws(mechanism) if mechanism.laws else None


def law_values(mechanism: Mechanism, coupling: int, q: ArrayLike, t: ArrayLike) -> Array:
    """Return the value (...) of a coupling's law at q (..., n) and t (...), rad or m."""
    laws = laws_of(mechanism)
    assert laws is not None
    return laws.values(np.asarray(q, float), t)[..., _place(mechanism, coupling)]


def law_derivatives(
    mechanism: Mechanism, coupling: int, joint: int, q: ArrayLike, t: ArrayLike
) -> tuple[Array, Array, Array]:
    """Return a coupling's law f, and f', f'' by one of its joints, at q (..., n) and t.

    Each is (...).  The other joints and time are held.  For a linear coupling f is its right side.
    """
    said = mechanism.description.couplings[coupling]
    at = np.asarray(q, float)
    if said.law is None:
        ratios = dict(said.terms)
        value = said.angle + sum(ratio * at[..., k] for k, ratio in ratios.items())
        value = np.broadcast_to(value, at.shape[:-1])
        return value, np.full(value.shape, ratios.get(joint, 0.0)), np.zeros(value.shape)
    laws = laws_of(mechanism)
    assert laws is not None
    i = _place(mechanism, coupling)
    way = np.zeros(at.shape)
    way[..., joint] = 1.0
    bends = laws.bends(at, way, t, 0.0)[..., i]
    return laws.values(at, t)[..., i], laws.slopes(at, t)[..., i, joint], bends


def check_laws(mechanism: Mechanism, q: ArrayLike, qd: ArrayLike | None, t: ArrayLike) -> None:
    """Raise LawError if a law or one of its derivatives is not finite at q, qd (..., n), t.

    Without qd only the values are checked.  The error names the law and the first such state.
    """
    laws = laws_of(mechanism)
    if laws is None:
        return
    q = np.asarray(q, float)
    each = {"no value": laws.values(q, t)}
    if qd is not None:
        q, qd = np.broadcast_arrays(q, np.asarray(qd, float))
        each["no derivative"] = laws.slopes(q, t).sum(axis=-1) + laws.drifts(q, t)
        each["no second derivative"] = laws.bends(q, qd, t)
    first = mechanism.first_coupling
    for what, values in each.items():
        lost = np.argwhere(~np.isfinite(values))
        if len(lost):
            *state, i = map(int, lost[0])
            row = laws.places[i]
            law = mechanism.rows[row].law
            assert law is not None
            now = float(np.broadcast_to(np.asarray(t, float), q.shape[:-1])[tuple(state)])
            at = {f"q{k + 1}": float(q[(*state, k)]) for k in range(mechanism.n)}
            at = {name: at[name] for name in at if f"q{int(name[1:]) - 1}" in law.names}
            if "t" in law.names:
                at["t"] = now
            told = ", ".join(f"{name} = {x:.15g}" for name, x in at.items())
            limit = f"has {what} at {told or 'this state'}"
            place = f"couplings[{row - first}]"
            raise LawError(place, where=mechanism.source, value=law.text, limit=limit)


def _place(mechanism: Mechanism, coupling: int) -> int:
    """Return the number of a coupling's law among the mechanism's laws."""
    before = mechanism.description.couplings[:coupling]
    return sum(x.law is not None for x in before)
