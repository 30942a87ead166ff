"""The placement of a mechanism: coordinates, directions of frames, and their motion.

Coordinates x = J q are the angles alpha of directions E = exp(i alpha), and displacements s.  X is
E for what turns, and s E_d for what slides on link d (E_d = 1 on the ground).  Rates and
accelerations of X are computed here, and T = dX/dx in `columns`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.errors import InputError, RobodynError
from robodyn.mechanics import parts
from robodyn.mechanics.planar_model import Mechanism
from robodyn.tables.arrays import Array, Complex
from robodyn.tables.csv_fields import shown

FEW = 32  # numbers
STATE = ("qd", "qdd", "tau", "q")  # what functions of a state are given


def as_states(mechanism: Mechanism, name: str, values: ArrayLike) -> Array:
    """Return `values` as floats (..., n); InputError unless they are finite and n wide."""
    return finite(name, n_wide(mechanism, name, values))


def n_wide(mechanism: Mechanism, name: str, values: ArrayLike) -> Array:
    """Return `values` as floats (..., n); InputError unless they are n wide.

    Torques `tau` may be those of the actuated joints alone: passive joints get zero.
    """
    array, n, driven = numbers(name, values), mechanism.n, list(mechanism.actuated)
    wide = array.shape[-1] if array.ndim else None
    if wide == n:
        return array
    if name == "tau" and wide == len(driven):
        torques = np.zeros((*array.shape[:-1], n))
        torques[..., driven] = array
        return torques
    limit = f"must have {n} values along the last axis, one a joint"
    if name == "tau" and len(driven) < n:
        limit += f", or {len(driven)}, one an actuated joint"
    raise InputError(f"{name}.shape", value=array.shape, limit=limit)


def actuated_wide(mechanism: Mechanism, name: str, values: ArrayLike) -> Array:
    """Return `values` as floats (..., actuated); InputError for another width."""
    array, wanted = numbers(name, values), len(mechanism.actuated)
    if array.shape[-1:] != (wanted,):
        names = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
        limit = f"must have {wanted} values along the last axis, one an actuated joint ({names})"
        raise InputError(f"{name}.shape", value=array.shape, limit=limit)
    return array


def numbers(name: str, values: ArrayLike) -> Array:
    """Return `values` as floats; InputError if they are no numbers."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(name, value=shown(repr(values)), limit="must be numbers") from None


def finite(name: str, array: Array) -> Array:
    """Return the array; InputError that names the first value that is not finite."""
    # of few numbers Python is faster
    good = map(math.isfinite, array.tolist()) if array.ndim == 1 and len(array) < FEW else None
    if not (np.isfinite(array).all() if good is None else all(good)):
        where = np.argwhere(~np.isfinite(array))[0]
        place = f"{name}[{', '.join(map(str, where))}]"
        raise InputError(place, value=array[tuple(where)], limit="must be finite")
    return array


def check_directions(mechanism: Mechanism, q: Array) -> None:
    """Raise SingularError if the ends of an element that needs a direction coincide.

    q is (..., n).
    """
    if not mechanism.parted:
        return
    with np.errstate(all="ignore"):
        met = parts.met_ends(mechanism, list(np.moveaxis(q, -1, 0)), np.exp)
    for place, states in met.items():
        if np.any(states):
            name = mechanism.name_of(mechanism.elements[place])
            raise parts.no_direction(mechanism, name)


