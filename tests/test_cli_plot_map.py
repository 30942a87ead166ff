"""`robodyn plot --colour`: pictures of maps, on the terminal, sizes, what is refused."""

from __future__ import annotations

import base64
import io
import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import Outcome

from robodyn.pictures import chart_figure
from robodyn.pictures.colour_scale import NONE, rgb, viridis

Run = Callable[..., Outcome]
MAP = ("--x", "q1", "--y", "q2", "--colour")
FIRST = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


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
def drawn(monkeypatch: pytest.MonkeyPatch) -> list:
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


@pytest.mark.parametrize("suffix", FIRST)
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
    robodyn: Run, sweep: Path, tmp_path: Path, drawn: list
) -> None:
    """The pixel at the centre of each cell, by matplotlib's own transformation of x and y."""
    path = tmp_path / "map.png"
    robodyn("plot", sweep, *MAP, "flip", "--log", "-o", path).succeeds()
    found = pixels(path)
    axes = drawn[0].axes[0]
    drawn[0].set_dpi(150)
    rows = [line.split(",") for line in sweep.read_text().splitlines()[1:]]
    for q1, q2, flip, _ in rows:
        x, y = axes.transData.transform((float(q1), float(q2)))
        pixel = found[found.shape[0] - 1 - int(y), int(x)]
        if flip:
            expected = viridis(np.array([math.log10(float(flip)) / 2.0]))[0]
            assert np.abs(pixel - expected).max() <= 3
        else:
            assert tuple(pixel) == rgb(NONE)


def test_cells_are_even_and_square_to_the_dot(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    t = range(7)
    rows = "".join(f"{a},{b},{(a + b) % 2}\n" for a in t for b in t)
    path = tmp_path / "map.png"
    robodyn("plot", "-", *MAP, "c", "-o", path, stdin="q1,q2,c\n" + rows).succeeds()
    found = pixels(path)
    left, bottom, width, height = drawn[0].axes[0].get_position().bounds
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


def test_labels_units_bar_and_none(robodyn: Run, sweep: Path, tmp_path: Path, drawn: list) -> None:
    given = ("plot", sweep, "--model", "robots/2r.yaml", *MAP)
    robodyn(*given, "flip", "--log", "-o", tmp_path / "x.png").succeeds()
    axes = drawn[0].axes[0]
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
    (bar,) = drawn[1].axes[0].child_axes
    assert bar.get_ylabel() == "q1 [rad]"


def test_words_have_a_list(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    text = "a,b,outcome\n0,0,$stays$\n0,1,flips\n1,0,\n1,1,flips\n"
    options = ("--x", "a", "--y", "b", "--color", "outcome", "-o", tmp_path / "x.png")
    robodyn("plot", "-", *options, stdin=text).succeeds()
    legend = drawn[0].axes[0].get_legend()
    assert legend.get_title().get_text() == "outcome"
    assert [text.get_text() for text in legend.get_texts()] == ["$stays$", "flips", "none"]
    found = pixels(tmp_path / "x.png")
    for colour in ("#0072b2", "#d55e00", NONE):
        assert (found == rgb(colour)).all(axis=-1).sum() > 5000


@pytest.mark.parametrize("size", [None, "4x4", "9x3", "3x7", "1x1"])
def test_texts_stand_inside_the_picture(
    robodyn: Run, sweep: Path, tmp_path: Path, drawn: list, size: str | None
) -> None:
    for column in ("flip", "outcome"):
        options = ("--size", size) if size else ()
        robodyn("plot", sweep, *MAP, column, *options, "-o", tmp_path / "x.png").succeeds()
        figure = drawn[-1]
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


def test_points_that_are_no_grid(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1, (2, 50))
    rows = "".join(f"{a},{b},{a if a > 0.3 else ''}\n" for a, b in zip(x, y, strict=True))
    options = ("--x", "a", "--y", "b", "--colour", "c", "-o", tmp_path / "x.png")
    robodyn("plot", "-", *options, stdin="a,b,c\n" + rows).succeeds()
    none, there = drawn[0].axes[0].collections
    points = np.concatenate([none.get_offsets(), there.get_offsets()])
    assert sorted(points.tolist()) == sorted(np.column_stack([x, y]).tolist())
    assert (none.get_offsets()[:, 0] <= 0.3).all()
    assert not drawn[0].axes[0].images


def test_files_are_one_map(robodyn: Run, tmp_path: Path, drawn: list) -> None:
    for k in range(2):
        rows = "".join(f"{a},{b},{k}\n" for a in (2 * k, 2 * k + 1) for b in range(3))
        (tmp_path / f"{k}.csv").write_text("q1,q2,c\n" + rows)
    files = (tmp_path / "0.csv", tmp_path / "1.csv")
    robodyn("plot", *files, *MAP, "c", "-o", tmp_path / "x.png").succeeds()
    (image,) = drawn[0].axes[0].images
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
    robodyn: Run, tmp_path: Path, drawn: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chart_figure, "MOST_POINTS", 1000)
    points = np.random.default_rng(0).uniform(-3, 3, (1500, 2))
    rows = "".join(f"{a},{b},{a}\n" for a, b in points)
    robodyn("plot", "-", *MAP, "c", "-o", tmp_path / "x.png", stdin="q1,q2,c\n" + rows).succeeds()
    axes = drawn[0].axes[0]
    assert not axes.collections
    assert axes.images[0].get_array().shape == (chart_figure.RASTER, chart_figure.RASTER, 3)


def test_rows_without_a_place_are_left_out_and_told(
    robodyn: Run, tmp_path: Path, drawn: list
) -> None:
    rows = "q1,q2,flip\n0,0,1\n1,,2\n2,1,NaN\nnan,2,4\n3,5,5\n"
    line = ("plot", "-", *MAP, "flip", "-o", tmp_path / "x.svg")
    given = robodyn(*line, stdin=rows)
    note = "Note: stdin: 5 rows, 1 without q1, 1 without q2: not drawn\n"
    assert (given.code, given.err) == (0, note)
    (figure,) = drawn
    placed = [points.get_offsets().tolist() for points in figure.axes[0].collections]
    assert placed == [[[2, 1]], [[0, 0], [3, 5]]]  # without a value first: it hides no other
