"""Many files that appear together, or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path, PurePosixPath

import pytest

from shapefit.errors import InputError
from shapefit.io.atomic_folder import staged_files


def put(files, name, text):
    files.write(PurePosixPath(name), lambda path: path.write_text(text))


def content(folder):
    """Return path -> text of every file below, hidden ones too."""
    return {
        str(Path(root, name).relative_to(folder)): Path(root, name).read_text()
        for root, _, names in os.walk(folder)
        for name in names
    }


@pytest.mark.parametrize("exists", [False, True])
def test_files_appear_when_all_are_complete(tmp_path, exists):
    folder = tmp_path / "out"
    if exists:
        folder.mkdir()
        (folder / "a.txt").write_text("old")
        (folder / "other.txt").write_text("stays")
    before = content(folder)
    with staged_files(folder) as files:
        put(files, "a.txt", "new")
        put(files, "sub/sub/b.txt", "b")
        assert {name: text for name, text in content(folder).items() if "partial" not in name} == (
            before
        )
        assert PurePosixPath("sub/sub/b.txt") in files
        assert PurePosixPath("b.txt") not in files
        assert PurePosixPath("other.txt") not in files
        # on the file system of the folder, whose neighbours may not be writable
        (staging,) = (path for path in tmp_path.rglob("*.partial"))
        assert staging.parent == (folder if exists else tmp_path)
        assert content(staging) == {"a.txt": "new", "sub/sub/b.txt": "b"}
    assert content(folder) == before | {"a.txt": "new", "sub/sub/b.txt": "b"}
    assert os.listdir(tmp_path) == ["out"]
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def write(folder, *names, write=lambda path: path.write_text(path.name), error=None):
    """Write files to a folder, then raise the error if there is one."""
    with staged_files(folder) as files:
        for name in names:
            files.write(PurePosixPath(name), write)
        if error is not None:
            raise error


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize("exists", [False, True])
def test_an_error_leaves_everything_as_it_was(tmp_path, exists, error):
    folder = tmp_path / "out"
    if exists:
        folder.mkdir()
        (folder / "a.txt").write_text("old")
    with pytest.raises(error):
        write(folder, "a.txt", "sub/b.txt", error=error())
    assert content(tmp_path) == ({"out/a.txt": "old"} if exists else {})
    assert os.listdir(tmp_path) == (["out"] if exists else [])


def test_a_name_that_comes_twice_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"sub/a\.txt: two items have this file name"):
        write(tmp_path, "sub/a.txt", "sub/a.txt")
    assert content(tmp_path) == {}


def test_a_full_disk_is_an_input_error_that_names_the_file(tmp_path):
    def fill(path):
        path.write_text("begun")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(InputError, match=r"a\.txt: cannot be written: No space left"):
        write(tmp_path, "a.txt", write=fill)
    assert os.listdir(tmp_path) == []


def test_a_folder_in_the_place_of_a_file_is_an_input_error(tmp_path):
    (tmp_path / "a.txt" / "deep").mkdir(parents=True)
    with pytest.raises(InputError, match=r"a\.txt: cannot be written: Is a directory"):
        write(tmp_path, "a.txt")
    assert os.listdir(tmp_path) == ["a.txt"]


def test_files_and_folders_have_the_usual_permissions(tmp_path):
    with staged_files(tmp_path / "out") as files:
        put(files, "sub/a.txt", "a")
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain.txt").touch()
    for made, usual in (("out", "plain"), ("out/sub", "plain"), ("out/sub/a.txt", "plain.txt")):
        assert (tmp_path / made).stat().st_mode == (tmp_path / usual).stat().st_mode
