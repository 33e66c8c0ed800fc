"""What `fit` refuses to export, before any image is fitted, and what a failing run leaves."""

import errno
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from shapefit.errors import InputError
from shapefit.io import LandmarkSet, write_dictionary


@pytest.fixture
def no_fitting(monkeypatch):
    """Fail the test where an image is fitted."""

    def refuse(*_arguments):
        raise AssertionError("an image was fitted before the complaint")

    monkeypatch.setattr("shapefit.pipelines.fit.run.lift_batch", refuse)


@pytest.fixture
def changed(tmp_path, car_atoms):
    """Write the dictionary of cars with other fields."""

    def write(**fields):
        path = tmp_path / "changed.h5"
        write_dictionary(path, replace(car_atoms, **fields))
        return path

    return write


NO_MESH = {"mesh_vertices": None, "mesh_faces": None}


@pytest.mark.usefixtures("no_fitting")
class TestRefused:
    def test_a_dictionary_with_nothing_to_draw(self, export, changed):
        with pytest.raises(InputError, match=r"changed\.h5: has neither a mesh nor edges .*learn"):
            export(dictionary=changed(edges=None, **NO_MESH))

    def test_the_unit_of_a_dictionary_without_sizes(self, export, changed):
        with pytest.raises(InputError, match=r"changed\.h5: has no `atom_scale`.*unit: landmarks"):
            export(dictionary=changed(atom_scale=None), unit="dictionary")

    @pytest.mark.parametrize("method", ["mean-shape", "pmp"])
    def test_a_mesh_without_coefficients(self, export, method):
        with pytest.raises(InputError, match=f"export: `method: {method}` gives no coefficients"):
            export(fit_keys={"method": method})

    @pytest.mark.parametrize("method", ["mean-shape", "pmp"])
    def test_a_size_without_coefficients(self, export, changed, method):
        with pytest.raises(InputError, match=r"export\.unit: .*no coefficients.*unit: landmarks"):
            export(dictionary=changed(**NO_MESH), fit_keys={"method": method}, unit="dictionary")

    @pytest.mark.parametrize(
        "fit_keys",
        [
            {"method": "alternate"},
            {"method": "convex", "camera": {"model": "perspective", "focal": 1600.0}},
        ],
    )
    def test_rotations_of_atoms_where_there_is_one(self, export, fit_keys):
        with pytest.raises(ValidationError, match="belongs to the method convex and weak"):
            export(fit_keys={**fit_keys, "rotations": "orthogonal"})

    @pytest.mark.parametrize("section", ["export", "pictures"])
    @pytest.mark.parametrize(
        ("folder", "message"),
        [
            ("-", "standard output; give the name of a folder"),
            ("views.h5", "it is not a folder"),
            ("views.h5/meshes", "views.h5 is not a folder; choose another folder"),
            ("result.h5", "result.h5 is also the output; give the folder a different name"),
            ("../{here}/result.h5", "is also the output; give the folder a different name"),
            ("n" * 256, "its name is too long; give a shorter one"),
            ("link", "link: it is a link to .*nowhere, which does not exist; create that folder"),
        ],
    )
    def test_a_folder_that_cannot_be(self, tmp_path, run, section, folder, message):
        (tmp_path / "link").symlink_to(tmp_path / "nowhere")
        name = folder if folder == "-" else str(tmp_path / folder.format(here=tmp_path.name))
        with pytest.raises(InputError, match=message):
            run(**{section: {"folder": name}})

    @pytest.mark.parametrize("section", ["export", "pictures"])
    def test_a_folder_that_is_not_writable(self, tmp_path, run, section, monkeypatch):
        (tmp_path / "locked").mkdir()
        access = os.access

        def locked(path, mode, **options):
            return not str(path).endswith("locked") and access(path, mode, **options)

        # permissions do not stop a superuser, who may be running this
        monkeypatch.setattr("os.access", locked)
        monkeypatch.setattr("os.supports_effective_ids", {locked})
        with pytest.raises(InputError, match="locked is not writable"):
            run(**{section: {"folder": str(tmp_path / "locked")}})

    @pytest.mark.parametrize(
        ("section", "file_format"),
        [("export", "ply-ascii"), ("export", "glb"), ("pictures", "png")],
    )
    def test_a_result_that_is_named_like_what_is_exported(
        self, tmp_path, run, section, file_format
    ):
        (tmp_path / "both/sub").mkdir(parents=True)
        suffix = file_format.split("-")[0]
        form = {} if section == "pictures" else {"format": file_format}
        output = tmp_path / f"both/sub/result.{suffix}"
        with pytest.raises(
            InputError, match=rf"has the same name as the \.{suffix} files that go into"
        ):
            run(
                output=output,
                **{section: {"folder": str(tmp_path / "both")} | form},
            )

    def test_pictures_without_matplotlib(self, tmp_path, run, monkeypatch):
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        with pytest.raises(
            InputError, match=r"pictures: matplotlib is not.*pip install matplotlib"
        ):
            run(pictures={"folder": str(tmp_path / "pictures")})


