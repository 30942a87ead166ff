"""Values as people write them: arithmetic with units, vectors, couplings."""

from __future__ import annotations

import math
import operator

import pytest
from conftest import within
from each_case import each
from hypothesis import given
from hypothesis import strategies as st
from sympy.physics import units as known_units
from sympy.physics.units.systems.si import SI

from robodyn.errors import InputError
from robodyn.scene.quantities import parse_coupling, parse_quantity, parse_vector
from robodyn.scene.units import UNITS

FLOATS = st.floats(allow_nan=False, allow_infinity=False)
NEAR_NUMBERS = st.text(alphabet="0123456789.eE+-pi*/degram ()^°²", max_size=14)
PLACES = ("", "rad", "m", "rad/s", "N m", "kg m²", "N m s/rad", "s", "Hz", "ohm")


def vector(text: str, unit: str = "rad") -> list[float]:
    return parse_vector(text, where="--q", unit=unit)


VALUES = {
    "": """
        0=0 7=7 -0.5=-0.5 +2=2 .25=0.25 3.=3 1e-3=0.001 1E+3=1000 -1.5e2=-150 010=10
        1/12=1/12 sqrt(2)/2=sqrt(2)/2 2^3=8 2**-1=0.5 -2^2=-4 2^3^2=512 (1+2)*3=9 1-2-3=-4
        8/4/2=1 3mm/m=0.003 hypot(3,4)=5 atan2(1,1)=pi/4 sin(30deg)=0.5 -(-1)=1 --1=1
        exp(1)=e log(8)=log(8) 20deg/(10deg)=2 cos(pi)=-1 asin(1)=pi/2 (4mm^2/m^2)^0.5=0.002
    """,
    "rad": """
        30deg=pi/6 -90deg=-pi/2 1e2deg=5*pi/9 90/2deg=pi/4 1.2rad=1.2 pi=pi +pi=pi -pi/4=-pi/4
        2pi=2*pi 2*pi/3=2*pi/3 -0.5*pi=-pi/2 3pi/2rad=3*pi/2 1/3=1/3 -0.5=-0.5 30°=pi/6 π/6=pi/6
        -pi/2+0.6=0.6-pi/2 30deg+0.1=pi/6+0.1 90deg-pi/4=pi/4 60rpm*1s=2*pi 5mrad=0.005 −1=-1
        10mm/(2cm)=0.5 atan2(3mm,3mm)=pi/4 2π=2*pi pi*2=2*pi
    """,
    "rad/s": """
        6.28=6.28 -2*pi=-2*pi 90deg=pi/2 90deg/s=pi/2 1.5rad/s=1.5 pi/2=pi/2 60rpm=2*pi
        -1e3rpm=-100*pi/3 2*30rpm=2*pi 1/(2s)=0.5
    """,
    "rad/s²": "20=20 90deg/s^2=pi/2 90deg/s²=pi/2 60rpm/s=2*pi",
    "s": "2=2 0.5s=0.5 20ms=0.02 -1s=-1 1min=60 1h=3600 1.5us=1.5e-6 1.5µs=1.5e-6",
    "Hz": "100=100 100Hz=100 2kHz=2000 1/(2s)=0.5",
    "m": "350mm=0.35 0.35=0.35 35cm=0.35 550mm=0.55 1in=0.0254 1ft=0.3048 2km=2000 300µm=3e-4",
    "kg": "2=2 250g=0.25 1lb=0.45359237 (2+1)*kg=3",
    "kg m²": "0.002=0.002 2e4g*cm^2=0.002 2e4g·cm²=0.002 0.4kg*(50mm)^2=0.001",
    "N m": "2N*m=2 2Nm=2 2J=2 350mN*m=0.35 1kJ=1000 2N*m/rad=bad",
    "N m/rad": "20=20 20N*m/rad=20 20N*m=20 1N*m/deg=180/pi",
    "m/s²": "9.81=9.81 9.81m/s^2=9.81 9.81m/s**2=9.81 9.81m/s²=9.81 981cm/s^2=9.81",
    "N m/A": "30e-3N*m/A=0.03 0.03V*s=0.03",
    "ohm": "1.2=1.2 1.2ohm=1.2 1.2Ω=1.2 1.2V/A=1.2 500mohm=0.5",
    "V": "24V=24 1.5kW/(10A)=150",
}
CASES = [
    (text, unit, expected)
    for unit, cases in VALUES.items()
    for text, _, expected in (case.partition("=") for case in cases.split())
]


