"""Closing loops by Newton's method, and the closure gap in extended precision.

`newton` serves dense arrays of states here, and extended precision in `benchmark.py`.  The
straight-line code of `straightline.py` and the loops over lanes have Newton's method written out;
they call this module for states that are nearly singular.

If Psi is nearly singular, a gap rounded to eps L moves a state by eps L/s, s the least singular
value, and its accelerations by eps/s^3.  There the gap is computed exactly, in integers: then a
closed state has only its own rounding error, and accelerations err by eps/s^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robodyn.engines.coupling_laws import laws_of
from robodyn.engines.factors import least_solution, svd
from robodyn.errors import SingularPoseError
from robodyn.loops.closures import absolute_jacobian, closure_gap, gap_at, scaled_jacobian
from robodyn.mechanics.placed import placed
from robodyn.mechanics.planar_model import Mechanism
from robodyn.tables.arrays import Array

# of q (k, n), and the places of these states: which are closed to rounding (k,), and the Newton
# steps (k, n)
Evaluator = Callable[[Any, Any], tuple[Any, Any]]

NEAR_SINGULAR = 1e-2  # s/L below which a gap is computed exactly
USUAL = 0.15  # s/L of regular states: where it is less at all of them, L counts for less
CUT = 1e-10  # singular values of Psi below this part of the largest are left alone
CLOSED = 1.5e-16  # a gap below this part of the loop's size is rounding
ROUNDED = 1e-9  # above this part of the loop's size floats tell a gap well enough for a step
PASSES = 12
SEARCHED = 2_000_000  # entries of Psi times its rank, of configurations that tell what is usual
LONGEST = 0.5  # rad of a step
SAMPLED = 10.0  # s, in which laws of the time are sampled
SETTLED = 1e-6  # rad; below it steps that shrink no more are rounding
SHRINKS = 0.7  # at a singular configuration steps are halved, elsewhere squared


def random_states(
    mechanism: Mechanism, rng: np.random.Generator, count: int, joints: Sequence[int] | None = None
) -> Array:
    """Return random angles on the full circle and random displacements, (count, joints).

    Displacements are up to a length of the mechanism.  `joints` selects joints; None takes all.
    """
    chosen = range(mechanism.n) if joints is None else joints
    drawn: Array = rng.uniform(-np.pi, np.pi, (count, len(chosen)))
    for column, k in enumerate(chosen):
        if k in mechanism.slides:
            drawn[:, column] *= mechanism.unit / np.pi
    return drawn


def wrapped(mechanism: Mechanism, way: Array) -> Array:
    """Return differences of q (..., n) without full turns; displacements in lengths."""
    if not mechanism.slides:
        return half_turn(way)
    found, slides = half_turn(way), list(mechanism.slides)
    found[..., slides] = way[..., slides] / mechanism.unit
    return found


@lru_cache(maxsize=256)
def loop_size(mechanism: Mechanism) -> float:
    """Return L, the largest sum of lengths in a closure (m), the scale of gaps."""
    sizes = [row.size + (abs(row.offset) if row.P else 0.0) for row in mechanism.rows]
    return max(sizes, default=0.0)


@lru_cache(maxsize=64)
def closed_jacobians(mechanism: Mechanism) -> Array:
    """Return Psi (k, r, n) at a few closed configurations, or at random ones.

    Random open configurations are used only if none could be closed.
    """
    rows = max(1, len(mechanism.rows))
    count = max(2, min(16, SEARCHED // (mechanism.n * rows * min(mechanism.n, rows))))
    rng = np.random.default_rng(0)
    drawn = random_states(mechanism, rng, count)
    # where laws of the time have values at random times, else at 0
    tried = [rng.uniform(0.0, SAMPLED, count)] if mechanism.driven else []
    for t in (*tried, np.zeros(count)):
        with np.errstate(all="ignore"):
            q = _closed(mechanism, drawn, t, list(range(mechanism.n)), 0.0)
        inside = np.isfinite(q).all(axis=-1)
        q, t = q[inside], t[inside]
        gap = np.abs(closure_gap(mechanism, q, t)).max(axis=-1)
        closed = gap <= 1e-9 * loop_size(mechanism)
        # Newton's method closes many loops in a row from nowhere, but Psi is as regular beside
        if closed.any():
            return scaled_jacobian(mechanism, q[closed], t[closed])
    return scaled_jacobian(mechanism, drawn, np.zeros(count))


@lru_cache(maxsize=64)
def regular_rank(mechanism: Mechanism) -> int:
    """Return the rank of Psi at closed configurations that are not singular."""
    drawn = closed_jacobians(mechanism)
    if not len(drawn):
        return min(len(mechanism.rows), mechanism.n)
    s = np.linalg.svd(drawn, compute_uv=False)
    return max(1, int((s > 1e-7 * loop_size(mechanism)).sum(axis=-1).max()))


@lru_cache(maxsize=64)
def singular_size(mechanism: Mechanism) -> float:
    """Return the length (m) that singular values of Psi are compared with.

    It is the loop's size L. With N loops in series all singular values are about 1/N smaller, and
    so is the result.
    """
    size, loops = loop_size(mechanism), len(mechanism.rows) / 2
    if loops <= 2:
        return size
    s = np.linalg.svd(closed_jacobians(mechanism), compute_uv=False)
    usual = float(s[:, regular_rank(mechanism) - 1].max()) / USUAL
    return min(size, max(usual, size * 2.0 / loops))


def singular_at(mechanism: Mechanism, kind: str, q: Array, limit: str) -> SingularPoseError:
    """Return the error for a singular configuration q (n,) of a kind."""
    at = ", ".join(f"{x:.9g}" for x in q)
    what = f"singular configuration ({kind}) at q = {at}"
    return SingularPoseError(what, where=mechanism.source, limit=limit)


def half_turn(angle: Array) -> Array:
    """Return angles reduced to [-pi, pi)."""
    return np.asarray(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)


def newton(q: Any, evaluate: Evaluator) -> Any:
    """Take Newton steps from q (..., n) until each state is closed or only rounding moves it.

    Only states that still move are evaluated.
    """
    shape, q = q.shape, q.reshape(-1, q.shape[-1]).copy()
    moving, before = np.arange(len(q)), np.full(len(q), np.inf)
    for _ in range(PASSES):
        closed, step = evaluate(q[moving], moving)
        length = np.abs(step).max(axis=-1, initial=0.0)
        goes = ~closed & ~((length > SHRINKS * before) & (before < SETTLED))
        moving, step, before = moving[goes], step[goes], length[goes]
        if not len(moving):
            break
        part = np.minimum(1.0, LONGEST / np.maximum(before, LONGEST))
        q[moving] -= part[:, None] * step
    return q.reshape(shape)


def close_positions(
    mechanism: Mechanism,
    q: ArrayLike,
    fixed: Sequence[int] = (),
    exact: bool = True,
    rows: Sequence[int] | None = None,
    *,
    t: ArrayLike,
) -> Array:
    """Return the nearest closed configuration (..., n) at times t (...).

    Newton's method, with the joints `fixed` held.  If it does not converge the gap remains, and the
    caller has to check it.  `exact` closes states next to a singular configuration to the limit of
    rounding, at ten times the cost.  `rows` selects rows of Psi to be closed; None takes all.
    """
    given = np.array(q, dtype=float)
    if not mechanism.rows or not given.size:
        return given
    free = [k for k in range(mechanism.n) if k not in set(fixed)]
    near = NEAR_SINGULAR * loop_size(mechanism) if exact else 0.0
    return _closed(mechanism, given, t, free, near, rows)


def _closed(
    mechanism: Mechanism,
    given: Array,
    t: ArrayLike,
    free: list[int],
    exact: float,
    rows: Sequence[int] | None = None,
) -> Array:
    """Do the work of `close_positions`; the gap is exact below singular values of `exact`."""
    size, units = loop_size(mechanism), mechanism.arrays.units
    kept = slice(None) if rows is None else list(rows)
    times = np.broadcast_to(np.asarray(t, float), given.shape[:-1]).ravel()

    def evaluate(q: Array, moving: Any) -> tuple[Any, Array]:
        t = times[moving]
        at = placed(mechanism, q)
        gap = gap_at(mechanism, mechanism.arrays, at, t)[..., kept]
        open_by = np.abs(gap).max(axis=-1)
        closed = open_by <= CLOSED * size
        if mechanism.laws and np.isnan(open_by).any():  # where a law has no value a state stays
            closed |= np.isnan(open_by)
            gap = np.where(np.isnan(open_by)[..., None], 0.0, gap)
        step = np.zeros_like(q)
        if not exact and closed.all():
            return closed, step
        Psi = absolute_jacobian(mechanism, at, t) @ mechanism.arrays.J
        Psi = (Psi * units if mechanism.slides else Psi)[..., kept, :][..., free]
        Psi = np.where(np.isfinite(Psi), Psi, 0.0)  # a state that is not finite stays as it is
        if not exact:
            step[..., free] = least_solution(Psi, gap, CUT)
            return closed, step * units if mechanism.slides else step
        U, s, Vt = svd(Psi)
        held = s > CUT * s[..., :1]
        least = np.where(held, s, np.inf).min(axis=-1)
        near = least < exact
        if near.any():
            near &= least < NEAR_SINGULAR * singular_size(mechanism)
        # a larger gap is known well enough without
        small = open_by < ROUNDED * size
        for state in map(tuple, np.argwhere(near & small)):
            gap[state] = exact_gap(mechanism, q[state], float(t[state]))[kept]
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=held)
        along = inverse * np.einsum("...ij,...i->...j", U, gap)
        step[..., free] = np.einsum("...ji,...j->...i", Vt, along)
        return closed & ~near, step * units if mechanism.slides else step

    result: Array = newton(given, evaluate)
    return result


# -- the gap in integers ---------------------------------------------------------------------------

BITS = 140  # behind the point
ONE = 1 << BITS
HALF_PI = 0x3243F6A8885A308D313198A2E03707344A4093822299F31D0082EFA98EC4E6C89 >> (257 - BITS)


def exact_gap(mechanism: Mechanism, q: Any, t: Any) -> Array:
    """Return the gap (r,) of one state q (n,), exact to 1e-40 of the loop's size.

    q may be floats or longdoubles.  Laws of couplings are only as exact as the number type of q.
    """
    if not np.isfinite(q).all():
        return np.full(len(mechanism.rows), np.nan)
    exponent = math.frexp(loop_size(mechanism))[1]  # in units of 2^-BITS of so many metres

    def whole(x: float, power: int = BITS - exponent) -> int:
        return int(math.ldexp(x, power))

    high = np.asarray(q, float)
    low = np.asarray(q - high, float)
    parts = zip(high.tolist(), low.tolist(), strict=True)
    x = [whole(x, BITS) + whole(y, BITS) for x, y in parts]
    for k in mechanism.order:
        above = mechanism.above[k]
        if above is not None:
            x[k] += x[above]
    directions: dict[int | None, tuple[int, int]] = {None: (ONE, 0)}

    def direction(k: int | None) -> tuple[int, int]:
        if k not in directions:
            assert k is not None
            directions[k] = _cos_sin(x[k])
        return directions[k]

    def coordinate(k: int) -> tuple[int, int]:
        if k not in mechanism.slides:
            return direction(k)
        cosine, sine = direction(mechanism.frames[k])
        return x[k] * cosine >> BITS, x[k] * sine >> BITS

    gap: list[float] = []
    laws = laws_of(mechanism)  # whose values are no more exact than numbers of q's kind are
    values = (
        {} if laws is None else dict(zip(laws.places, laws.values(np.asarray(q), t), strict=True))
    )
    for r, row in enumerate(mechanism.rows):
        if row.held:
            gap.append(0.0)
            continue
        real, imag = whole(row.ground.real) << BITS, whole(row.ground.imag) << BITS
        for k, p in row.P:
            (c, s), a, b = coordinate(k), whole(p.real), whole(p.imag)
            real, imag = real + a * c - b * s, imag + a * s + b * c
        c, s = direction(row.line)
        total = (real * c + imag * s >> BITS) + sum(whole(a) * x[k] for k, a in row.angles)
        law = 0
        if row.law is not None:
            value = -row.arm * values[r]
            law = whole(float(value)) + whole(float(value - float(value)))
        gap.append(math.ldexp(float((total >> BITS) + whole(row.offset) + law), exponent - BITS))
    return np.array(gap)


def _cos_sin(angle: int) -> tuple[int, int]:
    """Return cosine and sine in units of 2^-BITS, by series in octants around the axes."""
    quarter, x = divmod(angle + (HALF_PI >> 1), HALF_PI)
    x -= HALF_PI >> 1
    square = x * x >> BITS
    cosine = term = ONE
    sine = odd = x
    k = 1
    while term:
        term = -(term * square >> BITS) // (k * (k + 1))
        odd = -(odd * square >> BITS) // ((k + 1) * (k + 2))
        cosine += term
        sine += odd
        k += 2
        if abs(term) <= 1:  # floor division of a small negative number does not end
            break
    turned = ((cosine, sine), (-sine, cosine), (-cosine, -sine), (sine, -cosine))
    return turned[quarter & 3]


@lru_cache(maxsize=64)
def loop_terms(mechanism: Mechanism) -> int:
    """Return the number of entries of A and P, which sets the cost of straight-line code."""
    return len(mechanism.A) + sum(len(row.P) + len(row.angles) for row in mechanism.rows)
