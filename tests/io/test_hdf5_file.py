"""HDF5: what is stored and read, what each fault says, what damage, links and full
disks do.
"""

import dataclasses
import errno
import multiprocessing
import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import (
    inputs,
    open_landmarks,
    read_dictionary,
    read_results,
    read_shapes,
    write_dictionary,
    write_shapes,
)
from shapefit.io.hdf5_file import Hdf5File
from shapefit.io.layout import PER_ITEM, RENAMED
from shapefit.records import Fit, Landmarks, Shapes
from tests.columns import put
from tests.io.files import load, save

READERS = {
    "landmarks": load,
    "shapes": lambda path: read_shapes([path]),
    "results": lambda path: read_results(path, proofs=True),
    "dictionary": read_dictionary,
}


@pytest.fixture(params=READERS)
def reader(request):
    return READERS[request.param]


# What is stored


def test_files_are_laid_out_as_promised(
    shape_file, landmark_file, result_file, dictionary_file
):
    expected = {
        shape_file: ("shapes", {"shapes": (5, 4, 3), "mesh_vertices": (5, 6, 3)}),
        landmark_file: ("landmarks", {"landmarks": (5, 4, 2), "confidence": (5, 4)}),
        result_file: ("result", {"shapes": (5, 4, 3), "transforms": (5, 7, 2, 3)}),
        dictionary_file: ("dictionary", {"atoms": (7, 4, 3), "mean_shape": (4, 3)}),
    }

    def check(_name: str, node: object) -> None:
        if isinstance(node, h5py.Dataset):
            assert node.fletcher32 == (node.size > 0 and node.ndim > 0)
            kind = h5py.check_string_dtype(node.dtype)
            assert kind is None or (kind.encoding == "utf-8" and kind.length)

    for path, (kind, shapes_of) in expected.items():
        assert path.read_bytes()[8] == 3  # version of the superblock, with a checksum
        with h5py.File(path) as file:
            assert path.stat().st_size == file.id.get_filesize() < 1 << 20
            assert file.attrs["format"] == f"shapefit-{kind}"
            assert file.attrs["version"] == 2
            assert file.attrs["unit"] in {"m", "px", "normalised"}
            assert kind != "landmarks" or file.attrs["y_axis"] == "down"
            for name, shape in shapes_of.items():
                assert (file[name].shape, file[name].dtype) == (shape, np.float64)
            file.visititems(check)


def test_one_point_a_row_in_the_file_one_a_column_in_memory(shape_file, shapes):
    with h5py.File(shape_file) as file:
        np.testing.assert_array_equal(
            file["shapes"][2, 1], shapes.as_columns()[2, :, 1]
        )
        np.testing.assert_array_equal(
            file["mesh_vertices"][4, 5], shapes.mesh_vertices[4, 5]
        )
    assert read_shapes([shape_file]).as_columns().flags.c_contiguous


@pytest.mark.parametrize("n", [2, 3, 4])
def test_a_matrix_of_the_file_is_not_cut_where_there_are_as_many_items(tmp_path, n):
    items = tuple(map(str, range(n)))
    points = np.full((n, 3, 2), 50.0)
    whole = {"K": np.eye(3), "camera_matrix": np.eye(3)}
    save(
        tmp_path / "views.h5",
        Landmarks(
            points,
            landmark_names=tuple("abc"),
            items=items,
            times=np.arange(n),
            file_extras=whole,
        ),
    )
    with h5py.File(tmp_path / "views.h5", "a") as file:
        file["L"], file["mass"] = np.eye(3), np.ones(n + 1)
        file["mass"].attrs[PER_ITEM] = True  # which cannot be
        assert file["time"].attrs[PER_ITEM]
    with open_landmarks([tmp_path / "views.h5"]) as source:
        first, *_ = source.batches(1)
    assert all(
        first.column(name).shape == (3, 3) for name in ("K", "L", "camera_matrix")
    )
    assert first.column("mass").shape == (n + 1,)
    assert first.column("time").tolist() == [0]


def test_nested_datasets_are_carried(landmark_file, tmp_path, edit):
    edit(landmark_file, **{"camera/focal": np.arange(5.0), "camera/model": "pinhole"})
    with h5py.File(landmark_file, "a") as file:
        file["camera/focal"].attrs[PER_ITEM] = True
    first = load(landmark_file).take([0, 1, 2])
    assert first.column("camera/focal").tolist() == [0, 1, 2]
    assert first.column("camera/model").item() == "pinhole"
    save(tmp_path / "again.h5", first)
    with h5py.File(tmp_path / "again.h5") as file:
        assert file["camera/model"].asstr()[()] == "pinhole"


