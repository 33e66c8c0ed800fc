"""A result with readings has their number in CSV, and reads back without it."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.io import read_results
from shapefit.io.records import ResultSet
from tests.io.files import save


@pytest.mark.parametrize("sequences", [None, ("one", "two")])
def test_the_number_of_readings_is_a_column(tmp_path, rng, sequences):
    record = ResultSet(
        shapes=rng.normal(size=(2, 3, 2)),
        landmark_names=("a", "b"),
        items=("x", "y"),
        sequences=sequences,
        modes=np.array([1, 3]),
    )
    save(tmp_path / "result.csv", record)
    header, *rows = (tmp_path / "result.csv").read_text(encoding="utf-8").splitlines()
    assert header.endswith(",modes")
    assert [row.rpartition(",")[2] for row in rows] == ["1", "1", "3", "3"]
    found = read_results(tmp_path / "result.csv")
    np.testing.assert_array_equal(found.shapes, record.shapes)
    assert found.sequences == sequences
    assert found.modes is None
