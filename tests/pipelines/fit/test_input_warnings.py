"""Landmarks that cannot be what they are said to be: names, directions, scales."""

import json
import re

import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config.paths import find_dictionaries
from shapefit.geometry.rotations import rotation_about
from shapefit.io import (
    read_dictionary,
)
from shapefit.io.skeletons import THETA, installed_skeletons, people_parts
from shapefit.lifting import trust
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.pipelines.fitted import fit_images, texts


@pytest.mark.parametrize("people", [0, 1])
def test_nothing_that_could_be_seen_ends_with_1_and_without_warnings_of_numpy(
    tmp_path, recwarn, people
):
    """A detector that found nobody, and one that was sure of nobody."""
    for frame in range(6):
        body = {"pose_keypoints_2d": [300.0 + 9 * frame, 200.0, 0.05] * 25}
        text = json.dumps({"version": 1.3, "people": [body] * people})
        (tmp_path / f"f_{frame:04d}.json").write_text(text)
    code = shapefit(["fit", str(tmp_path), "-o", str(tmp_path / "o.h5"), "-q"])
    runtime_warnings = [
        warning for warning in recwarn if warning.category is RuntimeWarning
    ]
    assert code == 1
    assert runtime_warnings == []


COUNT = 30


SIZE = (1920, 1080)


CENTRE = np.array(SIZE)[:, None] / 2


FOCAL = 2000.0


BODIES = 2.5
"""Distance of the camera in heights of a body, of 4.7 units of normalised shapes."""


@pytest.fixture(scope="module")
def poses():
    """Shapes (n, 3, 24) of the prior, y up, and the names of their landmarks."""
    people = read_dictionary(find_dictionaries()["people"])
    rng = np.random.default_rng(3)
    prior = people.prior
    shapes = []
    for k in rng.choice(len(prior), size=COUNT, p=prior.weights):
        mean = prior.means[k].ravel()
        shape = rng.multivariate_normal(mean, prior.covariances[k])
        shapes.append(shape.reshape(3, -1))
    return np.array(shapes), people.landmark_names


def parts_from_joints(skeleton, joints):
    """Return the matrix (parts, joints) that makes the parts of a detector's skeleton
    of joints.
    """
    theta = {name: parameter.mean for name, parameter in THETA.items()}
    parts = people_parts(installed_skeletons()[skeleton].landmark_names)
    matrix = np.zeros((len(parts), len(joints)))
    for row, part in enumerate(parts.values()):
        for joint, weight in part.weights(theta).items():
            matrix[row, joints.index(joint)] = weight
    return matrix


def film(poses, skeleton):
    """Return what a detector finds of upright bodies that face all ways, from 2.5
    heights away.
    """
    shapes, joints = poses
    rng = np.random.default_rng(4)
    angles = rng.uniform(0, 2 * np.pi, COUNT)
    turns = rotation_about(np.array([0.0, 1.0, 0.0]), angles)
    upright = shapes @ parts_from_joints(skeleton, joints).T
    from_camera = np.diag([1.0, -1.0, -1.0]) @ turns @ upright
    from_camera[:, 2] += BODIES * 4.7
    pixels = FOCAL * from_camera[:, :2] / from_camera[:, 2:] + CENTRE
    pixels += rng.standard_normal(pixels.shape)
    return Landmarks(
        in_rows(pixels),
        landmark_names=installed_skeletons()[skeleton].landmark_names,
        items=tuple(f"image{i}" for i in range(COUNT)),
        unit="px",
        y_axis="down",
        file_extras={"image_size": np.array(SIZE)},
    )


@pytest.fixture
def fit_people(tmp_path):
    """Fit images by `people`; return the result and the warnings."""

    def fit(images):
        result, outcomes = fit_images(tmp_path, images, "people", method="posterior")
        return result, texts(outcomes)

    return fit


def containing(part, warnings):
    return [text for text in warnings if part in text]


SKELETONS = [
    ("body_25b", "body_25"),
    pytest.param("body_25", "body_25b", marks=pytest.mark.slow),
]
"""The skeleton that images have, and another of as many landmarks."""


