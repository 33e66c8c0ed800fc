"""Outputs appear whole or not at all, whatever ends the writer."""

import errno
import hashlib
import os
import shutil
import signal
import stat
import tempfile
from pathlib import Path

import pytest

from shapefit.errors import InputError
from shapefit.io.whole.atomic import atomic_file, atomic_path, check_output, digest, write_all


@pytest.fixture(params=["unnamed", "named"])
def writer(request, monkeypatch):
    """Write bytes through atomic_file, with and without the system's unnamed files."""
    if request.param == "named":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)

    def write(target: Path, data: bytes = b"new", error: Exception | None = None) -> None:
        with atomic_file(target) as file:
            write_all(file, data)
            if error:
                raise error

    return write


def by_path(target: Path, data: bytes = b"new", error: Exception | None = None) -> None:
    with atomic_path(target) as temporary:
        temporary.write_bytes(data)
        if error:
            raise error


def test_a_new_file_appears_and_an_old_one_is_replaced(tmp_path, writer):
    target = tmp_path / "out.bin"
    for write, data in ((writer, b"one"), (writer, b"two"), (by_path, b"three")):
        write(target, data)
        assert target.read_bytes() == data
    assert os.listdir(tmp_path) == ["out.bin"]


def test_after_an_error_the_old_file_stands_alone(tmp_path, writer):
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")
    for write in (writer, by_path):
        with pytest.raises(ZeroDivisionError):
            write(target, error=ZeroDivisionError())
        assert target.read_bytes() == b"old"
        assert os.listdir(tmp_path) == ["out.bin"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_is_an_input_error(tmp_path, writer, number, problems):
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")
    for write in (writer, by_path):
        (line,) = problems(write, target, b"new", OSError(number, "no room"))
        assert line.startswith(f"{target}: cannot be written: ")
        assert "free some space" in line
        assert target.read_bytes() == b"old"
        assert os.listdir(tmp_path) == ["out.bin"]


def test_other_errors_of_the_system_are_not_hidden(tmp_path, writer):
    with pytest.raises(BrokenPipeError):
        writer(tmp_path / "out.bin", error=BrokenPipeError(errno.EPIPE, "gone"))


def test_a_failing_rename_leaves_nothing(tmp_path, writer, monkeypatch):
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")

    def fail(*_):
        raise OSError(errno.EIO, "broken")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(InputError, match="cannot be written: broken"):
        writer(target)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["out.bin"]


def test_missing_folders_are_made(tmp_path, writer):
    target = tmp_path / "no" / "such" / "out.bin"
    assert check_output(target) == target
    assert not (tmp_path / "no").exists()
    writer(target)
    assert target.read_bytes()
    assert os.listdir(target.parent) == ["out.bin"]


def test_folders_made_for_a_run_that_fails_are_removed(tmp_path):
    (tmp_path / "old").mkdir()
    for folder in ("old", "new"):
        target = tmp_path / folder / "deep" / "out.bin"
        for opened in (atomic_path, atomic_file):
            with pytest.raises(KeyError), opened(target):
                raise KeyError(target.parent.is_dir())
    assert os.listdir(tmp_path) == ["old"]
    assert os.listdir(tmp_path / "old") == []


def test_a_folder_that_cannot_be_made(tmp_path, writer, problems):
    (tmp_path / "file").touch()
    target = tmp_path / "file" / "such" / "out.h5"
    for write in (writer, by_path, check_output):
        (line,) = problems(write, target)
        assert line == f"{target}: {tmp_path / 'file'} is not a folder; choose another folder"


def test_a_folder_or_device_as_target(tmp_path, problems):
    assert "it is a folder" in problems(check_output, tmp_path)[0]
    assert "not a regular file" in problems(check_output, Path(os.devnull))[0]
    with pytest.raises(InputError):
        by_path(Path(os.devnull))
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_a_pipe_as_target(problems):
    there, here = os.pipe()
    try:
        (line,) = problems(check_output, Path(f"/dev/fd/{here}"))
    finally:
        os.close(there)
        os.close(here)
    assert line == (
        f"/dev/fd/{here}: it is not a regular file; "
        "give the name of a file, or - for CSV to standard output"
    )


@pytest.fixture
def locked_folder():
    """Make a folder that the user of this test may not write to, even where that is root."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    yield folder
    if root:
        os.seteuid(0)
    folder.chmod(0o755)
    shutil.rmtree(folder)


def test_a_folder_that_is_not_writable(locked_folder, writer, problems):
    target = locked_folder / "out.h5"
    for write in (writer, by_path, check_output):
        (line,) = problems(write, target)
        assert line.startswith(f"{target}: its folder {locked_folder} is not writable; choose")
    assert os.listdir(locked_folder) == []


def test_permissions_are_those_of_the_old_file_or_of_any_new_one(tmp_path, writer):
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    for write in (writer, by_path):
        target = tmp_path / f"new-{write.__name__}"
        write(target)
        assert target.stat().st_mode == plain.stat().st_mode
        target.chmod(0o640)
        write(target)
        assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_a_link_stays_and_its_file_is_replaced(tmp_path, writer):
    (tmp_path / "real").write_bytes(b"old")
    link = tmp_path / "link"
    link.symlink_to("real")
    writer(link)
    assert link.is_symlink()
    assert (tmp_path / "real").read_bytes() == b"new"


def test_the_temporary_path_keeps_the_suffix(tmp_path):
    with atomic_path(tmp_path / "plot.png") as temporary:
        assert temporary.suffix == ".png"
        assert temporary.parent == tmp_path
        assert temporary.name.startswith(".")


KILLED = """
import os, signal, sys
from pathlib import Path
from shapefit.io.whole.atomic import atomic_file, write_all
with atomic_file(Path(sys.argv[1])) as file:
    write_all(file, b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not hasattr(os, "O_TMPFILE"), reason="this system has no unnamed files")
def test_a_killed_process_leaves_the_old_file_alone(tmp_path, run_python):
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")
    assert run_python(KILLED, target).returncode == -signal.SIGKILL
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["out.bin"]


def test_digest(tmp_path, problems):
    path = tmp_path / "file"
    path.write_bytes(b"content")
    assert digest(path) == hashlib.sha256(b"content").hexdigest()
    assert digest(Path("-")) == "stream"
    assert "no such file" in problems(digest, tmp_path / "none")[0]


@pytest.mark.parametrize(
    ("number", "fix"),
    [
        (errno.EISDIR, "choose another name, or move the existing file away"),
        (errno.EACCES, "choose another folder, or change its permissions"),
        (errno.EROFS, "choose another folder, or change its permissions"),
        (errno.ENAMETOOLONG, "choose a shorter name"),
        (errno.ENOSPC, "free some space or choose another disk"),
    ],
)
def test_what_a_user_can_mend_when_the_file_gets_its_name(
    tmp_path, writer, problems, monkeypatch, number, fix
):
    def fail(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "replace", fail)
    target = tmp_path / "out.bin"
    for write in (writer, by_path):
        (line,) = problems(write, target)
        assert line.startswith(f"{target}: cannot be written: {os.strerror(number)}; {fix}")
        assert os.listdir(tmp_path) == []


def test_the_same_errors_while_the_content_is_made_are_not_those_of_the_output(tmp_path, writer):
    with pytest.raises(PermissionError):
        writer(tmp_path / "out.bin", error=PermissionError(errno.EACCES, "elsewhere"))


@pytest.mark.parametrize("name", ["n" * 255, "n" * 251 + ".bin", "ü" * 127, "a." + "n" * 253])
def test_long_names(tmp_path, writer, problems, name):
    for write in (writer, by_path):
        write(tmp_path / name)
        assert os.listdir(tmp_path) == [name]
        (line,) = problems(write, tmp_path / f"{name}nn")
        assert line.endswith("its name is too long; give a shorter one")


def test_a_folder_that_comes_to_stand_in_the_place_of_the_file(tmp_path, writer):
    target = tmp_path / "out.bin"
    with pytest.raises(InputError, match="cannot be written: Is a directory"), atomic_file(target):
        target.mkdir()
    assert os.listdir(tmp_path) == ["out.bin"]


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path, writer):
    target = tmp_path / "out.bin"
    others = {".out-0123abcd.partial.txt", ".out-0123.partial.bin", ".in-0123abcd.partial.bin"}
    for name in (".out-0123abcd.partial.bin", ".out-deadbeef.partial.bin", *others):
        (tmp_path / name).write_bytes(b"litter")
    for write in (writer, by_path):
        (tmp_path / ".out-0123abcd.partial.bin").write_bytes(b"litter")
        write(target)
        assert set(os.listdir(tmp_path)) == {"out.bin", *others}


def test_what_a_running_process_writes_is_no_litter(tmp_path):
    target = tmp_path / "out.bin"
    with atomic_path(target) as first:
        with atomic_path(target) as second:
            second.write_bytes(b"second")
        assert target.read_bytes() == b"second"
        first.write_bytes(b"first")
    assert target.read_bytes() == b"first"
    assert os.listdir(tmp_path) == ["out.bin"]


@pytest.mark.parametrize("number", [errno.EIO, errno.EACCES, errno.ENOSPC])
@pytest.mark.parametrize("call", ["fsync", "link"])
def test_faults_of_the_output_itself_are_input_errors(
    tmp_path, problems, monkeypatch, number, call
):
    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, call, fail)
    target = tmp_path / "out.bin"
    (line,) = problems(lambda: write_new(target))
    assert line.startswith(f"{target}: cannot be written: {os.strerror(number)}; ")
    assert os.listdir(tmp_path) == []


def write_new(target):
    with atomic_file(target) as file:
        write_all(file, b"new")
