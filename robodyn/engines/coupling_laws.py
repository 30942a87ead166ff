"""Values of the laws of couplings, and their derivatives, at states: by numpy, or one by floats.

The rows are those of the equations of motion (`mechanics/law_rows.py`), recorded once for each
mechanism over joints that are numbers themselves.
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
from robodyn.mechanics.law_rows import LawRows
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Law
from robodyn.tables.arrays import Array

NUMPY = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}  # what numpy calls them
LONG = {name: getattr(np, NUMPY.get(name, name)) for name in FUNCTIONS}
LONG["pow"] = np.power


class CouplingLaws:
    """The laws of a mechanism's rows: `places` are those rows, `arms` (L,) their lengths, m.

    `ties` are pairs of a law's number and a joint that it depends on, one for each slope.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        rows = [(r, row) for r, row in enumerate(mechanism.rows) if row.law is not None]
        self.n = mechanism.n
        self.places = [r for r, _ in rows]
        self.arms = np.array([row.arm for _, row in rows])
        self.above = mechanism.above
        laws = [row.law for _, row in rows if row.law is not None]
        self.ties, self._values, self._bends = _codes(laws, self.n)

    def values(self, q: NDArray[Any]) -> Array:
        """The laws at q (..., n), (..., L), rad or m."""
        return self._values(q)[..., : len(self.places)]

    def slopes(self, q: NDArray[Any]) -> Array:
        """Their derivatives by joints at q (..., n), (..., L, n)."""
        each = self._values(q)[..., len(self.places) :]
        found = np.zeros((*each.shape[:-1], len(self.places), self.n), each.dtype)
        for i, (law, joint) in enumerate(self.ties):
            found[..., law, joint] = each[..., i]
        return found

    def bends(self, q: NDArray[Any], qd: NDArray[Any]) -> Array:
        """Their second derivatives by the time where no joint accelerates, (..., L)."""
        return self._bends(q, qd)

    def relative(self, x: NDArray[Any]) -> NDArray[Any]:
        """Values of joints (..., n) of those of coordinates x = J q."""
        q = np.array(x)
        for k, above in enumerate(self.above):
            if above is not None:
                q[..., k] -= x[..., above]
        return q

    def add_gap(self, x: NDArray[Any], gap: NDArray[Any]) -> None:
        """Take the laws off the gap (..., r) at coordinates x (..., n)."""
        gap[..., self.places] -= self.arms * self.values(self.relative(x))

    def add_jacobian(self, x: NDArray[Any], Psi: NDArray[Any]) -> None:
        """Take their slopes off d gap/dx (..., r, n)."""
        slopes = self.slopes(self.relative(x)) * self.arms[:, None]
        Psi[..., self.places, :] -= slopes
        for k, above in enumerate(self.above):
            if above is not None:
                Psi[..., self.places, above] += slopes[..., k]

    def add_bias(self, x: NDArray[Any], xd: NDArray[Any], bias: NDArray[Any]) -> None:
        """Take what their curvature does off the gap's acceleration (..., r)."""
        bends = self.bends(*np.broadcast_arrays(self.relative(x), self.relative(xd)))
        bias[..., self.places] -= self.arms * bends


class _Code:
    """A formula on states: numpy on many of them, floats on one."""

    def __init__(self, formula: Formula) -> None:
        self.width = len(formula.outputs)
        self._floats = straightline.compile_floats(formula, "laws")
        self._long = straightline.compile_floats(formula, "laws", LONG)
        self._arrays = ArrayFormula(formula.inputs, formula.outputs)

    def __call__(self, *states: NDArray[Any]) -> Array:
        """The outputs (..., width) of states that each are (..., n)."""
        shape, n = states[0].shape[:-1], states[0].shape[-1]
        if states[0].dtype == np.longdouble:
            each = zip(*(x.reshape(-1, n) for x in states), strict=True)
            exact: Any = [self._long(*np.concatenate(state)) for state in each]
            return np.array(exact, np.longdouble).reshape(*shape, self.width)  # type: ignore[return-value]
        if states[0].size == n:
            try:
                found = self._floats(*(x for state in states for x in state.ravel().tolist()))
                return np.array(found).reshape(*shape, self.width)
            except (ArithmeticError, ValueError):
                pass  # numpy makes nan of it
        values = np.empty((int(np.prod(shape)), self.width))
        flat = [np.ascontiguousarray(x, dtype=float).reshape(-1, n) for x in states]
        with np.errstate(all="ignore"):
            self._arrays.fill(flat, (values,))
        return values.reshape(*shape, self.width)


def _codes(laws: list[Law], n: int) -> tuple[list[tuple[int, int]], _Code, _Code]:
    """The joints that laws depend on; code of their values and slopes, and of second derivatives.

    The slopes are one for each pair of a law's number and a joint.
    """
    program, graph = Program(), Graph()

    def variable(name: str) -> Slot:
        return program.add(Given(name))

    rows = LawRows(program, variable)
    values: list[Slot] = []
    slopes: list[Slot] = []
    ties: list[tuple[int, int]] = []
    for i, law in enumerate(laws):
        value = rows.value(law)
        values.append(rows.made.slot(value))
        names = sorted(law.names)
        ties += [(i, int(name[1:])) for name in names]
        slopes += [rows.made.slot(x) for x in rows.slopes(value, names)]
    bends = [program.add(Derivative(program.add(Derivative(x)))) for x in values]
    q, qd = (tuple(f"{name}{k}" for k in range(n)) for name in ("q", "qd"))
    given: dict[str, Any] = {
        x: (graph.variable(x), graph.variable(xd)) for x, xd in zip(q, qd, strict=True)
    }
    wanted = [*values, *slopes, *bends]
    numbers: list[Value] = list(program.numbers)
    series = Series(program, RECORDED, numbers, 1, State((), (), given), slots=wanted)
    series.residuals(0)
    first = [series.real[x][0] for x in wanted]
    own = len(values) + len(slopes)
    both = Formula(q, tuple(first[:own]), ()), Formula((*q, *qd), tuple(first[own:]), ())
    return ties, _Code(both[0]), _Code(both[1])


@lru_cache(maxsize=64)
def laws_of(mechanism: Mechanism) -> CouplingLaws | None:
    """The laws of a mechanism; None if it has none."""
    return CouplingLaws(mechanism) if mechanism.laws else None


def law_values(mechanism: Mechanism, coupling: int, q: ArrayLike) -> Array:
    """The value (...) of a coupling's law at q (..., n), rad or m."""
    laws = laws_of(mechanism)
    assert laws is not None
    return laws.values(np.asarray(q, float))[..., _place(mechanism, laws, coupling)]


def law_derivatives(
    mechanism: Mechanism, coupling: int, joint: int, q: ArrayLike
) -> tuple[Array, Array, Array]:
    """The law f of a coupling at q (..., n), and f' and f'' by one of its joints, (...) each.

    The other joints stay as they are.  Of a linear coupling f is its right side.
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
    i = _place(mechanism, laws, coupling)
    way = np.zeros(at.shape)
    way[..., joint] = 1.0
    bends = laws.bends(at, way)[..., i]
    return laws.values(at)[..., i], laws.slopes(at)[..., i, joint], bends


def _place(mechanism: Mechanism, laws: CouplingLaws, coupling: int) -> int:
    """The number of a coupling's law among those of the mechanism."""
    before = mechanism.description.couplings[:coupling]
    return sum(x.law is not None for x in before)
