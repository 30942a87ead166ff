"""Steps of the Taylor integrator, looked at for events."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn.events.pieces import Step
from robodyn.events.signs import NODES
from robodyn.events.single_zeros import Places
from robodyn.events.told import Stop
from robodyn.events.watch import EventWatch
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.taylor import Chunk, Status
from robodyn.taylor.compiled import CompiledEngine
from robodyn.taylor.step_boxes import Kept, states_along, states_at


def with_events(
    events: EventWatch,
    mechanism: Mechanism,
    chunk: Chunk,
    t: float,
    y: Array,
    engine: CompiledEngine,
) -> tuple[Chunk, Callable[[Array], Array], Stop | None]:
    """A chunk from (t, y) up to the event that ends it, and the states in its last step."""
    assert isinstance(chunk.kept, Kept)
    terms = chunk.kept.terms
    times, before = np.concatenate([[t], chunk.t]), np.concatenate([y[None], chunk.y[:-1]])
    forward = 1.0 if times[1] > times[0] else -1.0
    h = times[1:] - times[:-1]

    def step(j: int) -> Step:
        begin, end = float(times[j]), float(times[j + 1])
        return Step(begin, end, chunk.y[j], engine.dense(begin, before[j], end))

    def sampled(places: Places) -> Array:
        some = h[places]
        return states_along(mechanism, before[places], terms[..., places], some, NODES)

    def within(places: Places, t: Array) -> Array:
        some, x = h[places], t - times[places]
        found = states_at(mechanism, before[places], terms[..., places], x, x / some)
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
