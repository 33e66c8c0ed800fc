"""The dictionary: without the atoms of one training shape, and of other landmarks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary, map_landmarks
from shapefit.geometry.normalisation import normalise
from tests.gaussians import covariance_of_root
from tests.points import chain, edge_lengths

OTHERS = [0, 2, 4]
"""Atoms that are not of `polo`."""


@pytest.fixture
def exemplars(rng):
    """Five atoms of four items; `polo` is two of them."""
    atoms = normalise(rng.standard_normal((5, 3, 6))).points
    mean_shape = normalise(atoms.mean(axis=0)).points
    return Dictionary(
        atoms=atoms,
        landmark_names=tuple("abcdef"),
        mean_shape=mean_shape,
        edges=np.array([[0, 1]]),
        mesh_vertices=rng.standard_normal((5, 3, 9)),
        mesh_faces=np.array([[0, 1, 8]]),
        atom_scale=rng.uniform(1, 2, 5),
        unit="m",
        atom_items=("golf", "polo", "jetta", "polo", "up"),
        provenance={"version": "0"},
    )


def test_all_atoms_of_the_item_go(exemplars):
    rest = exemplars.without("polo")

    assert rest.atom_items == ("golf", "jetta", "up")
    assert_array_equal(rest.atoms, exemplars.atoms[OTHERS])
    assert_array_equal(rest.mesh_vertices, exemplars.mesh_vertices[OTHERS])
    assert_array_equal(rest.atom_scale, exemplars.atom_scale[OTHERS])


def test_what_is_not_of_single_atoms_stays_as_it_was(exemplars):
    rest = exemplars.without("polo")
    for name in ("landmark_names", "edges", "mesh_faces", "unit", "provenance"):
        assert getattr(rest, name) is getattr(exemplars, name)


def test_atoms_of_other_items_are_marked(exemplars):
    assert_array_equal(exemplars.atoms_without("polo"), [1, 0, 1, 0, 1])


def test_the_mean_shape_is_that_of_the_other_atoms(exemplars):
    rest = exemplars.without("polo")
    mean = rest.atoms.mean(axis=0)
    assert_allclose(rest.mean_shape, normalise(mean).points)


def test_the_mean_shape_knows_nothing_of_the_item(exemplars):
    garbage = exemplars.atoms.copy()
    garbage[[1, 3]] = 1e9
    no_mean_shape = np.full((3, 6), np.nan)
    spoilt = replace(exemplars, atoms=garbage, mean_shape=no_mean_shape)

    found = spoilt.without("polo").mean_shape

    assert_array_equal(found, exemplars.without("polo").mean_shape)


def test_atoms_without_items_cannot_be_left_out(exemplars):
    learned = replace(exemplars, atom_items=None)
    with pytest.raises(ValueError, match="not exemplars"):
        learned.without("polo")


def test_the_last_item_cannot_be_left_out(exemplars):
    one_item = replace(exemplars, atom_items=("golf",) * 5)
    with pytest.raises(ValueError, match="every atom is the item 'golf'"):
        one_item.without("golf")


def test_optional_landmarks_depend_on_the_one_before_them(exemplars):
    marked = replace(exemplars, provenance={"where_marked": "b:c,d f:e"})
    assert_array_equal(marked.depends_on, [-1, -1, 1, 1, 5, -1])


CHAIN = chain(4)


@pytest.fixture
def dictionary_with_prior(rng):
    """A prior of two components over a chain of four landmarks."""
    means = rng.standard_normal((2, 3, 4))
    roots = 0.3 * rng.standard_normal((2, 12, 12))
    covariances = covariance_of_root(roots, floor=0.01)
    return Dictionary(
        means,
        landmark_names=tuple("abcd"),
        mean_shape=means[0],
        edges=CHAIN,
        prior=Mixture(np.array([0.3, 0.7]), means, covariances),
        edge_length=np.array([1.0, 2, 3]),
    )


def draw_shapes(rng, prior, count):
    """Draw shapes (count, 3, p), as many of each component as its weight says."""
    drawn = []
    for weight, mean, C in zip(
        prior.weights, prior.means, prior.covariances, strict=True
    ):
        rows = rng.multivariate_normal(mean.ravel(), C, int(weight * count))
        drawn.append(rows.reshape(-1, *mean.shape))
    return np.concatenate(drawn)


def mean_square_lengths(shapes):
    return (edge_lengths(shapes, CHAIN) ** 2).mean(axis=0)


def test_the_means_of_a_prior_are_its_own(dictionary_with_prior):
    prior = dictionary_with_prior.prior
    assert dictionary_with_prior.prior_means is prior.means


def test_edges_of_landmarks_are_as_long_as_their_map_makes_them(
    rng, dictionary_with_prior
):
    """Root mean square lengths of samples of the prior, before and behind the map."""
    A = np.eye(4)
    A[3] = [0.2, 0.3, -0.4, 0.9]
    before = draw_shapes(rng, dictionary_with_prior.prior, 400_000)
    behind = before @ A.T
    growth = mean_square_lengths(behind) / mean_square_lengths(before)
    expected = dictionary_with_prior.edge_length * np.sqrt(growth)

    found = map_landmarks(dictionary_with_prior, A, np.zeros(4))

    assert_allclose(found.edge_length, expected, rtol=0.01)
