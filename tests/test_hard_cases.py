"""The hard cases of forward simulation: every row of their table passes (`hard_cases`)."""

import pytest

from hard_cases.cases import CASES


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case):
    rows = case.rows()
    failed = [f"{row.measure}: {row.measured}, not {row.bound}" for row in rows if not row.passed]
    assert rows
    assert not failed, "\n".join([case.hard, *failed])
