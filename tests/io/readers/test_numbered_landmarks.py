"""Landmarks that have numbers in the place of names."""

import numpy as np
import pytest

import shapefit
from shapefit.errors import InputError

from .made import read_images as read


@pytest.fixture
def array_of_17(tmp_path, rng):
    path = tmp_path / "a.npy"
    np.save(path, rng.uniform(1, 600, (3, 17, 2)))
    return path


def test_which_skeleton_an_array_has_must_be_said(array_of_17):
    fault = "17 landmarks without names, as coco_17 and h36m_17 have"
    with pytest.raises(InputError, match=fault):
        read(array_of_17)


@pytest.mark.parametrize(
    ("keypoints", "first"), [("coco_17", "nose"), ("numbered", "0")]
)
def test_the_skeleton_that_is_said_names_landmarks(array_of_17, keypoints, first):
    images, _ = read(array_of_17, keypoints=keypoints)
    assert images.landmark_names[0] == first


@pytest.mark.parametrize("numbers", [("5", "6"), ("0", "1"), ("1", "2"), ("01", "02")])
@pytest.mark.parametrize("keypoints", [None, "numbered"])
def test_numbers_of_landmarks_are_names(table, numbers, keypoints):
    one, two = numbers
    path = table(f"frame,x{one},y{one},x{two},y{two}\n0,10,20,30,40\n")
    images, _ = read(path, keypoints=keypoints)
    assert images.landmark_names == numbers


@pytest.fixture
def write_numbered(tmp_path):
    """Write an image whose landmarks have these names, as HDF5 or as a table."""

    def write(name, names):
        path = tmp_path / name
        points = np.arange(2.0 * len(names)).reshape(1, -1, 2) + 100
        if path.suffix == ".h5":
            landmarks = shapefit.Landmarks(points, landmark_names=names)
            shapefit.write_landmarks(path, landmarks)
            return path
        rows = ["item,landmark,x,y"]
        for landmark, (x, y) in zip(names, points[0], strict=True):
            rows.append(f"0,{landmark},{x},{y}")
        delimiter = "\t" if path.suffix == ".tsv" else ","
        path.write_text("\n".join(rows).replace(",", delimiter), encoding="utf-8")
        return path

    return write


SUFFIXED = ["t.csv", "t.tsv", "t.h5"]


NUMBERS = [
    (range(17), "nose", ""),
    (range(1, 18), "nose", "1 to 17 counted from 1: 1 is nose of coco_17"),
    (range(1, 12), "left_eye", "1 to 11 counted from 0: 1 is left_eye of coco_17"),
    (range(2, 18), "left_eye", "2 to 17 counted from 1: 2 is left_eye of coco_17"),
]
"""Numbers of landmarks, what the first is, and what is said of it."""


@pytest.mark.parametrize("name", SUFFIXED)
@pytest.mark.parametrize(("numbers", "first", "told"), NUMBERS)
def test_numbers_of_a_skeleton(write_numbered, name, numbers, first, told):
    """What is counted from 0 and from 1 is said wherever 0 is not among the numbers."""
    path = write_numbered(name, tuple(map(str, numbers)))
    images, notes = read(path, keypoints="coco_17")
    assert images.landmark_names[0] == first
    assert len(notes) == bool(told)
    assert told in "".join(notes)


@pytest.mark.parametrize("name", SUFFIXED)
@pytest.mark.parametrize("numbers", [numbers for numbers, *_ in NUMBERS])
def test_without_a_skeleton_numbers_stay(write_numbered, name, numbers):
    names = tuple(map(str, numbers))
    images, _ = read(write_numbered(name, names))
    assert images.landmark_names == names


def test_numbers_that_a_skeleton_has_not(table):
    path = table("item,landmark,x,y\n0,0,10,20\n0,17,30,40\n")
    with pytest.raises(InputError, match=r"0 to 17; give another .* coco_17 has 17"):
        read(path, keypoints="coco_17")
