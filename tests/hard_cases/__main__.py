"""Run every hard case and print the table; exit 1 if a row fails."""

import os
import sys
from concurrent.futures import ProcessPoolExecutor

from rich.console import Console
from rich.table import Table

from hard_cases.cases import CASES, Row


def rows_of(index: int) -> list[Row]:
    return CASES[index].rows()


def main() -> int:
    with ProcessPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        results = list(pool.map(rows_of, range(len(CASES))))
    table = Table("case", "what is hard", "measure", "bound", "measured", "pass")
    for rows in results:
        table.add_section()
        for k, row in enumerate(rows):
            told = (row.case, row.hard) if k == 0 else ("", "")
            verdict = "yes" if row.passed else "[bold red]NO"
            table.add_row(*told, row.measure, row.bound, row.measured, verdict)
    Console(width=None if sys.stdout.isatty() else 200).print(table)
    every = [row for rows in results for row in rows]
    failed = sum(not row.passed for row in every)
    print(f"{len(every)} rows, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
