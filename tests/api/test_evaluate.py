"""`evaluate` does as the command does, and refuses the same."""

import csv

import pytest
from numpy.testing import assert_array_equal

import shapefit
from tests.api.conftest import run_command


@pytest.fixture(scope="module")
def chain(people, views):
    """A fit of the views."""
    atoms = shapefit.read_dictionary(people["sparse-coding"])
    return shapefit.fit(shapefit.read_landmarks(views), atoms)


@pytest.fixture(scope="module")
def truth(sample):
    return shapefit.read_shapes(sample / "people_test.h5")


KEYS = {"metrics": ["similarity", "reprojection"], "groups": {"all": "*"}}


@pytest.fixture
def report(tmp_path, chain, sample):
    """The report that the command writes."""
    result = tmp_path / "result.h5"
    output = tmp_path / "report"
    shapefit.write_results(result, chain)
    files = {
        "results": {"result": str(result)},
        "truth": str(sample / "people_test.h5"),
        "output": str(output),
    }
    run_command("eval", **files, **KEYS, plots="none")
    return output


def read_rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_errors_are_those_of_the_command(chain, truth, report):
    found = shapefit.evaluate(chain, truth, **KEYS)
    expected = {}
    for row in read_rows(report / "per_image.csv"):
        expected[row["metric"], row["unit"], row["item"]] = float(row["error"])
    errors = {}
    for (metric, unit), values in found.errors.items():
        for item, value in zip(found.items, values, strict=True):
            errors[metric, unit, item] = value
    assert errors == expected


def test_means_are_those_of_the_command(chain, truth, report):
    found = shapefit.evaluate(chain, truth, **KEYS)
    expected = [float(row["mean"]) for row in read_rows(report / "report.csv")]
    assert [summary.mean for summary in found.summaries] == expected


def test_means_are_asked_for_by_metric_and_unit(chain, truth):
    found = shapefit.evaluate(chain, truth, **KEYS)
    assert 0.05 < found.mean("similarity") < 0.5
    assert found.mean("similarity", "m") < found.mean("similarity")
    with pytest.raises(ValueError, match="no camera was measured"):
        found.mean("camera")


def test_metrics_that_cannot_be_measured_are_warned_of(chain, truth):
    warning = "no camera and rotation without `true_rotation`"
    with pytest.warns(UserWarning, match=warning):
        named = shapefit.evaluate(chain, truth)
    assert {metric for metric, _ in named.errors} >= {"similarity", "reprojection"}


def similarity_errors(result, truth):
    found = shapefit.evaluate(result, truth, metrics=["similarity"])
    return found.errors["similarity", "normalised"]


def test_arrays_are_matched_by_their_order(chain, truth):
    rows = [truth.items.index(item) for item in chain.items]
    in_order = truth.shapes[rows]
    expected = similarity_errors(chain, truth)
    assert_array_equal(similarity_errors(chain, in_order), expected)
    assert_array_equal(similarity_errors(chain.shapes, in_order), expected)


def test_an_array_of_another_number_of_shapes_is_refused(chain, truth):
    with pytest.raises(shapefit.InputError, match="truth: has 3 shapes for 48 images"):
        shapefit.evaluate(chain, truth.shapes[:3])


WRONG_KEYS = [
    ({"metrics": ["simlarity"]}, "did you mean 'similarity'"),
    ({"metrics": []}, "expected a list, each similarity, camera"),
    ({"match": "model"}, "there is no dataset 'model' with one name"),
    ({"plots": "svg"}, r"^evaluate\.plots: .* `plots`; it is for files"),
    ({"groups": {"a": "nobody*"}}, "no sequence matches any group"),
]


@pytest.mark.parametrize(("keys", "message"), WRONG_KEYS)
def test_what_is_wrong_is_an_error_with_its_place(chain, truth, keys, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.evaluate(chain, truth, **{"metrics": ["similarity"]} | keys)
