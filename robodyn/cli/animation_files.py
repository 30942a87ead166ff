"""Animations as files of pictures: gif and mp4, drawn by matplotlib (the extra `plot`)."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import numpy as np

from robodyn.cli.pictures import FONT, Picture
from robodyn.errors import RobodynError
from robodyn.pictures.colour_scale import COLOURS
from robodyn.pictures.drawing import Drawing
from robodyn.pictures.motion_frames import FINER, time_decimals
from robodyn.tables.output_file import open_output

DOTS = 100  # an inch
COLOURS_OF_GIF = 128
APART = 8  # of 255, the least difference of two of them
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
        """Move to a frame."""
        super().show(pose)
        for line, z in zip(self._lines, self._traces, strict=True):
            end = FINER * pose + 1
            line.set_data(z.real[:end], z.imag[:end])
        self._time.set_text(f"t = {self._t[pose]:.{self._decimals}f} s")

    def image(self, pose: int) -> Any:
        """A frame as an image of Pillow's."""
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
    palette = _palette(film)

    def images() -> Iterator[Any]:
        for pose in range(film.count):
            watch(pose / film.count)
            yield film.image(pose).quantize(palette=palette, dither=0)

    each, drawn = images(), BytesIO()  # Pillow's own writing tells no reason where it fails
    with open_output(out) as stream:
        times = {"duration": durations(film.count, rate), "loop": 0}
        next(each).save(drawn, format="GIF", save_all=True, append_images=each, **times)
        stream.write(drawn.getbuffer())


def _palette(film: Film) -> Any:
    """The commonest colours of a few frames, an image of Pillow's."""
    from PIL import Image

    counts: Counter[tuple[int, int, int]] = Counter()
    for image in map(film.image, sorted({0, film.count // 2, film.count - 1})):
        found = image.getcolors(image.width * image.height)
        counts.update({colour: count for count, colour in found})
    chosen: list[tuple[int, int, int]] = []
    for colour, _ in counts.most_common():
        # Pillow finds the nearest colour in coarse steps: those too near would be mixed up
        if all(max(abs(a - b) for a, b in zip(colour, c, strict=True)) > APART for c in chosen):
            chosen.append(colour)
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in chosen[:COLOURS_OF_GIF] for value in colour])
    return palette


def write_mp4(film: Film, rate: float, out: str, watch: Watch) -> None:
    """A film by the program ffmpeg."""
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
