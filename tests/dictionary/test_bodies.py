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
from tests.points import centred, chain, edge_lengths, edge_vectors, flatten, resized

BONES = np.array([[0, 1], [1, 2], [1, 3]])


@pytest.fixture
def film(rng):
    """400 shapes that wander far from the origin, of different sizes."""
    steps = 0.1 * rng.standard_normal((400, 3, 4)).cumsum(axis=0)
    sizes = rng.uniform(1, 3, (400, 1, 1))
    start = rng.standard_normal((3, 4))
    return 50 + sizes * (start + steps)


def usual_size(film):
    return np.median(normalise(film).scale)


@pytest.mark.parametrize("sequences", ["a" * 400, "a" * 130 + "b" * 170 + "a" * 100])
def test_acceleration_is_the_root_mean_square_of_second_differences(film, sequences):
    y = centred(film) / usual_size(film)
    runs = zip(sequences, sequences[1:], sequences[2:], strict=False)
    inside = [t for t, run in enumerate(runs, 1) if len(set(run)) == 1]
    squares = [(y[t - 1] - 2 * y[t] + y[t + 1]) ** 2 for t in inside]
    expected = np.sqrt(np.mean(squares, axis=(0, 1)))

    found = find_acceleration(film, list(sequences))

    assert_allclose(found, expected, rtol=1e-10)


def test_shapes_without_a_sequence_show_no_motion(film):
    unnamed = ["a"] * 200 + [""] * 200
    found = find_acceleration(film, unnamed)
    of_named = find_acceleration(film[:200], ["a"] * 200)
    size = usual_size(film)
    size_of_named = usual_size(film[:200])
    assert_allclose(found * size, of_named * size_of_named, rtol=1e-10)


class TestMissingFrames:
    """Of a motion of which frames are missing, acceleration is that of the whole."""

    FRAMES = 4000
    FRAME_RATE = 24.0

    @pytest.fixture
    def motion(self, rng):
        """A film whose velocity drifts slowly."""
        steps = rng.standard_normal((self.FRAMES, 3, 4))
        velocity = np.cumsum(steps, axis=0) / 5000
        start = rng.standard_normal((3, 4))
        return start + np.cumsum(velocity, axis=0) / 50

    @pytest.fixture
    def names(self):
        """The sequence of each frame: one for all."""
        return np.array(["a"] * self.FRAMES)

    @pytest.fixture
    def left(self, rng, motion):
        """Frames that are left: neither those within a long gap nor three in ten."""
        frames = np.flatnonzero(rng.random(self.FRAMES) > 0.3)
        return frames[(frames < 1000) | (frames > 2000)]

    def test_missing_frames_are_no_acceleration(self, motion, names, left):
        whole = find_acceleration(motion, names)
        found = find_acceleration(motion[left], names[left], left, self.FRAME_RATE)
        assert_allclose(found, whole, rtol=0.15)

    def test_without_numbers_of_frames_gaps_look_like_acceleration(
        self, motion, names, left
    ):
        known = find_acceleration(motion[left], names[left], left, self.FRAME_RATE)
        unknown = find_acceleration(motion[left], names[left])
        assert (unknown > 1.3 * known).all()

    def test_the_number_of_the_first_frame_does_not_matter(self, motion, names):
        whole = find_acceleration(motion, names)
        frames = np.arange(self.FRAMES) + 7
        found = find_acceleration(motion, names, frames, self.FRAME_RATE)
        assert_array_equal(found, whole)

    def test_frames_that_repeat_are_those_of_no_motion(self, motion, names):
        frames = np.arange(self.FRAMES) // 2
        assert find_acceleration(motion, names, frames, self.FRAME_RATE) is None


def test_give_is_the_deviation_of_lengths_within_each_sequence(film):
    sequences = np.array(list("ab" * 200))
    lengths = edge_lengths(film, BONES)
    variances = [lengths[sequences == name].var(axis=0) for name in "ab"]
    expected = np.sqrt(np.mean(variances, axis=0)) / usual_size(film)

    found = find_bone_tolerance(film, BONES, sequences)

    assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.parametrize("names", [["a", "b"], ["a", "b", "b"]])
