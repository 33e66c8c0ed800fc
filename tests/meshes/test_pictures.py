import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.image import imread

from shapefit.evaluation.plots import save
from shapefit.geometry.rotations import rotation_about
from shapefit.meshes import panels
from shapefit.meshes.pictures import (
    FittedImage,
    Model,
    Pose,
    contact_sheet,
    fit_picture,
    skeleton_picture,
)
from shapefit.meshes.views import View

EDGES = np.array([[0, 1], [1, 3], [3, 2]])


@pytest.fixture
def image(box) -> FittedImage:
    """A box 4 wide, 3 high, 2 deep around (10, 20): corner 2 is hidden, corner 4 an outlier."""
    shape = box(4, 3, 2) + np.array([[10.0], [20], [0]])
    landmarks = shape[:2].copy()
    landmarks[:, 2] = np.nan
    landmarks[:, 4] += (3, -1)
    outliers = np.arange(8) == 4
    return FittedImage("box", landmarks, shape, shape, outliers)


def marks(axes):
    """Return colour -> the points (x, y) of the marks on the axes, sorted."""
    found = {}
    for line in axes.lines:
        points = np.transpose(line.get_data())
        points = points[np.isfinite(points).all(axis=1)]
        found[to_rgba(line.get_color())] = sorted(map(tuple, points))
    return found


def corners(points, which):
    return sorted(map(tuple, points[:2, which].T))


@pytest.mark.parametrize(("y_axis", "sign"), [("up", 1), ("down", -1)])
def test_landmarks_are_marked_as_seen_hidden_or_outliers(y_axis, sign, image, box_faces):
    figure = fit_picture([image], Model(y_axis, box_faces))
    plain, over = figure.axes[:2]
    flip = np.array([[1], [sign]])
    seen = corners(flip * image.landmarks, [0, 1, 3, 5, 6, 7])
    outlier = corners(flip * image.landmarks, [4])
    hidden = corners(flip * image.shape[:2], [2])
    assert marks(plain)[to_rgba(panels.SEEN)] == seen
    assert marks(plain)[to_rgba(panels.OUTLIER)] == outlier
    assert to_rgba(panels.HIDDEN) not in marks(plain)
    assert marks(over)[to_rgba(panels.HIDDEN)] == hidden
    assert marks(over)[to_rgba(panels.OUTLIER)] == outlier


def test_lines_lead_from_the_landmarks_to_the_model(image, box_faces):
    over = fit_picture([image], Model("up", box_faces)).axes[1]
    (lines,) = (
        c.get_segments() for c in over.collections
        if isinstance(c, LineCollection) and c.get_zorder() == 4
    )  # fmt: skip
    assert len(lines) == 7  # the seen ones
    lengths = sorted(np.linalg.norm(line[1] - line[0]) for line in lines)
    assert lengths == pytest.approx([0] * 6 + [10**0.5])


