"""The program of a scene for lanes, and what of it is evaluated, as numpy code or row by row.

Straight-line code is written once for each shape; of large mechanisms it would be long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.expansion import MotionProgram
from robodyn.engines.expression import Graph
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import RECORDED, Formula
from robodyn.engines.series import Arithmetic, Series, State, Value
from robodyn.engines.straightline import compile_arrays
from robodyn.loops.closing import CLOSED, loop_size
from robodyn.loops.projection import loop_terms
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.program import Slot
from robodyn.sweeps.step_extremes import sums

Array = NDArray[np.float64]
Lanes = NDArray[Any]
Number = Any  # a float that all lanes share, or an array (B,)

STRAIGHT = 1000  # entries of A and P, times the order, up to which straight-line code is written


def _convolve(x: Array, y: Array, m: int, first: int, last: int) -> Array:
    """Sum of x_j y_{m-j} for j from first to last."""
    return sums(x[first : last + 1], y[m - last : m - first + 1][::-1])


def _power(x: Number, exponent: float) -> Number:
    if exponent == -0.5:
        return 1.0 / np.sqrt(x)
    return np.sqrt(x) if exponent == 0.5 else np.power(x, exponent)


def over_lanes(B: int) -> Arithmetic:
    """Numbers are arrays (B,), series (K, B)."""
    return Arithmetic(
        cos=np.cos,
        sin=np.sin,
        power=_power,
        functions={"tanh": np.tanh},
        convolve=_convolve,
        room=lambda orders: np.zeros((orders, B)),
    )


class Start(NamedTuple):
    """Where something is evaluated, over any kind of numbers; q and qd (n)."""

    arithmetic: Arithmetic
    numbers: Sequence[Value]
    sizes: Sequence[Value]  # of rows
    q: Sequence[Value]
    qd: Sequence[Value]
    state: State


class LaneProgram:
    """The program of one mechanism, for lanes; `driven` (n) tells where there are torques.

    Those of one `key` are equal: they differ in `numbers` alone.
    """

    def __init__(self, mechanism: Mechanism, driven: NDArray[np.bool_], order: int) -> None:
        self.mechanism, self.order = mechanism, order
        constants = tuple(1.0 if x else 0.0 for x in driven)
        self.motion = MotionProgram(mechanism, Actuation(constants), work=True)
        self.n, self.r = mechanism.n, len(mechanism.rows)
        program = self.program = self.motion.program
        self.closures = replace(program, residuals=program.residuals[self.n :])
        self.states = replace(program, residuals=[])
        lightest = min(a.real for j, k, a in mechanism.A if j == k and a.real > 0.0)
        self.sizes = [row.size**2 for row in mechanism.rows]
        self.others = [CLOSED * loop_size(mechanism), lightest, *self.motion.arms]
        self.straight = loop_terms(mechanism) * order <= STRAIGHT

    @property
    def numbers(self) -> list[float]:
        """All that may differ between those of one key."""
        return [*self.program.numbers, *self.sizes, *self.others]

    @cached_property
    def key(self) -> tuple[object, ...]:
        """What lanes of one `LaneMotion` share."""
        return self.program.shape, self.mechanism.parent, self.order

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LaneProgram) and self.key == other.key

    # -- what is evaluated, in one list ------------------------------------------------------------

    def series(self, at: Start) -> list[Value]:
        """rho (order + 2, n), theta likewise, power (order + 1), what may bend (order, k)."""
        found = self.motion.expand(at.arithmetic, at.numbers, self.order, at.state)
        values = [*zip(*found.rho, strict=True), *zip(*found.theta, strict=True)]
        values += [*zip(found.power), *zip(*found.watched, strict=True)]
        return [x for each in values for x in each]

    def watched(self, at: Start) -> list[Value]:
        """The values (k) of what may bend."""
        return self._values(at, self.motion.bends)

    def energies(self, at: Start) -> list[Value]:
        """KE and PE less its constant, J."""
        return self._values(at, [*self.program.named["KE"], *self.program.named["PE"]])

    def _values(self, at: Start, slots: Sequence[Slot]) -> list[Value]:
        series = Series(self.states, at.arithmetic, at.numbers, 0, at.state, slots=slots)
        series.residuals(0)
        return [series.real[slot][0] for slot in slots]

    def closing(self, at: Start) -> list[Value]:
        """A Newton step of q (n), the rates' projection (n), gaps (r), relative pivots (r)."""
        gaps, Psi = self._closures(at)
        for row in Psi:  # to joints
            for k in reversed(self.mechanism.order):
                above = self.mechanism.parent[k]
                if above is not None and k in row:
                    row[above] = row[above] + row[k] if above in row else row[k]
        normal = [
            {s: total for s, other in enumerate(Psi) if (total := _dot(row, other)) is not None}
            for row in Psi
        ]
        factors = Factors(normal, self.r)
        speeds = [_dot(row, dict(enumerate(at.qd))) for row in Psi]
        values: list[Value] = []
        for right in (gaps, speeds):
            multipliers = dict(enumerate(factors.solve(right)))
            for k in range(self.n):
                step = _dot({r: row[k] for r, row in enumerate(Psi) if k in row}, multipliers)
                values.append(0.0 if step is None else step)
        pivots = zip(factors.pivots, at.sizes, strict=True)
        return [*values, *gaps, *(pivot / size for pivot, size in pivots)]

    def jacobian(self, at: Start) -> list[Value]:
        """The entries of Psi in alpha that are not zero at every state."""
        Psi = self._closures(at)[1]
        return [row.get(k, 0.0) for row, own in zip(Psi, self._own, strict=True) for k in own]

    @property
    def _own(self) -> list[list[int]]:
        """The links of each row."""
        rows = self.mechanism.rows
        return [sorted({k for k, _ in row.P} | {k for k, _ in row.angles}) for row in rows]

    def rows(self, entries: Array) -> list[dict[int, Value]]:
        """What `jacobian` tells, row by row."""
        each = iter(entries)
        return [{k: next(each) for k in own} for own in self._own]

    def _closures(self, at: Start) -> tuple[list[Value], list[dict[int, Value]]]:
        """The gaps, and the rows of Psi in alpha."""
        gaps = self.program.named["gap"]
        series = Series(self.closures, at.arithmetic, at.numbers, 1, at.state, slots=gaps)
        series.residuals(0)
        Psi = [{k: x for k, x in row.items() if k < self.n} for row in series.matrix()]
        return [series.real[slot][0] for slot in gaps], Psi


