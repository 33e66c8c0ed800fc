"""C3D is read back by its library, in millimetres to the precision of the format."""

import sys

import numpy as np
import pytest

from shapefit.io.writers.motion import Motion
from shapefit.io.writers.tables import MAX_FRAMES, write_c3d
from tests.io.files import save

ezc3d = pytest.importorskip("ezc3d")


def test_points_come_back_in_millimetres(tmp_path, scene):
    target = tmp_path / "man.c3d"
    shapes = scene.result.shapes.copy()
    shapes[2] = np.nan
    save(target, scene.result.replaced(shapes=shapes))
    file = ezc3d.c3d(str(target))
    point = file["parameters"]["POINT"]
    assert point["UNITS"]["value"] == ["mm"]
    assert point["LABELS"]["value"] == list(scene.result.landmark_names)
    assert point["RATE"]["value"] == [25]
    assert point["Y_SCREEN"]["value"] == ["+Y"]
    assert file["header"]["points"]["first_frame"] == 7
    points = file["data"]["points"][:3].transpose(2, 0, 1)
    np.testing.assert_allclose(points[[0, 1, 3]], 1000 * scene.y_up[[0, 1, 3]], atol=1e-3)
    assert np.isnan(points[2]).all()
    residuals = file["data"]["meta_points"]["residuals"][0]
    np.testing.assert_array_equal(residuals, np.tile([0, 0, -1, 0], (15, 1)))


def test_shapes_keep_their_axes_and_promise_none(tmp_path, scene, shapes):
    save(tmp_path / "walk.c3d", shapes)
    file = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    points = file["data"]["points"][:3].transpose(2, 0, 1)
    np.testing.assert_allclose(points, 1000 * scene.world, atol=1e-3)
    assert "Y_SCREEN" not in file["parameters"]["POINT"]
    assert file["parameters"]["SHAPEFIT"]["AXES"]["value"] == ["axes as in the shapes"]


def test_more_frames_than_a_file_can_number(tmp_path, scene, problems):
    late = scene.result.replaced(further=scene.result.further | {"frame": 65530 + np.arange(4)})
    save(tmp_path / "late.c3d", late.take(slice(0, 3)))
    later = scene.result.replaced(further=scene.result.further | {"frame": 65533 + np.arange(4)})
    (line,) = problems(save, tmp_path / "later.c3d", later)
    assert (
        line == "film/anna: the frames run to 65,537, and C3D numbers 65,535 at most; write "
        "TRC, or shorter sequences"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["late.c3d"]


def test_without_the_library_the_error_says_how_to_get_it(tmp_path, scene, problems, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    (line,) = problems(save, tmp_path / "man.c3d", scene.result)
    assert line.endswith("need the library ezc3d; run `pip install ezc3d`")


def test_a_disk_that_fills_up_unseen(tmp_path, scene, problems, monkeypatch):
    target = tmp_path / "man.c3d"
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
    assert [path.name for path in tmp_path.iterdir()] == ["man.c3d"]


def motion_of(names, first=0):
    """Two frames of points at the origin."""
    return Motion(
        name="",
        landmark_names=names,
        points=np.zeros((2, 3, len(names))),
        first=first,
        rate=30.0,
        axes="",
        size="",
        warnings=(),
        deviations=np.zeros((2, len(names))),
        angles=np.empty((2, 0)),
        angle_deviations=np.empty((2, 0)),
    )


def test_the_last_frame_that_c3d_can_number(tmp_path, problems):
    write_c3d(tmp_path / "man.c3d", motion_of(("a",), MAX_FRAMES - 2))
    (line,) = problems(write_c3d, tmp_path / "man.c3d", motion_of(("a",), MAX_FRAMES - 1))
    assert f"and C3D numbers {MAX_FRAMES:,} at most" in line


@pytest.mark.parametrize(("count", "bytes_"), [(3, 256), (256, 3)])
def test_more_labels_or_longer_ones_than_a_byte_counts(tmp_path, count, bytes_, problems):
    names = tuple(f"{number:03}".rjust(bytes_, "x") for number in range(count))
    (line,) = problems(write_c3d, tmp_path / "man.c3d", motion_of(names))
    assert "C3D holds 255 landmarks at most, with names of 255 bytes; write TRC" in line
