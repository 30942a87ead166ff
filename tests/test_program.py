"""The program of rows: every engine, on every kind of scene, against independent mechanics."""

import math
import os

import numpy as np
import pytest
from mpmath import mp, mpf
from program_cases import KINDS, ROBOTS, SEEDS, accelerations, cases, known, torques

from robodyn.engines import array_blocks, formulas, machine, straightline
from robodyn.engines.expansion import MotionProgram, longest_formula
from robodyn.engines.formulas import RECORDED, Formula, Recorded
from robodyn.engines.machine_rows import Rows
from robodyn.engines.series import FLOATS, Arithmetic, Series
from robodyn.mechanics.actuation import Actuation, expressions
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.simulation.extended import LONGS

FRESH = bool(os.environ.get("FRESH"))  # as `make hard` has it: more seeds
DIGITS = 30
ORDER = 12  # of the series of motions
MADE = 1  # seeds of each shape for which machine code is made: 0.1 s a formula
MANY = Arithmetic(
    cos=mp.cos,
    sin=mp.sin,
    power=lambda x, exponent: x ** mpf(exponent),
    functions={name: getattr(mp, name) for name in FLOATS.functions},
)
# arithmetics of `Series`, and how they make numbers of floats
NUMBERS = {"floats": (FLOATS, float), "longdouble": (LONGS, np.longdouble), "mpmath": (MANY, mpf)}

EVERY = pytest.mark.parametrize("name", [*KINDS, *ROBOTS], ids=lambda x: getattr(x, "stem", x))

# ---------------------------------------------------------------------------------------------
# The engines: qdd, lambda, tau, lambda again, gap and Psi of a case
# ---------------------------------------------------------------------------------------------


def relative(mech, values):
    """Values in angles of joints, of those in angles of links."""
    return [
        x - (0.0 if above is None else values[above])
        for x, above in zip(values, mech.parent, strict=True)
    ]


def by_series(one, kind, grounded=False):
    """By `Series` on numbers of a kind."""
    mech, (arithmetic, number) = one.mech, NUMBERS[kind]
    n, J = mech.n, mech.arrays.J
    with mp.workdps(DIGITS):
        motion = MotionProgram(mech, Actuation(tuple(one.tau.tolist())), False)
        start = motion.state(
            arithmetic, number(0.0), [number(x) for x in (*one.q, *one.qd)], ((), ())
        )
        program = motion.program
        wanted = program.named["gap"]
        numbers = [number(x) for x in program.numbers]
        series = Series(program, arithmetic, numbers, 1, start, slots=wanted, grounded=grounded)
        solution = series.expand()[0]
        gap = [series.real[slot][0] for slot in wanted]
        equations = EquationsOfMotion(mech)
        program = equations.write([None] * n)
        wanted = program.named["load"]
        numbers = [number(x) for x in program.numbers]
        series = Series(program, arithmetic, numbers, 1, start, slots=wanted, grounded=grounded)
        series.residuals(0)
        rows = [[row.get(k, 0.0) for k in range(n)] for row in series.matrix()[n:]]
        series.complete([*map(number, J @ one.qdd), *[0.0] * len(rows)])
        Psi = np.reshape(np.array(rows, float), (len(rows), n)) @ J
        load = J.T @ np.array([series.real[slot][0] for slot in wanted], float)
        for j, slot in enumerate(equations.torques):
            load[j] -= 0.0 if slot is None else float(series.real[slot][0])
        driven = np.eye(n)[:, list(mech.actuated)]
        solved = np.linalg.solve(np.hstack([driven, Psi.T]), load)
        tau, inner = np.split(solved, [driven.shape[1]])
        qdd, outer = relative(mech, solution[:n]), [-x for x in solution[n:]]
    return {"forward": [*qdd, *outer], "inverse": [*(driven @ tau), *inner],
            "kinematics": [*gap, *Psi.ravel()]}  # fmt: skip


def recorded(mech, by_direction, parameters=False):
    """Formulas of the dynamics, and of gap and Psi; no inverse one where there is none."""
    found = {"forward": formulas._forward(
        Recorded(mech, ("qd", "tau"), by_direction, parameters), None, 0.0, False
    )}  # fmt: skip
    if len(mech.rows) <= 2:
        found["inverse"] = formulas.inverse_of(
            Recorded(mech, ("qd", "qdd"), by_direction, parameters)
        )
    state = Recorded(mech, ("qd",), by_direction, parameters)
    series = state.series([0.0] * mech.n)
    series.residuals(0)
    gap = [series.real[slot][0] for slot in series.program.named["gap"]]
    Psi = formulas.joint_jacobian(state, series)
    found["kinematics"] = Formula(state.inputs, (*gap, *(x for row in Psi for x in row)), ())
    return {kind: formula for kind, formula in found.items() if formula.outputs}


