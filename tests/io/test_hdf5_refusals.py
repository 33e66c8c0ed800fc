"""HDF5: what each fault of a file says."""

import h5py
import numpy as np
import pytest

from tests.io.files import READERS, load


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_missing_file(read, tmp_path, problems):
    path = tmp_path / "none" / "x.h5"
    told = problems(read, path)
    assert told == (f"{path}: there is no such file; check the path",)


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_folder_in_place_of_a_file(read, tmp_path, problems):
    (line,) = problems(read, tmp_path)
    assert line.startswith(f"{tmp_path}: it is a folder")
    assert "; name the files in it" in line


OTHER_FORMAT = "is a shapefit-shapes file; give a shapefit-landmarks file"


VERSIONS = [
    (3, "3"),
    ("1", "'1'"),
    (None, "None"),
    ([1, 2], "[1, 2]"),
    (h5py.Empty("f"), "None"),
]
"""Values of the root attribute `version`, of which None is its absence, and as the
error shows them.
"""


@pytest.fixture
def set_root_attribute(landmark_file):
    """Give a file of landmarks a root attribute, or none of this name for None."""

    def change(name, value):
        with h5py.File(landmark_file, "a") as file:
            file.attrs.pop(name, None)
            if value is not None:
                file.attrs[name] = value

    return change


@pytest.mark.parametrize(("value", "shown"), VERSIONS)
def test_another_version(landmark_file, set_root_attribute, problems, value, shown):
    set_root_attribute("version", value)
    (line,) = problems(load, landmark_file)
    fault = f"has the root attribute version {shown}"
    fix = "this program reads version 2, a number"
    assert line.startswith(f"{landmark_file}: {fault}; {fix}")


ROOT_ATTRIBUTES = [
    ("format", None, "has no root attribute format; give a shapefit-landmarks file"),
    ("format", "shapefit-shapes", OTHER_FORMAT),
    ("format", [1, 2], "is a [1, 2] file; give a shapefit-landmarks file"),
    ("format", b"\xff", "cannot be read ("),
    (
        "y_axis",
        "left",
        "has the root attributes y_axis 'left' and frame_rate None; set y_axis",
    ),
    (
        "y_axis",
        ["up", "down"],
        "has the root attributes y_axis ['up', 'down'] and frame_rate",
    ),
    (
        "frame_rate",
        -1.0,
        "has the root attributes y_axis 'down' and frame_rate -1.0; set y_",
    ),
]
"""A root attribute, a wrong value, and what the error says of it."""


