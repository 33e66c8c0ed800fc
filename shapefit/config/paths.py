"""Paths in configs: relative to the file that says them, globs, `{data}` and `-`."""

from __future__ import annotations

import errno
import glob
import json
import os
import stat
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, InstanceOf, PlainSerializer, PlainValidator

from shapefit.errors import path_text
from shapefit.stores import UrlPath, find_state, is_url, location, matching

STANDARD_STREAM = Path("-")
DATA = "{data}"

MANIFEST = "manifest.jsonl"
"""In a folder of results, the list of them."""

MOST_MANIFEST = 1 << 30
"""Bytes of a manifest: some 500 for a part."""

DONE, FAILED = "done", "failed"
"""Status of a part in the manifest."""


@dataclass(frozen=True)
class ResultFolder:
    """A folder as output: one result file per part, and the manifest of them."""

    path: Path

    @property
    def manifest(self) -> Path:
        """The list of the parts that are done."""
        return self.path / MANIFEST


@dataclass(frozen=True)
class Expected:
    """Annotation metadata: the words for a field whose type alone does not say them well."""

    phrase: str


class PathWords(Expected):
    """Annotation metadata: the field holds paths."""


class OfTheData:
    """Annotation metadata: the field fits certain data only, and a preset leaves it out."""


OF_THE_DATA = OfTheData()


class Anchored(str):
    """A path taken relative to the folder of a config; `given` is what stands there."""

    given: str

    @classmethod
    def of(cls, given: str, folder: Path) -> Anchored:
        """Return the path `given` in the folder."""
        path = cls(folder / os.path.expanduser(given))
        path.given = given
        return path


def change_texts(value: Any, change: Callable[[str], str]) -> Any:
    """Return a value with `change` made to every text in its lists and mappings."""
    if isinstance(value, list):
        return [change_texts(item, change) for item in value]
    if isinstance(value, dict):
        return {key: change_texts(item, change) for key, item in value.items()}
    return change(value) if isinstance(value, str) else value


def anchored(path: str, folder: Path) -> str:
    """Return a path relative to `folder`; `-`, "", URLs and what begins with `{data}` stay."""
    stays = path in ("", "-") or path.startswith(DATA) or is_url(path)
    return path if stays else Anchored.of(path, folder)


def with_data(path: str, data: Any) -> str:
    """Return a path with `{data}` at its beginning replaced by `data`, where this is a text."""
    if not isinstance(data, str) or not path.startswith(DATA):
        return path
    return data + path.removeprefix(DATA)


def absolute_path(value: Any) -> Path:
    """Return the absolute path of a text or path; `-` and URLs stay. Raises ValueError."""
    if isinstance(value, UrlPath):
        return value
    if not isinstance(value, str | Path):
        raise ValueError(f"expected a path, found {value!r}")
    text = str(value)
    if not text:
        raise ValueError("expected a path, found an empty string")
    if "\0" in text:
        raise ValueError("expected a path, found one with a zero byte")
    if DATA in text:
        if text.startswith(DATA):
            raise ValueError(
                f"{text!r} begins with {DATA}, but `data` is not set; "
                "set it in the config or with --set data=FOLDER"
            )
        raise ValueError(f"{text!r} has {DATA} inside; it is allowed at the beginning only")
    path = location(text)
    return (
        path
        if path == STANDARD_STREAM or isinstance(path, UrlPath)
        else Path(os.path.abspath(os.path.expanduser(path)))
    )


def expand_path(value: Any) -> tuple[Path, ...]:
    """Return the files that a path or glob names, sorted, at least one. Raises ValueError.

    Pipes that have a name are files too (`<(...)` in a shell makes them), and so are folders, whose
    files may be one recording; but not for a glob.
    """
    path = absolute_path(value)
    if isinstance(path, UrlPath):
        return _expand_url(path)
    if os.path.isdir(path):
        return result_parts(path) or (path,)
    if path == STANDARD_STREAM or os.path.exists(path):
        if path.is_socket() or path.is_block_device():
            raise ValueError(f"{path} is neither a file nor a pipe; name one, or use - for stdin")
        return (path,)
    if not glob.has_magic(str(path)):
        raise ValueError(f"no file {path}; check the spelling")
    matches = sorted(Path(match) for match in glob.glob(str(path), recursive=True))
    files = tuple(match for match in matches if os.path.isfile(match))
    if not files:
        raise ValueError(f"no file matches {path}; check the pattern")
    return files


