"""What dictionaries know of motion and of how rigid bones are."""

import numpy as np
import pytest

from shapefit.dictionary.bodies import find_acceleration, find_bone_tolerance
from shapefit.geometry.normalisation import normalise

EDGES = np.array([[0, 1], [1, 2], [1, 3]])


@pytest.fixture
def shapes(rng):
    """400 shapes that wander far from the origin, of different sizes."""
    steps = 0.1 * rng.standard_normal((400, 3, 4)).cumsum(axis=0)
    return 50 + rng.uniform(1, 3, (400, 1, 1)) * (rng.standard_normal((3, 4)) + steps)


@pytest.mark.parametrize("sequences", ["a" * 400, "a" * 130 + "b" * 170 + "a" * 100])
def test_acceleration_is_the_root_mean_square_of_second_differences(shapes, sequences):
    y = (shapes - shapes.mean(axis=2, keepdims=True)) / np.median(normalise(shapes).scale)
    runs = zip(sequences, sequences[1:], sequences[2:], strict=False)
    inside = [t for t, run in enumerate(runs, 1) if len(set(run)) == 1]
    squares = [(y[t - 1] - 2 * y[t] + y[t + 1]) ** 2 for t in inside]
    expected = np.sqrt(np.mean(squares, axis=(0, 1)))
    np.testing.assert_allclose(find_acceleration(shapes, list(sequences)), expected, rtol=1e-10)


def test_too_few_differences_are_none(shapes):
    assert find_acceleration(shapes[:101], ["a"] * 101) is None
    assert find_acceleration(shapes[:102], ["a"] * 102) is not None


def test_give_is_the_deviation_of_lengths_within_each_sequence(shapes):
    sequences = np.array(list("ab" * 200))
    lengths = np.linalg.norm(shapes[:, :, EDGES[:, 0]] - shapes[:, :, EDGES[:, 1]], axis=1)
    variance = [lengths[sequences == name].var(axis=0) for name in "ab"]
    expected = np.sqrt(np.mean(variance, axis=0)) / np.median(normalise(shapes).scale)
    np.testing.assert_allclose(find_bone_tolerance(shapes, EDGES, sequences), expected, rtol=1e-10)
