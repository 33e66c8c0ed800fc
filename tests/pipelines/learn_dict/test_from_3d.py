"""`learn-dict` of 3D shapes: what is learned from, atoms by three methods, priors."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit import __version__
from shapefit.config import LearnDictConfig
from shapefit.dictionary.learning import learn_atoms, principal_components
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise, std
from shapefit.geometry.procrustes import generalised_procrustes, rotation_onto
from shapefit.io import (
    digest,
    read_dictionary,
    read_shapes,
    write_shapes,
)
from shapefit.pipelines.learn_dict.from_3d import every_nth
from shapefit.pipelines.learn_dict.run import learn_dictionary as run
from shapefit.records import Shapes
from shapefit.records.columns import in_columns
from tests.pipelines.fitted import failures, warnings
from tests.pipelines.learn_dict.conftest import EDGES, FACES

LEARNED = {"k": 4, "iterations": 5}
EXEMPLARS = {"method": "exemplars"}
FEW = {"k": 6, "iterations": 2}


def aligned(shapes):
    """Return the normalised shapes in their common frame."""
    return generalised_procrustes(normalise(shapes.as_columns()).points)


def assert_mean_is(dictionary, mean):
    assert_array_equal(dictionary.mean_shape, normalise(mean).points)


# Sparse coding


def test_atoms_are_learned_from_normalised_aligned_shapes(make, shapes):
    dictionary, _ = make(shapes, k=6, iterations=4)
    alignment = aligned(shapes)
    *_, expected = learn_atoms(alignment.shapes, 6, 0.1, iterations=4)
    assert_array_equal(dictionary.atoms, expected.atoms)
    assert_array_equal(dictionary.objective_trace, expected.trace)
    assert_mean_is(dictionary, alignment.mean)


def test_a_dictionary_knows_the_mean_lengths_of_edges(make, shapes):
    dictionary, _ = make(shapes, **FEW)
    i, j = EDGES.T
    edges = shapes.shapes[:, i] - shapes.shapes[:, j]
    lengths = np.linalg.norm(edges, axis=2)
    assert_allclose(dictionary.edge_length, lengths.mean(axis=0))


def test_the_provenance_says_where_it_comes_from(make, shapes, tmp_path):
    source = tmp_path / "shapes.h5"
    dictionary, _ = make(shapes, beta=0.2, **LEARNED)
    provenance = dictionary.provenance
    config = json.loads(provenance["config"])
    assert provenance["version"] == __version__
    assert provenance["method"] == "sparse-coding"
    assert config["beta"] == 0.2
    assert json.loads(provenance["inputs"]) == {str(source): digest(source)}


def test_the_file_is_written_last(shapes, tmp_path):
    source = tmp_path / "shapes.h5"
    output = tmp_path / "dict.h5"
    write_shapes(source, shapes)
    config = LearnDictConfig(shapes=str(source), output=str(output), **LEARNED)
    learning = run(config)
    before = [next(learning) for _ in range(7)]
    for outcome in before:
        assert not outcome.written
    assert not output.exists()
    assert "reconstruction error" in before[-1].rows[0][1]
    assert next(learning).written == (output,)
    assert output.exists()


def test_sizes_are_in_the_unit_of_the_shapes(make, models):
    dictionary, _ = make(models, **LEARNED)
    *_, learned = learn_atoms(aligned(models).shapes, 4, 0.1, iterations=5)
    shares = learned.coefficients / learned.coefficients.sum(axis=0)
    expected = shares.T @ normalise(models.as_columns()).scale
    sizes = dictionary.atom_scale * std(dictionary.atoms)
    assert dictionary.unit == "m"
    assert dictionary.atom_items is None
    assert_allclose(sizes, expected, rtol=1e-12)


# Exemplars


def test_every_normalised_model_is_an_atom(make, models):
    dictionary, outcomes = make(models, align="none", **EXEMPLARS)
    normalised = normalise(models.as_columns())
    assert_array_equal(dictionary.atoms, normalised.points)
    assert_array_equal(dictionary.atom_scale, normalised.scale)
    assert_mean_is(dictionary, normalised.points.mean(axis=0))
    assert warnings(outcomes) == []


def test_exemplars_keep_names_edges_and_faces(make, models):
    dictionary, _ = make(models, align="none", **EXEMPLARS)
    assert dictionary.atom_items == models.items
    assert_array_equal(dictionary.edges, models.edges)
    assert_array_equal(dictionary.mesh_faces, FACES)
    assert dictionary.provenance["method"] == "exemplars"


def test_models_are_turned_onto_each_other_with_their_meshes(make, models):
    dictionary, _ = make(models, align="all", **EXEMPLARS)
    alignment = aligned(models)
    middle = models.shapes.mean(axis=1, keepdims=True)
    vertices = in_columns(models.mesh_vertices - middle)
    in_metres = dictionary.atom_scale[:, None, None] * dictionary.mesh_vertices
    expected = alignment.rotations @ vertices
    assert_array_equal(dictionary.atoms, alignment.shapes)
    assert_allclose(in_metres, expected, atol=1e-12)


# Bases: components of each sequence one after another, and the mean pose


def test_bases_are_those_of_each_aligned_sequence(make, shapes):
    dictionary, _ = make(shapes, method="pca-bases")
    alignment = aligned(shapes)
    walk = principal_components(alignment.shapes[:10])
    run = principal_components(alignment.shapes[10:])
    assert_array_equal(dictionary.atoms, np.concatenate([walk, run]))
    assert_mean_is(dictionary, alignment.mean)
    assert dictionary.objective_trace.size == 0


def test_bases_need_motion_beyond_rounding(make, shapes):
    first_of_sequence = [shapes.sequences.index(name) for name in shapes.sequences]
    still = shapes.shapes[first_of_sequence].astype(np.float32)
    rounded = shapes.replaced(shapes=still.astype(np.float64))
    fault = r"shapes: .* all alike; give sequences that move"
    with pytest.raises(InputError, match=fault):
        make(rounded, method="pca-bases")


# The prior

REFUSED_PRIORS = [
    (
        {"components": 31},
        "prior.components: 31 components are more than the 30 shapes",
    ),
    (
        {"components": 1, "bone_scale": 0.1},
        "prior: 0 edges of 5 landmarks are not a tree; give shapes",
    ),
]


@pytest.mark.parametrize(("prior", "message"), REFUSED_PRIORS)
def test_priors_that_are_refused(make, shapes, prior, message):
    with pytest.raises(InputError, match=message):
        make(shapes.replaced(edges=None), prior=prior, **EXEMPLARS)


def test_shapes_stay_unturned_where_bones_vary(make, models):
    tree = models.replaced(edges=np.array([[0, 1], [0, 2], [0, 3], [0, 4]]))
    means = []
    for bone_scale in (0, 1e-9):
        prior = {"components": 1, "bone_scale": bone_scale}
        dictionary, _ = make(tree, align="none", prior=prior, **EXEMPLARS)
        means.append(dictionary.prior.means)
    without, with_bones = means
    assert_allclose(without, with_bones, atol=1e-6)


@pytest.mark.parametrize(("count", "components"), [(20, 1), (300, 2)])
def test_a_component_for_every_150_shapes(make, rng, count, components):
    many = Shapes(
        rng.normal(size=(count, 5, 3)),
        landmark_names=tuple("abcde"),
        items=tuple(f"pose {i}" for i in range(count)),
    )
    dictionary, outcomes = make(many, prior={"components": "auto"}, k=4, iterations=2)
    notes = [outcome.note for outcome in outcomes if outcome.unit == "round"]
    of_prior = [note for note in notes if note.startswith("prior")]
    assert len(dictionary.prior) == components
    assert len(notes) - len(of_prior) == 2
    assert of_prior[0].endswith("round 1")


# Every n-th shape


def test_every_nth_counts_within_each_sequence():
    sequences = ("a",) * 4 + ("b",) * 3 + ("a",) * 3
    assert every_nth(sequences, 3) == [0, 3, 4, 9]


def test_the_first_glob_that_fits_a_sequence_counts():
    sequences = ("a_1",) * 4 + ("b_1",) * 3 + ("a_1",) * 3 + ("c",) * 2
    globs = {"a_*": 3, "*_1": 2}
    assert every_nth(sequences, globs) == [0, 3, 4, 6, 9, 10, 11]


def test_the_rest_is_not_learned_from(make, shapes):
    retained = [0, 3, 6, 9, 10, 13, 16, 19, 22, 25, 28]
    thinned, _ = make(shapes, every=3, **FEW)
    expected, _ = make(shapes.take(retained), **FEW)
    assert_array_equal(thinned.atoms, expected.atoms)


def test_bones_bend_as_in_all_shapes(make, shapes):
    thinned, _ = make(shapes, every=3, **FEW)
    whole, _ = make(shapes, **FEW)
    assert_array_equal(thinned.bone_tolerance, whole.bone_tolerance)


# The number of shapes


def test_few_shapes_lower_the_atoms(make, shapes):
    dictionary, _ = make(shapes, iterations=1)
    assert dictionary.k == 30


def test_more_atoms_than_shapes_are_refused_where_they_are_set(make, shapes):
    with pytest.raises(InputError, match="64 atoms are more than the 30 shapes"):
        make(shapes, k=64)


@pytest.mark.parametrize("method", ["exemplars", "pca-bases"])
def test_atoms_that_are_not_coded_are_not_counted(make, shapes, method):
    """k is that of sparse coding alone."""
    dictionary, _ = make(shapes, method=method, k=64)
    expected, _ = make(shapes, method=method)
    assert_array_equal(dictionary.atoms, expected.atoms)


@pytest.fixture
def with_a_point(shapes):
    """The shapes, of which the fifth has all landmarks at one point."""
    points = shapes.shapes.copy()
    points[4] = points[4, :1]
    return shapes.replaced(shapes=points)


def test_shapes_of_one_point_are_left_out(make, shapes, with_a_point):
    dictionary, outcomes = make(with_a_point, **FEW)
    expected, _ = make(shapes.take(np.arange(30) != 4), **FEW)
    reason = "all its landmarks are at one point, or not finite"
    assert failures(outcomes) == {"item4": reason}
    assert_array_equal(dictionary.atoms, expected.atoms)


def test_shapes_of_one_point_are_not_counted(make, with_a_point):
    with pytest.raises(InputError, match="29 shapes"):
        make(with_a_point, k=30)


def test_no_shape_that_can_be_used(make, shapes):
    points = np.repeat(shapes.shapes[:, :1], 5, axis=1)
    fault = r"0 shapes.*; item0, for one: all its landmarks are"
    with pytest.raises(InputError, match=fault):
        make(shapes.replaced(shapes=points), k=1)


@pytest.mark.real_data
def test_the_protocol_on_motion_capture(real_data: Path, tmp_path):
    """Every third frame of each sequence: 3,359 shapes. The mean stands as the first
    shape does: no turn brings one nearer to the other.
    """
    source = str(real_data / "mocap" / "subject86_24fps.h5")
    output = str(tmp_path / "dict.h5")
    config = LearnDictConfig(shapes=source, output=output, every=3)
    outcomes = list(run(config))
    dictionary = read_dictionary(config.output)
    first = normalise(read_shapes(config.shapes).as_columns()[0]).points
    turn = rotation_onto(first, dictionary.mean_shape)
    assert outcomes[0].note == "3359 shapes"
    assert (np.diff(dictionary.objective_trace) < 0).all()
    assert len(dictionary.objective_trace) == 31
    assert "reconstruction error 2." in outcomes[-2].rows[0][1]
    assert_allclose(turn, np.eye(3), atol=1e-6)
