"""What a grammar is made of: keys, and mappings with known keys."""

from __future__ import annotations

from typing import NamedTuple

ONE = "one of the three"  # what stands for a key of several that exclude one another


class Key(NamedTuple):
    """A key of a mapping: the kind of its value, what it is, its unit, and what stands for it."""

    kind: str
    help: str
    unit: str = ""
    default: str = "needed"  # as it is told
    listed: bool = False  # whether the value is a list of this kind
    hint: str = ""  # what a message adds where a limit is not kept
    symbol: str = ""  # its letters in equations, and what a legend says of it

    @property
    def needed(self) -> bool:
        """Whether a file must have it."""
        return self.default == "needed"

    @property
    def absent(self) -> bool:
        """Whether there is nothing where a file leaves it out."""
        return self.default in ("none", "the ground", ONE)


class Form(NamedTuple):
    """A mapping with known keys."""

    help: str
    keys: dict[str, Key]
    one: tuple[str, ...] = ()  # keys of which a file must have exactly one

    def named(self, needed: bool) -> list[str]:
        """The keys that a file must have, or the others."""
        return [name for name, key in self.keys.items() if key.needed == needed]
