"""Animations as files: gif and mp4, drawn by matplotlib (the extra `plot`), and html pages."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from html import escape
from io import BytesIO
from itertools import groupby
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any, NamedTuple, Self

import numpy as np

from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics.named_points import NamedPoint
from robodyn.errors import InputError, RobodynError
from robodyn.loops.closing import close_positions
from robodyn.mechanics.mechanism import Mechanism
from robodyn.pictures.chart_figure import check_matplotlib
from robodyn.pictures.drawing import Drawing, Shape, drawing, traced
from robodyn.pictures.mechanism_picture import (
    FONT,
    FOOT,
    LONGEST,
    STYLES,
    Frame,
    Picture,
    Size,
    frame,
    scale_bar,
    scale_bar_line,
    style_of,
)
from robodyn.pictures.value_map import COLOURS
from robodyn.tables.arrays import Array
from robodyn.tables.output_file import open_output, write_text

MOST_FRAMES = 20_000
FINER = 4  # points of a trace from frame to frame


class Frames(NamedTuple):
    """Times of the motion (T,), s, the closed configurations there (T, n), and frames a second.

    `fine` (FINER (T - 1) + 1, n) are those and configurations between them, for smooth traces.
    """

    t: Array
    q: Array
    rate: float
    fine: Array


def frames(
    mechanism: Mechanism, t: Array, q: Array, qd: Array | None, rate: float, speed: float
) -> Frames:
    """The motion of the rows t (R,), q and qd (R, n) at `rate` frames a second of watching.

    `speed` seconds of the motion pass in one of watching.  Between rows q is a cubic where qd is
    given, else linear, and is closed again.  Rows that run backwards are shown forwards.  Raises
    InputError where the times do not rise or fall throughout, and for too many frames.
    """
    if len(t) < 2:
        raise InputError("rows", value=len(t), limit="a motion needs two or more")
    if t[-1] < t[0]:
        t, q, qd = t[::-1], q[::-1], None if qd is None else qd[::-1]
    steps = np.diff(t)
    if not (steps > 0.0).all():
        row = int(np.argmax(steps <= 0.0))
        limit = f"must differ from {t[row]:.9g} before it, and all must rise, or all fall"
        raise InputError("t", value=f"{t[row + 1]:.9g}", limit=limit)
    count = (t[-1] - t[0]) / speed * rate
    if not count < MOST_FRAMES:
        raise InputError("frames", value=f"{count:.6g}", limit=f"must be at most {MOST_FRAMES}")
    shown = int(count + 1e-9) + 1
    times = t[0] + np.arange(FINER * (shown - 1) + 1) * (speed / rate / FINER)
    inside = np.minimum(times, t[-1])
    if qd is None:
        between = np.stack([np.interp(inside, t, angle) for angle in q.T], axis=-1)
    else:
        between = ReferenceTable(t, q, qd).at(inside)[0]
    fine = close_positions(mechanism, between, t=inside)
    return Frames(times[::FINER], fine[::FINER], rate, fine)


def time_decimals(t: Array) -> int:
    """Decimals of a second that tell two hundred times of t apart."""
    return max(0, min(4, math.ceil(-math.log10((t[-1] - t[0]) / 200.0)))) if t[-1] > t[0] else 2


DOTS = 100  # an inch
DIGITS = 4  # of coordinates, in powers of ten below the width of the picture
BEHIND = 2.9  # the height of traces, below that of links

FASTEST = {".gif": 50.0, ".mp4": 240.0, ".html": 240.0}  # browsers slow down faster gifs
Traces = Sequence[np.ndarray]  # each has FINER points from frame to frame
Watch = Callable[[float], object]  # the part that is done


def check_animation(out: str, fps: float, speed: float) -> None:
    """Raise InputError, before the work, for values that no animation has."""
    suffix = Path(out).suffix.lower()
    if suffix not in FASTEST:
        raise InputError("out", value=out, limit=f"must end in {', '.join(FASTEST)}")
    if not 0.0 < fps <= FASTEST[suffix]:
        limit = f"must be > 0 and at most {FASTEST[suffix]:g} in a {suffix[1:]}"
        raise InputError("fps", value=fps, limit=limit)
    if not 0.0 < speed < float("inf"):
        raise InputError("speed", value=speed, limit="must be > 0 and finite")


def check_programs(out: str) -> None:
    """Raise RobodynError where what writes such a file is not there."""
    suffix = Path(out).suffix.lower()
    if suffix != ".html":
        check_matplotlib(f"an animation ({suffix[1:]})")
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        limit = "needs the program ffmpeg, which is not on the path; .gif and .html do not"
        raise RobodynError("an animation (mp4)", limit=limit)


@dataclass(frozen=True, repr=False)
class MovingPicture:
    """A motion as a moving picture: bodies at frames, `speed` s of it in one, and paths behind."""

    drawn: Drawing
    frames: Frames
    speed: float
    traces: Traces
    size: Size = None

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        shown: Frames,
        speed: float,
        points: Sequence[NamedPoint],
        size: Size,
    ) -> Self:
        """Return the moving picture of a mechanism's frames, with the paths of points."""
        paths = [path for _, path in traced(mechanism, points, shown.fine)]
        return cls(drawing(mechanism, shown.q, points), shown, speed, paths, size)

    def write(self, out: str, watched: Callable[[], AbstractContextManager[Watch]]) -> None:
        """Write it as the suffix of `out` says; gif and mp4, which take time, are watched."""
        suffix = Path(out).suffix.lower()
        if suffix == ".html":
            write_text(page(self), out)
            return
        film = Film(self)
        write = write_gif if suffix == ".gif" else write_mp4
        with watched() as watch:
            write(film, self.frames.rate, out, watch)


