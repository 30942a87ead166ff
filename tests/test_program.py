"""The program of rows: every engine, on every kind of scene, against independent mechanics.

The oracle takes M, C qd and G from Newton and Euler (`oracles.py`), closures from the kinematics
of points (`random_mechanisms.Pose`), springs, loads and friction from virtual power
(`test_forces.Forces`), and reads nothing but the description of the scene.
"""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import mpmath
import numpy as np
import pytest
from conftest import ROOT
from mpmath import mp, mpf
from test_forces import Forces

import oracles
from random_mechanisms import (
    LOOPS,
    Pose,
    Scene,
    Shape,
    forced,
    mechanism,
    oracle_tree,
    seeded_scene,
    seeded_tree,
)
from robodyn.dynamics import identities
from robodyn.engines import blocks, formulas, machine, straightline
from robodyn.engines.expansion import MotionProgram, expansion
from robodyn.engines.factors import SMALL, Factors
from robodyn.engines.formulas import RECORDED, Formula, Recorded
from robodyn.engines.machine_rows import Rows
from robodyn.engines.series import FLOATS, Arithmetic, Series, State
from robodyn.mechanics.actuation import Actuation, expressions
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.program import (
    Derivative,
    Function,
    Given,
    Integral,
    Number,
    Power,
    Primitive,
    Product,
    Program,
    Quotient,
    Rate,
    Sum,
    Turn,
    Unknown,
)
from robodyn.simulation.extended import LONGS

DIGITS = 30
ORDER = 12  # of series
SEEDS = range(20)
MADE = 1  # seeds of each shape for which machine code is made: 0.1 s a formula
MANY = Arithmetic(
    cos=mp.cos,
    sin=mp.sin,
    power=lambda x, exponent: x ** mpf(exponent),
    functions={name: getattr(mp, name) for name in FLOATS.functions},
)
# arithmetics of `Series`, and how they make numbers of floats
NUMBERS = {"floats": (FLOATS, float), "longdouble": (LONGS, np.longdouble), "mpmath": (MANY, mpf)}

# ---------------------------------------------------------------------------------------------
# The oracle
# ---------------------------------------------------------------------------------------------


class Known(NamedTuple):
    """M qdd + h = tau + Psi^T lambda, Psi qdd + bias = 0, and the gap."""

    M: np.ndarray
    h: np.ndarray
    Psi: np.ndarray
    bias: np.ndarray
    gap: np.ndarray


def known(mech, q, qd) -> Known:
    """All terms at a state, of the description alone (of a coupling's row only its scale `arm`)."""
    description, n = mech.description, len(q)
    tree, rest = oracle_tree(description), np.zeros(n)
    columns = [oracles.newton_euler(tree, 0j, q, rest, qdd) for qdd in np.eye(n)]
    h = np.array(oracles.newton_euler(tree, description.gravity, q, qd, rest))
    potential, other, _ = Forces(SimpleNamespace(mechanism=mech, q=q, qd=qd)).torques()
    h += np.array([link.damping for link in description.links]) * qd - potential - other
    pose = Pose(tree, q)
    Psi, bias, gap = [], [], []
    for closure in description.closures:
        sides = [(point.link, point.at) for point in (closure.first, closure.second)]
        along = closure.along
        for direction in (1.0, 1j) if along is None else (1j * along / abs(along),):
            d, slope, bend = (
                a - b
                for a, b in (
                    [pose.position(side) for side in sides],
                    [pose.slope(side) for side in sides],
                    [pose.bias(side, qd) for side in sides],
                )
            )
            gap.append((np.conj(direction) * d).real)
            Psi.append((np.conj(direction) * slope).real)
            bias.append((np.conj(direction) * bend).real)
    arms = [row.arm for row in mech.rows if row.closure is None]
    for coupling, arm in zip(description.couplings, arms, strict=True):
        row = np.eye(n)[coupling.joint]
        for k, ratio in coupling.terms:
            row[k] -= ratio
        Psi.append(arm * row)
        bias.append(0.0)
        gap.append(arm * (row @ q - coupling.angle))
    r = len(gap)
    return Known(np.array(columns).T, h, np.reshape(Psi, (r, n)), np.array(bias), np.array(gap))


def accelerations(at: Known, tau):
    """qdd and lambda, and the rounding that they may have."""
    n, r = len(at.h), len(at.gap)
    K = np.block([[at.M, -at.Psi.T], [at.Psi, np.zeros((r, r))]])
    solution = np.linalg.solve(K, np.concatenate([tau - at.h, -at.bias]))
    return np.split(solution, [n]), 1e-13 * (1.0 + np.linalg.cond(K))


def torques(at: Known, qdd, actuated):
    """tau and lambda."""
    n, r = len(at.h), len(at.gap)
    driven = np.eye(n)[:, list(actuated)]
    K = np.hstack([driven, at.Psi.T])
    solution = np.linalg.solve(K, at.M @ qdd + at.h)
    tau, multipliers = np.split(solution, [n - r])
    return [driven @ tau, multipliers], 1e-13 * (1.0 + np.linalg.cond(K))


