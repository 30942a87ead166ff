"""scipy's solvers with a projection: on plain differential equations, nothing of mechanics here."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from each_case import each
from scipy.integrate import solve_ivp

from robodyn.runs.segments import kept_step, solver_segment
from robodyn.runs.solvers import EXPLICIT, METHODS, STIFF_STEPS, StiffError, projected

EACH_METHOD = each("method", METHODS)
TOLERANCE = 1e-8
OPTIONS = {"rtol": TOLERANCE, "atol": TOLERANCE}


def oscillator(t, y):
    return np.array([y[1], -y[0]])


def exact(t):
    return np.array([np.cos(t), -np.sin(t)])


def onto_circle(_, y):
    """The nearest point of the unit circle, on which the oscillator's motion stays."""
    return y / np.hypot(*y)


def integrate(method, fun, end, y0, t0=0.0, look=lambda solver: None, **options):
    """The accepted steps, t (T,) and y (T, n), and what scipy would say of them.

    `look` sees the solver after each.
    """
    solver = projected(method)(fun, t0, np.asarray(y0, float), end, **{**OPTIONS, **options})
    t, y = [t0], [np.asarray(y0, float)]
    while solver.status == "running":
        solver.step()
        if solver.status != "failed":
            t.append(solver.t)
            y.append(solver.y.copy())
            look(solver)
    success = solver.status == "finished"
    facts = {"success": success, "status": 0 if success else -1, "nfev": solver.nfev}
    t, y = np.array(t), np.array(y)
    return t[1:], y[1:], SimpleNamespace(t=t, y=y.T, **facts)


class TestPlain:
    @EACH_METHOD
    def test_without_projection_it_is_scipys_solver(self, method):
        """Bit for bit, step by step, evaluation by evaluation."""
        for end in (5.0, -5.0):
            t, y, found = integrate(method, oscillator, end, exact(0.0))
            known = solve_ivp(oscillator, (0, end), exact(0.0), method=method, **OPTIONS)
            assert np.array_equal(t, known.t[1:])
            assert np.array_equal(y, known.y.T[1:])
            assert found.nfev == known.nfev
            assert found.success

    @EACH_METHOD
    def test_its_name_and_its_kind(self, method):
        solver = projected(method)
        assert issubclass(solver, METHODS[method])
        assert solver.__name__ == f"Projected{method}"
        assert projected(method) is solver

    @EACH_METHOD
    def test_a_list_serves_as_rates(self, method):
        t, y, _ = integrate(method, lambda t, y: [y[1], -y[0]], 2.0, exact(0.0))
        known, states, _ = integrate(method, oscillator, 2.0, exact(0.0))
        assert np.array_equal(t, known)
        assert np.array_equal(y, states)


