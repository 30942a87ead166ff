"""Linkages that narrowly miss a change point: against mpmath, and motions in longdoubles."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence

import mpmath as mp
import numpy as np

import robodyn
from robodyn.dynamics.closed_form import closure_jacobian
from robodyn.loops.change_points import nearness
from robodyn.loops.closing import close_positions
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text
from robodyn.simulation.extended import reference
from robodyn.simulation.simulation import simulate

Maker = Callable[[float], Mechanism]

EPS = float(np.finfo(float).eps)
BARS = """gravity: 9.81
links:
  - {{name: a, m: 0.45, l: {a!r}, r: 0.14, I: 0.0041}}
  - {{name: b, m: 1.1, l: {b!r}, r: 0.36, I: 0.049, from: a}}
  - {{name: c, m: 0.55, l: {c!r}, r: 0.16, I: 0.0052, from: [{d!r}, 0]}}
closures: [[b, c]]
actuated: [a]
"""
CRANK = """gravity: 9.81
links:
  - {{name: a, m: 0.45, l: 0.3, r: 0.14, I: 0.0041}}
  - {{name: b, m: 1.1, l: {b!r}, r: 0.16, I: 0.049, from: a}}
closures: [{{point: b, on: {{through: [0, 0], along: [1, 0]}}}}]
actuated: [a]
assembly: open
"""


def parallelogram(miss: float) -> Mechanism:
    return build(from_text(BARS.format(a=0.3, b=0.7, c=0.3, d=0.7 + miss), "parallelogram"))


def generic(miss: float) -> Mechanism:
    """The longest and the shortest bar as long as the other two, but for the miss."""
    text = BARS.format(a=0.35, b=0.8, c=0.55, d=0.35 + 0.8 - 0.55 + miss)
    return build(from_text(text, "four-bar"))


def two_four_bars(miss: float) -> Mechanism:
    """The N-four-bar, N = 2, of a last pivot that is off."""
    bar = "m: 1, l: 1, r: 0.5, I: 0.083333333333333333"
    pivots = (0.0, 1.0, 2.0 + miss)
    links = [f"{{name: v{k}, {bar}, from: [{x!r}, 0]}}" for k, x in enumerate(pivots)]
    links += [f"{{name: h{k}, {bar}, from: v{k}}}" for k in range(2)]
    text = f"gravity: 9.81\nlinks: [{', '.join(links)}]\nclosures: [[h0, v1], [h1, v2]]\n"
    return build(from_text(text, "two-four-bars"))


def slider_crank(miss: float) -> Mechanism:
    """A rod as long as the crank: it can stay at the pivot, or turn with the crank."""
    return build(from_text(CRANK.format(b=0.3 + miss), "slider-crank"))


def exact_state(mechanism: Mechanism, q: np.ndarray, rate: float, tau: float) -> list[np.ndarray]:
    """q, qd, qdd under a torque and qdd of a steady crank, with its torque: 60 digits, one loop."""
    n, arrays = mechanism.n, mechanism.arrays
    driven, *_ = mechanism.actuated
    passive = list(mechanism.passive)
    with mp.workdps(60):

        def matrix(values: np.ndarray) -> mp.matrix:
            return mp.matrix([[mp.mpmathify(complex(x)) for x in row] for row in values])

        J, A, P = (matrix(x) for x in (arrays.J, arrays.A, arrays.P))
        rows = range(P.rows)

        def part(values: mp.matrix, columns: Sequence[int]) -> mp.matrix:
            return mp.matrix([[values[i, k] for k in columns] for i in rows])

        def loop(q: mp.matrix) -> tuple[list, mp.matrix, mp.matrix]:
            E = [mp.expj(x.real) for x in J * q]
            gap = [sum((P[r, k] * E[k]).real for k in range(n)) + arrays.offset[r] for r in rows]
            Psi = mp.matrix([[-(P[r, k] * E[k]).imag for k in range(n)] for r in rows]) * J
            return E, mp.matrix(gap), Psi

        def follow(Psi: mp.matrix, value: mp.mpf, bias: mp.matrix) -> mp.matrix:
            found = mp.matrix(n, 1)
            found[driven] = value
            others = mp.lu_solve(part(Psi, passive), -(part(Psi, [driven]) * value + bias))
            for i, k in enumerate(passive):
                found[k] = others[i]
            return found

        x = mp.matrix([mp.mpf(float(v)) for v in q])
        for _ in range(60):
            E, gap, Psi = loop(x)
            step = mp.lu_solve(part(Psi, passive), gap)
            for i, k in enumerate(passive):
                x[k] -= step[i].real
            if mp.norm(step) < mp.mpf(10) ** -45:
                break
        E, gap, Psi = loop(x)
        qd = follow(Psi, mp.mpf(rate), mp.matrix(P.rows, 1))
        w = J * qd
        W = mp.matrix([[mp.conj(E[j]) * A[j, k] * E[k] for k in range(n)] for j in range(n)])
        M = J.T * W.apply(mp.re) * J
        bias = mp.matrix([-sum((P[r, k] * E[k]).real * w[k] ** 2 for k in range(n)) for r in rows])
        weights = [mp.mpmathify(complex(v)) for v in arrays.weights]
        turning = [sum(W[j, k].imag * w[k] ** 2 for k in range(n)) for j in range(n)]
        force = J.T * mp.matrix([turning[j] - (weights[j] * E[j]).imag for j in range(n)])
        K = mp.matrix(n + P.rows, n + P.rows)
        right = mp.matrix(n + P.rows, 1)
        for i in range(n):
            right[i] = force[i] + (tau if i == driven else 0)
            for j in range(n):
                K[i, j] = M[i, j]
            for j in rows:
                K[i, n + j], K[n + j, i] = -Psi[j, i], Psi[j, i]
        for j in rows:
            right[n + j] = -bias[j]
        qdd = mp.lu_solve(K, right)[:n]
        steady = follow(Psi, mp.mpf(0), bias)
        load = M * steady - force
        lam = mp.lu_solve(part(Psi, passive).T, mp.matrix([load[k] for k in passive]))
        torque = load[driven] - sum(Psi[j, driven] * lam[j] for j in rows)
        return [
            np.array([float(mp.re(v)) for v in values]) for values in (x, qd, qdd, steady, [torque])
        ]


def state_error(mechanism: Mechanism, angle: float, rate: float = 3.0, tau: float = 1.5) -> float:
    """What `accel` and `torque` miss, in units of eps (w^2 + |qdd|)/(s/L)^2."""
    q = robodyn.assemble(mechanism, [angle])
    _, qd, qdd, steady, torque = exact_state(mechanism, q, rate, tau)
    applied = np.zeros(mechanism.n)
    applied[list(mechanism.actuated)] = tau
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rates = robodyn.loop_velocities(mechanism, q, [rate])
        driven = robodyn.loop_accelerations(mechanism, q, rates, [0.0])
        found = robodyn.forward_dynamics(mechanism, q, rates, applied)
        needed = robodyn.inverse_dynamics(mechanism, q, rates, driven)
    near = float(nearness(mechanism, closure_jacobian(mechanism, q)))
    square = float(np.abs(qd).max()) ** 2
    terms = EPS / near**2
    accel = np.abs(found - qdd).max() / (square + np.abs(qdd).max())
    size = square + np.abs(steady).max() + np.abs(torque).max()
    inverse = max(np.abs(driven - steady).max(), abs(needed[mechanism.actuated[0]] - torque[0]))
    return float(max(accel, inverse / size) / terms)


def five_bar(miss: float) -> Mechanism:
    """Two freedoms: its bars can all but lie in one line."""
    lengths = (0.4, 0.5, 0.6, 0.3)
    names = ("a", "b", "c", "d")
    hangs = ("[0, 0]", "a", f"[{0.4 + 0.5 - 0.6 + 0.3 + miss!r}, 0]", "c")
    links = [
        f"{{name: {k}, m: {1 + l}, l: {l}, r: {l / 2}, I: {l / 9}, from: {h}}}"
        for k, l, h in zip(names, lengths, hangs, strict=True)
    ]
    text = f"gravity: 9.81\nlinks: [{', '.join(links)}]\nclosures: [[b, d]]\nactuated: [a, c]\n"
    return build(from_text(text, "five-bar"))


# the angle of the crank, its rate, and how long it goes, past the near miss
PASSES = {
    parallelogram: (0.5, -5.0, 0.2),
    generic: (0.5, -5.0, 0.2),
    slider_crank: (1.2, 5.0, 0.2),
    two_four_bars: (0.5, -5.0, 0.2),
}


def motion_error(make: Maker, miss: float, **options: object) -> tuple[float, float]:
    """What `simulate` misses at its end, and 2,000 eps L/s of s on the way."""
    mechanism, (angle, rate, time) = make(miss), PASSES[make]
    lying = np.zeros(mechanism.n)
    lying[list(mechanism.actuated)] = angle
    if len(mechanism.rows) == 4:
        lying = np.array([angle, angle, angle, -angle, -angle])
        q = close_positions(mechanism, lying, mechanism.actuated)
    else:
        q = robodyn.assemble(mechanism, [angle])
    qd = robodyn.loop_velocities(mechanism, q, [rate])
    nothing = Actuation((0.0,) * mechanism.n)
    exact = reference(mechanism, np.concatenate([q, qd]), np.array([time]), nothing)
    motion = simulate(mechanism, q, qd, time, **options)
    if motion.t[-1] != time:
        return np.inf, 0.0
    end = np.concatenate([motion.q[-1], motion.qd[-1]])
    nearest = motion.report.nearest_singular
    assert nearest is not None
    return float(np.abs(end - exact.y[-1]).max()), 2000.0 * EPS / nearest + exact.uncertainty


STATES = (1e-14, 1e-12, 1e-9, 1e-6, 1e-3)  # m
MOTIONS = (1e-12, 1e-9, 1e-6, 1e-3)
TIGHT: tuple[dict[str, object], ...] = (
    {"method": "taylor", "engine": "python", "rtol": 1e-14, "atol": 1e-14},
    {"method": "DOP853", "rtol": 1e-13, "atol": 1e-13},
)


def states(misses: Sequence[float] = STATES) -> Iterator[tuple[str, float]]:
    """Of each linkage the worst of several angles, in units of eps (w^2 + |qdd|)/(s/L)^2."""
    for make, singular in ((parallelogram, 0.0), (generic, 0.0), (slider_crank, np.pi / 2)):
        for miss in misses:
            angles = [singular - beside for beside in (0.03, 0.01, 1e-3, 1e-5, 1e-7)]
            worst = max(state_error(make(miss), angle) for angle in angles)
            yield f"{make.__name__}, misses by {miss:g} m", worst


def motions(
    misses: Sequence[float] = MOTIONS, ways: Sequence[dict[str, object]] = TIGHT
) -> Iterator[tuple[str, float, float]]:
    """Each linkage, by each way of integration, past its near miss: error and bound."""
    for make in PASSES:
        for miss in misses:
            for way in ways:
                found, bound = motion_error(make, miss, **way)
                yield f"{make.__name__}, misses by {miss:g} m, {way['method']}", found, bound
