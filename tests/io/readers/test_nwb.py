"""Poses in NWB: times of series, and units."""

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.io.files import load_shapes
from tests.io.readers import made

BEHAVIOR = "processing/behavior/animal0"


@pytest.fixture
def nwb_file(tmp_path, points, confidence):
    """A file of one animal, of which the second landmark has two frames alone."""
    path = tmp_path / "p.nwb"
    made.write_nwb(path, points[:, :1], confidence[:, :1])
    with h5py.File(path, "a") as file:
        series = file[f"{BEHAVIOR}/point1"]
        for name in ("data", "confidence", "starting_time"):
            del series[name]
        series["data"] = [[1.0, 2.0], [3.0, 4.0]]
        series["confidence"] = [0.5, 0.75]
        series["timestamps"] = np.array([2, 5]) / 30
    return path


def test_a_file_of_nwb_whose_series_differ_in_time(nwb_file, read):
    images = read(nwb_file)
    second = images.landmarks[:, 1]
    seen = np.isfinite(second[:, 0])
    assert len(images) == 7
    assert np.flatnonzero(seen).tolist() == [2, 5]
    assert second[5].tolist() == [3, 4]
    assert images.confidence[:, 1].tolist() == [0, 0, 0.5, 0, 0, 0.75, 0]


@pytest.mark.parametrize(("late", "rate"), [(0.19, pytest.approx(30)), (0.3, None)])
def test_a_rate_is_that_of_nearly_steady_times(nwb_file, read, late, rate):
    """The last frame is late by a share of the usual step."""
    times = np.append(np.arange(6), 6 + late) / 30
    with h5py.File(nwb_file, "a") as file:
        for number in (0, 2, 3):
            series = file[f"{BEHAVIOR}/point{number}"]
            del series["starting_time"]
            series["timestamps"] = times
    assert read(nwb_file).frame_rate == rate


UNITS = [(["meters"], "m"), (["meters", "ft"], "unknown")]
"""Units of the series in turn, and that of the shapes."""


@pytest.mark.parametrize(("units", "unit"), UNITS)
def test_the_unit_of_shapes_in_nwb_is_that_of_all_series(tmp_path, rng, units, unit):
    path = tmp_path / "poses.nwb"
    points = rng.standard_normal((5, 1, 4, 3))
    made.write_nwb(path, points, np.ones((5, 1, 4)))
    with h5py.File(path, "a") as file:
        for number in range(4):
            data = file[f"{BEHAVIOR}/point{number}/data"]
            data.attrs["unit"] = units[number % len(units)]
            data.attrs["conversion"] = 0.001
    shapes, _ = load_shapes(path)
    assert shapes.unit == unit
    assert_allclose(shapes.shapes, points[:, 0] / 1000)
