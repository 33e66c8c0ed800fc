"""Left and right of training shapes: `symmetry` of `learn-dict`."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import mirror
from shapefit.io import ShapeSet

PARTNERS = np.array([1, 0, 3, 2, 4])


@pytest.fixture
def shapes(rng):
    """Six lopsided shapes: two pairs, left and right along z, and a point between."""
    half = np.array([[0.5, 0.2, 2.0], [-0.8, 1.0, 1.0]]).T
    middle = np.array([[0.0, -0.5, 0.0]]).T
    points = np.concatenate([half, half * [[1], [1], [-1]], middle], axis=1)[:, [0, 2, 1, 3, 4]]
    return ShapeSet(
        shapes=points + 0.1 * rng.standard_normal((6, 3, 5)),
        landmark_names=("left eye", "right eye", "left ear", "right ear", "nose"),
        items=tuple(f"face{i}" for i in range(6)),
        sequences=("a",) * 3 + ("b",) * 3,
        unit="m",
        columns={"mirror_index": PARTNERS},
    )


PLAIN = {"method": "exemplars", "align": "none"}


def test_doubled_atoms_are_the_shapes_and_their_mirror_images(make, shapes):
    dictionary, outcomes = make(shapes, mirror=True, **PLAIN)
    plain = normalise(shapes.shapes).points
    np.testing.assert_array_equal(dictionary.atoms[:6], plain)
    np.testing.assert_allclose(dictionary.atoms[6:], mirror(plain, PARTNERS, 2), atol=1e-14)
    np.testing.assert_allclose(dictionary.atom_scale[6:], dictionary.atom_scale[:6])
    np.testing.assert_allclose(
        mirror(dictionary.mean_shape, PARTNERS, 2), dictionary.mean_shape, atol=1e-14
    )
    assert outcomes[0].note == "12 shapes"


def test_leaving_out_a_model_leaves_out_its_mirror_image(make, shapes):
    dictionary, _ = make(shapes, mirror=True, **PLAIN)
    rest, _ = make(shapes.take([0, 1, 3, 4, 5]), mirror=True, **PLAIN)
    left = dictionary.without("face2")
    np.testing.assert_allclose(left.atoms, rest.atoms, atol=1e-14)
    assert left.atom_items == rest.atom_items
    assert "face2" not in rest.atom_items


def test_learned_atoms_come_from_doubled_shapes(make, shapes):
    keys = {"method": "sparse-coding", "align": "all", "iterations": 3, "k": 12}
    dictionary, _ = make(shapes, mirror=True, **keys)
    assert dictionary.k == 12
    both = np.concatenate([shapes.shapes, mirror(shapes.shapes, PARTNERS, 2)])
    items = tuple(f"face{i}" for i in range(12))
    given = shapes.replaced(shapes=both, items=items, sequences=("a",) * 12)
    expected, _ = make(given, **keys)
    np.testing.assert_allclose(dictionary.atoms, expected.atoms, atol=1e-12)
    with pytest.raises(InputError, match="12 atoms are more than the 6 shapes"):
        make(shapes, **keys)


def test_meshes_are_left_out_and_a_warning_says_why(make, shapes, rng):
    meshed = shapes.replaced(
        mesh_vertices=rng.normal(size=(6, 3, 4)), mesh_faces=np.array([[0, 1, 2]])
    )
    dictionary, outcomes = make(meshed, mirror=True, **PLAIN)
    assert (dictionary.mesh_vertices, dictionary.mesh_faces) == (None, None)
    (warning,) = outcomes[0].warnings
    assert warning.startswith("the meshes are left out: `mirror` mirrors landmarks")
    dictionary, outcomes = make(meshed, **PLAIN)
    assert outcomes[0].warnings == ()
    assert dictionary.mesh_vertices.shape == (6, 3, 4)


def test_shapes_without_pairs_are_refused(make, shapes):
    with pytest.raises(InputError, match="does not pair landmarks; name each"):
        make(shapes.replaced(further={}), mirror=True, **PLAIN)


@pytest.mark.parametrize(
    "index",
    [[1, 2, 0, 3, 4], [1, 0, 3, 5, 4], [1, 0, 3, -1, 4], [0, 1, 2, 3, 4], [1, 0, 3, 2], [1.0] * 5],
    ids=["cycle", "too high", "negative", "nobody has a partner", "too few", "no integers"],
)
def test_an_index_that_pairs_nothing_is_refused(make, shapes, index):
    broken = shapes.replaced(further={"mirror_index": np.array(index)})
    with pytest.raises(InputError, match="does not pair landmarks; name each"):
        make(broken, mirror=True, **PLAIN)


def test_pairs_of_the_config_are_those_of_the_file(make, shapes):
    """`mirror` stands for a `mirror_index` that files do not have."""
    names, index = shapes.landmark_names, shapes.columns["mirror_index"]
    mirror = {names[a]: names[b] for a, b in enumerate(index) if a < b}
    known, _ = make(shapes, mirror=True, **PLAIN)
    told, _ = make(shapes.replaced(further={}), mirror=mirror, **PLAIN)
    np.testing.assert_array_equal(told.atoms, known.atoms)
    np.testing.assert_array_equal(told.mirror_index, index)
    first, second = next(iter(mirror.items()))
    with pytest.raises(InputError, match="name each landmark of a pair once"):
        make(shapes, mirror={first: second, names[-1]: second}, **PLAIN)
