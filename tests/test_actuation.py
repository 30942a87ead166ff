"""Torques as constants, expressions and tables: their values, and that only arithmetic can run."""

import math
import subprocess
import sys
import warnings
from contextlib import suppress

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from named_case import case

import robodyn
from random_mechanisms import mechanism
from robodyn import load
from robodyn.errors import InputError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation

ARM = load(ROOT / "robots/2r.yaml")
FOUR_BAR = load(ROOT / "robots/four-bar.yaml")
FIVE_BAR = load(ROOT / "robots/five-bar.yaml")
MOTOR = "I: 0.0028, motor: {ratio: 5, inertia: 1e-5}"
GEARED = mechanism((ROOT / "robots/five-bar.yaml").read_text().replace("I: 0.0028", MOTOR))
Y = (0.7, -0.4, 1.3, -2.2)  # q1, q2, qd1, qd2
T = 0.6
NAMES = {"t": T, "q1": Y[0], "q2": Y[1], "qd1": Y[2], "qd2": Y[3], "pi": math.pi, "e": math.e}


def value(text, t=T, y=Y):
    """The first joint's torque of the expression."""
    source = actuation.expressions(ARM, f"{text}, 0", "--tau")
    first, second = source.function(2)(t, y)
    assert second == 0.0
    return first


def refused(text, mech=ARM):
    """The message with which an expression is refused."""
    with pytest.raises(InputError) as caught:
        actuation.expressions(mech, text, "--tau")
    message = str(caught.value)
    assert message.startswith("--tau: ")
    assert "\n" not in message
    return message


class TestConstants:
    def test_all_joints_or_the_actuated_ones(self):
        assert actuation.constant(ARM, [1, 2.5]).constants == (1.0, 2.5)
        assert actuation.constant(FOUR_BAR, [3]).constants == (3.0, 0.0, 0.0)
        assert actuation.constant(FOUR_BAR, [3, 0, 0]).constants == (3.0, 0.0, 0.0)
        assert actuation.constant(FIVE_BAR, [1, 2]).constants == (1.0, 0.0, 2.0, 0.0)

    def test_a_passive_joint_takes_none(self):
        with pytest.raises(InputError, match=r"tau2 = 1.0.*coupler is passive"):
            actuation.constant(FOUR_BAR, [3, 1, 0])

    @pytest.mark.parametrize("values", [[], [1], [1, 2, 3]])
    def test_the_wrong_number(self, values):
        with pytest.raises(InputError, match=rf"tau = {len(values)} value.*2"):
            actuation.constant(ARM, values)

    def test_active_where_any_is_not_zero(self):
        assert not Actuation((0.0, -0.0)).active
        assert Actuation((0.0, 1e-300)).active
        assert actuation.expressions(ARM, "t, 0", "").active
        assert not actuation.expressions(ARM, "0, 1 - 1", "").active

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("1, -2", (1.0, -2.0)),
            ("1e3,.5", (1000.0, 0.5)),
            ("2*pi/3, -e**2", (2 * math.pi / 3, -(math.e**2))),
            ("sin(1), sqrt(2)", (math.sin(1), math.sqrt(2))),
            ("1 if 2 > 1 else 5, -(-3)", (1.0, 3.0)),
            ("7 % 4, 2**0.5", (3.0, 2**0.5)),
        ],
    )
    def test_an_expression_of_nothing_is_folded(self, text, expected):
        assert actuation.expressions(ARM, text, "").constants == expected

    @pytest.mark.parametrize(
        ("text", "part"),
        [
            ("1/0, 0", "division"),
            ("sqrt(-1), 0", "sqrt of a number that has none"),
            ("exp(1000), 0", "finite"),
            ("1e308*10, 0", "finite"),
            ("1e308*10 - 1e308*10, 0", "finite"),
            ("(-8)**(1/3), 0", "real|complex|number|domain"),
            ("1e999, 0", "1e"),
        ],
    )
    def test_a_constant_that_is_no_number(self, text, part):
        with pytest.raises(InputError, match=part):
            actuation.expressions(ARM, text, "--tau")


