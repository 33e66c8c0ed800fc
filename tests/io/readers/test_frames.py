"""Every reader that knows the number or the time of a frame gives it: files with
dropped, unsorted and repeated frames.
"""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_shapes
from shapefit.io.options import InputOptions

from .numbered import (
    FOLDERS,
    IMAGES,
    PEOPLE,
    RATE,
    amc,
    movement,
    numbered_lists,
    nwb,
    results_by_number,
    trc,
    vicon,
)


def read(path: Path):
    """Return frames, and x of the first landmark above that of frame 0."""
    options = InputOptions(keypoints="numbered" if path.suffix != ".csv" else None)
    with open_landmarks([path], options) as source:
        images = source.whole()
    x = images.as_columns()[:, 0, 0]
    x = x * 1000 if images.unit.startswith("fraction") else x
    return images, np.rint(x - 100).astype(int).tolist()


@pytest.mark.parametrize("make", IMAGES.values(), ids=IMAGES)
@pytest.mark.parametrize(
    "frames",
    [
        pytest.param((0, 1, 2, 9, 10, 11), id="dropped"),
        pytest.param((1, 3, 2, 12, 0, 5), id="unsorted"),
        pytest.param((0, 1, 10, 11, 2, 3), id="sorted as text"),
    ],
)
def test_frames_are_those_of_the_file(tmp_path, make, frames):
    if make in (nwb, movement):  # times that fall are refused, or put in order
        frames = sorted(frames)
    images, seen = read(make(tmp_path / "v", frames))
    assert seen == sorted(frames)
    got = images.column("frame")
    assert (got - got[0]).tolist() == [
        number - min(frames) for number in sorted(frames)
    ]
    if make in (nwb, movement):
        times = 2 + np.array(frames) / RATE
        assert_allclose(images.column("time"), times)


@pytest.mark.parametrize("make", IMAGES.values(), ids=IMAGES)
def test_a_frame_that_repeats_is_refused_or_has_two_people(tmp_path, make):
    if make.__name__ in FOLDERS:
        pytest.skip("names of files do not repeat")
    path = make(tmp_path / "v", (0, 1, 1, 2))
    if make.__name__ in PEOPLE:
        images, seen = read(path)
        assert seen == [0, 1, 1, 2]
        assert len({*images.items}) == 4
        assert images.column("frame").tolist() == [0, 1, 1, 2]
    elif make is numbered_lists:  # the last of two equal keys of JSON counts
        assert read(path)[1] == [0, 1, 2]
    else:
        with pytest.raises(InputError):
            read(path)


def test_a_few_of_many_numbered_images_are_in_their_order_and_no_frames(tmp_path):
    frames = (785, 139, 397133, 40083)
    images, seen = read(results_by_number(tmp_path / "v", frames))
    assert seen == sorted(frames)
    assert images.column("frame").tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("make", [trc, vicon, amc])
@pytest.mark.parametrize("frames", [(1, 2, 3, 10, 11, 12), (3, 1, 2, 12, 7), (5, 6)])
def test_frames_of_motion_are_those_of_the_file(tmp_path, make, frames):
    shapes = read_shapes([make(tmp_path / "v", frames)], gaps=True)
    assert shapes.as_columns()[:, 0, 0].tolist() == sorted(frames)
    got = shapes.column("frame")
    assert (got - got[0]).tolist() == [
        number - min(frames) for number in sorted(frames)
    ]
    with pytest.raises(InputError, match=r"frame 2 twice"):
        read_shapes([make(tmp_path / "twice", (1, 2, 2, 3))], gaps=True)


def test_times_of_trc_count_where_its_frames_were_numbered_anew(tmp_path):
    times = np.array([0, 1, 2, 9, 10]) / RATE
    shapes = read_shapes([trc(tmp_path / "v", range(1, 6), times)], gaps=True)
    assert shapes.column("frame").tolist() == [0, 1, 2, 9, 10]
    assert_allclose(shapes.column("time"), times, atol=1e-4)
