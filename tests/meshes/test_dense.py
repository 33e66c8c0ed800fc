import numpy as np
import pytest

from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes, similarity_transform
from shapefit.meshes.dense import (
    carry_mesh,
    mesh_of_atoms,
    metric_scale,
)


def normalised_models(shapes):
    normalised = normalise(shapes)
    return normalised, generalised_procrustes(normalised.points)


def residual_variance(source, target):
    """Largest distance of points left by the best similarity, as a share of the target's norm."""
    rest = similarity_transform(source, target).apply(source) - target
    return np.linalg.norm(rest, axis=-2).max() / np.linalg.norm(target)


def test_a_mesh_is_carried_as_its_landmarks_are(rng):
    shapes = 40 + 7 * rng.normal(size=(6, 3, 9))
    normalised, alignment = normalised_models(shapes)
    carried = carry_mesh(shapes, normalised, alignment.rotations)
    np.testing.assert_allclose(carried, alignment.shapes, atol=1e-13)


def test_atoms_mixed_from_shapes_have_meshes_mixed_alike(rng):
    shapes, meshes = rng.normal(size=(5, 3, 7)), rng.normal(size=(5, 3, 20))
    mixture = rng.normal(size=(4, 5))
    mixed = mesh_of_atoms(np.tensordot(mixture, shapes, 1), shapes, meshes)
    np.testing.assert_allclose(mixed, np.tensordot(mixture, meshes, 1), atol=1e-12)
    np.testing.assert_allclose(mesh_of_atoms(shapes[3:], shapes, meshes), meshes[3:], atol=1e-12)


def test_an_atom_out_of_the_span_of_the_shapes_is_refused(rng):
    shapes, meshes = rng.normal(size=(5, 3, 7)), rng.normal(size=(5, 3, 20))
    with pytest.raises(ValueError, match="not a linear combination"):
        mesh_of_atoms(shapes[:2] + 1e-3 * rng.normal(size=(2, 3, 7)), shapes, meshes)


def test_a_fit_by_one_atom_has_the_metric_size_of_its_model(rng):
    models = np.array([1.0, 3.0, 0.2])[:, None, None] * rng.normal(size=(3, 3, 8)) + 5
    normalised, alignment = normalised_models(models)
    c = np.array([[0.0, 0.7, 0.0], [0.3, 0.0, 0.0]])
    factor = metric_scale(alignment.shapes, c, normalised.scale)
    metric = factor[:, None, None] * np.tensordot(c, alignment.shapes, axes=1)
    for shape, model in zip(metric, models[[1, 0]], strict=True):
        centred = model - model.mean(axis=1, keepdims=True)
        assert np.linalg.norm(shape) == pytest.approx(np.linalg.norm(centred))
        assert residual_variance(shape, centred) < 1e-12


def test_the_metric_size_of_a_mixture_is_the_mean_of_the_sizes_of_its_parts(box):
    atoms = np.stack([box(4, 3, 2), 2 * box(4, 3, 2)])
    # in metres twice and once the first box; shares 0.6 and 0.4 of the shape's length
    coefficients, atom_scale = np.array([[0.6, 0.2]]), np.array([2.0, 0.5])
    factor = metric_scale(atoms, coefficients, atom_scale)
    metric = factor * np.tensordot(coefficients, atoms, axes=1)
    np.testing.assert_allclose(metric[0], (0.6 * 2 + 0.4 * 1) * box(4, 3, 2))


def test_without_coefficients_there_is_no_metric_size(rng):
    factor = metric_scale(rng.normal(size=(2, 3, 4)), np.array([[0.0, 0], [1, 0]]), np.ones(2))
    np.testing.assert_array_equal(np.isnan(factor), [True, False])
