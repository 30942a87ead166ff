"""Maps made of characters: what each shows, in colours, shades and plain marks."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from robodyn.pictures.characters import DEEP, PALETTE, map_lines
from robodyn.pictures.colour_scale import NONE, painted, rgb
from robodyn.pictures.value_map import ValueMap, value_map

CODE = re.compile(r"\x1b\[([\d;]*)m")
CUBE = (0, 95, 135, 175, 215, 255)


def small(words: tuple[str, ...] = (), log: bool = False) -> ValueMap:
    """A 4 x 3 grid; the value rises along x, one cell is empty, one has no row."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(4.0), np.arange(3.0)))
    values = np.array([0.0, 1, 2, 0]) if words else np.array([1.0, 10, 100, 1000])
    values = np.tile(values, 3)
    values[0] = math.nan
    return value_map(("a", "b", "c"), x[:-1], y[:-1], values[:-1], words, log)


def told(code: str) -> tuple[int, int, int]:
    """The colour of `2;r;g;b` or of one of xterm's 256, `5;n`."""
    kind, *numbers = map(int, code.split(";"))
    if kind == 2:
        return tuple(numbers)  # type: ignore[return-value]
    (n,) = numbers
    if n >= 232:
        return (8 + 10 * (n - 232),) * 3
    n -= 16
    return CUBE[n // 36], CUBE[n // 6 % 6], CUBE[n % 6]


def dots(line: str) -> list[tuple[object, object]]:
    """The colours, upper and lower, that a terminal shows in each character; None is blank."""
    found = []
    front = back = None
    for part in re.split(r"(\x1b\[[\d;]*m)", line):
        code = CODE.fullmatch(part)
        if not code:
            halves = {"▀": (front, back), "▄": (back, front), " ": (back, back)}
            found += [halves.get(character, (front, front)) for character in part]
        elif code[1] == "0":
            front = back = None
        elif code[1].startswith("38;"):
            front = told(code[1][3:])
        else:
            assert code[1].startswith("48;")
            back = told(code[1][3:])
    assert (front, back) == (None, None)
    return found


def test_shades_to_the_character() -> None:
    assert map_lines(small(log=True), 30, 15) == [
        "  b",
        "2 ┤░░░░░░▒▒▒▒▒▒▓▓▓▓▓▓",
        "  │░░░░░░▒▒▒▒▒▒▓▓▓▓▓▓",
        "1 ┤░░░░░░▒▒▒▒▒▒▓▓▓▓▓▓██████",
        "  │░░░░░░▒▒▒▒▒▒▓▓▓▓▓▓██████",
        "0 ┤······▒▒▒▒▒▒▓▓▓▓▓▓██████",
        "  │······▒▒▒▒▒▒▓▓▓▓▓▓██████",
        "  └───┬───────────┬────────",
        "      0           2",
        "                          a",
        "   c, log",
        "   ░░▒▒▒▓▓███  · none",
        "   1    100",
    ]


def test_words_in_plain_characters() -> None:
    lines = map_lines(small(("open", "crossed", "stuck")), 60, 12, ascii=True)
    text = "\n".join(lines)
    assert text.isascii()
    legend = [line.strip() for line in lines[lines.index(next(x for x in lines if "c:" in x)) :]]
    assert legend == ["c:", "* open", "+ crossed", "o stuck", ". none"]
    first = next(line for line in lines if line.startswith("0 -"))
    assert re.fullmatch(r"0 -(\.+)(\++)(o+)(\*+)", first)


@pytest.mark.parametrize("colours", [DEEP, PALETTE])
@pytest.mark.parametrize("words", [(), ("x", "y", "z")])
def test_each_half_of_a_character_has_its_own_colour(colours: str, words: tuple[str, ...]) -> None:
    content = small(words)
    lines = map_lines(content, 60, 14, colours=colours)
    inside = [line[3:] for line in lines if re.match(r". [│┤]", line)]
    rows = len(inside)
    columns = len(dots(inside[-1]))
    expected = content.rows_at(columns, 2 * rows)[::-1]
    shades = painted(np.where(expected < 0, 0, content.values[expected]), content.scale, words)
    near = 0 if colours == DEEP else 48
    for k, line in enumerate(inside):
        shown = dots(line)
        shown += [(None, None)] * (columns - len(shown))
        for c, halves in enumerate(shown):
            for half, colour in enumerate(halves):
                if expected[2 * k + half, c] < 0:
                    assert colour is None
                else:
                    apart = np.abs(np.array(colour) - shades[2 * k + half, c].astype(int))
                    assert apart.max() <= near
    grey = [line for line in lines if line.endswith("none")]
    assert "█" in grey[0]
    assert np.abs(np.array(told(CODE.findall(grey[0])[-2][3:])) - rgb(NONE)).max() <= 5


@pytest.mark.parametrize("width", [29, 40, 79, 132])
@pytest.mark.parametrize("height", [9, 23, 50])
def test_no_line_is_wider_than_asked(width: int, height: int) -> None:
    t = np.linspace(-3, 3, 40)
    x, y = (part.ravel() for part in np.meshgrid(t, t))
    for names in (("q1", "q2", "flip"), ("q1", "tau1", "energy")):
        content = value_map(names, x, y, np.where(x > 0, math.nan, x * y))
        for options in ({}, {"ascii": True}, {"colours": DEEP}, {"ascii": True, "colours": DEEP}):
            lines = map_lines(content, width, height, **options)
            plain = [CODE.sub("", line) for line in lines]
            assert max(map(len, plain)) <= width
            assert len(lines) <= max(height, 3 + 4 + 3)
            assert "\n".join(plain).isascii() == options.get("ascii", False)
            assert any("none" in line for line in plain)


def test_a_map_to_scale_has_square_dots() -> None:
    """A square of angles is twice as many characters wide as high, whatever stands beside it."""
    t = np.linspace(-3, 3, 200)
    x, y = (part.ravel() for part in np.meshgrid(t, t))
    content = value_map(("q1", "q2", "flip"), x, y, x)
    for width, height in ((79, 23), (60, 40), (200, 50)):
        lines = map_lines(content, width, height)
        inside = [
            re.split("[│┤]", line)[1].split("   ")[0] for line in lines if re.search("[│┤]", line)
        ]
        assert len(inside[0]) == pytest.approx(2 * len(inside), abs=1)
    beside = map_lines(content, 200, 30)
    assert any("█" in line and "flip [s]" in line for line in beside)
    assert len(beside) == 30


def test_points_without_values_and_one_point() -> None:
    nothing = np.array([math.nan])
    one = np.array([1.0])
    lines = map_lines(value_map(("a", "b", "c"), one, one, nothing), 40, 12)
    assert sum(line.count("·") for line in lines) == 2  # the point, and what it means
    assert lines[-1].strip() == "c: · none"
    lines = map_lines(value_map(("a", "b", "c"), one, one, one), 40, 12)
    assert sum(len(re.findall("[░▒▓█]", line)) for line in lines[:8]) == 1


def test_names_cannot_command_the_terminal() -> None:
    t = np.arange(3.0)
    content = value_map(("a\x1b[2J", "b", "c\x07"), t, t, np.zeros(3), ("w\x1b]0;",))
    text = "\n".join(map_lines(content, 60, 12))
    assert text.replace("\n", "").isprintable()


def test_a_joint_that_slides_has_no_ticks_of_angles() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid([0.0, 1.0], [0.0, 4.0]))
    content = value_map(("q1", "q2", "c"), x, y, x + y)
    assert any("π/2 ┤" in line for line in map_lines(content, 60, 24))
    lines = map_lines(content._replace(units={"q2": "m"}), 60, 24)
    assert "q2 [m]" in lines[0]
    assert not any("π" in line for line in lines)
