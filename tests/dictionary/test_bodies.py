"""Bodies: how they move, their bones, their size, and other bodies made of them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.bodies import (
    find_acceleration,
    find_bone_tolerance,
    find_bone_tree,
    find_edge_covariance,
    find_lengths,
    metres_per_unit,
    vary,
)
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise

BONES = np.array([[0, 1], [1, 2], [1, 3]])


@pytest.fixture
def film(rng):
    """400 shapes that wander far from the origin, of different sizes."""
    steps = 0.1 * rng.standard_normal((400, 3, 4)).cumsum(axis=0)
    return 50 + rng.uniform(1, 3, (400, 1, 1)) * (rng.standard_normal((3, 4)) + steps)


@pytest.mark.parametrize("sequences", ["a" * 400, "a" * 130 + "b" * 170 + "a" * 100])
def test_acceleration_is_the_root_mean_square_of_second_differences(film, sequences):
    y = (film - film.mean(axis=2, keepdims=True)) / np.median(normalise(film).scale)
    runs = zip(sequences, sequences[1:], sequences[2:], strict=False)
    inside = [t for t, run in enumerate(runs, 1) if len(set(run)) == 1]
    squares = [(y[t - 1] - 2 * y[t] + y[t + 1]) ** 2 for t in inside]
    expected = np.sqrt(np.mean(squares, axis=(0, 1)))
    assert_allclose(find_acceleration(film, list(sequences)), expected, rtol=1e-10)


def test_missing_frames_are_no_acceleration(rng):
    """Of a motion of which frames are missing it is that of the whole, nearly."""
    velocity = np.cumsum(rng.standard_normal((4000, 3, 4)), axis=0) / 5000
    film = rng.standard_normal((3, 4)) + np.cumsum(velocity, axis=0) / 50
    names = np.array(["a"] * 4000)
    whole = find_acceleration(film, names)
    rows = np.flatnonzero(rng.random(4000) > 0.3)
    rows = rows[(rows < 1000) | (rows > 2000)]
    left = find_acceleration(film[rows], names[rows], rows, 24.0)
    assert_allclose(left, whole, rtol=0.15)
    assert (find_acceleration(film[rows], names[rows]) > 1.3 * left).all()
    alike = find_acceleration(film, names, np.arange(4000) + 7, 24.0)
    assert_array_equal(alike, whole)
    twice = find_acceleration(film, names, np.arange(4000) // 2, 24.0)
    assert twice is None  # no frames of a motion


def test_give_is_the_deviation_of_lengths_within_each_sequence(film):
    sequences = np.array(list("ab" * 200))
    lengths = np.linalg.norm(film[:, :, BONES[:, 0]] - film[:, :, BONES[:, 1]], axis=1)
    variance = [lengths[sequences == name].var(axis=0) for name in "ab"]
    expected = np.sqrt(np.mean(variance, axis=0)) / np.median(normalise(film).scale)
    assert_allclose(find_bone_tolerance(film, BONES, sequences), expected, rtol=1e-10)


@pytest.mark.parametrize("names", [["a", "b"], ["a", "b", "b"]])
def test_mean_lengths_are_those_of_each_sequence_however_short(film, names):
    lengths, mean, number = find_lengths(film[: len(names)], BONES, names)
    expected = [lengths[np.array(names) == name].mean(axis=0) for name in "ab"]
    assert_allclose(mean, expected)
    assert number.tolist() == ["ab".index(name) for name in names]


def test_many_bodies_say_how_bodies_differ(rng):
    true = np.array([[0.8, 0.6, 0], [0.6, 0.8, 0], [0, 0, 0.4]])
    bodies = np.exp(rng.multivariate_normal(np.log([0.3, 0.4, 0.5]), true, 500))
    assert_allclose(find_edge_covariance(bodies), true, atol=0.1)
    assert_allclose(find_edge_covariance(7 * bodies), find_edge_covariance(bodies))


def test_sequences_of_one_body_count_once(rng):
    bodies = np.exp(0.1 * rng.standard_normal((4, 6)))
    again = bodies[[0, 0, 1, 0, 2, 3, 3]] * np.exp(0.005 * rng.standard_normal((7, 6)))
    again[[0, 2, 4, 5]] = bodies
    assert_allclose(find_edge_covariance(again), find_edge_covariance(bodies))


def test_an_edge_without_length_differs_by_the_usual_spread(rng):
    bodies = np.exp(0.1 * rng.standard_normal((5, 3)))
    bodies[2, 1] = 0
    found = find_edge_covariance(bodies)
    assert np.isfinite(found).all()
    assert found[1, 0] == found[1, 2] == 0


def test_shapes_of_nobody_knows_whom_are_one_body_and_as_much_surer_as_they_are_alike():
    """Of bones of one length, S is that of one body; lengths that differ add how they
    do.
    """
    one = np.array([[1.0, 2.0, 0.5]])
    alone = find_edge_covariance(one)
    assert_allclose(find_edge_covariance(one, np.tile(one, (9, 1))), alone)
    rng = np.random.default_rng(3)
    other = one * np.exp(0.1 * rng.normal(size=(4000, 3)))
    found = find_edge_covariance(one, other)
    assert_allclose(found, alone + 0.01 * np.eye(3), atol=1e-3)
    other[7, 1] = 0.0
    assert_allclose(find_edge_covariance(one, other)[1], alone[1], atol=1e-12)


CHAIN = np.array([[0, 1], [1, 2], [2, 3]])


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
        edges=CHAIN,
        edge_length=find_lengths(shapes, CHAIN, ("",) * len(shapes))[0].mean(axis=0),
        atom_scale=normalised.scale,
        unit="cm",
    )


def test_edges_are_as_long_as_they_were(shapes, dictionary):
    factor = metres_per_unit(17 * shapes, dictionary)
    found = find_lengths(
        factor[:, None, None] * 17 * shapes, CHAIN, ("",) * len(shapes)
    )[0].mean(axis=0)
    total = np.linalg.norm(np.diff(shapes, axis=2), axis=1).sum(axis=1).mean()
    assert found.sum() == pytest.approx(total / 100)


def test_without_edges_the_size_is_that_of_the_training_shapes(shapes, dictionary):
    factor = metres_per_unit(
        5 * shapes, replace(dictionary, edges=None, edge_length=None)
    )
    size = normalise(factor[:, None, None] * 5 * shapes).scale
    assert_allclose(size, dictionary.atom_scale.mean() / 100)


def test_what_has_no_size(shapes, dictionary):
    assert metres_per_unit(shapes, replace(dictionary, unit="unknown")) is None
    nothing = replace(dictionary, edge_length=None, atom_scale=None)
    assert metres_per_unit(shapes, nothing) is None
    lost = np.concatenate([np.full((1, 3, 4), np.nan), np.zeros((1, 3, 4))])
    assert np.isnan(metres_per_unit(lost, dictionary)).all()


TREE = np.array([[0, 1], [1, 2], [2, 3], [0, 4], [4, 5], [5, 6], [0, 7]])
"""A trunk at 0, two limbs 1-2-3 and 4-5-6, and a head at 7."""


def lengths(shapes):
    return np.linalg.norm(shapes[:, :, TREE[:, 0]] - shapes[:, :, TREE[:, 1]], axis=1)


@pytest.mark.parametrize("edges", [TREE[:-1], np.vstack([TREE[:-1], [[1, 4]]])])
def test_bones_that_are_no_tree_are_refused(edges):
    with pytest.raises(ValueError, match=r"tree|apart"):
        find_bone_tree(edges, 8)


def test_stretching_keeps_directions_and_partners_alike():
    shapes = np.random.default_rng(0).normal(size=(50, 3, 8))
    partners = np.array([0, 4, 5, 6, 1, 2, 3, 7])
    varied = vary(
        shapes,
        find_bone_tree(TREE, 8),
        copies=1,
        bone_scale=0.2,
        exchange=0.0,
        partners=partners,
    )
    factor = lengths(varied) / lengths(shapes)
    assert factor[:, :3] == pytest.approx(factor[:, 3:6])
    assert np.log(factor).std() == pytest.approx(0.2, abs=0.04)
    bones = [s[:, :, TREE[:, 1]] - s[:, :, TREE[:, 0]] for s in (shapes, varied)]
    cosine = (bones[0] * bones[1]).sum(axis=1) / (lengths(shapes) * lengths(varied))
    assert cosine == pytest.approx(1.0)


def test_exchanged_limbs_come_from_other_shapes_whole():
    shapes = np.random.default_rng(0).normal(size=(30, 3, 8))
    varied = vary(
        shapes, find_bone_tree(TREE, 8), copies=1, bone_scale=0.0, exchange=1.0
    )
    assert varied[:, :, [0, 1, 4, 7]] == pytest.approx(shapes[:, :, [0, 1, 4, 7]])
    limb = (varied[:, :, [2, 3]] - varied[:, :, [1, 1]]).reshape(30, -1)
    given = (shapes[:, :, [2, 3]] - shapes[:, :, [1, 1]]).reshape(30, -1)
    nearest = np.abs(limb[:, None] - given).max(axis=2)
    assert nearest.min(axis=1) == pytest.approx(0.0, abs=1e-12)
    assert len(set(nearest.argmin(axis=1).tolist())) == 30