def test_mean_lengths_are_those_of_each_sequence_however_short(film, names):
    short = film[: len(names)]

    lengths, mean, number = find_lengths(short, BONES, names)

    sequence_of_shape = np.array(names)
    expected = [lengths[sequence_of_shape == name].mean(axis=0) for name in "ab"]
    assert_allclose(mean, expected)
    assert number.tolist() == ["ab".index(name) for name in names]


def test_many_bodies_say_how_bodies_differ(rng):
    true = np.array([[0.8, 0.6, 0], [0.6, 0.8, 0], [0, 0, 0.4]])
    log_lengths = rng.multivariate_normal(np.log([0.3, 0.4, 0.5]), true, 500)
    found = find_edge_covariance(np.exp(log_lengths))
    assert_allclose(found, true, atol=0.1)


def random_bodies(rng, count, edges):
    """Draw lengths of edges that differ by a tenth."""
    return np.exp(0.1 * rng.standard_normal((count, edges)))


def test_how_bodies_differ_has_no_unit(rng):
    bodies = random_bodies(rng, 20, 3)
    found = find_edge_covariance(7 * bodies)
    assert_allclose(found, find_edge_covariance(bodies))


def test_sequences_of_one_body_count_once(rng):
    bodies = random_bodies(rng, 4, 6)
    body_of_sequence = [0, 0, 1, 0, 2, 3, 3]
    first_of_body = [0, 2, 4, 5]
    errors = np.exp(0.005 * rng.standard_normal((7, 6)))
    sequences = bodies[body_of_sequence] * errors
    sequences[first_of_body] = bodies

    found = find_edge_covariance(sequences)

    assert_allclose(found, find_edge_covariance(bodies))


def test_an_edge_without_length_differs_by_the_usual_spread(rng):
    bodies = random_bodies(rng, 5, 3)
    bodies[2, 1] = 0

    found = find_edge_covariance(bodies)

    assert np.isfinite(found).all()
    assert found[1, 0] == 0
    assert found[1, 2] == 0


class TestShapesOfUnknownBodies:
    """Shapes of which nobody knows whose they are count as one body.

    Where their bones differ in length, the bodies differ by as much more.
    """

    BODY = np.array([[1.0, 2.0, 0.5]])

    @pytest.fixture
    def alone(self):
        return find_edge_covariance(self.BODY)

    @pytest.fixture
    def different(self):
        """Lengths that differ by a tenth from shape to shape."""
        rng = np.random.default_rng(3)
        return self.BODY * np.exp(0.1 * rng.normal(size=(4000, 3)))

    def test_shapes_that_are_alike_add_nothing(self, alone):
        alike = np.tile(self.BODY, (9, 1))
        found = find_edge_covariance(self.BODY, alike)
        assert_allclose(found, alone)

    def test_lengths_that_differ_add_their_covariance(self, alone, different):
        found = find_edge_covariance(self.BODY, different)
        assert_allclose(found, alone + 0.01 * np.eye(3), atol=1e-3)

    def test_an_edge_without_length_adds_nothing(self, alone, different):
        different[7, 1] = 0.0
        found = find_edge_covariance(self.BODY, different)
        assert_allclose(found[1], alone[1], atol=1e-12)


CHAIN = chain(4)


def mean_edge_lengths(shapes):
    one_body = ("",) * len(shapes)
    lengths, _, _ = find_lengths(shapes, CHAIN, one_body)
    return lengths.mean(axis=0)


@pytest.fixture
def shapes(rng):
    return rng.normal(size=(6, 3, 4))


@pytest.fixture
def dictionary(shapes) -> Dictionary:
    """The shapes as atoms, in centimetres."""
    normalised = normalise(shapes)
    return Dictionary(
        atoms=normalised.points,
        landmark_names=tuple("abcd"),
        mean_shape=normalised.points[0],
        edges=CHAIN,
        edge_length=mean_edge_lengths(shapes),
        atom_scale=normalised.scale,
        unit="cm",
    )


def test_edges_are_as_long_as_they_were(shapes, dictionary):
    larger = 17 * shapes

    factor = metres_per_unit(larger, dictionary)

    in_metres = resized(larger, factor)
    total = edge_lengths(shapes, CHAIN).sum(axis=1).mean()
    assert mean_edge_lengths(in_metres).sum() == pytest.approx(total / 100)


