"""Pictures of characters: dots where they belong, exact small charts, colours, names."""

from __future__ import annotations

import re

import numpy as np
import pytest

from robodyn.pictures.characters import Canvas, chart_lines
from robodyn.pictures.chart import Chart, chart

ALL = "".join(map(chr, range(0x2800, 0x2900)))


def dots(lines: list[str]) -> set[tuple[int, int]]:
    """The dots of braille lines, (x, y) from the lower left: Unicode numbers them 1-3, 7 and
    4-6, 8 from the top of a character's two columns."""
    places = [(0, 3), (0, 2), (0, 1), (1, 3), (1, 2), (1, 1), (0, 0), (1, 0)]
    found = set()
    for row, line in enumerate(reversed(lines)):
        for column, character in enumerate(line):
            bits = ord(character) - 0x2800
            if 0 <= bits < 256:
                found |= {
                    (2 * column + x, 4 * row + y)
                    for bit, (x, y) in enumerate(places)
                    if bits >> bit & 1
                }
    return found


def small(*columns: str) -> Chart:
    t = np.array([0.0, 1, 2, 3, 4])
    values = {"q1": t, "q2": 4 - t, "tau1": 0 * t + 2}
    return chart(["x.csv"], ["t"], [{"t": t} | {name: values[name] for name in columns}])


# The canvas


@pytest.mark.parametrize("seed", range(5))
def test_each_dot_is_where_it_was_put(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = {
        (int(x), int(y))
        for x, y in zip(rng.integers(0, 20, 30), rng.integers(0, 12, 30), strict=True)
    }
    canvas = Canvas(10, 3)
    for x, y in points:
        canvas.line(np.array([complex(x, y)]), 0)
    assert dots(canvas.lines()) == points


def test_a_line_is_connected_and_straight() -> None:
    canvas = Canvas(20, 10)
    canvas.line(np.array([1 + 2j, 37 + 31j]), 0)
    found = sorted(dots(canvas.lines()))
    assert {x for x, _ in found} == set(range(1, 38))
    for x, y in found:
        assert abs(y - (2 + (x - 1) * 29 / 36)) <= 0.51


def test_what_is_outside_is_left_out() -> None:
    canvas = Canvas(4, 2)
    canvas.line(np.array([-5 + 3j, 20 + 3j]), 0)
    canvas.text(-1, 0, "abc")
    canvas.text(3, 1, "xyz")
    canvas.text(0, 5, "gone")
    assert dots(canvas.lines()) == {(x, 3) for x in range(6)}
    assert canvas.lines() == ["bc", "⠉⠉⠉x"]


def test_plain_marks_tell_owners() -> None:
    canvas = Canvas(5, 2, ascii=True)
    canvas.line(np.array([0j, 4]), 0)
    canvas.line(np.array([1j, 4 + 1j]), 1)
    assert canvas.lines() == ["+++++", "*****"]


def test_colours_are_asked_for() -> None:
    canvas = Canvas(3, 1)
    canvas.line(np.array([0j, 5]), 1)
    canvas.text(2, 0, "q", 0)
    assert canvas.lines() == ["⣀⣀q"]
    assert canvas.lines(colour=True) == ["\x1b[33m⣀⣀\x1b[34mq\x1b[0m"]


# Charts


def test_a_small_chart_to_the_character() -> None:
    assert chart_lines(small("q1", "q2"), 27, 5) == [
        "  q [rad]",
        "4 ┤⠉⠒⠤⣀             ⣀⠤⠒⠉ q1",
        "  │    ⠉⠒⠤⢄⡀   ⢀⡠⠤⠒⠉",
        "2 ┤        ⢈⡱⠶⢎⡁",
        "  │    ⣀⠤⠒⠊⠁   ⠈⠑⠒⠤⣀",
        "0 ┤⣀⠤⠒⠉             ⠉⠒⠤⣀ q2",
        "  └┬───────────────────┬",
        "   0                   4",
        "                   t [s]",
    ]


def test_a_small_chart_of_plain_characters() -> None:
    assert chart_lines(small("q1", "tau1"), 30, 3, ascii=True) == [
        "    q1 [rad]",
        "  4 -             ***** * q1",
        "  2 -    *********",
        "  0 -****",
        "    tau1 [N m]",
        "2.1 -",
        "  2 -++++++++++++++++++ + tau1",
        "1.9 -",
        "    ++----------------+",
        "     0                4",
        "                  t [s]",
    ]


@pytest.mark.parametrize("width", [40, 60, 79, 132])
def test_no_line_is_wider_than_asked(width: int) -> None:
    for ascii in (False, True):
        lines = chart_lines(small("q1", "q2", "tau1"), width, 8, ascii)
        assert max(map(len, lines)) <= width
        assert max(map(len, lines)) > width - 8
        text = "\n".join(lines)
        assert text.isascii() == ascii
        for word in ("q1", "q2", "tau1", "q [rad]", "tau1 [N m]", "t [s]"):
            assert word in text


def test_the_curve_is_drawn_where_its_values_are() -> None:
    """Each column of dots against the function, to a dot."""
    t = np.linspace(0, 6, 400)
    content = chart(["x"], ["t"], [{"t": t, "q1": np.sin(t)}])
    lines = chart_lines(content, 70, 12)[1:13]
    inside = [re.sub(r"^.*?[┤│]|q1", "", line) for line in lines]
    found = dots(inside)
    high = max(y for _, y in found)
    assert (min(y for _, y in found), high) == (0, 47)
    width = max(x for x, _ in found)
    for x, y in found:
        near = np.sin(np.linspace(max(0, x - 0.6), min(width, x + 0.6), 9) * 6 / width)
        expected = (near - np.sin(t).min()) / np.ptp(np.sin(t)) * 47
        assert expected.min() - 0.6 <= y <= expected.max() + 0.6


def test_one_row_and_equal_values() -> None:
    for table in (
        {"t": np.array([1.0]), "q1": np.array([2.0])},
        {"t": np.ones(3), "q1": np.ones(3)},
    ):
        lines = chart_lines(chart(["x"], ["t"], [table]), 50, 6)
        assert len(dots([line[8:] for line in lines[1:7]])) == 1


def test_more_names_than_rows_make_more_rows() -> None:
    t = np.arange(3.0)
    content = chart(["x"], ["t"], [{"t": t} | {f"q{k}": t for k in range(1, 15)}])
    text = "\n".join(chart_lines(content, 60, 5))
    for k in range(1, 15):
        assert re.search(rf"q{k}$", text, re.MULTILINE)


def test_units_in_plain_characters() -> None:
    t = np.arange(3.0)
    lines = chart_lines(chart(["x"], ["t"], [{"t": t, "qdd1": t}]), 40, 4, ascii=True)
    assert "qdd1 [rad/s^2]" in lines[0]