def _expand_url(path: UrlPath) -> tuple[Path, ...]:
    """Return the objects that a URL or glob names, or the results below it. Raises ValueError."""
    if glob.has_magic(path.url):
        matches = matching(path)
        if not matches:
            raise ValueError(f"no object matches {path}; check the pattern")
        return matches
    if find_state(path) is not None:
        return (path,)
    parts = result_parts(path)
    if not parts:
        raise ValueError(f"no object {path}; check the spelling, or name several as {path}/*")
    return parts


def result_parts(folder: Path) -> tuple[Path, ...]:
    """Return the results in a folder that `fit` wrote part by part, in the order of their numbers.

    There are none for any other folder. Raises ValueError as `manifest_lines`.
    """
    _, *parts = manifest_lines(folder) or [{}]
    names = {part["file"] for part in parts if part["status"] == DONE}
    for name in names:
        if (folder / name).exists() and not (folder / name).is_file():
            raise ValueError(f"{folder / name} is not a regular file; fit again")
    return tuple(folder / name for name in sorted(names, key=lambda name: (len(name), name)))


def manifest_lines(folder: Path) -> list[dict[str, Any]] | None:
    """Return the lines of the manifest of a folder: the run, then a part each, the last one counts.

    A line that was not written to its end is none. None where there is no manifest. Raises
    ValueError where a file of that name is something else.
    """
    name = MANIFEST
    try:
        text = read_regular(folder / name, MOST_MANIFEST)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise ValueError(f"{folder / name} cannot be read ({error.strerror})") from None
    try:
        run, *parts = map(json.loads, text[: text.rindex(b"\n")].split(b"\n"))
        if strange := [
            part["file"] for part in parts if PurePath(part["file"]).name != part["file"]
        ]:
            raise ValueError(f"{strange[0]} is not in the folder")
        {run["config"], run["dictionary"], *run["estimated"]}
        for part in parts:
            part["inputs"], part["sizes"], part["changed"], part["rows"]
            {part["status"], part["status"] == DONE and (part["images"] + 0, part["digest"])}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(
            f"{folder / name} is not a manifest of results ({error}); fit again"
        ) from None
    return [run, *parts]


def read_regular(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file; raises OSError for others, as pipes, and larger ones."""
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        state = os.fstat(file.fileno())
        if not stat.S_ISREG(state.st_mode):
            raise OSError(errno.EINVAL, "not a regular file")
        if state.st_size > most:
            raise OSError(errno.EFBIG, f"larger than {most >> 20} MiB")
        return file.read(most)


def expand_one(value: Any) -> Path:
    """Return the one file that a path or glob names. Raises ValueError."""
    files = expand_path(value)
    if len(files) > 1:
        raise ValueError(f"{value} matches {len(files)} files; name one")
    if files[0] != STANDARD_STREAM and files[0].is_dir():
        raise ValueError(f"{files[0]} is a folder; name a file in it")
    return files[0]


def as_tuple(value: Any) -> tuple[Any, ...]:
    """Return a path or a list of paths as a tuple."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def at_least_one(value: Any) -> Any:
    """Return a path or a list of them; raises ValueError for an empty list."""
    if not as_tuple(value):
        raise ValueError("expected at least one path, found an empty list")
    return value


def flat(expanded: Iterable[tuple[Path, ...]]) -> tuple[Path, ...]:
    """Join what several paths name, each file once."""
    return tuple(dict.fromkeys(path for files in expanded for path in files))


def unless_none(read: Callable[[Any], Path]) -> BeforeValidator:
    """Return what reads a value that may be None."""
    return BeforeValidator(lambda value: None if value is None else read(value))


Folder = Annotated[Path | None, PathWords("a folder"), unless_none(absolute_path)]

OptionalPath = Annotated[Path | None, PathWords("a path"), unless_none(absolute_path)]

OptionalInputPath = Annotated[Path | None, PathWords("a path"), unless_none(expand_one)]

OutputPath = Annotated[Path, PathWords("a path"), BeforeValidator(absolute_path)]


def _output_or_folder(value: Any) -> Path | ResultFolder:
    """Return the path of an output, or the folder where it ends in /."""
    if isinstance(value, ResultFolder):
        return value
    given = value.given if isinstance(value, Anchored) else value
    path = absolute_path(value)
    return ResultFolder(path) if isinstance(given, str) and given.endswith("/") else path


def _as_given(value: Path | ResultFolder) -> Path | str:
    return f"{path_text(value.path)}/" if isinstance(value, ResultFolder) else value


OutputOrFolder = Annotated[
    Path | InstanceOf[ResultFolder],
    PathWords("a path"),
    BeforeValidator(_output_or_folder),
    PlainSerializer(_as_given),
]
"""A file to write, or a folder: `FOLDER/`."""

# Each item becomes the tuple of the files that it names (so that a wrong item is reported at its
# own place), and the tuples are joined last.
OptionalInputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_path)], ...],
    PathWords("a path or glob, or a list of them"),
    BeforeValidator(as_tuple),
    AfterValidator(flat),
]

