"""`learn-dict` with `batch`: what it writes beside the run on all shapes, refuses, and holds."""

import errno
import os
import re
import subprocess
import sys
import tracemalloc
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import LearnDictConfig
from shapefit.errors import InputError
from shapefit.io import columns, open_shapes, read_dictionary, read_shapes, write_shapes
from shapefit.io import memory as free_memory
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.learn_dict.batches import find_training_batches
from tests.pipelines.told import failures, texts

MIRROR = {f"r{name}": f"l{name}" for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")}


@pytest.fixture(autouse=True)
def _on_the_disk(monkeypatch):
    """Let shapes go to the disk that would all be in memory, as few as they are."""
    monkeypatch.setattr(columns, "MOST_HELD", 40_000)


@pytest.fixture
def people(project):
    """The 1,920 shapes of the sample data, in sequences."""
    return read_shapes([project / "sample_data/people_train.h5"])


@pytest.fixture
def learned(tmp_path):
    """Return a function that learns from shapes; it gives the outcomes and the dictionary."""

    def run(*shapes, **changes):
        paths = [tmp_path / f"train{number}.h5" for number in range(len(shapes))]
        for path, some in zip(paths, shapes, strict=True):
            write_shapes(path, some)
        output = tmp_path / "dict.h5"
        settings = {"shapes": [str(path) for path in paths], "output": str(output), "k": 16}
        outcomes = list(learn_dict.run(LearnDictConfig(**settings | changes)))
        return outcomes, read_dictionary(output)

    return run


def same_bits(one, other):
    """Tell whether two dictionaries are equal but for their provenance."""
    pairs = (
        (getattr(one, each.name), getattr(other, each.name))
        for each in fields(one)
        if each.name != "provenance"
    )
    return all(np.array_equal(a, b) if a is not None else b is None for a, b in pairs)


WAYS = {
    "plain": {},
    "torso": {"align": ["neck", "rhip", "lhip"]},
    "unturned": {"align": "none"},
    "thinned": {"every": {"walk*": 3, "*": 2}},
    "symmetrised": {"symmetry": "symmetrise", "mirror": MIRROR},
    "doubled": {"symmetry": "double", "mirror": MIRROR, "every": 2},
}


@pytest.mark.parametrize("changes", WAYS.values(), ids=WAYS)
def test_a_dictionary_is_as_good_and_holds_the_same(learned, people, changes):
    outcomes, whole = learned(people, **changes)
    batched, found = learned(people, batch=130, **changes)
    assert batched[0].note == outcomes[0].note
    assert found.objective_trace[-1] <= 1.01 * whole.objective_trace[-1]
    assert (np.diff(found.objective_trace) <= 1e-12 * found.objective_trace[0]).all()
    for name in ("acceleration", "edge_give", "edge_length", "edge_covariance"):
        np.testing.assert_allclose(getattr(found, name), getattr(whole, name), rtol=1e-10)
    np.testing.assert_allclose(found.mean_shape, whole.mean_shape, atol=1e-4)
    np.testing.assert_array_equal(found.mirror_index, whole.mirror_index)
    np.testing.assert_array_equal(found.edges, whole.edges)
    assert found.atom_scale.mean() == pytest.approx(whole.atom_scale.mean(), rel=0.05)
    for name in ("landmark_names", "unit", "frame_rate"):
        assert getattr(found, name) == getattr(whole, name)
    np.testing.assert_allclose(found.atoms.mean(axis=-1), 0, atol=1e-14)
    assert texts(batched) == texts(outcomes) == []


def test_the_last_note_is_about_all_shapes(learned, people):
    outcomes, found = learned(people, batch=500)
    (objective,) = re.findall(r"^objective (\S+),", outcomes[-1].note)
    assert float(objective) == pytest.approx(found.objective_trace[-1], rel=1e-5)
    (gap,) = re.findall(r"relative gap of the coding at most (\S+), ", outcomes[-1].note)
    assert 0 <= float(gap) < 1e-10
    notes = [outcome.note for outcome in outcomes]
    assert sum(note.startswith("sample of 500 shapes, objective ") for note in notes) == 15


def test_one_batch_is_all_shapes_at_once(learned, people):
    assert same_bits(learned(people, batch=len(people))[1], learned(people)[1])


def test_a_sample_of_all_that_are_kept_needs_no_further_rounds(learned, people):
    outcomes, found = learned(people, batch=1000, every=2)
    assert sum(outcome.note.startswith("objective ") for outcome in outcomes) == 1
    _, whole = learned(people, every=2)
    np.testing.assert_allclose(found.objective_trace, whole.objective_trace, rtol=1e-4)


class TestSameBits:
    def test_twice(self, learned, people):
        assert same_bits(learned(people, batch=300)[1], learned(people, batch=300)[1])

    def test_from_several_files(self, learned, people):
        _, one = learned(people, batch=300)
        _, two = learned(people.take(slice(0, 700)), people.take(slice(700, None)), batch=300)
        assert same_bits(one, two)

    def test_whatever_the_number_of_threads(self, people, project, tmp_path):
        found = []
        for number in ("1", "3"):
            output = tmp_path / f"{number}.h5"
            command = [str(Path(sys.executable).with_name("shapefit")), "learn-dict", "-q"]
            command += [
                "-o",
                str(output),
                str(project / "sample_data/people_train.h5"),
                "--set=batch=700",
            ]
            threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), number)
            subprocess.run([*command, "--set=k=16"], check=True, env=os.environ | threads)
            found.append(read_dictionary(output))
        assert same_bits(*found)