def run_text(formula, arrays):
    """By straight-line Python."""
    function = straightline.compile_floats(formula, "text")
    return function(*np.concatenate(arrays).tolist())[: len(formula.outputs)]


def run_blocks(formula, arrays):
    """By numpy calls on blocks; of three equal states the last."""
    function, buffers = straightline.compile_arrays(formula, "blocks")
    outputs = [np.empty((3, len(part))) for part in (formula.outputs, formula.pivots)]
    array_blocks.evaluate(function, buffers, [np.tile(x, (3, 1)) for x in arrays], outputs)
    return outputs[0][-1]


def run_machine(formula, arrays):
    """By machine code on rows; of eleven equal states the last."""
    inputs = np.reshape(formula.inputs, (-1, len(arrays[0]))).tolist()
    evaluate = Rows(inputs, [formula.outputs], formula.pivots, 1e-12).compile()
    output = np.empty((11, len(formula.outputs)))
    assert not evaluate([np.tile(x, (11, 1)) for x in arrays], [output]).size
    return output[-1]


def by_formulas(one, run, by_direction, parameters=False):
    given = {"forward": (one.q, one.qd, one.tau), "inverse": (one.q, one.qd, one.qdd)}
    given["kinematics"] = one.q, one.qd
    each = recorded(one.mech, by_direction, parameters)
    return {kind: run(formula, given[kind]) for kind, formula in each.items()}


MANY_SEEDS, SOME = (SEEDS, SEEDS[:8]) if FRESH else (SEEDS[:6], SEEDS[2:6:3])
ENGINES = {
    "series on floats": (lambda one: by_series(one, "floats"), MANY_SEEDS),
    "series on floats, grounded": (lambda one: by_series(one, "floats", grounded=True), MANY_SEEDS),
    "series in longdouble": (lambda one: by_series(one, "longdouble"), SOME),
    "series in mpmath": (lambda one: by_series(one, "mpmath"), SOME),
    "text, by angles": (lambda one: by_formulas(one, run_text, False), SOME),
    "text, by directions": (lambda one: by_formulas(one, run_text, True), SOME),
    "numpy blocks": (lambda one: by_formulas(one, run_blocks, True), SOME),
    "machine code": (lambda one: by_formulas(one, run_machine, True, True), SEEDS[:MADE]),
}


def has_machine_code():
    return machine.make(lambda processor: "") is not None


@pytest.mark.parametrize("engine", ENGINES)
@EVERY
def test_values(name, engine):
    evaluate, seeds = ENGINES[engine]
    if engine == "machine code" and not has_machine_code():
        pytest.skip("no machine code")
    for one in cases(name, seeds):
        n, r = one.mech.n, len(one.at.gap)
        expected = {}
        (qdd, outer), expected["forward"] = accelerations(one.at, one.tau)
        (tau, inner), expected["inverse"] = torques(one.at, one.qdd, one.mech.actuated)
        expected["kinematics"] = 1e-13
        values = {"forward": ((n, qdd), (r, outer)), "inverse": ((n, tau), (r, inner))}
        values["kinematics"] = ((r, one.at.gap), (r * n, one.at.Psi.ravel()))
        found = evaluate(one)
        assert found.keys() >= {"forward"}
        for kind, outputs in found.items():
            x = np.array([float(value) for value in outputs])
            size = 1.0 + max(np.abs(y).max(initial=0.0) for _, y in values[kind])
            for count, y in values[kind]:
                part, x = x[:count], x[count:]
                worst = np.abs(part - y).max(initial=0.0)
                assert worst <= expected[kind] * size, (kind, one.mech.name, worst / size)
            assert not x.size


# ---------------------------------------------------------------------------------------------
# The Taylor series of motions
# ---------------------------------------------------------------------------------------------


def long(x):
    """Any number as a longdouble."""
    return np.longdouble(mp.nstr(x, 25) if isinstance(x, mpf) else x)


def expanded(one, kind, actuation=None, order=ORDER, grounded=False):
    """rho and theta of the links' turns, (2, n, order + 2), by numbers of a kind."""
    arithmetic, number = NUMBERS[kind]
    with mp.workdps(DIGITS):
        motion = MotionProgram(one.mech, actuation or Actuation(tuple(one.tau.tolist())), False)
        y = [number(x) for x in (*one.q, *one.qd)]
        start = motion.state(arithmetic, number(0.0), y, ((), ()))
        numbers = [number(x) for x in motion.program.numbers]
        found = motion.expand(arithmetic, numbers, order, start, grounded)
        rows = found.rho, found.theta
        return np.array([[[long(x) for x in c] for c in part] for part in rows])


