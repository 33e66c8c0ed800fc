"""TPS of specimens, and .pts of faces."""

import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.files import load_shapes

from .made import read_images as read

TPS = (
    "LM=3\n10 20\n30.5 40\n50 60\nIMAGE=skull_a.jpg\nID=0\nSCALE=0.02\n"
    "LM=3\n11 21\n31.5 41\n51 61\nCURVES=1\nPOINTS=2\n1 1\n2 2\n"
    "IMAGE=frog_b.jpg\nID=1\n"
)


@pytest.mark.parametrize("text", [TPS, TPS.replace("\n", "\r\n"), TPS.lower()])
def test_specimens_of_tps(tmp_path, text):
    path = tmp_path / "a.tps"
    path.write_text(text, newline="")
    images, (note,) = read(path)
    assert images.items == ("skull_a", "frog_b")
    assert images.sequences is None
    assert images.landmark_names == ("1", "2", "3")
    assert images.landmarks[1].tolist() == [[11, 21], [31.5, 41], [51, 61]]
    assert images.y_axis == "up"
    assert note.endswith("a.tps: left out: CURVES, SCALE")
    assert read(path, y_axis="down")[0].y_axis == "down"


def test_specimens_of_several_sizes_lack_the_last_landmarks(tmp_path):
    path = tmp_path / "a.tps"
    path.write_text("LM=2\n10 20\n30 40\nID=a\nLM=3\n1 2\n3 4\n5 6\nID=b\n")
    images, _ = read(path)
    assert images.items == ("a", "b")
    assert np.isnan(images.landmarks[:, 2, 0]).tolist() == [True, False]


def test_tps_in_3d_is_shapes(tmp_path):
    path = tmp_path / "a.tps"
    path.write_text("LM3=2\n1 2 3\n4 5 6\nID=a\n")
    shapes, _ = load_shapes(path)
    assert shapes.shapes[0].tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (TPS.replace("30.5", "x"), r"a\.tps:3: 'x' is no number; write 2 numbers"),
        (TPS.replace("30.5 ", ""), r"a\.tps:3: 1 numbers, not 2; write 2 numbers for"),
        ("LM=4\n1 2\n3 4\n", r"a\.tps:4: 0 numbers, not 2; .* each of the 4 landmarks"),
        ("LM=2\n1 2\n3 4\nLM3=2\n1 2 3\n4 5 6\n", "specimens in 2D and in 3D"),
    ],
)
def test_what_is_wrong_with_tps_is_named(tmp_path, text, told):
    path = tmp_path / "a.tps"
    path.write_text(text)
    with pytest.raises(InputError, match=told):
        read(path)


PTS = "version: 1\nn_points: 2\n{{\n{} 20.5\n30 40\n}}\n"


def test_faces_of_a_folder(tmp_path):
    for number, name in enumerate(("face_b", "face_a")):
        (tmp_path / f"{name}.pts").write_text(PTS.format(number))
    for given in ([tmp_path], sorted(tmp_path.glob("*.pts"))):
        images, notes = read(*given)
        assert notes == ()
        assert images.items == ("face_a", "face_b")
        assert images.landmark_names == ("1", "2")
        assert images.landmarks[:, 0, 0].tolist() == [1, 0]
        assert images.sequences is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (PTS.format("x"), r"a\.pts:4: 'x' is no number; write 2 numbers"),
        (PTS.format(1).replace("30 40\n", ""), r"a\.pts:5: "),
        (PTS.format(1).replace("{", ""), "does not begin with n_points and {"),
    ],
)
def test_what_is_wrong_with_pts_is_named(tmp_path, text, told):
    path = tmp_path / "a.pts"
    path.write_text(text)
    with pytest.raises(InputError, match=told):
        read(path)