class Film(Picture):
    """A picture that is moved from frame to frame, with the paths of traced points behind it."""

    def __init__(self, shown: MovingPicture) -> None:
        super().__init__(shown.drawn, shown.size)
        self.figure.set_dpi(DOTS)
        self.count, self._t, self._traces = len(shown.drawn.q), shown.frames.t, shown.traces
        self._lines = [
            self.axes.plot([], [], color=COLOURS[(k + 1) % len(COLOURS)], lw=1.3, zorder=2.5)[0]
            for k in range(len(self._traces))
        ]
        inch = self.frame.scale
        place = self.frame.right - 0.12 * inch, self.frame.bottom + 0.1 * inch
        self._time = self.axes.text(*place, "", ha="right", fontsize=FONT, color="#555555")
        self._decimals = time_decimals(self._t)

    def show(self, pose: int) -> None:
        super().show(pose)
        for line, z in zip(self._lines, self._traces, strict=True):
            end = FINER * pose + 1
            line.set_data(z.real[:end], z.imag[:end])
        self._time.set_text(f"t = {self._t[pose]:.{self._decimals}f} s")

    def image(self, pose: int) -> Any:
        from PIL import Image

        self.show(pose)
        self.figure.canvas.draw()
        return Image.fromarray(np.asarray(self.figure.canvas.buffer_rgba())[..., :3])


def durations(count: int, rate: float) -> list[int]:
    """Milliseconds of each frame, as gif has them in steps of 10, that keep real time in sum."""
    ends = np.round(100.0 / rate * np.arange(count + 1)).astype(int)
    return [int(10 * step) for step in np.diff(ends)]


def write_gif(film: Film, rate: float, out: str, watch: Watch) -> None:
    """Write a gif that repeats."""
    from PIL import Image

    def images() -> Iterator[Any]:
        for pose in range(film.count):
            watch(pose / film.count)
            yield film.image(pose).quantize(method=Image.Quantize.MAXCOVERAGE)

    each, drawn = images(), BytesIO()  # Pillow's own writing tells no reason where it fails
    with open_output(out) as stream:
        times = {"duration": durations(film.count, rate), "loop": 0}
        next(each).save(drawn, format="GIF", save_all=True, append_images=each, **times)
        stream.write(drawn.getbuffer())


