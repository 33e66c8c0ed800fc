"""The dictionary: without the atoms of one training shape, and of other landmarks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary, mapped
from shapefit.geometry.normalisation import normalise


@pytest.fixture
def exemplars(rng):
    """Five atoms of four items; `polo` is two of them."""
    atoms = normalise(rng.standard_normal((5, 3, 6))).points
    return Dictionary(
        atoms=atoms,
        landmark_names=tuple("abcdef"),
        mean_shape=normalise(atoms.mean(axis=0)).points,
        edges=np.array([[0, 1]]),
        mesh_vertices=rng.standard_normal((5, 3, 9)),
        mesh_faces=np.array([[0, 1, 8]]),
        atom_scale=rng.uniform(1, 2, 5),
        unit="m",
        atom_items=("golf", "polo", "jetta", "polo", "up"),
        provenance={"version": "0"},
    )


def test_all_atoms_of_the_item_go_and_the_others_stay_as_they_were(exemplars):
    rest = exemplars.without("polo")
    assert rest.atom_items == ("golf", "jetta", "up")
    for name in ("atoms", "mesh_vertices", "atom_scale"):
        assert_array_equal(getattr(rest, name), getattr(exemplars, name)[[0, 2, 4]])
    for name in ("landmark_names", "edges", "mesh_faces", "unit", "provenance"):
        assert getattr(rest, name) is getattr(exemplars, name)
    assert_array_equal(exemplars.atoms_without("polo"), [1, 0, 1, 0, 1])


def test_the_mean_shape_knows_nothing_of_the_item(exemplars):
    rest = exemplars.without("polo")
    assert_allclose(rest.mean_shape, normalise(rest.atoms.mean(axis=0)).points)
    garbage = exemplars.atoms.copy()
    garbage[[1, 3]] = 1e9
    spoilt = replace(exemplars, atoms=garbage, mean_shape=np.full((3, 6), np.nan))
    assert_array_equal(spoilt.without("polo").mean_shape, rest.mean_shape)


def test_atoms_without_items_and_the_last_item_cannot_be_left_out(exemplars):
    with pytest.raises(ValueError, match="not exemplars"):
        replace(exemplars, atom_items=None).without("polo")
    with pytest.raises(ValueError, match="every atom is the item 'golf'"):
        replace(exemplars, atom_items=("golf",) * 5).without("golf")


def test_optional_landmarks_depend_on_the_one_before_them(exemplars):
    marked = replace(exemplars, provenance={"where_marked": "b:c,d f:e"})
    assert_array_equal(marked.depends_on, [-1, -1, 1, 1, 5, -1])


def test_edges_of_landmarks_are_as_long_as_their_map_makes_them(rng):
    """Root mean square lengths of samples of the prior, before and behind the map."""
    mean, A = rng.standard_normal((2, 3, 4)), np.eye(4)
    A[3] = [0.2, 0.3, -0.4, 0.9]
    B = 0.3 * rng.standard_normal((2, 12, 12))
    prior = Mixture(
        np.array([0.3, 0.7]), mean, B @ B.swapaxes(1, 2) + 0.01 * np.eye(12)
    )
    edges, length = np.array([[0, 1], [1, 2], [2, 3]]), np.array([1.0, 2, 3])
    given = Dictionary(
        mean, tuple("abcd"), mean[0], edges, prior=prior, edge_length=length
    )
    drawn = np.concatenate(
        [
            rng.multivariate_normal(m.ravel(), C, int(weight * 400_000)).reshape(
                -1, 3, 4
            )
            for weight, m, C in zip(prior.weights, mean, prior.covariances, strict=True)
        ]
    )

    def squares(x):
        return (
            ((x[:, :, edges[:, 0]] - x[:, :, edges[:, 1]]) ** 2)
            .sum(axis=1)
            .mean(axis=0)
        )

    expected = length * np.sqrt(squares(drawn @ A.T) / squares(drawn))
    assert given.prior_means is mean
    found = mapped(given, A, np.zeros(4)).edge_length
    assert_allclose(found, expected, rtol=0.01)
