"""A mechanism as flat arrays of numbers, for series in numpy over many lanes.

They lie in two arrays, `whole` and `real`; what is computed lies in a third, `work`; a Layout tells
where.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.loops.closing import CLOSED, loop_size
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SMALL = 24  # links, or rows, up to which an ordering is not worth its search


class Layout(NamedTuple):
    """Sizes, and where things begin in `whole`, `real` and `work`.

    Sparse matrices are rows of entries as in CSR.  Symmetric ones are skylines: rows of the lower
    triangle from their first entry to the diagonal, (i, j) at start[i] + j for first[i] <= j <= i.
    """

    n: int  # links
    rows: int  # r, of closures
    entries: int  # of all rows of P
    order: int  # the last coefficient of w
    K: int  # coefficients that a series has room for

    # whole
    parent: int  # (n,), -1 for the ground
    outward: int  # (n,) the links, parents first
    A_start: int  # (n + 1,) A's entries beside the diagonal, both triangles
    A_link: int
    A_spot: int  # where M_jl goes in the system; -1 in the upper triangle
    P_start: int  # (r + 1,)
    P_link: int
    P_spot: int  # where Psi's entry goes in the system
    P_slot: int  # its place among the row's joints
    joint_start: int  # (r + 1,) the joints that move what a row closes, leaves first
    joint: int
    joint_above: int  # place of the joint's parent among them, or -1
    place: int  # (n + r,) of links and rows in the system [M Psi^T; Psi 0]
    first: int  # (n + r,)
    start: int
    normal_place: int  # (r,) of rows in Psi Psi^T
    normal_row: int  # (r,) the row at each place
    normal_first: int  # (r,)
    normal_start: int

    # real
    inertia: int  # (n,) A_jj, kg m^2
    A_re: int  # kg m^2
    A_im: int
    weight_re: int  # (n,) conj(weights), N m
    weight_im: int
    damping: int  # (n,) N m s/rad
    torque: int  # (n,) N m
    moment: int  # (n,) N m, on links
    P_re: int
    P_im: int
    offset: int  # (r,) m
    size: int  # (r,) square of the row's sum of |P|, m^2
    closed: int  # gap that is rounding, m

    # work
    W: int  # (n, K) of w
    C: int  # (n, K) of c, coefficient k at K - 1 - k
    S: int  # (n, K) of s, likewise
    FX: int  # (n, K)
    FY: int
    X: int  # (n,) of P's known part, one order
    Y: int
    Z_re: int  # i A_jl E_l at the step's start, as A
    Z_im: int
    power: int  # (K,) of torques less dampers
    system: int  # factors of [M Psi^T; Psi 0], and their pivots' inverses (n + r,)
    pivot: int
    x: int  # (n + r,)
    Psi: int  # in joint coordinates, as `joint`
    normal: int  # factors of Psi Psi^T, and their pivots' inverses (r,)
    normal_pivot: int
    dense: int  # (n,), zero between uses
    h: int  # (K,) powers of a time
    h_angle: int  # (K,) and their integrals
    alpha: int  # (n,)
    c: int  # (n,) of the state that was closed last
    s: int
    c0: int  # (n,) of the step's start
    s0: int
    size_of_work: int


def numbers(
    mechanism: Mechanism, actuation: Actuation, order: int
) -> tuple[Integers, Array, Layout]:
    """`whole`, `real` and where things are in them and in `work`."""
    assert actuation.constants is not None
    n, r = mechanism.n, len(mechanism.rows)
    parent = [-1 if above is None else above for above in mechanism.parent]
    weight = np.conj(np.array(mechanism.weights, complex))
    beside: list[list[tuple[int, complex]]] = [[] for _ in range(n)]
    inertia = [0.0] * n
    for j, k, value in mechanism.A:
        if j == k:
            inertia[j] = value.real
        else:
            beside[j].append((k, value))
            beside[k].append((j, value.conjugate()))
    A = [(j, l, value) for j, entries in enumerate(beside) for l, value in entries]
    P = [(row, l, value) for row, entry in enumerate(mechanism.rows) for l, value in entry.P]

    place = _places(n, A, P)
    pairs = [(place[j], place[l]) for j, l, _ in A] + [(place[n + i], place[l]) for i, l, _ in P]
    first, start, system = _skyline(n + r, pairs)

    joints = [_moving(mechanism, [l for l, _ in row.P]) for row in mechanism.rows]
    joint_start = [0, *itertools.accumulate(len(found) for found in joints)]
    slots = [{k: joint_start[i] + g for g, k in enumerate(found)} for i, found in enumerate(joints)]
    moved: list[list[int]] = [[] for _ in range(n)]  # the rows that each joint moves
    for i, found in enumerate(joints):
        for k in found:
            moved[k].append(i)
    common = {(i, j) for group in moved for i in group for j in group if j < i}
    normal_place = _narrow(r, common)
    normal_first, normal_start, normal = _skyline(
        r, [(normal_place[i], normal_place[j]) for i, j in common]
    )

    whole = {
        "parent": parent,
        "outward": mechanism.order,
        "A_start": _row_starts(n, [j for j, _, _ in A]),
        "A_link": [l for _, l, _ in A],
        "A_spot": [start[place[j]] + place[l] if place[l] < place[j] else -1 for j, l, _ in A],
        "P_start": _row_starts(r, [i for i, _, _ in P]),
        "P_link": [l for _, l, _ in P],
        "P_spot": [start[place[n + i]] + place[l] for i, l, _ in P],
        "P_slot": [slots[i][l] for i, l, _ in P],
        "joint_start": joint_start,
        "joint": [k for found in joints for k in found],
        "joint_above": [
            slots[i].get(parent[k], -1) for i, found in enumerate(joints) for k in found
        ],
        "place": place,
        "first": first,
        "start": start,
        "normal_place": normal_place,
        "normal_row": sorted(range(r), key=normal_place.__getitem__),
        "normal_first": normal_first,
        "normal_start": normal_start,
    }
    real = {
        "inertia": inertia,
        "A_re": [value.real for _, _, value in A],
        "A_im": [value.imag for _, _, value in A],
        "weight_re": weight.real,
        "weight_im": weight.imag,
        "damping": mechanism.damping,
        "torque": actuation.constants,
        "moment": mechanism.moments,
        "P_re": [value.real for _, _, value in P],
        "P_im": [value.imag for _, _, value in P],
        "offset": [row.offset for row in mechanism.rows],
        "size": _sizes(mechanism),
        "closed": [CLOSED * loop_size(mechanism)],
    }
    K = order + 2
    work = dict.fromkeys(("W", "C", "S", "FX", "FY"), n * K)
    work |= {"X": n, "Y": n, "Z_re": len(A), "Z_im": len(A), "power": K}
    work |= {"system": system, "pivot": n + r, "x": n + r}
    work |= {"Psi": joint_start[-1], "normal": normal, "normal_pivot": r, "dense": n}
    work |= {"h": K, "h_angle": K, "alpha": n, "c": n, "s": n, "c0": n, "s0": n}
    at: dict[str, int] = {}
    for lengths in (
        {name: len(values) for name, values in whole.items()},
        {name: len(values) for name, values in real.items()},
        work,
    ):
        begins = itertools.accumulate(lengths.values(), initial=0)
        at |= dict(zip(lengths, begins, strict=False))
    sizes = {"n": n, "rows": r, "entries": len(P), "order": order, "K": K}
    return (
        np.concatenate([np.array(values, np.int64) for values in whole.values()]),
        np.concatenate([np.array(values, np.float64) for values in real.values()]),
        Layout(**sizes, **at, size_of_work=sum(work.values())),
    )


def _row_starts(rows: int, row: Sequence[int]) -> list[int]:
    """Where the rows of entries sorted by row begin, and where the last ends."""
    counts = [0] * rows
    for i in row:
        counts[i] += 1
    return [0, *itertools.accumulate(counts)]


def _moving(mechanism: Mechanism, links: Sequence[int]) -> list[int]:
    """The joints that move any of these links, leaves first."""
    moving = set()
    for link in links:
        above: int | None = link
        while above is not None and above not in moving:
            moving.add(above)
            above = mechanism.parent[above]
    return [k for k in reversed(mechanism.order) if k in moving]


def _places(
    n: int, A: Sequence[tuple[int, int, complex]], P: Sequence[tuple[int, int, complex]]
) -> list[int]:
    """Where links and rows stand in the system: a row after its links, so that no pivot is zero.

    (The links before it have a positive definite M of their own, and the rows full rank on them.)
    """
    members: dict[int, list[int]] = {}
    for row, l, _ in P:
        members.setdefault(row, []).append(l)
    pairs = {(j, l) for j, l, _ in A if l < j}
    pairs |= {(j, l) for links in members.values() for j in links for l in links if l < j}
    narrow = _narrow(n, pairs)
    keys = [(float(narrow[l]), 0) for l in range(n)]
    keys += [(float(max(narrow[l] for l in members[row])), 1 + row) for row in sorted(members)]
    place = [0] * len(keys)
    for i, which in enumerate(sorted(range(len(keys)), key=keys.__getitem__)):
        place[which] = i
    return place


def _narrow(n: int, pairs: set[tuple[int, int]]) -> list[int]:
    """The place of each of n unknowns that keeps coupled pairs together, for large systems."""
    if n <= SMALL or len(pairs) > n * n // 4:
        return list(range(n))
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    i, j = np.array(sorted(pairs)).T
    graph = csr_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(n, n))
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    place: list[int] = np.argsort(order).tolist()
    size, plain = (_skyline(n, [(to[a], to[b]) for a, b in pairs])[2] for to in (place, range(n)))
    return place if size < plain else list(range(n))


def _skyline(n: int, pairs: Iterable[tuple[int, int]]) -> tuple[list[int], list[int], int]:
    """`first` and `start` (n) of a matrix with these entries, and how many numbers it takes."""
    first = list(range(n))
    for i, j in pairs:
        first[max(i, j)] = min(first[max(i, j)], i, j)
    ends = list(itertools.accumulate(i - first[i] + 1 for i in range(n)))
    start = [ends[i] - 1 - i for i in range(n)]
    return first, start, ends[-1] if ends else 0


def _sizes(mechanism: Mechanism) -> list[float]:
    """What the rows' pivots are measured against, m^2."""
    return [sum(abs(value) for _, value in row.P) ** 2 for row in mechanism.rows]
