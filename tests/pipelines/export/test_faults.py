"""What `fit` refuses to export, before any image is fitted, and what a failing run leaves."""

import errno
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import LandmarkSet, write_dictionary

NO_MESH = {"mesh_vertices": None, "mesh_faces": None}


@pytest.fixture
def no_fitting(monkeypatch):
    """Fail the test where an image is fitted."""
    monkeypatch.setattr(
        "shapefit.pipelines.fit.run.lift_batch", lambda *_: pytest.fail("an image was fitted")
    )


@pytest.mark.usefixtures("no_fitting")
@pytest.mark.parametrize(
    ("fields", "method", "unit", "message"),
    [
        ({"edges": None, **NO_MESH}, "convex", "landmarks", "neither a mesh nor edges .*learn"),
        ({"atom_scale": None}, "convex", "dictionary", "no `atom_scale`.*unit: landmarks"),
        ({}, "pmp", "landmarks", "export: `method: pmp` gives no coefficients"),
        (NO_MESH, "mean-shape", "dictionary", r"export\.unit: .*no coefficients.*unit: landmarks"),
    ],
)
def test_a_mesh_or_size_that_cannot_be(tmp_path, export, car_atoms, fields, method, unit, message):
    write_dictionary(tmp_path / "changed.h5", replace(car_atoms, **fields))
    with pytest.raises(InputError, match=message):
        export(dictionary=tmp_path / "changed.h5", fit_keys={"method": method}, unit=unit)
    assert sorted(os.listdir(tmp_path)) == ["changed.h5", "views.h5"]


@pytest.mark.usefixtures("no_fitting")
@pytest.mark.parametrize("section", ["export", "pictures"])
def test_a_folder_that_cannot_be(tmp_path, run, section, monkeypatch):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    (tmp_path / "locked").mkdir()
    access = os.access

    def locked(path, mode, **options):  # permissions do not stop a superuser, who may run this
        return not str(path).endswith("locked") and access(path, mode, **options)

    monkeypatch.setattr("os.access", locked)
    monkeypatch.setattr("os.supports_effective_ids", {locked})
    for folder, message in (
        ("-", "standard output; give the name of a folder"),
        ("views.h5", "it is not a folder"),
        ("views.h5/meshes", "views.h5 is not a folder; choose another folder"),
        (f"../{tmp_path.name}/result.h5", "is also the output; give the folder a different name"),
        ("n" * 256, "its name is too long; give a shorter one"),
        ("link", "link: it is a link to .*nowhere, which does not exist; create that folder"),
        ("locked", "locked is not writable"),
    ):
        name = folder if folder == "-" else str(tmp_path / folder)
        with pytest.raises(InputError, match=message):
            run(**{section: {"folder": name}})
    suffix = {"export": "ply", "pictures": "png"}[section]
    (tmp_path / "both").mkdir()
    with pytest.raises(InputError, match=rf"has the same name as the \.{suffix} files that go"):
        run(output=tmp_path / f"both/r.{suffix}", **{section: {"folder": str(tmp_path / "both")}})


@pytest.mark.usefixtures("no_fitting")
def test_pictures_without_matplotlib(tmp_path, run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"pictures: matplotlib is not.*pip install matplotlib"):
        run(pictures={"folder": str(tmp_path / "pictures")})


def everything(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "views.h5"
    }


@pytest.fixture
def earlier(tmp_path, export, views):
    """Export to meshes and pictures; return what all files hold, and the same images moved."""
    export(fit_keys={"pictures": {"folder": str(tmp_path / "pictures"), "most": 1}})
    (tmp_path / "meshes/notes.txt").write_text("mine")
    return everything(tmp_path), views.replaced(landmarks=2 * views.landmarks)


@pytest.mark.parametrize(
    ("error", "raised"),
    [(OSError(errno.EIO, "Input/output error"), InputError), (KeyboardInterrupt(),) * 2],
)
def test_folders_stay_as_they_were_where_the_result_cannot_be_completed(
    tmp_path, export, earlier, monkeypatch, error, raised
):
    before, images = earlier
    replace_file, move = Path.replace, os.replace

    def fail(temporary, target):
        if Path(target).name == "result.h5":
            raise error
        return replace_file(temporary, target)

    def fail_too(temporary, target, **options):
        if Path(target).name == "result.h5":
            raise error
        return move(temporary, target, **options)

    monkeypatch.setattr(Path, "replace", fail)
    monkeypatch.setattr(os, "replace", fail_too)
    pictures = {"folder": str(tmp_path / "pictures"), "sheet": 2}
    with pytest.raises(raised if isinstance(raised, type) else KeyboardInterrupt):
        export(images, fit_keys={"pictures": pictures})
    assert everything(tmp_path) == before


def test_two_files_that_clash_are_named(tmp_path, run, views):
    both = {"folder": str(tmp_path / "both")}
    for item, form in (("car.ply/1", "ply"), ("car.png/1", "ply")):
        clashing = views.replaced(items=("car", item, "c", "d", "e", "f"))
        with pytest.raises(InputError, match=r"both/car\.p..: is a file of another item"):
            run(clashing, export=both | {"format": form}, pictures=both)
        assert sorted(os.listdir(tmp_path)) == ["views.h5"]
    (tmp_path / "both").mkdir()  # the result may lie among the meshes
    _, outcomes = run(clashing, output=tmp_path / "both/r.h5", export=both | {"format": "obj"})
    assert len(list((tmp_path / "both").rglob("*.obj"))) == 6
    assert outcomes[-1].written == (tmp_path / "both/r.h5", tmp_path / "both")


def test_zero_images_give_no_files(tmp_path, export, views):
    nothing = LandmarkSet(
        landmarks=np.empty((0, 2, 72)), landmark_names=views.landmark_names, items=()
    )
    pictures = {"folder": str(tmp_path / "pictures"), "sheet": 4}
    found, outcomes = export(nothing, fit_keys={"method": "convex", "pictures": pictures})
    assert len(found) == 0
    assert outcomes[-1].note == "y down in the images; 0 meshes, 0 pictures"
    assert outcomes[-1].written == (tmp_path / "result.h5",)
    assert sorted(os.listdir(tmp_path)) == ["result.h5", "views.h5"]
