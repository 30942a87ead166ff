"""Trees of links on pins and slides with drawn numbers, and the scenes that users would write."""

from __future__ import annotations

import numpy as np


def link(name, m, l, r, I, parent, at, axis=None):
    """A link for the oracle and as YAML."""
    found = {"name": name, "m": m, "l": l, "r": complex(r), "I": I, "parent": parent, "at": at}
    return found | ({} if axis is None else {"axis": axis / abs(axis)})


def random_tree(seed: int, joints: str, parents) -> list[dict]:
    """Links with joints such as RPR, their numbers drawn."""
    rng = np.random.default_rng(seed)

    def point(size):
        return complex(*rng.uniform(-size, size, 2))

    return [
        link(
            f"link{k}",
            rng.uniform(0.2, 2.0),
            rng.uniform(0.3, 1.0),
            point(0.4),
            rng.uniform(0.01, 0.3),
            parent,
            point(0.8),
            point(1.0) if kind == "P" else None,
        )
        for k, (kind, parent) in enumerate(zip(joints, parents, strict=True))
    ]


def text_of(tree, gamma, closures=(), lines=(), actuated=None) -> str:
    """The scene that a user would write."""

    def place(parent, at):
        own = [at.real, at.imag]
        return own if parent is None else f"{{link: {tree[parent]['name']}, at: {own}}}"

    rows = [f"gravity: [{gamma.real!r}, {gamma.imag!r}]", "links:"]
    for each in tree:
        slides = ""
        if "axis" in each:
            slides = f"joint: prismatic, axis: [{each['axis'].real!r}, {each['axis'].imag!r}], "
        rows.append(
            f"  - {{name: {each['name']}, {slides}m: {each['m']!r}, l: {each['l']!r}, "
            f"r: [{each['r'].real!r}, {each['r'].imag!r}], I: {each['I']!r}, "
            f"from: {place(each['parent'], each['at'])}}}"
        )
    written = [f"  - [{place(*a)}, {place(*b)}]" for a, b in closures]
    for (first, a), (second, b), along in lines:
        carrier = "" if second is None else f"link: {tree[second]['name']}, "
        written.append(
            f"  - {{point: {place(first, a)}, on: {{{carrier}through: [{b.real!r}, {b.imag!r}], "
            f"along: [{along.real!r}, {along.imag!r}]}}}}"
        )
    rows += ["closures:", *written] if written else []
    if actuated is not None:
        rows.append(f"actuated: [{', '.join(tree[k]['name'] for k in actuated)}]")
    return "\n".join(rows) + "\n"
