"""Where a mechanism rests, how it moves near by, and what to feed back to keep it there."""
