"""HDF5: what is stored, what is read, and how version 1 is converted."""

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from shapefit.cli.main import run

from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_dictionary, read_results, read_shapes
from shapefit.io.layout import PER_ITEM, RENAMED
from shapefit.records import Landmarks
from tests.columns import put
from tests.io.files import load, save

# What is stored

PROMISED = [
    ("shape", "shapes", {"shapes": (5, 4, 3), "mesh_vertices": (5, 6, 3)}),
    ("landmark", "landmarks", {"landmarks": (5, 4, 2), "confidence": (5, 4)}),
    ("result", "result", {"shapes": (5, 4, 3), "transforms": (5, 7, 2, 3)}),
    ("dictionary", "dictionary", {"atoms": (7, 4, 3), "mean_shape": (4, 3)}),
]
"""A fixture without its `_file`, the format that its file names, and the shapes of some
datasets.
"""


@pytest.fixture
def promised_file(request):
    """The file of the fixture that a row of PROMISED names."""
    return request.getfixturevalue(f"{request.param}_file")


@pytest.mark.parametrize(
    ("promised_file", "kind", "shapes_of"), PROMISED, indirect=["promised_file"]
)
def test_files_are_laid_out_as_promised(promised_file, kind, shapes_of):
    with h5py.File(promised_file) as file:
        assert file.attrs["format"] == f"shapefit-{kind}"
        assert file.attrs["version"] == 2
        assert file.attrs["unit"] in {"m", "px", "normalised"}
        for name, shape in shapes_of.items():
            dataset = file[name]
            assert dataset.shape == shape
            assert dataset.dtype == np.float64


def test_landmarks_say_where_y_points(landmark_file):
    with h5py.File(landmark_file) as file:
        assert file.attrs["y_axis"] == "down"


FILES = ["shape_file", "landmark_file", "result_file", "dictionary_file"]


@pytest.fixture(params=FILES)
def any_file(request):
    """A file of each kind."""
    return request.getfixturevalue(request.param)


def test_the_superblock_has_a_checksum_and_says_how_long_the_file_is(any_file):
    version_of_superblock = any_file.read_bytes()[8]
    size = any_file.stat().st_size
    assert version_of_superblock == 3
    assert size < 1 << 20
    with h5py.File(any_file) as file:
        assert file.id.get_filesize() == size


def test_every_dataset_has_a_checksum_and_texts_are_utf8_of_any_length(any_file):
    def check(_name: str, node: object) -> None:
        if not isinstance(node, h5py.Dataset):
            return
        is_an_array_of_values = node.size > 0 and node.ndim > 0
        assert node.fletcher32 == is_an_array_of_values
        text = h5py.check_string_dtype(node.dtype)
        if text is not None:
            assert text.encoding == "utf-8"
            assert text.length

    with h5py.File(any_file) as file:
        file.visititems(check)


def test_one_point_a_row_in_the_file_one_a_column_in_memory(shape_file, shapes):
    columns = shapes.as_columns()
    with h5py.File(shape_file) as file:
        left_hand = file["shapes"][2, 1]
        vertex = file["mesh_vertices"][4, 5]
    assert_array_equal(left_hand, columns[2, :, 1])
    assert_array_equal(vertex, shapes.mesh_vertices[4, 5])


def test_columns_are_contiguous_in_memory(shape_file):
    columns = read_shapes([shape_file]).as_columns()
    assert columns.flags.c_contiguous


# What is read


@pytest.mark.parametrize("n", [2, 3, 4])
def test_a_matrix_of_the_file_is_not_cut_where_there_are_as_many_items(tmp_path, n):
    path = tmp_path / "views.h5"
    landmarks = Landmarks(
        np.full((n, 3, 2), 50.0),
        landmark_names=tuple("abc"),
        items=tuple(map(str, range(n))),
        times=np.arange(n),
        file_extras={"K": np.eye(3), "camera_matrix": np.eye(3)},
    )
    save(path, landmarks)
    with h5py.File(path, "a") as file:
        assert file["time"].attrs[PER_ITEM]
        file["L"] = np.eye(3)
        file["mass"] = np.ones(n + 1)
        file["mass"].attrs[PER_ITEM] = True  # which cannot be
    with open_landmarks([path]) as source:
        first, *_ = source.batches(1)
    for name in ("K", "L", "camera_matrix"):
        assert first.column(name).shape == (3, 3)
    assert first.column("mass").shape == (n + 1,)
    assert first.column("time").tolist() == [0]


