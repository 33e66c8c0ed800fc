"""`fit` and inputs that are refused, or taken with a warning; results as CSV."""

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import write_dictionary
from shapefit.io.records import LandmarkSet


def test_a_refused_input_leaves_the_old_result(fit, tmp_path, dictionary):
    (tmp_path / "result.h5").write_text("old")
    with pytest.raises(InputError, match=r"views\.csv:2"):
        fit(dictionary, "item,landmark,x,y\none,point0,abc,1\n")
    assert (tmp_path / "result.h5").read_text() == "old"
    names = ["dictionary.h5", "result.h5", "views.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


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
        _, outcomes = fit(tmp_path / "d.h5", images)
        return [warning for outcome in outcomes for warning in outcome.warnings]

    return told


def test_confidences_above_one_are_told(warnings):
    (warning,) = warnings(3, 95.0)
    assert warning.startswith("confidences above 1: ")
    assert "`lambda`" in warning
    for confidence in (None, 0.5, 1.0):
        assert warnings(3, confidence) == []
