"""Pictures in 256 colours, which are enough, in a third of the bytes."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from robodyn.pictures.colour_scale import Rgb


def in_palette(png: bytes, palette: Sequence[Rgb]) -> bytes:
    """The image in the colours of a palette, else in the 256 that suit it best."""
    written = BytesIO()
    with Image.open(BytesIO(png)) as image:
        size = {"dpi": image.info["dpi"]} if "dpi" in image.info else {}
        if palette:
            small = _nearest_of(palette, image.convert("RGB"))
        else:
            small = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    small.save(written, format="PNG", optimize=True, **size)
    return written.getvalue()


def with_images_in_palette(svg: bytes, palette: Sequence[Rgb]) -> bytes:
    """The drawing with its images in the colours of the palette, less those that one sees through.

    matplotlib writes four bytes a dot, which take three times the room.
    """

    def smaller(match: re.Match[bytes]) -> bytes:
        png = base64.b64decode(match[2])
        with Image.open(BytesIO(png)) as image:
            if image.convert("RGBA").getchannel("A").getextrema() != (255, 255):
                return match[0]
        return match[1] + base64.b64encode(in_palette(png, palette))

    return re.sub(rb"(data:image/png;base64,)([^\"]*)", smaller, svg)


def _nearest_of(palette: Sequence[Rgb], image: Any) -> Any:
    """The image with each colour the nearest of the palette."""
    parts = np.asarray(image, np.uint32)
    packed = (parts[..., 0] << 16) | (parts[..., 1] << 8) | parts[..., 2]
    colours, places = np.unique(packed, return_inverse=True)
    apart = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=-1).astype(float)
    known = np.array(palette, float)
    near = np.array([((known - colour) ** 2).sum(axis=-1).argmin() for colour in apart], np.uint8)
    small = Image.fromarray(near[places.reshape(packed.shape)], "P")
    small.putpalette(np.array(palette, np.uint8).tobytes())
    return small
