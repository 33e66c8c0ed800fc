"""`learn-dict` of shapes and their mirror images."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import mirror
from shapefit.records import Shapes
from tests.columns import in_rows
from tests.pipelines.learn_dict.conftest import FACES

PARTNERS = np.array([1, 0, 3, 2, 4])
"""Of each landmark, that of the other side."""

PLAIN = {"method": "exemplars", "align": "none"}


def mirrored(shapes):
    """Return shapes (..., 3, p) mirrored along z."""
    return mirror(shapes, PARTNERS, 2)


@pytest.fixture
def faces(rng):
    """Six lopsided shapes: two pairs, left and right along z, and a point between."""
    eye = np.array([0.5, 0.2, 2.0])
    ear = np.array([-0.8, 1.0, 1.0])
    nose = np.array([0.0, -0.5, 0.0])
    other_side = np.array([1, 1, -1])
    face = np.array([eye, eye * other_side, ear, ear * other_side, nose])
    noise = in_rows(rng.standard_normal((6, 3, 5)))
    return Shapes(
        face + 0.1 * noise,
        landmark_names=("left eye", "right eye", "left ear", "right ear", "nose"),
        items=tuple(f"face{i}" for i in range(6)),
        mirror_index=PARTNERS,
    )


def test_atoms_are_the_shapes_and_their_mirror_images(make, faces):
    dictionary, outcomes = make(faces, mirror=True, **PLAIN)
    shapes = normalise(faces.as_columns()).points
    scales = dictionary.atom_scale
    assert_array_equal(dictionary.atoms[:6], shapes)
    assert_allclose(dictionary.atoms[6:], mirrored(shapes), atol=1e-14)
    assert_allclose(scales[6:], scales[:6])
    assert outcomes[0].note == "12 shapes"


def test_the_mean_is_its_own_mirror_image(make, faces):
    dictionary, _ = make(faces, mirror=True, **PLAIN)
    mean = dictionary.mean_shape
    assert_allclose(mirrored(mean), mean, atol=1e-14)


def test_a_shape_is_left_out_with_its_mirror_image(make, faces):
    dictionary, _ = make(faces, mirror=True, **PLAIN)
    expected, _ = make(faces.take([0, 1, 3, 4, 5]), mirror=True, **PLAIN)
    left = dictionary.without("face2")
    assert_allclose(left.atoms, expected.atoms, atol=1e-14)
    assert left.atom_items == expected.atom_items


@pytest.fixture
def meshed(faces, rng):
    vertices = rng.normal(size=(6, 4, 3))
    return faces.replaced(mesh_vertices=vertices, mesh_faces=FACES)


def test_meshes_are_left_out_of_mirror_images(make, meshed):
    dictionary, _ = make(meshed, mirror=True, **PLAIN)
    assert dictionary.mesh_vertices is None
    assert dictionary.mesh_faces is None


def test_meshes_are_kept_without_mirror_images(make, meshed):
    dictionary, _ = make(meshed, **PLAIN)
    assert dictionary.mesh_vertices.shape == (6, 3, 4)


NO_PAIRS = {
    "absent": None,
    "cycle": np.array([1, 2, 0, 3, 4]),
    "too high": np.array([1, 0, 3, 5, 4]),
    "nobody has a partner": np.array([0, 1, 2, 3, 4]),
}


@pytest.mark.parametrize("index", NO_PAIRS.values(), ids=NO_PAIRS)
def test_an_index_that_pairs_nothing_is_refused(make, faces, index):
    with pytest.raises(InputError, match="does not pair landmarks; name each"):
        make(faces.replaced(mirror_index=index), mirror=True, **PLAIN)


def test_pairs_of_the_config_are_those_of_the_file(make, faces):
    pairs = {"left eye": "right eye", "left ear": "right ear"}
    expected, _ = make(faces, mirror=True, **PLAIN)
    named, _ = make(faces.replaced(mirror_index=None), mirror=pairs, **PLAIN)
    assert_array_equal(named.atoms, expected.atoms)
    assert_array_equal(named.mirror_index, PARTNERS)


def test_a_landmark_of_two_pairs_is_refused(make, faces):
    pairs = {"left eye": "right eye", "nose": "right eye"}
    with pytest.raises(InputError, match="name each landmark of a pair once"):
        make(faces, mirror=pairs, **PLAIN)
