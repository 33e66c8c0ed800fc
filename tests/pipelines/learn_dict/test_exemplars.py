"""`method: exemplars`: every training shape an atom, with its mesh, its size and its name."""

import numpy as np
import pytest

from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.rotations import random_rotations
from shapefit.io import ShapeSet
from tests.pipelines.told import warnings

FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])


@pytest.fixture
def models(rng):
    """Nine models of five landmarks, each with a tetrahedron around it, differently turned."""
    corners = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4)], dtype=float).T - 1
    points = rng.standard_normal((3, 5)) + 0.3 * rng.standard_normal((9, 3, 5))
    R, shift = random_rotations(9, rng), rng.standard_normal((9, 3, 1))
    size = rng.uniform(0.5, 2, (9, 1, 1))
    return ShapeSet(
        shapes=size * R @ points + shift,
        landmark_names=tuple("abcde"),
        items=tuple(f"model{i}" for i in range(9)),
        edges=np.array([[0, 1]]),
        mesh_vertices=size * R @ (corners + 0.1 * rng.standard_normal((9, 3, 4))) + shift,
        mesh_faces=FACES,
        unit="m",
    )


EXEMPLARS = {"method": "exemplars"}


def metric(dictionary, points):
    return dictionary.atom_scale[:, None, None] * points


def test_every_normalised_model_is_an_atom(make, models):
    dictionary, outcomes = make(models, align="none", **EXEMPLARS)
    normalised = normalise(models.shapes)
    np.testing.assert_array_equal(dictionary.atoms, normalised.points)
    np.testing.assert_array_equal(dictionary.atom_scale, normalised.scale)
    mean = normalise(normalised.points.mean(axis=0)).points
    np.testing.assert_array_equal(dictionary.mean_shape, mean)
    assert dictionary.atom_items == models.items
    assert dictionary.unit == "m"
    np.testing.assert_array_equal(dictionary.edges, models.edges)
    assert warnings(outcomes) == []
    assert [outcome.note for outcome in outcomes[:-1]] == ["9 shapes", "9 atoms"]
    assert dictionary.provenance["method"] == "exemplars"


def test_the_scale_gives_the_models_back_with_their_meshes(make, models):
    dictionary, _ = make(models, align="none", **EXEMPLARS)
    middle = models.shapes.mean(axis=2, keepdims=True)
    np.testing.assert_allclose(metric(dictionary, dictionary.atoms) + middle, models.shapes)
    found = metric(dictionary, dictionary.mesh_vertices) + middle
    np.testing.assert_allclose(found, models.mesh_vertices)
    np.testing.assert_array_equal(dictionary.mesh_faces, FACES)


def test_models_are_turned_onto_each_other_with_their_meshes(make, models):
    dictionary, _ = make(models, align="all", **EXEMPLARS)
    alignment = generalised_procrustes(normalise(models.shapes).points)
    np.testing.assert_array_equal(dictionary.atoms, alignment.shapes)
    assert np.abs(alignment.rotations - np.eye(3)).max() > 0.5
    middle = models.shapes.mean(axis=2, keepdims=True)
    turned = alignment.rotations @ (models.mesh_vertices - middle)
    np.testing.assert_allclose(metric(dictionary, dictionary.mesh_vertices), turned, atol=1e-12)
