"""A box that the state stays in along a step, from the step's series.

z = rho + i theta turns a direction at the rate w = Im(z'/z).  With the rate w0 at the start and
D = z' - i w0 z, which is zero there, z = exp(i w0 x) (1 + integral of exp(-i w0 x) D), so that

    |D| <= far = sum_{k>0} |(k + 1) z_{k+1} - i w0 z_k| h^k,      |z| >= 1 - h far,
    |w - w0| = |Im(D/z)| <= far / (1 - h far),

and the angle goes away from alpha_0 + w0 x by h times that at most.  Of a displacement z' - z'(0)
is D, and far is all.  Sizes |z| are |rho| + |theta|, and a joint's box is that of its own
coordinate and the one below.

The rate's slope a = Im(z'/z)' stays near a0, that at the start, likewise: with u = z'/z and
F = D' - i w0 D - i a0 z is (u' - i a0) z = F - (u - i w0) D, so that

    |a - a0| <= (sum |F_k| h^k + |w - w0| far) / (1 - h far),

and of a displacement F is z'' - z''(0), and all.  Of the pair D_0 and F_0, zero but for rounding
and for what a series leaves out, the sums have the sizes too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.placed import relative_matrix
from robodyn.events.signs import MISSED
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array

Places = NDArray[np.int64]

SLACK = 1e-12  # of the sizes of what is added: more than rounding adds
TURNS: Array = np.array([1.0, -1.0])  # less i times it: what turns rho and theta


class Kept(NamedTuple):
    """What an engine keeps of m steps, until it advances again.

    `boxes` (m, 2, 2n) are the middles of q and qd, and how far they go from there;
    `terms(places, h)` (2, n, p, k) are rho and theta of z_k h^k, k > 0, of some steps h (k).
    """

    boxes: Array
    terms: Callable[[Places, Array], Array]


def terms_of(parts: Array, h: Array) -> Array:
    """z_k h^k, k > 0, (2, n, p, m) of rho and theta in `parts` (2, n, p + 1, m) of steps h (m)."""
    most, k = parts.shape[2] - 1, 1
    powers = np.empty((most, len(h)))
    powers[0] = h
    while k < most:
        upto = min(2 * k, most)
        np.multiply(powers[: upto - k], powers[k - 1], out=powers[k:upto])
        k = upto
    terms = np.empty((*parts.shape[:2], *powers.shape))  # steps side by side: that is fast
    return np.multiply(parts[:, :, 1:], powers, out=terms)


@np.errstate(all="ignore")
def boxes_along(mechanism: Mechanism, y: Array, ends: Array, terms: Array, h: Array) -> Array:
    """The boxes (m, 2, 2n) of steps h (m) from y (m, 2n or more) to `ends`, by their `terms`."""
    n, slides = mechanism.n, list(mechanism.slides)
    turned = terms[1, :, 0]  # w0 h
    if slides:
        turned = turned.copy()
        turned[slides] = 0.0
    stray = np.empty_like(terms)
    np.multiply(terms[::-1], np.multiply.outer(TURNS, turned)[:, :, None], out=stray)
    stray[:, :, :-1] += terms[:, :, 1:] * _orders(terms.shape[2])[1:]
    far = np.add.reduce(np.abs(stray, out=stray), axis=(0, 2))
    far *= 1.0 + SLACK
    left = np.maximum(1.0 - far, 0.0)
    if slides:
        left[slides] = 1.0
    own = far / left
    own += SLACK * np.abs(turned)
    if n > 1:
        apart = own.copy()
        for k, above in enumerate(mechanism.above):
            if above is not None:
                own[k] += apart[above]
    start, half = y[:, : 2 * n].T, 0.5 * h
    box = np.empty((2, 2 * n, len(h)))
    middle, reach = box
    way = start[n:] * half
    middle[:] = start
    middle[:n] += way
    np.abs(start, out=reach)
    reach *= SLACK
    reach[:n] += np.abs(way, out=way)
    reach[:n] += own
    own /= np.abs(h)
    reach[n:] += own
    if mechanism.rows:
        there = states_along(mechanism, y, terms, h, np.ones(1))[:, 0]
        reach += MISSED * np.abs(there - ends[:, : 2 * n]).T
    return box.transpose(2, 0, 1)


def states_along(mechanism: Mechanism, y: Array, terms: Array, h: Array, parts: Array) -> Array:
    """q and qd (m, k, 2n) at `parts` (k) of steps h (m) from y (m, 2n or more), by their terms.

    Closures are kept as far as these do.
    """
    n, p, m = terms.shape[1:]
    sums = _weights(p, parts.tobytes()) @ terms
    return _states(mechanism, y[:, None], sums.reshape(2, n, 2, len(parts), m), h)


def states_at(mechanism: Mechanism, y: Array, terms: Array, h: Array, part: Array) -> Array:
    """The same (m, 2n) at one `part` (m) of each step."""
    weights = np.empty((2, *terms.shape[2:]))
    powers, slopes = weights
    powers[:] = part
    np.multiply.accumulate(powers, out=powers)
    slopes[0], slopes[1:] = 1.0, powers[:-1]
    slopes *= _orders(len(slopes))
    sums = np.add.reduce(terms[:, :, None] * weights, axis=3)
    return _states(mechanism, y, sums, h)


def _states(mechanism: Mechanism, y: Array, sums: Array, h: Array) -> Array:
    """The states (m, ..., 2n) where z - z_0 and z' h have the `sums` (2, n, 2, ..., m).

    Of y (m, 1.., 2n or more) and steps h (m).  See `placed.joint_ways`; parts are faster in turn.
    """
    n, slides = mechanism.n, list(mechanism.slides)
    (rho, along), (theta, across) = sums[0].swapaxes(0, 1), sums[1].swapaxes(0, 1)
    turn = rho + 1.0
    states = np.empty((2 * n, *rho.shape[1:]))
    way, rates = states[:n], states[n:]
    np.arctan2(theta, turn, out=way)
    np.multiply(turn, across, out=rates)
    rates -= theta * along
    rates /= np.square(turn, out=turn) + theta * theta
    if slides:
        way[slides], rates[slides] = theta[slides], across[slides]
    rates /= h
    if n > 1:
        both = states.reshape(2, n, -1)
        np.matmul(relative_matrix(mechanism), both.copy(), out=both)
    way += y.T[:n]
    return states.T


@lru_cache(maxsize=64)
def _orders(count: int) -> Array:
    return np.arange(1.0, count + 1.0)[:, None]


@lru_cache(maxsize=64)
def _weights(count: int, parts: bytes) -> Array:
    """What makes sums of terms (columns), and of their slopes, at parts of a step (rows)."""
    orders, at = _orders(count)[:, 0], np.frombuffer(parts)[:, None]
    return np.concatenate([at**orders, orders * at ** (orders - 1.0)])
