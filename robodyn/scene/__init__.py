"""What a scene file says: its grammar, the numbers and units in it, and the examples."""
