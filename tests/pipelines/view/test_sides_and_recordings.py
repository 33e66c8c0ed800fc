"""Names say what is left and right; sequences of one video, or files, are seen at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.io.skeletons import installed_skeletons
from shapefit.pipelines.view.reading import Frames
from shapefit.pipelines.view.scene import find_recordings, find_sides
from tests.io.files import mirror_pairs


def test_names_of_other_files():
    names = ["nose", "L_ear", "R_ear", "HipLeft", "HipRight", "left", "lone", "left_toe", "HEAD"]
    assert find_sides(names) == [0, 1, 2, 1, 2, 0, 0, 0, 0]
    rat = ["HeadL", "SpineL", "HipL", "KneeL", "HipR", "KneeR", "XL"]
    assert find_sides(rat) == [0, 0, 1, 1, 2, 2, 0]


@pytest.mark.parametrize("name", installed_skeletons())
def test_the_pairs_of_detectors(name):
    skeleton = installed_skeletons()[name]
    sides = np.array(find_sides(skeleton.landmark_names))
    right, left = np.array(mirror_pairs(skeleton)).T
    assert (sides[right] == 2).all()
    assert (sides[left] == 1).all()
    assert np.count_nonzero(sides) == 2 * len(left)


def frames_of(numbers, **groups):
    starts = np.cumsum([0, *map(len, groups.values())]).tolist()
    sequences = tuple(zip([name.replace("_", "/") for name in groups], starts, strict=False))
    items = tuple("".join(groups.values()))
    numbers = np.full(len(items), np.nan) if numbers is None else np.array(numbers, float)
    return Frames(items, sequences, 1, numbers)


@pytest.mark.parametrize(
    ("groups", "numbers", "expected"),
    [
        ({"v_1": "abc", "v_2": "de"}, [7, 8, 9, 8, 9], ([[0, 1]], [0, 1, 2, 1, 2])),
        ({"v_1": "abc", "v_2": "de"}, None, ([[0], [1]], [0, 1, 2, 0, 1])),
        ({"v_1": "abc", "v_2": "de"}, [7, 8, np.nan, 8, 9], ([[1], [0]], [0, 1, 2, 0, 1])),
        ({"v_1": "abc", "v_2": "de"}, [1, 2, 3, 4, 5], ([[0], [1]], [0, 1, 2, 0, 1])),
        ({"v_1": "abc", "w_1": "de"}, [7, 8, 9, 8, 9], ([[0], [1]], [0, 1, 2, 0, 1])),
        ({"v_1": "ab", "w_1": "c", "v_2": "de"}, [7, 9, 7, 8, 9], ([[0, 2], [1]], [0, 2, 0, 1, 2])),
    ],
)  # fmt: skip
def test_individuals_of_a_video_are_seen_at_once(groups, numbers, expected):
    content = SimpleNamespace(role="result", name="r")
    recordings, times = find_recordings([content], frames_of(numbers, **groups))
    assert (sorted(recordings), times.tolist()) == (sorted(expected[0]), expected[1])


@pytest.mark.parametrize(
    ("files", "recordings", "times"),
    [(2, [[0, 1]], [0, 1, 1, 2]), (1, [[0], [1]], [0, 1, 0, 1])],
)
def test_files_of_one_individual_each_are_seen_at_once(files, recordings, times):
    found = find_recordings(
        [SimpleNamespace(role="shapes")] * files, frames_of([0, 1, 1, 2], anna="ab", ben="cd")
    )
    assert (found[0], found[1].tolist()) == (recordings, times)
