"""`leave_one_out`: the model that an image shows has no part in its fit, whatever it
looks like.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import write_dictionary
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.pipelines.fitted import done, warnings

NAMES = tuple(f"point{j}" for j in range(10))
MODELS = ("golf", "jetta", "passat", "polo", "up")
ATOM_ITEMS = (*MODELS, "polo")
"""The models of the atoms: `polo` is there also as its mirror image."""

SHOWN = ("polo", "golf", "polo", "up", "jetta", "golf", "passat", "up", "polo")
"""The models of the images."""

ATTRIBUTES = (
    "shapes",
    "rotation",
    "translation",
    "scale",
    "objective",
    "iterations",
    "status",
)
COLUMNS = ("landmarks", "lambda", "residual")


def check_same(result, expected, rows=slice(None)):
    """Assert that rows of a result are another in all that a fit finds, but for axes of
    atoms.
    """
    for name in ATTRIBUTES:
        values = getattr(result, name)[rows]
        assert_array_equal(values, getattr(expected, name), err_msg=name)
    for name in COLUMNS:
        values = result.column(name)[rows]
        assert_array_equal(values, expected.column(name), err_msg=name)


@pytest.fixture
def models(rng):
    """Six exemplars in metres."""
    common = rng.standard_normal((3, 10))
    deviations = 0.4 * rng.standard_normal((6, 3, 10))
    atoms = normalise(common + deviations).points
    return Dictionary(
        atoms=atoms,
        landmark_names=NAMES,
        mean_shape=normalise(atoms.mean(axis=0)).points,
        atom_scale=rng.uniform(1, 2, 6),
        unit="m",
        atom_items=ATOM_ITEMS,
    )


@pytest.fixture
def images(rng, models):
    """Nine images of the models; one shows two landmarks only."""
    shapes = models.atoms[[ATOM_ITEMS.index(name) for name in SHOWN]]
    turned = random_rotations(9, rng) @ shapes
    landmarks = in_rows(20 * turned[:, :2] + 100)
    landmarks += 0.5 * rng.standard_normal(landmarks.shape)
    landmarks[5, 2:] = np.nan
    extras = {"true_model": np.array(SHOWN, dtype=object), "box": np.ones((9, 4))}
    return Landmarks(
        landmarks,
        landmark_names=NAMES,
        items=tuple(f"image{i}" for i in range(9)),
        unit="px",
        extras=extras,
    )


@pytest.fixture
def run(fit, tmp_path, models, images):
    """Return what fits images with a dictionary."""
    path = tmp_path / "dict.h5"

    def run(dictionary=models, views=images, leave_one_out="true_model", **keys):
        write_dictionary(path, dictionary)
        return fit(path, views, leave_one_out=leave_one_out, **keys)

    return run


THROUGH_ALL_STAGES = {
    "method": "convex+refine",
    "outliers": "ransac",
    "camera": {"focal": 900, "principal_point": [100, 100]},
}

STAGES = [
    {"method": "convex"},
    {"method": "alternate"},
    {"method": "mean-shape"},
    THROUGH_ALL_STAGES,
]


@pytest.mark.parametrize("keys", STAGES)
def test_each_image_has_the_dictionary_of_the_other_models(run, models, images, keys):
    """Whose mean is another one: no stage of the fit has seen the model."""
    result, outcomes = run(**keys)
    assert warnings(outcomes) == []
    for model in MODELS:
        rows = np.flatnonzero(np.array(SHOWN) == model)
        retained = np.array(ATOM_ITEMS) != model
        atoms = models.atoms[retained]
        mean = normalise(atoms.mean(axis=0)).points
        others = Dictionary(atoms, NAMES, mean)
        expected, _ = run(others, images.take(rows), leave_one_out=None, **keys)
        check_same(result, expected, rows)
        if expected.coefficients is not None:
            coefficients = result.coefficients[rows][:, retained]
            assert_array_equal(coefficients, expected.coefficients)


@pytest.fixture
def images_with_a_beetle(images):
    """The images, of which those of `up` show a model that the dictionary lacks."""
    shown = ["beetle" if name == "up" else name for name in SHOWN]
    return images.replaced(extras={"true_model": np.array(shown, dtype=object)})


def test_what_was_left_out_is_stored(run, images_with_a_beetle):
    result, _ = run(views=images_with_a_beetle, method="mean-shape")
    expected = ["" if name == "up" else name for name in SHOWN]
    assert list(result.column("omitted")) == expected


def test_batches_change_no_bit(run, images_with_a_beetle, monkeypatch):
    whole, _ = run(views=images_with_a_beetle, method="mean-shape")
    monkeypatch.setattr("shapefit.pipelines.fit.family.IMAGES_PER_BLOCK", 1)
    monkeypatch.setattr("shapefit.convex.problem.IMAGES_PER_BLOCK", 1)
    monkeypatch.setattr("shapefit.pipelines.fit.fit.IMAGES_PER_BATCH", 2)
    in_batches, outcomes = run(views=images_with_a_beetle, method="mean-shape")
    assert done(outcomes) == 9
    check_same(whole, in_batches)


@pytest.mark.parametrize("keys", STAGES)
def test_batches_of_several_blocks_change_no_bit(run, images, monkeypatch, keys):
    """Each image starts from another one of its model, if one of its block is."""
    rows = np.arange(150) % len(images)
    items = tuple(f"image{i}" for i in range(len(rows)))
    many = images.take(rows).replaced(items=items)
    whole, _ = run(views=many, **keys)
    monkeypatch.setattr("shapefit.pipelines.fit.fit.IMAGES_PER_BATCH", 64)
    in_batches, outcomes = run(views=many, **keys)
    assert done(outcomes) == 150
    check_same(whole, in_batches)


def test_a_model_that_the_dictionary_lacks_has_all_atoms(
    run, images, images_with_a_beetle
):
    rows = [3, 7]
    result, _ = run(views=images_with_a_beetle, method="mean-shape")
    expected, _ = run(views=images.take(rows), leave_one_out=None, method="mean-shape")
    check_same(result, expected, rows)


NOTHING_LEFT_OUT = [
    (ATOM_ITEMS, "true_modle", "no dataset 'true_modle' .* one of: item, true_model"),
    (ATOM_ITEMS, "box", "no dataset 'box' with one name per image"),
    (ATOM_ITEMS, "item", "show no items of the dictionary; .* golf, jetta, passat"),
    (None, "true_model", "atoms of the dictionary are of no items; .*: exemplars"),
    (("golf",) * 6, "true_model", "atoms of the dictionary are of 1 items"),
]
"""Models of the atoms, the dataset of those of images, and what is said."""


@pytest.mark.parametrize(("items", "dataset", "message"), NOTHING_LEFT_OUT)
def test_names_that_leave_nothing_out_are_refused(
    run, tmp_path, models, items, dataset, message
):
    dictionary = replace(models, atom_items=items)
    with pytest.raises(InputError, match=f"leave_one_out: .*{message}"):
        run(dictionary, leave_one_out=dataset)
    assert not (tmp_path / "result.h5").exists()
