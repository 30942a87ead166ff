"""Export of a mechanism to formats of other tools."""
