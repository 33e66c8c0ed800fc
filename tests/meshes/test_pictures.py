"""What pictures show, and where, read from what matplotlib was given to draw."""

import warnings
from io import BytesIO

import numpy as np
import pytest
from mpl_toolkits.mplot3d import proj3d

from shapefit.geometry.rotations import rotation_about
from shapefit.meshes.pictures import (
    IN_AXES,
    FittedImage,
    Model,
    contact_sheet,
    save,
)


@pytest.fixture
def image(box):
    """Eight corners of a box of which one is hidden and one an outlier, two pixels off."""
    shape = box(4, 3, 2) * 100 + 500
    landmarks = shape[:2] + 2.0
    landmarks[:, 3] = np.nan
    outliers = np.arange(8) == 5
    return FittedImage("a", landmarks, shape, shape[:2], shape, shape[:2], outliers)


def marks(axes):
    """The marks of a panel by their word in the legend, (2, m)."""
    return {line.get_label(): line.get_xydata().T for line in axes.lines}


def on_screen(axes, points):
    """Where (2, p) a panel in 3D shows points (3, p) of its frame: right and up."""
    x, y, _ = proj3d.proj_transform(*points, axes.get_proj())
    return np.stack([x, y])


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_landmarks_stand_as_in_the_image(y_axis, image, box_faces):
    axes = contact_sheet([image], Model(y_axis, box_faces)).axes[0]
    found = marks(axes)
    np.testing.assert_array_equal(found["judged outlier"], image.landmarks[:, [5]])
    np.testing.assert_array_equal(found["hidden, from the model"], image.shape[:2, [3]])
    np.testing.assert_array_equal(found["seen"], image.landmarks[:, [0, 1, 2, 3, 4, 6, 7]])
    assert axes.yaxis_inverted() == (y_axis == "down")
    assert axes.get_aspect() == 1
    lines = next(c for c in axes.collections if c.get_label() == "to the model").get_segments()
    assert len(lines) == 7
    for line in lines:
        np.testing.assert_allclose(line[0] - line[1], 2.0)


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_novel_views_walk_around_the_model_which_stands_upright(y_axis, image, box_faces):
    _, right = contact_sheet([image], Model(y_axis, box_faces)).axes
    corner = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    flip = np.array([1.0, 1, 1] if y_axis == "up" else [1.0, -1, -1])[:, None]
    viewer = flip * corner  # x right, y up, z towards the viewer
    frame = IN_AXES @ np.diag(flip.ravel())
    tilt, turn = (rotation_about(np.eye(3)[a], np.radians([d]))[0] for a, d in ((0, 15), (1, 60)))
    expected = (tilt @ turn @ viewer)[:2]
    middle = frame @ np.full((3, 1), 500.0)
    shown = on_screen(right, middle + frame @ corner) - on_screen(right, middle)
    shown *= np.linalg.norm(expected) / np.linalg.norm(shown)
    np.testing.assert_allclose(shown, expected, atol=1e-9)


def test_edges_are_drawn_where_there_is_no_mesh(image):
    edges = np.array([[0, 1], [1, 3]])
    bare = image._replace(mesh=None, projected_mesh=None)
    flat, right = contact_sheet([bare], Model("down", edges=edges)).axes
    drawn, _ = flat.collections
    np.testing.assert_array_equal(drawn.get_segments(), image.shape[:2].T[edges])
    (bones,) = right.collections
    assert len(bones._segments3d) == 2


def test_an_image_without_a_shape_says_so(image, box_faces):
    nowhere = np.full((3, 8), np.nan)
    failed = FittedImage("f", image.landmarks, nowhere, nowhere[:2])
    figure = contact_sheet([failed], Model("down", box_faces))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["no shape"]
    assert set(marks(axes)) == {"seen"}
    empty = failed._replace(landmarks=np.full((2, 8), np.nan))
    assert marks(contact_sheet([empty], Model("down", box_faces)).axes[0]) == {}


def test_titles_are_taken_literally_and_of_long_ones_the_end(image, box_faces):
    titled = image._replace(title="recording_of_monday/person 1/$x^2$\n\x1b" + "0" * 30)
    titles = contact_sheet([titled], Model("down")).axes[0].get_title(loc="left")
    assert titles == "x^2$\\n\\x1b" + "0" * 30
    odd = image._replace(title="$\\frac{$ \u4f60")
    for file_format in ("png", "svg"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            save(contact_sheet([odd], Model("down", box_faces)), BytesIO(), file_format)
