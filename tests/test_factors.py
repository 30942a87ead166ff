"""The elimination of [M Psi^T; Psi 0]: its order, its fill, its pivots."""

import itertools

import numpy as np
import pytest

from random_mechanisms import mechanism
from robodyn.engines.expansion import MotionProgram
from robodyn.engines.factors import SMALL, Factors, elimination_order
from robodyn.engines.series import FLOATS, Series
from robodyn.engines.singular_values import svd
from robodyn.mechanics.actuation import Actuation


def n_four_bar(N):
    """K of N four-bars in a row, at a crank angle of 2 rad; and the number of links."""
    bar = "m: 1, l: 1, r: 0.5, I: 0.08333333333333333"
    links = [f"{{name: v{k}, {bar}, from: [{k}, 0]}}" for k in range(N + 1)]
    links += [f"{{name: h{k}, {bar}, from: v{k}}}" for k in range(N)]
    closures = ", ".join(f"[h{k}, v{k + 1}]" for k in range(N))
    mech = mechanism(f"links: [{', '.join(links)}]\nclosures: [{closures}]\n")
    motion = MotionProgram(mech, Actuation((0.0,) * mech.n), False)
    y = [2.0] * (N + 1) + [-2.0] * N + [1.0] * (N + 1) + [-1.0] * N
    start = motion.state(FLOATS, 0.0, y, ((), ()))
    series = Series(motion.program, FLOATS, motion.program.numbers, 1, start)
    series.residuals(0)
    return series.matrix(), mech.n


def dense(matrix):
    K = np.zeros((len(matrix), len(matrix)))
    for i, row in enumerate(matrix):
        K[i, list(row)] = list(row.values())
    return K


class TestFactors:
    def test_long_rows_of_four_bars_fill_little(self):
        fills = []
        for N in (10, 20, 40):
            matrix, links = n_four_bar(N)
            size = len(matrix)
            assert (size, links) == (4 * N + 1, 2 * N + 1)
            factors = Factors(matrix, links)
            assert sorted(factors.place) == list(range(size))
            for r in range(links, size):  # a closure stands after its links
                assert all(factors.place[r] > factors.place[k] for k in matrix[r] if k < links)
            pivots = np.array(factors.pivots)
            assert (pivots[:links] > 1e-3).all()
            assert (pivots[links:] < -1e-3).all()
            right = np.random.default_rng(N).normal(size=size)
            K = dense(matrix)
            assert np.allclose(K, K.T, atol=1e-14)
            assert K @ factors.solve(right.tolist()) == pytest.approx(right, abs=1e-10)
            fills.append(sum(map(len, factors.columns)))
        for few, many in itertools.pairwise(fills):
            assert many < 2.2 * few
        assert fills[-1] < 12 * 40 * 2

    @pytest.mark.parametrize("links", [1, 4, 15, 30])
    def test_any_saddle_matrix(self, links):
        rng = np.random.default_rng(links)
        for closures in (0, links // 3, links // 2):
            A = rng.normal(size=(links, links)) * (rng.uniform(size=(links, links)) < 0.2)
            M = A @ A.T + np.eye(links)
            Psi = rng.normal(size=(closures, links))
            K = np.block([[M, Psi.T], [Psi, np.zeros((closures, closures))]])
            matrix = [{j: float(x) for j, x in enumerate(row) if x} for row in K]
            order = elimination_order(matrix, links)
            assert sorted(order) == list(range(len(K)))
            if len(K) <= SMALL:
                assert order == list(range(len(K)))
            right = rng.normal(size=len(K))
            found = Factors(matrix, links).solve(right.tolist())
            assert K @ found == pytest.approx(right, abs=1e-8)


def test_a_decomposition_where_divide_and_conquer_gives_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    a = np.random.default_rng(3).normal(size=(2, 3, 4))

    def gives_up(*args: object, **options: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", gives_up)
    U, s, Vt = svd(a)
    np.testing.assert_allclose(U * s[:, None] @ Vt, a, atol=1e-14)
    U, s, Vt = svd(a[0], full=True)
    assert Vt.shape == (4, 4)
    np.testing.assert_allclose(U * s @ Vt[:3], a[0], atol=1e-14)
