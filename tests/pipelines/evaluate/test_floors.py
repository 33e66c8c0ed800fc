"""Rows of the mean shape, the nearest atom and the best combination beside those of fits."""

import json
from dataclasses import replace

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.evaluation.floors import best_combination
from shapefit.evaluation.metrics import similarity
from shapefit.geometry.normalisation import normalise
from shapefit.io import write_dictionary, write_shapes

MEAN, NEAREST, BEST = "Mean shape (oracle)", "Nearest atom (oracle)", "Best combination (oracle)"
OWN = ("item0", "item1", "item2", "item3")
"""Atoms of the dictionary: the first four true shapes."""


@pytest.fixture
def atoms(truth):
    return normalise(truth.shapes[:4]).points


@pytest.fixture
def dictionary(atoms, truth):
    mean = normalise(atoms.mean(axis=0)).points
    return Dictionary(atoms, truth.landmark_names, mean, atom_items=OWN)


@pytest.fixture
def floors(desk, dictionary, results):
    """The key `floors`; the results name the item itself as the shape to leave out."""
    write_dictionary(desk.folder / "dictionary.h5", dictionary)
    own = np.array(results.items, dtype=object)
    desk.write("convex.h5", results.replaced(further={**results.further, "own": own}))
    return {"dictionary": desk.folder / "dictionary.h5"}


def test_a_shape_that_is_an_atom_is_its_own_floor(desk, floors, truth, atoms):
    desk.run(floors=floors)
    for name in (NEAREST, BEST):
        found = desk.errors(method=name, unit="m")
        np.testing.assert_allclose(found[:4], 0, atol=1e-9)
        assert (found[4:] > 0.05).all()
    mean = np.broadcast_to(atoms.mean(axis=0), truth.shapes.shape)
    np.testing.assert_allclose(
        desk.errors(method=MEAN, unit="m"), similarity(mean, truth.shapes), rtol=1e-12
    )


def test_left_out_shapes_are_no_atoms_of_their_own_images(desk, floors, truth, atoms):
    desk.run(floors={**floors, "leave_out": "own"})
    mean, nearest, best = (desk.errors(method=name, unit="m") for name in (MEAN, NEAREST, BEST))
    for i, shape in enumerate(truth.shapes):
        others = np.delete(atoms, i, axis=0) if i < 4 else atoms
        true = np.broadcast_to(shape, others.shape)
        assert mean[i] == pytest.approx(similarity(others.mean(axis=0)[None], shape[None])[0])
        assert nearest[i] == pytest.approx(similarity(others, true).min())
        combined = best_combination(shape[None], others)
        assert best[i] == pytest.approx(similarity(combined, shape[None])[0])


def test_images_of_one_true_shape_may_leave_out_different_ones(desk, floors, results):
    extras = {
        "shown": np.array(["item0", "item0", "item1"], dtype=object),
        "own": np.array(["item0", "item2", "item0"], dtype=object),
    }
    few = results.take([0, 1, 2])
    desk.write("convex.h5", few.replaced(further=extras))
    desk.run(match="shown", metrics=["similarity"], floors={**floors, "leave_out": "own"})
    found = desk.errors(method=NEAREST, unit="m")
    assert found[0] > 0.05
    np.testing.assert_allclose(found[1:], 0, atol=1e-9)


def test_they_stand_in_both_units_with_the_sequences_of_the_images(desk, floors, truth):
    *_, last = desk.run(floors=floors)
    rows = [row for row in desk.rows("per_image.csv") if row["method"] == MEAN]
    assert {row["metric"] for row in rows} == {"similarity"}
    metres, normalised = (desk.errors(method=MEAN, unit=unit) for unit in ("m", "normalised"))
    scale = truth.shapes.std(axis=-1).mean(axis=-1)
    np.testing.assert_allclose(normalised * scale, metres)
    assert [row["sequence"] for row in rows if row["unit"] == "m"] == list(truth.sequences)
    group = desk.row(method=MEAN, unit="m", group="Subject 13", sequence="")
    assert float(group["mean"]) == pytest.approx((metres[:4].mean() + metres[4]) / 2)
    assert MEAN in last.note


