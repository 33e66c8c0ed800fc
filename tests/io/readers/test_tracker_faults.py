"""What is wrong with a file of a tracker is said with its place and a fix, whatever it is."""

from __future__ import annotations

import pickle

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks
from tests.io.readers.tracker_files import WRITERS


@pytest.fixture
def write(tmp_path, points, confidence):
    def write(name: str):
        WRITERS[name](tmp_path / name, points, confidence)
        return tmp_path / name

    return write


def read_or_refuse(path) -> bool:
    """Whether a file can be read; False where it is refused in plain words."""
    try:
        with open_landmarks([path]) as source:
            for _ in source.batches(3):
                pass
    except InputError:
        return False
    return True


@pytest.mark.parametrize("name", WRITERS)
def test_files_that_are_cut_off(write, name):
    path = write(name)
    data = path.read_bytes()
    for end in np.linspace(1, len(data) - 1, 6).astype(int):
        path.write_bytes(data[:end])
        whole = read_or_refuse(path)
        assert name.endswith(".csv") or not whole


def test_pickles_that_are_not_lists_of_names_are_refused(write, problem, tmp_path):
    path = write("table.h5")
    witness = tmp_path / "executed"
    evil = b"cos\nsystem\n(Vtouch " + str(witness).encode() + b"\ntR."
    for blob, found in (
        (evil, "asks for os.system, which is never executed here"),
        (pickle.dumps(np.zeros, 2), "asks for numpy"),
        (b"(lp999999999\n.", "cannot be read as a DeepLabCut HDF5 file"),
        (b"(lp0\n", "cannot be read as a DeepLabCut HDF5 file"),
    ):
        with h5py.File(path, "a") as file:
            file["df_with_missing/table"].attrs["values_block_0_kind"] = np.bytes_(blob)
        text = problem(path)
        assert found in text
    assert not witness.exists()


def test_a_filter_that_is_not_there(write, problem):
    path = write("tracks.analysis.h5")
    with h5py.File(path, "a") as file:
        values = file["tracks"][:]
        del file["tracks"]
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk(values.shape)
        creation.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, (2, 2, 4, 64))  # blosc
        space = h5py.h5s.create_simple(values.shape)
        kind = h5py.h5t.IEEE_F64LE
        dataset = h5py.h5d.create(file.id, b"tracks", kind, space, creation)
        dataset.write_direct_chunk((0, 0, 0, 0), values.tobytes())
    text = problem(path)
    assert text.startswith(":/tracks: cannot be read (")
    assert text.endswith("write it again with gzip or without compression")


def two_tables(file):
    file.copy("df_with_missing", "tracks")


def edge_to_nowhere(file):
    file["edge_inds"][...] = [[0, 4]]


def bounding_boxes(file):
    file.attrs["ds_type"] = "bboxes"


def never_written(file):
    del file["edge_inds"]
    file.create_dataset("edge_inds", (10**7, 2), "i8", chunks=(1, 2))


def more_than_memory_holds(file):
    del file["tracks"], file["point_scores"]
    file.create_dataset("tracks", (2, 2, 4, 10**12), "f8", chunks=(2, 2, 4, 1 << 20))


def instances(column, rows, value, of="instances"):
    def change(file):
        table = file[of][:]
        table[column][:rows] = value
        file[of][...] = table

    return change


def no_start(file):
    file["processing/behavior/animal0/point1/starting_time"][()] = np.nan


def falling_times(file):
    series = file["processing/behavior/animal0/point1"]
    del series["starting_time"]
    series["timestamps"] = [0.0, 1, 2, 2, 3, 4, 5]


def no_poses(file):
    del file["processing/behavior"]


@pytest.mark.parametrize(
    ("name", "change", "found"),
    [
        ("table.h5", two_tables, "the tables df_with_missing, tracks; save one"),
        ("tracks.analysis.h5", edge_to_nowhere, "edge_inds points at no landmarks"),
        ("poses.nc", bounding_boxes, "bboxes, not poses"),
        ("tracks.analysis.h5", never_written, "the file holds 0 bytes; write its values"),
        ("tracks.analysis.h5", more_than_memory_holds, "tracks"),
        (
            "labels.slp",
            instances("instance_id_end", 1, 99, "frames"),
            "frames of instances that it does not hold",
        ),
        ("labels.slp", instances("track", 2, 0), "item 'labels/animal0/0' is also at"),
        (
            "labels.slp",
            instances("track", 1, 7),
            "instances of tracks, skeletons, videos or points",
        ),
        (
            "labels.slp",
            instances("skeleton", 1, 3),
            "instances of tracks, skeletons, videos or points",
        ),
        (
            "labels.slp",
            instances("instance_type", 1, 9),
            "instances of tracks, skeletons, videos or points",
        ),
        (
            "labels.slp",
            instances("point_id_end", 1, 3),
            "instances of tracks, skeletons, videos or points",
        ),
        ("poses.nwb", no_start, "the times of processing/behavior/animal0/point1 do not"),
        ("poses.nwb", falling_times, "the times of processing/behavior/animal0/point1 do not"),
        ("poses.nwb", no_poses, "no PoseEstimation (ndx-pose), so no landmarks"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(write, problem, name, change, found):
    path = write(name)
    with h5py.File(path, "a") as file:
        change(file)
    assert found in problem(path)


def test_a_name_that_is_not_utf8_is_no_reason_to_stop(write):
    path = write("table.h5")
    with h5py.File(path, "a") as file:
        file[b"\xff"] = 1
    assert read_or_refuse(path) in (True, False)
