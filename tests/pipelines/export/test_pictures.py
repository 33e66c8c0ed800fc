"""The pictures that `fit` draws: which, of what, and where in them the model lies."""

import numpy as np
import pytest
from matplotlib.image import imread

from shapefit.config import FitConfig
from shapefit.convex.transforms import Transforms
from shapefit.pipelines.export.pictures import fitted_image


@pytest.fixture
def draw(tmp_path, run):
    """Return the function that fits with keys of `pictures` to tmp_path/pictures."""

    def run_fit(*records, **keys):
        fit_keys = keys.pop("fit_keys", {})
        return run(*records, pictures={"folder": str(tmp_path / "pictures")} | keys, **fit_keys)

    return run_fit


@pytest.fixture
def sheets(monkeypatch):
    """Collect the images of contact sheets in place of drawing them."""
    drawn = []
    from shapefit.pipelines.export import pictures as picture_export

    real = picture_export.contact_sheet

    def collect(images, model):
        drawn.append((list(images), model))
        return real(images[:1], model)

    monkeypatch.setattr(picture_export, "contact_sheet", collect)
    return drawn


def written(tmp_path):
    folder = tmp_path / "pictures"
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_chosen_items_and_a_contact_sheet(tmp_path, draw, views):
    first, last = views.items[0], views.items[-1]
    _, outcomes = draw(items=[first, last, "lorry*"], sheet=4)
    assert written(tmp_path) == {f"{first}.png", f"{last}.png", "contact_sheet.png"}
    for path in (tmp_path / "pictures").rglob("*.png"):
        pixels = imread(path)
        assert min(pixels.shape[:2]) > 150
        assert (pixels[..., :3] < 0.9).any(axis=-1).mean() > 0.1
    sheet = tmp_path / "pictures/contact_sheet.png"
    assert outcomes[-1].written == (tmp_path / "result.h5", tmp_path / "pictures", sheet)
    assert outcomes[-1].note == "y down in the images; 2 pictures, contact sheet of 4"
    assert outcomes[-1].warnings == ("pictures.items: no item has this name or matches 'lorry*'",)


def test_an_image_may_be_called_like_the_sheet(tmp_path, draw, views, sheets):
    items = list(views.items)
    items[-1], items[2] = "contact_sheet", "contact_sheet%"
    named = views.replaced(items=tuple(items))
    draw(named, items=["contact_sheet*"], sheet=3, fit_keys={"chunk": 2})
    ((images, _),) = sheets
    assert [image.title for image in images] == [items[i] for i in (1, 3, 5)]  # spread evenly
    assert written(tmp_path) == {
        "contact_sheet.png", "contact_sheet%25.png", "contact_sheet%.png",
    }  # fmt: skip
    alone, sheet = (
        imread(tmp_path / "pictures" / f"{name}.png").shape[:2]
        for name in ("contact_sheet", "contact_sheet%")
    )
    assert alone[1] / alone[0] > 2 > sheet[1] / sheet[0]


def test_an_image_without_a_shape_has_its_picture(tmp_path, draw, views, sheets):
    landmarks = views.landmarks.copy()
    landmarks[1][:, np.flatnonzero(np.isfinite(landmarks[1, 0]))[2:]] = np.nan
    _, outcomes = draw(views.replaced(landmarks=landmarks), items=[views.items[1]], sheet=6)
    assert f"{views.items[1]}.png" in written(tmp_path)
    ((images, _),) = sheets
    assert [image.fitted for image in images] == [True, False, True, True, True, True]
    for image, observed in zip(images, landmarks, strict=True):
        np.testing.assert_array_equal(image.landmarks, observed)
    assert np.isfinite(images[1].landmarks[0]).sum() == 2
    assert outcomes[-1].note == "y down in the images; 1 picture, contact sheet of 6"


def test_images_without_a_shape_that_nobody_names_make_room_for_others(tmp_path, draw, views):
    landmarks = views.landmarks.copy()
    for failing in (0, 1):
        landmarks[failing][:, np.flatnonzero(np.isfinite(landmarks[failing, 0]))[2:]] = np.nan
    _, outcomes = draw(views.replaced(landmarks=landmarks), most=3, fit_keys={"chunk": 2})
    assert written(tmp_path) == {f"{item}.png" for item in views.items[2:5]}
    assert outcomes[-1].warnings == (
        "images without a shape (failed, or with all coefficients 0): 2; they have no picture "
        "unless `pictures.items` lists them",
    )


class TestFittedImages:
    """What a picture is given to draw."""

    @pytest.fixture
    def gather(self, tmp_path, run, cars, car_atoms):
        """Fit, and gather every image."""

        def fit_and_gather(*records, dictionary=car_atoms, **keys):
            found, _ = run(*records, **keys)
            files = {"landmarks": str(tmp_path / "views.h5"), "dictionary": str(cars)}
            files["output"] = str(tmp_path / "other.h5")
            config = FitConfig(**files, **({"method": "convex+refine"} | keys))
            return found, [
                fitted_image(
                    found.take([row]), Transforms.of(found.transforms[[row]]), config, dictionary
                )
                for row in range(len(found))
            ]

        return fit_and_gather

    @pytest.mark.parametrize(
        "keys",
        [
            {"method": "convex+refine"},
            {"method": "convex"},
            {"method": "convex", "rotations": "orthogonal"},
            {
                "camera": {
                    "model": "perspective", "focal": 1600.0, "principal_point": [640.0, 480.0],
                }
            },
        ],
    )  # fmt: skip
    def test_the_model_is_seen_under_its_fitted_landmarks(self, gather, car_atoms, keys):
        # sample landmarks are vertices of the mesh
        apart = car_atoms.mesh_vertices[0, :, None, :] - car_atoms.atoms[0, :, :, None]
        vertex = (apart**2).sum(axis=0).argmin(axis=1)
        found, images = gather(**keys)
        for row, image in enumerate(images):
            fitted = found.landmarks_fitted[row]
            np.testing.assert_allclose(image.seen, fitted, atol=1e-3)
            np.testing.assert_allclose(image.seen_mesh[:, vertex], fitted, atol=1e-3)

    def test_a_camera_that_looks_up_y_sees_the_same(self, gather, views):
        flipped = views.replaced(
            landmarks=views.landmarks * np.array([1, -1])[:, None], y_axis="up"
        )
        seen = {}
        for images, centre in ((views, [640.0, 480.0]), (flipped, [640.0, -480.0])):
            camera = {"model": "perspective", "focal": 1600.0, "principal_point": centre}
            _, gathered = gather(images, camera=camera)
            seen[images.y_axis] = gathered
        turn = np.array([1, -1])[:, None]
        for down, up in zip(seen["down"], seen["up"], strict=True):
            np.testing.assert_allclose(down.seen_mesh, turn * up.seen_mesh, atol=0.5)

    def test_the_mesh_in_novel_views_has_one_rotation(self, gather, car_atoms, mixed):
        found, images = gather(method="convex")
        for row, image in enumerate(images):
            expected = found.scale[row] * mixed(car_atoms.mesh_vertices, found, row)
            turned = found.rotation[row].T @ image.mesh
            np.testing.assert_allclose(
                turned - turned.mean(axis=1, keepdims=True),
                expected - expected.mean(axis=1, keepdims=True),
                atol=1e-9,
            )