VALUES_ARE_PYTHONS = [
    "t",
    "q1 + 2*q2 - qd1/qd2",
    "-q1**2",
    "(-q1)**2",
    "2**-t",
    "2**3**t",
    "1 - 2 - t",
    "8/4/t",
    "t % 0.25",
    "-t % 0.25",
    "+t - -q2",
    "q1*(q2 + qd1)*qd2",
    "1.5e-3*t + .25",
    "1 if t > 0.5 else -1",
    "q1 if qd1 <= 0 else q2 if qd2 < 0 else 7",
    "max(q1, q2, t) - min(qd1, qd2)",
    "abs(q2)",
    "2*pi*t + e",
    "sin(t) + cos(t) + tan(t)",
    "asin(t) + acos(t) + atan(t)",
    "atan2(q1, q2)",
    "sinh(t) - cosh(t)*tanh(t)",
    "exp(-t) + log(t) + sqrt(t)",
    "log(t, 10)",
    "hypot(q1, q2, qd1)",
    "floor(3*qd2)",
    "floor(t)",
]


AN_UNKNOWN_NAME_IS_TOLD_WITH_THE_KNOWN_ONES = [
    "q0",
    "q3",
    "qd0",
    "qd3",
    "q",
    "qd",
    "q-1",
    "x",
    "T",
    "qdd1",
    "tau1",
    "nan",
    "inf",
]


ONE_FOR_EACH_ACTUATED_JOINT = ["t", "t, t, t", "t, t,", ",t", "t,,t", "", " ", "t; t", "t t"]


THE_WRONG_NUMBER_OF_ARGUMENTS = [
    "sin()",
    "sin(t, t)",
    "atan2(t)",
    "min(t)",
    "max()",
    "abs(t, t)",
    "sign()",
    "log(t, t, t)",
]


