"""JSON by declared kinds: what a reader uses of a file is checked once, before it is
used.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import cache
from typing import Any, TypeVar, cast

import orjson
from pydantic import TypeAdapter, ValidationError

from shapefit.errors import listed, printable
from shapefit.io.readers.poses import FormatError

Kind = TypeVar("Kind")

Identity = int | str
"""What names an image, a category or a track."""


NAMES_OF_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "string": "a text",
    "list": "a list",
    "dict": "an object",
    "tuple": "a list",
}
"""What a value should be, by how the types of pydantic's errors begin."""


def check_json(kind: type[Kind], content: object) -> Kind:
    """Check parsed JSON against a declared type; return it without undeclared keys.

    Raises FormatError that names the place of the first value of another type.
    """
    try:
        values: Kind = _adapter(cast(Hashable, kind)).validate_python(content)
    except ValidationError as error:
        first, *others = error.errors(include_url=False, include_context=False)
        path = _existing_path(content, first["loc"])
        place = _format_path(path)
        if first["type"] == "missing":
            within = f" in {place}" if place else ""
            problem = f"there is no {printable(first['loc'][-1])!r}{within}"
            raise FormatError(problem) from error
        # One error for each of the kinds that are allowed in this place.
        alike = [one for one in others if _existing_path(content, one["loc"]) == path]
        kinds = [one["type"].partition("_")[0] for one in (first, *alike)]
        expected = dict.fromkeys(NAMES_OF_KINDS.get(one, "another") for one in kinds)
        found = _describe_value(_value_at(content, path))
        problem = f"{place or 'it'} is {found}, not {listed(expected)}"
        raise FormatError(problem) from error
    return values


def parse_json(kind: type[Kind], text: str, subject: str) -> Kind:
    """Parse a text of JSON, and check it against a declared type, see `check_json`.

    The subject names the text in messages. FormatError, too, for what is not JSON.
    """
    try:
        content = orjson.loads(text)
    except ValueError as error:
        raise FormatError(f"{subject} is not whole JSON") from error
    return check_json(kind, content)


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Return pydantic's validator of a declared type, which is cached."""
    return TypeAdapter(kind)


Path = tuple[int | str, ...]


def _existing_path(content: Any, location: Sequence[int | str]) -> Path:
    """Return the keys and indices at the start of `location` that exist in `content`.

    pydantic adds names of its own to those that lead to a value.
    """
    path: list[int | str] = []
    for step in location:
        has_key = isinstance(content, Mapping) and step in content
        if not has_key and not _has_index(content, step):
            break
        content = content[step]
        path.append(step)
    return tuple(path)


def _has_index(content: Any, index: int | str) -> bool:
    """Whether a value is a list that has this index."""
    return isinstance(content, list) and isinstance(index, int) and index < len(content)


def _value_at(content: Any, path: Path) -> Any:
    """Return the value in nested content at a path of keys and indices."""
    for step in path:
        content = content[step]
    return content


def _format_path(path: Path) -> str:
    """Format a path of keys and indices as `annotations[3].keypoints`."""
    steps = (
        f"[{step}]" if isinstance(step, int) else f".{printable(step)[:40]}"
        for step in path
    )
    return "".join(steps).removeprefix(".")


def _describe_value(value: object) -> str:
    """Describe a value of JSON in messages: `an object`, `a list`, or else its JSON."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "a list"
    return printable(orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS).decode())[:40]
