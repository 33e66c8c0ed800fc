"""Kinds of paths in configs: relative to the file that names them, globs, `{data}` and `-`."""

from __future__ import annotations

import glob
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePath
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BeforeValidator, InstanceOf, PlainSerializer, PlainValidator

from shapefit.errors import input_error, path_text

STANDARD_STREAM = Path("-")

UNNAMED = Path()
"""An output that is named after the first input."""

DATA = "{data}"

MANIFEST = "manifest.jsonl"
"""In a folder of results, the list of them."""

DONE, FAILED = "done", "failed"
"""Status of a part in the manifest."""

PACKAGE = Path(__file__).resolve().parents[1]

DICTIONARIES = PACKAGE / "data"
"""The installed dictionaries."""


@dataclass(frozen=True)
class ResultFolder:
    """A folder as output: one result file for `partition` images each, and a manifest of them.

    `workers` processes of this machine do the parts, or a running Dask scheduler; `replace`
    replaces other results in the folder.
    """

    path: Path
    partition: int = 100_000
    workers: int | None = None
    scheduler: str | None = None
    scheduler_file: Path | None = None
    replace: bool = False

    @property
    def manifest(self) -> Path:
        """The list of the parts."""
        return self.path / MANIFEST


class Description(NamedTuple):
    """Annotation metadata: what a field expects, where its type does not say it well.

    `paths` and `names`: the field holds paths, or names of installed dictionaries.
    """

    phrase: str
    paths: bool = False
    names: bool = False


def in_folder(value: Any, folder: Path, *, names: bool) -> Any:
    """Return the paths in a value, which a config in this folder names, relative to the folder."""

    def anchor(path: str) -> str:
        if path in ("", "-") or path.startswith(DATA):
            return path
        joined = os.path.join(folder, os.path.expanduser(path))
        is_name = names and not os.path.exists(joined)
        return str(find_dictionaries().get(path, joined)) if is_name else joined

    return change_texts(value, anchor)


def change_texts(value: Any, change: Callable[[str], str]) -> Any:
    """Return a value with every text in its lists and mappings changed."""
    if isinstance(value, list):
        return [change_texts(item, change) for item in value]
    if isinstance(value, dict):
        return {key: change_texts(item, change) for key, item in value.items()}
    return change(value) if isinstance(value, str) else value


def find_dictionaries() -> dict[str, Path]:
    """Return the installed dictionaries by their names, sorted."""
    return {file.stem: file for file in sorted(DICTIONARIES.glob("*.h5"))}


def find_presets(command: str) -> dict[str, Path]:
    """Return the installed configs of a command by name, sorted: `cars` is cars/fit.yaml of `fit`.

    They are in the package, or beside it in a checkout. `sequences` is people/sequences.yaml.
    """
    folder = PACKAGE / "configs"
    folder = folder if folder.is_dir() else PACKAGE.parent / "configs"
    files = {file.parent.name: file for file in folder.glob(f"*/{command}.yaml")}
    if command == "fit":
        files["sequences"] = folder / "people/sequences.yaml"
    return dict(sorted(files.items()))


