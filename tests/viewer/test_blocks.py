"""Points as the page reads them: numbers that no 32-bit float holds are missing."""

from __future__ import annotations

import json

import numpy as np
import pytest

from shapefit.viewer.blocks import block_of_points


@pytest.mark.parametrize("far", [1e39, 1e160, 1.7e308, np.inf, np.nan])
def test_what_32_bits_cannot_hold_is_missing(rng, far):
    points = rng.standard_normal((4, 5, 2))
    without = points.copy()
    points[1, 2], points[3, 0] = (far, 0.5), (0.25, -far)
    without[1, 2], without[3, 0] = np.nan, np.nan
    found = block_of_points(points)
    json.dumps(found, allow_nan=False)
    assert found == block_of_points(without)
