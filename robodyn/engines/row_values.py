"""Values of the rows of a scene's program at states q, qd: by numpy, or by floats for one state.

The rows are recorded once; each name asked for becomes a formula of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from robodyn.elements.base import Element
from robodyn.elements.builder import LinkMoment, NoDirection, PointForce
from robodyn.elements.program import finite
from robodyn.engines import straightline
from robodyn.engines.arithmetic import Planar, planar_times
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.expression import Graph, Value, slopes_by
from robodyn.engines.formulas import Formula, Recorded, balance, energies
from robodyn.engines.series import Series
from robodyn.errors import SignalError
from robodyn.mechanics import parts
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.parts import no_direction
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Law, Table, signal_place
from robodyn.tables.arrays import Array, Complex

NEAR_END = 1e-3  # of a table's span, where a run that cannot go on has come to its end
SIGNALS = ("tables", "laws")
DIRECTED = ("torques", "forces")  # they are lost where a spring has no direction


class TableLeftError(SignalError):
    """A state is beyond the rows of a table."""

    def __init__(self, mechanism: Mechanism, table: Table, x: float) -> None:
        name = table.over if table.over in ("t", "x") else f"q{int(table.over[1:]) + 1}"
        place = signal_place(mechanism.description, table)
        limit = f"the rows of {table.file} end: they go from {table.x[0]:g} to {table.x[-1]:g}"
        what = f"{place}: {name}"
        super().__init__(what, where=mechanism.source, value=f"{x:.9g}", limit=limit)


class _Code:
    """Code of a formula whose pivots are squared lengths that must not be zero."""

    def __init__(self, formula: Formula) -> None:
        self.formula = formula

    @cached_property
    def floats(self) -> straightline.FloatFunction:
        return straightline.compile_floats(self.formula._replace(pivots=()), "rows")

    @cached_property
    def arrays(self) -> ArrayFormula:
        return ArrayFormula(self.formula.inputs, self.formula.outputs + self.formula.pivots)


class RowValues:
    """Rows of a mechanism at states, by name.

    "torques" (n): load of the joints, N m; "forces" (2p): forces of `acting`, x and y, N;
    "moments": those of `couples`, N m; "tables": arguments of tables; "laws": values of
    expressions; "power" (1): power without a potential, W; "gap" (r), m; "PE" (1), J; "PE rate"
    (1), W.
    """

    def __init__(self, mechanism: Mechanism, graph: Graph | None = None) -> None:
        self.mechanism = mechanism
        self._recorded = Recorded(mechanism, ("qd",), by_direction=True, graph=graph)
        self._codes: dict[str, _Code] = {}

    def __call__(
        self, name: str, q: ArrayLike, qd: ArrayLike | None = None, t: ArrayLike = 0.0
    ) -> Array:
        """Return values (..., k) at q and qd (..., n), which broadcast, and time t (...).

        qd is zero by default.  Raises SingularError if the ends of a spring that needs a direction
        coincide, and SignalError if a table has ended or an expression is not finite.
        """
        if name not in self._codes:
            self._codes[name] = _Code(self._formula(name))
        code, n = self._codes[name], self.mechanism.n
        rates = np.zeros(n) if qd is None else np.asarray(qd, float)
        q, qd = np.broadcast_arrays(np.asarray(q, float), rates)
        widths = len(code.formula.outputs), len(code.formula.pivots)
        shape = (*q.shape[:-1], widths[0])
        states = [x.reshape(-1, n) for x in (q, qd)]
        if self._recorded.timed:
            states.append(np.broadcast_to(np.asarray(t, float), q.shape[:-1]).reshape(-1, 1))
        if q.size == n:
            try:
                found = code.floats(*(x for state in states for x in state.ravel().tolist()))
                if not self.mechanism.signals or finite(list(found)):
                    return np.array(found).reshape(shape)
            except (ArithmeticError, ValueError):
                pass  # arrays say where
        values, squares = (np.empty((len(states[0]), k)) for k in widths)
        code.arrays.fill(states, (values, squares))
        lost = np.argwhere(squares == 0.0)
        if lost.size:
            element, _ = self._squares()[lost[0, -1]]
            raise no_direction(self.mechanism, self.mechanism.name_of(element))
        if self.mechanism.signals and name not in SIGNALS and not np.isfinite(values).all():
            self.check_signals(q, qd, t)
        return values.reshape(shape)

    def check_signals(self, q: ArrayLike, qd: ArrayLike, t: ArrayLike = 0.0) -> None:
        """Raise SignalError if a table ends before a state or an expression is not finite.

        States that are not finite themselves are ignored.
        """
        if self.mechanism.has_tables:
            places = self("tables", q, qd, t)
            for k, (table, _) in enumerate(self.tables):
                x = places[..., k][np.isfinite(places[..., k])]
                out = x[(x < table.x[0]) | (x > table.x[-1])]
                if out.size and not table.repeats:
                    raise TableLeftError(self.mechanism, table, float(out.flat[0]))
        if all(isinstance(signal, Table) for signal in self.mechanism.signals):
            return
        values = self("laws", q, qd, t)
        states = np.broadcast_arrays(q, qd, np.asarray(t, float)[..., None])
        sound = np.isfinite(states).all(axis=(0, -1))
        for k, (law, _) in enumerate(self._recorded.equations.laws):
            lost = np.argwhere(sound & ~np.isfinite(values[..., k]))
            if len(lost):
                raise self._not_finite(law, [x[tuple(lost[0])] for x in states])

    def _not_finite(self, law: Law, state: Sequence[Array]) -> SignalError:
        """Return the error for an expression not finite at q (n,), qd (n,), t (n,)."""
        q, qd, t = (x.tolist() for x in state)
        values = {f"q{k}": (f"q{k + 1}", x) for k, x in enumerate(q)}
        values |= {f"qd{k}": (f"qd{k + 1}", x) for k, x in enumerate(qd)} | {"t": ("t", t[0])}
        at = [f"{name} = {x:.9g}" for key, (name, x) in values.items() if key in law.names]
        limit = f"is not finite at {', '.join(at) or 'this state'}"
        place = signal_place(self.mechanism.description, law)
        return SignalError(place, where=self.mechanism.source, value=law.text, limit=limit)

    def planar(
        self, name: str, q: ArrayLike, qd: ArrayLike | None = None, t: ArrayLike = 0.0
    ) -> Complex:
        """Return values that come as x and y as complex numbers (..., k/2)."""
        found = self(name, q, qd, t)
        return found[..., ::2] + 1j * found[..., 1::2]

    def _formula(self, name: str) -> Formula:
        rows = tuple(self.nodes(name))
        squares = tuple(x for _, x in self._squares()) if name in DIRECTED else ()
        return Formula(self._recorded.inputs + self._recorded.timed, rows, squares)

    def nodes(self, name: str) -> Sequence[Value]:
        """Return the formulas of the values called `name`."""
        match name:
            case "torques":
                return balance(self._recorded, self._series)
            case "forces":
                return [x for force in self._forces() for x in force]
            case "PE":
                q, qd = (self._recorded.relative[x] for x in ("q", "qd"))
                return [energies(self.mechanism, float, q, qd)[1] + self.mechanism.energy_offset]
            case "PE rate":
                rates = enumerate(self._recorded.relative["qd"])
                return slopes_by(self.nodes("PE"), {f"q{k}": {"t": x} for k, x in rates}, ["t"])
        real, named = self._series.real, self._series.program.named
        equations = self._written
        given = {name: [x for _, x in getattr(equations, name)] for name in SIGNALS}
        given["moments"] = [x.torque for x in equations.couples]
        if name in given:
            return [real[slot][0] for slot in given[name]]
        return [real[slot][0] for slot in named[name]] or [0.0]  # without power where none acts

    @property
    def tables(self) -> list[tuple[Table, int]]:
        """Tables with the index of their argument."""
        return self._written.tables

    @property
    def acting(self) -> list[PointForce]:
        """Forces at points."""
        return self._written.forces

    @property
    def couples(self) -> list[LinkMoment]:
        """Torques on links."""
        return self._written.couples

    @property
    def _written(self) -> EquationsOfMotion:
        _, equations = self._series, self._recorded.equations  # the series has them written
        return equations

    @cached_property
    def _series(self) -> Series:
        try:
            series = self._recorded.series([0.0] * self.mechanism.n, power=True)
        except NoDirection as error:
            raise no_direction(self.mechanism, *error.args) from None
        series.residuals(0)
        return series

    def _forces(self) -> Iterator[Planar]:
        for x in self.acting:
            by = x.unit.real, x.unit.imag
            yield by if x.force is None else planar_times(by, self._series.ground(x.force, 0))

    def _squares(self) -> list[tuple[Element, Value]]:
        """Return |d|^2 for each element that needs a direction."""
        real = self._series.real
        return [(x.element, real[x.square][0]) for x in self.acting if x.square is not None]


def near_table_end(mechanism: Mechanism, t: float, y: Array) -> str:
    """Return a sentence on a table that ends next to state y = (q, qd, ...), or ""."""
    rows, n = rows_of(parts.acting, mechanism), mechanism.n
    places = rows("tables", y[:n], y[n : 2 * n], t)
    for (table, _), x in zip(rows.tables, places.tolist(), strict=True):
        first, last = table.x[0], table.x[-1]
        left = min(abs(x - first), abs(x - last)) / (last - first)
        if not table.repeats and left <= NEAR_END:
            return f"it leaves the table: {TableLeftError(mechanism, table, x)}"
    return ""


@lru_cache(maxsize=64)
def rows_of(part: Callable[[Mechanism], Mechanism], mechanism: Mechanism) -> RowValues:
    """Return the rows of a part of a mechanism (`parts.py`), cached."""
    return RowValues(part(mechanism))