@pytest.mark.parametrize(("name", "value", "fault"), ROOT_ATTRIBUTES)
def test_root_attributes_that_are_wrong(
    landmark_file, set_root_attribute, problems, name, value, fault
):
    set_root_attribute(name, value)
    (line,) = problems(load, landmark_file)
    assert line.startswith(f"{landmark_file}: {fault}")


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
    (
        "landmarks",
        {
            "item": None,
            "landmarks": np.zeros((5, 2, 4)),
            "confidence": np.zeros((4, 4)),
        },
        [
            "item: there is no such dataset; store UTF-8 text (n,)",
            "landmarks: holds float64 (5, 2, 4); store numbers (5, 4, 2)",
            "confidence: holds float64 (4, 4); store numbers (5, 4)",
        ],
    ),
    (
        "shapes",
        {"shapes": "text", "item": np.arange(5), "edges": np.zeros((1, 2))},
        [
            "item: holds int64 (5,); store UTF-8 text (5,)",
            "edges: holds float64 (1, 2); store integers (1, 2)",
            "shapes: holds text (); store numbers (5, 4, 3)",
        ],
    ),
    *(
        (
            "shapes",
            {"landmark_names": ["a", name, "b", "c"]},
            [
                "landmark_names: holds an empty name, or one twice; give every landmark"
                " a unique name"
            ],
        )
        for name in ("a", "")
    ),
    *(
        (
            "shapes",
            {"shapes": point([1.0, 2.0, value], 3, 1)},
            [f"shapes[3]: landmark 'left hand' is (1.0, 2.0, {value}); {FINITE}"],
        )
        for value in (np.inf, -np.inf)
    ),
    (
        "shapes",
        {"mesh_vertices": point([np.nan, 1.0, 2.0], 0, 5)},
        [f"mesh_vertices[0]: vertex 5 is (nan, 1.0, 2.0); {FINITE}"],
    ),
    (
        "landmarks",
        {"landmarks": point([1.0, np.inf], 4, 0)},
        [
            "landmarks[4]: landmark 'head' is (1.0, inf); write NaN where the landmark"
            " is unseen"
        ],
    ),
    *(
        (
            "landmarks",
            {"confidence": point(value, 2, 3)},
            [f"confidence[2]: landmark 'foot' is ({value}); {WEIGHT}"],
        )
        for value in (-0.1, np.nan, np.inf)
    ),
    (
        "shapes",
        {"edges": [[0, 1], [2, 4]]},
        ["edges[1]: holds the indices (2, 4); indices run from 0 to 3"],
    ),
    (
        "dictionary",
        {"mesh_faces": [[0, -1, 2]]},
        ["mesh_faces[0]: holds the indices (0, -1, 2); indices run from 0 to 5"],
    ),
    (
        "dictionary",
        {"atoms": np.full((7, 4, 3), np.inf)},
        [
            f"atoms[0]: landmark 'head' is (inf, inf, inf); {FINITE}",
            *["*"] * 9,
            "... and 18 more",
        ],
    ),
    (
        "dictionary",
        {"atoms": np.zeros((0, 4, 3)), **dict.fromkeys(PER_ATOM)},
        ["atoms: has the shape (0, 4, 3); a dictionary needs atoms and landmarks"],
    ),
    *(
        (
            "dictionary",
            {"atom_scale": point(value, 2)},
            ["atom_scale: holds numbers that cannot be; make the dictionary again"],
        )
        for value in (0.0, -1.0, np.nan, np.inf)
    ),
    (
        "dictionary",
        {"atom_scale": np.ones(6), "atom_item": ["x"] * 8},
        [
            "atom_scale: holds float64 (6,); store numbers (7,)",
            "atom_item: holds text (8,); store UTF-8 text (7,)",
        ],
    ),
    *(
        (
            kind,
            {"item": ["a", "b", "c", "b", "b"]},
            [
                f"item[{row}]: item 'b' is also at {{path}}:/item[{other}]; give every"
                " item a unique name"
                for row, other in ((3, 1), (4, 3))
            ],
        )
        for kind in ("shapes", "results")
    ),
]
"""A reader, datasets of its file changed, and the lines of the error, of which * is
any.
"""


def test_a_name_that_is_not_utf8_is_refused(landmark_file, problems):
    with h5py.File(landmark_file, "a") as file:
        file[b"\xff\xfe"] = np.zeros(8)
    (line,) = problems(load, landmark_file)
    assert line.startswith(f"{landmark_file}: cannot be read (")


def test_an_attribute_that_is_not_utf8_is_refused(shape_file, problems):
    with h5py.File(shape_file, "a") as file:
        file.attrs.create("unit", b"m\xff", dtype=h5py.string_dtype())
    (line,) = problems(READERS["shapes"], shape_file)
    assert line.startswith(f"{shape_file}: cannot be read (")


@pytest.mark.parametrize(("kind", "datasets", "lines"), FAULTS)
def test_datasets_that_are_wrong(request, problems, edit, kind, datasets, lines):
    path = request.getfixturevalue(f"{kind.removesuffix('s')}_file")
    changed = change_datasets(path, datasets)
    edit(path, **changed)
    told = problems(READERS[kind], path)
    for line, expected in zip(told, lines, strict=True):
        if expected == "*":
            continue
        place_and_fault = line.removeprefix(f"{path}:/")
        assert place_and_fault.replace(str(path), "{path}") == expected


def change_datasets(path, datasets):
    """Return datasets to write, where a function is given the values of the file."""
    changed = {}
    with h5py.File(path) as file:
        for name, value in datasets.items():
            changed[name] = value(file[name][()]) if callable(value) else value
    return changed
