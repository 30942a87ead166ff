"""heyoka: Taylor series compiled for one system of differential equations by LLVM.

Its systems are the textbook's (27) of a 2R arm and (33) of a four-bar, in its expressions.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import heyoka as hy
import numpy as np
from bench_frontier import Array, Case, Run

from robodyn import Mechanism

System = list[tuple[Any, Any]]


def two_link_system(arm: Mechanism) -> System:
    """(27) without torques: M qdd = -C qd - G by Cramer's rule."""
    q1, q2, qd1, qd2 = hy.make_vars("q1", "q2", "qd1", "qd2")
    (M11, M12, M22), (f1, f2) = _two_links(arm, q1, q2, qd1, qd2)
    det = M11 * M22 - M12 * M12
    qdd = [(M22 * f1 - M12 * f2) / det, (M11 * f2 - M12 * f1) / det]
    return list(zip((q1, q2, qd1, qd2), (qd1, qd2, *qdd), strict=True))


def four_bar_system(linkage: Mechanism) -> System:
    """(33) without torques, q = (crank, coupler relative, rocker)."""
    crank, coupler, rocker = linkage.description.links
    names = ("q1", "q2", "q3", "qd1", "qd2", "qd3")
    q1, q2, q3, qd1, qd2, qd3 = variables = hy.make_vars(*names)
    (M11, M12, M22), (f1, f2) = _two_links(linkage, q1, q2, qd1, qd2)
    r3, l1, l2, l3 = rocker.r.real, crank.l, coupler.l, rocker.l
    M33 = rocker.m * r3**2 + rocker.I
    f3 = rocker.m * r3 * linkage.gamma.imag * hy.cos(q3)
    det = M11 * M22 - M12 * M12

    def solve(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:  # M^-1 (x, y, z)
        return (M22 * x - M12 * y) / det, (M11 * y - M12 * x) / det, z / M33

    def dot(u: Any, v: Any) -> Any:
        return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]

    c1, c12, c3 = l1 * hy.cos(q1), l2 * hy.cos(q1 + q2), l3 * hy.cos(q3)
    s1, s12, s3 = l1 * hy.sin(q1), l2 * hy.sin(q1 + q2), l3 * hy.sin(q3)
    u, v = (-s1 - s12, -s12, s3), (c1 + c12, c12, -c3)  # the rows of Psi
    squares = (qd1 * qd1, (qd1 + qd2) * (qd1 + qd2), qd3 * qd3)
    free, along_u, along_v = solve(f1, f2, f3), solve(*u), solve(*v)
    e1 = dot(u, free) - dot((c1, c12, -c3), squares)
    e2 = dot(v, free) - dot((s1, s12, -s3), squares)
    S11, S12, S22 = dot(u, along_u), dot(u, along_v), dot(v, along_v)
    det_S = S11 * S22 - S12 * S12
    k1, k2 = (S22 * e1 - S12 * e2) / det_S, (S11 * e2 - S12 * e1) / det_S
    qdd = [free[i] - along_u[i] * k1 - along_v[i] * k2 for i in range(3)]
    return list(zip(variables, (qd1, qd2, qd3, *qdd), strict=True))


def _two_links(mechanism: Mechanism, q1: Any, q2: Any, qd1: Any, qd2: Any) -> tuple[Any, Any]:
    """(M11, M12, M22) and -C qd - G of the first two links in series."""
    upper, fore = mechanism.description.links[:2]
    g, r1, r2 = -mechanism.gamma.imag, upper.r.real, fore.r.real
    b, M22 = fore.m * upper.l * r2, fore.m * r2**2 + fore.I
    a = upper.m * r1**2 + upper.I + fore.m * upper.l**2 + M22
    bc, h = b * hy.cos(q2), b * hy.sin(q2)
    G2 = fore.m * r2 * g * hy.cos(q1 + q2)
    f1 = h * qd2 * (2.0 * qd1 + qd2) - (upper.m * r1 + fore.m * upper.l) * g * hy.cos(q1) - G2
    return (a + 2.0 * bc, M22 + bc, hy.expression(M22)), (f1, -h * qd1 * qd1 - G2)


def system(mechanism: Mechanism) -> System:
    if mechanism.n == 2 and not mechanism.rows:
        return two_link_system(mechanism)
    if mechanism.n == 3 and len(mechanism.rows) == 2:
        return four_bar_system(mechanism)
    raise NotImplementedError("equations by hand: the 2R and the four-bar only")


def terms(mechanism: Mechanism) -> dict[str, Callable[..., Array]]:
    variables, rates = zip(*system(mechanism), strict=True)
    compiled = hy.cfunc(list(rates), list(variables))
    n = mechanism.n
    return {"qdd": lambda q, qd: compiled(np.concatenate([q, qd]))[n:]}


def ready_seconds(case: Case, tolerance: float) -> tuple[float, float]:
    """Seconds to have the system compiled for this tolerance: anew, and from the cache on disk."""
    state, seconds = hy.llvm_state, []
    enabled = state.get_diskcache_enabled()
    prepared(case, 1e-3)  # what loads once does not count
    for cached in (False, True, True):
        state.set_diskcache_enabled(cached)
        state.clear_memcache()
        start = perf_counter()
        prepared(case, tolerance)
        seconds.append(perf_counter() - start)
    state.set_diskcache_enabled(enabled)
    return seconds[0], seconds[2]


def prepared(case: Case, tolerance: float) -> Run:
    engine = hy.taylor_adaptive(system(case.mechanism), case.start.tolist(), tol=tolerance)

    def run() -> Array:
        engine.time = 0.0
        engine.state[:] = case.start
        engine.propagate_until(case.time)
        return engine.state.copy()

    return run


def runs(case: Case, tolerances: list[float]) -> dict[str, list[Run]]:
    return {"taylor_adaptive": [prepared(case, tolerance) for tolerance in tolerances]}
