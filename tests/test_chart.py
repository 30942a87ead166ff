"""What a chart shows: the columns chosen, their panels, round ticks, places of names."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest
from conftest import RP_ARM, within
from hypothesis import given
from hypothesis import strategies as st

import robodyn
from robodyn.dynamics.columns import guide_table, scene_units, unit_of, with_unit
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import build
from robodyn.pictures.chart import (
    MOST_POINTS,
    Canvas,
    Chart,
    chart,
    chart_lines,
    choose_columns,
    choose_x,
    limits,
    short_names,
    spread,
    thinned,
    tick_texts,
    ticks,
)
from robodyn.scene.description import from_text
from robodyn.sweeps.row_results import TAKEN

MOTION = ("t", "q1", "q2", "qd1", "qd2", "qdd1", "qdd2", "tau1", "fx1", "fy1", "energy", "gap")


# Columns


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        (None, ["q1", "q2", "tau1"]),
        (["q*"], ["q1", "q2"]),
        (["qd*", "q1"], ["qd1", "qd2", "q1"]),
        (["q1", "q*"], ["q1", "q2"]),
        (["f*"], ["fx1", "fy1"]),
        (["*1"], ["q1", "qd1", "qdd1", "tau1", "fx1", "fy1"]),
        (["*"], list(MOTION)),
        (["t"], ["t"]),
    ],
)
def test_columns(patterns: list[str] | None, expected: list[str]) -> None:
    assert choose_columns(MOTION, patterns, "t", "x.csv") == expected


def test_columns_where_the_usual_are_missing() -> None:
    assert choose_columns(["t", "KE", "note", "PE"], None, "t", "x.csv") == ["KE", "PE"]
    assert choose_columns(["t", "a", "b"], None, "t", "x.csv") == ["a", "b"]
    assert choose_columns(["t", "shake_fx", "shake_m"], ["shake_*"], "t", "") == [
        *("shake_fx", "shake_m")
    ]


@pytest.mark.parametrize("pattern", ["q3", "Q1", "x*", "q.", "[q]1", ""])
def test_a_column_that_is_not_there_is_told_with_those_that_are(pattern: str) -> None:
    with pytest.raises(InputError) as caught:
        choose_columns(MOTION, [pattern], "t", "x.csv")
    assert str(caught.value) == f"x.csv: --y = {pattern}: is no column; there are " + ", ".join(
        MOTION
    )


def test_many_stars_take_little_time() -> None:
    with within(5.0):
        for pattern in ("*a" * 40 + "b", "*" * 200 + "b"):
            with pytest.raises(InputError, match="is no column"):
                choose_columns(["a" * 5000 + "c", "1" * 5000], [pattern], None, "t.csv")
    assert choose_columns(["q1a2", "q1a", "qba2", "x"], ["q*a*"], None, "t.csv") == ["q1a2"]
    assert choose_columns(["q1a2", "xq", "1q2"], ["**q**"], None, "t.csv") == ["1q2"]


def test_the_only_column_cannot_be_drawn_against_itself() -> None:
    with pytest.raises(InputError, match=r"x\.csv: no column to draw: there is only t"):
        choose_columns(["t"], None, "t", "x.csv")


def test_x() -> None:
    assert choose_x(MOTION, None, "x.csv") == "t"
    assert choose_x(["q1"], None, "x.csv") is None
    assert choose_x(MOTION, "q2", "x.csv") == "q2"
    with pytest.raises(InputError, match=r"x\.csv: --x = q3: is no column; there are t, q1"):
        choose_x(MOTION, "q3", "x.csv")


# Panels


def table(names: tuple[str, ...], rows: int = 5) -> dict[str, np.ndarray]:
    return {name: np.arange(rows) * (k + 1.0) for k, name in enumerate(names)}


def test_curves_of_one_unit_share_a_panel() -> None:
    content = chart(["x.csv"], ["t"], [table(MOTION)])
    assert content.x_label == "t [s]"
    assert [panel.label for panel in content.panels] == [
        *("q [rad]", "qd [rad/s]", "qdd [rad/s²]", "tau1 [N m]", "fx, fy [N]", "energy [J]"),
        "gap [m]",
    ]
    assert [[curve.column for curve in panel.curves] for panel in content.panels][:2] == [
        *(["q1", "q2"], ["qd1", "qd2"])
    ]
    for curve in content.curves:
        assert curve.label == curve.column
        assert np.array_equal(curve.x, table(MOTION)["t"])
        assert np.array_equal(curve.y, table(MOTION)[curve.column])


def test_files_are_told_apart_by_their_names() -> None:
    content = chart(
        ["a/one.csv", "b/two.csv"], ["t", "t"], [table(("t", "q1")), table(("t", "q1"))]
    )
    (panel,) = content.panels
    assert [(curve.label, curve.file) for curve in panel.curves] == [("q1 one", 0), ("q1 two", 1)]
    assert panel.label == "q1 [rad]"
    assert short_names(["a/x.csv", "b/x.csv"]) == ["a/x.csv", "b/x.csv"]
    assert short_names(["stdin", "x.csv"]) == ["stdin", "x"]


def test_without_t_rows_are_counted_from_1() -> None:
    content = chart(["x.csv"], [None], [table(("q1",))])
    assert content.x_label == "row"
    assert content.curves[0].x.tolist() == [1, 2, 3, 4, 5]


def test_points_of_the_plane_are_to_scale() -> None:
    assert chart(["x"], ["tip_x1"], [table(("tip_x1", "tip_y1"))]).to_scale
    assert not chart(["x"], ["tip_x1"], [table(("tip_x1", "q1"))]).to_scale
    assert not chart(["x"], ["t"], [table(("t", "tip_y1"))]).to_scale


def test_tables_that_cannot_be_drawn() -> None:
    with pytest.raises(InputError, match=r"b\.csv: no rows: .* nothing to draw"):
        chart(["a.csv", "b.csv"], ["t", "t"], [table(("t", "q1")), table(("t", "q1"), 0)])
    with pytest.raises(InputError, match=r"different x = a\.csv: t, b\.csv: row: give --x"):
        chart(["a.csv", "b.csv"], ["t", None], [table(("t", "q1")), table(("q1",))])


def test_columns_and_units_are_those_of_the_guide() -> None:
    from documents import PAGES, rows_below

    rows = rows_below(PAGES["columns"], "| columns | unit | family | what |")
    assert [tuple(row) for row in rows] == guide_table()
    for names, unit, *_ in rows:
        for name in names.replace("`", "").replace(", ...", "").split(", "):
            assert unit_of(name) == unit
    assert unit_of("note") == ""


def test_columns_of_results_are_those_of_the_guide() -> None:
    from documents import PAGES, rows_below

    rows = rows_below(PAGES["columns"], "| results | unit | family | what |")
    assert [tuple(row) for row in rows] == guide_table(results=True)
    units = {"tau1": "N m", "q2": "rad", "P_vx": "m/s", "q1_deg": "°"}
    for names, unit, *_ in rows:
        for name in names.replace("`", "").split(", "):
            if unit == "X":
                assert {x: unit_of(name.replace("X", x)) for x in units} == units
                assert unit_of(name.replace("X", "note")) == ""
    assert {unit_of(f"{x}(tau1)") for x in TAKEN} == {"N m"}
    assert unit_of("shake_fx_phase") == "rad"
    assert unit_of("note_phase") == ""
    # a joint that slides
    rails = scene_units(robodyn.load("rack-gripper"))
    assert {unit_of(x, rails) for x in ("max(q1)", "q1_end", "q1_residual", "q1_amp")} == {"m"}


# Thinning


@pytest.mark.parametrize("seed", range(4))
def test_a_long_curve_keeps_what_can_be_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0, 9, 3 * MOST_POINTS))
    y = rng.normal(size=len(x)).cumsum()
    x_, y_ = thinned(x, y)
    assert len(x_) <= MOST_POINTS
    assert (y_.min(), y_.max()) == (y.min(), y.max())
    assert (x_[0], x_[-1], y_[0], y_[-1]) == (x[0], x[-1], y[0], y[-1])
    assert (np.diff(x_) >= 0).all()
    assert set(zip(x_, y_, strict=True)) <= set(zip(x, y, strict=True))


@pytest.mark.parametrize("seed", range(4))
def test_a_long_curve_keeps_its_gaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.arange(3.0 * MOST_POINTS)
    y = rng.normal(size=len(x)).cumsum()
    for begin in rng.integers(0, len(x), 5):
        y[begin : begin + 1000] = np.nan
    x_, y_ = thinned(x, y)
    assert len(x_) <= MOST_POINTS
    assert (np.nanmin(y_), np.nanmax(y_)) == (np.nanmin(y), np.nanmax(y))
    for a, b in itertools.pairwise(np.flatnonzero(~np.isnan(y_))):
        missing = np.isnan(y[int(x_[a]) : int(x_[b]) + 1]).sum()
        assert (b - a > 1) == (missing > 0)


def test_short_curves_and_loops_stay_whole() -> None:
    x = np.cos(np.arange(3.0 * MOST_POINTS))
    assert thinned(x, x)[0] is x
    x = np.arange(float(MOST_POINTS))
    assert thinned(x, x)[0] is x


# Ticks


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(2, 12))
def test_ticks_are_few_round_and_inside(low: float, width: float, most: int) -> None:
    high = low + width
    found = ticks(low, high, most)
    assert len(found) <= most
    room = 1e-8 * width + 1e-15 * max(abs(low), abs(high))  # and rounding
    assert all(low - room <= value <= high + room for value in found)
    if len(found) > 2:
        step = found[1] - found[0]
        digits = step / 10.0 ** math.floor(math.log10(step) + 1e-9)
        assert min(abs(digits - good) for good in (1, 2, 5, 10)) < 1e-3
    assert len(found) >= 2
    texts = tick_texts(found)
    assert len(set(texts)) == len(texts)


@pytest.mark.parametrize(
    ("low", "high", "most", "texts"),
    [
        (0, 10, 6, "0 2 4 6 8 10"),
        (0, 1, 5, "0 0.5 1"),
        (-0.9, 2.2, 6, "-0.5 0 0.5 1 1.5 2"),
        (0, 3e-9, 4, "0 1e-9 2e-9 3e-9"),
        (1e6, 1.3e6, 4, "1e6 1.1e6 1.2e6 1.3e6"),
        (12.643595001, 12.643595004, 5, "12.643595001 12.643595002 12.643595003 12.643595004"),
    ],
)
def test_ticks_of(low: float, high: float, most: int, texts: str) -> None:
    assert " ".join(tick_texts(ticks(low, high, most))) == texts


def test_limits() -> None:
    assert limits([np.array([1.0, 2]), np.array([-3.0])]) == (-3, 2)
    for value in (0.0, 5.0, -2e-9, 1e12):
        low, high = limits([np.array([value, value])])
        assert low < value < high


# Names at the ends of curves


@given(st.lists(st.floats(-1, 11), min_size=1, max_size=10), st.floats(0.1, 1))
def test_spread_keeps_order_distance_and_room(wanted: list[float], gap: float) -> None:
    places = spread(wanted, gap, 0, 10)
    assert places is not None
    ordered = [places[k] for k in sorted(range(len(wanted)), key=lambda k: wanted[k])]
    assert all(b - a >= gap * (1 - 1e-9) for a, b in itertools.pairwise(ordered))
    assert all(-1e-9 <= place <= 10 + 1e-9 for place in places)


def test_spread_moves_only_what_it_must() -> None:
    assert spread([1, 5, 9], 1, 0, 10) == [1, 5, 9]
    assert spread([5, 5], 1, 0, 10) == [4.5, 5.5]
    assert spread([10, 10, 2], 1, 0, 10) == [9, 10, 2]
    assert spread([1, 2, 3], 6, 0, 10) is None


def test_units_of_joints_that_slide() -> None:
    """Told by the scene alone; a coupling's by the joint that it gives."""
    text = RP_ARM + "couplings: [q2 = 0.1 q1]\n"
    units = scene_units(build(from_text(text, "x.yaml")))
    for name, unit in (
        *(("q1", "rad"), ("q2", "m"), ("qd2_end", "m/s"), ("qdd2_max", "m/s²"), ("e2", "m")),
        *(("tau1", "N m"), ("tau2", "N"), ("tc1", "N"), ("rm2", "N m"), ("mz1", "N m")),
        *(("q12", "rad"), ("fx2", "N")),
    ):
        assert unit_of(name, units) == unit
    assert unit_of("q2") == "rad"
    assert with_unit("tau2", units) == "tau2 [N]"


# Pictures of characters: dots where they belong, exact small charts, colours, names.


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
