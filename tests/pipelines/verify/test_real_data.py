"""Honest results on real data are accepted, whatever the loss and the method."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.config import LearnDictConfig, ProjectConfig
from shapefit.io import read_shapes, write_shapes
from shapefit.pipelines import projection as projecting
from shapefit.pipelines.learn_dict import run as learn_dict
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file
from tests.pipelines.verify.conftest import TERMS

IMAGES = 150


@pytest.fixture(scope="module")
def people(real_data, tmp_path_factory):
    """A dictionary of subject 86 and images of subject 13, 150 spread over all its trials."""
    folder = tmp_path_factory.mktemp("people")
    shapes = read_shapes([real_data / "mocap/subject13_24fps.h5"])
    chosen = np.linspace(0, len(shapes) - 1, IMAGES).astype(int)
    write_shapes(folder / "shapes.h5", shapes.take(chosen))
    camera = {"view": "turntable", "up": "y"}
    list(
        projecting.run(
            ProjectConfig(
                shapes=[str(folder / "shapes.h5")], output=str(folder / "views.h5"), camera=camera
            )
        )
    )
    training = [str(real_data / "mocap/subject86_24fps.h5")]
    keys = {"k": 32, "iterations": 2, "every": 40, "output": str(folder / "dictionary.h5")}
    list(learn_dict.run(LearnDictConfig(shapes=training, **keys)))
    return SimpleNamespace(landmarks=folder / "views.h5", dictionary=folder / "dictionary.h5")


@pytest.fixture(scope="module")
def cars(real_data, tmp_path_factory):
    """A dictionary of all models, and every eighth annotated car."""
    folder = tmp_path_factory.mktemp("cars")
    images = load(real_data / "cars/annotated_cars.h5")
    save(folder / "views.h5", images.take(slice(0, None, 8)))
    keys = {"method": "exemplars", "align": "none", "output": str(folder / "dictionary.h5")}
    models = [str(real_data / "cars/models.h5")]
    list(learn_dict.run(LearnDictConfig(shapes=models, **keys)))
    return SimpleNamespace(landmarks=folder / "views.h5", dictionary=folder / "dictionary.h5")


def accept(data, verify, folder, **keys):
    output = folder / "result.h5"
    fit_file(data.landmarks, data.dictionary, output, **keys)
    found = verify(output, data.dictionary, [data.landmarks])
    assert found.done >= IMAGES - 1
    assert found.failures == {}


@pytest.mark.real_data
@pytest.mark.parametrize("method", ["convex+refine", "alternate"])
def test_methods_on_people(people, verify, tmp_path, method):
    accept(people, verify, tmp_path, method=method)


@pytest.mark.real_data
@pytest.mark.parametrize("loss", list(TERMS))
def test_losses_on_people(people, verify, tmp_path, loss):
    accept(people, verify, tmp_path, **TERMS[loss])


@pytest.mark.real_data
@pytest.mark.parametrize("loss", list(TERMS))
def test_losses_on_cars(cars, verify, tmp_path, loss):
    accept(cars, verify, tmp_path, **TERMS[loss], lam=1.0, leave_out="true_model")


@pytest.mark.real_data
@pytest.mark.parametrize("method", ["convex+refine", "mean-shape"])
def test_perspective_on_cars(cars, verify, tmp_path, method):
    camera = {"model": "perspective", "intrinsics": "camera_matrix", "principal_point": (0, 0)}
    accept(cars, verify, tmp_path, method=method, lam=1.0, leave_out="true_model", camera=camera)
