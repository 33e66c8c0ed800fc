"""What `learn-dict` learns from: `align`, `every`, `mirror`, what is left out and refused."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes, mirror
from shapefit.io import ShapeSet
from shapefit.pipelines.learn_dict.training_shapes import every_nth
from tests.pipelines.learn_dict.conftest import FACES
from tests.pipelines.told import failures

FEW = {"k": 6, "iterations": 2}


class TestAlign:
    def test_a_subset_turns_the_whole_shape(self, make, shapes):
        dictionary, _ = make(shapes, align=["neck", "hip", "head"], **FEW)
        points = normalise(shapes.shapes).points
        expected = generalised_procrustes(points, [1, 0, 2])
        np.testing.assert_array_equal(dictionary.mean_shape, normalise(expected.mean).points)
        everything = generalised_procrustes(points)
        assert np.abs(expected.mean - everything.mean).max() > 1e-3

    def test_an_unknown_landmark_is_named(self, make, shapes):
        with pytest.raises(InputError, match=r"align: .*'nekc'.*'neck'"):
            make(shapes, align=["hip", "nekc", "head"])


class TestEvery:
    def test_counts_within_each_sequence(self):
        assert every_nth(("a",) * 4 + ("b",) * 3 + ("a",) * 3, 3) == [0, 3, 4, 9]

    def test_the_first_glob_that_fits_a_sequence_counts(self):
        sequences = ("a_1",) * 4 + ("b_1",) * 3 + ("a_1",) * 3 + ("c",) * 2
        globs = {"a_*": 3, "*_1": 2}
        assert every_nth(sequences, globs) == [0, 3, 4, 6, 9, 10, 11]

    def test_the_rest_is_not_learned_from(self, make, shapes):
        thinned, _ = make(shapes, every=3, **FEW)
        expected, _ = make(shapes.take([0, 3, 6, 9, 10, 13, 16, 19, 22, 25, 28]), **FEW)
        np.testing.assert_array_equal(thinned.atoms, expected.atoms)
        whole, _ = make(shapes, **FEW)  # bones bend as in all shapes
        np.testing.assert_array_equal(thinned.bone_tolerance, whole.bone_tolerance)


class TestNumber:
    def test_few_shapes_lower_the_atoms_unless_their_number_is_set(self, make, shapes):
        assert make(shapes, iterations=1)[0].k == 30
        with pytest.raises(InputError, match="64 atoms are more than the 30 shapes"):
            make(shapes, k=64)

    def test_shapes_of_one_point_are_left_out(self, make, shapes):
        points = shapes.shapes.copy()
        points[4] = points[4, :, :1]
        dictionary, outcomes = make(shapes.replaced(shapes=points), **FEW)
        assert failures(outcomes) == {"item4": "all its landmarks are at one point"}
        expected, _ = make(shapes.take(np.arange(30) != 4), **FEW)
        np.testing.assert_array_equal(dictionary.atoms, expected.atoms)
        with pytest.raises(InputError, match="29 shapes"):
            make(shapes.replaced(shapes=points), k=30)

    def test_no_shape_that_can_be_used(self, make, shapes):
        points = np.repeat(shapes.shapes[:, :, :1], 5, axis=2)
        with pytest.raises(InputError, match=r"0 shapes.*; item0, for one: all its landmarks are"):
            make(shapes.replaced(shapes=points), k=1)


PARTNERS = np.array([1, 0, 3, 2, 4])
PLAIN = {"method": "exemplars", "align": "none"}


@pytest.fixture
def faces(rng):
    """Six lopsided shapes: two pairs, left and right along z, and a point between."""
    half = np.array([[0.5, 0.2, 2.0], [-0.8, 1.0, 1.0]]).T
    middle = np.array([[0.0, -0.5, 0.0]]).T
    points = np.concatenate([half, half * [[1], [1], [-1]], middle], axis=1)[:, [0, 2, 1, 3, 4]]
    return ShapeSet(
        shapes=points + 0.1 * rng.standard_normal((6, 3, 5)),
        landmark_names=("left eye", "right eye", "left ear", "right ear", "nose"),
        items=tuple(f"face{i}" for i in range(6)),
        columns={"mirror_index": PARTNERS},
    )


class TestMirror:
    def test_atoms_are_the_shapes_and_their_mirror_images(self, make, faces):
        dictionary, outcomes = make(faces, mirror=True, **PLAIN)
        plain = normalise(faces.shapes).points
        np.testing.assert_array_equal(dictionary.atoms[:6], plain)
        np.testing.assert_allclose(dictionary.atoms[6:], mirror(plain, PARTNERS, 2), atol=1e-14)
        np.testing.assert_allclose(dictionary.atom_scale[6:], dictionary.atom_scale[:6])
        np.testing.assert_allclose(
            mirror(dictionary.mean_shape, PARTNERS, 2), dictionary.mean_shape, atol=1e-14
        )
        assert outcomes[0].note == "12 shapes"
        rest, _ = make(faces.take([0, 1, 3, 4, 5]), mirror=True, **PLAIN)
        left = dictionary.without("face2")
        np.testing.assert_allclose(left.atoms, rest.atoms, atol=1e-14)
        assert left.atom_items == rest.atom_items

    def test_meshes_are_left_out(self, make, faces, rng):
        meshed = faces.replaced(mesh_vertices=rng.normal(size=(6, 3, 4)), mesh_faces=FACES)
        dictionary, _ = make(meshed, mirror=True, **PLAIN)
        assert (dictionary.mesh_vertices, dictionary.mesh_faces) == (None, None)
        assert make(meshed, **PLAIN)[0].mesh_vertices.shape == (6, 3, 4)

    @pytest.mark.parametrize(
        "index",
        [None, [1, 2, 0, 3, 4], [1, 0, 3, 5, 4], [0, 1, 2, 3, 4], [1, 0, 3, 2], [1.0] * 5],
        ids=["absent", "cycle", "too high", "nobody has a partner", "too few", "no integers"],
    )
    def test_an_index_that_pairs_nothing_is_refused(self, make, faces, index):
        further = {} if index is None else {"mirror_index": np.array(index)}
        with pytest.raises(InputError, match="does not pair landmarks; name each"):
            make(faces.replaced(further=further), mirror=True, **PLAIN)

    def test_pairs_of_the_config_are_those_of_the_file(self, make, faces):
        names = faces.landmark_names
        pairs = {names[0]: names[1], names[2]: names[3]}
        expected, _ = make(faces, mirror=True, **PLAIN)
        named, _ = make(faces.replaced(further={}), mirror=pairs, **PLAIN)
        np.testing.assert_array_equal(named.atoms, expected.atoms)
        np.testing.assert_array_equal(named.mirror_index, PARTNERS)
        with pytest.raises(InputError, match="name each landmark of a pair once"):
            make(faces, mirror={names[0]: names[1], names[4]: names[1]}, **PLAIN)
