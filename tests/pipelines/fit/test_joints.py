"""Landmarks of detectors and the joints of a dictionary of people."""

from __future__ import annotations

import json

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import read_results, write_dictionary
from shapefit.io.skeletons import PEOPLE, SKELETONS
from shapefit.pipelines.fit.joints import counterparts, find_strange
from shapefit.pipelines.fit.run import run


@pytest.fixture
def fit(tmp_path, rng):
    """Fit a folder of one frame of a skeleton; return warnings and result."""
    mean = rng.standard_normal((3, 15))
    atoms = rng.standard_normal((2, 3, 15))
    path = tmp_path / "d.h5"
    write_dictionary(path, Dictionary(atoms, PEOPLE, mean, objective_trace=np.empty(0)))

    def fitted(points, **options):
        frame = {"people": [{"pose_keypoints_2d": points.ravel().tolist()}]}
        (tmp_path / "cam").mkdir(exist_ok=True)
        (tmp_path / "cam" / "0.json").write_text(json.dumps(frame))
        config = FitConfig(
            landmarks=[tmp_path / "cam"],
            dictionary=path,
            output=tmp_path / "r.h5",
            input=options,
        )
        warnings = [str(text) for outcome in run(config) for text in outcome.warnings]
        return warnings, read_results(tmp_path / "r.h5")

    return fitted


@pytest.mark.parametrize(
    ("skeleton", "joints"), [("coco_17", 12), ("body_25b", 13), ("halpe_26", 13), ("body_25", 12)]
)
def test_landmarks_become_joints_with_one_warning(fit, rng, skeleton, joints):
    preset = SKELETONS[skeleton]
    count = len(preset.landmark_names)
    points = np.column_stack([rng.uniform(1, 9, (count, 2)), np.ones(count)])
    (warning,), result = fit(points, keypoints=skeleton)
    assert warning.startswith(f"{joints} landmarks of {skeleton} taken as joints of the dictionary")
    assert f"; {count - joints} without a counterpart left out (" in warning
    assert result.landmark_names == PEOPLE


def test_rename_wins(fit, rng):
    points = np.column_stack([rng.uniform(1, 9, (25, 2)), np.ones(25)])
    warnings, _ = fit(points, keypoints="body_25", rename={"MidHip": "pelvis", "REye": "rhip"})
    assert "11 landmarks of body_25 taken" in warnings[0]  # RHip is left out, rhip is there already


def test_three_names_that_match_are_enough():
    own = ("rhip", "lhip", "head", "LKnee")
    assert counterparts(own, PEOPLE) == {}
    assert find_strange(own, PEOPLE) == ["LKnee"]
    assert counterparts(own, PEOPLE, {"rhip"}) == {}
    assert counterparts(("LHip", "RHip"), PEOPLE) == {}
    assert counterparts(("LHip", "RHip", "LKnee"), ("a", "b", "c")) == {}


def test_names_that_do_not_match_are_told_with_both_lists(fit, rng):
    points = np.column_stack([rng.uniform(1, 9, (4, 2)), np.ones(4)])
    with pytest.raises(InputError) as caught:
        fit(points, rename={"0": "lft_hip", "1": "ankle_l"})
    (line,) = caught.value.problems
    assert "0 of the 4 landmarks of the files are in the dictionary, and 3 must be" in line
    assert "the files have lft_hip, ankle_l, 2, 3; the dictionary has pelvis, rhip" in line
    assert "name them alike: `rename: {lft_hip: lhip, ankle_l: lankle}`" in line


def test_two_names_of_one_joint_stand_for_none():
    own = ("left_hip", "LHip", "RHip", "LKnee", "RKnee")
    assert counterparts(own, PEOPLE) == {"RHip": "rhip", "LKnee": "lknee", "RKnee": "rknee"}


def test_joints_whose_definition_differs_weigh_less(fit, rng):
    points = np.column_stack([rng.uniform(1, 9, (25, 2)), np.full(25, 0.5)])
    _, result = fit(points, keypoints="body_25b")
    confidence = dict(zip(PEOPLE, result.extras["confidence"][0], strict=True))
    assert confidence["head"] == pytest.approx(0.5 * SKELETONS["body_25b"].weights["Head"])
    assert confidence["lknee"] == pytest.approx(0.5)