def test_values() -> None:
    scope = vars(math)
    for text, unit, expected in CASES:
        if expected == "bad":
            with pytest.raises(ValueError, match="must be in"):
                parse_quantity(text, unit)
            continue
        value = eval(expected, {}, scope)
        assert parse_quantity(text, unit) == pytest.approx(value, rel=4e-16, abs=1e-300), text


def test_blanks_stand_for_products() -> None:
    for text, unit, value in (
        ("30 deg", "rad", math.pi / 6),
        ("30 °", "rad", math.pi / 6),
        ("2 pi", "rad", 2 * math.pi),
        ("350 mm", "m", 0.35),
        ("9.81 m/s^2", "m/s²", 9.81),
        ("5 N m s/rad", "N m s/rad", 5.0),
        ("0.02 kg m^2", "kg m²", 0.02),
        ("1/2 m", "m", 0.5),
        ("(1 + 1) kg", "kg", 2.0),
        (" 1 ", "", 1.0),
        ("1 - 2", "", -1.0),
    ):
        assert parse_quantity(text, unit) == value, text


@each("name", sorted(UNITS))
def test_units_are_those_of_sympy(name: str) -> None:
    own = {"in": "inch", "deg": "degree", "°": "degree", "min": "minute", "h": "hour"}
    own |= {"lb": "pound", "Hz": "hertz", "W": "watt", "J": "joule", "ohm": "ohm"}
    own |= {"Nm": "joule", "us": "microsecond", "um": "micrometer"}
    sizes = {"mN": ("newton", 1e-3), "kN": ("newton", 1e3), "kJ": ("joule", 1e3)}
    sizes |= {"kW": ("watt", 1e3), "mA": ("ampere", 1e-3), "mV": ("volt", 1e-3)}
    sizes |= {"mohm": ("ohm", 1e-3), "kHz": ("hertz", 1e3), "mrad": ("radian", 1e-3)}
    # Boulder's standard gravity times a pound, and a turn a minute
    sizes |= {"lbf": ("newton", 0.45359237 * 9.80665), "rpm": ("hertz", 2 * math.pi / 60)}
    known, factor = sizes.get(name, (own.get(name, name), 1.0))
    unit = getattr(known_units, known)
    base = (known_units.m, known_units.kg, known_units.s, known_units.A, known_units.rad)
    exact = known_units.convert_to(unit, base)
    number = float(exact.as_independent(*base)[0]) * factor
    size, ten, of = UNITS[name][:3]
    assert size * 10.0**ten == pytest.approx(number, rel=1e-15)
    dimension = SI.get_dimension_system().get_dimensional_dependencies(unit.dimension)
    letters = {"length": "m", "mass": "kg", "time": "s", "current": "A"}
    expected = {
        letters[str(x.name)]: float(k) for x, k in dimension.items() if str(x.name) in letters
    }
    assert {base: k for base, k in of.items() if base not in ("rad", "cycle")} == expected


@st.composite
def sums(draw: st.DrawFn, depth: int = 3) -> tuple[str, float]:
    """Arithmetic, and what it is by Python's own operators."""
    if depth == 0 or draw(st.integers(0, 3)) == 0:
        value = draw(st.floats(1e-3, 1e3))
        return repr(value), value
    sign = draw(st.sampled_from("+-*/"))
    (left, a), (right, b) = draw(sums(depth - 1)), draw(sums(depth - 1))
    apply = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}[sign]
    blank = draw(st.sampled_from(["", " "]))
    try:
        return f"({left}){blank}{sign}{blank}({right})", apply(a, b)
    except ZeroDivisionError:
        return left, a


