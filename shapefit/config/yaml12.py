"""YAML 1.2 read into plain values, each with its line and column, by ruamel.yaml."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import (
    ConstructorError,
    DuplicateKeyError,
    RoundTripConstructor,
)
from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning

from shapefit.config.model import Location
from shapefit.errors import InputError

MAX_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

MAX_INTEGER = 2**63 - 1


Places = dict[Location, tuple[str, str]]
"""Where a key and its value stand, as a message names them."""


class _Constructor(RoundTripConstructor):
    """Dates and binary data are texts; a repeated key is refused without writing out its values."""

    def check_mapping_key(
        self, node: Any, key_node: Any, mapping: Any, key: Any, value: Any
    ) -> bool:
        try:
            repeated = key in mapping
        except TypeError:  # a list or a mapping as key
            fault = "found a key that is no text"
            raise ConstructorError(None, node.start_mark, fault, key_node.start_mark) from None
        if repeated:
            fault = f'found duplicate key "{key}"'
            raise DuplicateKeyError(None, node.start_mark, fault, key_node.start_mark)
        return True


for _tag in ("timestamp", "binary"):
    _Constructor.add_constructor(f"tag:yaml.org,2002:{_tag}", lambda _, node: str(node.value))


def read_yaml(text: str, place: Callable[[int, int], str]) -> tuple[Any, Places]:
    """Return the values of a YAML text and the place of each.

    `place` words a line and column, both from 1. The keys of mappings are texts. Raises InputError
    for what is not YAML, and for values that are no number, text, list or mapping.
    """
    yaml = YAML(pure=True)
    yaml.Constructor = _Constructor
    at, places = place(1, 1), Places()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and repeated anchors
            root = yaml.load(text)
        return _plain(root, (), (at, at), place, places), places
    except MarkedYAMLError as error:
        if mark := error.problem_mark or error.context_mark:
            at = place(mark.line + 1, mark.column + 1)
        problem = f"not valid YAML: {error.problem or error.context}"
    except (YAMLError, ValueError) as error:
        problem = f"not valid YAML: {str(error).splitlines()[0]}"
    except RecursionError:
        problem = "lists or mappings are nested too deeply, or an alias contains itself"
    raise InputError(f"{at}: {problem}")


def _plain(
    value: Any,
    location: Location,
    at: tuple[str, str],
    place: Callable[[int, int], str],
    places: Places,
) -> Any:
    """Return a value of ruamel.yaml as Python's own, and note where it and its values stand."""
    places[location] = at
    if len(places) > MAX_VALUES:
        raise ValueError(f"more than {MAX_VALUES} values, aliases written out; write fewer")
    if isinstance(value, Mapping | list):
        marks = getattr(getattr(value, "lc", None), "data", None) or {}  # none of what a tag makes
        items: dict[Any, Any] = {}
        for key, inner in value.items() if isinstance(value, Mapping) else enumerate(value):
            mark = [number + 1 for number in marks.get(key, ())]
            of_key = place(*mark[:2]) if mark else at[1]
            if not isinstance(key, str | int | float):
                raise InputError(f"{of_key}: a key must be a string")
            of_value = place(*mark[-2:]) if mark and inner is not None else of_key
            name = str(key).lower() if isinstance(key, bool) else str(key)
            step = len(items) if isinstance(value, list) else name
            items[step] = _plain(inner, (*location, step), (of_key, of_value), place, places)
        return items if isinstance(value, Mapping) else list(items.values())
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str) and not any("\ud800" <= letter <= "\udfff" for letter in value):
        return str(value)
    if isinstance(value, float):
        return float(value)
    if isinstance(value, int) and abs(value) <= MAX_INTEGER:
        return int(value)
    fault = f"{str(value)!r} is no number, text, list or mapping that a config can hold"
    raise InputError(f"{at[1]}: {fault}; write a plain value")
