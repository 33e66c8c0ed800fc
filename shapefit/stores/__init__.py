"""Objects of stores (`s3://bucket/key`) as paths: read through local copies, put by one upload.

Everything that speaks to a store is fsspec's; its errors become InputErrors that name the URL.
"""

from __future__ import annotations

import errno
import os
import re
import socket
import tempfile
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import unquote, urlsplit

from shapefit.errors import InputError, input_error, printable

State = tuple[int, int | str]
"""Bytes of a file, and by what else a change of it is known: time, or the etag of an object."""

STORAGE_OPTIONS = "storage_options"
"""Key of the configs, and how the options are called in messages."""

MASK = "***"
LIBRARIES = {"s3": "s3fs", "s3a": "s3fs", "gs": "gcsfs", "gcs": "gcsfs"}
"""Schemes of URLs -> the library that reads and writes them."""

PATIENCE: Mapping[str, Mapping[str, Any]] = {
    "s3": {
        "config_kwargs": {
            "connect_timeout": 5,
            "read_timeout": 60,
            "retries": {"mode": "standard", "max_attempts": 3},
        }
    }
}
"""Scheme -> options that bound how long its store is waited for."""

VERSIONS = ("ETag", "etag", "mtime", "LastModified", "created")
"""Where stores say of which version an object is, the best first."""

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")  # not C://, which is a drive of Windows
_USER = re.compile(r"^[^/@]*:[^/@]*@")
_SECRET = re.compile(r"(KEY|SECRET|TOKEN|PASSWORD|CREDENTIALS)")
"""In the name of a variable of the environment whose value is not shown."""
_OF_STORES = ("AWS_", "FSSPEC_", "GOOGLE_", "GCSFS_")
_ACCESS = f"check the credentials in the environment, or set `{STORAGE_OPTIONS}`"

if TYPE_CHECKING:
    _Path = Path
else:  # Python 3.11 knows the rules of the system in a subclass only
    _Path = type(Path())


class UrlPath(_Path):
    """The URL of an object as a path: `/`, `parent`, `name`, `suffix` as of paths, `str` the URL.

    Whoever opens it as a file of this machine gets a local copy, downloaded when first asked for.
    """

    def __str__(self) -> str:
        """Return the URL, without user and password."""
        scheme, *rest = self.parts
        return f"{scheme}//{_USER.sub('***@', '/'.join(rest))}"

    def __fspath__(self) -> str:
        """Return the path of a local copy."""
        return str(local_copy(self))

    @property
    def scheme(self) -> str:
        """What stands before `://`."""
        return self.parts[0].removesuffix(":")

    @property
    def url(self) -> str:
        """The URL as it was given, for the store; never for messages."""
        scheme, *rest = self.parts
        return f"{scheme}//{'/'.join(rest)}"

    def resolve(self, strict: bool = False) -> Self:
        """Return the URL, which is complete."""
        return self

    def as_uri(self) -> str:
        """Return the URL."""
        return str(self)

    def is_dir(self) -> bool:
        """Return False: a store has names with `/` in them, and no folders."""
        return False

    def is_file(self) -> bool:
        """Whether there is such an object."""
        return find_state(self) is not None

    def iterdir(self) -> Generator[Self, None, None]:
        """Yield the objects right below the URL."""
        yield from (self / name for name in files_in(self))


def is_url(text: str) -> bool:
    """Whether a text begins like a URL."""
    return _URL.match(text) is not None


def location(text: str) -> Path:
    """Return the path of a text: of a URL, or of this machine (`file://` too)."""
    if not is_url(text):
        return Path(text)
    scheme, _, rest = text.partition("://")
    if scheme.lower() == "file":
        return Path(unquote(urlsplit(text).path))
    return UrlPath(f"{scheme.lower()}://{rest}")


def real_path(path: Path) -> Path:
    """Return what a path leads to, links followed; a URL as it is."""
    return path if isinstance(path, UrlPath) else Path(os.path.realpath(path))


# Options, and what of them is secret: of each thread its own, as workers do parts of several runs.

_options: ContextVar[Mapping[str, Any]] = ContextVar(STORAGE_OPTIONS, default=MappingProxyType({}))


def use_storage_options(options: Mapping[str, Any]) -> None:
    """Open stores with these options from now on, in this thread."""
    _options.set(dict(options))


def masked(text: str) -> str:
    """Return a text with *** for every option of stores, and secret of the environment, in it."""
    environment = (
        value
        for name, value in os.environ.items()
        if name.startswith(_OF_STORES) and _SECRET.search(name)
    )
    secrets = {secret for secret in (*_texts(_options.get()), *environment) if secret}
    for secret in sorted(secrets, key=len, reverse=True):
        text = text.replace(secret, MASK)
    return text


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(inner)


