"""Whole runs by the Taylor series: what it serves, change points, outcomes, the process."""

import itertools
import json
import math
import re
import subprocess
import sys
import warnings
from functools import cache
from itertools import product

import numpy as np
import pytest
from conftest import FRESH, ROOT
from named_case import case
from reference_motions import DAMPED, SENSITIVITY, START, reference, scene, slope

import oracles
from hard_cases.cases import n_four_bar, scaled
from hard_cases.cases import scene as hard_case
from random_mechanisms import mechanism
from robodyn import assemble, closure_gap, closure_jacobian, load, simulate
from robodyn.engines import machine
from robodyn.engines.expansion import Coefficients, longest_step
from robodyn.errors import InputError, SingularError
from robodyn.loops.loop_rates import loop_velocities
from robodyn.loops.projection import float_closing, suspect_quality
from robodyn.mechanics.actuation import Actuation, expressions
from robodyn.runs import machine_motion, series_engine
from robodyn.runs.accuracy import AUTO, best_method, settings_for
from robodyn.runs.benchmark import reference as longdouble_reference
from robodyn.runs.machine_motion import Status
from robodyn.runs.march import run
from robodyn.runs.report import Outcome
from robodyn.runs.series_engine import SeriesEngine
from robodyn.runs.settings import Settings
from robodyn.sweeps.lanes import order_where_series_cost

pytestmark = pytest.mark.filterwarnings("ignore:the torque changes too fast")


def taylor(mech, q, qd, t_end, tau=None, tolerance=1e-9, **options):
    options = {"rtol": tolerance, "atol": tolerance, **options}
    return simulate(mech, q, qd, t_end, tau, "taylor", **options)


def apart(first, second):
    return np.abs(np.hstack([first.q - second.q, first.qd - second.qd])).max()


@cache
def known_run(text, q, qd, t_end, tau, method, tolerance, times):
    """A run by another method, kept."""
    options = {"rtol": tolerance, "atol": tolerance, "t_eval": times}
    return simulate(mechanism(text), q, qd, t_end, tau, method, **options)


class TestBalance:
    @pytest.mark.parametrize("tau", [None, (1.5,), "1.5*sin(2*t) + 0.2*q1"])
    @pytest.mark.parametrize("name", DAMPED)
    @pytest.mark.thinned
    def test_work_is_dop853s(self, name, tau):
        """With dampers; constant torques and expressions."""
        text, q, qd, _, _ = DAMPED[name]
        mech = mechanism(text)
        if q is None:
            q = assemble(mech, [1.0])
            qd = loop_velocities(mech, q, qd, t=0.0)
        if name == "arm" and tau is not None:
            tau = (*tau, 0.5) if isinstance(tau, tuple) else f"{tau}, 1 - 0.5*q2"
        found = taylor(mech, q, qd, 3.0, tau, 1e-12, t_eval=[1.5, 3.0])
        known = known_run(text, tuple(q), tuple(qd), 3.0, tau, "DOP853", 1e-12, (1.5, 3.0))
        assert found.report.energy_drift < 1e-11
        assert found.report.work == pytest.approx(known.report.work, abs=1e-8)
        assert abs(known.report.work) > 0.1
        assert apart(found, known) < 1e-8

    @pytest.mark.parametrize("name", ["2r-regular", "3r", "four-bar", "five-bar", "slider-crank"])
    def test_energy_is_kept(self, name):
        known = reference(name)
        n = known.mechanism.n
        motion = taylor(known.mechanism, *np.split(known.states[0], [n]), 20.0, tolerance=1e-15)
        assert motion.report.energy_drift < 3e-13
        assert motion.report.work == 0.0
        assert motion.report.largest_gap < 3e-14


