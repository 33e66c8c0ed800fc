"""Principal components: planted, optimal, equal to an independent solver's, and equivariant."""

import numpy as np
import pytest

from shapefit.dictionary.learning import principal_components


@pytest.fixture
def shapes(rng):
    """40 centred shapes around one that is not 0, of falling variation."""
    forms = rng.standard_normal((12, 3, 6)) * 0.6 ** np.arange(12)[:, None, None]
    points = rng.standard_normal((3, 6)) + np.tensordot(rng.standard_normal((40, 12)), forms, 1)
    return points - points.mean(axis=-1, keepdims=True)


def flat(shapes):
    return shapes.reshape(len(shapes), -1)


@pytest.fixture
def planted(rng):
    """Three orthonormal components (3, 18) and shapes that have them with energies 25, 4, 1."""
    components = np.linalg.qr(rng.standard_normal((18, 3)))[0].T
    ones_and_more = np.column_stack([np.ones(30), rng.standard_normal((30, 3))])
    C = np.linalg.qr(ones_and_more)[0][:, 1:]  # orthonormal columns of mean 0
    mean = rng.standard_normal((3, 6))
    return components, mean + ((C * [5, 2, 1]) @ components).reshape(30, 3, 6)


def test_as_many_as_the_energy_needs_and_no_more(planted):
    # The first holds 0.833 of the energy, the first two 0.967.
    _, shapes = planted
    counts = [len(principal_components(shapes, e)) for e in (0.5, 0.83, 0.84, 0.96, 0.97, 0.999)]
    assert counts == [1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize("components", [1, 4, 9])
def test_they_leave_the_least_residual(shapes, components):
    """Certificate (Eckart and Young): the residual is the sum of the other squared values."""
    found = flat(principal_components(shapes, components))
    np.testing.assert_allclose(found @ found.T, np.eye(components), atol=1e-12)
    X = flat(shapes - shapes.mean(axis=0))
    residual = np.linalg.norm(X - X @ found.T @ found) ** 2
    least = (np.linalg.svd(X, compute_uv=False)[components:] ** 2).sum()
    assert residual == pytest.approx(least, rel=1e-12)


@pytest.mark.parametrize("keys", [{"bases": 1 - 1e-15}, {"bases": 99}])
def test_never_more_than_the_rank(shapes, keys):
    # 12 forms in 15 centred dimensions; 5 shapes vary in 4.
    assert len(principal_components(shapes, **keys)) == 12
    assert len(principal_components(shapes[:5], **keys)) == 4


def test_rounding_of_single_precision_is_no_motion(shapes, rng):
    still = np.repeat(10 * shapes[:1], 40, axis=0)
    rounded = still * (1 + np.finfo(np.float32).eps * rng.uniform(-0.5, 0.5, still.shape))
    assert len(principal_components(rounded)) == 0
    moving = rounded + 1e-4 * np.sin(np.arange(40))[:, None, None] * shapes[1]
    assert len(principal_components(moving)) == 1
