"""An animation as one html page that holds everything in itself."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from itertools import groupby

import numpy as np

from robodyn.cli.pictures import LINK_COLOURS, LONGEST, STYLES
from robodyn.pictures.colour_scale import COLOURS
from robodyn.pictures.drawing import Drawing
from robodyn.pictures.motion_frames import FINER, Frames, time_decimals
from robodyn.pictures.outlines import Shape
from robodyn.pictures.picture_plan import Frame, frame, scale_bar
from robodyn.tables.output_file import open_output

DIGITS = 4  # of coordinates, in powers of ten below the width of the picture
PIXELS = 100  # an inch
LINKS = STYLES["link"]["zorder"]  # traces lie behind what is as high as this

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
    view = frame(drawn.box(), LONGEST, size, 0.3)
    step = speed / shown.rate
    decimals = DIGITS - math.floor(math.log10(view.right - view.left))
    lines = [
        f'<polyline fill="none" stroke="{COLOURS[(k + 1) % len(COLOURS)]}" stroke-width="1.6"/>'
        for k in range(len(traces))
    ]
    ordered = sorted(
        (STYLES[shape.kind]["zorder"] + 0.01 * b, b, _path(drawn, b, shape))
        for b, body in enumerate(drawn.bodies)
        for shape in body.shapes
    )
    moving = [b for b, body in enumerate(drawn.bodies) if body.moves]
    groups = []
    for (b, in_front), paths in groupby(ordered, lambda item: (item[1], item[0] >= LINKS)):
        content = "".join(path for _, _, path in paths)
        still = b not in moving
        groups.append(
            (in_front, f"<g>{content}</g>" if still else f'<g data-b="{b}">{content}</g>')
        )
    behind = [text for in_front, text in groups if not in_front]
    front = [text for in_front, text in groups if in_front]
    poses = {
        str(b): [
            [round(x, decimals) for x in (z.real, z.imag)] + [round(x, 5) for x in (e.real, e.imag)]
            for z, e in zip(drawn.place[:, b].tolist(), drawn.turn[:, b].tolist(), strict=True)
        ]
        for b in moving
    }
    scale = _scale_bar(view)
    page = PAGE.format(
        title=escape(drawn.mechanism.name),
        width=round(view.width * PIXELS),
        view=f"{view.left:.6g} {-view.top:.6g} {view.right - view.left:.6g} "
        f"{view.top - view.bottom:.6g}",
        shapes="\n".join([*behind, *lines, *front, scale]),
        last=len(shown.t) - 1,
        count=len(shown.t),
        poses=json.dumps(poses, separators=(",", ":")),
        traces=json.dumps([[_pair(p, decimals) for p in z.tolist()] for z in traces]),
        finer=FINER,
        rate=repr(shown.rate),
        begin=repr(float(shown.t[0])),
        step=repr(step),
        decimals=time_decimals(shown.t),
    )
    with open_output(out) as stream:
        stream.write(page.encode())


def _scale_bar(view: Frame) -> str:
    length, text = scale_bar(view)
    inch = view.scale
    x, y, tick = view.left + 0.14 * inch, view.bottom + 0.14 * inch, 0.06 * inch
    return (
        f'<path d="M{x:.6g} {y + tick:.6g}v{-tick:.6g}h{length:.6g}v{tick:.6g}" fill="none"'
        ' stroke="#555" stroke-width="1"/>'
        f'<text transform="matrix(1 0 0 -1 {x + length + tick:.6g} {y:.6g})"'
        f' font-size="{2 * tick:.6g}" fill="#555">{text}</text>'
    )


def _pair(point: complex, decimals: int) -> str:
    return f"{round(point.real, decimals):.10g},{round(point.imag, decimals):.10g}"


def _path(drawn: Drawing, b: int, shape: Shape) -> str:
    """A shape in the frame of its body."""
    style = STYLES[shape.kind]
    link = drawn.bodies[b].link or 0
    fill = style.get("facecolor", "none")
    if shape.kind in ("link", "block"):
        fill = LINK_COLOURS[link % len(LINK_COLOURS)]
    if not shape.closed:
        fill = "none"
    points = "L".join(f"{z.real:.6g} {z.imag:.6g}" for z in shape.points.tolist())
    dashes = ' stroke-dasharray="8 3 1 3"' if "linestyle" in style else ""
    return (
        f'<path d="M{points}{"Z" if shape.closed else ""}" fill="{fill}"'
        f' stroke="{style["edgecolor"]}" stroke-width="{1.3 * style["linewidth"]:.3g}"{dashes}/>'
    )
