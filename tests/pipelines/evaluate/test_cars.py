"""Real cars against their models: perfect estimates, and the floors of the 34 models."""

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.io import open_landmarks, read_shapes
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
