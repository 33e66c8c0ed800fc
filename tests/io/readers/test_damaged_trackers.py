"""Damaged files of trackers: what is wrong is named."""

import pickle
from contextlib import suppress

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.readers.made import TRACKERS, read_images


@pytest.fixture
def write(tmp_path, points, confidence):
    """Write the file of a tracker."""

    def write(name):
        path = tmp_path / name
        TRACKERS[name](path, points, confidence)
        return path

    return write


@pytest.mark.parametrize("name", TRACKERS)
def test_files_that_are_cut_off(write, name):
    """A table may end behind any row."""
    path = write(name)
    data = path.read_bytes()
    may_be_read = name.endswith(".csv")
    for size in np.linspace(1, len(data) - 1, 6).astype(int):
        path.write_bytes(data[:size])
        with suppress(InputError) if may_be_read else pytest.raises(InputError):
            read_images(path)


BROKEN_PICKLES = {
    "of another object": (pickle.dumps(np.zeros, 2), "asks for numpy"),
    "of a list without end": (
        b"(lp999999999\n.",
        "cannot be read as a DeepLabCut HDF5 file",
    ),
    "cut off": (b"(lp0\n", "cannot be read as a DeepLabCut HDF5 file"),
}


def put_pickle(path, pickled):
    with h5py.File(path, "a") as file:
        table = file["df_with_missing/table"]
        table.attrs["values_block_0_kind"] = np.bytes_(pickled)


@pytest.mark.parametrize(
    ("pickled", "fault"), BROKEN_PICKLES.values(), ids=BROKEN_PICKLES
)
def test_pickles_that_are_not_lists_of_names_are_refused(
    write, problem, pickled, fault
):
    path = write("table.h5")
    put_pickle(path, pickled)
    assert fault in problem(path)


def test_no_pickle_is_executed(write, problem, tmp_path):
    path = write("table.h5")
    witness = tmp_path / "executed"
    put_pickle(path, f"cos\nsystem\n(Vtouch {witness}\ntR.".encode())
    assert "asks for os.system, which is never executed here" in problem(path)
    assert not witness.exists()


BLOSC = 32001
"""The number of a filter that HDF5 does not have."""


def test_a_filter_that_is_not_there(write, problem):
    path = write("tracks.analysis.h5")
    with h5py.File(path, "a") as file:
        values = file["tracks"][:]
        del file["tracks"]
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk(values.shape)
        creation.set_filter(BLOSC, h5py.h5z.FLAG_OPTIONAL, (2, 2, 4, 64))
        space = h5py.h5s.create_simple(values.shape)
        kind = h5py.h5t.IEEE_F64LE
        dataset = h5py.h5d.create(file.id, b"tracks", kind, space, creation)
        dataset.write_direct_chunk((0, 0, 0, 0), values.tobytes())
    text = problem(path)
    assert text.startswith(":/tracks: cannot be read (")
    assert text.endswith("write it again with gzip or without compression")


LOST = "instances of "


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


TIMES_OF_POINT_1 = "the times of processing/behavior/animal0/point1 do not"


ANALYSIS = "tracks.analysis.h5"


DAMAGES = [
    ("table.h5", two_tables, "the tables df_with_missing, tracks; save one"),
    (ANALYSIS, edge_to_nowhere, "edge_inds points at no landmarks"),
    (ANALYSIS, never_written, "the file holds 0 bytes; write its values"),
    (ANALYSIS, more_than_memory_holds, "tracks"),
    ("poses.nc", bounding_boxes, "bboxes, not poses"),
    (
        "labels.slp",
        instances("instance_id_end", 1, 99, "frames"),
        "frames of instances that it does not hold",
    ),
    ("labels.slp", instances("track", 2, 0), "item 'labels/animal0/0' is also at"),
    ("labels.slp", instances("track", 1, 7), LOST),
    ("labels.slp", instances("skeleton", 1, 3), LOST),
    ("labels.slp", instances("instance_type", 1, 9), LOST),
    ("labels.slp", instances("point_id_end", 1, 3), LOST),
    ("poses.nwb", no_start, TIMES_OF_POINT_1),
    ("poses.nwb", falling_times, TIMES_OF_POINT_1),
    ("poses.nwb", no_poses, "no PoseEstimation (ndx-pose), so no landmarks"),
]
"""A file, what damages it, and a part of what is said."""


@pytest.mark.parametrize(("name", "change", "fault"), DAMAGES)
def test_what_is_wrong_is_named_with_its_place(write, problem, name, change, fault):
    path = write(name)
    with h5py.File(path, "a") as file:
        change(file)
    assert fault in problem(path)
