"""Outputs that appear whole or not at all: write beside the target, sync, rename."""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import stat
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING

from shapefit.errors import input_error, path_text
from shapefit.io.sources import is_stream, require_file
from shapefit.io.whole.litter import lock, lock_new, remove_litter
from shapefit.stores import UrlPath, check_target, uploaded

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

FIXES = {
    **dict.fromkeys(NO_ROOM, "free some space or choose another disk (nothing was replaced)"),
    **dict.fromkeys(
        (errno.EACCES, errno.EPERM, errno.EROFS),
        "choose another folder, or change its permissions",
    ),
    **dict.fromkeys(
        (errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENOTEMPTY),
        "choose another name, or move the existing file away",
    ),
    errno.EIO: "check the disk, or choose another",
    errno.ENOENT: "choose a folder that exists and stays",
    errno.ENAMETOOLONG: "choose a shorter name",
}
"""What a user can mend when a file cannot be put in its place: number of the error -> how."""

MOST_BYTES = 100
"""Of the name of an output, in the name of its temporary."""


def check_output(target: Path) -> Path:
    """Return the file that writing to `target` would replace, links followed.

    Raises InputError where its folder can be neither written to nor made, or `target` is a folder
    or some other thing that cannot be replaced by a file. Nothing is written. `-` is always good.
    """
    if is_stream(target):
        return target
    if isinstance(target, UrlPath):
        check_target(target)
        return target
    if os.path.exists(target) and not os.path.isfile(target) and not os.path.isdir(target):
        # Before links are followed: those of /dev/stdout and the like can lead to no path at all.
        found = "it is not a regular file"
        raise input_error(target, found, "give the name of a file, or - for CSV to standard output")
    resolved = Path(os.path.realpath(target))
    if _is_too_long(resolved):
        raise input_error(target, "its name is too long", "give a shorter one")
    around = next(folder for folder in resolved.parents if os.path.lexists(folder))
    if not os.path.isdir(around):
        raise input_error(target, f"{around} is not a folder", "choose another folder")
    if os.path.isdir(resolved):
        raise input_error(target, "it is a folder", "give the name of a file in it")
    if not is_writable(around):
        found = f"its folder {around} is not writable"
        raise input_error(target, found, "choose another folder, or change its permissions")
    return resolved


def is_writable(folder: Path) -> bool:
    """Whether this process may make files in the folder."""
    effective = os.access in os.supports_effective_ids
    return os.access(folder, os.W_OK | os.X_OK, effective_ids=effective)


def shortened(name: str) -> str:
    """Return as much of the name of a file as the name of a temporary has room for."""
    return os.fsencode(name)[:MOST_BYTES].decode(errors="ignore")


@contextmanager
def storage_errors(
    target: Path, numbers: Container[int | None] | None = NO_ROOM, done: str = "written"
) -> Iterator[None]:
    """Turn errors of these numbers, by default of a full disk, into InputErrors at `target`.

    `numbers` = None stands for all of them; `done` is what cannot be done.
    """
    try:
        yield
    except OSError as error:
        if numbers is not None and error.errno not in numbers:
            raise
        fix = FIXES.get(error.errno or 0, "choose another folder")
        reason = error.strerror or str(error)  # libraries raise OSError without a number, too
        raise input_error(target, f"cannot be {done}: {reason}", fix) from error


