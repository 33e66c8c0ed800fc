"""A desk to write small files on and look at the page, and a dictionary with a mesh."""

import json
import re
from base64 import b64decode
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.io import (
    result_writer,
    write_shapes,
)
from shapefit.pipelines.view.run import write_page
from shapefit.pipelines.view.scene import make_scene
from shapefit.records import Fit, Landmarks, Shapes
from shapefit.records.columns import in_columns
from tests.columns import in_rows, put
from tests.io.files import save

NAMES = ("a", "b", "c", "d", "e")


def random_shapes(rng, n, p=5):
    return rng.normal(size=(n, 3, p)) * 10 + 100


def settings(count, fields):
    """Return names and items, and further fields of a record."""
    items = tuple(f"i{i}" for i in range(count))
    return {"landmark_names": NAMES, "items": items} | fields


def write_result(path, shapes, extras=None, attributes=None, **fields):
    """Write a result of shapes (n, 3, p); what was seen is their x and y unless
    `extras` differ.
    """
    count = len(shapes)
    points = in_rows(shapes)
    if extras is None:
        extras = {"landmarks": points[..., :2]}
    status = np.array(["optimal"] * count, dtype=object)
    fields = {"unit": "px", "status": status} | fields
    for name in {"shape_sd", "landmarks_fitted"} & fields.keys():
        fields[name] = in_rows(fields[name])
    of_file = {k: v for k, v in extras.items() if k.startswith("extrinsic_")}
    of_items = {k: v for k, v in extras.items() if k not in of_file}
    fit = Fit(points, **settings(count, fields))
    with result_writer(path) as writer:
        writer.append(put(fit, of_items, of_file))
        writer.attributes.update(attributes or {})
    return path


def write_truth(path, shapes, **fields):
    record = Shapes(in_rows(shapes), **settings(len(shapes), fields))
    write_shapes(path, record)
    return path


def write_landmarks(path, landmarks, **fields):
    record = Landmarks(in_rows(landmarks), **settings(len(landmarks), fields))
    save(path, record)
    return path


@dataclass(frozen=True)
class Desk:
    """Write files by what they hold; view them, and read the page's JSON again."""

    folder: Path
    rng: np.random.Generator

    def shapes(self, n, p=5):
        """Draw shapes (n, 3, p)."""
        return random_shapes(self.rng, n, p)

    def result(self, name="result.h5", n=6, shapes=None, **fields):
        if shapes is None:
            shapes = self.shapes(n)
        return write_result(self.folder / name, shapes, **fields)

    def truth(self, n=6, **fields):
        return write_truth(self.folder / "truth.h5", self.shapes(n), **fields)

    def landmarks(self, name="landmarks.h5", n=6, **fields):
        return write_landmarks(self.folder / name, self.shapes(n)[:, :2], **fields)

    def scene(self, *files, **settings):
        """Return what a page would show of these files."""
        named = {file.stem: (file,) for file in files}
        return make_scene(ViewConfig(files=named, **settings))

    def view(self, *files, **settings):
        """Write the page of these files; return the outcome, its notes and the page's
        data.
        """
        output = self.folder / "page.html"
        named = {file.stem: (file,) for file in files}
        (outcome,) = write_page(ViewConfig(files=named, output=output, **settings))
        (data,) = re.findall(r'id="page">(.*?)</script>', output.read_text("utf-8"))
        notes = " ".join(outcome.warnings)
        return SimpleNamespace(outcome=outcome, notes=notes, data=json.loads(data))


@pytest.fixture
def desk(tmp_path, rng):
    return Desk(tmp_path, rng)


def decoded(block):
    """Undo a block as blocks.js does."""
    data = b64decode(block["data"])
    codes = np.frombuffer(data, "<" + block["type"]).reshape(block["shape"])
    if "places" not in block:
        return codes
    places = decoded(block["places"]).astype(float)
    origins = places[:, None, :-1]
    steps = places[:, None, -1:]
    values = np.where(codes == -32768, np.nan, origins + steps * codes)
    return in_columns(values)


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