@pytest.mark.parametrize(("meant", "given"), SKELETONS)
def test_another_skeleton_of_as_many_landmarks_is_named(
    fit_people, poses, meant, given
):
    images = film(poses, meant)
    names = installed_skeletons()[given].landmark_names
    result, warnings = fit_people(images.replaced(landmark_names=names))
    (warning,) = containing("is it", warnings)
    assert warning.startswith("no shape of this file is to be trusted")
    assert f"is it {meant}? Set `keypoints: {meant}`" in warning
    assert not result.trusted.any()


@pytest.mark.parametrize("skeleton", ["body_25", "body_25b"])
def test_the_skeleton_that_images_have_is_not_warned_of(fit_people, poses, skeleton):
    result, warnings = fit_people(film(poses, skeleton))
    assert not warnings
    assert result.trusted.any()


def test_images_that_pass_by_chance_are_not_trusted(fit_people, poses, monkeypatch):
    """Though landmarks that are hidden in turn would be predicted well."""
    contradicts_dictionary = trust.contradicts_dictionary

    def predicted_well(kappa, distance, *shares):
        return contradicts_dictionary(1.0, 0.1, *shares)

    monkeypatch.setattr(trust, "contradicts_dictionary", predicted_well)
    images = film(poses, "body_25")
    as_many_as_no_skeleton_has = 19
    wrong = images.replaced(
        landmarks=images.landmarks[:, :as_many_as_no_skeleton_has],
        landmark_names=images.landmark_names[1:20],
    )
    result, warnings = fit_people(wrong)
    assert not result.trusted.any()
    assert containing("% of a sample would be; are the names", warnings)


def turned_in_the_image(images, degrees):
    """Return the images turned about their middle."""
    angle = np.radians(degrees)
    c = np.cos(angle)
    s = np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    points = turn @ (images.as_columns() - CENTRE) + CENTRE
    return images.replaced(landmarks=in_rows(points))


def test_people_on_their_heads_are_counted(fit_people, poses):
    images = film(poses, "body_25")
    result, warnings = fit_people(turned_in_the_image(images, 180))
    (warning,) = containing("heads", warnings)
    told = r"\d+ images with people on their heads: y was taken to point down"
    assert re.match(told, warning)
    assert result.trusted.any()


@pytest.mark.parametrize("angle", [0, 90])
def test_people_who_stand_or_lie_are_not_on_their_heads(fit_people, poses, angle):
    images = film(poses, "body_25")
    result, warnings = fit_people(turned_in_the_image(images, angle))
    assert not containing("heads", warnings)
    assert result.trusted.any()


def scaled(images, factors):
    """Return images of unknown size whose x and y are multiplied."""
    landmarks = images.landmarks * factors
    return replace_columns(images.replaced(landmarks=landmarks), {})


PERCENT = (100 / SIZE[0], 100 / SIZE[1])


@pytest.mark.parametrize("factors", [(0.5, 1), PERCENT])
def test_scales_of_x_and_y_that_differ_are_named(fit_people, poses, factors):
    images = film(poses, "body_25")
    result, warnings = fit_people(scaled(images, factors))
    (warning,) = containing("x and y have different", warnings)
    assert warning.startswith("no shape of this file is to be trusted: people")
    assert "are these percent of the image" in warning
    assert not result.trusted.any()


@pytest.mark.parametrize("factors", [(1, 1), (7, 7)])
def test_a_scale_that_x_and_y_share_is_not_warned_of(fit_people, poses, factors):
    images = film(poses, "body_25")
    result, warnings = fit_people(scaled(images, factors))
    assert not containing("x and y have different", warnings)
    assert result.trusted.any()


def test_landmarks_outside_the_stated_image_are_said(fit_people, poses):
    images = film(poses, "body_25")
    small = replace_columns(images, {"image_size": np.array([640, 480])})
    _, warnings = fit_people(small)
    (warning,) = containing("outside", warnings)
    assert "% of the landmarks lie outside the stated image of 640 x 480" in warning
    assert "--image-size WxH" in warning


def replace_columns(images, columns):
    """The same images with other datasets."""
    return Landmarks(
        images.points,
        landmark_names=images.landmark_names,
        items=images.items,
        unit=images.unit,
        y_axis=images.y_axis,
        file_extras=columns,
    )
