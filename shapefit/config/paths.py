"""Paths in configs: relative to the file that names them, globs, `{data}` and `-`."""

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

STANDARD_STREAM = Path("-")

UNNAMED = Path()
"""An output that is named after the first input."""

DATA = "{data}"

MANIFEST = "manifest.jsonl"
"""In a folder of results, the list of them."""

MOST_MANIFEST = 1 << 30
"""Bytes of a manifest: some 500 for a part."""

DONE, FAILED = "done", "failed"
"""Status of a part in the manifest."""

DICTIONARIES = Path(__file__).resolve().parents[1] / "data"
"""The installed dictionaries."""


@dataclass(frozen=True)
class ResultFolder:
    """A folder as output: one result file per part, and the manifest of them."""

    path: Path

    @property
    def manifest(self) -> Path:
        """The list of the parts that are done."""
        return self.path / MANIFEST


@dataclass(frozen=True)
class Description:
    """Annotation metadata: the words for a field whose type alone does not say them well."""

    phrase: str


class PathField(Description):
    """Annotation metadata: the field holds paths."""


class RelativePath(str):
    """A path taken relative to the folder of a config; `given` is what stands there."""

    given: str


def change_texts(value: Any, change: Callable[[str], str]) -> Any:
    """Return a value with `change` made to every text in its lists and mappings."""
    if isinstance(value, list):
        return [change_texts(item, change) for item in value]
    if isinstance(value, dict):
        return {key: change_texts(item, change) for key, item in value.items()}
    return change(value) if isinstance(value, str) else value


def in_folder(path: str, folder: Path) -> str:
    """Return a path relative to `folder`; `-`, "" and what begins with `{data}` stay."""
    if path in ("", "-") or path.startswith(DATA):
        return path
    found = RelativePath(folder / os.path.expanduser(path))
    found.given = path
    return found


def with_data(path: str, data: str) -> str:
    """Return a path with `{data}` at its beginning replaced by `data`."""
    return data + path.removeprefix(DATA) if path.startswith(DATA) else path


def absolute_path(value: Any) -> Path:
    """Return the absolute path of a text or path; `-` stays. Raises ValueError."""
    if not isinstance(value, str | Path):
        raise ValueError(f"expected a path, found {value!r}")
    text = str(value)
    if not text:
        raise ValueError("expected a path, found an empty string")
    if "\0" in text:
        raise ValueError("expected a path, found one with a zero byte")
    if text.startswith(DATA):
        fix = "set it in the config or with --set data=FOLDER"
        raise ValueError(f"{text!r} begins with {DATA}, but `data` is not set; {fix}")
    if DATA in text:
        raise ValueError(f"{text!r} has {DATA} inside; it is allowed at the beginning only")
    path = Path(text)
    return path if path == STANDARD_STREAM else Path(os.path.abspath(os.path.expanduser(path)))


def expand_path(value: Any) -> tuple[Path, ...]:
    """Return the files that a path or glob names, sorted, at least one. Raises ValueError.

    A pipe with a name is a file too (`<(...)` in a shell makes one), and so is a folder, whose
    files may be one recording; but not for a glob.
    """
    path = absolute_path(value)
    if os.path.isdir(path):
        return result_parts(path) or (path,)
    if path == STANDARD_STREAM or os.path.exists(path):
        if path.is_socket() or path.is_block_device():
            raise ValueError(f"{path} is neither a file nor a pipe; name one, or use - for stdin")
        return (path,)
    if not glob.has_magic(str(path)):
        raise ValueError(f"no file {path}; check the spelling")
    files = tuple(file for file in _matches(path) if os.path.isfile(file))
    if not files:
        raise ValueError(f"no file matches {path}; check the pattern")
    return files


