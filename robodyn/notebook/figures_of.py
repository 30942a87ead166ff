"""plot, draw and animate for notebooks: what these commands draw, of what was computed here."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from html import escape
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.columns import ANY_SCENE, scene_units
from robodyn.dynamics.joint_vectors import full, vectors
from robodyn.dynamics.named_points import named_points
from robodyn.errors import InputError, printable
from robodyn.loops.assembly import first_pose
from robodyn.mechanics.mechanism import Mechanism
from robodyn.notebook.inline import named_as_arguments, opened, own_settings
from robodyn.pictures import animation_files
from robodyn.pictures.animation_files import check_animation, check_programs, frames
from robodyn.pictures.chart import read_chart
from robodyn.pictures.chart_figure import chart_figure, map_figure
from robodyn.pictures.drawing import drawing, even_rows, traced
from robodyn.pictures.force_arrows import forces_at
from robodyn.pictures.mechanism_picture import mechanism_figure
from robodyn.pictures.value_map import read_map
from robodyn.runs.simulation import Motion
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.named_columns import Columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Size = tuple[float, float] | None  # inches
POSES = 8


def plot(
    *tables: Motion | Mapping[str, Any],
    x: str | None = None,
    y: str | Sequence[str] | None = None,
    colour: str | None = None,
    mechanism: Mechanism | None = None,
    log: bool = False,
    points: bool = False,
    degrees: bool = False,
    title: str = "",
    size: Size = None,
) -> Figure:
    """Columns of motions, or of other tables, as a chart; with `colour` a map over x and y.

    A table has columns (T,) by name: a dict, a data frame, what `sweep` gives.  `y` names columns,
    "q*,energy" or a list; by default q and tau over t.  nan is a gap.  With `points` these are not
    joined, nor are rows of a sweep in no order of x.  `mechanism` tells which joints slide, which
    a motion knows; `degrees` of columns of joints needs it.  Raises InputError for columns that are
    not there, RobodynError without matplotlib (the extra `plot`).
    """
    if not tables:
        raise InputError("plot", limit="needs a motion, or a table of columns")
    known = mechanism or next((x.mechanism for x in tables if isinstance(x, Motion)), None)
    units = ANY_SCENE if known is None else scene_units(known)
    names = y.split(",") if isinstance(y, str) else y
    patterns = None if names is None else [name.strip() for name in names if name.strip()]
    if colour is not None and (x is None or not patterns):
        raise InputError("colour", value=shown(colour), limit="needs x and y")
    if colour is not None and points:
        raise InputError("points", limit="is for charts: leave it out with colour")
    given = [opened(_columns(x), str(k + 1)) for k, x in enumerate(tables)]
    with own_settings(), named_as_arguments():
        if colour is None:
            content = read_chart(given, x, patterns, units, degrees, points=points)
            figure: Figure = chart_figure(content, size, shown(title))
            return figure
        untold: list[str] = []
        mapped = read_map(
            given, x or "", patterns or [], colour, log, units, degrees, untold.append
        )
        drawn: Figure = map_figure(mapped, size, shown(title))
        return drawn


def _columns(table: object) -> Columns:
    if isinstance(table, Motion):
        return table.to_dict()
    names = table if isinstance(table, Mapping) else getattr(table, "columns", None)
    if names is None:
        limit = "must be a motion, or columns by name: a dict or a data frame"
        raise InputError("table", value=type(table).__name__, limit=limit)
    columns = Columns({str(name): np.asarray(table[name]).tolist() for name in names})  # type: ignore[index]
    lengths = {name: len(x) if isinstance(x, list) else 0 for name, x in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name}: {count}" for name, count in lengths.items())
        raise InputError("table", value=shown(told), limit="columns must be as long as each other")
    return columns


def draw(
    mechanism: Mechanism,
    q: ArrayLike | None = None,
    qd: ArrayLike | None = None,
    qdd: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    *,
    forces: bool = False,
    of: Sequence[str] = (),
    labels: Literal["names", "numbers"] | None = None,
    poses: int = POSES,
    size: Size = None,
) -> Figure:
    """The mechanism in the closed pose q, to scale; of q (T, n) some poses, the last in full.

    Vectors are of all joints or of the actuated ones; without q a pose is chosen.  `of` names
    points whose paths through q are drawn.  With `forces` weights and forces in pins of the state
    q, qd, that moves with qdd, or as the torques tau make it.  Raises InputError for values that
    do not fit, AssemblyError where the pose does not close, RobodynError without matplotlib.
    """
    named = named_points(mechanism, of, "of") if of else []
    if poses < 1:
        raise InputError("poses", value=poses, limit="must be >= 1")
    if not forces:
        for name, value in (("qd", qd), ("qdd", qdd), ("tau", tau)):
            if value is not None:
                raise InputError(name, limit="is for forces=True")
    elif q is None:
        raise InputError("q", limit="missing: forces need a state")
    elif qdd is not None and tau is not None:
        raise InputError("qdd and tau", limit="exclude each other")
    given = vectors(
        mechanism,
        q=first_pose(mechanism, t=0.0) if q is None else q,
        qd=np.zeros(mechanism.n) if forces and qd is None else qd,
        qdd=qdd,
        tau=tau,
    )
    for name, (values, whole) in given.items():
        few = values.size == values.shape[-1]  # of one state
        if not 1 <= values.ndim <= 2 or not values.size or (forces and not few):
            limit = "must be one pose, for forces" if forces else "must be one pose, or rows"
            raise InputError(f"{name}.shape", value=values.shape, limit=limit)
        given[name] = (values.reshape(-1) if forces else values), whole
    state = full(mechanism, given, t=0.0)
    rows, found = np.atleast_2d(state["q"]), []
    if forces:
        found = forces_at(mechanism, **state, t=0.0)
    drawn = drawing(mechanism, rows[even_rows(len(rows), poses)], named)
    texts = list(map(shown, mechanism.link_names))
    if labels != "names":
        texts = [str(k + 1) for k in range(mechanism.n)] if labels else []
    with own_settings():
        traces = traced(mechanism, named, rows)
        figure: Figure = mechanism_figure(drawn, texts, traces, found, size)
        return figure


class Animation(animation_files.MovingPicture):
    """A motion as a moving picture, which a notebook shows; `save` writes it to a file."""

    def __repr__(self) -> str:
        t, name = self.frames.t, printable(self.drawn.mechanism.name)
        return f"<Animation of {name}: {len(t)} frames, t = {t[0]:.6g} to {t[-1]:.6g} s>"

    def figure(self, frame: int = -1) -> Figure:
        """One of its frames; without matplotlib RobodynError."""
        with own_settings():
            film = animation_files.Film(self)
            film.show(range(film.count)[frame])
            figure: Figure = film.figure
            return figure

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .html, or with matplotlib a .gif, or with ffmpeg too an .mp4."""
        out = os.fspath(path)
        check_animation(out, self.frames.rate, self.speed)
        check_programs(out)
        with nullcontext() if out.lower().endswith(".html") else own_settings():
            self.write(out, lambda: nullcontext(lambda part: None))

    def _repr_html_(self) -> str:
        text = animation_files.page(self)
        style = "width: 640px; height: 560px; border: 0"
        return f'<iframe srcdoc="{escape(text, quote=True)}" style="{style}"></iframe>'