def test_rows_do_not_steer_the_steps():
    """A narrow pulse bounds steps from where they start, however many rows are asked for."""
    pendulum = load(ROOT / "robots/pendulum.yaml")
    tau, ends = "20*exp(-((t-5)/0.01)**2)", []
    for times in ([10.0], np.linspace(0.0, 10.0, 203)):
        motion = simulate(pendulum, [-1.5], [0.0], 10.0, tau, "taylor", 1e-8, 1e-8, t_eval=times)
        ends.append([motion.report.steps, motion.q[-1, 0], motion.qd[-1, 0]])
    assert ends[0] == ends[1]


@pytest.mark.parametrize("k", [1, 2, 4, 8, 12])
def test_by_a_torque_that_grows_as_a_power_of_time(k: int) -> None:
    """Of E = exp(i c t^(k + 2)) all orders but a few vanish, and tell of no step.

    Nor do they where an arm turns slowly, or another one beside it.
    """
    links = "".join(
        f"  - {{name: {name}, m: 1, l: 1, r: 0.5, I: 0.1, from: [0, 0]}}\n" for name in "ab"
    )
    arms = load(f"links:\n{links}")
    cases = product(((0.0, 0.0), (0.01, 0.0), (0.0, 1e-3)), (2.0, -2.0))
    for (rates, end), tolerance in product(cases, (1e-3, 1e-6, 1e-9, 1e-12)):
        exact = rates[1] * end + end ** (k + 2) / ((k + 1) * (k + 2) * 0.35)
        given = {"method": "taylor", "rtol": tolerance, "atol": tolerance}
        motion = simulate(arms, [0.0, 0.0], rates, end, f"0, t**{k}", **given)
        with case(rates, end, tolerance):
            assert abs(motion.q[-1, 1] - exact) < 10.0 * tolerance * max(1.0, abs(exact))


@pytest.mark.parametrize(
    ("a", "b", "rate", "end"), [(0.0, -9.81, 5.0, 10.0 / 9.81), (180.0, -90.0, 15.0, 1.0)]
)
def test_a_high_power_acts_within_a_step(a: float, b: float, rate: float, end: float) -> None:
    """Without it the block is where it began at the end of a step, and in its middle too.

    The series of x^39 from x = 0 has no term below the 39th.
    """
    link = "{name: block, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}"
    block = load(f"gravity: 0\nlinks:\n  - {link}\n")
    start, tau = ([0.0], [rate], end, f"{a}*t + {b} - q1**39"), "DOP853"
    exact = simulate(block, *start, tau, 1e-13, 1e-13).qd[-1, 0]
    for tolerance in (1e-3, 1e-6, 1e-9):
        with case(tolerance):
            motion = simulate(block, *start, "taylor", tolerance, tolerance)
            assert abs(motion.qd[-1, 0] - exact) < 100.0 * tolerance


def test_a_divisor_that_does_not_turn_shortens_no_steps() -> None:
    """The bend of 1/(1 + exp(-x)) is where exp is near 1, not all along the way there."""
    link = "{name: block, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}"
    block = load(f"gravity: 0\nlinks:\n  - {link}\n")
    given, ends = ([0.0], [-5.0], 1.0), []
    for tau in ("10 - 2/(1+exp(-qd1/0.01))", "9 - tanh(qd1/0.02)"):
        motion = simulate(block, *given, tau, "taylor", 1e-9, 1e-9)
        ends.append(motion.q[-1, 0])
        assert motion.report.steps < 100
    assert abs(ends[0] - ends[1]) < 1e-8


