"""Norms in closed form beside LAPACK's, rotations that pass for the nearest, missed claims."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.geometry.rotations import nearest_rotation, rotation_about
from shapefit.verification.checks import Checks
from shapefit.verification.fit import seen_in
from shapefit.verification.program import (
    ACTIVE,
    Transforms,
    check_coefficients,
    check_nearest,
    nuclear_norms,
)

N = 40


def test_norms_are_sums_of_singular_values(rng):
    some = rng.standard_normal((64, 2, 3))
    turned = np.linalg.svd(some, full_matrices=False)
    flat, line = some.copy(), some.copy()
    flat[:, 1], line[:, 1] = 2 * flat[:, 0] + 1e-9 * flat[:, 1], 0
    blocks = np.concatenate([some, turned.U @ turned.Vh, flat, line, np.zeros((1, 2, 3))])
    s = np.linalg.svd(blocks, compute_uv=False)
    x, y = blocks[:, 0, :, None], blocks[:, 1, :, None]
    assert nuclear_norms(x, y)[:, 0] == pytest.approx(s.sum(axis=1), rel=1e-14, abs=1e-28)
    M = Transforms(np.zeros(len(blocks), int), np.zeros(len(blocks), int), blocks, 1)
    assert M.norms == pytest.approx(s[:, 0], rel=1e-14, abs=1e-28)


@pytest.fixture
def sums(rng):
    """Sums of scaled rotations (n, 3, 3), some of them nearer to reflections than to rotations."""
    A = rng.standard_normal((N, 3, 3))
    return A / np.linalg.norm(A, axis=(1, 2))[:, None, None]


def missed(rotation, total, size=1.0):
    checks = Checks(np.ones(N, dtype=bool), {})
    bound = np.full(N, 1e-12)
    with np.errstate(all="ignore"):
        check_nearest(rotation, total, np.full(N, size), bound, checks)
    return checks.missed()


def test_the_nearest_rotation_passes_and_no_other_stationary_one(sums, rng):
    assert (np.linalg.det(sums) < 0).any()
    nearest = nearest_rotation(sums)
    assert not missed(nearest, sums).any()
    turn = rotation_about(rng.standard_normal(3), np.array([1e-9]))[0]
    assert missed(turn @ nearest, sums).all()
    U, _, Vt = np.linalg.svd(sums)
    proper = np.sign(np.linalg.det(U @ Vt))
    for flips in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1]):  # R^T A stays symmetric
        signs = np.tile(np.array(flips, dtype=float), (N, 1))
        signs[:, 2] *= proper
        assert missed((U * signs[:, None]) @ Vt, sums).all()
    assert missed(nearest, np.zeros_like(sums), 0.0).all()
    assert not missed(np.full_like(nearest, np.nan), np.zeros_like(sums), 0.0).any()


def test_the_worst_of_an_image_counts_and_nan_misses():
    checks = Checks(np.array([True, True, True, False]), {})
    off = np.array([[1.0, 3.0], [1.0, 2.0], [np.nan, 0.0], [9.0, 9.0]])
    checks.add("c", off, 2.0)
    assert checks.missed().tolist() == [True, False, True, False]
    checks.add("d", off, np.array([[9.0, 9.0], [0.5, 9.0], [9.0, 9.0], [9.0, 9.0]]), "x y")
    assert checks.missed().tolist() == [True, True, True, False]
    assert checks.settled == {"x", "y"}
    assert [image for image, _ in checks.reasons()] == [0, 1, 2]
    checks.add("e", off, np.full(4, np.nan), of=np.array([False, False, False, True]))
    assert checks.missed()[3]
    none = Checks(np.zeros(0, dtype=bool), {})
    none.add("c", np.zeros((0, 3)), 1.0)
    assert none.missed().tolist() == []


def test_a_coefficient_at_the_limit_counts_as_active_or_not():
    beyond = np.array([-2e-9, -5e-10, 5e-10, 2e-9])
    c = np.stack([np.ones(4), ACTIVE * (1 + beyond)], axis=1)
    for stated, wrong in ((1, [False, False, False, True]), (2, [True, False, False, False])):
        checks = Checks(np.ones(4, dtype=bool), {"coefficients": c})
        images = SimpleNamespace(
            columns={"active_atoms": np.full(4, stated)}, allow=lambda terms, number: 1e-9 * terms
        )
        check_coefficients(images, c, None, c.sum(axis=1), checks)
        assert checks.missed().tolist() == wrong


def test_what_has_no_place_or_no_confidence_is_not_seen():
    landmarks = np.zeros((1, 2, 4))
    landmarks[0, 1, 1] = np.nan
    confidence = np.array([[1.0, 1.0, 0.0, 0.5]])
    assert seen_in({"landmarks": landmarks}).tolist() == [[True, False, True, True]]
    both = {"landmarks": landmarks, "confidence": confidence}
    assert seen_in(both).tolist() == [[True, False, False, True]]
