"""What learns a dictionary from shapes given, through files, and the shapes."""

import numpy as np
import pytest

from shapefit.config import LearnDictConfig
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    read_dictionary,
    write_shapes,
)
from shapefit.pipelines.learn_dict.run import learn_dictionary as run
from shapefit.records import Shapes
from tests.columns import in_rows

EDGES = np.array([[0, 1], [1, 2], [1, 3], [1, 4]])
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])


@pytest.fixture
def make(tmp_path):
    """Return what learns from shapes with keys of `learn-dict`: the dictionary, the
    outcomes.
    """

    def learn(shapes, **keys):
        source = tmp_path / "shapes.h5"
        output = tmp_path / "dict.h5"
        write_shapes(source, shapes)
        config = LearnDictConfig(shapes=str(source), output=str(output), **keys)
        outcomes = list(run(config))
        return read_dictionary(output), outcomes

    return learn


@pytest.fixture
def shapes(rng):
    """30 shapes in two sequences, in metres, differently turned and placed."""
    common = rng.standard_normal((3, 5))
    points = common + 0.3 * rng.standard_normal((30, 3, 5))
    turned = 0.5 * random_rotations(30, rng) @ points
    placed = turned + rng.standard_normal((30, 3, 1))
    return Shapes(
        in_rows(placed),
        landmark_names=("hip", "neck", "head", "left hand", "right hand"),
        items=tuple(f"item{i}" for i in range(30)),
        sequences=("walk",) * 10 + ("run",) * 20,
        edges=EDGES,
        unit="m",
    )


MODEL = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4), (1, 1, 2)], dtype=float)
"""The corners of a mesh, and a point in it."""


@pytest.fixture
def models(rng):
    """12 models whose first four landmarks are the corners of their mesh, differently
    turned.
    """
    sizes = rng.uniform(0.5, 2, (12, 1, 1))
    deviations = 0.3 * rng.standard_normal((12, 3, 5))
    turned = random_rotations(12, rng) @ (sizes * (MODEL.T + deviations))
    points = in_rows(turned + rng.standard_normal((12, 3, 1)))
    return Shapes(
        points,
        landmark_names=tuple("abcde"),
        items=tuple(f"model{i}" for i in range(12)),
        edges=np.array([[0, 1]]),
        mesh_vertices=points[:, :4],
        mesh_faces=FACES,
        unit="m",
    )