def test_they_are_of_the_images_that_are_judged(desk, floors, results, truth):
    """Without truth there is no floor, without fit there is; an item of two methods counts once."""
    shapes = results.shapes.copy()
    shapes[1] = np.nan
    files = {
        "a": [desk.write("a.h5", results.replaced(shapes=shapes).take([0, 1, 5]))],
        "b": [desk.write("b.h5", results.take([1, 2, 5, 6]))],
    }
    write_shapes(desk.folder / "truth.h5", truth.take([0, 1, 2, 3, 4, 5]))
    desk.run(results=files, floors=floors)
    rows = [row for row in desk.rows("per_image.csv") if row["method"] == BEST]
    found = [row["item"] for row in rows if row["unit"] == "m"]
    assert found == ["item0", "item1", "item5", "item2"]
    images = desk.row(method=BEST, unit="m", group="Subject 13", sequence="")["images"]
    assert images == "3"


def test_landmarks_are_matched_by_name(desk, floors, dictionary):
    """A dictionary with its landmarks in another order and one of its own gives the same."""
    desk.run(floors=floors)
    names = (MEAN, NEAREST, BEST)
    expected = [desk.errors(method=name, unit="m") for name in names]
    order = [3, 0, 5, 4, 1, 2]
    strange = np.full((4, 3, 1), 9.0)
    shuffled = replace(
        dictionary,
        atoms=np.concatenate([dictionary.atoms, strange], axis=-1)[..., order],
        mean_shape=np.concatenate([dictionary.mean_shape, strange[0]], axis=-1)[:, order],
        landmark_names=tuple(np.array([*dictionary.landmark_names, "tail"])[order].tolist()),
    )
    write_dictionary(desk.folder / "dictionary.h5", shuffled)
    desk.run(floors=floors)
    np.testing.assert_allclose(
        [desk.errors(method=name, unit="m") for name in names], expected, atol=1e-9
    )


def test_the_dictionary_is_among_the_inputs(desk, floors):
    desk.run(floors=floors)
    document = json.loads((desk.config.output / "report.json").read_text())
    assert str(floors["dictionary"]) in document["inputs"]
    assert [method["name"] for method in document["methods"]] == ["convex"]


class TestInputErrors:
    def stops(self, desk, match, **floors):
        with pytest.raises(InputError, match=match):
            desk.run(floors=floors)
        assert not desk.config.output.exists()

    def test_no_dataset_of_that_name(self, desk, floors):
        match = r"convex\.h5: .* no dataset 'model'.*`floors.leave_out` to one of: item, .*own"
        self.stops(desk, match, **floors, leave_out="model")

    def test_atoms_without_items(self, desk, floors, dictionary):
        write_dictionary(floors["dictionary"], replace(dictionary, atom_items=None))
        match = r"dictionary\.h5: does not state which .*`method: exemplars`"
        self.stops(desk, match, **floors, leave_out="own")

    def test_items_that_no_atom_has(self, desk, floors, dictionary):
        write_dictionary(floors["dictionary"], replace(dictionary, atom_items=tuple("abcd")))
        match = r"has no atom of item0, .*; its atoms are of a, b, c, d"
        self.stops(desk, match, **floors, leave_out="own")

    def test_no_other_atom(self, desk, floors, dictionary):
        write_dictionary(floors["dictionary"], replace(dictionary, atom_items=("item2",) * 4))
        self.stops(desk, "no atom but those of 'item2'", **floors, leave_out="own")

    def test_other_landmarks(self, desk, floors, dictionary):
        names = ("head", "left", "x", "y", "z")
        write_dictionary(floors["dictionary"], replace(dictionary, landmark_names=names))
        self.stops(desk, r"the truth has 2 of its landmarks.*at least 3", **floors)