class TestProjection:
    @EACH_METHOD
    def test_every_accepted_state_is_projected(self, method):
        t, y, solution = integrate(method, oscillator, 20.0, exact(0.0), projection=onto_circle)
        assert np.hypot(*y.T) == pytest.approx(np.ones(len(t)), abs=3e-16)
        assert t[-1] == 20.0
        assert solution.y[:, -1] == pytest.approx(y[-1], abs=1e-14)

    @EACH_METHOD
    def test_it_costs_neither_steps_nor_digits(self, method):
        t, y, with_it = integrate(method, oscillator, 20.0, exact(0.0), projection=onto_circle)
        s, z, without = integrate(method, oscillator, 20.0, exact(0.0))
        assert len(t) <= 1.05 * len(s)
        assert with_it.nfev <= 1.05 * without.nfev + len(t)  # the rates at a state that was moved
        errors = [np.linalg.norm(y - exact(t).T), np.linalg.norm(z - exact(s).T)]
        assert errors[0] <= errors[1]
        assert errors[0] <= 1e4 * TOLERANCE * math.sqrt(len(t))

    @EACH_METHOD
    @each("end", [2.0, -2.0])
    def test_what_it_moves_stays_moved(self, method, end):
        """A solver goes on from the projected state, not from what it remembers.

        y' = cos t, y moved by d once: sin t, and sin t + d from there on.
        """
        d = 0.125
        t, y, _ = integrate(
            method,
            lambda t, y: np.array([math.cos(t)]),
            end,
            [0.0],
            projection=Once(d),
            max_step=0.1,
        )
        shift = y[:, 0] - np.sin(t)
        assert shift[: Once.STEP - 1] == pytest.approx(np.zeros(Once.STEP - 1), abs=1e-6)
        assert shift[Once.STEP - 1 :] == pytest.approx(np.full(len(t) + 1 - Once.STEP, d), abs=1e-6)

    @EACH_METHOD
    @each("rate", [1.0, -1.0])
    def test_the_rates_follow_it(self, method, rate):
        """y' = r y, y moved by d at t1: exp(r t) + d exp(r (t - t1))."""
        d = 1e-3  # as a projection's change: small
        t, y, _ = integrate(
            method, lambda t, y: rate * y, 2.0, [1.0], projection=Once(d), max_step=0.1
        )
        after = t >= t[Once.STEP - 1]
        known = np.exp(rate * t) + after * d * np.exp(rate * (t - t[Once.STEP - 1]))
        assert y[:, 0] == pytest.approx(known, abs=2e-6)
        assert abs(known[-1] - math.exp(rate * 2.0)) > 20e-6  # it would show

    @EACH_METHOD
    def test_scipys_own_record_holds_the_projected_states(self, method):
        t, y, _ = integrate(method, oscillator, 3.0, exact(0.0), projection=onto_circle)
        found = solve_ivp(
            oscillator,
            (0, 3),
            exact(0.0),
            method=projected(method),
            projection=onto_circle,
            **OPTIONS,
        )
        assert np.array_equal(found.t[1:], t)
        assert np.array_equal(found.y.T[1:], y)

    @EACH_METHOD
    def test_states_between_steps_are_projected(self, method):
        steps = []
        integrate(
            method,
            oscillator,
            3.0,
            exact(0.0),
            projection=onto_circle,
            look=lambda solver: steps.append(kept_step(solver)),
        )
        between = np.linspace(0.0, 3.0, 500)
        found = solver_segment(exact(0.0), steps).at(between).T
        assert np.hypot(*found) == pytest.approx(np.ones(500), abs=3e-16)
        assert found == pytest.approx(exact(between), abs=1e-5)


class Once:
    """A projection that moves the state by d, after one step, and never again."""

    STEP = 9

    def __init__(self, d):
        self.d, self.calls = d, 0

    def __call__(self, _, y):
        self.calls += 1
        return y + self.d if self.calls == self.STEP else y


class TestDenseOutput:
    @EACH_METHOD
    def test_is_projected_at_one_time_and_at_many(self, method):
        solver = projected(method)(
            oscillator, 0.0, exact(0.0), 50.0, projection=onto_circle, **OPTIONS
        )
        for _ in range(12):
            begun = solver.y
            assert solver.step() is None
        segment = solver_segment(begun, [kept_step(solver)])
        times = np.linspace(solver.t_old, solver.t, 7)
        many = segment.at(times)
        assert many.shape == (7, 2)
        assert np.hypot(*many.T) == pytest.approx(np.ones(7), abs=3e-16)
        for k in range(len(times)):
            one = segment.at(times[k : k + 1])
            assert one.shape == (1, 2)
            assert one[0] == pytest.approx(many[k], abs=1e-14)
        almost = np.nextafter(times[-1:], 0.0)
        assert segment.at(almost)[0] == pytest.approx(solver.y, abs=1e-14)

    @EACH_METHOD
    def test_without_projection_is_scipys(self, method):
        solvers = [
            kind(oscillator, 0.0, exact(0.0), 50.0, **OPTIONS)
            for kind in (METHODS[method], projected(method))
        ]
        for solver in solvers:
            for _ in range(12):
                solver.step()
        t = 0.3 * solvers[0].t_old + 0.7 * solvers[0].t
        plain, ours = (solver.dense_output()(t) for solver in solvers)
        assert np.array_equal(plain, ours)


class TestSteps:
    @EACH_METHOD
    def test_come_once_and_in_order(self, method):
        t, y, solution = integrate(method, oscillator, 5.0, exact(0.0))
        assert (np.diff(t) > 0).all()
        assert t[0] > 0.0
        assert t[-1] == 5.0
        assert len(t) > 5
        assert solution.y[:, -1] == pytest.approx(y[-1], abs=1e-14)

    @EACH_METHOD
    def test_may_be_looked_into(self, method):
        """Taking rows does not change the run."""

        def look(solver):
            seen.append(solver.dense_output()(0.5 * (solver.t_old + solver.t)))

        seen = []
        options = {"projection": onto_circle}
        _, _, watched = integrate(method, oscillator, 5.0, exact(0.0), look=look, **options)
        _, _, alone = integrate(method, oscillator, 5.0, exact(0.0), **options)
        assert len(seen) == len(watched.t) - 1
        assert np.array_equal(watched.t, alone.t)
        assert np.array_equal(watched.y, alone.y)

    @EACH_METHOD
    def test_none_is_one_that_failed(self, method):
        """Rates that end at t = 1: the run fails there, and what came before was seen."""

        def ends(t, y):
            return np.array([math.sqrt(1.0 - t) if t <= 1.0 else math.nan])

        t, y, solution = integrate(method, ends, 2.0, [0.0])
        assert solution.status == -1
        assert 0.9 < t[-1] <= 1.0
        assert np.isfinite(y).all()
        assert y[-1, 0] == pytest.approx(2 / 3 * (1 - (1 - t[-1]) ** 1.5), abs=1e-5)


