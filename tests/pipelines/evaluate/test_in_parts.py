"""Results in many files: the report is that of one file."""

import json
from itertools import pairwise

import numpy as np
import pytest

from shapefit.io import write_shapes
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate import run as evaluate
from tests.pipelines.evaluate.conftest import NAMES

COUNT = 150
NUMBERS = ("per_image.csv", "report.csv", "error_bars.json")


@pytest.fixture
def truth(rng):
    """Shapes in two sequences, one of which has most of them; a few lack a landmark."""
    shapes = rng.standard_normal((COUNT, 3, 5))
    shapes[7, :, 2] = np.nan
    sequences = ["14_01" if i % 10 == 3 else "13_01" for i in range(COUNT)]
    items = tuple(f"item{i}" for i in range(COUNT))
    return ShapeSet(shapes, NAMES, items, tuple(sequences), unit="m", edges=[[0, 1], [1, 2]])


@pytest.fixture
def results(truth, rng):
    """What a method with error bars found, a few images of which failed."""
    estimate = np.nan_to_num(truth.shapes) + 0.2 * rng.standard_normal(truth.shapes.shape)
    estimate[[0, 40, 41]] = np.nan
    turns = np.tile(np.eye(3), (COUNT, 1, 1))
    return ResultSet(
        shapes=estimate,
        shape_sd=np.full(estimate.shape, 0.2),
        rotation=turns,
        objective=rng.random(COUNT),
        status=np.array(["optimal", "converged", "iteration limit"] * 50),
        landmark_names=NAMES,
        items=truth.items,
        sequences=truth.sequences,
        unit="m",
        attributes={"solve_seconds": 0.5},
        columns={
            "true_rotation": turns,
            "p_value": np.round(rng.random(COUNT), 1),
            "outliers": rng.random((COUNT, 5)) < 0.2,
            "corrupted": rng.random((COUNT, 5)) < 0.2,
            "landmarks": estimate[:, :2].swapaxes(1, 2) + 0.01,
        },
    )


@pytest.fixture
def options(desk, truth):
    """Options that write everything that a report can have."""
    write_shapes(desk.folder / "truth.h5", truth.take(np.arange(COUNT) != 7))
    return {
        "metrics": ("similarity", "camera", "rotation", "precision", "recall"),
    }


def divided(desk, results: ResultSet, sizes: list[int]) -> list:
    """Write the results to files of these sizes, and of what is left."""
    ends = np.cumsum([0, *sizes, len(results) - sum(sizes)])
    return [
        desk.write(f"part{n}.h5", results.take(slice(start, end)))
        for n, (start, end) in enumerate(pairwise(ends))
    ]


def written(desk) -> dict[str, str]:
    """Return the lines of the tables; those of images are in the order of the files."""
    texts = {name: (desk.config.output / name).read_text() for name in NUMBERS}
    return texts | {"per_image.csv": "\n".join(sorted(texts["per_image.csv"].splitlines()))}


def test_parts_have_the_report_of_one_file_to_the_last_bit(desk, results, options):
    whole = [desk.write("whole.h5", results)]
    desk.run(**options, results={"m": whole, "other": [desk.folder / "convex.h5"]})
    once, report = written(desk), json.loads((desk.config.output / "report.json").read_text())
    for sizes in ([64, 64], [1, 7, 30, 2, 60]):
        parts = divided(desk, results, sizes)
        desk.run(**options, results={"m": parts, "other": [desk.folder / "convex.h5"]})
        assert written(desk) == once
        again = json.loads((desk.config.output / "report.json").read_text())
        assert again["methods"][0]["failures"] == report["methods"][0]["failures"]
        solving = report["methods"][0]["solving"]
        assert again["methods"][0]["solving"]["mean_objective"] == solving["mean_objective"]


@pytest.mark.parametrize("match", ["item", "model"])
def test_the_truth_may_be_in_many_files_and_in_any_order(desk, results, truth, options, rng, match):
    if match == "model":  # many images of the same shape
        models = np.array([f"item{i // 10 * 10 + 1}" for i in range(COUNT)], dtype=object)
        results = results.with_columns({"model": models}).replaced(sequences=None)
    parts = {"results": {"m": divided(desk, results, [50, 50])}, "match": match}
    write_shapes(desk.folder / "truth.h5", truth)
    desk.run(**options, **parts)
    once = written(desk)
    order = rng.permutation(COUNT)
    for n in range(3):
        write_shapes(desk.folder / f"truth{n}.h5", truth.take(order[n::3]))
    desk.run(**options, **parts, truth=[desk.folder / f"truth{n}.h5" for n in range(3)])
    assert written(desk) == once


def test_failures_beyond_a_number_are_counted(desk, results, options, monkeypatch):
    monkeypatch.setattr(evaluate, "MOST_LISTED", 3)
    parts = divided(desk, results, [41, 60])
    outcomes = desk.run(**options, results={"m": parts})
    method = json.loads((desk.config.output / "report.json").read_text())["methods"][0]
    assert method["failed"] == sum(len(outcome.failures) for outcome in outcomes) == 4
    assert [failure["item"] for failure in method["failures"]] == ["item0", "item7", "item40"]
