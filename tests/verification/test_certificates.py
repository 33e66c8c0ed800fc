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

NAN = np.nan


def orthonormal_rows(blocks, rng):
    """Return the blocks with rows of norm 1 that are orthogonal."""
    U, _, Vt = np.linalg.svd(blocks, full_matrices=False)
    return U @ Vt


def nearly_parallel_rows(blocks, rng):
    flat = blocks.copy()
    flat[:, 1] = 2 * flat[:, 0] + 1e-9 * flat[:, 1]
    return flat


def one_row(blocks, rng):
    line = blocks.copy()
    line[:, 1] = 0
    return line


@pytest.mark.parametrize(
    "change",
    [
        lambda blocks, rng: blocks,
        orthonormal_rows,
        nearly_parallel_rows,
        one_row,
        lambda blocks, rng: 0 * blocks,
    ],
    ids=["random", "orthonormal", "nearly parallel", "one row", "zero"],
)
def test_norms_are_sums_of_singular_values(rng, change):
    blocks = change(rng.standard_normal((64, 2, 3)), rng)
    singular_values = np.linalg.svd(blocks, compute_uv=False)
    first_row = blocks[:, 0, :, None]
    second_row = blocks[:, 1, :, None]

    found = nuclear_norms(first_row, second_row)[:, 0]

    expected = singular_values.sum(axis=1)
    assert found == pytest.approx(expected, rel=1e-14, abs=1e-28)


class TestClaims:
    """Of four images, of which the last claims nothing."""

    @pytest.fixture
    def claims(self):
        return Claims(np.array([True, True, True, False]))

    @pytest.fixture
    def far(self, claims):
        """Claims that differences are below 2."""
        off = np.array([[1.0, 3.0], [1.0, 2.0], [NAN, 0.0], [9.0, 9.0]])
        claims.near("c", off, 2.0)
        return claims

    def test_the_worst_of_an_image_counts_and_nan_misses(self, far):
        assert far.missed.tolist() == [True, False, True, False]

    def test_images_that_miss_have_a_reason(self, far):
        assert [*far.reasons] == [0, 2]

    def test_a_claim_may_be_of_other_images(self, far):
        last = np.array([False, False, False, True])
        far.near("d", np.zeros((4, 2)), np.full(4, NAN), where=last)
        assert far.missed[3]

    def test_of_no_images_none_misses(self):
        claims = Claims(np.zeros(0, dtype=bool))
        claims.near("c", np.zeros((0, 3)), 1.0)
        assert claims.missed.tolist() == []


B = np.array([[[1.0, -1, 0, 0], [0, 0, 1, -1], [0.5, 0.5, -0.5, -0.5]]])
"""One atom (1, 3, 4)."""

LAMBDA = 0.1
HALF = 0.5


def mean_std(landmarks):
    """Return the size by which landmarks (2, p) are normalised."""
    return landmarks.std(axis=1).mean()


@pytest.fixture
def planted():
    """One atom, seen from the front at half its size: M = c Rbar, Y = Omega o (V - M
    B).

    V = B_xy / (2 s), with its standard deviation at 1, so that M B = a V with the
    largest a for which Y stays feasible: the nuclear norm of (1 - a) V B^T is lambda.
    """
    front = B[0, :2]
    landmarks = 100 * HALF * front
    V = front / mean_std(front)
    singular_values = np.linalg.svd(V @ B[0].T, compute_uv=False)
    a = 1 - LAMBDA / singular_values.sum()
    M = a * np.eye(2, 3) / mean_std(front)
    Y = (1 - a) * V
    c = M[0, 0]
    objective = 0.5 * (Y**2).sum() + LAMBDA * c
    size = mean_std(landmarks)
    return {
        "landmarks": landmarks[None],
        "lambda": np.array([LAMBDA]),
        "dual": Y[None],
        "convex_translation": np.zeros((1, 2)),
        "transform_count": np.array([1]),
        "transform_atom": np.array([0]),
        "active_transforms": M[None],
        "objective": np.array([objective]),
        "relative_gap": np.zeros(1),
        "coefficients": np.array([[c]]),
        "scale": np.array([size]),
        "translation": np.zeros((1, 2)),
        "shapes": size * c * B,
        "status": np.array(["optimal"]),
        "rotation": np.eye(3)[None],
    }


def make_program(loss="squared"):
    return CertifiedProgram(B, None, False, True, False, loss, 0.1, 1e-6)


def first_false_claim(columns):
    """Return the first claim of an image that is false, or nothing."""
    claims = Claims(np.ones(1, dtype=bool))
    with np.errstate(all="ignore"):
        is_certified = check_certificate(columns, make_program(), claims)
        check_ranges(columns, claims)
    assert is_certified.tolist() == [True]
    return claims.reasons.get(0, "")


def test_a_known_optimum_is_certified(planted):
    assert first_false_claim(planted) == ""


FALSE_CLAIMS = [
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
]
"""A column, how it is changed, and a word of the claim that is false then."""


@pytest.mark.parametrize(("name", "change", "word"), FALSE_CLAIMS)
def test_nothing_else_is_certified(planted, name, change, word):
    changed = planted | {name: change(planted[name])}
    assert word in first_false_claim(changed)


def test_half_a_shape_is_no_shape(planted):
    half = planted["shapes"].copy()
    half[0, 0, 0] = NAN
    failed = {"shapes": half, "status": np.array(["degenerate input"])}
    claims = Claims(np.zeros(1, dtype=bool))

    check_ranges(planted | failed, claims)

    assert "whole or absent" in claims.reasons[0]


@pytest.mark.parametrize(("loss", "bound"), [("sparse-error", 0.1), ("l1", 1.0)])
class TestRobustLoss:
    """The dual of a robust loss is bounded: with a lambda so large that nothing else
    limits it.
    """

    def check(self, planted, loss, largest):
        """Check the dual whose largest entry is so large."""
        program = make_program(loss)
        images = normalise_images(planted | {"lambda": np.array([100.0])}, program)
        Y = planted["dual"] * largest / np.abs(planted["dual"]).max()
        claims = Claims(np.ones(1, dtype=bool))
        check_dual(images, Y, program, claims, np.ones(1, dtype=bool))
        return claims

    def test_a_dual_within_the_bound_is_feasible(self, planted, loss, bound):
        claims = self.check(planted, loss, bound * (1 - 1e-6))
        assert claims.missed.tolist() == [False]

    def test_a_dual_beyond_it_is_not(self, planted, loss, bound):
        claims = self.check(planted, loss, bound * (1 + 1e-6))
        assert claims.missed.tolist() == [True]
        assert "within the bound of the loss" in claims.reasons[0]
