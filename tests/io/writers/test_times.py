"""Frames that are missing, and times that are stated, in the files of motion."""

import csv

import numpy as np
import pytest

from shapefit.io.readers.motion import read_bvh
from shapefit.io.writers.motion import bridge_gaps, find_times
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
    rows = [*csv.DictReader(path.open(encoding="utf-8"))]
    times = {int(row["frame"]): float(row["time"]) for row in rows}
    return [*times], [*times.values()]


def test_every_table_has_the_true_times(tmp_path, timed):
    record, expected = timed
    save(tmp_path / "m.trc", record)
    save(tmp_path / "m.metres.csv", record)
    save(tmp_path / "m.mot", record)
    rows = parse_trc(tmp_path / "m.trc")[3]
    body = (tmp_path / "m.mot").read_text().split("endheader\n")[1].split("\n")[1:-1]
    of_angles = [float(line.split("\t")[0]) for line in body]
    tables = [
        (rows[:, 0], rows[:, 1]),
        read_columns(tmp_path / "m.metres.csv"),
        read_columns(tmp_path / "m_angles.csv"),
    ]
    np.testing.assert_allclose(of_angles, expected, atol=1e-6)  # no row is empty
    for frames, times in tables:
        assert [int(frame) for frame in frames] == [*range(3, 21)]
        there = np.array(FRAMES) - 3
        np.testing.assert_allclose(np.array(times)[there], expected, atol=1e-6)
        assert (np.diff(times) > 0).all()
    empty = np.isnan(rows[:, 2:]).all(axis=1)
    assert (np.flatnonzero(~empty) + 3).tolist() == FRAMES


def test_a_format_of_one_rate_has_all_frames_and_says_where_times_are_others(
    tmp_path, timed
):
    record, expected = timed
    note = save(tmp_path / "m.bvh", record).note
    assert len(read_bvh((tmp_path / "m.bvh",))) == 18
    uneven = np.ptp(expected - np.array(FRAMES) / 25) > 0.1
    assert ("times are off the steady 25 Hz by up to 0.22 s" in note) == uneven


def test_stated_times_say_the_rate(tmp_path, scene):
    frames = np.array(FRAMES)
    record = scene.result.replaced(frame_rate=None, frames=frames, times=frames / 50)
    summary = save(tmp_path / "m.trc", record)
    assert not any("frame rate is unknown" in text for text in summary.warnings)
    assert parse_trc(tmp_path / "m.trc")[1]["DataRate"] == "50"


def test_numbers_that_are_no_frames_are_refused(tmp_path, scene, problems):
    record = scene.result.replaced(frames=1_700_000_000_000 + 33 * np.arange(4) ** 5)
    (line,) = problems(save, tmp_path / "m.trc", record)
    assert "4 items are of the frames 1700000000000 to 1700000008019" in line
    save(tmp_path / "m.csv", record)


def test_times_go_on_at_the_rate_where_none_is_stated():
    stated = np.array([np.nan, 2.0, np.nan])
    found = find_times(np.array([10, 12, 15]), 6, stated, 10.0)
    np.testing.assert_allclose(found, [1.8, 1.9, 2.0, 2.1, 2.2, 2.3])
    assert find_times(np.array([], int), 0, None, 10.0).shape == (0,)


def test_short_gaps_are_bridged_and_long_ones_stay():
    frames = np.array([5, 6, 9, 30])
    values = np.stack([1.0 * frames, np.array([0.0, np.nan, 1.0, 2.0])], axis=1)
    found = bridge_gaps(values, frames, 24.0)
    assert len(found) == 26
    np.testing.assert_allclose(found[:5, 0], [5, 6, 7, 8, 9])
    assert np.isnan(found[5:-1]).all()
    np.testing.assert_array_equal(found[[0, 4, -1], 1], [0, 1, 2])
    assert np.isnan(found[1:4, 1]).all()
    assert bridge_gaps(values, np.arange(4), 24.0) is values
