"""HDF5 files that are wrong: what each fault says, and where."""

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
        return list(source.batches(3))


def open_landmarks_alone(path):
    """Open a file, from which nothing is read: faults are found before any chunk."""
    with open_landmarks([path]):
        pass


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
    assert problems(reader, path) == (f"{path}: there is no such file; check the path",)


def test_a_folder(reader, tmp_path, problems):
    (line,) = problems(reader, tmp_path)
    assert line.startswith(f"{tmp_path}: it is a folder")
    assert "; name the files in it" in line


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("x.h5", "", "is empty (0 bytes); make or copy the file again"),
        ("x.csv", "", "is empty (0 bytes); make or copy the file again"),
        ("x.h5", "item,landmark,x,y\n", "is not an HDF5 file; give an HDF5 file, or name it .csv"),
    ],
)
def test_an_empty_file_or_another_one(reader, tmp_path, problems, name, text, told):
    (tmp_path / name).write_text(text)
    (line,) = problems(reader, tmp_path / name)
    assert line.startswith(f"{tmp_path / name}: {told}")


def test_another_format(shape_file, landmark_file, problems):
    for reader in (READERS["landmarks"], READERS["results"], READERS["dictionary"]):
        (line,) = problems(reader, shape_file)
        assert line.startswith(f"{shape_file}: is a shapefit-shapes file; give a shapefit-")
    (line,) = problems(READERS["shapes"], landmark_file)
    assert line == f"{landmark_file}: is a shapefit-landmarks file; give a shapefit-shapes file"


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("version", 3, "has the root attribute version 3; this program reads version 2, a number"),
        ("version", "1", "has the root attribute version '1'; this program reads version 2"),
        ("version", None, "has the root attribute version None; this program reads version 2"),
        ("format", None, "has no root attribute format, and holds edges, item, landmark_names"),
    ],
)
def test_no_format_or_another_version(shape_file, problems, name, value, found):
    with h5py.File(shape_file, "a") as file:
        del file.attrs[name]
        if value is not None:
            file.attrs[name] = value
    (line,) = problems(READERS["shapes"], shape_file)
    assert line.startswith(f"{shape_file}: {found}")


def test_a_dictionary_through_a_pipe(tmp_path, problems):
    os.mkfifo(tmp_path / "pipe")
    for path, name in ((tmp_path / "pipe", tmp_path / "pipe"), (Path("-"), "standard input")):
        (line,) = problems(READERS["dictionary"], path)
        assert line == f"{name}: is a CSV file, not an HDF5 file; give a shapefit-dictionary file"


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
            "format": "shapefit-landmarks file"
            if value != h5py.Empty("f")
            else "to shapefit-landmarks",
            "version": "this program reads version 2, a number",
            "y_axis": "set it to up or down",
        }[name]
    )


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 0.999])
def test_a_truncated_file(landmark_file, problems, share):
    data = landmark_file.read_bytes()
    landmark_file.write_bytes(data[: int(share * len(data))])
    (line,) = problems(read_landmarks, landmark_file)
    assert line.startswith(f"{landmark_file}: cannot be read (")
    assert line.endswith("; the file may be cut off or damaged: copy or make it again")


def test_a_wrong_direction_of_y(landmark_file, problems):
    with h5py.File(landmark_file, "a") as file:
        file.attrs["y_axis"] = "left"
    (line,) = problems(read_landmarks, landmark_file)
    assert line == f"{landmark_file}: the root attribute y_axis is 'left'; set it to up or down"


def point(value, *place):
    """Return what puts a value at this place of a dataset."""

    def change(values):
        values = values.copy()
        values[place] = value
        return values

    return change


FINITE = "write a finite number, at most 1e+150, or leave the item out"
WEIGHT = "write 0 (hidden) or a positive number"
PER_ATOM = ("mesh_vertices", "atom_scale", "atom_item")

