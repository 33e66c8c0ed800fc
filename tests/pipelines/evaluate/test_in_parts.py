"""Results in many files: the report is that of one file, in memory that does not grow with them."""

import json
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

from shapefit.dictionary.model import Dictionary
from shapefit.evaluation import averages
from shapefit.geometry.normalisation import normalise
from shapefit.io import columns, name_index, write_dictionary, write_shapes
from shapefit.io.csv import writing
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate import examples, floors, method_images
from shapefit.pipelines.evaluate import plan as truths
from shapefit.pipelines.evaluate import run as evaluate
from tests.pipelines.evaluate.conftest import NAMES

COUNT = 150
ROUNDED = {"mean", "mean_kept"}
"""Columns of sums, whose last bits depend on how many numbers are added up together."""

NUMBERS = ("per_image.csv", "report.csv", "calibration.csv", "trusted.csv")


LIMITS = [
    *((columns, "MOST_HELD"), (columns, "GAP"), (columns, "STRETCH"), (name_index, "RUN")),
    *((columns, "AT_A_TIME"), (averages, "TOGETHER"), (writing, "BLOCK_ROWS")),
    *((floors, "TOGETHER"), (truths, "AT_A_TIME")),
]
"""How much is in memory at a time."""


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
            "plausibility": np.round(rng.random(COUNT), 1),
            "outliers": rng.random((COUNT, 5)) < 0.2,
            "corrupted": rng.random((COUNT, 5)) < 0.2,
            "landmarks": estimate[:, :2].swapaxes(1, 2) + 0.01,
        },
    )


@pytest.fixture
def options(desk, truth):
    """Options that write everything that a report can have."""
    atoms = normalise(truth.shapes[20:24]).points
    mean = normalise(atoms.mean(axis=0)).points
    write_dictionary(desk.folder / "dictionary.h5", Dictionary(atoms, NAMES, mean))
    write_shapes(desk.folder / "truth.h5", truth.take(np.arange(COUNT) != 7))
    return {
        "floors": {"dictionary": desk.folder / "dictionary.h5"},
        "metrics": ("similarity", "camera", "rotation", "precision", "recall"),
        "view": False,
    }


@pytest.fixture
def tiny(monkeypatch):
    """Next to nothing may be in memory at a time."""
    for module, name in LIMITS:
        monkeypatch.setattr(module, name, 8)


def divided(desk, results: ResultSet, sizes: list[int]) -> list:
    """Write the results to files of these sizes, and of what is left."""
    ends = np.cumsum([0, *sizes, len(results) - sum(sizes)])
    return [
        desk.write(f"part{n}.h5", results.take(slice(start, end)))
        for n, (start, end) in enumerate(pairwise(ends))
    ]


def written(desk) -> dict[str, str]:
    return {name: (desk.config.output / name).read_text() for name in NUMBERS}


@pytest.mark.usefixtures("tiny")
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


def test_next_to_no_memory_changes_last_bits_only(desk, results, options, request):
    parts = {"results": {"m": divided(desk, results, [64, 64])}}
    desk.run(**options, **parts)
    once = {name: desk.rows(name) for name in NUMBERS}
    request.getfixturevalue("tiny")
    desk.run(**options, **parts)
    for name, rows in once.items():
        again = desk.rows(name)
        assert len(again) == len(rows)
        for row, other in zip(rows, again, strict=True):
            for key in row.keys() & ROUNDED if row["method"] == "m" else ():
                ours, theirs = (float(each.pop(key) or "nan") for each in (row, other))
                assert theirs == pytest.approx(ours, rel=1e-14, nan_ok=True)
            # Floors stop when all shapes that are measured together are still.
            assert other == row or row["method"] != "m"


@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("match", ["item", "model"])
def test_the_truth_may_be_in_many_files_and_in_any_order(desk, results, truth, options, rng, match):
    del options["floors"]
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


@pytest.mark.usefixtures("tiny")
def test_examples_are_read_again_from_their_files(desk, results, truth, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        examples, "skeleton_picture", lambda *given: drawn.append(given) or Figure()
    )
    write_shapes(desk.folder / "truth.h5", truth)
    parts = divided(desk, results, [30, 60])
    other = desk.write("other.h5", results.take([149, 129, 90, 45, 30]))
    desk.run(
        results={"m": parts, "other": [other]},
        metrics=("similarity",),
        plots=True,
        examples=("item12?", "item45", "item30", "item90"),
    )
    ((poses, *_),) = drawn
    assert [pose.title for pose in poses] == ["item129", "item45", "item30", "item90"]
    for pose in poses:
        row = truth.items.index(pose.title)
        np.testing.assert_array_equal(pose.shapes["m"], results.shapes[row])
        np.testing.assert_array_equal(pose.shapes["other"], results.shapes[row])
        np.testing.assert_allclose(pose.shapes["truth"], results.shapes[row], atol=1.5)


def test_failures_beyond_a_number_are_counted(desk, results, options, monkeypatch):
    monkeypatch.setattr(method_images, "MOST_LISTED", 3)
    parts = divided(desk, results, [41, 60])
    outcomes = desk.run(**options, results={"m": parts})
    method = json.loads((desk.config.output / "report.json").read_text())["methods"][0]
    assert method["failed"] == sum(len(outcome.failures) for outcome in outcomes) == 4
    assert [failure["item"] for failure in method["failures"]] == ["item0", "item7", "item40"]


def test_no_viewer_beside_the_report_of_too_many(desk, results, monkeypatch):
    monkeypatch.setattr(evaluate, "MOST_VIEWED", COUNT - 1)
    outcomes = desk.run()
    told = "view.html is left out: 150 images or shapes are more than the 149"
    assert any(str(w).startswith(told) for outcome in outcomes for w in outcome.warnings)
    assert not (desk.config.output / "view.html").exists()


def test_memory_does_not_grow_with_the_number_of_parts(desk, results, truth, monkeypatch):
    for module, name in LIMITS:
        monkeypatch.setattr(module, name, 256)
    rows = np.resize(np.arange(50, COUNT), 800)  # of which none failed: failures are listed
    results, truth = results.take(rows), truth.take(rows)

    def peak(count: int) -> int:
        """Bytes of an evaluation of the same part so many times, under other names."""
        parts, true = [], []
        for n in range(count):
            items = tuple(f"{n}/{row}" for row in range(len(rows)))
            parts.append(desk.write(f"part{n}.h5", results.replaced(items=items)))
            true.append(desk.folder / f"truth{n}.h5")
            write_shapes(true[-1], truth.replaced(items=items))
        tracemalloc.start()
        try:
            desk.run(results={"m": parts}, truth=true, view=False, metrics=("similarity",))
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(1)  # what is imported and remembered for good
    few, many = peak(2), peak(6)
    assert many < few + 4 * 60_000  # what is read of a part takes 600 kB
