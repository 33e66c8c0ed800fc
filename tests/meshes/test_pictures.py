"""What pictures of shapes show, and where, read from matplotlib."""

import re
import warnings
from collections.abc import Callable
from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.rotations import rotation_about, rotation_about_axis
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
    draw_silhouette,
    save,
    viewer_frame,
)
from shapefit.viewer.page import resource
from tests.points import centred


@pytest.fixture
def box() -> Callable[[float, float, float], Floats]:
    """Return the function that gives the corners (3, 8) of a box around the origin.

    Corner i lies high on x, y and z where the bits 4, 2 and 1 of i are set.
    """
    bits = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])
    corners = bits - 0.5
    return lambda width, height, depth: (corners * (width, height, depth)).T


@pytest.fixture
def box_faces() -> NDArray[np.int64]:
    """Return two triangles a side, wound outwards."""
    sides = [
        [(0, 1, 3), (0, 3, 2)],
        [(4, 6, 7), (4, 7, 5)],
        [(0, 4, 5), (0, 5, 1)],
        [(2, 3, 7), (2, 7, 6)],
        [(0, 2, 6), (0, 6, 4)],
        [(1, 5, 7), (1, 7, 3)],
    ]
    return np.array(sides).reshape(12, 3)


HIDDEN = 3
OUTLIER = 5


@pytest.fixture
def image(box):
    """Eight corners of a box of which one is hidden and one an outlier, two pixels
    off.
    """
    shape = box(4, 3, 2) * 100 + 500
    landmarks = shape[:2] + 2.0
    landmarks[:, HIDDEN] = np.nan
    outliers = np.arange(8) == OUTLIER
    return FittedImage("a", landmarks, shape, shape[:2], shape, shape[:2], outliers)


@pytest.fixture
def without_mesh(image):
    """The image of one individual, by landmarks alone."""
    return image._replace(mesh=None, projected_mesh=None, individual=("anna", 1))


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
    (words,) = figure.legends
    return [text.get_text() for text in words.get_texts()]


def places_in_panel(axes, points):
    """Where (m, 2) a panel shows points (2, m), from 0 to 1."""
    return axes.transLimits.transform(points.T)


def assert_fills_panel(axes, points):
    """All points are within the panel, and take more than half of it."""
    places = places_in_panel(axes, points)
    assert places.min() > 0
    assert places.max() < 1
    assert np.ptp(places, axis=0).max() > 0.6


@pytest.mark.parametrize("y_axis", ["up", "down"])
class TestImagePanel:
    """Landmarks stand as in the image."""

    @pytest.fixture
    def figure(self, image, box_faces, y_axis):
        return contact_sheet([image], DrawnModel(y_axis, box_faces))

    @pytest.fixture
    def panel(self, figure):
        return figure.axes[0]

    def test_observed_landmarks_and_the_outlier_are_where_they_were_seen(
        self, panel, image
    ):
        found = marks(panel)
        observed = np.delete(image.landmarks, OUTLIER, axis=1)
        assert_array_equal(found["outlier"], image.landmarks[:, [OUTLIER]])
        assert_array_equal(found["observed"], observed)

    def test_a_hidden_landmark_is_where_the_model_has_it(self, panel, image):
        assert_array_equal(marks(panel)["hidden"], image.shape[:2, [HIDDEN]])

    def test_residuals_lead_to_fitted_positions(self, panel):
        (residuals,) = panel.collections
        lines = residuals.get_segments()
        assert len(lines) == 7
        for start, end in lines:
            assert_allclose(start - end, 2.0)

    def test_axes_are_those_of_the_image(self, panel, y_axis):
        assert panel.yaxis_inverted() == (y_axis == "down")
        assert panel.get_aspect() == 1

    def test_the_legend_names_what_there_is(self, figure):
        assert legend(figure) == [
            "observed",
            "hidden, from the model",
            "outlier",
            "to its fitted position",
        ]


def corners_drawn(axes):
    """Return the corners (m, 2) of the faces that a panel shows."""
    (solid,) = axes.collections
    return np.concatenate([path.vertices for path in solid.get_paths()])


