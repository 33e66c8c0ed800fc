"""Inner steps are optimal, errors fall, planted shapes are found, a plain version agrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.convex.solver import Status
from shapefit.geometry.procrustes import similarity_transform
from shapefit.lifting.matching_pursuit import Pursuit, find_limbs


def centred(weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., p) less their weighted mean, times the weights."""
    mean = np.average(points, axis=-1, weights=weights**2)[..., None]
    return weights * (points - mean)


def least_squares_camera(w: np.ndarray, X: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(X.T, w.T, rcond=None)[0].T


@dataclass(frozen=True)
class InnerStep:
    """min ||A a - b||^2 subject to a^T H a = length2: the mean and the atoms of an image."""

    A: np.ndarray
    b: np.ndarray
    H: np.ndarray
    length2: float
    a: np.ndarray

    @classmethod
    def of(cls, scene, found: Pursuit, image: int, camera: np.ndarray) -> InnerStep:
        chosen = np.flatnonzero(found.coefficients[image])
        shapes = np.concatenate([scene.mean[None], scene.bases[chosen]])
        weights = scene.weights[image]
        A = (camera @ centred(weights, shapes)).reshape(len(shapes), -1).T
        b = centred(weights, scene.problem.landmarks[image]).ravel()
        limbs = find_limbs(shapes, scene.edges)
        a = np.append(found.mean_coefficient[image], found.coefficients[image, chosen])
        return cls(A, b, limbs @ limbs.T, float(limbs[0] @ limbs[0]), a)

    def check_optimality(self) -> float:
        """On the constraint, stationary, the Lagrangian's Hessian >= 0; returns the multiplier."""
        assert self.a @ self.H @ self.a == pytest.approx(self.length2, rel=1e-10)
        slope, normal = self.A.T @ (self.b - self.A @ self.a), self.H @ self.a
        multiplier = float(slope @ normal / (normal @ normal))
        scale = np.abs(self.A.T @ self.b).max()
        np.testing.assert_allclose(slope, multiplier * normal, atol=1e-7 * scale)
        hessian = self.A.T @ self.A + multiplier * self.H
        assert np.linalg.eigvalsh(hessian)[0] >= -1e-7 * np.linalg.norm(hessian, 2)
        return multiplier


class TestCertificate:
    @pytest.fixture
    def settled(self, noisy):
        """Every inner loop run to its end."""
        found = noisy.pursue(goal=0.0, change=1e-16, most_atoms=4, most_rounds=20_000)
        assert (np.count_nonzero(found.coefficients, axis=1) == 4).all()
        return noisy, found

    def test_where_a_loop_comes_to_rest_both_steps_are_optimal(self, settled):
        scene, found = settled
        for image, S in enumerate(scene.mix(found)):
            step = InnerStep.of(scene, found, image, found.camera[image])
            # The size of the shape is that of the camera too, so the constraint costs nothing.
            assert step.check_optimality() == pytest.approx(0, abs=1e-7)
            w = centred(scene.weights[image], scene.problem.landmarks[image])
            X = centred(scene.weights[image], S)
            np.testing.assert_allclose(
                found.camera[image], least_squares_camera(w, X), rtol=0, atol=1e-9
            )
            error = np.linalg.norm(w - found.camera[image] @ X) ** 2
            assert found.error[image] == pytest.approx(error, rel=1e-10)


class TestDescent:
    @pytest.mark.parametrize("most_rounds", [1, 30])
    def test_no_atom_raises_the_error(self, noisy, most_rounds):
        errors = [
            noisy.pursue(goal=0.0, most_atoms=most, most_rounds=most_rounds).error
            for most in range(7)
        ]
        assert (np.diff(errors, axis=0) <= 1e-12).all()
        assert (errors[-1] < 0.5 * errors[0]).all()


class TestPlanted:
    @pytest.mark.parametrize("keys", [{}, {"hidden": 0.15, "weighted": True}])
    def test_mixtures_of_the_mean_and_few_bases_are_recovered(self, make_scene, keys):
        scene = make_scene(n=20, k=6, active=2, **keys)
        found = scene.pursue(goal=1e-22, change=1e-24, most_rounds=20_000)
        S = scene.mix(found)
        moved = similarity_transform(S, scene.shapes).apply(S)
        np.testing.assert_allclose(moved, scene.shapes, atol=1e-6)
        singular = np.linalg.svd(found.camera, compute_uv=False)
        np.testing.assert_allclose(singular[:, 0], singular[:, 1], rtol=1e-6)
        relative = np.abs(found.coefficients / found.mean_coefficient[:, None])
        np.testing.assert_allclose(np.sort(relative)[:, -2:], 2, atol=1e-5)
        np.testing.assert_allclose(np.sort(relative)[:, :-2], 0, atol=1e-5)

    def test_the_mean_shape_needs_no_atom(self, make_scene):
        found = (scene := make_scene(active=0)).pursue(goal=1e-12)
        assert not found.coefficients.any()
        np.testing.assert_allclose(found.mean_coefficient, 1, rtol=1e-14)
        assert (found.rounds == 0).all()
        assert set(found.status) == {Status.CONVERGED}
        np.testing.assert_allclose(
            scene.mix(found), np.broadcast_to(scene.mean, scene.shapes.shape)
        )
