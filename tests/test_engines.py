"""Every engine on every scene: each quantity, series and motion against what is known of it.

The scenes are all of robots/ and random ones of every kind, plain and with springs, dampers, loads
and friction (`engine_cases.py`); the engines of quantities are in `engine_table.py`, those of
Taylor series in `series_table.py`.
"""

import math

import engine_table
import numpy as np
import pytest
import series_table
from conftest import FRESH
from engine_cases import KINDS, ROBOTS, SEEDS, VARIED, case, cases
from hypothesis import given, settings
from hypothesis import strategies as st
from known_terms import Known
from named_case import case as case_of
from series_table import ORDER, known, states

from random_mechanisms import loops, trees
from robodyn import kinetic_energy, potential_energy, simulate
from robodyn.engines import machine
from robodyn.loops.projection import float_closing, suspect_quality
from robodyn.mechanics.actuation import Actuation, expressions, table
from robodyn.runs.machine_motion import Status
from robodyn.runs.series_engine import serves

EVERYWHERE = (*KINDS, *ROBOTS)
EVERY = pytest.mark.parametrize("name", EVERYWHERE, ids=lambda x: getattr(x, "stem", x))
CODE = machine.available()
NEAR = 0.02  # how much nearer the next row of a table is than a series ends
QUICK = (
    *("closed form", "dense algebra", "calls", "rates, dense"),
    "series on floats",
)


def each(engines, name):
    """The engines that are for a scene."""
    for label, engine in engines.items():
        if name in engine.scenes and (CODE or not engine.compiles):
            yield label, engine


# ---------------------------------------------------------------------------------------------
# Quantities
# ---------------------------------------------------------------------------------------------


def check(one, find):
    """What an engine finds of a case is what is known, but for rounding."""
    found = find(one)
    for each in found if isinstance(found, list) else [found]:
        for quantity, values in each.items():
            expected, allowed = one.expected[quantity], one.allowed[quantity]
            assert np.shape(values) == expected.shape, quantity
            worst = np.abs(values - expected).max(initial=0.0)
            assert worst <= allowed, (quantity, one.mech.name, float(worst), allowed)
        if "outer" in each:
            assert max(one.unbalance(each["qdd"], each["outer"])) <= 1.0


@EVERY
def test_quantities(name):
    for label, engine in each(engine_table.ENGINES, name):
        for one in engine.cases(name):
            with case_of(label, one.mech.name):
                check(one, engine.find)


@pytest.mark.parametrize("scenes", [trees(most=7), loops()], ids=["trees", "loops"])
def test_quantities_of_any_scene(scenes):
    """Zeros, equal numbers and states in line among them."""

    @settings(deadline=None, max_examples=80 if FRESH else 25)
    @given(
        scenes, st.sampled_from(["code by angles", "code by directions", "rates, straight-line"])
    )
    def walk(scene, code):
        one = case(scene.mechanism, scene.q, scene.qd, 1, scene.qdd)
        for label in (*QUICK, code):
            check(one, engine_table.ENGINES[label].find)

    walk()


# ---------------------------------------------------------------------------------------------
# Taylor series
# ---------------------------------------------------------------------------------------------


def radius(z):
    """About how far the series hold, s: |z_k| <= radius^-k."""
    orders = np.arange(1, z.shape[1])
    return float(1.0 / (np.abs(z[:, 1:]) ** (1.0 / orders)).max())


@EVERY
def test_series(name):
    """Of turns and power; turns stay on their circles, and loops closed."""
    for label, engine in each(series_table.ENGINES, name):
        for which in states(name):
            with case_of(label, which):
                check_series(name, engine, which)


def check_series(name, engine, which):
    (one, _, exact), found = known(name, which), engine.find(name, which)
    powers = radius(exact.z) ** np.arange(ORDER + 2)
    allowed = min(one.rounding, 2e-12) * engine.unit
    assert np.abs((found.turns - exact.turns) * powers).max() <= allowed
    count = min(len(found.power), len(exact.power))  # text drops what is not asked for
    assert count >= min(ORDER, len(exact.power))
    terms = exact.power[:count] * powers[:count]
    wrong = np.abs(found.power[:count] * powers[:count] - terms).max(initial=0.0)
    assert wrong <= one.rounding * engine.unit * max(1.0, np.abs(terms).max(initial=0.0))
    assert found.longest == pytest.approx(exact.longest, rel=engine.step)
    assert 0.0 < found.longest < np.inf
    for k, turn in enumerate(found.z):
        if k in one.mech.slides:
            continue
        square = np.convolve(turn, turn.conj())[: ORDER + 2]
        size = np.convolve(abs(turn), abs(turn))[: ORDER + 2]
        assert (abs(square - np.eye(1, ORDER + 2)[0]) <= 1e-14 * size).all()
    X, P = placed_series(one, found.z), one.mech.arrays.P
    own = [row.line is None and not row.angles for row in one.mech.rows]
    gaps, sizes = np.abs((P @ X[:, 1:]).real), np.abs(P) @ np.abs(X[:, 1:])
    assert (gaps <= 1e-12 * sizes)[own].all()


def placed_series(one, z):
    """The series of X: E turned by z, and s E of what slides."""
    alpha, X = one.mech.arrays.J @ one.q, []
    for k, d in enumerate(one.mech.frames):
        turn = np.eye(1, z.shape[1])[0] if d is None else np.exp(1j * alpha[d]) * z[d]
        slides = k in one.mech.slides
        X.append(np.convolve(z[k].imag, turn)[: z.shape[1]] if slides else turn)
    return np.array(X)