def write_mp4(film: Film, rate: float, out: str, watch: Watch) -> None:
    from matplotlib.animation import FFMpegWriter

    with tempfile.TemporaryDirectory() as directory, open_output(out) as stream:
        path = Path(directory) / "film.mp4"
        writer: Any = FFMpegWriter(fps=rate)  # type: ignore[arg-type]  # need not be whole
        try:
            with writer.saving(film.figure, str(path), DOTS):
                for pose in range(film.count):
                    watch(pose / film.count)
                    film.show(pose)
                    writer.grab_frame()
            stream.write(path.read_bytes())
        except (CalledProcessError, OSError) as error:
            told = getattr(error, "stderr", None) or getattr(error, "output", None) or str(error)
            text = told.decode(errors="replace") if isinstance(told, bytes) else str(told)
            last = (text.strip().splitlines() or ["no reason told"])[-1]
            raise RobodynError("ffmpeg failed", where=out, limit=last) from None


PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ margin: 1em auto; max-width: {width}px; font: 14px sans-serif; color: #222 }}
svg {{ width: 100%; display: block }}
path, polyline {{ stroke-linejoin: round; vector-effect: non-scaling-stroke }}
form {{ display: flex; gap: 1em; align-items: center }}
input {{ flex: 1 }}
output {{ min-width: 7em; text-align: right }}
</style>
<svg viewBox="{view}" role="img" aria-label="{title}">
<g transform="scale(1 -1)">
{shapes}
</g>
</svg>
<form onsubmit="return false">
<button id="play" type="button">pause</button>
<input id="at" type="range" min="0" max="{last}" value="0" aria-label="frame">
<output id="t"></output>
</form>
<script>
const poses = {poses}, traces = {traces}, rate = {rate}, begin = {begin}, step = {step};
const bodies = document.querySelectorAll("g[data-b]");
const lines = document.querySelectorAll("polyline");
const at = document.getElementById("at"), play = document.getElementById("play");
let running = true, offset = 0, now = 0;
function show(k) {{
  bodies.forEach(g => {{
    const [x, y, c, s] = poses[g.dataset.b][k], h = Math.hypot(c, s);
    g.setAttribute("transform", `matrix(${{c}} ${{s}} ${{-s / h}} ${{c / h}} ${{x}} ${{y}})`);
  }});
  lines.forEach((p, i) => p.setAttribute("points", traces[i].slice(0, {finer} * k + 1).join(" ")));
  document.getElementById("t").textContent = `t = ${{(begin + k * step).toFixed({decimals})}} s`;
  at.value = k;
}}
function tick(time) {{
  now = time;
  if (running) show(Math.floor((time - offset) / 1000 * rate) % {count});
  requestAnimationFrame(tick);
}}
function run(yes) {{
  running = yes;
  play.textContent = yes ? "pause" : "play";
  if (yes) offset = now - 1000 * at.value / rate;
}}
play.onclick = () => run(!running);
at.oninput = () => {{ run(false); show(+at.value); }};
show(0);
requestAnimationFrame(time => {{ offset = now = time; tick(time); }});
</script>
</html>
"""


def page(shown: MovingPicture) -> str:
    """Shapes as svg in a page of html, each body moved by a matrix a frame."""
    drawn, t, rate = shown.drawn, shown.frames.t, shown.frames.rate
    view = frame(drawn.box(), LONGEST, shown.size, FOOT)
    decimals = DIGITS - math.floor(math.log10(view.right - view.left))
    moving = _moving(drawn)
    poses = {
        str(b): [
            [round(z.real, decimals), round(z.imag, decimals), round(e.real, 5), round(e.imag, 5)]
            for z, e in zip(drawn.place[:, b].tolist(), drawn.turn[:, b].tolist(), strict=True)
        ]
        for b in moving
    }
    rounded = [np.column_stack([z.real, z.imag]).round(decimals) for z in shown.traces]
    return PAGE.format(
        title=escape(drawn.mechanism.name),
        width=round(view.width * DOTS),
        view=_view_box(view),
        shapes=_shapes(drawn, view, {b: f' data-b="{b}"' for b in moving}, len(shown.traces)),
        last=len(t) - 1,
        count=len(t),
        poses=json.dumps(poses, separators=(",", ":")),
        traces=json.dumps([[f"{x:.10g},{y:.10g}" for x, y in z.tolist()] for z in rounded]),
        finer=FINER,
        rate=repr(rate),
        begin=repr(float(t[0])),
        step=repr(shown.speed / rate),
        decimals=time_decimals(t),
    )


def svg(drawn: Drawing, width: int) -> str:
    """The first pose of a drawing as an image of so many pixels for a page of html."""
    view = frame(drawn.box(), LONGEST, None, FOOT)
    moves = {}
    for b in _moving(drawn):
        z, e = drawn.place[0, b], drawn.turn[0, b]
        up = 1j * e / abs(e)  # springs are stretched along x alone
        numbers = " ".join(f"{x:.6g}" for y in (e, up, z) for x in (y.real, y.imag))
        moves[b] = f' transform="matrix({numbers})"'
    lines = 'stroke-linejoin="round" vector-effect="non-scaling-stroke"'
    shapes = _shapes(drawn, view, moves, 0).replace("<path ", f"<path {lines} ")
    name = escape(drawn.mechanism.name, quote=True)
    return (
        f'<svg viewBox="{_view_box(view)}" width="{width}" role="img" aria-label="{name}">'
        f'<g transform="scale(1 -1)">{shapes}</g></svg>'
    )


def _moving(drawn: Drawing) -> list[int]:
    """The bodies that do not stay where they are."""
    return [b for b, body in enumerate(drawn.bodies) if body.link is not None or body.end]


def _view_box(view: Frame) -> str:
    wide, high = view.right - view.left, view.top - view.bottom
    return f"{view.left:.6g} {-view.top:.6g} {wide:.6g} {high:.6g}"


def _shapes(drawn: Drawing, view: Frame, moves: Mapping[int, str], traces: int) -> str:
    """The shapes, those of a body in a group with what moves it, traces, and the scale bar."""
    parts = [
        (STYLES[shape.kind]["zorder"] + 0.01 * b, b, _path(shape, drawn.bodies[b].link))
        for b, body in enumerate(drawn.bodies)
        for shape in body.shapes
    ]
    for k in range(traces):
        stroke = f'stroke="{COLOURS[(k + 1) % len(COLOURS)]}" stroke-width="1.6"'
        parts.append((BEHIND, -1, f'<polyline fill="none" {stroke}/>'))
    ordered = sorted(parts, key=lambda part: part[:2])
    groups = [
        f"<g{moves.get(b, '')}>{''.join(path for _, _, path in paths)}</g>"
        for b, paths in groupby(ordered, lambda part: part[1])
    ]
    bar, text = Shape("scale bar", scale_bar_line(view), False), scale_bar(view)[1]
    z, tall = bar.points[2] + 0.06 * view.scale, 0.12 * view.scale
    place = f'transform="matrix(1 0 0 -1 {z.real:.6g} {z.imag:.6g})" font-size="{tall:.6g}"'
    return "\n".join([*groups, _path(bar, None), f'<text {place} fill="#555">{text}</text>'])


def _path(shape: Shape, link: int | None) -> str:
    """A shape in the frame of its body."""
    style = style_of(shape.kind, shape.closed, link)
    points = "L".join(f"{z.real:.6g} {z.imag:.6g}" for z in shape.points.tolist())
    dashes = ' stroke-dasharray="8 3 1 3"' if "linestyle" in style else ""
    return (
        f'<path d="M{points}{"Z" if shape.closed else ""}" fill="{style["facecolor"]}"'
        f' stroke="{style["edgecolor"]}" stroke-width="{1.3 * style["linewidth"]:.3g}"{dashes}/>'
    )
