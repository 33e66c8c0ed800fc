"""Names of files: installed dictionaries, such as `people`, and files under names of their own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, PlainValidator

from shapefit.config.paths import (
    STANDARD_STREAM,
    Anchored,
    InputPaths,
    PathWords,
    absolute_path,
    as_tuple,
    at_least_one,
    expand_one,
    expand_path,
    flat,
    result_parts,
    unless_none,
)
from shapefit.errors import path_text

FOLDER = Path(__file__).resolve().parents[1] / "dictionaries"


def find_dictionaries() -> dict[str, Path]:
    """Return the installed dictionaries by their names, sorted."""
    return {file.stem: file for file in sorted(FOLDER.glob("*.h5"))}


def find_dictionary(value: Any) -> Path:
    """Return the file of a dictionary: the one at a path, or the installed one of that name.

    A file wins over an installed dictionary, a folder does not. Raises ValueError where there is
    neither.
    """
    path = absolute_path(value)
    name = value.given if isinstance(value, Anchored) else str(value)
    is_name = name.isidentifier() and path != STANDARD_STREAM
    if not is_name or (path.exists() and not path.is_dir()):
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
