"""Steps of the Taylor integrator, looked at for events."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.placed import states_along
from robodyn.events.pieces import Step
from robodyn.events.signs import NODES
from robodyn.events.told import Found, Stop
from robodyn.events.watch import EventWatch
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.taylor import Chunk, Engine, Status

Places = NDArray[np.int64]

WHOLE = np.ones(1)


def with_events(
    events: EventWatch, mechanism: Mechanism, chunk: Chunk, t: float, y: Array, engine: Engine
) -> tuple[Chunk, Callable[[Array], Array], Stop | None]:
    """A chunk from (t, y) up to the event that ends it, and the states in its last step."""
    if isinstance(chunk.kept, Found):
        events.take(chunk.kept)
        return chunk, engine.within, None
    assert chunk.kept is not None
    events.doubts += engine.forms is not None
    series = chunk.kept.series
    times = np.concatenate([[t], chunk.t])
    forward = 1.0 if times[1] > times[0] else -1.0

    def step(j: int) -> Step:
        begin, end = float(times[j]), float(times[j + 1])
        return Step(begin, end, chunk.y[j], engine.dense(begin, chunk.y[j - 1] if j else y, end))

    def starts(places: Places) -> Array:
        return np.where(places[:, None] > 0, chunk.y[places - 1], y)

    def sampled(places: Places) -> Array:
        h = times[places + 1] - times[places]
        return states_along(mechanism, starts(places), series(places), h, NODES)

    def within(places: Places, t: Array) -> Array:
        h = t - times[places]
        found = states_along(mechanism, starts(places), series(places), h, WHOLE)[:, 0]
        return engine.closed(found) if mechanism.rows else found

    ends, exact = chunk.y[:, : 2 * mechanism.n], not mechanism.rows
    found = events.series(times, chunk.kept.boxes, sampled, ends, step, exact, within)
    if found is None:
        return chunk, engine.within, None
    j, stop = found
    whole, last = chunk.first(j, forward), step(j)
    if stop.t == last.begin:
        return whole, last.states, stop
    before = chunk.row_t * forward <= stop.t * forward
    ends, states = np.append(whole.t, stop.t), np.concatenate([whole.y, stop.y[None]])
    cut = Chunk(ends, states, chunk.row_t[before], chunk.row_y[before], Status.FULL)
    return cut, last.states, stop
