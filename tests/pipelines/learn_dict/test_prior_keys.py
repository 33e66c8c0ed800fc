"""The section `prior` of `learn-dict`: weights of shapes, and what it cannot learn from."""

import json

import numpy as np
import pytest

from shapefit.dictionary.left_out import AS_LEARNED, Chosen
from shapefit.errors import InputError
from shapefit.io.records import ShapeSet
from shapefit.pipelines.learn_dict import from_3d

PLAIN = {"method": "exemplars"}
WEIGHTS = {
    "ones": np.ones(8),
    "negative": np.full(8, -1.0),
    "none": np.zeros(8),
    "twice": np.array([2.0, 1, 1, 1, 1, 1, 1, 0]),
}


@pytest.fixture
def shapes(rng):
    points = rng.normal(size=(8, 3, 5))
    items = tuple(f"walk/{number}" for number in range(8))
    return ShapeSet(points, tuple("abcde"), items, columns=WEIGHTS)


@pytest.mark.parametrize(
    ("prior", "told"),
    [
        ({"components": 9}, "prior.components: 9 components are more than the 8 shapes to learn"),
        ({"components": 1, "weights": "no"}, "prior.weights: no: the shapes have no such dataset"),
        ({"components": 1, "weights": "negative"}, "prior.weights: negative: holds no weights"),
        ({"components": 1, "weights": "none"}, "prior.weights: none: holds no weights"),
        ({"components": 1, "stretch": 0.1}, "prior: the shapes have no edges"),
    ],
)
def test_what_is_refused(make, shapes, prior, told):
    with pytest.raises(InputError, match=told):
        make(shapes, prior=prior, **PLAIN)


def test_a_shape_of_weight_two_counts_as_two(make, shapes):
    """And one of weight 0 not at all."""
    rows = [0, 0, 1, 2, 3, 4, 5, 6]
    twice = shapes.take(rows).replaced(items=shapes.items)
    keys = {**PLAIN, "align": "none"}
    weighted, _ = make(shapes, prior={"components": 1, "weights": "twice"}, **keys)
    repeated, _ = make(twice, prior={"components": 1}, **keys)
    assert weighted.prior is not None
    np.testing.assert_allclose(weighted.prior.means, repeated.prior.means, rtol=1e-6)
    assert not np.allclose(
        weighted.prior.means, make(shapes, prior={"components": 1}, **keys)[0].prior.means
    )


def test_how_sure_the_prior_is_follows_from_shapes_left_out_unless_keys_say(make, rng):
    """What was chosen is told, and stands in the config of the dictionary."""
    points = rng.normal(size=(24, 3, 5)) * np.linspace(0.3, 2, 5)
    few = ShapeSet(points, tuple("abcde"), tuple(f"pose {i}" for i in range(24)))
    prior = {"components": 1}
    found, outcomes = make(few, prior=prior, **PLAIN)
    (line,) = (each.line for each in outcomes if each.line.startswith("prior: "))
    assert line.startswith("prior: covariances times ")
    assert "by 8 folds of shapes left out" in line
    stored = json.loads(found.provenance["config"])["prior"]
    as_given = {key: stored[key] for key in ("components", "shrinkage", "floor", "width")}
    again, outcomes = make(few, prior=as_given, **PLAIN)
    assert not any(each.line.startswith("prior: ") for each in outcomes)
    assert again.prior == found.prior
    kept, _ = make(few, prior={**as_given, "floor": 0.01, "width": 1.0}, **PLAIN)
    ratio = found.prior.covariances[0].trace() / kept.prior.covariances[0].trace()
    assert ratio > 0.999 * stored["width"] > 1


def test_mirror_images_are_left_out_with_their_shapes(make, rng, monkeypatch):
    given = []
    monkeypatch.setattr(
        from_3d,
        "choose_sureness",
        lambda shapes, weights, folds, *rest: given.append(folds) or Chosen(AS_LEARNED, 2, 0.0),
    )
    points = rng.normal(size=(30, 3, 5))
    shapes = ShapeSet(points, tuple("abcde"), tuple(f"pose {i}" for i in range(30)))
    make(shapes, prior={"components": 1}, symmetry="double", mirror={"a": "b"}, **PLAIN)
    first, second = given[0].reshape(2, 30)
    assert (first == second).all()
    assert len(set(first.tolist())) > 2