class TestExpressions:
    def test_values_are_pythons(self):
        for text in VALUES_ARE_PYTHONS:
            with case(text):
                scope = {**NAMES, **vars(math), "abs": abs, "min": min, "max": max}
                expected = eval(text, scope)
                found = value(text)
                assert found == pytest.approx(float(expected), rel=1e-15)
                assert isinstance(found, float)

    @pytest.mark.parametrize(("x", "expected"), [(-2.5, -1.0), (0.0, 0.0), (1e-300, 1.0)])
    def test_sign(self, x, expected):
        assert value("sign(q1)", y=(x, 0.0, 0.0, 0.0)) == expected

    def test_a_number_that_is_none_is_told_with_its_place(self):
        for text, told in (
            ("t/0", "a division by zero"),
            ("q1 + t % (1 - 1)", "a division by zero, at character 6"),
            ("t*sqrt(1 - 2)", "sqrt of a number that has none, at character 3"),
            ("t + (-8)^(1/3)", "a root of a negative number, at character 5"),
            ("t*1e300^2", "a number that is too large, at character 3"),
            ("1 if t > 2 else 1/0", "a division by zero, at character 17"),
        ):
            assert refused(f"{text}, 0") == f"--tau: torque expression does not allow {told}"

    @pytest.mark.parametrize("text", ["t/(q1 - 0.7)", "sin(t/5e-324)", "cos(t*1e308*10)"])
    def test_errors_are_pythons(self, text):
        with pytest.raises((ZeroDivisionError, ValueError)) as expected:
            eval(text, {**NAMES, **vars(math)})
        with pytest.raises(expected.type):
            value(text)

    @settings(deadline=None, max_examples=60)
    @given(st.data())
    def test_random_arithmetic(self, data):
        def grow(depth):
            kind = data.draw(st.integers(0, 5 if depth else 1))
            if kind == 0:
                return data.draw(st.sampled_from(["t", "q1", "q2", "qd1", "qd2", "pi", "e"]))
            if kind == 1:
                return repr(data.draw(st.floats(0.0, 10.0, allow_nan=False)))
            if kind == 2:
                return f"-{grow(depth - 1)}"
            if kind == 3:
                return f"{data.draw(st.sampled_from(['sin', 'cos', 'atan']))}({grow(depth - 1)})"
            if kind == 4:
                return f"({grow(depth - 1)})"
            sign = data.draw(st.sampled_from([" + ", " - ", "*", "/"]))
            return f"{grow(depth - 1)}{sign}{grow(depth - 1)}"

        text = "0*t + " + grow(4)
        scope = {**NAMES, "sin": math.sin, "cos": math.cos, "atan": math.atan}
        try:
            expected = eval(text, scope)
        except (ZeroDivisionError, ValueError) as error:  # 1/0, and the sine of infinity
            with pytest.raises(type(error)):
                value(text)
            return
        assert value(text) == expected or math.isnan(expected)

    def test_every_joint_by_its_own_number(self):
        source = actuation.expressions(FIVE_BAR, "q3 + 10*qd4, q4 + 10*qd3", "")
        state = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
        assert source.function(4)(0.0, state) == [83.0, 0.0, 74.0, 0.0]

    def test_what_follows_the_state_is_left_alone(self):
        """An integrator's y may hold the work done as well."""
        source = actuation.expressions(ARM, "q1, qd2", "")
        assert source.function(2)(0.0, (*Y, 99.0)) == [Y[0], Y[3]]

    def test_all_joints_with_zeros_at_the_passive_ones(self):
        source = actuation.expressions(FOUR_BAR, "2*t, 0, 0.0", "")
        assert source.function(3)(3.0, (0.0,) * 6) == [6.0, 0.0, 0.0]
        assert "passive" in refused("t, 0, 1", FOUR_BAR)
        assert "passive" in refused("t, q1, 0", FOUR_BAR)

    def test_white_space_and_comments(self):
        assert value("  sin( t )\t+ 1 ") == math.sin(T) + 1
        source = actuation.expressions(ARM, "t,\n q1  # the forearm", "")
        assert source.function(2)(T, Y) == [T, Y[0]]

    def test_one_for_each_actuated_joint(self):
        for text in ONE_FOR_EACH_ACTUATED_JOINT:
            with case(text):
                message = refused(text)
                assert "expression" in message

    @pytest.mark.parametrize(
        "text",
        ["\uff11", "\u0661", "q\uff11", "\uff51 1", "\u00b2", "\U0001d42c\U0001d422\U0001d427(t)"],
    )
    def test_characters_of_other_scripts(self, text):
        """Python itself takes some for digits and letters of our own."""
        assert "is no expression" in refused(f"{text}, 0")

    @pytest.mark.parametrize(
        "text", ["0if t else 1", "1or t", "0x1for x in t", "t is 1", "t(1)(2)"]
    )
    def test_what_python_warns_of_is_refused_without_a_warning(self, text):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            assert "expression" in refused(f"{text}, 0")
        assert not told

    def test_an_unknown_name_is_told_with_the_known_ones(self):
        for name in AN_UNKNOWN_NAME_IS_TOLD_WITH_THE_KNOWN_ONES:
            with case(name):
                message = refused(f"{name}, 0")
                assert name.partition("-")[0] in message
                assert "q1..q2" in message
                assert "pi" in message

    @pytest.mark.parametrize("text", ["foo(t)", "pow(t, 2)", "sin", "math.sin(t)", "q1(t)"])
    def test_an_unknown_function_is_told(self, text):
        message = refused(f"{text}, 0")
        assert "does not allow" in message or "'.' at character 5" in message

    def test_the_wrong_number_of_arguments(self):
        """Told when it is written, not when the motion comes to it."""
        for text in THE_WRONG_NUMBER_OF_ARGUMENTS:
            with case(text):
                assert text.partition("(")[0] in refused(f"{text}, 0")

    @pytest.mark.parametrize("text", ["(t - 1)**0.5", "(-t)**(1/3)", "(-t)**q1"])
    def test_a_root_of_a_negative_number_is_an_error_of_arithmetic(self, text):
        """As sqrt is; Python would go on with complex numbers."""
        with pytest.raises((ArithmeticError, ValueError)):
            value(text)

    def test_a_comparison_is_a_number(self):
        for text, expected in (("(t < 1)*2", 2.0), ("t < 1", 1.0), ("t > 1", 0.0)):
            assert value(text) == expected

    def test_a_long_sum(self):
        """As long as a Fourier series may be."""
        text = " + ".join(f"{1 / k:.3f}*sin({k}*t)" for k in range(1, 90))
        known = sum(float(f"{1 / k:.3f}") * math.sin(k * T) for k in range(1, 90))
        assert value(text) == pytest.approx(known, rel=1e-12)


