"""`robodyn animate`: gifs in real time, pages that hold everything, films, and what is refused."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, RP_ARM, SCOTCH_YOKE, Outcome

import oracles
import robodyn
from robodyn.errors import InputError
from robodyn.pictures import animation_files, chart_figure
from robodyn.pictures.animation_files import FINER, durations, frames

Run = Callable[..., Outcome]
BAR = "robots/four-bar.yaml"
# a crank that turns evenly: t and the actuated joint alone
TURN = "t,q1\n" + "".join(f"{k / 10},{0.8 * k / 10}\n" for k in range(11))


def images(path: Path) -> list[tuple[np.ndarray, int]]:
    """The frames of a gif, with their milliseconds."""
    from PIL import Image, ImageSequence

    with Image.open(path) as gif:
        return [
            (np.asarray(frame.convert("RGB")).astype(int), frame.info["duration"])
            for frame in ImageSequence.Iterator(gif)
        ]


# gif


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ((), 26),
        (("--fps", "10"), 11),
        (("--fps", "15", "--speed", "0.5"), 31),
        (("--fps", "30"), 31),
    ],
)
def test_a_gif_lasts_as_long_as_the_motion(
    robodyn: Run, tmp_path: Path, options: tuple[str, ...], count: int
) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    from PIL import Image

    path = tmp_path / "x.gif"
    robodyn("animate", BAR, "-", "-o", path, "--size", "3x2", *options, stdin=TURN).succeeds()
    frames = images(path)
    assert len(frames) == count
    seconds = sum(time for _, time in frames) / 1000
    rate = float(options[1]) if options else 25.0
    speed = float(options[3]) if len(options) > 2 else 1.0
    assert seconds == pytest.approx(1 / speed + 1 / rate, abs=0.011)  # the last frame stays, too
    with Image.open(path) as gif:
        assert gif.size == (300, 200)
        assert gif.info["loop"] == 0
    assert [each.name for each in tmp_path.iterdir()] == ["x.gif"]


@pytest.mark.parametrize("rate", [7.0, 24.0, 25.0, 30.0, 48.0])
def test_durations_add_up(rate: float) -> None:
    found = durations(500, rate)
    assert all(time % 10 == 0 for time in found)
    assert np.abs(np.cumsum(found) - np.arange(1, 501) * 1000 / rate).max() <= 5.001
    assert np.ptp(found) <= 10


def test_what_a_frame_shows(robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At each frame the crank's pin, a white circle, is where the oracle has it."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    from robodyn.pictures import mechanism_picture as pictures

    kept = []
    begin = pictures.Picture.__init__
    monkeypatch.setattr(
        pictures.Picture, "__init__", lambda self, *a: begin(self, *a) or kept.append(self)
    )
    path = tmp_path / "x.gif"
    robodyn("animate", BAR, "-", "-o", path, "--fps", "10", "--trace", "coupler", stdin=TURN)
    shown = kept[0].frame
    trace = np.array([0xD5, 0x5E, 0x00])
    for k, (pixels, _) in enumerate(images(path)):
        dots = pixels.shape[1] / (shown.right - shown.left)
        q = oracles.four_bar_position(FOUR_BAR, 0.08 * k)
        A = FOUR_BAR.l1 * np.exp(1j * q[0])
        P = A + FOUR_BAR.l2 * np.exp(1j * (q[0] + q[1]))
        for z in (0, A, P, 1.1):
            row, column = (shown.top - z.imag) * dots, (z.real - shown.left) * dots
            assert (pixels[int(row), int(column)] >= 250).all()
        assert (pixels[0, 0] == 255).all()
        traced = (np.abs(pixels - trace).max(axis=-1) < 12).sum()
        assert (traced > 0) == (k > 1)


# html


class Page(HTMLParser):
    """The elements of a page, with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


def constant(page: str, name: str) -> object:
    """A constant of the page's script."""
    start = re.search(rf"\b{name} = ", page).end()
    return json.JSONDecoder().raw_decode(page, start)[0]


def page_of(robodyn: Run, path: Path, *options: object) -> str:
    robodyn("animate", BAR, "-", "-o", path, *options, stdin=TURN).succeeds()
    return path.read_text()


def test_a_page_holds_everything_in_itself(robodyn: Run, tmp_path: Path) -> None:
    text = page_of(robodyn, tmp_path / "x.html")
    page = Page(text)
    assert not re.search(r"https?:|//[a-z]|@import|url\(", text)
    for _, attributes in page.found:
        assert not {"src", "href"} & attributes.keys()
    assert {"svg", "script", "button", "input"} <= {tag for tag, _ in page.found}
    assert len(text) < 60_000


