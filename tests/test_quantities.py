"""Numbers, angles and vectors as people write them."""

from __future__ import annotations

import math

import pytest
from conftest import within
from hypothesis import given
from hypothesis import strategies as st

from robodyn.errors import InputError
from robodyn.scene.quantities import (
    parse_angle,
    parse_coupling,
    parse_number,
    parse_rate,
    parse_time,
    parse_vector,
)

FLOATS = st.floats(allow_nan=False, allow_infinity=False)
NEAR_NUMBERS = st.text(alphabet="0123456789.eE+-pi*/degra, ", max_size=12)


def vector(text: str, angles: bool = True) -> list[float]:
    return parse_vector(text, where="--q", angles=angles)


# Rates and times


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("6.28", 6.28),
        ("-2*pi", -2 * math.pi),
        ("90deg", math.pi / 2),
        ("90deg/s", math.pi / 2),
        ("1.5rad/s", 1.5),
        ("pi/2", math.pi / 2),
        ("60rpm", 2 * math.pi),
        ("-1e3rpm", -1000 * math.pi / 30),
    ],
)
def test_rates(text: str, value: float) -> None:
    assert parse_rate(text) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["", "rpm", "1 rpm", "pirpm", "1/s/s", "1hz", "nan", "infrpm"])
def test_what_is_no_rate(text: str) -> None:
    with pytest.raises(ValueError, match=r"not a number|not an angle|finite"):
        parse_rate(text)


@pytest.mark.parametrize(("text", "value"), [("2", 2), ("0.5s", 0.5), ("20ms", 0.02), ("-1s", -1)])
def test_times(text: str, value: float) -> None:
    assert parse_time(text) == value


@pytest.mark.parametrize("text", ["", "s", "ms", "2 s", "2min", "1us", "2ss", "nans", "infms"])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match=r"not a number|finite"):
        parse_time(text)


# Numbers


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0.0),
        ("7", 7.0),
        ("-0.5", -0.5),
        ("+2", 2.0),
        (".25", 0.25),
        ("3.", 3.0),
        ("1e-3", 0.001),
        ("1E+3", 1000.0),
        ("-1.5e2", -150.0),
        ("010", 10.0),
    ],
)
def test_numbers(text: str, value: float) -> None:
    assert parse_number(text) == value


@given(FLOATS)
def test_every_float_is_read_exactly(value: float) -> None:
    assert parse_number(repr(value)) == value


@pytest.mark.parametrize(
    "text",
    ["", " ", "x", "1 ", " 1", "1_000", "0x10", "1,5", "e5", "1e", ".", "-", "--1", "yes", "pi"],
)
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(ValueError, match="not a number"):
        parse_number(text)


@pytest.mark.parametrize("text", ["nan", "NaN", ".nan", "inf", "-inf", ".inf", "-.INF", "infinity"])
def test_nan_and_infinity_are_told_apart(text: str) -> None:
    with pytest.raises(ValueError, match="finite"):
        parse_number(text)


def test_a_number_beyond_the_floats_is_told() -> None:
    with pytest.raises(ValueError, match="too large"):
        parse_number("-1e309")


# Angles


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("30deg", math.pi / 6),
        ("-90deg", -math.pi / 2),
        ("1e2deg", math.radians(100)),
        ("90/2deg", math.pi / 4),
        ("1.2rad", 1.2),
        ("pi", math.pi),
        ("+pi", math.pi),
        ("-pi/4", -math.pi / 4),
        ("2pi", 2 * math.pi),
        ("2*pi/3", 2 * math.pi / 3),
        ("-0.5*pi", -math.pi / 2),
        ("3pi/2rad", 1.5 * math.pi),
        ("1/3", 1 / 3),
        ("-0.5", -0.5),
    ],
)
def test_angles(text: str, value: float) -> None:
    assert parse_angle(text) == pytest.approx(value, rel=1e-15)


@given(FLOATS)
def test_an_angle_without_unit_is_the_same_float(value: float) -> None:
    assert parse_angle(repr(value)) == value


