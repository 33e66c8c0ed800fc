"""What changes the answer of a method and how, and what does not: every method, every
change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations, rotation_about_axis
from shapefit.lifting import shared_rotation
from shapefit.lifting.estimate import Estimate, Estimator
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.posterior import posterior
from shapefit.lifting.posterior.model import PosteriorModel
from tests.gaussians import covariance_of_root, single_gaussian
from tests.lifting.estimators import make_estimator
from tests.points import assert_rotations, binary_tree

N = 10
"""Images."""

K = 8
"""Atoms."""

P = 12
"""Landmarks."""

FAR = 2.0**38

METHODS = {
    "convex": ("convex", Loss.SQUARED),
    "exact": ("convex", Loss.EXACT),
    "l1": ("convex", Loss.ABSOLUTE),
    "sparse-error": ("convex", Loss.SPARSE_ERROR),
    "convex+refine": ("convex+refine", Loss.SQUARED),
    "alternate": ("alternate", Loss.SQUARED),
    "mean-shape": ("mean-shape", Loss.SQUARED),
    "global": ("global", Loss.SQUARED),
    "pmp": ("pmp", Loss.SQUARED),
    "posterior": ("posterior", Loss.SQUARED),
}
"""Case -> method, loss."""


@dataclass(frozen=True)
class Case:
    """Images and the class that they show."""

    landmarks: np.ndarray
    weights: np.ndarray
    atoms: np.ndarray
    mean: np.ndarray
    edges: np.ndarray
    prior: Mixture

    def estimator(self, name: str, threads: int = 1) -> Estimator[Any]:
        method, _ = METHODS[name]
        return make_estimator(
            method,
            solve=partial(solve_newton, tolerance=1e-10, threads=threads),
            mean_shape=self.mean,
            edges=self.edges,
            model=PosteriorModel(prior=self.prior, mean_shape=self.mean),
            threads=threads,
        )

    def estimate(self, name: str, threads: int = 1) -> Estimate:
        _, loss = METHODS[name]
        problem = build_problem(
            self.landmarks, self.atoms, 0.1, weights=self.weights, loss=loss, beta=0.3
        )
        estimate = self.estimator(name, threads)
        return estimate(problem)


@pytest.fixture(autouse=True)
def to_the_end(monkeypatch):
    """Go on until nothing more is gained, as far as numbers can tell."""
    monkeypatch.setattr(posterior, "MIN_LIKELIHOOD_GAIN", 1e-12)
    fine = partial(shared_rotation.alternate, tolerance=1e-14, max_rounds=5000)
    monkeypatch.setattr(shared_rotation, "alternate", fine)


@pytest.fixture
def case(make_scene, rng) -> Case:
    """Landmarks are multiples of 2^-10, so that they are the same numbers far from the
    origin.
    """
    scene = make_scene(n=N, k=K, p=P, noise=0.1, hidden=0.15, weighted=True)
    mean = scene.mean_shape
    root = rng.standard_normal((3 * P, 3 * P))
    root *= np.sqrt(0.1 / (3 * P))
    covariance = covariance_of_root(root, floor=0.02)
    return Case(
        landmarks=np.round(scene.landmarks * 2**10) / 2**10,
        weights=scene.weights,
        atoms=scene.atoms,
        mean=mean / np.linalg.norm(mean) * np.sqrt(3 * P),
        edges=binary_tree(P),
        prior=single_gaussian(mean, covariance),
    )


Carried = Callable[[np.ndarray], np.ndarray]
"""What a change does to the shapes that are found."""

Change = Callable[[Case, np.random.Generator], tuple[Case, Carried]]


def same(shapes: np.ndarray) -> np.ndarray:
    return shapes


def hide_garbage(case, rng):
    is_seen = case.weights[:, None] > 0
    landmarks = np.where(is_seen, case.landmarks, 1e6)
    return replace(case, landmarks=landmarks), same


def move_far(case, rng):
    return replace(case, landmarks=case.landmarks + FAR), same


def turn_image(case, rng):
    Q = rotation_about_axis(2, np.array(0.7))
    turned = replace(case, landmarks=Q[:2, :2] @ case.landmarks)
    return turned, lambda shapes: Q @ shapes


def turn_class(case, rng):
    Q = random_rotations(1, rng)[0]
    C = np.kron(Q, np.eye(P))
    prior = replace(
        case.prior,
        means=Q @ case.prior.means,
        covariances=C @ case.prior.covariances @ C.T,
    )
    return replace(case, atoms=Q @ case.atoms, mean=Q @ case.mean, prior=prior), same


def permute_landmarks(case, rng):
    order = rng.permutation(P)
    rows = np.concatenate([order + P * axis for axis in range(3)])
    prior = replace(
        case.prior,
        means=case.prior.means[..., order],
        covariances=case.prior.covariances[:, rows][:, :, rows],
    )
    permuted = Case(
        landmarks=case.landmarks[..., order],
        weights=case.weights[..., order],
        atoms=case.atoms[..., order],
        mean=case.mean[:, order],
        edges=np.argsort(order)[case.edges],
        prior=prior,
    )
    return permuted, lambda shapes: shapes[..., order]


def permute_atoms(case, rng):
    order = rng.permutation(K)
    return replace(case, atoms=case.atoms[order]), same


SOME = np.array([7, 2, 4])


def leave_some_out(case, rng):
    some = replace(case, landmarks=case.landmarks[SOME], weights=case.weights[SOME])
    return some, lambda shapes: shapes[SOME]


CHANGES: dict[str, Change] = {
    "garbage under the mask": hide_garbage,
    "far away": move_far,
    "image turned": turn_image,
    "class turned": turn_class,
    "landmarks in another order": permute_landmarks,
    "atoms in another order": permute_atoms,
    "some of the images": leave_some_out,
}


AXES_MATTER = ("image turned", "pmp")
"""The camera of pmp has a scale for each axis of the image."""


EVERY_CHANGE = [pair for pair in product(CHANGES, METHODS) if pair != AXES_MATTER]


@pytest.mark.parametrize(("change", "name"), EVERY_CHANGE)
def test_a_change_of_the_images_or_the_class(case, rng, name, change):
    """Shapes, and objectives, which are unique where shapes may not be."""
    images = SOME if change == "some of the images" else np.arange(N)
    base = case.estimate(name)
    other, carried = CHANGES[change](case, rng)

    found = other.estimate(name)

    assert np.isfinite(base.shapes).all()
    assert found.status == tuple(base.status[image] for image in images)
    if change != "far away":  # where the last digits of a residual are lost
        assert_allclose(found.objective, base.objective[images], rtol=1e-7, atol=1e-9)
    if name != "l1":
        assert_allclose(found.shapes, carried(base.shapes), atol=5e-4)


SQUARED_METHODS = [
    name
    for name, (method, loss) in METHODS.items()
    if loss is Loss.SQUARED and method != "posterior"
]


@pytest.mark.parametrize("name", SQUARED_METHODS)
def test_a_weight_of_root_two_counts_as_a_landmark_seen_twice(case, name):
    weights = case.weights.copy()
    weights[:, 3] = 1.0
    heavy = weights.copy()
    heavy[:, 3] = np.sqrt(2)
    twice = [*range(P), 3]
    copied = replace(
        case,
        landmarks=case.landmarks[..., twice],
        weights=weights[:, twice],
        atoms=case.atoms[..., twice],
        mean=case.mean[:, twice],
    )

    found = replace(case, weights=heavy).estimate(name)
    expected = copied.estimate(name)

    assert_allclose(found.objective, expected.objective, rtol=1e-7, atol=1e-9)
    assert_allclose(found.shapes, expected.shapes[..., :P], atol=5e-4)


@pytest.mark.parametrize("name", METHODS)
class TestThroughLift:
    """`lift` normalises: nothing of a method depends on pixels."""

    @pytest.fixture
    def lift_landmarks(self, case, name):
        _, loss = METHODS[name]
        lam = None if loss is Loss.EXACT else 0.1
        program = Program(lam, loss, beta=0.3)

        def lift_landmarks(landmarks):
            estimator = case.estimator(name)
            return lift(landmarks, case.weights, case.atoms, program, estimator)

        return lift_landmarks

    def test_landmarks_in_another_unit_and_place(self, case, name, lift_landmarks):
        place = np.array([[300.0], [-20.0]])

        found = lift_landmarks(case.landmarks)
        moved = lift_landmarks(50 * case.landmarks + place)

        assert found.failures == {}
        assert moved.failures == {}
        assert_allclose(moved.scale, 50 * found.scale, rtol=1e-8)
        assert_allclose(moved.estimate.objective, found.estimate.objective, rtol=1e-8)
        if name != "l1":
            expected = 50 * found.shapes
            expected[:, :2] += place
            assert_allclose(moved.shapes, expected, atol=50 * 5e-4)

    def test_rotations_are_proper(self, case, lift_landmarks):
        R = lift_landmarks(case.landmarks).estimate.rotation
        assert_rotations(R, atol=1e-9)