def test_a_dataset_without_values_is_not_carried_along(landmark_file):
    with h5py.File(landmark_file, "a") as file:
        file["note"] = h5py.Empty("f")
        file["camera/note"] = h5py.Empty(h5py.string_dtype())
    landmarks = load(landmark_file)
    assert not {"note", "camera/note"} & landmarks.file_extras.keys()
    save(landmark_file, landmarks)


@pytest.fixture
def file_with_groups(landmark_file, edit):
    """Landmarks with a group: a focal length of each image, a model of all cameras."""
    edit(landmark_file, **{"camera/focal": np.arange(5.0), "camera/model": "pinhole"})
    with h5py.File(landmark_file, "a") as file:
        file["camera/focal"].attrs[PER_ITEM] = True
    return landmark_file


def test_nested_datasets_are_read(file_with_groups):
    first_three = load(file_with_groups).take([0, 1, 2])
    assert first_three.column("camera/focal").tolist() == [0, 1, 2]
    assert first_three.column("camera/model").item() == "pinhole"


def test_nested_datasets_are_written_again(file_with_groups, tmp_path):
    again = tmp_path / "again.h5"
    save(again, load(file_with_groups))
    with h5py.File(again) as file:
        model = file["camera/model"].asstr()
        assert model[()] == "pinhole"


def test_single_precision_is_read_as_double(landmark_file, landmarks, edit):
    points = landmarks.landmarks.astype("f4")
    edit(landmark_file, landmarks=points)
    read = load(landmark_file).landmarks
    assert read.dtype == np.float64
    assert_array_equal(read, points)


def test_half_a_position_is_none(landmark_file, landmarks, edit):
    points = landmarks.landmarks.copy()
    points[0, 0] = (1.0, np.nan)
    edit(landmark_file, landmarks=points)
    head = load(landmark_file).landmarks[0, 0]
    assert np.isnan(head).all()


def test_flags_are_read_as_confidence(landmark_file, edit):
    edit(landmark_file, confidence=np.ones((5, 4), bool))
    confidence = load(landmark_file).confidence
    assert (confidence == 1).all()


def test_texts_of_fixed_length_are_read(landmark_file, edit):
    items = np.array([b"a", b"b", b"c", b"d", b"e"])
    edit(landmark_file, item=items)
    assert load(landmark_file).items == tuple("abcde")


# Version 1


def to_version_1(path):
    """Give a file the names of version 1, and none of what came with version 2."""
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 1
        for old, name in RENAMED.items():
            if name in file:
                file.move(name, old)
        for node in file.values():
            node.attrs.pop(PER_ITEM, None)


INLIERS = np.linspace(0, 1, 20).reshape(5, 4)


@pytest.fixture
def old_result(tmp_path, results):
    """A result of version 1 with columns that later had other names."""
    path = tmp_path / "old.h5"
    no_reasons = np.array([""] * 5, dtype=object)
    columns = {"inlier_probability": INLIERS, "reasons": no_reasons}
    save(path, put(results, columns))
    to_version_1(path)
    return path


@pytest.fixture
def old_dictionary(dictionary_file):
    to_version_1(dictionary_file)
    return dictionary_file


@pytest.mark.parametrize(
    ("fixture", "read"),
    [("old_result", read_results), ("old_dictionary", read_dictionary)],
)
def test_version_1_is_refused_with_the_command_that_converts_it(
    request, tmp_path, fixture, read
):
    old = request.getfixturevalue(fixture)
    new = tmp_path / "new.h5"
    fix = rf"version 1.*shapefit convert {old.name} -o NEW.h5"
    with pytest.raises(InputError, match=fix):
        read(old)
    assert run(["info", str(old)]) == 0
    assert run(["convert", str(old), "-o", str(new)]) == 0
    read(new)


def test_a_converted_result_has_the_columns_of_the_old_one(old_result, tmp_path):
    new = tmp_path / "new.h5"
    assert run(["convert", str(old_result), "-o", str(new)]) == 0
    converted = read_results(new)
    inliers = converted.column("inlier_probability")
    assert_array_equal(inliers, INLIERS)
    assert converted.column("reasons").tolist() == [""] * 5


def test_an_old_dictionary_can_be_asked_for(old_dictionary):
    dictionary = read_dictionary(old_dictionary, old=True)
    assert len(dictionary.atom_items) == 7