# Nothing but arithmetic can run
ATTACKS = [
    # attributes and dunder names
    "t.real",
    "t.__class__",
    "().__class__.__bases__[0].__subclasses__()",
    "sin.__self__",
    "(1).__class__",
    "1.0.hex()",
    "__import__('os').system('touch {mark}')",
    "__builtins__",
    "__name__",
    "__import__",
    "_sin(t)",
    "_sin",
    "_interpolate(t)",
    "_torques(t)",
    # builtins
    "open('{mark}', 'w')",
    "eval('1')",
    "exec('1')",
    "compile('1', '', 'eval')",
    "getattr(t, 'real')",
    "globals()",
    "locals()",
    "vars()",
    "breakpoint()",
    "print(t)",
    "input()",
    "exit()",
    "sum(t)",
    "range(9)",
    "pow(2, 3)",
    "float('1')",
    # syntax beyond arithmetic
    "lambda: t",
    "(lambda: t)()",
    "(lambda x: x)(t)",
    "[x for x in (1, 2)]",
    "(x for x in (1, 2))",
    "{{x for x in (1, 2)}}",
    "{{x: x for x in (1, 2)}}",
    "[t]",
    "[t][0]",
    "(t, t)",
    "{{t}}",
    "{{}}",
    "{{t: t}}",
    "t[0]",
    "t[:]",
    "(x := t)",
    "(sin := t)",
    "'a'",
    "'a' * 3",
    "b'a'",
    "f'{{t}}'",
    "f'{{open(1)}}'",
    "f''",
    "'%s' % t",
    "...",
    "None",
    "True",
    "False",
    "1j",
    "t*1j",
    "not t",
    "~t",
    "t and 1",
    "t or 1",
    "t == 1",
    "t != 1",
    "t is 1",
    "t in (1, 2)",
    "1 < t < 2",
    "t // 2",
    "t @ t",
    "t << 2",
    "t >> 2",
    "t | 1",
    "t & 1",
    "await t",
    "yield t",
    "(yield)",
    "(yield from t)",
    "*t",
    "sin(*t)",
    "sin(**t)",
    "sin(x=t)",
    "max(t, key=sin)",
    "max(t, 1, default=2)",
    "sin(t)(t)",
    "(sin)(t)(t)",
    "(sin if t else cos)(t)",
    "import os",
    "t = 1",
    "t; import os",
    "del t",
    "assert t",
    "pass",
    "return t",
    "raise t",
    "global t",
    "while 1: pass",
    "t\nimport os",
    # out of the parentheses that it is parsed in
    "1,)+(2",
    "t,) or (t",
    "t) or (t",
    "t) and print(t) or (t",
    "0)\nimport os\n(0",
    "0)\n#",
    "t)if(t)else(t",
    "0,) if (x := 1) else (0",
    # numbers
    "1e999",
    "-1e999",
    "2**65",
    "t**65",
    "t**-65",
    "t**(100)",
    "2**1e9",
    "9" * 400,
    "0x" + "f" * 300,
    # names that look like others
    "q1 + １",
    "q²",
    "q_1",
    "q1_",
    "Q1",
    "т",
]


DEEP_NESTING_IS_COMPUTED_OR_REFUSED = [
    "(" * 150 + "t" + ")" * 150,
    "(" * 900 + "t" + ")" * 900,
    "-" * 1900 + "t",
    "-" * 300 + "t",
    "-" * 1900 + "1",
    "sin(" * 90 + "t" + ")" * 90,
    "sin(" * 400 + "t" + ")" * 400,
    "2**" * 300 + "t",
    "[" * 150 + "]" * 150,
    "1 if t else " * 150 + "t",
    "t if t else " * 80 + "1",
    "abs(" * 1000,
    "+".join(["t"] * 250),
    "*".join(["t"] * 990),
]


class TestNothingElseCanRun:
    def test_refused(self, tmp_path):
        mark = tmp_path / "mark"
        for text in ATTACKS:
            with case(text):
                refused(f"{text.format(mark=mark) if '{' in text else text}, 0")
                assert not mark.exists()

    @pytest.mark.parametrize("character", ["\0", "\x1b", "\ud800", "\u202e", "\x85", "\ufeff"])
    def test_characters_of_no_expression(self, character):
        message = refused(f"t{character}, 0")
        assert message.isprintable()

    def test_deep_nesting_is_computed_or_refused(self):
        """With a message: no RecursionError, no crash."""
        for text in DEEP_NESTING_IS_COMPUTED_OR_REFUSED:
            with case(text), suppress(InputError, ArithmeticError):
                assert isinstance(value(text), float)

    def test_length_is_bounded(self):
        assert "longer" in refused("t" + "+t" * 100_000 + ", 0")

    def test_huge_powers_end_at_once(self):
        """A power of whole numbers would never end, nor answer a Ctrl-C."""
        program = f"""
import resource, sys
from robodyn import load
from robodyn.errors import RobodynError
from robodyn.mechanics import actuation
resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
for text in sys.argv[1:]:
    print(text, file=sys.stdout, flush=True)
    try:
        source = actuation.expressions(load({str(ROOT / "robots/2r.yaml")!r}), text + ", 0", "")
        source.function(2)(0.5, (0.1, 0.2, 0.3, 0.4))
    except (RobodynError, ArithmeticError):
        pass
"""
        texts = [
            "floor(1e9)**floor(1e9)",
            "floor(1e15)**floor(64)**floor(64)",
            "floor(9e15 + t)**floor(9e15)",
            "floor(t + 1e9)**floor(1e9)**floor(1e9)",
            "(60*60)**(60*60*60)",
            "64**64**64",
            "2**(60 + 60 + t)**60",
            "9**9**9**9",
            "max(9, 1)**max(9**9, 1)**9",
            "abs(9)**abs(9**9)",
        ]
        command = [sys.executable, "-c", program, *texts]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert (done.returncode, done.stderr, done.stdout.splitlines()) == (0, "", texts)


