"""Names say what is left and right; sequences of one video, or files, are seen at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.io.skeletons import PEOPLE, installed_skeletons
from shapefit.pipelines.view.reading import Frames
from shapefit.pipelines.view.scene import find_recordings, find_sides


def test_names_of_other_files():
    names = ["nose", "L_ear", "R_ear", "HipLeft", "HipRight", "left", "lone", "left_toe", "HEAD"]
    assert find_sides(names) == [0, 1, 2, 1, 2, 0, 0, 0, 0]
    rat = ["HeadL", "SpineL", "HipL", "KneeL", "HipR", "KneeR", "XL"]
    assert find_sides(rat) == [0, 0, 1, 1, 2, 2, 0]


@pytest.mark.parametrize("name", installed_skeletons())
def test_the_pairs_of_detectors(name):
    skeleton = installed_skeletons()[name]
    sides = np.array(find_sides(skeleton.landmark_names))
    right, left = np.array(skeleton.mirror).T
    assert (sides[right] == 2).all()
    assert (sides[left] == 1).all()
    assert np.count_nonzero(sides) == 2 * len(left)


def test_joints_of_people():
    sides = find_sides(PEOPLE)
    assert [side for name, side in zip(PEOPLE, sides, strict=True) if name[0] == "l"] == [1] * 6
    assert sides.count(2) == 6


def gathered(name, items, frame):
    numbers = {} if frame is None else {"frame": np.array(frame, dtype=float)}
    return SimpleNamespace(name=name, listings=[SimpleNamespace(items=items)], of_frames=numbers)


def recordings(found, frames):
    made = find_recordings(found, frames)
    return made and (made[0], made[1].tolist())


def test_individuals_of_a_video():
    frames = Frames.of({"v/1": "abc", "v/2": "de"}, 5)
    found = [gathered("walk", "abcde", [7, 8, 9, 8, 9])]
    assert recordings(found, frames) == ([[0, 1]], [0, 1, 2, 1, 2])
    assert recordings([gathered("walk", "abcde", None)], frames) is None
    assert recordings([gathered("walk", "abcde", [7, 8, 9, np.nan, 9])], frames) is None
    after = [gathered("walk", "abcde", [1, 2, 3, 4, 5])]
    assert recordings(after, frames) is None  # never at once
    apart = Frames.of({"v/1": "abc", "w/1": "de"}, 5)
    assert recordings(found, apart) is None
    mixed = Frames.of({"v/1": "ab", "w/1": "c", "v/2": "de"}, 5)
    found = [gathered("walk", "abcde", [7, 9, 7, 8, 9])]
    assert recordings(found, mixed) == ([[0, 2], [1]], [0, 2, 0, 1, 2])


def test_files_of_one_individual_each():
    frames = Frames.of({"anna": "ab", "ben": "cd"}, 4)
    nan = np.nan
    files = [gathered("anna", "ab", [0, 1, nan, nan]), gathered("ben", "cd", [nan, nan, 1, 2])]
    assert recordings(files, frames) == ([[0, 1]], [0, 1, 1, 2])
    one = [gathered("both", "abcd", [0, 1, 1, 2])]
    assert recordings(one, frames) is None
