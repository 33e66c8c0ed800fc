"""Lifted shapes are as large as the training shapes were."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.dictionary.bodies import find_lengths, metres_per_unit
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise

EDGES = np.array([[0, 1], [1, 2], [2, 3]])


@pytest.fixture
def shapes(rng):
    return rng.normal(size=(6, 3, 4))


@pytest.fixture
def dictionary(shapes) -> Dictionary:
    normalised = normalise(shapes)
    return Dictionary(
        atoms=normalised.points,
        landmark_names=tuple("abcd"),
        mean_shape=normalised.points[0],
        edges=EDGES,
        edge_length=find_lengths(shapes, EDGES, ("",) * len(shapes))[0].mean(axis=0),
        atom_scale=normalised.scale,
        unit="cm",
    )


def test_edges_are_as_long_as_they_were(shapes, dictionary):
    factor = metres_per_unit(17 * shapes, dictionary)
    found = find_lengths(factor[:, None, None] * 17 * shapes, EDGES, ("",) * len(shapes))[0].mean(
        axis=0
    )
    total = np.linalg.norm(np.diff(shapes, axis=2), axis=1).sum(axis=1).mean()
    assert found.sum() == pytest.approx(total / 100)


def test_without_edges_the_spread_is_that_of_the_training_shapes(shapes, dictionary):
    plain = replace(dictionary, edges=None, edge_length=None)
    factor = metres_per_unit(5 * shapes, plain)
    size = normalise(factor[:, None, None] * 5 * shapes).scale
    np.testing.assert_allclose(size, dictionary.atom_scale.mean() / 100)


def test_what_has_no_size(shapes, dictionary):
    assert metres_per_unit(shapes, replace(dictionary, unit="unknown")) is None
    nothing = replace(dictionary, edge_length=None, atom_scale=None)
    assert metres_per_unit(shapes, nothing) is None
    lost = np.concatenate([np.full((1, 3, 4), np.nan), np.zeros((1, 3, 4))])
    assert np.isnan(metres_per_unit(lost, dictionary)).all()
