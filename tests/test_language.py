"""One language of values and expressions: products left out, units, texts that would do harm."""

from __future__ import annotations

import contextlib
import gc
import math
import random
import re
import time
from collections.abc import Iterator
from typing import Any

import mpmath
import numpy as np
import pytest
from conftest import ROOT
from each_case import each

import robodyn
from robodyn.mechanics import actuation
from robodyn.mechanics.mechanism import build
from robodyn.runs.event_functions import event_function, values_of
from robodyn.scene.description import from_text
from robodyn.scene.expressions import OPERATIONS, SCOPE, code_of, fold, value_in, walk
from robodyn.scene.quantities import (
    Expression,
    expressions,
    parse_coupling,
    parse_quantity,
    read_value,
    state_variables,
)
from robodyn.scene.syntax import FUNCTIONS, Node, NotAllowedError, parsed

STATE = {"t": 0.75, "q0": 0.4, "qd0": -1.5, "q1": 0.02, "qd1": 0.1}  # q2 slides
LONGEST = 0.2  # s that a text may take


def written(text: str) -> list[Expression]:
    return expressions(text, state_variables(2, {1}))


def value(text: str) -> float:
    (found,) = written(text)
    return float(eval(code_of(found.node), {"__builtins__": {}, **SCOPE, **STATE}))


@each(
    ("text", "python"),
    [
        ("10 q1 + 5 q1^3", "10*q0 + 5*q0**3"),
        ("20 mm (1 - cos(q1))", "0.02*(1 - cos(q0))"),
        ("20 mm(1 - cos(q1))", "0.02*(1 - cos(q0))"),
        ("2 N m*sin(3 rad/s*t)", "2*sin(3*t)"),
        ("2 N m sqrt(4) + 1 N m", "2*sqrt(4) + 1"),
        ("0.5 sin(3 t)", "0.5*sin(3*t)"),
        ("2 q1 sin(t)^2 cos(q1) 3 mm", None),
        ("2 q1 sin(t)^2 cos(q1) mm", "2*q0*sin(t)**2*cos(q0)*0.001"),
        ("sin(t) t/2 exp(-t)", "sin(t)*t/2*exp(-t)"),
        ("3 t*q1/2 t", "3*t*q0/2*t"),
        ("2 pi t", "2*pi*t"),
        ("2q1", "2*q0"),
        ("90 deg/2 t", "pi/2/2*t"),
        ("5*mm*q1", "0.005*q0"),
        ("q1/(2 rad)", "q0/2"),
        ("1/s*t", "t"),
        ("1 in*q1", "0.0254*q0"),
        ("-2 cm^2 q1 - -1 cm^2", "-2e-4*q0 + 1e-4"),
    ],
)
def test_products_that_are_left_out(text: str, python: str | None) -> None:
    if python is None:
        with pytest.raises(ValueError, match="operator is missing before 3 at character 23"):
            value(text)
        return
    expected = eval(python, {**vars(math), **STATE})
    assert value(text) == pytest.approx(expected, rel=4e-16)


@each("text", ["2(3)", "(1)(2)", "q1 2", "sin(q1) 2", "2 sin(q1)(3)", "3 mm 2", "1 q1 q2 5"])
def test_an_operator_that_is_missing(text: str) -> None:
    for read in (written, parse_quantity):
        with pytest.raises(ValueError, match=r"operator is missing before .* at character"):
            read(text)


def test_values_and_expressions_without_variables_are_the_same() -> None:
    for text in ("350 mm", "9.81 m/s^2", "2 km/3 h", "7 mm*m/(3 ms)", "-0.3 N mm", "1.5^2 µm"):
        unit = {"350 mm": "m", "9.81 m/s^2": "m/s²", "2 km/3 h": "m s", "-0.3 N mm": "N m"}
        place = unit.get(text, "m" if "µm" in text else "m²/s")
        assert value(text) == parse_quantity(text, place)


def test_functions_of_values_are_those_of_expressions() -> None:
    for text, expected in (
        ("min(3 mm, 0.2 cm)", 0.002),
        ("max(3 mm, 0.2 cm, 1 um)", 0.003),
        ("abs(-3 mm)", 0.003),
        ("hypot(2 m, 3 m, 6 m)", 7.0),
        ("floor(2.5 m)", 2.0),
        ("sign(-3 kg) m", -1.0),
        ("cosh(0) tanh(1) m + log(8, 2) m", 3.0 + math.tanh(1)),
        ("log(8, 2) m", 3.0),
        ("3 min s^-1 m", 180.0),
    ):
        assert parse_quantity(text, "m") == pytest.approx(expected, rel=4e-16), text
        assert value(text) == pytest.approx(expected, rel=4e-16), text


