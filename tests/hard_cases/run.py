"""`make hard`: every hard case in one table, printed as it is measured; exits 1 where one fails.

python tests/hard_cases/run.py [TABLE ...]      only those, named as functions of cases.py
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from hard_cases.cases import CASES


def main(names: list[str]) -> int:
    known = {case.__name__: case for case in CASES}
    if unknown := [name for name in names if name not in known]:
        print(f"{__doc__}\n{', '.join(unknown)}: no table; there are\n  " + "\n  ".join(known))
        return 2
    failed = []
    for name in names or known:
        begin, worst, count = time.perf_counter(), 0.0, 0
        for row in known[name]():
            told = f"{row.case}: {row.measure}, {row.hard}: {row.measured:.2g} (<= {row.bound:.3g})"
            print("ok " if row.passed else "NO ", told, flush=True)
            failed += [] if row.passed else [told]
            worst, count = max(worst, row.measured / row.bound if row.bound else 0.0), count + 1
        seconds = time.perf_counter() - begin
        print(
            f"-- {name}: {count} rows, {seconds:.0f} s, at worst {worst:.2g} of a bound", flush=True
        )
    print(*(f"FAILED {told}" for told in failed), f"{len(failed)} failed", sep="\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
