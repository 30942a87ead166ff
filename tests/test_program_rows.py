"""Single rows of a program in closed form; what they look ahead; and shapes."""

import mpmath
import numpy as np
import pytest
from conftest import FRESH
from engine_cases import KINDS, ROBOTS, SEEDS, cases
from engine_table import NUMBERS
from known_terms import DIGITS
from mpmath import mp, mpf

from random_mechanisms import mechanism
from robodyn.engines import straightline
from robodyn.engines.expansion import MotionProgram
from robodyn.engines.expression import Graph
from robodyn.engines.formulas import RECORDED, Formula
from robodyn.engines.series import FLOATS, Series, State
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.program import (
    Anchored,
    Derivative,
    Function,
    Given,
    Inner,
    Integral,
    Number,
    PlanarSum,
    Power,
    Primitive,
    Product,
    Program,
    Quotient,
    Rate,
    RealPart,
    Scaled,
    Slide,
    Sum,
    Turn,
    Unknown,
)

ORDER = 12


# x(t) and y(t) that rows are made of, about t = 0
def X(t):
    return mpf("0.4") + mp.sin(2 * t) / 3 - t**2


def Y(t):
    return mp.exp(-t) + mpf("0.3") * t**3


def primitive(name, density):
    """The row of a function of x whose slope is 1/density; `density` adds that of x."""
    return lambda add, x, y: add(Primitive(name, x, density(add, x)))


def one_more(sign):
    """1 + sign x^2."""
    return lambda add, x: add(Sum(1.0, ((sign, add(Product(x, x))),)))


def root(sign):
    """sign sqrt(1 - x^2)."""
    return lambda add, x: add(Sum(0.0, ((sign, add(Power(one_more(-1.0)(add, x), 0.5))),)))


def function(name):
    return lambda add, x, y: add(Function(name, x))


def power(exponent):
    return lambda add, x, y: add(Power(x, exponent))


ROWS = {name: (function(name), lambda x, y, f=getattr(mp, name): f(x))
        for name in ("exp", "tanh", "sin", "cos", "sinh", "cosh")}  # fmt: skip
ROWS |= {f"x^{e}": (power(e), lambda x, y, e=e: x ** mpf(e)) for e in (-3.0, -0.5, 0.5, 2.25, 1.0)}
ROWS |= {
    "log": (primitive("log", lambda add, x: x), lambda x, y: mp.log(x)),
    "atan": (primitive("atan", one_more(1.0)), lambda x, y: mp.atan(x)),
    "asin": (primitive("asin", root(1.0)), lambda x, y: mp.asin(x)),
    "acos": (primitive("acos", root(-1.0)), lambda x, y: mp.acos(x)),
    "x/y": (lambda add, x, y: add(Quotient(x, y)), lambda x, y: x / y),
    "y/x": (lambda add, x, y: add(Quotient(y, x)), lambda x, y: y / x),
    "x y": (lambda add, x, y: add(Product(x, y)), lambda x, y: x * y),
    "x x": (lambda add, x, y: add(Product(x, x)), lambda x, y: x * x),
    "2 - x + y/2": (
        lambda add, x, y: add(Sum(2.0, ((-1.0, x), (0.5, y)))), lambda x, y: 2 - x + y / 2
    ),
    "tanh of sin": (
        lambda add, x, y: add(Function("tanh", add(Function("sin", x)))),
        lambda x, y: mp.tanh(mp.sin(x)),
    ),
}  # fmt: skip


def taylor(function, order=ORDER):
    """The coefficients of a function of t about 0, to 60 digits."""
    with mp.workdps(60):
        return mpmath.taylor(function, 0, order)


def of_rows(program, slot, kind, given, orders=ORDER + 1):
    """The coefficients of a slot by numbers of a kind, or by recorded text."""
    with mp.workdps(DIGITS):
        if kind == "text":
            graph, values = Graph(), [float(c) for each in given.values() for c in each]
            names = [f"{name}{k}" for name, each in given.items() for k in range(len(each))]
            nodes = iter([graph.variable(name) for name in names])
            start = {name: [next(nodes) for _ in each] for name, each in given.items()}
            arithmetic = RECORDED
        else:
            arithmetic, number = NUMBERS[kind]
            start = {name: [number(mp.nstr(c, 40) if isinstance(c, mpf) else c) for c in each]
                     for name, each in given.items()}  # fmt: skip
        state = State([], [], start)
        series = Series(program, arithmetic, program.numbers, orders, state, slots=[slot])
        for p in range(orders):
            series.residuals(p)
        found = [series.real[slot][p] for p in range(orders)]
        if kind == "text":
            found = straightline.compile_floats(Formula(tuple(names), tuple(found), ()), "f")(
                *values
            )
        # str of a longdouble has all its digits, repr of a float too
        return [+c if isinstance(c, mpf) else mpf(str(c)) for c in found]


