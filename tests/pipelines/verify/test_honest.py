"""Honest results are accepted: every method and data term, from every kind of file, in
parts.
"""

import json

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.io import read_dictionary
from shapefit.pipelines.partition.run import fit_parts
from shapefit.records import Landmarks
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file
from tests.pipelines.verify.conftest import TERMS

PERSPECTIVE = {"focal": "files"}
ALL, NONE = True, False

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
        n = len(file["item"])
    for given in ([landmarks[kind]], []):
        found = verify(result, dictionaries[kind], given)
        assert found.failures == {}
        assert found.done == n
        assert found.data["certified"] == (n if certified else 0)
        assert found.data["sealed"] == n
        assert (found.data["largest_gap"] > 0) == certified or "lam" in keys


@pytest.fixture(scope="session")
def tables(landmarks, tmp_path_factory):
    """The images of people in two sequences: as a table, and with other names as
    HDF5.
    """
    folder = tmp_path_factory.mktemp("tables")
    images = load(landmarks["people"])
    header, *lines = landmarks["people"].read_text().splitlines()
    first = tuple(f"{item}," for item in images.items[:5])
    rows = [
        f"{line},{'first' if line.startswith(first) else 'second'}" for line in lines
    ]
    (folder / "people.csv").write_text("\n".join([f"{header},sequence", *rows]) + "\n")
    named = {"sequences": ["a"] * 5 + ["b"] * (len(images) - 5)}
    save(
        folder / "people.h5",
        images.replaced(items=[f"b{i}" for i in images.items], **named),
    )
    return {
        "csv": [folder / "people.csv", folder / "people.h5"],
        "hdf5": [folder / "people.h5"],
    }


@pytest.fixture(scope="session")
def persons(landmarks, tmp_path_factory):
    """A detector's folder a camera, of the same names."""
    folder = tmp_path_factory.mktemp("cameras")
    for camera, frames in (("cam01", slice(0, 8)), ("cam02", slice(8, 20))):
        (folder / camera).mkdir()
        for file in sorted(landmarks["walk"].iterdir())[frames]:
            (folder / camera / file.name).write_bytes(file.read_bytes())
    return [folder / "cam01", folder / "cam02"]


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
    verify, world, dictionaries, tables, persons, tmp_path, form, parts, method
):
    files = persons if form == "folder" else tables[form]
    files = files if parts else files[:1]
    keys = {"frame_rate": 24} if method == "sequences" else {}
    keys |= {"keypoints": "body_25"} if form == "folder" else {}
    dictionary = dictionaries[
        "prior" if method in ("posterior", "sequences") else "people"
    ]
    if method == "pmp":
        dictionary = world.dictionary("bases of people")
    output = (
        ResultFolder(tmp_path / "out", partition=4)
        if parts
        else str(tmp_path / "out.h5")
    )
    config = FitConfig(
        landmarks=[str(file) for file in files],
        dictionary=str(dictionary),
        output=output,
        method=method,
        **keys,
    )
    if parts:
        list(fit_parts(config))
    else:
        fit_file(files[0], dictionary, tmp_path / "out.h5", method=method, **keys)
    for given in ([], files, files[::-1]):
        found = verify(tmp_path / ("out" if parts else "out.h5"), dictionary, given)
        assert found.failures == {}
        assert found.done == found.data["images"] == found.data["sealed"] > 10
        assert (found.data["certified"] > 0) == (method in ("convex", "convex+refine"))


def test_hard_images_are_accepted(tmp_path, verify, dictionaries, rng):
    """Far from the origin, tiny, huge, with strange confidences, hidden or on one
    point.
    """
    dictionary = read_dictionary(dictionaries["people"])
    atoms = dictionary.atoms
    p = atoms.shape[2]
    shapes = np.einsum("nk,kap->nap", rng.random((12, len(atoms))), atoms)[:, :2]
    landmarks = shapes + 0.05 * rng.standard_normal(shapes.shape)
    landmarks[1] += 1e7
    landmarks[2] *= 1e-100
    landmarks[3] *= 1e100
    landmarks[4] = 5.0
    landmarks[5, :, 2:] = np.nan
    landmarks[6, :, :6] = np.nan
    confidence = rng.uniform(0, 1.5, (12, p))
    confidence[7] *= 1e4
    confidence[8] *= 1e-4
    confidence[9, ::2] = 0
    images = Landmarks(
        landmarks.swapaxes(1, 2),
        confidence=confidence,
        landmark_names=dictionary.landmark_names,
        items=tuple(f"image{i}" for i in range(12)),
    )
    path = tmp_path / "landmarks.h5"
    save(path, images)
    for loss, term in TERMS.items():
        output = tmp_path / f"{loss}.h5"
        fit_file(path, dictionaries["people"], output, **term)
        for given in ([path], []):
            found = verify(output, dictionaries["people"], given)
            assert found.failures == {}
            assert "No shape   2 of 12 images" in found.note


def test_nothing_that_a_result_names_is_opened(
    fitted, changed, verify, dictionaries, tmp_path
):
    """A calibration that never ends, landmarks and a dictionary that are not there."""
    import hashlib
    import os

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)

    def name_it(file):
        config = json.loads(file.attrs["config"])
        config["camera"] |= {"calibration": str(pipe)}
        config["landmarks"] = [str(pipe)]
        file.attrs["config"] = json.dumps(config)
        file.attrs["config_digest"] = hashlib.sha256(
            file.attrs["config"].encode()
        ).hexdigest()

    found = verify(changed(fitted("people"), name_it), dictionaries["people"])
    assert list(found.failures) == [str(pipe)]  # which has no digest


def test_csv_cannot_be_verified_and_chunks_do_not_matter(
    tmp_path, fitted, verify, dictionaries, monkeypatch
):
    path = tmp_path / "shapes.csv"
    path.write_text("item,landmark,x,y,z\na,b,0,0,0\n")
    with pytest.raises(InputError, match="give a result that `shapefit fit` wrote"):
        verify(path, dictionaries["people"])
    monkeypatch.setattr("shapefit.pipelines.verify.IMAGES_CHECKED_AT_ONCE", 16)
    found = verify(
        fitted("cars", lam=1.0, leave_one_out="true_model"), dictionaries["cars"]
    )
    assert found.failures == {}
    assert found.done == 108
