"""Photographs of a page lie under their frames."""

import numpy as np
import pytest
from PIL import Image

from tests.columns import in_rows


def sizes_of_pictures(page):
    """Return frame -> width and height of its photograph."""
    return {frame: each["size"] for frame, each in page["pictures"].items()}


def write_picture(path, width, height, mode="L", **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, (width, height)).save(path, **options)


def test_pictures_lie_under_their_frames(desk):
    images = desk.folder / "images"
    write_picture(images / "i1.jpg", 2000, 1000, "RGB")
    write_picture(images / "deep" / "i3.png", 20, 10)
    result = desk.result(items=("i0", "x/i1", "i2", "deep/i3", "i4", "i5"))
    page = desk.view(result, images=images).data
    assert sizes_of_pictures(page) == {"1": [2000, 1000], "3": [20, 10]}
    assert page["pictures"]["1"]["data"].startswith("data:image/jpeg;base64,")


def test_no_picture_outside_the_folder_is_shown(desk):
    images = desk.folder / "images"
    write_picture(images / "i1.png", 20, 10)
    write_picture(desk.folder / "secret.png", 20, 10)
    result = desk.result(n=3, items=("i1", "../secret", "/etc/hosts"))
    page = desk.view(result, images=images).data
    assert sizes_of_pictures(page) == {"0": [20, 10]}


def test_pictures_of_a_video_are_numbered(desk):
    """Programs count from any number."""
    images = desk.folder / "frames"
    for number in (8, 9, 10):
        write_picture(images / f"film_{number}.png", 10 * number, 10)
    (images / "notes.txt").write_text("nothing")
    result = desk.result(items=("v/a/0", "v/a/2", "v/b/2", "v/b/3", "v/c", "v/b/1"))
    page = desk.view(result, images=images).data
    widths = {frame: size[0] for frame, size in sizes_of_pictures(page).items()}
    assert widths == {"0": 80, "1": 100, "2": 100, "5": 90}


ORIENTATION = 0x0112


QUARTER_TURN = 6
"""Of a camera that is held upright."""


@pytest.fixture
def made_with_faults(desk, rng):
    """The page of six images of 1280 x 720, of which one has no photograph, one a
    damaged one, and one a photograph of another shape.
    """
    images = desk.folder / "photos"
    write_picture(images / "i0.png", 640, 360, "RGB")
    write_picture(images / "i1.png", 1280, 720, "RGB")
    write_picture(images / "i2.png", 300, 400, "RGB")
    (images / "i3.jpg").write_bytes(rng.bytes(300))
    turned = Image.Exif()
    turned[ORIENTATION] = QUARTER_TURN
    write_picture(images / "i4.jpg", 720, 1280, "RGB", exif=turned)
    shapes = desk.shapes(6)
    extras = {
        "landmarks": in_rows(shapes)[..., :2],
        "image_size": np.tile([1280.0, 720.0], (6, 1)),
    }
    return desk.view(desk.result(shapes=shapes, extras=extras), images=images)


def test_photographs_that_are_right_are_shown(made_with_faults):
    """A smaller copy is shown as large as the image."""
    assert sizes_of_pictures(made_with_faults.data) == {
        "0": [1280, 720],
        "1": [1280, 720],
        "2": [300, 400],
        "4": [1280, 720],
    }


def test_what_is_wrong_with_photographs_is_said(made_with_faults):
    notes = made_with_faults.notes
    other_shape = "1 photograph not of the shape of the images, which are 1280 x 720: "
    assert "1 frame of 6 without a photograph in photos." in notes
    assert "1 photograph cannot be read, such as i3.jpg (" in notes
    assert other_shape in notes
    assert "such as on i2.png, 300 x 400." in notes
