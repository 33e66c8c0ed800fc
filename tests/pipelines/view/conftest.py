"""A desk to write small files on and look at the page, and a dictionary with a mesh."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.io import LandmarkSet, ResultSet, ShapeSet, result_writer, write_shapes
from shapefit.pipelines.view.run import view_files
from shapefit.pipelines.view.scene import make_scene
from tests.io.files import save

NAMES = ("a", "b", "c", "d", "e")


def random_shapes(rng, n, p=5):
    return rng.normal(size=(n, 3, p)) * 10 + 100


def settings(n, fields):
    return {"landmark_names": NAMES, "items": tuple(f"i{i}" for i in range(n))} | fields


def write_result(path, shapes, extras=None, attributes=None, **fields):
    """Write a result of shapes (n, 3, p); what was seen is their x and y unless
    `extras` differ.
    """
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


@pytest.fixture
def desk(tmp_path, rng):
    """Write files by what they hold; view them, and read the page's JSON again."""

    def result(name="result.h5", n=6, shapes=None, **fields):
        shapes = random_shapes(rng, n) if shapes is None else shapes
        return write_result(tmp_path / name, shapes, **fields)

    def truth(n=6, **fields):
        return write_truth(tmp_path / "truth.h5", random_shapes(rng, n), **fields)

    def landmarks(name="landmarks.h5", n=6, **fields):
        return write_landmarks(tmp_path / name, random_shapes(rng, n)[:, :2], **fields)

    def scene(*files, **settings):
        return make_scene(
            ViewConfig(files={file.stem: (file,) for file in files}, **settings)
        )

    def view(*files, **settings):
        output = tmp_path / "page.html"
        config = ViewConfig(
            files={file.stem: (file,) for file in files}, output=output, **settings
        )
        (outcome,) = view_files(config)
        (data,) = re.findall(r'id="page">(.*?)</script>', output.read_text("utf-8"))
        notes = " ".join(outcome.warnings)
        return SimpleNamespace(outcome=outcome, notes=notes, data=json.loads(data))

    return SimpleNamespace(
        shapes=lambda *size: random_shapes(rng, *size),
        result=result,
        truth=truth,
        landmarks=landmarks,
        view=view,
        scene=scene,
        folder=tmp_path,
    )


@pytest.fixture
def made_dictionary(rng):
    """Three atoms of five landmarks, with a mesh of seven vertices that moves with
    them.
    """
    from shapefit.dictionary.model import Dictionary
    from shapefit.geometry.normalisation import normalise

    atoms = normalise(rng.normal(size=(3, 3, 5))).points
    return Dictionary(
        atoms=atoms,
        landmark_names=NAMES,
        mean_shape=normalise(atoms.mean(axis=0)).points,
        edges=np.array([[0, 1]]),
        mesh_vertices=rng.normal(size=(3, 3, 7)),
        mesh_faces=np.array([[0, 1, 2], [2, 3, 4]]),
    )
