"""What a result file holds: the datasets of the fit, and those that came with the landmarks."""

import numpy as np
import pytest

from shapefit.io import open_landmarks, write_dictionary
from tests.io.files import save
from tests.pipelines.fitted import fit_file
from tests.pipelines.told import warnings


@pytest.fixture
def fit(project, made_cars, tmp_path):
    """Fit three images of cars with these further datasets; returns the result and warnings."""
    write_dictionary(tmp_path / "dictionary.h5", made_cars)
    with open_landmarks([project / "sample_data" / "cars_views.h5"]) as source:
        images = next(source.batches(3))

    def fit(per_item=None, output="result.h5", edges=None, **keys):
        whole = {"camera_matrix": images.columns["camera_matrix"]}
        whole |= {} if edges is None else {"edges": np.array(edges)}
        save(tmp_path / "views.h5", images.replaced(further={**(per_item or {}), **whole}))
        dictionary = tmp_path / "dictionary.h5"
        found, outcomes = fit_file(tmp_path / "views.h5", dictionary, tmp_path / output, **keys)
        return found, warnings(outcomes)

    return fit


def test_datasets_of_the_landmarks_do_not_pass_for_those_of_the_fit(fit):
    mine = {name: np.full(3, -7.0) for name in ("status", "lambda", "residual", "outliers")}
    found, told = fit({**mine, "subject": np.full(3, -7.0)})
    assert list(found.status) == ["optimal"] * 3
    np.testing.assert_array_equal(found.columns["lambda"], 0.1)
    assert "outliers" not in found.columns
    assert (found.columns["residual"] >= 0).all()
    for name in (*(f"input_{name}" for name in mine), "subject"):
        np.testing.assert_array_equal(found.columns[name], -7.0)
    (warning,) = (line for line in told if "that a result uses" in line)
    for name in mine:
        assert f"{name} is stored as input_{name}" in warning
    assert "subject" not in warning