class TestBadShapes:
    def test_one_point_is_left_out_and_named(self, learned, people):
        points = people.shapes.copy()
        points[1234] = points[1234, :, :1]
        outcomes, found = learned(people.replaced(shapes=points), batch=300)
        item = people.items[1234]
        assert failures(outcomes) == {item: "all its landmarks are at one point"}
        _, expected = learned(people.take(np.arange(1920) != 1234), batch=300)
        assert found.objective_trace[-1] == pytest.approx(expected.objective_trace[-1], rel=1e-3)

    def test_nan_is_an_error_of_its_row(self, learned, people, tmp_path):
        import h5py

        learned(people)
        with h5py.File(tmp_path / "train0.h5", "r+") as file:
            file["shapes"][1234, 2, 1] = np.nan
        config = LearnDictConfig(
            shapes=str(tmp_path / "train0.h5"), output=str(tmp_path / "d.h5"), k=16, batch=300
        )
        with pytest.raises(InputError, match=r"train0\.h5:/shapes\[1234\]"):
            list(learn_dict.run(config))

    def test_none_that_can_be_used(self, learned, people):
        points = np.zeros_like(people.shapes)
        with pytest.raises(InputError, match=r"0 shapes.*, for one: all its landmarks are"):
            learned(people.replaced(shapes=points), batch=300)

    def test_fewer_than_atoms(self, learned, people):
        few = people.take(slice(0, 20))
        points = few.shapes.copy()
        points[:9] = 0
        with pytest.raises(InputError, match=r"k: 16 atoms .* 11 shapes .*; lower k"):
            learned(few.replaced(shapes=points), batch=17)


class TestRefusals:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"k": 301}, "300 shapes are fewer than the 301 atoms"),
            ({"prior": {"components": 2}}, "learned from all shapes at once; leave out `batch`"),
        ],
        ids=["atoms", "prior"],
    )
    def test_by_the_config(self, settings, message):
        with pytest.raises(ValueError, match=message):
            LearnDictConfig(**{"shapes": "-", "output": "d.h5", "batch": 300} | settings)

    def test_what_does_not_fit_is_told_of_batch(self, learned, people, monkeypatch):
        monkeypatch.setattr(free_memory, "ALWAYS_FITS", 0)
        monkeypatch.setattr(free_memory, "free_memory", lambda: 4_000_000)
        fix = r"train0.h5: .*learning from all shapes at once takes .* MB.*; set `batch`"
        with pytest.raises(InputError, match=fix):
            learned(people)
        learned(people, batch=300)
        learned(people.take(slice(0, 300)))

    def test_a_full_disk(self, learned, people, monkeypatch):
        class Full:
            def __init__(self, *_, **__):
                pass

            def seek(self, _):
                pass

            def write(self, _):
                raise OSError(errno.ENOSPC, "No space left on device")

            def close(self):
                pass

        monkeypatch.setattr(columns, "SpooledTemporaryFile", Full)
        with pytest.raises(InputError, match="used for temporary files: No space left"):
            learned(people, batch=300)


def test_landmarks_are_paired_by_the_file(learned, project):
    cars = read_shapes([project / "sample_data/cars.h5"])
    bare = cars.replaced(mesh_vertices=None, mesh_faces=None)
    settings = {"k": 4, "symmetry": "symmetrise", "align": "none"}
    _, whole = learned(bare, **settings)
    _, found = learned(bare, batch=len(cars) - 1, **settings)
    np.testing.assert_array_equal(found.mirror_index, whole.mirror_index)
    np.testing.assert_allclose(found.mean_shape, whole.mean_shape, atol=1e-12)


def test_meshes_are_left_out_with_a_warning(learned, people):
    mesh = np.repeat(people.shapes[:, :, :4], 2, axis=2)
    faces = np.array([[0, 1, 2]])
    outcomes, found = learned(people.replaced(mesh_vertices=mesh, mesh_faces=faces), batch=300)
    assert found.mesh_vertices is None
    assert found.mesh_faces is None
    assert texts(outcomes) == ["the meshes are left out: leave out `batch` to keep them"]


def test_nothing_is_left_in_the_folder(learned, people, tmp_path):
    learned(people, batch=300)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dict.h5", "train0.h5"]


def test_memory_grows_with_the_batch_alone(people, tmp_path):
    """Four times the shapes in batches of the same size take as much memory, names aside."""

    def peak(count):
        rows = np.arange(count) % len(people)
        path = tmp_path / f"{count}.h5"
        items = tuple(map(str, range(count)))
        write_shapes(path, people.take(rows).replaced(items=items, sequences=None))
        config = LearnDictConfig(
            shapes=str(path), output=str(tmp_path / "d.h5"), k=8, batch=1000, iterations=2
        )
        with open_shapes(config.shapes) as source:
            tracemalloc.start()
            options = learn_dict.plan_training(config)
            training = find_training_batches(source, options)
            list(learn_dict.make_dictionary(training, config, options, {}))
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        return peak

    assert peak(16_000) < 1.05 * peak(4_000)


@pytest.mark.slow
@pytest.mark.real_data
def test_motion_capture_within_a_hundredth(real_data, tmp_path):
    """Subject 86, all 10,067 frames, in batches of a 4th, a 20th and a 100th of them."""
    shapes = str(real_data / "mocap" / "subject86_24fps.h5")
    objectives = []
    for batch in (0, 2517, 504, 101):
        config = LearnDictConfig(shapes=shapes, output=str(tmp_path / "d.h5"), batch=batch)
        list(learn_dict.run(config))
        objectives.append(read_dictionary(config.output).objective_trace[-1])
    assert max(objectives[1:]) <= 1.01 * objectives[0]
