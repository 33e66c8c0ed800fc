"""Dictionaries: files, or installed ones that a name stands for, such as `people`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, PlainValidator

from shapefit.config.paths import (
    STANDARD_STREAM,
    Anchored,
    PathWords,
    absolute_path,
    as_tuple,
    expand_one,
    expand_path,
    flat,
)

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


_EXPECTED = "a path, or the name of an installed dictionary"

DictionaryPath = Annotated[Path, PathWords(_EXPECTED), BeforeValidator(find_dictionary)]

OptionalDictionaryPath = Annotated[
    Path | None,
    PathWords(_EXPECTED),
    BeforeValidator(lambda value: None if value is None else find_dictionary(value)),
]

NamedInputPaths = Annotated[
    tuple[Annotated[Path, PlainValidator(expand_named)], ...],
    PathWords("a path, a glob or the name of an installed dictionary, or a list of them"),
    BeforeValidator(as_tuple),
    AfterValidator(flat),
]
