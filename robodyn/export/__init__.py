"""The same mechanism in the formats of other tools."""
