"""The camera where none is given: the measured one, else an assumed one, else none."""

import struct

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.errors import InputError
from shapefit.geometry.pinhole import ASSUMED_FOCAL as FOCAL
from shapefit.io import LandmarkSet
from shapefit.io.inputs import read_image_size
from shapefit.pipelines.fit.camera import choose_camera

SIZE = np.array([1920, 1080])
MATRIX = np.array([[2500.0, 0, 900], [0, 2600, 500], [0, 0, 1]])


def images(points, unit="px", per_item=None, **whole):
    """Images (n, 2, p) of some points."""
    points = np.asarray(points, dtype=np.float64)
    return LandmarkSet(
        landmarks=points,
        landmark_names=tuple("abcdefgh"[: points.shape[2]]),
        items=tuple(f"video/{i:03}.png" for i in range(len(points))),
        unit=unit,
        columns=per_item,
        whole=whole,
    )


def box(width, height, at=(700.0, 300.0), n=6):
    """Images of the corners of a box."""
    corners = np.array([[0, width, 0, width], [0, 0, height, height]], dtype=np.float64)
    return np.tile(np.array(at)[:, None] + corners, (n, 1, 1))


def choose(images, of_people=True, paths=(), image_size=None, **camera):
    """Return the section `camera` with what was chosen, and the line that says so."""
    files = {"landmarks": ["a.h5"], "dictionary": "people", "output": "b.h5"}
    looks = FitConfig.model_fields["camera"].annotation(**camera)
    keys = {"method": "posterior", "camera": looks, "image_size": image_size}
    config = FitConfig.model_construct(**files, **keys)
    found, line = choose_camera(config, images, of_people=of_people, paths=paths)
    return config.changed(camera=found).camera, line


def focal_of(images, *args, **keys):
    found, _ = choose(images, *args, **keys)
    return None if found.model != "perspective" else found.focal


def test_the_size_of_the_image_gives_focal_length_and_centre():
    for people in (True, False):
        found, line = choose(images(box(300, 400), image_size=SIZE), people)
        assert found.focal == pytest.approx(FOCAL * 1920)
        assert found.principal_point == (960.0, 540.0)
        assert "1920 x 1080 (of the files)" in line
        assert "assumed" in line


@pytest.mark.parametrize(
    ("most", "size"),
    [
        ((700, 700), (1280, 720)),
        ((1280, 720), (1280, 720)),
        ((700, 1000), (720, 1280)),
        ((1281, 300), (1920, 1080)),
        ((1000, 1500), (1080, 1920)),
        ((1081, 1500), (3840, 2160)),
        ((1500, 2200), (2160, 3840)),
    ],
)
def test_a_size_that_nobody_states_is_the_smallest_usual_one_that_holds_all(most, size):
    corner = (most[0] - 400, most[1] - 300)
    spread = np.concatenate([box(400, 300, (0, 0)), box(400, 300, corner)])
    found, line = choose(images(spread))
    assert found.focal == pytest.approx(FOCAL * max(size))
    assert found.principal_point == (size[0] / 2, size[1] / 2)
    assert "set `image_size`" in line
    assert focal_of(images(spread[6:])) == found.focal


def test_stated_sizes_come_first():
    seen = images(box(300, 400), image_size=SIZE)
    assert focal_of(seen, image_size=(2000, 1500)) == pytest.approx(2200)
    each = images(box(300, 400), per_item={"image_size": np.tile(SIZE, (6, 1))})
    assert focal_of(each) == pytest.approx(FOCAL * 1920)


def jpeg(width, height):
    comment = b"\xff\xfe" + struct.pack(">H", 7) + b"hello"
    frame = b"\xff\xc2" + struct.pack(">HBHHB", 17, 8, height, width, 3) + bytes(9)
    return b"\xff\xd8" + comment + frame


def png(width, height):
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + bytes(9)