class TestChangePoints:
    @pytest.mark.parametrize("tolerance", [1e-6, 1e-13])
    @pytest.mark.parametrize("n", [1, 2, 5])
    @pytest.mark.thinned
    def test_n_four_bar(self, n, tolerance):
        """The hard cases have tolerances between."""
        q = np.concatenate([np.full(n + 1, np.pi / 2), np.full(n, -np.pi / 2)])
        qd = np.concatenate([np.full(n + 1, -1.0), np.full(n, 1.0)])
        motion = taylor(n_four_bar(n), q, qd, 4.0, tolerance=tolerance)
        assert motion.outcome is Outcome.FINISHED
        verticals = motion.q[-1, : n + 1]
        exact = float(oracles.n_four_bar_exact(n, 4.0)[0])
        assert np.abs(verticals - exact).max() < max(4000 * tolerance, 2e-8)
        assert np.ptp(verticals) < 1e-12
        assert motion.report.largest_gap < 1e-14
        assert motion.report.evaluations < 3000  # no stall

    @pytest.mark.parametrize("n", [1, 2, 5])
    @pytest.mark.thinned
    def test_a_start_at_a_change_point(self, n):
        for tolerance in (1e-6, 1e-12) if n < 5 else (1e-6,):
            lying = np.zeros(2 * n + 1)
            falling = np.concatenate([np.full(n + 1, -0.01), np.full(n, 0.01)])
            motion = taylor(n_four_bar(n), lying, falling, 1.0, tolerance=tolerance)
            assert motion.outcome is Outcome.FINISHED
            assert np.ptp(motion.q[-1, : n + 1]) < 1e-12
            assert abs(motion.q[-1, 0]) > 0.5

    def test_at_rest_there_it_can_go_on_in_two_ways(self):
        lying = np.zeros(3)
        for method in ("taylor", "DOP853"):
            with pytest.raises(SingularError, match="two ways"):
                simulate(n_four_bar(1), lying, lying, 1.0, method=method)

    def test_the_parallelogram(self):
        mech = scene("parallelogram")
        q = assemble(mech, [1.0])
        motion = taylor(mech, q, loop_velocities(mech, q, [6.0], t=0.0), 4.0, tolerance=1e-10)
        assert motion.outcome is Outcome.FINISHED
        turns = np.abs(np.diff(motion.q[:, 0])).sum() / np.pi
        assert turns > 2  # it passes change points
        assert np.ptp(motion.q[:, [0, 2]], axis=1).max() < 1e-9
        assert motion.report.energy_drift < 1e-8

    def test_closures_that_depend_on_one_another_on_this_branch(self):
        """DOP853 leads all the way: each state is as near to a singular one as any."""
        mech = hard_case("third-crank")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", category=UserWarning)
            motion = taylor(mech, assemble(mech, [1.0]), np.zeros(4), 1.0)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.energy_drift < 1e-7
        assert np.ptp(motion.q[:, [0, 2, 3]], axis=1).max() < 1e-9


