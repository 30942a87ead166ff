"""The examples that have no equations: friction by the forces in pins, which are unknowns."""

UNWRITTEN = frozenset(("shaper",))
