"""A run: its settings and record, scipy's solvers, its accuracy and its reference."""