def distance_to_nearest(points, others):
    """Return how far (m,) points (m, 2) are from the nearest of others (2, k)."""
    away = np.abs(points[:, :, None] - others[None])
    return away.sum(axis=1).min(axis=1)


@pytest.mark.parametrize("y_axis", ["up", "down"])
@pytest.mark.parametrize("upright", [False, True])
class TestViews:
    """Views walk around the model, which stands upright."""

    TO_OBJECT = rotation_about(np.array([0.3, 1, 0.2]), np.array([0.7]))[0].T

    @pytest.fixture
    def model(self, y_axis, box_faces):
        return DrawnModel(y_axis, box_faces)

    @pytest.fixture
    def to_upright(self, y_axis, upright):
        """From the camera, or from the frame of the object, however it is seen."""
        if upright:
            return self.TO_OBJECT
        return np.diag([1.0, 1, 1] if y_axis == "up" else [1.0, -1, -1])

    @pytest.fixture
    def seen(self, image, upright):
        return image._replace(upright=self.TO_OBJECT) if upright else image

    @pytest.mark.parametrize("turn", MESH_TURNS)
    def test_a_viewer_beside_the_model_sees_its_axes(
        self, seen, model, to_upright, turn
    ):
        tilt = rotation_about_axis(0, np.radians(np.float64(VIEW_TILT)))
        around = rotation_about_axis(1, np.radians(np.float64(turn)))
        frame = viewer_frame(seen, model, turn)
        assert_allclose(frame @ to_upright.T, tilt @ around, atol=1e-12)

    def test_each_shows_the_model_from_its_side_in_all_of_its_panel(self, seen, model):
        shape = centred(seen.shape)

        _, *sides = contact_sheet([seen], model).axes

        for axes, turn in zip(sides, MESH_TURNS, strict=True):
            expected = (viewer_frame(seen, model, turn) @ shape)[:2]
            away = distance_to_nearest(corners_drawn(axes), expected)
            assert away.max() < 1e-9
            assert_fills_panel(axes, expected)

    def test_there_are_two(self, seen, model):
        _, *sides = contact_sheet([seen], model).axes
        assert len(sides) == 2


def test_near_faces_are_drawn_over_far_ones(image, box_faces):
    """A box shows three of its six sides, two triangles each, in three shades."""
    _, *sides = contact_sheet([image], DrawnModel("down", box_faces)).axes
    for axes in sides:
        (solid,) = axes.collections
        shades = np.unique(solid.get_facecolors(), axis=0)
        assert len(solid.get_paths()) == 6
        assert len(shades) == 3


def test_of_an_open_mesh_seen_from_behind_nothing_is_drawn(image, box_faces):
    """Of one side of the box, which one of the two views does not see."""
    side = box_faces[8:10]
    _, *sides = contact_sheet([image], DrawnModel("down", side)).axes
    drawn = [len(axes.collections) for axes in sides]
    assert sorted(drawn) == [0, 1]


class TestEdges:
    """They are drawn where there is no mesh."""

    EDGES = np.array([[0, 1], [1, 3], [2, 4], [4, 5]])
    SIDES = (0, 1, 0, 1, 2, 0, 0, 0)

    @pytest.fixture
    def model(self):
        return DrawnModel("down", edges=self.EDGES, sides=list(self.SIDES))

    @pytest.fixture
    def figure(self, without_mesh, model):
        return contact_sheet([without_mesh], model)

    def test_they_join_their_landmarks_in_the_image(self, figure, image):
        flat, _ = figure.axes
        drawn, _ = flat.collections
        assert_array_equal(drawn.get_segments(), image.shape[:2].T[self.EDGES])

    def test_left_and_right_have_their_colours(self, figure):
        flat, _ = figure.axes
        drawn, _ = flat.collections
        names = [LEFT_COLOUR, LEFT_COLOUR, RIGHT_COLOUR, RIGHT_COLOUR]
        assert_allclose(drawn.get_colors(), [to_rgba(name) for name in names])
        assert legend(figure)[:2] == ["left", "right"]

    def test_the_side_view_has_them_too(self, figure):
        _, side = figure.axes
        (bones,) = side.collections
        assert len(bones.get_segments()) == len(self.EDGES)

    def test_residuals_are_thin_on_thick_bones(self, figure):
        flat, side = figure.axes
        drawn, residuals = flat.collections
        (bones,) = side.collections
        assert residuals.get_linewidths()[0] == 0.8
        assert drawn.get_linewidths()[0] == 2
        assert bones.get_linewidths()[0] == 2

    def test_without_sides_they_have_the_colour_of_the_individual(
        self, without_mesh, model
    ):
        figure = contact_sheet([without_mesh], model._replace(sides=None))
        (bones,) = figure.axes[1].collections
        assert legend(figure)[0] == "anna"
        assert_allclose(bones.get_colors()[0], to_rgba(BODY_COLOURS[1]))

    def test_without_edges_there_are_landmarks(self, without_mesh):
        _, side = contact_sheet([without_mesh], DrawnModel("down")).axes
        (points,) = side.lines
        assert len(points.get_xydata()) == 8