def test_angles_that_jump_are_refused_or_unwrapped(robodyn: Run, tmp_path: Path) -> None:
    """A wrapped angle would be drawn to run back by a whole turn from row to row."""
    rows = [(k / 5, 3.0 + 0.1 * k) for k in range(6)]
    plain, jumping = (
        "t,q1\n" + "".join(f"{t},{q - (turn if q > 3.15 else 0.0)!r}\n" for t, q in rows)
        for turn in (0.0, 2.0 * math.pi)
    )
    path = tmp_path / "x.html"
    command = ("animate", "robots/pendulum.yaml", "-", "-o", path, "--trace", "rod", "--fps", 20)
    told = "stdin: line 4: jump of q1 (rod) = 3.1 to -3.08319 rad: more than half a turn: --unwrap"
    robodyn(*command, stdin=jumping).fails(2, told)
    traces = []
    for more, table in (((), plain), (("--unwrap",), jumping)):
        robodyn(*command, *more, stdin=table).succeeds()
        (trace,) = constant(path.read_text(), "traces")
        traces.append(trace)
    assert traces[0] == traces[1]


def test_what_slides_goes_to_and_fro_on_a_page(
    robodyn: Run, scene: Callable[[str], Path], tmp_path: Path
) -> None:
    """By metres that are more than a turn of an angle, from row to row."""
    text = SCOTCH_YOKE.replace("l: 0.1", "l: 10").replace("0.3", "30")
    path, rows = tmp_path / "x.html", "t,q1\n0,0\n1,1.5\n2,3\n"
    arguments = ("animate", scene(text), "-", "--fps", 1, "--trace", "yoke", "-o", path)
    robodyn(*arguments, stdin=rows).succeeds()
    yoke = [30.0 + 10 * math.cos(angle) for angle in (0.0, 1.5, 3.0)]
    poses = constant(path.read_text(), "poses").values()
    found = [[(place[0], place[1]) for place in body] for body in poses]
    assert any(np.allclose(body, [(x, 0.0) for x in yoke], atol=1e-2) for body in found)
    (trace,) = constant(path.read_text(), "traces")
    ends = [float(place.split(",")[0]) for place in trace[::4]]
    assert ends == pytest.approx([x + 0.2 for x in yoke], abs=1e-2)


@pytest.mark.parametrize("text", [RP_ARM, SCOTCH_YOKE], ids=["arm", "yoke"])
def test_a_gif_of_what_slides(
    robodyn: Run, scene: Callable[[str], Path], tmp_path: Path, text: str
) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    path = tmp_path / "x.gif"
    rows = "t,q1,q2\n0,0,0\n0.2,0.3,0.1\n" if text == RP_ARM else "t,q1\n0,0\n0.2,0.7\n"
    arguments = ("animate", scene(text), "-", "--size", "3x2", "-o", path)
    robodyn(*arguments, stdin=rows).succeeds()
    frames = images(path)
    assert len(frames) == 6
    assert (frames[0][0] != frames[-1][0]).any()


def test_the_poses_of_a_page_are_those_of_the_motion(robodyn: Run, tmp_path: Path) -> None:
    text = page_of(robodyn, tmp_path / "x.html", "--trace", "coupler,centre3", "--fps", 20)
    poses, traces = constant(text, "poses"), constant(text, "traces")
    assert constant(text, "rate") == 20
    assert constant(text, "step") == 0.05
    assert sorted(poses) == sorted({g["data-b"] for g in Page(text).named("g") if "data-b" in g})
    crank, rocker, coupler = (poses[key] for key in sorted(poses, key=int))
    assert len(crank) == 21
    for k in range(21):
        q = oracles.four_bar_position(FOUR_BAR, 0.04 * k)
        A = FOUR_BAR.l1 * np.exp(1j * q[0])
        P = A + FOUR_BAR.l2 * np.exp(1j * (q[0] + q[1]))
        for pose, z, angle in (
            (crank[k], 0, q[0]),
            (coupler[k], A, q[0] + q[1]),
            (rocker[k], 1.1, q[2]),
        ):
            expected = [np.real(z), np.imag(z), np.cos(angle), np.sin(angle)]
            assert np.abs(np.array(pose) - expected).max() < 5e-4  # lines between the rows
        x, y = map(float, traces[0][4 * k].split(","))
        assert abs(complex(x, y) - P) < 5e-4
    assert len(Page(text).named("polyline")) == len(traces) == 2


