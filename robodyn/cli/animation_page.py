"""An animation as one html page that holds everything in itself."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from itertools import groupby

import numpy as np

from robodyn.cli.pictures import FOOT, LONGEST, STYLES, style_of
from robodyn.pictures.bodies import Shape
from robodyn.pictures.colour_scale import COLOURS
from robodyn.pictures.drawing import Drawing
from robodyn.pictures.motion_frames import FINER, Frames, time_decimals
from robodyn.pictures.picture_plan import frame, scale_bar, scale_bar_line
from robodyn.tables.output_file import open_output

DIGITS = 4  # of coordinates, in powers of ten below the width of the picture
PIXELS = 100  # an inch
BEHIND = 2.9  # the height of traces, below that of links

PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ margin: 1em auto; max-width: {width}px; font: 14px sans-serif }}
body {{ color: #222; background: #fff }}
svg {{ width: 100%; display: block }}
path, polyline {{ stroke-linejoin: round; stroke-linecap: round }}
path, polyline {{ vector-effect: non-scaling-stroke }}
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
    moving = [b for b, body in enumerate(drawn.bodies) if body.moves]
    ordered = sorted(parts, key=lambda part: part[:2])
    for b, paths in groupby(ordered, lambda part: part[1]):
        data = f' data-b="{b}"' if b in moving else ""
        groups.append(f"<g{data}>{''.join(path for _, _, path in paths)}</g>")
    bar, text = Shape("scale bar", scale_bar_line(view), False), scale_bar(view)[1]
    z, tall = bar.points[2] + 0.06 * view.scale, 0.12 * view.scale
    place = f'transform="matrix(1 0 0 -1 {z.real:.6g} {z.imag:.6g})" font-size="{tall:.6g}"'
    poses = {
        str(b): [
            [round(x, decimals) for x in (z.real, z.imag)] + [round(x, 5) for x in (e.real, e.imag)]
            for z, e in zip(drawn.place[:, b].tolist(), drawn.turn[:, b].tolist(), strict=True)
        ]
        for b in moving
    }
    page = PAGE.format(
        title=escape(drawn.mechanism.name),
        width=round(view.width * PIXELS),
        view=f"{view.left:.6g} {-view.top:.6g} {wide:.6g} {high:.6g}",
        shapes="\n".join([*groups, _path(bar, None), f'<text {place} fill="#555">{text}</text>']),
        last=len(shown.t) - 1,
        count=len(shown.t),
        poses=json.dumps(poses, separators=(",", ":")),
        traces=json.dumps([[_pair(p, decimals) for p in z.tolist()] for z in traces]),
        finer=FINER,
        rate=repr(shown.rate),
        begin=repr(float(shown.t[0])),
        step=repr(speed / shown.rate),
        decimals=time_decimals(shown.t),
    )
    with open_output(out) as stream:
        stream.write(page.encode())


def _pair(point: complex, decimals: int) -> str:
    return f"{round(point.real, decimals):.10g},{round(point.imag, decimals):.10g}"


def _path(shape: Shape, link: int | None) -> str:
    """A shape in the frame of its body."""
    style = style_of(shape.kind, shape.closed, link)
    points = "L".join(f"{z.real:.6g} {z.imag:.6g}" for z in shape.points.tolist())
    dashes = ' stroke-dasharray="8 3 1 3"' if "linestyle" in style else ""
    return (
        f'<path d="M{points}{"Z" if shape.closed else ""}" fill="{style["facecolor"]}"'
        f' stroke="{style["edgecolor"]}" stroke-width="{1.3 * style["linewidth"]:.3g}"{dashes}/>'
    )
