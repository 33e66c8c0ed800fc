"""Real cars against their models: perfect estimates, and the floors of the 34 models."""

import numpy as np
import pytest
from scipy.optimize import nnls

from shapefit.config import EvalConfig
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation.metrics import similarity, truth_scale
from shapefit.geometry.normalisation import normalise
from shapefit.io import open_landmarks, read_shapes, write_dictionary
from shapefit.io.records import ResultSet

pytestmark = pytest.mark.real_data


@pytest.fixture
def cars(real_data):
    with open_landmarks([real_data / "cars" / "annotated_cars.h5"]) as source:
        return next(source.batches(300))


@pytest.fixture
def models(real_data):
    return read_shapes([real_data / "cars" / "models.h5"])


@pytest.fixture
def rows(cars, models):
    """Model of each car."""
    return np.array([models.items.index(model) for model in cars.columns["true_model"]])


@pytest.fixture
def cars_desk(desk, cars, models, rows, real_data):
    """The true shapes as estimates, their landmarks 3 and 4 px beside the observed ones."""
    R = np.asarray(cars.columns["true_rotation"], dtype=float)
    perfect = ResultSet(
        shapes=50 * R @ models.shapes[rows],
        landmarks_fitted=cars.landmarks + np.array([[3.0], [4.0]]),
        rotation=R,
        landmark_names=cars.landmark_names,
        items=cars.items,
        unit=cars.unit,
        y_axis=cars.y_axis,
        columns={**cars.further, "landmarks": cars.landmarks.swapaxes(-1, -2)},
    )
    config = EvalConfig(
        results=[desk.write("cars.h5", perfect)],
        truth=[real_data / "cars" / "models.h5"],
        output=desk.folder / "report",
        match="true_model",
        plots=False,
    )
    return type(desk)(desk.folder, config)


def test_they_are_matched_by_their_model(cars_desk, cars):
    judged, _ = cars_desk.run()
    assert (judged.failures, judged.warnings) == ((), ())
    for row in cars_desk.rows():
        if row["unit"] != "box":
            expected = 5.0 if row["metric"] == "reprojection" else 0.0
            np.testing.assert_allclose(float(row["mean"]), expected, atol=1e-4)
    _, _, width, height = np.asarray(cars.columns["bounding_box"], dtype=float).T
    np.testing.assert_allclose(cars_desk.errors(unit="box"), 5 / np.sqrt(width**2 + height**2))


def test_the_floors_of_the_other_models(cars_desk, cars, models, rows):
    """The best combination against scipy's, which keeps the frame of the models."""
    B = normalise(models.shapes).points
    write_dictionary(
        cars_desk.folder / "models.h5",
        Dictionary(B, models.landmark_names, B.mean(axis=0), atom_items=models.items),
    )
    floors = {"dictionary": cars_desk.folder / "models.h5", "leave_out": "true_model"}
    cars_desk.run(floors=floors, least_visible=20, metrics=["similarity"])
    chosen = rows[np.isfinite(cars.landmarks).all(axis=1).sum(axis=1) >= 20]
    S = models.shapes - models.shapes.mean(axis=-1, keepdims=True)
    scale = truth_scale(S, S)
    expected = np.zeros((3, len(S)))
    for j in np.unique(chosen):
        others = np.delete(B, j, axis=0)
        true = np.broadcast_to(S[j], others.shape)
        c, _ = nnls(others.reshape(len(others), -1).T, S[j].ravel())
        combined = np.tensordot(c, others, axes=1)
        expected[0, j] = similarity(others.mean(axis=0)[None], S[j][None])[0] / scale[j]
        expected[1, j] = similarity(others, true).min() / scale[j]
        expected[2, j] = similarity(combined[None], S[j][None])[0] / scale[j]
    floor = [
        cars_desk.errors(method=f"{name} (oracle)", unit="normalised")
        for name in ("Mean shape", "Nearest atom", "Best combination")
    ]
    np.testing.assert_allclose(floor[:2], expected[:2, chosen])
    # Turning the models too, which scipy's does not, can only fit them better, by little.
    assert 0.95 * expected[2, chosen].mean() < floor[2].mean() <= expected[2, chosen].mean()
    assert floor[2].mean() < floor[1].mean() < floor[0].mean()
