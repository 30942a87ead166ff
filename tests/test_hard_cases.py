"""The hard cases of `make hard`, asserted row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hard_cases.cases import (
    CASES,
    Row,
    bounces_without_end,
    double_pendulum,
    events_at_one_instant,
    grazes,
    inconsistent_start,
    long_run,
    long_stick_slip,
    mass_ratios,
    near_miss_commands,
    near_miss_motions,
    near_miss_states,
    parallel_bars,
    parallel_bars_by_chance,
    redundant_closures,
    seven_body,
    sines,
)

# test_near_misses.py, test_machine_code.py, test_contacts.py and test_cli_simulate.py have theirs
ELSEWHERE = (
    near_miss_states,
    near_miss_commands,
    near_miss_motions,
    sines,
    bounces_without_end,
    inconsistent_start,
)
CHOSEN = [case for case in CASES if case not in ELSEWHERE]
PARTS: dict[Callable[..., Iterator[Row]], int] = {
    parallel_bars: 2,
    double_pendulum: 10,
    redundant_closures: 5,
    long_run: 100,
    mass_ratios: 10,
    long_stick_slip: 10,
    events_at_one_instant: 10,
    grazes: 5,
    parallel_bars_by_chance: 30,
    seven_body: 2,
}  # `make hard` takes all of them


@pytest.mark.parametrize("case", CHOSEN, ids=lambda case: case.__name__)
def test_hard_case(case: Callable[..., Iterator[Row]]) -> None:
    rows = list(case(PARTS[case]) if case in PARTS else case())
    assert rows
    assert [row for row in rows if not row.passed] == []
