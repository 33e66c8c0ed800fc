"""Bones that stretch, limbs that change owners."""

import numpy as np
import pytest

from shapefit.dictionary.bodies import find_skeleton, vary

EDGES = np.array([[0, 1], [1, 2], [2, 3], [0, 4], [4, 5], [5, 6], [0, 7]])
"""A trunk at 0, two limbs 1-2-3 and 4-5-6, and a head at 7."""


def lengths(shapes):
    return np.linalg.norm(shapes[:, :, EDGES[:, 0]] - shapes[:, :, EDGES[:, 1]], axis=1)


@pytest.mark.parametrize("edges", [EDGES[:-1], np.vstack([EDGES[:-1], [[1, 4]]])])
def test_bones_that_are_no_tree_are_refused(edges):
    with pytest.raises(ValueError, match=r"tree|apart"):
        find_skeleton(edges, 8)


def test_stretching_keeps_directions_and_partners_alike():
    shapes = np.random.default_rng(0).normal(size=(50, 3, 8))
    partners = np.array([0, 4, 5, 6, 1, 2, 3, 7])
    varied = vary(
        shapes, find_skeleton(EDGES, 8), copies=1, bone_scale=0.2, exchange=0.0, partners=partners
    )
    factor = lengths(varied) / lengths(shapes)
    assert factor[:, :3] == pytest.approx(factor[:, 3:6])
    assert np.log(factor).std() == pytest.approx(0.2, abs=0.04)
    bones = [s[:, :, EDGES[:, 1]] - s[:, :, EDGES[:, 0]] for s in (shapes, varied)]
    cosine = (bones[0] * bones[1]).sum(axis=1) / (lengths(shapes) * lengths(varied))
    assert cosine == pytest.approx(1.0)


def test_exchanged_limbs_come_from_other_shapes_whole():
    shapes = np.random.default_rng(0).normal(size=(30, 3, 8))
    varied = vary(shapes, find_skeleton(EDGES, 8), copies=1, bone_scale=0.0, exchange=1.0)
    assert varied[:, :, [0, 1, 4, 7]] == pytest.approx(shapes[:, :, [0, 1, 4, 7]])
    limb = (varied[:, :, [2, 3]] - varied[:, :, [1, 1]]).reshape(30, -1)
    given = (shapes[:, :, [2, 3]] - shapes[:, :, [1, 1]]).reshape(30, -1)
    nearest = np.abs(limb[:, None] - given).max(axis=2)
    assert nearest.min(axis=1) == pytest.approx(0.0, abs=1e-12)
    assert len(set(nearest.argmin(axis=1).tolist())) == 30