class TestKinks:
    KINKS = (0.3, 0.7000000000000001, 1.1, 1.1000000001, 1.7)

    @staticmethod
    def rate(t):
        """A rate that bends at 0.3, steps between 1.1 and 1.1000000001, and is 0 from 1.7."""
        knots = [-9.0, 0.3, 0.7000000000000001, 1.1, 1.1000000001, 1.7, 9.0]
        return np.interp(t, knots, [0.0, 0.0, 4.0, -1.0, 5.0, 0.0, 0.0])

    AREA = 0.5 * 0.4 * 4.0 + 0.5 * 0.4 * (4.0 - 1.0) + 0.5 * 0.6 * 5.0

    @EACH_METHOD
    @each("backwards", [False, True])
    def test_are_stepped_onto_exactly(self, method, backwards):
        t0, end = (2.0, 0.0) if backwards else (0.0, 2.0)
        for kinks in (self.KINKS, self.KINKS[::-1], (*self.KINKS, -1.0, 0.0, 2.0, 2.5, 0.3)):
            t, y, solution = integrate(
                method, lambda t, y: np.array([self.rate(t)]), end, [0.0], t0, kinks=kinks
            )
            assert set(self.KINKS) <= set(t.tolist())
            assert solution.success
            assert t[-1] == end
            assert (np.diff(t) * (end - t0) > 0).all()
            assert y[-1, 0] == pytest.approx(-self.AREA if backwards else self.AREA, abs=1e-6)

    @pytest.mark.parametrize("method", EXPLICIT)
    def test_save_evaluations(self, method):
        """Between its kinks this rate is a polynomial, and no step is tried in vain."""
        counts = []
        for kinks in (self.KINKS, ()):
            _, _, solution = integrate(
                method, lambda t, y: np.array([self.rate(t)]), 2.0, [0.0], kinks=kinks
            )
            counts.append(solution.nfev)
        assert counts[0] < 0.5 * counts[1]

    @EACH_METHOD
    def test_many(self, method):
        """A table's rows, one every millisecond."""
        kinks = np.arange(201) / 1000
        heights = np.where(np.arange(201) % 2, 1.0, -1.0)
        t, y, solution = integrate(
            method, lambda t, y: [np.interp(t, kinks, heights)], 0.2, [0.0], kinks=kinks.tolist()
        )
        near = t[np.minimum(np.searchsorted(t, kinks[1:] - 1e-14), len(t) - 1)]
        assert near == pytest.approx(kinks[1:], abs=1e-15)
        assert solution.success
        assert y[-1, 0] == pytest.approx(0.0, abs=1e-6)
        where = np.searchsorted(t, kinks[1:] - 1e-14)
        assert np.abs(y[where, 0]).max() < 1e-5

    @EACH_METHOD
    def test_a_hair_apart(self, method):
        """Kinks some rounding errors apart are one, and do not stop the run."""
        near = np.nextafter(1.0, 2.0)
        kinks = [1.0, near, np.nextafter(near, 2.0), 1.0 + 1e-14]
        t, y, solution = integrate(method, oscillator, 2.0, exact(0.0), kinks=kinks)
        assert solution.success
        assert 1.0 in t
        assert y[-1] == pytest.approx(exact(2.0), abs=1e-5)

    @EACH_METHOD
    def test_none_of_them_ends_the_run(self, method):
        """The end stays where it is: a step onto a kink is no end."""
        solver = projected(method)(oscillator, 0.0, exact(0.0), 2.0, kinks=[0.01], **OPTIONS)
        seen = []
        while solver.status == "running":
            solver.step()
            seen.append(solver.t)
            assert solver.t_bound == 2.0
        assert 0.01 in seen
        assert seen[-1] == 2.0
        assert solver.status == "finished"


