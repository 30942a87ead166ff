"""Public functions refuse wrong types, shapes and NaN in each argument by InputError."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import suppress
from decimal import Decimal

import numpy as np
import pytest

import robodyn

ARM, LOOP = robodyn.load("2r"), robodyn.load("four-bar")
MOTOR = {"ratio": 10.0, "inertia": 1e-4, "torque_constant": 0.1, "resistance": 1.0}
DRIVEN = robodyn.load(
    {"links": [{"name": "a", "m": 1, "l": 1, "r": 0.5, "I": 0.1, "motor": MOTOR}]}
)
ROWS, TWO, THREE = np.linspace(0.0, 1.0, 24).reshape(12, 2), [0.0, 0.0], [0.0, 0.0, 0.0]
STATE = {"mechanism": ARM, "q": [0.1, 0.2], "qd": TWO, "qdd": TWO, "tau": TWO}
CLOSED = {"mechanism": LOOP, "q": robodyn.assemble(LOOP, [1.0]), "qd": THREE, "qdd": THREE}
HELD = {**CLOSED, "multipliers": TWO}
FIT = {"mechanism": ARM, "vary": {"links.forearm.m": (1, 3)}, "starts": 1}
WAY = {"mechanism": ARM, "points": [[0, 0], [1, 1]]}
MOTION = robodyn.reference_motion(ARM, [[0, 0], [1, 1]], 1.0)
CALLS = {
    "animate": {"motion": ARM, "t": [0, 1.0], "q": ROWS[:2]},
    "assemble": {"mechanism": LOOP, "q_actuated": [1.0]},
    "controller": {"mechanism": ARM, "reference": MOTION, "control": "pd", "kp": 1, "kd": 1},
    "coupling_torques": {"mechanism": LOOP, "multipliers": TWO},
    "draw": {"mechanism": ARM, "q": TWO},
    "equilibria": {"mechanism": ARM},
    "equilibrium": {"mechanism": ARM},
    "fit": {**FIT, "columns": ["tau1"], "q": ROWS, "target": ROWS[:, :1]},
    "fit_motion": {**FIT, "columns": ["q1"], "t": [0, 0.05], "q": TWO, "target": [[0], [0]]},
    "identify": {"mechanism": ARM, **dict.fromkeys(("q", "qd", "qdd", "tau"), ROWS)},
    "inverse_kinematics": {"mechanism": ARM, "xy": [0.5, 0.5], "of": "tip2"},
    "kept_moments": {"mechanism": LOOP, "multipliers": TWO},
    "load": {"scene": "2r"},
    "loop_accelerations": {**CLOSED, "qdd_actuated": [0.0]},
    "loop_velocities": {**CLOSED, "qd_actuated": [0.0]},
    "lqr": {"model": robodyn.linearize(ARM, TWO)},
    "pin_forces": {"mechanism": LOOP, "multipliers": TWO},
    "plot": {},
    "postures": {"mechanism": ARM, "xy": [0.5, 0.5], "of": "tip2"},
    "reactions": HELD,
    "reference_motion": {**WAY, "duration": 1.0},
    "shortest_motion": {**WAY, "max_qd": [1, 1], "max_qdd": [1, 1]},
    "simulate": {"mechanism": ARM, "q": TWO, "qd": TWO, "t_end": 0.01},
    "slide_moments": HELD,
    "sweep": {"mechanism": ARM, "vary": {"q1": [0, 1]}, "kind": "torque"},
    "voltages": {"mechanism": DRIVEN, "volt": [0.0]},
}
FUNCTIONS = [name for name in robodyn.__all__ if inspect.isfunction(getattr(robodyn, name))]
NEVER = [object(), b"x", 1j, [None], [np.nan, 1.0], [np.nan], np.nan, np.zeros((2, 3, 4)), [["a"]]]
WIDE = [1.0, 2.0, 3.0, 4.0]
OTHERS = [None, "a", "", 5, -1, True, [], WIDE, [[1.0], [2.0]], {}, {"a": 1}]
OTHERS += [["a"], lambda: 0, [[1.0], [2.0, 3.0]], 10**400, np.array(["a"])]
STATES = ("q", "qd", "qdd", "tau", "multipliers", "q_actuated", "qd_actuated", "qdd_actuated")
ANY = {"plot": ["tables"], "sweep": ["options"]}  # what is no argument by name


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.filterwarnings("ignore")
def test_wrong_arguments_are_refused_by_input_errors(name: str) -> None:
    function = getattr(robodyn, name)
    names = [x for x in inspect.signature(function).parameters if x not in ANY.get(name, [])]
    known = CALLS.get(name, STATE)
    valid = {x: known[x] for x in (*names, "kind") if x in known}
    tables = [robodyn.simulate(ARM, TWO, TWO, 0.01)] if name == "plot" else []
    function(*tables, **valid)
    for argument in names:
        for value in [*NEVER, WIDE] if argument in STATES else NEVER:
            with pytest.raises(robodyn.InputError):
                function(*tables, **{**valid, argument: value})
        for value in OTHERS:
            with suppress(robodyn.RobodynError):
                function(*tables, **{**valid, argument: value})


@pytest.mark.parametrize("kind", [list, tuple, np.array, np.float32, np.longdouble])
def test_numbers_may_be_lists_tuples_and_arrays_of_numpy(kind: Callable[[object], object]) -> None:
    expected = robodyn.inverse_dynamics(ARM, [0.5, 0.25], TWO, [1.0, 2.0], 0.0)
    given = [kind([0.5, 0.25]), kind(TWO), kind([1.0, 2.0]), np.float32(0.0)]
    np.testing.assert_array_equal(robodyn.inverse_dynamics(ARM, *given), expected)
    decimals = [Decimal("0.5"), Decimal("0.25")]
    np.testing.assert_array_equal(
        robodyn.inverse_dynamics(ARM, decimals, TWO, np.array([1, 2]), np.int64(0)), expected
    )


@pytest.mark.parametrize("name", ["other_forces", "kinetic_energy", "points", "reactions"])
def test_states_and_times_broadcast(name: str) -> None:
    wide = {"q": np.zeros((3, 2)), "qd": np.zeros((2, 2)), "qdd": TWO, "multipliers": []}
    function = getattr(robodyn, name)
    given = {x: wide[x] for x in inspect.signature(function).parameters if x in wide}
    with pytest.raises(robodyn.InputError, match="must broadcast to one another"):
        function(ARM, **given)
    if "t" in inspect.signature(function).parameters:
        with pytest.raises(robodyn.InputError, match="one a state"):
            function(ARM, **{**given, "qd": TWO}, t=[0.0, 1.0])
