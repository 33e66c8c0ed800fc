"""Wrong in every image: another skeleton, axes exchanged or turned."""

import numpy as np
import pytest

from shapefit.config.paths import find_dictionaries
from shapefit.geometry.rotations import rotation_about
from shapefit.io import LandmarkSet, read_dictionary
from shapefit.io.skeletons import THETA, installed_skeletons, people_parts
from tests.io.files import save
from tests.pipelines.fitted import fit_file

N, SIZE, FOCAL = 60, (1920, 1080), 2000.0
BODIES = 2.5
"""Distance of the camera in heights of a body, of 4.7 units of normalised shapes."""


@pytest.fixture(scope="module")
def dictionary():
    return find_dictionaries()["people"]


@pytest.fixture(scope="module")
def poses(dictionary):
    """Shapes (N, 3, 24) of the prior, y up, and the names of their landmarks."""
    known = read_dictionary(dictionary)
    rng = np.random.default_rng(3)
    prior = known.prior
    chosen = rng.choice(len(prior), size=N, p=prior.weights)
    shapes = np.array(
        [
            rng.multivariate_normal(prior.means[k].ravel(), prior.covariances[k]).reshape(3, -1)
            for k in chosen
        ]
    )
    return shapes, known.landmark_names


def film(poses, skeleton):
    """Return what a detector finds of upright bodies that face all ways, from 2.5 heights away."""
    shapes, joints = poses
    theta = {name: parameter.mean for name, parameter in THETA.items()}
    parts = people_parts(installed_skeletons()[skeleton].landmark_names)
    rows = np.zeros((len(parts), len(joints)))
    for row, part in enumerate(parts.values()):
        for joint, weight in part.weights(theta).items():
            rows[row, joints.index(joint)] = weight
    rng = np.random.default_rng(4)
    turns = rotation_about(np.array([0.0, 1.0, 0.0]), rng.uniform(0, 2 * np.pi, N))
    visible = np.diag([1.0, -1.0, -1.0]) @ turns @ shapes @ rows.T
    visible[:, 2] += BODIES * 4.7
    pixels = FOCAL * visible[:, :2] / visible[:, 2:] + np.array(SIZE)[:, None] / 2
    return LandmarkSet(
        landmarks=pixels + rng.standard_normal(pixels.shape),
        landmark_names=installed_skeletons()[skeleton].landmark_names,
        items=tuple(f"image{i}" for i in range(N)),
        unit="px",
        y_axis="down",
        columns={"image_size": np.array(SIZE)},
    )


@pytest.fixture
def warnings_of(tmp_path, dictionary):
    """Return what fits images as `-d people` does: its warnings as texts.

    What is warned of before the fit is not trusted.
    """

    def warn(images):
        save(tmp_path / "images.h5", images)
        paths = tmp_path / "images.h5", dictionary, tmp_path / "result.h5"
        result, outcomes = fit_file(*paths, method="posterior")
        found = [str(each) for outcome in outcomes for each in outcome.warnings]
        doubted = any("is it " in each or "exchanged:" in each for each in found)
        assert result.columns["trusted"].any() != doubted
        return found

    return warn


@pytest.mark.parametrize(("meant", "said"), [("body_25b", "body_25"), ("body_25", "body_25b")])
def test_another_skeleton_of_as_many_landmarks_is_named(warnings_of, poses, meant, said):
    images = film(poses, meant)
    assert not warnings_of(images)
    wrong = images.replaced(landmark_names=installed_skeletons()[said].landmark_names)
    (warning,) = [each for each in warnings_of(wrong) if "is it" in each]
    assert warning.startswith("no shape of this file is to be trusted")
    assert f"is it {meant}? Set `keypoints: {meant}`" in warning


@pytest.mark.parametrize(
    ("turn", "said"),
    [
        ([[0, 1], [1, 0]], "with people who lie: if they stand, are x and y exchanged, or is"),
        ([[0, -1], [1, 0]], "is the video turned by 90 degrees?"),
        ([[-1, 0], [0, -1]], "with people on their heads: y was taken to point down"),
        ([[1, 0], [0, 1]], None),
    ],
)
def test_axes_that_are_exchanged_or_turned_are_named_once(warnings_of, poses, turn, said):
    images = film(poses, "body_25")
    centre = np.array(SIZE)[:, None] / 2
    turned = np.array(turn) @ (images.landmarks - centre) + centre
    found = [each for each in warnings_of(images.replaced(landmarks=turned)) if "people" in each]
    assert len(found) == (said is not None)
    assert not found or said in found[0]