TIMES_THAT_DO_NOT_SERVE = [
    ([], "two rows"),
    ([0.0], "two rows"),
    ([0.0, 0.0], "two times"),
    ([0.0, 1.0, 0.5], "increase"),
    ([1.0, 0.0], "increase"),
    ([0.0, math.nan], "increase|finite"),
    ([math.nan, 1.0], "increase|finite"),
    ([0.1, 1.0], "cover"),
    ([0.0, 0.9], "cover"),
    ([-2.0, -1.0], "cover"),
]


class TestTables:
    TIMES = (0.0, 0.5, 0.75, 2.0)
    ROWS = ((1.0, -1.0), (2.0, 0.0), (-2.0, 10.0), (0.0, 10.0))

    def table(self, **options):
        return actuation.table(ARM, self.TIMES, self.ROWS, **options)

    def test_linear_between_its_rows(self):
        function = self.table().function(2)
        for t in np.linspace(0.0, 2.0, 41).tolist():
            expected = [np.interp(t, self.TIMES, column) for column in zip(*self.ROWS, strict=True)]
            assert function(t, Y) == pytest.approx(expected, abs=1e-14)

    def test_exact_on_its_rows(self):
        function = self.table().function(2)
        for t, row in zip(self.TIMES, self.ROWS, strict=True):
            assert function(t, Y) == pytest.approx(row, abs=1e-15)

    def test_rows_hold_the_actuated_joints(self):
        source = actuation.table(FIVE_BAR, [0, 1], [[1, 2], [3, 4]])
        assert source.function(4)(0.5, (0.0,) * 8) == [2.0, 0.0, 3.0, 0.0]

    def test_kinks_are_its_times(self):
        source = self.table()
        assert source.kinks == self.TIMES
        assert source.active
        assert source.constants is None
        assert actuation.expressions(ARM, "t, t", "").kinks == ()

    def test_whole_numbers_and_arrays(self):
        source = actuation.table(ARM, np.array([0, 1]), np.array([[1, 2], [3, 4]]))
        assert source.function(2)(0.25, Y) == [1.5, 2.5]

    def test_times_that_do_not_serve(self):
        for times, match in TIMES_THAT_DO_NOT_SERVE:
            with case(times, match):
                rows = [(1.0, 2.0)] * len(times)
                with pytest.raises(InputError, match=match) as caught:
                    actuation.table(ARM, times, rows, where="file.csv", until=1.0)
                assert str(caught.value).startswith("file.csv: ")

    def test_backwards(self):
        actuation.table(ARM, [-1.0, 0.0], [(1, 1), (2, 2)], until=-1.0)
        with pytest.raises(InputError, match=r"cover.*-1 to 0"):
            actuation.table(ARM, [0.0, 1.0], [(1, 1), (2, 2)], until=-1.0)

    @pytest.mark.parametrize("row", [(1.0,), (1.0, 2.0, 3.0)])
    def test_rows_of_the_wrong_length(self, row):
        with pytest.raises((InputError, ValueError)):
            actuation.table(ARM, [0.0, 1.0], [row, row]).function(2)(0.5, Y)


class TestFunctions:
    def test_gets_time_and_state(self):
        seen = []

        def law(t, q, qd):
            seen.append((t, q, qd))
            return [1.0, 2]

        assert actuation.callback(ARM, law).function(2)(T, (*Y, 5.0)) == [1.0, 2.0]
        assert seen == [(T, [0.7, -0.4], [1.3, -2.2])]

    def test_the_actuated_joints_or_all(self):
        for values in ([1.5], [1.5, 0.0, 0.0], np.array([1.5])):
            source = actuation.callback(FOUR_BAR, lambda t, q, qd, values=values: values)
            assert source.function(3)(0.0, (0.0,) * 6) == [1.5, 0.0, 0.0]

    def test_the_wrong_number(self):
        source = actuation.callback(ARM, lambda t, q, qd: [1.0])
        with pytest.raises(InputError, match="1 value"):
            source.function(2)(0.0, Y)


