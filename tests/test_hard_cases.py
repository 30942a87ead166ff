"""The hard cases of `make hard`, asserted row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hard_cases.cases import (
    CASES,
    Row,
    events_at_one_instant,
    long_run,
    long_stick_slip,
    mass_ratios,
    near_misses,
    parallel_bars,
    parallel_bars_by_chance,
    sines,
)

# test_near_misses.py and test_machine_code.py have smaller ones
CHOSEN = [case for case in CASES if case not in (near_misses, sines)]
PARTS: dict[Callable[..., Iterator[Row]], int] = {
    parallel_bars: 2,
    long_run: 40,
    mass_ratios: 5,
    long_stick_slip: 10,
    events_at_one_instant: 4,
    parallel_bars_by_chance: 20,
}  # `make hard` takes all of them


@pytest.mark.parametrize("case", CHOSEN, ids=lambda case: case.__name__)
def test_hard_case(case: Callable[..., Iterator[Row]]) -> None:
    rows = list(case(PARTS[case]) if case in PARTS else case())
    assert rows
    assert [row for row in rows if not row.passed] == []