# ---------------------------------------------------------------------------------------------
# The scenes
# ---------------------------------------------------------------------------------------------

SLIDERS = {
    "two sliders on a chain": Shape((None, 0, 1), sliders=(1, 2), actuated=(0,)),
    "two sliders on a crank": Shape((None, 0, 0), sliders=(1, 2), actuated=(0,)),
    "slider and pin": Shape((None, 0, None, 1), ((1, 2),), sliders=(3,), actuated=(0,)),
}
COUPLED = {"tree": (1, 0), "loop": (2, 0)}  # the joint that follows, and the one it does


def geared(seed, plain, joint, other, actuated):
    """The scene with a gear between two joints, put where it fits."""
    numbers = np.random.default_rng(2000 + seed)
    ratio, angle = (round(float(x), 6) for x in numbers.uniform(0.3, 2.0, 2) * [(-1) ** seed, 1])
    q = plain.q.copy()
    if plain.mechanism.rows:
        angle = float(q[joint] - ratio * q[other])
    q[joint] = ratio * q[other] + angle
    lines = [line for line in plain.text.splitlines() if not line.startswith("actuated")]
    lines.append(f'couplings: ["q{joint + 1} = {ratio!r} q{other + 1} + {angle:.17f}"]')
    lines.append(f"actuated: [{', '.join(f'link{k}' for k in actuated)}]")
    return Scene("\n".join(lines).replace("+ -", "- ") + "\n", q, plain.qd, plain.qdd)


def plain_scene(name, seed):
    """A random scene of a kind."""
    if name == "tree":
        return seeded_tree(seed, 1 + seed % 6)
    if name == "geared tree":
        tree, n = seeded_tree(seed, 2 + seed % 4), 2 + seed % 4
        joint, other = (seed % n, (seed + 1) % n)
        return geared(seed, tree, joint, other, [k for k in range(n) if k != joint])
    if name == "geared five-bar":
        return geared(seed, seeded_scene(seed, LOOPS["five-bar"]), 2, 0, [0])
    return seeded_scene(seed, (LOOPS | SLIDERS)[name])


KINDS = ("tree", *LOOPS, *SLIDERS, "geared tree", "geared five-bar")
ROBOTS = sorted((ROOT / "robots").glob("*.yaml"))


class Case(NamedTuple):
    """A state of a scene, and torques tau."""

    mech: object
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    at: Known


def case(mech, q, qd, seed):
    """Rates and accelerations that keep the closures, torques at the actuated joints."""
    rng = np.random.default_rng(seed)
    at = known(mech, q, qd)
    qd = qd - np.linalg.pinv(at.Psi) @ (at.Psi @ qd)
    at = known(mech, q, qd)
    assert np.abs(at.gap).max(initial=0.0) < 1e-11
    qdd = rng.uniform(-15.0, 15.0, len(q))
    qdd -= np.linalg.pinv(at.Psi) @ (at.Psi @ qdd + at.bias)
    tau = np.zeros(len(q))
    tau[list(mech.actuated)] = rng.uniform(-5.0, 5.0, len(mech.actuated))
    return Case(mech, q, qd, qdd, tau, at)


@functools.cache
def random_case(name, seed, acted):
    scene = plain_scene(name, seed)
    if acted:
        scene = forced(seed, scene)
    return case(scene.mechanism, scene.q, scene.qd, seed)


@functools.cache
def robot_cases(path):
    mech = mechanism(path.read_text())
    sample = identities.sample_states(mech, 3)
    assert len(sample.q) == 3
    return [case(mech, q, qd, k) for k, (q, qd) in enumerate(zip(sample.q, sample.qd, strict=True))]


def cases(name, seeds=SEEDS):
    if isinstance(name, str):
        return [random_case(name, seed, acted) for seed in seeds for acted in (False, True)]
    return robot_cases(name)[: len(seeds)]


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
    blocks.evaluate(function, buffers, [np.tile(x, (3, 1)) for x in arrays], outputs)
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


ENGINES = {
    "series on floats": (lambda one: by_series(one, "floats"), SEEDS),
    "series on floats, grounded": (lambda one: by_series(one, "floats", grounded=True), SEEDS),
    "series in longdouble": (lambda one: by_series(one, "longdouble"), SEEDS[:8]),
    "series in mpmath": (lambda one: by_series(one, "mpmath"), SEEDS[:8]),
    "text, by angles": (lambda one: by_formulas(one, run_text, False), SEEDS[:8]),
    "text, by directions": (lambda one: by_formulas(one, run_text, True), SEEDS[:4]),
    "numpy blocks": (lambda one: by_formulas(one, run_blocks, True), SEEDS[:4]),
    "machine code": (lambda one: by_formulas(one, run_machine, True, True), SEEDS[:MADE]),
}


@pytest.mark.parametrize("engine", ENGINES)
@EVERY
def test_values(name, engine):
    evaluate, seeds = ENGINES[engine]
    if engine == "machine code" and machine.make(lambda processor: "") is None:
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