@pytest.mark.parametrize("kind", [*NUMBERS, "text"])
@pytest.mark.parametrize("name", ROWS)
def test_row_is_mpmath_s_taylor_series(name, kind):
    row, exact = ROWS[name]
    program = Program()
    x, y = program.add(Given("x")), program.add(Given("y"))
    slot = row(program.add, x, y)
    found = of_rows(program, slot, kind, {"x": taylor(X), "y": taylor(Y)})
    expected = taylor(lambda t: exact(X(t), Y(t)))
    scale = max(1.0, *(float(abs(c)) ** (1 / k) for k, c in enumerate(expected) if k))
    unit = {"mpmath": 1e-30, "longdouble": float(np.finfo(np.longdouble).eps)}.get(kind, 2.0**-52)
    for k, (a, b) in enumerate(zip(found, expected, strict=True)):
        assert abs(a - b) <= 1e3 * unit * (2.0 * scale) ** k, (k, a, b)


@pytest.mark.parametrize("kind", NUMBERS)
def test_derivative_and_integral(kind):
    program, x = Program(), taylor(X)
    given = program.add(Given("x"))
    again = program.add(Derivative(program.add(Integral(given, "start"))))
    twice = program.add(Derivative(program.add(Derivative(given))))
    integral = program.add(Integral(given, "start"))
    anchored = program.add(Anchored(given, "start"))
    starts = {"x": x, "start": [mpf(7)]}

    def of(slot):
        return [float(c) for c in of_rows(program, slot, kind, starts, ORDER - 2)]

    x = [float(c) for c in x]
    assert of(again) == pytest.approx(x[: ORDER - 2], rel=1e-14)
    assert of(twice) == pytest.approx([(k + 1) * (k + 2) * x[k + 2] for k in range(ORDER - 2)])
    assert of(integral) == pytest.approx([7.0, *(x[k - 1] / k for k in range(1, ORDER - 2))])
    assert of(anchored) == pytest.approx([7.0, *x[1 : ORDER - 2]])


class TestSchedule:
    def setup_method(self):
        self.program = Program()
        add = self.program.add
        self.E = add(Turn(0))
        self.w = add(Rate(self.E))
        self.q = add(Integral(self.w, "q0"))

    def test_the_second_derivative_of_an_angle(self):
        program = self.program
        qd = program.add(Derivative(self.q))
        qdd = program.add(Derivative(qd))
        program.residuals = [qdd]
        slots, ahead, live = program.schedule()
        assert slots == (self.E, self.w, self.q, qd, qdd)
        assert ahead == {self.E: 2, self.w: 1, self.q: 2, qd: 1, qdd: 0}
        assert live == {self.E: (), self.w: (self.E,), self.q: (self.w,), qd: (self.q,), qdd: (qd,)}

    def test_rates_and_angles_do_not_hang_on_accelerations(self):
        program = self.program
        force = program.add(Product(self.w, program.add(Function("sin", self.q))))
        mu = program.add(Unknown("mu"))
        unused = program.add(Given("tau"))
        program.residuals = [program.sum((1.0, force), (1.0, mu))]
        slots, ahead, live = program.schedule()
        assert unused not in slots
        assert (ahead[self.E], ahead[self.w], ahead[self.q], ahead[mu]) == (2, 0, 0, 0)
        assert live == {self.E: (), mu: (), program.residuals[0]: (mu,)}
        assert unused in program.schedule([unused]).slots

    @pytest.mark.parametrize("name", [*KINDS, *ROBOTS], ids=lambda x: getattr(x, "stem", x))
    def test_what_is_completed_is_what_the_rows_say(self, name):
        for one in cases(name, SEEDS[:2] if FRESH else SEEDS[2:3]):
            motion = MotionProgram(one.mech, Actuation(tuple(one.tau.tolist())), work=True)
            program, y = motion.program, [*one.q.tolist(), *one.qd.tolist()]
            start = motion.state(FLOATS, 0.0, y, ((), ()))
            wanted = [*program.named["gap"], *motion.power]
            series = Series(program, FLOATS, program.numbers, 4, start, slots=wanted)
            completed_anew(series)

    def test_all_rows_that_unknowns_may_change(self):
        """Second derivatives of products of what moves."""
        program = self.program
        add = program.add
        other = add(Turn(1))
        d = add(PlanarSum((0.3, -0.2), (((1.0, 0.0), self.E), ((0.5, 0.2), other))))
        q = add(Integral(add(Anchored(self.w, "qd0")), "q0"))
        products = [add(Inner(d, d)), add(Inner(d, other)), add(Product(q, q))]
        products += [add(RealPart(add(Scaled(q, d)))), add(Product(q, products[0]))]
        products.append(add(RealPart(add(Scaled(add(Given("t")), d)))))
        program.residuals = [add(Derivative(add(Derivative(x)))) for x in products]
        given = {"qd0": (1.5,), "q0": (0.8,), "t": (0.4, 1.0)}
        state = State([(0.6, 0.8), (-0.8, 0.6)], [1.5, -0.7], given)
        completed_anew(Series(program, FLOATS, program.numbers, 4, state))


