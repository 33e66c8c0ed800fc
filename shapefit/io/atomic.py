"""Outputs that appear whole or not at all: written beside the target, synced, renamed.

A temporary is hidden, has a random name that ends in `.partial` and the suffix of its
target, and is removed on any error. What a killed process leaves is left to the user.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from shapefit.errors import input_error, path_text
from shapefit.io.inputs import is_stream, require_file

OF_THE_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})
OF_PERMISSION = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
PARTIAL = ".partial"
SYNCED_MODE = "rb+" if os.name == "nt" else "rb"
"""Windows syncs only files that are open for writing."""

OTHER_FOLDER = "choose another folder, or change its permissions"


def check_output(target: Path, instead: str = "give the name of a file in it") -> Path:
    """Check that `target` can be written, and return its path with links followed.

    Writes nothing. Raises InputError where its folder can be neither written to nor
    made, or `target` is a folder (`instead` says what to do then) or a device. `-` is
    always good.
    """
    if is_stream(target):
        return target
    if os.path.isdir(target):
        raise input_error(target, "it is a folder", instead)
    if os.path.exists(target) and not os.path.isfile(target):
        fix = "give the name of a file, or - for CSV to standard output"
        raise input_error(target, "it is not a regular file", fix)
    resolved = Path(os.path.realpath(target))
    around = next(folder for folder in resolved.parents if os.path.lexists(folder))
    if not os.path.isdir(around):
        raise input_error(target, f"{around} is not a folder", "choose another folder")
    effective = os.access in os.supports_effective_ids  # Windows has one user alone
    if not os.access(around, os.W_OK | os.X_OK, effective_ids=effective):
        raise input_error(target, f"its folder {around} is not writable", OTHER_FOLDER)
    return resolved


def check_folder(folder: Path) -> None:
    """Raise InputError unless the folder can be made or written to; change nothing."""
    if is_stream(folder) or (os.path.exists(folder) and not os.path.isdir(folder)):
        raise input_error(folder, "it is not a folder", "give the name of a folder")
    check_output(folder / "report" if os.path.isdir(folder) else folder)


@contextmanager
def storage_errors(
    target: Path, errnos: Container[int | None] | None = OF_THE_DISK
) -> Iterator[None]:
    """Turn OSErrors whose errno is in `errnos` into InputErrors at `target`.

    With None every OSError is turned; so is every one about a temporary file.
    """
    try:
        yield
    except OSError as error:
        refused = error.errno in OF_PERMISSION
        temporary = PARTIAL in str(error.filename)
        if not (errnos is None or temporary or error.errno in errnos):
            raise
        fix = (
            OTHER_FOLDER
            if refused
            else "free some space or choose another disk or name"
        )
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise input_error(target, f"cannot be written: {reason}", fix) from error


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """Give the path of an empty temporary file that becomes `target` on a clean exit.

    On any error it is removed and the target stays as it was. Missing folders are made.
    Raises InputError as `check_output` does, and where the disk is full.
    """
    resolved = check_output(target)
    with (
        storage_errors(target),
        _temporary_path(resolved.parent, resolved.suffix) as temporary,
    ):
        with storage_errors(target, None):
            temporary.touch(exist_ok=False)
            if resolved.exists():
                shutil.copymode(resolved, temporary)
        yield temporary
        with storage_errors(target, None):
            with temporary.open(SYNCED_MODE) as written:
                os.fsync(written.fileno())
            temporary.replace(resolved)


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """Give a hidden folder whose files move into `folder` on a clean exit.

    `folder` is made for them. On any error before, they are gone. Raises InputError
    where they cannot be written, and before any moves where something is in the way of
    one.
    """
    around = folder if folder.is_dir() else folder.parent
    with storage_errors(folder), _temporary_path(around, "") as staging:
        staging.mkdir()
        yield staging
        made = [
            Path(place, name) for place, _, names in os.walk(staging) for name in names
        ]
        targets = {path: folder / path.relative_to(staging) for path in made}
        for target in targets.values():
            check_output(target, "remove or rename it, or choose another folder")
        with storage_errors(folder, None):
            for path, target in targets.items():
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)


@contextmanager
def _temporary_path(folder: Path, suffix: str) -> Iterator[Path]:
    """Give an unused hidden path in `folder`; remove the file or folder there on exit.

    The folder is made where there is none.
    """
    temporary = folder / f".{secrets.token_hex(8)}{PARTIAL}{suffix[:20]}"
    with storage_errors(folder, None):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield temporary
    finally:
        with suppress(OSError):
            temporary.unlink() if temporary.is_file() else shutil.rmtree(temporary)


def digests(paths: Iterable[Path]) -> dict[str, str]:
    """Return path -> SHA-256 of each file or folder, see `digest`; both are texts."""
    return {path_text(path): digest(path) for path in dict.fromkeys(paths)}


def digest(path: Path) -> str:
    """Return the SHA-256 of a file or folder in hexadecimal, `stream` for a pipe or -.

    These cannot be read twice. That of a folder is the digest of the names and digests
    of its files, in their order, but for hidden ones, such as a result that is being
    written there. Raises InputError as `require_file` does.
    """
    if path.is_dir():
        shown = (file for file in path.iterdir() if not file.name.startswith("."))
        files = sorted(file for file in shown if file.is_file())
        text = "".join(f"{path_text(file.name)} {digest(file)}\n" for file in files)
        return hashlib.sha256(text.encode()).hexdigest()
    # of some formats an empty file is an image of nobody
    is_empty = path.is_file() and path.stat().st_size == 0
    if not is_empty and not is_stream(path):
        require_file(path)
    if not path.is_file():
        return "stream"
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


MAX_NAME_BYTES = 200
"""Bytes of a part of a path: systems allow 255, of which a suffix takes some."""


def file_stem(item: str) -> PurePosixPath:
    """Return a safe relative path, without suffix, for files that belong to an item.

    `/` divides folders. Other characters that a name cannot have are written %XX, as in
    URLs, and so are dots and spaces at its ends; an empty part is %. Of a part that is
    too long the rest is a number, found from the whole of it. No path leads out of its
    folder, and no two items have the same.
    """
    return PurePosixPath(*map(_as_file_name, item.split("/")))


def _as_file_name(part: str) -> str:
    """Escape and shorten a part of an item's name, so that every system allows it."""
    # `%` begins an escape; the others Windows does not allow
    allowed = [c.isprintable() and c not in '%<>:"|?*\\' for c in part]
    text = "".join(
        letter if whole else quote(letter, "", errors="surrogatepass")
        for letter, whole in zip(part, allowed, strict=True)
    )
    text = re.sub(r"^[. ]|[. ]$", lambda end: f"%{ord(end[0]):02X}", text) or "%"
    encoded = text.encode()
    if len(encoded) <= MAX_NAME_BYTES:
        return text
    number = int.from_bytes(hashlib.sha256(encoded).digest()[:8])
    suffix = f"%{number:020}"
    start = encoded[: MAX_NAME_BYTES - len(suffix)].decode("utf-8", "ignore")
    return start + suffix
