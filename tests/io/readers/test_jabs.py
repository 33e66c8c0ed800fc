"""Pose files of JABS: one mouse, several, and identities."""

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.io.readers import made

JABS = "mouse_pose_est_v2.h5"


@pytest.fixture
def mouse(tmp_path, rng):
    """A file of version 2, of one mouse that lacks a landmark once; and its points."""
    path = tmp_path / JABS
    points = rng.integers(1, 600, (7, 1, 12, 2)).astype(float)
    points[3, 0, 2] = np.nan
    made.write_jabs(path, points, np.full((7, 1, 12), 0.5))
    return path, points[:, 0]


def test_jabs(mouse, read):
    """Whose y comes first, and of whose landmarks none stands alone."""
    path, points = mouse
    images = read(path)
    assert_array_equal(images.landmarks, points)
    assert images.confidence[3].tolist() == [0.5, 0.5, 0, *[0.5] * 9]
    assert images.items[0] == "mouse/0"
    assert images.landmark_names[:2] == ("NOSE", "LEFT_EAR")
    assert {*images.lines.ravel()} == {*range(12)}


def test_jabs_of_another_number_of_landmarks_is_refused(mouse, problem):
    path, _ = mouse
    with h5py.File(path, "a") as file:
        values = file["poseest/points"][:]
        del file["poseest/points"]
        file["poseest/points"] = values[:, :9]
    assert "points of the shape (7, 9, 2), not of 12 land" in problem(path)


VERSIONS = [3, 4, 5]


@pytest.fixture
def mice(tmp_path, rng):
    """Write a file of two mice, of which the second is absent once; return it and the
    points.
    """

    def write(version):
        path = tmp_path / f"mice_pose_est_v{version}.h5"
        points = rng.integers(1, 600, (7, 2, 12, 2)).astype(float)
        points[3, 1] = np.nan
        confidence = np.full((7, 2, 12), 0.5)
        made.write_jabs_of_several(path, points, confidence, version=version)
        return path, points

    return write


@pytest.mark.parametrize("version", VERSIONS)
def test_jabs_of_several_mice(mice, read, version):
    """Their identities are kept where they change places, and where one is absent."""
    path, points = mice(version)
    images = read(path)
    first = 0 if version == 3 else 1
    names = [f"mice/{first}", f"mice/{first + 1}"]
    assert {*images.sequences} == {*names}
    for who, name in enumerate(names):
        rows = np.array(images.sequences) == name
        present = [frame for frame in range(7) if (frame, who) != (3, 1)]
        assert images.frames[rows].tolist() == present
        assert_array_equal(images.landmarks[rows], points[present, who])


@pytest.mark.parametrize("version", VERSIONS)
def test_several_mice_without_identities_are_refused(mice, problem, version):
    path, _ = mice(version)
    with h5py.File(path, "a") as file:
        del file["poseest/instance_track_id"]
        if version > 3:
            del file["poseest/instance_embed_id"]
    assert "several mice without identities" in problem(path)


LEFT_OUT = [
    (4, "instance_embed_id", [[1, 2], [0, 1]]),
    (3, "instance_count", [2, 1]),
]
"""A version, a dataset, and values by which one of four mice is none."""


@pytest.mark.parametrize(("version", "name", "values"), LEFT_OUT)
def test_a_mouse_without_an_identity_or_beyond_the_count_is_left_out(
    tmp_path, read, version, name, values
):
    path = tmp_path / f"m{version}.h5"
    points = np.full((2, 2, 12, 2), 7.0)
    made.write_jabs_of_several(path, points, points[..., 0], version=version)
    with h5py.File(path, "a") as file:
        file[f"poseest/{name}"][...] = values
    assert len(read(path)) == 3
