"""Honest results of every loss and method are accepted, and verify says what is proved of them."""

import h5py
import numpy as np
import pytest

from shapefit.config import LearnDictConfig, ProjectConfig
from shapefit.errors import InputError
from shapefit.io import LandmarkSet, read_dictionary, read_shapes, write_shapes
from shapefit.pipelines import projection as projecting
from shapefit.pipelines.learn_dict import run as learn_dict
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file
from tests.pipelines.verify.conftest import TERMS

PERSPECTIVE = {"model": "perspective", "intrinsics": "camera_matrix"}

PEOPLE = [
    *TERMS.values(),
    *({**term, "solver": {"max_iterations": 1}} for term in TERMS.values()),
    {"method": "convex+refine"},
    {"method": "convex+refine", "outliers": {"method": "l1"}},
    {"method": "convex+refine", "outliers": {"method": "sparse-error"}},
    {"method": "alternate"},
    {"method": "convex+refine", "lam": 0.01, "alternation": {"signed": True}},
    {"method": "mean-shape"},
    {"method": "global", "search": {"proof_every": 3, "max_cells": 2000}},
    {"rotations": "orthogonal"},
    {"transforms": True},
    {"lam": 50.0},
    {"lam": "auto", "noise": 3.0},
    {"solver": {"tolerance": 1e-12}},
    {"proof": False},
]

CARS = [
    *({**term, "leave_out": "true_model", "lam": 1.0} for term in TERMS.values()),
    {"outliers": {"method": "ransac"}},
    {"camera": PERSPECTIVE, "outliers": {"method": "l1"}},
    {"camera": PERSPECTIVE, "method": "convex+refine", "leave_out": "true_model"},
    {"camera": PERSPECTIVE, "method": "alternate"},
    {"camera": PERSPECTIVE, "method": "mean-shape"},
]

PRIOR = [
    {"method": "posterior"},
    {"method": "posterior", "posterior": {"covariance": True}},
    {"method": "posterior", "posterior": {"least_score": None}},
    {"method": "sequences", "sequences": {"frame_rate": 24}},
    {"method": "sequences", "sequences": {"frame_rate": 24}, "posterior": {"covariance": True}},
]

KINDS = {"people": PEOPLE, "cars": CARS, "prior": PRIOR[:3], "walk": PRIOR}


@pytest.mark.parametrize(("kind", "keys"), [(k, keys) for k in KINDS for keys in KINDS[k]])
def test_an_honest_result_is_accepted(fitted, verify, dictionaries, landmarks, kind, keys):
    result = fitted(kind, **keys)
    found = verify(result, dictionaries[kind], [landmarks[kind]])
    with h5py.File(result) as file:
        n = len(file["item"])
        gaps = file["relative_gap"][()] if "relative_gap" in file else np.zeros(n)
        without = file["item"].asstr()[np.isnan(gaps)].tolist()
    assert found.done == n > 0
    assert list(found.failures) == without
    assert not without or keys["loss"] == "exact"
    proof = keys.get("method", "convex") in ("convex", "convex+refine") and "camera" not in keys
    proof &= keys.get("proof", True)
    robust = "method" in keys and "outliers" in keys
    proved = (n - len(without)) * (proof and not robust)
    assert (f"Proved: {proved} of {n}" in found.note) == (proved > 0)
    if kind in ("prior", "walk"):
        assert "Proved" not in found.note
        assert f"Consistent, not proved: {n} of {n}" in found.note


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "Proved: 12 of 12 images. The objective is within the gap stated of the optimum"),
        ({"proof": False}, "Consistent, not proved: 12 of 12 images; the file holds no proof"),
        ({"method": "convex+refine"}, "The dual of the convex program bounds the objective"),
        ({"method": "alternate"}, "12 of 12 images; alternate has no certificate"),
        ({"method": "convex+refine", "outliers": {"method": "l1"}}, "the refinement is not"),
        ({"method": "global", "search": {"proof_every": 3, "max_cells": 2000}},
         "Proved: 4 of 12 images. No rotation has an objective below"),
    ],
)  # fmt: skip
def test_what_is_proved_is_said(fitted, verify, dictionaries, keys, said):
    assert said in verify(fitted("people", **keys), dictionaries["people"]).note


