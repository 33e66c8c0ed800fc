"""Each lie that is planted in a result is found, in the image where it was planted."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.rotations import rotation_about
from tests.pipelines.verify.conftest import TERMS

IMAGE = 3
TURN = rotation_about(np.array([1.0, 2.0, 3.0]), np.array([1e-9]))[0]


def states(name, other, *at):
    """Return the lie that an entry of the image in a dataset is `other` of what it is."""

    def lie(file):
        file[name][(IMAGE, *at)] = other(file[name][(IMAGE, *at)])

    return lie


def first_row(file):
    """Row of the first active transform of the image."""
    return int(file["transform_count"][:IMAGE].sum())


def change_transform(file):
    file["active_transforms"][first_row(file), 0, 1] += 1e-9


def take_another_atom(file):
    row = first_row(file)
    file["transform_atom"][row] = file["transform_atom"][row + 1]


def change_coefficient(file):
    atom = int(np.argmax(file["coefficients"][IMAGE]))
    file["coefficients"][IMAGE, atom] *= 1 + 1e-9


def invent_coefficient(file):
    atom = int(np.argmin(file["coefficients"][IMAGE]))
    file["coefficients"][IMAGE, atom] += 1e-9


def withhold_shape(file):
    file["scale"][IMAGE] = np.nan
    row, count = first_row(file), int(file["transform_count"][IMAGE])
    for name in ("transform_atom", "active_transforms"):
        left = np.delete(file[name][()], slice(row, row + count), axis=0)
        file[name].resize(len(left), axis=0)
        file[name][...] = left
    file["transform_count"][IMAGE] = 0


LIES = {
    "gap lowered": states("relative_gap", lambda gap: 0.9 * gap),
    "gap unknown": states("relative_gap", lambda gap: np.nan),
    "objective lowered": states("objective", lambda P: P * (1 - 1e-10)),
    "dual scaled up": states("dual", lambda Y: Y * (1 + 1e-9)),
    "dual scaled down": states("dual", lambda Y: 0.9 * Y),
    "dual shifted": states("dual", lambda Y: Y + 1e-9),
    "transform changed": change_transform,
    "transform of another atom": take_another_atom,
    "coefficient changed": change_coefficient,
    "coefficient invented": invent_coefficient,
    "shape moved": states("shapes", lambda z: z + 1e-7, 5, 2),
    "rotation turned": states("rotation", lambda R: TURN @ R),
    "rotation mirrored": states("rotation", lambda R: -R),
    "translation moved": states("translation", lambda x: x + 1e-7, 0),
    "scale changed": states("scale", lambda s: s * (1 + 1e-10)),
    "landmark moved": states("landmarks", lambda x: x + 1e-6, 0, 0),
    "landmark hidden": states("landmarks", lambda point: np.nan, 0),
    "fitted landmark moved": states("landmarks_fitted", lambda x: x + 1e-7, 0, 0),
    "lambda changed": states("lambda", lambda lam: lam * (1 + 1e-9)),
    "residual lowered": states("residual", lambda residual: 0.5 * residual),
    "shape withheld": withhold_shape,
    "depth changed": states("camera_translation", lambda z: z * (1 + 1e-8), 2),
}

OF_A_PROGRAM = {
    "gap lowered": "the gap is (P - D) / P",
    "gap unknown": "the gap is (P - D) / P",
    "objective lowered": "the objective is P",
    "dual scaled up": "the dual is feasible",
    "dual scaled down": "the gap is (P - D) / P",
    "dual shifted": "the dual is",
    "transform changed": "the objective is P",
    "transform of another atom": "the transforms are in order",
    "coefficient changed": "coefficients follow from the transforms",
    "coefficient invented": "coefficients follow from the transforms",
    "shape moved": "shapes follow from the fit",
    "rotation turned": "rotation is nearest to the transforms",
    "rotation mirrored": "rotation is",
    "translation moved": "translation follows from the fit",
    "scale changed": "scale follows from the landmarks",
    "landmark moved": "",
    "landmark hidden": "",
    "fitted landmark moved": "landmarks_fitted follow from the fit",
    "lambda changed": "lambda is that of the config",
    "residual lowered": "residual follows from the fit",
    "shape withheld": "status is one of the method",
}
"""Lie -> the claim that does not hold."""


@pytest.mark.parametrize("loss", ["squared", "l1"])
@pytest.mark.parametrize(("lie", "claim"), OF_A_PROGRAM.items(), ids=OF_A_PROGRAM)
def test_a_lie_is_found(
    fitted, changed, verify, dictionaries, landmarks, item_of, loss, lie, claim
):
    honest = fitted("people", **TERMS[loss])
    found = verify(changed(honest, LIES[lie]), dictionaries["people"], [landmarks["people"]])
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
        file[name][first_row(file) if name == "active_transforms" else IMAGE] = value

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
            file["transform_atom"][first_row(file)] = atom

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


ONE_ROTATION = {
    "coefficient changed": "",
    "shape moved": "shapes follow",
    "objective lowered": "the objective is that of the fit",
    "gap lowered": "the gap is that to the dual",
    "dual scaled up": "the dual is feasible",
    "transform changed": "the convex objective is P",
    "translation moved": "translation follows",
    "fitted landmark moved": "landmarks_fitted follow",
}


@pytest.mark.parametrize(("lie", "claim"), ONE_ROTATION.items(), ids=ONE_ROTATION)
def test_a_lie_in_a_refined_result_is_found(
    fitted, changed, verify, dictionaries, item_of, lie, claim
):
    honest = fitted("people", method="convex+refine")
    found = verify(changed(honest, LIES[lie]), dictionaries["people"])
    assert list(found.failures) == [item_of(honest, IMAGE)]
    assert claim in found.failures[item_of(honest, IMAGE)]


@pytest.mark.parametrize(
    "lie",
    [
        "shape moved",
        "fitted landmark moved",
        "depth changed",
        "dual scaled up",
        "rotation mirrored",
    ],
)
def test_a_lie_in_a_perspective_result_is_found(
    fitted, changed, verify, dictionaries, item_of, lie
):
    camera = {"model": "perspective", "intrinsics": "camera_matrix"}
    honest = fitted("cars", method="convex+refine", camera=camera)
    found = verify(changed(honest, LIES[lie]), dictionaries["cars"])
    assert list(found.failures) == [item_of(honest, IMAGE)]


@pytest.mark.parametrize("factor", [0.0, 2.0, 1e-300, 1 + 1e-6])
@pytest.mark.parametrize("kind", ["people", "prior"])
def test_what_is_stated_as_rotation_is_one(fitted, changed, verify, dictionaries, kind, factor):
    honest = fitted(kind, method="convex" if kind == "people" else "posterior")

    def scale(file):
        file["rotation"][...] *= factor

    found = verify(changed(honest, scale), dictionaries[kind])
    assert len(found.failures) == found.done
    assert all("rotation is a rotation" in reason for reason in found.failures.values())