@each(
    "text",
    [
        "3 m/mm + 4 kg",
        "30deg + 1deg^2",
        "1deg^2 + 30deg",
        "1 rad - 1/rad",
        "1 rad + 0.5 + 2 m",
        "hypot(1 m, 2 kg)",
        "atan2(1 m, 1 kg)",
    ],
)
def test_units_that_do_not_fit(text: str) -> None:
    for read in (written, parse_quantity):
        with pytest.raises(ValueError, match=r"a sum of|hypot of|atan2 of"):
            read(text)


def random_text(draw: random.Random, depth: int) -> str:
    """An expression in Python's own syntax, with all that a tree may have."""
    if depth == 0 or draw.random() < 0.15:
        return draw.choice(["t", "q1", "q2", "qd1", "pi", "e", f"{draw.uniform(0, 3):.2f}", "2"])

    def part() -> str:
        return random_text(draw, depth - 1)

    match draw.randrange(9):
        case 0 | 1:
            return f"{part()} {draw.choice('+-*/%')} {part()}"
        case 2:
            return f"({part()} {draw.choice(['+', '-', '*', '<', '>=', '<=', '>'])} {part()})"
        case 3:
            return f"({part()} if {part()} {draw.choice('<>')} {part()} else {part()})"
        case 4:
            return f"-{part()}"
        case 5:
            return f"({part()})**{draw.choice(['2', '3', '-1', '0.5', part(), '(1/3)'])}"
        case 6:
            return f"{draw.choice(['atan2', 'hypot', 'min', 'max'])}({part()}, {part()})"
        case 7:
            return f"({part()} if {part()} else {part()})"
    return f"{draw.choice(['sin', 'cos', 'tanh', 'exp', 'sqrt', 'abs', 'floor', 'log'])}({part()})"


def trees(count: int, seed: int) -> Iterator[tuple[str, Node]]:
    """Yield random expressions that are allowed, and their trees."""
    draw = random.Random(seed)
    while count:
        text = random_text(draw, 5)
        with contextlib.suppress(ValueError):  # a part of numbers has none, as sqrt(-1)
            (found,) = written(text)
            yield text, found.node
            count -= 1


def test_trees_are_printed_so_that_they_read_the_same() -> None:
    def same(name: str) -> str:
        return name

    for text, tree in trees(3000, seed=1):
        code = code_of(tree)
        plain = re.sub(r"\b_(\w+)\(", r"\1(", code)
        if "pow(" not in plain:  # which people write as **
            assert parsed(plain, same).nodes[0] == tree, (text, code)


def test_folds_of_one_tree_agree() -> None:
    """Numbers by Python, arrays by numpy, the same at many digits by mpmath."""
    t = np.array([0.75, 0.1, 2.0, -1.3])
    states = {"q0": 0.4, "q1": 0.02, "qd0": -1.5, "qd1": 0.1}
    functions = {name: getattr(mpmath, name) for name in ("sin", "cos", "tanh", "exp", "log")}
    functions |= {"hypot": mpmath.hypot, "atan2": mpmath.atan2, "floor": mpmath.floor}
    compared = [0, 0]  # with arrays, and with many digits
    for text, tree in trees(3000, seed=2):
        found = []
        for one in t.tolist():
            try:
                found.append(
                    float(value_in(tree, {"t": one, **states}, {**OPERATIONS, **FUNCTIONS}))
                )
            except (ArithmeticError, ValueError):
                found.append(math.nan)
            with contextlib.suppress(ArithmeticError, ValueError):
                code = eval(code_of(tree), {"__builtins__": {}, **SCOPE, **states, "t": one})
                assert float(code) == found[-1] or math.isnan(found[-1]), text
        with np.errstate(all="ignore"):
            arrays = values_of(tree, 2)(t, np.tile([0.4, 0.02, -1.5, 0.1], (4, 1)))
        operations = {x[0] for x in walk(tree) if type(x) is tuple}
        near = all(abs(x) < 1e9 for x in found)  # nan is not
        if near and operations.isdisjoint(JUMPS):
            assert arrays == pytest.approx(found, rel=1e-9, abs=1e-9), text
            compared[0] += 1
        smooth = operations.isdisjoint(STEPS)
        if smooth and all(map(math.isfinite, found)):
            with mpmath.workdps(40):
                exact = [mpmath_value(tree, {**states, "t": one}, functions) for one in t.tolist()]
            size = [max(1.0, abs(x)) for x in found]
            compared[1] += 1
            assert all(abs(x - y) < 1e-6 * s for x, y, s in zip(found, exact, size, strict=True)), (
                text
            )
    assert compared[0] > 500
    assert compared[1] > 300