def test_a_small_mechanism_keeps_its_digits(robodyn: Run, tmp_path: Path, scene: Run) -> None:
    model = scene("links: [{name: a, m: 1, l: 1.0e-6, r: 5.0e-7, I: 0}]")
    robodyn("animate", model, "-", "-o", tmp_path / "x.html", "--trace", "a", stdin=TURN).succeeds()
    traces = constant((tmp_path / "x.html").read_text(), "traces")
    x, y = map(float, traces[0][-1].split(","))
    assert abs(complex(x, y) - 1e-6 * np.exp(0.8j)) < 1e-9


def test_a_name_is_no_html(robodyn: Run, tmp_path: Path, four_bar_text: str, scene: Run) -> None:
    name = "crank-rocker four-bar"
    model = scene(four_bar_text.replace(f"name: {name}", "name: '<b>\"&</script>'"))
    robodyn("animate", model, "-", "-o", tmp_path / "x.html", stdin=TURN).succeeds()
    text = (tmp_path / "x.html").read_text()
    assert "<b>" not in text
    assert "&lt;b&gt;&quot;&amp;&lt;/script&gt;" in text


@pytest.mark.skipif(shutil.which("node") is None, reason="no JavaScript at hand")
def test_the_script_runs(robodyn: Run, tmp_path: Path) -> None:
    """Against a document of its own making: which frame is shown when."""
    text = page_of(robodyn, tmp_path / "x.html", "--fps", 10, "--trace", "coupler")
    script = re.search(r"<script>(.*)</script>", text, re.DOTALL)[1]
    stub = """
    const set = {setAttribute(name, value) { this[name] = value; }};
    const g = ["BODIES"].map(b => ({dataset: {b}, ...set})), p = {...set};
    const parts = {at: {}, play: {}, t: {}};
    globalThis.document = {
      querySelectorAll: s => s.startsWith("g") ? g : [p], getElementById: id => parts[id]};
    let next; globalThis.requestAnimationFrame = f => { next = f; };
    SCRIPT
    const told = () => console.log(
      [parts.at.value, parts.t.textContent, p.points.split(" ").length, parts.play.textContent]
      .join("|"));
    next(5000); told(); next(5350); told(); next(5000 + 1150); told();
    parts.play.onclick(); next(9000); told();
    parts.at.value = 7; parts.at.oninput(); told();
    parts.play.onclick(); next(9250); told();
    """
    stub = stub.replace("BODIES", '","'.join(constant(text, "poses"))).replace("SCRIPT", script)
    done = subprocess.run(["node", "-e", stub], capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        "0|t = 0.000 s|1|",
        "3|t = 0.300 s|13|",
        "0|t = 0.000 s|1|",  # eleven frames, and again
        "0|t = 0.000 s|1|play",
        "7|t = 0.700 s|29|play",
        "9|t = 0.900 s|37|pause",
    ]


def test_a_page_needs_no_extra(
    robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chart_figure, "find_spec", lambda name: None)
    page_of(robodyn, tmp_path / "x.html")
    robodyn("animate", BAR, "-", "-o", tmp_path / "x.gif", stdin=TURN).fails(
        1, "pip install '.[plot]'"
    )


# mp4


