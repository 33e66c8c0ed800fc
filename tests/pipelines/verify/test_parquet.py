"""Results of all kinds in Parquet: the proofs in them hold, and all comes back to HDF5."""

import h5py
import numpy as np
import pytest

from shapefit.config import ConvertConfig
from shapefit.pipelines.convert import run as convert

TREES = {"method": "global", "search": {"modes": 0.5, "proof_every": 4, "max_cells": 2000}}
CASES = {
    "squared": ("people", {}),
    "exact": ("people", {"loss": "exact"}),
    "sparse-error": ("people", {"outliers": {"method": "sparse-error"}}),
    "refined": ("people", {"method": "convex+refine"}),
    "alternate": ("people", {"method": "alternate"}),
    "all transforms": ("people", {"transforms": True}),
    "all readings and trees": ("people", TREES),
    "perspective": (
        "cars",
        {"camera": {"model": "perspective", "intrinsics": "camera_matrix"}, "method": "alternate"},
    ),
}


def contents(path) -> dict[str, np.ndarray]:
    """Return all datasets and root attributes of an HDF5 file."""
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, node: found.update({name: node[()]} if hasattr(node, "dtype") else {})
        )
        found |= {f"attribute {name}": value for name, value in file.attrs.items()}
    return found


@pytest.mark.parametrize("case", CASES)
def test_a_result_goes_to_parquet_and_back(fitted, verify, dictionaries, tmp_path, case):
    kind, keys = CASES[case]
    result = fitted(kind, **keys)
    there, back = tmp_path / "result.parquet", tmp_path / "back.h5"
    for source, target in ((result, there), (there, back)):
        list(convert(ConvertConfig(files=[str(source)], output=str(target), chunk=7)))
    before, after = contents(result), contents(back)
    assert before.keys() == after.keys()
    assert ("tree_splits" in before) == (keys is TREES)
    for name, values in before.items():
        assert np.asarray(values).dtype == np.asarray(after[name]).dtype, name
        np.testing.assert_array_equal(values, after[name], err_msg=name)
    found = verify(there, dictionaries[kind])
    assert found.failures == {}
    assert found.done == len(before["item"])
    assert found.note == verify(result, dictionaries[kind]).note
