"""Springs, loads and friction of a scene at states, from the rows of its program."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.row_values import RowValues
from robodyn.mechanics import parts
from robodyn.mechanics.planar_model import Mechanism

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@lru_cache(maxsize=64)
def rows(part: Callable[[Mechanism], Mechanism], mechanism: Mechanism) -> RowValues:
    """The rows of a part of what acts on a mechanism."""
    return RowValues(part(mechanism))


def potential_torques(mechanism: Mechanism, q: Array) -> Array:
    """dPE/dq of the springs, (..., n), N m: their part of G."""
    return rows(parts.stored, mechanism)("torques", q, np.zeros(mechanism.n))


def other_torques(mechanism: Mechanism, q: Array, qd: Array) -> Array:
    """Q of equation (1), (..., n), N m."""
    return 0.0 - rows(parts.spent, mechanism)("torques", q, qd)  # no -0.0


def all_torques(mechanism: Mechanism, q: Array, qd: Array) -> Array:
    """The springs' part of G, less Q, (..., n), N m."""
    return rows(parts.acting, mechanism)("torques", q, qd)


def spring_energy(mechanism: Mechanism, q: Array) -> Array:
    """PE of the springs, (...), J."""
    return rows(parts.stored, mechanism)("PE", q, np.zeros(mechanism.n))[..., 0]


def spring_forces(mechanism: Mechanism, q: Array, qd: Array) -> Complex:
    """What each spring between points does to its first end, (..., p), N, as Fx + i Fy."""
    found = _complex(rows(parts.acting, mechanism)("forces", q, qd))
    return found[..., : len(mechanism.springs)]


def load_forces(mechanism: Mechanism, q: Array) -> Complex:
    """Each load at a point, (..., p), N, as Fx + i Fy."""
    return _complex(rows(parts.loaded, mechanism)("forces", q, np.zeros(mechanism.n)))


def forces_on_links(mechanism: Mechanism, q: Array, qd: Array) -> Complex:
    """What springs and loads put on each link, (..., n), N, as Fx + i Fy."""
    return _complex(rows(parts.acting, mechanism)("on links", q, qd))


def _complex(pairs: Array) -> Complex:
    x, y = pairs[..., ::2], pairs[..., 1::2]
    return x + 1j * y