def test_a_film_takes_what_ffmpeg_makes(
    shell: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stand-in for ffmpeg counts the pictures that it is given."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\nfor last; do :; done\nwc -c > "$last"\necho "$@" >> "$last"\n')
    program.chmod(0o755)
    (tmp_path / "turn.csv").write_text(TURN)
    path = f"{program.parent}:{Path(os.sys.executable).parent}:{os.environ['PATH']}"
    film = tmp_path / "x.mp4"
    line = f"robodyn animate {BAR} {tmp_path / 'turn.csv'} -o {film} --size 3x2 --fps 20"
    shell(line, env={"PATH": path}).succeeds()
    size, arguments = film.read_text().splitlines()
    assert int(size) == 21 * 300 * 200 * 4
    assert "-framerate 20" in arguments
    film.write_text("older")
    program.write_text("#!/bin/sh\ncat > /dev/null\necho 'no such codec' >&2\nexit 3\n")
    shell(line, env={"PATH": path}).fails(1, "ffmpeg failed", str(film))
    assert film.read_text() == "older"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bin", "turn.csv", "x.mp4"]


def test_without_ffmpeg(robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    monkeypatch.setattr(animation_files.shutil, "which", lambda name: None)
    given = robodyn("animate", BAR, "-", "-o", tmp_path / "x.mp4", stdin=TURN)
    given.fails(1, "ffmpeg", ".gif and .html")
    assert list(tmp_path.iterdir()) == []


# Rows


def test_rows_of_simulate_and_torque(quick_shell: Run, tmp_path: Path) -> None:
    start = "robodyn simulate robots/2r.yaml --q 1,0 --time 0.2 --quiet"
    for k, line in enumerate([start, f"{start} | robodyn torque robots/2r.yaml -"]):
        out = tmp_path / f"{k}.html"
        done = quick_shell(f"{line} | robodyn animate robots/2r.yaml - --trace tip2 -o {out}")
        assert done.code == 0, done.err
    assert (tmp_path / "0.html").read_bytes() == (tmp_path / "1.html").read_bytes()


def test_a_progress_bar_is_for_terminals(robodyn: Run, tmp_path: Path) -> None:
    given = robodyn("animate", BAR, "-", "-o", tmp_path / "x.html", stdin=TURN)
    assert (given.code, given.out, given.err) == (0, "", "")


# Frames of a motion in time: where they lie, between rows, and what is traced.


ARM = robodyn.load(ROOT / "robots/2r.yaml")
FOUR = robodyn.load(ROOT / "robots/four-bar.yaml")


def cubic(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q and qd that are polynomials of degree 3: Hermite's cubic must meet them exactly."""
    q = np.stack([1 - t + t**3, 0.5 * t**2 - 0.2 * t**3], axis=-1)
    return q, np.stack([-1 + 3 * t**2, t - 0.6 * t**2], axis=-1)


@pytest.mark.parametrize("speed", [1.0, 0.25, 3.0])
@pytest.mark.parametrize("rate", [25.0, 30.0, 7.5])
def test_frames_lie_in_real_time(rate: float, speed: float) -> None:
    t = np.array([0.5, 0.7, 1.6, 2.5])
    found = frames(ARM, t, *cubic(t), rate, speed)
    assert found.t[0] == 0.5
    assert np.allclose(np.diff(found.t), speed / rate)
    assert 0 <= 2.5 - found.t[-1] < speed / rate + 1e-9
    assert found.q.shape == (len(found.t), 2)


def test_between_rows_q_is_a_cubic_by_qd() -> None:
    t = np.array([0.0, 0.3, 1.1, 2.0])
    found = frames(ARM, t, *cubic(t), 40.0, 1.0)
    assert np.allclose(found.q, cubic(found.t)[0], atol=1e-13)
    fine = np.arange(len(found.fine)) / 40.0 / FINER
    assert np.allclose(found.fine, cubic(fine)[0], atol=1e-13)
    assert np.array_equal(found.fine[::FINER], found.q)


def test_without_qd_it_is_a_line() -> None:
    t, q = np.array([0.0, 1.0, 3.0]), np.array([[0.0, 0], [1, -2], [5, 0]])
    found = frames(ARM, t, q, None, 2.0, 1.0)
    assert np.allclose(found.q[:, 0], [0, 0.5, 1, 2, 3, 4, 5])
    assert np.allclose(found.q[:, 1], [0, -1, -2, -1.5, -1, -0.5, 0])


def test_a_motion_that_runs_backwards_is_shown_forwards() -> None:
    t = np.linspace(0, -2, 9)
    found = frames(ARM, t, *cubic(t), 10.0, 1.0)
    assert (found.t[0], found.t[-1]) == (-2.0, pytest.approx(0.0))
    assert np.allclose(found.q, cubic(found.t)[0], atol=1e-13)


def test_loops_are_closed_between_rows() -> None:
    theta = np.linspace(0, 6, 13)
    q = np.unwrap(robodyn.assemble(FOUR, theta[:, None]), axis=0)
    assert np.abs(np.diff(q, axis=0)).max() < np.pi
    found = frames(FOUR, theta, q, None, 20.0, 1.0)
    assert np.abs(robodyn.closure_gap(FOUR, found.fine)).max() < 1e-12
    for pose in found.q[::7]:
        expected = oracles.four_bar_position(FOUR_BAR, pose[0])
        assert np.allclose(np.exp(1j * pose), np.exp(1j * np.array(expected)), atol=1e-9)


@pytest.mark.parametrize(
    ("t", "parts"),
    [
        ([0.0], ("rows = 1", "two or more")),
        ([0.0, 1, 1], ("t = 1", "differ from 1")),
        ([0.0, 1, 0.5, 2], ("t = 0.5",)),
        ([2.0, 1, 1.5, 0], ("t = 1",)),
        ([0.0, 1e9], ("frames", "at most")),
    ],
)
def test_what_has_no_frames(t: list[float], parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        frames(ARM, np.array(t), np.zeros((len(t), 2)), None, 25.0, 1.0)
    for part in parts:
        assert part in str(caught.value)


# Traced points
