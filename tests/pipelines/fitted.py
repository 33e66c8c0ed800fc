"""Landmarks fitted from file to file, as the command does it, and what the results
tell.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from shapefit.config import FitConfig
from shapefit.io import read_results
from shapefit.pipelines.fit.fit import fit as run
from shapefit.pipelines.result import Counted, Result
from shapefit.records import Fit, Landmarks
from tests.io.files import save


def fit_file(
    landmarks: Path, dictionary: Path | str, output: Path, **keys: Any
) -> tuple[Fit, list[Result]]:
    """Fit a file of landmarks with keys of the config; return the result and the
    outcomes.
    """
    paths = {
        "landmarks": str(landmarks),
        "dictionary": str(dictionary),
        "output": str(output),
    }
    outcomes = list(run(FitConfig(**paths, **{"method": "convex"} | keys)))
    return read_results(output), outcomes


def fit_images(
    folder: Path, images: Landmarks, dictionary: Path | str, **keys: Any
) -> tuple[Fit, list[Result]]:
    """Write images to views.h5 in a folder and fit them there, to result.h5."""
    save(folder / "views.h5", images)
    return fit_file(folder / "views.h5", dictionary, folder / "result.h5", **keys)


def done(outcomes: Iterable[Result]) -> int:
    """Count the items that were done."""
    return sum(outcome.done for outcome in outcomes)


def failures(outcomes: Iterable[Result]) -> dict[str, str]:
    """Return the items that failed, each once, and why."""
    told = [each for outcome in outcomes for each in outcome.failures]
    reasons = {each.item: each.reason for each in told}
    assert len(reasons) == len(told)
    return reasons


def warnings(outcomes: Iterable[Result]) -> list[str | Counted]:
    """Return all warnings."""
    return [warning for outcome in outcomes for warning in outcome.warnings]


def texts(outcomes: Iterable[Result]) -> list[str]:
    """Return the text of each warning."""
    return list(map(str, warnings(outcomes)))