JUMPS = ("%", "floor", "if", "<", "<=", ">", ">=")
STEPS = (*JUMPS, "log", "sqrt", "pow", "/", "atan2")  # and what makes much of rounding


def mpmath_value(tree: Node, names: dict[str, float], functions: dict[str, Any]) -> Any:
    """The value of a tree at many digits."""
    exact = {name: mpmath.mpf(x) for name, x in names.items()}
    own = {**OPERATIONS, "abs": abs, "min": min, "max": max, **functions}
    return fold(
        tree,
        lambda x: exact[x] if isinstance(x, str) else mpmath.mpf(x),
        lambda node, parts: own[node[0]](*parts),
    )


def test_values_are_expressions_without_variables() -> None:
    draw = random.Random(3)
    units = ["m", "mm", "kg", "deg", "rpm", "N", "s", "h", "in", "m^2", "kg m/s^2", "rad/s", "lb"]
    count = 0
    while count < 1500:
        terms = [f"{draw.uniform(0, 9):.3g} {draw.choice(units)}" for _ in range(3)]
        a, b, c = terms
        text = draw.choice([f"{a}*{b}/({c})", f"({a} + 2*{a}) {draw.choice(units)}", f"-{a}^2*{b}",
                            f"sqrt({a}*{a}) + {a}", f"{a} - {b}", f"min({a}, {b})*2"])  # fmt: skip
        try:
            number = read_value(text)
        except ValueError:
            with pytest.raises(ValueError, match="of"):
                written(text)
            continue
        count += 1
        (found,) = written(text)
        assert (found.value, found.measure) == (number.value, number.measure)


@each(
    ("text", "told"),
    [
        ("20 N m*q1 + 3 N m*q1^2", ""),
        ("20 N m/rad*q1 + 3 N m*q1^2", ""),
        ("q1^2 + 30 deg", "a sum of rad^2 and rad"),
        ("q1 > 30 deg^2", "a comparison of rad and rad^2"),
        ("qd1 + 3 m/mm", "a sum of 1/s and a plain number"),
        ("qd1 > 90 deg", ""),
        ("3 N m*sin(q1)*q1 + 2 N m", ""),
        ("sin(t)*q2 + 2 N m", "a sum of m and N m"),
        ("5 sin(t) + 2 N m", ""),
        ("(2 m)^q1", "a varying power of m"),
        ("2^(3 m) + t", "a power in m"),
        ("(q1 > 3 deg)*4 N m + 2 kg", "a sum of N m and kg"),
        ("q1 % 10 mm", "a remainder of rad and m"),
        ("1 m if t > 2 s else 3 kg", "a choice of m and kg"),
        ("t/0", "a division by zero"),
        ("q1 + t % (1 - 1)", "a division by zero, at character 6"),
        ("2 mm*(1 m/(0 s))", "a division by zero"),
        ("1e308 km*q1", "a number that is too large"),
    ],
)
def test_dimensions_of_expressions(text: str, told: str) -> None:
    if not told:
        assert written(text)
        return
    with pytest.raises(NotAllowedError, match=re.escape(told)):
        written(text)


