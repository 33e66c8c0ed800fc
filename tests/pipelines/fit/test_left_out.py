"""`omit`: the model that an image shows has no part in its fit, whatever it looks like."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    LandmarkSet,
    write_dictionary,
)
from tests.pipelines.told import done, warnings

NAMES = tuple(f"point{j}" for j in range(10))
MODELS = ("golf", "jetta", "passat", "polo", "up")
SHOWN = ("polo", "golf", "polo", "up", "jetta", "golf", "passat", "up", "polo")
METHODS = ["convex", "convex+refine", "alternate", "mean-shape"]


@pytest.fixture
def models(rng):
    """Five exemplars in metres, `polo` also as its mirror image."""
    atoms = normalise(rng.standard_normal((3, 10)) + 0.4 * rng.standard_normal((6, 3, 10))).points
    return Dictionary(
        atoms=atoms,
        landmark_names=NAMES,
        mean_shape=normalise(atoms.mean(axis=0)).points,
        atom_scale=rng.uniform(1, 2, 6),
        unit="m",
        atom_items=(*MODELS, "polo"),
    )


@pytest.fixture
def images(rng, models):
    """Nine images of the models; one shows two landmarks only."""
    shapes = models.atoms[[models.atom_items.index(name) for name in SHOWN]]
    landmarks = 20 * (random_rotations(9, rng) @ shapes)[:, :2] + 100
    landmarks += 0.5 * rng.standard_normal(landmarks.shape)
    landmarks[5, :, 2:] = np.nan
    return LandmarkSet(
        landmarks=landmarks,
        landmark_names=NAMES,
        items=tuple(f"image{i}" for i in range(9)),
        unit="px",
        columns={"true_model": np.array(SHOWN, dtype=object), "box": np.ones((9, 4))},
    )


@pytest.fixture
def run(fit, tmp_path, models, images):
    """Return the function that fits images of a record with a dictionary."""

    def run(dictionary=models, views=images, leave_one_out="true_model", **keys):
        write_dictionary(tmp_path / "dict.h5", dictionary)
        return fit(tmp_path / "dict.h5", views, leave_one_out=leave_one_out, **keys)

    return run


def check_same(one, other, rows=slice(None), other_rows=slice(None)):
    """Assert that results agree in all that a fit finds, but for axes of atoms."""
    for name in ("shapes", "rotation", "translation", "scale", "objective"):
        mine, theirs = getattr(one, name)[rows], getattr(other, name)[other_rows]
        np.testing.assert_array_equal(mine, theirs, err_msg=name)
    for name in ("iterations", "status"):
        assert list(getattr(one, name)[rows]) == list(getattr(other, name)[other_rows])
    for name in ("landmarks", "lambda", "residual"):
        np.testing.assert_array_equal(one.columns[name][rows], other.columns[name][other_rows])


THROUGH_ALL = {
    "method": "convex+refine",
    "outliers": "ransac",
    "camera": {"focal": 900, "principal_point": [100, 100]},
}


@pytest.mark.parametrize("keys", [*({"method": name} for name in METHODS), THROUGH_ALL], ids=str)
def test_each_image_is_fitted_with_the_dictionary_of_the_other_models(run, models, images, keys):
    """Whose mean is another one: no stage of the fit has seen the model."""
    found, outcomes = run(**keys)
    assert warnings(outcomes) == []
    items = np.array(models.atom_items)
    for model in MODELS:
        rows = [i for i in range(9) if SHOWN[i] == model]
        retained = items != model
        others = Dictionary(
            models.atoms[retained], NAMES, normalise(models.atoms[retained].mean(axis=0)).points
        )
        expected, _ = run(others, images.take(rows), leave_one_out=None, **keys)
        check_same(found, expected, rows)
        if expected.coefficients is not None:
            mine = found.coefficients[rows]
            np.testing.assert_array_equal(mine[:, retained], expected.coefficients)


def test_chunks_make_no_difference_but_to_starts(run, monkeypatch):
    whole, _ = run(method="mean-shape")
    monkeypatch.setattr("shapefit.pipelines.fit.run.IMAGES_PER_BLOCK", 1)
    monkeypatch.setattr("shapefit.pipelines.fit.run.CHUNK", 2)
    parts, outcomes = run(method="mean-shape")
    assert len(outcomes) == 6
    assert done(outcomes) == 9
    check_same(whole, parts)


def test_models_that_the_dictionary_lacks_are_fitted_with_all_atoms(run, images):
    shown = np.array(["beetle" if name == "up" else name for name in SHOWN], dtype=object)
    odd = images.replaced(further={"true_model": shown})
    found, outcomes = run(views=odd, method="mean-shape")
    assert warnings(outcomes) == [
        "leave_one_out: 2 of 9 images show items that are not in the dictionary, the first "
        "'beetle'; they were fitted with all atoms"
    ]
    known, _ = run(method="mean-shape")
    all_atoms, _ = run(leave_one_out=None, method="mean-shape")
    check_same(found, all_atoms, [3, 7], [3, 7])
    check_same(found, known, [0, 1, 2, 4, 6, 8], [0, 1, 2, 4, 6, 8])


@pytest.mark.parametrize(("items", "omit", "message"), [
    ((*MODELS, "polo"), "true_modle", "no dataset 'true_modle' .* one of: item, true_model"),
    ((*MODELS, "polo"), "box", "no dataset 'box' with one name per image"),
    (None, "true_model", "atoms of the dictionary are of no items; .*method: exemplars"),
    (("golf",) * 6, "true_model", "atoms of the dictionary are of 1 items"),
    (
        (*MODELS, "polo"), "item",
        "9 of 9 images show items that are not in the dictionary, the first 'image0'; .* such as "
        "'golf', 'jetta', 'passat'",
    ),
])  # fmt: skip
def test_names_that_leave_nothing_out_are_refused(run, tmp_path, models, items, omit, message):
    with pytest.raises(InputError, match=f"leave_one_out: .*{message}"):
        run(replace(models, atom_items=items), leave_one_out=omit)
    assert not (tmp_path / "result.h5").exists()
