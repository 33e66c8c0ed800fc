"""`view RESULT -o SHEET.png`: what is drawn, and where, is read from what matplotlib
was given.
"""

import numpy as np
import pytest

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


def test_images_spread_over_the_result_are_drawn(tmp_path, world, monkeypatch):
    from matplotlib.image import imread

    monkeypatch.setattr(
        viewing, "MAX_SHEET_IMAGES", 8
    )  # each takes a tenth of a second
    result = world.fit("cars", method="convex+refine")
    outcome = sheet(
        tmp_path / "s.png", result, dictionary=str(world.dictionary("cars"))
    )
    assert outcome.done == 8
    assert outcome.written == (tmp_path / "s.png",)
    assert imread(tmp_path / "s.png").shape[1] > 1000
    outcome = sheet(tmp_path / "s.svg", result, items=["sedan_1/*", "lorry*"])
    assert outcome.done == 6
    assert outcome.warnings == ("items: no item has this name or matches 'lorry*'",)
    text = (tmp_path / "s.svg").read_text(encoding="utf-8")
    assert "sedan_1/view_2" in text


@pytest.mark.parametrize(
    "camera", [{}, {"focal": 1600.0, "principal_point": [640.0, 480.0]}]
)
def test_the_mesh_lies_under_the_landmarks(world, camera):
    result = world.fit(
        "cars", method="convex+refine", **({"camera": camera} if camera else {})
    )
    files, path = {"cars": (result,)}, world.dictionary("cars")
    dictionary = read_dictionary(path)
    fit = read_results(result)
    scene = make_scene(ViewConfig(files=files, dictionary=path))
    apart = dictionary.mesh_vertices[0, :, None, :] - dictionary.atoms[0, :, :, None]
    vertex = (apart**2).sum(axis=0).argmin(axis=1)
    seen = (
        fit.as_columns()[:, :2]
        if fit.landmarks_fitted is None
        else fit.landmarks_fitted.swapaxes(1, 2)
    )
    for row in range(0, len(fit), 30):
        image = fitted_image(scene, row)
        np.testing.assert_allclose(image.projected, seen[row], atol=1e-6)
        np.testing.assert_allclose(image.landmarks, fit.column("landmarks")[row].T)
        np.testing.assert_allclose(
            image.projected_mesh[:, vertex], image.projected, atol=1e-3
        )
        np.testing.assert_allclose(image.mesh[:, vertex], image.shape, atol=1e-5)


def test_a_sheet_shows_one_result(tmp_path, world):
    result = world.fit("cars", method="convex+refine")
    save(tmp_path / "other.h5", read_results(result))
    for files in ((world.shapes("cars"),), (result, tmp_path / "other.h5")):
        with pytest.raises(InputError, match="a sheet shows one result"):
            sheet(tmp_path / "s.png", *files)
    with pytest.raises(InputError, match="no item fits"):
        sheet(tmp_path / "s.png", result, items=["lorry"])
    assert [path.name for path in tmp_path.iterdir()] == ["other.h5"]


def test_photographs_of_the_rows_alone_are_read(tmp_path, world, monkeypatch):
    """They lie under the landmarks; what is missing is told."""
    from PIL import Image

    result = world.fit("cars", method="convex+refine")
    items = read_results(result).items
    folder = tmp_path / "photos"
    for item in items:
        path = folder / f"{item}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (64, 48), "grey").save(path)
    drawn, opened = [], []
    draw = viewing.contact_sheet
    monkeypatch.setattr(
        viewing,
        "contact_sheet",
        lambda images, model: drawn.extend(images) or draw(images[:1], model),
    )
    whole = Image.open
    monkeypatch.setattr(
        Image, "open", lambda path, **keys: opened.append(path) or whole(path, **keys)
    )
    outcome = sheet(tmp_path / "s.png", result, images=str(folder))
    assert len(opened) == len(drawn) == outcome.done == 24
    for image, path in zip(drawn, opened, strict=True):
        assert path == folder / f"{image.title}.jpg"
        assert image.photograph.pixels.size == (64, 48)
    (folder / f"{drawn[0].title}.jpg").unlink()
    outcome = sheet(tmp_path / "s.png", result, images=str(folder))
    assert "1 frame of 24 without a photograph in photos." in outcome.warnings
    assert drawn[24].photograph is None


def test_cars_stand_upright(world):
    path = world.dictionary("cars")
    result = world.fit("cars", method="convex+refine")
    scene = make_scene(ViewConfig(files={"cars": (result,)}, dictionary=path))
    dictionary = read_dictionary(path)
    fit = read_results(result)
    image = fitted_image(scene, 7)
    upright = image.upright @ image.mesh
    mixed = np.tensordot(fit.coefficients[7], dictionary.mesh_vertices, axes=1)
    upright -= upright.mean(axis=1, keepdims=True)
    mixed -= mixed.mean(axis=1, keepdims=True)
    scale = np.linalg.norm(upright) / np.linalg.norm(mixed)
    np.testing.assert_allclose(upright, scale * mixed, atol=1e-6 * scale)
    assert image.individual == ("", 0)


def test_a_film_is_not_drawn_on_a_sheet(tmp_path, world):
    result = world.fit("cars", method="convex+refine")
    film = tmp_path / "my clip.mp4"
    film.write_bytes(b"")
    line = r"ffmpeg -i '.*my clip.mp4' -fps_mode passthrough frames/%06d.jpg"
    with pytest.raises(InputError, match=line):
        sheet(tmp_path / "s.png", result, images=str(film))
    assert not (tmp_path / "s.png").exists()
