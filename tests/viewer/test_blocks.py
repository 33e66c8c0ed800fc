"""Points as the page reads them: numbers that no 32-bit float holds are missing."""

import json

import numpy as np
import pytest

from shapefit.viewer.blocks import block_of_points
from shapefit.viewer.scene import Layer, Measure, Scene, as_json


@pytest.mark.parametrize("far", [1e39, 1e160, 1.7e308, np.inf, np.nan])
def test_what_32_bits_cannot_hold_is_missing(rng, far):
    points = rng.standard_normal((4, 5, 2))
    without = points.copy()
    points[1, 2], points[3, 0] = (far, 0.5), (0.25, -far)
    without[1, 2], without[3, 0] = np.nan, np.nan
    found = block_of_points(points)
    json.dumps(found, allow_nan=False)
    assert found == block_of_points(without)


def test_a_unit_that_is_not_known_is_not_shown():
    values = np.zeros(1)
    measures = tuple(Measure("error", values, unit=unit) for unit in ("unknown", "mm"))
    layer = Layer("fit", "result", np.zeros((1, 3, 2)), measures=measures)
    edges = np.empty((0, 2), np.int64)
    scene = Scene("t", ["a"], [("", 0)], ["x", "y"], edges, [layer], "unknown", True)
    page = as_json(scene)
    assert page["unit"] == ""
    assert [measure["unit"] for measure in page["layers"][0]["measures"]] == ["", "mm"]
