"""`learn` does as the command does, bit for bit, and refuses the same."""

import numpy as np
import pytest

import shapefit
from tests.api.conftest import LEARN_KEYS, same_file


@pytest.mark.parametrize("method", LEARN_KEYS)
def test_learn_makes_what_the_command_makes(tmp_path, people, sample, method):
    path = tmp_path / "made.h5"
    shapes = shapefit.read_shapes(sample / "people_train.h5")
    made = shapefit.learn(shapes, method=method, every=20, **LEARN_KEYS[method])
    shapefit.write_dictionary(path, made)
    same_file(people[method], path)


def test_learn_takes_arrays_and_warns_of_those_that_cannot_be_used(sample):
    shapes = shapefit.read_shapes(sample / "people_train.h5").shapes[::60].copy()
    shapes[4] = 1.0
    warning = "1 shape cannot be used; 4, for one: all its landmarks"
    with pytest.warns(UserWarning, match=warning):
        made = shapefit.learn(shapes, method="exemplars")
    assert made.atoms.shape == (31, 15, 3)
    assert made.landmark_names == tuple(map(str, range(15)))


LEARN = [
    (
        np.ones((4, 15, 2)),
        {},
        r"^shapes: has the shape \(4, 15, 2\); it must be \(n, p, 3\)",
    ),
    (
        np.full((4, 15, 3), np.nan),
        {},
        r"^shapes: no landmark is known in 90% of its 4 shapes",
    ),
    (np.ones((4, 5, 3)), {"k": 0}, r"^learn\.k: expected a whole number >= 1, found 0"),
    (
        np.ones((4, 5, 3)),
        {"kk": 0},
        r"^learn\.kk: there is no argument `kk`; did you mean `k`",
    ),
]


@pytest.mark.parametrize(("shapes", "options", "message"), LEARN)
def test_learn_names_the_place_of_an_error(shapes, options, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.learn(shapes, **options)
