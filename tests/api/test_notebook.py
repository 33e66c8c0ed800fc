"""A fit in a notebook: picture, plot and page; progress, and what is warned of."""

import html
import re
import sys
import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import shapefit
from shapefit.api.notebook import MAX_DRAWN_IMAGES, as_html
from shapefit.io.skeletons import installed_skeletons


@pytest.fixture(scope="module")
def keypoints(project):
    """One person (36, 25, 2) of the sample walk."""
    folder = project / "sample_data/openpose"
    walk = shapefit.read_landmarks(folder, keypoints="body_25", track="nearest")
    return np.asarray(walk.landmarks)[:36]


def picture_in(html_text):
    """Return the picture in HTML, as a tree."""
    return ET.fromstring(re.search("<svg.*</svg>", html_text)[0])


@pytest.fixture(scope="module")
def walk(keypoints):
    return shapefit.fit(keypoints, keypoints="body_25", frame_rate=25)


def test_a_fit_has_a_picture_and_a_table_of_about_10_kb(walk):
    shown = walk._repr_html_()
    assert len(shown) < 15_000
    assert "<td><code>shape_sd</code></td><td>(36, 21, 3)</td>" in shown


def test_the_picture_has_some_of_the_images(walk):
    picture = picture_in(walk._repr_html_())
    titles = [place.findtext(".//title") for place in picture.findall("g")]
    heights = [float(circle.get("cy")) for circle in picture.iter("circle")]
    assert titles == [f"landmarks/{row}" for row in (0, 7, 14, 21, 28, 35)]
    assert len(titles) == MAX_DRAWN_IMAGES
    assert min(heights) > 0
    assert max(heights) < 110


def test_images_that_are_not_trusted_are_faint(walk):
    first_in_doubt = walk.replaced(trusted=np.arange(36) > 0)
    places = picture_in(first_in_doubt._repr_html_()).findall("g")
    faint = [place.find("g").get("opacity") is not None for place in places]
    assert faint == [True, *[False] * 5]


@pytest.fixture(params=["up", "down"])
def one_image(request, walk):
    """The first image of the walk, with y in one of both directions."""
    turn = np.array([1, -1, -1]) if request.param == "up" else 1
    return walk.replaced(shapes=walk.shapes * turn, y_axis=request.param)[:1]


def test_heads_are_above_in_the_picture(one_image):
    head = one_image.landmark_names.index("head")
    foot = one_image.landmark_names.index("rankle")
    circles = [*picture_in(as_html(one_image)).iter("circle")]
    height_of_head = float(circles[head].get("cy"))
    height_of_foot = float(circles[foot].get("cy"))
    assert height_of_head < height_of_foot - 20


def test_heads_are_above_in_the_plot(one_image, walk):
    pytest.importorskip("matplotlib").use("svg")
    head = one_image.landmark_names.index("head")
    foot = one_image.landmark_names.index("rankle")
    axes = one_image.plot()
    _, depth, y = axes.collections[0]._offsets3d
    points_down = y[foot] > y[head] + 20
    assert axes.get_title() == "landmarks/0"
    assert axes.zaxis_inverted() == (one_image.y_axis == "down")
    assert axes.zaxis_inverted() == points_down
    assert_array_equal(depth, walk.shapes[0, :, 2])


def test_a_plot_has_error_bars_and_may_have_several_images(one_image, walk):
    pytest.importorskip("matplotlib").use("svg")
    axes = one_image.plot()
    assert len(axes.lines) >= one_image.shape_sd.size
    both = walk.plot(1, one_image.plot(0, axes))
    assert both.zaxis_inverted()


def test_what_has_no_shape_or_trust_is_shown_with_its_name(walk):
    names = tuple(f"<{name}>" for name in walk.items[:2])
    unknown = np.full((2, 21, 3), np.nan)
    empty = walk[:2].replaced(items=names, shapes=unknown, trusted=None, shape_sd=None)
    shown = empty._repr_html_()
    picture_in(shown)
    assert "&lt;landmarks/0&gt;" in shown


def test_a_fit_of_no_image_has_no_picture(walk):
    assert "<svg" not in walk[:0]._repr_html_()


def test_landmarks_without_names_are_one_line():
    unnamed = shapefit.Landmarks(np.ones((1, 4, 2)))
    assert repr(unnamed) == "<shapefit.Landmarks: 1 item, 4 landmarks, in unknown>"


@pytest.mark.parametrize("image", [36, "walk", -37])
def test_a_plot_of_no_image_is_refused(walk, image):
    with pytest.raises(shapefit.InputError, match=f"no image {image!r}; give"):
        walk.plot(image)


@pytest.fixture(scope="module")
def page(walk):
    return walk.view()


