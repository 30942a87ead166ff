"""`robodyn draw`: pictures of every kind, what they show, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, RP_ARM, SCOTCH_YOKE, TWO_LINK, Outcome

from robodyn.cli import draw
from robodyn.pictures import chart_figure

Run = Callable[..., Outcome]
FIRST = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
ARM = ("draw", "robots/2r.yaml", "--q", "30deg,45deg")
BAR = ("draw", "robots/four-bar.yaml", "--q", "60deg")


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch) -> list:
    """The pictures that are made, kept to be asked."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    from robodyn.pictures import mechanism_picture as pictures

    kept = []
    begin = pictures.Picture.__init__

    def keep(self: object, *arguments: object) -> None:
        begin(self, *arguments)
        kept.append(self)

    monkeypatch.setattr(pictures.Picture, "__init__", keep)
    return kept


def texts(picture) -> list[str]:
    """What is written, less the scale bar's length."""
    return [text.get_text() for text in picture.axes.texts if text.get_text()][1:]


def pixels_of(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


@pytest.mark.parametrize("suffix", FIRST)
@pytest.mark.parametrize("scene", sorted(ROOT.glob("robots/*.yaml")), ids=lambda path: path.stem)
@pytest.mark.thinned
def test_every_scene_in_every_kind(robodyn: Run, tmp_path: Path, scene: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    path = tmp_path / f"x{suffix}"
    given = robodyn("draw", scene, "--labels", "names", "-o", path)
    assert (given.code, given.out) == (0, "")
    assert given.err.startswith("Note: without --q drawn at q = ")
    assert path.read_bytes().startswith(FIRST[suffix])
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", FIRST)
@pytest.mark.parametrize("text", [RP_ARM, SCOTCH_YOKE], ids=["arm", "yoke"])
def test_what_slides_in_every_kind(
    robodyn: Run, scene: Callable[[str], Path], tmp_path: Path, text: str, suffix: str
) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    path = tmp_path / f"x{suffix}"
    given = robodyn("draw", scene(text), "--labels", "names", "-o", path)
    assert (given.code, given.out) == (0, "")
    assert path.read_bytes().startswith(FIRST[suffix])


def sizes(picture) -> dict[str, float]:
    """The size of each force and torque that a picture names, N and N m."""
    named = [re.fullmatch(r"(.*) = (\S+) ([mk]?)N( m)?", text) for text in texts(picture)]
    factors = {"m": 1e-3, "": 1.0, "k": 1e3}
    return {x[1]: float(x[2]) * factors[x[3]] for x in named}


def test_no_force_is_told(robodyn: Run, scene: Callable[[str], Path], tmp_path: Path) -> None:
    path = scene("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    given = robodyn("draw", path, "--q", "0", "--forces", "-o", tmp_path / "x.svg")
    assert (given.code, given.err) == (0, "Note: all forces are zero\n")


def test_forces_where_links_slide(
    robodyn: Run, scene: Callable[[str], Path], tmp_path: Path, pictures: list
) -> None:
    state = (scene("gravity: 9.81" + SCOTCH_YOKE), "--q", "60deg", "--qd", "5")
    robodyn("draw", *state, "--forces", "-o", tmp_path / "x.svg").succeeds()
    row = robodyn("reactions", *state).row
    expected = {f"r{k}": abs(complex(row[f"rx{k}"], row[f"ry{k}"])) for k in (1, 2)}
    expected |= {"f1": abs(complex(row["fx1"], row["fy1"])), "m1 g": 0.8 * 9.81, "m2 g": 1.5 * 9.81}
    expected["tau1"] = abs(robodyn("torque", *state).row["tau1"])
    found = sizes(pictures[0])
    assert found.keys() == expected.keys()
    for name, size in expected.items():
        assert found[name] == pytest.approx(size, rel=6e-3)


def test_joints_are_where_they_are_to_the_pixel(
    robodyn: Run, tmp_path: Path, pictures: list
) -> None:
    """White circles in coloured links, at the places of the elbow and the shoulder."""
    robodyn(*ARM, "--size", "6x6", "-o", tmp_path / "x.png").succeeds()
    pixels = pixels_of(tmp_path / "x.png")
    assert pixels.shape == (900, 900, 3)
    shown = pictures[0].frame
    assert (shown.right - shown.left) == pytest.approx(shown.top - shown.bottom)
    dots = 900 / (shown.right - shown.left)
    elbow = TWO_LINK.l1 * np.exp(1j * np.pi / 6)
    tip = elbow + TWO_LINK.l2 * np.exp(1j * np.radians(75))

    def colour(z: complex) -> np.ndarray:
        row, column = round((shown.top - z.imag) * dots), round((z.real - shown.left) * dots)
        return pixels[row, column]

    assert (colour(0) == 255).all()
    assert (colour(elbow) == 255).all()
    assert (colour(tip) < 60).all()  # a dark dot
    for middle, expected in ((0.7 * elbow, "#9ad0f3"), (elbow + 0.7 * (tip - elbow), "#f5c86e")):
        wanted = [int(expected[k : k + 2], 16) for k in (1, 3, 5)]
        assert np.abs(colour(middle) - wanted).max() <= 3
    for corner in pixels[0, 0], pixels[0, -1], pixels[-1, -1]:
        assert (corner == 255).all()


def test_nothing_is_clipped(robodyn: Run, tmp_path: Path, pictures: list) -> None:
    """A rim of white, and all texts inside."""
    for k, options in enumerate(
        [(*BAR, "--labels", "names"), (*BAR, "--qd", "5", "--forces"), (*ARM, "--size", "3x9")]
    ):
        robodyn(*options, "-o", tmp_path / "x.png").succeeds()
        pixels = pixels_of(tmp_path / "x.png")
        for rim in (pixels[:3], pixels[-3:], pixels[:, :3], pixels[:, -3:]):
            assert (rim == 255).all()
        picture = pictures[k]
        picture.figure.canvas.draw()
        for text in picture.axes.texts:
            box = text.get_window_extent()
            assert 0 <= box.x0 < box.x1 <= picture.figure.bbox.x1
            assert 0 <= box.y0 < box.y1 <= picture.figure.bbox.y1


def test_labels(robodyn: Run, tmp_path: Path, pictures: list) -> None:
    for options in ((), ("--labels", "names"), ("--labels", "numbers")):
        robodyn(*BAR, *options, "-o", tmp_path / "x.svg").succeeds()
    assert [texts(picture) for picture in pictures] == [
        [],
        ["crank", "coupler", "rocker"],
        ["1", "2", "3"],
    ]


def test_a_labels_size_is_foreseen(robodyn: Run, tmp_path: Path, pictures: list) -> None:
    robodyn(*BAR, "--labels", "names", "-o", tmp_path / "x.png").succeeds()
    picture = pictures[0]
    picture.figure.canvas.draw()
    for text in picture.axes.texts[1:]:
        box = text.get_window_extent()
        expected = picture.extent(text.get_text()) / picture.frame.scale * picture.figure.dpi
        assert box.width == pytest.approx(expected.real, rel=0.15)


def test_forces_are_those_of_reactions(robodyn: Run, tmp_path: Path, pictures: list) -> None:
    state = ("robots/four-bar.yaml", "--q", "60deg", "--qd", "5")
    robodyn("draw", *state, "--forces", "-o", tmp_path / "x.svg").succeeds()
    row = robodyn("reactions", *state).row
    expected = {f"r{k}": abs(complex(row[f"rx{k}"], row[f"ry{k}"])) for k in (1, 2, 3)}
    expected |= {f"m{k} g": m * 9.81 for k, m in ((1, 0.6), (2, 1.3), (3, 1.0))}
    expected["f1"] = abs(complex(row["fx1"], row["fy1"]))
    expected["tau1"] = abs(robodyn("torque", *state).row["tau1"])
    found = sizes(pictures[0])
    assert found.keys() == expected.keys()
    for name, size in expected.items():
        assert found[name] == pytest.approx(size, rel=6e-3)
    arrows = [a for a in pictures[0].axes.texts if a.get_text() == ""]
    assert len(arrows) == len(expected)


def test_forces_by_tau(robodyn: Run, tmp_path: Path, pictures: list) -> None:
    """The torque that torque finds makes the same forces as the accelerations."""
    state = ("draw", "robots/2r.yaml", "--q", "0.3,0.4", "--qd", "1,2", "--forces")
    tau = robodyn("torque", "robots/2r.yaml", "--q", "0.3,0.4", "--qd", "1,2").succeeds().out
    robodyn(*state, "-o", tmp_path / "x.svg").succeeds()
    robodyn(*state, "--tau", tau.splitlines()[1], "-o", tmp_path / "x.svg").succeeds()
    assert texts(pictures[0]) == texts(pictures[1])


def test_poses_of_a_table(robodyn: Run, tmp_path: Path, pictures: list) -> None:
    rows = "note,q1\n" + "".join(f"x,{angle}\n" for angle in np.linspace(0, 5, 40))
    slider = ("draw", "robots/slider-crank.yaml", "-", "-o", tmp_path / "x.svg")
    robodyn(*slider, "--poses", 5, stdin=rows).succeeds()
    q1 = pictures[0].drawn.q[:, 0]
    assert len(q1) == 5
    assert (q1[0], q1[-1]) == (0, 5)
    assert np.ptp(np.diff(q1)) < 0.3
    robodyn(*slider, stdin="q1\n2\n").succeeds()
    assert len(pictures[1].drawn.q) == 1
    robodyn(*slider, "--poses", 1, stdin=rows).succeeds()
    assert pictures[2].drawn.q[:, 0].tolist() == [5]


# What cannot be drawn


@pytest.mark.parametrize(
    "text",
    [
        "links: [{name: a, m: 1, l: 1e150, r: 0, I: 1}]",
        "links: [{name: a, m: 1, l: 1e-150, r: 0, I: 1}]",
        "links: [{name: a, m: 1, l: 1, r: 0, I: 1}]\n"
        "springs: [{between: [{link: a, at: [1e200, 0]}, [0, 1]], stiffness: 1, length: 1}]",
    ],
)
def test_what_is_too_large_or_too_small(robodyn: Run, scene: Run, text: str) -> None:
    robodyn("draw", scene(text), "--q", "0", "--format", "svg").fails(1, "cannot be drawn", "large")


def test_angles_whose_sum_is_no_number(robodyn: Run) -> None:
    draw = ("draw", "robots/2r.yaml", "--q=1e308,1e308", "--format", "svg")
    robodyn(*draw).fails(1, "cannot be drawn", "the angles are too large")


def test_a_pose_that_cannot_close(robodyn: Run, four_bar_text: str, scene: Run) -> None:
    path = scene(four_bar_text.replace("l: 0.80", "l: 0.01"))
    robodyn("draw", path, "--q", "60deg", "--format", "svg").fails(1, "cannot be closed")


def test_without_the_extra(robodyn: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(chart_figure, "find_spec", lambda name: None)
    robodyn(*ARM, "-o", tmp_path / "x.svg").fails(1, "pip install '.[plot]'")
    assert list(tmp_path.iterdir()) == []


def test_no_folder_of_matplotlib_stays_behind(shell: Run, tmp_path: Path) -> None:
    """Where it can keep nothing at home it makes one for temporary files, and warns."""
    home = dict.fromkeys(("XDG_CONFIG_HOME", "XDG_CACHE_HOME", "MPLCONFIGDIR"), "")
    home |= {"HOME": "/proc/none", "TMPDIR": str(tmp_path)}
    shell(f"robodyn draw robots/2r.yaml --q 0,1 -o {tmp_path}/x.png", env=home).succeeds()
    assert [path.name for path in tmp_path.iterdir()] == ["x.png"]


def test_the_users_settings_of_matplotlib_break_no_picture(shell: Run, tmp_path: Path) -> None:
    """A window that is not there, TeX that is not installed, effects that are none."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\npath.effects: 3\nfigure.dpi: 1e9\n")
    line = f"robodyn draw robots/2r.yaml --q 0,1 -o {tmp_path}"
    env = {"MPLBACKEND": "none such", "MATPLOTLIBRC": str(tmp_path / "matplotlibrc")}
    shell(f"{line}/x.png && env -u MPLBACKEND -u MATPLOTLIBRC {line}/y.png", env=env).succeeds()
    assert (tmp_path / "x.png").read_bytes() == (tmp_path / "y.png").read_bytes()


def test_the_pictures_of_the_readme_are_there_and_small() -> None:
    from documents import DOCUMENTS
    from PIL import Image

    named = set(re.findall(r"robots/pictures/[\w-]+\.png", "".join(DOCUMENTS.values())))
    assert {f"robots/pictures/{path.stem}.png" for path in ROOT.glob("robots/*.yaml")} <= named
    there = {str(path.relative_to(ROOT)) for path in ROOT.glob("robots/pictures/*")}
    assert named == there
    charts = {f"robots/pictures/{name}.png" for name in ("work-precision", "flip-map")}
    drawn = sorted(named - charts)
    assert sum((ROOT / path).stat().st_size for path in drawn) < 650_000
    for path in drawn:
        with Image.open(ROOT / path) as image:
            assert image.size == (960, 720)
            assert image.convert("RGB").getpixel((1, 1)) == (255, 255, 255)


def test_the_most_poses_are_named_in_the_help(robodyn: Run) -> None:
    shown = robodyn("draw", "--help").succeeds().out
    assert re.search(rf"\[default:\s+{draw.DEFAULT_POSES}\]", shown)


def test_settings_of_matplotlib_that_are_no_text(shell: Run, tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(bytes(range(256)))
    env = {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc")}
    shell(f"robodyn draw robots/2r.yaml --q 0,1 -o {tmp_path}/x.png", env=env).succeeds()


def test_settings_in_the_working_directory_that_are_no_text(shell: Run, tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(bytes(range(256)))
    outcome = shell("robodyn draw 2r --q 0,1 -o x.png", tmp_path)
    outcome.fails(2, "matplotlibrc: is no text in UTF-8")


def test_all_branches_side_by_side(robodyn: Run, pictures: list, tmp_path: Path) -> None:
    rows = robodyn("assemble", "robots/watt-six-bar.yaml", "--q", "60deg").succeeds().rows
    assert len(rows) > 1
    for suffix, first in FIRST.items():
        out = tmp_path / f"x{suffix}"
        pictures.clear()
        command = ("draw", "robots/watt-six-bar.yaml", "--q", "60deg", "--branches", "-o", out)
        robodyn(*command, "--of", "P=tip2").succeeds()
        assert out.read_bytes().startswith(first)
        titles = [text.get_text() for text in pictures[0].figure.texts]
        assert titles == [f"{k} {row['branch']}" for k, row in enumerate(rows, start=1)]
        assert len({picture.figure for picture in pictures}) == 1
        for picture, row in zip(pictures, rows, strict=True):
            cross = next(line for line in picture.axes.lines if line.get_marker() == "+")
            x, y = (float(each[0]) for each in cross.get_data())
            wanted = float(row["tip_x2"]), float(row["tip_y2"])
            assert (x, y) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--forces", "--q", "1"), "--forces"),
        (("--qd", "1", "--q", "1"), "--qd"),
        (("--poses", "3", "--q", "1"), "--poses"),
        (("states.csv",), "STATES"),
        ((), "--q"),
    ],
)
def test_what_does_not_go_with_branches(
    robodyn: Run, tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    given = robodyn("draw", "four-bar", *words, "--branches", "-o", tmp_path / "x.svg")
    assert given.code == 2
    assert f"Error: {told}" in given.err


def test_branches_make_no_gif(robodyn: Run, tmp_path: Path) -> None:
    out = tmp_path / "x.gif"
    given = robodyn("draw", "four-bar", "--q", "1", "--branches", "-o", out)
    assert given.code == 2
    assert "--out" in given.err
