"""Certificates of several images at once, convex or refined, and the claims of each."""

from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.verification.certificate import (
    CertifiedProgram,
    Claims,
    check_certificate,
)
from tests.points import centred, mix

NAN = np.nan

N = 3
"""Images, none of them at its optimum."""

K = 2
"""Atoms."""

P = 8
"""Landmarks."""

LAM = 0.2


def weighted_mean(points, weights):
    """Return the translations (N, 2) that leave the least weighted squares."""
    return np.array(
        [np.average(points[i], axis=1, weights=weights[i] ** 2) for i in range(N)]
    )


def half_squares(residual, weights):
    """Return half the sum of squares of weighted residuals (N, 2, P): (N,)."""
    return ((weights[:, None] * residual) ** 2).sum(axis=(1, 2)) / 2


def feasible_dual(V, weights, atoms):
    """Return Y = t Omega o (V - T) with the largest t, and its bound (N,)."""
    T = weighted_mean(V, weights)
    residual = weights[:, None] * (V - T[..., None])
    products = np.einsum("nap,np,kbp->nkab", residual, weights, atoms)
    norms = np.linalg.svd(products, compute_uv=False).sum(axis=2)
    t = LAM / norms.max(axis=1)
    Y = t[:, None, None] * residual
    along = np.einsum("nap,np,nap->n", Y, weights, V)
    return Y, along - (Y**2).sum(axis=(1, 2)) / 2


@dataclass
class SeenImages:
    """Images of size and centroid, normalised V (N, 2, P), weighted."""

    V: np.ndarray
    weights: np.ndarray
    size: np.ndarray
    centroid: np.ndarray

    def columns(self):
        """Return what a result has of them whatever its shapes are."""
        landmarks = self.size[:, None, None] * self.V + self.centroid[..., None]
        return {
            "landmarks": landmarks,
            "confidence": self.weights,
            "lambda": np.full(N, LAM),
            "scale": self.size,
        }

    def placed(self, S, T):
        """Return translations and shapes in the unit of the landmarks."""
        place = self.size[:, None] * T + self.centroid
        shapes = self.size[:, None, None] * S
        shapes[:, :2] += place[..., None]
        return {"translation": place, "shapes": shapes}


@pytest.fixture
def seen(rng):
    return SeenImages(
        V=normalise(rng.standard_normal((N, 2, P))).points,
        weights=rng.uniform(0.2, 1.5, (N, P)),
        size=rng.uniform(5, 50, N),
        centroid=rng.uniform(-100, 100, (N, 2)),
    )


@pytest.fixture
def program(rng):
    return CertifiedProgram(
        atoms=centred(rng.standard_normal((K, 3, P))),
        atom_items=None,
        refined=False,
        has_bound=True,
        hides_outliers=False,
        loss="squared",
        beta=0.1,
        tolerance=1e-6,
    )


def check_images(columns, program):
    """Return the claims of the images, and which have a certificate."""
    claims = Claims(np.ones(N, dtype=bool))
    with np.errstate(all="ignore"):
        is_certified = check_certificate(columns, program, claims)
    return claims, is_certified.tolist()


class TestConvexShapes:
    """S = sum_i c_i R_i B_i: R_i are the rows of M_i / c_i, and their cross product."""

    @pytest.fixture
    def columns(self, program, seen, rng):
        """The last image has the second atom alone."""
        M = rng.standard_normal((N, K, 2, 3))
        M[2, 0] = 0.0
        c = np.linalg.svd(M, compute_uv=False)[..., 0]
        S = np.zeros((N, 3, P))
        for image, atom in np.argwhere(c > 0):
            x, y = M[image, atom]
            rows = np.stack([x, y, np.cross(x, y) / c[image, atom]])
            S[image] += rows @ program.atoms[atom]
        T = weighted_mean(seen.V - S[:, :2], seen.weights)
        Y, D = feasible_dual(seen.V, seen.weights, program.atoms)
        objective = half_squares(seen.V - S[:, :2] - T[..., None], seen.weights)
        objective += LAM * c.sum(axis=1)
        return {
            **seen.columns(),
            **seen.placed(S, T),
            "dual": Y,
            "convex_translation": T,
            "transform_count": np.array([2, 2, 1]),
            "transform_atom": np.array([0, 1, 1, 0, 1]),
            "active_transforms": np.stack([*M[0], M[1, 1], M[1, 0], M[2, 1]]),
            "objective": objective,
            "relative_gap": (objective - D) / objective,
            "coefficients": c,
            "status": np.full(N, "iteration limit"),
        }

    def test_true_ones_are_certified(self, columns, program):
        claims, is_certified = check_images(columns, program)
        assert claims.reasons == {}
        assert is_certified == [True] * N

    @pytest.mark.parametrize(("row", "image"), [(0, 0), (3, 1), (4, 2)])
    def test_another_transform_is_false_of_its_image_alone(
        self, columns, program, row, image
    ):
        transforms = columns["active_transforms"].copy()
        transforms[row, 0, 0] += 1e-6
        changed = columns | {"active_transforms": transforms}
        claims, _ = check_images(changed, program)
        assert [*claims.reasons] == [image]

    def test_the_mirror_image_is_not_that_of_the_transforms(self, columns, program):
        shapes = columns["shapes"] * np.array([1, 1, -1])[:, None]
        claims, _ = check_images(columns | {"shapes": shapes}, program)
        assert [*claims.reasons] == [*range(N)]

    def test_an_atom_that_is_left_out_has_no_coefficient(self, columns, program):
        of_items = program._replace(atom_items=("a", "b"))
        omitted = {"omitted": np.array(["", "b", "a"])}
        claims, _ = check_images(columns | omitted, of_items)
        assert [*claims.reasons] == [1]
        assert "left out" in claims.reasons[1]

    def test_an_image_without_a_gap_has_no_certificate(self, columns, program):
        """And no objective of it is claimed."""
        changed = {name: columns[name].copy() for name in ("relative_gap", "objective")}
        changed["relative_gap"][1] = NAN
        changed["objective"][1] = NAN
        claims, is_certified = check_images(columns | changed, program)
        assert is_certified == [True, False, True]
        assert claims.reasons == {}


