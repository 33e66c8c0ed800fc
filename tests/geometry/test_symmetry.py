import numpy as np
import pytest

from shapefit.geometry.procrustes import lateral_axis, mirror

# left hand, nose, right hand, tail: hands are partners, nose and tail their own
PARTNERS = [2, 1, 0, 3]


def test_mirror_negates_the_lateral_axis_and_exchanges_partners():
    shape = np.array([[1.0, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]])
    expected = np.array([[-3.0, -2, -1, -4], [7, 6, 5, 8], [11, 10, 9, 12]])
    np.testing.assert_array_equal(mirror(shape, PARTNERS), expected)


@pytest.mark.parametrize("lateral", [0, 1, 2])
def test_mirror_is_its_own_inverse_and_keeps_its_argument(rng, lateral):
    shapes = rng.normal(size=(2, 5, 3, 4))
    before = shapes.copy()
    once = mirror(shapes, PARTNERS, lateral)
    np.testing.assert_array_equal(shapes, before)
    assert not np.allclose(once, shapes)
    np.testing.assert_array_equal(mirror(once, PARTNERS, lateral), shapes)


@pytest.mark.parametrize(
    ("partners", "message"),
    [
        ([0, 1, 2], r"shape \(3,\), not \(4,\)"),
        ([1, 2, 0, 3], "not its own inverse"),
        ([0, 0, 2, 3], "not its own inverse"),
        ([0, 1, 2, 4], "not its own inverse"),
        ([0, 1, 2, -1], "not its own inverse"),
    ],
)
def test_an_index_that_pairs_nothing_is_refused(partners, message):
    with pytest.raises(ValueError, match=message):
        mirror(np.zeros((3, 4)), partners)


@pytest.mark.parametrize("lateral", [0, 1, 2])
def test_the_lateral_axis_is_the_one_along_which_partners_lie_apart(rng, lateral):
    offsets = 0.1 * rng.normal(size=(5, 3, 4))
    shape = rng.normal(size=(5, 3, 4))
    shapes = (shape + mirror(shape, PARTNERS, lateral)) / 2 + offsets
    assert lateral_axis(shapes, PARTNERS) == lateral
    assert lateral_axis(shapes[0] + 100, PARTNERS) == lateral
