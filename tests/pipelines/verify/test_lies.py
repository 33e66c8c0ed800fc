"""Each lie that is planted in a result is found, or the dataset is named as not checked."""

import hashlib
import json
import shutil

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shapefit.errors import InputError
from shapefit.geometry.pinhole import complete, undistort
from shapefit.geometry.rotations import rotation_about
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file
from tests.pipelines.verify.conftest import TERMS

IMAGE = 3
PERSPECTIVE = {"model": "perspective", "intrinsics": "camera_matrix"}
POSTERIOR = {"method": "posterior", "posterior": {"covariance": True}}
SEQUENCES = {"method": "sequences", "sequences": {"frame_rate": 25}}

CASES = {
    "convex": ("people", {"transforms": True}),
    "exact": ("people", {"loss": "exact"}),
    "sparse-error": ("people", {"outliers": {"method": "sparse-error"}}),
    "noise": ("people", {"lam": "auto", "noise": 3.0}),
    "refined": ("people", {"method": "convex+refine", "transforms": True}),
    "alternate": ("people", {"method": "alternate"}),
    "global": ("people", {"method": "global", "search": {"proof_every": 2, "max_cells": 2000}}),
    "mean": ("people", {"method": "mean-shape"}),
    "unproved": ("people", {"proof": False}),
    "left out": ("cars", {"lam": 1.0, "leave_out": "true_model"}),
    "ransac": ("cars", {"outliers": {"method": "ransac"}}),
    "camera": ("cars", {"camera": PERSPECTIVE, "method": "convex+refine"}),
    "posterior": ("prior", POSTERIOR),
    "walk": ("walk", {"method": "posterior"}),
    "narrow": ("walk", {"method": "posterior", "posterior": {"widening": 100.0}}),
    "sequences": ("walk", SEQUENCES),
}
"""Kinds of results, with every dataset that a fit writes."""


def is_told(found, name):
    return bool(found.failures) or f"`{name}`" in found.note


def false_rows(found):
    return "\n".join(row for row in found.note.splitlines() if "| 0 |" not in row)


def lie_in(node, row, size, up):
    """Change one entry of a dataset by a share of its largest number, 1e-6 or more."""
    values = node[()]
    if values.size == 0:
        return False
    at = np.unravel_index(row % values.size, values.shape)
    old = values[at]
    if values.dtype.kind in "OS":
        node[at] = "iteration limit" if old == b"optimal" else "another"
    elif values.dtype.kind == "b":
        node[at] = not old
    elif values.dtype.kind in "iu":
        node[at] = old + 1 if old < np.iinfo(values.dtype).max else old - 1
    else:
        finite = np.abs(values[np.isfinite(values)])
        change = size * max(1.0, finite.max(initial=0.0)) * (1 if up else -1)
        node[at] = (old if np.isfinite(old) else 0.0) + change
        return bool(np.isnan(old)) or node[at] != old
    return True


@pytest.fixture
def lie_is_told(fitted, verify, dictionaries, landmarks, tmp_path):
    """Change an entry of a dataset of a case; return whether that is found or named."""

    def told(case, name, row, size, up):
        kind, keys = CASES[case]
        lie = tmp_path / "lie.h5"
        shutil.copy(fitted(kind, **keys), lie)
        with h5py.File(lie, "r+") as file:
            if not lie_in(file[name], row, size, up):
                return True
        try:
            return is_told(verify(lie, dictionaries[kind], [landmarks[kind]]), name)
        except InputError:
            return True

    return told


def names_of(path):
    with h5py.File(path) as file:
        return sorted(file)


@pytest.mark.parametrize("case", CASES)
def test_a_change_of_each_dataset_is_found_or_named(fitted, lie_is_told, case):
    kind, keys = CASES[case]
    rng = np.random.default_rng([*case.encode()])
    for name in names_of(fitted(kind, **keys)):
        row, size, up = rng.integers(10**6), 10.0 ** rng.uniform(-6, 2), rng.random() < 0.5
        assert lie_is_told(case, name, row, size, up), (name, row, size, up)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
