"""Rows on the disk: as they were written, in batches; and the median of numbers in batches."""

import numpy as np
import pytest

from shapefit.pipelines.learn_dict.median import median
from shapefit.pipelines.learn_dict.spill import Spill


@pytest.fixture
def rows(rng):
    return rng.standard_normal((23, 3, 4))


@pytest.fixture
def spill(tmp_path, rows):
    filled = Spill(tmp_path, (3, 4), 5)
    for part in np.array_split(rows, 4):
        filled.append(part)
    return filled


def whole(spill):
    return np.concatenate(list(spill))


def test_gives_the_rows_in_batches_whenever_asked(spill, rows):
    assert len(spill) == 23
    assert [len(batch) for batch in spill] == [5, 5, 5, 5, 3]
    np.testing.assert_array_equal(whole(spill), rows)
    np.testing.assert_array_equal(whole(spill), rows)


def test_grows_by_what_is_made_of_its_rows(spill, rows):
    spill.extend(-batch for batch in spill)
    np.testing.assert_array_equal(whole(spill), np.concatenate([rows, -rows]))


def test_rows_are_replaced_in_their_place(spill, rows):
    spill.replace(lambda batch: 2 * batch)
    np.testing.assert_array_equal(whole(spill), 2 * rows)


@pytest.mark.parametrize(
    "chosen", [[0], [22], [0, 4, 5, 5, 21], list(range(23))], ids=["first", "last", "some", "all"]
)
def test_takes_some(spill, rows, chosen):
    np.testing.assert_array_equal(spill.take(np.array(chosen)), rows[chosen])


def test_has_no_name(spill, tmp_path):
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("count", [1, 2, 3, 10, 999, 1000])
@pytest.mark.parametrize("equal", [False, True], ids=["different", "equal"])
def test_the_median_is_that_of_numpy(rng, count, equal):
    numbers = 10.0 ** rng.uniform(-100, 100, count)
    if equal:
        numbers = rng.choice([0.1, 0.3, 7.0], count)
    assert median(np.array_split(numbers, 3), count) == np.median(numbers)