def test_pursuit_has_no_proof_and_is_no_failure(world, verify):
    result = world.fit("people", "bases of people", method="pmp", transforms=True)
    found = verify(result, world.dictionary("bases of people"))
    assert found.failures == {}
    assert "pmp has no certificate" in found.note


@pytest.mark.parametrize(
    ("kind", "keys", "name", "values"),
    [
        ("cars", {"camera": PERSPECTIVE, "method": "mean-shape"}, "scale",
         lambda scale: scale * (1 + 5e-10)),
        ("prior", {"method": "posterior"}, "shape_correlation",
         lambda correlation: np.sign(correlation) * np.float32(1 + 2**-23)),
    ],
)  # fmt: skip
def test_a_number_may_be_rounded(fitted, changed, verify, dictionaries, kind, keys, name, values):
    """By a share of 1e-9, and as much as a number of 32 bits about 1."""

    def rounded(file):
        file[name][...] = values(file[name][()])

    found = verify(changed(fitted(kind, **keys), rounded), dictionaries[kind])
    assert found.failures == {}


def test_hard_images_are_accepted(tmp_path, verify, dictionaries, rng):
    """Far from the origin, tiny, huge, with strange confidences, hidden or on one point."""
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
    images = LandmarkSet(
        landmarks=landmarks,
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
            assert "Without a shape: 2 of 12 images." in found.note


def test_csv_holds_no_proof(tmp_path, verify, dictionaries):
    path = tmp_path / "shapes.csv"
    path.write_text("item,landmark,x,y,z\na,b,0,0,0\n")
    with pytest.raises(InputError, match="tables hold points only"):
        verify(path, dictionaries["people"])


def test_chunks_do_not_matter(fitted, verify, dictionaries, monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.verify.FEWEST", 1)
    monkeypatch.setattr("shapefit.pipelines.verify.MOST", 7)
    found = verify(fitted("cars", lam=1.0, leave_out="true_model"), dictionaries["cars"])
    assert (found.failures, found.done) == ({}, 108)


@pytest.fixture(scope="module")
def real(real_data, tmp_path_factory):
    """A dictionary of subject 86 and images of subject 13; one of all cars, and cars."""
    folder = tmp_path_factory.mktemp("real")
    shapes = read_shapes([real_data / "mocap/subject13_24fps.h5"])
    chosen = np.linspace(0, len(shapes) - 1, 150).astype(int)
    write_shapes(folder / "shapes.h5", shapes.take(chosen))
    save(folder / "cars.h5", load(real_data / "cars/annotated_cars.h5").take(slice(0, None, 8)))
    keys = {"camera": {"view": "turntable", "up": "y"}, "output": str(folder / "people.h5")}
    list(projecting.run(ProjectConfig(shapes=[str(folder / "shapes.h5")], **keys)))
    training = [str(real_data / "mocap/subject86_24fps.h5")]
    keys = {"k": 32, "iterations": 2, "every": 40, "output": str(folder / "people-dict.h5")}
    list(learn_dict.run(LearnDictConfig(shapes=training, **keys)))
    models = [str(real_data / "cars/models.h5")]
    keys = {"method": "exemplars", "align": "none", "output": str(folder / "cars-dict.h5")}
    list(learn_dict.run(LearnDictConfig(shapes=models, **keys)))
    return folder


ON_CARS = {"lam": 1.0, "leave_out": "true_model"}
CAMERA = {"camera": {**PERSPECTIVE, "principal_point": (0, 0)}}


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        *(("people", term) for term in TERMS.values()),
        *(("people", {"method": method}) for method in ("convex+refine", "alternate")),
        *(("cars", ON_CARS | term) for term in TERMS.values()),
        *(("cars", ON_CARS | CAMERA | {"method": m}) for m in ("convex+refine", "mean-shape")),
    ],
)
def test_real_results_are_accepted(real, verify, tmp_path, kind, keys):
    landmarks, dictionary = real / f"{kind}.h5", real / f"{kind}-dict.h5"
    fit_file(landmarks, dictionary, tmp_path / "result.h5", **keys)
    found = verify(tmp_path / "result.h5", dictionary, [landmarks])
    assert (found.done > 140, found.failures) == (True, {})