FAULTS = [
    ("landmarks", {"item": None, "landmarks": np.zeros((5, 2, 4)), "confidence": np.zeros((4, 4))},
     ["item: there is no such dataset; store UTF-8 text (items)",
      "landmarks: has the shape (5, 2, 4); store numbers (5 items, 4 landmarks, 2)",
      "confidence: has the shape (4, 4); store numbers (5 items, 4 landmarks)"]),
    ("shapes", {"shapes": "text", "item": np.arange(5), "edges": np.zeros((1, 2))},
     ["item: holds values of type int64; store UTF-8 text (5 items)",
      "shapes: holds values of type text; store numbers (5 items, 4 landmarks, 3)",
      "edges: holds values of type float64; store integers (1 edges, 2)"]),
    ("shapes", {"landmark_names": ["a", "b", "a", "c"]},
     ["landmark_names: holds an empty name, or one twice; give every landmark a unique name"]),
    ("shapes", {"landmark_names": ["a", "", "b", "c"]},
     ["landmark_names: holds an empty name, or one twice; give every landmark a unique name"]),
    *(("shapes", {"shapes": point([1.0, 2.0, value], 3, 1)},
       [f"shapes[3]: landmark 'left hand' is (1.0, 2.0, {value}); {FINITE}"])
      for value in (np.nan, np.inf, -np.inf)),
    ("shapes", {"mesh_vertices": point([np.nan, 1.0, 2.0], 0, 5)},
     [f"mesh_vertices[0]: vertex 5 is (nan, 1.0, 2.0); {FINITE}"]),
    ("landmarks", {"landmarks": point([1.0, np.inf], 4, 0)},
     ["landmarks[4]: landmark 'head' is (1.0, inf); write NaN where the landmark is unseen"]),
    *(("landmarks", {"confidence": point(value, 2, 3)},
       [f"confidence[2]: landmark 'foot' is ({value}); {WEIGHT}"])
      for value in (-0.1, np.nan, np.inf)),
    ("shapes", {"edges": [[0, 1], [2, 4]]},
     ["edges[1]: holds the indices (2, 4); indices run from 0 to 3"]),
    ("dictionary", {"mesh_faces": [[0, -1, 2]]},
     ["mesh_faces[0]: holds the indices (0, -1, 2); indices run from 0 to 5"]),
    ("dictionary", {"atoms": np.full((7, 4, 3), np.inf)},
     [f"atoms[0]: landmark 'head' is (inf, inf, inf); {FINITE}", *["*"] * 9, "... and 18 more"]),
    ("dictionary", {"atoms": np.zeros((0, 4, 3)), **dict.fromkeys(PER_ATOM)},
     ["atoms: has the shape (0, 4, 3); a dictionary needs atoms and landmarks"]),
    ("dictionary", {"mesh_vertices": point([1.0, np.inf, 2.0], 6, 5)},
     [f"mesh_vertices[6]: vertex 5 is (1.0, inf, 2.0); {FINITE}"]),
    *(("dictionary", {"atom_scale": point(value, 2)},
       ["atom_scale: holds numbers that cannot be; make the dictionary again"])
      for value in (0.0, -1.0, np.nan, np.inf)),
    ("dictionary", {"atom_scale": np.ones(6), "atom_item": ["x"] * 8},
     ["atom_scale: has the shape (6,); store numbers (7 atoms)",
      "atom_item: has the shape (8,); store UTF-8 text (7 atoms)"]),
    *((kind, {"item": ["a", "b", "c", "b", "b"]},
       [f"item[{row}]: item 'b' is also at {{path}}:/item[{other}]; give every item a unique name"
        for row, other in ((3, 1), (4, 3))])
      for kind in ("shapes", "results")),
]  # fmt: skip
"""A reader, datasets of its file changed, and the lines of the error, of which * is any."""


@pytest.mark.parametrize(("kind", "datasets", "lines"), FAULTS)
def test_datasets_that_are_wrong(request, problems, edit, kind, datasets, lines):
    path = request.getfixturevalue(f"{kind.removesuffix('s')}_file")
    with h5py.File(path) as file:
        made = {
            name: value(file[name][()]) if callable(value) else value
            for name, value in datasets.items()
        }
    reader = open_landmarks_alone if kind == "landmarks" else READERS[kind]
    told = problems(reader, edit(path, **made))
    for line, wanted in zip(told, lines, strict=True):
        assert wanted in ("*", line.removeprefix(f"{path}:/").replace(str(path), "{path}"))


def test_faults_far_into_the_file_are_named_by_their_row(
    tmp_path, problems, monkeypatch, landmarks, edit
):
    monkeypatch.setattr("shapefit.io.source.MAX_IN_MEMORY", 0)
    bad = landmarks.landmarks.copy()
    bad[4, 0, 3] = np.inf
    items = (*landmarks.items[:3], "", "image 1")
    path = tmp_path / "views.h5"
    save(path, landmarks.replaced(landmarks=bad, items=items))
    (line,) = problems(open_landmarks, [path])
    assert line.startswith(f"{path}:/landmarks[4]: landmark 'foot' is (inf, ")
    edit(path, landmarks=landmarks.landmarks.swapaxes(1, 2))
    line, _ = problems(open_landmarks, [path])
    assert line == f"{path}:/item[3]: is empty; name every item"
    edit(path, item=[*items[:3], "x", "image 1"])
    (line,) = problems(open_landmarks, [path])
    assert line == (
        f"{path}:/item[4]: item 'image 1' is also at {path}:/item[1]; give every item a unique name"
    )


def test_a_dictionary_may_lack_scales_and_items(dictionary_file, dictionary, same, edit):
    edit(dictionary_file, atom_scale=None, atom_item=None)
    bare = replace(dictionary, atom_scale=None, atom_items=None)
    same(read_dictionary(dictionary_file), bare)
