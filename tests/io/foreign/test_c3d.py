"""C3D files, written by ezc3d, and what can be wrong with them."""

import sys

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import write_shapes
from shapefit.io.foreign import markers as reader
from tests.io.files import load_shapes


@pytest.fixture
def c3d(tmp_path):
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is the extra `c3d`")

    def make(labels=("knee", "ankle"), units="mm", rate=100.0, n=4, **lists):
        file = ezc3d.c3d()
        parameters = file["parameters"]["POINT"]
        parameters["LABELS"]["value"] = list(labels)
        parameters["UNITS"]["value"] = [units]
        parameters["RATE"]["value"] = [rate]
        for name, value in lists.items():
            file.add_parameter("POINT", name, value)
        points = np.ones((4, len(labels), n))
        points[:3] = np.arange(3 * len(labels) * n).reshape(3, len(labels), n)
        points[:3, -1, 2] = np.nan
        file["data"]["points"] = points
        path = tmp_path / "walk.c3d"
        file.write(str(path))
        return path, points[:3].transpose(2, 0, 1)

    return make


def test_units_rate_and_missing_points(c3d):
    path, points = c3d()
    shapes, notes = load_shapes(path)
    assert shapes.landmark_names == ("knee", "ankle")
    assert (shapes.unit, shapes.frame_rate, notes) == ("m", 100.0, ())
    assert len(set(shapes.items)) == 4
    np.testing.assert_allclose(shapes.shapes, points / 1000, rtol=1e-6)
    assert np.isnan(shapes.shapes[2, :, 1]).all()


def test_subjects_are_individuals(c3d):
    path, points = c3d(labels=("Ann:knee", "Bob:knee", "Bob:hip", "*3"))
    shapes, _ = load_shapes(path)
    assert shapes.landmark_names == ("knee", "hip", "*3")
    assert set(shapes.sequences) == {"walk/Ann", "walk/Bob", "walk/unassigned"}
    bob = np.array(shapes.sequences) == "walk/Bob"
    np.testing.assert_allclose(shapes.shapes[bob][:, :, :2], points[:, :, 1:3] / 1000, rtol=1e-6)


def test_what_a_model_computed_is_no_point(c3d):
    path, _ = c3d(labels=("knee", "KneeAngle"), ANGLES=["KneeAngle"])
    shapes, notes = load_shapes(path)
    assert shapes.landmark_names == ("knee",)
    assert any("KneeAngle" in note for note in notes)


def test_without_ezc3d_the_error_says_how_to_get_it(c3d, monkeypatch):
    path, _ = c3d()
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(InputError, match="pip install ezc3d"):
        load_shapes(path)


def test_a_cut_off_file_is_refused_before_ezc3d_sees_it(c3d):
    path, _ = c3d()
    whole = path.read_bytes()
    for end in (600, len(whole) // 2, len(whole) - 500):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match=r"walk\.c3d"):
            load_shapes(path)


def test_damaged_parameters_are_refused(c3d):
    """A record whose name is too long sends ezc3d anywhere."""
    path, _ = c3d()
    whole = path.read_bytes()
    place = whole.index(b"POINT") - 2
    for wrong in (127, 130):
        path.write_bytes(whole[:place] + bytes([wrong]) + whole[place + 1 :])
        with pytest.raises(InputError, match=r"walk\.c3d: cannot be read"):
            load_shapes(path)


def test_a_negative_residual_is_missing_whatever_the_point(c3d, monkeypatch):
    """Of ezc3d such points are not numbers; another version may leave what stood there."""
    path, points = c3d()
    file = reader._read_c3d(path)
    file["data"]["points"][:3, 0, 1] = 7.0
    residuals = np.array(file["data"]["meta_points"]["residuals"])
    residuals[0, 0, 1] = -1.0
    file["data"]["meta_points"]["residuals"] = residuals
    monkeypatch.setattr(reader, "_read_c3d", lambda _: file)
    shapes, _ = load_shapes(path)
    assert np.isnan(shapes.shapes[1, :, 0]).all()
    np.testing.assert_allclose(shapes.shapes[0], points[0] / 1000, rtol=1e-6)


def test_labels_that_are_not_utf8_are_latin1(c3d, tmp_path):
    path, _ = c3d(labels=("ZZpaule", "Köper"))
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"ZZpaule", b"\xc9paule "))
    shapes, _ = load_shapes(path)
    assert shapes.landmark_names == ("Épaule", "Köper")
    write_shapes(tmp_path / "same.h5", shapes)