def _dot(a: dict[int, Value], b: dict[int, Value]) -> Value | None:
    products = [a[k] * b[k] for k in a if k in b]
    return sum(products[1:], products[0]) if products else None


Quantity = Callable[[LaneProgram, Start], list[Value]]


class Code(NamedTuple):
    function: Callable[..., None]
    buffers: int
    outputs: int


@lru_cache(maxsize=64)
def code_of(what: Quantity, program: LaneProgram) -> Code:
    """Straight-line code of what programs of one key tell."""
    graph, n = Graph(), program.n

    def variables(name: str, count: int) -> list[Value]:
        return [graph.variable(f"{name}{k}") for k in range(count)]

    lists = {name: variables(name, n) for name in ("q", "qd", "alpha", "rate", "c", "s", "tau")}
    numbers, sizes = variables("number", len(program.program.numbers)), variables("size", program.r)
    state = state_of(program, *lists.values())
    outputs = what(program, Start(RECORDED, numbers, sizes, lists["q"], lists["qd"], state))
    names = [str(x.args[0]) for each in (*lists.values(), numbers, sizes) for x in each]
    function, buffers = compile_arrays(Formula(tuple(names), tuple(outputs), ()), what.__name__)
    return Code(function, buffers, len(outputs))


def state_of(
    program: LaneProgram, q: Any, qd: Any, alpha: Any, w: Any, c: Any, s: Any, tau: Any
) -> State:
    given = program.motion.given(0.0, q, qd, alpha, ((), ()))
    given |= {f"tau{j}": (x,) for j, x in enumerate(tau)}
    return State(list(zip(c, s, strict=True)), w, given)
