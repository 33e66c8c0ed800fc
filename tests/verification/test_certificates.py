"""Norms in closed form beside LAPACK's, missed claims, a program whose optimum is
known.
"""

import numpy as np
import pytest

from shapefit.verification.certificate import (
    CertifiedProgram,
    Claims,
    check_certificate,
    check_dual,
    check_ranges,
    normalise_images,
    nuclear_norms,
)


def test_norms_are_sums_of_singular_values(rng):
    some = rng.standard_normal((64, 2, 3))
    turned = np.linalg.svd(some, full_matrices=False)
    flat, line = some.copy(), some.copy()
    flat[:, 1], line[:, 1] = 2 * flat[:, 0] + 1e-9 * flat[:, 1], 0
    blocks = np.concatenate(
        [some, turned.U @ turned.Vh, flat, line, np.zeros((1, 2, 3))]
    )
    s = np.linalg.svd(blocks, compute_uv=False)
    x, y = blocks[:, 0, :, None], blocks[:, 1, :, None]
    assert nuclear_norms(x, y)[:, 0] == pytest.approx(
        s.sum(axis=1), rel=1e-14, abs=1e-28
    )


def test_the_worst_of_an_image_counts_and_nan_misses():
    claims = Claims(np.array([True, True, True, False]))
    off = np.array([[1.0, 3.0], [1.0, 2.0], [np.nan, 0.0], [9.0, 9.0]])
    claims.near("c", off, 2.0)
    assert claims.missed.tolist() == [True, False, True, False]
    assert [*claims.reasons] == [0, 2]
    claims.near(
        "d", off, np.full(4, np.nan), where=np.array([False, False, False, True])
    )
    assert claims.missed[3]
    none = Claims(np.zeros(0, dtype=bool))
    none.near("c", np.zeros((0, 3)), 1.0)
    assert none.missed.tolist() == []


B = np.array([[[1.0, -1, 0, 0], [0, 0, 1, -1], [0.5, 0.5, -0.5, -0.5]]])
LAMBDA, HALF = 0.1, 0.5


@pytest.fixture
def planted():
    """One atom, seen from the front at half its size: M = c Rbar, Y = Omega o (V - M
    B).

    V = B_xy / (2 s), with its standard deviation at 1, so that M B = a V with the
    largest a for which Y stays feasible: the nuclear norm of (1 - a) V B^T is lambda.
    """
    w = 100 * HALF * B[0, :2]
    V = B[0, :2] / B[0, :2].std(axis=1).mean()
    s = np.linalg.svd(V @ B[0].T, compute_uv=False).sum()
    a = 1 - LAMBDA / s
    M = a * np.eye(2, 3) / B[0, :2].std(axis=1).mean()
    Y, c, size = (1 - a) * V, M[0, 0], w.std(axis=1).mean()
    P = 0.5 * (Y**2).sum() + LAMBDA * c
    S = c * B[0]
    return {
        "landmarks": w[None],
        "lambda": np.array([LAMBDA]),
        "dual": Y[None],
        "convex_translation": np.zeros((1, 2)),
        "transform_count": np.array([1]),
        "transform_atom": np.array([0]),
        "active_transforms": M[None],
        "objective": np.array([P]),
        "relative_gap": np.zeros(1),
        "coefficients": np.array([[c]]),
        "scale": np.array([size]),
        "translation": np.zeros((1, 2)),
        "shapes": size * S[None],
        "status": np.array(["optimal"]),
        "rotation": np.eye(3)[None],
    }


def missed(columns):
    """Return the first false claim of each way that leads to one."""
    program = CertifiedProgram(B, None, False, True, False, "squared", 0.1, 1e-6)
    claims = Claims(np.ones(1, dtype=bool))
    with np.errstate(all="ignore"):
        assert check_certificate(columns, program, claims).tolist() == [True]
        check_ranges(columns, claims)
    return claims.reasons.get(0, "")


def test_a_known_optimum_is_certified_and_nothing_else(planted):
    assert missed(planted) == ""
    for name, change, said in [
        ("dual", lambda Y: (1 + 1e-8) * Y, "feasible"),
        ("dual", lambda Y: Y + 1e-3, "balanced"),
        ("objective", lambda P: 0.999 * P, "objective"),
        ("active_transforms", lambda M: 0.99 * M, "objective"),
        ("relative_gap", lambda gap: gap - 1e-3, "relative_gap"),
        ("shapes", lambda S: 1.001 * S, "shapes"),
        ("coefficients", lambda c: 1.001 * c, "coefficients"),
        ("scale", lambda scale: 1.001 * scale, "scale"),
        ("translation", lambda x: x + 1, "translation"),
        ("rotation", lambda R: 2 * R, "orthonormal"),
        ("rotation", np.negative, "proper"),
        ("lambda", np.negative, "objective"),
        ("status", lambda _: np.array(["degenerate input"]), "status"),
    ]:
        assert said in missed(planted | {name: change(planted[name])}), (name, said)
    half, claims = planted["shapes"].copy(), Claims(np.zeros(1, dtype=bool))
    half[0, 0, 0] = np.nan
    check_ranges(
        planted | {"shapes": half, "status": np.array(["degenerate input"])}, claims
    )
    assert "whole or absent" in claims.reasons[0]


@pytest.mark.parametrize(("loss", "bound"), [("sparse-error", 0.1), ("l1", 1.0)])
@pytest.mark.parametrize("over", [-1e-6, 1e-6])
def test_the_dual_of_a_robust_loss_is_bounded(planted, loss, bound, over):
    """With a lambda so large that nothing else limits it."""
    program = CertifiedProgram(B, None, False, True, False, loss, 0.1, 1e-6)
    images = normalise_images(planted | {"lambda": np.array([100.0])}, program)
    Y = planted["dual"] * (1 + over) * bound / np.abs(planted["dual"]).max()
    claims = Claims(np.ones(1, dtype=bool))
    check_dual(images, Y, program, claims, np.ones(1, dtype=bool))
    assert claims.missed.tolist() == [over > 0]
    assert over < 0 or "within the bound of the loss" in claims.reasons[0]