def test_without_edges_the_size_is_that_of_the_training_shapes(shapes, dictionary):
    without_edges = replace(dictionary, edges=None, edge_length=None)
    larger = 5 * shapes

    factor = metres_per_unit(larger, without_edges)

    in_metres = resized(larger, factor)
    expected = dictionary.atom_scale.mean() / 100
    assert_allclose(normalise(in_metres).scale, expected)


def test_a_dictionary_without_unit_gives_no_size(shapes, dictionary):
    without_unit = replace(dictionary, unit="unknown")
    assert metres_per_unit(shapes, without_unit) is None


def test_a_dictionary_without_lengths_gives_no_size(shapes, dictionary):
    without_lengths = replace(dictionary, edge_length=None, atom_scale=None)
    assert metres_per_unit(shapes, without_lengths) is None


@pytest.mark.parametrize("coordinate", [np.nan, 0.0])
def test_shapes_without_extent_have_no_size(coordinate, dictionary):
    lost = np.full((1, 3, 4), coordinate)
    assert np.isnan(metres_per_unit(lost, dictionary)).all()


TREE = np.array([[0, 1], [1, 2], [2, 3], [0, 4], [4, 5], [5, 6], [0, 7]])
"""A trunk at 0, two limbs 1-2-3 and 4-5-6, and a head at 7."""

WITHOUT_HEAD = TREE[:-1]
WITH_LOOP = np.vstack([WITHOUT_HEAD, [[1, 4]]])


@pytest.mark.parametrize("edges", [WITHOUT_HEAD, WITH_LOOP])
def test_bones_that_are_no_tree_are_refused(edges):
    with pytest.raises(ValueError, match=r"tree|apart"):
        find_bone_tree(edges, 8)


class TestStretching:
    """Bones are stretched at random, those of partners by the same factor."""

    PARTNERS = np.array([0, 4, 5, 6, 1, 2, 3, 7])

    @pytest.fixture
    def shapes(self):
        return np.random.default_rng(0).normal(size=(50, 3, 8))

    @pytest.fixture
    def stretched(self, shapes):
        return vary(
            shapes,
            find_bone_tree(TREE, 8),
            copies=1,
            bone_scale=0.2,
            exchange=0.0,
            partners=self.PARTNERS,
        )

    def test_factors_are_alike_for_partners_and_as_various_as_asked(
        self, shapes, stretched
    ):
        factor = edge_lengths(stretched, TREE) / edge_lengths(shapes, TREE)
        assert factor[:, :3] == pytest.approx(factor[:, 3:6])
        assert np.log(factor).std() == pytest.approx(0.2, abs=0.04)

    def test_directions_are_kept(self, shapes, stretched):
        before = edge_vectors(shapes, TREE)
        after = edge_vectors(stretched, TREE)
        dot = (before * after).sum(axis=1)
        lengths = edge_lengths(shapes, TREE) * edge_lengths(stretched, TREE)
        assert dot / lengths == pytest.approx(1.0)


class TestExchange:
    """Limbs are exchanged whole between shapes."""

    TRUNK = np.array([0, 1, 4, 7])
    LIMB = np.array([[1, 2], [1, 3]])
    """From where a limb leaves the trunk to its landmarks."""

    @pytest.fixture
    def shapes(self):
        return np.random.default_rng(0).normal(size=(30, 3, 8))

    @pytest.fixture
    def exchanged(self, shapes):
        tree = find_bone_tree(TREE, 8)
        return vary(shapes, tree, copies=1, bone_scale=0.0, exchange=1.0)

    def test_the_trunk_stays(self, shapes, exchanged):
        before = shapes[:, :, self.TRUNK]
        assert exchanged[:, :, self.TRUNK] == pytest.approx(before)

    def test_each_limb_is_that_of_another_shape(self, shapes, exchanged):
        before = flatten(edge_vectors(shapes, self.LIMB))
        after = flatten(edge_vectors(exchanged, self.LIMB))
        distance = np.abs(after[:, None] - before).max(axis=2)
        origin = distance.argmin(axis=1)
        assert distance.min(axis=1) == pytest.approx(0.0, abs=1e-12)
        assert sorted(origin.tolist()) == list(range(30))
