"""Scene files: their grammar, numbers and units, and the examples."""
