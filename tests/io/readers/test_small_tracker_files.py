"""Files of trackers with as little in them as they may have."""

import h5py
import numpy as np
import pytest

from tests.io.files import load_shapes
from tests.io.readers import tracker_files as made


@pytest.mark.parametrize("frames", [7, 2])  # of two the order of axes is open but for the rule
def test_an_analysis_file_of_tracks_and_nodes_alone(tmp_path, points, confidence, read, frames):
    path = tmp_path / "tracks.h5"
    made.write_sleap_analysis(path, points[:frames], confidence[:frames])
    whole = read(path)
    with h5py.File(path, "a") as file:
        for name in set(file) - {"tracks", "node_names"}:
            del file[name]
    found = read(path)
    np.testing.assert_array_equal(found.landmarks, whole.landmarks)
    assert found.landmark_names == whole.landmark_names
    assert found.sequences == tuple(name.replace("animal", "track_") for name in whole.sequences)


def test_edges_of_a_skeleton_of_two_nodes(tmp_path, points, confidence, read):
    path = tmp_path / "labels.slp"
    made.write_slp(path, points[:, :, :2], confidence[:, :, :2])
    np.testing.assert_array_equal(read(path).columns["edges"], [[0, 1]])


@pytest.mark.parametrize(
    ("units", "unit"),
    [(["meters"], "m"), (["meters", "inches"], "unknown")],
)
def test_the_unit_of_shapes_in_nwb_is_that_of_all_series(tmp_path, rng, units, unit):
    path = tmp_path / "poses.nwb"
    points = rng.standard_normal((5, 1, 4, 3))
    made.write_nwb(path, points, np.ones((5, 1, 4)))
    with h5py.File(path, "a") as file:
        for number in range(4):
            data = file[f"processing/behavior/animal0/point{number}/data"]
            data.attrs["unit"] = units[number % len(units)]
    shapes, _ = load_shapes(path)
    assert shapes.unit == unit
    np.testing.assert_allclose(shapes.shapes.swapaxes(1, 2), points[:, 0])


def test_an_edge_to_a_landmark_that_is_not_there(tmp_path, points, confidence, problem):
    path = tmp_path / "tracks.h5"
    made.write_sleap_analysis(path, points, confidence)
    with h5py.File(path, "a") as file:
        file["edge_inds"][...] = [[0, points.shape[2]]]
    assert "edge_inds points at no landmarks" in problem(path)
