"""The hard cases of forward simulation: scenes, measures and bounds, one table.

`PYTHONPATH=tests python -m hard_cases` prints it; `tests/test_hard_cases.py` asserts its rows.
"""
