"""SymPy: the Lagrangian of the scene derived and made into numpy code by lambdify, with cse."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import sympy as sp
from bench_frontier import Array, Run

from robodyn import Mechanism
from robodyn.scene.scene import Point


class Lagrangian:
    """Symbols and expressions of a scene; gaps are those of its closures."""

    def __init__(self, mechanism: Mechanism) -> None:
        links = mechanism.description.links
        if any(link.payload or link.damping for link in links):
            raise NotImplementedError("payload, damping")
        n = mechanism.n
        self.q, self.qd, self.qdd = (
            sp.Matrix(sp.symbols(f"{name}0:{n}")) for name in ("q", "qd", "qdd")
        )

        @cache
        def angle(k: int | None) -> Any:
            return 0 if k is None else angle(links[k].hangs_from.link) + self.q[k]

        @cache
        def place(point: Point) -> Any:
            x, y, c, s = point.at.real, point.at.imag, 1, 0
            if point.link is not None:
                c, s = sp.cos(angle(point.link)), sp.sin(angle(point.link))
            here = sp.Matrix([x * c - y * s, x * s + y * c])
            return here if point.link is None else place(links[point.link].hangs_from) + here

        kinetic, potential = 0, 0
        g = mechanism.description.gravity
        for k, link in enumerate(links):
            centre = place(Point(k, link.r))
            velocity = centre.jacobian(self.q) * self.qd
            spin = sp.diff(angle(k), self.q.T).dot(self.qd)
            kinetic += (link.m * velocity.dot(velocity) + link.I * spin**2) / 2
            potential -= link.m * (g.real * centre[0] + g.imag * centre[1])
        momentum = sp.Matrix([kinetic]).jacobian(self.qd)
        self.M = momentum.jacobian(self.qd)
        self.G = sp.Matrix([potential]).jacobian(self.q).T
        force = sp.Matrix([kinetic - potential]).jacobian(self.q).T
        self.bias = momentum.jacobian(self.q) * self.qd - force
        gaps = []
        for closure in mechanism.description.closures:
            if closure.along is not None:
                raise NotImplementedError("slider")
            gaps.append(place(closure.first) - place(closure.second))
        self.Psi = sp.Matrix.vstack(sp.zeros(0, n), *(gap.jacobian(self.q) for gap in gaps))
        self.drift = (self.Psi * self.qd).jacobian(self.q) * self.qd

    def compiled(self, *expressions: Any) -> Callable[..., Any]:
        """A function of q, qd, qdd, whose parts may be arrays for lists of expressions."""
        return sp.lambdify([list(self.q), list(self.qd), list(self.qdd)], expressions, cse=True)


def terms(mechanism: Mechanism) -> dict[str, Callable[..., Array]]:
    made = Lagrangian(mechanism)
    both = made.compiled(made.M, made.bias, made.G, made.Psi, made.drift)
    n, actuated = mechanism.n, list(mechanism.actuated)

    def parts(q: Array, qd: Array) -> list[Array]:
        M, bias, G, Psi, drift = both(q, qd, np.zeros(n))
        return [M, bias[:, 0], G[:, 0], np.reshape(Psi, (-1, n)), np.ravel(drift)]

    def torques(q: Array, qd: Array, qdd: Array) -> Array:
        M, bias, _, Psi, _ = parts(q, qd)
        tau = np.zeros(n)
        shares = np.hstack([np.eye(n)[:, actuated], Psi.T])
        tau[actuated] = np.linalg.solve(shares, M @ qdd + bias)[: len(actuated)]
        return tau

    def accelerations(q: Array, qd: Array) -> Array:
        M, bias, _, Psi, drift = parts(q, qd)
        r = len(Psi)
        whole = np.block([[M, Psi.T], [Psi, np.zeros((r, r))]])
        return np.linalg.solve(whole, np.concatenate([-bias, -drift]))[:n]

    return {
        "M": lambda q: parts(q, np.zeros(n))[0],
        "G": lambda q: parts(q, np.zeros(n))[2],
        "bias": lambda q, qd: parts(q, qd)[1],
        "tau": torques,
        "qdd": accelerations,
    }


def batches(tree: Mechanism, q: Array, qd: Array, qdd: Array) -> dict[str, Run]:
    made = Lagrangian(tree)
    torques = made.compiled(*(made.M * made.qdd + made.bias))
    columns = [list(np.ascontiguousarray(x.T)) for x in (q, qd, qdd)]
    return {"lambdify, cse, arrays": lambda: np.column_stack(torques(*columns))}
