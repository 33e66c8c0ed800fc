"""Whether the verdict on each frame is right: the error of trusted and of doubtful frames.

`python -m benchmarks.verdict` reads what `make detected` left in results/detected, and prints for
each set and method how many frames are doubted, and the mean similarity error (normalised) of the
others and of these; then the same by reason, over all sets.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

from benchmarks.detected import FOLDER, WITH_BARS
from shapefit.evaluation.report import markdown_table


def errors_of(folder: Path, method: str) -> dict[str, float]:
    """Return the similarity error of each item of a report, normalised."""
    with (folder / "report/per_image.csv").open(encoding="utf-8") as file:
        return {
            row["item"]: float(row["error"] or "nan")
            for row in csv.DictReader(file)
            if (row["method"], row["metric"], row["unit"]) == (method, "similarity", "normalised")
        }


def doubts_of(path: Path) -> dict[str, str]:
    """Return the doubt of each item of a result, "" where it is trusted."""
    with h5py.File(path) as file:
        items, doubts = file["item"].asstr()[:], file["doubt"].asstr()[:]
    return dict(zip(items, doubts, strict=True))


def mean(values: Iterable[float]) -> str:
    """Return a mean as the table has it."""
    known = np.array([value for value in values if np.isfinite(value)])
    return f"{known.mean():.3f}" if len(known) else "-"


def main() -> None:
    """Print the two tables."""
    rows, reasons = [], defaultdict(list)
    for folder in sorted(path.parent for path in FOLDER.glob("*/report")):
        for method in WITH_BARS:
            errors, doubts = errors_of(folder, method), doubts_of(folder / f"{method}.h5")
            judged = [(errors[item], doubt) for item, doubt in doubts.items() if item in errors]
            for error, doubt in judged:
                reasons[doubt or "trusted"].append(error)
            bad = [error for error, doubt in judged if doubt]
            good = [error for error, doubt in judged if not doubt]
            rows.append(
                (folder.name, method, f"{len(bad)} of {len(judged)}", mean(good), mean(bad))
            )
    print(markdown_table(("set", "method", "doubted", "error, trusted", "error, doubted"), rows))
    print(
        markdown_table(
            ("doubt", "frames", "error"),
            [(reason, str(len(found)), mean(found)) for reason, found in sorted(reasons.items())],
        )
    )


if __name__ == "__main__":
    main()