class TestLegendOfOneImage:
    """It stands whole between the edge of the figure and the words."""

    @pytest.fixture
    def figure(self, without_mesh):
        named = without_mesh._replace(individual=("a person", 0))
        edges = np.array([[0, 1], [2, 4]])
        sides = [0, 0, 1, 0, 2, 0, 0, 0]
        figure = contact_sheet([named], DrawnModel("down", edges=edges, sides=sides))
        figure.canvas.draw()
        return figure

    @pytest.fixture
    def place(self, figure):
        (legend,) = figure.legends
        return legend.get_window_extent()

    def test_it_is_within_the_figure(self, figure, place):
        whole = figure.bbox
        assert whole.x0 <= place.x0
        assert place.x1 <= whole.x1
        assert whole.y0 <= place.y0

    def test_words_are_above_it_and_below_the_panels(self, figure, place):
        (words,) = figure.texts
        extent = words.get_window_extent()
        panels = [axes.get_window_extent() for axes in figure.axes]
        lowest = min(panel.y0 for panel in panels)
        assert words.get_text().endswith("the shape from another side")
        assert place.y1 <= extent.y0
        assert extent.y1 <= lowest + 1


@pytest.mark.parametrize(
    ("y_axis", "extent"), [("down", [0, 800, 400, 0]), ("up", [0, 800, 0, 400])]
)
def test_a_photograph_lies_under_the_landmarks(image, box_faces, y_axis, extent):
    """The panel shows the landmarks, not all of the photograph."""
    from PIL import Image

    pixels = Image.new("RGB", (20, 10), "red")
    photographed = image._replace(photograph=PlacedPhotograph(pixels, (800.0, 400.0)))

    panel, *_ = contact_sheet([photographed], DrawnModel(y_axis, box_faces)).axes

    (drawn,) = panel.images
    assert drawn.get_extent() == extent
    assert_fills_panel(panel, np.delete(image.landmarks, HIDDEN, axis=1))


def test_why_a_shape_is_not_trusted_stands_in_red(image, box_faces):
    doubted = image._replace(doubt="large expected error")

    panels = contact_sheet([image, doubted], DrawnModel("down", box_faces)).axes

    trusted = panels[0]._left_title
    red = panels[3]._left_title
    assert trusted.get_text() == "a"
    assert trusted.get_color() != DOUBT_COLOUR
    assert red.get_text() == "a  large expected error"
    assert red.get_color() == DOUBT_COLOUR


class TestColours:
    """They are those of the page."""

    @pytest.fixture
    def page(self):
        """Name -> colour, in light."""
        light, _, _ = resource("palette.css").partition("@media")
        return dict(re.findall(r"--([\w-]+): (#\w{6})", light))

    def test_those_of_bodies(self, page):
        assert [page[f"body-{number}"] for number in range(6)] == list(BODY_COLOURS)

    @pytest.mark.parametrize(
        ("name", "colour"),
        [
            ("left", LEFT_COLOUR),
            ("right", RIGHT_COLOUR),
            ("mesh", MESH_COLOUR),
            ("ink", INK_COLOUR),
            ("untrusted", DOUBT_COLOUR),
            ("residual", RESIDUAL_COLOUR),
        ],
    )
    def test_those_with_names(self, page, name, colour):
        assert page[name] == colour


