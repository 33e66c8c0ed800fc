"""Frames that are missing, and times that are stated, in the files of motion."""

import csv

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.io.readers.motion import read_bvh
from shapefit.io.writers.motion import MAX_GAP_SECONDS, bridge_gaps, find_times
from tests.io.files import save
from tests.io.writers.conftest import parse_trc

FRAMES = [3, 4, 7, 20]
"""Of four shapes at 25 Hz."""

STATED = {
    "none": None,
    "rounded": [0.12, 0.16, 0.281, 0.8],
    "unknown": [np.nan] * 4,
    "offset": [5.12, 5.16, 5.28, 5.8],
    "uneven": [0.12, 0.2, 0.5, np.nan],
}
EXPECTED = {
    "none": [0.12, 0.16, 0.28, 0.8],
    "rounded": [0.12, 0.16, 0.28, 0.8],
    "unknown": [0.12, 0.16, 0.28, 0.8],
    "offset": [5.12, 5.16, 5.28, 5.8],
    "uneven": [0.12, 0.2, 0.5, 0.5 + 13 / 25],
}


@pytest.fixture(params=STATED)
def timed(request, scene):
    times = STATED[request.param]
    record = scene.result.replaced(frames=np.array(FRAMES), times=times)
    return record, np.array(EXPECTED[request.param])


def read_columns(path):
    """Return the frames of a table and their times."""
    rows = [*csv.DictReader(path.open(encoding="utf-8"))]
    times = {int(row["frame"]): float(row["time"]) for row in rows}
    return list(times), list(times.values())


def check_times(frames, times, expected):
    """Assert that frames 3 to 20 are there, and those of the shapes at their times."""
    rows = np.array(FRAMES) - 3
    assert [int(frame) for frame in frames] == [*range(3, 21)]
    assert_allclose(np.array(times)[rows], expected, atol=1e-6)
    assert (np.diff(times) > 0).all()


def test_trc_has_the_true_times(tmp_path, timed):
    record, expected = timed
    save(tmp_path / "m.trc", record)
    trc = parse_trc(tmp_path / "m.trc")
    full = np.flatnonzero(~trc.empty)
    check_times(trc.frames, trc.times, expected)
    assert (full + 3).tolist() == FRAMES


def test_tables_have_the_true_times(tmp_path, timed):
    record, expected = timed
    save(tmp_path / "m.trc", record)
    save(tmp_path / "m.metres.csv", record)
    for name in ("m.metres.csv", "m_angles.csv"):
        frames, times = read_columns(tmp_path / name)
        check_times(frames, times, expected)


def test_mot_has_the_true_times_and_no_empty_rows(tmp_path, timed):
    record, expected = timed
    path = tmp_path / "m.mot"
    save(path, record)
    _, body = path.read_text().split("endheader\n")
    _labels, *rows = body.splitlines()
    times = [float(row.split("\t")[0]) for row in rows]
    assert_allclose(times, expected, atol=1e-6)


def test_a_format_of_one_rate_has_all_frames_and_says_where_times_are_others(
    tmp_path, timed
):
    record, expected = timed
    path = tmp_path / "m.bvh"
    note = save(path, record).note
    off_the_rate = expected - np.array(FRAMES) / 25
    is_uneven = np.ptp(off_the_rate) > 0.1
    says_so = "times are off the steady 25 Hz by up to 0.22 s" in note
    assert len(read_bvh((path,))) == 18
    assert says_so == is_uneven


def test_stated_times_say_the_rate(tmp_path, scene):
    path = tmp_path / "m.trc"
    frames = np.array(FRAMES)
    record = scene.result.replaced(frame_rate=None, frames=frames, times=frames / 50)
    summary = save(path, record)
    assert not any("frame rate is unknown" in text for text in summary.warnings)
    assert parse_trc(path).header["DataRate"] == "50"


def test_numbers_that_are_no_frames_are_refused(tmp_path, scene, problems):
    time_stamps = 1_700_000_000_000 + 33 * np.arange(4) ** 5
    record = scene.result.replaced(frames=time_stamps)
    (line,) = problems(save, tmp_path / "m.trc", record)
    assert "4 items are of the frames 1700000000000 to 1700000008019" in line


def test_a_table_may_have_any_numbers_of_frames(tmp_path, scene):
    time_stamps = 1_700_000_000_000 + 33 * np.arange(4) ** 5
    save(tmp_path / "m.csv", scene.result.replaced(frames=time_stamps))


def test_times_go_on_at_the_rate_where_none_is_stated():
    stated = np.array([np.nan, 2.0, np.nan])
    times = find_times(np.array([10, 12, 15]), 6, stated, 10.0)
    assert_allclose(times, [1.8, 1.9, 2.0, 2.1, 2.2, 2.3])


def test_no_frames_have_no_times():
    no_frames = np.array([], int)
    assert find_times(no_frames, 0, None, 10.0).shape == (0,)


GAPS = np.array([5, 6, 9, 30])
"""Frames with a short gap and a long one."""


def test_short_gaps_are_bridged_and_long_ones_stay():
    values = np.stack([1.0 * GAPS], axis=1)
    bridged = bridge_gaps(values, GAPS, 24.0)[:, 0]
    assert len(bridged) == 26
    assert_allclose(bridged[:5], [5, 6, 7, 8, 9])
    assert np.isnan(bridged[5:-1]).all()
    assert bridged[-1] == 30


def test_no_gap_is_bridged_from_an_unknown_value():
    values = np.array([[0.0], [np.nan], [1.0], [2.0]])
    bridged = bridge_gaps(values, GAPS, 24.0)[:, 0]
    assert_array_equal(bridged[[0, 4, -1]], [0, 1, 2])
    assert np.isnan(bridged[1:4]).all()


def test_without_gaps_values_stay_as_they_are():
    values = np.zeros((4, 2))
    assert bridge_gaps(values, np.arange(4), 24.0) is values


@pytest.mark.parametrize("rate", [10.0, 24.0, 120.0])
def test_a_gap_is_bridged_up_to_its_longest_time(rate):
    """That of the frames that are missing, not that between those at its ends."""
    missing = int(MAX_GAP_SECONDS * rate)
    values = np.array([[0.0], [1.0]])

    bridged = bridge_gaps(values, np.array([0, missing + 1]), rate)[:, 0]
    open_gap = bridge_gaps(values, np.array([0, missing + 2]), rate)[:, 0]

    assert_allclose(bridged, np.linspace(0, 1, missing + 2))
    assert np.isnan(open_gap[1:-1]).all()
    assert open_gap[[0, -1]].tolist() == [0, 1]