class TestWidths:
    """Each function takes torques of all joints, or of the actuated ones alone."""

    Q = robodyn.assemble(FIVE_BAR, [2.0, 1.0])
    QD = robodyn.loop_velocities(FIVE_BAR, Q, [1.0, 0.5])
    STATE = FIVE_BAR, Q, QD
    FEW, ALL = [0.3, -0.2], [0.3, 0.0, -0.2, 0.0]
    CASES = (
        lambda self, tau: robodyn.forward_dynamics(*self.STATE, tau),
        lambda self, tau: robodyn.forward_dynamics(*self.STATE, np.tile(tau, (300, 1))),
        lambda self, tau: robodyn.forward_dynamics_and_forces(*self.STATE, tau).multipliers,
        lambda self, tau: robodyn.forward_dynamics_derivatives(*self.STATE, tau).by_q,
        lambda self, tau: robodyn.linearize(*self.STATE, tau).A,
        lambda self, tau: robodyn.equilibrium(FIVE_BAR, tau=tau).q,
        lambda self, tau: [rest.q for rest in robodyn.equilibria(FIVE_BAR, tau=tau)],
        lambda self, tau: robodyn.simulate(*self.STATE, 0.1, tau).q,
        lambda self, tau: robodyn.simulate(*self.STATE, 0.1, lambda t, q, qd: tau).q,
        lambda self, tau: robodyn.simulate(*self.STATE, 0.1, self.feedback(tau)).q,
        lambda self, tau: self.labels(tau),
        lambda self, tau: robodyn.motor_loads(GEARED, tau, self.QD)["motor3"],
        lambda self, tau: robodyn.identify(*self.measured(len(tau) == 4)).pi,
    )

    def feedback(self, tau):
        given = robodyn.StateFeedback((0, 2), self.Q.tolist(), tau, [[9, 1, 2, 0], [0, 8, 0, 1]])
        reference = robodyn.ReferenceTable.set_point([2.0, 1.0], 1.0)
        return robodyn.controller(FIVE_BAR, reference, "state-feedback", gain=given)

    def labels(self, tau):
        picture = robodyn.draw(*self.STATE, tau=tau, forces=True)
        return [text.get_text() for text in picture.axes[0].texts]

    def measured(self, whole):
        t = np.linspace(0.0, 2.0, 60)
        q = robodyn.assemble(FIVE_BAR, np.stack([2.0 + 0.3 * np.sin(3 * t), 1.0 + 0.2 * t], -1))
        qd = robodyn.loop_velocities(FIVE_BAR, q, np.stack([0.9 * np.cos(3 * t), 0.2 + 0 * t], -1))
        tau = robodyn.inverse_dynamics(FIVE_BAR, q, qd, np.zeros_like(q))
        return FIVE_BAR, q, qd, np.zeros_like(q), tau if whole else tau[:, [0, 2]]

    @pytest.mark.parametrize("case", CASES)
    def test_both(self, case):
        few, every = (case(self, tau) for tau in (self.FEW, self.ALL))
        assert np.array_equal(few, every)

    def test_others(self):
        match = r"tau.shape = \(3,\): must have 4 .*one a joint, or 2, one an actuated joint"
        for function in (robodyn.forward_dynamics, robodyn.linearize):
            with pytest.raises(InputError, match=match):
                function(*self.STATE, [1.0, 2.0, 3.0])
        mech, *states, tau = self.measured(whole=True)
        with pytest.raises(InputError, match=r"must be \(60, 2\).*\(60, 4\), zero at passive"):
            robodyn.identify(mech, *states, tau + 1.0)


def test_a_step_by_exponentials_goes_on_where_they_overflow():
    """1/(1 + exp(-200 qd)) is 0 far below zero, not outside of the domain."""
    mech = load(ROOT / "robots/pendulum.yaml")
    tau = actuation.expressions(mech, "1/(1+exp(-200*qd1))", "test").function(1)
    assert tau(0.0, [0.0, -10.0]) == [0.0]
    assert tau(0.0, [0.0, 10.0]) == [1.0]