def test_other_types_of_numbers_and_texts_are_read(landmark_file, landmarks, edit):
    points = landmarks.as_columns().swapaxes(1, 2).astype("f4")
    points[0, 0] = (1.0, np.nan)  # half a position is none
    items = np.array([b"a", b"b", b"c", b"d", b"e"])
    edit(landmark_file, landmarks=points, confidence=np.ones((5, 4), bool), item=items)
    images = load(landmark_file)
    assert images.items == tuple("abcde")
    assert images.as_columns().dtype == np.float64
    assert np.isnan(images.as_columns()[0, :, 0]).all()
    np.testing.assert_array_equal(images.as_columns()[1], points[1].T)
    assert (images.confidence == 1).all()


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


def test_results_and_dictionaries_of_version_1_are_converted(
    tmp_path, results, dictionary_file
):
    more = {
        "inlier_probability": np.ones((5, 4)),
        "reasons": np.array([""] * 5, dtype=object),
    }
    result_file, new = tmp_path / "old.h5", tmp_path / "new.h5"
    save(result_file, put(results, more))
    for path, read in ((dictionary_file, read_dictionary), (result_file, read_results)):
        to_version_1(path)
        with pytest.raises(
            InputError, match=rf"version 1.*shapefit convert {path.name} -o NEW.h5"
        ):
            read(path)
        assert run(["info", str(path)]) == 0
        assert run(["convert", str(path), "-o", str(new)]) == 0
        again = read(new)
    assert (
        again.column("inlier_probability").tolist()
        == more["inlier_probability"].tolist()
    )
    assert again.column("reasons").tolist() == [""] * 5
    old = read_dictionary(dictionary_file, old=True)
    assert len(old.atom_items) == 7


# What is wrong


def test_a_missing_file_or_a_folder(reader, tmp_path, problems):
    path = tmp_path / "none" / "x.h5"
    assert problems(reader, path) == (f"{path}: there is no such file; check the path",)
    (line,) = problems(reader, tmp_path)
    assert line.startswith(f"{tmp_path}: it is a folder")
    assert "; name the files in it" in line


OTHER_FORMAT = "is a shapefit-shapes file; give a shapefit-landmarks file"
VERSION = "this program reads version 2, a number"


@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("version", 3, f"has the root attribute version 3; {VERSION}"),
        ("version", "1", f"has the root attribute version '1'; {VERSION}"),
        ("version", None, f"has the root attribute version None; {VERSION}"),
        ("version", [1, 2], f"has the root attribute version [1, 2]; {VERSION}"),
        ("version", h5py.Empty("f"), f"has the root attribute version None; {VERSION}"),
        (
            "format",
            None,
            "has no root attribute format; give a shapefit-landmarks file",
        ),
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
    ],
)
def test_root_attributes_that_are_wrong(landmark_file, problems, name, value, fault):
    with h5py.File(landmark_file, "a") as file:
        file.attrs.pop(name, None)
        if value is not None:
            file.attrs[name] = value
    (line,) = problems(load, landmark_file)
    assert line.startswith(f"{landmark_file}: {fault}")


def test_names_and_attributes_that_are_not_utf8_are_refused(
    landmark_file, shape_file, problems
):
    with h5py.File(landmark_file, "a") as file:
        file[b"\xff\xfe"] = np.zeros(8)
    with h5py.File(shape_file, "a") as file:
        file.attrs.create("unit", b"m\xff", dtype=h5py.string_dtype())
    for path, read in ((landmark_file, load), (shape_file, READERS["shapes"])):
        (line,) = problems(read, path)
        assert line.startswith(f"{path}: cannot be read (")


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


@pytest.mark.parametrize(("kind", "datasets", "lines"), FAULTS)
def test_datasets_that_are_wrong(request, problems, edit, kind, datasets, lines):
    path = request.getfixturevalue(f"{kind.removesuffix('s')}_file")
    with h5py.File(path) as file:
        made = {
            name: value(file[name][()]) if callable(value) else value
            for name, value in datasets.items()
        }
    told = problems(READERS[kind], edit(path, **made))
    for line, wanted in zip(told, lines, strict=True):
        assert wanted in (
            "*",
            line.removeprefix(f"{path}:/").replace(str(path), "{path}"),
        )


