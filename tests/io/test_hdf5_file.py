"""Open HDF5 files: values that lie elsewhere, or do not fit in memory, are refused by name."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.dictionary.model import Dictionary
from shapefit.io import (
    LandmarkSet,
    ShapeSet,
    inputs,
    read_dictionary,
    read_results,
    read_shapes,
    write_dictionary,
    write_shapes,
)
from shapefit.io.hdf5_file import Hdf5File
from tests.io.files import save

SECRET = "what stands in a file of somebody else"
N, NAMES = 6, ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with one sound file of each kind, and one outside that a link can point at."""
    folder = tmp_path_factory.mktemp("sound")
    rng = np.random.default_rng(0)
    items = tuple(f"image {i}" for i in range(N))
    shapes, views = rng.normal(size=(N, 3, 4)), rng.normal(size=(N, 2, 4))
    save(
        folder / "landmarks.h5",
        LandmarkSet(landmarks=views, landmark_names=NAMES, items=items, unit="px"),
    )
    write_shapes(folder / "shapes.h5", ShapeSet(shapes, NAMES, items, unit="m"))
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
    for name in ("fit", "learn-dict", "eval", "project"):
        (folder / f"{name}.yaml").write_text("seed: 0\n" if name == "project" else "{}\n")
    inputs = [folder / "landmarks.h5", "-d", folder / "dictionary.h5", "-o", folder / "result.h5"]
    assert run(["fit", "-c", str(folder / "fit.yaml"), *map(str, inputs)]) == 0
    return folder


def _external_storage(file: h5py.File, name: str, folder: Path) -> None:
    file.create_dataset(name, (N, 8), "u1", external=[(str(folder / "secret"), 0, 8 * N)])


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

COMMANDS = {
    "landmarks": ("fit -c fit.yaml {} -d dictionary.h5 -o out.h5", "convert {} -o out.csv"),
    "shapes": (
        "learn-dict -c learn-dict.yaml {} -o out.h5",
        "view result.h5 --truth {} -o out.html",
    ),
    "result": ("eval -c eval.yaml {} --truth shapes.h5 -o out", "verify {} -d dictionary.h5"),
    "dictionary": ("fit -c fit.yaml landmarks.h5 -d {} -o out.h5", "info {}"),
    "sleap": ("fit -c fit.yaml {} -d dictionary.h5 -o out.h5", "info {}"),
}
POINTS = {
    "landmarks": "landmarks",
    "shapes": "shapes",
    "result": "shapes",
    "dictionary": "atoms",
    "sleap": "tracks",
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("kind", COMMANDS)
def test_values_that_lie_elsewhere_are_refused_by_every_command(
    files, tmp_path, monkeypatch, capsys, kind, link
):
    for sound in files.iterdir():
        (tmp_path / sound.name).write_bytes(sound.read_bytes())
    monkeypatch.chdir(tmp_path)
    for dataset in ("note", POINTS[kind], "group/inner"):
        path = tmp_path / f"linked-{dataset.replace('/', '-')}.h5"
        path.write_bytes((files / f"{kind}.h5").read_bytes())
        with h5py.File(path, "a") as file:
            if dataset in file:
                del file[dataset]
            LINKS[link](file, dataset, tmp_path)
        before = sorted(tmp_path.rglob("*"))
        for command in COMMANDS[kind]:
            code = run(command.format(path.name).split())
            told = capsys.readouterr()
            assert code == 2, (command, dataset, told.err)
            assert f"{path.name}:/{dataset}: " in told.err, (command, dataset, told.err)
            assert SECRET not in told.err + told.out
            assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("kind", COMMANDS)
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
    """Make a file of shapes of some kB whose datasets, all fill values, are of these sizes."""

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
        ({"p": MANY}, "landmark_names", "B of memory, and this machine has "),
        ({"further": (MANY, 100)}, "further", "B of memory, and this machine has "),
        ({"further": (10**5, 100)}, "further", ": of its 80 MB the file holds 0 bytes; "),
        ({"n": MANY}, "item", " the file holds 0 bytes; "),
    ],
)
def test_a_file_of_some_kilobytes_that_would_take_more(sparse, problems, sizes, place, found):
    path = sparse(**sizes)
    (line,) = problems(read_shapes, [path])
    assert line.startswith(f"{path}:/{place}: ")
    assert found in line


def test_the_limit_is_what_is_free(shape_file, dictionary_file, result_file, problems, monkeypatch):
    monkeypatch.setattr(inputs, "ALWAYS_FITS", 0)
    readers = (lambda path: read_shapes([path]), read_dictionary, read_results)
    for read, path in zip(readers, (shape_file, dictionary_file, result_file), strict=True):
        monkeypatch.setattr(inputs, "machine_memory", lambda: 10**5)
        read(path)
        monkeypatch.setattr(inputs, "machine_memory", lambda: 10)
        (line,) = problems(read, path)
        assert line.startswith(f"{path}:/")
        assert "and this machine has 10 bytes; " in line