def test_one_language_everywhere() -> None:
    """In values of scenes, loads, laws, couplings, torques, voltages, events and options."""
    text = f"""links:
  - {{name: a, m: 7 % 4, l: 2 sin(30deg) m, r: (200 + 150) mm, I: 1 if 2 > 1 else 3}}
  - {{name: b, m: "max(250 g, 1 lb)", l: 1, r: 0.5, I: 0.1, motor: {MOTOR}}}
couplings: q2 = 2 cos(60deg) q1 + 0.5 sin(30deg)
loads: [{{link: a, torque: 0.5 sin(3 t) + 2 N m/rad q1}}]
springs: [{{joint: a, law: 2 N m sin(x) + 3 x v, angle: 10deg/2}}]
"""
    scene = from_text(text, "scene")
    a, b = scene.links
    assert (a.m, a.r, a.I, b.m) == (3.0, 0.35, 1.0, 0.45359237)
    assert a.l == pytest.approx(1.0)
    (coupling,) = scene.couplings
    assert coupling.terms[0][1] == pytest.approx(1.0)
    assert coupling.angle == pytest.approx(0.25)
    mechanism = build(scene)
    slow = robodyn.other_forces(mechanism, [0.2, 0.45], [0.0, 0.0])
    assert np.isfinite(slow).all()
    for tau in ("0.5 sin(3 t)", "0.5*sin(3*t)"):
        torque = actuation.expressions(mechanism, tau, "--tau").function(2)
        assert torque(0.4, [0.0] * 4)[0] == 0.5 * math.sin(3 * 0.4)
    event = event_function(mechanism, "e", "2 sin(q1) > 0.5 cos(t)", "")
    known = 2 * math.sin(0.3) - 0.5 * math.cos(0.1)
    assert event.values(np.array([0.1]), np.array([[0.3, 0.0, 0.0, 0.0]])) == pytest.approx(known)


MOTOR = "{ratio: 2^3 + 2, inertia: 1e-5, torque_constant: 30e-3 N m/A, resistance: 1.2 V/A}"


def test_only_the_syntax_knows_the_trees_of_python() -> None:
    known = [
        path.name for path in (ROOT / "robodyn").rglob("*.py") if "import ast" in path.read_text()
    ]
    assert known == ["syntax.py"]


HOSTILE = [
    "9**9**9**9", "9^9^9^9", "10^400", "(9^9)^(9^9)", "((2^64)^64)^64", "(q1^64)^64", "1^1" * 900,
    "(" * 1000, "(" * 1900 + ")" * 90, "-" * 1999 + "1", "1" + "^1" * 900, "1" + "+1" * 990,
    "1" + "*1 mm" * 300, "1 " + "m " * 900, "mm^" * 400 + "2", "1 km^999999999", "1 mm^-999999999",
    "1 km^999999999/m^999999998", "1 m^" + "9" * 400, "9" * 1999, "1e" + "9" * 1900, "pi" * 900,
    "q1" * 900, "q1 " * 600, "sin(" * 600, "sin(" * 90 + "1" + ")" * 90, "1 if " * 300,
    "1 if 1 else " * 150 + "1", "1 < " * 400 + "1", "a" * 1999, "\u03c0" * 1999, "1" + "°" * 1999,
    "\ud800", "\x00", "1\x00", "#" * 1999, "\n" * 1999, "*" * 1999, "{1:2}", "1;2", "[1]*9**9",
    "'a'*10**9", "f'{exec(1)}'", "lambda: 1", "(x:=1)", "exec('1')", "open('harm', 'w')",
    "__import__('os').abort()", "().__class__.__base__", "q1.__class__", "__m", "__0", "1__m",
    "0x" + "f" * 1900, "min(" + ",".join("1" * 900) + ")", "q1 in q2", "1 in in in", "if", "in",
]  # fmt: skip
PIECES = [
    *"0123456789.eE+-*/^%()<>=,#_[]{}'\"\\°²π:;@! \n", "q1", "qd1", "t", "sin(", "cos(", "pi", "mm",
    "m", "s", "deg", "in", "min", " if ", " else ", " lambda ", "__", "1e9", "**", "//", "exec",
]  # fmt: skip


@pytest.fixture(autouse=True)
def _no_collection() -> Iterator[None]:
    """What takes its time is the text, and not the garbage of earlier tests."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def harmless(text: str) -> None:
    """Nothing but numbers or ValueError comes of a text, soon."""
    for read in (
        lambda: parse_quantity(text, "m"),
        lambda: parse_coupling(f"q2 = {text}", ["rad", "m"]),
    ):
        begun = time.process_time()
        with contextlib.suppress(ValueError):
            read()
        assert time.process_time() - begun < LONGEST, text
    begun = time.process_time()
    codes: list[str] = []
    with contextlib.suppress(ValueError):
        codes = [code_of(x.node) for x in written(text)]
    for code in codes:
        with contextlib.suppress(ArithmeticError, ValueError):
            eval(code, {"__builtins__": {}, **SCOPE, **STATE})
    assert time.process_time() - begun < LONGEST, text


@each("text", HOSTILE)
def test_hostile_texts(text: str) -> None:
    harmless(text)


def test_random_texts() -> None:
    draw = random.Random(0)
    for _ in range(5000):
        harmless("".join(draw.choices(PIECES, k=draw.choice([3, 8, 20, 60, 300]))))
