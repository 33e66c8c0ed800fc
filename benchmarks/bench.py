"""Compare with the release before; floors must hold.

Usage: python -m benchmarks.bench [--data FOLDER] [--cars FOLDER] [--only CASE]...
[--quick]
           [--base REVISION] [--write-floors]
Prints a Markdown table. Exit code 1 where a ratio is under its floor, an
image is not certified, or a case does not run.

The two versions take turns, A B A B, so that whatever else the machine does hits both.
Floors are in floors.toml, by the release before and the instruction set: a fifth under
the median measured.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np

from benchmarks.cases import PROJECT, Bench, Environment, Row, cases
from shapefit import core

DATA = PROJECT.parent / "shared" / "data"
FIRST_BASE = "051afd75"
"""What is compared with where there is no tag yet."""

FLOORS = Path(__file__).with_name("floors.toml")
FLOORS_HEADER = """\
# The ratio below which `make bench` fails, for each case, by the release before and the
# instruction set: a fifth under the median measured.
# Written by `make bench BENCH_OPTIONS=--write-floors`.
"""
MARGIN = 0.8

NOISE = 0.9
"""Ratio to the release before under which a case without a floor is slower."""

SAME = 1e-3
"""Relative difference up to which two certified sums of objectives are those of one
program.
"""


def main() -> None:
    """Measure the cases against the release before, print them as a table, and end with
    exit code 1 where a floor does not hold.
    """
    arguments = read_arguments()
    base = arguments.base or find_base()
    table = Table(read_floors().get(base, {}).get(core.LEVEL, {}))
    sides = install_base(base), install_working_tree()
    print(f"Against {base}, level {core.LEVEL}.\n\n{Table.heading}")
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(
            *sides, arguments.data, arguments.cars, Path(name), arguments.quick
        )
        for case, run in cases(bench):
            if not arguments.only or any(part in case for part in arguments.only):
                try:
                    print(table.add(run()), flush=True)
                except (
                    RuntimeError
                ) as error:  # the other cases are measured all the same
                    table.faults.append(f"{case}: not measured. {error}")
    if arguments.write_floors:
        write_floors(base, core.LEVEL, {row.case: row.ratio for row in table.rows})
    print("\n" + "\n".join(table.faults or ["Every floor holds."]))
    sys.exit(bool(table.faults))


def read_arguments() -> argparse.Namespace:
    """Return the options of the command line, None for folders of data that are not
    there.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--data", type=Path, default=DATA / "mocap", help="motion capture files"
    )
    parser.add_argument(
        "--cars", type=Path, default=DATA / "cars", help="annotated cars"
    )
    parser.add_argument(
        "--only", action="append", default=[], help="cases whose name holds this"
    )
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
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


def find_base() -> str:
    """Return the last tag before this commit, or FIRST_BASE."""
    named = git("describe", "--tags", "--abbrev=0", "HEAD^")
    return named.stdout.decode().strip() if named.returncode == 0 else FIRST_BASE


def install_base(revision: str) -> Environment:
    """Return the environment of a revision, installed in build/bench once, as a user
    would.
    """
    named = git("rev-parse", "--short=12", f"{revision}^{{commit}}")
    if named.returncode:
        sys.exit(f"bench: no revision {revision} in this repository")
    folder = PROJECT / "build/bench" / named.stdout.decode().strip()
    environment = Environment(folder / "source", folder / "environment")
    if not environment.command.is_file():
        packed = git("archive", "--format=tar", revision).stdout
        with tarfile.open(fileobj=BytesIO(packed)) as archive:
            archive.extractall(environment.source, filter="data")
        install(environment)
    return environment


def install_working_tree() -> Environment:
    """Return the environment of the working tree, installed anew; its dependencies stay
    from one run to the next.
    """
    environment = Environment(PROJECT, PROJECT / "build/bench/this")
    again = ["--force-reinstall", "--no-deps"] if environment.command.is_file() else []
    install(environment, *again)
    return environment


def install(environment: Environment, *options: str) -> None:
    """Build a wheel of an environment's source, with the build tools of the running
    one, and install it there with its dependencies; options are those of pip.
    """
    if not environment.python.is_file():
        subprocess.run(
            [sys.executable, "-m", "venv", str(environment.folder)], check=True
        )
    wheels = environment.folder / "wheels"
    shutil.rmtree(wheels, ignore_errors=True)
    quiet = "-q", "--disable-pip-version-check"
    build = ["--no-deps", "--no-build-isolation", "-C", "build-dir=build/{wheel_tag}"]
    where = ["-w", str(wheels), str(environment.source)]
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", *quiet, *build, *where], check=True
    )
    constraints = "--constraint", str(environment.source / "constraints.txt")
    pip = [
        str(environment.python),
        "-m",
        "pip",
        "install",
        *quiet,
        *options,
        *constraints,
    ]
    wheel = next(wheels.glob("shapefit-*.whl"))
    subprocess.run([*pip, f"{wheel}[plots]"], check=True)


def git(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    """Run git in the project; return its exit code and output, also where it fails."""
    return subprocess.run(
        ["git", *arguments], cwd=PROJECT, capture_output=True, check=False
    )


@dataclass
class Table:
    """The rows measured so far, and what is wrong with them by the floors of their
    cases.
    """

    floors: Mapping[str, float]
    rows: list[Row] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    heading = (
        "| case | before | now | ratio | imports of NumPy | floor | certified |\n"
        "|---|--:|--:|--:|--:|--:|--:|"
    )

    def add(self, row: Row) -> str:
        """Add a row and its faults; return its line in Markdown."""
        self.rows.append(row)
        floor = self.floors.get(row.case)
        least = NOISE if floor is None else floor
        faults = [
            (row.ratio < least, f"ratio {row.ratio:.2f} is under {least:.2f}"),
            (row.certified and row.well < 1, f"only {row.well:.2%} are certified"),
            (
                row.well < row.well_before,
                f"{row.well:.2%} end well, {row.well_before:.2%} did",
            ),
            (
                row.certified and abs(row.change) > SAME,
                f"the sum of the objectives changed by {row.change:.1e} of it",
            ),
        ]
        self.faults += [f"{row.case}: {text}." for is_fault, text in faults if is_fault]
        imports = "" if np.isnan(row.imports) else f"{row.imports:.1f}"
        shown = "" if floor is None else f"{floor:.2f}"
        certified = f"{row.well:.0%}" if row.certified else ""
        cells = (
            row.case,
            row.before,
            row.now,
            f"{row.ratio:.2f}",
            imports,
            shown,
            certified,
        )
        return f"| {' | '.join(cells)} |"


def read_floors() -> dict[str, dict[str, dict[str, float]]]:
    """Return base -> instruction set -> case -> least ratio, as floors.toml has
    them.
    """
    return tomllib.loads(FLOORS.read_text(encoding="utf-8"))


def write_floors(base: str, level: str, ratios: Mapping[str, float]) -> None:
    """Write floors from the ratios of the cases that were measured against a base at an
    instruction set; the others stay.
    """
    floors = read_floors() if FLOORS.is_file() else {}
    of_level = floors.setdefault(base, {}).setdefault(level, {})
    of_level |= {case: float(f"{MARGIN * ratio:.3g}") for case, ratio in ratios.items()}
    text = FLOORS_HEADER
    for name, levels in sorted(floors.items()):
        for rung, values in sorted(levels.items()):
            text += f'\n["{name}".{rung}]\n'
            text += "".join(f'"{case}" = {floor:g}\n' for case, floor in values.items())
    FLOORS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
