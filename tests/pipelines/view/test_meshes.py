"""Meshes of a page follow the coefficients."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.io import (
    write_dictionary,
)
from shapefit.pipelines.view.run import fitted_image


@pytest.fixture
def dictionary_file(desk, made_dictionary):
    path = desk.folder / "dict.h5"
    write_dictionary(path, made_dictionary)
    return path


def test_meshes_follow_the_coefficients(desk, made_dictionary, dictionary_file, rng):
    c = np.array([[1.0, 0, 0.5], [0, 2.0, 0], [np.nan] * 3])
    R, _ = np.linalg.qr(rng.normal(size=(3, 3, 3)))
    s = np.array([2.0, 3.0, 1.0])
    T = rng.normal(size=(3, 2))
    result = desk.result(n=3, coefficients=c, rotation=R, scale=s, translation=T)
    scene = desk.scene(result, dictionary=dictionary_file)
    assert not scene["video"]
    assert scene["rigid"]
    for i in range(2):
        mixed = np.tensordot(c[i], made_dictionary.mesh_vertices, axes=1)
        expected = s[i] * R[i] @ mixed
        expected[:2] += T[i][:, None]
        assert_allclose(fitted_image(scene, i).mesh, expected)
    assert fitted_image(scene, 2).mesh is None


CANNOT_FOLLOW = {
    "another method": {"attributes": {"method": "pmp"}},
    "fewer coefficients": {"coefficients": np.ones((6, 2))},
    "no rotation": {"rotation": None},
}


@pytest.mark.parametrize("fields", CANNOT_FOLLOW.values(), ids=CANNOT_FOLLOW)
def test_meshes_that_cannot_follow(desk, dictionary_file, fields):
    pose = {
        "coefficients": np.ones((6, 3)),
        "rotation": np.tile(np.eye(3), (6, 1, 1)),
        "scale": np.ones(6),
        "translation": np.zeros((6, 2)),
    }
    result = desk.result(**(pose | fields))
    made = desk.view(result, dictionary=dictionary_file)
    assert "mixes no atoms of this dictionary" in made.notes
    assert "blend" not in made.data["layers"][0]
