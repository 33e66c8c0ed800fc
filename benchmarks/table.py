"""The table of a run, a line for each case, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from benchmarks.pairs import Comparison

NOISE = 0.9
"""Ratio to the release before under which a case is slower, whatever its floor."""

SAME = 1e-3
"""Relative difference up to which two certified sums of objectives are those of one program."""


GOALS: Mapping[str, float] = {
    "subject 13, gap 1e-4": 1.15,
    "subject 13, gap 1e-6": 1.15,
    "cars, convex+refine": 1.5,
    "cars, alternate": 1.5,
    "posterior, 32 components, p=15": 4.0,
    "posterior, 32 components, p=41": 5.0,
    "posterior, 32 components, p=75": 5.0,
    "sequences end to end": 3.0,
    "fit, 21,740 images, CPU": 2.0,
    "fit, 10^6 images, CPU": 2.0,
    "fit, two threads over one": 1.6,
    "import numpy over one image, CSV to CSV": 1 / 3.3,
    "verify, images/s": 1.0,
    "plan and manifest of 10^5 files, files/s": 1.0,
    "eval, images/s": 1.0,
    "install, CPU": 4.0,
    "make demo, fresh clone, in a minute": 1.0,
}
"""The ratio that a case is meant to have, against 82ffeac where it is one to the release before; 1
where what is aimed at stands in the place of the release before.
"""


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
        return (
            f"| {row.case} | {row.before} | {row.now} | {row.ratio:.2f} | {goal} | {shown} "
            f"| {certified} |"
        )

    def goals(self) -> str:
        """Return the table of what was aimed at beside what was measured."""
        lines = ["| goal | asked | measured | |", "|---|--:|--:|---|"]
        for row in self.rows:
            if (asked := GOALS.get(row.case)) is not None:
                verdict = "met" if row.ratio >= asked else "missed"
                lines.append(f"| {row.case} | {asked:.2f} | {row.ratio:.2f} | {verdict} |")
        return "\n".join(lines)


def reached(case: str, asked: float, rate: float) -> Row:
    """Make a row of images per second beside those asked for."""
    return Row(case, f"{asked:,.0f}/s", f"{rate:,.0f}/s", rate / asked)


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
