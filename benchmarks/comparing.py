"""Two sides of a comparison, in turns: A B A B, so that what else the machine does hits both.

Ratios are judged by floors (floors.toml, a fifth under the median measured, by the release before
and the instruction set) and shown beside goals.
"""

from __future__ import annotations

import json
import os
import subprocess
import tomllib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

WORKER = Path(__file__).with_name("worker.py")
FLOORS = Path(__file__).with_name("floors.toml")
FLOORS_HEADER = """\
# The ratio below which `make bench` fails, for each case, by the release before and the instruction
# set: a fifth under the median measured. Written by `make bench BENCH_OPTIONS=--write-floors`.
"""
MARGIN = 0.8

NOISE = 0.9
"""Ratio to the release before under which a case is slower, whatever its floor."""

SAME = 1e-3
"""Relative difference up to which two certified sums of objectives are those of one program."""

NO_SPINNING = {"OPENBLAS_THREAD_TIMEOUT": "4"}
"""Threads of BLAS sleep at once. By default they wait for 25 ms by turning round, which counts as
time of the processor: short turns took up to twice as long, in one process and not in the next.
"""

GOALS: Mapping[str, float] = {
    "posterior, 2,174 images, CPU": 1.35,
    "one image, people": 1.9,
    "learn-dict, people, CPU": 2.2,
    "subject 13, shuffled": 1.5,
    "made, k=64, p=1000": 10.0,
    "fit, 21,740 images, CPU": 1.1,
    "fit, two threads over one": 1.6,
    "verify, images/s": 1.0,
    "eval, images/s": 1.0,
}
"""The ratio to 051afd75 that a case is meant to have; 1 where what is aimed at stands in the place
of the release before.
"""


@dataclass(frozen=True)
class Turn:
    """Seconds of one run, the share of images that ended well, and a sum of what it found."""

    seconds: float
    well: float = 1.0
    sum: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """How many times faster the second side is: the median of the ratios of neighbouring turns.

    With the median seconds of either, the smallest share of images that ended well, and the
    relative change of the sum.
    """

    ratio: float
    before: float
    now: float
    well_before: float = 1.0
    well: float = 1.0
    change: float = 0.0


Side = Callable[[], Turn]


def compare(before: Side, now: Side, repeats: int) -> Comparison:
    """Run both in turns and summarise."""
    turns = [(before(), now()) for _ in range(repeats)]
    return Comparison(
        ratio=float(np.median([old.seconds / new.seconds for old, new in turns])),
        before=float(np.median([old.seconds for old, _ in turns])),
        now=float(np.median([new.seconds for _, new in turns])),
        well_before=min(old.well for old, _ in turns),
        well=min(new.well for _, new in turns),
        change=turns[-1][1].sum / (turns[-1][0].sum or 1.0) - 1.0,
    )


def compare_workers(
    before: tuple[Path, dict[str, object]],
    now: tuple[Path, dict[str, object]],
    job: str,
    data: Path,
    repeats: int,
) -> Comparison:
    """Compare two environments, each with its options, at one job."""
    with ExitStack() as stack:
        old, new = (
            stack.enter_context(Worker(python, job, data, options))
            for python, options in (before, now)
        )
        return compare(old, new, repeats)


class Worker:
    """A process of worker.py, warm; each call is one turn."""

    def __init__(self, python: Path, job: str, data: Path, options: dict[str, object]) -> None:
        told = [f"{key}={value}" for key, value in options.items()]
        self._process = subprocess.Popen(
            [str(python), "-P", str(WORKER), job, str(data), *told],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd="/",
            env=os.environ | NO_SPINNING,
        )
        self._read()

    def __call__(self) -> Turn:
        """Take a turn."""
        assert self._process.stdin
        self._process.stdin.write("go\n")
        self._process.stdin.flush()
        return Turn(**json.loads(self._read()))

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def _read(self) -> str:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a worker ended with exit code {self._process.wait()}")
        return line


@dataclass(frozen=True)
class Row:
    """What a case took before and takes now, and the ratio.

    certified is the share of images solved to their gap, None where there is no certificate;
    least the ratio that it must have even without a floor.
    """

    case: str
    before: str
    now: str
    ratio: float
    certified: float | None = None
    least: float = 0.0
    fault: str = ""


def compared(
    case: str,
    found: Comparison,
    *,
    images: int = 0,
    certified: bool = False,
    least: float = NOISE,
    unit: str = "s",
) -> Row:
    """Make a row of a comparison: images per second where their number is known, else seconds."""
    before, now = (
        f"{images / seconds:,.0f}/s" if images else f"{seconds:.3g} {unit}"
        for seconds in (found.before, found.now)
    )
    fault = ""
    if found.well < found.well_before:
        fault = f"{found.well:.2%} of the images end well, {found.well_before:.2%} did"
    if certified and abs(found.change) > SAME:
        fault = f"the sum of the objectives changed by {found.change:.1e} of it"
    share = found.well if certified else None
    return Row(case, before, now, found.ratio, share, least, fault)


@dataclass
class Table:
    """Rows as they come, judged by the floors of their cases."""

    floors: Mapping[str, float]
    rows: list[Row] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    heading = (
        "| case | before | now | ratio | goal | floor | certified |\n|---|--:|--:|--:|--:|--:|--:|"
    )

    def add(self, row: Row) -> str:
        """Judge a row and return its line."""
        self.rows.append(row)
        floor = self.floors.get(row.case)
        least = max(row.least, floor or 0.0)
        if row.ratio < least:
            self.faults.append(f"{row.case}: ratio {row.ratio:.2f} is under {least:.2f}.")
        if row.certified is not None and row.certified < 1:
            self.faults.append(f"{row.case}: only {row.certified:.2%} of the images are certified.")
        if row.fault:
            self.faults.append(f"{row.case}: {row.fault}.")
        certified = "" if row.certified is None else f"{row.certified:.0%}"
        goal, shown = (
            "" if number is None else f"{number:.2f}" for number in (GOALS.get(row.case), floor)
        )
        cells = (row.case, row.before, row.now, f"{row.ratio:.2f}", goal, shown, certified)
        return f"| {' | '.join(cells)} |"

    def goals(self) -> str:
        """Return the table of what was aimed at beside what was measured."""
        lines = ["| goal | asked | measured | |", "|---|--:|--:|---|"]
        for row in self.rows:
            if (asked := GOALS.get(row.case)) is not None:
                verdict = "met" if row.ratio >= asked else "missed"
                lines.append(f"| {row.case} | {asked:.2f} | {row.ratio:.2f} | {verdict} |")
        return "\n".join(lines)


Floors = dict[str, dict[str, dict[str, float]]]


def read_floors() -> Floors:
    """Return floors by base, level and case."""
    return tomllib.loads(FLOORS.read_text(encoding="utf-8")) if FLOORS.is_file() else {}


def write_floors(base: str, level: str, ratios: Mapping[str, float]) -> None:
    """Set the floors of the cases measured against a base at a level; the others stay."""
    floors = read_floors()
    cases = floors.setdefault(base, {}).setdefault(level, {})
    cases |= {case: float(f"{MARGIN * ratio:.3g}") for case, ratio in ratios.items()}
    text = FLOORS_HEADER
    for name, levels in sorted(floors.items()):
        for rung, values in sorted(levels.items()):
            text += f'\n["{name}".{rung}]\n'
            text += "".join(f'"{case}" = {floor:g}\n' for case, floor in values.items())
    FLOORS.write_text(text, encoding="utf-8")
