"""A fit in a notebook: picture, plot and page; progress, and what is warned of."""

import html
import re
import sys
import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import shapefit
from shapefit.api.notebook import MAX_DRAWN_IMAGES, as_html
from shapefit.io.skeletons import installed_skeletons


@pytest.fixture(scope="module")
def keypoints(project):
    """One person (36, 25, 2) of the sample walk."""
    walk = shapefit.read_landmarks(
        project / "sample_data/openpose", keypoints="body_25", track="nearest"
    )
    return np.asarray(walk.landmarks)[:36]


@pytest.fixture(scope="module")
def walk(keypoints):
    return shapefit.fit(keypoints, keypoints="body_25", frame_rate=25)


def test_a_fit_has_a_picture_and_a_table_of_about_10_kb(walk):
    doubtful = walk.replaced(trusted=np.arange(36) > 0)
    shown = doubtful._repr_html_()
    assert len(shown) < 15_000
    picture = ET.fromstring(re.search("<svg.*</svg>", shown)[0])
    places = picture.findall("g")
    titles = [place.findtext(".//title") for place in places]
    assert titles == [f"landmarks/{row}" for row in (0, 7, 14, 21, 28, 35)]
    assert len(titles) == MAX_DRAWN_IMAGES
    faint = [place.find("g").get("opacity") is not None for place in places]
    assert faint == [True, *[False] * 5]
    for circle in picture.iter("circle"):
        assert 0 < float(circle.get("cy")) < 110
    assert "<td><code>shape_sd</code></td><td>(36, 21, 3)</td>" in shown


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_heads_are_above_in_the_picture_and_the_plot(walk, y_axis):
    pytest.importorskip("matplotlib").use("svg")
    turned = walk.shapes * (1 if y_axis == "down" else np.array([1, -1, -1]))
    one = walk.replaced(shapes=turned, y_axis=y_axis)[:1]
    head, foot = (one.landmark_names.index(name) for name in ("head", "rankle"))
    picture = ET.fromstring(re.search("<svg.*</svg>", as_html(one))[0])
    circles = [*picture.iter("circle")]
    assert float(circles[head].get("cy")) < float(circles[foot].get("cy")) - 20
    axes = one.plot()
    assert axes.get_title() == "landmarks/0"
    _, depth, y = axes.collections[0]._offsets3d
    assert axes.zaxis_inverted() == (y_axis == "down")
    assert (y[foot] > y[head] + 20) == axes.zaxis_inverted()
    np.testing.assert_array_equal(depth, walk.shapes[0, :, 2])
    assert walk.plot(1, one.plot(0, axes)).zaxis_inverted()
    bars = one.shape_sd.size
    assert len(axes.lines) >= bars


def test_what_has_no_shape_name_or_trust_is_shown(walk):
    names = tuple(f"<{name}>" for name in walk.items[:2])
    empty = walk[:2].replaced(
        items=names, shapes=np.full((2, 21, 3), np.nan), trusted=None, shape_sd=None
    )
    shown = empty._repr_html_()
    ET.fromstring(re.search("<svg.*</svg>", shown)[0])
    assert "&lt;landmarks/0&gt;" in shown
    assert "<svg" not in walk[:0]._repr_html_()
    unnamed = shapefit.Landmarks(np.ones((1, 4, 2)))
    assert repr(unnamed) == "<shapefit.Landmarks: 1 item, 4 landmarks, in unknown>"


def test_a_plot_of_no_image_is_refused(walk):
    for image in (36, "walk", -37):
        with pytest.raises(shapefit.InputError, match=f"no image {image!r}; give"):
            walk.plot(image)


