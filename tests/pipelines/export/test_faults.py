"""What `fit` refuses to export, before any image is fitted, and what a failing run leaves."""

from __future__ import annotations

import os
import sys
from dataclasses import replace

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

    monkeypatch.setattr("shapefit.pipelines.fit.choose_lifter", lambda _config, _dictionary: refuse)


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

    def test_a_mesh_whose_landmarks_move_on_their_own(self, export):
        with pytest.raises(InputError, match=r"export: `temporal\.depths` moves every landmark"):
            export(fit_keys={"temporal": {"depths": True}})

    @pytest.mark.parametrize(
        "fit_keys",
        [
            {"method": "alternate"},
            {"method": "convex", "camera": {"model": "perspective", "focal": 1600.0}},
        ],
    )
    def test_rotations_per_atom_where_there_is_one(self, export, fit_keys):
        with pytest.raises(ValidationError, match="belongs to the method convex and weak"):
            export(fit_keys=fit_keys, rotation="per-atom")

    @pytest.mark.parametrize("section", ["export", "pictures"])
    @pytest.mark.parametrize(
        ("folder", "message"),
        [
            ("-", "standard output; give the name of a folder"),
            ("views.h5", "it is not a folder"),
            ("nowhere/meshes", "does not exist; create the folder"),
        ],
    )
    def test_a_folder_that_cannot_be(self, tmp_path, run, section, folder, message):
        name = folder if folder == "-" else str(tmp_path / folder)
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

    def test_pictures_without_matplotlib(self, tmp_path, run, monkeypatch):
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        with pytest.raises(InputError, match=r"pictures: matplotlib is not.*shapefit\[plots\]"):
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
        "shapefit.pipelines.fit.find_failures", lambda *_: pytest.fail("on the way")
    )
    moved = LandmarkSet(
        landmarks=2 * views.landmarks, landmark_names=views.landmark_names, items=views.items
    )
    with pytest.raises(pytest.fail.Exception):
        export(moved)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert (tmp_path / "result.h5").read_bytes() == result
    assert sorted(path.name for path in tmp_path.iterdir()) == ["meshes", "result.h5", "views.h5"]


def test_other_files_of_the_folder_stay(tmp_path, export):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/notes.txt").write_text("mine")
    export()
    assert (tmp_path / "meshes/notes.txt").read_text() == "mine"


def test_two_items_of_one_file_name_are_refused(tmp_path, export, views):
    # the landmarks of the first are the mesh of the second
    items = ("car", "car-landmarks", "c", "d", "e", "f")
    with pytest.raises(InputError, match=r"car-landmarks\.ply: two items have this file name"):
        export(replace(views, items=items), landmarks=True)
    assert not (tmp_path / "meshes").exists()


def test_zero_images_give_no_files(tmp_path, export, views):
    nothing = LandmarkSet(
        landmarks=np.empty((0, 2, 72)), landmark_names=views.landmark_names, items=()
    )
    pictures = {"folder": str(tmp_path / "pictures"), "sheet": 4}
    found, outcomes = export(nothing, fit_keys={"method": "convex", "pictures": pictures})
    assert len(found) == 0
    assert outcomes[-1].note == "0 meshes, 0 pictures"
    assert list((tmp_path / "pictures").iterdir()) == []
