"""By how many images a stretch of the picture is ruled out."""

import numpy as np
import pytest

from shapefit.pipelines.fit.aspect import (
    FIRST_LOOK,
    MIN_STRETCH_GAIN,
    first_quartile,
    may_be_enough,
)

RNG = np.random.default_rng(2)


@pytest.mark.parametrize("n", [*range(20, 30), 96])
def test_few_gains_rule_a_stretch_out_only_where_all_would(n):
    ruled_out = []
    for _ in range(200):
        gains = RNG.normal(loc=MIN_STRETCH_GAIN + RNG.uniform(-3, 3), size=n)
        gains[RNG.random(n) < 0.05] = np.nan
        is_enough = first_quartile(gains) > MIN_STRETCH_GAIN
        possible = may_be_enough(gains[::FIRST_LOOK], n)
        assert possible or not is_enough
        ruled_out.append(not possible)
    assert 0.05 < np.mean(ruled_out) < 0.5


@pytest.mark.parametrize("n", range(20, 30))
def test_no_more_gains_are_asked_for_than_the_quartile_needs(n):
    needed = (n - 1) // 4 + 2
    gains = np.full(n, MIN_STRETCH_GAIN + 1)
    gains[:needed] = MIN_STRETCH_GAIN
    assert first_quartile(gains) <= MIN_STRETCH_GAIN
    assert not may_be_enough(gains[:needed], n)
    assert may_be_enough(gains[: needed - 1], n)
