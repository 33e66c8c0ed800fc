"""Means and percentiles are those of numpy, of all numbers and of those with a name."""

from __future__ import annotations

import numpy as np

from shapefit.evaluation.averages import (
    by_name,
    labels_of,
    mean,
    median,
    of_names,
    percentiles,
    slices,
)


def test_of_nothing_there_is_nothing():
    nothing = np.empty(0)
    assert all(np.isnan([mean(nothing), median(nothing), *percentiles(nothing, (90, 5))]))


def test_statistics_have_the_bits_of_numpy(rng):
    values = rng.lognormal(size=10_001)
    assert (mean(values), median(values)) == (values.mean(), np.median(values))
    assert percentiles(values, (5, 90)) == tuple(np.percentile(values, (5, 90)))


def test_values_by_name_are_those_of_a_mask(rng):
    # Some names come together, some are spread over all, one has next to all of the values.
    names = np.array([*["a"] * 5, *rng.choice([*"bcde", "much", "much", "much"], 300), *["f"] * 20])
    values = rng.standard_normal(len(names))
    values[rng.random(len(names)) < 0.1] = np.nan
    values[names == "e"] = np.nan
    labels = labels_of(names.tolist())
    found = {name: (count, known) for name, count, known in by_name(values, labels)}
    assert sorted(found) == sorted(set(names.tolist()))
    for name, (count, known) in found.items():
        own = values[names == name]
        assert count == len(own)
        np.testing.assert_array_equal(known, own[~np.isnan(own)])
    two = of_names(values, labels, ("b", "f", "none"))
    expected = values[np.isin(names, ["b", "f"]) & ~np.isnan(values)]
    np.testing.assert_array_equal(two, expected)


def test_slices_cover_all_rows():
    assert [list(range(*part.indices(9))) for part in slices(7, 3)] == [[0, 1, 2], [3, 4, 5], [6]]
