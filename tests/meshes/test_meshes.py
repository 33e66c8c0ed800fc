"""Dense vertices follow the landmarks; what pictures show, and where, read from
matplotlib.
"""

import re
import warnings
from collections.abc import Callable
from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes, similarity_transform
from shapefit.geometry.rotations import rotation_about
from shapefit.meshes.dense import (
    carry_mesh,
    metric_scale,
)
from shapefit.meshes.pictures import (
    BODY_COLOURS,
    DOUBT_COLOUR,
    INK_COLOUR,
    LEFT_COLOUR,
    MESH_COLOUR,
    MESH_TURNS,
    RESIDUAL_COLOUR,
    RIGHT_COLOUR,
    VIEW_TILT,
    DrawnModel,
    FittedImage,
    PlacedPhotograph,
    contact_sheet,
    save,
    viewer_frame,
)
from shapefit.viewer.page import resource


@pytest.fixture
def box() -> Callable[[float, float, float], Floats]:
    """Return the function that gives the corners (3, 8) of a box around the origin.

    Corner i lies high on x, y and z where the bits 4, 2 and 1 of i are set.
    """
    corners = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) - 0.5
    return lambda width, height, depth: (corners * (width, height, depth)).T


@pytest.fixture
def box_faces() -> NDArray[np.int64]:
    """Return two triangles a side, wound outwards."""
    return np.array(
        [
            (0, 1, 3),
            (0, 3, 2),
            (4, 6, 7),
            (4, 7, 5),
            (0, 4, 5),
            (0, 5, 1),
            (2, 3, 7),
            (2, 7, 6),
            (0, 2, 6),
            (0, 6, 4),
            (1, 5, 7),
            (1, 7, 3),
        ]
    )


def normalised_models(shapes):
    normalised = normalise(shapes)
    return normalised, generalised_procrustes(normalised.points)


def residual_variance(source, target):
    """Largest distance of points left by the best similarity, as a share of the
    target's norm.
    """
    rest = similarity_transform(source, target).apply(source) - target
    return np.linalg.norm(rest, axis=-2).max() / np.linalg.norm(target)


def test_a_mesh_is_carried_as_its_landmarks_are(rng):
    shapes = 40 + 7 * rng.normal(size=(6, 3, 9))
    normalised, alignment = normalised_models(shapes)
    carried = carry_mesh(shapes, normalised, alignment.rotations)
    assert_allclose(carried, alignment.shapes, atol=1e-13)


def test_a_fit_by_one_atom_has_the_metric_size_of_its_model(rng):
    models = np.array([1.0, 3.0, 0.2])[:, None, None] * rng.normal(size=(3, 3, 8)) + 5
    normalised, alignment = normalised_models(models)
    c = np.array([[0.0, 0.7, 0.0], [0.3, 0.0, 0.0]])
    factor = metric_scale(alignment.shapes, c, normalised.scale)
    metric = factor[:, None, None] * np.tensordot(c, alignment.shapes, axes=1)
    for shape, model in zip(metric, models[[1, 0]], strict=True):
        centred = model - model.mean(axis=1, keepdims=True)
        assert np.linalg.norm(shape) == pytest.approx(np.linalg.norm(centred))
        assert residual_variance(shape, centred) < 1e-12


def test_without_coefficients_there_is_no_metric_size(rng):
    factor = metric_scale(
        rng.normal(size=(2, 3, 4)), np.array([[0.0, 0], [1, 0]]), np.ones(2)
    )
    assert_array_equal(np.isnan(factor), [True, False])


@pytest.fixture
def image(box):
    """Eight corners of a box of which one is hidden and one an outlier, two pixels
    off.
    """
    shape = box(4, 3, 2) * 100 + 500
    landmarks = shape[:2] + 2.0
    landmarks[:, 3] = np.nan
    outliers = np.arange(8) == 5
    return FittedImage("a", landmarks, shape, shape[:2], shape, shape[:2], outliers)


