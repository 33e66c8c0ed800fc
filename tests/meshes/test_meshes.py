"""Dense vertices follow the landmarks; what pictures show, and where, read from
matplotlib.
"""

import warnings
from collections.abc import Callable
from io import BytesIO

import numpy as np
import pytest
from mpl_toolkits.mplot3d import proj3d
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
    IN_AXES,
    DrawnModel,
    FittedImage,
    contact_sheet,
    save,
)


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
    np.testing.assert_allclose(carried, alignment.shapes, atol=1e-13)


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
    np.testing.assert_array_equal(np.isnan(factor), [True, False])


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
    """The marks of a panel by their word in the legend, (2, m)."""
    return {line.get_label(): line.get_xydata().T for line in axes.lines}


def on_screen(axes, points):
    """Where (2, p) a panel in 3D shows points (3, p) of its frame: right and up."""
    x, y, _ = proj3d.proj_transform(*points, axes.get_proj())
    return np.stack([x, y])


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_landmarks_stand_as_in_the_image(y_axis, image, box_faces):
    axes = contact_sheet([image], DrawnModel(y_axis, box_faces)).axes[0]
    found = marks(axes)
    np.testing.assert_array_equal(found["judged outlier"], image.landmarks[:, [5]])
    np.testing.assert_array_equal(found["hidden, from the model"], image.shape[:2, [3]])
    np.testing.assert_array_equal(
        found["seen"], image.landmarks[:, [0, 1, 2, 3, 4, 6, 7]]
    )
    assert axes.yaxis_inverted() == (y_axis == "down")
    assert axes.get_aspect() == 1
    assert axes.figure.legends[0].get_window_extent().y1 < axes.get_window_extent().y0
    lines = next(
        c for c in axes.collections if c.get_label() == "to the model"
    ).get_segments()
    assert len(lines) == 7
    for line in lines:
        np.testing.assert_allclose(line[0] - line[1], 2.0)


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_novel_views_walk_around_the_model_which_stands_upright(
    y_axis, image, box_faces
):
    _, right = contact_sheet([image], DrawnModel(y_axis, box_faces)).axes
    corner = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    flip = np.array([1.0, 1, 1] if y_axis == "up" else [1.0, -1, -1])[:, None]
    viewer = flip * corner  # x right, y up, z towards the viewer
    frame = IN_AXES @ np.diag(flip.ravel())
    tilt, turn = (
        rotation_about(np.eye(3)[a], np.radians([d]))[0] for a, d in ((0, 15), (1, 60))
    )
    expected = (tilt @ turn @ viewer)[:2]
    middle = frame @ np.full((3, 1), 500.0)
    shown = on_screen(right, middle + frame @ corner) - on_screen(right, middle)
    inside = np.ptp(
        right.transLimits.transform(on_screen(right, frame @ image.shape).T), axis=0
    )
    assert 0.6 < inside.max() < 1  # of the panel
    shown *= np.linalg.norm(expected) / np.linalg.norm(shown)
    np.testing.assert_allclose(shown, expected, atol=1e-9)


def test_edges_are_drawn_where_there_is_no_mesh(image):
    edges = np.array([[0, 1], [1, 3]])
    bare = image._replace(mesh=None, projected_mesh=None)
    flat, right = contact_sheet([bare], DrawnModel("down", edges=edges)).axes
    drawn, residuals = flat.collections
    np.testing.assert_array_equal(drawn.get_segments(), image.shape[:2].T[edges])
    (bones,) = right.collections
    in_axes = image.shape.T[:, [0, 2, 1]] * [1, 1, -1]  # right, away, up
    np.testing.assert_array_equal(bones._segments3d, in_axes[edges])
    widths = [lines.get_linewidths()[0] for lines in (residuals, drawn, bones)]
    assert widths == [0.8, 1.5, 1.5]  # thin residuals on thick bones
    flat, right = contact_sheet([bare], DrawnModel("down")).axes
    ring = next(
        line for line in flat.lines if line.get_label() == "hidden, from the model"
    )
    assert (
        4 * ring.get_markeredgewidth()
        == ring.get_markersize()
        < right.lines[0].get_markersize()
    )
    assert right.lines[0].get_markersize() < 4


def test_an_image_without_a_shape_says_so(image, box_faces):
    nowhere = np.full((3, 8), np.nan)
    failed = FittedImage("f", image.landmarks, nowhere, nowhere[:2])
    figure = contact_sheet([failed], DrawnModel("down", box_faces))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["no shape"]
    assert set(marks(axes)) == {"seen"}
    empty = failed._replace(landmarks=np.full((2, 8), np.nan))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (
            marks(contact_sheet([empty], DrawnModel("down", box_faces)).axes[0]) == {}
        )


def test_titles_are_taken_literally_and_of_long_ones_the_end(image, box_faces):
    titled = image._replace(title="recording_of_monday/person 1/$x^2$\n\x1b" + "0" * 30)
    titles = contact_sheet([titled], DrawnModel("down")).axes[0].get_title(loc="left")
    assert titles == "x^2$\\n\\x1b" + "0" * 30
    odd = image._replace(title="$\\frac{$ \u4f60")
    for file_format in ("png", "svg"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            save(
                contact_sheet([odd], DrawnModel("down", box_faces)),
                BytesIO(),
                file_format,
            )
