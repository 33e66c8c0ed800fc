"""YAML 1.2 read into plain values, each with its line and column, by ruamel.yaml."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError, RoundTripConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning

from shapefit.config.model import Location, Place

MAX_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

MAX_INTEGER = 2**63 - 1


class _Constructor(RoundTripConstructor):
    """Dates and binary data are texts; a repeated key is refused without writing out its values."""

    def check_mapping_key(
        self, node: Any, key_node: Any, mapping: Any, key: Any, value: Any
    ) -> bool:
        if key in mapping:
            found = f'found duplicate key "{key}"'
            start = "while constructing a mapping"
            raise DuplicateKeyError(start, node.start_mark, found, key_node.start_mark)
        return True


for _tag in ("timestamp", "binary"):
    _Constructor.add_constructor(f"tag:yaml.org,2002:{_tag}", lambda _, node: str(node.value))


@dataclass
class Document:
    """Plain values of one YAML text, the place of each, and what is wrong with it."""

    value: Any = None
    places: dict[Location, Place] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    readable: bool = True


def read_yaml(text: str, place: Callable[[int, int], str]) -> Document:
    """Return the values of a YAML text; `place` names a line and column, both from 1.

    The keys of mappings are texts; a repeated key is an error.
    """
    yaml = YAML(pure=True)
    yaml.Constructor = _Constructor
    document, where = Document(), place(1, 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and repeated anchors
            root = yaml.load(text)
        mark = getattr(root, "lc", None)
        where = place((getattr(mark, "line", 0) or 0) + 1, (getattr(mark, "col", 0) or 0) + 1)
        document.value = _plain(root, (), Place(where, where), place, document, [])
        return document
    except MarkedYAMLError as error:
        if mark := error.problem_mark or error.context_mark:
            where = place(mark.line + 1, mark.column + 1)
        problem = f"not valid YAML: {error.problem or error.context}"
    except (YAMLError, ValueError) as error:
        problem = f"not valid YAML: {str(error).splitlines()[0]}"
    except RecursionError:
        problem = "lists or mappings are nested too deeply"
    return Document(problems=[f"{where}: {problem}"], readable=False)


def _plain(
    value: Any,
    location: Location,
    at: Place,
    place: Callable[[int, int], str],
    document: Document,
    around: list[int],
) -> Any:
    """Return a value of ruamel.yaml as Python's own, and note where it and its values stand."""
    document.places[location] = at
    if len(document.places) > MAX_VALUES:
        raise ValueError(f"more than {MAX_VALUES} values, aliases written out; write fewer")
    if isinstance(value, Mapping | list) and id(value) not in around:
        around.append(id(value))
        marks = getattr(getattr(value, "lc", None), "data", None) or {}  # none of what a tag makes
        items: dict[Any, Any] = {}
        for key, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            name = str(key).lower() if isinstance(key, bool) else str(key)
            own, of_value = marks.get(key, ())[:2], marks.get(key, ())[2:]
            here = place(*(n + 1 for n in own)) if own else at.value
            if not isinstance(key, str | int | float):
                document.problems.append(f"{here}: a key must be a string")
                continue
            there = place(*(n + 1 for n in of_value)) if of_value and inner is not None else here
            step = len(items) if isinstance(value, list) else name
            items[step] = _plain(
                inner, (*location, step), Place(here, there), place, document, around
            )
        around.pop()
        return items if isinstance(value, Mapping) else list(items.values())
    if value is None or isinstance(value, bool):
        return value
    problem = "is no number, text, list or mapping; leave out the tag"
    if isinstance(value, str):
        if not any("\ud800" <= letter <= "\udfff" for letter in value):
            return str(value)
        problem = f"{str(value)!r} contains an unpaired surrogate; write it whole"
    elif isinstance(value, float):
        return float(value)
    elif isinstance(value, int):
        if abs(value) <= MAX_INTEGER:
            return int(value)
        problem = f"a whole number beyond {MAX_INTEGER}; write a smaller one"
    elif isinstance(value, Mapping | list):
        problem = "an alias contains itself; write it out"
    document.problems.append(f"{at.value}: {problem}")
    return None
