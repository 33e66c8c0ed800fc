"""Files under names, such as those of the methods that are compared."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator

from shapefit.config.paths import InputPaths, PathWords, absolute_path, expand_path, result_parts
from shapefit.errors import path_text

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