def test_the_page_is_that_of_view_in_a_sandboxed_frame(walk, tmp_path):
    page = walk.view()
    assert page.path is None
    assert repr(page).startswith("<shapefit.Page: 0.")
    frame = page._repr_html_()
    assert frame.startswith('<iframe sandbox="allow-scripts" ')
    assert html.unescape(re.search('srcdoc="([^"]*)"', frame)[1]) == page.html
    saved = walk.view(tmp_path / "walk.html")
    assert saved.path == tmp_path / "walk.html"
    assert saved.path.read_text(encoding="utf-8") == page.html
    assert "<html" in page.html[:200]
    with pytest.raises(shapefit.InputError, match=r"view\.open: a browser shows a fi"):
        walk.view(open=True)


def test_progress_is_shown_and_changes_neither_result_nor_warnings(
    keypoints, walk, capsys
):
    before = [*warnings.filters]
    shown = shapefit.fit(keypoints, keypoints="body_25", frame_rate=25, progress=True)
    assert warnings.filters == before
    np.testing.assert_array_equal(shown.shapes, walk.shapes)
    assert re.search(r"shapefit: 100%.* 36/36 ", capsys.readouterr().err)
    shapes = shapefit.Shapes(walk.shapes, landmark_names=walk.landmark_names)
    shapefit.learn(shapes, k=3, iterations=2, progress=True)
    assert "2/2 " in capsys.readouterr().err
    shapefit.learn(shapes, k=3, iterations=2)
    assert not capsys.readouterr().err


def test_landmarks_that_are_left_out_are_warned_of(keypoints):
    names = installed_skeletons()["coco_133"].landmark_names
    whole = np.full((4, 133, 2), np.nan)
    whole[:, :17] = np.random.default_rng(0).normal(300, 50, (4, 17, 2))
    assert len(names) == 133
    with pytest.warns(UserWarning, match=r"11\d landmarks left out, which the dict"):
        shapefit.fit(whole, keypoints="coco_133")


def test_atoms_of_another_scale_are_warned_of(keypoints):
    people = shapefit.read_dictionary("people")
    atoms = 1000 * people.atoms[:, :15]
    own = shapefit.Dictionary(atoms, landmark_names=people.landmark_names[:15])
    with pytest.warns(UserWarning, match=r"the atoms have a norm of .*e\+03") as caught:
        shapefit.fit(keypoints[:2], own, keypoints="body_25")
    assert {warning.filename for warning in caught} == {__file__}


def test_every_result_says_what_it_is(walk):
    people = shapefit.read_dictionary("people")
    assert repr(people) == (
        "<shapefit.Dictionary: 64 atoms, 24 landmarks, a prior of 32 components, in m>"
    )
    atoms = people.atoms.swapaxes(1, 2)
    images = walk.landmarks[:2].swapaxes(1, 2)
    known = np.isfinite(images).all(axis=(0, 1))
    atoms = atoms[:, :, : len(known)][:, :, known]
    found = shapefit.solve(images[..., known], atoms, 1.0)
    assert re.fullmatch(
        r"<shapefit\.Optimum: 2 images, at most \d+ of 64 atoms, optimal, gap .*e-.*>",
        repr(found),
    )
    errors = shapefit.evaluate(walk, walk.shapes, metrics=["similarity"])
    assert repr(errors).startswith("<shapefit.Evaluation: 36 images, similarity ")


def test_a_library_that_is_missing_is_named(walk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(shapefit.InputError, match="run `pip install matplotlib`"):
        walk.plot()


@pytest.mark.slow
def test_a_dataset_of_xarray_has_named_axes(walk, tmp_path):
    xarray = pytest.importorskip("xarray")
    dataset = walk.to_xarray()
    picked = dataset.shapes.sel(item="landmarks/3", landmark="head", space="y")
    assert float(picked) == walk.shapes[3, walk.landmark_names.index("head"), 1]
    assert dataset.landmarks.dims == ("item", "landmark", "plane")
    assert dataset.trusted.dims == ("item",)
    assert dataset.attrs == {"unit": "unknown", "y_axis": "down", "frame_rate": 25}
    dataset.to_netcdf(tmp_path / "fit.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "fit.nc", engine="h5netcdf") as again:
        np.testing.assert_array_equal(again.shapes, walk.shapes)