def moved(one, turns, t):
    """q, qd and qdd at a time t of the links' turns."""
    z, zd, zdd = (
        np.array([np.polyval(np.polyder(c[::-1], k), t) for c in turns[0] + 1j * turns[1]])
        for k in range(3)
    )
    rate, bend = zd / z, zdd / z
    moves = [np.angle(z), rate.imag, (bend - rate**2).imag]
    for k in one.mech.slides:
        for x, own in zip(moves, (z[k].imag - one.q[k], zd[k].imag, zdd[k].imag), strict=True):
            x[k] = own
    q, qd, qdd = (np.linalg.inv(one.mech.arrays.J) @ x for x in moves)
    return one.q + q, qd, qdd


@EVERY
def test_series_follow_the_equations_of_motion(name):
    """At a later time the second derivative is the acceleration of the state there."""
    for one in cases(name, SEEDS[:5] if FRESH else SEEDS[2:3]):
        actuation, law = Actuation(tuple(one.tau.tolist())), None
        driven = one.mech.actuated[0]
        if not one.mech.rows and one.mech.n > 1:  # torques that change with time and state
            text = f"2*cos(3*t)*q{driven + 1} - 0.3*qd2" + ", t**2" * (one.mech.n - 1)
            actuation = expressions(one.mech, text, "test")
            law = [lambda t, q, qd: 2 * math.cos(3 * t) * q[0] - 0.3 * qd[1]]
            law += [lambda t, q, qd: t * t] * (one.mech.n - 1)
        found = series_table.by_program(one, actuation, "floats", order=12)
        turns, reach = found.turns.astype(float), 0.05 * radius(found.z)
        reach *= NEAR if name in VARIED else 1.0
        for t in (reach, -reach):
            q, qd, qdd = moved(one, turns, t)
            now = one.t + t
            tau = one.tau if law is None else np.array([each(now, q, qd) for each in law])
            at = Known(one.mech, q, qd, now)
            expected = at.accelerations(tau)[0].astype(float)
            rounding = 1e-13 * (1.0 + at.condition)
            size = 1.0 + np.abs(expected).max()
            assert np.abs(qdd - expected).max() <= 100 * (rounding + 1e-13) * size
            for open_by in (at.gap, at.Psi @ qd):
                assert np.abs(open_by).max(initial=0.0) < 1e-11 * (1.0 + np.abs(qd).max())


# ---------------------------------------------------------------------------------------------
# Motions; those of robots/ that are known to 18 digits are in test_taylor_run.py
# ---------------------------------------------------------------------------------------------

BY_ROWS = 100.0  # DOP853 takes the rows of tables by its errors alone


def energy(mech, rows):
    q, qd = rows[:, : mech.n], rows[:, mech.n : 2 * mech.n]
    return kinetic_energy(mech, q, qd) + potential_energy(mech, q)


@EVERY
def test_motions(name):
    """States are those of DOP853, and the energy what it was and the work."""
    for which in states(name):
        one, actuation, _ = known(name, which)
        mech, n, y = one.mech, one.mech.n, np.concatenate([one.q, one.qd, [0.0]])
        times = np.array([0.02, 0.1, 0.3])
        given = {"tau": actuation, "t_eval": times, "rtol": 1e-12, "atol": 1e-12}
        motion = simulate(mech, one.q, one.qd, 0.3, **given)
        right = np.hstack([motion.q, motion.qd])
        if not (CODE and serves(mech)):
            continue
        chunk = series_table.compiled(name, which).advance(0.0, y, 0.3, times, 10**5)
        rows, found = chunk.row_y, len(chunk.row_t)
        if chunk.status is Status.SINGULAR:  # as it was left: others lead across
            quality = float_closing(mech)(0.0, chunk.y[-1].tolist())[1]
            assert quality < 2.0 * suspect_quality(mech)
        else:
            assert chunk.status is Status.REACHED
            assert found == 3
        for row, known_row, bound in zip(rows, right, (1e-10, 1e-10, 1e-9), strict=False):
            size = max(1.0, np.abs(known_row).max())
            bound *= BY_ROWS if name in VARIED else 1.0
            assert np.abs(row[: 2 * n] - known_row).max() <= bound * size
        gained = energy(mech, rows) - energy(mech, y[None])
        size = 1.0 + np.abs(energy(mech, rows))
        assert (np.abs(gained - (rows[:, -1])) <= 1e-11 * size).all()


@pytest.mark.parametrize("name", KINDS[::4])
def test_motions_as_users_ask_for_them(name):
    """By every method: without torques, by a table of bent ones, and waves for Radau."""
    one = known(name, 1)[0]
    bent = table(
        one.mech, [0.0, 0.15, 1.0], [[float(k)] * len(one.mech.actuated) for k in range(3)]
    )
    waves = ", ".join(["0.5*cos(t)"] * len(one.mech.actuated))
    given = {"t_eval": np.linspace(0.0, 0.3, 6), "rtol": 1e-11, "atol": 1e-11}
    for tau in (None, bent):
        first, second = (
            simulate(one.mech, one.q, one.qd, 0.3, tau=tau, method=method, **given)
            for method in ("DOP853", "taylor")
        )
        assert second.q == pytest.approx(first.q, abs=1e-8)
        assert second.report.work == pytest.approx(first.report.work, abs=1e-8)
        assert max(first.report.energy_drift, second.report.energy_drift) < 1e-9
    motion = simulate(one.mech, one.q, one.qd, 0.3, tau=waves, method="Radau")
    assert motion.outcome.label == "finished"
    assert motion.report.energy_drift < 1e-6
