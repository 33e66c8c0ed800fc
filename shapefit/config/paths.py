"""Paths in configs: relative to their file, globs, installed names, `-`, `{data}`."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    InstanceOf,
    PlainSerializer,
    PlainValidator,
)

from shapefit.errors import path_text

STANDARD_STREAM = Path("-")

UNNAMED_OUTPUT = Path()
"""An output that is named after the first input."""

DATA_FOLDER = "{data}"
"""What the folder `data` of a config replaces in its paths."""

DICTIONARIES = Path(__file__).resolve().parents[1] / "data"
"""The installed dictionaries."""


@dataclass(frozen=True)
class ResultFolder:
    """A folder as output: a result file for `partition` images each, and a manifest.

    `workers` processes of this machine do the parts, or a running Dask scheduler;
    `replace` replaces other results in the folder.
    """

    path: Path
    partition: int = 100_000
    workers: int | None = None
    scheduler: str | None = None
    scheduler_file: Path | None = None
    replace: bool = False

    @property
    def manifest(self) -> Path:
        """The path of the manifest, which lists the parts."""
        from shapefit.config.manifest import MANIFEST

        return self.path / MANIFEST


class FileText(str):
    """A text of a config file, to whose folder paths are relative."""

    folder: Path = Path()


class Description(NamedTuple):
    """Annotation metadata: what a field expects that its type does not say well."""

    phrase: str


class Paths(Description):
    """What a field of paths expects."""


def find_dictionaries() -> dict[str, Path]:
    """Return the installed dictionaries by their names, sorted."""
    return {file.stem: file for file in sorted(DICTIONARIES.glob("*.h5"))}


def find_presets(command: str) -> dict[str, Path]:
    """Return the installed configs of a command by name, sorted.

    `cars` of fit is cars/fit.yaml.
    """
    files = sorted(find_installed("configs").glob(f"*/{command}.yaml"))
    return {file.parent.name: file for file in files}


def find_installed(folder: str) -> Path:
    """Return the path of a folder in the package, or in the clone that it runs in."""
    package = DICTIONARIES.parent
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


def fill_in(value: object, data: str) -> object:
    """Replace `{data}` by the folder `data` in all texts of a value from YAML."""
    if isinstance(value, list | tuple):
        return [fill_in(item, data) for item in value]
    if isinstance(value, dict):
        return {key: fill_in(item, data) for key, item in value.items()}
    if isinstance(value, str) and DATA_FOLDER in value:
        return value.replace(DATA_FOLDER, data)
    return value  # which may know the folder of its file


# What reads a value: each raises ValueError for a wrong one.


def absolute_path(value: object) -> Path:
    """Return the absolute path of a text or path; `-` stays.

    A text of a config file is relative to the folder of that. Raises ValueError for
    what is no path, and for `{data}` that was not filled in.
    """
    text = str(value)
    if not isinstance(value, str | Path) or not text or "\0" in text:
        raise ValueError(f"expected a path, found {value!r}")
    if DATA_FOLDER in text:
        raise ValueError(
            f"{text!r} begins with the folder `data`; give --set data=FOLDER"
        )
    if text == "-":
        return STANDARD_STREAM
    folder = value.folder if isinstance(value, FileText) else Path()
    return Path(os.path.abspath(folder / os.path.expanduser(text)))


def list_results(path: Path) -> tuple[Path, ...]:
    """Return the results in a folder that `fit` wrote part by part, else none."""
    if not path.is_dir():
        return ()
    from shapefit.config.manifest import result_parts  # models that few commands need

    return result_parts(path)


def expand_path(value: object) -> tuple[Path, ...]:
    """Return the files that a path or glob names, sorted, at least one.

    A path can be that of a pipe, or of a folder, whose files may be one recording; a
    glob names neither. A folder of results stands for its results. Where there is no
    such file, the name of an installed dictionary is that dictionary. Raises ValueError
    where there is no file.
    """
    path = absolute_path(value)
    if path == STANDARD_STREAM or os.path.exists(path):
        return list_results(path) or (path,)
    installed = find_dictionaries()
    if isinstance(value, str) and value in installed:
        return (installed[value],)
    folder, pattern = _existing_folder(path)
    if not glob.has_magic(pattern):
        raise ValueError(f"no file {path}; check the spelling")
    escaped = os.path.join(glob.escape(str(folder)), pattern)
    matches = sorted(map(Path, glob.glob(escaped, recursive=True)))
    files = tuple(match for match in matches if match.is_file())
    if not files:
        raise ValueError(f"no file matches {path}; check the pattern")
    return files


def _existing_folder(path: Path) -> tuple[Path, str]:
    """Return the deepest folder of a path that exists, and the rest, maybe a glob.

    Brackets in the name of that folder are no glob.
    """
    folder = next(above for above in path.parents if above.is_dir())
    return folder, str(path.relative_to(folder))


def find_file(value: object) -> Path:
    """Return the one file that a path or glob names; ValueError for several."""
    path, *others = expand_path(value)
    if others or path.is_dir():
        raise ValueError(f"{value} is not one file; name one")
    return path


def find_dictionary(value: object) -> Path:
    """Return the file of a dictionary, else the installed one of that name."""
    installed = find_dictionaries().get(str(value))
    if installed and not absolute_path(value).is_file():
        return installed
    return find_file(value)


def find_named_files(value: object) -> Mapping[str, object]:
    """Return name -> file for a path, a glob or a list of these; a mapping stays.

    Globs are expanded, and folders stay whole; the name of a file is that without its
    ending. Raises ValueError for two files of one name, and where there is no file.
    """
    if isinstance(value, Mapping):
        return value
    patterns = value if isinstance(value, list | tuple) else [value]
    named: dict[str, Path] = {}
    for pattern in patterns:
        folder = absolute_path(pattern)
        paths = (folder,) if folder.is_dir() else expand_path(pattern)
        for path in paths:
            name = path_text(path.stem)
            if named.setdefault(name, path) != path:
                fault = f"{named[name]} and {path} would both be called {name!r}"
                raise ValueError(
                    f"{fault}; name them in the config, `results: {{name: path}}`"
                )
    return named


def find_output(value: object) -> Path | ResultFolder:
    """Return the path of an output, or the ResultFolder of one that ends in /.

    None, an output that is not given, is UNNAMED_OUTPUT.
    """
    if value is None:
        return UNNAMED_OUTPUT
    if isinstance(value, ResultFolder):
        return value
    path = absolute_path(value)
    return ResultFolder(path) if str(value).endswith("/") else path


def unless_none(read: Callable[[object], Path]) -> BeforeValidator:
    """Return a validator that reads a value, unless it is None, which stays."""
    return BeforeValidator(lambda value: None if value is None else read(value))


# The kinds of fields. Each item of a list becomes the tuple of the files that it names
# (so that a wrong item is reported at its place), and the tuples are joined last, each
# file once.

_PATH = Paths("a path")
_DICTIONARY = Paths("a path, or the name of an installed dictionary")

OutputPath = Annotated[
    Path,
    _PATH,
    BeforeValidator(lambda v: UNNAMED_OUTPUT if v is None else absolute_path(v)),
]
OutputOrFolder = Annotated[
    Path | InstanceOf[ResultFolder],
    _PATH,
    BeforeValidator(find_output),
    PlainSerializer(
        lambda out: f"{path_text(out.path)}/" if hasattr(out, "manifest") else out
    ),
]
"""A file to write, or a folder: `FOLDER/`."""

OptionalPath = Annotated[Path | None, _PATH, unless_none(absolute_path)]
OptionalInputPath = Annotated[Path | None, _PATH, unless_none(find_file)]
DictionaryPath = Annotated[Path, _DICTIONARY, BeforeValidator(find_dictionary)]
OptionalDictionaryPath = Annotated[
    Path | None, _DICTIONARY, unless_none(find_dictionary)
]
InputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_path)], ...],
    Paths("a path or glob, or a list of them"),
    BeforeValidator(lambda v: tuple(v) if isinstance(v, list | tuple) else (v,)),
    Field(min_length=1),
    AfterValidator(lambda files: tuple(dict.fromkeys(chain.from_iterable(files)))),
]
NamedFiles = Annotated[
    Mapping[str, InputPaths],
    Paths("a path or glob, a list of them, or a mapping of names to paths"),
    BeforeValidator(find_named_files),
    Field(min_length=1),
]
"""Names -> files; in a list, a file is called by its name without folder and ending."""