# Opening stores, and their errors.


class StoreError(InputError):
    """A store does not answer, or cannot do what it should: this may pass."""


def open_store(path: UrlPath) -> tuple[Any, str]:
    """Return the file system of fsspec that a URL is in, and its name there.

    Raises InputError where what speaks to it is not installed, or does not know the options.
    """
    try:
        import fsspec

        fsspec.get_filesystem_class(path.scheme)
    except ImportError as error:
        found = f"cannot be opened ({_first_line(error)})"
        fix = f"run `pip install {LIBRARIES.get(path.scheme, 'fsspec')}`"
        raise input_error(path, found, fix) from None
    except ValueError:
        found = f"there is no kind of store {path.scheme!r}"
        raise input_error(path, found, "give s3:// or gs://, or a file") from None
    patience = PATIENCE.get(path.scheme.replace("s3a", "s3"), {})
    options = {**patience, "use_listings_cache": False, **_options.get()}
    with store_errors(path):
        system, name = fsspec.url_to_fs(path.url, **options)
    return system, name


@contextmanager
def store_errors(path: UrlPath, done: str = "read") -> Iterator[None]:
    """Turn what a store raises into InputErrors at the URL; `done` is what cannot be done."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError as error:
        missing = "bucket" if "bucket does not exist" in str(error) else "object"
        raise input_error(path, f"there is no such {missing}", "check its name") from None
    except PermissionError as error:
        found = f"cannot be {done}: access is denied ({_first_line(error)})"
        raise input_error(path, found, _ACCESS) from None
    except TypeError as error:
        if not _options.get():
            raise
        found = f"the store of {path} does not take them ({_first_line(error)})"
        raise input_error(STORAGE_OPTIONS, found, "give those that it knows") from None
    except Exception as error:  # each library of a store has kinds of its own
        if "Credential" in type(error).__name__:
            found = f"cannot be {done}: there are no credentials ({_first_line(error)})"
            raise input_error(path, found, _ACCESS) from None
        fix = "check the connection, and try again"
        raise StoreError(f"{path}: cannot be {done} ({_first_line(error)}); {fix}") from None


def _first_line(error: BaseException) -> str:
    """Return what an error says, on one line, without secrets."""
    said = str(error).strip().partition("\n")[0]
    return printable(masked(said)) or type(error).__name__


# What there is.


def matching(pattern: UrlPath) -> tuple[UrlPath, ...]:
    """Return the objects that a glob names, sorted by name."""
    system, name = open_store(pattern)
    with store_errors(pattern):
        found = system.glob(name, detail=True)
    names = [name for name, entry in found.items() if entry["type"] != "directory"]
    bare = (str(system.unstrip_protocol(name)).partition("://")[2] for name in names)
    return tuple(sorted(UrlPath(f"{pattern.scheme}://{name}") for name in bare))


def files_in(folder: Path) -> dict[str, int]:
    """Return the names of the files in a folder, here or in a store, with their bytes."""
    if isinstance(folder, UrlPath):
        system, name = open_store(folder)
        with store_errors(folder):
            found = system.find(name, maxdepth=1, detail=True)
        entries = {name.rpartition("/")[2]: entry for name, entry in found.items()}
        return {n: int(e["size"] or 0) for n, e in entries.items() if e["type"] != "directory"}
    try:
        return {path.name: path.stat().st_size for path in folder.iterdir() if path.is_file()}
    except FileNotFoundError:
        return {}


def find_state(path: Path) -> State | None:
    """Return the state of a file, as it is now; None where there is none.

    Raises InputError where the store does not answer.
    """
    if not isinstance(path, UrlPath):
        try:
            found = os.stat(path)
        except OSError:
            return None
        return found.st_size, found.st_mtime_ns
    system, name = open_store(path)
    with store_errors(path):
        try:
            entry = system.info(name)
        except FileNotFoundError:
            return None
    version = next((entry[key] for key in VERSIONS if entry.get(key)), "")
    state = int(entry.get("size") or 0), str(version).strip('"')
    return None if entry["type"] == "directory" else state


# Reading: the first bytes from the store itself, all else from a copy on this machine.


_copies: ContextVar[dict[UrlPath, tempfile.TemporaryDirectory[str]]] = ContextVar(
    "copies",
    default={},  # noqa: B039
)
"""Objects -> the folders of their copies, which have the names of the objects."""


@contextmanager
def own_copies() -> Iterator[None]:
    """Know of no copy at the start, and remove in the end what is copied within."""
    token = _copies.set({})
    try:
        yield
    finally:
        for folder in _copies.get().values():
            folder.cleanup()
        _copies.reset(token)


def local_copy(path: UrlPath) -> Path:
    """Return a copy of an object on this machine, downloaded the first time.

    Raises InputError where that is not possible.
    """
    known = _copies.get()
    if path not in known:
        system, name = open_store(path)
        with store_errors(path):
            try:
                folder = tempfile.TemporaryDirectory(prefix="shapefit-copies-")
                system.get_file(name, str(Path(folder.name, path.name)))
            except OSError as error:
                if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                    raise
                found = f"has no room for a copy of {path} ({error.strerror})"
                fix = "free some space, or set TMPDIR to another folder"
                raise input_error(tempfile.gettempdir(), found, fix) from error
        known[path] = folder
    return Path(known[path].name, path.name)


def forget_copy(path: Path) -> None:
    """Drop the copy of an object that changed, or may have."""
    folder = _copies.get().pop(path, None) if isinstance(path, UrlPath) else None
    if folder is not None:
        folder.cleanup()


def read_head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file; of an object, only these are fetched."""
    if not isinstance(path, UrlPath) or path in _copies.get():
        with path.open("rb") as file:
            return file.read(size)
    system, name = open_store(path)
    with store_errors(path):
        head: bytes = system.cat_file(name, start=0, end=size)
    return head


