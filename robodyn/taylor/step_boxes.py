"""A box that the state stays in along a step, from the step's series.

z = rho + i theta turns a direction at the rate w = Im(z'/z).  With the rate w0 at the start and
D = z' - i w0 z, which is zero there, z = exp(i w0 x) (1 + integral of exp(-i w0 x) D), so that

    |D| <= far = sum_{k>0} |(k + 1) z_{k+1} - i w0 z_k| h^k,      |z| >= 1 - h far,
    |w - w0| = |Im(D/z)| <= far / (1 - h far),

and the angle goes away from alpha_0 + w0 x by h times that at most.  Of a displacement z' - z'(0)
is D, and far is all.  Sizes |z| are |rho| + |theta|, and a joint's box is that of its own
coordinate and the one below.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from robodyn.dynamics.placed import relative_matrix
from robodyn.events.signs import MISSED
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array, Complex

SLACK = 1e-12  # of the sizes of what is added: more than rounding adds
BLOCK = 256  # steps of one link whose strays are summed at a time: memory near at hand is fast
END: Array = np.ones(1)  # of a step, the part that is all


class Kept(NamedTuple):
    """What an engine keeps of m steps h.

    `boxes` (m, 2, 2n) are the middles of q and qd, and how far they go from there; `terms`
    (n, p, m) are z_k h^k, k > 0.
    """

    boxes: Array
    terms: Complex


def terms_of(parts: Array, h: Array) -> Complex:
    """z_k h^k, k > 0, (n, p, m) of rho and theta in `parts` (2, n, p + 1, m) of steps h (m)."""
    most, k = parts.shape[2] - 1, 1
    powers = np.empty((most, len(h)))
    powers[0] = h
    while k < most:
        upto = min(2 * k, most)
        np.multiply(powers[: upto - k], powers[k - 1], out=powers[k:upto])
        k = upto
    terms = np.empty((len(parts[0]), *powers.shape), complex)  # steps side by side: that is fast
    np.multiply(parts[0, :, 1:], powers, out=terms.real)
    np.multiply(parts[1, :, 1:], powers, out=terms.imag)
    return terms


@np.errstate(all="ignore")
def boxes_along(mechanism: Mechanism, y: Array, terms: Complex, h: Array) -> Array:
    """The boxes (m, 2, 2n) of steps h (m) between y (m + 1, 2n or more), by their `terms`."""
    n, slides = mechanism.n, list(mechanism.slides)
    turned = terms[:, 0].imag  # w0 h
    if slides:
        turned = turned.copy()
        turned[slides] = 0.0
    far, some = np.empty(turned.shape), max(1, BLOCK // n)
    for first in range(0, len(h), some):
        block = slice(first, first + some)
        far[:, block] = _strays(terms[..., block], turned[:, block])
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
    start = y[:-1, : 2 * n].T
    box = np.empty((2, 2 * n, len(h)))
    middle, reach = box
    way = start[n:] * (0.5 * h)
    middle[:] = start
    middle[:n] += way
    np.abs(start, out=reach)
    reach *= SLACK
    reach[:n] += np.abs(way)
    reach[:n] += own
    reach[n:] += own / np.abs(h)
    if mechanism.rows:
        there = states_along(mechanism, y[:-1], terms, h, END)[:, 0]
        reach += MISSED * np.abs(there - y[1:, : 2 * n]).T
    return box.transpose(2, 0, 1)


def _strays(terms: Complex, turned: Array) -> Array:
    """The sums (n, m) of |D_k| h^k of steps that turn by w0 h (n, m), k > 0."""
    stray = terms * (turned * -1j)[:, None]
    stray[:, :-1] += terms[:, 1:] * _orders(terms.shape[1])[1:]
    sizes = stray.view(float)
    sums = np.add.reduce(np.abs(sizes, out=sizes), axis=1)
    return np.asarray(sums[:, ::2] + sums[:, 1::2])


def states_along(mechanism: Mechanism, y: Array, terms: Complex, h: Array, parts: Array) -> Array:
    """q and qd (m, k, 2n) at `parts` (k) of steps h (m) from y (m, 2n or more), by their terms.

    Closures are kept as far as these do.  See `placed.joint_ways`; parts are faster in turn.
    """
    n, slides, k = mechanism.n, list(mechanism.slides), len(parts)
    sums = _weights(terms.shape[1], parts.tobytes()) @ terms
    turn, slope = sums[:, :k], sums[:, k:]
    states = np.empty((2 * n, k, len(h)))
    way, rates = states[:n], states[n:]
    if slides:
        moved = sums.imag[slides]
    turn += 1.0
    np.arctan2(turn.imag, turn.real, out=way)
    slope /= turn
    rates[:] = slope.imag
    if slides:
        way[slides], rates[slides] = moved[:, :k], moved[:, k:]
    rates /= h
    if n > 1:
        both = states.reshape(2, n, -1)
        np.matmul(relative_matrix(mechanism), both.copy(), out=both)
    way += y[:, None].T[:n]
    return states.T


def states_at(mechanism: Mechanism, y: Array, terms: Complex, x: Array, part: Array) -> Array:
    """The same (m, 2n) at one time of each step, x (m) after y, not 0: this `part` (m) of it."""
    powers = np.empty(terms.shape[1:])
    powers[:] = part
    np.multiply.accumulate(powers, out=powers)
    return states_along(mechanism, y, terms * powers, x, END)[:, 0]


@lru_cache(maxsize=64)
def _orders(count: int) -> Array:
    return np.arange(1.0, count + 1.0)[:, None]


@lru_cache(maxsize=64)
def _weights(count: int, parts: bytes) -> Complex:
    """What makes sums of terms (columns), and of their slopes, at parts of a step (rows)."""
    orders, at = _orders(count)[:, 0], np.frombuffer(parts)[:, None]
    return np.concatenate([at**orders, orders * at ** (orders - 1.0)]).astype(complex)
