"""Recorded arithmetic: what folds away, and that both emitters compute what floats compute."""

import math

import numpy as np
import pytest
from conftest import FRESH
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robodyn.engines import expression
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.expression import Expression, Graph, cost
from robodyn.engines.straightline import float_source

NAMES = ("x", "y", "z")
examples = settings(deadline=None, max_examples=150 if FRESH else 60)


# -- random programs -----------------------------------------------------------------------------
#
# A program is a list of operations on what came before: three inputs, constants, earlier results.
# It runs on floats, and on Expressions, and then the code written from those runs too.

OPERATIONS = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "negate": lambda a, b: -a,
    "halve": lambda a, b: a / 2.0,
    "twice": lambda a, b: 2.0 * a,
    "square": lambda a, b: a * a,
}


def on_either(recorded, computed, a):
    """A function of an Expression or of a float; nan beyond the floats."""
    if isinstance(a, Expression):
        return recorded(a)
    return computed(a) if math.isfinite(a) else math.nan


FUNCTIONS = OPERATIONS | {
    "sin": lambda a, b: on_either(expression.sin, math.sin, a),
    "cos": lambda a, b: on_either(expression.cos, math.cos, a),
    "divide": lambda a, b: a / (b * b + 1.0),
    "reciprocal": lambda a, b: 3.0 / (a * a + 0.5),
}


@st.composite
def programs(draw, operations, most=14):
    """A list of (operation, first, second): indices of earlier values, or constants."""
    constants = st.sampled_from([0.0, 1.0, -1.0, 2.0, -3.0, 0.5])
    steps = []
    for i in range(draw(st.integers(1, most))):
        earlier = st.integers(0, i + len(NAMES) - 1)
        steps.append(
            (
                draw(st.sampled_from(sorted(operations))),
                draw(earlier),
                draw(st.one_of(earlier, constants)),
            )
        )
    return steps


def run(program, operations, inputs):
    """All values of a program, the inputs first."""
    values = list(inputs)
    for name, a, b in program:
        values.append(operations[name](values[a], b if isinstance(b, float) else values[b]))
    return values


def outputs_of(program, operations):
    """The last four values of a program as expressions of x, y, z."""
    graph = Graph()
    return run(program, operations, [graph.variable(name) for name in NAMES])[-4:]


def evaluate_floats(outputs, inputs):
    """What the emitted float code gives."""
    lines, shown = float_source(outputs)
    body = "\n    ".join([*lines, f"return ({', '.join(shown)},)"])
    scope = {"sin": math.sin, "cos": math.cos}
    exec(f"def f({', '.join(NAMES)}):\n    {body}\n", scope)
    return scope["f"](*inputs)


def evaluate_arrays(outputs, inputs):
    """What numpy calls on blocks give, into strided columns, for inputs (3, T)."""
    columns = np.full((inputs.shape[1], len(outputs)), np.nan)
    before = inputs.copy()
    ArrayFormula(NAMES, outputs).fill([inputs.T], [columns])
    assert np.array_equal(inputs, before), "an input was written to"
    return columns.T


def small(values, limit):
    """Whether all values are finite and within the limit: beyond it rounding takes over."""
    return all(abs(value) <= limit for value in values)


