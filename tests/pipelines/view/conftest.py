"""Small results, truths and landmarks on disk, and `view` run on them."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.io import LandmarkSet, ResultSet, ShapeSet, result_writer
from shapefit.pipelines.view.run import run
from tests.io.files import save

NAMES = ("a", "b", "c", "d", "e")


@pytest.fixture
def desk(tmp_path, rng):
    """Write files by what they hold; view them, and read the page's JSON again."""

    def shapes(n, p=5):
        return rng.normal(size=(n, 3, p)) * 10 + 100

    def result(name="result.h5", n=6, attributes=None, **fields):
        found = fields.pop("shapes", None)
        found = shapes(n) if found is None else found
        extras = fields.pop("extras", {"landmarks": found[:, :2].swapaxes(1, 2)})
        settings = {
            "landmark_names": NAMES,
            "items": tuple(f"i{i}" for i in range(n)),
            "unit": "px",
            "status": np.array(["optimal"] * n, dtype=object),
            **fields,
        }
        with result_writer(tmp_path / name) as writer:
            writer.append(ResultSet(shapes=found, columns=extras, **settings))
            writer.attributes.update(attributes or {})
        return tmp_path / name

    def truth(n=6, **fields):
        from shapefit.io import write_shapes

        settings = {"landmark_names": NAMES, "items": tuple(f"i{i}" for i in range(n)), **fields}
        write_shapes(tmp_path / "truth.h5", ShapeSet(shapes(n), **settings))
        return tmp_path / "truth.h5"

    def landmarks(name="landmarks.h5", n=6, **fields):
        settings = {"landmark_names": NAMES, "items": tuple(f"i{i}" for i in range(n)), **fields}
        save(tmp_path / name, LandmarkSet(landmarks=shapes(n)[:, :2], **settings))
        return tmp_path / name

    def view(*files, **settings):
        output = tmp_path / "page.html"
        config = ViewConfig(files={file.stem: (file,) for file in files}, output=output, **settings)
        (outcome,) = run(config)
        text = output.read_text("utf-8")
        (data,) = re.findall(r'id="page">(.*?)</script>', text)
        return SimpleNamespace(
            outcome=outcome, notes=" ".join(outcome.warnings), text=text, data=json.loads(data)
        )

    return SimpleNamespace(
        shapes=shapes, result=result, truth=truth, landmarks=landmarks, view=view, folder=tmp_path
    )


@pytest.fixture
def made_dictionary(rng):
    """Three atoms of five landmarks, with a mesh of seven vertices that moves with them."""
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
