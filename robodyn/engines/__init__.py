"""Evaluators of recorded formulas: Python code, numpy arrays, machine code."""
