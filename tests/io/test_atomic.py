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
from hypothesis import given
from hypothesis import strategies as st

from shapefit.errors import InputError
from shapefit.io.atomic import (
    atomic_path,
    check_output,
    digest,
    file_stem,
    staged_files,
)


def write(target: Path, data: bytes = b"new", error: Exception | None = None) -> None:
    with atomic_path(target) as temporary:
        temporary.write_bytes(data)
        if error:
            raise error


def content(folder):
    """Return path -> text of every file below, hidden ones too."""
    return {
        str(Path(root, name).relative_to(folder)): Path(root, name).read_text()
        for root, _, names in os.walk(folder)
        for name in names
    }


class TestOneFile:
    def test_a_new_one_appears_and_an_old_one_is_replaced(self, tmp_path):
        target = tmp_path / "out.bin"
        for data in (b"one", b"two"):
            write(target, data)
            assert target.read_bytes() == data
        assert os.listdir(tmp_path) == ["out.bin"]

    @pytest.mark.parametrize(
        ("error", "raised"),
        [
            (ZeroDivisionError(), ZeroDivisionError),
            (PermissionError(errno.EACCES, "elsewhere"), PermissionError),
            (BrokenPipeError(errno.EPIPE, "gone"), BrokenPipeError),
            *(
                (OSError(n, os.strerror(n)), InputError)
                for n in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            ),
        ],
    )
    def test_after_an_error_the_old_one_stands_alone(self, tmp_path, error, raised):
        target = tmp_path / "out.bin"
        target.write_bytes(b"old")
        with pytest.raises(raised) as found:
            write(target, error=error)
        assert target.read_bytes() == b"old"
        assert os.listdir(tmp_path) == ["out.bin"]
        if raised is InputError:
            assert str(found.value).startswith(
                f"{target}: cannot be written: {error.strerror}; free"
            )

    @pytest.mark.parametrize(
        ("number", "fix"),
        [
            (errno.EISDIR, "free some space or choose another disk or name"),
            (errno.EROFS, "choose another folder, or change its permissions"),
            (errno.EIO, "free some space or choose another disk"),
        ],
    )
    @pytest.mark.parametrize("call", ["fsync", "replace"])
    def test_faults_of_the_disk(
        self, tmp_path, problems, monkeypatch, number, fix, call
    ):
        def fail(*_, **__):
            raise OSError(number, os.strerror(number))

        target = tmp_path / "out.bin"
        target.write_bytes(b"old")
        with monkeypatch.context() as patched:
            patched.setattr(os, call, fail)
            (line,) = problems(write, target)
        assert line.startswith(
            f"{target}: cannot be written: {os.strerror(number)}; {fix}"
        )
        assert content(tmp_path) == {"out.bin": "old"}

    def test_missing_folders_are_made(self, tmp_path):
        target = tmp_path / "no" / "such" / "out.bin"
        assert check_output(target) == target
        with pytest.raises(KeyError):
            write(target, error=KeyError())
        assert content(tmp_path) == {}
        write(target)
        assert os.listdir(target.parent) == ["out.bin"]

    def test_targets_that_cannot_be(self, tmp_path, problems):
        (tmp_path / "file").touch()
        target = tmp_path / "file" / "such" / "out.h5"
        for check in (write, check_output):
            (line,) = problems(check, target)
            assert (
                line == f"{target}: {tmp_path / 'file'} is not a folder; choose another"
                " folder"
            )
            assert "it is a folder" in problems(check, tmp_path)[0]
            assert "not a regular file" in problems(check, Path(os.devnull))[0]
        assert stat.S_ISCHR(os.stat(os.devnull).st_mode)

    def test_a_folder_that_is_not_writable(self, problems):
        folder = Path(tempfile.mkdtemp())
        folder.chmod(0o555)
        root = os.geteuid() == 0
        os.seteuid(65534) if root else None
        try:
            for check in (write, check_output):
                (line,) = problems(check, folder / "out.h5")
                assert f"its folder {folder} is not writable; choose" in line
        finally:
            os.seteuid(0) if root else None
            shutil.rmtree(folder)

    def test_permissions_are_those_of_the_old_file_or_of_any_new_one(self, tmp_path):
        (tmp_path / "plain").touch()
        target = tmp_path / "new"
        write(target)
        assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode
        target.chmod(0o640)
        write(target)
        assert stat.S_IMODE(target.stat().st_mode) == 0o640

    def test_a_link_stays_and_its_file_is_replaced(self, tmp_path):
        (tmp_path / "real").write_bytes(b"old")
        link = tmp_path / "link"
        link.symlink_to("real")
        write(link)
        assert link.is_symlink()
        assert (tmp_path / "real").read_bytes() == b"new"


