"""What a dictionary leaves of a shape: planted answers, and scipy as an independent judge."""

import numpy as np
import pytest
from scipy.optimize import minimize, nnls
from scipy.spatial.transform import Rotation

from benchmarks.lower_bounds import best_combination, nearest_atom
from shapefit.evaluation.metrics import similarity
from shapefit.geometry.rotations import random_rotations, rotation_about

Z = np.array([0.0, 0, 1])


@pytest.fixture
def atoms(rng):
    """Variants of one shape, as exemplars are: a rotation fits all of them or none."""
    atoms = rng.standard_normal((3, 9)) + 0.4 * rng.standard_normal((4, 3, 9))
    return atoms - atoms.mean(axis=-1, keepdims=True)


def residual(shape, combined):
    """min over R, t of ||E - R S - t||^2, by scipy."""
    S, E = (x - x.mean(axis=-1, keepdims=True) for x in (shape, combined))
    return Rotation.align_vectors(E.T, S.T)[1] ** 2


def test_the_nearest_atom_is_the_one_that_the_shape_was_made_from(atoms, rng):
    made_from = np.array([2, 0, 3, 2])
    noise = 0.01 * rng.standard_normal((4, 3, 9))
    shapes = 5 * random_rotations(4, rng) @ (atoms[made_from] + noise) + 7
    np.testing.assert_allclose(
        nearest_atom(shapes, atoms), similarity(atoms[made_from], shapes), rtol=1e-12
    )


def test_a_combination_of_atoms_is_found_whichever_way_it_is_turned_and_sized(atoms, rng):
    c = np.abs(rng.standard_normal((6, 4)))
    mixed = np.einsum("nk,kap->nap", c, atoms)
    shapes = 3 * random_rotations(6, rng) @ mixed + rng.standard_normal((6, 3, 1))
    np.testing.assert_allclose(best_combination(shapes, atoms), 3 * mixed, atol=1e-3)
    np.testing.assert_allclose(similarity(best_combination(shapes, atoms), shapes), 0, atol=1e-3)


def test_no_other_rotation_with_its_own_combination_is_better(atoms, rng):
    R = rotation_about(Z, np.linspace(0, 3, 5))
    shapes = R @ (atoms[[0, 1, 2, 3, 0]] + 0.3 * rng.standard_normal((5, 3, 9)))
    A = atoms.reshape(4, -1).T
    for shape, found in zip(shapes, best_combination(shapes, atoms), strict=True):
        S = shape - shape.mean(axis=-1, keepdims=True)

        def remains(v, S=S):
            return nnls(A, (Rotation.from_rotvec(v).as_matrix() @ S).ravel())[1] ** 2

        starts = Rotation.random(12, rng=1).as_rotvec()
        best = min(minimize(remains, v, method="Nelder-Mead", tol=1e-9).fun for v in starts)
        assert residual(shape, found) == pytest.approx(best, rel=1e-4)


def test_coefficients_are_not_negative(atoms, rng):
    """What only a negative coefficient would explain stays unexplained."""
    shape = (atoms[0] - 0.9 * atoms[1] + 0.4 * atoms[2])[None]
    found = best_combination(shape, atoms)
    c = np.linalg.lstsq(atoms.reshape(4, -1).T, found.ravel(), rcond=None)[0]
    assert c.min() > -1e-9
    assert residual(shape[0], found[0]) > 1e-3 * (shape**2).sum()


def test_unknown_landmarks_have_no_say(atoms, rng):
    shapes = random_rotations(3, rng) @ (atoms[:3] + 0.3 * rng.standard_normal((3, 3, 9)))
    shapes[1, :, [2, 5]] = np.nan
    known = np.isfinite(shapes[1, 0])
    found = best_combination(shapes, atoms)
    alone = best_combination(shapes[1:2][..., known], atoms[..., known])
    np.testing.assert_allclose(found[1][:, known], alone[0])
    assert np.isnan(found[1][:, ~known]).all()
    np.testing.assert_allclose(found[[0, 2]], best_combination(shapes[[0, 2]], atoms))
    assert nearest_atom(shapes, atoms)[1] == pytest.approx(
        nearest_atom(shapes[1:2][..., known], atoms[..., known])[0]
    )