@contextmanager
def new_folders(folder: Path) -> Iterator[None]:
    """Make a folder and those around it; on any error, those that are new and empty are removed."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    made: list[Path] = []
    try:
        for new in reversed(missing):
            with storage_errors(new, None, "created"):
                new.mkdir(exist_ok=True)
            made.append(new)
        yield
    except BaseException:
        with suppress(OSError):
            for new in reversed(made):
                new.rmdir()
        raise


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """Give the path of an empty temporary file that becomes `target` on a clean exit.

    The temporary lies beside the target and is hidden; on any error it is removed and the target
    stays as it was. Its name ends in the suffix of the target. Missing folders are made. Raises
    InputError as `check_output` does, and where the disk is full. For a URL it lies in the folder
    of temporary files.
    """
    if isinstance(target, UrlPath):
        with uploaded(target) as local, storage_errors(local):
            yield local
        return
    resolved = check_output(target)
    with new_folders(resolved.parent), _atomic_path(target, resolved) as temporary:
        yield temporary


@contextmanager
def _atomic_path(target: Path, resolved: Path) -> Iterator[Path]:
    _remove_litter(resolved)
    with storage_errors(target, None, "created"):
        temporary, descriptor = lock_new(lambda: _temporary_file(resolved))
    try:
        with storage_errors(target, None):
            _copy_mode(resolved, descriptor)
        with storage_errors(target):
            yield temporary
        with storage_errors(target, None):
            with temporary.open("rb") as written:
                os.fsync(written.fileno())
            temporary.replace(resolved)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


@contextmanager
def atomic_file(target: Path) -> Iterator[FileIO]:
    """Give an unbuffered binary file, open to read and write, that becomes `target`.

    As `atomic_path`; moreover the file has no name before it is complete, where the system can do
    that (Linux), so that not even a killed process leaves a part of it behind.
    """
    if isinstance(target, UrlPath):
        with uploaded(target) as local, _Output(local, local) as file, storage_errors(local):
            yield file
        return
    resolved = check_output(target)
    with new_folders(resolved.parent), _atomic_file(target, resolved) as file:
        yield file


@contextmanager
def _atomic_file(target: Path, resolved: Path) -> Iterator[FileIO]:
    with storage_errors(target, None, "created"):
        descriptor = _unnamed_file(resolved)
    if descriptor is None:
        with _atomic_path(target, resolved) as temporary, _Output(temporary, target) as file:
            yield file
        return
    _remove_litter(resolved)
    with _Output(descriptor, target) as file, storage_errors(target):
        yield file
        with storage_errors(target, None):
            os.fsync(descriptor)
            lock(descriptor)
            _name_file(descriptor, resolved)


class _Output(FileIO):
    """A file open to read and write whose own faults are InputErrors at the target."""

    def __init__(self, file: int | Path, target: Path) -> None:
        super().__init__(file, "r+")
        self._target = target

    def write(self, data: Buffer, /) -> int:
        with storage_errors(self._target, None):
            return super().write(data)

    def truncate(self, size: int | None = None, /) -> int:
        with storage_errors(self._target, None):
            return super().truncate(size)


def write_all(file: FileIO, data: bytes | memoryview) -> None:
    """Write every byte of `data` (a raw file may take fewer at a time)."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


def digests(paths: Iterable[Path]) -> dict[str, str]:
    """Return the digest of each file under its path, as JSON can hold it."""
    return {path_text(path): digest(path) for path in dict.fromkeys(paths)}


def digest(path: Path) -> str:
    """SHA-256 of the file in hexadecimal; `stream` for what cannot be read twice (`-`, a pipe).

    That of a folder is the digest of the names and digests of its files, in their order.
    """
    if is_stream(path):
        return "stream"
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.is_file())
        text = "".join(f"{path_text(file.name)} {digest(file)}\n" for file in files)
        return hashlib.sha256(text.encode()).hexdigest()
    require_file(path)
    if not path.is_file():
        return "stream"
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _temporary_name(target: Path) -> Path:
    """Return a new hidden name beside `target`, with its suffix."""
    start, end = _around_token(target)
    return target.with_name(f"{start}{secrets.token_hex(4)}{end}")


def _around_token(target: Path) -> tuple[str, str]:
    stem, suffix = shortened(target.stem), shortened(target.suffix)
    return f".{stem}-", f".partial{suffix}"


def _temporary_file(target: Path) -> Path:
    """Make an empty temporary file beside `target`."""
    path = _temporary_name(target)
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return path


def _remove_litter(target: Path) -> None:
    """Remove what killed runs left beside `target`."""
    remove_litter(target.parent, *_around_token(target), os.unlink)


def _is_too_long(path: Path) -> bool:
    try:
        path.lstat()
    except OSError as error:
        return error.errno == errno.ENAMETOOLONG
    return False


def _copy_mode(target: Path, descriptor: int) -> None:
    """Give the open file the permissions of the file that it will replace, if there is one."""
    if target.exists():
        os.fchmod(descriptor, stat.S_IMODE(target.stat().st_mode))


def _unnamed_file(target: Path) -> int | None:
    """Open a file without a name in the folder of `target`; None where that is not possible."""
    if not hasattr(os, "O_TMPFILE") or not Path("/proc/self/fd").is_dir():
        return None
    try:
        descriptor = os.open(target.parent, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno in {errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL}:
            return None
        raise
    _copy_mode(target, descriptor)
    return descriptor


def _name_file(descriptor: int, target: Path) -> None:
    """Give the unnamed file a name of its own, then rename it over `target`."""
    name = _temporary_name(target)
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        # With a folder descriptor os.link calls linkat, which follows /proc/self/fd to the file.
        os.link(f"/proc/self/fd/{descriptor}", name, src_dir_fd=folder, follow_symlinks=True)
        name.replace(target)
    except BaseException:
        name.unlink(missing_ok=True)
        raise
    finally:
        os.close(folder)
