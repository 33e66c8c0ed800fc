"""C3D, read back by ezc3d."""

import sys

import ezc3d
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.io import read_shapes
from shapefit.io.writers.tables import MAX_FRAMES
from shapefit.records import Shapes
from tests.io.files import save


@pytest.fixture
def target(tmp_path):
    return tmp_path / "man.c3d"


@pytest.fixture
def written(target, scene):
    """The result as C3D, its third frame without a shape."""
    shapes = scene.result.shapes.copy()
    shapes[2] = np.nan
    save(target, scene.result.replaced(shapes=shapes))
    return target


def points_of(file):
    """Return the points (n, 3, p) in a file that ezc3d has read."""
    return file["data"]["points"][:3].transpose(2, 0, 1)


def test_c3d_has_points_in_millimetres(written, scene):
    points = points_of(ezc3d.c3d(str(written)))
    known = [0, 1, 3]
    expected = 1000 * scene.y_up[known]
    assert_allclose(points[known], expected, atol=1e-3)
    assert np.isnan(points[2]).all()


def test_points_that_are_missing_have_the_residual_minus_1(written):
    file = ezc3d.c3d(str(written))
    residuals = file["data"]["meta_points"]["residuals"][0]
    assert residuals.shape == (15, 4)
    for of_landmark in residuals:
        assert_array_equal(of_landmark, [0, 0, -1, 0])


def test_parameters_of_c3d(written, scene):
    file = ezc3d.c3d(str(written))
    parameters = file["parameters"]["POINT"]
    assert parameters["UNITS"]["value"] == ["mm"]
    assert parameters["RATE"]["value"] == [25]
    assert parameters["Y_SCREEN"]["value"] == ["+Y"]
    assert parameters["LABELS"]["value"] == list(scene.result.landmark_names)
    assert file["header"]["points"]["first_frame"] == 7


def test_c3d_comes_back(written, scene):
    back = read_shapes([written])
    assert back.landmark_names == scene.result.landmark_names
    assert back.frame_rate == 25


def test_shapes_keep_their_axes_and_promise_none(target, scene, shapes):
    save(target, shapes)
    file = ezc3d.c3d(str(target))
    parameters = file["parameters"]
    assert_allclose(points_of(file), 1000 * scene.world, atol=1e-3)
    assert "Y_SCREEN" not in parameters["POINT"]
    assert parameters["SHAPEFIT"]["AXES"]["value"] == ["axes as in the shapes"]


def still(names, first=0, frames=2) -> Shapes:
    """Frames of points at the origin."""
    return Shapes(
        np.zeros((frames, len(names), 3)),
        landmark_names=names,
        items=tuple(map(str, range(frames))),
        sequences=("a",) * frames,
        unit="m",
        frame_rate=30.0,
        frames=first + np.arange(frames),
    )


LONG_NAME = ("x" * 256,)


MANY_NAMES = tuple(map(str, range(256)))


TOO_MUCH = {
    "late frames": still(("a",), first=MAX_FRAMES - 1),
    "no frames": still(("a",), frames=0),
    "long name": still(LONG_NAME),
    "many landmarks": still(MANY_NAMES),
}


@pytest.mark.parametrize("shapes", TOO_MUCH.values(), ids=TOO_MUCH)
def test_more_than_a_c3d_file_can_hold_is_refused(tmp_path, target, problems, shapes):
    (line,) = problems(save, target, shapes)
    limits = "255 landmarks at most, with names of 255 bytes, and the frames 1 to 65"
    assert f"C3D holds {limits}" in line
    assert not list(tmp_path.iterdir())


def test_as_much_as_a_c3d_file_can_hold_is_written(target):
    names = (*MANY_NAMES[:254], "x" * 255)
    save(target, still(names, first=MAX_FRAMES - 2))
    assert target.is_file()


def test_without_the_library_the_error_says_how_to_get_it(
    target, scene, problems, monkeypatch
):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    (line,) = problems(save, target, scene.result)
    assert line.endswith("need the library ezc3d; run `pip install ezc3d`")


def test_a_disk_that_fills_up_unseen(target, scene, problems, monkeypatch):
    target.write_bytes(b"old")
    original = ezc3d.c3d.write

    def cut(self, path):
        original(self, path)
        with open(path, "r+b") as file:
            file.truncate(600)

    monkeypatch.setattr(ezc3d.c3d, "write", cut)
    (line,) = problems(save, target, scene.result)
    assert "cannot be written: No space left" in line
    assert target.read_bytes() == b"old"
