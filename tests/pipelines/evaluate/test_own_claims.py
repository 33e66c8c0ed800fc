"""What results claim of themselves: expected errors, labels of outliers, error bars."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.evaluation.calibration import measure_error_bars
from shapefit.records.columns import in_columns
from tests.columns import in_rows, put

from .conftest import N
from .measured import SHAPES, changed, measured


def sizes(record):
    """Return the size of each shape: the root of the sum of squares about the mean."""
    shapes = record.shapes
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    return np.linalg.norm(centred, axis=(1, 2))


def test_the_expected_error_is_set_beside_the_measured_one(results, truth):
    column = np.array([5.0, *[10.0] * 5, np.nan])
    record = put(results, {"expected_error": column})
    found = measured(record, truth, metrics=["similarity", "expected"])
    errors = found.errors["expected", "m"]
    in_unit_of_truth = column * sizes(truth) / sizes(results)
    assert_allclose(errors[:6], in_unit_of_truth[:6])
    assert np.isinf(errors[6])
    assert found.failures == {}


def test_without_expected_errors_there_are_none(results, truth):
    found = measured(results, truth, metrics=["similarity", "expected"])
    assert ("expected", "m") not in found.errors
    assert found.warnings == ()


WITH_LABELS = ["similarity", "precision", "recall"]


@pytest.fixture
def labelled(results):
    """Results whose outliers are labelled, and which landmarks were corrupted."""
    outliers = np.zeros((N, 5), bool)
    corrupted = np.zeros((N, 5), bool)
    corrupted[0, :4] = True
    corrupted[1, 2] = True
    corrupted[2, 3] = True
    outliers[0, [0, 1, 4]] = True
    outliers[1, 2] = True
    outliers[5, 0] = True
    record = put(results, {"outliers": outliers})
    return put(record, {"corrupted": corrupted})


def test_labels_of_outliers_count_where_there_are_some(labelled, truth):
    without_a_shape = changed(labelled, "shapes", 1, np.nan)
    found = measured(without_a_shape, truth, metrics=WITH_LABELS)
    precision = found.errors["precision", "share"]
    recall = found.errors["recall", "share"]
    inf = np.inf
    assert_allclose(precision, [2 / 3, np.nan, inf, inf, inf, 0, inf])
    assert_allclose(recall, [0.5, np.nan, 0, inf, inf, inf, inf])
    assert list(found.failures) == ["item1"]


def test_without_the_truth_about_outliers_labels_are_not_judged(labelled, truth):
    unknown = labelled.without(["corrupted"])
    found = measured(unknown, truth, metrics=WITH_LABELS)
    assert "no precision and recall without `corrupted`" in found.warnings[0]


@pytest.fixture
def squares(with_bars, truth):
    """How far the truth is from the shapes in their error bars, and how wide these
    are.
    """
    return measure_error_bars(
        with_bars.as_columns(),
        truth.as_columns(),
        with_bars.column("true_rotation"),
        in_columns(with_bars.shape_sd),
        in_columns(with_bars.column("shape_correlation")),
    )


def check_bars(bars, squares, truth):
    square, width = squares
    size = truth.as_columns().std(axis=-1).mean(axis=-1)
    assert_allclose(bars.square, square)
    assert_allclose(bars.width["m"], width)
    assert_allclose(bars.width["normalised"], width / size[:, None])


def test_error_bars_are_those_of_the_frame_of_the_camera(with_bars, truth, squares):
    bars = measured(with_bars, truth, metrics=SHAPES, truth_frame="object").bars
    check_bars(bars, squares, truth)


def test_error_bars_of_a_truth_in_the_frame_of_the_camera(with_bars, truth, squares):
    R = with_bars.column("true_rotation")
    without = with_bars.without(["true_rotation"])
    turned = truth.replaced(shapes=in_rows(R @ truth.as_columns()))
    bars = measured(without, turned, metrics=SHAPES, truth_frame="camera").bars
    check_bars(bars, squares, turned)


def test_error_bars_of_an_unknown_frame_are_not_judged(with_bars, truth):
    without = with_bars.without(["true_rotation"])
    found = measured(without, truth, metrics=SHAPES)
    assert found.bars is None
    assert "without `true_rotation` or `truth_frame`" in found.warnings[0]
