"""Files of version 2: plain texts, and what is per item by an attribute; those of version 1."""

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.errors import InputError
from shapefit.io import LandmarkSet, open_landmarks, read_dictionary, read_results
from shapefit.io.layout import PER_ITEM, RENAMED
from tests.io.files import load, save


def to_version_1(path):
    """Give a file the names of version 1, and none of what came with version 2."""
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 1
        for old, name in RENAMED.items():
            if name in file:
                file.move(name, old)
        for node in file.values():
            node.attrs.pop(PER_ITEM, None)


def test_attributes_are_text(landmark_file):
    with h5py.File(landmark_file) as file:
        assert file.attrs["y_axis"] == "down"
        assert file.attrs["unit"] == "px"


@pytest.mark.parametrize("n", [2, 3, 4])
def test_a_matrix_of_the_file_is_not_cut_where_there_are_as_many_items(tmp_path, n):
    items = tuple(map(str, range(n)))
    images = LandmarkSet(
        np.full((n, 2, 3), 50.0),
        "abc",
        items,
        columns={"time": np.arange(n)},
        whole={"K": np.eye(3)},
    )
    save(tmp_path / "views.h5", images)
    with h5py.File(tmp_path / "views.h5", "a") as file:
        file["L"] = np.eye(3)
        assert file["time"].attrs[PER_ITEM]
    with open_landmarks([tmp_path / "views.h5"]) as source:
        first, *_ = source.batches(1)
    assert first.whole["K"].shape == first.whole["L"].shape == (3, 3)
    assert first.per_item["time"].tolist() == [0]


def test_per_item_without_a_row_for_each_item_is_refused(landmark_file):
    with h5py.File(landmark_file, "a") as file:
        file["mass"] = np.ones(3)
        file["mass"].attrs[PER_ITEM] = True
    with pytest.raises(InputError, match="/mass: has the shape"):
        load(landmark_file)


def test_results_of_version_1_are_converted(tmp_path, results, same, capsys):
    more = {"inlier_probability": np.ones((5, 4)), "reasons": np.array([""] * 5, dtype=object)}
    path, new = tmp_path / "old.h5", tmp_path / "new.h5"
    save(path, results.with_columns(more))
    to_version_1(path)
    with pytest.raises(InputError, match=r"version 1.*shapefit convert old.h5 -o NEW.h5"):
        read_results(path)
    assert run(["convert", str(path), "-o", str(new)]) == 0
    assert run(["info", str(path)]) == 0
    again = read_results(new)
    assert again.per_item["inlier_probability"].tolist() == more["inlier_probability"].tolist()
    assert again.per_item["reasons"].tolist() == [""] * 5


def test_dictionaries_of_version_1_are_converted(tmp_path, dictionary_file):
    to_version_1(dictionary_file)
    with pytest.raises(InputError, match="is of version 1, an earlier format"):
        read_dictionary(dictionary_file)
    new = tmp_path / "new.h5"
    assert run(["convert", str(dictionary_file), "-o", str(new)]) == 0
    retained, old = read_dictionary(new), read_dictionary(dictionary_file, old=True)
    assert retained.atom_items == old.atom_items
    np.testing.assert_array_equal(retained.atoms, old.atoms)


def test_landmarks_of_version_1_hold_the_same(landmark_file, same):
    before = load(landmark_file)
    to_version_1(landmark_file)
    same(before, load(landmark_file))