def animate(
    motion: Motion | Mechanism,
    t: ArrayLike | None = None,
    q: ArrayLike | None = None,
    qd: ArrayLike | None = None,
    *,
    of: Sequence[str] = (),
    fps: float = 25.0,
    speed: float = 1.0,
    size: Size = None,
) -> Animation:
    """A motion as a moving picture: one that `simulate` gave, or a mechanism and its t, q, qd.

    t (T,), s, q and qd (T, n), or of the actuated joints alone; `of` names points whose paths are
    drawn.  `speed` seconds of the motion pass in one.  Raises InputError for values that do not
    fit.
    """
    if isinstance(motion, Motion):
        if t is not None or q is not None or qd is not None:
            raise InputError("t, q and qd", limit="are those of the motion: leave them out")
        mechanism, times, rows = motion.mechanism, motion.t, motion.q
        rates: Array | None = motion.qd
    elif isinstance(motion, Mechanism):
        if t is None or q is None:
            raise InputError("t and q", limit="missing: a mechanism alone does not move")
        mechanism, times = motion, np.asarray(t, float)
        given = vectors(motion, q=q, qd=qd)
        for name, (values, _) in given.items():
            if times.ndim != 1 or values.shape[:-1] != times.shape:
                limit = "must have a row each of the times (T,)"
                raise InputError(f"{name}.shape", value=values.shape, limit=limit)
        state = full(mechanism, given, t=times)
        rows, rates = state["q"], state.get("qd")
    else:
        limit = "must be a motion, or a mechanism with t and q"
        raise InputError("motion", value=type(motion).__name__, limit=limit)
    check_animation("page.html", fps, speed)
    named = named_points(mechanism, of, "of") if of else []
    moving = frames(mechanism, times, rows, rates, float(fps), float(speed))
    return Animation.of(mechanism, moving, float(speed), named, size)
