"""`learn-dict` of 3D shapes: what is learned from, atoms by three methods, priors,
meshes.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from shapefit import __version__
from shapefit.config import LearnDictConfig
from shapefit.dictionary.learning import learn_atoms, principal_components
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise, std
from shapefit.geometry.procrustes import generalised_procrustes, mirror, rotation_onto
from shapefit.io import (
    digest,
    read_dictionary,
    read_shapes,
    write_shapes,
)
from shapefit.pipelines.learn_dict.from_3d import every_nth
from shapefit.pipelines.learn_dict.run import learn_dictionary as run
from shapefit.records import Shapes
from tests.pipelines.fitted import failures, warnings
from tests.pipelines.learn_dict.conftest import EDGES, FACES

LEARNED = {"k": 4, "iterations": 5}
EXEMPLARS = {"method": "exemplars"}
FEW = {"k": 6, "iterations": 2}


class TestSparseCoding:
    def test_atoms_are_learned_from_normalised_aligned_shapes(self, make, shapes):
        dictionary, _ = make(shapes, k=6, iterations=4)
        aligned = generalised_procrustes(normalise(shapes.as_columns()).points)
        *_, expected = learn_atoms(aligned.shapes, 6, 0.1, iterations=4)
        np.testing.assert_array_equal(dictionary.atoms, expected.atoms)
        np.testing.assert_array_equal(dictionary.objective_trace, expected.trace)
        np.testing.assert_array_equal(
            dictionary.mean_shape, normalise(aligned.mean).points
        )
        i, j = EDGES.T
        lengths = np.linalg.norm(
            shapes.as_columns()[:, :, i] - shapes.as_columns()[:, :, j], axis=1
        )
        np.testing.assert_allclose(dictionary.edge_length, lengths.mean(axis=0))

    def test_the_provenance_says_where_it_comes_from(self, make, shapes, tmp_path):
        provenance = make(shapes, beta=0.2, **LEARNED)[0].provenance
        assert provenance["version"] == __version__
        assert provenance["method"] == "sparse-coding"
        assert json.loads(provenance["config"])["beta"] == 0.2
        source = tmp_path / "shapes.h5"
        assert json.loads(provenance["inputs"]) == {str(source): digest(source)}

    def test_the_file_is_written_last(self, shapes, tmp_path):
        write_shapes(tmp_path / "shapes.h5", shapes)
        output = tmp_path / "dict.h5"
        keys = {"shapes": str(tmp_path / "shapes.h5"), "output": str(output), **LEARNED}
        learning = run(LearnDictConfig(**keys))
        before = [next(learning) for _ in range(7)]
        assert not any(outcome.written for outcome in before)
        assert not output.exists()
        assert "reconstruction error" in before[-1].rows[0][1]
        assert next(learning).written == (output,)
        assert output.exists()

    def test_sizes_are_in_the_unit_of_the_shapes(self, make, models):
        dictionary, _ = make(models, **LEARNED)
        assert dictionary.unit == "m"
        assert dictionary.atom_items is None
        normalised = normalise(models.as_columns())
        *_, learned = learn_atoms(
            generalised_procrustes(normalised.points).shapes, 4, 0.1, iterations=5
        )
        grown = dictionary.atom_scale * std(dictionary.atoms)
        share = learned.coefficients / learned.coefficients.sum(axis=0)
        np.testing.assert_allclose(grown, share.T @ normalised.scale, rtol=1e-12)


class TestExemplars:
    def test_every_normalised_model_is_an_atom(self, make, models):
        dictionary, outcomes = make(models, align="none", **EXEMPLARS)
        normalised = normalise(models.as_columns())
        np.testing.assert_array_equal(dictionary.atoms, normalised.points)
        np.testing.assert_array_equal(dictionary.atom_scale, normalised.scale)
        mean = normalise(normalised.points.mean(axis=0)).points
        np.testing.assert_array_equal(dictionary.mean_shape, mean)
        assert dictionary.atom_items == models.items
        np.testing.assert_array_equal(dictionary.edges, models.edges)
        np.testing.assert_array_equal(dictionary.mesh_faces, FACES)
        assert warnings(outcomes) == []
        assert dictionary.provenance["method"] == "exemplars"

    def test_models_are_turned_onto_each_other_with_their_meshes(self, make, models):
        dictionary, _ = make(models, align="all", **EXEMPLARS)
        alignment = generalised_procrustes(normalise(models.as_columns()).points)
        np.testing.assert_array_equal(dictionary.atoms, alignment.shapes)
        middle = models.as_columns().mean(axis=2, keepdims=True)
        turned = alignment.rotations @ (models.mesh_vertices.swapaxes(1, 2) - middle)
        metric = dictionary.atom_scale[:, None, None] * dictionary.mesh_vertices
        np.testing.assert_allclose(metric, turned, atol=1e-12)


class TestPcaBases:
    """Components of each sequence one after another, and the mean pose."""

    def test_are_those_of_each_aligned_sequence(self, make, shapes):
        dictionary, _ = make(shapes, method="pca-bases")
        aligned = generalised_procrustes(normalise(shapes.as_columns()).points)
        parts = aligned.shapes[:10], aligned.shapes[10:]
        expected = np.concatenate([principal_components(part) for part in parts])
        np.testing.assert_array_equal(dictionary.atoms, expected)
        np.testing.assert_array_equal(
            dictionary.mean_shape, normalise(aligned.mean).points
        )
        assert dictionary.objective_trace.size == 0

    def test_need_motion_beyond_rounding(self, make, shapes):
        of_sequence = np.array(
            [shapes.sequences.index(name) for name in shapes.sequences]
        )
        still = shapes.as_columns()[of_sequence].astype(np.float32).astype(np.float64)
        with pytest.raises(
            InputError, match=r"shapes: .* all alike; give sequences that move"
        ):
            make(shapes.replaced(shapes=still.swapaxes(1, 2)), method="pca-bases")


class TestPrior:
    @pytest.mark.parametrize(
        ("prior", "message"),
        [
            (
                {"components": 31},
                "prior.components: 31 components are more than the 30 shapes",
            ),
            (
                {"components": 1, "bone_scale": 0.1},
                "prior: 0 edges of 5 landmarks are not a tree; give shapes",
            ),
        ],
    )
    def test_what_is_refused(self, make, shapes, prior, message):
        with pytest.raises(InputError, match=message):
            make(shapes.replaced(edges=None), prior=prior, **EXEMPLARS)

    def test_shapes_stay_unturned_where_bones_vary(self, make, models):
        models, none = (
            models.replaced(edges=np.array([[0, 1], [0, 2], [0, 3], [0, 4]])),
            "none",
        )
        priors = [{"components": 1, "bone_scale": scale} for scale in (0, 1e-9)]
        a, b = (
            make(models, align=none, prior=prior, **EXEMPLARS)[0].prior
            for prior in priors
        )
        np.testing.assert_allclose(a.means, b.means, atol=1e-6)

    @pytest.mark.parametrize(("number", "components"), [(20, 1), (300, 2)])
    def test_a_component_for_every_150_shapes(self, make, rng, number, components):
        points = rng.normal(size=(number, 3, 5))
        many = Shapes(
            points.swapaxes(1, 2),
            landmark_names=tuple("abcde"),
            items=tuple(f"pose {i}" for i in range(number)),
        )
        made, outcomes = make(many, prior={"components": "auto"}, k=4, iterations=2)
        assert len(made.prior) == components
        notes = [outcome.note for outcome in outcomes if outcome.unit == "round"]
        of_prior = [note for note in notes if note.startswith("prior")]
        assert len(notes) - len(of_prior) == 2
        assert of_prior[0].endswith("round 1")


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
        points = shapes.as_columns().copy()
        points[4] = points[4, :, :1]
        dictionary, outcomes = make(
            shapes.replaced(shapes=points.swapaxes(1, 2)), **FEW
        )
        assert failures(outcomes) == {
            "item4": "all its landmarks are at one point, or not finite"
        }
        expected, _ = make(shapes.take(np.arange(30) != 4), **FEW)
        np.testing.assert_array_equal(dictionary.atoms, expected.atoms)
        with pytest.raises(InputError, match="29 shapes"):
            make(shapes.replaced(shapes=points.swapaxes(1, 2)), k=30)

    def test_no_shape_that_can_be_used(self, make, shapes):
        points = np.repeat(shapes.as_columns()[:, :, :1], 5, axis=2)
        with pytest.raises(
            InputError, match=r"0 shapes.*; item0, for one: all its landmarks are"
        ):
            make(shapes.replaced(shapes=points.swapaxes(1, 2)), k=1)


PARTNERS = np.array([1, 0, 3, 2, 4])
PLAIN = {"method": "exemplars", "align": "none"}


@pytest.fixture
def faces(rng):
    """Six lopsided shapes: two pairs, left and right along z, and a point between."""
    half = np.array([[0.5, 0.2, 2.0], [-0.8, 1.0, 1.0]]).T
    middle = np.array([[0.0, -0.5, 0.0]]).T
    points = np.concatenate([half, half * [[1], [1], [-1]], middle], axis=1)[
        :, [0, 2, 1, 3, 4]
    ]
    return Shapes(
        (points + 0.1 * rng.standard_normal((6, 3, 5))).swapaxes(1, 2),
        landmark_names=("left eye", "right eye", "left ear", "right ear", "nose"),
        items=tuple(f"face{i}" for i in range(6)),
        mirror_index=PARTNERS,
    )


class TestMirror:
    def test_atoms_are_the_shapes_and_their_mirror_images(self, make, faces):
        dictionary, outcomes = make(faces, mirror=True, **PLAIN)
        plain = normalise(faces.as_columns()).points
        np.testing.assert_array_equal(dictionary.atoms[:6], plain)
        np.testing.assert_allclose(
            dictionary.atoms[6:], mirror(plain, PARTNERS, 2), atol=1e-14
        )
        np.testing.assert_allclose(dictionary.atom_scale[6:], dictionary.atom_scale[:6])
        np.testing.assert_allclose(
            mirror(dictionary.mean_shape, PARTNERS, 2),
            dictionary.mean_shape,
            atol=1e-14,
        )
        assert outcomes[0].note == "12 shapes"
        rest, _ = make(faces.take([0, 1, 3, 4, 5]), mirror=True, **PLAIN)
        left = dictionary.without("face2")
        np.testing.assert_allclose(left.atoms, rest.atoms, atol=1e-14)
        assert left.atom_items == rest.atom_items

    def test_meshes_are_left_out(self, make, faces, rng):
        meshed = faces.replaced(
            mesh_vertices=rng.normal(size=(6, 3, 4)).swapaxes(1, 2), mesh_faces=FACES
        )
        dictionary, _ = make(meshed, mirror=True, **PLAIN)
        assert dictionary.mesh_vertices is None
        assert dictionary.mesh_faces is None
        assert make(meshed, **PLAIN)[0].mesh_vertices.shape == (6, 3, 4)

    @pytest.mark.parametrize(
        "index",
        [None, [1, 2, 0, 3, 4], [1, 0, 3, 5, 4], [0, 1, 2, 3, 4]],
        ids=["absent", "cycle", "too high", "nobody has a partner"],
    )
    def test_an_index_that_pairs_nothing_is_refused(self, make, faces, index):
        wrong = None if index is None else np.array(index)
        with pytest.raises(InputError, match="does not pair landmarks; name each"):
            make(faces.replaced(mirror_index=wrong), mirror=True, **PLAIN)

    def test_pairs_of_the_config_are_those_of_the_file(self, make, faces):
        names = faces.landmark_names
        pairs = {names[0]: names[1], names[2]: names[3]}
        expected, _ = make(faces, mirror=True, **PLAIN)
        named, _ = make(faces.replaced(mirror_index=None), mirror=pairs, **PLAIN)
        np.testing.assert_array_equal(named.atoms, expected.atoms)
        np.testing.assert_array_equal(named.mirror_index, PARTNERS)
        with pytest.raises(InputError, match="name each landmark of a pair once"):
            make(faces, mirror={names[0]: names[1], names[4]: names[1]}, **PLAIN)


@pytest.mark.real_data
def test_the_protocol_on_motion_capture(real_data: Path, tmp_path):
    """Every third frame of each sequence: 3,359 shapes."""
    source = real_data / "mocap" / "subject86_24fps.h5"
    config = LearnDictConfig(
        shapes=str(source), output=str(tmp_path / "dict.h5"), every=3
    )
    outcomes = list(run(config))
    dictionary = read_dictionary(config.output)
    assert outcomes[0].note == "3359 shapes"
    assert (np.diff(dictionary.objective_trace) < 0).all()
    assert len(dictionary.objective_trace) == 31
    assert "reconstruction error 2." in outcomes[-2].rows[0][1]
    # The mean stands as the first shape does: no turn brings one nearer to the other.
    first = normalise(read_shapes(config.shapes).as_columns()[0]).points
    np.testing.assert_allclose(
        rotation_onto(first, dictionary.mean_shape), np.eye(3), atol=1e-6
    )
