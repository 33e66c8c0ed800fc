"""`view RESULT -o SHEET.png`: what is drawn, and where, is read from what matplotlib
was given.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.testing import assert_allclose
from PIL import Image

from shapefit.config import CONFIGS, ViewConfig
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_results
from shapefit.pipelines.view import run as viewing
from shapefit.pipelines.view.run import fitted_image
from shapefit.pipelines.view.run import write_page as run
from shapefit.pipelines.view.scene import make_scene
from tests.io.files import save


def sheet(output, *results, **keys):
    files = {path.stem: [str(path)] for path in results}
    (outcome,) = run(CONFIGS["view"](files=files, output=str(output), **keys))
    return outcome


@pytest.fixture(scope="module")
def cars(world):
    """A result of cars, whose dictionary has a mesh."""
    return world.fit("cars", method="convex+refine")


@pytest.fixture
def eight_images(monkeypatch):
    """Fewer images on a sheet: each takes a tenth of a second."""
    monkeypatch.setattr(viewing, "MAX_SHEET_IMAGES", 8)


@pytest.mark.usefixtures("eight_images")
def test_images_spread_over_the_result_are_drawn(tmp_path, world, cars):
    path = tmp_path / "s.png"
    outcome = sheet(path, cars, dictionary=str(world.dictionary("cars")))
    _, width, _ = imread(path).shape
    assert outcome.done == 8
    assert outcome.written == (path,)
    assert width > 1000


@pytest.mark.usefixtures("eight_images")
def test_chosen_items_are_drawn_by_name(tmp_path, cars):
    path = tmp_path / "s.svg"
    outcome = sheet(path, cars, items=["sedan_1/*", "lorry*"])
    assert outcome.done == 6
    assert outcome.warnings == ("items: no item has this name or matches 'lorry*'",)
    assert "sedan_1/view_2" in path.read_text(encoding="utf-8")


def nearest_vertices(points, vertices):
    """Return the index of the vertex (3, q) that is nearest to each point (3, p)."""
    apart = vertices[:, None, :] - points[:, :, None]
    squares = (apart**2).sum(axis=0)
    return squares.argmin(axis=1)


PERSPECTIVE = {"camera": {"focal": 1600.0, "principal_point": [640.0, 480.0]}}


@pytest.mark.parametrize("keys", [{}, PERSPECTIVE])
def test_the_mesh_lies_under_the_landmarks(world, keys):
    result = world.fit("cars", method="convex+refine", **keys)
    path = world.dictionary("cars")
    dictionary = read_dictionary(path)
    vertices = nearest_vertices(dictionary.atoms[0], dictionary.mesh_vertices[0])
    fit = read_results(result)
    in_images = fit.landmarks_fitted
    if in_images is None:
        in_images = fit.shapes[:, :, :2]
    observed = fit.column("landmarks")
    scene = make_scene(ViewConfig(files={"cars": (result,)}, dictionary=path))
    for row in range(0, len(fit), 30):
        image = fitted_image(scene, row)
        of_landmarks = image.mesh[:, vertices]
        projected = image.projected_mesh[:, vertices]
        assert_allclose(image.projected, in_images[row].T, atol=1e-6)
        assert_allclose(image.landmarks, observed[row].T)
        assert_allclose(projected, image.projected, atol=1e-3)
        assert_allclose(of_landmarks, image.shape, atol=1e-5)


def test_a_sheet_of_shapes_is_refused(tmp_path, world):
    path = tmp_path / "s.png"
    with pytest.raises(InputError, match="a sheet shows one result"):
        sheet(path, world.shapes("cars"))
    assert not path.exists()


def test_a_sheet_of_two_results_is_refused(tmp_path, cars):
    path = tmp_path / "s.png"
    other = tmp_path / "other.h5"
    save(other, read_results(cars))
    with pytest.raises(InputError, match="a sheet shows one result"):
        sheet(path, cars, other)
    assert not path.exists()


def test_a_sheet_of_no_item_is_refused(tmp_path, cars):
    path = tmp_path / "s.png"
    with pytest.raises(InputError, match="no item fits"):
        sheet(path, cars, items=["lorry"])
    assert not path.exists()


@pytest.fixture
def photos(tmp_path, cars):
    """A folder with a photograph of each item."""
    folder = tmp_path / "photos"
    for item in read_results(cars).items:
        path = folder / f"{item}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (64, 48), "grey").save(path)
    return folder


@pytest.fixture
def seen(monkeypatch):
    """The photographs that are opened and the images that are drawn, of which one
    reaches matplotlib.
    """
    record = SimpleNamespace(opened=[], drawn=[])
    draw = viewing.contact_sheet
    open_image = Image.open

    def contact_sheet(images, model):
        record.drawn += images
        return draw(images[:1], model)

    def open_recorded(path, **keys):
        record.opened.append(path)
        return open_image(path, **keys)

    monkeypatch.setattr(viewing, "contact_sheet", contact_sheet)
    monkeypatch.setattr(Image, "open", open_recorded)
    return record


def test_photographs_of_the_drawn_images_alone_are_read(tmp_path, cars, photos, seen):
    outcome = sheet(tmp_path / "s.png", cars, images=str(photos))
    assert outcome.done == 24
    assert seen.opened == [photos / f"{image.title}.jpg" for image in seen.drawn]
    assert len(seen.drawn) == 24
    for image in seen.drawn:
        assert image.photograph.pixels.size == (64, 48)


def test_a_missing_photograph_is_told(tmp_path, cars, photos, seen):
    path = tmp_path / "s.png"
    sheet(path, cars, images=str(photos))
    first = seen.drawn[0].title
    (photos / f"{first}.jpg").unlink()
    seen.drawn.clear()
    outcome = sheet(path, cars, images=str(photos))
    assert "1 frame of 24 without a photograph in photos." in outcome.warnings
    assert seen.drawn[0].title == first
    assert seen.drawn[0].photograph is None


def about_the_mean(points):
    return points - points.mean(axis=1, keepdims=True)


def test_cars_stand_upright(world, cars):
    path = world.dictionary("cars")
    meshes = read_dictionary(path).mesh_vertices
    coefficients = read_results(cars).coefficients[7]
    mixed = about_the_mean(np.tensordot(coefficients, meshes, axes=1))
    scene = make_scene(ViewConfig(files={"cars": (cars,)}, dictionary=path))
    image = fitted_image(scene, 7)
    upright = about_the_mean(image.upright @ image.mesh)
    scale = np.linalg.norm(upright) / np.linalg.norm(mixed)
    assert_allclose(upright, scale * mixed, atol=1e-6 * scale)
    assert image.individual == ("", 0)


def test_a_film_is_not_drawn_on_a_sheet(tmp_path, cars):
    path = tmp_path / "s.png"
    film = tmp_path / "my clip.mp4"
    film.write_bytes(b"")
    line = r"ffmpeg -i '.*my clip.mp4' -fps_mode passthrough frames/%06d.jpg"
    with pytest.raises(InputError, match=line):
        sheet(path, cars, images=str(film))
    assert not path.exists()