def completed_anew(series):
    """Each slot evaluated anew, after unknowns were added, is what it was made by adding."""
    rng = np.random.default_rng(0)
    for p in range(4):
        series.residuals(p)
        series.complete(rng.normal(size=len(series.program.unknowns)).tolist())
        for slot, row in series.rows:
            if isinstance(row, Turn | Slide | Unknown):
                continue
            m = p + series.ahead[slot]
            anew = series.known(slot, row, m)
            if slot in series.planar:
                made, anew = series.ground(slot, m), series.into(None, anew)
            else:
                made = series.real[slot][m]
            size = 1.0 + np.max(np.abs([made, anew]))
            assert np.max(np.abs(np.subtract(made, anew))) <= 1e-9 * size, (row, p)


FOUR_BAR = """
gravity: {g}
links:
  - {{name: a, m: 0.6, l: 0.35, r: {r}, I: 0.008}}
  - {{name: b, m: {m}, l: 0.95, r: 0.45, I: 0.102, damping: {d}}}
  - {{name: c, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}}
closures: [[b, c]]
springs: [{{joint: c, stiffness: 2, angle: {angle}}}]
"""


class TestShape:
    def made(self, **values):
        numbers = {"g": 9.81, "r": "[0.15, 0.02]", "m": 1.3, "d": 0.1, "angle": 0.4}
        mech = mechanism(FOUR_BAR.format(**(numbers | values)))
        return MotionProgram(mech, Actuation((1.0, 0.0, 0.0)), work=False)

    def expanded(self, motion, numbers):
        start = motion.state(FLOATS, 0.0, [0.7, -0.3, 1.4, 1.0, 0.5, -2.0], ((), ()))
        return motion.expand(FLOATS, numbers, 6, start)

    @pytest.mark.parametrize(
        "values",
        [{"r": "[-0.15, -0.02]"}, {"g": -3.0, "angle": -0.1}, {"m": 2.0, "d": 7, "r": "[0.1, -1]"}],
    )
    def test_numbers_and_their_signs_are_no_part_of_it(self, values):
        one, other = self.made(), self.made(**values)
        assert one.program.shape == other.program.shape
        assert hash(one.program.shape) == hash(other.program.shape)
        assert len(one.program.numbers) == len(other.program.numbers)
        assert one.program.numbers != other.program.numbers
        known = self.expanded(other, other.program.numbers)
        assert self.expanded(one, other.program.numbers) == known
        assert self.expanded(one, one.program.numbers) != known

    @pytest.mark.parametrize("values", [{"d": 0}, {"r": 0.15}, {"angle": 0}])
    def test_zeros_are(self, values):
        assert self.made().program.shape != self.made(**values).program.shape

    def test_numbers(self):
        program = Program()
        assert program.number(0.0) == 0.0
        assert not program.numbers
        assert program.planar_number(-2.0 + 3.0j) == (Number(0), Number(1))
        assert program.numbers == [-2.0, 3.0]
        assert -Number(1) == Number(1, -1.0)
        assert -Number(1, -1.0) == Number(1)
        x = program.add(Given("x"))
        assert program.sum((1.0, x), (0.0, x)) == x  # nothing to add
        assert program.add(Given("x")) == x  # equal rows are one
        slot = program.sum((-Number(1), x), (-1.0, x), (Number(0), x), constant=-Number(0))
        series = Series(
            program, FLOATS, program.numbers, 1, State([], [], {"x": (5.0,)}), slots=[slot]
        )
        series.residuals(0)
        assert series.real[slot][0] == 2.0 - 3.0 * 5.0 - 5.0 - 2.0 * 5.0