def together(mechanism: Mechanism, given: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Return joint values (..., n), broadcast to one another; InputError if they do not fit."""
    each = [n_wide(mechanism, name, value) for name, value in given.items()]
    try:
        return dict(zip(given, np.broadcast_arrays(*each), strict=True))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in each)
        raise InputError("shapes", value=shapes, limit="must broadcast to one another") from None


def times_of(t: ArrayLike, q: Array) -> Array:
    """Return the times (...) of states q (..., n)."""
    try:
        times = np.broadcast_to(finite("t", np.asarray(t, float)), q.shape[:-1])
    except ValueError:
        limit = f"must broadcast to {q.shape[:-1]}, one a state"
        raise InputError("t.shape", value=np.shape(t), limit=limit) from None
    return np.array(times)


def within_floats(
    function: Callable[..., Any], names: Sequence[str], given: Sequence[Any], named: dict[str, Any]
) -> Any:
    """Call a function of a mechanism and a state; its arguments have `names`.

    Raises RobodynError that names the largest number of the state if results overflow.
    """
    try:
        with np.errstate(over="raise"):
            return function(*given, **named)
    except FloatingPointError:
        values = dict(zip(names, given, strict=False)) | named
    arrays = {name: np.abs(numbers(name, values[name])) for name in STATE if name in values}
    name = max(arrays, key=lambda name: arrays[name].max())
    place = np.unravel_index(arrays[name].argmax(), arrays[name].shape)
    value = np.asarray(values[name], float)[place]
    limit = "is too large: results beyond the floats follow"
    raise RobodynError(f"{name}[{', '.join(map(str, place))}]", value=value, limit=limit)


def matvec(matrix: NDArray[Any], vector: NDArray[Any]) -> NDArray[Any]:
    """Return matrices (..., r, n) times vectors (..., n), each by itself.

    So the digits of a state do not depend on the number of states, unlike those of rows @ matrix.
    """
    return np.asarray((matrix @ vector[..., None])[..., 0])


class Placed(NamedTuple):
    """The placement of a mechanism: x = J q, X, and the direction E of each frame, (..., n)."""

    x: Array
    X: Complex
    E: Complex

    def rates(self, mechanism: Mechanism, xd: Array) -> Placed:
        """Return xd, X' and E'."""
        w = frame_rates(mechanism, xd)
        moved = 1j * self.X * w
        if not mechanism.slides:
            return Placed(xd, moved, moved)
        slides = list(mechanism.slides)
        moved[..., slides] += self.E[..., slides] * xd[..., slides]
        return Placed(xd, moved, 1j * self.E * w)

    def accelerations(self, mechanism: Mechanism, xd: Array, xdd: Array) -> Placed:
        """Return xdd, X'' and E''."""
        w, a = frame_rates(mechanism, xd), frame_rates(mechanism, xdd)
        turned = 1j * a - w * w
        bent = self.X * turned
        if not mechanism.slides:
            return Placed(xdd, bent, bent)
        k = list(mechanism.slides)
        bent[..., k] += self.E[..., k] * (xdd[..., k] + 2j * w[..., k] * xd[..., k])
        return Placed(xdd, bent, self.E * turned)


def frame_rates(mechanism: Mechanism, rates: Array) -> Array:
    """Return the rate at which each coordinate's frame turns, (..., n), from those of x."""
    if not mechanism.slides:
        return rates
    w = rates.copy()
    for k in mechanism.slides:
        d = mechanism.frames[k]
        w[..., k] = 0.0 if d is None else rates[..., d]
    return w


def placed(mechanism: Mechanism, q: ArrayLike) -> Placed:
    """Return the placement of a mechanism at q (..., n)."""
    return placed_at(mechanism, matvec(mechanism.arrays.J, as_states(mechanism, "q", q)))


def placed_at(mechanism: Mechanism, x: NDArray[Any]) -> Placed:
    """Return the placement of a mechanism at x = J q, in any precision."""
    E = np.empty(x.shape, np.result_type(x, 1j))
    alpha = frame_rates(mechanism, x)  # as rates go, so go the angles themselves
    np.cos(alpha, out=E.real)
    np.sin(alpha, out=E.imag)
    if not mechanism.slides:
        return Placed(x, E, E)
    X = E.copy()
    slides = list(mechanism.slides)
    X[..., slides] *= x[..., slides]
    return Placed(x, X, E)


def columns(mechanism: Mechanism, V: NDArray[Any], X: Complex, E: Complex) -> Complex:
    """Return V dX/dx (..., n) for V (..., n): a turning link moves what slides on it."""
    found: Complex = V * (1j * X)
    for k in mechanism.slides:
        d = mechanism.frames[k]
        if d is not None:
            found[..., d] += found[..., k]
        found[..., k] = V[..., k] * E[..., k]
    return found


def absolute_rates(mechanism: Mechanism, qd: ArrayLike, name: str = "qd") -> Array:
    """Return xd = J qd, angular velocities and rates of displacements, (..., n)."""
    return matvec(mechanism.arrays.J, as_states(mechanism, name, qd))


def joint_ways(
    mechanism: Mechanism, q: NDArray[Any], z: NDArray[Any], slope: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return displacements of joints from q (..., n), and qd, (..., n), from series of x.

    z = rho + i theta turns a direction; for a displacement s it is 1 + i s.  `slope` is dz/dt.
    """
    way, rates = np.angle(z), (slope / z).imag
    for k in mechanism.slides:
        way[..., k], rates[..., k] = z[..., k].imag - q[..., k], slope[..., k].imag
    if mechanism.n == 1:
        return way, rates
    relative = relative_matrix(mechanism).T
    return way @ relative, rates @ relative


@lru_cache(maxsize=64)
def relative_matrix(mechanism: Mechanism) -> Array:
    """Return J^-1 (n, n): joint rates from absolute ones."""
    inverse = np.eye(mechanism.n)
    for k, above in enumerate(mechanism.above):
        if above is not None:
            inverse[k, above] = -1.0
    return inverse
