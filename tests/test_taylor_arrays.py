"""The series by numpy arrays: extended precision, many links, torques pushed order by order."""

from functools import cache

import numpy as np
import pytest
from test_simulation import SENSITIVITY, UNFORCED, reference

from random_mechanisms import LOOPS, Shape, seeded_scene, seeded_tree
from robodyn.actuation import Actuation, constant
from robodyn.engines.step_text import step_text
from robodyn.taylor.arrays import ArraySeries, _inverse, link_rates

EXTENDED = pytest.mark.skipif(
    np.finfo(np.longdouble).eps > 1e-18, reason="longdouble is no wider than a double here"
)
EACH = pytest.mark.parametrize("name", [1, 3, 5, *LOOPS])


@cache
def drawn(name):
    return seeded_tree(name, name) if isinstance(name, int) else seeded_scene(11, LOOPS[name])


def torques(mech):
    values = np.random.default_rng(5).uniform(-4, 4, len(mech.actuated))
    return np.array(constant(mech, values.tolist()).constants)


def expansion(name, order, dtype=np.float64):
    found = drawn(name)
    series = ArraySeries(found.mechanism, order, torques(found.mechanism), dtype)
    return series.expand(found.q.astype(dtype), found.qd.astype(dtype))


def growth(z):
    """rho with |z_k| <= rho^k."""
    orders = np.arange(1, z.shape[1])
    return float((np.abs(z[:, 1:]) ** (1.0 / orders)).max())


class TestPrecision:
    @EACH
    def test_doubles_are_extended_to_rounding(self, name):
        (z, _), (fine, _) = expansion(name, 14), expansion(name, 14, np.longdouble)
        assert fine.dtype == np.clongdouble
        assert z.dtype == np.complex128
        assert (np.abs(z - fine) / growth(fine) ** np.arange(16)).max() < 2e-12

    @EACH
    def test_doubles_are_the_straight_lines(self, name):
        found = drawn(name)
        mech = found.mechanism
        expand = step_text(mech, Actuation(tuple(torques(mech).tolist())), 10, False).expand
        _, _, series = expand(0.0, [*found.q, *found.qd], (), (), 1e-3, 1.0, 1e-9, 1e-9)
        straight = np.array(series[: mech.n]) + 1j * np.array(series[mech.n : 2 * mech.n])
        z, _ = expansion(name, 10)
        assert (np.abs(z - straight) / growth(z) ** np.arange(12)).max() < 2e-12

    @EXTENDED
    @pytest.mark.parametrize("name", UNFORCED)
    def test_a_motion_in_extended_precision(self, name):
        """Steps of the series alone; A, of doubles, is what errs."""
        known = reference(name)
        mech, order = known.mechanism, 24
        start = np.array([[np.longdouble(x) for x in part[0]] for part in (known.q, known.qd)])
        end = np.array([[np.longdouble(x) for x in part[1]] for part in (known.q, known.qd)])
        series = ArraySeries(mech, order, np.zeros(mech.n), np.longdouble)
        (q, qd), t, bound = start, np.longdouble(0), np.longdouble(known.t[1])
        while t < bound:
            z, _ = series.expand(q, qd)
            h = min(bound - t, np.longdouble(1e-21) ** (1 / 24) / growth(z))
            powers = h ** np.arange(order + 2)
            turn = z @ powers
            slope = (z[:, 1:] * np.arange(1, order + 2)) @ powers[:-1]
            q = q + series.relative @ np.arctan2(turn.imag, turn.real)
            qd = series.relative @ (turn.conj() * slope).imag
            t += h
        error = np.abs(np.array([q, qd]) - end).max()
        assert error < 5e-18 * SENSITIVITY[name] * np.abs(end).max()


class TestExpansion:
    def test_damping_and_torques_are_the_net_torque(self):
        found = drawn(3)
        mech = found.mechanism
        z, net = expansion(3, 8)
        assert any(mech.damping)
        assert net.shape == (3, 9)
        rates = np.stack([link_rates(z, k) for k in range(9)], axis=1)
        relative = ArraySeries(mech, 8, None).relative @ rates
        known = -np.array(mech.damping)[:, None] * relative
        known[:, 0] += torques(mech)
        assert net == pytest.approx(known, rel=1e-12)

    def test_without_dampers_constant_torques_do_not_change(self):
        mech = reference("five-bar").mechanism
        y = reference("five-bar").states[0]
        _, net = ArraySeries(mech, 8, np.zeros(4)).expand(y[:4], y[4:])
        assert net is None

    def test_pushed_torques(self):
        """A torque given as a series of constants is the constant."""
        found = drawn("four-bar")
        tau, orders = torques(found.mechanism), []

        def push(rates):
            orders.append(rates)
            return (tau if len(orders) == 1 else 0 * tau).tolist()

        z, _ = ArraySeries(found.mechanism, 9, None).expand(found.q, found.qd, push)
        known, _ = expansion("four-bar", 9)
        assert z == pytest.approx(known, rel=1e-11, abs=1e-11)
        assert len(orders) == 10
        assert orders[0] == pytest.approx(found.qd, abs=1e-14)

    def test_a_long_chain(self):
        """Kinetic and potential energy keep their sum in every order, dampers' loss apart."""
        chain = seeded_scene(1, Shape((None, *range(59))))
        mech = chain.mechanism
        arrays = mech.arrays
        z, net = ArraySeries(mech, 10, None).expand(chain.q, 0.05 * chain.qd, lambda r: [0.0] * 60)
        E = np.exp(1j * (arrays.J @ chain.q))
        V = z[:, 1:] * np.arange(1, 12)  # velocities turned into the links' frames
        W = E.conj()[:, None] * arrays.A * E
        for k in range(1, 8):
            kinetic = sum((V[:, m].conj() @ W @ V[:, k - m]).real for m in range(k + 1)) / 2
            potential = -(mech.gamma.conjugate() * ((arrays.B * E) @ z[:, k])).real
            rates = np.stack([link_rates(z, m) for m in range(k)], axis=1)
            relative = ArraySeries(mech, 1, None).relative @ rates
            power = sum(net[:, m] @ relative[:, k - 1 - m] for m in range(k))
            sizes = sum(np.abs(V[:, m]) @ np.abs(W) @ np.abs(V[:, k - m]) for m in range(k + 1))
            assert abs(kinetic + potential - power / k) < 1e-11 * sizes


class TestInverse:
    @pytest.mark.parametrize("dtype", [np.float64, np.longdouble])
    def test_with_zeros_on_the_diagonal(self, dtype):
        rng = np.random.default_rng(3)
        for size in (1, 2, 5, 9):
            matrix = rng.normal(size=(size, size)).astype(dtype)
            if size > 1:
                np.fill_diagonal(matrix, 0)
            product = _inverse(matrix) @ matrix
            assert np.abs(product - np.eye(size)).max() < 200 * np.finfo(dtype).eps * size

    def test_link_rates(self):
        """w = Im(conj(z) z') of z = exp(i (t + t^2)): 1 + 2 t."""
        z = np.array([[1, 1j, 1j - 1 / 2, -1 - 1j / 6]])
        assert [link_rates(z, k)[0] for k in range(2)] == pytest.approx([1.0, 2.0])
        assert abs(link_rates(z, 2)[0]) < 1e-15