def radius(turns):
    """About how far the series hold, s: by the roots of their coefficients."""
    sizes = np.abs(turns).max(axis=(0, 1))[2:]
    return 1.0 / max(size ** (1 / (m + 2)) for m, size in enumerate(sizes))


def moved(one, turns, t):
    """q, qd and qdd at a time t of the links' turns."""
    z, zd, zdd = (
        np.array([np.polyval(np.polyder(c[::-1], k), t) for c in turns[0] + 1j * turns[1]])
        for k in range(3)
    )
    rate, bend = zd / z, zdd / z
    J_inverse = np.linalg.inv(one.mech.arrays.J)
    q, qd, qdd = (J_inverse @ x for x in (np.angle(z), rate.imag, (bend - rate**2).imag))
    return one.q + q, qd, qdd


@EVERY
def test_series_follow_the_equations_of_motion(name):
    """At a later time the second derivative is the acceleration of the state there."""
    for k, one in enumerate(cases(name, SEEDS[:5])):
        actuation, law = None, None
        first = one.mech.actuated[0]
        if not one.mech.rows and one.mech.n > 1:  # torques that change with time and state
            text = f"2*cos(3*t)*q{first + 1} - 0.3*qd2" + ", t**2" * (one.mech.n - 1)
            actuation = expressions(one.mech, text, "test")
            law = [lambda t, q, qd: 2 * math.cos(3 * t) * q[0] - 0.3 * qd[1]]
            law += [lambda t, q, qd: t * t] * (one.mech.n - 1)
        turns = expanded(one, "floats", actuation, grounded=k % 2 == 0).astype(float)
        for t in (0.0, 0.05 * radius(turns), -0.05 * radius(turns)):
            q, qd, qdd = moved(one, turns, t)
            tau = one.tau if law is None else np.array([each(t, q, qd) for each in law])
            at = known(one.mech, q, qd)
            (expected, _), rounding = accelerations(at, tau)
            size = 1.0 + np.abs(expected).max()
            assert np.abs(qdd - expected).max() <= 100 * (rounding + 1e-13) * size
            for open_by in (at.gap, at.Psi @ qd):
                assert np.abs(open_by).max(initial=0.0) < 1e-11 * (1.0 + np.abs(qd).max())


def at_radius(turns, scale):
    """Coefficients c_m R^m: sizes compare."""
    return turns * np.power(scale, np.arange(turns.shape[-1]))


@EVERY
def test_series_of_many_digits(name):
    """Longdouble is nearer to mpmath than floats are by the digits that it has more."""
    for one in cases(name, SEEDS[:2])[1:2]:  # in its first state a parallelogram is near singular
        exact = expanded(one, "mpmath")
        R = radius(exact)
        rounding = accelerations(one.at, one.tau)[1]
        for kind, unit in (
            ("floats", 1.0),
            ("longdouble", float(np.finfo(np.longdouble).eps) * 2.0**52),
        ):
            wrong = np.abs(at_radius(expanded(one, kind) - exact, R)).max()
            assert wrong <= rounding * unit, (kind, wrong, rounding)


@pytest.mark.parametrize("engine", ["text", "machine"])
@EVERY
def test_recorded_series(name, engine):
    if engine == "machine" and not has_machine_code():
        pytest.skip("no machine code")
    order, seeds = {"text": (4, 2), "machine": (3, 1)}[engine]
    for one in cases(name, SEEDS[:seeds]):
        n = one.mech.n
        actuation = Actuation(tuple(one.tau.tolist()))
        motion = MotionProgram(one.mech, actuation, False)
        start = motion.start()
        found = motion.expand(RECORDED, start.numbers, order, start.state)
        outputs = tuple(x for part in (found.rho, found.theta) for c in part for x in c)
        outputs = (*outputs, longest_formula(start.graph, found, start.state.w))
        names = [f"{name}{k}" for name in ("q", "qd") for k in range(n)]
        formula = Formula((*names, "rtol", "atol"), outputs, ())
        if engine == "text":
            values = run_text(formula, [one.q, one.qd, np.array([1e-9, 1e-9])])
        else:
            evaluate = Rows([names, ["rtol", "atol"]], [outputs]).compile()
            values = np.empty((1, len(outputs)))
            state = np.concatenate([one.q, one.qd])[None]
            assert not evaluate([state, np.full((1, 2), 1e-9)], [values]).size
            values = values[0]
        turns = np.reshape(values[:-1], (2, n, order + 2))
        expected = expanded(one, "floats", order=order)
        wrong = np.abs(at_radius(turns - expected, radius(expected))).max()
        assert wrong <= 10 * accelerations(one.at, one.tau)[1]
        assert 0.0 < values[-1] < np.inf