def _matches(path: Path) -> list[Path]:
    """Return what a glob matches, sorted; a folder whose name has brackets is taken literally."""
    parts = path.parts
    fixed = Path(*parts[:1])
    while (at := len(fixed.parts)) < len(parts) - 1 and (fixed / parts[at]).is_dir():
        fixed /= parts[at]
    pattern = os.path.join(*parts[len(fixed.parts) :])
    return sorted(fixed / match for match in glob.glob(pattern, root_dir=fixed, recursive=True))


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


def find_dictionaries() -> dict[str, Path]:
    """Return the installed dictionaries by their names, sorted."""
    return {file.stem: file for file in sorted(DICTIONARIES.glob("*.h5"))}


def find_dictionary(value: Any) -> Path:
    """Return the file of a dictionary: the one at a path, or the installed one of that name.

    A file wins over an installed dictionary, a folder does not. Raises ValueError where there is
    neither.
    """
    path = absolute_path(value)
    name = value.given if isinstance(value, RelativePath) else str(value)
    if not name.isidentifier() or (path.exists() and not path.is_dir()):
        return expand_one(value)
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


def unless_none(read: Callable[[Any], Any]) -> BeforeValidator:
    """Return what reads a value that may be None."""
    return BeforeValidator(lambda value: None if value is None else read(value))


def _output_or_folder(value: Any) -> Path | ResultFolder:
    """Return the path of an output, or the folder where it ends in /."""
    if isinstance(value, ResultFolder):
        return value
    given = value.given if isinstance(value, RelativePath) else value
    path = absolute_path(value)
    return ResultFolder(path) if isinstance(given, str) and given.endswith("/") else path


def _as_given(value: Path | ResultFolder) -> Path | str:
    return f"{path_text(value.path)}/" if isinstance(value, ResultFolder) else value


_NAMED = "a path or glob, a list of them, or a mapping name -> path(s)"


def _named(value: Any) -> Any:
    """Give each file of a list its stem as name; a mapping has its names already."""
    patterns = value if isinstance(value, list | tuple | Mapping) else [value]
    if not patterns:
        kind = "mapping" if isinstance(value, Mapping) else "list"
        raise ValueError(f"expected {_NAMED}, found an empty {kind}")
    if isinstance(patterns, Mapping):
        return dict(patterns)
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
    files, folder = expand_path(pattern), absolute_path(pattern)
    return (folder,) if folder.is_dir() else files


# The kinds of fields. Each item of a list becomes the tuple of the files that it names (so that a
# wrong item is reported at its own place), and the tuples are joined last.

_A_DICTIONARY = PathField("a path, or the name of an installed dictionary")

Folder = Annotated[Path | None, PathField("a folder"), unless_none(absolute_path)]

OutputPath = Annotated[Path, PathField("a path"), BeforeValidator(absolute_path)]

OptionalPath = Annotated[Path | None, PathField("a path"), unless_none(absolute_path)]

OptionalInputPath = Annotated[Path | None, PathField("a path"), unless_none(expand_one)]

OutputOrFolder = Annotated[
    Path | InstanceOf[ResultFolder],
    PathField("a path"),
    BeforeValidator(_output_or_folder),
    PlainSerializer(_as_given),
]
"""A file to write, or a folder: `FOLDER/`."""

OptionalInputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_path)], ...],
    PathField("a path or glob, or a list of them"),
    BeforeValidator(as_tuple),
    AfterValidator(flat),
]

InputPaths = Annotated[OptionalInputPaths, BeforeValidator(at_least_one)]

DictionaryPath = Annotated[Path, _A_DICTIONARY, BeforeValidator(find_dictionary)]

OptionalDictionaryPath = Annotated[Path | None, _A_DICTIONARY, unless_none(find_dictionary)]

NamedInputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_named)], ...],
    PathField("a path, a glob or the name of an installed dictionary, or a list of them"),
    BeforeValidator(as_tuple),
    AfterValidator(flat),
]

NamedFiles = Annotated[Mapping[str, InputPaths], PathField(_NAMED), BeforeValidator(_named)]
"""Names -> files; in a list, a file is called by its name without folder and ending."""
