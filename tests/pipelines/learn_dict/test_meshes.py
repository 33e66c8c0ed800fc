"""Meshes and sizes of atoms that `learn-dict` mixes from training shapes."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.dictionary.learning import learn
from shapefit.geometry.normalisation import normalise, std
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.io import ShapeSet
from shapefit.meshes.dense import carry_mesh, mesh_of_atoms
from shapefit.pipelines.learn_dict import from_3d
from tests.pipelines.told import warnings

FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])


@pytest.fixture
def models(rng):
    """Twelve models of five landmarks, four of which are the corners of a tetrahedron."""
    points = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4), (1, 1, 2)], dtype=float).T
    points = rng.uniform(0.5, 2, (12, 1, 1)) * (points + 0.3 * rng.standard_normal((12, 3, 5)))
    return ShapeSet(
        shapes=points,
        landmark_names=tuple("abcde"),
        items=tuple(f"model{i}" for i in range(12)),
        sequences=("here",) * 6 + ("there",) * 6,
        mesh_vertices=points[:, :, :4],
        mesh_faces=FACES,
        unit="m",
    )


LEARNED = {"k": 4, "iterations": 5}


def test_vertices_go_where_the_landmarks_go_on_which_they_lie(make, models):
    for align in ("all", "none", ["a", "b", "c"]):
        dictionary, outcomes = make(models, align=align, **LEARNED)
        assert warnings(outcomes) == []
        np.testing.assert_allclose(
            dictionary.mesh_vertices, dictionary.atoms[:, :, :4], rtol=0, atol=1e-12
        )
        np.testing.assert_array_equal(dictionary.mesh_faces, FACES)


def test_meshes_mixed_otherwise_follow_the_mixture(make, models, rng):
    meshes = rng.standard_normal((12, 3, 7))
    dictionary, _ = make(models.replaced(mesh_vertices=meshes), **LEARNED)
    normalised = normalise(models.shapes)
    alignment = generalised_procrustes(normalised.points)
    carried = carry_mesh(meshes, normalised, alignment.rotations)
    expected = mesh_of_atoms(dictionary.atoms, alignment.shapes, carried)
    np.testing.assert_array_equal(dictionary.mesh_vertices, expected)


def test_learned_atoms_have_sizes_in_the_unit_of_the_shapes(make, models):
    dictionary, _ = make(models, **LEARNED)
    assert dictionary.unit == "m"
    assert dictionary.atom_items is None
    normalised = normalise(models.shapes)
    *_, learned = learn(generalised_procrustes(normalised.points).shapes, 4, 0.1, iterations=5)
    grown = dictionary.atom_scale * std(dictionary.atoms)
    share = learned.coefficients / learned.coefficients.sum(axis=0)
    np.testing.assert_allclose(grown, share.T @ normalised.scale, rtol=1e-12)
    larger, _ = make(models.replaced(shapes=1000 * models.shapes), **LEARNED)
    np.testing.assert_allclose(larger.atom_scale, 1000 * dictionary.atom_scale, rtol=1e-9)


def test_an_atom_that_is_no_mixture_leaves_the_meshes_out(make, models, monkeypatch):
    def learn_elsewhere(shapes, *settings, **options):
        *_, learned = learn(shapes, *settings, **options)
        bent = learned.atoms + 0.1 * np.sin(np.arange(15)).reshape(3, 5)
        yield replace(learned, atoms=bent - bent.mean(axis=-1, keepdims=True))

    monkeypatch.setattr(from_3d, "learn", learn_elsewhere)
    few = models.take([0, 1, 2, 3])
    dictionary, outcomes = make(few, **LEARNED)
    assert warnings(outcomes) == [
        "the meshes are left out: an atom is not a linear combination of the training shapes"
    ]
    assert (dictionary.mesh_vertices, dictionary.mesh_faces) == (None, None)
