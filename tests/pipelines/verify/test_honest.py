"""Honest results are accepted: every method and data term, from every kind of file, in
parts.
"""

import hashlib
import json
import os
import shutil

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.io import read_dictionary
from shapefit.pipelines.partition.run import fit_parts
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file
from tests.pipelines.verify.conftest import TERMS

PERSPECTIVE = {"focal": "files"}

# How many of its frames a run certifies.
ALL = True
NONE = False

KEYS = [
    *(("people", term, ALL) for term in TERMS.values()),
    *(("people", term | {"tolerance": 1e-300}, ALL) for term in TERMS.values()),
    ("people", {"method": "convex+refine"}, ALL),
    ("people", {"method": "convex+refine", "outliers": "l1"}, ALL),
    ("people", {"method": "convex+refine", "lam": 0.01, "signed": True}, ALL),
    ("people", {"method": "alternate"}, NONE),
    ("people", {"method": "mean-shape"}, NONE),
    ("people", {"method": "global"}, NONE),
    ("people", {"lam": 50.0}, ALL),
    ("people", {"lam": "auto", "noise": 3.0}, ALL),
    ("people", {"tolerance": 1e-12}, ALL),
    ("people", {"save": {"proof": False}}, NONE),
    *(
        ("cars", {**term, "leave_one_out": "true_model", "lam": 1.0}, ALL)
        for term in TERMS.values()
    ),
    ("cars", {"outliers": "ransac"}, ALL),
    ("cars", {"camera": PERSPECTIVE, "outliers": "l1"}, ALL),
    (
        "cars",
        {
            "camera": PERSPECTIVE,
            "method": "convex+refine",
            "leave_one_out": "true_model",
        },
        ALL,
    ),
    ("cars", {"camera": PERSPECTIVE, "method": "mean-shape"}, NONE),
    ("prior", {"method": "posterior", "save": {"covariance": True}}, NONE),
    ("walk", {"method": "convex"}, ALL),
    ("walk", {"method": "posterior"}, NONE),
    ("walk", {"method": "sequences", "frame_rate": 24}, NONE),
]


@pytest.mark.parametrize(("kind", "keys", "certified"), KEYS)
def test_an_honest_result_is_accepted(
    fitted, verify, dictionaries, landmarks, kind, keys, certified
):
    result = fitted(kind, **keys)
    with h5py.File(result) as file:
        count = len(file["item"])
    for given in ([landmarks[kind]], []):
        found = verify(result, dictionaries[kind], given)
        has_gap = found.data["largest_gap"] > 0
        assert found.failures == {}
        assert found.done == count
        assert found.data["certified"] == (count if certified else 0)
        assert found.data["sealed"] == count
        assert has_gap == certified or "lam" in keys


@pytest.fixture(scope="session")
def tables(landmarks, tmp_path_factory):
    """The images of people in two sequences: as a table, and with other names as
    HDF5.
    """
    folder = tmp_path_factory.mktemp("tables")
    table = folder / "people.csv"
    other = folder / "people.h5"
    images = load(landmarks["people"])
    header, *lines = landmarks["people"].read_text().splitlines()
    of_first = tuple(f"{item}," for item in images.items[:5])
    rows = [f"{header},sequence"]
    for line in lines:
        sequence = "first" if line.startswith(of_first) else "second"
        rows.append(f"{line},{sequence}")
    table.write_text("\n".join([*rows, ""]))
    sequences = ["a"] * 5 + ["b"] * (len(images) - 5)
    items = [f"b{item}" for item in images.items]
    save(other, images.replaced(items=items, sequences=sequences))
    return {"csv": [table, other], "hdf5": [other]}


@pytest.fixture(scope="session")
def persons(landmarks, tmp_path_factory):
    """A detector's folder a camera, of the same names."""
    folder = tmp_path_factory.mktemp("cameras")
    files = sorted(landmarks["walk"].iterdir())
    for camera, frames in (("cam01", slice(0, 8)), ("cam02", slice(8, 20))):
        (folder / camera).mkdir()
        for file in files[frames]:
            shutil.copy(file, folder / camera / file.name)
    return [folder / "cam01", folder / "cam02"]


@pytest.fixture
def dictionary_of(world, dictionaries):
    """Return the dictionary that a method takes."""

    def find(method):
        if method == "pmp":
            return world.dictionary("bases of people")
        needs_prior = method in ("posterior", "sequences")
        return dictionaries["prior" if needs_prior else "people"]

    return find


