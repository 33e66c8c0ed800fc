"""HDF5: values in other files are refused, links inside a file are read."""

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.dictionary.model import Dictionary
from shapefit.io import (
    write_dictionary,
    write_shapes,
)
from shapefit.records import Fit, Landmarks, Shapes
from shapefit.records.columns import in_columns
from tests.io.files import save

SECRET = "what stands in a file of somebody else"


ITEM_COUNT = 6


NAMES = ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with one sound file of each kind, and two that a link can point at."""
    folder = tmp_path_factory.mktemp("sound")
    rng = np.random.default_rng(0)
    items = tuple(f"image {i}" for i in range(ITEM_COUNT))
    names = {"landmark_names": NAMES, "items": items}
    points = rng.normal(size=(ITEM_COUNT, 4, 3))
    images = rng.normal(size=(ITEM_COUNT, 4, 2))
    atoms = in_columns(points)
    dictionary = Dictionary(
        atoms=atoms, landmark_names=NAMES, mean_shape=atoms[0], unit="m"
    )
    save(folder / "landmarks.h5", Landmarks(images, unit="px", **names))
    write_shapes(folder / "shapes.h5", Shapes(points, unit="m", **names))
    save(folder / "result.h5", Fit(points, **names))
    write_dictionary(folder / "dictionary.h5", dictionary)
    write_sleap_analysis(folder / "sleap.h5", rng)
    write_targets(folder)
    return folder


def write_sleap_analysis(path: Path, rng: np.random.Generator) -> None:
    with h5py.File(path, "w") as file:
        file["tracks"] = rng.uniform(10, 90, (1, 2, 4, ITEM_COUNT))
        file["node_names"] = np.array(NAMES, dtype="S")
        file["track_names"] = np.array(["one"], dtype="S")
        file["track_occupancy"] = np.ones((ITEM_COUNT, 1), np.uint8)


def write_targets(folder: Path) -> None:
    """Write what links point at: a text that nobody must see, and numbers."""
    (folder / "secret").write_text(SECRET * 40)
    with h5py.File(folder / "other.h5", "w") as file:
        file["values"] = np.ones((ITEM_COUNT, 4, 3))


def _external_storage(file: h5py.File, name: str, folder: Path) -> None:
    secret = str(folder / "secret")
    whole = [(secret, 0, 8 * ITEM_COUNT)]
    file.create_dataset(name, (ITEM_COUNT, 8), "u1", external=whole)


def _external_link(file: h5py.File, name: str, folder: Path) -> None:
    file[name] = h5py.ExternalLink(str(folder / "other.h5"), "/values")


def _virtual(source: str, dataset: str) -> Callable[[h5py.File, str, Path], None]:
    shape = (ITEM_COUNT, 4, 2)

    def make(file: h5py.File, name: str, folder: Path) -> None:
        layout = h5py.VirtualLayout(shape, "f8")
        path = source if source == "." else str(folder / source)
        layout[:] = h5py.VirtualSource(path, dataset.format(name), shape)
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
"""Kind of file -> its dataset of points."""


@pytest.fixture
def copied(folder, tmp_path):
    """Copy the sound file of a kind, to be changed."""

    def copy(kind: str) -> Path:
        return shutil.copy(folder / f"{kind}.h5", tmp_path / "linked.h5")

    return copy


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("kind", POINTS)
def test_values_that_lie_elsewhere_are_refused(folder, copied, capsys, kind, link):
    for dataset in ("note", POINTS[kind], "group/inner"):
        path = copied(kind)
        with h5py.File(path, "a") as file:
            if dataset in file:
                del file[dataset]
            LINKS[link](file, dataset, folder)
        code = run(["info", str(path)])
        told = capsys.readouterr()
        assert code == 2, (dataset, told.err)
        assert f"{path.name}:/{dataset}: has its values in another file" in told.err
        assert SECRET not in told.err + told.out


@pytest.mark.parametrize("kind", POINTS)
def test_links_inside_a_file_are_read(copied, capsys, kind):
    path = copied(kind)
    points = POINTS[kind]
    with h5py.File(path, "a") as file:
        file.move(points, "kept")
        file[points] = h5py.SoftLink("/kept")
        file["group/again"] = file["kept"]
    code = run(["info", str(path)])
    assert code == 0, capsys.readouterr().err
