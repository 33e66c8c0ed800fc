"""What is measured in which units, and what fails and why."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.errors import InputError
from shapefit.evaluation import metrics
from shapefit.geometry.rotations import rotation_about
from tests.columns import put

from .conftest import N
from .measured import FILE, METRICS, SHAPES, changed, measured


def assert_same_errors(found, expected):
    assert found.errors.keys() == expected.keys()
    for kind, values in expected.items():
        assert_allclose(found.errors[kind], values)


def test_every_metric_in_its_units(results, truth, errors):
    turn = rotation_about(np.array([0.0, 1, 0]), np.full(N, np.pi / 6))
    turned = results.replaced(rotation=turn @ results.rotation)
    found = measured(turned, truth)
    size = truth.as_columns().std(axis=-1).mean(axis=-1)
    box = np.linalg.norm(np.ptp(results.column("landmarks"), axis=1), axis=1)
    expected = {
        ("similarity", "normalised"): errors["similarity"] / size,
        ("similarity", "m"): errors["similarity"],
        ("camera", "normalised"): errors["camera"] / size,
        ("camera", "m"): errors["camera"],
        ("rotation", "deg"): np.full(N, 30.0),
        ("reprojection", "px"): errors["reprojection"],
        ("reprojection", "box"): errors["reprojection"] / box,
    }
    assert_same_errors(found, expected)
    assert found.failures == {}
    assert found.warnings == ()
    assert found.bars is None


def test_a_bounding_box_is_the_size_of_an_image(results, truth, errors):
    boxes = np.tile(np.uint8([9, 9, 1, 2]), (N, 1))
    boxed = put(results, {"bounding_box": boxes})
    found = measured(boxed, truth, metrics=["reprojection"])
    expected = errors["reprojection"] / np.sqrt(5)
    assert_allclose(found.errors["reprojection", "box"], expected)


def test_a_truth_without_a_unit_has_no_errors_in_one(results, truth):
    plain = truth.replaced(unit="normalised")
    found = measured(results, plain, metrics=SHAPES)
    assert set(found.errors) == {("similarity", "normalised")}


FAILURES = {
    "shape": (
        {"shapes": np.nan},
        "the results hold no shape (status degenerate input)",
    ),
    "landmarks": (
        {"shapes": [[1], [2], *[[np.nan]] * 3]},
        "2 landmarks are on both sides",
    ),
    "nan box": (
        {"bounding_box": [0, 0, np.nan, 4]},
        "5 landmarks are on both sides, and no reprojection (box)",
    ),
    "overflow": (
        {"landmarks_fitted": 1e300},
        "5 landmarks are on both sides, and no reprojection (px), reproject",
    ),
    "empty": (
        {"shapes": 9.0, "rotation": np.nan},
        "5 landmarks are on both sides, and no rotation (deg)",
    ),
}
"""Columns of one image, and why it fails."""


@pytest.fixture
def measured_failure(results, truth):
    """What is measured where one image has these values of columns."""

    def find(changes):
        boxes = np.tile([0.0, 0, 3, 4], (N, 1))
        status = np.array(["optimal"] * 3 + ["degenerate input"] * 4)
        record = put(results, {"bounding_box": boxes}).replaced(status=status)
        for name, value in changes.items():
            record = changed(record, name, 3, value)
        return measured(record, truth)

    return find


@pytest.mark.parametrize(("changes", "reason"), FAILURES.values(), ids=FAILURES)
def test_an_image_that_fails_is_listed_with_the_reason(
    measured_failure, changes, reason
):
    found = measured_failure(changes)
    assert list(found.failures) == ["item3"]
    assert found.failures["item3"].startswith(reason)
    for values in found.errors.values():
        without_error = np.flatnonzero(np.isnan(values))
        assert set(without_error) <= {3}


def test_a_shape_without_extent_has_errors_but_for_its_rotation(measured_failure):
    """What is left of it is the extent of the truth."""
    changes, _ = FAILURES["empty"]
    found = measured_failure(changes)
    for (metric, _), values in found.errors.items():
        assert np.isnan(values[3]) == (metric == "rotation")


def test_without_truth_an_image_fails_in_every_metric(results, truth):
    found = measured(results, truth.take([0, 1, 2, 3, 5, 6]))
    assert found.failures == {"item4": "it has no true shape"}
    for values in found.errors.values():
        assert np.flatnonzero(np.isnan(values)).tolist() == [4]


def test_a_partial_shape_is_measured_where_it_is_known(results, truth):
    shapes = results.shapes.copy()
    shapes[1, 0] = np.nan
    found = measured(results.replaced(shapes=shapes), truth, metrics=SHAPES)
    known = results.as_columns()[1:2, :, 1:]
    (expected,) = metrics.similarity_error(known, truth.as_columns()[1:2, :, 1:])
    assert_allclose(found.errors["similarity", "m"][1], expected)


NEEDED = [
    ("true_rotation", {"camera", "rotation"}),
    ("landmarks", {"reprojection"}),
    ("landmarks_fitted", {"reprojection"}),
    ("rotation", {"rotation"}),
]
"""A dataset, and the metrics that need it."""


@pytest.mark.parametrize(("absent", "skipped"), NEEDED)
def test_metrics_without_their_datasets_are_named(results, truth, absent, skipped):
    found = measured(results.without([absent]), truth)
    left = {metric for metric, _ in found.errors}
    names = " and ".join(metric for metric in METRICS if metric in skipped)
    assert left == set(METRICS) - skipped
    assert found.warnings == (f"{FILE}: no {names} without `{absent}`",)


@pytest.mark.parametrize(("absent", "skipped"), NEEDED)
def test_a_metric_alone_without_its_dataset_is_refused(results, truth, absent, skipped):
    metric = min(skipped)
    fault = f"no {metric} without `{absent}`; add the metric"
    with pytest.raises(InputError, match=fault):
        measured(results.without([absent]), truth, metrics=[metric])


@pytest.mark.parametrize("name", ["true_rotation", "bounding_box"])
def test_datasets_of_another_shape_are_refused(results, truth, name):
    boxed = put(results, {"bounding_box": np.ones((N, 4))})
    wrong = put(boxed, {name: boxed.column(name)[:, :2]})
    with pytest.raises(InputError, match=f"convex.h5:/{name}: has the shape"):
        measured(wrong, truth)


def test_no_shapes_are_refused(results, truth):
    with pytest.raises(InputError, match="holds no shapes"):
        measured(results.take([]), truth)
    with pytest.raises(InputError, match="truth: holds no shapes; give results"):
        measured(results, truth.take([]))


@pytest.fixture
def partly_observed(results):
    """Results of images in which 5, 4, 3, 5, 2, 4 and 5 landmarks were observed."""
    observed = results.column("landmarks").copy()
    for image, count in zip(observed, (5, 4, 3, 5, 2, 4, 5), strict=True):
        image[count:] = np.nan
    return put(results, {"landmarks": observed})


def test_images_with_at_least_so_many_observed_landmarks_are_measured(
    partly_observed, truth
):
    results = changed(partly_observed, "shapes", 0, np.nan)
    found = measured(results, truth, metrics=SHAPES, least_visible=4)
    assert found.items == ("item0", "item1", "item3", "item5", "item6")
    assert list(found.failures) == ["item0"]


def test_more_landmarks_than_any_image_has_are_refused(partly_observed, truth):
    with pytest.raises(InputError, match="holds no shapes with 6 observed `landmarks`"):
        measured(partly_observed, truth, metrics=SHAPES, least_visible=6)


def test_observed_landmarks_that_are_not_stored_are_refused(partly_observed, truth):
    without = partly_observed.without(["landmarks"])
    with pytest.raises(InputError, match="holds no shapes with 1 observed `landmarks`"):
        measured(without, truth, metrics=SHAPES, least_visible=1)
