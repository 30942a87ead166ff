"""`robodyn plot`: files of every kind, what they show, the terminal's chart, what is refused."""

from __future__ import annotations

import base64
import io
import math
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT, Outcome

from robodyn.cli import figures
from robodyn.pictures import chart_figure
from robodyn.pictures.value_map import NONE, rgb, viridis

Run = Callable[..., Outcome]
TWO = "robots/2r.yaml"
FIRST = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF", ".txt": b" "}
ROWS = "t,q1,q2,tau1,note\n0,0,1,5,a\n1,1,0,5,b\n2,2,-1,5,c\n"


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    path = tmp_path / "motion.csv"
    path.write_text(ROWS)
    return path


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list:
    """The figures that are made, kept to be asked."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    kept = []
    make = chart_figure.chart_figure
    monkeypatch.setattr(chart_figure, "chart_figure", lambda *a: kept.append(make(*a)) or kept[-1])
    return kept


@pytest.fixture(scope="module")
def drawn_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of what the motion's charts were as stdout of one process that made them all."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "motion.csv").write_text(ROWS)
    code = """
import os
from robodyn import cli
for format in ("svg", "pdf", "png"):
    with open(f"out.{format}", "wb") as file:
        os.dup2(file.fileno(), 1)
        assert cli.run(["plot", "motion.csv", "--format", format]) == 0
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, check=True)
    return folder


# Files


