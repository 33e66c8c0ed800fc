"""Names that a dictionary lacks: left out with a hint, or an error with both lists."""

from __future__ import annotations

import pytest

from shapefit.errors import InputError
from shapefit.io.skeletons import PEOPLE, SKELETONS
from shapefit.pipelines.joints import (
    check_enough,
    find_strange,
    left_out_landmarks,
    name_warnings,
)


def test_three_names_that_match_are_enough():
    own = ("rhip", "lhip", "head", "LKnee")
    check_enough(own, PEOPLE, "here")
    assert find_strange(own, PEOPLE) == ["LKnee"]
    check_enough(("rhip",), PEOPLE, "here")
    check_enough((), PEOPLE, "here")


def test_names_that_do_not_match_are_told_with_both_lists():
    with pytest.raises(InputError) as caught:
        check_enough(("lft_hip", "ankle_l", "2", "rhip"), PEOPLE, "here")
    (line,) = caught.value.problems
    assert line.startswith("here: 1 of the 4 landmarks of the files are in the dictionary, and 3")
    assert "the files have lft_hip, ankle_l, 2, rhip; the dictionary has pelvis, rhip" in line
    assert line.endswith("name them alike: `rename: {lft_hip: lhip, ankle_l: lankle}`")


def test_names_of_another_object_are_not_paired():
    with pytest.raises(InputError, match="give a dictionary of such objects, or name") as caught:
        check_enough(("snout", "leftear", "rightear", "tailbase"), PEOPLE, "here")
    assert "leftear: " not in str(caught.value)


def test_no_hint_at_a_name_that_the_file_has_itself():
    own = ("a1", "b", "c", "finger1", "finger3")
    (warning,) = name_warnings(own, ("a1", "b", "c", "finger1"))
    assert "finger3" in warning
    assert "rename" not in warning


def test_two_skeletons_are_told():
    own = (*SKELETONS["body_25"].landmark_names, *SKELETONS["coco_17"].landmark_names)
    with pytest.raises(InputError, match=r"RShoulder and right_shoulder are one joint.*separate"):
        check_enough(own, PEOPLE, "here")


def test_spaces_are_told():
    with pytest.raises(InputError, match="in spaces"):
        check_enough((" rhip", "lhip ", "head "), PEOPLE, "here")


@pytest.mark.parametrize(
    ("name", "meant"),
    [("left_hip", "lhip"), ("RKnees", "rknee"), ("wrist.R", "rwrist"), ("Rumpf", None)],
)
def test_hints_keep_to_one_side(name, meant):
    (warning,) = left_out_landmarks([name], PEOPLE)
    assert (f"{name}: {meant}" if meant else "(Rumpf)") in warning
    assert ("rename" in warning) == (meant is not None)
