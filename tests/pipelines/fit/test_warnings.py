"""What a fit says of inputs that it takes, and that may not be meant."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.io import write_dictionary
from shapefit.io.records import LandmarkSet

NAMES = tuple("abcdef")


@pytest.fixture
def warnings(fit, tmp_path, rng):
    """Fit images of these confidences, and return the warnings."""
    mean = rng.standard_normal((3, 6))
    atoms = rng.standard_normal((2, 3, 6))
    write_dictionary(tmp_path / "d.h5", Dictionary(atoms, NAMES, mean, objective_trace=np.empty(0)))

    def told(n, confidence):
        images = LandmarkSet(
            landmarks=rng.standard_normal((n, 2, 6)),
            confidence=None if confidence is None else np.full((n, 6), confidence),
            landmark_names=NAMES,
            items=tuple(map(str, range(n))),
        )
        _, outcomes = fit(tmp_path, tmp_path / "d.h5", images)
        return [warning for outcome in outcomes for warning in outcome.warnings]

    return told


def test_confidences_above_one_are_told(warnings):
    (warning,) = warnings(3, 95.0)
    assert warning.startswith("confidences above 1: ")
    assert "`lambda`" in warning
    for confidence in (None, 0.5, 1.0):
        assert warnings(3, confidence) == []


def test_an_input_of_no_images_is_told(warnings):
    assert warnings(0, None) == ["the input holds no images"]
