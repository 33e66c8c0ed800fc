"""`shapefit.evaluate` finds the errors that the command writes."""

import csv

import numpy as np
import pytest

import shapefit

from .conftest import run_command


@pytest.fixture(scope="module")
def chain(people, views):
    return shapefit.fit(
        shapefit.read_landmarks(views), shapefit.read_dictionary(people["sparse-coding"])
    )


def test_errors_and_sums_are_those_of_the_command(tmp_path, chain, sample):
    shapefit.write_results(tmp_path / "result.h5", chain)
    metrics = ["similarity", "reprojection"]
    run_command(
        "eval", results={"result": str(tmp_path / "result.h5")},
        truth=str(sample / "people_test.h5"), output=str(tmp_path / "report"),
        metrics=metrics, groups={"all": "*"}, plots=False,
    )  # fmt: skip
    truth = shapefit.read_shapes(sample / "people_test.h5")
    found = shapefit.evaluate(chain, truth, metrics=metrics, groups={"all": "*"})
    with (tmp_path / "report/per_image.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    written = {(r["metric"], r["unit"], r["item"]): float(r["error"]) for r in rows}
    for (metric, unit), values in found.errors.items():
        for item, value in zip(found.items, values, strict=True):
            assert written.pop((metric, unit, item)) == value
    assert not written
    with (tmp_path / "report/report.csv").open(newline="", encoding="utf-8") as file:
        means = [float(row["mean"]) for row in csv.DictReader(file)]
    assert means == [summary.mean for summary in found.summaries]
    assert 0.05 < found.mean("similarity") < 0.5
    assert found.mean("similarity", "m") < found.mean("similarity")
    with pytest.raises(ValueError, match="no camera was measured"):
        found.mean("camera")


def test_arrays_are_matched_by_their_order(chain, sample):
    truth = shapefit.read_shapes(sample / "people_test.h5")
    rows = [truth.items.index(item) for item in chain.items]
    with pytest.warns(UserWarning, match="no camera and rotation without `true_rotation`"):
        named = shapefit.evaluate(chain, truth)
    assert {metric for metric, _ in named.errors} >= {"similarity", "reprojection"}
    with pytest.raises(shapefit.InputError, match="truth: has 3 shapes for 150 images"):
        shapefit.evaluate(chain, truth.shapes[:3])
    for result in (chain, chain.shapes):
        plain = shapefit.evaluate(result, truth.shapes[rows], metrics=["similarity"])
        np.testing.assert_array_equal(
            plain.errors["similarity", "normalised"], named.errors["similarity", "normalised"]
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metrics": ["simlarity"]}, "did you mean 'similarity'"),
        ({"metrics": []}, "expected a list, each similarity, camera"),
        ({"match": "model"}, "there is no dataset 'model' with one name"),
        ({"plots": True}, r"^evaluate\.plots: is a key of reports only"),
        ({"groups": {"a": "nobody*"}}, "no sequence matches any group"),
    ],
)
def test_what_is_wrong_is_an_error_with_its_place(chain, sample, changes, message):
    truth = shapefit.read_shapes(sample / "people_test.h5")
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.evaluate(chain, truth, **({"metrics": ["similarity"]} | changes))
