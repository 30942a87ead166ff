"""Functions for notebooks and scripts: the commands, and how results display themselves."""