class TestRandomPrograms:
    POINTS = np.array([[1.0, -2.0, 3.0], [0.0, 0.0, 0.0], [2.0, 1.0, -1.0], [-1.0, -1.0, 4.0]]).T

    @examples
    @given(programs(OPERATIONS, most=10))
    def test_sums_and_products_are_exact(self, program):
        """On small whole numbers no rounding happens, so every rewriting must give the same."""
        runs = [run(program, OPERATIONS, [float(x) for x in point]) for point in self.POINTS.T]
        assume(all(small(values, 2.0**40) for values in runs))
        outputs = outputs_of(program, OPERATIONS)
        arrays = evaluate_arrays(outputs, self.POINTS)
        for values, column in zip(runs, arrays.T, strict=True):
            assert list(evaluate_floats(outputs, values[:3])) == values[-4:]
            assert column.tolist() == values[-4:]

    @examples
    @given(programs(FUNCTIONS, most=10), st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
    def test_all_operations_to_rounding(self, program, numbers):
        points = np.array(numbers).reshape(3, 2)
        runs = [run(program, FUNCTIONS, [float(x) for x in point]) for point in points.T]
        assume(all(small(values, 1e2) for values in runs))
        outputs = outputs_of(program, FUNCTIONS)
        arrays = evaluate_arrays(outputs, points)
        for values, column in zip(runs, arrays.T, strict=True):
            expected = pytest.approx(values[-4:], abs=1e-6)
            assert list(evaluate_floats(outputs, values[:3])) == expected
            assert column.tolist() == expected

    @examples
    @given(programs(FUNCTIONS))
    def test_cost_is_that_of_the_nodes_once_each(self, program):
        outputs = outputs_of(program, FUNCTIONS)
        found = {}
        stack = [out for out in outputs if isinstance(out, Expression)]
        while stack:
            node = stack.pop()
            found[node.index] = expression.COST.get(node.op, 0.0)
            stack += [a for a in node.args if isinstance(a, Expression)]
        assert cost(outputs) == pytest.approx(sum(found.values()))


class TestFolding:
    def setup_method(self):
        self.graph = Graph()
        self.x, self.y = self.graph.variable("x"), self.graph.variable("y")

    def test_zeros_and_ones_vanish(self):
        x = self.x
        assert x + 0.0 is x
        assert 0.0 + x is x
        assert x - 0.0 is x
        assert x * 1.0 is x
        assert x / 1.0 is x
        assert x * 0.0 == 0.0
        assert 0.0 / x == 0.0
        assert x - x == 0.0

    def test_signs_move_to_where_they_are_free(self):
        x, y = self.x, self.y
        assert expression.negate(-x) is x
        assert -(x - y) is y - x
        assert x + -y is x - y
        assert (-x) * (-y) is x * y
        assert x * -1.0 is -x
        assert 0.0 - x is -x
        assert (-x) / y is -(x / y)

    def test_equal_subexpressions_are_one_node(self):
        x, y = self.x, self.y
        assert x + y is y + x
        assert x * y is y * x
        assert expression.cos(x + y) is expression.cos(y + x)
        assert x - y is not y - x
        assert x / y is not y / x

    def test_constants_gather(self):
        x, y = self.x, self.y
        assert 2.0 * (3.0 * x) is 6.0 * x
        assert (2.0 * x) * (3.0 * y) is 6.0 * (x * y)
        assert x / 4.0 is 0.25 * x
        assert x + x is 2.0 * x
        assert -(2.0 * x) is -2.0 * x

    def test_cosine_is_even_and_sine_is_odd(self):
        x = self.x
        assert expression.cos(-x) is expression.cos(x)
        assert expression.sin(-x) is -expression.sin(x)
        assert expression.cos(0.0) == 1.0
        assert expression.sin(0.5) == math.sin(0.5)

    def test_whole_numbers_and_floats_mix(self):
        assert evaluate_floats([1 + self.x * 2 - 3], [5.0, 0.0, 0.0]) == (8.0,)
        assert evaluate_floats([7 / self.x], [2.0, 0.0, 0.0]) == (3.5,)


class TestFloatSource:
    @pytest.mark.parametrize(
        ("formula", "text"),
        [
            (lambda x, y: x - (y + x * y), "x - (y + x*y)"),
            (lambda x, y: (x + y) * (x - y), "(x + y)*(x - y)"),
            (lambda x, y: x / (x * y), "x/(x*y)"),
            (lambda x, y: (x / y) * y, None),
            (lambda x, y: -(x + y), "-(x + y)"),
            (lambda x, y: x - 2.0 * y, "x - 2.0*y"),
            (lambda x, y: x + -2.0, "x + -2.0"),
            (lambda x, y: -2.5 * x / y, "-2.5*x/y"),
        ],
    )
    def test_parentheses_stand_where_they_are_needed(self, formula, text):
        graph = Graph()
        output = formula(graph.variable("x"), graph.variable("y"))
        lines, shown = float_source([output])
        assert lines == []
        assert text is None or shown == [text]
        for x, y in ((3.0, 7.0), (-2.0, 0.5)):
            assert evaluate_floats([output], [x, y, 0.0])[0] == pytest.approx(formula(x, y))

    def test_what_is_used_twice_is_computed_once(self):
        graph = Graph()
        x = graph.variable("x")
        shared = expression.sin(x)
        lines, shown = float_source([shared * shared + shared])
        assert len(lines) == 1
        assert "".join(lines + shown).count("sin") == 1

    def test_constants_and_inputs_may_be_outputs(self):
        x = Graph().variable("x")
        assert evaluate_floats([0.0, x, -1.5], [4.0, 0.0, 0.0]) == (0.0, 4.0, -1.5)

    def test_tiny_and_huge_constants_keep_all_their_digits(self):
        x = Graph().variable("x")
        for constant in (1e-300, 0.1 + 0.2, -1.7976931348623157e308, 5e-324):
            assert evaluate_floats([constant * x], [1.0, 0.0, 0.0]) == (constant,)

    def test_names_of_nodes_and_a_limit_of_length(self):
        graph = Graph()
        a, b, c = (graph.variable(name) for name in "abc")
        angle, total = a + b, b * (a * c) + (a + c)
        outputs = [expression.cos(angle), expression.sin(angle), total]
        names = {outputs[0].index: "cab", angle.index: "", total.index: "T"}
        lines, shown = float_source(outputs, names, str.upper, readable=True)
        assert lines == ["T = B*A*C + A + C", "cab = cos(A + B)"]
        assert shown == ["cab", "sin(A + B)", "T"]
        quotient = expression.multiply(1.0 / a, expression.multiply(b, c))
        assert float_source([quotient], readable=True) == ([], ["b*c/a"])
        lines, shown = float_source([total], longest=9)
        assert max(map(len, lines + shown)) <= len("t1 = ") + 9
        values = {"a": 2.0, "b": 3.0, "c": 5.0}
        for line in lines:
            exec(line, values)
        assert eval(shown[0], values) == 37.0

    def test_a_factor_two_moves_into_a_sum_with_factors(self):
        """Where that is exact and saves work: in 2 (0.5 x - 0.5 y + 3 z), not in 2 (x + y)."""
        graph = Graph()
        x, y, z = (graph.variable(name) for name in "xyz")
        assert float_source([2.0 * (0.5 * x - 0.5 * y + 3.0 * z)]) == ([], ["x - y + 6.0*z"])
        assert float_source([2.0 * (x + y)]) == ([], ["2.0*(x + y)"])
        assert float_source([2.0 * (0.5 * x + y)]) == ([], ["2.0*(y + 0.5*x)"])


class TestArraySource:
    def test_one_node_may_be_several_outputs_and_be_read_later(self):
        graph = Graph()
        x, y = graph.variable("x"), graph.variable("y")
        shared = x * y
        outputs = [shared, shared, shared + 1.0, x, 2.5, expression.cos(shared)]
        points = np.array([[1.0, 2.0], [3.0, 4.0], [0.0, 0.0]])
        found = evaluate_arrays(outputs, points)
        product = points[0] * points[1]
        expected = [product, product, product + 1.0, points[0], [2.5, 2.5], np.cos(product)]
        assert np.array_equal(found, expected)

    def test_buffers_are_used_again(self):
        """A sum of many products needs two buffers, however long it is."""
        graph = Graph()
        x, y = graph.variable("x"), graph.variable("y")
        total = x
        for k in range(1, 30):
            total = total + expression.sin(float(k + 1) * y) * x
        formula = ArrayFormula(["x", "y"], [total])
        assert formula._buffers <= 3
        assert len(formula._calls) >= 4 * 29

    def test_no_states(self):
        graph = Graph()
        output = graph.variable("x") + graph.variable("y")
        assert evaluate_arrays([output], np.zeros((3, 0))).shape == (1, 0)


@pytest.mark.parametrize("factor", [0.5, 2.0, 3.0])
def test_factors_of_sums_and_products_of_parameters(factor):
    """They go into sums whose terms have factors, of numbers or of parameters alike."""
    graph = Graph()
    x, y = graph.variable("x"), graph.variable("y")
    a, b = graph.parameter("a", 1.7), graph.parameter("b", -0.3)
    values = {"x": 0.9, "y": -1.1}
    cases = [(a * b, 1.7 * -0.3), (a * x - b * y, 1.7 * 0.9 - -0.3 * -1.1), (a + b, 1.4)]
    found = np.empty((1, len(cases)))
    outputs = [factor * case for case, _ in cases]
    ArrayFormula(list(values), outputs).fill([np.array([list(values.values())])], [found])
    assert found[0] == pytest.approx([factor * number for _, number in cases], rel=1e-15)
    numbers = 1.7 * x - 0.3 * y
    assert expression.cost([factor * (a * x - b * y)]) == expression.cost([factor * numbers])