# What damage does


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 0.999])
def test_a_truncated_file(landmark_file, problems, share):
    data = landmark_file.read_bytes()
    landmark_file.write_bytes(data[: int(share * len(data))])
    (line,) = problems(load, landmark_file)
    assert line.startswith(f"{landmark_file}: cannot be read (")
    assert line.endswith("; the file may be cut off or damaged: copy or make it again")


def spoil(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Flip a bit, zero a stretch, or put noise there: in the header, or anywhere."""
    spoilt = bytearray(data)
    end = len(data) if rng.random() < 0.7 else min(len(data), 2048)
    at = int(rng.integers(0, end))
    if kind == "flip":
        spoilt[at] ^= 1 << int(rng.integers(8))
        return bytes(spoilt)
    size = min(int(rng.integers(1, 64)), len(data) - at)
    spoilt[at : at + size] = bytes(size) if kind == "zeros" else rng.bytes(size)
    return bytes(spoilt) if spoilt != data else spoil(data, kind, rng)


def values_of(record) -> str:
    """Return what a record or a dictionary holds in datasets with checksums."""
    named = {
        field.name: getattr(record, field.name) for field in dataclasses.fields(record)
    }
    for name in ("extras", "file_extras"):
        named |= named.pop(name, {})
    unchecked = ("prior", "maker", "attributes", "provenance", "unit")
    named = {name: value for name, value in named.items() if name not in unchecked}
    return repr(
        {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in named.items()}
    )


@pytest.mark.parametrize("kind", ["flip", "zeros", "noise"])
@pytest.mark.parametrize("name", READERS)
def test_no_damage_to_datasets_is_read_in_silence(request, tmp_path, name, kind):
    path = request.getfixturevalue(f"{name.removesuffix('s')}_file")
    data, sound = path.read_bytes(), values_of(READERS[name](path))
    rng = np.random.default_rng(len(path.stem) + len(kind))
    spoilt = [tmp_path / f"{number}.h5" for number in range(25)]
    for one in spoilt:
        one.write_bytes(spoil(data, kind, rng))
    found = read_in_a_process(READERS[name], spoilt)
    assert set(found) <= {sound, "refused"}
    assert found.count("refused") >= 12


def send_values(read, paths, sender) -> None:
    for path in paths:
        try:
            sender.send(values_of(read(path)))
        except InputError:
            sender.send("refused")


def read_in_a_process(read, paths) -> list[str]:
    """Return the values, or "refused", also where damage lets libhdf5 loop for ever."""
    fork = multiprocessing.get_context("fork")
    found: list[str] = []
    while len(found) < len(paths):
        receiver, sender = fork.Pipe(duplex=False)
        process = fork.Process(
            target=send_values, args=(read, paths[len(found) :], sender)
        )
        process.start()
        sender.close()
        while len(found) < len(paths) and receiver.poll(1):
            found.append(receiver.recv())
        if len(found) < len(paths):
            found.append("refused")  # it loops; the next process goes on behind it
        process.kill()
        process.join()
    return found


# Values that lie elsewhere

SECRET = "what stands in a file of somebody else"
N, NAMES = 6, ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with one sound file of each kind, and one outside that a link can point
    at.
    """
    folder = tmp_path_factory.mktemp("sound")
    rng = np.random.default_rng(0)
    items = tuple(f"image {i}" for i in range(N))
    shapes, views = rng.normal(size=(N, 3, 4)), rng.normal(size=(N, 2, 4))
    save(
        folder / "landmarks.h5",
        Landmarks(views.swapaxes(1, 2), landmark_names=NAMES, items=items, unit="px"),
    )
    write_shapes(
        folder / "shapes.h5",
        Shapes(shapes.swapaxes(1, 2), landmark_names=NAMES, items=items, unit="m"),
    )
    write_dictionary(
        folder / "dictionary.h5",
        Dictionary(atoms=shapes, landmark_names=NAMES, mean_shape=shapes[0], unit="m"),
    )
    with h5py.File(folder / "sleap.h5", "w") as file:
        file["tracks"] = rng.uniform(10, 90, (1, 2, 4, N))
        file["node_names"] = np.array(NAMES, dtype="S")
        file["track_names"] = np.array(["one"], dtype="S")
        file["track_occupancy"] = np.ones((N, 1), np.uint8)
    (folder / "secret").write_text(SECRET * 40)
    with h5py.File(folder / "other.h5", "w") as file:
        file["values"] = np.ones((N, 4, 3))
    names = {"landmark_names": NAMES, "items": items}
    save(folder / "result.h5", Fit(shapes.swapaxes(1, 2), **names))
    return folder


def _external_storage(file: h5py.File, name: str, folder: Path) -> None:
    file.create_dataset(
        name, (N, 8), "u1", external=[(str(folder / "secret"), 0, 8 * N)]
    )


def _external_link(file: h5py.File, name: str, folder: Path) -> None:
    file[name] = h5py.ExternalLink(str(folder / "other.h5"), "/values")


def _virtual(source: str, dataset: str) -> Callable[[h5py.File, str, Path], None]:
    def make(file: h5py.File, name: str, folder: Path) -> None:
        layout = h5py.VirtualLayout((N, 4, 2), "f8")
        where = source if source == "." else str(folder / source)
        layout[:] = h5py.VirtualSource(where, dataset.format(name), (N, 4, 2))
        file.create_virtual_dataset(name, layout)

    return make


LINKS = {
    "external storage": _external_storage,
    "external link": _external_link,
    "virtual of another file": _virtual("other.h5", "values"),
    "virtual of itself": _virtual(".", "{}"),
}

POINTS = {
    "landmarks": "landmarks",
    "shapes": "shapes",
    "result": "shapes",
    "dictionary": "atoms",
    "sleap": "tracks",
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("kind", POINTS)
def test_values_that_lie_elsewhere_are_refused(files, tmp_path, capsys, kind, link):
    for dataset in ("note", POINTS[kind], "group/inner"):
        path = tmp_path / "linked.h5"
        path.write_bytes((files / f"{kind}.h5").read_bytes())
        with h5py.File(path, "a") as file:
            if dataset in file:
                del file[dataset]
            LINKS[link](file, dataset, files)
        code = run(["info", str(path)])
        told = capsys.readouterr()
        assert code == 2, (dataset, told.err)
        assert f"{path.name}:/{dataset}: has its values in another file" in told.err
        assert SECRET not in told.err + told.out


@pytest.mark.parametrize("kind", POINTS)
def test_links_inside_a_file_are_read(files, tmp_path, capsys, kind):
    path = tmp_path / "inner.h5"
    path.write_bytes((files / f"{kind}.h5").read_bytes())
    with h5py.File(path, "a") as file:
        name = POINTS[kind]
        file.move(name, "kept")
        file[name] = h5py.SoftLink("/kept")
        file["group/again"] = file["kept"]
    code = run(["info", str(path)])
    assert code == 0, capsys.readouterr().err


# What does not fit in memory, or in its file

MANY = 10**11


@pytest.fixture
def sparse(tmp_path):
    """Make a file of shapes of some kB whose datasets, all fill values, are of these
    sizes.
    """

    def make(n=1, p=1, **further):
        path = tmp_path / "sparse.h5"
        with h5py.File(path, "w") as file:
            file.attrs.update({"format": "shapefit-shapes", "version": 1})
            for name, size in (("landmark_names", p), ("item", n)):
                chunks = (10_000,) if size > 1 else None
                file.create_dataset(name, (size,), "S1", chunks=chunks, fillvalue=b"a")
            file.create_dataset("shapes", (n, p, 3), "f8", chunks=(1, 1, 3))
            for name, shape in further.items():
                file.create_dataset(name, shape, "f8", chunks=(100,) * len(shape))
            if n == 1:
                file["item"][0] = b"a"
        assert path.stat().st_size < 50_000
        return path

    return make


def test_values_that_were_never_written_are_the_fill_value(tmp_path, monkeypatch):
    """HDF5 itself would go through the eight million chunks, by 14 GB of memory."""
    path = tmp_path / "unwritten.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (10**6, 4, 2), "f8", chunks=(1, 1, 1), fillvalue=3.0)
    with Hdf5File(path) as file:
        monkeypatch.setattr(h5py.Dataset, "__getitem__", None)
        rows = file.rows("x", slice(2, 5))
    assert rows.shape == (3, 4, 2)
    assert (rows == 3).all()


@pytest.mark.parametrize(
    ("sizes", "place", "found"),
    [
        ({"p": MANY}, "landmark_names", "B of memory, and "),
        ({"further": (MANY, 100)}, "further", "B of memory, and "),
        (
            {"further": (10**5, 100)},
            "further",
            ": of its 80 MB the file holds 0 bytes; ",
        ),
        ({"n": MANY}, "item", " the file holds 0 bytes; "),
    ],
)
def test_a_file_of_some_kilobytes_that_would_take_more(
    sparse, problems, sizes, place, found
):
    path = sparse(**sizes)
    (line,) = problems(read_shapes, [path])
    assert line.startswith(f"{path}:/{place}: ")
    assert found in line


def test_the_limit_is_what_is_free(
    shape_file, dictionary_file, result_file, problems, monkeypatch
):
    monkeypatch.setattr(inputs, "ALWAYS_FITS", 0)
    readers = (lambda path: read_shapes([path]), read_dictionary, read_results)
    for read, path in zip(
        readers, (shape_file, dictionary_file, result_file), strict=True
    ):
        monkeypatch.setattr(inputs, "free_memory", lambda: 10**5)
        read(path)
        monkeypatch.setattr(inputs, "free_memory", lambda: 10)
        (line,) = problems(read, path)
        assert line.startswith(f"{path}:/")
        assert "and 10 bytes are free; " in line


# Full disks, memory, and what is imported

MAKE = """
import os, resource, signal, sys
from pathlib import Path
import numpy as np
from shapefit.errors import InputError
from shapefit.io import *
from shapefit.records import Fit, Landmarks

def views(start, size):
    return Landmarks(
        landmarks=np.random.default_rng(start).normal(size=(size, 15, 2)),
        landmark_names=[f"landmark {i}" for i in range(15)],
        items=[f"sequence/{i:09}" for i in range(start, start + size)],
        extras={"true_rotation": np.zeros((size, 3, 3))},
    )

def results(chunk):
    n = len(chunk)
    return Fit(
        np.ones((n, 15, 3)),
        landmarks_fitted=chunk.landmarks,
        coefficients=np.ones((n, 64)),
        status=np.full(n, "solved"),
        landmark_names=chunk.landmark_names,
        items=chunk.items,
        extras=chunk.extras,
    )
"""

FULL = """
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    with result_writer(Path(sys.argv[1])) as writer:
        for start in range(0, 8000, 1000):
            writer.append(results(views(start, 1000)))
    print("written")
except InputError as error:
    print(error)
"""


def test_a_full_disk_is_told_and_one_that_cannot_reserve_is_not(
    shapes, tmp_path, monkeypatch
):
    reserve = Mock()
    monkeypatch.setattr(os, "posix_fallocate", reserve)
    for number in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSPC):
        reserve.side_effect = OSError(number, "refused")
        with (
            pytest.raises(InputError, match="No space")
            if number == errno.ENOSPC
            else nullcontext()
        ):
            write_shapes(tmp_path / f"{number}.h5", shapes)
        assert (tmp_path / f"{number}.h5").exists() == (number != errno.ENOSPC)


@pytest.mark.parametrize("limit", [0, 1_000, 300_000, 2_500_000])
@pytest.mark.parametrize("name", ["result.h5", "result.csv"])
def test_a_disk_that_fills_while_writing(tmp_path, run_python, name, limit):
    target = tmp_path / name
    target.write_text("old")
    done = run_python(MAKE + FULL, target, str(limit))
    assert done.stdout.startswith(
        f"{target}: cannot be written: File too large; free some space"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == [name]


MEMORY = """
def peak():
    # That of getrusage begins with the peak of the process that started this one.
    (line,) = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]
    return int(line.split()[1]) * 1024

def run(count):
    with landmark_writer(Path(sys.argv[1]) / "views.h5") as writer:
        for start in range(0, count, 2000):
            writer.append(views(start, 2000))
    with open_landmarks([Path(sys.argv[1]) / "views.h5"]) as source:
        with result_writer(Path(sys.argv[1]) / "result.h5") as writer:
            for chunk in source.batches(2000):
                writer.append(results(chunk))

run(20_000)
before = peak()
run(90_000)
print(peak() - before)
"""


def test_memory_is_flat_in_the_number_of_images(tmp_path, run_python):
    # 70,000 images more hold 22 MB of landmarks and rotations, and 91 MB of results.
    done = run_python(MAKE + MEMORY, tmp_path)
    assert done.stderr == ""
    assert int(done.stdout) < 12e6
