"""Numbers of a page come back as blocks.js reads them."""

import numpy as np
import pytest

from shapefit.viewer.page import as_json, block_of_points
from tests.pipelines.view.conftest import decoded


@pytest.fixture
def scattered_points(rng):
    """Points (50, 3, 4) of which some are very far, or not known."""
    points = rng.normal(size=(50, 3, 4)) * np.array([1, 100, 5])[:, None] + 1000
    points[0] *= 1e9
    points[3, :, 2] = np.nan
    points[7, 0, 1] = np.inf
    return points


def test_points_come_back_within_half_a_step_and_far_ones_do_not_spoil_the_others(
    scattered_points,
):
    known = np.isfinite(scattered_points).all(axis=1)
    known_points = np.where(known[:, None], scattered_points, 1000)
    steps = np.ptp(known_points, axis=2).max(axis=1) / 65534
    back = decoded(block_of_points(scattered_points))
    differences = np.abs(back - scattered_points).max(axis=1)
    rounding = 1e-7 * np.abs(scattered_points).max(axis=1)
    tolerances = 0.6 * steps[:, None] + rounding
    assert (differences <= tolerances)[known].all()


def test_points_that_are_not_known_come_back_as_such(scattered_points):
    known = np.isfinite(scattered_points).all(axis=1)
    back = decoded(block_of_points(scattered_points))
    unknown = np.moveaxis(back, 1, 2)[~known]
    assert np.isnan(unknown).all()


SMALLEST_KINDS = [(255, "u1"), (256, "u2"), (65535, "u2"), (65536, "u4")]


@pytest.mark.parametrize(("largest", "kind"), SMALLEST_KINDS)
def test_integers_take_as_few_bytes_as_they_need(largest, kind):
    block = as_json(np.array([largest]))
    assert block["type"] == kind
