"""Steps of the series: reference digits, rows between steps, what ends a step."""

import itertools
import math

import numpy as np
import pytest
from reference_motions import SENSITIVITY, reference, scene, slope

from random_mechanisms import mechanism
from robodyn import closure_gap, closure_jacobian
from robodyn.engines.expansion import Coefficients, longest_step
from robodyn.loops.projection import float_closing, suspect_quality
from robodyn.mechanics.actuation import Actuation, expressions
from robodyn.taylor import Status, order_where_series_cost
from robodyn.taylor.compiled import CompiledEngine

EACH = pytest.mark.parametrize("name", SENSITIVITY)
ALL = 10**6
FREE = 1e100  # a tolerance that holds no step
NONE = np.zeros(0)


def engine(mech, tau="", rtol=1e-15, order=None, work=False):
    actuation = expressions(mech, tau, "test") if tau else Actuation((0.0,) * mech.n)
    return CompiledEngine(mech, actuation, rtol=rtol, atol=rtol, order=order, work=work)


def run(name, times=NONE, **options):
    known = reference(name)
    made = engine(known.mechanism, known.tau, **options)
    return made.advance(0.0, known.states[0], float(known.t[-1]), times, ALL)


class TestReferences:
    """Every motion whose digits are known."""

    @EACH
    def test_near_rounding(self, name):
        known = reference(name)
        chunk = run(name, known.t[1:])
        assert chunk.status is Status.REACHED
        assert np.array_equal(chunk.row_t, known.t[1:])
        error = np.abs(chunk.row_y - known.states[1:]).max()
        assert error < 3e-15 * SENSITIVITY[name] + 1e-13
        assert (np.diff(chunk.t) > 0).all()

    @EACH
    def test_the_error_follows_the_tolerance_and_loops_stay_closed(self, name):
        known = reference(name)
        mech, n = known.mechanism, known.mechanism.n
        times = np.union1d(known.t[1:], np.linspace(0.01, 0.4, 40))  # many lie between steps
        at = np.isin(times, known.t)
        for rtol in (1e-5, 1e-8):
            chunk = run(name, times, rtol=rtol)
            error = np.abs(chunk.row_y[at] - known.states[1:]).max()
            assert error < SENSITIVITY[name] * rtol, rtol
            for rows in (chunk.y, chunk.row_y) if mech.rows else ():
                q, qd = rows[:, :n], rows[:, n:]
                most = max(100, np.abs(q).max() * 5)
                assert np.abs(closure_gap(mech, q)).max() < 1e-16 * most
                rates = np.einsum("tij,tj->ti", closure_jacobian(mech, q), qd)
                assert np.abs(rates).max() < 1e-14 * max(1.0, np.abs(qd).max())


COUNTS = {"2r-regular": (20, 24, 30, 40), "four-bar": (80, 96, 120, 160)}  # steps in 0.5 s


@pytest.mark.parametrize("order", [6, 8, 10])
@pytest.mark.parametrize("name", COUNTS)
def test_slope_of_the_error_of_equal_steps(name, order):
    """The series are kept up to order + 1: a step errs by h^(order + 1) in the rates."""
    known = reference(name)
    mech, t = known.mechanism, float(known.t[1])
    still = Actuation((0.0,) * mech.n)  # without closings, and with a tolerance that holds no step
    made = CompiledEngine(mech, still, rtol=FREE, atol=FREE, order=order, project=False)
    counts = [round(2 * t) * count for count in COUNTS[name]]
    errors = []
    for count in counts:
        y, times = known.states[0], np.linspace(0.0, t, count + 1)
        for begin, end in itertools.pairwise(times.tolist()):
            chunk = made.advance(begin, y, end, NONE, ALL)
            assert len(chunk.t) == 1
            y = chunk.y[-1]
        errors.append(np.abs(y - known.states[1]).max())
    assert slope(t / np.array(counts), errors) == pytest.approx(order, abs=0.7)


def test_half_a_turn_in_one_step():
    """The turn is counted; no step turns by more than two radians."""
    wheel = mechanism("gravity: 0\nlinks:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}\n")
    made = engine(wheel, rtol=0.9, order=30)
    for direction in (1.0, -1.0):
        for turn in (0.5, 0.79, 0.81, 1.5, 1.99, 9.0):
            chunk = made.advance(0.0, np.array([7.0, 3.0]), direction * turn / 3.0, NONE, 1)
            assert chunk.y[0] == pytest.approx([7.0 + 3.0 * chunk.t[0], 3.0], rel=1e-14)
            assert abs(chunk.t[0]) == pytest.approx(min(turn, 2.0) / 3.0)


