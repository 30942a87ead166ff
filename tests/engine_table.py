"""Every engine of the program as a function of a case: the quantities that it finds.

Quantities are named as in `engine_cases.Case.expected`: M, C, G, Q, KE, PE, gap, Psi, bias; qdd
and the multipliers `outer` of the torques, tau and the multipliers `inner` of the accelerations;
the power of all torques, the reactions, and what
springs and loads put on the links.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from conftest import FRESH
from engine_cases import KINDS, ROBOTS, SEEDS, Case, cases, plain_too
from known_terms import DIGITS
from mpmath import mp, mpf

from robodyn import other_forces, pin_forces, reactions
from robodyn.dynamics import closed_form, dense_dynamics
from robodyn.dynamics import dynamics as dyn
from robodyn.elements.loads import Force
from robodyn.elements.springs import PointSpring
from robodyn.engines import batches, formulas, straightline
from robodyn.engines.arithmetic import FLOATS, Arithmetic
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.batches import Rows
from robodyn.engines.expansion import MotionProgram
from robodyn.engines.formulas import Formula, Recorded
from robodyn.engines.machine import PLAIN
from robodyn.engines.row_values import rows_of
from robodyn.engines.series import Series
from robodyn.loops import closures
from robodyn.mechanics import parts
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.runs.benchmark import LONGS
from robodyn.runs.right_hand_side import right_hand_side

DIGITAL = Arithmetic(
    cos=mp.cos,
    sin=mp.sin,
    power=lambda x, exponent: x ** mpf(exponent),
    functions={name: getattr(mp, name) for name in FLOATS.functions},
)
# arithmetics of `Series`, and how they make numbers of floats
NUMBERS = {
    "floats": (FLOATS, float),
    "longdouble": (LONGS, np.longdouble),
    "mpmath": (DIGITAL, mpf),
}
LANES = 11  # rows of machine code that are equal: more than a processor's lanes


def parted(one: Case, forward=None, inverse=None, kinematics=None):
    """Quantities of the arrays that formulas give."""
    n, r, found = one.mech.n, one.at.r, {}
    for joints, forces, values in (("qdd", "outer", forward), ("tau", "inner", inverse)):
        if values is not None:
            found[joints], found[forces] = np.split(np.asarray(values, float), [n])
    if kinematics is not None:
        gap, Psi = np.split(np.asarray(kinematics, float), [r])
        found |= {"gap": gap, "Psi": Psi.reshape(r, n)}
    return found


# ---------------------------------------------------------------------------------------------
# numpy on arrays
# ---------------------------------------------------------------------------------------------


def forces_on_links(mech, q, qd, t):
    """What springs and loads put on each link, (n,), N, complex."""
    found = np.zeros(mech.n, complex)
    if mech.of(PointSpring) or mech.of(Force):
        each = iter(rows_of(parts.acting, mech).planar("forces", q, qd, t))
        ends = [[(x.first.link, 1.0), (x.second.link, -1.0)] for x in mech.of(PointSpring)]
        ends += [[(x.point.link, 1.0)] for x in mech.of(Force)]
        for force, links in zip(each, ends, strict=True):
            for link, sign in links:
                if link is not None:
                    found[link] += sign * force
    return found


def by_closed_form(one):
    cf, mech, q, qd = closed_form, one.mech, one.q, one.qd
    found = {"M": cf.mass_matrix(mech, q), "G": cf.gravity_vector(mech, q)}
    found["C"] = cf.coriolis_matrix(mech, q, qd)
    found["Q"] = other_forces(mech, q, qd, one.t) - np.array(mech.damping) * qd
    found |= {"KE": cf.kinetic_energy(mech, q, qd), "PE": cf.potential_energy(mech, q)}
    found |= {
        "gap": closures.closure_gap(mech, q, one.t),
        "Psi": closures.closure_jacobian(mech, q, one.t),
    }
    on_links = forces_on_links(mech, q, qd, one.t)
    found["on links"] = np.column_stack([on_links.real, on_links.imag])
    return found | {"bias": closures.closure_bias(mech, q, qd, one.t)}


def by_dense_algebra(one):
    qdd, outer, _ = dense_dynamics.forward(one.mech, one.q, one.qd, one.tau, t=one.t)
    tau, inner, _ = dense_dynamics.inverse(one.mech, one.q, one.qd, one.qdd, one.t)
    return {"qdd": qdd, "outer": outer, "tau": tau, "inner": inner}


def by_calls(one):
    """As users ask for one state; pin forces are the multipliers along their directions."""
    mech, state = one.mech, (one.q, one.qd)
    qdd, outer, _ = dyn.forward_dynamics_and_forces(mech, *state, one.tau, one.t)
    tau, inner, _ = dyn.inverse_dynamics_and_forces(mech, *state, one.qdd, one.t)
    assert np.array_equal(qdd, dyn.forward_dynamics(mech, *state, one.tau, one.t))
    assert np.array_equal(tau, dyn.inverse_dynamics(mech, *state, one.qdd, one.t))
    assert not tau[list(mech.passive)].any()
    multipliers = iter(inner)
    for closure, (x, y) in zip(
        mech.description.closures, pin_forces(mech, inner, one.q), strict=True
    ):
        F = sum(direction * next(multipliers) for direction in one.at.directions(closure))
        assert abs(complex(x, y) - F) <= 1e-14 * abs(F)
    found = {"qdd": qdd, "outer": outer, "tau": tau, "inner": inner}
    return found | {"reactions": reactions(mech, *state, one.qdd, inner, one.t)}


def by_batches(one, count=dyn.BATCH + 1, alone=True):
    """The same of many equal states; the first and the last. `alone`: joint values alone, too."""
    mech, found = one.mech, {}
    many = {name: np.tile(getattr(one, name), (count, 1)) for name in ("q", "qd", "qdd", "tau")}
    for kind, given, names in (
        ("forward", "tau", ("qdd", "outer")),
        ("inverse", "qdd", ("tau", "inner")),
    ):
        states = many["q"], many["qd"], many[given]
        joints, forces, _ = getattr(dyn, f"{kind}_dynamics_and_forces")(mech, *states, one.t)
        if alone:
            only = getattr(dyn, f"{kind}_dynamics")(mech, *states, one.t)
            assert np.abs(only - joints).max() <= 1e-12 * max(1.0, np.abs(joints).max())
        for name, values in zip(names, (joints, forces), strict=True):
            assert np.ptp(values, axis=0).max(initial=0.0) <= 1e-13 * np.abs(values).max(initial=0)
            found[name] = values[-1]
    return found


def by_batches_of_code(one, family=""):
    """Batches by machine code alone, as if it were worth it for any number of states."""
    made, compiled, worth = [], Rows.compile, batches.WORTH
    written = [dyn._generated(kind, one.mech) for kind in ("forward", "inverse")]
    written = [rows for rows in written if rows is not None]

    def compile(self):
        made.append(compiled(self, 0 if family else None, family))
        return made[-1]

    for rows in written:
        rows._machine.clear()
    Rows.compile, batches.WORTH = compile, 0.0
    try:
        found = by_batches(one, alone=one.mech.has_state_forces)
    finally:
        Rows.compile, batches.WORTH = compiled, worth
        for rows in written:
            rows._machine.clear()
    assert None not in made
    assert bool(made) == bool(written)
    return found


def by_rates(one, kind):
    """The right-hand sides of solvers."""
    mech, y = one.mech, np.concatenate([one.q, one.qd, [0.0]])
    actuation = Actuation(tuple(one.tau.tolist()))
    rates = np.asarray(
        right_hand_side(mech, actuation, work=True, kind=kind).rates(one.t, y), float
    )
    assert np.abs(rates[: mech.n] - one.qd).max() <= 1e-12 * (1.0 + np.abs(one.qd).max())
    return {"qdd": rates[mech.n : -1], "power": rates[-1]}


# ---------------------------------------------------------------------------------------------
# The rows of the program, and formulas recorded of them
# ---------------------------------------------------------------------------------------------


def relative(mech, values):
    """Values in angles of joints, of those in angles of links."""
    return [
        x - (0.0 if above is None else values[above])
        for x, above in zip(values, mech.above, strict=True)
    ]


def by_series(one, kind, grounded=False):
    """By `Series` on numbers of a kind."""
    mech, (arithmetic, number) = one.mech, NUMBERS[kind]
    n, J = mech.n, mech.arrays.J
    with mp.workdps(DIGITS):
        motion = MotionProgram(mech, Actuation(tuple(one.tau.tolist())), False)
        start = motion.state(
            arithmetic, number(one.t), [number(x) for x in (*one.q, *one.qd)], ((), ())
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
    return parted(one, [*qdd, *outer], [*(driven @ tau), *inner], [*gap, *Psi.ravel()])


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
    outputs = [np.empty((3, len(part))) for part in (formula.outputs, formula.pivots)]
    array = ArrayFormula(formula.inputs, formula.outputs + formula.pivots)
    array.fill([np.tile(x, (3, 1)) for x in arrays], outputs)
    return outputs[0][-1]


def run_machine(formula, arrays):
    """By machine code on rows; of equal states the last."""
    names = iter(formula.inputs)
    inputs = [[next(names) for _ in array] for array in arrays]
    evaluate = Rows(inputs, [formula.outputs], formula.pivots, 1e-12).compile()
    output = np.empty((LANES, len(formula.outputs)))
    assert not evaluate([np.tile(x, (LANES, 1)) for x in arrays], [output]).size
    return output[-1]


def by_formulas(one, by_direction, *ways):
    """By each formula, in each of several ways to run it."""
    given = {"forward": (one.q, one.qd, one.tau), "inverse": (one.q, one.qd, one.qdd)}
    given["kinematics"] = one.q, one.qd
    for kind in ("forward", "inverse") if one.mech.timed else ():
        given[kind] = *given[kind], np.array([one.t])
    each = recorded(one.mech, by_direction).items()
    return [
        parted(one, **{kind: run(formula, given[kind]) for kind, formula in each}) for run in ways
    ]


def kinematics_by_machine_code(one):
    """Gap and Psi, which batches do not tell."""
    formula = recorded(one.mech, True, parameters=True).get("kinematics")
    return parted(one, kinematics=run_machine(formula, (one.q, one.qd))) if formula else {}


# ---------------------------------------------------------------------------------------------
# The table
# ---------------------------------------------------------------------------------------------

# but with FRESH all engines share the cases of one seed, which take long to know
MANY, SOME, FEW = (SEEDS, SEEDS[:8], SEEDS[:1]) if FRESH else (SEEDS[2:3],) * 3
EVERYWHERE = (*KINDS, *ROBOTS)
# where code is made for each: all kinds, and of robots/ one in three, others by other engines
THIRDS = [EVERYWHERE if FRESH else (*KINDS, *ROBOTS[k::3]) for k in range(3)]


class Engine(NamedTuple):
    """What finds quantities of a case, on which seeds of which scenes; whether it compiles."""

    find: Callable[[Case], dict | list[dict]]
    seeds: range = SOME
    scenes: Sequence[str | Path] = EVERYWHERE
    compiles: bool = False
    long: bool = False  # code is written for each case: of most kinds for the one with forces

    def cases(self, name: str | Path) -> list[Case]:
        """Those of a scene."""
        found = cases(name, self.seeds)
        return found if plain_too(name) or not (self.compiles or self.long) else found[-1:]


ENGINES = {
    "closed form": Engine(by_closed_form, MANY),
    "dense algebra": Engine(by_dense_algebra, MANY),
    "calls": Engine(by_calls, MANY),
    "batches": Engine(by_batches),
    "batches, by machine code": Engine(by_batches_of_code, FEW, THIRDS[0], compiles=True),
    "batches, by plain machine code": Engine(
        lambda one: by_batches_of_code(one, PLAIN), FEW, EVERYWHERE[::6], compiles=True
    ),
    "rates, straight-line": Engine(lambda one: by_rates(one, "straight-line"), FEW, long=True),
    "rates, dense": Engine(lambda one: by_rates(one, "dense")),
    "series on floats": Engine(lambda one: by_series(one, "floats"), MANY),
    "series on floats, grounded": Engine(lambda one: by_series(one, "floats", grounded=True), MANY),
    "series in longdouble": Engine(lambda one: by_series(one, "longdouble")),
    "series in mpmath": Engine(lambda one: by_series(one, "mpmath")),
    "code by angles": Engine(
        lambda one: by_formulas(one, False, run_text, run_blocks), SOME, THIRDS[0], long=True
    ),
    "code by directions": Engine(
        lambda one: by_formulas(one, True, run_text, run_blocks), SOME, THIRDS[1], long=True
    ),
    "kinematics by machine code": Engine(kinematics_by_machine_code, FEW, THIRDS[2], compiles=True),
}
