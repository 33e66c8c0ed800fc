"""TRC, read back by another parser."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.io import read_shapes
from tests.io.files import save
from tests.io.writers.conftest import parse_trc, trc_points

SIZE_AND_AXES = "in m by the size of the training shapes, y up, the axis z"


@pytest.fixture
def target(tmp_path):
    return tmp_path / "man.trc"


def test_the_header_of_trc(target, scene):
    save(target, scene.result)
    trc = parse_trc(target)
    axes = trc.first_line[4]
    assert trc.first_line[:3] == ["PathFileType", "4", "(X/Y/Z)"]
    assert axes.startswith(
        "y up, the axis z of the extrinsics; position from the camera"
    )
    assert trc.header["Units"] == "m"
    assert trc.header["DataRate"] == "25"
    assert trc.header["NumFrames"] == "4"
    assert trc.header["NumMarkers"] == "15"
    assert trc.header["OrigDataStartFrame"] == "7"
    assert trc.names == list(scene.result.landmark_names)


def test_batches_are_one_table_of_points_and_times(target, scene):
    first_three = scene.result.take(slice(0, 3))
    last = scene.result.take([3])
    save(target, first_three, last)
    trc = parse_trc(target)
    assert_array_equal(trc.frames, [7, 8, 9, 10])
    assert_allclose(trc.times, [0.28, 0.32, 0.36, 0.4])
    assert_allclose(trc.points, scene.y_up, atol=1e-12)


def test_what_is_told_of_trc(target, scene):
    summary = save(target, scene.result)
    angles = target.with_name("man_angles.csv")
    assert summary.written == (target, angles)
    assert SIZE_AND_AXES in summary.note
    assert summary.warnings == ()


def test_trc_comes_back(target, scene):
    save(target, scene.result)
    back = read_shapes([target])
    assert back.unit == "m"
    assert back.frame_rate == 25
    assert back.items == ("man/7", "man/8", "man/9", "man/10")


def test_frames_are_sorted_and_those_missing_are_gaps(target, scene):
    result = scene.result.take([3, 0, 2])
    shapes = result.shapes.copy()
    shapes[2] = np.nan  # frame 9 failed
    summary = save(target, result.replaced(shapes=shapes, frame_rate=None))
    trc = parse_trc(target)
    gaps, rate = summary.warnings
    assert_array_equal(trc.frames, [7, 8, 9, 10])
    assert_array_equal(trc.times, [7, 8, 9, 10])
    assert_array_equal(trc.empty, [False, True, True, False])
    assert trc.header["NumFrames"] == "4"
    assert gaps == "2 frames without a shape of film/anna"
    assert rate.startswith("the frame rate is unknown")


def test_an_unknown_landmark_is_an_empty_cell(target, shapes, scene):
    shapes.shapes[1, 4] = np.nan
    save(target, shapes, up="z")
    expected = scene.y_up.copy()
    expected[1, :, 4] = np.nan
    assert_allclose(trc_points(target), expected, atol=1e-12)


def test_names_with_tabs_do_not_shift_columns(target, shapes):
    names = ("a\tb", "c\nd", *shapes.landmark_names[2:])
    save(target, shapes.replaced(landmark_names=names))
    assert parse_trc(target).names[:2] == ["a\\tb", "c\\nd"]


def test_times_of_a_rate_that_is_nearly_25_are_short(target, scene):
    """Other tools state rates such as 1 / 0.04: 99 frames end at 3.96 s, not
    3.9599...95.
    """
    nearly_25 = 25.000000000000004
    frames = np.arange(96, 100)
    save(target, scene.result.replaced(frame_rate=nearly_25, frames=frames))
    rows = target.read_text().splitlines()[5:]
    times = [row.split("\t")[1] for row in rows]
    assert times == ["3.84", "3.88", "3.92", "3.96"]
