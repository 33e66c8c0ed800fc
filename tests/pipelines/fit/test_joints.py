"""Landmarks as detectors name them, and a dictionary with joints of people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.config.dictionaries import find_dictionary
from shapefit.io import LandmarkSet, landmark_writer, read_dictionary, read_results
from shapefit.io.skeletons import PEOPLE, SKELETONS
from shapefit.pipelines.fit import run as fit
from shapefit.pipelines.fit.joints import as_joints, find_joints


@pytest.fixture(scope="module")
def people():
    return read_dictionary(find_dictionary("people"))


@pytest.fixture
def images(people, rng):
    """Five views of means of the prior, with all 15 joints."""
    turn = np.linalg.qr(rng.standard_normal((5, 3, 3)))[0]
    turn[:, :, 0] *= np.linalg.det(turn)[:, None]
    return LandmarkSet(
        landmarks=100 * (turn @ people.prior.means[:5])[:, :2],
        landmark_names=PEOPLE,
        items=tuple(f"image{i}" for i in range(5)),
    )


def as_detected(images, skeleton):
    """The images with landmarks of a skeleton in its order, of which those without joint are 0."""
    columns = {name: PEOPLE.index(joint) for name, joint in skeleton.people.items()}
    names = skeleton.landmark_names
    points = np.zeros((len(images), 2, len(names)))
    for i, name in enumerate(names):
        if name in columns:
            points[:, :, i] = images.landmarks[:, :, columns[name]]
    return LandmarkSet(landmarks=points, landmark_names=names, items=images.items)


@pytest.fixture
def lift(tmp_path):
    def lift(images):
        with landmark_writer(tmp_path / "views.h5") as writer:
            writer.append(images)
        config = FitConfig(
            landmarks=str(tmp_path / "views.h5"),
            dictionary="people",
            output=str(tmp_path / "result.h5"),
            method="posterior",
        )
        warnings = [text for outcome in fit.run(config) for text in outcome.warnings]
        return read_results(tmp_path / "result.h5"), warnings

    return lift


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=list(SKELETONS))
def test_a_detector_s_names_give_what_the_joints_give(images, lift, skeleton):
    shared = list(skeleton.people.values())
    weights = [skeleton.weights.get(name, 1.0) for name in skeleton.people]
    part = images.arrange(tuple(shared), "here", leave_out=True)
    expected, _ = lift(replace(part, confidence=np.tile(weights, (5, 1))))
    found, warnings = lift(as_detected(images, skeleton))
    assert found.landmark_names == PEOPLE
    np.testing.assert_allclose(found.shapes, expected.shapes, atol=1e-6)
    assert f"{len(shared)} landmarks taken for joints of people" in " ".join(map(str, warnings))
    assert "rename" not in " ".join(map(str, warnings))


def test_a_confidence_is_multiplied(images):
    detected = as_detected(images, SKELETONS["body_25b"])
    given = np.full((5, 25), 0.5)
    joints = find_joints(detected.landmark_names, PEOPLE)
    named = as_joints(replace(detected, confidence=given), joints, "here")
    head = named.landmark_names.index("head")
    np.testing.assert_allclose(named.confidence[:, head], 0.15)
    np.testing.assert_array_equal(np.delete(named.confidence, head, axis=1), 0.5)


def test_nothing_changes_where_names_match(images):
    joints = find_joints(PEOPLE, PEOPLE)
    assert joints == ({}, {})
    assert joints.notes == ()
    assert as_joints(images, joints, "here") is images


def test_joints_that_the_file_names_itself_stay():
    assert find_joints(("lhip", "LHip", "RHip"), PEOPLE).names == {"RHip": "rhip"}


def test_two_names_of_one_joint_stand_for_none():
    assert find_joints(("left_hip", "LHip", "RHip"), PEOPLE).names == {"RHip": "rhip"}


def test_other_dictionaries_are_left_alone():
    assert find_joints(("LHip", "Head"), ("snout", "tail")).names == {}
