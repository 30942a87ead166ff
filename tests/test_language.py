"""One language of values and expressions: products left out, units, texts that would do harm."""

from __future__ import annotations

import contextlib
import gc
import math
import random
import time
from collections.abc import Iterator

import pytest
from each_case import each

from robodyn.scene.expressions import SCOPE, code_of
from robodyn.scene.quantities import (
    Expression,
    expressions,
    parse_coupling,
    parse_quantity,
    state_variables,
)

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
