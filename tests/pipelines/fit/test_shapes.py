"""`fit` from files to files: shapes that come back, whatever the units, chunks and threads."""

import json
from pathlib import Path

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import LandmarkSet, read_dictionary, write_dictionary
from shapefit.lifting.methods import METHODS
from tests.pipelines.told import failures

PRIORLESS = [name for name, m in METHODS.items() if "prior" not in {n.name for n in m.needs}]
"""Methods that the plain dictionary of these tests serves; the others have tests of their own."""


NAMES = tuple(f"point{j}" for j in range(10))


class TestShapes:
    def test_an_exact_image_gives_its_shape_rotation_and_place(
        self, fit, dictionary, images, atoms, rotations
    ):
        found, outcomes = fit(dictionary, images, **{"lambda": 1e-4})
        assert failures(outcomes) == {}
        truth = 20 * rotations @ atoms[np.arange(8) % 6]
        truth[:, :2] += np.array([100.0, 50.0])[:, None]
        np.testing.assert_allclose(found.shapes, truth, atol=0.02)
        np.testing.assert_allclose(found.shapes[:, :2], found.shapes[:, :2])
        assert rotation_angle(found.rotation, rotations).max() < 0.1
        assert list(found.status) == ["optimal"] * 8
        assert (found.relative_gap <= 1e-4).all()
        assert (found.unit, found.y_axis) == ("px", "down")

    def test_hidden_landmarks_are_filled_in_without_bias(
        self, fit, dictionary, images, atoms, rotations
    ):
        visible = images.landmarks.copy()
        images.landmarks[np.arange(8), :, np.arange(8)] = np.nan
        images.landmarks[np.arange(8), :, np.arange(8) - 1] = np.nan
        found, _ = fit(dictionary, images, **{"lambda": 1e-5})
        np.testing.assert_allclose(found.shapes[:, :2], visible, atol=0.02)
        depth = 20 * (rotations @ atoms[np.arange(8) % 6])[:, 2]
        np.testing.assert_allclose(found.shapes[:, 2], depth, atol=0.1)

    def test_a_landmark_counts_by_its_confidence(self, fit, dictionary, images):
        """The wrong landmark 3 is followed where it is sure, and hardly where it is not."""
        images.landmarks[:, :, 3] += 6.0
        confidence, left = np.ones((8, 10)), []
        for sure in (0.1, 1.0, 10.0):
            confidence[:, 3] = sure
            views = LandmarkSet(
                landmarks=images.landmarks, confidence=confidence, landmark_names=NAMES,
                items=images.items,
            )  # fmt: skip
            found, _ = fit(dictionary, views)
            residual = (found.shapes[:, :2] - images.landmarks)[:, :, 3]
            left.append(np.linalg.norm(residual, axis=1))
        assert (left[0] > 1.5 * left[1]).all()
        assert (left[1] > 1.5 * left[2]).all()

    def test_further_datasets_and_provenance_are_carried(self, fit, dictionary, images):
        found, _ = fit(dictionary, images)
        np.testing.assert_array_equal(
            found.columns["true_rotation"], images.columns["true_rotation"]
        )
        np.testing.assert_array_equal(found.columns["camera_matrix"], np.eye(3))
        assert found.sequences == images.sequences
        assert json.loads(found.attributes["config"])["method"] == "convex"
        inputs = {Path(name).name for name in json.loads(found.attributes["inputs"])}
        assert inputs == {"views.h5", "dictionary.h5"}

    @pytest.mark.parametrize("method", PRIORLESS)
    def test_zero_images_give_zero_results(self, fit, dictionary, atoms, method):
        edges = np.array([[0, 1], [1, 2]])
        prior = read_dictionary(dictionary).prior
        write_dictionary(dictionary, Dictionary(atoms, NAMES, atoms[0], edges=edges, prior=prior))
        empty = LandmarkSet(landmarks=np.empty((0, 2, 10)), landmark_names=NAMES, items=())
        found, outcomes = fit(dictionary, empty, method=method)
        assert found.shapes.shape == (0, 3, 10)
        assert failures(outcomes) == {}