def test_images_beside_the_landmarks_have_the_size(tmp_path):
    (tmp_path / "landmarks.csv").write_text("")
    seen, paths = images(box(300, 400)), (tmp_path / "landmarks.csv",)
    (tmp_path / "report.png").write_bytes(png(640, 480))  # of something else
    assert focal_of(seen, paths=paths) == pytest.approx(FOCAL * 1280)
    (tmp_path / "000.png").write_bytes(png(1000, 1600))
    (tmp_path / "003.jpg").write_bytes(jpeg(1000, 1600))
    found, line = choose(seen, False, paths)
    assert found.focal == pytest.approx(FOCAL * 1600)
    assert "beside" in line
    (tmp_path / "004.jpg").write_bytes(jpeg(800, 600))
    found, line = choose(seen, paths=paths)
    assert found.model == "weak-perspective"
    assert "several sizes" in line


def test_files_of_a_frame_each_are_named_like_their_images(tmp_path):
    (tmp_path / "json").mkdir()
    (tmp_path / "json" / "cam_0001_keypoints.json").write_text("{}")
    (tmp_path / "json" / "cam_0001.jpg").write_bytes(jpeg(640, 900))
    assert focal_of(images(box(300, 400)), paths=(tmp_path / "json",)) == pytest.approx(FOCAL * 900)


@pytest.mark.parametrize("content", [
    b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xc0\x00", b"\xff\xd8\xff\xfe\0\0", b"x",
])  # fmt: skip
def test_what_is_no_image_has_no_size(tmp_path, content):
    (tmp_path / "x").write_bytes(content)
    assert read_image_size(tmp_path / "x") is None


NEGATIVE = box(300, 400, (-10, 500))


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (images(box(300, 400), unit="m"), None),
        (images(NEGATIVE, unit="unknown"), None),
        (images(NEGATIVE), "beyond the usual sizes"),
        (images(box(300, 400, (5000, 0))), "beyond the usual sizes"),
        (images(box(160, 119.9), image_size=SIZE), "cover little"),  # 200 px
        (images(box(700, 700, (0, 0))), "may be crops"),
        (images(np.full((3, 2, 1), 500.0)), None),
        (images(box(300, 400), image_size=np.array([0, 5])), "impossible"),
        (images(box(30, 40), per_item={"image_size": np.arange(1, 13).reshape(6, 2)}), "several"),
    ],
)
def test_weak_perspective_stays_where_perspective_cannot_be_known(seen, said):
    found, line = choose(seen)
    assert found.model == "weak-perspective"
    assert line == "" if said is None else said in line


def test_the_extent_is_the_median_of_images_with_two_landmarks():
    """By the mean, or with single landmarks, these would cover too little, or enough."""
    large, small = box(300, 400, n=1), box(60, 80, n=3)
    assert focal_of(images(np.concatenate([small, 4 * large]), image_size=SIZE)) is None
    single = np.full((5, 2, 4), np.nan)
    single[:, :, 0] = 500.0
    assert focal_of(images(np.concatenate([large, single]), image_size=SIZE)) is not None


def test_animals_need_the_size_of_the_image():
    found, line = choose(images(box(300, 400)), of_people=False)
    assert found.model == "weak-perspective"
    assert "set `image_size`" in line


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_the_camera_of_the_files_is_obeyed(factor):
    matrix = MATRIX * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]]
    found, _ = choose(images(box(300, 400), camera_matrix=matrix, image_size=SIZE))
    assert found.focal == "files"


def test_a_skew_is_left_out():
    skewed = MATRIX + np.array([[0, 30, 0], [0, 0, 0], [0, 0, 0]])
    found, line = choose(images(box(300, 400), camera_matrix=skewed))
    assert found.focal == pytest.approx(np.sqrt(2500 * 2600))
    assert found.principal_point == (900.0, 500.0)
    assert "without its skew" in line
    skewed[0, 0] *= -1
    with pytest.raises(InputError):
        choose(images(box(300, 400), camera_matrix=skewed))


def test_what_is_given_stays():
    found, line = choose(images(box(300, 400), image_size=SIZE), focal="none")
    assert (found.model, found.focal, line) == ("weak-perspective", "none", "")
