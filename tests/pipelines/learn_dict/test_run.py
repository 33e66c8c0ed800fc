"""`learn-dict` from files to a file: what is learned from, written, left out and refused."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from shapefit import __version__
from shapefit.config import LearnDictConfig
from shapefit.dictionary.learning import learn, principal_components
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes, rotation_onto
from shapefit.geometry.rotations import random_rotations
from shapefit.io import ShapeSet, digest, read_dictionary, read_shapes, write_shapes
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.learn_dict import training_shapes
from shapefit.pipelines.learn_dict.training_shapes import every_nth
from shapefit.pipelines.outcome import Note
from tests.pipelines.told import failures, warnings

NAMES = ("hip", "neck", "head", "left hand", "right hand")
EDGES = np.array([[0, 1], [1, 2], [1, 3], [1, 4]])


@pytest.fixture
def shapes(rng):
    """30 shapes in two sequences, in metres, differently turned and placed."""
    points = rng.standard_normal((3, 5)) + 0.3 * rng.standard_normal((30, 3, 5))
    points = 0.5 * random_rotations(30, rng) @ points + rng.standard_normal((30, 3, 1))
    return ShapeSet(
        shapes=points,
        landmark_names=NAMES,
        items=tuple(f"item{i}" for i in range(30)),
        sequences=("walk",) * 10 + ("run",) * 20,
        edges=EDGES,
        unit="m",
    )


@pytest.fixture
def config(tmp_path, shapes):
    """Return a function that makes a config; the shapes given stay those of its file."""
    write_shapes(tmp_path / "train.h5", shapes)

    def make(given=None, **changes):
        if given is not None:
            write_shapes(tmp_path / "train.h5", given)
        settings = {
            "shapes": str(tmp_path / "train.h5"),
            "output": str(tmp_path / "dict.h5"),
        }
        if changes.get("method") != "pca-bases":
            settings |= {"k": 6, "iterations": 4}
        return LearnDictConfig(**settings | changes)

    return make


def learned(config):
    outcomes = list(learn_dict.run(config))
    return outcomes, read_dictionary(config.output)


class TestDictionary:
    def test_is_learned_from_normalised_aligned_shapes(self, config, shapes):
        _, dictionary = learned(config())
        aligned = generalised_procrustes(normalise(shapes.shapes).points)
        *_, expected = learn(aligned.shapes, 6, 0.1, iterations=4)
        np.testing.assert_array_equal(dictionary.atoms, expected.atoms)
        np.testing.assert_array_equal(dictionary.objective_trace, expected.trace)
        np.testing.assert_array_equal(dictionary.mean_shape, normalise(aligned.mean).points)

    def test_knows_how_long_its_edges_were(self, config, shapes):
        i, j = EDGES.T
        lengths = np.linalg.norm(shapes.shapes[:, :, i] - shapes.shapes[:, :, j], axis=1)
        _, dictionary = learned(config())
        np.testing.assert_allclose(dictionary.edge_length, lengths.mean(axis=0))

    def test_says_where_it_comes_from(self, config, tmp_path):
        _, dictionary = learned(made := config(beta=0.2))
        assert dictionary.provenance["version"] == __version__
        assert dictionary.provenance["method"] == "sparse-coding"
        assert dictionary.provenance["config"] == made.as_json()
        source = tmp_path / "train.h5"
        assert json.loads(dictionary.provenance["inputs"]) == {str(source): digest(source)}


class TestAlign:
    def test_a_subset_turns_the_whole_shape(self, config, shapes):
        torso = ("neck", "hip", "head")
        _, dictionary = learned(config(align=list(torso)))
        points = normalise(shapes.shapes).points
        expected = generalised_procrustes(points, [1, 0, 2])
        np.testing.assert_array_equal(dictionary.mean_shape, normalise(expected.mean).points)
        everything = generalised_procrustes(points)
        assert np.abs(expected.mean - everything.mean).max() > 1e-3

    def test_an_unknown_landmark_is_named(self, config):
        with pytest.raises(InputError, match=r"align: .*'nekc'.*'neck'"):
            list(learn_dict.run(config(align=["hip", "nekc", "head"])))


class TestEvery:
    def test_counts_within_each_sequence(self):
        assert every_nth(("a",) * 4 + ("b",) * 3 + ("a",) * 3, 3) == [0, 3, 4, 9]

    def test_the_first_glob_that_fits_a_sequence_counts(self):
        sequences = ("a_1",) * 4 + ("b_1",) * 3 + ("a_1",) * 3 + ("c",) * 2
        globs = {"a_*": 3, "*_1": 2}
        assert every_nth(sequences, globs) == [0, 3, 4, 6, 9, 10, 11]
        assert every_nth(sequences, {"*": 3}) == every_nth(sequences, 3)

    def test_the_rest_is_not_learned_from(self, config, shapes):
        _, thinned = learned(config(every=3))
        _, expected = learned(config(shapes.take([0, 3, 6, 9, 10, 13, 16, 19, 22, 25, 28])))
        np.testing.assert_array_equal(thinned.atoms, expected.atoms)


class TestOutcomes:
    def test_the_file_is_written_last(self, config):
        run = learn_dict.run(made := config())
        *before, last = [next(run) for _ in range(6)]
        assert not any(outcome.written for outcome in before)
        assert not made.output.exists()
        assert next(run).written == (made.output,)
        assert made.output.exists()
        assert "relative error" in last.note

    def test_an_alignment_that_did_not_come_to_rest_is_reported(self, config, monkeypatch):
        hasty = partial(generalised_procrustes, max_rounds=1)
        monkeypatch.setattr(training_shapes, "generalised_procrustes", hasty)
        outcomes, _ = learned(config())
        expected = "the mean of the aligned shapes was still moving after 1 rounds"
        assert warnings(outcomes) == [expected]

    def test_fewer_shapes_than_atoms_lower_their_number_unless_it_is_set(self, config):
        asked = config()
        unset = LearnDictConfig(shapes=str(asked.shapes[0]), output=str(asked.output), iterations=1)
        outcomes, dictionary = learned(unset)
        assert dictionary.k == 30
        assert warnings(outcomes) == ["30 atoms in place of 64: there are 30 shapes"]
        assert isinstance(warnings(outcomes)[0], Note)
        with pytest.raises(InputError, match="64 atoms are more than"):
            learned(config(k=64))


class TestPcaBases:
    """`method: pca-bases`: components of each sequence one after another, and the mean pose."""

    def test_are_those_of_each_aligned_sequence(self, config, shapes):
        _, dictionary = learned(config(method="pca-bases", bases=0.9))
        aligned = generalised_procrustes(normalise(shapes.shapes).points)
        walk = principal_components(aligned.shapes[:10], 0.9)
        run = principal_components(aligned.shapes[10:], 0.9)
        np.testing.assert_array_equal(dictionary.atoms, np.concatenate([walk, run]))
        np.testing.assert_array_equal(dictionary.mean_shape, normalise(aligned.mean).points)
        np.testing.assert_allclose(np.linalg.norm(dictionary.atoms, axis=(1, 2)), 1)
        np.testing.assert_array_equal(dictionary.edges, EDGES)
        assert dictionary.objective_trace.size == 0

    def test_their_number_can_be_given(self, config):
        outcomes, dictionary = learned(config(method="pca-bases", bases=3))
        assert dictionary.k == 6
        notes = ["30 shapes", "3 bases of walk", "3 bases of run", "6 bases"]
        assert [o.note for o in outcomes[:-1]] == notes
        assert [o.done for o in outcomes] == [0, 1, 1, 0, 0]
        assert outcomes[-1].written == (config().output,)

    def test_need_motion_beyond_rounding(self, config, shapes):
        of_sequence = np.array([shapes.sequences.index(name) for name in shapes.sequences])
        still = shapes.shapes[of_sequence].astype(np.float32).astype(np.float64)
        with pytest.raises(InputError, match=r"shapes: .* all alike; give sequences that move"):
            list(learn_dict.run(config(shapes.replaced(shapes=still), method="pca-bases")))


class TestFailures:
    def test_shapes_of_one_point_are_left_out(self, config, shapes):
        points = shapes.shapes.copy()
        points[4] = points[4, :, :1]
        outcomes, dictionary = learned(config(shapes.replaced(shapes=points)))
        assert failures(outcomes) == {"item4": "all its landmarks are at one point"}
        _, expected = learned(config(shapes.take(np.arange(30) != 4)))
        np.testing.assert_array_equal(dictionary.atoms, expected.atoms)


class TestRefusals:
    def test_failed_shapes_do_not_count(self, config, shapes):
        points = shapes.shapes.copy()
        points[4] = 0
        with pytest.raises(InputError, match="29 shapes"):
            list(learn_dict.run(config(shapes.replaced(shapes=points), k=30)))

    def test_no_shape_that_can_be_used(self, config, shapes):
        points = np.repeat(shapes.shapes[:, :, :1], shapes.shapes.shape[2], axis=2)
        with pytest.raises(InputError, match=r"0 shapes.*; item0, for one: all its landmarks are"):
            list(learn_dict.run(config(shapes.replaced(shapes=points), k=1)))


@pytest.mark.real_data
def test_the_protocol_on_motion_capture(real_data: Path, tmp_path):
    """Every third frame of each sequence: 3,359 shapes."""
    config = LearnDictConfig(
        shapes=str(real_data / "mocap" / "subject86_24fps.h5"),
        output=str(tmp_path / "dict.h5"),
        every=3,
    )
    outcomes, dictionary = learned(config)
    assert outcomes[0].note == "3359 shapes"
    assert (np.diff(dictionary.objective_trace) < 0).all()
    assert len(dictionary.objective_trace) == 31
    assert "relative error 0.02" in outcomes[-2].note
    # The mean stands as the first shape does: no turn brings one nearer to the other.
    first = read_shapes(config.shapes).shapes[0]
    first = normalise(first).points
    np.testing.assert_allclose(rotation_onto(first, dictionary.mean_shape), np.eye(3), atol=1e-6)