@pytest.mark.parametrize("broken", [0, 1])
def test_what_is_not_finite_makes_no_step(broken):
    """In whichever of two arms that share nothing."""
    links = "  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}\n"
    links += "  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031, from: [1, 0]}\n"
    pair = mechanism(f"links:\n{links}")
    for value in (1e300, np.inf, np.nan):
        tau = [0.0, 0.0]
        tau[broken] = value
        made = CompiledEngine(pair, Actuation(tuple(tau)), order=8)
        chunk = made.advance(0.0, np.array([0.1, 0.2, 0.0, 0.0]), 1.0, NONE, ALL)
        assert (chunk.status, len(chunk.t)) == (Status.NOT_FINITE, 0)


class TestRows:
    def test_are_those_of_a_restart(self):
        known = reference("five-bar")
        made = engine(known.mechanism, rtol=1e-12)
        times = np.sort(np.random.default_rng(2).uniform(0.0, 0.6, 200))  # beyond the first room
        chunk = made.advance(0.0, known.states[0], 0.6, times, ALL)
        assert np.array_equal(chunk.row_t, times)
        for t, row in zip(times[::40], chunk.row_y[::40], strict=True):
            again = made.advance(0.0, known.states[0], float(t), NONE, ALL)
            assert again.t[-1] == t
            assert np.abs(again.y[-1] - row).max() < 1e-10

    def test_at_ends_of_steps_are_the_states(self):
        known = reference("four-bar")
        made = engine(known.mechanism, rtol=1e-7)
        plain = made.advance(0.0, known.states[0], 1.0, NONE, ALL)
        chunk = made.advance(0.0, known.states[0], 1.0, plain.t, ALL)
        assert np.array_equal(chunk.t, plain.t)
        assert np.array_equal(chunk.row_t, plain.t)
        assert np.array_equal(chunk.row_y, plain.y)

    def test_do_not_depend_on_how_many_there_are(self):
        many = np.linspace(0.0, 1.0, 1001)[1:]
        rows = run("four-bar", many, rtol=1e-8)
        few = run("four-bar", many[99::100], rtol=1e-8)
        assert np.abs(rows.row_y[99::100] - few.row_y).max() < 2e-14  # rounding
        assert np.array_equal(rows.t, few.t)

    def test_backwards_is_the_mirror_of_forwards(self):
        mech = scene("2r")
        times = np.linspace(0.1, 1.0, 10)
        y, mirror = np.array([0.3, -0.4, 1.0, -2.0]), np.array([1, 1, -1, -1])
        made = engine(mech, rtol=1e-12)
        forth = made.advance(0.0, y, 1.0, times, ALL)
        back = made.advance(0.0, y * mirror, -1.0, -times, ALL)
        assert back.t == pytest.approx(-forth.t, rel=1e-13)
        assert np.abs(back.row_y * mirror - forth.row_y).max() < 1e-12

    def test_back_to_the_start(self):
        known = reference("four-bar-driven")
        made = engine(known.mechanism, known.tau, rtol=1e-13)
        t = known.t[::-1]
        chunk = made.advance(t[0], known.states[-1], 0.0, t[1:], ALL)
        assert np.abs(chunk.row_y - known.states[-2::-1]).max() < 1e-9

    def test_work_is_the_change_of_energy(self):
        """Of a flywheel: a constant torque's way, a damper's loss, an expression's series."""
        for damping, tau in ((0.0, "1.5"), (0.4, "1.5"), (0.4, "1.5*cos(t)"), (0.0, "sin(t)*qd1")):
            wheel = mechanism(
                "gravity: 0\nlinks:\n"
                f"  - {{name: a, m: 1, l: 1, r: 0, I: 2.0, damping: {damping}}}\n"
            )
            made = engine(wheel, tau, rtol=1e-12, work=True)
            times = np.linspace(0.05, 3.0, 60)
            chunk = made.advance(0.0, np.array([0.2, 1.0, 0.5]), 3.0, times, ALL)
            for rows in (chunk.y, chunk.row_y):
                assert rows[:, 2] - 0.5 == pytest.approx(rows[:, 1] ** 2 - 1.0, abs=1e-11)


