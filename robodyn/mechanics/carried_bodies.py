"""The links as bodies: what the equations of motion are linear in, and its sums along the tree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from robodyn.mechanics.link_tree import Tree
from robodyn.scene.scene import Link


class Bodies(NamedTuple):
    """Of each link with its payload: mass, kg, first moment, kg m, and J about its joint, kg m^2.

    Both about the link's own origin, in its frame.
    """

    mass: list[float]
    first: list[complex]
    inertia: list[float]


def bodies(links: Sequence[Link]) -> Bodies:
    """What the links are to the equations of motion, which are linear in it."""
    return Bodies(
        [link.m + link.payload for link in links],
        [link.r * link.m + link.l * link.payload for link in links],
        [link.I + link.m * _square(link.r) + link.payload * link.l * link.l for link in links],
    )


def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


def carried_by(
    tree: Tree, own: Bodies | None = None
) -> tuple[list[float], list[complex], list[float]]:
    """Of all that each link carries: its mass, its first moment B_k, and A_kk."""
    links = tree.links
    given = own or bodies(links)
    mass, B, inertia = list(given.mass), list(given.first), list(given.inertia)
    for k in reversed(tree.order):  # what link k carries acts on its parent at k's own joint
        p, j = links[k].hangs_from.at, tree.parent[k]
        if j is not None:
            mass[j] += mass[k]
            B[j] += p * mass[k]
            inertia[j] += mass[k] * _square(p)
    return mass, B, inertia


def largest(tree: Tree) -> Iterator[complex]:
    """Numbers that are finite only where A is: the products' sizes, from below."""
    _, B, inertia = carried_by(tree)
    yield from map(complex, inertia)
    most = [max(abs(b.real), abs(b.imag)) for b in B]
    for k in reversed(tree.order):
        p, j = tree.links[k].hangs_from.at, tree.parent[k]
        if j is not None:
            most[j] = max(most[j], most[k])
            yield complex(max(abs(p.real), abs(p.imag)) * most[k] * 2.0)
