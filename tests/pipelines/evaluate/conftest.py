"""Seven images of five landmarks in three sequences, and a config that judges them."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.geometry.rotations import random_rotations
from shapefit.io import write_shapes
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate.run import run
from shapefit.pipelines.outcome import Outcome
from tests.io.files import save

NAMES = ("head", "left", "right", "foot", "hand")
SEQUENCES = ("13_01",) * 4 + ("13_02",) + ("14_01",) * 2
N = len(SEQUENCES)


@pytest.fixture
def truth(rng):
    return ShapeSet(
        shapes=rng.standard_normal((N, 3, 5)),
        landmark_names=NAMES,
        items=tuple(f"item{i}" for i in range(N)),
        sequences=SEQUENCES,
        unit="m",
    )


@pytest.fixture
def results(truth, rng):
    R = random_rotations(N, rng)
    shapes = R @ truth.shapes + 0.2 * rng.standard_normal(truth.shapes.shape)
    return ResultSet(
        shapes=shapes,
        landmarks_fitted=shapes[:, :2],
        rotation=R,
        landmark_names=NAMES,
        items=truth.items,
        sequences=SEQUENCES,
        unit="m",
        columns={"true_rotation": R, "landmarks": (R @ truth.shapes)[:, :2].swapaxes(-1, -2)},
    )


@dataclass(frozen=True)
class Desk:
    """A folder with truth.h5 and convex.h5, and what is done there."""

    folder: Path
    config: EvalConfig

    def write(self, name: str, records: ResultSet) -> Path:
        save(self.folder / name, records)
        return self.folder / name

    def changed(self, **changes) -> EvalConfig:
        return EvalConfig(**{**self.config.model_dump(), **changes})

    def run(self, **changes) -> list[Outcome]:
        """Return the outcomes that say something: the first tells of the truth alone."""
        return [each for each in run(self.changed(**changes)) if each != Outcome()]

    def begin(self, **changes) -> Outcome:
        """Run up to the first outcome only."""
        return next(run(self.changed(**changes)))

    def rows(self, name: str = "report.csv") -> list[dict[str, str]]:
        with (self.config.output / name).open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def row(self, name: str = "report.csv", **labels: str) -> dict[str, str]:
        """Return the one row that has these labels."""
        fits = [row for row in self.rows(name) if labels.items() <= row.items()]
        (row,) = fits
        return row

    def errors(self, **labels: str) -> np.ndarray:
        """Errors of per_image.csv in the order of the file; nan for an empty cell."""
        fits = [row for row in self.rows("per_image.csv") if labels.items() <= row.items()]
        return np.array([float(row["error"] or "nan") for row in fits])


@pytest.fixture
def desk(tmp_path, truth, results):
    write_shapes(tmp_path / "truth.h5", truth)
    save(tmp_path / "convex.h5", results)
    config = EvalConfig(
        results=[tmp_path / "convex.h5"],
        truth=[tmp_path / "truth.h5"],
        output=tmp_path / "report",
        groups={"Subject 13": "13_*", "Subject 14": "14_*"},
        plots=False,
    )
    return Desk(tmp_path, config)
