"""Precision and recall of outlier labels, counted by hand."""

import numpy as np

from shapefit.evaluation.labels import precision, recall

LABELLED = np.array(
    [[1, 1, 1, 0, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [1, 1, 0, 0, 0]], bool
)
CORRUPTED = np.array(
    [[1, 1, 0, 1, 1], [1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]], bool
)
NAN = np.nan


def test_precision_is_the_share_of_the_labelled():
    np.testing.assert_array_equal(precision(LABELLED, CORRUPTED), [2 / 3, 1, NAN, NAN, 0])


def test_recall_is_the_share_of_the_corrupted():
    np.testing.assert_array_equal(recall(LABELLED, CORRUPTED), [2 / 4, 1, 0, NAN, NAN])
