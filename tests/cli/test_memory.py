"""Files of some kB that would take terabytes: each command refuses them by name, size and limit."""

import re
import shutil

import h5py
import pytest

FILES = {
    "shapes": "shapes.h5",
    "views": "views.h5",
    "dictionary": "d.h5",
    "result": "r.h5",
}
FIT = ("fit", "{views}", "-d", "{dictionary}", "-o", "{out}/o.h5")
EVAL = ("eval", "{result}", "--truth", "{shapes}", "-o", "{out}/report", "--set=plots=false")
VERIFY = ("verify", "{result}", "-d", "{dictionary}", "--landmarks", "{views}")
VIEW = ("view", "{result}", "--truth", "{shapes}", "-d", "{dictionary}", "-o", "{out}/page.html")
LEARN = ("learn-dict", "{shapes}", "-o", "{out}/o.h5", "--set=iterations=1", "--set=k=3")
PROJECT = ("project", "{shapes}", "-o", "{out}/o.h5")

LARGE = [
    (LEARN, "shapes", "mesh_vertices"),
    (LEARN, "shapes", "further"),
    (PROJECT, "shapes", "further"),
    (FIT, "views", "further"),
    (FIT, "dictionary", "mesh_vertices"),
    (EVAL, "shapes", "mesh_vertices"),
    (EVAL, "result", "further"),
    (VERIFY, "dictionary", "mesh_vertices"),
    (VERIFY, "result", "further"),
    (VIEW, "result", "further"),
    (VIEW, "shapes", "mesh_vertices"),
]


@pytest.fixture(scope="module")
def good(project, tmp_path_factory):
    """A folder of small files, one of each kind."""
    from shapefit.cli.main import run

    folder = tmp_path_factory.mktemp("good")
    paths = {kind: str(folder / name) for kind, name in FILES.items()}
    shutil.copy(project / "sample_data/people_test.h5", paths["shapes"])
    learn = ("--set=method=exemplars", "--set=every=80", "-o", paths["dictionary"])
    assert run(("learn-dict", paths["shapes"], *learn)) == 0
    assert run(("project", paths["shapes"], "-o", paths["views"])) == 0
    assert run(("fit", paths["views"], "-d", paths["dictionary"], "-o", paths["result"])) == 0
    return folder


@pytest.mark.parametrize(("command", "kind", "dataset"), LARGE)
def test_what_does_not_fit_is_refused(good, shapefit, tmp_path, command, kind, dataset):
    folder = tmp_path / "files"
    shutil.copytree(good, folder)
    (tmp_path / "out").mkdir()
    large = folder / FILES[kind]
    with h5py.File(large, "r+") as file:
        first = len(file["atoms"] if kind == "dictionary" else file["item"])
        shape = (first, 10**12, 3) if dataset == "mesh_vertices" else (first, 10**11)
        file.create_dataset(dataset, shape, "f8", chunks=(1, 10**4, *shape[2:]))
    assert large.stat().st_size < 3e6
    paths = {name: folder / path for name, path in FILES.items()} | {"out": tmp_path / "out"}
    result = shapefit(*(word.format(**paths) for word in command))
    assert result.code == 2
    assert re.search(
        rf"Error: {re.escape(str(large))}:/{dataset}: (.*takes [0-9.]+ [TP]B of memory, and "
        r"[0-9.e+]+ [kMGT]B are free; divide the file, or use a machine with more memory|"
        r"of its [0-9.]+ [TP]B the file holds 0 bytes; write its values, or make it smaller)",
        result.err,
    ), result.err
    assert not list((tmp_path / "out").iterdir())
