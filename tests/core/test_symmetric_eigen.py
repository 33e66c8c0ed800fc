"""Eigenvalues of small symmetric matrices: NumPy's, orthonormal vectors, hard spectra."""

import numpy as np
import pytest

from shapefit import core


def decompose(A):
    values, V = np.empty(len(A)), np.empty_like(A)
    core.parts.symmetric_eigen(A.copy(), values, V)
    return values, V


@pytest.mark.parametrize("m", [1, 2, 3, 8, 16])
@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_values_are_numpys_and_vectors_rebuild_the_matrix(rng, m, scale):
    for _ in range(10):
        A = rng.standard_normal((m, m))
        A = scale * (A + A.T)
        values, V = decompose(A)
        size = np.abs(A).max() * m
        np.testing.assert_allclose(values, np.linalg.eigvalsh(A), atol=1e-14 * size)
        np.testing.assert_allclose(V @ V.T, np.eye(m), atol=1e-14 * m)
        np.testing.assert_allclose((V.T * values) @ V, A, atol=1e-14 * size)


def test_equal_and_vanishing_values(rng):
    U, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    spectrum = np.array([0, 0, 1e-9, 1, 1, 1])
    values, V = decompose((U * spectrum) @ U.T)
    np.testing.assert_allclose(values, spectrum, atol=1e-14)
    np.testing.assert_allclose(V @ V.T, np.eye(6), atol=1e-14)
    values, V = decompose(np.zeros((4, 4)))
    np.testing.assert_array_equal(values, np.zeros(4))
    np.testing.assert_array_equal(V, np.eye(4))
