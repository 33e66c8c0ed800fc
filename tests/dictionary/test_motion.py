"""What is known of motion, block by block, is what is known of all shapes at once."""

import numpy as np
import pytest

from shapefit.dictionary.motion import MotionSums, find_acceleration, find_give
from shapefit.geometry.normalisation import normalise

EDGES = np.array([[0, 1], [1, 2], [1, 3]])


@pytest.fixture
def shapes(rng):
    """400 shapes that wander far from the origin, of different sizes."""
    steps = 0.1 * rng.standard_normal((400, 3, 4)).cumsum(axis=0)
    return 50 + rng.uniform(1, 3, (400, 1, 1)) * (rng.standard_normal((3, 4)) + steps)


SEQUENCES = {
    "one": ("",) * 400,
    "several": ("a",) * 130 + ("b",) * 170 + ("a",) * 100,
    "in-turns": ("a", "a", "b") * 133 + ("c",),
}


@pytest.mark.parametrize("block", [1, 2, 7, 130, 400])
@pytest.mark.parametrize("sequences", SEQUENCES.values(), ids=SEQUENCES)
def test_sums_over_blocks_are_those_of_all(shapes, sequences, block):
    sums = MotionSums(EDGES)
    for start in range(0, 400, block):
        rows = slice(start, start + block)
        sums.add(shapes[rows], sequences[rows])
    unit = float(np.median(normalise(shapes).scale))
    expected = find_acceleration(shapes, sequences)
    if expected is None:
        assert sums.acceleration(unit) is None
    else:
        np.testing.assert_allclose(sums.acceleration(unit), expected, rtol=1e-10)
    expected = find_give(shapes, EDGES, sequences)
    np.testing.assert_allclose(sums.give(unit), expected, rtol=1e-10)


def test_rigid_bones_give_nothing(shapes):
    sums = MotionSums(EDGES)
    rigid = shapes[0] + np.linspace(0, 1000, 400)[:, None, None]
    for block in np.array_split(rigid, 9):
        sums.add(block, ("",) * len(block))
    assert sums.give(1.0).max() < 1e-10


def test_too_few_differences_are_none(shapes):
    sums = MotionSums(EDGES)
    sums.add(shapes[:101], ("a",) * 101)
    assert sums.acceleration(1.0) is None
    sums.add(shapes[101:102], ("a",))
    assert sums.acceleration(1.0) is not None
