"""Norms of 2 x 3 blocks in closed form, beside LAPACK's."""

import numpy as np
import pytest

from shapefit.verification.proofs.block_norms import (
    nuclear_norms,
    polar_rows,
    spectral_norms,
    third_rows,
)


@pytest.fixture
def blocks(rng):
    """Blocks of every kind: any, orthogonal rows, nearly rank 1, rank 1, zero."""
    some = rng.standard_normal((64, 2, 3))
    turned = np.linalg.svd(some, full_matrices=False)
    equal = turned.U @ turned.Vh * rng.random((64, 1, 1))
    flat = some.copy()
    flat[:, 1] = 2 * flat[:, 0] + 1e-9 * flat[:, 1]
    line = some.copy()
    line[:, 1] = 0
    return np.concatenate([some, 1e-12 * some, equal, flat, line, np.zeros((1, 2, 3))])


def test_norms_are_sums_of_singular_values(blocks):
    s = np.linalg.svd(blocks, compute_uv=False)
    x, y = blocks[:, 0, :, None], blocks[:, 1, :, None]
    assert nuclear_norms(x, y)[:, 0] == pytest.approx(s.sum(axis=1), rel=1e-14, abs=1e-28)
    assert spectral_norms(blocks) == pytest.approx(s[:, 0], rel=1e-14, abs=1e-28)


def test_third_rows_complete_scaled_rotations(rng):
    rows = np.linalg.qr(rng.standard_normal((20, 3, 3)))[0][:, :2]
    c = rng.random(20) + 0.1
    third = third_rows(c[:, None, None] * rows, c)
    turned = np.concatenate([rows, third[:, None] / c[:, None, None]], axis=1)
    assert turned @ turned.swapaxes(1, 2) == pytest.approx(np.tile(np.eye(3), (20, 1, 1)))
    assert np.linalg.det(turned) == pytest.approx(np.ones(20))
    assert third_rows(np.zeros((1, 2, 3)), np.zeros(1)).tolist() == [[0, 0, 0]]


def test_polar_rows_are_the_nearest_and_say_how_sure_they_are(rng):
    blocks = rng.standard_normal((64, 2, 3))
    svd = np.linalg.svd(blocks, full_matrices=False)
    norms = spectral_norms(blocks)
    rows, condition = polar_rows(blocks, norms)
    assert condition == pytest.approx(svd.S[:, 0] / svd.S[:, 1])
    expected = norms[:, None, None] * (svd.U @ svd.Vh)
    off = np.abs(rows - expected).max(axis=(1, 2))
    assert (off <= 1e-14 * norms * condition).all()
    assert polar_rows(np.ones((1, 2, 3)), np.ones(1))[1][0] > 1e7