KILLED = """
import os, signal, sys
from pathlib import Path
from shapefit.io.atomic import atomic_path
with atomic_path(Path(sys.argv[1], "a")) as path:
    path.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_leaves_the_old_file_and_its_temporary(tmp_path, run_python):
    (tmp_path / "a").write_text("old")
    assert run_python(KILLED, tmp_path).returncode == -signal.SIGKILL
    assert (tmp_path / "a").read_text() == "old"
    write(tmp_path / "a")
    assert sorted(content(tmp_path).values()) == ["half", "new"]


def put(staging, name):
    (staging / name).parent.mkdir(parents=True, exist_ok=True)
    (staging / name).write_text("new")


class TestManyFiles:
    @pytest.mark.parametrize("exists", [False, True])
    def test_they_appear_when_all_are_complete(self, tmp_path, exists):
        folder = tmp_path / "out"
        before = {"a.txt": "old", "other.txt": "stays"} if exists else {}
        for name, text in before.items():
            folder.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        with staged_files(folder) as files:
            put(files, "a.txt")
            put(files, "sub/sub/b.txt")
            found = {
                name: text
                for name, text in content(folder).items()
                if "partial" not in name
            }
            assert found == before
        new = dict.fromkeys(["a.txt", "sub/sub/b.txt"], "new")
        assert content(tmp_path) == {
            f"out/{n}": text for n, text in (before | new).items()
        }
        (tmp_path / "plain").mkdir()
        assert folder.stat().st_mode == (tmp_path / "plain").stat().st_mode

    @pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
    @pytest.mark.parametrize("exists", [False, True])
    def test_an_error_leaves_everything_as_it_was(self, tmp_path, exists, error):
        folder = tmp_path / "out"
        if exists:
            folder.mkdir()
            (folder / "a.txt").write_text("old")
        with pytest.raises(error), staged_files(folder) as files:  # noqa: PT012
            put(files, "a.txt")
            put(files, "sub/b.txt")
            raise error
        assert content(tmp_path) == ({"out/a.txt": "old"} if exists else {})
        assert os.listdir(tmp_path) == (["out"] if exists else [])

    @pytest.mark.parametrize(
        ("obstacle", "message"),
        [
            ("folder", r"/z\.txt: it is a folder; remove or rename it"),
            ("file", r"/new is not a folder; choose another folder"),
        ],
    )
    def test_what_is_in_the_way_is_told_before_anything_moves(
        self, tmp_path, obstacle, message
    ):
        (tmp_path / "a.txt").write_text("old")
        if obstacle == "folder":
            (tmp_path / "z.txt/deep").mkdir(parents=True)
        else:
            (tmp_path / "new").write_text("mine")
        raises = pytest.raises(InputError, match=message)
        with raises, staged_files(tmp_path) as files:
            for name in ("a.txt", "new/deep/first.txt", "z.txt"):
                put(files, name)
        assert content(tmp_path) == {"a.txt": "old"} | (
            {"new": "mine"} if obstacle == "file" else {}
        )

    def test_without_files_there_is_no_folder(self, tmp_path):
        with staged_files(tmp_path / "out"):
            pass
        assert os.listdir(tmp_path) == []


def test_digest(tmp_path, problems):
    (tmp_path / "file").write_bytes(b"content")
    assert digest(tmp_path / "file") == hashlib.sha256(b"content").hexdigest()
    assert digest(Path("-")) == "stream"
    assert "no such file" in problems(digest, tmp_path / "none")[0]


ODD = '/.% <>:"|?*\\\n\0ab é'


class TestNamesOfItems:
    @pytest.mark.parametrize(
        ("item", "stem"),
        [
            ("walk_emil/020", "walk_emil/020"),
            ("Škoda Fabia (2005), no. 3", "Škoda Fabia (2005), no. 3"),
            ("../../etc/passwd", "%2E%2E/%2E%2E/etc/passwd"),
            ("/etc/passwd", "%/etc/passwd"),
            ("a//b", "a/%/b"),
            ("", "%"),
            (".hidden", "%2Ehidden"),
            ("c:\\x", "c%3A%5Cx"),
            ("two\nlines", "two%0Alines"),
            (" a ", "%20a%20"),
            ("50%", "50%25"),
            ("a\0b", "a%00b"),
        ],
    )
    def test_they_are_readable_and_lead_nowhere_else(self, item, stem):
        assert str(file_stem(item)) == stem

    @given(st.lists(st.text(alphabet=ODD, max_size=8), unique=True, max_size=20))
    def test_they_stay_in_their_folder_and_differ(self, items):
        stems = [file_stem(item) for item in items]
        assert len(set(stems)) == len(items)
        for stem in stems:
            assert not stem.is_absolute()
            for part in stem.parts:
                assert part.strip(" .") == part != ""
                assert not set(part) & set('<>:"|?*\\\n\0')
