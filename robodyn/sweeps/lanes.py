"""Many motions of one structure at once in machine code, one in each lane.

The code is that of `runs/machine_motion.py` and `lane_observer.py`, for every scene that machine
code serves: numbers of the scene and torques may differ from lane to lane.
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.runs import machine_motion
from robodyn.runs.machine_motion import RUNNING, Loaded, Status
from robodyn.runs.machine_steps import Scene
from robodyn.runs.series_engine import serves
from robodyn.sweeps.lane_observer import LaneObserver, Notes, kept
from robodyn.tables.arrays import Array

KEPT = 64  # codes in a process
PIECE = 128  # lanes of one call of machine code, and
BUDGET = 512  # steps of each: some 10 ms, which Ctrl-C does not end


def order_where_series_cost(tolerance: float) -> int:
    """The order that measured cheapest for many side by side: the series is most of a step."""
    return 2 * max(3, round((4.0 - 0.5 * math.log(tolerance)) / 2.0))


class Aims(NamedTuple):
    """Settings of the integration of lanes, and the results wanted besides their ends."""

    rtol: float
    atol: float
    most: int = 100_000  # steps
    suspect: float = 0.0  # quality of a closing below which no step starts
    extremes: bool = True
    link: int = -1  # whose flip is wanted; -1: none's
    work: bool = False  # whether torques or dampers change the energy


class Motions(NamedTuple):
    """Motions of one mechanism: starts y (k, 2n), torques tau (k, n), angles (k,) from hanging.

    The angle is that of the link whose flip is wanted: it flips where |angle| exceeds pi.
    """

    mechanism: Mechanism
    y: Array
    tau: Array
    angle: Array


@dataclass(slots=True)
class Ends:
    """Results of L lanes in SI units; nan if a lane has none.

    `low` and `high` (L, 2n) are the extremes of q, then of qd.  `energy` (L, 2) are its extremes at
    the ends of steps, without the mechanism's constant.  `drift` is the largest |E - E(0) - work|
    there over the energy in motion, as in `report.Report`.  `flip` is when the link passed upright.
    """

    t: Array
    y: Array  # (L, 2n)
    low: Array
    high: Array
    energy: Array
    drift: Array
    flip: Array
    status: NDArray[np.int64]  # a Status
    steps: NDArray[np.int64]

    @classmethod
    def room(cls, L: int, n: int) -> Ends:
        """For L lanes of n links."""
        wide, long = np.full((3, L, 2 * n), math.nan), np.full((2, L), math.nan)
        energy, whole = np.full((L, 2), math.nan), np.zeros((2, L), np.int64)
        return cls(np.zeros(L), wide[0], wide[1], wide[2], energy, *long, *whole)


class _Shape(NamedTuple):
    """What serves all scenes of one shape: places of items, and code that runs columns of them."""

    scene: Scene
    run: Callable[[Array], None]


_shapes: dict[str, _Shape | None] = {}
_making = threading.Lock()


def integrate(
    members: Sequence[Motions],
    t_end: float,
    aims: Aims,
    driven: Sequence[bool],
) -> list[Ends | None]:
    """The motions of each member from t = 0 to t_end; None where its mechanism is not served.

    `driven` (n) tells which joints may have a torque at all.  Neither which members come together
    nor their order changes a digit.  A lane that cannot go on stops; its status tells why.
    """
    found: list[Ends | None] = [None] * len(members)
    alike: dict[str, list[int]] = {}
    scenes = [_scene(x.mechanism, tuple(driven), aims) for x in members]
    for i, scene in enumerate(scenes):
        if scene is not None:
            alike.setdefault(scene.key, []).append(i)
    for key, indices in alike.items():
        shape = _shape(key, scenes[indices[0]], aims)
        if shape is None:
            continue
        parts = [_columns(scenes[i], members[i], t_end, aims) for i in indices]
        columns = np.concatenate(parts, axis=1)
        shape.run(columns)
        ends = _ends(shape.scene, columns)
        begin = 0
        for i, part in zip(indices, parts, strict=True):
            stop = begin + part.shape[1]
            found[i] = Ends(*(getattr(ends, name)[begin:stop] for name in Ends.__slots__))
            begin = stop
    return found


def served(mechanism: Mechanism) -> bool:
    """Whether its motions go in lanes, if there is machine code at all.

    No lane steps onto times of loads.
    """
    return serves(mechanism) and not mechanism.timed


@lru_cache(maxsize=8)
def _scene(mechanism: Mechanism, driven: tuple[bool, ...], aims: Aims) -> Scene | None:
    if not served(mechanism):
        return None
    try:
        return Scene(
            mechanism,
            Actuation(tuple(map(float, driven))),
            order_where_series_cost(aims.rtol),
            work=aims.work,
            rate_series=aims.extremes,
            link=aims.link,
            kept=kept(mechanism),
        )
    except ZeroDivisionError:  # no state has a series: the others say why
        return None


def _shape(key: str, scene: Scene | None, aims: Aims) -> _Shape | None:
    with _making:  # all threads get the same
        if key not in _shapes:
            while len(_shapes) >= KEPT:
                _shapes.pop(next(iter(_shapes)))
            _shapes[key] = _made(scene, aims)
        return _shapes[key]


def _made(scene: Scene | None, aims: Aims) -> _Shape | None:
    assert scene is not None
    observer = LaneObserver(scene, aims.extremes)
    try:
        loaded = machine_motion.compile(scene, observer, 0)
        return None if loaded is None else _Shape(scene, _MachineLanes(scene, loaded).run)
    except ZeroDivisionError:  # no state has a series
        return None


def _columns(scene: Scene | None, motions: Motions, t_end: float, aims: Aims) -> Array:
    """The items that Python fills, (items, lanes)."""
    assert scene is not None
    place, n = scene.place, scene.mechanism.n
    column = np.zeros(len(place))
    scene.fill(column, aims.rtol, aims.atol)
    given = {"bound": t_end, "direction": 1.0 if t_end >= 0.0 else -1.0, "most_steps": aims.most}
    given |= {"status": RUNNING if t_end else Status.REACHED, "suspect": aims.suspect}
    for name, value in given.items():
        column[place[name]] = value
    columns = np.repeat(column[:, None], len(motions.y), axis=1)
    columns[place["to_q0"] : place["to_q0"] + 2 * n] = motions.y.T
    columns[place["u0"] : place["u0"] + n] = motions.tau.T
    columns[place["angle"]] = motions.angle
    return columns


def _ends(scene: Scene, columns: Array) -> Ends:
    """Return the results of lanes that have ended from their columns (items, L)."""
    place, n = scene.place, scene.mechanism.n
    rows = {name: columns[i] for name, i in place.items()}
    moving = np.maximum(rows["KE"], rows["PE_high"] - rows["PE_low"])
    drift = np.divide(rows["off"], moving, out=moving * 0.0, where=moving > 0.0)
    return Ends(
        t=rows["t"],
        y=columns[: 2 * n].T,
        low=columns[place["low0"] : place["low0"] + 2 * n].T,
        high=columns[place["high0"] : place["high0"] + 2 * n].T,
        energy=np.stack([rows["E_low"], rows["E_high"]], axis=1),
        drift=drift,
        flip=rows["flip"],
        status=rows["status"].astype(np.int64),
        steps=rows["steps"].astype(np.int64),
    )


class _MachineLanes:
    """Lanes in machine code."""

    def __init__(self, scene: Scene, loaded: Loaded) -> None:
        types = [ctypes.c_void_p] * 3 + [ctypes.c_int64] * 4
        self.scene, self.loaded = scene, loaded
        self.call = loaded.code.function("run", *types)

    def run(self, columns: Array) -> None:
        """Take columns (items, L) to their ends, in place."""
        lanes, (count, L) = self.loaded.lanes, columns.shape
        held = np.empty((count, -(-L // lanes) * lanes))
        held[:, :L] = columns
        held[:, L:] = columns[:, -1:]  # what pads the last lanes idles
        held[self.scene.place["status"], L:] = float(Status.REACHED)
        block, wide = self.loaded.block(), held.shape[1]
        notes = Notes(self.scene, lanes, wide)
        places = (x.ctypes.data for x in (block, notes.whole, held))
        call = partial(self.call, *places, wide)
        with np.errstate(all="ignore"):  # what leaves the floats is told by its status
            for first in range(0, wide, PIECE):
                stop = min(first + PIECE, wide)
                while call(first, stop, BUDGET):
                    if notes.full:
                        notes.take()
            notes.take()
            notes.merge(held, self.scene.place)
        columns[:] = held[:, :L]