@given(sums(), st.sampled_from(["", " mm", "*1e-3*m"]))
def test_arithmetic_is_that_of_floats(drawn: tuple[str, float], unit: str) -> None:
    text, value = drawn
    scale = 1e-3 if unit else 1.0
    found = parse_quantity(f"({text}){unit}", "m")
    assert found == pytest.approx(value * scale, rel=1e-15)


@given(FLOATS)
def test_every_float_is_read_exactly(value: float) -> None:
    for unit in PLACES:
        assert parse_quantity(repr(value), unit) == value


@given(st.floats(-1e6, 1e6))
def test_degrees(value: float) -> None:
    assert parse_quantity(f"{value!r}deg", "rad") == math.radians(value)


REFUSED = {
    "is not a number": """
        x 1_000 0x10 e5 1e . - yes deg-- 30degs 30degrees *pi 1//2 1,5 ( 1) ()
        sin sin30 sin() 2(3) 2m2 pirpm 1hz q1 1;2 [1] 1+ 1*/2 1e1e1 1..2 a=b
    """,
    "must be a finite number": "nan NaN .nan inf -inf .inf -.INF infinity",
    "too large": "1e309 -1e309 1e400deg 1e308*pi*pi 1/1e-320 10^64*1e300 (1e200)^2 exp(1000)",
    "a division by zero": "1/0 pi/0.0 0^-1 1/(1-1)",
    "must be in rad, not in": "30mm 2kg 60rpm 1Hz 2N*m deg^2 °° 1/rad s",
    "a sum of": "30deg+1mm 0.1+1kg 1rad/s+1",
    "is not a number: .*(of|above|in)": """
        sqrt(-1) log(0) asin(2) (-8)^(1/3) 2^(1m) sin(1m) log(1kg) hypot(1m,1) atan2(1) 10^400
    """,
}


def test_what_is_no_angle() -> None:
    for reason, texts in REFUSED.items():
        for text in ["", " ", "1 2", *texts.split()][3 * (reason != "is not a number") :]:
            with pytest.raises(ValueError, match=reason):
                parse_quantity(text, "rad")


def test_a_unit_is_refused_where_a_plain_number_is_due() -> None:
    for text in ("30deg", "1 m", "2 kg"):
        with pytest.raises(ValueError, match="must be a plain number, not in"):
            parse_quantity(text)


def test_the_place_and_the_nearest_name_are_told() -> None:
    with pytest.raises(ValueError, match=r"degs is no unit.*did you mean deg\?.*character 3"):
        parse_quantity("30degs", "rad")
    with pytest.raises(ValueError, match="operator is missing before 2 at character 7"):
        parse_quantity("30 mm 2", "m")


@given(st.one_of(st.text(max_size=20), NEAR_NUMBERS), st.sampled_from(PLACES))
def test_a_value_is_finite_or_refused(text: str, unit: str) -> None:
    try:
        value = parse_quantity(text, unit)
    except ValueError as error:
        assert str(error)  # noqa: PT017
        return
    assert math.isfinite(value)


def test_deep_or_long_text_is_refused() -> None:
    for text in ("(" * 200 + "1", "-" * 290 + "1", "1" + "^1" * 140, "1" + "+1" * 140, "(" * 299):
        try:
            parse_quantity(text)
        except ValueError:
            continue
    with pytest.raises(ValueError, match="too many nested parentheses"):
        parse_quantity("(" * 300 + "1" + ")" * 300)
    with pytest.raises(ValueError, match="more than 300 operations within one another"):
        parse_quantity("1" + "+1" * 310)
    with pytest.raises(ValueError, match="more than 2000 characters"):
        parse_quantity("1 " + "m" * 2000)


# Vectors


