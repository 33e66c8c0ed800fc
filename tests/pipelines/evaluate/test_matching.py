"""Which truth, which sequence and which individual belong to an image."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.evaluation import metrics
from shapefit.records import Fit, Shapes
from shapefit.records.columns import in_columns
from tests.columns import put

from .conftest import ITEMS, NAMES, N
from .measured import FILE, SHAPES, measured

SHARED = [4, 2, 0, 1]
"""Landmarks of the results that the next truth has, in its order."""


@pytest.fixture
def tailed_truth(truth):
    """The truth in another order, which lacks the foot and has a tail instead."""
    tail = np.full((N, 1, 3), 1e6)
    shapes = np.concatenate([tail, truth.shapes[:, SHARED]], axis=1)
    names = ("tail", *(NAMES[i] for i in SHARED))
    record = Shapes(shapes, landmark_names=names, items=ITEMS, unit="m")
    return record.take([3, 1, 5, 0, 4, 2, 6])


def test_items_and_landmarks_are_matched_by_name(results, truth, tailed_truth):
    found = measured(results, tailed_truth)
    expected = metrics.similarity_error(
        results.as_columns()[:, :, SHARED], truth.as_columns()[:, :, SHARED]
    )
    assert_allclose(found.errors["similarity", "m"], expected)
    assert found.warnings == (
        f"{FILE}: landmarks in the results alone are left out: foot",
        f"{FILE}: landmarks in the truth alone are left out: tail",
    )


def test_the_reprojection_error_keeps_all_landmarks(results, errors, tailed_truth):
    """It needs no truth."""
    found = measured(results, tailed_truth).errors["reprojection", "px"]
    assert_array_equal(found, errors["reprojection"])


def test_another_dataset_can_name_the_truth(results, truth):
    models = np.array([f"item{i}" for i in (0, 0, 2, 2, 0, 2, 9)], dtype=object)
    shapes = truth.shapes[[0, 0, 2, 2, 0, 2, 0]]
    named = put(results, {"true_model": models}).replaced(shapes=shapes)
    found = measured(named, truth.take([2, 0]), "true_model", SHAPES)
    of_known_models = found.errors["similarity", "m"][:6]
    assert_allclose(of_known_models, 0, atol=1e-12)
    assert found.items == ITEMS
    assert found.failures == {"item6": "it has no true shape"}


def test_sequences_are_those_of_the_results(results, truth):
    assert measured(results, truth).sequences == truth.sequences


def test_sequences_are_else_those_of_the_truth(results, truth):
    plain = results.replaced(sequences=None)
    found = measured(plain, truth.take([0, 1, 2, 3, 4, 5]))
    assert found.sequences == (*truth.sequences[:6], "")


def test_without_sequences_all_images_are_one(results, truth):
    plain = results.replaced(sequences=None)
    found = measured(plain, truth.replaced(sequences=None))
    assert found.sequences == ("all",) * N


def test_results_of_other_landmarks_are_refused(results, truth):
    names = ("head", "left", "x", "y", "z")
    with pytest.raises(InputError, match=r"has 2 of its landmarks.*at least 3"):
        measured(results.replaced(landmark_names=names), truth)


def test_a_truth_of_other_items_is_refused(results, truth):
    optimal = results.replaced(status=np.array(["optimal"] * N))
    others = truth.replaced(items=tuple("abcdefg"))
    fault = r"none of its 7 images is in the truth.*set `match`"
    with pytest.raises(InputError, match=fault):
        measured(optimal, others)


def walk_of(shapes, **sequences):
    """Fields of frames of shapes (n, p, 3) in sequences (name -> its number of
    frames).
    """
    names = []
    frames = []
    for name, count in sequences.items():
        names += [name] * count
        frames += range(count)
    items = tuple(f"{name}/{i}" for name, i in zip(names, frames, strict=True))
    return {
        "landmark_names": NAMES,
        "items": items,
        "sequences": tuple(names),
        "unit": "m",
        "frames": np.array(frames),
        "shapes": shapes,
    }


@pytest.fixture
def people(truth, rng):
    """Who -> shapes: a man who is near the truth, and a bystander."""
    man = truth.shapes + 0.02 * rng.standard_normal(truth.shapes.shape)
    bystander = rng.standard_normal(truth.shapes.shape)
    return {"man": man, "bystander": bystander}


ORDERS = [("man", "bystander"), ("bystander", "man")]


def result_of(people, order):
    shapes = np.concatenate([people[name] for name in order])
    return Fit(**walk_of(shapes, **dict.fromkeys(order, N)))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("match", ["frame", "item"])
def test_one_individual_is_measured_against_one_truth(truth, people, order, match):
    """By frame two people match one truth; the one whose shapes are farther from it is
    left out.
    """
    subject = Shapes(**walk_of(truth.shapes, subject=N))
    found = measured(result_of(people, order), subject, match, SHAPES)
    expected = metrics.similarity_error(in_columns(people["man"]), truth.as_columns())
    warning = "bystander left out: another individual fits the same true shapes better"
    assert set(found.sequences) == {"man"}
    assert found.failures == {}
    assert_allclose(found.errors["similarity", "m"], expected)
    assert warning in found.warnings[0]


@pytest.mark.parametrize("order", ORDERS)
def test_an_individual_who_is_left_out_lacks_no_truth(truth, people, order):
    subject = Shapes(**walk_of(truth.shapes, subject=N)).take(slice(1, None))
    found = measured(result_of(people, order), subject, "frame", SHAPES)
    assert set(found.sequences) == {"man"}
    assert len(found.failures) == 1


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("match", ["frame", "item"])
def test_two_people_of_the_truth_by_the_same_names_are_both_measured(
    truth, people, order, match
):
    twice = np.concatenate([truth.shapes] * 2)
    both = Shapes(**walk_of(twice, **dict.fromkeys(order, N)))
    found = measured(result_of(people, order), both, match, SHAPES)
    assert len(found.items) == 2 * N
