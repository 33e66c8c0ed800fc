"""The table of methods: what each promises beside the others, on made and on real
images.
"""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import Loss
from shapefit.convex.solver import Status, solve_newton
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.mixture import Mixture
from shapefit.lifting.lift import Program, lift
from tests.lifting.estimators import make_estimator

RIGID = ("convex+refine", "alternate")
# Matching pursuit has bases and tests of its own: test_matching_pursuit.py.
NAMES = ("convex", *RIGID, "mean-shape")

NEEDS = {
    "edges": np.array([[0, 1], [1, 2]]),
    "prior": Mixture(
        np.ones(1),
        np.random.default_rng(0).normal(size=(1, 3, 12)),
        0.1 * np.eye(36)[None],
    ),
}
"""What dictionaries of 12 landmarks have for those methods that need more than atoms.
"""


@pytest.fixture
def scene(make_scene):
    return make_scene(n=25, k=15, noise=0.3, weighted=True, hidden=0.15)


@pytest.fixture
def settings(scene):
    return {
        "solve": partial(solve_newton, tolerance=1e-7),
        "mean_shape": scene.mean_shape,
    }


@pytest.mark.parametrize("name", RIGID)
@pytest.mark.parametrize("signed", [False, True])
def test_an_estimate_of_one_rotation_agrees_with_itself(name, signed, scene, settings):
    """Shape, transforms, objective and residual follow from c, R and T."""
    problem = scene.problem(0.1)
    found = make_estimator(name, **settings | {"signed": signed})(problem)
    c, R = found.coefficients, found.rotation
    assert_allclose(
        found.shapes, R @ np.einsum("nk,kap->nap", c, scene.atoms), atol=1e-12
    )
    assert_allclose(
        np.einsum("nkab,kbp->nap", found.transforms.dense(), scene.atoms),
        found.shapes[:, :2],
        atol=1e-12,
    )
    assert_array_equal(found.active_atoms, (np.abs(c) > 1e-6).sum(axis=1))
    left = scene.landmarks - found.shapes[:, :2] - found.translation[..., None]
    left *= scene.weights[:, None]
    assert_allclose(
        found.objective,
        0.5 * (left**2).sum(axis=(1, 2)) + 0.1 * np.abs(c).sum(axis=1),
        rtol=1e-12,
    )
    assert (c < 0).any() == signed


def test_refinement_is_bounded_by_the_convex_program(scene, settings):
    problem = scene.problem(0.1)
    convex = make_estimator("convex", **settings)(problem)
    for signed in (False, True):
        found = make_estimator("convex+refine", **settings | {"signed": signed})(
            problem
        )
        assert (found.relative_gap >= -1e-12).all()
        assert found.relative_gap.max() > 1e-3
        assert_allclose(
            found.objective * (1 - found.relative_gap),
            convex.objective * (1 - convex.relative_gap),
            rtol=1e-12,
        )


@pytest.mark.parametrize("name", NAMES)
def test_a_large_lambda_and_hidden_images_are_no_accident(name, scene, settings):
    scene.weights[4] = 0.0
    found = make_estimator(name, **settings)(scene.problem(1e4))
    assert found.status[4] is Status.DEGENERATE
    if name != "mean-shape":
        assert_array_equal(found.coefficients, 0.0)
        assert_array_equal(found.shapes, 0.0)
        assert np.isnan(found.rotation).all()
        assert not found.transforms.count.any()
    lifting = lift(
        scene.landmarks,
        scene.weights,
        scene.atoms,
        Program(1e4),
        make_estimator(name, **settings),
    )
    assert lifting.failures == {4: "all landmarks are hidden"}
    assert np.isnan(lifting.shapes[4]).all()
    assert np.isfinite(np.delete(lifting.shapes, 4, axis=0)).all()


def test_only_images_without_an_atom_begin_again(scene, settings):
    """Some transforms have the wrong sign, one image is hidden, and one lets no atom in
    at all.
    """
    scene.weights[7] = 0.0
    wrong = np.array([2, 11, 20])
    lam = np.full(25, 0.05)
    lam[4] = 1e4
    problem = replace(scene.problem(0.05), lam=lam)

    def solve(problem):
        solution = solve_newton(problem)
        transforms = solution.transforms.dense()
        transforms[wrong] *= -1
        return solution._replace(transforms=Transforms.of(transforms))

    refined = make_estimator("convex+refine", **settings | {"solve": solve})(problem)
    plain = make_estimator("convex+refine", **settings | {"solve": solve_newton})(
        problem
    )
    retained = np.setdiff1d(np.arange(25), [*wrong, 4])
    for field in fields(refined):
        mine, theirs = getattr(refined, field.name), getattr(plain, field.name)
        if isinstance(mine, np.ndarray):
            assert_array_equal(mine[retained], theirs[retained], err_msg=field.name)
    assert refined.coefficients[wrong].any(axis=1).all()
    assert not refined.coefficients[[4, 7]].any()
    assert refined.status[7] is Status.DEGENERATE
    assert {refined.status[i] for i in range(25) if i != 7} == {Status.CONVERGED}

    alone = make_estimator("alternate", **settings)(problem.take(wrong))
    assert_allclose(refined.coefficients[wrong], alone.coefficients, atol=1e-9)
    assert_allclose(refined.shapes[wrong], alone.shapes, atol=1e-9)
    assert_allclose(refined.residual[wrong], alone.residual, rtol=1e-9)
    assert (refined.iterations[wrong] > alone.iterations).all()


@pytest.mark.parametrize("loss", [Loss.ABSOLUTE, Loss.SPARSE_ERROR])
def test_outliers_are_the_landmarks_whose_weighted_residual_exceeds_beta(
    loss, scene, settings
):
    problem = replace(scene.problem(1.0), loss=loss, beta=0.1)
    found = make_estimator("convex", **settings)(problem)
    left = np.abs(
        problem.landmarks - found.shapes[:, :2] - found.translation[..., None]
    )
    beyond = (left * problem.weights[:, None] > 0.1).any(axis=1)
    assert_array_equal(found.outliers, beyond)
    assert ((left > 0.1).any(axis=1) != beyond).any()
    assert 0.05 < beyond.mean() < 0.95


@pytest.mark.parametrize("loss", [Loss.SQUARED, Loss.ABSOLUTE])
def test_a_failure_of_the_convex_solver_is_not_forgotten(loss, scene, settings):
    def solve(problem):
        solution = settings["solve"](problem)
        status = list(solution.status)
        status[3], status[5] = Status.NUMERICAL_FAILURE, Status.ITERATION_LIMIT
        return solution._replace(status=tuple(status))

    problem = replace(scene.problem(0.1), loss=loss)
    found = make_estimator("convex+refine", **settings | {"solve": solve})(problem)
    assert found.status[3] is Status.NUMERICAL_FAILURE
    assert set(np.delete(found.status, 3)) == {Status.CONVERGED}
