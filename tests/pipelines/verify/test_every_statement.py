"""Whatever a result states is changed once: `verify` finds the lie, or names the dataset."""

import json

import numpy as np
import pytest
from pyarrow.lib import ArrowInvalid

from shapefit.errors import InputError
from shapefit.io import read_results, result_writer
from shapefit.io.layout import RESULTS
from shapefit.pipelines.fit.record import OF_A_RESULT
from shapefit.verification.fates import ATTRIBUTES, DATASETS

IMAGE = 3
PERSPECTIVE = {"model": "perspective", "intrinsics": "camera_matrix"}
READINGS = {"modes": 0.5, "proof_every": 2, "max_cells": 2000}

CASES = {
    "convex": ("people", {"transforms": True}),
    "sparse-error": ("people", {"outliers": {"method": "sparse-error"}}),
    "noise": ("people", {"lam": "auto", "noise": 3.0}),
    "refined": ("people", {"method": "convex+refine", "transforms": True}),
    "alternate": ("people", {"method": "alternate"}),
    "readings": ("people", {"method": "global", "search": READINGS}),
    "mean": ("people", {"method": "mean-shape"}),
    "left out": ("cars", {"lam": 1.0, "leave_out": "true_model"}),
    "ransac": ("cars", {"outliers": {"method": "ransac"}}),
    "camera": ("cars", {"camera": PERSPECTIVE, "method": "convex+refine"}),
    "posterior": ("prior", {"method": "posterior", "posterior": {"covariance": True}}),
}

FIELDS = {known.name: known for known in RESULTS.datasets}


def test_every_dataset_and_attribute_has_a_fate(fitted):
    assert DATASETS.keys() == OF_A_RESULT | {"confidence"}
    for kind, keys in CASES.values():
        result = read_results(fitted(kind, **keys), proofs=True)
        assert result.attributes.keys() | {"unit", "y_axis", "frame_rate"} <= ATTRIBUTES.keys() | {
            "metres_from"
        }


def changed(values, row):
    """Return other values, in one row."""
    values = np.array(values)
    if values.dtype.kind in "OUS":
        values[row] = "iteration limit" if str(values[row]) == "optimal" else "another"
    elif values.dtype.kind == "b":
        values[row] = ~values[row]
    elif values.dtype.kind in "iu":
        values[row] = values[row] + 1
    else:
        values[row] = np.where(np.isfinite(values[row]), 1.01 * values[row] + 0.01, 1.0)
    return values


def dataset_lies(result):
    """Yield the name of each dataset with a record in which one image states something else."""
    for name, known in FIELDS.items():
        value = getattr(result, known.attribute)
        if value is None or not np.size(value):
            continue
        counts = getattr(result, known.counted_by) if known.counted_by else None
        row = IMAGE if counts is None else int(np.flatnonzero(np.repeat(counts > 0, 1))[0])
        if name == "landmark_names":
            other = (value[1], value[0], *value[2:])
        else:
            other = changed(value, row)
        yield name, result.replaced(**{known.attribute: other})
    for name, value in ((n, v) for n, v in result.further.items() if n not in result.of_file):
        yield name, result.replaced(further=result.further | {name: changed(value, IMAGE)})


def attribute_lies(result):
    """Yield the name of each attribute with a record that states something else."""
    for name, value in result.attributes.items():
        other = 2 * value + 1 if isinstance(value, float) else f"{value} "
        if name == "inputs":
            other = json.dumps({key: digest[::-1] for key, digest in json.loads(value).items()})
        yield name, result.replaced(attributes={**result.attributes, name: other})
        if name in ("inputs", "config_digest"):
            rest = {key: value for key, value in result.attributes.items() if key != name}
            yield name, result.replaced(attributes=rest)
    yield "y_axis", result.replaced(y_axis="up" if result.y_axis == "down" else "down")
    yield "unit", result.replaced(unit="furlong")
    yield "frame_rate", result.replaced(frame_rate=17.0)