@each(
    ("text", "values"),
    [
        ("1", [1.0]),
        ("1,2", [1.0, 2.0]),
        ("-0.5,-1", [-0.5, -1.0]),
        ("1 2", [1.0, 2.0]),
        ("  1,  2 ,3 4\t5\n", [1.0, 2.0, 3.0, 4.0, 5.0]),
        ("180deg,pi", [math.pi, math.pi]),
        ("180deg pi", [math.pi, math.pi]),
        ("180 deg 1 rad", [math.pi, 1.0]),
        ("180 deg, 1", [math.pi, 1.0]),
        ("1 -2", [1.0, -2.0]),
        ("1 - 2", [-1.0]),
        ("1 -2, 3", [1.0, -2.0, 3.0]),
        ("atan2(0, -1),1", [math.pi, 1.0]),
        ("sqrt(4) (1 + 1)*3", [2.0, 6.0]),
        ("-pi/2+pi,0", [math.pi / 2, 0.0]),
    ],
)
def test_vectors(text: str, values: list[float]) -> None:
    assert vector(text) == values


@given(st.lists(FLOATS, min_size=1, max_size=8), st.sampled_from([",", " ", ", ", " ,"]))
def test_vectors_of_any_floats(values: list[float], separator: str) -> None:
    text = separator.join(map(repr, values))
    assert vector(text) == values
    assert vector(text, "") == values


@each(
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
        ("2 pi", ["--q", "entry 1 = 2 pi", "one value or two", "2*pi or 2,pi"]),
        ("1, 2 kg", ["--q", "entry 2 = 2 kg", "must be in rad, not in kg"]),
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
        vector("30deg", "")
    assert "entry 1 = 30deg" in str(caught.value)
    assert "pi" not in str(caught.value)  # a torque is no angle


@given(st.one_of(st.text(max_size=20), NEAR_NUMBERS), st.sampled_from(PLACES))
def test_a_vector_is_finite_or_an_input_error(text: str, unit: str) -> None:
    try:
        values = vector(text, unit)
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
    for unit in PLACES:
        with within(5.0), pytest.raises(ValueError, match=r"is not|is too large"):
            parse_quantity(text, unit)
    for coupling in (f"q2 = {text} q1", f"q2 = q1 + {text}", f"q{NINES} = q1"):
        with within(5.0), pytest.raises(ValueError, match="must be"):
            parse_coupling(coupling, ["rad", "rad"])


def test_units_of_couplings() -> None:
    units = ["rad", "m", "m"]
    found = parse_coupling("q2 = 50 mm/rad * q1 + 3 mm - q3/2", units)
    assert found[:3] == (1, {0: 0.05, 2: -0.5}, 0.003)
    with pytest.raises(ValueError, match="a sum of rad and m"):
        parse_coupling("q1 = 20 rad/m*q2 + 3 mm", units)
    for text, limit in (
        ("q2 = 3 deg", "must be in m, not in rad"),
        ("q2 = 3 kg*q3", "must be in m, not in kg m"),
        ("q2 = q4", "names q4; the joints are q1 to q3"),
        ("q0 = q1", "names q0; the joints"),
        ("q2 = q1 - 3 q2", "has q2 on both sides"),
        ("q2 = 3 deg*q1", r"must be in m, not in rad\^2"),
    ):
        with pytest.raises(ValueError, match=limit):
            parse_coupling(text, units)
    for text in ("0.1 m sin(q1)", "q3*q1^2", "sqrt(q3*q3)"):
        found = parse_coupling(f"q2 = {text}", units)
        assert found[:4] == (1, {}, 0.0, text)
    for text, limit in (
        ("5 rad/s*sin(q1)", "must be in m, not in 1/s"),
        ("abs(q3)", r"has abs\(\), which bends"),
        ("q3 if q1 < 1 else 0", "has `if`, which bends"),
        ("min(q3, 1)", r"min\(\)"),
        ("floor(q1)", r"floor\(\)"),
    ):
        with pytest.raises(ValueError, match=limit):
            parse_coupling(f"q2 = {text}", units)
