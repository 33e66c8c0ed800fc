"""How often each method with one rotation is optimal, and what its gap consists of.

`python -m benchmarks.optimality FOLDER` reads the results of `make paper` in FOLDER. The best
objective known is that of the global search. What lies between it and the objective of a method is
due to the method's search; what lies between it and the bound of the convex program to the
relaxation.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation.tables.markdown import markdown_table

Floats = NDArray[np.float64]

METHODS = {"Convex+refine": "refine", "Alternate": "alternate", "Alternate+": "alternate-plus"}
WITHIN = 0.01
"""How far above the global optimum an objective may be that counts as optimal."""


def sections(folder: Path) -> list[str]:
    """Return the section of the index; nothing where the global search was not run."""
    if not (folder / "global.h5").exists():
        return []
    with h5py.File(folder / "global.h5") as file:
        best = file["objective"][:]
        gap = file["relative_gap"][:]
        status = file["status"].asstr()[:]
        modes = file["modes"][:] if "modes" in file else None
    known = np.isfinite(best)
    certified = (status[known] == "optimal").mean()
    lines = [
        f"Certified to {WITHIN:.0%}: {certified:.2%} of {known.sum():,} images; largest gap "
        f"{gap[known].max():.2%}."
    ]
    if modes is not None:
        lines.append(f"More than one reading within 5%: {(modes[known] > 1).mean():.1%}.")
    rows = [row(folder / f"{stem}.h5", name, best) for name, stem in METHODS.items()]
    header = [
        "method",
        f"not optimal within {WITHIN:.0%}",
        "excess there, mean (largest)",
        "mean gap to the convex bound",
        "of it the search's",
        "of it the relaxation's",
    ]
    return ["### How often each method is optimal", " ".join(lines), markdown_table(header, rows)]


def row(path: Path, name: str, best: Floats) -> list[str]:
    """Return what a method's result says beside the best objectives (n,)."""
    with h5py.File(path) as file:
        objective = file["objective"][:]
        gap = file["relative_gap"][:] if "relative_gap" in file else np.full_like(best, np.nan)
    both = np.isfinite(best) & np.isfinite(objective) & (objective > 0)
    excess = objective[both] / best[both] - 1
    beyond = excess > WITHIN
    search = 1 - best[both] / objective[both]
    relaxation = gap[both] - search
    bounded = bool(np.isfinite(relaxation).all())
    return [
        name,
        f"{beyond.mean():.2%}",
        f"{excess[beyond].mean() if beyond.any() else 0:.0%} ({max(excess.max(), 0):.0%})",
        f"{gap[both].mean():.2%}" if bounded else "–",
        f"{search.mean():.2%}",
        f"{relaxation.mean():.2%}" if bounded else "–",
    ]


def main() -> None:
    """Print the section."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    print("\n\n".join(sections(parser.parse_args().folder)))


if __name__ == "__main__":
    main()