@given(st.floats(-1e6, 1e6))
def test_degrees(value: float) -> None:
    assert parse_angle(f"{value!r}deg") == pytest.approx(value * math.pi / 180, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not a number"),
        ("deg", "not a number"),
        ("30 deg", "not a number"),
        ("30°", "not a number"),
        ("30degrees", "not a number"),
        ("*pi", "not a number"),
        ("pi*2", "not a number"),
        ("pi pi", "not a number"),
        ("1//2", "not a number"),
        ("nan", "finite"),
        ("-inf", "finite"),
        ("2pideg", "mixes pi with deg"),
        ("1/0", "divides by zero"),
        ("pi/0.0", "divides by zero"),
        ("1e400", "too large"),
        ("1e308pi", "too large"),
        ("1/1e-320", "too large"),
        ("1e400deg", "too large"),
        ("1e400/1e400", "too large"),
        ("pi/1e400", "too large"),
    ],
)
def test_what_is_no_angle(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_angle(text)


@given(st.one_of(st.text(max_size=20), NEAR_NUMBERS))
def test_an_angle_is_finite_or_refused(text: str) -> None:
    try:
        value = parse_angle(text)
    except ValueError:
        return
    assert math.isfinite(value)


# Vectors


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1", [1.0]),
        ("1,2", [1.0, 2.0]),
        ("-0.5,-1", [-0.5, -1.0]),
        ("1 2", [1.0, 2.0]),
        ("  1,  2 ,3 4\t5\n", [1.0, 2.0, 3.0, 4.0, 5.0]),
        ("180deg,pi", [math.pi, math.pi]),
    ],
)
def test_vectors(text: str, values: list[float]) -> None:
    assert vector(text) == values


@given(st.lists(FLOATS, min_size=1, max_size=8), st.sampled_from([",", " ", ", ", " ,"]))
def test_vectors_of_any_floats(values: list[float], separator: str) -> None:
    text = separator.join(map(repr, values))
    assert vector(text) == values
    assert vector(text, angles=False) == values


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["--q", "empty"]),
        ("  ", ["--q", "empty"]),
        (",", ["--q", "missing at a comma"]),
        ("1,", ["--q", "1,", "missing at a comma"]),
        (",1", ["--q", ",1", "missing at a comma"]),
        ("1,,2", ["--q", "1,,2", "missing at a comma"]),
        ("1 2 x", ["--q", "entry 3 = x", "not a number"]),
        ("1,nan", ["--q", "entry 2 = nan", "finite"]),
        ("30 deg", ["--q", "entry 2 = deg"]),
        ("1;2", ["--q", "entry 1 = 1;2"]),
        ("[1,2]", ["--q", "entry 1 = [1"]),
    ],
)
def test_a_faulty_vector_names_its_option_entry_and_value(text: str, parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        vector(text)
    for part in parts:
        assert part in str(caught.value)


def test_what_to_write_instead_is_told() -> None:
    with pytest.raises(InputError, match=r"30deg.*pi/2"):
        vector("x")
    with pytest.raises(InputError, match="-2e-3") as caught:
        vector("30deg", angles=False)
    assert "entry 1 = 30deg" in str(caught.value)
    assert "pi" not in str(caught.value)  # a torque is no angle


@given(st.one_of(st.text(max_size=20), NEAR_NUMBERS), st.booleans())
def test_a_vector_is_finite_or_an_input_error(text: str, angles: bool) -> None:
    try:
        values = vector(text, angles)
    except InputError as error:
        assert str(error).startswith("--q: ")  # noqa: PT017
        return
    assert values
    assert all(map(math.isfinite, values))


NINES = "9" * 200_000


@pytest.mark.parametrize(
    "text",
    [NINES + "x", f"0.{NINES}x", f".{NINES}e", f"1e{NINES}x", f"{NINES}/{NINES}x", f"pi/{NINES}x"],
)
def test_long_text_that_is_no_number_takes_time_by_its_length(text: str) -> None:
    for parse in (parse_number, parse_angle, parse_rate, parse_time):
        with within(5.0), pytest.raises(ValueError, match=r"is not|is too large"):
            parse(text)
    for coupling in (f"q2 = {text} q1", f"q2 = q1 + {text}", f"q{NINES} = q1"):
        with within(5.0), pytest.raises(ValueError, match="must be"):
            parse_coupling(coupling)
