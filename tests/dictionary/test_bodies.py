"""How lengths of edges differ between bodies: planted ones, one alone, edges without length."""

import numpy as np

from shapefit.dictionary.bodies import find_edge_covariance
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary, mapped


def test_many_bodies_say_how_bodies_differ(rng):
    true = np.array([[0.8, 0.6, 0], [0.6, 0.8, 0], [0, 0, 0.4]])
    bodies = np.exp(rng.multivariate_normal(np.log([0.3, 0.4, 0.5]), true, 500))
    np.testing.assert_allclose(find_edge_covariance(bodies), true, atol=0.1)
    np.testing.assert_allclose(find_edge_covariance(7 * bodies), find_edge_covariance(bodies))


def test_sequences_of_one_body_count_once(rng):
    bodies = np.exp(0.1 * rng.standard_normal((4, 6)))
    again = bodies[[0, 0, 1, 0, 2, 3, 3]] * np.exp(0.005 * rng.standard_normal((7, 6)))
    again[[0, 2, 4, 5]] = bodies
    np.testing.assert_allclose(find_edge_covariance(again), find_edge_covariance(bodies))


def test_an_edge_without_length_differs_by_the_usual_spread(rng):
    bodies = np.exp(0.1 * rng.standard_normal((5, 3)))
    bodies[2, 1] = 0
    found = find_edge_covariance(bodies)
    assert np.isfinite(found).all()
    assert found[1, 0] == found[1, 2] == 0


def test_edges_of_landmarks_are_as_long_as_their_map_makes_them(rng):
    """Root mean square lengths of samples of the prior, before and behind the map."""
    mean, A = rng.standard_normal((2, 3, 4)), np.eye(4)
    A[3] = [0.2, 0.3, -0.4, 0.9]
    B = 0.3 * rng.standard_normal((2, 12, 12))
    prior = Mixture(np.array([0.3, 0.7]), mean, B @ B.swapaxes(1, 2) + 0.01 * np.eye(12))
    edges, length = np.array([[0, 1], [1, 2], [2, 3]]), np.array([1.0, 2, 3])
    given = Dictionary(mean, tuple("abcd"), mean[0], edges, prior=prior, edge_length=length)
    drawn = [
        rng.multivariate_normal(m.ravel(), C, 200_000)
        for m, C in zip(mean, prior.covariances, strict=True)
    ]

    def squares(A):
        along = [
            (x.reshape(-1, 3, 4) @ A.T)[:, :, edges[:, 0]]
            - (x.reshape(-1, 3, 4) @ A.T)[:, :, edges[:, 1]]
            for x in drawn
        ]
        return sum(
            share * (each**2).sum(axis=1).mean(axis=0)
            for share, each in zip(prior.weights, along, strict=True)
        )

    expected = length * np.sqrt(squares(A) / squares(np.eye(4)))
    found = mapped(given, A, np.zeros(4)).edge_length
    np.testing.assert_allclose(found, expected, rtol=0.01)


def test_shapes_of_nobody_knows_whom_are_one_body_and_as_much_surer_as_they_are_alike():
    """Of bones of one length, S is that of one body; lengths that differ add how they do."""
    one = np.array([[1.0, 2.0, 0.5]])
    alone = find_edge_covariance(one)
    np.testing.assert_allclose(find_edge_covariance(one, np.tile(one, (9, 1))), alone)
    rng = np.random.default_rng(3)
    other = one * np.exp(0.1 * rng.normal(size=(4000, 3)))
    found = find_edge_covariance(one, other)
    np.testing.assert_allclose(found, alone + 0.01 * np.eye(3), atol=1e-3)
    other[7, 1] = 0.0
    np.testing.assert_allclose(find_edge_covariance(one, other)[1], alone[1], atol=1e-12)