class TestServed:
    """What machine code does not serve is refused by name; where no method is asked, DOP853."""

    @pytest.mark.parametrize("name", ["closed twice", "massless-coupler"])
    def test_scenes(self, name):
        mech, why = hard_case("massless-coupler"), "masses are missing"
        if name == "closed twice":
            text = (ROOT / "robots/four-bar.yaml").read_text()
            twice = "- [{link: coupler, at: [0.95, 0]}, {link: rocker, at: [0.8, 0]}]"
            text, changed = re.subn(r"closures:\n", rf"closures:\n  {twice}\n", text)
            text = re.sub("assembly: open", "assembly: [open, open]", text)
            assert changed
            mech, why = mechanism(text), "closures depend on one another"
        still = Actuation((0.0,) * mech.n)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", category=UserWarning)
            q = assemble(mech, [1.0])
        with pytest.raises(InputError, match=rf"method = taylor: .*{why}.*take DOP853"):
            taylor(mech, q, np.zeros(mech.n), 1.0)
        assert best_method(mech, still) == "DOP853"
        settings, _ = settings_for(
            mech, np.concatenate([q, np.zeros(mech.n)]), 0.2, still, Settings(AUTO), 1e-6
        )
        assert settings.method == "DOP853"

    def test_too_many_loops(self, monkeypatch):
        monkeypatch.setattr(series_engine, "LARGEST", 20)
        bars = n_four_bar(3)
        with pytest.raises(InputError, match="160 loops"):
            taylor(bars, np.repeat([1.0, -1.0], [4, 3]), np.zeros(7), 1.0)

    def test_a_massless_tip_is_explained(self):
        with pytest.raises(SingularError, match="wire"):
            taylor(hard_case("massless-tip"), [0.0, 0.0], [0.0, 0.0], 1.0)

    def test_without_llvmlite(self, monkeypatch):
        monkeypatch.setattr(machine, "available", lambda: False)
        with pytest.raises(InputError, match=r"method = taylor: needs .* pip install '.\[fast\]'"):
            taylor(scene("2r"), *START, 1.0)
        start, still = np.concatenate(START), Actuation((0.0, 0.0))
        settings, _ = settings_for(scene("2r"), start, 0.2, still, Settings(AUTO), 1e-6)
        assert settings.method == "DOP853"

    def test_it_is_machine_code_from_the_first_step(self):
        assert taylor(scene("2r"), *START, 0.1).report.evaluator == "compiled"

    def test_engines_are_no_option_any_more(self, robodyn):
        for engine in ("auto", "python", "compiled"):
            with pytest.raises(InputError, match=r"engine = .*: the method taylor is machine code"):
                taylor(scene("2r"), *START, 1.0, engine=engine)
        told = robodyn(*TestProcess.LINE, "--engine", "python")
        assert told.code == 2
        assert "--engine = python: is no option any more" in told.err

    def test_code_that_cannot_be_made_for_what_comes_later(self, monkeypatch):
        """Machine code of one piece of an expression; DOP853 goes through the next."""
        tau = "0 if t < 0.5 else sin(3*t), 0"
        known = taylor(scene("2r"), *START, 1.0, tau)
        kernels = []
        compile = machine_motion.compile

        def one(*arguments):
            kernels.append(arguments)
            return compile(*arguments) if len(kernels) == 1 else None

        series_engine._kept.cache_clear()
        monkeypatch.setattr(machine_motion, "compile", one)
        motion = taylor(scene("2r"), *START, 1.0, tau)
        assert len(kernels) > 1
        assert motion.outcome is Outcome.FINISHED
        assert np.abs(motion.q[-1] - known.q[-1]).max() < 1e-7

    def test_a_phase_of_contacts_that_it_does_not_serve(self):
        """A four-bar of which two joints stick: what holds them depends on the closure."""
        text = (ROOT / "robots/four-bar.yaml").read_text()
        for inertia in ("I: 0.008", "I: 0.061"):
            assert inertia in text
            text = text.replace(inertia, f"{inertia}, friction: {{torque: 0.05, static: 30}}")
        mech = mechanism(text)
        q = assemble(mech, [1.0])
        runs = [
            simulate(mech, q, np.zeros(3), 2.0, "40*t", method=method, rtol=1e-10, atol=1e-10)
            for method in ("DOP853", "taylor")
        ]
        names = [[event.name for event in run.events] for run in runs]
        assert names[0] == names[1] != []
        np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], atol=1e-7)


class TestRuns:
    @pytest.mark.parametrize("name", ["2r", "four-bar"])
    def test_a_run_does_not_depend_on_those_before(self, name):
        """Nor on one that goes on at the same time, with the same code."""
        mech = load(ROOT / f"robots/{name}.yaml")
        cranks = [[0.5, 0.3], [1.2, -0.4]] if mech.n == 2 else [[0.7], [1.9]]
        first, second = (assemble(mech, crank) for crank in cranks)
        still, inner = np.zeros(mech.n), []

        def watch(t):
            inner.append(taylor(mech, second, still, 5.0))
            return False

        settings = Settings("taylor")
        alone = [taylor(mech, q, still, 5.0) for q in (first, second)]
        begin, unforced = np.concatenate([first, still]), Actuation((0.0,) * mech.n)
        _, recorder = run(mech, begin, 5.0, unforced, settings, lambda t, y, _: None, watch=watch)
        again = taylor(mech, first, still, 5.0)
        assert apart(again, alone[0]) == apart(inner[0], alone[1]) == 0.0
        assert recorder.settle().energy_drift == alone[0].report.energy_drift

    def test_rows_do_not_depend_on_the_others(self):
        rows = [
            taylor(scene("2r"), *START, 1.0, t_eval=np.linspace(0.0, 1.0, count))
            for count in (3, 21, 301)
        ]
        for motion in rows[1:]:
            step = (len(motion.t) - 1) // 2
            assert np.abs(motion.q[::step] - rows[0].q).max() < 1e-14

    @pytest.mark.parametrize("times", [[0.0], [1.0], [], [0.0, 1.0], [0.3]])
    @pytest.mark.parametrize("way", [1.0, -1.0])
    def test_exactly_the_times_given(self, times, way):
        given = [way * t for t in times]
        assert taylor(scene("2r"), *START, way, t_eval=given).t.tolist() == given

    def test_time_zero(self):
        motion = taylor(scene("2r"), *START, 0.0)
        assert motion.t.tolist() == [0.0]
        assert motion.outcome is Outcome.FINISHED


