"""Single rows of a program in closed form; what they look ahead; and shapes."""

import itertools
import re

import mpmath
import numpy as np
import pytest
from conftest import FRESH
from engine_cases import KINDS, ROBOTS, SEEDS, cases
from engine_table import NUMBERS
from known_terms import DIGITS
from mpmath import mp, mpf
from reference_motions import START, scene

from random_mechanisms import mechanism
from robodyn import simulate
from robodyn.elements.program import (
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
from robodyn.engines import straightline
from robodyn.engines.arithmetic import FLOATS
from robodyn.engines.expansion import MotionProgram
from robodyn.engines.expression import Graph
from robodyn.engines.factors import SMALL, Factors, elimination_order, svd
from robodyn.engines.formulas import RECORDED, Formula
from robodyn.engines.series import Series, State
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.actuation import Actuation, callback, expressions, table
from robodyn.mechanics.torque_rows import linear_piece, torque_slots
from robodyn.runs.report import Outcome
from robodyn.scene.expressions import FUNCTIONS

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


# The elimination of [M Psi^T; Psi 0]: its order, its fill, its pivots.


def n_four_bar(N):
    """K of N four-bars in a row, at a crank angle of 2 rad; and the number of links."""
    bar = "m: 1, l: 1, r: 0.5, I: 0.08333333333333333"
    links = [f"{{name: v{k}, {bar}, from: [{k}, 0]}}" for k in range(N + 1)]
    links += [f"{{name: h{k}, {bar}, from: v{k}}}" for k in range(N)]
    closures = ", ".join(f"[h{k}, v{k + 1}]" for k in range(N))
    mech = mechanism(f"links: [{', '.join(links)}]\nclosures: [{closures}]\n")
    motion = MotionProgram(mech, Actuation((0.0,) * mech.n), False)
    y = [2.0] * (N + 1) + [-2.0] * N + [1.0] * (N + 1) + [-1.0] * N
    start = motion.state(FLOATS, 0.0, y, ((), ()))
    series = Series(motion.program, FLOATS, motion.program.numbers, 1, start)
    series.residuals(0)
    return series.matrix(), mech.n


def dense(matrix):
    K = np.zeros((len(matrix), len(matrix)))
    for i, row in enumerate(matrix):
        K[i, list(row)] = list(row.values())
    return K


class TestFactors:
    def test_long_rows_of_four_bars_fill_little(self):
        fills = []
        for N in (10, 20, 40):
            matrix, links = n_four_bar(N)
            size = len(matrix)
            assert (size, links) == (4 * N + 1, 2 * N + 1)
            factors = Factors(matrix, links)
            assert sorted(factors.place) == list(range(size))
            for r in range(links, size):  # a closure stands after its links
                assert all(factors.place[r] > factors.place[k] for k in matrix[r] if k < links)
            pivots = np.array(factors.pivots)
            assert (pivots[:links] > 1e-3).all()
            assert (pivots[links:] < -1e-3).all()
            right = np.random.default_rng(N).normal(size=size)
            K = dense(matrix)
            assert np.allclose(K, K.T, atol=1e-14)
            assert K @ factors.solve(right.tolist()) == pytest.approx(right, abs=1e-10)
            fills.append(sum(map(len, factors.columns)))
        for few, many in itertools.pairwise(fills):
            assert many < 2.2 * few
        assert fills[-1] < 12 * 40 * 2

    @pytest.mark.parametrize("links", [1, 4, 15, 30])
    def test_any_saddle_matrix(self, links):
        rng = np.random.default_rng(links)
        for closures in (0, links // 3, links // 2):
            A = rng.normal(size=(links, links)) * (rng.uniform(size=(links, links)) < 0.2)
            M = A @ A.T + np.eye(links)
            Psi = rng.normal(size=(closures, links))
            K = np.block([[M, Psi.T], [Psi, np.zeros((closures, closures))]])
            matrix = [{j: float(x) for j, x in enumerate(row) if x} for row in K]
            order = elimination_order(matrix, links)
            assert sorted(order) == list(range(len(K)))
            if len(K) <= SMALL:
                assert order == list(range(len(K)))
            right = rng.normal(size=len(K))
            found = Factors(matrix, links).solve(right.tolist())
            assert K @ found == pytest.approx(right, abs=1e-8)


def test_a_decomposition_where_divide_and_conquer_gives_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    a = np.random.default_rng(3).normal(size=(2, 3, 4))

    def gives_up(*args: object, **options: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", gives_up)
    U, s, Vt = svd(a)
    np.testing.assert_allclose(U * s[:, None] @ Vt, a, atol=1e-14)
    U, s, Vt = svd(a[0], full=True)
    assert Vt.shape == (4, 4)
    np.testing.assert_allclose(U * s @ Vt[:3], a[0], atol=1e-14)


# The series of torques along a motion, against mpmath's differentiation of the composed function.
#
# The motion itself is given: q and qd as known functions of time.


pytestmark = pytest.mark.filterwarnings("ignore:the torque changes too fast")

SERIES_ORDER = 10
T0 = 0.3
# the angles of a motion as mpmath takes them: q1(t), q2(t), and their rates
WAYS = (lambda t: mp.sin(2 * t) / 2 + mpf("0.4"), lambda t: mp.exp(-t) - t**2 / 3)
RATES = (lambda t: mp.cos(2 * t), lambda t: -mp.exp(-t) - 2 * t / 3)

SMOOTH = """
1.5 + 0*t | t | q1 | qd2 | q1 + qd1 | q1 - 2*qd2 | -q2 + +t | q1*qd2 | q1/(2 + qd1) | 3/(1 + t)
sin(q1) | cos(3*t - q2) | tan(q1) | sinh(qd1) | cosh(q2) | tanh(3*q2) | exp(-q1*qd1) | log(2 + q1)
log(2 + q1, 3) | log(3, 2 + q1) | sqrt(1 + q1**2) | hypot(q1, qd2) | hypot(1 + q1) | hypot(t, q1, 2)
atan(2*q1) | asin(q1/2) | acos(q2/2) | q1**2 | q1**0 | (1 - t)**3 | (2 + q1)**-3 | q1**1 | t**7
(2 + q1)**0.5 | (2 + q1)**-1.5 | (1 + t)**2.25 | (1 + q1)**q2 | 2**t | (1 + t)**(2 + sin(q1))
sin(q1)*exp(-t)*qd2**2 | pi*q1 + e*t | 1/(1/(1 + q1) + qd1**2) | exp(sin(cos(q1*q2)))
""".replace("\n", "|").split("|")
SMOOTH = [text.strip() for text in SMOOTH if text.strip()]
NAMES = {name: getattr(mpmath, name) for name in ("sin", "cos", "tan", "sinh", "cosh")}
NAMES |= {"log": mpmath.log, "sqrt": mpmath.sqrt, "atan": mpmath.atan, "asin": mpmath.asin}
NAMES |= {"tanh": mpmath.tanh, "exp": mpmath.exp, "acos": mpmath.acos, "pi": mp.pi, "e": mp.e}
NAMES["hypot"] = lambda *x: mpmath.sqrt(sum(a * a for a in x))


def coefficients(function, count=SERIES_ORDER + 1):
    with mp.workdps(50):
        return [float(c) for c in mpmath.taylor(function, mpf(T0), count - 1)]


class Along:
    """In place of the equations of motion: angles and rates of the joints are given."""

    def __init__(self, mech):
        self.mechanism, self.program = mech, Program()

    def variable(self, name):
        return self.program.add(Given(name))


def torque_series(text, t, q, qd):
    """The coefficients (order + 1, 2) of torques, given those of q and qd."""
    along = Along(scene("2r"))
    slots = torque_slots(along, expressions(along.mechanism, text, "test"))
    given = {"t": (t, 1.0)} | {f"q{j}": x for j, x in enumerate(q)}
    given |= {f"qd{j}": x for j, x in enumerate(qd)}
    program = along.program
    wanted = [slot for slot in slots if slot is not None]
    series = Series(
        program, FLOATS, program.numbers, SERIES_ORDER, State([], [], given), slots=wanted
    )
    for k in range(SERIES_ORDER + 1):
        series.residuals(k)
    rows = [
        [0.0] * (SERIES_ORDER + 1) if x is None else series.real[x][: SERIES_ORDER + 1]
        for x in slots
    ]
    return np.array(rows).T


def series(text):
    """Those along the motion above."""
    return torque_series(text, T0, *(list(map(coefficients, part)) for part in (WAYS, RATES)))


class TestFunctions:
    @pytest.mark.parametrize("text", SMOOTH)
    def test_against_mpmath(self, text):
        def composed(t):
            q = [way(t) for way in WAYS]
            qd = [rate(t) for rate in RATES]
            names = {"t": t, "q1": q[0], "q2": q[1], "qd1": qd[0], "qd2": qd[1], **NAMES}
            return mpf(1) * eval(text, {}, names)

        found = series(f"{text}, t")
        known = np.array(coefficients(composed))
        scale = max((abs(c) ** (1 / k) for k, c in enumerate(known) if k), default=1.0) or 1.0
        scale = max(scale, 1.0)
        bound = 1e-12 * max(1.0, abs(known[0])) * scale ** np.arange(SERIES_ORDER + 1)
        assert (np.abs(found[:, 0] - known) <= bound).all()
        assert found[:, 1].tolist() == [T0, 1.0, *[0.0] * (SERIES_ORDER - 1)]

    def test_every_function_of_the_list_is_here_or_refused(self):
        has = set(re.findall(r"(\w+)\(", " ".join(SMOOTH)))
        without = {found[1] for text in ROUGH if (found := re.match(r"(\w+)\(", text))}
        assert has | without == set(FUNCTIONS)
        assert not has & without

    def test_flat_ends_of_tanh(self):
        """Where sinh and cosh are beyond the floats."""
        found = series("tanh(1e4*(t - 10)), tanh(1e3 + q1)")
        assert found[0].tolist() == [-1.0, 1.0]
        assert not found[1:].any()


ROUGH = """
abs(q1) | min(q1, q2) | max(q1, t) | floor(q1) | sign(qd1) | q1 % 2 | 1 if q1 < 2 else 0 | q1 > 0
atan2(q1, q2) | 2 + sin(abs(qd1))
""".replace("\n", "|").split("|")
ROUGH = [text.strip() for text in ROUGH if text.strip()]


class TestRefused:
    @pytest.mark.parametrize("text", ROUGH)
    def test_what_has_no_series(self, text):
        with pytest.raises(InputError, match=r"no series.*DOP853"):
            simulate(scene("2r"), *START, 1.0, tau=f"{text}, t", method="taylor")

    def test_a_function_of_python(self):
        law = callback(scene("2r"), lambda t, q, qd: [0.0, 0.0])
        with pytest.raises(InputError, match=r"function of Python has no series.*DOP853"):
            simulate(scene("2r"), *START, 1.0, tau=law, method="taylor")


TIMES, SERIES_ROWS = [-1.0, 0.0, 0.5, 2.0], [[0.0, 1.0], [4.0, 1.0], [2.0, -1.0], [2.0, 0.5]]


class TestTable:
    @pytest.mark.parametrize(
        ("t", "direction", "piece"),
        [
            (0.0, 1.0, 1),
            (0.2, 1.0, 1),
            (0.5, 1.0, 2),
            (0.5, -1.0, 1),
            (0.2, -1.0, 1),
            (0.0, -1.0, 0),
            (2.0, -1.0, 2),
            (-1.0, 1.0, 0),
        ],
    )
    def test_value_and_slope_of_the_piece_ahead(self, t, direction, piece):
        torques = table(scene("2r"), TIMES, SERIES_ROWS)
        y = [0.1, 0.2, 0.3, 0.4]
        found = linear_piece(torques, torques.function(2), t, y, direction)
        begin, end = (np.array(SERIES_ROWS[k]) for k in (piece, piece + 1))
        slope = (end - begin) / (TIMES[piece + 1] - TIMES[piece])
        assert found[0] == pytest.approx(begin + slope * (t - TIMES[piece]), abs=1e-14)
        assert found[1] == pytest.approx(slope, abs=1e-13)

    @pytest.mark.parametrize("way", [1.0, -1.0])
    def test_steps_end_on_kinks_and_the_motion_is_dop853s(self, way):
        times = sorted(way * t for t in (0.0, 0.125, 0.3, 0.1 + 0.2, 0.7, 1.0))
        mech, rows = scene("2r"), [[k % 2, -k] for k in range(len(times))]
        tau = table(mech, times, rows, until=way)
        found = simulate(mech, *START, way, tau=tau, method="taylor", rtol=1e-13, atol=1e-13)
        assert set(times) <= set(found.t.tolist())
        known = simulate(mech, *START, way, tau=tau, rtol=1e-13, atol=1e-13, t_eval=[way])
        assert found.q[-1] == pytest.approx(known.q[-1], abs=1e-11)
        assert found.report.work == pytest.approx(known.report.work, rel=1e-10)
        assert found.report.energy_drift < 1e-12


class TestAgrees:
    """The torque at the end of a step is that of the series, or it bent on the way."""

    @pytest.mark.parametrize("text", ["sqrt((t - 0.5)**2), 0", "0, ((q1 - 0.25)**2)**0.5"])
    def test_a_kink_is_found(self, text):
        """|x| has the series of x or -x, which nothing ends."""
        tau = text.replace("sqrt((t - 0.5)**2)", "abs(t - 0.5)")
        tau = tau.replace("((q1 - 0.25)**2)**0.5", "abs(q1 - 0.25)")
        options = {"rtol": 1e-10, "atol": 1e-10, "t_eval": [1.0]}
        start = ([0.1, 0.2], [3.0, 0.0])
        found = simulate(scene("2r"), *start, 1.0, tau=text, method="taylor", **options)
        known = simulate(scene("2r"), *start, 1.0, tau=tau, **options)
        assert np.abs(found.q - known.q).max() < 1e-7

    @pytest.mark.parametrize(
        "tau", ["sqrt(0.5 - t), 0", "1/(0.5 - t), 0", "log(0.5 - t), 0", "1/(t - 0.5)**2, 0",
                "0, acos(2*t)", "tan(pi*t), 0", "(0.5 - t)**2.5, 0"]
    )  # fmt: skip
    def test_no_step_leaps_beyond_the_domain(self, tau):
        for way in (1.0, -1.0):
            given = tau if way > 0 else tau.replace("t", "(-t)").replace("sqr(-t)", "sqrt")
            given = given.replace("(-t)an", "tan")
            motion = simulate(scene("2r"), *START, way, tau=given, method="taylor")
            assert motion.outcome is Outcome.STEP_TOO_SMALL
            assert "torque is undefined" in motion.outcome.advice
            assert motion.t[-1] == motion.report.t_reached
            assert 0.4999 < way * motion.t[-1] <= 0.5
            assert np.isfinite(motion.q).all()

    @pytest.mark.parametrize("tau", ["log(t - 1), 0", "1/t, 0", "0, log(t)"])
    def test_a_start_without_a_torque_is_an_error(self, tau):
        with pytest.raises(RobodynError, match="cannot start"):
            simulate(scene("2r"), *START, 1.0, tau=tau, method="taylor")

    def test_a_start_without_a_series_is_an_outcome(self):
        motion = simulate(scene("2r"), *START, 1.0, tau=[1e200, 0], method="taylor")
        assert motion.outcome is Outcome.STEP_TOO_SMALL
        assert motion.t.tolist() == [0.0]
        options = {"tau": "1e200*exp(0*t), 0", "method": "taylor", "max_evals": 3000}
        motion = simulate(scene("2r"), *START, 1.0, **options)
        assert motion.outcome in (Outcome.STEP_TOO_SMALL, Outcome.TOO_MANY_EVALUATIONS)

    def test_from_a_start_without_a_series_dop853_leads_on(self):
        for tau in ("sqrt(t), 0", "t**1.5, 0"):
            motion = simulate(scene("2r"), *START, 1.0, tau=tau, method="taylor")
            known = simulate(scene("2r"), *START, 1.0, tau=tau, rtol=1e-12, atol=1e-12)
            assert motion.outcome is Outcome.FINISHED
            assert motion.q[-1] == pytest.approx(known.q[-1], abs=1e-7)

    def test_what_is_smooth_costs_no_steps(self):
        """A torque too small to matter may have a series that does not serve."""
        steps = [
            simulate(scene("2r"), *START, 1.0, tau=tau, method="taylor").report.steps
            for tau in ("0*t, 0", "1e-14*sin(300*t), 0", "t**64*1e-9, 0")
        ]
        for first, second in itertools.pairwise(steps):
            assert abs(first - second) <= 3
