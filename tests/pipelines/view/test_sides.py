"""Sides of landmarks, by their names."""

import numpy as np
import pytest

from shapefit.io.skeletons import installed_skeletons
from shapefit.pipelines.view.scene import find_sides
from tests.io.files import mirror_pairs


def test_names_of_other_files():
    sides = {
        "nose": 0,
        "L_ear": 1,
        "R_ear": 2,
        "HipLeft": 1,
        "HipRight": 2,
        "left": 0,
        "lone": 0,
        "left_toe": 0,
        "HEAD": 0,
    }
    assert find_sides([*sides]) == [*sides.values()]


def test_letters_at_the_end_are_sides_where_there_are_both():
    sides = {
        "HeadL": 0,
        "SpineL": 0,
        "HipL": 1,
        "KneeL": 1,
        "HipR": 2,
        "KneeR": 2,
        "XL": 0,
    }
    assert find_sides([*sides]) == [*sides.values()]


@pytest.mark.parametrize("name", installed_skeletons())
def test_the_pairs_of_detectors(name):
    skeleton = installed_skeletons()[name]
    sides = np.array(find_sides(skeleton.landmark_names))
    right, left = np.array(mirror_pairs(skeleton)).T
    assert (sides[right] == 2).all()
    assert (sides[left] == 1).all()
    assert np.count_nonzero(sides) == 2 * len(left)