class TestOutcomes:
    def test_stiff_but_feasible_is_done(self):
        text = DAMPED["arm"][0].replace("damping: 0.3", "damping: 3e+3")
        motion = taylor(mechanism(text), [0.5, 0.8], [0.0, 0.0], 1.0)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.energy_drift < 1e-7

    def test_long_is_not_stiff(self):
        still = mechanism("gravity: 0\nlinks:\n  - {name: a, m: 1, l: 1, r: 0, I: 0.1}\n")
        motion = taylor(still, [0.0], [1000.0], 1e5, max_evals=2000)
        assert motion.outcome is Outcome.TOO_MANY_EVALUATIONS
        motion = taylor(scene("2r"), *START, 1e6, max_evals=2000)
        assert motion.outcome is Outcome.TOO_MANY_EVALUATIONS

    @pytest.mark.parametrize("tau", [[1e20, 0.0], "0, 1e20*exp(0*t)", [1e200, 0.0], [1e8, 0.0]])
    def test_torques_beyond_all_bounds(self, tau):
        motion = taylor(scene("2r"), *START, 1.0, tau, max_evals=3000)
        assert motion.outcome in (Outcome.STEP_TOO_SMALL, Outcome.TOO_MANY_EVALUATIONS)
        assert np.isfinite(motion.q).all()

    def test_few_digits_high_orders_long_times(self):
        for options in ({"tolerance": 0.5}, {"order": 60}, {"order": 4}, {"tolerance": 1e-16}):
            motion = taylor(scene("2r"), *START, 1.0, **options)
            assert motion.outcome is Outcome.FINISHED
        rest = taylor(scene("pendulum"), [-np.pi / 2], [0.0], 1e4)
        assert rest.outcome is Outcome.FINISHED
        assert np.abs(rest.q + np.pi / 2).max() < 1e-9

    def test_whole_numbers_of_numpy_and_floats(self):
        options = {"order": np.int64(8), "max_evals": np.inf}
        motion = taylor(scene("2r"), *START, 0.5, **options)
        assert motion.outcome is Outcome.FINISHED
        options["max_evals"] = 2.5
        assert taylor(scene("2r"), *START, 0.5, **options).report.steps < 4

    def test_1000_rad_a_second(self):
        motion = taylor(scene("2r"), [0.3, 0.2], [1000.0, 0.0], 0.1)
        assert motion.report.energy_drift < 1e-8

    @pytest.mark.parametrize("size", [2.0**-20, 2.0**20])
    def test_scales(self, size):
        """Times go with the root of lengths; angles are the same."""
        q, slow, times = assemble(scaled(1.0), [1.0]), np.sqrt(size), np.linspace(0.0, 1.0, 5)
        known = taylor(scaled(1.0), q, np.zeros(3), 1.0, tolerance=1e-10, t_eval=times)
        atol = 1e-10 / max(slow, 1.0)
        options = {"rtol": 1e-10, "atol": atol, "t_eval": times * slow}
        motion = taylor(scaled(size), q, np.zeros(3), slow, **options)
        assert np.abs(motion.q - known.q).max() < 1e-8

    @pytest.mark.parametrize(
        ("options", "match"),
        [
            ({"method": "DOP853", "order": 8}, "order: is for the method taylor"),
            ({"stabilize": "baumgarte"}, "stabilize = baumgarte"),
            ({"order": 3}, "order = 3"),
            ({"order": 100}, "order = 100"),
            ({"order": 8.0}, "order = 8.0: must be a whole number"),
            ({"max_evals": np.nan}, "max_evals = nan"),
            ({"rtol": 1e-17}, "rtol = 1e-17"),
        ],
    )
    def test_settings_that_are_none(self, options, match):
        with pytest.raises(InputError, match=match):
            simulate(scene("2r"), *START, 1.0, **{"method": "taylor", **options})


