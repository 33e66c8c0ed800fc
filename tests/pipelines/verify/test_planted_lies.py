"""Each lie that is planted in a result is found, in the image where it was planted."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.rotations import rotation_about

IMAGE = 3
TURN = rotation_about(np.array([1.0, 2.0, 3.0]), np.array([1e-9]))[0]

TERMS = {
    "squared": {},
    "exact": {"loss": "exact"},
    "l1": {"outliers": {"method": "l1"}},
    "sparse-error": {"outliers": {"method": "sparse-error"}},
}
"""Data term -> the keys of `fit` that choose it."""


def gap_lowered(file):
    file["relative_gap"][IMAGE] *= 0.9


def gap_unknown(file):
    file["relative_gap"][IMAGE] = np.nan


def objective_lowered(file):
    file["objective"][IMAGE] *= 1 - 1e-10


def dual_scaled_up(file):
    file["dual"][IMAGE] *= 1 + 1e-9


def dual_scaled_down(file):
    file["dual"][IMAGE] *= 0.9


def dual_shifted(file):
    file["dual"][IMAGE] += 1e-9


def transform_changed(file):
    rows = file["active_transforms"]
    rows[int(file["transform_count"][:IMAGE].sum()), 0, 1] += 1e-9


def transform_of_another_atom(file):
    row = int(file["transform_count"][:IMAGE].sum())
    file["transform_atom"][row] = file["transform_atom"][row + 1]


def coefficient_changed(file):
    atom = int(np.argmax(file["coefficients"][IMAGE]))
    file["coefficients"][IMAGE, atom] *= 1 + 1e-9


def coefficient_invented(file):
    atom = int(np.argmin(file["coefficients"][IMAGE]))
    file["coefficients"][IMAGE, atom] += 1e-9


def shape_moved(file):
    file["shapes"][IMAGE, 5, 2] += 1e-7


def rotation_turned(file):
    file["rotation"][IMAGE] = TURN @ file["rotation"][IMAGE]


def rotation_mirrored(file):
    file["rotation"][IMAGE] = -file["rotation"][IMAGE]


def translation_moved(file):
    file["translation"][IMAGE, 0] += 1e-7


def scale_changed(file):
    file["scale"][IMAGE] *= 1 + 1e-10


def landmark_moved(file):
    file["landmarks"][IMAGE, 0, 0] += 1e-6


def landmark_hidden(file):
    file["landmarks"][IMAGE, 0] = np.nan


def fitted_landmark_moved(file):
    file["landmarks_fitted"][IMAGE, 0, 0] += 1e-7


def lambda_changed(file):
    file["lambda"][IMAGE] *= 1 + 1e-9


def residual_lowered(file):
    file["residual"][IMAGE] *= 0.5


def shape_withheld(file):
    file["scale"][IMAGE] = np.nan
    row = int(file["transform_count"][:IMAGE].sum())
    count = int(file["transform_count"][IMAGE])
    for name in ("transform_atom", "active_transforms"):
        left = np.delete(file[name][()], slice(row, row + count), axis=0)
        file[name].resize(len(left), axis=0)
        file[name][...] = left
    file["transform_count"][IMAGE] = 0


LIES = [
    (gap_lowered, "the gap is (P - D) / P"),
    (gap_unknown, "the gap is (P - D) / P"),
    (objective_lowered, "the objective is P"),
    (dual_scaled_up, "the dual is feasible"),
    (dual_scaled_down, "the gap is (P - D) / P"),
    (dual_shifted, "the dual is"),
    (transform_changed, "the objective is P"),
    (transform_of_another_atom, "the transforms are in order"),
    (coefficient_changed, "coefficients follow from the transforms"),
    (coefficient_invented, "coefficients follow from the transforms"),
    (shape_moved, "shapes follow from the fit"),
    (rotation_turned, "rotation is nearest to the transforms"),
    (rotation_mirrored, "rotation is"),
    (translation_moved, "translation follows from the fit"),
    (scale_changed, "scale follows from the landmarks"),
    (landmark_moved, ""),
    (landmark_hidden, ""),
    (fitted_landmark_moved, "landmarks_fitted follow from the fit"),
    (lambda_changed, "lambda is that of the config"),
    (residual_lowered, "residual follows from the fit"),
    (shape_withheld, "status is one of the method"),
]


@pytest.mark.parametrize("loss", ["squared", "l1"])
@pytest.mark.parametrize(("lie", "claim"), LIES, ids=[lie.__name__ for lie, _ in LIES])
def test_a_lie_is_found(
    fitted, changed, verify, dictionaries, landmarks, item_of, loss, lie, claim
):
    honest = fitted("people", **TERMS[loss])
    found = verify(changed(honest, lie), dictionaries["people"], [landmarks["people"]])
    assert list(found.failures) == [item_of(honest, IMAGE)]
    assert claim in found.failures[item_of(honest, IMAGE)]


@pytest.mark.parametrize("loss", ["squared", "exact", "l1", "sparse-error"])
def test_a_raised_status_is_found(fitted, changed, verify, dictionaries, item_of, loss):
    honest = fitted("people", **TERMS[loss], solver={"max_iterations": 1})

    def raised(file):
        assert file["status"].asstr()[IMAGE] == "iteration limit"
        file["status"][IMAGE] = "optimal"

    unproved = list(verify(honest, dictionaries["people"]).failures)
    found = verify(changed(honest, raised), dictionaries["people"])
    if loss == "exact":  # an image that misses its landmarks has no gap
        assert list(found.failures) == unproved
        claim = "the gap is (P - D) / P"
    else:
        assert unproved == []
        assert list(found.failures) == [item_of(honest, IMAGE)]
        claim = "an optimal image is within the"
    assert claim in found.failures[item_of(honest, IMAGE)]


def test_a_status_of_another_method_is_found(fitted, changed, verify, dictionaries, item_of):
    honest = fitted("people", method="convex+refine")

    def raised(file):
        file["status"][IMAGE] = "optimal"

    found = verify(changed(honest, raised), dictionaries["people"])
    assert list(found.failures) == [item_of(honest, IMAGE)]


def test_another_dictionary_is_found_by_digest_and_in_every_image(fitted, verify, dictionaries):
    found = verify(fitted("people"), dictionaries["other_people"])
    path = str(dictionaries["other_people"])
    assert "the digests differ" in found.failures[path]
    assert len(found.failures) == found.done + 1


def test_a_dictionary_of_another_size_is_refused(fitted, verify, dictionaries):
    with pytest.raises(InputError, match=r"landmark"):
        verify(fitted("people"), dictionaries["cars"])


def test_another_file_of_landmarks_is_found(
    fitted, verify, dictionaries, landmarks, tmp_path, item_of
):
    lines = landmarks["people"].read_text().splitlines()
    with_xy = lines[1].split(",")
    with_xy[2] = str(float(with_xy[2]) + 0.1)
    lines[1] = ",".join(with_xy)
    other = tmp_path / "views.csv"
    other.write_text("\n".join(lines) + "\n")
    honest = fitted("people")
    assert verify(honest, dictionaries["people"], [landmarks["people"]]).failures == {}
    found = verify(honest, dictionaries["people"], [other])
    assert set(found.failures) == {str(other), item_of(honest, 0)}
    assert "landmarks are those of the file" in found.failures[item_of(honest, 0)]


def test_a_changed_config_is_found(fitted, changed, verify, dictionaries):
    def loosen(file):
        file.attrs["config"] = file.attrs["config"].replace("1e-06", "0.1")

    found = verify(changed(fitted("people"), loosen), dictionaries["people"])
    assert list(found.failures) == ["config"]


CLAIMED = [
    *("objective", "dual", "convex_translation", "active_transforms", "coefficients", "shapes"),
    *("rotation", "translation", "scale", "landmarks", "landmarks_fitted", "lambda", "residual"),
]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("name", CLAIMED)
def test_numbers_that_are_none_hold_for_nothing(
    fitted, changed, verify, dictionaries, landmarks, item_of, name, value
):
    honest = fitted("people", outliers={"method": "sparse-error"})

    def spoil(file):
        first = int(file["transform_count"][:IMAGE].sum())
        file[name][first if name == "active_transforms" else IMAGE] = value

    found = verify(changed(honest, spoil), dictionaries["people"], [landmarks["people"]])
    assert list(found.failures) == [item_of(honest, IMAGE)]


@pytest.mark.parametrize("name", ["landmarks", "lambda", "residual", "outliers"])
def test_a_dataset_of_another_shape_is_refused(fitted, changed, verify, dictionaries, name):
    def reshape(file):
        values = file[name][()]
        del file[name]
        file[name] = np.repeat(values[:, None], 2, axis=1)

    with pytest.raises(InputError, match=rf"/{name}: holds .* of the shape"):
        verify(
            changed(fitted("people", outliers={"method": "l1"}), reshape), dictionaries["people"]
        )


@pytest.mark.parametrize("text", ["", "[]", "{}", "no", '{"method": "convex"}'])
def test_a_config_that_is_none_is_refused(fitted, changed, verify, dictionaries, text):
    def spoil(file):
        file.attrs["config"] = text

    with pytest.raises(InputError, match="are not those of a fit"):
        verify(changed(fitted("people"), spoil), dictionaries["people"])


class TestModelsLeftOut:
    def keys(self):
        return {"lam": 1.0, "leave_out": "true_model"}

    def test_using_the_model_is_found(self, fitted, changed, verify, dictionaries, item_of):
        honest = fitted("cars", **self.keys())

        def use(file):
            names = [name.decode() for name in h5_items(dictionaries["cars"])]
            atom = names.index(file["left_out"].asstr()[IMAGE])
            row = int(file["transform_count"][:IMAGE].sum())
            file["transform_atom"][row] = atom

        found = verify(changed(honest, use), dictionaries["cars"])
        assert list(found.failures) == [item_of(honest, IMAGE)]

    def test_hiding_what_was_left_out_is_found(
        self, fitted, changed, verify, dictionaries, item_of
    ):
        honest = fitted("cars", **self.keys())

        def forget(file):
            file["left_out"][IMAGE] = ""

        found = verify(changed(honest, forget), dictionaries["cars"])
        assert list(found.failures) == [item_of(honest, IMAGE)]
        assert "left_out is the item" in found.failures[item_of(honest, IMAGE)]


def h5_items(path):
    import h5py

    with h5py.File(path) as file:
        return file["atom_item"][()]


ONE_ROTATION = [
    (coefficient_changed, ""),
    (shape_moved, "shapes follow"),
    (objective_lowered, "the objective is that of the fit"),
    (gap_lowered, "the gap is that to the dual"),
    (dual_scaled_up, "the dual is feasible"),
    (transform_changed, "the convex objective is P"),
    (translation_moved, "translation follows"),
    (fitted_landmark_moved, "landmarks_fitted follow"),
]


@pytest.mark.parametrize(
    ("lie", "claim"), ONE_ROTATION, ids=[lie.__name__ for lie, _ in ONE_ROTATION]
)
def test_a_lie_in_a_refined_result_is_found(
    fitted, changed, verify, dictionaries, item_of, lie, claim
):
    honest = fitted("people", method="convex+refine")
    found = verify(changed(honest, lie), dictionaries["people"])
    assert list(found.failures) == [item_of(honest, IMAGE)]
    assert claim in found.failures[item_of(honest, IMAGE)]


def depth_changed(file):
    file["camera_translation"][IMAGE, 2] *= 1 + 1e-8


@pytest.mark.parametrize(
    "lie",
    [shape_moved, fitted_landmark_moved, depth_changed, dual_scaled_up, rotation_mirrored],
)
def test_a_lie_in_a_perspective_result_is_found(
    fitted, changed, verify, dictionaries, item_of, lie
):
    camera = {"model": "perspective", "intrinsics": "camera_matrix"}
    honest = fitted("cars", method="convex+refine", camera=camera)
    found = verify(changed(honest, lie), dictionaries["cars"])
    assert list(found.failures) == [item_of(honest, IMAGE)]
