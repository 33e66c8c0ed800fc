"""`shapefit.learn` makes what the command makes, bit for bit, and refuses what it refuses."""

import numpy as np
import pytest

import shapefit

from .conftest import run_command, same_file


@pytest.mark.parametrize("method", ["sparse-coding", "pca-bases", "exemplars"])
def test_every_method_makes_what_the_command_makes(tmp_path, people, sample, method):
    prior = {"components": 2, "floor": 0.01}
    own = {"k": 24, "iterations": 2, "prior": prior} if method == "sparse-coding" else {}
    shapes = shapefit.read_shapes(sample / "people_train.h5")
    made = shapefit.learn(shapes, method=method, every=20, **own)
    shapefit.write_dictionary(tmp_path / "made.h5", made)
    same_file(people[method], tmp_path / "made.h5")


@pytest.mark.filterwarnings("ignore:the meshes are left out")
def test_cars_with_meshes_and_symmetry(tmp_path, sample):
    shapes = shapefit.read_shapes(sample / "cars.h5")
    for mirror in (False, True):
        keys = {"method": "exemplars", "align": "none", "mirror": mirror}
        run_command(
            "learn-dict",
            shapes=str(sample / "cars.h5"),
            output=str(tmp_path / "command.h5"),
            **keys,
        )
        made = shapefit.learn(shapes, **keys)
        assert (made.mesh_vertices is None) == mirror
        shapefit.write_dictionary(tmp_path / "function.h5", made)
        same_file(tmp_path / "command.h5", tmp_path / "function.h5")


def test_arrays_alone_are_enough(sample):
    shapes = shapefit.read_shapes(sample / "people_train.h5")
    made = shapefit.learn(shapes.shapes[::60], k=5, iterations=1)
    assert made.atoms.shape == (5, 15, 3)
    assert made.landmark_names == tuple(map(str, range(15)))
    named = shapefit.learn(shapes.replaced(sequences=None), k=5, iterations=1, every=60)
    np.testing.assert_array_equal(named.atoms, made.atoms)


def test_shapes_that_cannot_be_used_are_a_warning(sample):
    shapes = shapefit.read_shapes(sample / "people_train.h5").shapes[::60].copy()
    shapes[4] = 1.0
    with pytest.warns(UserWarning, match="1 shape cannot be used; 4, for one: all its landmarks"):
        made = shapefit.learn(shapes, method="exemplars")
    assert made.atoms.shape == (31, 15, 3)


@pytest.mark.parametrize(
    ("shapes", "options", "message"),
    [
        (np.ones((4, 15, 2)), {}, r"^shapes: has the shape \(4, 15, 2\); it must be \(n, p, 3\)"),
        (np.full((4, 15, 3), np.nan), {}, r"^shapes\[0\]: landmark '0' is \(nan, nan, nan\)"),
        (np.eye(5, 3)[None].repeat(4, 0), {"k": 5}, "5 atoms are more than the 4 shapes"),
        (
            np.ones((4, 5, 3)),
            {"k": 0},
            r"^learn\.k: expected a whole number >= 1, found 0",
        ),
        (np.ones((4, 5, 3)), {"kk": 0}, r"^learn\.kk: unknown key"),
    ],
)
def test_what_is_wrong_is_an_error_with_its_place(shapes, options, message):
    with pytest.raises(shapefit.InputError, match=message):
        shapefit.learn(shapes, **options)
