"""YAML read into plain values, each with its line and column, by ruamel.yaml."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError, RoundTripConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning

Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""

MOST_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

LARGEST_INTEGER = 2**63 - 1


class _Constructor(RoundTripConstructor):
    """Dates are texts; a repeated key is refused without its values, which may be secrets."""

    def check_mapping_key(
        self, node: Any, key_node: Any, mapping: Any, key: Any, value: Any
    ) -> bool:
        if key in mapping:
            found = f'found duplicate key "{key}"'
            start = "while constructing a mapping"
            raise DuplicateKeyError(start, node.start_mark, found, key_node.start_mark)
        return True


for _tag in ("timestamp", "binary"):
    _Constructor.add_constructor(
        f"tag:yaml.org,2002:{_tag}", lambda constructor, node: str(node.value)
    )


@dataclass
class Document:
    """What one YAML text says: plain values, the place of each, and what is wrong with it.

    places holds for each location where its key stands, and where its value. Where the text is not
    `readable`, nothing is known about its values.
    """

    value: Any = None
    places: dict[Location, tuple[str, str]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    readable: bool = True


def read_yaml(text: str, place: Callable[[int, int], str]) -> Document:
    """Return what `text` says; `place` names a line and column, both from 1.

    A mapping's keys are always text; a repeated key is an error.
    """
    yaml = YAML(pure=True)
    yaml.Constructor = _Constructor
    where = place(1, 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and anchors given again
            return _plain_document(yaml.load(text), place)
    except MarkedYAMLError as error:
        if mark := error.problem_mark or error.context_mark:
            where = place(mark.line + 1, mark.column + 1)
        problem = f"not valid YAML: {error.problem or error.context}"
    except (YAMLError, ValueError) as error:
        problem = f"not valid YAML: {str(error).splitlines()[0]}"
    except RecursionError:
        problem = "lists or mappings are nested too deeply"
    return Document(problems=[f"{where}: {problem}"], readable=False)


def _plain_document(root: Any, place: Callable[[int, int], str]) -> Document:
    """Return the plain values of those of ruamel.yaml, whose `lc` says where they stand."""
    document = Document()
    around: list[int] = []

    def plain(value: Any, location: Location, key: str, here: str) -> Any:
        """Return the plain value at `location`, which stands `here`; note the places in it."""
        document.places[location] = key, here
        if len(document.places) > MOST_VALUES:
            return None
        if isinstance(value, Mapping | list) and id(value) not in around:
            around.append(id(value))
            found = inner(value, location, here)
            around.pop()
            return found
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
            if abs(value) <= LARGEST_INTEGER:
                return int(value)
            problem = f"a whole number beyond {LARGEST_INTEGER}; write a smaller one"
        elif isinstance(value, Mapping | list):
            problem = "an alias contains itself; write it out"
        document.problems.append(f"{here}: {problem}")
        return None

    def inner(values: Any, location: Location, here: str) -> Any:
        """Return the plain values of a list or a mapping that stands `here`."""
        places = (
            getattr(getattr(values, "lc", None), "data", None) or {}
        )  # none of what a tag makes

        def placed(key: Any, end: slice) -> str:
            line, column = places[key][end]
            return place(line + 1, column + 1)

        if isinstance(values, list):
            own = [placed(i, slice(2)) if i in places else here for i in range(len(values))]
            return [plain(v, (*location, i), own[i], own[i]) for i, v in enumerate(values)]
        found = {}
        for key, value in values.items():
            own_place = placed(key, slice(2)) if key in places else here
            if not isinstance(key, str | int | float):
                document.problems.append(f"{own_place}: a key must be a string")
                continue
            said = placed(key, slice(2, 4)) if key in places and value is not None else own_place
            name = str(key).lower() if isinstance(key, bool) else str(key)
            found[name] = plain(value, (*location, name), own_place, said)
        return found

    lc = getattr(root, "lc", None)
    top = place((getattr(lc, "line", 0) or 0) + 1, (getattr(lc, "col", 0) or 0) + 1)
    document.value = plain(root, (), top, top)
    if len(document.places) > MOST_VALUES:
        found = f"more than {MOST_VALUES} values, aliases written out; a config must be small"
        return Document(problems=[f"{place(1, 1)}: {found}"], readable=False)
    return document
