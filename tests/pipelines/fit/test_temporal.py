"""`fit` with `temporal.depths`: whole sequences, observed x and y, refused inputs."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import rotation_about
from shapefit.io import LandmarkSet, landmark_writer, read_results, write_dictionary
from shapefit.pipelines.fit.run import run

NAMES = tuple(f"point{j}" for j in range(8))
EDGES = np.array([[j, j + 1] for j in range(7)])


@pytest.fixture
def fit(tmp_path, rng):
    """Fit two sequences of a turning body of which the dictionary knows only the like."""
    atoms = normalise(rng.standard_normal((4, 3, 8))).points / 5
    body = 100 * (atoms[0] + 0.2 * atoms[1])
    turns = rotation_about(np.array([0.0, 1.0, 0.0]), np.linspace(0, 2 * np.pi, 12))
    landmarks = (turns @ body)[:, :2] + 30.0
    landmarks[5, :, 3] = np.nan

    def run_fit(*, edges=EDGES, sequences=("a",) * 7 + ("b",) * 5, repeat=1, **settings):
        write_dictionary(
            tmp_path / "dictionary.h5",
            Dictionary(atoms, NAMES, normalise(atoms.mean(0)).points, edges=edges),
        )
        several = np.tile(landmarks, (repeat, 1, 1))
        items = tuple(f"image{i}" for i in range(len(several)))
        with landmark_writer(tmp_path / "views.h5") as writer:
            writer.append(
                LandmarkSet(
                    landmarks=several, landmark_names=NAMES, items=items, sequences=sequences
                )
            )
        config = FitConfig(
            landmarks=[tmp_path / "views.h5"],
            dictionary=tmp_path / "dictionary.h5",
            output=tmp_path / "result.h5",
            **{"solver": {"tolerance": 1e-8 if repeat == 1 else 1e-4}, **settings},
        )
        list(run(config))
        return read_results(tmp_path / "result.h5")

    run_fit.landmarks = landmarks
    return run_fit


def test_sequences_are_not_divided(fit, monkeypatch):
    whole = fit(temporal={"depths": True})
    monkeypatch.setattr("shapefit.pipelines.fit.run.READ_AHEAD", 2)
    cut = fit(temporal={"depths": True})
    np.testing.assert_allclose(cut.shapes, whole.shapes, rtol=1e-4, atol=1e-2)
    assert cut.items == whole.items


@pytest.mark.parametrize("chunk", [1, 50, 64])
def test_the_size_of_a_chunk_does_not_change_a_bit(fit, chunk):
    """Sequences of 70 images, longer than a stretch of the solver, and shorter than two."""
    many = {"repeat": 15, "sequences": ("a",) * 70 + ("b",) * 70 + ("c",) * 40}
    whole = fit(temporal={"depths": True}, **many)
    cut = fit(temporal={"depths": True}, chunk=chunk, **many)
    assert len(whole) == 180
    for name in ("shapes", "coefficients", "rotation", "objective", "relative_gap"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name), name)


def test_x_and_y_are_observed_where_seen_and_fitted_where_hidden(fit):
    plain, refined = fit(), fit(temporal={"depths": True})
    seen = np.isfinite(fit.landmarks)
    np.testing.assert_allclose(refined.shapes[:, :2][seen], fit.landmarks[seen])
    np.testing.assert_allclose(refined.shapes[5, :2, 3], plain.shapes[5, :2, 3])
    np.testing.assert_array_equal(refined.landmarks_fitted, plain.landmarks_fitted)
    assert np.abs(refined.shapes[:, 2] - plain.shapes[:, 2]).max() > 0.1


def test_what_is_set_aside_as_an_outlier_keeps_its_fitted_x_and_y(fit):
    fit.landmarks[2, :, 4] += 150.0
    robust = {"outliers": {"method": "l1", "threshold": 0.3}, "lambda": 1.0}
    plain, refined = fit(**robust), fit(temporal={"depths": True}, **robust)
    outliers = plain.extras["outliers"].astype(bool)
    assert outliers[2, 4]
    inliers = np.isfinite(fit.landmarks).all(axis=1) & ~outliers
    assert inliers.mean() > 0.8
    for axis in range(2):
        kept, fitted = refined.shapes[:, axis], plain.shapes[:, axis]
        np.testing.assert_allclose(kept[outliers], fitted[outliers])
        np.testing.assert_allclose(kept[inliers], fit.landmarks[:, axis][inliers])


@pytest.mark.parametrize("lacks", ["edges", "sequences"])
def test_bones_and_sequences_are_needed(fit, lacks):
    with pytest.raises(InputError, match=f"without `{lacks.removesuffix('s')}"):
        fit(temporal={"depths": True}, **{lacks: None})
