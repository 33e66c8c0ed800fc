"""What learns a dictionary from shapes given, through files, and the shapes."""

import numpy as np
import pytest

from shapefit.config import LearnDictConfig
from shapefit.geometry.rotations import random_rotations
from shapefit.io import ShapeSet, read_dictionary, write_shapes
from shapefit.pipelines.learn_dict.run import learn_dictionary

EDGES = np.array([[0, 1], [1, 2], [1, 3], [1, 4]])
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])


@pytest.fixture
def make(tmp_path):
    """Return what learns from shapes with keys of `learn-dict`: the dictionary, the
    outcomes.
    """

    def learn(shapes, **keys):
        path = tmp_path / "shapes.h5"
        write_shapes(path, shapes)
        config = LearnDictConfig(
            shapes=str(path), output=str(tmp_path / "dict.h5"), **keys
        )
        outcomes = list(learn_dictionary(config))
        return read_dictionary(config.output), outcomes

    return learn


@pytest.fixture
def shapes(rng):
    """30 shapes in two sequences, in metres, differently turned and placed."""
    points = rng.standard_normal((3, 5)) + 0.3 * rng.standard_normal((30, 3, 5))
    return ShapeSet(
        shapes=0.5 * random_rotations(30, rng) @ points
        + rng.standard_normal((30, 3, 1)),
        landmark_names=("hip", "neck", "head", "left hand", "right hand"),
        items=tuple(f"item{i}" for i in range(30)),
        sequences=("walk",) * 10 + ("run",) * 20,
        edges=EDGES,
        unit="m",
    )


@pytest.fixture
def models(rng):
    """12 models whose first four landmarks are the corners of their mesh, differently
    turned.
    """
    points = np.array(
        [(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4), (1, 1, 2)], dtype=float
    ).T
    points = rng.uniform(0.5, 2, (12, 1, 1)) * (
        points + 0.3 * rng.standard_normal((12, 3, 5))
    )
    points = random_rotations(12, rng) @ points + rng.standard_normal((12, 3, 1))
    return ShapeSet(
        shapes=points,
        landmark_names=tuple("abcde"),
        items=tuple(f"model{i}" for i in range(12)),
        edges=np.array([[0, 1]]),
        mesh_vertices=points[:, :, :4],
        mesh_faces=FACES,
        unit="m",
    )
