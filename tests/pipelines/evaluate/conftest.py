"""Seven images of five landmarks in three sequences, and a config that compares
them.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import pytest

from shapefit.config import EvalConfig
from shapefit.evaluation import metrics
from shapefit.geometry.rotations import random_rotations
from shapefit.io import write_shapes
from shapefit.pipelines.evaluate.run import evaluate_results as run
from shapefit.pipelines.result import Result
from shapefit.records import Fit, Shapes
from shapefit.records.columns import in_columns
from tests.columns import in_rows
from tests.io.files import save

NAMES = ("head", "left", "right", "foot", "hand")
SEQUENCES = ("13_01",) * 4 + ("13_02",) + ("14_01",) * 2
N = len(SEQUENCES)
ITEMS = tuple(f"item{i}" for i in range(N))


@pytest.fixture
def truth(rng):
    return Shapes(
        rng.standard_normal((N, 5, 3)),
        landmark_names=NAMES,
        items=ITEMS,
        sequences=SEQUENCES,
        unit="m",
    )


@pytest.fixture
def results(truth, rng):
    """The truth turned, a little wrong, with its landmarks in the image and error
    bars.
    """
    R = random_rotations(N, rng)
    turned = in_rows(R @ truth.as_columns())
    shapes = turned + 0.2 * rng.standard_normal(turned.shape)
    return Fit(
        shapes,
        landmarks_fitted=shapes[..., :2],
        rotation=R,
        landmark_names=NAMES,
        items=ITEMS,
        sequences=SEQUENCES,
        unit="px",
        landmarks=turned[..., :2],
        extras={"true_rotation": R},
    )


@pytest.fixture
def errors(results, truth):
    """Metric -> the errors of the images, in the unit of the truth or of the images."""
    shapes = results.as_columns()
    true = truth.as_columns()
    observed = in_columns(results.column("landmarks"))
    fitted = in_columns(results.landmarks_fitted)
    return {
        "similarity": metrics.similarity_error(shapes, true),
        "camera": metrics.camera_error(shapes, true, results.column("true_rotation")),
        "reprojection": metrics.reprojection(fitted, observed),
    }


@pytest.fixture
def with_bars(results, rng):
    shape_sd = rng.uniform(0.1, 0.3, (N, 5, 3))
    correlation = rng.uniform(-0.3, 0.3, (N, 5, 3))
    return results.replaced(shape_sd=shape_sd, shape_correlation=correlation)


@dataclass(frozen=True)
class Desk:
    """A folder with truth.h5 and convex.h5, and what is done there."""

    folder: Path
    config: EvalConfig

    def write(self, name: str, records: Fit | Shapes) -> Path:
        save(self.folder / name, records)
        return self.folder / name

    def run(self, **changes) -> list[Result]:
        """Return the outcomes that say something: the first tells of the truth
        alone.
        """
        config = EvalConfig(**{**self.config.model_dump(), **changes})
        return [outcome for outcome in run(config) if outcome != Result()]

    def text(self, name: str) -> str:
        return (self.config.output / name).read_text(encoding="utf-8")

    def rows(self, name: str = "report.csv", **labels: str) -> list[dict[str, str]]:
        """Return the rows of a table that have these labels."""
        with (self.config.output / name).open(newline="", encoding="utf-8") as file:
            return [
                row for row in csv.DictReader(file) if labels.items() <= row.items()
            ]

    def row(self, **labels: str) -> dict[str, str]:
        (row,) = self.rows(**labels)
        return row

    def errors(self, **labels: str) -> dict[str, float]:
        """Return the errors of per_image.csv by item; nan for an empty cell."""
        rows = self.rows("per_image.csv", **labels)
        return {row["item"]: float(row["error"] or "nan") for row in rows}


@pytest.fixture
def desk(tmp_path, truth, results):
    write_shapes(tmp_path / "truth.h5", truth)
    save(tmp_path / "convex.h5", results)
    config = EvalConfig(
        results=[tmp_path / "convex.h5"],
        truth=[tmp_path / "truth.h5"],
        output=tmp_path / "report",
        groups={"Subject 13": "13_*", "Subject 14": "14_*"},
        plots="none",
    )
    return Desk(tmp_path, config)