class TestRefinedShapes:
    """S = R sum_i c_i B_i, c of either sign, beside the bound D of the convex program,
    which has no transforms here.
    """

    @pytest.fixture
    def program(self, program):
        return program._replace(refined=True)

    @pytest.fixture
    def columns(self, program, seen, rng):
        c = np.array([[-2.5, -1.5], [0.5, -1.2], [0.7, 0.0]])
        R = random_rotations(N, rng)
        S = R @ mix(c, program.atoms)
        T = weighted_mean(seen.V - S[:, :2], seen.weights)
        objective = half_squares(seen.V - S[:, :2] - T[..., None], seen.weights)
        objective += LAM * np.abs(c).sum(axis=1)
        Y, D = feasible_dual(seen.V, seen.weights, program.atoms)
        convex_T = weighted_mean(seen.V, seen.weights)
        convex_objective = half_squares(seen.V - convex_T[..., None], seen.weights)
        return {
            **seen.columns(),
            **seen.placed(S, T),
            "dual": Y,
            "convex_translation": convex_T,
            "transform_count": np.zeros(N, int),
            "transform_atom": np.zeros(0, int),
            "active_transforms": np.zeros((0, 2, 3)),
            "convex_objective": convex_objective,
            "convex_relative_gap": (convex_objective - D) / convex_objective,
            "objective": objective,
            "relative_gap": (objective - D) / objective,
            "coefficients": c,
            "rotation": R,
            "status": np.full(N, "converged"),
        }

    def test_true_ones_are_certified(self, columns, program):
        claims, is_certified = check_images(columns, program)
        assert claims.reasons == {}
        assert is_certified == [True] * N

    @pytest.mark.parametrize("image", range(N))
    @pytest.mark.parametrize(
        ("name", "word"),
        [
            ("objective", "not true: objective"),
            ("relative_gap", "not true: relative_gap"),
            ("convex_objective", "convex_objective"),
            ("convex_relative_gap", "convex_relative_gap"),
            ("coefficients", "not true: objective"),
            ("shapes", "shapes"),
            ("translation", "translation"),
            ("scale", "scale"),
            ("lambda", "objective"),
        ],
    )
    def test_a_number_that_is_off_is_false_of_its_image_alone(
        self, columns, program, image, name, word
    ):
        changed = columns | {name: columns[name].copy()}
        changed[name][image] *= 1 + 1e-6

        claims, _ = check_images(changed, program)

        assert [*claims.reasons] == [image]
        assert word in claims.reasons[image]

    def test_another_rotation_is_not_that_of_the_shape(self, columns, program):
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        changed = columns | {"rotation": columns["rotation"].copy()}
        changed["rotation"][1] = quarter @ changed["rotation"][1]
        claims, _ = check_images(changed, program)
        assert [*claims.reasons] == [1]

    def test_an_image_without_a_gap_of_its_program_has_no_certificate(
        self, columns, program
    ):
        """And no gap or objective of it is claimed."""
        changed = {
            name: columns[name].copy() for name in ("convex_relative_gap", "objective")
        }
        changed["convex_relative_gap"][1] = NAN
        changed["objective"][1] = NAN
        claims, is_certified = check_images(columns | changed, program)
        assert is_certified == [True, False, True]
        assert claims.reasons == {}

    def test_without_a_bound_the_refined_shape_is_not_checked(self, columns, program):
        changed = columns | {"shapes": columns["shapes"] + 1.0}
        claims, _ = check_images(changed, program._replace(has_bound=False))
        assert claims.reasons == {}