def pixels(figure, axes, points):
    """Return the colours (m, 3) that the figure shows at points (m, 2) of the axes."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    buffer = np.asarray(canvas.buffer_rgba())[..., :3] / 255
    x, y = axes.transData.transform(points).round().astype(int).T
    return buffer[len(buffer) - 1 - y, x]


@pytest.mark.parametrize("sheet", [False, True])
def test_the_mesh_is_painted_where_it_is(sheet, image, box_faces):
    image = replace(image, landmarks=np.full((2, 8), np.nan), outliers=None)
    model = Model("up", box_faces)
    figure = contact_sheet([image], model) if sheet else fit_picture([image], model)
    over = figure.axes[0 if sheet else 1]
    inside = [(8.3, 19), (11.7, 21), (10, 20.5)]
    outside = [(7.8, 20), (12.2, 20), (10, 18.3), (10, 21.7)]
    assert (pixels(figure, over, inside) < 0.99).all()
    np.testing.assert_array_equal(pixels(figure, over, outside), 1)


def test_one_unit_is_as_long_up_as_across_in_every_panel(image, box_faces):
    pose = Pose("box", image.landmarks, {"estimate": image.shape})
    figures = [
        fit_picture([image] * 2, Model("down", box_faces)),
        contact_sheet([image] * 5, Model("down", box_faces)),
        skeleton_picture([pose], EDGES, "up"),
    ]
    for figure in figures:
        FigureCanvasAgg(figure).draw()
        for axes in (axes for axes in figure.axes if axes.collections):
            (x0, y0), (x1, y1) = axes.transData.transform([(0, 0), (1, 1)])
            assert x1 - x0 == pytest.approx(y1 - y0)
            # without shrinking the panel
            np.testing.assert_allclose(axes.get_position(), axes.get_position(original=True))
    # all there is to see lies within the panel
    for axes in figures[0].axes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        for collection in axes.collections:
            for path in collection.get_paths():
                assert (path.vertices >= (left, low)).all()
                assert (path.vertices <= (right, high)).all()


def triangles(axes):
    (mesh,) = (c for c in axes.collections if isinstance(c, PolyCollection))
    return np.array([path.vertices[:3] for path in mesh.get_paths()])


def extent(points):
    flat = points.reshape(-1, 2)
    return flat.max(axis=0) - flat.min(axis=0)


def test_the_overlay_shows_the_model_where_the_camera_sees_it(image, box, box_faces):
    seen = box(5, 4, 1) + np.array([[20.0], [30], [0]])
    side = [View(90, 0)]
    elsewhere = replace(image, seen_shape=seen, seen_mesh=seen)
    plain, other = (fit_picture([i], Model("up", box_faces), side) for i in (image, elsewhere))
    np.testing.assert_allclose(extent(triangles(plain.axes[1])), [4, 3])
    np.testing.assert_allclose(extent(triangles(other.axes[1])), [5, 4])
    np.testing.assert_array_equal(triangles(plain.axes[2]), triangles(other.axes[2]))
    assert marks(other.axes[1])[to_rgba(panels.HIDDEN)] == corners(seen, [2])
    # both panels show the landmarks in one place, with room for the model
    for axes in other.axes[:2]:
        assert axes.get_xlim() == other.axes[0].get_xlim()
        assert axes.get_xlim()[0] < 8 < 22.5 < axes.get_xlim()[1]


def test_edges_are_drawn_where_the_camera_sees_them(image, box):
    seen = box(5, 4, 1)
    elsewhere = replace(image, mesh_vertices=None, seen_shape=seen)
    figure = fit_picture([elsewhere], Model("up", edges=EDGES))
    over, novel = (
        np.array(next(c for c in axes.collections if c.get_zorder() == 3).get_segments())
        for axes in figure.axes[1:3]
    )
    np.testing.assert_allclose(extent(over), extent(seen.T[EDGES][..., :2]))
    assert np.abs(novel).max() > 10  # around (10, 20), where the shape is


def test_novel_views_walk_around_the_mesh(image, box_faces):
    side, top = View(90, 0), View(0, 90)
    axes = fit_picture([image], Model("down", box_faces), [side, top]).axes
    np.testing.assert_allclose(extent(triangles(axes[1])), [4, 3])
    np.testing.assert_allclose(extent(triangles(axes[2])), [2, 3])
    np.testing.assert_allclose(extent(triangles(axes[3])), [4, 2])
    assert [a.get_title() for a in axes] == [
        "landmarks",
        "fitted model",
        "turned by +90°",
        "turned by +0°",
    ]


@pytest.mark.parametrize(("y_axis", "half_turns"), [("up", 0), ("down", 1)])
def test_novel_views_stand_upright_where_the_rotation_is_known(
    y_axis, half_turns, image, box, box_faces
):
    pyramid = box(4, 3, 2)
    top = pyramid[1] > 0
    pyramid[::2, top] = 0
    angles = np.array([0.4 + half_turns * np.pi])
    rotation = rotation_about(np.array([1.0, 0, 0]), angles)[0]
    tilted = replace(image, shape=rotation @ pyramid, mesh_vertices=rotation @ pyramid)
    model, view = Model(y_axis, box_faces), [View(90, 0)]
    known = fit_picture([replace(tilted, rotation=rotation)], model, view)
    faces = triangles(known.axes[2])
    np.testing.assert_allclose(extent(faces), [2, 3])
    summit = faces[faces[..., 1] > 0]
    np.testing.assert_allclose(summit, np.tile([0, 1.5], (len(summit), 1)), atol=1e-12)
    unknown = fit_picture([tilted], model, view)
    assert abs(extent(triangles(unknown.axes[2]))[1] - 3) > 0.1


def test_edges_are_drawn_where_there_is_no_mesh(image):
    figure = fit_picture([replace(image, mesh_vertices=None)], Model("up", edges=EDGES))
    for axes, zorder in zip(figure.axes[1:], (3, 3, 3), strict=True):
        (lines,) = (c for c in axes.collections if c.get_zorder() == zorder)
        assert len(lines.get_segments()) == len(EDGES)
    bare = fit_picture([replace(image, mesh_vertices=None)], Model("up"))
    assert len(marks(bare.axes[2])[to_rgba(panels.SEEN)]) == 8


def test_the_nearest_edge_is_drawn_last_and_darkest(image):
    figure = fit_picture([replace(image, mesh_vertices=None)], Model("up", edges=EDGES))
    (lines,) = (c for c in figure.axes[2].collections if c.get_zorder() == 3)
    darkness = -lines.get_colors()[:, :3].sum(axis=1)
    assert (np.diff(darkness) > 0).all()
    np.testing.assert_allclose(lines.get_colors()[-1, :3], panels.NEAR)
    assert (np.diff(lines.get_linewidths()) > 0).all()


def test_an_image_whose_fit_failed_says_so(image, box_faces):
    nothing = np.full((3, 8), np.nan)
    failed = replace(image, shape=nothing, mesh_vertices=nothing, rotation=np.full((3, 3), np.nan))
    model = Model("down", box_faces)
    for figure in (fit_picture([failed, image], model), contact_sheet([failed, image], model)):
        FigureCanvasAgg(figure).draw()
        said = [[text.get_text() for text in axes.texts] for axes in figure.axes]
        assert any(axes.lines for axes in figure.axes)
        if len(figure.axes) == 8:  # rows: landmarks, fitted model, two views
            assert said[:4] == [["box"], ["no shape"], ["no shape"], ["no shape"]]
            assert said[4:] == [["box"], [], [], []]
        else:
            assert said == [[], ["no shape"], [], []]


def test_the_contact_sheet_has_every_image_and_no_more(image, box_faces):
    images = [replace(image, title=f"box {i}") for i in range(6)]
    figure = contact_sheet(images, Model("up", box_faces))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title for title in titles if title] == [image.title for image in images]
    drawn = [axes for axes in figure.axes if axes.collections]
    assert len(drawn) == 12
    assert len(figure.axes) == 16


def test_titles_are_taken_literally_and_long_ones_without_their_middle(image, box_faces):
    titles = ["a$b_{$", f"walk{'x' * 80}/0007", "two\nlines\x00 \udc80", "été/日本🚗 x"]
    images = [replace(image, title=title) for title in titles]
    rows, sheet = (draw(images, Model("up", box_faces)) for draw in (fit_picture, contact_sheet))
    names = [text.get_text() for axes in rows.axes for text in axes.texts]
    heads = [axes.get_title(loc="left") for axes in sheet.axes]
    for found, letters in ((names, 32), ([head for head in heads if head], 40)):
        assert found[0] == "a$b_{$"
        assert len(found[1]) == letters
        assert found[1].startswith("walkxx")
        assert "xx…xx" in found[1]
        assert found[1].endswith("xx/0007")
        assert found[2] == r"two\nlines\x00 \udc80"
        assert found[3] == "été/日本🚗 x"


def test_titles_of_a_contact_sheet_keep_to_their_image(image, box_faces):
    images = [replace(image, title="Sedan_of_somebody-else/" * 4 + f"{i}") for i in range(4)]
    figure = contact_sheet(images, Model("up", box_faces))
    FigureCanvasAgg(figure).draw()
    ends = [
        (axes.get_window_extent().x0, axes._left_title.get_window_extent().x1)
        for axes in figure.axes[::2]
    ]
    starts = [start for start, _ in ends]
    assert len(starts) == 4
    for (_, end), start in zip(ends, [*starts[1:], figure.bbox.x1], strict=False):
        assert end < start


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_the_legend_explains_what_is_drawn_and_no_more(image, box, box_faces):
    seen, hidden = "seen", "hidden, from the model"
    outlier, line = "judged outlier", "to the model"
    whole = box(4, 3, 2)[:2] + np.array([[10.0], [20]])
    nothing = np.full((3, 8), np.nan)
    cases = [
        ([image], [seen, hidden, outlier, line]),
        ([replace(image, outliers=None)], [seen, hidden, line]),
        ([replace(image, outliers=np.zeros(8, dtype=bool))], [seen, hidden, line]),
        ([replace(image, outliers=None, landmarks=whole)], [seen, line]),
        ([replace(image, outliers=np.ones(8, dtype=bool))], [hidden, outlier, line]),
        ([replace(image, outliers=None, shape=nothing)], [seen]),
        ([replace(image, outliers=None, landmarks=np.full((2, 8), np.nan))], [hidden]),
        ([replace(image, landmarks=whole, outliers=None), image], [seen, hidden, outlier, line]),
    ]
    for images, expected in cases:
        for draw in (fit_picture, contact_sheet):
            for faces, edges in ((box_faces, None), (None, EDGES), (None, None)):
                assert legend(draw(images, Model("up", faces, edges))) == expected


def test_skeletons_are_seen_from_the_same_side(image, box):
    shape = box(4, 3, 2)
    landmarks = shape[:2].copy()
    landmarks[:, 0] = np.nan
    pose = Pose("frame 1", landmarks, {"convex": 100 * shape, "truth": shape})
    figure = skeleton_picture([pose, pose], EDGES, "up", View(90, 0))
    assert [axes.get_title() for axes in figure.axes[:3]] == ["landmarks", "convex", "truth"]
    flat, convex, truth = (np.array(axes.collections[0].get_segments()) for axes in figure.axes[:3])
    assert len(flat) == 2  # one edge ends at the hidden landmark
    np.testing.assert_allclose(convex, 100 * truth, atol=1e-12)
    # seen from the left, what was deep lies across
    expected = np.sort(shape.T[EDGES][..., 2].ravel())
    np.testing.assert_allclose(np.sort(truth[..., 0].ravel()), expected, atol=1e-12)


@pytest.mark.real_data
def test_pictures_of_real_cars_are_files_that_open(cars, tmp_path):
    turn = View(30, 10).rotation() * np.array([[1.0], [-1], [-1]])
    images = []
    for shape, mesh in zip(cars.shapes[:3], cars.mesh_vertices[:3], strict=True):
        landmarks = (turn @ shape)[:2]
        landmarks[:, ::2] = np.nan
        images.append(FittedImage("car", landmarks, turn @ shape, turn @ mesh, None, turn))
    model = Model("down", cars.mesh_faces)
    for name, figure in (
        ("rows", fit_picture(images[:1], model)),
        ("sheet", contact_sheet(images, model)),
    ):
        png, svg = tmp_path / f"{name}.png", tmp_path / f"{name}.svg"
        save(figure, png, "png")
        save(figure, svg, "svg")
        colours = imread(png)
        assert min(colours.shape[:2]) > 150
        assert (colours[..., :3] < 0.9).any(axis=-1).mean() > 0.1
        tree = ElementTree.parse(svg)
        embedded = tree.findall(".//{http://www.w3.org/2000/svg}image")
        assert bool(embedded) == (name == "sheet")
        assert svg.stat().st_size < 2_000_000


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("file_format", ["png", "svg"])
def test_letters_that_the_font_lacks_give_no_warning(tmp_path, image, box_faces, file_format):
    odd = replace(image, title="été/日本🚗 x")
    save(fit_picture([odd], Model("up", box_faces)), tmp_path / "picture", file_format)
    assert (tmp_path / "picture").stat().st_size > 1000


def test_pictures_need_no_screen_and_no_pyplot():
    script = """
import sys
import shapefit.meshes.dense, shapefit.meshes.export, shapefit.meshes.pictures as pictures
assert not {"matplotlib", "trimesh"} & set(sys.modules)
import numpy as np
shape = np.eye(3)
image = pictures.FittedImage("a", shape[:2], shape)
pictures.fit_picture([image], pictures.Model("up", edges=np.array([[0, 1]])))
assert "matplotlib" in sys.modules and "matplotlib.pyplot" not in sys.modules
"""
    environment = {"PATH": "", "MPLBACKEND": "TkAgg"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, check=False)
    assert done.returncode == 0