InputPaths = Annotated[OptionalInputPaths, BeforeValidator(at_least_one)]


# Installed dictionaries, and files under names of their own.

DICTIONARIES = Path(__file__).resolve().parents[1] / "data"


def find_dictionaries() -> dict[str, Path]:
    """Return the installed dictionaries by their names, sorted."""
    return {file.stem: file for file in sorted(DICTIONARIES.glob("*.h5"))}


def find_dictionary(value: Any) -> Path:
    """Return the file of a dictionary: the one at a path, or the installed one of that name.

    A file wins over an installed dictionary, a folder does not. Raises ValueError where there is
    neither.
    """
    path = absolute_path(value)
    name = value.given if isinstance(value, Anchored) else str(value)
    is_name = name.isidentifier() and path != STANDARD_STREAM
    if not is_name or (path.exists() and not path.is_dir()):
        file = expand_one(value)
        if file.exists() and not file.is_file():
            raise ValueError(f"{file} is not a regular file; name a dictionary")
        return file
    known = find_dictionaries()
    if name not in known:
        there = ", ".join(known)
        raise ValueError(
            f"no file {path}, and no installed dictionary {name!r}; installed: {there}"
        )
    return known[name]


def expand_named(value: Any) -> tuple[Path, ...]:
    """Return the files that a path or glob names, or the installed dictionary of that name."""
    if str(value) in find_dictionaries() and not absolute_path(value).exists():
        return (find_dictionary(value),)
    return expand_path(value)


_DICTIONARY = PathWords("a path, or the name of an installed dictionary")

DictionaryPath = Annotated[Path, _DICTIONARY, BeforeValidator(find_dictionary)]

OptionalDictionaryPath = Annotated[Path | None, _DICTIONARY, unless_none(find_dictionary)]

NamedInputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_named)], ...],
    PathWords("a path, a glob or the name of an installed dictionary, or a list of them"),
    BeforeValidator(as_tuple),
    BeforeValidator(at_least_one),
    AfterValidator(flat),
]


_EXPECTED = "a path or glob, a list of them, or a mapping name -> path(s)"


def _named(value: Any) -> Any:
    """Give each file of a list its stem as name; a mapping has its names already."""
    if isinstance(value, Mapping):
        if not value:
            raise ValueError(f"expected {_EXPECTED}, found an empty mapping")
        return dict(value)
    patterns = value if isinstance(value, list | tuple) else [value]
    if not patterns:
        raise ValueError(f"expected {_EXPECTED}, found an empty list")
    named: dict[str, Path] = {}
    for path in dict.fromkeys(file for pattern in patterns for file in _results(pattern)):
        name = path_text(path.stem)
        if name in named:
            raise ValueError(
                f"{named[name]} and {path} would both be called {name!r}; "
                "name them in the config, `results: {name: path}`"
            )
        named[name] = path
    return named


def _results(pattern: Any) -> tuple[Path, ...]:
    """Return the files that a pattern names; a folder of results stays one of them."""
    files = expand_path(pattern)
    folder = absolute_path(pattern)
    whole = files != (folder,) and (folder.is_dir() or files == result_parts(folder))
    return (folder,) if whole else files


NamedFiles = Annotated[Mapping[str, InputPaths], PathWords(_EXPECTED), BeforeValidator(_named)]
"""Names -> files; in a list, a file is called by its name without folder and ending."""