class TestJumps:
    """Rates that are set anew at each kink, from the state there."""

    KINKS = (0.4, 1.0, 1.7, 2.0)

    class Turned:
        """Turns on the circle, clockwise or not: each kink reverses it, and is written down."""

        restarts = True

        def __init__(self):
            self.turns, self.seen = [1.0], []

        def reach(self, t, y):
            self.turns.append(-self.turns[-1])
            self.seen.append((t, *y))

        def rates(self, t, y):
            known = [k for k, time in enumerate(TestJumps.KINKS[: len(self.seen)], 1) if time <= t]
            turn = self.turns[known[-1] if known else 0]
            return np.array([turn * y[1], -turn * y[0]])

    @classmethod
    def angle(cls, t):
        """How far it has turned."""
        bounds, ways = (0.0, *cls.KINKS), (1.0, -1.0, 1.0, -1.0, 1.0)
        parts = zip(ways, bounds, (*bounds[1:], np.inf), strict=True)
        return sum(way * np.clip(t - begin, 0.0, end - begin) for way, begin, end in parts)

    @EACH_METHOD
    @each("project", [False, True])
    def test_every_piece_has_its_own_rates(self, method, project):
        control, rows = self.Turned(), []

        def look(solver):
            between = solver.t_old + (solver.t - solver.t_old) * np.array([0.3, 0.8, 1.0])
            rows.extend(zip(between, solver.dense_output()(between).T, strict=True))

        options = {"kinks": self.KINKS, "listener": control, "look": look}
        if project:
            options["projection"] = onto_circle
        _, _, solution = integrate(method, control.rates, 2.4, exact(0.0), **options)
        assert solution.success
        assert [entry[0] for entry in control.seen] == list(self.KINKS)
        for t, *y in control.seen:
            assert y == pytest.approx(exact(self.angle(t)), abs=1e-5)
        for t, y in rows:
            assert y == pytest.approx(exact(self.angle(t)), abs=1e-5)
        assert rows[-1][0] == 2.4

    @pytest.mark.parametrize("method", EXPLICIT)
    def test_no_step_is_tried_in_vain(self, method):
        control = self.Turned()
        options = {"kinks": self.KINKS, "listener": control}
        _, _, solution = integrate(method, control.rates, 2.4, exact(0.0), **options)
        _, _, known = integrate(method, oscillator, 2.4, exact(0.0), kinks=self.KINKS)
        assert solution.nfev <= 1.06 * known.nfev + 2 * len(self.KINKS)

    @EACH_METHOD
    def test_evaluations_of_all_pieces_are_counted(self, method):
        control, calls = self.Turned(), []

        def rates(t, y):
            calls.append(t)
            return control.rates(t, y)

        options = {"kinks": self.KINKS, "listener": control}
        _, _, solution = integrate(method, rates, 2.4, exact(0.0), **options)
        assert solution.nfev <= len(calls) <= 1.6 * solution.nfev
        assert solution.nfev >= len([t for t in calls if t > 2.0])


class TestStiffness:
    LAMBDA = 1e6

    def stiff(self, t, y):
        """y' = -lambda (y - cos t), and a motion of its own that is not stiff."""
        return np.array([-self.LAMBDA * (y[0] - math.cos(t)), y[2], -y[1]])

    @pytest.mark.parametrize("method", EXPLICIT)
    @pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
    def test_an_explicit_method_tells_it(self, method, tolerance):
        steps = []
        with pytest.raises(StiffError):
            integrate(
                method,
                self.stiff,
                1.0,
                [1.0, 1.0, 0.0],
                rtol=tolerance,
                atol=tolerance,
                look=lambda solver: give_up(steps, 20_000),
            )

    def test_an_implicit_one_goes_on(self):
        t, y, solution = integrate("Radau", self.stiff, 1.0, [1.0, 1.0, 0.0], rtol=1e-6, atol=1e-6)
        assert solution.success
        assert len(t) < 2000
        assert y[-1] == pytest.approx([math.cos(1.0), math.cos(1.0), -math.sin(1.0)], abs=1e-4)

    @pytest.mark.parametrize("method", EXPLICIT)
    @pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
    @pytest.mark.thinned
    def test_a_motion_that_is_not_stiff_is_none(self, method, tolerance):
        """A thousand steps and more, as large as the tolerance lets them be."""
        end = {"RK45": 4000.0, "DOP853": 8000.0}[method]
        t, _, solution = integrate(
            method, oscillator, end, exact(0.0), rtol=tolerance, atol=tolerance
        )
        assert solution.success
        assert len(t) > STIFF_STEPS


def give_up(steps, most):
    steps.append(0)
    assert len(steps) < most, "not told"
