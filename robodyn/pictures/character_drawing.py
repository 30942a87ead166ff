"""A mechanism made of characters, to scale."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.character_plot import Canvas
from robodyn.pictures.drawing import Drawing

Complex = NDArray[np.complex128]

LINES = ("link", "support", "guide", "block", "spring")
SHAPE = 2.0  # a character is so much higher than it is wide


def drawing_lines(
    drawn: Drawing,
    names: Sequence[str],
    width: int,
    height: int,
    ascii: bool = False,
    colour: bool = False,
) -> list[str]:
    """The poses of a drawing as lines of at most `width` characters, at most `height` of them.

    Outlines of links, supports and guides, an o for each joint, and the links' `names`, if any,
    at the last pose.
    """
    left, bottom, right, top = drawn.box()
    canvas = Canvas(width, height, ascii)
    stretch = canvas.up / canvas.across / SHAPE  # dots up for one across
    scale = min((canvas.width - 1) / (right - left), (canvas.height - 1) / (top - bottom) / stretch)
    rows = min(height, int((top - bottom) * scale * stretch / canvas.up) + 1)
    canvas = Canvas(width, rows, ascii)

    def dots(z: Complex) -> Complex:
        moved = (z.real - left) + 1j * stretch * (z.imag - bottom)
        return np.asarray(scale * moved, complex)

    joints = []
    for pose in range(len(drawn.q)):
        for b, shape, z in drawn.placed(pose):
            if shape.kind in LINES:
                line = np.append(z, z[0]) if shape.closed else z
                canvas.line(dots(line), drawn.bodies[b].link or 0)
            elif shape.kind == "joint":
                joints.append(dots(z).mean())
    for joint in joints:
        canvas.text(*canvas.cell(joint), "o")
    for k, name in enumerate(names):
        b = next(b for b, body in enumerate(drawn.bodies) if body.link == k and body.turns)
        middle = 0.5 * drawn.mechanism.description.links[k].l
        at = drawn.place[-1:, b] + middle * drawn.turn[-1:, b]
        column, row = canvas.cell(dots(at)[0])
        canvas.text(max(0, min(column + 2, width - len(name))), row, name, k)
    return canvas.lines(colour)