@settings(
    max_examples=60, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
@given(data=st.data())
def test_any_change_of_any_dataset_is_found_or_named(fitted, lie_is_told, case, data):
    kind, keys = CASES[case]
    name = data.draw(st.sampled_from(names_of(fitted(kind, **keys))), "dataset")
    row = data.draw(st.integers(0, 10**6), "entry")
    size = 10.0 ** data.draw(st.floats(-6, 2), "size")
    assert lie_is_told(case, name, row, size, data.draw(st.booleans(), "up"))


@pytest.mark.parametrize("case", ["global", "posterior", "left out", "camera"])
def test_a_dataset_that_is_gone_is_no_internal_error(fitted, changed, verify, dictionaries, case):
    kind, keys = CASES[case]
    with h5py.File(fitted(kind, **keys)) as file:
        names = set(file)
    for name in names:
        lie = changed(fitted(kind, **keys), lambda file, name=name: file.__delitem__(name))
        try:
            found = verify(lie, dictionaries[kind])
        except InputError:
            continue
        assert found.failures or f"`{name}`" not in found.note


@pytest.mark.parametrize("case", ["convex", "camera", "walk"])
def test_any_change_of_an_attribute_and_any_invention_is_found_or_named(
    fitted, changed, verify, dictionaries, landmarks, case
):
    kind, keys = CASES[case]
    honest = fitted(kind, **keys)
    with h5py.File(honest) as file:
        attributes, n = dict(file.attrs), len(file["item"])
        invented = {"foreign", "relative_gap", "shape_sd", "modes", "removed_distortion"} - set(
            file
        )

    def change(name):
        def lie(file):
            value = attributes[name]
            text = isinstance(value, str)
            file.attrs[name] = f"{value} " if text else 2 * value + 1
            if name == "inputs":
                turned = {key: digest[::-1] for key, digest in json.loads(value).items()}
                file.attrs[name] = json.dumps(turned)

        return lie

    texts = {name for name, value in attributes.items() if not isinstance(value, bytes)}
    for name in texts - {"format", "version"}:
        try:
            found = verify(changed(honest, change(name)), dictionaries[kind], [landmarks[kind]])
        except InputError:
            continue
        assert is_told(found, name.removeprefix("shapefit_")), name
    for name in invented:
        shape = (n, 13, 3) if name == "shape_sd" else (n,)

        def invent(file, name=name, shape=shape):
            file[name] = np.ones(shape, int if name == "modes" else float)

        try:
            found = verify(changed(honest, invent), dictionaries[kind], [landmarks[kind]])
        except InputError:
            continue
        assert is_told(found, name), name


def states(name, other, *at):
    """Return the lie that an entry of the image in a dataset is `other` of what it is."""

    def lie(file):
        file[name][(IMAGE, *at)] = other(file[name][(IMAGE, *at)])

    return lie


def everywhere(**values):
    """Return the lie that datasets hold nothing but these values, or what they make of a file."""

    def lie(file):
        for name, value in values.items():
            file[name][...] = value(file) if callable(value) else value

    return lie


def another_atom(file):
    row = int(file["transform_count"][:IMAGE].sum())
    file["transform_atom"][row] = file["transform_atom"][row + 1]


def withhold_shape(file):
    file["scale"][IMAGE] = np.nan
    row, count = int(file["transform_count"][:IMAGE].sum()), int(file["transform_count"][IMAGE])
    for name in ("transform_atom", "active_transforms"):
        left = np.delete(file[name][()], slice(row, row + count), axis=0)
        file[name].resize(len(left), axis=0)
        file[name][...] = left
    file["transform_count"][IMAGE] = 0


TURN = rotation_about(np.array([1.0, 2.0, 3.0]), np.array([1e-6]))[0]

LIES = {
    "relative_gap follows": states("relative_gap", lambda gap: gap - 1e-7),
    "objective follows": states("objective", lambda P: P * (1 - 1e-7)),
    "the dual is feasible": states("dual", lambda Y: Y * (1 + 1e-7)),
    "the dual is balanced": states("dual", lambda Y: Y + 1e-7),
    "the transforms are in order": another_atom,
    "shapes follow": states("shapes", lambda z: z + 1e-4, 5, 2),
    "rotation is nearest": states("rotation", lambda R: TURN @ R),
    "rotation is proper": states("rotation", lambda R: -R),
    "translation follows": states("translation", lambda x: x + 1e-4, 0),
    "landmarks are those": states("landmarks", lambda x: x + 1e-10, 0, 0),
    "landmarks_fitted": states("landmarks_fitted", lambda x: x + 1e-4, 0, 0),
    "lambda follows": states("lambda", lambda lam: lam * (1 + 1e-9)),
    "residual follows": states("residual", lambda residual: 0.5 * residual),
    "status is one": withhold_shape,
}
"""The start of the claim that does not hold, and the lie."""


@pytest.mark.parametrize("loss", ["squared", "l1"])
@pytest.mark.parametrize("claim", LIES)
def test_a_false_claim_is_named(
    fitted, changed, verify, dictionaries, landmarks, item_of, loss, claim
):
    honest = fitted("people", **TERMS[loss])
    found = verify(changed(honest, LIES[claim]), dictionaries["people"], [landmarks["people"]])
    assert list(found.failures) == [item_of(honest, IMAGE)]
    if claim != "landmarks are those":  # a moved landmark is found by its size first
        assert f"| {claim}" in false_rows(found)


def whole(name, other):
    """Return the lie that a dataset is `other` of what it is."""
    return lambda file: file[name].__setitem__((), other(file[name][()]))


def at(row, other):
    """Return what changes some rows of a dataset."""

    def change(values):
        values[row] = other(values[row])
        return values

    return change


def raise_limit(file):
    config = json.loads(file.attrs["config"])
    config["posterior"]["implausible"] = 0.999
    file.attrs["config"] = json.dumps(config)
    file.attrs["config_digest"] = hashlib.sha256(file.attrs["config"].encode()).hexdigest()


def noise_for_shapes(file):
    shapes = file["shapes"][()]
    shapes += np.random.default_rng(1).normal(0, 0.2 * np.nanstd(shapes), shapes.shape)
    file["shapes"][...] = shapes
    file["landmarks_fitted"][...] = shapes[..., :2]


def exchange(file):
    names = file["input_landmark_names"][()]
    left = np.array([name.replace(b"R", b"?").replace(b"L", b"R") for name in names])
    file["input_landmark_names"][...] = [name.replace(b"?", b"L") for name in left]


def reverse_edges(file):
    file["edges"][0, 0] = (file["edges"][0, 0] + 1) % 13


FOUND = {
    "rotation of zeros": ("convex", whole("rotation", lambda R: 0.0 * R)),
    "rotation twice as long": ("convex", whole("rotation", lambda R: 2.0 * R)),
    "rotation all but zero": ("convex", whole("rotation", lambda R: 1e-300 * R)),
    "rotation of a posterior": ("walk", whole("rotation", lambda R: 0.0 * R)),
    "bars negative": ("posterior", whole("shape_sd", np.negative)),
    "bars nan": ("posterior", everywhere(shape_sd=np.nan)),
    "bars infinite": ("walk", everywhere(shape_sd=np.inf)),
    "bars a tenth": ("posterior", whole("shape_sd", lambda sd: 0.1 * sd)),
    "trusted and not exchanged": ("walk", whole("trusted", lambda trusted: 1 - trusted)),
    "reasons in other words": ("walk", everywhere(reasons="all fine")),
    "covariance": ("posterior", everywhere(shape_covariance=0.0)),
    "correlation": ("walk", everywhere(shape_correlation=5.0)),
    "correlation of inputs": ("walk", everywhere(input_shape_correlation=-2.0)),
    "inlier_probability": ("walk", everywhere(inlier_probability=-3.0)),
    "p_value": ("walk", everywhere(p_value=17.0)),
    "scale": ("walk", everywhere(scale=0.0)),
    "scale of sequences": ("sequences", everywhere(scale=0.0)),
    "input shapes": ("walk", everywhere(input_shapes=0.0)),
    "limit of the verdict": ("narrow", raise_limit),
    "noise for shapes": ("walk", noise_for_shapes),
    "left and right exchanged": ("walk", exchange),
    "scale infinite": ("convex", everywhere(scale=np.inf)),
    "distortion": ("convex", lambda f: f.create_dataset("removed_distortion", data=[0.1] * 5)),
    "edges": ("convex", reverse_edges),
    "gap withheld": ("refined", lambda f: f.__delitem__("relative_gap")),
    "the cells hold: split": (
        "global", whole("tree_splits", at(slice(2), lambda s: [4 if s[0] == 5 else 5, -1])),
    ),
    "the cells hold: root": (
        "global", whole("tree_rotations", at(4, lambda q: q[[1, 2, 3, 0]] + 0.1)),
    ),
    "the cells hold: middle": ("global", whole("tree_rotations", at(61, lambda q: q + 1e-9))),
    "the multipliers are feasible: exchange": (
        "global", whole("tree_multipliers", lambda Y: Y[::-1]),
    ),
    "the multipliers are feasible: scale": (
        "global", whole("tree_multipliers", at(slice(60), lambda Y: 1.2 * Y)),
    ),
    "the multipliers have the value: sign": (
        "global", whole("tree_multipliers", at(7, lambda Y: -Y)),
    ),
    "the multipliers have the value: bound": (
        "global", whole("relative_gap", at(0, lambda gap: 0.9 * gap)),
    ),
    "the multipliers are balanced: moved": (
        "global", whole("tree_multipliers", at(3, lambda Y: Y + 1e-6)),
    ),
}  # fmt: skip
"""What is changed, or the claim that does not hold: how -> the kind of result, and the lie."""


@pytest.mark.parametrize("name", FOUND)
def test_what_needs_no_solver_is_checked(fitted, changed, verify, dictionaries, landmarks, name):
    case, lie = FOUND[name]
    kind, keys = CASES[case]
    lied = changed(fitted(kind, **keys), lie)
    given = [[landmarks[kind]], []]
    if name == "left and right exchanged":  # which the files of landmarks alone know
        given.pop()
    for files in given:
        found = verify(lied, dictionaries[kind], files)
        assert found.failures
        claim, way, _ = name.partition(": ")
        assert not way or f"| {claim}" in false_rows(found)


def test_no_images_prove_nothing(fitted, verify, dictionaries, tmp_path):
    from shapefit.io import read_results, result_writer

    with result_writer(tmp_path / "none.h5") as writer:
        writer.append(read_results(fitted("people"), proofs=True).take(slice(0)))
    found = verify(tmp_path / "none.h5", dictionaries["people"])
    assert "holds no image" in "".join(found.failures.values())
    assert "nothing is proved" in found.note


@pytest.fixture
def moved(project, tmp_path, dictionaries):
    """Landmarks, coefficients that bend no lens of theirs, and a fit of what these make of them."""
    images = load(project / "sample_data/cars_views.h5")
    matrix, bend = images.columns["camera_matrix"], np.array([0.08, -0.02, 0.001, 0.002, 0.0])
    true, other = tmp_path / "true.h5", tmp_path / "other.h5"
    save(true, images)
    shutil.copy(true, other)
    matrix = np.broadcast_to(np.asarray(matrix, float), (len(images), 3, 3))
    focal, centre = matrix[:, [0, 1], [0, 1]], matrix[:, :2, 2]
    every = np.broadcast_to(complete(bend), (len(images), 8))
    flat = (images.landmarks - centre[..., None]) / focal[..., None]
    straight = centre[..., None] + focal[..., None] * undistort(flat, every)
    with h5py.File(other, "r+") as file:
        file["landmarks"][...] = straight.swapaxes(1, 2)
    output = tmp_path / "result.h5"
    fit_file(other, dictionaries["cars"], output)
    return true, bend, output


def test_a_distortion_that_is_not_in_the_file_is_found(moved, verify, dictionaries):
    true, bend, result = moved
    with h5py.File(result, "r+") as file:
        file["removed_distortion"] = bend
        inputs = json.loads(file.attrs["inputs"])
        digest = hashlib.sha256(true.read_bytes()).hexdigest()
        inputs = {k: digest if k.endswith("other.h5") else v for k, v in inputs.items()}
        file.attrs["inputs"] = json.dumps(inputs)
    found = verify(result, dictionaries["cars"], [true])
    assert "is not that of the landmarks" in found.failures["removed_distortion"]


@pytest.mark.parametrize("loss", list(TERMS))
def test_a_raised_status_is_found(fitted, changed, verify, dictionaries, item_of, loss):
    honest = fitted("people", **TERMS[loss], solver={"max_iterations": 1})
    found = verify(changed(honest, everywhere(status="optimal")), dictionaries["people"])
    assert len(found.failures) == found.done


def test_another_dictionary_is_found_by_digest_and_in_every_image(fitted, verify, dictionaries):
    found = verify(fitted("people"), dictionaries["other people"])
    assert "the digests differ" in found.failures[str(dictionaries["other people"])]
    assert len(found.failures) == found.done + 1
    with pytest.raises(InputError, match="landmark"):
        verify(fitted("people"), dictionaries["cars"])


def test_another_file_of_landmarks_is_found(
    fitted, verify, dictionaries, landmarks, tmp_path, item_of
):
    lines = landmarks["people"].read_text().splitlines()
    cells = lines[1].split(",")
    lines[1] = ",".join([*cells[:2], str(float(cells[2]) + 0.1), *cells[3:]])
    other = tmp_path / "views.csv"
    other.write_text("\n".join(lines) + "\n")
    honest = fitted("people")
    found = verify(honest, dictionaries["people"], [other])
    assert set(found.failures) == {str(other), item_of(honest, 0)}
    assert "without `--landmarks` also not `confidence`" not in found.note
    note = verify(honest, dictionaries["people"]).note.splitlines()[-1]
    assert all(f"`{name}`" in note for name in ("item", "landmarks", "unit", "y_axis"))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize(
    "name", ["objective", "dual", "convex_translation", "active_transforms", "coefficients",
             "shapes", "rotation", "translation", "scale", "landmarks", "lambda", "residual"],
)  # fmt: skip
def test_numbers_that_are_none_hold_for_nothing(
    fitted, changed, verify, dictionaries, landmarks, item_of, name, value
):
    honest = fitted("people", outliers={"method": "sparse-error"})

    def spoil(file):
        row = int(file["transform_count"][:IMAGE].sum())
        file[name][row if name == "active_transforms" else IMAGE] = value

    spoilt = changed(honest, spoil)
    if name == "shapes" and not np.isnan(value):  # refused by whatever reads it
        with pytest.raises(InputError, match=r"item '.*', landmark"):
            verify(spoilt, dictionaries["people"])
        return
    found = verify(spoilt, dictionaries["people"], [landmarks["people"]])
    assert list(found.failures) == [item_of(honest, IMAGE)]


def test_a_file_that_is_no_result_of_a_fit_is_refused(fitted, changed, verify, dictionaries):
    honest = fitted("people", outliers={"method": "l1"})

    def reshape(file):
        values = file["residual"][()]
        del file["residual"]
        file["residual"] = np.repeat(values[:, None], 2, axis=1)

    with pytest.raises(InputError, match=r"/residual: has the shape \(12, 2\)"):
        verify(changed(honest, reshape), dictionaries["people"])
    for wrong in (-1, 1, 10**6):
        lied = changed(honest, states("transform_count", lambda count, by=wrong: count + by))
        with pytest.raises(InputError, match="the file was changed: fit again"):
            verify(lied, dictionaries["people"])
    for text in ("", "[]", "{}", "no", '{"method": "convex"}'):
        lied = changed(honest, lambda file, text=text: file.attrs.__setitem__("config", text))
        with pytest.raises(InputError, match="are not those of a fit"):
            verify(lied, dictionaries["people"])


def test_using_or_hiding_the_model_that_is_left_out_is_found(
    fitted, changed, verify, dictionaries, item_of
):
    honest = fitted("cars", lam=1.0, leave_out="true_model")

    def use(file):
        with h5py.File(dictionaries["cars"]) as own:
            names = own["atom_item"].asstr()[()].tolist()
        row = int(file["transform_count"][:IMAGE].sum())
        file["transform_atom"][row] = names.index(file["left_out"].asstr()[IMAGE])

    for lie in (use, states("left_out", lambda _: "")):
        found = verify(changed(honest, lie), dictionaries["cars"])
        assert list(found.failures) == [item_of(honest, IMAGE)]
