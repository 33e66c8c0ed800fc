"""Means and percentiles in blocks are those of numpy on the whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from shapefit.evaluation.statistics import samples
from shapefit.evaluation.statistics.labels import by_name, labels_of, of_names
from shapefit.evaluation.statistics.samples import Sample, in_order, mean, median, percentiles
from shapefit.evaluation.statistics.selection import numbers, ordered_keys, select

TINY = np.nextafter(0, 1)
PLANTED = (0.0, -0.0, TINY, -TINY, 1.0, np.nextafter(1, 2), -1.0, 1e308, -1e308, 2.0**-1022)

finite = arrays.arrays(
    np.float64,
    st.integers(1, 60),
    elements=st.sampled_from(PLANTED) | st.floats(-1e300, 1e300),
)
with_infinities = arrays.arrays(
    np.float64,
    st.integers(1, 60),
    elements=st.sampled_from((*PLANTED, np.inf, -np.inf)) | st.floats(allow_nan=False),
)


def in_blocks(values: np.ndarray, size: int) -> Sample:
    """Return the values as a sample of so many at a time."""
    return Sample(len(values), lambda: (values[i : i + size] for i in range(0, len(values), size)))


@given(with_infinities, st.integers(1, 20), st.integers(1, 20))
def test_every_rank_is_found(values, size, most):
    sample = in_blocks(values, size)
    found = select(sample.count, sample.blocks, range(len(values)), most)
    np.testing.assert_array_equal(found, np.sort(values))


@given(with_infinities)
def test_keys_are_ordered_like_numbers(values):
    keys = ordered_keys(values)
    np.testing.assert_array_equal(numbers(keys).view(np.uint64), values.view(np.uint64))
    np.testing.assert_array_equal(numbers(np.sort(keys)), np.sort(values))


@given(finite, st.integers(1, 20), st.sampled_from((1, 5, 25, 50, 75, 90, 100, 33.3)))
@np.errstate(over="ignore", invalid="ignore")
def test_median_and_percentiles_have_the_bits_of_numpy(values, size, share):
    sample = in_blocks(values, size)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(samples, "AT_ONCE", 7)
        np.testing.assert_array_equal(median(sample), np.median(values))
        np.testing.assert_array_equal(percentiles(sample, (share,)), np.percentile(values, [share]))


def test_very_many_ties_need_few_passes(rng):
    values = np.concatenate([np.full(300_000, 0.25), rng.standard_normal(1000)])
    passes = []
    sample = in_blocks(values, 1 << 16)

    def counted():
        passes.append(None)
        return sample.blocks()

    found = select(len(values), counted, [0, len(values) // 2, len(values) - 1], 1 << 16)
    np.testing.assert_array_equal(found, [values.min(), 0.25, values.max()])
    assert len(passes) <= 5


def test_a_mean_of_one_block_has_the_bits_of_numpy(rng):
    values = rng.lognormal(size=10_001)
    assert mean(in_blocks(values, len(values))) == values.mean()
    assert mean(in_blocks(values, 100)) == pytest.approx(values.mean(), rel=1e-14)


def test_of_nothing_there_is_nothing():
    nothing = in_blocks(np.empty(0), 1)
    assert all(np.isnan([mean(nothing), median(nothing), *percentiles(nothing, (90, 5))]))


@pytest.mark.parametrize("most", [3, 40, 10_000])
def test_values_by_name_are_those_of_a_mask(rng, monkeypatch, most):
    monkeypatch.setattr(samples, "AT_ONCE", most)
    # Some names come together, some are spread over all, one has next to all of the values.
    names = np.array([*["a"] * 5, *rng.choice([*"bcde", "much", "much", "much"], 300), *["f"] * 20])
    values = rng.standard_normal(len(names))
    values[rng.random(len(names)) < 0.1] = np.nan
    values[names == "e"] = np.nan
    labels = labels_of(names.tolist())
    found = {name: (count, sample) for name, count, sample in by_name(values, labels)}
    assert sorted(found) == sorted(set(names.tolist()))
    for name, (count, sample) in found.items():
        own = values[names == name]
        known = own[~np.isnan(own)]
        assert count == len(own)
        np.testing.assert_array_equal(np.concatenate([known[:0], *sample.blocks()]), known)
    two = of_names(values, labels, ("b", "f", "none"))
    expected = values[np.isin(names, ["b", "f"]) & ~np.isnan(values)]
    np.testing.assert_array_equal(in_order(two, range(two.count)), np.sort(expected))
