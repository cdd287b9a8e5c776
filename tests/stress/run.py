"""The stress suite as a report: python tests/stress/run.py [--long] [case ...]

Every case runs in a process of its own with a limit on its time, so that nothing can hang. Prints a table (scene, what
was stressed, worst residual, worst energy error, status) and what is wrong; exits with 1 if anything is.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from own_process import in_own_process  # noqa: E402

# s; the long random scenes are 10,000 runs of some 30 ms
LIMIT_SHORT, LIMIT_LONG = 120.0, 3600.0


def _work(name: str, long: bool, connection: Any) -> None:
    sys.path[:0] = [str(HERE), str(HERE.parent)]
    from stress_cases import CASES

    try:
        for finding in CASES[name](long):
            connection.send(finding)
        connection.send(None)
    except Exception as error:
        connection.send(error)


def run_case(name: str, long: bool) -> tuple[list[Any], str]:
    """Findings of one case, and what ended it before its time."""
    end = time.monotonic() + (LIMIT_LONG if long else LIMIT_SHORT)
    return in_own_process(_work, (name, long), lambda n: max(0.0, end - time.monotonic()), "HANGS")


def main() -> int:
    from stress_cases import CASES

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="case", help=f"any of {', '.join(CASES)}; all by default")
    parser.add_argument("--long", action="store_true", help="hours of motion, ten million steps, 10,000 scenes")
    options = parser.parse_args()
    for name in options.cases:
        if name not in CASES:
            parser.error(f"there is no case {name!r}")
    widths = (24, 38, 10, 10, 18)
    heads = ("scene", "stressed", "residual", "energy", "status")
    print("  ".join(head.ljust(width) for head, width in zip(heads, widths)))
    bad = total = 0
    for name in options.cases or CASES:
        began = time.monotonic()
        findings, trouble = run_case(name, options.long)
        print(f"-- {name}: {len(findings)} rows, {time.monotonic() - began:.1f} s {trouble}")
        bad += bool(trouble)
        for row in findings:
            total += 1
            cells = (row.scene, row.stressed, f"{row.residual:.1e}", f"{row.energy:.1e}", row.status)
            print("  ".join(cell.ljust(width) for cell, width in zip(cells, widths)).rstrip())
            for fault in row.wrong:
                print(f"    WRONG: {fault}")
            bad += bool(row.wrong)
        sys.stdout.flush()
    print(f"{total} rows, {bad} with something wrong")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