def marks(axes):
    """The marks of a panel (2, m): rings, dots and crosses."""
    found = {}
    for line in axes.lines:
        name = "outlier" if line.get_marker() == "X" else "observed"
        if line.get_markerfacecolor() == "white":
            name = "hidden"
        found[name] = line.get_xydata().T
    return found


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def inside(axes, points):
    """Where (m, 2) a panel shows points (2, m), from 0 to 1."""
    return axes.transLimits.transform(points.T)


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_landmarks_stand_as_in_the_image(y_axis, image, box_faces):
    figure = contact_sheet([image], DrawnModel(y_axis, box_faces))
    axes = figure.axes[0]
    found = marks(axes)
    assert_array_equal(found["outlier"], image.landmarks[:, [5]])
    assert_array_equal(found["hidden"], image.shape[:2, [3]])
    assert_array_equal(found["observed"], image.landmarks[:, [0, 1, 2, 3, 4, 6, 7]])
    assert axes.yaxis_inverted() == (y_axis == "down")
    assert axes.get_aspect() == 1
    (residuals,) = axes.collections
    assert len(residuals.get_segments()) == 7
    for line in residuals.get_segments():
        assert_allclose(line[0] - line[1], 2.0)
    words = ["observed", "hidden, from the model", "outlier", "to its fitted position"]
    assert legend(figure) == words


@pytest.mark.parametrize("y_axis", ["up", "down"])
@pytest.mark.parametrize("upright", [False, True])
def test_views_walk_around_the_model_which_stands_upright(
    y_axis, upright, image, box_faces
):
    """A step along each axis of the model is drawn where a viewer beside it sees it."""
    flip = np.diag([1.0, 1, 1] if y_axis == "up" else [1.0, -1, -1])
    turned = rotation_about(np.array([0.3, 1, 0.2]), np.array([0.7]))[0]
    if upright:  # in the frame of the object, however the camera sees it
        image = image._replace(upright=turned.T)
        flip = turned.T
    for turn in MESH_TURNS:
        tilt, around = (
            rotation_about(np.eye(3)[axis], np.radians([angle]))[0]
            for axis, angle in ((0, VIEW_TILT), (1, turn))
        )
        frame = viewer_frame(image, DrawnModel(y_axis, box_faces), turn)
        assert_allclose(frame @ flip.T, tilt @ around, atol=1e-12)
    _, *sides = contact_sheet([image], DrawnModel(y_axis, box_faces)).axes
    assert len(sides) == 2
    for axes, turn in zip(sides, MESH_TURNS, strict=True):
        (solid,) = axes.collections
        drawn = np.concatenate([path.vertices for path in solid.get_paths()])
        shape = image.shape - image.shape.mean(axis=1, keepdims=True)
        frame = viewer_frame(image, DrawnModel(y_axis, box_faces), turn)
        expected = (frame @ shape)[:2]
        away = np.abs(drawn[:, :, None] - expected[None]).sum(axis=1).min(axis=1)
        assert away.max() < 1e-9
        places = inside(axes, expected)
        assert 0 < places.min()
        assert places.max() < 1
        assert 0.6 < np.ptp(places, axis=0).max()  # of the panel


def test_near_faces_are_drawn_over_far_ones(image, box_faces):
    _, *sides = contact_sheet([image], DrawnModel("down", box_faces)).axes
    for axes in sides:
        (solid,) = axes.collections
        # a box shows three of its six sides, two triangles each
        assert len(solid.get_paths()) == 6
        assert len(np.unique(solid.get_facecolors(), axis=0)) == 3  # three shades


def test_edges_are_drawn_where_there_is_no_mesh(image):
    edges = np.array([[0, 1], [1, 3], [2, 4], [4, 5]])
    bare = image._replace(mesh=None, projected_mesh=None, individual=("anna", 1))
    sides = [0, 1, 0, 1, 2, 0, 0, 0]
    model = DrawnModel("down", edges=edges, sides=sides)
    figure = contact_sheet([bare], model)
    flat, right = figure.axes
    drawn, residuals = flat.collections
    assert_array_equal(drawn.get_segments(), image.shape[:2].T[edges])
    names = [LEFT_COLOUR, LEFT_COLOUR, RIGHT_COLOUR, RIGHT_COLOUR]
    assert_allclose(drawn.get_colors(), [to_rgba(name) for name in names])
    (bones,) = right.collections
    assert len(bones.get_segments()) == 4
    widths = [lines.get_linewidths()[0] for lines in (residuals, drawn, bones)]
    assert widths == [0.8, 2, 2]  # thin residuals on thick bones
    assert legend(figure)[:2] == ["left", "right"]
    model = model._replace(sides=None)
    figure = contact_sheet([bare], model)
    assert legend(figure)[0] == "anna"
    (bones,) = figure.axes[1].collections
    assert_allclose(bones.get_colors()[0], to_rgba(BODY_COLOURS[1]))
    flat, right = contact_sheet([bare], DrawnModel("down")).axes
    assert len(right.lines[0].get_xydata()) == 8


