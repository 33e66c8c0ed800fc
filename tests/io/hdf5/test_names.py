"""Names and texts in HDF5 files that no other file could hold."""

from __future__ import annotations

import h5py
import numpy as np

from shapefit.io import open_landmarks, read_shapes
from shapefit.io.records import LandmarkSet
from tests.io.files import save


def test_a_zero_byte_in_a_text_is_refused(shape_file, landmark_file, problems, edit):
    items = np.array([f"a\0{number}".encode() for number in range(5)], "S4")
    for path, read in ((shape_file, read_shapes), (landmark_file, open_landmarks)):
        assert problems(read, [edit(path, item=items)]) == (
            f"{path}:/item: holds a string with a zero byte; remove it",
        )


def test_a_dataset_whose_name_is_not_utf8_is_refused(shape_file, landmark_file, problems):
    for path, read in ((shape_file, read_shapes), (landmark_file, open_landmarks)):
        with h5py.File(path, "a") as file:
            file[b"\xff\xfe"] = np.zeros(8)
        (line,) = problems(read, [path])
        assert line.startswith(f"{path}: there is a name that is not plain UTF-8: ")


def test_many_landmark_names_are_compared_at_once(tmp_path):
    """Each with each would be 2e10 comparisons: the test would not end."""
    names = tuple(f"landmark {number}" for number in range(200_000))
    few = LandmarkSet(landmarks=np.zeros((1, 2, len(names))), landmark_names=names, items=("one",))
    save(tmp_path / "many.h5", few)
    with open_landmarks([tmp_path / "many.h5"]) as source:
        assert source.head.landmark_names == names