METHODS = [
    "convex",
    "convex+refine",
    "alternate",
    "mean-shape",
    "global",
    "pmp",
    "posterior",
    "sequences",
]
FORMS = [("csv", True), ("folder", True), ("hdf5", False)]
"""Form of the images, and whether there are two files of them, the second HDF5, and
parts.
"""


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("form", "parts"), FORMS)
def test_every_kind_of_file_is_accepted(
    verify, dictionary_of, tables, persons, tmp_path, form, parts, method
):
    files = persons if form == "folder" else tables[form]
    dictionary = dictionary_of(method)
    keys = {"method": method}
    if method == "sequences":
        keys["frame_rate"] = 24
    if form == "folder":
        keys["keypoints"] = "body_25"
    if parts:
        written = tmp_path / "out"
        config = FitConfig(
            landmarks=[str(file) for file in files],
            dictionary=str(dictionary),
            output=ResultFolder(written, partition=4),
            **keys,
        )
        list(fit_parts(config))
    else:
        written = tmp_path / "out.h5"
        fit_file(files[0], dictionary, written, **keys)
    for given in ([], files, files[::-1]):
        check_accepted(verify(written, dictionary, given), method)


def check_accepted(found, method):
    has_proof = method in ("convex", "convex+refine")
    assert found.failures == {}
    assert found.done > 10
    assert found.data["images"] == found.done
    assert found.data["sealed"] == found.done
    assert (found.data["certified"] > 0) == has_proof


@pytest.fixture
def hard_images(dictionaries, rng):
    """Images far from the origin, tiny, huge, with strange confidences, hidden or on
    one point.
    """
    dictionary = read_dictionary(dictionaries["people"])
    atoms = dictionary.atoms
    coefficients = rng.random((12, len(atoms)))
    shapes = in_rows(np.einsum("nk,kap->nap", coefficients, atoms))
    landmarks = shapes[..., :2] + 0.05 * rng.standard_normal((*shapes.shape[:2], 2))
    landmarks[1] += 1e7
    landmarks[2] *= 1e-100
    landmarks[3] *= 1e100
    landmarks[4] = 5.0
    landmarks[5, 2:] = np.nan
    landmarks[6, :6] = np.nan
    confidence = rng.uniform(0, 1.5, shapes.shape[:2])
    confidence[7] *= 1e4
    confidence[8] *= 1e-4
    confidence[9, ::2] = 0
    return Landmarks(
        landmarks,
        confidence=confidence,
        landmark_names=dictionary.landmark_names,
        items=tuple(f"image{i}" for i in range(12)),
    )


@pytest.mark.parametrize("term", TERMS.values(), ids=TERMS)
def test_hard_images_are_accepted(tmp_path, verify, dictionaries, hard_images, term):
    path = tmp_path / "landmarks.h5"
    output = tmp_path / "result.h5"
    save(path, hard_images)
    fit_file(path, dictionaries["people"], output, **term)
    for given in ([path], []):
        found = verify(output, dictionaries["people"], given)
        assert found.failures == {}
        assert "No shape   2 of 12 images" in found.note


def test_nothing_that_a_result_names_is_opened(
    fitted, changed, verify, dictionaries, tmp_path
):
    """A calibration that never ends, landmarks and a dictionary that are not there."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)

    def name_it(file):
        config = json.loads(file.attrs["config"])
        config["camera"] |= {"calibration": str(pipe)}
        config["landmarks"] = [str(pipe)]
        text = json.dumps(config)
        file.attrs["config"] = text
        file.attrs["config_digest"] = hashlib.sha256(text.encode()).hexdigest()

    result = changed(fitted("people"), name_it)
    found = verify(result, dictionaries["people"])
    assert list(found.failures) == [str(pipe)]  # which has no digest


def test_csv_cannot_be_verified(tmp_path, verify, dictionaries):
    path = tmp_path / "shapes.csv"
    path.write_text("item,landmark,x,y,z\na,b,0,0,0\n")
    with pytest.raises(InputError, match="give a result that `shapefit fit` wrote"):
        verify(path, dictionaries["people"])


def test_batches_do_not_matter(fitted, verify, dictionaries, monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.verify.IMAGES_CHECKED_AT_ONCE", 16)
    result = fitted("cars", lam=1.0, leave_one_out="true_model")
    found = verify(result, dictionaries["cars"])
    assert found.failures == {}
    assert found.done == 108
