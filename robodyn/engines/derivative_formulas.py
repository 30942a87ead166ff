"""The derivatives of a mechanism's dynamics as formulas: tangents of the program's residuals.

The residuals R = r(q, qd, tau) + K(q) u vanish at the unknowns u: the accelerations a of x, and
mu = -lambda.  With u held,

    du = -K^-1 dR

so that what is eliminated once serves all directions.
"""

from __future__ import annotations

from robodyn.engines.expression import Value
from robodyn.engines.factors import Factors
from robodyn.engines.formulas import Formula, Recorded, closure_pivots, written
from robodyn.engines.frames import relative
from robodyn.engines.series import Series
from robodyn.engines.tangents import slopes_by, substituted
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


def _directions(mechanism: Mechanism) -> list[str]:
    return [f"{kind}{k}" for kind in KINDS for k in range(mechanism.n)]


def forward_derivatives_formula(mechanism: Mechanism, parameters: bool = False) -> Formula | None:
    """qdd (n), then its derivatives by q, qd and tau, each (n, n), row by row.

    None as by `forward_formula`.
    """
    return written(mechanism, lambda way: _forward(Recorded(mechanism, KINDS[1:], way, parameters)))


def _forward(state: Recorded) -> Formula:
    mechanism, n = state.mechanism, state.mechanism.n
    names, (series, r, _, R) = _directions(mechanism), residuals(state)
    factors = series.factorise()
    assert isinstance(factors, Factors)
    u = factors.solve([-x for x in r])
    slopes = substituted(slopes_by(R, names), {f"u{i}": x for i, x in enumerate(u)})
    every = (factors.solve([-x for x in slopes[j :: len(names)]]) for j in range(len(names)))
    found = [relative(mechanism, du[:n]) for du in every]
    outputs = relative(mechanism, u[:n])
    for kind in range(len(KINDS)):
        outputs += [found[kind * n + j][i] for i in range(n) for j in range(n)]
    pivots = closure_pivots(state, factors)
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
