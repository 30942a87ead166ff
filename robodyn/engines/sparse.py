"""The equations of a mechanism with many links, assembled as a sparse system and factorised.

In absolute angles [M Psi^T; Psi 0] has a few entries a link, however many loops there are, so a
sparse factorisation costs close to linearly in the number of loops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import splu

from robodyn.engines.row_values import rows_of
from robodyn.loops.change_points import EXACT, Closing, suspect_quality
from robodyn.loops.closing import newton
from robodyn.mechanics import parts
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

SINGULAR = 1e-12  # ratio of pivots below which a factorisation is not trusted
CONVERGED = 3e-15  # rad


class _Pattern:
    """A symmetric sparse matrix of fixed pattern, refilled and factorised."""

    def __init__(self, rows: NDArray[np.int64], columns: NDArray[np.int64], size: int) -> None:
        order = csc_matrix((np.arange(1.0, len(rows) + 1.0), (rows, columns)), shape=(size, size))
        self._fill = order.data.astype(np.int64) - 1
        self._matrix = order

    def factorise(self, values: Array) -> Any:
        self._matrix.data = values[self._fill]
        return splu(self._matrix)


class SparseMechanism:
    """The constants of a mechanism as index arrays, and its system assembled from them."""

    def __init__(self, mechanism: Mechanism) -> None:
        n, r = mechanism.n, len(mechanism.rows)
        self.n, self.r = n, r
        self.mechanism = mechanism
        self.weight, self.moments = np.array(mechanism.weights), np.array(mechanism.moments)
        self.damping = np.array(mechanism.damping)
        rotors = _rotors(mechanism)
        entries_of_A = _with_places(mechanism.A, rotors)
        self.j, self.k = (np.array([entry[i] for entry in entries_of_A]) for i in (0, 1))
        self.A = np.array([entry[2] for entry in entries_of_A])
        self.rotors = np.array([rotors.get(entry[:2], 0.0) for entry in entries_of_A])
        self.off = np.flatnonzero(self.j != self.k)
        entries = [
            (row, k, p, a)
            for row, x in enumerate(mechanism.rows)
            for k, p, a in (*((k, p, 0.0) for k, p in x.P), *((k, 0j, a) for k, a in x.angles))
        ]
        self.row, self.link = (np.array([e[i] for e in entries], dtype=int) for i in (0, 1))
        self.P, self.angles = (np.array([e[i] for e in entries]) for i in (2, 3))
        self.offset = np.array([x.offset for x in mechanism.rows])
        self.held = list(mechanism.held)
        paths = [(k, ancestor) for k in range(n) for ancestor in mechanism.path(k)]
        self.J = csr_matrix((np.ones(len(paths)), tuple(np.array(paths).T)), shape=(n, n))
        children = [(k, above) for k, above in enumerate(mechanism.parent) if above is not None]
        self.child, self.above = (np.array([c[i] for c in children], dtype=int) for i in (0, 1))
        j, k, off = self.j, self.k, self.off
        self._system = _Pattern(
            np.concatenate([j, k[off], self.link, n + self.row]),
            np.concatenate([k, j[off], n + self.row, self.link]),
            n + r,
        )

    def directions(self, q: Array) -> NDArray[np.complex128]:
        """E."""
        direction: NDArray[np.complex128] = np.exp(1j * (self.J @ q))
        return direction

    def accelerations(self, baumgarte: float, t: float, y: Array, tau: Array) -> Array | None:
        """qdd (n); None for states too near a singular configuration."""
        n = self.n
        E = self.directions(y[:n])
        rates = self.J @ y[n : 2 * n]
        squares = rates**2
        w = E[self.j].conj() * self.A * E[self.k]
        joint = tau - self.damping * y[n : 2 * n]
        if self.mechanism.has_state_forces:
            joint -= rows_of(parts.acting, self.mechanism)("torques", y[:n], y[n : 2 * n], t)
        force: Array = joint - (self.weight * E).imag + self.moments
        force = force - np.bincount(self.above, joint[self.child], minlength=n)
        j, k, turning = self.j[self.off], self.k[self.off], w.imag[self.off]
        force = force + np.bincount(j, turning * squares[k], minlength=n)
        force = force - np.bincount(k, turning * squares[j], minlength=n)
        PE = self.P * E[self.link]
        slope = self.angles - PE.imag  # Psi
        bend = np.asarray(
            np.bincount(self.row, PE.real * squares[self.link], minlength=self.r), float
        )
        if baumgarte:
            gapd = np.bincount(self.row, slope * rates[self.link], minlength=self.r)
            gap = self.gap(PE, self.J @ y[:n])
            bend = bend - 2 * baumgarte * gapd - baumgarte**2 * gap
        inertia = w.real + self.rotors if self.mechanism.rotors else w.real
        values = np.concatenate([inertia, inertia[self.off], slope, slope])
        try:
            factors = self._system.factorise(values)
        except RuntimeError:  # splu: exactly singular
            return None
        pivots = np.abs(factors.U.diagonal())
        if not pivots.min() / pivots.max() > SINGULAR:
            return None
        absolute = factors.solve(np.concatenate([force, bend]))[:n]
        qdd: Array = absolute.copy()
        qdd[self.child] -= absolute[self.above]
        return qdd

    def gap(self, PE: NDArray[np.complex128], alpha: Array) -> Array:
        """Re(P E) + angles alpha + offset, (r,)."""
        terms = PE.real + self.angles * alpha[self.link]
        gap: Array = np.bincount(self.row, terms, minlength=self.r) + self.offset
        gap[self.held] = 0.0
        return gap

    def closing_step(self, q: Array) -> tuple[Array, Any, float, Callable[[Array], Array]]:
        """The gap at q (r,), Psi, the ratio of pivots, and what takes a gap to its least step."""
        E = self.directions(q)
        PE = self.P * E[self.link]
        slope = self.angles - PE.imag
        Psi = csr_matrix((slope, (self.row, self.link)), shape=(self.r, self.n)) @ self.J
        # unscaled and with pivots from the diagonal, which are small where a loop hardly closes
        symmetric = {"Equil": False, "SymmetricMode": True}
        factors = splu(csc_matrix(Psi @ Psi.T), diag_pivot_thresh=0.0, options=symmetric)
        pivots = np.abs(factors.U.diagonal())
        gap = self.gap(PE, self.J @ q)
        ratio = float(pivots.min() / pivots.max())
        return gap, Psi, ratio, lambda x: Psi.T @ factors.solve(x)


def _rotors(mechanism: Mechanism) -> dict[tuple[int, int], float]:
    """What rotors add to M in absolute angles, by place, that of the carrying link first."""
    found: dict[tuple[int, int], float] = {}
    for rotor in mechanism.rotors:
        own, *carrier = rotor.spin
        for place, c in (
            *(((k, k), c * c) for k, c in rotor.spin),
            *(((d, own[0]), c * own[1]) for d, c in carrier),
        ):
            found[place] = found.get(place, 0.0) + rotor.inertia * c
    return found


def _with_places(
    A: Sequence[tuple[int, int, complex]], rotors: Iterable[tuple[int, int]]
) -> list[tuple[int, int, complex]]:
    """The entries of A, with zeros where rotors alone have some."""
    known = {(j, k) for j, k, _ in A}
    return [*A, *((j, k, 0j) for j, k in rotors if (j, k) not in known)]


class _Lost(Exception):
    """A factorisation is not to be trusted."""


def closing(system: SparseMechanism, fallback: Closing) -> Closing:
    """The nearest state that closes (`projection.py`); singular ones are left to `fallback`."""
    n = system.n

    least_ratio = EXACT * suspect_quality(system.mechanism)

    def nearest(y: Array) -> tuple[Array, float]:
        last: list[Any] = []

        def evaluate(q: Array) -> tuple[bool, Array]:
            last[:] = system.closing_step(q)
            gap, _, ratio, least = last
            if not ratio > least_ratio:
                raise _Lost
            step = least(gap)
            return bool(np.abs(step).max() <= CONVERGED), step

        closed = y.copy()
        try:
            closed[:n] = newton(y[:n], evaluate)
        except (RuntimeError, _Lost):  # splu: exactly singular
            return fallback(y)
        _, Psi, ratio, least = last
        closed[n : 2 * n] -= least(Psi @ y[n : 2 * n])
        return closed, ratio

    return nearest
