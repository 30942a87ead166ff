"""L D L^T factors of the matrix [M Psi^T; Psi 0], over any kind of numbers.

There is no pivoting.  Each closure follows links that have a positive definite M and on which
independent closures have full rank, so no pivot vanishes except at singular states.  Small pivots
show how near these are; rank-deficient or ill-scaled systems go to the null-space solver.

Singular value decompositions fall back on LAPACK's QR iteration, which always converges.  The
divide-and-conquer method of numpy fails on some nearly singular matrices (of 100 closures in
series, say).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from robodyn.tables.arrays import Array

Value = Any

SMALL = 24  # unknowns up to which closures stand behind all links: no search for an order pays


class Factors:
    """Factors of a symmetric matrix given by full rows; the first `links` rows belong to links.

    `keep` marks factors that are used again and again.
    """

    def __init__(
        self,
        matrix: Sequence[dict[int, Value]],
        links: int,
        keep: Callable[[Value], Value] = lambda value: value,
    ) -> None:
        size = len(matrix)
        self.place = elimination_order(matrix, links)  # of each unknown
        at = sorted(range(size), key=self.place.__getitem__)
        upper: list[dict[int, Value]] = [{} for _ in range(size)]
        for i, row in enumerate(matrix):
            for j, value in row.items():
                if self.place[j] >= self.place[i]:
                    upper[self.place[i]][self.place[j]] = value
        self.inverse: list[Value] = []
        self.columns: list[list[tuple[int, Value]]] = []
        self.pivots: list[Value] = [0.0] * size
        for i in range(size):
            row = upper[i]
            pivot = row.pop(i, 0.0)
            self.pivots[at[i]] = pivot
            self.inverse.append(keep(1.0 / pivot))
            columns = sorted(row)
            self.columns.append([(j, keep(row[j] * self.inverse[i])) for j in columns])
            for place, j in enumerate(columns):
                factor = self.columns[i][place][1]
                for k in columns[place:]:
                    product = factor * row[k]
                    before = upper[j].get(k)
                    upper[j][k] = -product if before is None else before - product

    def solve(self, right: Sequence[Value]) -> list[Value]:
        """Return the unknowns for a right side, in the order of the matrix."""
        x: list[Value] = [0.0] * len(right)
        for unknown, value in enumerate(right):
            x[self.place[unknown]] = value
        for i, columns in enumerate(self.columns):
            if type(x[i]) is float and x[i] == 0.0:
                continue
            for j, factor in columns:
                x[j] = x[j] - factor * x[i]
        for i in reversed(range(len(x))):
            total = x[i] * self.inverse[i]
            for j, factor in self.columns[i]:
                total = total - factor * x[j]
            x[i] = total
        return [x[place] for place in self.place]


def small_system(
    rows: Sequence[Sequence[Value]], right: Sequence[Value]
) -> tuple[list[Value], Value]:
    """Solve one or two linear equations `rows` x = right; return x and the determinant."""
    if len(rows) == 1:
        return [right[0] / rows[0][0]], rows[0][0]
    (a, b), (c, d) = rows
    det = a * d - b * c
    return [(right[0] * d - right[1] * b) / det, (a * right[1] - c * right[0]) / det], det


def elimination_order(matrix: Sequence[dict[int, Value]], links: int) -> list[int]:
    """Return the position of each unknown in the elimination.

    Links come first, then closures.  In large systems a closure follows the last of its links, and
    links that interact stay close together.
    """
    size = len(matrix)
    if size <= SMALL:
        return list(range(size))
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    pairs = {(i, j) for i in range(links) for j in matrix[i] if j < links and i != j}
    members = [[j for j in matrix[r] if j < links] for r in range(links, size)]
    pairs |= {(i, j) for group in members for i in group for j in group if i != j}
    narrow = list(range(links))
    if pairs and len(pairs) <= links * links // 2:
        rows, columns = zip(*sorted(pairs), strict=True)
        graph = csr_matrix(([1.0] * len(rows), (rows, columns)), shape=(links, links))
        order = reverse_cuthill_mckee(graph, symmetric_mode=True)
        for place, link in enumerate(order.tolist()):
            narrow[link] = place
    keys = [(narrow[k], -1) for k in range(links)]
    keys += [(max((narrow[j] for j in group), default=links), r) for r, group in enumerate(members)]
    places = [0] * size
    for i, which in enumerate(sorted(range(size), key=keys.__getitem__)):
        places[which] = i
    return places


WELL = 1e7  # condition number below which a matrix may be inverted


def svd(a: Array, full: bool = False) -> tuple[Array, Array, Array]:
    """Return U, s, Vt of finite matrices (..., r, n); with `full`, U and Vt are square."""
    try:
        U, s, Vt = np.linalg.svd(a, full_matrices=full)
    except np.linalg.LinAlgError:
        from scipy.linalg import svd as decompose

        parts = [
            decompose(each, full_matrices=full, lapack_driver="gesvd")
            for each in a.reshape(-1, *a.shape[-2:])
        ]
        U, s, Vt = (
            np.array(x).reshape(*a.shape[:-2], *x[0].shape) for x in zip(*parts, strict=True)
        )
    return U, s, Vt


def least_solution(matrices: Array, right: Array, cut: float) -> Array:
    """Return the x (k, n) of least norm that minimises |matrices x - right|.

    Matrices are (k, r, n), right (k, r).  Singular values below `cut` times the largest count as
    zero.  Well-conditioned square matrices are inverted instead, ten times as fast.
    """
    x, left = np.zeros((len(right), matrices.shape[-1])), np.ones(len(right), bool)
    if matrices.shape[-1] == matrices.shape[-2]:
        with suppress(np.linalg.LinAlgError):
            inverses = np.linalg.inv(matrices)
            x = (inverses @ right[..., None])[..., 0]
            squares = [np.square(each).sum(axis=(-1, -2)) for each in (matrices, inverses)]
            left = ~(squares[0] * squares[1] <= WELL * WELL)
    if left.any():
        U, s, Vt = svd(matrices[left])
        kept = s > cut * s[..., :1]
        along = np.divide(1.0, s, out=np.zeros_like(s), where=kept)
        along = along * np.einsum("...ij,...i->...j", U, right[left])
        x[left] = np.einsum("...ji,...j->...i", Vt, along)
    return np.asarray(x)


def damped(matrix: Array, right: Array, damping: Array | float, least: float = 0.0) -> Array:
    """Return the x (..., n) that minimises |matrix x - right|^2 + damping |x|^2.

    This is a Levenberg-Marquardt step.  Singular values up to `least` count as zero. right is (...,
    r).
    """
    U, s, Vt = svd(matrix)
    kept = s > least
    parts = np.where(kept, s, 0.0) / np.where(kept, s * s + np.asarray(damping)[..., None], 1.0)
    parts = parts * (np.swapaxes(U, -1, -2) @ right[..., None])[..., 0]
    return np.asarray((np.swapaxes(Vt, -1, -2) @ parts[..., None])[..., 0])
