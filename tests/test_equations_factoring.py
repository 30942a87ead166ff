"""Sums of products: their algebra, and how they are collected and written."""

from __future__ import annotations

from fractions import Fraction

import pytest

from robodyn.equations.factoring import by_angle, by_function, by_role, simplified, written
from robodyn.equations.notation import GLUE, PLAIN, PYTHON, broken, one_line
from robodyn.equations.symbolic import ONE, ZERO, Atom, Planar, Role, Sum, of, total


def Symbol(name: str, role: int, place: tuple[int, str]) -> Atom:
    return Atom(role, place, name)


def Call(function: str, joints: tuple[int, ...]) -> Atom:
    return Atom(Role.function, joints, function)


def Rates(joints: tuple[int, ...]) -> Atom:
    return Atom(Role.rate, joints)


M1, M2, M3 = (of(Symbol(f"m{k}", Role.mass, (k, "m"))) for k in (1, 2, 3))
L1, L2 = (of(Symbol(f"l{k}", Role.length, (k, "l"))) for k in (1, 2))
R1, R2 = (of(Symbol(f"r{k}", Role.length, (k, "r"))) for k in (1, 2))
C1, S1, C12 = of(Call("cos", (0,))), of(Call("sin", (0,))), of(Call("cos", (0, 1)))
W1, W12 = of(Rates((0,))), of(Rates((0, 1)))


def plain(sum_: Sum, *levels) -> str:
    return one_line(PLAIN.text(written(sum_, levels)))


@pytest.mark.parametrize(
    ("sum_", "text"),
    [
        (ZERO, "0"),
        (ONE, "1"),
        (-ONE, "-1"),
        (M1, "m1"),
        (-M1, "-m1"),
        (L1 * M2 * R1, "m2 l1 r1"),
        (R1 * R1 * M1, "m1 r1²"),
        (M1 * R1 + M2 * L1 + M3 * L1, "m1 r1 + (m2 + m3) l1"),
        (M2 * L1 + M3 * L1 + M1 * R1, "(m2 + m3) l1 + m1 r1"),
        (L1 * L1 + (L1 * R2).times(2), "l1² + 2 l1 r2"),  # squares stay whole
        ((M1 * L1).times(2) - (M2 * L1).times(4), "2 (m1 - 2 m2) l1"),
        (-(M1 * L1) - M1 * L2, "-m1 (l1 + l2)"),
        (-(M1 * L1) + M1 * L2, "-m1 (l1 - l2)"),
        (M1 * L1 * R1 - M1 * R1 * L1, "0"),
        (W12 * W12 * L1, "l1 (qd1 + qd2)²"),
        (L1 * of(Symbol("k", Role.length, (0, "k")), -2), "l1/k²"),
        (of(Symbol("k", Role.length, (0, "k")), -1), "1/k"),
    ],
)
def test_what_a_person_would_write(sum_: Sum, text: str) -> None:
    assert plain(sum_, lambda product: ()) == text


def test_levels() -> None:
    sum_ = M1 * R1 * C1 + M2 * L1 * C1 + M2 * R2 * C12
    assert plain(sum_, by_angle, by_function) == "(m1 r1 + m2 l1) cos(q1) + m2 r2 cos(q1 + q2)"
    assert plain(sum_, by_role(Role.mass)) == "m1 r1 cos(q1) + m2 (l1 cos(q1) + r2 cos(q1 + q2))"


def test_a_bracket_is_a_common_factor_too() -> None:
    """(m1 r1 + m2 l1) (l1 sin(q1) + l2 cos(q1 + q2)) from its four terms."""
    both = M1 * R1 + M2 * L2
    sum_ = both * (L1 * S1 + R2 * C12) * W1
    text = "(m1 r1 + m2 l2) qd1 (l1 sin(q1) + r2 cos(q1 + q2))"
    assert plain(sum_, by_role(Role.rate), by_angle, by_function) == text


def test_numbers_are_exact_until_they_are_written() -> None:
    values = {"m1": Fraction("0.1"), "m2": Fraction("0.3")}
    assert not (M1 + M1 + M1 - M2).substituted(values)
    third = M1.times(3).substituted(values)
    assert one_line(PYTHON.text(written(third, ()))) == "0.3"
    assert 3 * 0.1 != 0.3


def test_planar_is_the_algebra_of_complex_numbers() -> None:
    p = Planar(ONE.times(2), ONE.times(3))
    q = Planar(ONE.times(-1), ONE.times(4))
    assert p * q == Planar(ONE.times(-14), ONE.times(5))
    assert p.conjugate() == Planar(ONE.times(2), ONE.times(-3))
    assert p * 1j == Planar(ONE.times(-3), ONE.times(2))
    turned = Planar(L1, ZERO) * Planar(C1, S1)
    assert (turned.real, turned.imag) == (L1 * C1, L1 * S1)
    assert total([]) == ZERO


def test_broken_outside_brackets_where_it_can_be() -> None:
    text = f"aaaa{GLUE}bbbb +{GLUE}c{GLUE}(dd +{GLUE}ee +{GLUE}ff) -{GLUE}g"
    assert broken(text, 100) == ["aaaa bbbb + c (dd + ee + ff) - g"]
    assert broken(text, 25) == ["aaaa bbbb", "+ c (dd + ee + ff) - g"]
    assert broken(text, 12) == ["aaaa bbbb", "+ c (dd + ee", "  + ff) - g"]
    assert broken("unbreakable", 5) == ["unbreakable"]


def test_sums_of_products_become_functions_of_differences() -> None:
    S2, C2, S12 = of(Call("sin", (1,))), of(Call("cos", (1,))), of(Call("sin", (0, 1)))
    found = {
        plain(simplified(C1 * C12 + S1 * S12)): "cos(q2)",
        plain(simplified(S1 * C12 - C1 * S12)): "-sin(q2)",
        plain(simplified(C1 * C2 + S1 * S2)): "cos(q1 - q2)",
        plain(simplified(C1 * S2 - S1 * C2)): "-sin(q1 - q2)",
        plain(simplified((S1 * S1 + C1 * C1) * M1 * L1)): "m1 l1",
        plain(simplified((S1 * S1).times(3) + C1 * C1)): "2 sin(q1)² + 1",
        plain(simplified(S1 * S1 - C1 * C1)): "sin(q1)² - cos(q1)²",
        plain(simplified(C1 * C12 - S1 * S12)): "cos(q1) cos(q1 + q2) - sin(q1) sin(q1 + q2)",
    }
    assert list(found) == list(found.values())


def test_the_cosines_of_a_direction_square_to_one() -> None:
    x, y = (of(Symbol(f"u1{axis}", Role.direction, (0, axis))) for axis in "xy")
    assert simplified(M1 * (x * x + y * y)) == M1
    turned = (x * x + y * y) * (C1 * C12 + S1 * of(Call("sin", (0, 1))))
    assert plain(simplified(turned)) == "cos(q2)"
