"""States that the examples are tried at."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robodyn.loops import loop_rates
from robodyn.loops.assembly import assemble
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.quantities import parse_vector

Array = NDArray[np.float64]

loaded = lru_cache(load)  # one mechanism of a scene: what is made for it is made once


def start(scene: str, rate: float) -> tuple[Mechanism, Array, Array]:
    """A scene at rest where it is tried, or its actuated joints at a rate."""
    mechanism = loaded(f"robots/{scene}.yaml")
    text = Path(f"robots/{scene}.yaml").read_text()
    tried = re.search(r"^# try:.*--q (\S+)", text, re.MULTILINE)
    given = parse_vector(tried[1] if tried else "50deg", where="q", unit="rad")
    if not mechanism.rows:
        return mechanism, np.array(given), np.full(mechanism.n, rate)
    q = assemble(mechanism, given, t=0.0)
    rates = np.full(len(mechanism.actuated), rate)
    return mechanism, q, loop_rates.loop_velocities(mechanism, q, rates, t=0.0)
