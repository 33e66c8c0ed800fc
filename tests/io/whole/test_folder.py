"""Many files that appear together, or not at all."""

import errno
import os
import signal
from pathlib import Path, PurePosixPath

import pytest

from shapefit.errors import InputError
from shapefit.io.whole.folder import staged_files


def put(files, name, text, item=None):
    files.write(PurePosixPath(name), lambda path: path.write_text(text), item or f"item of {name}")


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
            files.write(PurePosixPath(name), write, name)
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


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ("sub/a.txt", "sub/a.txt", "sub/a.txt: is a file of another item as well as of 'two'"),
        ("a.txt", "a.txt/b/c", "a.txt: is a file of another item as well as of 'two'"),
        ("a.txt/b/c", "a.txt", "a.txt: is a file of another item as well as of 'two'"),
    ],
)
def test_two_items_that_clash_are_refused(tmp_path, first, second, message):
    def write_both():
        with staged_files(tmp_path / "out") as files:
            put(files, "before", "", "neither")
            put(files, first, "1", "one")
            put(files, "between", "", "neither")
            put(files, second, "2", "two")

    with pytest.raises(InputError, match=f"out/{message}; rename one of them, or choose"):
        write_both()
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_an_input_error_that_names_the_file(tmp_path):
    def fill(path):
        path.write_text("begun")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(InputError, match=r"a\.txt: cannot be written: No space left"):
        write(tmp_path, "a.txt", write=fill)
    assert os.listdir(tmp_path) == []


@pytest.fixture
def earlier(tmp_path):
    """Write the files of an earlier run, one of them a link; return all there is."""
    (tmp_path / "sub").mkdir()
    for name in ("a.txt", "other.txt", "sub/c.txt"):
        (tmp_path / name).write_text(f"old {name}")
    (tmp_path / "b.txt").symlink_to("other.txt")
    return content(tmp_path)


NEW = ("new/deep/first.txt", "a.txt", "b.txt", "sub/c.txt", "sub/new.txt", "z.txt")


def stand_in_the_way(folder, obstacle):
    """Put something where a file of NEW cannot go."""
    if obstacle == "folder":
        (folder / "z.txt/deep").mkdir(parents=True)
    else:
        (folder / "new").write_text("mine")


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        ("folder", r"/z\.txt: it is a folder, but must be a file; remove or rename it"),
        ("file", r"/new: it is not a folder, but files must go into it; remove or rename it"),
    ],
)
@pytest.mark.parametrize("when", ["before", "while writing"])
def test_what_is_in_the_way_is_told_before_anything_moves(
    tmp_path, earlier, obstacle, message, when
):
    written = []

    def run():
        with staged_files(tmp_path) as files:
            for name in NEW:
                put(files, name, "new")
                written.append(name)
            stand_in_the_way(tmp_path, obstacle)
            files.publish()

    if when == "before":
        stand_in_the_way(tmp_path, obstacle)
    with pytest.raises(InputError, match=message):
        run()
    assert (len(written) == len(NEW)) == (when == "while writing")
    assert content(tmp_path) == earlier | ({"new": "mine"} if obstacle == "file" else {})
    assert (tmp_path / "b.txt").is_symlink()
    assert not list(tmp_path.glob(".*"))


def test_a_folder_that_is_not_writable_is_told_before_anything_moves(tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    access = os.access

    def locked(path, mode, **options):
        return not str(path).endswith("sub") and access(path, mode, **options)

    # permissions do not stop a superuser, who may be running this
    monkeypatch.setattr("os.access", locked)
    with pytest.raises(InputError, match=r"/sub: it is not writable.*change its permissions"):
        write(tmp_path, "a.txt", "sub/b.txt")
    assert content(tmp_path) == {}


def test_without_files_there_is_no_folder(tmp_path):
    with staged_files(tmp_path / "out") as files:
        assert files.empty
    assert os.listdir(tmp_path) == []


KILLED = """
import os, signal, sys
from pathlib import Path, PurePosixPath
from shapefit.io.whole.folder import staged_files
replace, moved = Path.replace, []
def one(path, target):
    if moved:
        os.kill(os.getpid(), signal.SIGKILL)
    moved.append(target)
    return replace(path, target)
Path.replace = one
with staged_files(Path(sys.argv[1])) as files:
    for name in "ab":
        files.write(PurePosixPath(name), lambda path: path.write_text("new"), name)
"""


def test_the_next_run_clears_away_what_a_killed_one_left(tmp_path, run_python):
    """What it moved before is whole."""
    for name in "ab":
        (tmp_path / name).write_text("old")
    assert run_python(KILLED, tmp_path).returncode == -signal.SIGKILL
    with staged_files(tmp_path):
        pass
    assert sorted(content(tmp_path).values()) == ["new", "old"]


def test_a_folder_of_another_run_at_work_is_no_litter(tmp_path, run_python):
    with staged_files(tmp_path) as first:
        first.write(PurePosixPath("a"), lambda path: path.write_text("first"), "a")
        with staged_files(tmp_path) as second:
            second.write(PurePosixPath("b"), lambda path: path.write_text("second"), "b")
    assert content(tmp_path) == {"a": "first", "b": "second"}


@pytest.mark.parametrize("name", ["n" * 250, "ü" * 120])
def test_a_folder_may_have_a_long_name(tmp_path, name):
    write(tmp_path / name, "a.txt")
    assert content(tmp_path) == {f"{name}/a.txt": "a.txt"}


def test_a_path_that_is_too_long_is_an_input_error(tmp_path):
    folder = tmp_path
    while len(bytes(folder)) < 3700:
        folder = folder / ("n" * 200)
        folder.mkdir()
    with pytest.raises(InputError, match="cannot be written: File name too long; choose a shorter"):
        write(folder, "/".join(["x" * 99] * 5))
    assert os.listdir(folder) == []


def test_files_and_folders_have_the_usual_permissions(tmp_path):
    with staged_files(tmp_path / "out") as files:
        put(files, "sub/a.txt", "a")
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain.txt").touch()
    for made, usual in (("out", "plain"), ("out/sub", "plain"), ("out/sub/a.txt", "plain.txt")):
        assert (tmp_path / made).stat().st_mode == (tmp_path / usual).stat().st_mode
