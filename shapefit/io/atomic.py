"""Outputs that appear whole or not at all: written beside the target, synced, renamed.

A temporary is hidden, has a random name that ends in `.partial` and the suffix of its target, and
is removed on any error. What a killed process leaves is left to the user.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from shapefit.errors import input_error, path_text
from shapefit.io.inputs import is_stream, require_file

WriteBytes = Callable[[bytes | memoryview], None]

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
OTHER_FOLDER = "choose another folder, or change its permissions"
FIXES = {
    **dict.fromkeys(NO_ROOM, "free some space or choose another disk (nothing was replaced)"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), OTHER_FOLDER),
    **dict.fromkeys(
        (errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENOTEMPTY),
        "choose another name, or move the existing file away",
    ),
    errno.EIO: "check the disk, or choose another",
    errno.ENOENT: "choose a folder that exists and stays",
    errno.ENAMETOOLONG: "choose a shorter name",
}
"""What a user can mend when a file cannot be put in its place: number of the error -> how."""

LONGEST_NAME, LONGEST_PART = 100, 180
"""Bytes of the name of an output in that of its temporary, and of a part of an item's file; most
systems take 255."""


def check_output(target: Path, instead: str = "give the name of a file in it") -> Path:
    """Return the file that writing to `target` would replace, links followed.

    Raises InputError where its folder can be neither written to nor made, or `target` is a folder
    (`instead` says what to do then) or some other thing that cannot be replaced by a file. Nothing
    is written. `-` is always good.
    """
    if is_stream(target):
        return target
    if os.path.exists(target) and not os.path.isfile(target) and not os.path.isdir(target):
        # Before links are followed: those of /dev/stdout and the like can lead to no path at all.
        found = "it is not a regular file"
        raise input_error(target, found, "give the name of a file, or - for CSV to standard output")
    resolved = Path(os.path.realpath(target))
    try:
        resolved.lstat()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise input_error(target, "its name is too long", "give a shorter one") from None
    if os.path.isdir(resolved):
        raise input_error(target, "it is a folder", instead)
    around = next(folder for folder in resolved.parents if os.path.lexists(folder))
    if not os.path.isdir(around):
        raise input_error(target, f"{around} is not a folder", "choose another folder")
    if not is_writable(around):
        raise input_error(target, f"its folder {around} is not writable", OTHER_FOLDER)
    return resolved


def check_folder(folder: Path) -> None:
    """Raise InputError unless the folder can be made or written to; change nothing."""
    if is_stream(folder):
        raise input_error("output", "a report is several files", "give the name of a folder")
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise input_error(folder, "it is not a folder", "give the name of a folder")
    check_output(folder / "report" if os.path.isdir(folder) else folder)


def is_writable(folder: Path) -> bool:
    """Whether this process may make files in the folder."""
    effective = os.access in os.supports_effective_ids
    return os.access(folder, os.W_OK | os.X_OK, effective_ids=effective)


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
def atomic_path(target: Path) -> Iterator[Path]:
    """Give the path of an empty temporary file that becomes `target` on a clean exit.

    On any error it is removed and the target stays as it was. Its name ends in the suffix of the
    target. Missing folders are made. Raises InputError as `check_output` does, and where the disk
    is full.
    """
    resolved = check_output(target)
    with _temporary(resolved.parent, resolved.stem, resolved.suffix) as temporary:
        with storage_errors(target, None):
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            if resolved.exists():
                temporary.chmod(stat.S_IMODE(resolved.stat().st_mode))
        with storage_errors(target):
            yield temporary
        with storage_errors(target, None):
            _sync(temporary)
            temporary.replace(resolved)


@contextmanager
def output_bytes(target: Path) -> Iterator[WriteBytes]:
    """Give what writes bytes to a file that appears on a clean exit, as `atomic_path`."""
    with atomic_path(target) as path, _opened(path, target) as write:
        yield write


def append_bytes(path: Path, data: bytes) -> None:
    """Add bytes at the end of a file; what goes wrong is an InputError."""
    with storage_errors(path, None), path.open("ab", buffering=0) as file:
        file.write(data)


@contextmanager
def _opened(path: Path, target: Path) -> Iterator[WriteBytes]:
    """Give what writes to a file; what goes wrong there is an InputError at the target."""
    with storage_errors(target, None):
        file = open(path, "wb", buffering=0)  # noqa: SIM115

    def write(data: bytes | memoryview) -> None:
        rest = memoryview(data)
        with storage_errors(target, None):
            while rest:  # a raw file may take fewer at a time
                rest = rest[file.write(rest) :]

    with file:
        yield write


class StagedFiles:
    """Files on their way to `folder`, in a hidden folder."""

    def __init__(self, folder: Path, staging: Path) -> None:
        self.folder, self._staging = folder, staging

    def write(
        self, name: PurePosixPath, write: Callable[[Path], object], item: str, *, sync: bool = False
    ) -> None:
        """Let `write` fill the file of an item that becomes folder/name, its folders included.

        With `sync` it is on the disk, then. Raises InputError where it cannot be written, where
        something in the folder is in the way, and where a file of another item is: the names of
        two items may be equal for the file system.
        """
        target, path = self.folder / name, self._staging / name
        with storage_errors(target, None):
            occupied = next(place for place in (path, *path.parents) if place.exists())
            if occupied == path or not occupied.is_dir():
                found = f"is a file of another item as well as of {item!r}"
                place = self.folder / occupied.relative_to(self._staging)
                raise input_error(place, found, "rename one of them, or choose another format")
            check_output(target, IN_THE_WAY)
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
            if sync:
                _sync(path)

    @contextmanager
    def opened(self, name: str) -> Iterator[WriteBytes]:
        """Give what writes the file that becomes folder/name, piece by piece."""
        check_output(self.folder / name, IN_THE_WAY)
        with _opened(self._staging / name, self.folder / name) as write:
            yield write


IN_THE_WAY = "remove or rename it, or choose another folder"


@contextmanager
def staged_files(folder: Path) -> Iterator[StagedFiles]:
    """Give files that move into `folder` on a clean exit, and are gone on any error before.

    They lie in a hidden folder: in `folder` itself, or beside it as long as it does not exist. What
    else the folder holds stays; without files it is not made. The files are not synced one by one,
    which would take most of the time: a power failure, unlike a killed process, may leave empty
    ones. Raises InputError as `StagedFiles` does, before any moves.
    """
    around = folder if folder.is_dir() else folder.parent
    with _temporary(around, folder.name, "") as staging:
        with storage_errors(folder, None):
            staging.mkdir()
        yield StagedFiles(folder, staging)
        made = [Path(place, name) for place, _, names in os.walk(staging) for name in names]
        targets = {path: folder / path.relative_to(staging) for path in made}
        for target in targets.values():
            check_output(target, IN_THE_WAY)
        for path, target in targets.items():
            with storage_errors(target, None):
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)


def _sync(path: Path) -> None:
    with path.open("rb") as written:
        os.fsync(written.fileno())


@contextmanager
def _temporary(folder: Path, stem: str, suffix: str) -> Iterator[Path]:
    """Give a new hidden name in a folder, which is made; after it nothing is there any more.

    On any error folders that are new and empty are removed.
    """
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    short, end = (os.fsencode(n)[:LONGEST_NAME].decode(errors="ignore") for n in (stem, suffix))
    temporary = folder / f".{short}-{secrets.token_hex(8)}.partial{end}"
    failed = True
    try:
        for new in reversed(missing):
            with storage_errors(new, None, "created"):
                new.mkdir(exist_ok=True)
        yield temporary
        failed = False
    finally:
        with suppress(OSError):
            temporary.unlink() if temporary.is_file() else shutil.rmtree(temporary)
        for new in missing if failed else ():
            with suppress(OSError):
                new.rmdir()


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


def file_stem(item: str) -> PurePosixPath:
    """Return the relative path, without suffix, of the files of an item: `walk/007` -> walk/007.

    `/` divides folders. Other characters that a name cannot have are written %XX, as in URLs, and
    so are dots and spaces at its ends; an empty part is %. The end of a part beyond 180 bytes gives
    way to its digest. No path leads out of its folder, and no two items have the same.
    """
    return PurePosixPath(*map(_file_part, item.split("/")))


def _file_part(text: str) -> str:
    bad = frozenset('%<>:"|?*\\')  # `%` begins an escape; the others Windows does not allow
    letters = (c if c.isprintable() and c not in bad else quote(c, safe="") for c in text)
    name = re.sub(r"^[. ]|[. ]$", lambda end: f"%{ord(end[0]):02X}", "".join(letters))
    if len(name.encode()) <= LONGEST_PART:
        return name or "%"
    head = name.encode()[:LONGEST_PART].decode(errors="ignore")
    return f"{head}%-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