def test_the_page_is_in_a_sandboxed_frame(page):
    frame = page._repr_html_()
    source = re.search('srcdoc="([^"]*)"', frame)[1]
    assert page.path is None
    assert repr(page).startswith("<shapefit.Page: 0.")
    assert frame.startswith('<iframe sandbox="allow-scripts" ')
    assert html.unescape(source) == page.html
    assert "<html" in page.html[:200]


def test_a_page_is_saved_as_it_is_shown(walk, page, tmp_path):
    path = tmp_path / "walk.html"
    saved = walk.view(path)
    assert saved.path == path
    assert path.read_text(encoding="utf-8") == page.html


def test_a_page_without_a_file_is_not_opened(walk):
    with pytest.raises(shapefit.InputError, match=r"view\.open: a browser shows a fi"):
        walk.view(open=True)


def test_progress_is_shown_and_changes_neither_result_nor_warnings(
    keypoints, walk, capsys
):
    before = [*warnings.filters]
    fit = shapefit.fit(keypoints, keypoints="body_25", frame_rate=25, progress=True)
    assert warnings.filters == before
    assert_array_equal(fit.shapes, walk.shapes)
    assert re.search(r"shapefit: 100%.* 36/36 ", capsys.readouterr().err)


def test_progress_of_learning_is_shown_where_it_is_asked_for(walk, capsys):
    shapes = shapefit.Shapes(walk.shapes, landmark_names=walk.landmark_names)
    shapefit.learn(shapes, k=3, iterations=2, progress=True)
    assert "2/2 " in capsys.readouterr().err
    shapefit.learn(shapes, k=3, iterations=2)
    assert not capsys.readouterr().err


def test_landmarks_that_are_left_out_are_warned_of():
    """As those of hands and face."""
    names = installed_skeletons()["coco_133"].landmark_names
    body = np.random.default_rng(0).normal(300, 50, (4, 17, 2))
    whole = np.full((4, len(names), 2), np.nan)
    whole[:, :17] = body
    with pytest.warns(UserWarning, match=r"11\d landmarks left out, which the dict"):
        shapefit.fit(whole, keypoints="coco_133")


def test_atoms_of_another_scale_are_warned_of(keypoints):
    people = shapefit.read_dictionary("people")
    atoms = 1000 * people.atoms[:, :15]
    large = shapefit.Dictionary(atoms, landmark_names=people.landmark_names[:15])
    with pytest.warns(UserWarning, match=r"the atoms have a norm of .*e\+03") as caught:
        shapefit.fit(keypoints[:2], large, keypoints="body_25")
    assert {warning.filename for warning in caught} == {__file__}


def test_a_dictionary_says_what_it_is():
    people = shapefit.read_dictionary("people")
    sizes = "64 atoms, 24 landmarks, a prior of 32 components"
    assert repr(people) == f"<shapefit.Dictionary: {sizes}, in m>"


def test_an_optimum_says_what_it_is(walk):
    atoms = np.moveaxis(shapefit.read_dictionary("people").atoms, 1, 2)
    images = np.moveaxis(walk.landmarks[:2], 1, 2)
    known = np.flatnonzero(np.isfinite(images).all(axis=(0, 1)))
    optimum = shapefit.solve(images[..., known], atoms[..., known], 1.0)
    line = r"2 images, at most \d+ of 64 atoms, optimal, gap .*e-.*"
    assert re.fullmatch(rf"<shapefit\.Optimum: {line}>", repr(optimum))


def test_an_evaluation_says_what_it_is(walk):
    errors = shapefit.evaluate(walk, walk.shapes, metrics=["similarity"])
    assert repr(errors).startswith("<shapefit.Evaluation: 36 images, similarity ")


def test_a_library_that_is_missing_is_named(walk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(shapefit.InputError, match="run `pip install matplotlib`"):
        walk.plot()


@pytest.mark.slow
def test_a_dataset_of_xarray_has_named_axes(walk):
    pytest.importorskip("xarray")
    dataset = walk.to_xarray()
    head = walk.landmark_names.index("head")
    picked = dataset.shapes.sel(item="landmarks/3", landmark="head", space="y")
    assert float(picked) == walk.shapes[3, head, 1]
    assert dataset.landmarks.dims == ("item", "landmark", "plane")
    assert dataset.trusted.dims == ("item",)
    assert dataset.attrs == {"unit": "unknown", "y_axis": "down", "frame_rate": 25}


@pytest.fixture
def without_cluster():
    """Writing takes no lock from a cluster of other tests that has ended."""
    config = pytest.importorskip("dask.config")
    with config.set(scheduler="synchronous"):
        yield


@pytest.mark.slow
def test_a_dataset_of_xarray_is_written(walk, tmp_path, without_cluster):
    xarray = pytest.importorskip("xarray")
    path = tmp_path / "fit.nc"
    walk.to_xarray().to_netcdf(path, engine="h5netcdf")
    with xarray.open_dataset(path, engine="h5netcdf") as again:
        assert_array_equal(again.shapes, walk.shapes)
