"""Dense vertices follow the landmarks, and have a metric size."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes, similarity_transform
from shapefit.meshes.dense import metric_scale, transform_mesh
from tests.points import centred, mix, norms, resized


def align(shapes):
    """Return normalised shapes, and what aligns them."""
    normalised = normalise(shapes)
    return normalised, generalised_procrustes(normalised.points)


def largest_misfit(source, target):
    """Largest distance of points left by the best similarity, as a share of the
    target's norm.
    """
    moved = similarity_transform(source, target).apply(source)
    distances = np.linalg.norm(moved - target, axis=-2)
    return distances.max() / np.linalg.norm(target)


def test_a_mesh_is_carried_as_its_landmarks_are(rng):
    shapes = 40 + 7 * rng.normal(size=(6, 3, 9))
    normalised, alignment = align(shapes)
    carried = transform_mesh(shapes, normalised, alignment.rotations)
    assert_allclose(carried, alignment.shapes, atol=1e-13)


class TestMetricSize:
    """A fit by one atom has the metric size of its model."""

    @pytest.fixture
    def models(self, rng):
        """Of three sizes, beside the origin."""
        sizes = np.array([1.0, 3.0, 0.2])
        return resized(rng.normal(size=(3, 3, 8)), sizes) + 5

    @pytest.fixture
    def metric(self, models):
        """Fits by the second model, and by the first."""
        normalised, alignment = align(models)
        coefficients = np.array([[0.0, 0.7, 0.0], [0.3, 0.0, 0.0]])
        factor = metric_scale(alignment.shapes, coefficients, normalised.scale)
        return resized(mix(coefficients, alignment.shapes), factor)

    @pytest.fixture
    def expected(self, models):
        return centred(models[[1, 0]])

    def test_its_size(self, metric, expected):
        assert norms(metric) == pytest.approx(norms(expected))

    def test_its_shape(self, metric, expected):
        for shape, model in zip(metric, expected, strict=True):
            assert largest_misfit(shape, model) < 1e-12


def test_the_size_of_an_image_does_not_depend_on_the_others(rng):
    atoms = rng.normal(size=(40, 3, 15))
    coefficients = rng.random((50, 40))
    factors = metric_scale(atoms, coefficients, np.ones(40))
    alone = [metric_scale(atoms, c[None], np.ones(40)) for c in coefficients]
    assert_array_equal(factors, np.concatenate(alone))


def test_without_coefficients_there_is_no_metric_size(rng):
    atoms = rng.normal(size=(2, 3, 4))
    coefficients = np.array([[0.0, 0], [1, 0]])
    factor = metric_scale(atoms, coefficients, np.ones(2))
    assert_array_equal(np.isnan(factor), [True, False])
