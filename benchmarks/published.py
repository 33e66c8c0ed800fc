"""The paper's numbers set beside ours, in the reports of `eval` and `simulate`.

`python -m benchmarks.published mocap FOLDER` adds the rows and caveats of published.yaml to
report.md and report.json of an evaluation in FOLDER and prints the page; `recovery FOLDER` adds the
paper's shares to recovery.md, recovery.json and, with matplotlib, the picture of a simulation.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from benchmarks.oracles import oracle_rows
from shapefit.evaluation.calibration import Coverage
from shapefit.evaluation.recovery import Place, shares_table
from shapefit.evaluation.report import (
    Method,
    Report,
    Solving,
    as_markdown,
    report_blocks,
    report_json,
)
from shapefit.evaluation.summaries import Kept, Summary
from shapefit.io.whole.folder import Write, write_folder

QUOTED = Path(__file__).with_name("published.yaml")

OF_A_REPORT = {"methods", "summaries", "published", "caveats", "warnings"}
OF_ERROR_BARS = {"calibration", "trusted", "without_error_bars", "parallel_error_bars"}


def beside_errors(name: str, folder: Path, oracles: Sequence[Summary] = ()) -> str:
    """Add rows and caveats to the report of an evaluation; return its page."""
    quoted = _quoted(name)
    known = _read(folder / "report.json")
    report = Report(
        methods=tuple(
            Method(
                name=method["name"],
                files=tuple(method["files"]),
                images=method["images"],
                failures={each["item"]: each["reason"] for each in method["failures"]},
                solving=Solving(**method["solving"]),
            )
            for method in known["methods"]
        ),
        summaries=(*(Summary(**_with_nan(s)) for s in known["summaries"]), *oracles),
        published=quoted["rows"],
        caveats=tuple(quoted["caveats"]),
        warnings=tuple(known["warnings"]),
        coverage=tuple(_coverage(each) for each in known["calibration"]),
        kept=tuple(Kept(**each) for each in known["trusted"]),
        without_bars=tuple(known["without_error_bars"]),
        parallel=tuple(known["parallel_error_bars"]),
        provenance={
            key: value for key, value in known.items() if key not in OF_A_REPORT | OF_ERROR_BARS
        },
    )
    page = as_markdown(report_blocks(report))
    plots = (folder / "report.md").read_text(encoding="utf-8").partition("\n## Plots\n")
    write_folder(
        folder,
        {"report.md": _text(page + "".join(plots[1:])), "report.json": _text(report_json(report))},
    )
    return page


def beside_shares(folder: Path) -> str:
    """Add the paper's shares of exact recoveries to a simulation; return the new part of its page.

    The deviation of a cell is our share minus the paper's.
    """
    quoted = _quoted("recovery")
    paper: dict[Place, float] = {
        (p, z): share
        for p, row in zip(quoted["landmarks"], quoted["success"], strict=True)
        for z, share in zip(quoted["active_atoms"], row, strict=True)
    }
    report = _read(folder / "recovery.json")
    ours: dict[Place, float] = {(c["p"], c["z"]): c["success"] for c in report["cells"]}
    deviations = {at: share - paper[at] for at, share in ours.items() if at in paper}
    if not deviations:
        return ""
    report["published"] = {
        "source": quoted["source"],
        "cells": [
            {"p": p, "z": z, "success": paper[p, z], "deviation": deviation}
            for (p, z), deviation in deviations.items()
        ],
        "largest_deviation": max(map(abs, deviations.values())),
    }
    (p, z), most = max(deviations.items(), key=lambda item: abs(item[1]))
    shown = {at: paper[at] for at in deviations}
    parts = [
        "## Published",
        quoted["source"],
        shares_table(shown),
        "## Ours minus published",
        f"The largest deviation is {most:+.2f}, at p = {p} and z = {z}.",
        shares_table(deviations, "+.2f"),
    ]
    page = "\n\n".join(parts) + "\n"
    before = (folder / "recovery.md").read_text(encoding="utf-8").partition("\n## Published\n")[0]
    writers = {
        "recovery.md": _text(f"{before.rstrip()}\n\n{page}"),
        "recovery.json": _text(json.dumps(report, indent=2, ensure_ascii=False) + "\n"),
    }
    write_folder(folder, writers | _heat_maps({"Share recovered exactly": ours, "Paper": shown}))
    return page


def _heat_maps(panels: dict[str, dict[Place, float]]) -> dict[str, Write]:
    if find_spec("matplotlib") is None:
        return {}
    from shapefit.evaluation.experiment_plots import heat_maps
    from shapefit.evaluation.plots import writers

    return {**writers("recovery", heat_maps(panels, "landmarks p", "atoms in use z"))}


def _quoted(name: str) -> Any:
    return YAML(typ="safe").load(QUOTED)[name]


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _coverage(stored: Mapping[str, Any]) -> Coverage:
    """Return the coverage of a landmark, with nan for what JSON has as null."""
    nan = float("nan")
    inside = tuple(nan if share is None else share for share in stored["inside"])
    known = stored["median_width"].items()
    width = {unit: nan if value is None else value for unit, value in known}
    return Coverage(**{**stored, "inside": inside, "median_width": width})


def _with_nan(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return a summary with nan for what JSON has as null; `sequence` may be None."""
    numbers = ("mean", "median", "p90")
    return {
        key: float("nan") if value is None and key in numbers else value
        for key, value in summary.items()
    }


def _text(text: str) -> Write:
    return lambda path: path.write_text(text, encoding="utf-8")


REPORTS: dict[str, Callable[[Path], str]] = {
    "mocap": lambda folder: beside_errors("mocap", folder),
    "cars": lambda folder: beside_errors("cars", folder, oracle_rows(folder)),
    "recovery": beside_shares,
}


def main() -> None:
    """Add what was published to the report named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=REPORTS)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    print(REPORTS[options.name](options.folder), end="")


if __name__ == "__main__":
    main()
