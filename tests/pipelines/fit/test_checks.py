"""Wrong in every image: another skeleton, left and right exchanged, axes exchanged or turned."""

import numpy as np
import pytest

from shapefit.config.paths import find_dictionaries
from shapefit.geometry.rotations import rotation_about
from shapefit.io import LandmarkSet, read_dictionary
from shapefit.io.skeletons import THETA, installed_skeletons, people_parts
from shapefit.pipelines.fit.checks import facing
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


def exchanged(images):
    """Return the images with the names of left and right exchanged."""
    other = {"L": "R", "R": "L"}
    names = [
        other[name[0]] + name[1:] if name[0] in other and name[1].isupper() else name
        for name in images.landmark_names
    ]
    return images.replaced(landmark_names=tuple(names))


@pytest.mark.parametrize(("meant", "said"), [("body_25b", "body_25"), ("body_25", "body_25b")])
def test_another_skeleton_of_as_many_landmarks_is_named(warnings_of, poses, meant, said):
    images = film(poses, meant)
    assert not warnings_of(images)
    wrong = images.replaced(landmark_names=installed_skeletons()[said].landmark_names)
    (warning,) = [each for each in warnings_of(wrong) if "is it" in each]
    assert warning.startswith("no shape of this file is to be trusted")
    assert f"is it {meant}? Set `keypoints: {meant}`" in warning


def test_sides_that_are_exchanged_in_every_image_are_noticed(warnings_of, poses):
    images = film(poses, "body_25")
    assert not warnings_of(images)
    (warning,) = warnings_of(exchanged(images))
    assert warning.startswith("left and right may be exchanged")


@pytest.mark.parametrize("why", ["legs are not seen", "feet do not step"])
def test_sides_are_not_tried_without_legs_that_step(warnings_of, poses, why):
    """As of a man who sits at a desk, who was accused."""
    images = exchanged(film((poses[0][:1].repeat(N, axis=0), poses[1]), "body_25"))
    if why == "legs are not seen":
        images = exchanged(film(poses, "body_25"))
        landmarks = images.landmarks.copy()
        below = [any(part in name for part in ("Knee", "Ankle", "Heel", "Toe"))
                 for name in images.landmark_names]  # fmt: skip
        landmarks[..., below] = np.nan
        images = images.replaced(landmarks=landmarks)
    assert not [each for each in warnings_of(images) if "exchanged" in each]


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


def test_people_who_walk_backwards_have_their_sides_exchanged(warnings_of, poses):
    """Seen by weak perspective, where motion alone tells: six clips of bodies that come nearer."""
    shapes, joints = poses
    rng = np.random.default_rng(5)
    count, frames = 6, 20
    sides = [joints.index(name) for name in ("lhip", "rhip", "lshoulder", "rshoulder")]
    found, sequences = [], []
    partner = read_dictionary(find_dictionaries()["people"]).mirror_index
    at = {name: j for j, name in enumerate(joints)}
    apart = shapes[:, :, at["lankle"]] - shapes[:, :, at["rankle"]]
    strides = np.abs((apart * facing(shapes, at)).sum(axis=1))
    for clip in np.argsort(strides)[-count:]:
        lhip, rhip, lshoulder, rshoulder = (shapes[clip][:, side] for side in sides)
        forward = np.cross(lhip - rhip + lshoulder - rshoulder, lshoulder + rshoulder - lhip - rhip)
        yaw = np.arctan2(forward[0], forward[2]) + rng.uniform(-0.6, 0.6)
        ahead = rotation_about(np.array([0.0, 1.0, 0.0]), -yaw) @ shapes[clip]
        growing = 100 * np.exp(0.004 * np.arange(frames))
        mirrored = np.diag([-1.0, 1.0, 1.0]) @ ahead[:, partner]  # the other foot is ahead
        steps = np.where((np.arange(frames) // 5 % 2)[:, None, None], mirrored, ahead)
        found.append(growing[:, None, None] * (np.diag([1.0, -1.0]) @ steps[:, :2]) + 400)
        sequences += [f"clip{clip}"] * frames
    landmarks = np.concatenate(found)
    images = LandmarkSet(
        landmarks=landmarks + 0.5 * rng.standard_normal(landmarks.shape),
        landmark_names=joints,
        items=tuple(f"image{i}" for i in range(len(landmarks))),
        sequences=tuple(sequences),
        unit="px",
        y_axis="down",
    )
    assert not [each for each in warnings_of(images) if "exchanged" in each]
    other = {"l": "r", "r": "l"}
    names = [other[name[0]] + name[1:] if name[0] in other else name for name in joints]
    wrong = images.replaced(landmark_names=tuple(names))
    assert [each for each in warnings_of(wrong) if "exchanged" in each]