class TestProcess:
    LINE = ("simulate", "robots/2r.yaml", "--q", "0.3,-0.7", "--method", "taylor", "--quiet")

    def test_never_imports_scipy(self):
        code = f"from robodyn.cli import run; import sys; run({[*self.LINE, '--time', '1']!r})\n"
        code += "sys.stderr.write(__import__('json').dumps(sorted(sys.modules)))"
        line = [sys.executable, "-c", code]
        done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, check=True)
        modules = json.loads(done.stderr)
        assert "robodyn.runs.series_steps" in modules
        assert not [name for name in modules if name.split(".")[0] == "scipy"]
        assert len(done.stdout.splitlines()) > 5

    def test_torque_takes_the_motion_back(self, robodyn, tmp_path):
        options = ("--time", 1, "--points", 6, "--tau", "1.5,-0.25", "--order", 20)
        csv = robodyn(*self.LINE, *options).succeeds().out
        path = tmp_path / "motion.csv"
        path.write_text(csv)
        given = robodyn("torque", "robots/2r.yaml", path).replaces()
        assert np.abs(np.array(given.column("tau1")) - 1.5).max() < 1e-11
        assert np.abs(np.array(given.column("tau2")) + 0.25).max() < 1e-11


def test_a_run_stops_at_its_limit_of_evaluations():
    """However many steps are taken at a time."""
    motion = taylor(scene("2r"), [1.0, 0.5], [0, 0], 10.0, max_evals=7)
    assert motion.outcome is Outcome.TOO_MANY_EVALUATIONS
    assert motion.report.evaluations == 8


class TestFriction:
    """Far above its speed friction is flat, and its series does not see that it turns over."""

    @pytest.mark.parametrize("speed", [1e-3, 1e-2, 0.1, 1.0] if FRESH else [1e-3, 0.1])
    def test_a_pendulum_comes_to_rest(self, speed):
        text = (
            "gravity: 9.81\nlinks: [{name: a, m: 0.4, l: 0.5, r: 0.26, I: 0.0088, "
            f"friction: {{torque: 0.05, speed: {speed}}}}}]\n"
        )
        times = tuple(np.linspace(0.0, 3.0, 7).tolist())
        implicit = known_run(text, (1.0,), (2.0,), 3.0, None, "Radau", 1e-9, times)
        motion = taylor(mechanism(text), [1.0], [2.0], 3.0, t_eval=times)
        assert motion.outcome is Outcome.FINISHED
        assert motion.q == pytest.approx(implicit.q, abs=1e-6)
        assert motion.report.energy_drift < 1e-6

    def test_the_reference_sees_it_too(self):
        mech = mechanism(
            "gravity: 9.81\nlinks: [{name: a, m: 0.4, l: 0.5, r: 0.26, I: 0.0088, "
            "friction: {torque: 0.05, speed: 0.01}}]\n"
        )
        found = longdouble_reference(mech, np.array([1.0, 2.0]), np.array([0.5]), Actuation((0.0,)))
        motion = simulate(mech, [1.0], [2.0], 0.5, rtol=1e-12, atol=1e-12, t_eval=[0.5])
        assert found.uncertainty < 1e-10
        assert motion.q[0] == pytest.approx(found.y[0, :1], abs=1e-9)


