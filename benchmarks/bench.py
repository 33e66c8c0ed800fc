"""Compare with the release before and with other solvers; floors must hold.

Usage: python -m benchmarks.bench [--data FOLDER] [--cars FOLDER] [--only CASE]... [--quick]
           [--base REVISION] [--write-floors]
Prints a Markdown table, then one of the goals. Exit code 1 where a ratio is under its floor, or an
image is not certified.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from benchmarks.cases import Bench, cases
from benchmarks.comparing import Table, read_floors, write_floors
from benchmarks.environments import (
    PROJECT,
    base_environment,
    find_base,
    this_environment,
)
from shapefit import core

DATA = PROJECT.parent / "shared" / "data"


def main() -> None:
    """Measure, print, judge."""
    arguments = read_arguments()
    base = arguments.base or find_base()
    sides = base_environment(base), this_environment()
    table = Table(read_floors().get(base, {}).get(core.LEVEL, {}))
    print(f"Against {base}, level {core.LEVEL}.\n\n{table.heading}")
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(*sides, arguments.data, arguments.cars, Path(name), arguments.quick)
        for case, run in cases(bench):
            if not arguments.only or any(part in case for part in arguments.only):
                try:
                    print(table.add(run()), flush=True)
                except RuntimeError as error:  # the other cases are measured all the same
                    table.faults.append(f"{case}: not measured. {error}")
    if arguments.write_floors:
        write_floors(base, core.LEVEL, {row.case: row.ratio for row in table.rows})
    print(f"\n{table.goals()}\n\n" + "\n".join(table.faults or ["Every floor holds."]))
    sys.exit(bool(table.faults))


def read_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "mocap", help="motion capture files")
    parser.add_argument("--cars", type=Path, default=DATA / "cars", help="annotated cars")
    parser.add_argument("--only", action="append", default=[], help="cases whose name holds this")
    parser.add_argument("--quick", action="store_true", help="fewer cases, repeats and images")
    parser.add_argument("--base", help="revision to compare with; else the last tag")
    parser.add_argument(
        "--write-floors", action="store_true", help="a fifth under what is measured"
    )
    arguments = parser.parse_args()
    for name in ("data", "cars"):
        if not getattr(arguments, name).is_dir():
            print(f"No {getattr(arguments, name)}: cases left out.", file=sys.stderr)
            setattr(arguments, name, None)
    return arguments


if __name__ == "__main__":
    main()
