"""The section `prior` of `learn-dict`: what it cannot learn from."""

import json

import pytest

from shapefit.errors import InputError
from shapefit.io.records import ShapeSet

PLAIN = {"method": "exemplars"}


@pytest.fixture
def shapes(rng):
    points = rng.normal(size=(8, 3, 5))
    items = tuple(f"walk/{number}" for number in range(8))
    return ShapeSet(points, tuple("abcde"), items)


@pytest.mark.parametrize(
    ("prior", "told"),
    [
        ({"components": 9}, "prior.components: 9 components are more than the 8 shapes to learn"),
        ({"components": 1, "bone_scale": 0.1}, "prior: the shapes have no edges"),
    ],
)
def test_what_is_refused(make, shapes, prior, told):
    with pytest.raises(InputError, match=told):
        make(shapes, prior=prior, **PLAIN)


@pytest.mark.parametrize(("number", "components"), [(20, 1), (320, 2)])
def test_a_component_for_every_150_shapes(make, rng, number, components):
    points = rng.normal(size=(number, 3, 5))
    many = ShapeSet(points, tuple("abcde"), tuple(f"pose {i}" for i in range(number)))
    made, _ = make(many, prior={"components": "auto"}, **PLAIN)
    assert len(made.prior) == components
    assert json.loads(made.provenance["config"])["prior"]["components"] == "auto"


def test_rounds_of_the_prior_are_no_rounds_of_coding(make, rng):
    """Three rounds are done of three, whatever the prior takes."""
    points = rng.normal(size=(40, 3, 5))
    shapes = ShapeSet(points, tuple("abcde"), tuple(f"walk/{number}" for number in range(40)))
    _, outcomes = make(shapes, k=4, iterations=3, prior={"components": 2})
    rounds = [outcome for outcome in outcomes if outcome.unit == "round"]
    assert sum(outcome.done for outcome in rounds) == 3
    assert {outcome.total for outcome in rounds} <= {0, 3}
