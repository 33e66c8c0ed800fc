"""What misses a claim, and which image of many it is."""

import numpy as np
import pytest

from shapefit.verification.check import Tally, check


def test_the_worst_of_an_image_counts():
    off = np.array([[1.0, 3.0], [1.0, 2.0], [np.nan, 0.0]])
    assert check("c", off, 2.0).missed.tolist() == [True, False, True]
    assert check("c", off, np.array([3.0, 1.5, 9.0])[:, None]).missed.tolist() == [
        False, True, True,
    ]  # fmt: skip
    each = np.array([[0.0, 3.0], [1.0, 1.0], [9.0, 9.0]])
    found = check("c", off, each)
    assert found.missed.tolist() == [True, True, True]
    assert found.off[:2].tolist() == [1.0, 2.0]
    assert found.allowed[:2].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_an_unknown_allowance_allows_nothing(unknown):
    assert check("c", np.zeros(1), np.full(1, unknown)).missed.all()
    assert check("c", np.full(1, np.inf), np.full(1, unknown)).missed.all()


def test_only_images_that_make_a_claim_can_miss_it():
    found = check("c", np.ones(2), 0.0, np.array([True, False])).of_images(np.array([3, 1]), 5)
    assert found.missed.tolist() == [False, False, False, True, False]
    assert found.made.tolist() == [False, False, False, True, False]


def test_no_images_make_no_claims():
    assert check("c", np.zeros((0, 4)), 0.0).missed.tolist() == []


def test_an_image_counts_once_for_checks_of_one_claim():
    tally = Tally()
    twice = [check("c", np.ones(2), 0.5), check("c", np.array([1.0, 0.0]), 0.25)]
    tally.add(twice)
    tally.add([check("d", np.zeros(1), 0.0)])
    assert tally.lines()[2:] == ["| c | 2 | 2 | 0.5 |", "| d | 1 | 0 | none |"]