@pytest.fixture
def failed(image):
    """An image without a shape."""
    nowhere = np.full((3, 8), np.nan)
    return FittedImage("f", image.landmarks, nowhere, nowhere[:2])


def test_an_image_without_a_shape_says_so(failed, box_faces):
    (panel,) = contact_sheet([failed], DrawnModel("down", box_faces)).axes
    assert [text.get_text() for text in panel.texts] == ["no shape"]
    assert set(marks(panel)) == {"observed"}


def test_that_there_is_no_shape_stands_in_the_middle(failed, box_faces):
    """Of the panel, however far from the origin the landmarks are."""
    (panel,) = contact_sheet([failed], DrawnModel("down", box_faces)).axes
    (words,) = panel.texts
    box = panel.get_window_extent()
    extent = words.get_window_extent()
    low, high = (extent.corners() - box.corners()[0])[[0, 3]] / box.size
    assert low[0] > 0
    assert high[0] < 1
    assert (low + high)[0] / 2 == pytest.approx(0.5, abs=0.01)
    assert low[1] < 0.6
    assert high[1] > 0.4


@pytest.fixture
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.usefixtures("no_warnings")
def test_an_image_without_landmarks_has_no_marks(failed, box_faces):
    empty = failed._replace(landmarks=np.full((2, 8), np.nan))
    panel, *_ = contact_sheet([empty], DrawnModel("down", box_faces)).axes
    assert marks(panel) == {}


def title_of(image):
    (panel, *_) = contact_sheet([image], DrawnModel("down")).axes
    return panel.get_title(loc="left")


def test_of_a_long_title_as_much_is_cut_as_the_doubt_needs(image):
    long = image._replace(title="0" * 90 + "end")
    doubted = long._replace(doubt="large expected error")
    assert title_of(doubted).endswith("000end  large expected error")
    assert len(title_of(doubted)) == len(title_of(long))


def test_a_doubt_of_any_length_leaves_the_end_of_the_title(image):
    long = image._replace(title="0" * 90 + "end", doubt="large " * 30)
    assert title_of(long).startswith("00000end  large large ")
    assert len(title_of(long)) == len(title_of(long._replace(doubt="")))


NEAR_AND_FAR = {"down": (8, 10), "up": (10, 8)}
"""Direction of y -> the first of two faces near the viewer, and of two far from it: z
points away from the camera where y points down.
"""


@pytest.mark.parametrize("y_axis", NEAR_AND_FAR)
def test_the_silhouette_is_of_faces_that_look_at_the_viewer(image, box_faces, y_axis):
    near, far = (box_faces[first : first + 2] for first in NEAR_AND_FAR[y_axis])

    def corners_of(faces):
        axes = Figure().subplots()
        draw_silhouette(axes, image.projected_mesh, DrawnModel(y_axis, faces))
        (patch,) = [each for each in axes.get_children() if isinstance(each, PathPatch)]
        return len(patch.get_path().vertices)

    assert corners_of(near) == 2 * 4
    assert corners_of(far) == 0


def test_titles_are_taken_literally_and_of_long_ones_the_end(image):
    long = "recording_of_monday/person 1/$x^2$\n\x1b" + "0" * 50
    titled = image._replace(title=long)

    panel, *_ = contact_sheet([titled], DrawnModel("down")).axes

    title = panel.get_title(loc="left")
    assert title.endswith("x^2$\\n\\x1b" + "0" * 50)
    assert len(title) == 66


@pytest.mark.parametrize("file_format", ["png", "svg"])
@pytest.mark.usefixtures("no_warnings")
def test_odd_titles_are_drawn(image, box_faces, file_format):
    """No formula is looked for in them, and a sign that the font lacks is no matter."""
    odd = image._replace(title="$\\frac{$ \u4f60", doubt="$^")
    figure = contact_sheet([odd], DrawnModel("down", box_faces))
    save(figure, BytesIO(), file_format)
