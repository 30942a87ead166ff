"""The derivatives of a mechanism's dynamics as formulas: tangents of the program's residuals.

The residuals R = r(q, qd, tau) + K(q) u vanish at the unknowns u: the accelerations a of x, and
mu = -lambda.  With u held,

    du = -K^-1 dR

so that what is eliminated once serves all directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from robodyn.engines.expression import Value
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import Formula, Recorded, cheapest, closure_pivots
from robodyn.engines.frames import relative
from robodyn.engines.series import Series
from robodyn.engines.tangents import Tangents, slopes_by, substituted
from robodyn.mechanics.planar_model import Mechanism

KINDS = ("q", "qd", "tau")


def residuals(state: Recorded) -> tuple[Series, list[Value], list[dict[int, Value]], list[Value]]:
    """The series, r, K and R of a state whose unknowns are the inputs u0, u1, .."""
    series = state.series(None)
    r = series.residuals(0)
    K = series.matrix()
    u = [state.graph.variable(f"u{i}") for i in range(len(r))]
    R = [x + sum((k * u[i] for i, k in row.items()), 0.0) for x, row in zip(r, K, strict=True)]
    return series, r, K, R


class Solved:
    """The unknowns u of a state as nodes, and how they change."""

    def __init__(self, state: Recorded) -> None:
        self.state = state
        series, r, _, self.R = residuals(state)
        factors = series.factorise()
        assert isinstance(factors, Factors)
        self.factors, self.u = factors, factors.solve([-x for x in r])

    def along(
        self,
        names: Sequence[str],
        by: Mapping[str, Tangents] | None = None,
        R: Sequence[Value] | None = None,
        **known: Value,
    ) -> Iterator[list[Value]]:
        """du by each of the names, which the inputs change `by`; some values may be known."""
        held = {**known, **{f"u{i}": x for i, x in enumerate(self.u)}}
        slopes = substituted(slopes_by(R or self.R, by or names, names), held)
        for j in range(len(names)):
            yield self.factors.solve([-x for x in slopes[j :: len(names)]])


def _directions(mechanism: Mechanism) -> list[str]:
    return [f"{kind}{k}" for kind in KINDS for k in range(mechanism.n)]


def forward_derivatives_formula(mechanism: Mechanism, parameters: bool = False) -> Formula | None:
    """qdd (n), then its derivatives by q, qd and tau, each (n, n), row by row.

    None as by `forward_formula`.
    """
    return cheapest(lambda way: _forward(Recorded(mechanism, KINDS[1:], way, parameters)))


def _forward(state: Recorded) -> Formula:
    mechanism, n = state.mechanism, state.mechanism.n
    solved, names = Solved(state), _directions(mechanism)
    found = [relative(mechanism, du[:n]) for du in solved.along(names)]
    outputs = relative(mechanism, solved.u[:n])
    for kind in range(len(KINDS)):
        outputs += [found[kind * n + j][i] for i in range(n) for j in range(n)]
    pivots = closure_pivots(state, solved.factors)
    return Formula(state.inputs + state.timed, tuple(outputs), pivots)


def residual_derivatives_formula(mechanism: Mechanism) -> Formula:
    """K (N, N), then dR by q, qd and tau (N, 3n), row by row, at given unknowns u (N)."""
    state = Recorded(mechanism, KINDS[1:], True)
    _, r, K, R = residuals(state)
    size = len(r)
    names = _directions(mechanism)
    outputs = [row.get(j, 0.0) for row in K for j in range(size)]
    outputs += slopes_by(R, names)
    inputs = (*state.inputs, *(f"u{i}" for i in range(size)), *state.timed)
    return Formula(inputs, tuple(outputs), ())
