"""Training shapes that are doubtful: both sides, flat, landmarks in one place."""

import numpy as np
import pytest

import shapefit
from shapefit.errors import InputError
from shapefit.pipelines.learn_dict.doubts import (
    check_not_flat,
    find_mirrored,
    warn_of_shapes,
)
from shapefit.records import Shapes


@pytest.fixture
def shapes(rng) -> np.ndarray:
    """Shapes of one side, each turned in its own way."""
    turns = np.linalg.qr(rng.normal(size=(30, 3, 3)))[0]
    turns *= np.linalg.det(turns)[:, None, None]
    return turns @ (rng.normal(size=(3, 12)) + 0.3 * rng.normal(size=(30, 3, 12)))


def as_set(shapes: np.ndarray) -> Shapes:
    names = [f"p{number}" for number in range(shapes.shape[2])]
    return Shapes(
        shapes.swapaxes(1, 2),
        landmark_names=names,
        items=[f"t{row}" for row in range(len(shapes))],
    )


@pytest.mark.parametrize("rows", [slice(0, 15), slice(0, 30, 3), [4], [0, 29]])
@pytest.mark.parametrize("axis", [0, 2])
def test_shapes_of_the_other_side_are_found(shapes, rows, axis):
    shapes[rows, axis] *= -1
    mirrored = np.flatnonzero(find_mirrored(shapes))
    other = np.arange(30)[rows]
    assert mirrored.tolist() in (
        other.tolist(),
        np.setdiff1d(np.arange(30), other).tolist(),
    )
    assert len(mirrored) <= 15
    (warning,) = warn_of_shapes(as_set(shapes))
    assert warning.startswith(
        f"{len(mirrored)} of 30 shapes fit the others better when"
    )


def test_a_few_among_very_many_are_found(shapes):
    many = np.tile(shapes, (40, 1, 1))
    many[[17, 911]] *= -1
    assert np.flatnonzero(find_mirrored(many)).tolist() == [17, 911]


def test_shapes_of_one_side_are_not_warned_of(shapes, rng):
    assert warn_of_shapes(as_set(shapes)) == ()
    flat = shapes * [[1], [1], [0.05]]
    assert not find_mirrored(flat).any()
    assert not find_mirrored(rng.normal(size=(40, 3, 9))).any()


@pytest.mark.parametrize(
    "name", ["people_train", "people_test", "animal_train", "cars"]
)
def test_people_bend_both_ways(name):
    shapes = shapefit.read_shapes(f"sample_data/{name}.h5").as_columns()
    assert not find_mirrored(shapes.swapaxes(1, 2)).any()


def test_landmarks_in_one_place(shapes):
    shapes[..., 7] = shapes[..., 2]
    (warning,) = warn_of_shapes(as_set(shapes))
    assert "landmarks that are one point in all shapes: p2 and p7" in warning
    shapes[0, 0, 7] += 1e-9
    assert warn_of_shapes(as_set(shapes)) == ()


def test_shapes_in_two_units_are_told(shapes):
    shapes[3] *= 1000 / np.ptp(shapes[3])
    shapes[5] *= 1 / np.ptp(shapes[5])
    assert warn_of_shapes(as_set(shapes)) == ()
    (warning,) = warn_of_shapes(as_set(shapes).replaced(unit="m"))
    assert "'t3' is " in warning
    assert " times as large as 't5', and both state m" in warning


@pytest.mark.parametrize("z", [0.0, 7.5])
def test_shapes_without_depth_are_refused(shapes, z):
    shapes[:, 2] = z
    with pytest.raises(InputError, match=f"^a.trc: z is {z:g} everywhere, .* 2D landm"):
        check_not_flat(as_set(shapes), "a.trc")
    with pytest.raises(InputError, match=r"z is .* everywhere"):
        shapefit.learn(shapes.swapaxes(1, 2))
    shapes[0, 2, 0] += 1
    check_not_flat(as_set(shapes), "a.trc")


@pytest.mark.filterwarnings("error")
def test_what_is_left_out_in_python_is_said(shapes):
    shapes[3, :, 4] = np.nan
    with pytest.warns(UserWarning, match="shapes: 1 shape left out, in which"):
        made = shapefit.learn(shapes.swapaxes(1, 2), k=5)
    assert made.atoms.shape == (5, 12, 3)
