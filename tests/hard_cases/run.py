"""`make hard`: every hard case in one table; exits 1 where one fails."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from hard_cases.cases import CASES


def main() -> int:
    table = Table("case", "what is hard", "measure", "bound", "measured", "pass")
    failed = 0
    for case in CASES:
        for row in case():
            failed += not row.passed
            numbers = f"{row.bound:.3g}", f"{row.measured:.2g}"
            table.add_row(row.case, row.hard, row.measure, *numbers, "yes" if row.passed else "NO")
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