def read_bytes(path: Path) -> bytes:
    """Return what a file holds now. Raises FileNotFoundError where there is none."""
    if not isinstance(path, UrlPath):
        return path.read_bytes()
    if find_state(path) is None:
        raise FileNotFoundError(str(path))
    system, name = open_store(path)
    with store_errors(path):
        content: bytes = system.cat_file(name)
    return content


# Writing: objects appear whole or not at all.


def check_target(target: UrlPath) -> None:
    """Raise InputError where no object can be put at the URL; nothing is written.

    That is found out as far as the bucket: whether it takes the object shows when it is put.
    """
    if target.scheme in {"http", "https"}:
        fix = "name a file, or a URL of an object store (s3://, gs://)"
        raise input_error(target, "is read only", fix)
    if len(target.parts) < 3:
        raise input_error(target, "is no object", f"name one, such as {target}/result.h5")
    if target.scheme not in LIBRARIES:  # other stores make what is missing
        return
    bucket = type(target)(*target.parts[:2])
    system, name = open_store(bucket)
    with store_errors(bucket, "written"), suppress(PermissionError):
        try:  # whoever may write need not be allowed to ask
            system.info(name)
        except FileNotFoundError:
            found = "there is no such bucket"
            raise input_error(bucket, found, "make it, or check its name") from None


@contextmanager
def uploaded(target: UrlPath) -> Iterator[Path]:
    """Give the path of an empty local file that is put at `target` on a clean exit.

    One request puts it there, or several of which the last one does; until then what is there
    stays. Raises InputError as `check_target` does, and StoreError where it cannot be put.
    """
    check_target(target)
    with tempfile.TemporaryDirectory(prefix="shapefit-upload-") as folder:
        local = Path(folder) / target.name
        local.touch()
        yield local
        system, name = open_store(target)
        with store_errors(target, "written"):
            system.put_file(str(local), name)
        forget_copy(target)


def remove(path: Path) -> None:
    """Remove a file, here or in a store, if it is there."""
    if not isinstance(path, UrlPath):
        path.unlink(missing_ok=True)
        return
    system, name = open_store(path)
    with store_errors(path, "removed"), suppress(FileNotFoundError):
        system.rm_file(name)
    forget_copy(path)


@contextmanager
def held_object(path: UrlPath) -> Iterator[bool]:
    """Make an object for the length of the block; give False where there is one already.

    It is made in one request that fails where it is there. Stores that know no such request are
    asked first, so that two runs that begin within a moment are not noticed.
    """
    check_target(path)
    system, name = open_store(path)
    holder = f"{socket.gethostname()} {os.getpid()}\n".encode()
    with store_errors(path, "written"):
        try:
            system.pipe_file(name, holder, mode="create")
            made = True
        except FileExistsError:
            made = False
        except (NotImplementedError, TypeError, ValueError):
            made = not system.exists(name)
            if made:
                system.pipe_file(name, holder)
    try:
        yield made
    finally:
        if made:
            with suppress(Exception):
                system.rm_file(name)