@pytest.mark.parametrize("suffix", [*FIRST, ".PNG"])
def test_files_by_suffix(robodyn: Run, motion: Path, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    path = tmp_path / f"chart{suffix}"
    robodyn("plot", motion, "-o", path).succeeds()
    assert path.read_bytes().startswith(FIRST[suffix.lower()])
    assert sorted(each.name for each in tmp_path.iterdir()) == [path.name, "motion.csv"]


@pytest.mark.parametrize("format", ["svg", "pdf", "png"])
def test_stdout_by_format_and_the_same_bytes_twice(
    robodyn: Run, motion: Path, drawn_elsewhere: Path, format: str
) -> None:
    for name in "ab":
        robodyn("plot", motion, "-o", motion.parent / f"{name}.{format}").succeeds()
    first, second = ((motion.parent / f"{name}.{format}").read_bytes() for name in "ab")
    assert first == second
    assert (drawn_elsewhere / f"out.{format}").read_bytes() == first


def test_size_and_colours_of_the_picture(robodyn: Run, motion: Path, tmp_path: Path) -> None:
    """The curve q1 runs from the lower left to the upper right, dark on white."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    from PIL import Image

    robodyn("plot", motion, "--y", "q1", "--size", "6x3", "-o", tmp_path / "x.png").succeeds()
    with Image.open(tmp_path / "x.png") as image:
        assert image.size == (900, 450)
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert (pixels[0, 0] == 255).all()
    blue = np.argwhere(np.abs(pixels - [0, 0x72, 0xB2]).sum(axis=-1) < 30)
    curve = blue[blue[:, 1] < 840]  # less the name at its end
    row, column = curve.T
    slope = np.corrcoef(row, column)[0, 1]
    assert slope < -0.99
    assert np.ptp(column) > 600


# Panels and curves


def test_panels_by_units(robodyn: Run, motion: Path, tmp_path: Path, drawn: list) -> None:
    robodyn("plot", motion, "--model", TWO, "-o", tmp_path / "x.svg").succeeds()
    (figure,) = drawn
    assert [axes.get_ylabel() for axes in figure.axes] == ["q [rad]", "tau1 [N m]"]
    assert figure.axes[-1].get_xlabel() == "t [s]"
    curves = [line.get_xydata().tolist() for axes in figure.axes for line in axes.get_lines()]
    assert curves == [
        [[0, 0], [1, 1], [2, 2]],
        [[0, 1], [1, 0], [2, -1]],
        [[0, 5], [1, 5], [2, 5]],
    ]
    names = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert names == ["q1", "q2", "tau1"]
    assert all(axes.get_legend() is None for axes in figure.axes)


def test_names_stand_beside_their_ends_inside_the_picture(
    robodyn: Run, motion: Path, tmp_path: Path, drawn: list
) -> None:
    robodyn("plot", motion, "-o", tmp_path / "x.png").succeeds()
    (figure,) = drawn
    renderer = figure.canvas.get_renderer()
    for axes in figure.axes:
        for line, text in zip(axes.get_lines(), axes.texts, strict=True):
            assert text.get_color() == line.get_color()
            box = text.get_window_extent(renderer)
            end = axes.transData.transform(line.get_xydata()[-1])
            assert abs(box.x0 - end[0]) < 0.15 * figure.dpi
            assert abs((box.y0 + box.y1) / 2 - end[1]) < 0.2 * figure.dpi
            assert box.x1 < figure.bbox.x1


def test_many_curves_get_a_box(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    names = [f"q{k}" for k in range(1, 41)]
    text = f"t,{','.join(names)}\n0{',1' * 40}\n1{',2' * 40}\n"
    robodyn("plot", "-", "-o", tmp_path / "x.svg", stdin=text).succeeds()
    (axes,) = drawn[0].axes
    assert [x.get_text() for x in axes.get_legend().get_texts()] == names
    assert not axes.texts


def test_files_are_overlaid(robodyn: Run, motion: Path, tmp_path: Path, drawn: list) -> None:
    other = tmp_path / "other.csv"
    other.write_text("q2,t,q1\n3,0,1\n4,3,1\n")
    robodyn("plot", motion, other, "--y", "q*", "-o", tmp_path / "x.svg").succeeds()
    (axes,) = drawn[0].axes
    styles = {line.get_label(): (line.get_color(), line.get_linestyle()) for line in axes.lines}
    assert sorted(styles) == ["q1 motion", "q1 other", "q2 motion", "q2 other"]
    assert styles["q1 motion"][0] == styles["q1 other"][0] != styles["q2 other"][0]
    assert styles["q1 motion"][1] != styles["q1 other"][1] == styles["q2 other"][1]
    robodyn("plot", motion, other, "--y", "q1", "-o", tmp_path / "x.svg").succeeds()
    one, two = drawn[1].axes[0].lines
    assert one.get_color() != two.get_color()


def test_a_legend_tells_the_line_styles_of_files(
    robodyn: Run, motion: Path, tmp_path: Path, drawn: list
) -> None:
    other = tmp_path / "other.csv"
    other.write_text(ROWS)
    robodyn("plot", motion, other, "-o", tmp_path / "x.svg").succeeds()
    robodyn("plot", motion, "-o", tmp_path / "x.svg").succeeds()
    (legend,) = drawn[0].legends
    styles = {
        text.get_text(): line.get_linestyle()
        for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)
    }
    assert sorted(styles) == ["motion", "other"]
    assert styles["motion"] != styles["other"]
    for axes in drawn[0].axes:
        for line in axes.get_lines():
            assert line.get_linestyle() == styles[line.get_label().split()[-1]]
    assert not drawn[1].legends


# Gaps, and points that no line joins


def test_a_row_without_a_value_is_a_gap(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    """As `sweep` writes it; a point between two gaps is seen."""
    rows = "t,q1,q2\n0,,1\n1,2,1\n2,NaN,1\n3,4,1\n4,5,1\n,6,1\n6,nan,1\n"
    given = robodyn("plot", "-", "-o", tmp_path / "x.svg", stdin=rows)
    note = "Note: stdin: 7 rows, 3 without q1, 1 without t: not drawn\n"
    assert (given.code, given.err) == (0, note)
    one, two = (line for line in drawn[0].axes[0].get_lines())
    nan = np.nan
    assert np.array_equal(one.get_ydata(), [nan, 2, nan, 4, 5, nan, nan], equal_nan=True)
    assert np.array_equal(two.get_ydata(), [1, 1, 1, 1, 1, nan, 1], equal_nan=True)
    assert one.get_marker() == two.get_marker() == "o"
    assert (one.get_markevery(), two.get_markevery()) == ([1], [6])
    assert drawn[0].axes[0].get_xlim() == (0, 6)
    shown = robodyn("plot", "-", "--format", "text", stdin=rows)
    assert (shown.code, shown.err, "q1" in shown.out) == (0, note, True)
    robodyn("plot", "-", "--y", "q1", "--format", "text", stdin="t,q1\n0,\n,1\n").fails(
        2, "stdin: nothing to draw: no row has both t and a value to draw over it"
    )
    robodyn("plot", "-", "--format", "text", stdin="t,q1\n0,inf\n").fails(2, "q1 = inf")


def test_rows_of_a_sample_are_points(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    sample = "a,b,outcome\n2,1,finished\n1,5,finished\n3,2,finished\n"
    grid = "a,b,outcome\n1,1,finished\n2,5,finished\n3,2,finished\n"
    path = "t,a,b,outcome\n0,2,1,x\n1,1,5,x\n2,3,2,x\n"
    for rows, more, joined in (
        (sample, ("--x", "a"), False),
        (sample, (), False),
        (grid, ("--x", "a"), True),
        (path, ("--x", "a"), True),
        (path, ("--x", "a", "--points"), False),
        (path, ("--points",), False),
    ):
        line = ("plot", "-", "--y", "b", *more, "-o", tmp_path / "x.svg")
        robodyn(*line, stdin=rows).succeeds()
        (drawn_line,) = drawn.pop().axes[0].get_lines()[:1]
        assert (drawn_line.get_linestyle() == "None") == (not joined)
        assert (drawn_line.get_marker() == "o") == (not joined)
        assert drawn_line.get_ydata().tolist() == [1, 5, 2]
    mapped = ("--x", "a", "--y", "b", "--colour", "a", "--points")
    robodyn("plot", "-", *mapped, "--format", "svg", stdin=grid).fails(2, "--points")


def test_characters_leave_gaps_and_do_not_join_points(
    robodyn: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of ten rows on a level line each lacks a value, or none does: how much of it is drawn."""
    monkeypatch.setattr(figures, "_has_dots", lambda encoding: False)
    line = ("plot", "-", "--format", "text", "--y", "b", "--x", "a")
    lengths = []
    for gaps, more in ((False, ()), (True, ()), (False, ("--points",))):
        rows = "".join(f"{k},{'' if gaps and k % 5 == 2 else 1}\n" for k in range(10))
        shown = robodyn(*line, *more, stdin="a,b\n" + rows).out
        lengths.append(max(text.count("*") for text in shown.splitlines()) - 1)
    whole, broken, points = lengths
    assert whole > 50
    assert broken == pytest.approx(whole * 5 / 9, abs=4)
    assert points == 10


def test_columns_against_each_other(
    robodyn: Run, motion: Path, tmp_path: Path, drawn: list
) -> None:
    given = ("--model", TWO, "--x", "q1", "--y", "q2")
    robodyn("plot", motion, *given, "-o", tmp_path / "x.svg").succeeds()
    (axes,) = drawn[0].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("q1 [rad]", "q2 [rad]")
    assert axes.lines[0].get_xydata().tolist() == [[0, 1], [1, 0], [2, -1]]


def test_paths_in_the_plane_are_to_scale(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    angle = np.linspace(0, 6.3, 50)
    rows = "".join(f"{np.cos(a)},{np.sin(a)}\n" for a in angle)
    robodyn(
        *("plot", "-", "--x", "tip_x2", "--y", "tip_y2", "-o", tmp_path / "x.png"),
        stdin="tip_x2,tip_y2\n" + rows,
    ).succeeds()
    (axes,) = drawn[0].axes
    drawn[0].canvas.draw()
    a, b = axes.transData.transform([(0, 0), (1, 1)])
    assert abs(b - a)[0] == pytest.approx(abs(b - a)[1], rel=5e-3)


# Characters


def test_text_in_a_pipe(robodyn: Run, motion: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("LINES", "20")
    given = robodyn("plot", motion, "--format", "text").succeeds()
    lines = given.out.splitlines()
    assert lines[0].strip() == "q [rad or m]"
    assert lines[-1].strip() == "t [s]"
    assert max(map(len, lines)) <= 59
    assert len(lines) <= 20
    assert "\x1b" not in given.out


def test_an_output_without_braille_gets_plain_characters(quick_shell: Run, motion: Path) -> None:
    line = f"robodyn plot {motion} --format text"
    given = quick_shell(line, env={"PYTHONIOENCODING": "ascii"}).succeeds()
    assert given.out.isascii()
    assert "+ q2" in given.out
    given = quick_shell(line, env={"PYTHONIOENCODING": "utf-8"}).succeeds()
    assert not given.out.isascii()


def test_on_a_terminal(motion: Path) -> None:
    from terminals import on_terminal

    shown = on_terminal("plot", str(motion), columns=70)
    assert "\x1b[34m" in shown
    plain = re.sub(r"\x1b\[\d*m", "", shown)
    assert max(map(len, plain.splitlines())) <= 70
    assert max(map(len, plain.splitlines())) > 60
    assert "q [rad or m]" in plain


def test_no_color(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def lines(width: int, height: int, plain: bool, coloured: bool) -> list[str]:
        return [asked.append(coloured) or ""]

    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    for without in ("", "1"):
        monkeypatch.setenv("NO_COLOR", without)
        figures.write_characters(lines, out=None)
    assert asked == [True, False]


def test_stdin_beside_a_file(robodyn: Run, motion: Path) -> None:
    assert robodyn("plot", motion, "-", "--format", "text", stdin=ROWS).code == 0


def test_one_row_is_a_point(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    text = "t,q1\n3,7\n"
    assert "q1" in robodyn("plot", "-", "--format", "text", stdin=text).succeeds().out
    robodyn("plot", "-", "-o", tmp_path / "x.png", stdin=text).succeeds()
    (line,) = drawn[0].axes[0].lines
    assert line.get_marker() == "o"


def test_without_the_extra(
    robodyn: Run, motion: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(chart_figure, "find_spec", lambda name: None)
    path = tmp_path / "x.png"
    robodyn("plot", motion, "-o", path).fails(1, "pip install '.[plot]'")
    assert not path.exists()
    robodyn("plot", motion, "--format", "text").succeeds()


def test_a_failure_leaves_the_older_file(
    robodyn: Run, motion: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    figure = pytest.importorskip("matplotlib.figure", reason="the extra `plot`")
    path = tmp_path / "x.png"
    path.write_text("older")

    def fails(self: object, stream: object, **_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure.Figure, "savefig", fails)
    robodyn("plot", motion, "-o", path).fails(1, "No space left on device")
    assert path.read_text() == "older"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["motion.csv", "x.png"]


def test_text_needs_no_matplotlib(shell: Run, motion: Path) -> None:
    code = "import sys; from robodyn import cli; "
    code += f"cli.run(['plot', {str(motion)!r}, '--format', 'text']); "
    code += "sys.exit(bool({'matplotlib', 'scipy', 'PIL'} & set(sys.modules)))"
    assert shell(f'python -c "{code}"').code == 0


def test_units_of_joints_that_slide(robodyn: Run) -> None:
    rows = "t,q1,q2,tau2\n0,0,0.1,5\n1,1,0.3,6\n"
    given = ("plot", "-", "--format", "text")
    plain = robodyn(*given, stdin=rows).succeeds().out
    told = robodyn(*given, "--model", "robots/rp-arm.yaml", stdin=rows).succeeds().out
    assert "q [rad or m]" in plain
    assert "tau2 [N m or N]" in plain
    for part in ("q1 [rad]", "q2 [m]", "tau2 [N]"):
        assert part in told


def test_units_of_a_users_own_columns_are_not_invented(robodyn: Run) -> None:
    """No command writes these names; `energy2` and `t2` neither, as energy and t have no number."""
    names = "x,y,w,wd,angle,q,tau,power,volt,energy2,t2"
    rows = f"t,{names}\n" + "0" + ",1" * 11 + "\n1" + ",2" * 11 + "\n"
    for more in (), ("--degrees",), ("--model", TWO, "--degrees"):
        line = ("plot", "-", "--format", "text", "--y", names, *more)
        shown = robodyn(*line, stdin=rows).succeeds().out
        assert re.findall(r"\S+ \[.*\]", shown) == ["t [s]"]
    given = ("torque", TWO, "-", "--degrees")
    row = robodyn(*given, stdin="q1,q2,w,angle,x\n0,0,1,2,3\n").succeeds().row
    assert (row["w"], row["angle"], row["x"]) == (1, 2, 3)


def test_degrees_and_a_title(robodyn: Run, tmp_path: Path) -> None:
    """Angles are drawn times 180/pi; what slides, or is no angle, as it is."""
    rows = "t,q1,q2,tau1\n0,0,0.5,1\n1,3.141592653589793,0.7,2\n"
    line = ("plot", "-", "--format", "text", "--degrees", "--title", "A [turn]")
    robodyn(*line, stdin=rows).fails(2, "--degrees = q1", "rad or in m", "--model MODEL")
    file = tmp_path / "map.svg"
    mapped = ("plot", "-", "--degrees", "--title", "A [turn]", "-o", file, "--colour")
    given = robodyn(*mapped, "q2", "--x", "t", "--y", "tau1", stdin=rows)
    given.fails(2, "--degrees = q2", "--model MODEL")
    shown = robodyn(*line, "--y", "angle1", stdin="angle1\n0\n3.14\n").succeeds().out
    assert "angle1_deg [°]" in shown
    shown = robodyn(*line, "--model", TWO, stdin=rows).succeeds().out
    assert shown.startswith("  A [turn]\n")
    assert "q [°]" in shown
    assert "150 ┤" in shown
    shown = robodyn(*line, "--model", "robots/rp-arm.yaml", "--y", "q*", stdin=rows).succeeds().out
    assert "q1_deg [°]" in shown
    assert "q2 [m]" in shown
    robodyn(*mapped, "tau1", "--model", TWO, "--x", "q1", "--y", "q2", stdin=rows).succeeds()
    for part in ("A [turn]", "q1_deg [°]"):
        assert f"<!-- {part} -->" in file.read_text()
    for size in (100, 300):
        out = tmp_path / f"{size}.png"
        robodyn(
            *("plot", "-", "--title", "$E", "--dpi", size, "--size", "4x3", "-o", out), stdin=rows
        ).succeeds()
        assert int.from_bytes(out.read_bytes()[16:20], "big") == 4 * size


# `robodyn plot --colour`: pictures of maps, on the terminal, sizes, what is refused.


MAP = ("--x", "q1", "--y", "q2", "--colour")


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """A grid over a turn of both angles, 12 x 10: a time, which two points lack, and words."""
    path = tmp_path / "sweep.csv"
    lines = ["q1,q2,flip,outcome"]
    for k, a in enumerate(np.linspace(-math.pi, math.pi, 12)):
        for j, b in enumerate(np.linspace(-math.pi, math.pi, 10)):
            flip = "" if (k, j) in ((0, 0), (5, 5)) else repr(10.0 ** (k / 5.5))
            lines.append(f"{a!r},{b!r},{flip},{'flips' if flip else 'stays'}")
    path.write_text("\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n")
    return path


@pytest.fixture
def maps(monkeypatch: pytest.MonkeyPatch) -> list:
    """The figures that are made, kept to be asked."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    kept = []
    make = chart_figure.map_figure
    monkeypatch.setattr(chart_figure, "map_figure", lambda *a: kept.append(make(*a)) or kept[-1])
    return kept


def pixels(path: Path) -> np.ndarray:
    image = pytest.importorskip("PIL.Image", reason="the extra `plot`")
    with image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


# Files


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_files_by_suffix_and_the_same_bytes_twice(
    robodyn: Run, sweep: Path, tmp_path: Path, suffix: str
) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    for path in (one, two):
        robodyn("plot", sweep, *MAP, "flip", "--log", "-o", path).succeeds()
    assert one.read_bytes().startswith(FIRST[suffix])
    assert one.read_bytes() == two.read_bytes()


def test_every_cell_has_its_colour_and_its_place(
    robodyn: Run, sweep: Path, tmp_path: Path, maps: list
) -> None:
    """The pixel at the centre of each cell, by matplotlib's own transformation of x and y."""
    path = tmp_path / "map.png"
    robodyn("plot", sweep, *MAP, "flip", "--log", "-o", path).succeeds()
    found = pixels(path)
    axes = maps[0].axes[0]
    maps[0].set_dpi(150)
    rows = [line.split(",") for line in sweep.read_text().splitlines()[1:]]
    for q1, q2, flip, _ in rows:
        x, y = axes.transData.transform((float(q1), float(q2)))
        pixel = found[found.shape[0] - 1 - int(y), int(x)]
        if flip:
            expected = viridis(np.array([math.log10(float(flip)) / 2.0]))[0]
            assert np.abs(pixel - expected).max() <= 3
        else:
            assert tuple(pixel) == rgb(NONE)


def test_cells_are_even_and_square_to_the_dot(robodyn: Run, tmp_path: Path, maps: list) -> None:
    t = range(7)
    rows = "".join(f"{a},{b},{(a + b) % 2}\n" for a in t for b in t)
    path = tmp_path / "map.png"
    robodyn("plot", "-", *MAP, "c", "-o", path, stdin="q1,q2,c\n" + rows).succeeds()
    found = pixels(path)
    left, bottom, width, height = maps[0].axes[0].get_position().bounds
    tall, wide = found.shape[:2]
    row = int(tall * (1 - bottom - 0.5 * height / 7))
    line = found[row, int(wide * left) + 4 : int(wide * (left + width)) - 4]
    changes = np.flatnonzero(np.abs(np.diff(line[:, 1])) > 20)
    assert len(changes) == 6
    assert len(set(np.diff(changes))) == 1
    assert width * wide == pytest.approx(height * tall, abs=0.01)


@pytest.mark.parametrize("flat", [None, 0.25, 1.0, 3.0])
def test_the_longer_side_of_a_map_of_points_is_always_as_long(flat: float | None) -> None:
    wide, high = chart_figure._inside(SimpleNamespace(grid=None), flat)
    assert wide / high == pytest.approx(flat or chart_figure.WIDE)
    assert max(wide, high) == chart_figure.LONGEST


def test_labels_units_bar_and_none(robodyn: Run, sweep: Path, tmp_path: Path, maps: list) -> None:
    given = ("plot", sweep, "--model", "robots/2r.yaml", *MAP)
    robodyn(*given, "flip", "--log", "-o", tmp_path / "x.png").succeeds()
    axes = maps[0].axes[0]
    bar, none = axes.child_axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("q1 [rad]", "q2 [rad]")
    texts = [text.get_text() for text in axes.get_xticklabels()]
    assert (texts[0], texts[-1], len(texts)) == ("−π", "π", 9)
    assert bar.get_ylabel() == "flip [s]"
    ticks = zip(bar.get_yticks(), bar.get_yticklabels(), strict=True)
    for place, text in ticks:
        assert place == pytest.approx(math.log10(float(text.get_text())) / 2.0)
    assert [text.get_text() for text in none.texts] == ["none"]
    robodyn(*given, "q1", "-o", tmp_path / "x.png").succeeds()
    (bar,) = maps[1].axes[0].child_axes
    assert bar.get_ylabel() == "q1 [rad]"


def test_words_have_a_list(robodyn: Run, tmp_path: Path, maps: list) -> None:
    text = "a,b,outcome\n0,0,$stays$\n0,1,flips\n1,0,\n1,1,flips\n"
    options = ("--x", "a", "--y", "b", "--color", "outcome", "-o", tmp_path / "x.png")
    robodyn("plot", "-", *options, stdin=text).succeeds()
    legend = maps[0].axes[0].get_legend()
    assert legend.get_title().get_text() == "outcome"
    assert [text.get_text() for text in legend.get_texts()] == ["$stays$", "flips", "none"]
    found = pixels(tmp_path / "x.png")
    for colour in ("#0072b2", "#d55e00", NONE):
        assert (found == rgb(colour)).all(axis=-1).sum() > 5000


@pytest.mark.parametrize("size", [None, "4x4", "9x3", "3x7", "1x1"])
def test_texts_stand_inside_the_picture(
    robodyn: Run, sweep: Path, tmp_path: Path, maps: list, size: str | None
) -> None:
    for column in ("flip", "outcome"):
        options = ("--size", size) if size else ()
        robodyn("plot", sweep, *MAP, column, *options, "-o", tmp_path / "x.png").succeeds()
        figure = maps[-1]
        if size:
            wide, high = (float(side) for side in size.split("x"))
            assert figure.get_size_inches().tolist() == [wide, high]
        if size not in ("1x1",):
            box = figure.get_tightbbox(figure.canvas.get_renderer())
            width, height = figure.get_size_inches()
            assert box.x0 > 0
            assert box.y0 > 0
            assert box.x1 < width
            assert box.y1 < height
        axes = figure.axes[0]
        (x0, y0), (x1, y1) = axes.transData.transform([(0, 0), (1, 1)])
        assert x1 - x0 == pytest.approx(y1 - y0, rel=0.01)


def test_points_that_are_no_grid(robodyn: Run, tmp_path: Path, maps: list) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1, (2, 50))
    rows = "".join(f"{a},{b},{a if a > 0.3 else ''}\n" for a, b in zip(x, y, strict=True))
    options = ("--x", "a", "--y", "b", "--colour", "c", "-o", tmp_path / "x.png")
    robodyn("plot", "-", *options, stdin="a,b,c\n" + rows).succeeds()
    none, there = maps[0].axes[0].collections
    points = np.concatenate([none.get_offsets(), there.get_offsets()])
    assert sorted(points.tolist()) == sorted(np.column_stack([x, y]).tolist())
    assert (none.get_offsets()[:, 0] <= 0.3).all()
    assert not maps[0].axes[0].images


def test_files_are_one_map(robodyn: Run, tmp_path: Path, maps: list) -> None:
    for k in range(2):
        rows = "".join(f"{a},{b},{k}\n" for a in (2 * k, 2 * k + 1) for b in range(3))
        (tmp_path / f"{k}.csv").write_text("q1,q2,c\n" + rows)
    files = (tmp_path / "0.csv", tmp_path / "1.csv")
    robodyn("plot", *files, *MAP, "c", "-o", tmp_path / "x.png").succeeds()
    (image,) = maps[0].axes[0].images
    assert image.get_array().shape == (3, 4, 3)


def test_hidden_rows_are_told(robodyn: Run, sweep: Path) -> None:
    given = robodyn("plot", sweep, sweep, *MAP, "flip", "--format", "svg")
    assert given.code == 0
    assert given.err == "Note: 120 rows are hidden by later ones with the same q1, q2\n"


# Large tables


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_many_rows_are_quick_and_small(robodyn: Run, tmp_path: Path, suffix: str) -> None:
    """A twelfth of a million rows, half of them as rough as chaos is."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    n = 290
    rng = np.random.default_rng(0)
    t = np.linspace(-3, 3, n).tolist()
    rough = rng.uniform(1, 100, (n, n)).round(3)
    lines = [
        f"{a},{b},{rough[i, j] if b > 0 else 5 + a}\n"
        for i, a in enumerate(t)
        for j, b in enumerate(t)
    ]
    (tmp_path / "sweep.csv").write_text("q1,q2,flip\n" + "".join(lines))
    path = tmp_path / f"x{suffix}"
    begin = time.process_time()
    robodyn("plot", tmp_path / "sweep.csv", *MAP, "flip", "-o", path).succeeds()
    assert time.process_time() - begin < 5.0
    assert path.stat().st_size < 300_000
    if suffix == ".svg":
        (image,) = re.findall(rb'data:image/png;base64,([^"]*)', path.read_bytes())[:1]
        assert pixels(io.BytesIO(base64.b64decode(image))).shape[2] == 3


def test_many_points_become_a_raster(
    robodyn: Run, tmp_path: Path, maps: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chart_figure, "MOST_POINTS", 1000)
    points = np.random.default_rng(0).uniform(-3, 3, (1500, 2))
    rows = "".join(f"{a},{b},{a}\n" for a, b in points)
    robodyn("plot", "-", *MAP, "c", "-o", tmp_path / "x.png", stdin="q1,q2,c\n" + rows).succeeds()
    axes = maps[0].axes[0]
    assert not axes.collections
    assert axes.images[0].get_array().shape == (chart_figure.RASTER, chart_figure.RASTER, 3)


def test_rows_without_a_place_are_left_out_and_told(
    robodyn: Run, tmp_path: Path, maps: list
) -> None:
    rows = "q1,q2,flip\n0,0,1\n1,,2\n2,1,NaN\nnan,2,4\n3,5,5\n"
    line = ("plot", "-", *MAP, "flip", "-o", tmp_path / "x.svg")
    given = robodyn(*line, stdin=rows)
    note = "Note: stdin: 5 rows, 1 without q1, 1 without q2: not drawn\n"
    assert (given.code, given.err) == (0, note)
    (figure,) = maps
    placed = [points.get_offsets().tolist() for points in figure.axes[0].collections]
    assert placed == [[[2, 1]], [[0, 0], [3, 5]]]  # without a value first: it hides no other