def test_a_legend_of_one_image_is_whole(image):
    edges = np.array([[0, 1], [2, 4]])
    bare = image._replace(mesh=None, projected_mesh=None, individual=("a person", 0))
    sides = [0, 0, 1, 0, 2, 0, 0, 0]
    figure = contact_sheet([bare], DrawnModel("down", edges=edges, sides=sides))
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    whole = figure.bbox
    assert whole.x0 <= box.x0
    assert box.x1 <= whole.x1
    assert whole.y0 <= box.y0
    (said,) = figure.texts
    assert said.get_text().endswith("the shape from another side")
    words = said.get_window_extent()
    assert box.y1 <= words.y0
    assert words.y1 <= min(axes.get_window_extent().y0 for axes in figure.axes) + 1


def test_a_photograph_lies_under_the_landmarks(image, box_faces):
    from PIL import Image

    pixels = Image.new("RGB", (20, 10), "red")
    photographed = image._replace(photograph=PlacedPhotograph(pixels, (800.0, 400.0)))
    for y_axis, extent in (("down", [0, 800, 400, 0]), ("up", [0, 800, 0, 400])):
        axes = contact_sheet([photographed], DrawnModel(y_axis, box_faces)).axes[0]
        (drawn,) = axes.images
        assert drawn.get_extent() == extent
        places = inside(axes, image.landmarks[:, np.arange(8) != 3])
        assert 0 < places.min()  # the panel shows the landmarks, not the photograph
        assert places.max() < 1
        assert 0.6 < np.ptp(places, axis=0).max()


def test_why_a_shape_is_not_trusted_stands_in_red(image, box_faces):
    doubted = image._replace(doubt="large expected error")
    trusted, red = contact_sheet([image, doubted], DrawnModel("down", box_faces)).axes[
        ::3
    ]
    assert trusted._left_title.get_text() == "a"
    assert red._left_title.get_text() == "a  large expected error"
    assert (
        red._left_title.get_color() == DOUBT_COLOUR != trusted._left_title.get_color()
    )


def test_the_colours_are_those_of_the_page():
    light = resource("palette.css").partition("@media")[0]
    page = dict(re.findall(r"--([\w-]+): (#\w{6})", light))
    assert [page[f"body-{number}"] for number in range(6)] == list(BODY_COLOURS)
    named = {
        "left": LEFT_COLOUR,
        "right": RIGHT_COLOUR,
        "mesh": MESH_COLOUR,
        "ink": INK_COLOUR,
        "untrusted": DOUBT_COLOUR,
        "residual": RESIDUAL_COLOUR,
    }
    assert {name: page[name] for name in named} == named


def test_an_image_without_a_shape_says_so(image, box_faces):
    nowhere = np.full((3, 8), np.nan)
    failed = FittedImage("f", image.landmarks, nowhere, nowhere[:2])
    figure = contact_sheet([failed], DrawnModel("down", box_faces))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["no shape"]
    assert set(marks(axes)) == {"observed"}
    empty = failed._replace(landmarks=np.full((2, 8), np.nan))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (
            marks(contact_sheet([empty], DrawnModel("down", box_faces)).axes[0]) == {}
        )


def test_titles_are_taken_literally_and_of_long_ones_the_end(image, box_faces):
    titled = image._replace(title="recording_of_monday/person 1/$x^2$\n\x1b" + "0" * 50)
    title = contact_sheet([titled], DrawnModel("down")).axes[0].get_title(loc="left")
    assert title.endswith("x^2$\\n\\x1b" + "0" * 50)
    assert len(title) == 66
    odd = image._replace(title="$\\frac{$ \u4f60", doubt="$^")
    for file_format in ("png", "svg"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            save(
                contact_sheet([odd], DrawnModel("down", box_faces)),
                BytesIO(),
                file_format,
            )
