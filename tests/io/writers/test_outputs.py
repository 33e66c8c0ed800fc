"""Files in metres appear all together or not at all, and only where they can be written."""

import errno
import os

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.formats import record_writer
from shapefit.io.layout import RESULTS
from shapefit.io.options import OutputOptions
from shapefit.io.writers import tables
from shapefit.io.writers.motion import MOST_GAPS, find_motions, motion_output
from tests.io.files import save


@pytest.fixture
def several(scene):
    """A result of two individuals, two frames each."""
    return scene.result.replaced(
        items=("a/0", "a/1", "b/0", "b/1"),
        sequences=("a", "a", "b", "b"),
        further=scene.result.further | {"frame": np.array([0, 1, 0, 1])},
    )


def test_nothing_appears_before_all_is_written(tmp_path, several):
    with record_writer(tmp_path / "man.trc", RESULTS) as writer:
        writer.append(several)
        assert not list(tmp_path.iterdir())
    assert sorted(os.listdir(tmp_path)) == [
        f"man_{name}{end}" for name in "ab" for end in (".trc", "_angles.csv")
    ]


@pytest.mark.parametrize("one", [True, False])
def test_after_an_error_earlier_files_stand_alone(tmp_path, several, one):
    record = several.take([0, 1]) if one else several
    earlier = ["man.trc", "man_a.trc"]
    for name in earlier:
        (tmp_path / name).write_text("old")

    def fail() -> None:
        with record_writer(tmp_path / "man.trc", RESULTS) as writer:
            writer.append(record)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert sorted(os.listdir(tmp_path)) == earlier
    assert {(tmp_path / name).read_text() for name in earlier} == {"old"}


@pytest.mark.parametrize("one", [True, False])
def test_a_full_disk(tmp_path, several, one, monkeypatch, problems):
    record = several.take([0, 1]) if one else several
    (tmp_path / "man.trc").write_text("old")
    (tmp_path / "man_a.trc").write_text("old")
    original = tables.write_trc

    def fill(path, motion):
        original(path, motion)
        if one or motion.name == "b":
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tables, "trc_output", motion_output(fill))
    (line,) = problems(save, tmp_path / "man.trc", record)
    assert "cannot be written: No space left on device; free some space" in line
    assert sorted(os.listdir(tmp_path)) == ["man.trc", "man_a.trc"]
    assert (tmp_path / "man_a.trc").read_text() == "old"


def test_a_folder_in_the_way(tmp_path, several, problems):
    (tmp_path / "man_b.trc").mkdir()
    (line,) = problems(save, tmp_path / "man.trc", several)
    assert line.startswith(f"{tmp_path / 'man_b.trc'}: it is a folder")
    assert os.listdir(tmp_path) == ["man_b.trc"]


def test_names_that_no_file_can_have(tmp_path, several):
    odd = several.replaced(sequences=("a:b", "a:b", "../c", "../c"))
    written = save(tmp_path / "man.trc", odd).written
    assert [path.name for path in written[::2]] == ["man_a%3Ab.trc", "man_.._c.trc"]
    assert all(path.is_file() for path in written)


def test_options_for_metres_need_such_a_format(tmp_path, scene):
    with pytest.raises(InputError, match="height: an HDF5 file keeps the unit and the axes"):
        record_writer(tmp_path / "man.h5", RESULTS, options=OutputOptions(height=1.8))


def test_names_of_files_have_no_spaces(tmp_path, several):
    record = several.replaced(sequences=("a b", "a b", "a_b", "a_b"))
    written = [path.name for path in save(tmp_path / "man.trc", record).written]
    assert written[::2] == ["man_a_b.trc", "man_a_b_2.trc"]
    assert sorted(os.listdir(tmp_path)) == sorted(written)


def test_items_of_no_sequence_are_no_motion(tmp_path, several, problems):
    (line,) = problems(save, tmp_path / "man.trc", several.replaced(sequences=None))
    assert "a/0, a/1, b/0, b/1 belong to no sequence: they are no motion; read them with" in line


@pytest.mark.parametrize(("last", "refused"), [(2 * MOST_GAPS - 1, False), (2 * MOST_GAPS, True)])
def test_frames_too_far_apart_are_no_sequence(scene, problems, last, refused):
    frames = np.array([0, last])
    two = scene.result.take([0, 1])
    two = two.replaced(further={**two.further, "frame": frames}, sequences=("walk", "walk"))
    if refused:
        (line,) = problems(find_motions, two, OutputOptions(), "man.trc")
        assert f"there are 2 items in {last + 1} frames" in line
    else:
        (motion,) = find_motions(two, OutputOptions(), "man.trc")
        assert len(motion.points) == last + 1