def test_nothing_appears_where_something_is_refused(tmp_path, export, changed):
    with pytest.raises(InputError):
        export(dictionary=changed(atom_scale=None), unit="dictionary")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["changed.h5", "views.h5"]


def test_files_of_an_earlier_run_survive_a_run_that_fails(tmp_path, export, views, monkeypatch):
    export()
    folder = tmp_path / "meshes"
    before = {path: path.read_bytes() for path in folder.rglob("*.ply")}
    result = (tmp_path / "result.h5").read_bytes()
    monkeypatch.setattr(
        "shapefit.pipelines.fit.report.find_failures", lambda *_, **__: pytest.fail("on the way")
    )
    moved = LandmarkSet(
        landmarks=2 * views.landmarks, landmark_names=views.landmark_names, items=views.items
    )
    with pytest.raises(pytest.fail.Exception):
        export(moved)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert (tmp_path / "result.h5").read_bytes() == result
    assert sorted(path.name for path in tmp_path.iterdir()) == ["meshes", "result.h5", "views.h5"]


def test_the_result_may_lie_among_the_meshes(tmp_path, run):
    (tmp_path / "both").mkdir()
    found, outcomes = run(
        output=tmp_path / "both/result.h5", export={"folder": str(tmp_path / "both")}
    )
    assert len(found) == 6
    assert len(list((tmp_path / "both").rglob("*.ply"))) == 6
    assert outcomes[-1].written == (tmp_path / "both/result.h5", tmp_path / "both")


def test_other_files_of_the_folder_stay(tmp_path, export):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/notes.txt").write_text("mine")
    export()
    assert (tmp_path / "meshes/notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("items", "keys", "message"),
    [
        (
            ("car", "car.ply/1"),
            {},
            r"meshes/car\.ply: is a file of another item as well as of 'car\.ply/1'",
        ),
    ],
)
def test_two_items_that_clash_are_named(tmp_path, export, views, items, keys, message):
    clashing = views.replaced(items=(*items, "c", "d", "e", "f"))
    with pytest.raises(InputError, match=f"{message}; rename one of them, or .* another format"):
        export(clashing, **keys)
    assert sorted(os.listdir(tmp_path)) == ["views.h5"]
    export(clashing, format="obj", **keys)
    assert len(list((tmp_path / "meshes").rglob("*.obj"))) == 6


def test_a_mesh_and_a_picture_that_clash_are_named(tmp_path, run, views):
    both = {"folder": str(tmp_path / "both")}
    clashing = views.replaced(items=("car", "car.png/1", "c", "d", "e", "f"))
    with pytest.raises(InputError, match=r"car\.png: is a file of another item"):
        run(clashing, export=both, pictures=both)
    assert sorted(os.listdir(tmp_path)) == ["views.h5"]


@pytest.fixture
def earlier(tmp_path, export, views):
    """Export to meshes and pictures; return what all files hold, and the same images moved."""
    export(fit_keys={"pictures": {"folder": str(tmp_path / "pictures"), "most": 1}})
    moved = views.replaced(landmarks=2 * views.landmarks)
    return everything(tmp_path), moved


def everything(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "views.h5"
    }


def test_a_folder_where_a_mesh_goes_leaves_everything_as_it_was(tmp_path, export, earlier):
    _, images = earlier
    target = tmp_path / "meshes" / f"{images.items[-1]}.ply"
    target.unlink()
    target.mkdir()
    before = everything(tmp_path)
    with pytest.raises(InputError, match=f"{target}: it is a folder, but must be a file"):
        export(images)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (OSError(errno.EACCES, "Permission denied"), InputError),
        (OSError(errno.EIO, "Input/output error"), InputError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
def test_folders_stay_as_they_were_where_the_result_cannot_be_completed(
    tmp_path, export, earlier, monkeypatch, error, raised
):
    before, images = earlier
    replace_file = Path.replace

    def fail(temporary, target):
        if target.name != "result.h5":
            return replace_file(temporary, target)
        raise error

    monkeypatch.setattr(Path, "replace", fail)
    pictures = {"folder": str(tmp_path / "pictures"), "sheet": 2}
    with pytest.raises(raised):
        export(images, fit_keys={"pictures": pictures})
    assert everything(tmp_path) == before


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
