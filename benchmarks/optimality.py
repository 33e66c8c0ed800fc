"""How often each method with one rotation is optimal, and what its gap consists of.

`python -m benchmarks.optimality FOLDER` reads the results of `make paper` in FOLDER.
The best objective known is that of the global search. What lies between it and the
objective of a method is due to the method's search; what lies between it and the bound
of the convex program to the relaxation. Coefficients of either sign are another model:
such results are refused.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import h5py
import numpy as np

from shapefit.arrays import Floats
from shapefit.evaluation.report import markdown_table

METHODS = {"Convex+refine": "refine", "Alternate, c >= 0": "alternate-nonnegative"}
WITHIN = 0.01
"""How far above the global optimum an objective may be that counts as optimal."""


def sections(folder: Path) -> list[str]:
    """Return the section of the index on optimality as paragraphs, from the results in
    a folder; [] where the global search was not run.
    """
    if not (folder / "global.h5").exists():
        return []
    with h5py.File(folder / "global.h5") as file:
        best = file["objective"][:]
        gap = file["relative_gap"][:]
        status = file["status"].asstr()[:]
    known = np.isfinite(best)
    certified = (status[known] == "optimal").mean()
    lines = [
        f"Certified to {WITHIN:.0%}: {certified:.2%} of {known.sum():,} images; largest"
        f" gap {gap[known].max():.2%}."
    ]
    found = {
        name: read_objectives(folder / f"{stem}.h5") for name, stem in METHODS.items()
    }
    objectives = np.stack([objective for objective, _ in found.values()])
    found["the better of both"] = (
        np.where(np.isnan(objectives), np.inf, objectives).min(0),
        None,
    )
    rows = [method_row(name, best, *of_method) for name, of_method in found.items()]
    header = [
        "method",
        f"not optimal within {WITHIN:.0%}",
        "excess there, mean (largest)",
        "mean gap to the convex bound",
        "of it the search's",
        "of it the relaxation's",
    ]
    return [
        "### How often each method is optimal",
        " ".join(lines),
        markdown_table(header, rows),
    ]


def read_objectives(path: Path) -> tuple[Floats, Floats | None]:
    """Read objectives (n,) and relative gaps (n,) of a result. Raises ValueError where
    its model is not that of the global search.
    """
    with h5py.File(path) as file:
        if json.loads(file.attrs["config"])["signed"]:
            raise ValueError(f"{path}: coefficients of either sign are another model")
        gap = file["relative_gap"][:] if "relative_gap" in file else None
        return file["objective"][:], gap


def method_row(
    name: str, best: Floats, objective: Floats, gap: Floats | None
) -> list[str]:
    """Return the row of a method: how often and by how much its objectives (n,) exceed
    the best ones (n,), and what its relative gaps (n,) consist of.
    """
    both = np.isfinite(best) & np.isfinite(objective) & (objective > 0)
    excess = objective[both] / best[both] - 1
    beyond = excess > WITHIN
    search = 1 - best[both] / objective[both]
    bounds = (
        ["–", "–"] if gap is None else [gap[both].mean(), (gap[both] - search).mean()]
    )
    total, relaxation = (x if isinstance(x, str) else f"{x:.2%}" for x in bounds)
    typical = excess[beyond].mean() if beyond.any() else 0
    return [
        name,
        f"{beyond.mean():.2%}",
        f"{typical:.0%} ({max(excess.max(), 0):.0%})",
        total,
        f"{search.mean():.2%}",
        relaxation,
    ]


def main() -> None:
    """Print the section on optimality, from the results in a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    print("\n\n".join(sections(parser.parse_args().folder)))


if __name__ == "__main__":
    main()
