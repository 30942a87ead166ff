"""Many motions of one structure in machine code, one in each lane of a vector.

What `lanes.py` does in numpy, for every scene that machine code serves: numbers of the scene and
torques may differ from lane to lane.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.engines import machine_motion
from robodyn.engines.machine_motion import RUNNING
from robodyn.engines.machine_steps import Scene
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.sweeps.lane_observer import LaneObserver, kept
from robodyn.sweeps.lanes import Aims, Ends
from robodyn.taylor import Status, default_order
from robodyn.taylor.compiled import scene_kind, serves

Array = NDArray[np.float64]

KEPT = 64  # codes in a process
UNROLLED = 1000  # as in `taylor/compiled.py`: where lanes fill vectors, calls gain less
PIECE = 128  # lanes of one call, and
BUDGET = 512  # steps of each: some 10 ms, which Ctrl-C does not end


class Motions(NamedTuple):
    """Of one mechanism: starts y (k, 2n), torques tau (k, n), angles (k,) from hanging."""

    mechanism: Mechanism
    y: Array
    tau: Array
    angle: Array


class _Shape(NamedTuple):
    """The code that serves scenes of one shape, and where their items stand."""

    scene: Scene
    run: Callable[..., int]
    items: int
    lanes: int


_shapes: dict[str, _Shape | None] = {}
_making = threading.Lock()


def integrate(
    members: Sequence[Motions], t_end: float, aims: Aims, driven: Sequence[bool]
) -> list[Ends | None]:
    """The motions of each member from t = 0 to t_end; None where there is no machine code.

    `driven` (n) tells which joints may have a torque at all.  Neither which members come together
    nor their order changes a digit.
    """
    found: list[Ends | None] = [None] * len(members)
    alike: dict[str, list[int]] = {}
    scenes = [_scene(x.mechanism, tuple(driven), aims, default_order(aims.rtol)) for x in members]
    for i, scene in enumerate(scenes):
        if scene is not None:
            alike.setdefault(scene.key, []).append(i)
    for key, indices in alike.items():
        first = scenes[indices[0]]
        assert first is not None
        shape = _shape(key, first, aims)
        if shape is None:
            continue
        parts = [_columns(scenes[i], members[i], t_end, aims) for i in indices]
        ends = _run(shape, np.concatenate(parts, axis=1), aims)
        begin = 0
        for i, part in zip(indices, parts, strict=True):
            stop = begin + part.shape[1]
            found[i] = Ends(*(getattr(ends, name)[begin:stop] for name in Ends.__slots__))
            begin = stop
    return found


@lru_cache(maxsize=8)
def _scene(mechanism: Mechanism, driven: tuple[bool, ...], aims: Aims, order: int) -> Scene | None:
    if not serves(mechanism):
        return None
    try:
        return scene_kind(mechanism, order, UNROLLED)(
            mechanism,
            Actuation(tuple(map(float, driven))),
            order,
            work=aims.work,
            rate_series=aims.extremes,
            link=aims.link,
            kept=kept(mechanism),
        )
    except ZeroDivisionError:  # no state has a series: the others say why
        return None


def _shape(key: str, scene: Scene, aims: Aims) -> _Shape | None:
    with _making:  # all threads get the same
        if key not in _shapes:
            while len(_shapes) >= KEPT:
                _shapes.pop(next(iter(_shapes)))
            _shapes[key] = _made(scene, aims)
        return _shapes[key]


def _made(scene: Scene, aims: Aims) -> _Shape | None:
    try:
        loaded = machine_motion.compile(scene, LaneObserver(scene, aims.extremes), 0)
    except ZeroDivisionError:  # no state has a series
        return None
    if loaded is None:
        return None
    types = [ctypes.c_void_p] * 2 + [ctypes.c_int64] * 4
    return _Shape(scene, loaded.code.function("run", *types), loaded.items, loaded.lanes)


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


def _run(shape: _Shape, columns: Array, aims: Aims) -> Ends:
    lanes, (count, L) = shape.lanes, columns.shape
    place, n = shape.scene.place, shape.scene.mechanism.n
    held = np.empty((count, -(-L // lanes) * lanes))
    held[:, :L] = columns
    held[:, L:] = columns[:, -1:]  # what pads the last lanes idles
    held[place["status"], L:] = float(Status.REACHED)
    block = np.zeros(shape.items * lanes)
    for first in range(0, held.shape[1], PIECE):
        stop = min(first + PIECE, held.shape[1])
        while shape.run(block.ctypes.data, held.ctypes.data, held.shape[1], first, stop, BUDGET):
            pass
    rows = {name: held[i, :L] for name, i in place.items()}
    moving = np.maximum(rows["KE"], rows["PE_high"] - rows["PE_low"])
    drift = np.divide(rows["off"], moving, out=moving * 0.0, where=moving > 0.0)
    return Ends(
        t=rows["t"],
        y=held[: 2 * n, :L].T,
        low=held[place["low0"] : place["low0"] + 2 * n, :L].T,
        high=held[place["high0"] : place["high0"] + 2 * n, :L].T,
        energy=np.stack([rows["E_low"], rows["E_high"]], axis=1),
        drift=drift,
        flip=rows["flip"],
        status=rows["status"].astype(np.int64),
        steps=rows["steps"].astype(np.int64),
    )
