"""Differences over random states, relative to the size of the terms in what is compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import numpy as np
from bench_frontier import ROOT, Array

import robodyn
from robodyn.dynamics.named_points import point_jacobian
from robodyn.loops.loop_rates import loop_accelerations, loop_velocities
from robodyn.mechanics.mechanism import Mechanism

ROUNDING = 1e-13
STATES = 200
SLIDE = 0.04  # m, what displacements are of an angle of 1 rad

States = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True)
class Row:
    """One line: what an engine needs or reaches, and robodyn; ratio: of seconds, ours / theirs."""

    part: str
    what: str
    engine: str
    theirs: float
    unit: str
    ours: float | None = None
    ratio: float | None = None
    bound: float | None = None

    @property
    def ok(self) -> bool | None:
        if self.bound is None:
            return None
        value = self.theirs if self.ratio is None else self.ratio
        return bool(value <= self.bound)


def motion_states(mechanism: Mechanism, count: int) -> States:
    """Random q, qd, qdd that keep the closures, of any size there; displacements are small."""
    free = np.random.default_rng(mechanism.n).normal(size=(3, count, len(mechanism.actuated)))
    free[..., [k in mechanism.slides for k in mechanism.actuated]] *= SLIDE
    if not mechanism.rows:
        return free[0] * 2.0, free[1], free[2]
    q = robodyn.assemble(mechanism, free[0] * 2.0)
    qd = loop_velocities(mechanism, q, free[1], t=0.0)
    return q, qd, loop_accelerations(mechanism, q, qd, free[2], t=0.0)


class Compared(NamedTuple):
    """What is compared: robodyn's values, what they are functions of, the size of their terms."""

    ours: Array
    arguments: tuple[Array, ...]
    terms: Array


def compared(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> dict[str, Compared]:
    M, C = robodyn.mass_matrix(mechanism, q), robodyn.coriolis_matrix(mechanism, q, qd)
    G = robodyn.gravity_vector(mechanism, q)
    rates, accelerations = qd[..., None], qdd[..., None]
    arrays = mechanism.arrays
    weight = arrays.J.T @ np.abs(mechanism.gamma * arrays.B)  # the largest that gravity makes G
    weight = np.maximum(weight, np.abs(G))  # springs may make it larger
    passing = (np.abs(C) @ np.abs(rates))[..., 0] + weight + np.abs(arrays.damping * qd)
    passing += np.abs(robodyn.other_forces(mechanism, q, qd))
    bias, T = (C @ rates)[..., 0] + G, freedoms(mechanism)
    of = [f"tip{k + 1}" for k in range(mechanism.n)]
    x, v, a = robodyn.points(mechanism, q, qd, qdd, of)[1:]
    J = point_jacobian(mechanism, mechanism.tips, q)
    reach = np.abs(J).sum(axis=-1)
    fast = np.abs(rates).sum(axis=-2)[..., None]
    bent = reach * (np.abs(accelerations).sum(axis=-2)[..., None] + fast**2)
    torques = np.zeros_like(q)
    torques[..., list(mechanism.actuated)] = qdd[..., list(mechanism.actuated)]
    slopes: dict[str, Compared] = {}
    if not (mechanism.rows or mechanism.passive):
        inverse = robodyn.inverse_dynamics_derivatives(mechanism, q, qd, qdd)[1:4]
        forward = robodyn.forward_dynamics_derivatives(mechanism, q, qd, np.zeros_like(q))[1:4]
        dtau, dqdd = (np.concatenate(x, axis=-1) for x in (inverse, forward))
        size = np.abs(np.linalg.inv(M)) @ np.abs(dtau)
        slopes = {
            "dtau": Compared(dtau, (q, qd, qdd), dtau),
            "dqdd": Compared(dqdd, (q, qd), np.concatenate([dqdd, size], axis=-1)),
            "regressor": Compared(Y := inertial_columns(mechanism, q, qd, qdd), (q, qd, qdd), Y),
        }
    return slopes | {
        "M": Compared(M, (q,), M),
        "G": Compared(G, (q,), weight),
        "bias": Compared(bias, (q, qd), passing),
        "tau": Compared(
            robodyn.inverse_dynamics(mechanism, q, qd, qdd),
            (q, qd, qdd),
            passing + (np.abs(M) @ np.abs(accelerations))[..., 0],
        ),
        "qdd": Compared(
            robodyn.forward_dynamics(mechanism, q, qd, np.zeros_like(q)),
            (q, qd),
            (np.abs(np.linalg.inv(M)) @ passing[..., None])[..., 0],
        ),
        "M reduced": Compared(T.T @ M @ T, (q,), np.abs(T.T) @ np.abs(M) @ np.abs(T)),
        "bias reduced": Compared(bias @ T, (q, qd), passing @ np.abs(T)),
        "point": Compared(x, (q,), x),
        "point velocity": Compared(v, (q, qd), reach * fast),
        "point acceleration": Compared(a, (q, qd, qdd), bent),
        "point Jacobian": Compared(J, (q,), J),
        "driven": Compared(  # qdd by torques of the actuated joints, of any size
            robodyn.forward_dynamics(mechanism, q, qd, torques),
            (q, qd, torques),
            (np.abs(np.linalg.inv(M)) @ (passing + np.abs(torques))[..., None])[..., 0],
        ),
    }


def inertial_columns(mechanism: Mechanism, q: Array, qd: Array, qdd: Array) -> Array:
    """The regressor's columns (T, n, 4n) of m, m rx, m ry, J of each link."""
    found = robodyn.regressor(mechanism, q, qd, qdd)
    names = [f"{name}{k + 1}" for k in range(mechanism.n) for name in ("m", "mx", "my", "J")]
    return found.Y[..., [found.names.index(name) for name in names]]


def freedoms(mechanism: Mechanism) -> Array:
    """T of qd = T ud, u the joints that no coupling gives, where couplings follow only those."""
    couplings = mechanism.description.couplings
    T = np.eye(mechanism.n)
    for coupling in couplings:
        T[coupling.joint, coupling.joint] = 0.0
        for k, ratio in coupling.terms:
            T[coupling.joint, k] = ratio
    return np.delete(T, [coupling.joint for coupling in couplings], axis=1)


def apart(known: Compared, function: Callable[..., Array]) -> float:
    """The largest difference of their values from ours, relative to the size of the terms."""
    theirs = np.array([np.array(function(*x)) for x in zip(*known.arguments, strict=True)])
    return worst(theirs - known.ours, known.terms)


def product(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]


def worst(differences: Array, *terms: Array) -> float:
    """The largest difference at a state (the first axis), relative to the size of the terms."""

    def largest(values: Array) -> Array:
        return np.abs(values).reshape(len(values), -1).max(axis=1)

    return float((largest(differences) / sum(largest(term) for term in terms)).max())


def agreement(engines: dict[str, ModuleType]) -> Iterator[Row]:
    for scene in ("2r", "3r", "four-bar"):
        mechanism = robodyn.load(ROOT / f"robots/{scene}.yaml")
        known = compared(mechanism, *motion_states(mechanism, STATES))
        rows = []
        for name, engine in engines.items():
            try:
                terms = engine.terms(mechanism)
            except NotImplementedError:
                continue
            for term, function in terms.items():
                kind, _, remark = term.partition(", ")
                bound = None if remark else ROUNDING
                value = apart(known[kind], function)
                rows.append(Row("agreement", f"{scene}, {term}", name, value, "", bound=bound))
        yield from sorted(rows, key=lambda row: list(known).index(row.what.split(", ")[1]))
