"""A file for each sequence: all appear or none."""

import errno
import os

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError
from shapefit.io.formats import record_writer
from shapefit.io.layout import RESULTS
from shapefit.io.options import OutputOptions
from shapefit.io.writers import tables
from shapefit.records import Fit
from tests.io.files import save
from tests.io.writers.conftest import parse_trc


@pytest.fixture
def several(scene) -> Fit:
    """A result of two individuals, two frames each."""
    return scene.result.replaced(
        items=("a/0", "a/1", "b/0", "b/1"),
        sequences=("a", "a", "b", "b"),
        frames=np.array([0, 1, 0, 1]),
    )


# Files


@pytest.fixture
def target(tmp_path):
    return tmp_path / "man.trc"


def test_nothing_appears_before_all_is_written(tmp_path, target, several):
    with record_writer(target, RESULTS) as writer:
        writer.append(several)
        assert not list(tmp_path.iterdir())
    expected = [f"man_{name}{end}" for name in "ab" for end in (".trc", "_angles.csv")]
    written = parse_trc(tmp_path / "man_b.trc")
    assert sorted(os.listdir(tmp_path)) == expected
    assert_array_equal(written.frames, [0, 1])


ONE_SEQUENCE = [0, 1]


TWO_SEQUENCES = [0, 1, 2, 3]
"""Rows of `several`."""


@pytest.fixture
def earlier_files(tmp_path):
    """Files of an earlier run: name -> text."""
    files = {"man.trc": "old", "man_a.trc": "old"}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return files


@pytest.fixture
def fail_after_writing(monkeypatch):
    """Let this error follow the file of the last sequence."""

    def patch(error, last_sequence):
        original = tables.write_trc

        def write_and_fail(path, motion):
            original(path, motion)
            if motion.name == last_sequence:
                raise error

        monkeypatch.setattr(tables, "write_trc", write_and_fail)

    return patch


@pytest.mark.parametrize(("rows", "last"), [(ONE_SEQUENCE, "a"), (TWO_SEQUENCES, "b")])
def test_after_a_full_disk_earlier_files_stand_alone(
    tmp_path, target, several, earlier_files, fail_after_writing, rows, last
):
    full = OSError(errno.ENOSPC, "No space left on device")
    fail_after_writing(full, last)
    fault = "cannot be written: No space left on device; free"
    with pytest.raises(InputError, match=fault):
        save(target, several.take(rows))
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == earlier_files


@pytest.mark.parametrize(("rows", "last"), [(ONE_SEQUENCE, "a"), (TWO_SEQUENCES, "b")])
def test_after_an_internal_error_earlier_files_stand_alone(
    tmp_path, target, several, earlier_files, fail_after_writing, rows, last
):
    fail_after_writing(ZeroDivisionError(), last)
    with pytest.raises(ZeroDivisionError):
        save(target, several.take(rows))
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == earlier_files


def test_a_folder_in_the_way(tmp_path, target, several, problems):
    folder = tmp_path / "man_b.trc"
    folder.mkdir()
    (line,) = problems(save, target, several)
    assert line.startswith(f"{folder}: it is a folder")
    assert os.listdir(tmp_path) == ["man_b.trc"]


FILES_OF_SEQUENCES = [
    ("film/anna", "film/person 2", ["man_anna.trc", "man_person_2.trc"]),
    ("film", "film/b", ["man_film.trc", "man_film_b.trc"]),
    ("a:b", "../c", ["man_a%3Ab.trc", "man_.._c.trc"]),
    ("a b", "a_b", ["man_a_b.trc", "man_a_b_2.trc"]),
]
"""Two sequences, and the names of their files."""


@pytest.mark.parametrize(("one", "other", "names"), FILES_OF_SEQUENCES)
def test_files_are_named_after_sequences(tmp_path, target, several, one, other, names):
    record = several.replaced(sequences=(one, one, other, other))
    written = save(target, record).written
    trc_files = [path.name for path in written if path.suffix == ".trc"]
    assert trc_files == sorted(names)
    assert sorted(tmp_path.iterdir()) == sorted(written)


def test_an_ending_of_two_parts_stays_whole_behind_the_sequences(tmp_path, several):
    written = save(tmp_path / "man.METRES.csv", several).written
    names = sorted(path.name for path in written)
    assert names == ["man_a.METRES.csv", "man_b.METRES.csv"]


def test_options_for_metres_need_such_a_format(tmp_path):
    options = OutputOptions(height=1.8)
    fault = "height: an HDF5 file keeps the unit and the axes"
    with pytest.raises(InputError, match=fault):
        record_writer(tmp_path / "man.h5", RESULTS, options=options)


@pytest.mark.parametrize("sequences", [("a",) * 4, None])
def test_two_items_of_one_frame(tmp_path, target, several, problems, sequences):
    record = several.replaced(sequences=sequences)
    (line,) = problems(save, target, record)
    assert "man.trc: 'a/0' and 'b/0' are of one frame" in line
    assert line.endswith("give each individual a sequence of its own")
    assert not list(tmp_path.iterdir())