class TestStatus:
    def test_some_steps_at_a_time(self):
        known = reference("four-bar")
        made = engine(known.mechanism, rtol=1e-9)
        whole = made.advance(0.0, known.states[0], 1.0, NONE, ALL)
        t, y, ends = 0.0, known.states[0], []
        while t < 1.0:
            chunk = made.advance(t, y, 1.0, NONE, 7)
            t, y = float(chunk.t[-1]), chunk.y[-1]
            ends += chunk.t.tolist()
            assert chunk.status is (Status.REACHED if t == 1.0 else Status.FULL)
        assert ends == whole.t.tolist()
        assert np.array_equal(y, whole.y[-1])

    def test_at_rest_it_goes_to_the_bound(self):
        still = mechanism("gravity: 0\nlinks:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}\n")
        chunk = engine(still).advance(0.0, np.zeros(2), 1e6, NONE, ALL)
        assert chunk.status is Status.REACHED
        assert not chunk.y.any()

    def test_not_finite(self):
        for y in ([0, 0, 1e200, 0], [0, 0, math.nan, 0], [math.inf, 0, 0, 0]):
            chunk = engine(scene("2r")).advance(0.0, np.array(y, float), 1.0, NONE, ALL)
            assert (chunk.status, len(chunk.t)) == (Status.NOT_FINITE, 0)
            assert chunk.y.shape == (0, 4)

    def test_stuck_where_time_has_no_digits_left(self):
        y = np.array([0, 0, 1e6, 0])
        chunk = engine(scene("2r")).advance(1e12, y, 2e12, NONE, ALL)
        assert (chunk.status, len(chunk.t)) == (Status.STUCK, 0)

    @pytest.mark.parametrize("t", [0.0, 0.3, 1e6])
    def test_a_bound_next_to_the_start_is_reached(self, t):
        made = engine(scene("2r"), rtol=1e-9)
        y = np.array([0.1, 0.2, 0.3, 0.4])
        for bound in (math.nextafter(t, math.inf), math.nextafter(t, -math.inf)):
            chunk = made.advance(t, y, bound, NONE, ALL)
            assert chunk.status is Status.REACHED
            assert chunk.t.tolist() == [bound]
            assert chunk.y[0] == pytest.approx(y, abs=1e-8)

    @pytest.mark.parametrize("way", [1.0, -1.0])
    def test_where_a_torque_ends(self, way):
        given = "sqrt(0.5 - t), 0" if way > 0 else "sqrt(0.5 + t), 0"
        made = engine(scene("2r"), given, rtol=1e-9)
        chunk = made.advance(0.0, np.array([0.1, 0.2, 0, 0]), way, NONE, ALL)
        assert chunk.status in (Status.STUCK, Status.NOT_FINITE)
        assert 0.4999 < way * chunk.t[-1] <= 0.5

    def test_a_singular_end_moves(self):
        """The parallelogram runs towards its horizontal: no step ends next to it."""
        mech = scene("parallelogram")
        made = engine(mech, rtol=1e-9)
        n = mech.n
        q, qd = np.array([1.0, -1.0, 1.0]), np.array([-3.0, 3.0, -3.0])
        chunk = made.advance(0.0, np.concatenate([q, qd]), 3.0, NONE, ALL)
        closing = float_closing(mech)
        qualities = [closing(row.tolist())[1] for row in chunk.y]
        assert min(qualities[:-1]) >= suspect_quality(mech)
        assert np.ptp(chunk.y[:, [0, 2]], axis=1).max() < 1e-9
        assert chunk.y.shape[1] == 2 * n


class TestStepSize:
    def test_the_last_two_orders_meet_the_tolerance(self):
        for p in (6, 14, 30):
            rho, theta = np.zeros((2, 1, p + 2))
            theta[0, 1], rho[0, -1], rho[0, -2] = 1.0, 3.0**p, 3.0 ** (p - 1)
            h = longest_step(Coefficients(rho, theta, [], []), [1.0], 1e-9, 1e-9)
            terms = (p + 1) * 3.0**p * h**p, p * 3.0 ** (p - 1) * h ** (p - 1)
            assert max(terms) == pytest.approx(2e-9, rel=1e-6)

    @pytest.mark.parametrize("size", [1e-160, 1e160, 1e250])
    def test_coefficients_whose_squares_are_no_floats(self, size):
        p = 12
        rho, theta = np.zeros((2, 1, p + 2))
        theta[0, 1], theta[0, -1] = 1.0, size
        h = longest_step(Coefficients(rho, theta, [], []), [1.0], 1e-9, 1e-9)
        assert h == pytest.approx(min(2.0, (2e-9 / (p + 1) / size) ** (1 / p)), rel=1e-6)

    def test_no_more_than_two_radians(self):
        rho, theta = np.array([[[1.0, *[0.0] * 7]], [[0.0, 10.0, *[0.0] * 6]]])
        assert longest_step(Coefficients(rho, theta, [], []), [10.0], 0.5, 0.5) <= 0.2

    def test_orders_grow_with_the_digits(self):
        orders = [order_where_series_cost(10.0**-k) for k in range(1, 17)]
        assert orders == sorted(orders)
        assert all(order % 2 == 0 and 6 <= order <= 60 for order in orders)