def inventions(result):
    """Yield the name of each dataset that another method writes, with a record that has it, too."""
    n, p = len(result), len(result.landmark_names)
    axes = {"n": n, "p": p, "q": 2, "k": 3}
    for name in sorted(DATASETS.keys() - FIELDS.keys() - result.further.keys() - {"confidence"}):
        yield name, result.replaced(further=result.further | {name: np.ones(n)})
    for name in ("shape_sd", "mesh_vertices", "transforms", "relative_gap"):
        known = FIELDS[name]
        if getattr(result, name) is None:
            shape = [axes.get(axis, axis) for axis in known.memory_axes]
            if name == "transforms" and result.coefficients is not None:
                shape[1] = result.coefficients.shape[1]
            yield name, result.replaced(**{name: np.ones(shape)})
    yield "foreign", result.replaced(further=result.further | {"foreign": np.ones(n)})


@pytest.mark.parametrize(
    ("case", "suffix"),
    [
        ("convex", "h5"),
        ("left out", "h5"),
        ("readings", "h5"),
        *(pytest.param(case, "h5", marks=pytest.mark.slow) for case in CASES),
    ],
)
def test_each_lie_is_found_or_named(
    fitted, verify, dictionaries, landmarks, tmp_path, case, suffix
):
    kind, keys = CASES[case]
    honest = read_results(fitted(kind, **keys), proofs=True)
    target, missed, lies = tmp_path / f"lie.{suffix}", [], 0

    def told(record):
        with result_writer(target) as writer:
            writer.append(record)
        return verify(target, dictionaries[kind], [landmarks[kind]])

    assert told(honest).failures == {}
    for make in (dataset_lies, attribute_lies, inventions):
        for name, record in make(honest):
            lies += 1
            try:
                found = told(record)
            except (InputError, ArrowInvalid):  # refused, or not to be written at all
                continue
            if not found.failures and f"`{name}`" not in found.note:
                missed.append(name)
    assert missed == []
    assert lies > 40


def test_what_is_compared_with_landmarks_is_named_without_them(
    fitted, verify, dictionaries, landmarks
):
    honest = fitted("cars", **CASES["left out"][1])
    assert "Not compared" not in verify(honest, dictionaries["cars"], [landmarks["cars"]]).note
    (line,) = (
        line
        for line in verify(honest, dictionaries["cars"]).note.splitlines()
        if line.startswith("Not compared without `--landmarks`: ")
    )
    for name in ("item", "landmarks", "unit", "y_axis"):
        assert f"`{name}`" in line


@pytest.mark.parametrize("status", ["degenerate input", "numerical failure"])
def test_images_declared_to_have_no_shape_are_found(
    fitted, verify, dictionaries, landmarks, tmp_path, status
):
    result = read_results(fitted("people"), proofs=True)
    gone = np.arange(len(result)) < 5
    empty = {
        name: np.where(gone.reshape(-1, *[1] * (value.ndim - 1)), np.nan, value)
        for name in ("shapes", "landmarks_fitted", "coefficients", "rotation", "translation",
                     "scale", "objective", "relative_gap", "dual", "convex_translation")
        if (value := getattr(result, name)) is not None
    }  # fmt: skip
    kept = np.repeat(~gone, result.transform_count)
    lie = result.replaced(
        **empty,
        status=np.where(gone, status, result.status),
        transform_count=np.where(gone, 0, result.transform_count),
        transform_atom=result.transform_atom[kept],
        active_transforms=result.active_transforms[kept],
    )
    target = tmp_path / "lie.h5"
    with result_writer(target) as writer:
        writer.append(lie)
    found = verify(target, dictionaries["people"], [landmarks["people"]])
    assert list(found.failures) == list(result.items[:5])
    assert "Of 7 of 12 images: the optimum" in found.note
    assert "5 of 12 images have no shape: a claim above does not hold for 5 of them." in found.note
    found = verify(target, dictionaries["people"])
    assert "5 images without a shape" in found.failures
    assert "5 of 12 images have no shape: that is not checked" in found.note
