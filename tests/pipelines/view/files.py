"""Small results, truths and landmarks on disk."""

import numpy as np

from shapefit.io import LandmarkSet, ResultSet, ShapeSet, result_writer, write_shapes
from tests.io.files import save

NAMES = ("a", "b", "c", "d", "e")


def random_shapes(rng, n, p=5):
    return rng.normal(size=(n, 3, p)) * 10 + 100


def settings(n, fields):
    return {"landmark_names": NAMES, "items": tuple(f"i{i}" for i in range(n))} | fields


def write_result(path, shapes, extras=None, attributes=None, **fields):
    """Write a result of shapes (n, 3, p); what was seen is their x and y unless `extras` differ."""
    n = len(shapes)
    extras = {"landmarks": shapes[:, :2].swapaxes(1, 2)} if extras is None else extras
    fields = {"unit": "px", "status": np.array(["optimal"] * n, dtype=object)} | fields
    with result_writer(path) as writer:
        writer.append(ResultSet(shapes=shapes, columns=extras, **settings(n, fields)))
        writer.attributes.update(attributes or {})
    return path


def write_truth(path, shapes, **fields):
    write_shapes(path, ShapeSet(shapes, **settings(len(shapes), fields)))
    return path


def write_landmarks(path, landmarks, **fields):
    save(path, LandmarkSet(landmarks=landmarks, **settings(len(landmarks), fields)))
    return path
