"""Honest results of every loss and method are accepted, and verify says what it covers."""

import h5py
import numpy as np
import pytest

from shapefit.config import LearnDictConfig
from shapefit.errors import InputError
from shapefit.io import LandmarkSet, read_dictionary
from shapefit.pipelines.learn_dict import run as learn_dict
from tests.io.files import save
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
    {"method": "convex+refine", "alternation": {"signed": True}},
    {"method": "mean-shape"},
    {"rotations": "orthogonal"},
    {"transforms": True},
    {"lam": 50.0},
    {"lam": "auto", "noise": 3.0},
    {"solver": {"tolerance": 1e-12}},
]

CARS = [
    *({**term, "leave_out": "true_model", "lam": 1.0} for term in TERMS.values()),
    {"outliers": {"method": "ransac"}},
    {"outliers": {"method": "truncated"}, "method": "convex+refine"},
    {"camera": PERSPECTIVE, "outliers": {"method": "l1"}},
    {"camera": PERSPECTIVE, "method": "convex+refine", "leave_out": "true_model"},
    {"camera": PERSPECTIVE, "method": "alternate"},
    {"camera": PERSPECTIVE, "method": "mean-shape"},
]


@pytest.mark.parametrize(
    ("kind", "keys"), [("people", keys) for keys in PEOPLE] + [("cars", keys) for keys in CARS]
)
def test_an_honest_result_is_accepted(fitted, verify, dictionaries, landmarks, kind, keys):
    result = fitted(kind, **keys)
    found = verify(result, dictionaries[kind], [landmarks[kind]])
    with h5py.File(result) as file:
        gaps = file["relative_gap"][()] if "relative_gap" in file else np.zeros(found.done)
        without = file["item"].asstr()[np.isnan(gaps)].tolist()
        assert found.done == len(file["item"]) > 0
    assert list(found.failures) == without
    assert not without or keys["loss"] == "exact"


def test_pmp_has_no_proof_and_is_no_failure(project, tmp_path, verify, landmarks):
    dictionary, result = tmp_path / "bases.h5", tmp_path / "result.h5"
    shapes = [str(project / "sample_data/people_train.h5")]
    list(
        learn_dict.run(
            LearnDictConfig(shapes=shapes, method="pca-bases", every=8, output=str(dictionary))
        )
    )
    fit_file(landmarks["people"], dictionary, result, method="pmp")
    found = verify(result, dictionary)
    assert found.failures == {}
    assert "The method pmp has no proof of an optimum." in found.note


@pytest.mark.parametrize(
    ("kind", "keys", "said"),
    [
        ("people", {}, "The optimum of the convex program is proved to the gap stated."),
        ("people", {"method": "convex+refine"}, "bounded by the dual of the convex program"),
        ("people", {"method": "alternate"}, "alternate has no proof of an optimum"),
        ("cars", {"camera": PERSPECTIVE, "method": "convex+refine", "leave_out": "true_model"},
         "the refinement under perspective starts is proved; no bound is known"),
        ("people", {"method": "convex+refine", "outliers": {"method": "l1"}}, "robust program"),
    ],
)  # fmt: skip
def test_the_note_says_what_is_covered(fitted, verify, dictionaries, kind, keys, said):
    assert said in verify(fitted(kind, **keys), dictionaries[kind]).note


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
        assert verify(output, dictionaries["people"], [path]).failures == {}


def test_a_gap_of_nan_is_unproved_at_the_iteration_limit(fitted, changed, verify, dictionaries):
    def unknown(file):
        file["relative_gap"][:] = np.nan

    found = verify(changed(fitted("people"), unknown), dictionaries["people"])
    assert len(found.failures) == found.done == 12
    assert "Of 0 of 12 images" in found.note


def test_a_result_without_dual_says_so(fitted, changed, verify, dictionaries):
    with pytest.raises(InputError, match=r"holds no dual .*fit again with `proof: true`"):
        verify(fitted("people", proof=False), dictionaries["people"])

    def drop(file):
        del file["dual"]

    with pytest.raises(InputError, match="holds no dual"):
        verify(changed(fitted("people"), drop), dictionaries["people"])


def test_csv_holds_no_proof(tmp_path, verify, dictionaries):
    path = tmp_path / "shapes.csv"
    path.write_text("item,landmark,x,y,z\na,b,0,0,0\n")
    with pytest.raises(InputError, match="CSV holds points only"):
        verify(path, dictionaries["people"])


def test_counts_that_do_not_fit_the_transforms_are_refused(fitted, changed, verify, dictionaries):
    for wrong in (-1, 1, 10**6):

        def change(file, wrong=wrong):
            file["transform_count"][2] += wrong

        with pytest.raises(InputError, match="the file was changed: fit again"):
            verify(changed(fitted("people"), change), dictionaries["people"])


@pytest.mark.parametrize("size", [64, 100])
def test_chunks_do_not_matter(fitted, verify, dictionaries, monkeypatch, size):
    monkeypatch.setattr("shapefit.pipelines.verify.FEWEST", 1)
    monkeypatch.setattr("shapefit.pipelines.verify.MOST", 7)
    found = verify(fitted("cars", loss="squared", leave_out="true_model"), dictionaries["cars"])
    assert (found.failures, found.done) == ({}, 108)
