"""Errors of two methods on four images in two groups, and their report."""

import numpy as np
import pytest

from shapefit.evaluation.report import Method, Report
from shapefit.evaluation.summaries import ImageErrors, summarise

NAN = float("nan")
ITEMS = ("a", "b", "c", "d")
SEQUENCES = ("13_01", "13_01", "13_02", "14_01")


@pytest.fixture
def grouping():
    return {"Subject 13": ("13_01", "13_02"), "Subject 14": ("14_01",)}


@pytest.fixture
def image_errors():
    """Return what makes the similarity errors of a method."""

    def make(method="convex", values=(0.1, 0.2, 0.35, NAN), unit="normalised"):
        return ImageErrors(method, "similarity", unit, ITEMS, SEQUENCES, np.array(values))

    return make


@pytest.fixture
def errors(image_errors):
    return [image_errors(), image_errors("admm", (0.3, 0.3, 0.3, 0.4))]


@pytest.fixture
def report(errors, grouping):
    return Report(
        methods=(
            Method("convex", ("one.h5",), 4, {"d": "no estimate"}),
            Method("admm", ("two.h5",), 4, {}),
        ),
        summaries=tuple(row for e in errors for row in summarise(e, grouping)),
        warnings=("no true rotation",),
    )
