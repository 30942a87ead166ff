"""Animations as files: gif and mp4, drawn by matplotlib (the extra `plot`), and html pages."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from html import escape
from io import BytesIO
from itertools import groupby
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import numpy as np

from robodyn.cli.pictures import FONT, FOOT, LONGEST, STYLES, Picture, style_of
from robodyn.errors import RobodynError
from robodyn.pictures.colour_scale import COLOURS
from robodyn.pictures.drawing import Drawing
from robodyn.pictures.motion_frames import FINER, Frames, time_decimals
from robodyn.pictures.outlines import Shape
from robodyn.pictures.picture_plan import frame, scale_bar, scale_bar_line
from robodyn.tables.output_file import open_output

DOTS = 100  # an inch
COLOURS_OF_GIF = 128
APART = 8  # of 255, of two of them
DIGITS = 4  # of coordinates, in powers of ten below the width of the picture
PIXELS = 100  # an inch
BEHIND = 2.9  # the height of traces, below that of links

Watch = Callable[[float], object]  # the part that is done


class Film(Picture):
    """A picture that is moved from frame to frame, with the paths of traced points behind it.

    t (T,) are the times of the frames, s; each of the traces has FINER points from frame to frame.
    """

    def __init__(
        self,
        drawn: Drawing,
        t: np.ndarray,
        traces: Sequence[np.ndarray],
        size: tuple[float, float] | None,
    ) -> None:
        super().__init__(drawn, size)
        self.figure.set_dpi(DOTS)
        self.count, self._t, self._traces = len(drawn.q), t, traces
        self._lines = [
            self.axes.plot([], [], color=COLOURS[(k + 1) % len(COLOURS)], lw=1.3, zorder=2.5)[0]
            for k in range(len(traces))
        ]
        inch = self.frame.scale
        place = self.frame.right - 0.12 * inch, self.frame.bottom + 0.1 * inch
        self._time = self.axes.text(*place, "", ha="right", fontsize=FONT, color="#555555")
        self._decimals = time_decimals(t)

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
    """A gif that repeats, all frames with one palette."""
    from PIL import Image

    some = [np.asarray(film.image(pose)) for pose in {0, film.count // 2, film.count - 1}]
    sample: Any = Image.fromarray(np.concatenate(some))
    alike: dict[tuple[int, ...], tuple[int, ...]] = {}  # which Pillow would mix up
    for _, colour in sorted(sample.getcolors(sample.width * sample.height), reverse=True):
        alike.setdefault(tuple(part // APART for part in colour), colour)
    palette = Image.new("P", (1, 1))
    palette.putpalette([part for colour in [*alike.values()][:COLOURS_OF_GIF] for part in colour])

    def images() -> Iterator[Any]:
        for pose in range(film.count):
            watch(pose / film.count)
            yield film.image(pose).quantize(palette=palette, dither=0)

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


def write_page(
    drawn: Drawing,
    shown: Frames,
    speed: float,
    traces: Sequence[np.ndarray],
    size: tuple[float, float] | None,
    out: str,
) -> None:
    """Shapes as svg, each body moved by a matrix a frame."""
    view = frame(drawn.box(), LONGEST, size, FOOT)
    wide, high = view.right - view.left, view.top - view.bottom
    decimals = DIGITS - math.floor(math.log10(wide))
    parts = [
        (STYLES[shape.kind]["zorder"] + 0.01 * b, b, _path(shape, drawn.bodies[b].link))
        for b, body in enumerate(drawn.bodies)
        for shape in body.shapes
    ]
    for k in range(len(traces)):
        stroke = f'stroke="{COLOURS[(k + 1) % len(COLOURS)]}" stroke-width="1.6"'
        parts.append((BEHIND, -1, f'<polyline fill="none" {stroke}/>'))
    groups = []
    moving = [b for b, body in enumerate(drawn.bodies) if body.link is not None or body.end]
    ordered = sorted(parts, key=lambda part: part[:2])
    for b, paths in groupby(ordered, lambda part: part[1]):
        data = f' data-b="{b}"' if b in moving else ""
        groups.append(f"<g{data}>{''.join(path for _, _, path in paths)}</g>")
    bar, text = Shape("scale bar", scale_bar_line(view), False), scale_bar(view)[1]
    z, tall = bar.points[2] + 0.06 * view.scale, 0.12 * view.scale
    place = f'transform="matrix(1 0 0 -1 {z.real:.6g} {z.imag:.6g})" font-size="{tall:.6g}"'
    poses = {
        str(b): [
            [round(z.real, decimals), round(z.imag, decimals), round(e.real, 5), round(e.imag, 5)]
            for z, e in zip(drawn.place[:, b].tolist(), drawn.turn[:, b].tolist(), strict=True)
        ]
        for b in moving
    }
    rounded = [np.column_stack([z.real, z.imag]).round(decimals) for z in traces]
    page = PAGE.format(
        title=escape(drawn.mechanism.name),
        width=round(view.width * PIXELS),
        view=f"{view.left:.6g} {-view.top:.6g} {wide:.6g} {high:.6g}",
        shapes="\n".join([*groups, _path(bar, None), f'<text {place} fill="#555">{text}</text>']),
        last=len(shown.t) - 1,
        count=len(shown.t),
        poses=json.dumps(poses, separators=(",", ":")),
        traces=json.dumps([[f"{x:.10g},{y:.10g}" for x, y in z.tolist()] for z in rounded]),
        finer=FINER,
        rate=repr(shown.rate),
        begin=repr(float(shown.t[0])),
        step=repr(speed / shown.rate),
        decimals=time_decimals(shown.t),
    )
    with open_output(out) as stream:
        stream.write(page.encode())


def _path(shape: Shape, link: int | None) -> str:
    """A shape in the frame of its body."""
    style = style_of(shape.kind, shape.closed, link)
    points = "L".join(f"{z.real:.6g} {z.imag:.6g}" for z in shape.points.tolist())
    dashes = ' stroke-dasharray="8 3 1 3"' if "linestyle" in style else ""
    return (
        f'<path d="M{points}{"Z" if shape.closed else ""}" fill="{style["facecolor"]}"'
        f' stroke="{style["edgecolor"]}" stroke-width="{1.3 * style["linewidth"]:.3g}"{dashes}/>'
    )
