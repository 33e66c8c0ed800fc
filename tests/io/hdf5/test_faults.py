"""HDF5 files that are wrong: what each fault says, and where."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.io import (
    open_landmarks,
    read_dictionary,
    read_results,
    read_shapes,
)
from tests.io.files import save


def read_landmarks(*paths):
    with open_landmarks(paths) as source:
        return list(source.chunks(3))


READERS = {
    "shapes": lambda path: read_shapes([path]),
    "landmarks": read_landmarks,
    "results": read_results,
    "dictionary": read_dictionary,
}


@pytest.fixture(params=READERS)
def reader(request):
    return READERS[request.param]


def test_a_missing_file(reader, tmp_path, problems):
    path = tmp_path / "none" / "x.h5"
    assert problems(reader, path) == (
        f"{path}: there is no such file; check the path ({tmp_path} exists, what follows does not)",
    )
    assert problems(reader, tmp_path / "x.h5") == (
        f"{tmp_path / 'x.h5'}: there is no such file; check its name",
    )


def test_a_folder(reader, tmp_path, problems):
    (line,) = problems(reader, tmp_path)
    assert line.startswith(f"{tmp_path}: it is a folder")
    assert f"; name the files in it, e.g. '{tmp_path}/*.h5'" in line


def test_an_empty_file(reader, tmp_path, problems):
    for name in ("x.h5", "x.csv"):
        path = tmp_path / name
        path.write_bytes(b"")
        assert problems(reader, path) == (
            f"{path}: is empty (0 bytes); make or copy the file again",
        )


def test_not_hdf5(reader, tmp_path, problems):
    path = tmp_path / "x.h5"
    path.write_text("item,landmark,x,y\n")
    assert problems(reader, path) == (
        f"{path}: is not an HDF5 file; give an HDF5 file, or name it .csv if it is CSV",
    )


def test_hdf5_is_known_by_its_content(tmp_path, shape_file, shapes, same):
    same(read_shapes([shape_file.rename(tmp_path / "shapes.csv")]), shapes)


def test_another_format(shape_file, landmark_file, problems):
    for reader in (READERS["landmarks"], READERS["results"], READERS["dictionary"]):
        (line,) = problems(reader, shape_file)
        assert line.startswith(f"{shape_file}: is a shapefit-shapes file; give a shapefit-")
    (line,) = problems(READERS["shapes"], landmark_file)
    assert line == f"{landmark_file}: is a shapefit-landmarks file; give a shapefit-shapes file"


def test_no_format_or_another_version(shape_file, problems):
    with h5py.File(shape_file, "a") as file:
        file.attrs["version"] = 2
    (line,) = problems(READERS["shapes"], shape_file)
    assert line == f"{shape_file}: has version 2; this program reads version 1"
    with h5py.File(shape_file, "a") as file:
        file.attrs["version"] = "1"
    (line,) = problems(READERS["shapes"], shape_file)
    assert line == f"{shape_file}: has the version '1' as text; store the number 1"
    with h5py.File(shape_file, "a") as file:
        del file.attrs["version"]
    assert "no root attribute version" in problems(READERS["shapes"], shape_file)[0]
    with h5py.File(shape_file, "a") as file:
        del file.attrs["format"]
    assert "no root attribute format" in problems(READERS["shapes"], shape_file)[0]


def test_a_dictionary_through_a_pipe(tmp_path, problems):
    os.mkfifo(tmp_path / "pipe")
    for path, name in ((tmp_path / "pipe", tmp_path / "pipe"), (Path("-"), "standard input")):
        (line,) = problems(READERS["dictionary"], path)
        assert line == f"{name}: is not a file on a disk; give a shapefit-dictionary file"


@pytest.mark.parametrize("name", ["format", "version", "y_axis"])
@pytest.mark.parametrize("value", [[1, 2], [], ["up", "down"], h5py.Empty("f")])
def test_a_root_attribute_of_another_kind(landmark_file, problems, name, value):
    with h5py.File(landmark_file, "a") as file:
        file.attrs[name] = value
    if name == "y_axis" and isinstance(value, h5py.Empty):
        assert read_landmarks(landmark_file)[0].y_axis == "down"
        return
    (line,) = problems(read_landmarks, landmark_file)
    assert line.startswith(f"{landmark_file}: ")
    assert line.endswith(
        {
            "format": "shapefit-landmarks file" if value != h5py.Empty("f") else "has that layout",
            "version": "this program reads version 1",
            "y_axis": "set it to up or down",
        }[name]
    )


def test_a_root_attribute_in_an_array_of_one(landmark_file):
    with h5py.File(landmark_file, "a") as file:
        file.attrs["version"] = np.array([1])
        file.attrs["unit"] = np.array(["mm"], dtype=h5py.string_dtype())
    assert read_landmarks(landmark_file)[0].unit == "mm"


def test_a_root_attribute_that_is_not_utf8(landmark_file, problems):
    with h5py.File(landmark_file, "a") as file:
        file.attrs.create("unit", b"\xff", dtype=h5py.string_dtype())
    assert problems(read_landmarks, landmark_file) == (
        f"{landmark_file}: root attribute unit: is not UTF-8 text, or has a zero byte; "
        "write it as UTF-8",
    )


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 0.999])
def test_a_truncated_file(landmark_file, problems, share):
    data = landmark_file.read_bytes()
    landmark_file.write_bytes(data[: int(share * len(data))])
    (line,) = problems(read_landmarks, landmark_file)
    assert line.startswith(f"{landmark_file}: cannot be read (")
    assert line.endswith("; the file may be cut off or damaged: copy or make it again")


def test_missing_and_misshapen_datasets_are_told_together(landmark_file, landmarks, problems, edit):
    edit(landmark_file, item=None, landmarks=np.zeros((5, 2, 4)), confidence=np.zeros((4, 4)))
    assert problems(read_landmarks, landmark_file) == (
        f"{landmark_file}:/item: there is no such dataset; store UTF-8 text (items)",
        f"{landmark_file}:/landmarks: has the shape (5, 2, 4); "
        "store numbers (items, landmarks, 2), here (5, 4, 2)",
        f"{landmark_file}:/confidence: has the shape (4, 4); "
        "store numbers (items, landmarks), here (5, 4)",
    )


def test_datasets_of_another_kind(shape_file, problems, edit):
    edit(shape_file, shapes="text", item=np.arange(5), edges=np.zeros((1, 2)))
    assert problems(READERS["shapes"], shape_file) == (
        f"{shape_file}:/item: holds values of type int64; store UTF-8 text (items)",
        f"{shape_file}:/shapes: holds values of type text; store numbers (items, landmarks, 3)",
        f"{shape_file}:/edges: holds values of type float64; store integers (edges, 2)",
    )


def test_a_group_in_place_of_a_dataset(shape_file, problems, edit):
    edit(shape_file, shapes=None, edges=None)
    with h5py.File(shape_file, "a") as file:
        file.create_group("shapes")
        file.create_group("edges")
    assert problems(READERS["shapes"], shape_file) == (
        f"{shape_file}:/shapes: is not a dataset; store numbers (items, landmarks, 3)",
        f"{shape_file}:/edges: is not a dataset; store integers (edges, 2)",
    )


def test_a_damaged_dataset(shape_file, problems, edit):
    edit(shape_file, shapes=None)
    with h5py.File(shape_file, "a") as file:
        stored = file.create_dataset(
            "shapes", (5, 4, 3), "f8", chunks=(5, 4, 3), compression="gzip"
        )
        stored[...] = 1.5
        start = stored.id.get_chunk_info(0).byte_offset
    with shape_file.open("r+b") as file:
        file.seek(start)
        file.write(b"damage")
    (line,) = problems(READERS["shapes"], shape_file)
    assert line.startswith(f"{shape_file}:/shapes: cannot be read (")


def test_text_that_is_not_utf8(shape_file, problems, edit):
    edit(shape_file, item=None)
    with h5py.File(shape_file, "a") as file:
        file["item"] = np.array([b"\xff", b"b", b"c", b"d", b"e"])
    (line,) = problems(READERS["shapes"], shape_file)
    assert line == f"{shape_file}:/item: holds text that is not UTF-8; write its strings as UTF-8"


def test_landmark_names_that_repeat_or_are_empty(shape_file, problems, edit):
    edit(shape_file, landmark_names=["a", "b", "a", "c"])
    (line,) = problems(READERS["shapes"], shape_file)
    assert line.startswith(f"{shape_file}:/landmark_names[2]: repeats the name 'a'; ")
    edit(shape_file, landmark_names=["a", "", "b", "c"])
    (line,) = problems(READERS["shapes"], shape_file)
    assert line.startswith(f"{shape_file}:/landmark_names[1]: is empty; ")


def test_a_wrong_direction_of_y(landmark_file, problems):
    with h5py.File(landmark_file, "a") as file:
        file.attrs["y_axis"] = "left"
    (line,) = problems(read_landmarks, landmark_file)
    assert line == f"{landmark_file}: the root attribute y_axis is 'left'; set it to up or down"


def test_a_dataset_that_cannot_be_carried(landmark_file, problems):
    with h5py.File(landmark_file, "a") as file:
        file["link"] = np.array([file.ref] * 5, dtype=h5py.ref_dtype)
    (line,) = problems(read_landmarks, landmark_file)
    assert line.startswith(f"{landmark_file}:/link: cannot be carried over; ")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_coordinates_of_shapes_must_be_finite(shape_file, shapes, problems, value, edit):
    bad = shapes.shapes.swapaxes(1, 2).copy()
    bad[3, 1, 2] = value
    (line,) = problems(READERS["shapes"], edit(shape_file, shapes=bad))
    x, y, _ = bad[3, 1]
    assert line == (
        f"{shape_file}:/shapes[3]: landmark 'left hand' is ({x}, {y}, {value}); "
        "write a finite number, at most 1e+150, or leave the item out"
    )


def test_vertices_and_atoms_must_be_finite(shape_file, dictionary_file, shapes, problems, edit):
    bad = shapes.mesh_vertices.swapaxes(1, 2).copy()
    bad[0, 5, 0] = np.nan
    (line,) = problems(READERS["shapes"], edit(shape_file, mesh_vertices=bad))
    assert line.startswith(f"{shape_file}:/mesh_vertices[0]: vertex 5 is (nan, ")
    edit(dictionary_file, atoms=np.full((7, 4, 3), np.inf))
    lines = problems(read_dictionary, dictionary_file)
    assert lines[0].startswith(f"{dictionary_file}:/atoms[0]: landmark 'head' is (inf, inf, inf)")
    assert lines[-1] == "... and 18 more"


def test_infinite_landmarks_are_found_before_any_chunk(landmark_file, landmarks, problems, edit):
    bad = landmarks.landmarks.swapaxes(1, 2).copy()
    bad[4, 0, 1] = np.inf
    (line,) = problems(open_landmarks, [edit(landmark_file, landmarks=bad)])
    assert line.startswith(f"{landmark_file}:/landmarks[4]: landmark 'head' is (")
    assert line.endswith("; write NaN where the landmark is unseen")


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_confidence_must_be_a_weight(landmark_file, landmarks, problems, value, edit):
    bad = landmarks.confidence.copy()
    bad[2, 3] = value
    (line,) = problems(open_landmarks, [edit(landmark_file, confidence=bad)])
    assert line == (
        f"{landmark_file}:/confidence[2]: landmark 'foot' is ({value}); "
        "write 0 (hidden) or a positive number"
    )


def test_faults_far_into_the_file_are_named_by_their_row(
    tmp_path, problems, monkeypatch, landmarks, edit
):
    monkeypatch.setattr("shapefit.io.stored.reader.BLOCK", 2)
    bad = landmarks.landmarks.copy()
    bad[4, 0, 3] = np.inf
    items = (*landmarks.items[:3], "", "image 1")
    path = tmp_path / "views.h5"
    save(path, replace(landmarks, landmarks=bad, items=items))
    (line,) = problems(open_landmarks, [path])
    assert line == f"{path}:/item[3]: is empty; name every item"
    edit(path, item=[*items[:3], "x", "image 1"])
    (line,) = problems(open_landmarks, [path])
    assert line.startswith(f"{path}:/landmarks[4]: landmark 'foot' is (inf, ")
    edit(path, landmarks=landmarks.landmarks.swapaxes(1, 2))
    (line,) = problems(open_landmarks, [path])
    assert line == (
        f"{path}:/item[4]: item 'image 1' is also at {path}:/item[1]; give every item a unique name"
    )


def test_indices_must_point_at_something(shape_file, dictionary_file, problems, edit):
    (line,) = problems(READERS["shapes"], edit(shape_file, edges=[[0, 1], [2, 4]]))
    assert line == f"{shape_file}:/edges[1]: holds the indices (2, 4); indices run from 0 to 3"
    (line,) = problems(read_dictionary, edit(dictionary_file, mesh_faces=[[0, -1, 2]]))
    assert line.endswith("/mesh_faces[0]: holds the indices (0, -1, 2); indices run from 0 to 5")


def test_a_dictionary_without_atoms(dictionary_file, problems, edit):
    gone = dict.fromkeys(("mesh_vertices", "atom_scale", "atom_item"))
    edit(dictionary_file, atoms=np.zeros((0, 4, 3)), **gone)
    (line,) = problems(read_dictionary, dictionary_file)
    assert line.startswith(f"{dictionary_file}:/atoms: has the shape (0, 4, 3); ")


def test_duplicate_items_in_one_file(shape_file, result_file, problems, edit):
    for path, read in ((shape_file, READERS["shapes"]), (result_file, read_results)):
        edit(path, item=["a", "b", "c", "b", "b"])
        assert problems(read, path) == (
            f"{path}:/item[3]: item 'b' is also at {path}:/item[1]; give every item a unique name",
            f"{path}:/item[4]: item 'b' is also at {path}:/item[1]; give every item a unique name",
        )


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_an_atom_must_measure_something(dictionary_file, problems, value, edit):
    edit(dictionary_file, atom_scale=[1.0, 2.0, value, 1.0, 1.0, 1.0, 1.0])
    (line,) = problems(read_dictionary, dictionary_file)
    assert line == f"{dictionary_file}:/atom_scale[2]: is {value}; write a positive number"


def test_vertices_of_atoms_must_be_finite(dictionary_file, dictionary, problems, edit):
    bad = dictionary.mesh_vertices.swapaxes(1, 2).copy()
    bad[6, 5, 1] = np.inf
    (line,) = problems(read_dictionary, edit(dictionary_file, mesh_vertices=bad))
    assert line.startswith(f"{dictionary_file}:/mesh_vertices[6]: vertex 5 is (")


def test_scales_and_items_belong_to_atoms(dictionary_file, problems, edit):
    edit(dictionary_file, atom_scale=np.ones(6), atom_item=["x"] * 8)
    assert problems(read_dictionary, dictionary_file) == (
        f"{dictionary_file}:/atom_scale: has the shape (6,); store numbers (atoms), here (7)",
        f"{dictionary_file}:/atom_item: has the shape (8,); store UTF-8 text (atoms), here (7)",
    )


def test_items_of_atoms_have_names(dictionary_file, problems, edit):
    (line,) = problems(read_dictionary, edit(dictionary_file, atom_item=[*"abcde", "", "g"]))
    assert line == f"{dictionary_file}:/atom_item[5]: is empty; name every item"


def test_a_dictionary_may_lack_scales_and_items(dictionary_file, dictionary, same, edit):
    edit(dictionary_file, atom_scale=None, atom_item=None)
    bare = replace(dictionary, atom_scale=None, atom_items=None)
    same(read_dictionary(dictionary_file), bare)