def manifest_lines(folder: Path) -> list[dict[str, Any]] | None:
    """Return the lines of the manifest of a folder: the run, then a part each, the last one counts.

    A line without an end is omitted. None where there is no manifest. Raises InputError where a
    file of that name is something else.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return None
    try:
        run, *parts = map(json.loads, path.read_bytes().split(b"\n")[:-1])
        if "shapefit" not in run or any(
            PurePath(part["file"]).name != part["file"] for part in parts
        ):
            raise ValueError("its lines are others")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise input_error(path, f"is not a manifest of results ({error})", "fit again") from None
    return [run, *parts]


def result_parts(folder: Path) -> tuple[Path, ...]:
    """Return the results in a folder that `fit` wrote part by part, in the order of their numbers.

    There are none for anything else. Raises InputError as `manifest_lines`.
    """
    _, *parts = manifest_lines(folder) or [{}]
    done = {part["file"]: part["status"] == DONE for part in parts}
    names = sorted((name for name in done if done[name]), key=lambda name: (len(name), name))
    return tuple(folder / name for name in names)


# What reads a value: each raises ValueError for a wrong one.


def absolute_path(value: Any) -> Path:
    """Return the absolute path of a text or path; `-` stays."""
    text = str(value)
    if not isinstance(value, str | Path) or not text or "\0" in text:
        raise ValueError(f"expected a path, found {value!r}")
    if DATA in text:
        raise ValueError(f"{text!r} begins with the folder `data`; give --set data=FOLDER")
    path = Path(text)
    return path if path == STANDARD_STREAM else Path(os.path.abspath(os.path.expanduser(path)))


def expand_path(value: Any) -> tuple[Path, ...]:
    """Return the files that a path or glob names, sorted, at least one.

    A path can be that of a pipe, or of a folder, whose files may be one recording; a glob names
    neither. A folder of results stands for its results.
    """
    path = absolute_path(value)
    if path == STANDARD_STREAM or os.path.exists(path):
        return result_parts(path) or (path,)
    if not glob.has_magic(str(path)):
        raise ValueError(f"no file {path}; check the spelling")
    matches = sorted(map(Path, glob.glob(str(path), recursive=True)))
    files = tuple(match for match in matches if match.is_file())
    if not files:
        raise ValueError(f"no file matches {path}; check the pattern")
    return files


def expand_named(value: Any) -> tuple[Path, ...]:
    """Return the files that a path or glob names, or the installed dictionary of that name.

    A file wins over an installed dictionary, a folder does not.
    """
    path, installed = absolute_path(value), find_dictionaries()
    if str(value) in installed and not path.is_file():
        return (installed[str(value)],)
    if str(value).isidentifier() and not path.exists():
        fault = f"no file {path}, and no installed dictionary {path.name!r}"
        raise ValueError(f"{fault}; installed: {', '.join(installed)}")
    return expand_path(value)


def _one(expand: Callable[[Any], tuple[Path, ...]]) -> Callable[[Any], Path]:
    """Return what reads the path of exactly one file."""

    def read(value: Any) -> Path:
        path, *others = expand(value)
        if others or path.is_dir():
            raise ValueError(f"{value} is not one file; name one")
        return path

    return read


find_dictionary = _one(expand_named)
"""Return the file of a dictionary: the one at a path, or the installed one of that name."""


def _output(value: Any) -> Path | ResultFolder:
    """Return the path of an output: a folder where it ends in /, UNNAMED for None."""
    if value is None or isinstance(value, ResultFolder):
        return UNNAMED if value is None else value
    path = absolute_path(value)
    return ResultFolder(path) if str(value).endswith("/") else path


def _named(value: Any) -> Any:
    """Name each file of a list after itself; a mapping has its names already."""
    if isinstance(value, Mapping) and value:
        return dict(value)
    named: dict[str, Path] = {}
    for pattern in _not_empty(value if isinstance(value, list | tuple | Mapping) else [value]):
        folder = absolute_path(pattern)
        for path in (folder,) if folder.is_dir() else expand_path(pattern):
            name = path_text(path.stem)
            if named.setdefault(name, path) != path:
                fault = f"{named[name]} and {path} would both be called {name!r}"
                raise ValueError(f"{fault}; name them in the config, `results: {{name: path}}`")
    return named


def _not_empty(value: Any) -> Any:
    if isinstance(value, list | tuple | Mapping) and not value:
        raise ValueError("expected at least one path, found none")
    return value


def unless_none(read: Callable[[Any], Any]) -> BeforeValidator:
    """Return what reads a value that may be None."""
    return BeforeValidator(lambda value: None if value is None else read(value))


# The kinds of fields. Each item of a list becomes the tuple of the files that it names (so that a
# wrong item is reported at its place), and the tuples are joined last, each file once.

_PATH = Description("a path", paths=True)
_DICTIONARY = Description("a path, or the name of an installed dictionary", paths=True, names=True)
_TO_LIST = BeforeValidator(lambda v: tuple(v) if isinstance(v, list | tuple) else (v,))
_JOINED = AfterValidator(lambda files: tuple(dict.fromkeys(chain.from_iterable(files))))

OutputPath = Annotated[
    Path, _PATH, BeforeValidator(lambda v: UNNAMED if v is None else absolute_path(v))
]
OutputOrFolder = Annotated[
    Path | InstanceOf[ResultFolder],
    _PATH,
    BeforeValidator(_output),
    PlainSerializer(lambda out: f"{path_text(out.path)}/" if hasattr(out, "manifest") else out),
]
"""A file to write, or a folder: `FOLDER/`."""

OptionalPath = Annotated[Path | None, _PATH, unless_none(absolute_path)]
OptionalInputPath = Annotated[Path | None, _PATH, unless_none(_one(expand_path))]
InputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_path)], ...],
    Description("a path or glob, or a list of them", paths=True),
    _TO_LIST,
    BeforeValidator(_not_empty),
    _JOINED,
]

DictionaryPath = Annotated[Path, _DICTIONARY, BeforeValidator(find_dictionary)]
OptionalDictionaryPath = Annotated[Path | None, _DICTIONARY, unless_none(find_dictionary)]
PathsOrNames = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_named)], ...],
    Description(
        "a path, a glob or the name of an installed dictionary, or a list of them",
        paths=True,
        names=True,
    ),
    _TO_LIST,
    _JOINED,
]
NamedFiles = Annotated[
    Mapping[str, InputPaths],
    Description("a path or glob, a list of them, or a mapping of names to paths", paths=True),
    BeforeValidator(_named),
]
"""Names -> files; in a list, a file is called by its name without folder and ending."""