@pytest.mark.parametrize("beside", [0.0, 1e-8, 1e-4])
@pytest.mark.thinned
def test_a_springs_ends_that_pass_one_another(beside):
    """The tip swings through the anchor of a spring, or close by: its pull turns over."""
    mech = mechanism(
        "links: [{name: a, m: 0, l: 0.5, r: 0, I: 0.1, damping: 0.1}]\n"
        f"springs: [{{between: [a, [{0.5 + beside!r}, 0]], stiffness: 20, length: 0.1}}]\n"
    )
    options = {"t_eval": [1.0], "rtol": 1e-9, "atol": 1e-9}
    found = [simulate(mech, [0.6], [0], 1.0, **options), taylor(mech, [0.6], [0], 1.0, **options)]
    assert found[1].q == pytest.approx(found[0].q, abs=1e-5)
    assert found[1].report.energy_drift < 1e-5


@pytest.mark.parametrize("scene", ["pendulum", "four-bar"])
@pytest.mark.parametrize(
    "torque", ["sqrt(abs(t-0.5))", "3*t**0.25", "abs(t-0.5)**1.5", "2*sqrt(t-0.5) if t>0.5 else 1"]
)
@pytest.mark.thinned
def test_a_torque_without_a_series_at_a_time_is_led_across(torque: str, scene: str) -> None:
    """Its derivative is infinite there: DOP853 goes on from it for a few steps."""
    text = (ROOT / f"robots/{scene}.yaml").read_text()
    mech = mechanism(text)
    q, qd = assemble(mech, [1.0]), np.zeros(mech.n)
    motion = taylor(mech, q, qd, 1.0, torque)
    assert motion.outcome is Outcome.FINISHED
    known = known_run(text, tuple(q), tuple(qd), 1.0, torque, "DOP853", 1e-12, (1.0,))
    assert motion.q[-1] == pytest.approx(known.q[-1], abs=2e-7)
    assert motion.qd[-1] == pytest.approx(known.qd[-1], abs=1e-6)


def test_a_torque_that_is_infinite_at_a_time_ends_the_run_there() -> None:
    mech = load(ROOT / "robots/pendulum.yaml")
    motion = simulate(mech, [1.0], [0.0], 1.0, "1/(t-0.5)", "taylor")
    assert motion.outcome is Outcome.STEP_TOO_SMALL
    assert motion.report.t_reached == pytest.approx(0.5, abs=1e-3)


# Steps of the series: reference digits, rows between steps, what ends a step.


EACH = pytest.mark.parametrize("name", SENSITIVITY)
ALL = 10**6
FREE = 1e100  # a tolerance that holds no step
NONE = np.zeros(0)


def engine(mech, tau="", rtol=1e-15, order=None, work=False):
    actuation = expressions(mech, tau, "test") if tau else Actuation((0.0,) * mech.n)
    return SeriesEngine(mech, actuation, rtol=rtol, atol=rtol, order=order, work=work)


def taylor_steps_run(name, times=NONE, **options):
    known = reference(name)
    made = engine(known.mechanism, known.tau, **options)
    return made.advance(0.0, known.states[0], float(known.t[-1]), times, ALL)


class TestReferences:
    """Every motion whose digits are known."""

    @EACH
    def test_near_rounding(self, name):
        known = reference(name)
        chunk = taylor_steps_run(name, known.t[1:])
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
            chunk = taylor_steps_run(name, times, rtol=rtol)
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
    made = SeriesEngine(mech, still, rtol=FREE, atol=FREE, order=order, project=False)
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
        made = SeriesEngine(pair, Actuation(tuple(tau)), order=8)
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
        rows = taylor_steps_run("four-bar", many, rtol=1e-8)
        few = taylor_steps_run("four-bar", many[99::100], rtol=1e-8)
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
        qualities = [closing(0.0, row.tolist())[1] for row in chunk.y]
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
