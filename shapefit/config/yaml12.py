"""YAML 1.2 read into plain values, each with its line and column."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError, RoundTripConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning
from ruamel.yaml.nodes import ScalarNode

Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""

MOST_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

LARGEST_INTEGER = 2**63 - 1

# The core schema, section 10.3.2: ruamel.yaml also takes 1_000, 0b1 and signs before 0x.
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_BASES = {"0o": 8, "0x": 16}


class _Constructor(RoundTripConstructor):
    """Numbers as in the core schema, everything else that is no boolean or null as text."""

    def number(self, node: ScalarNode) -> int | float | str:
        text = str(node.value)
        if _INTEGER.fullmatch(text):
            return int(text, _BASES.get(text[:2], 10))
        return float(re.sub(r"\.(?=[in])", "", text.lower())) if _FLOAT.fullmatch(text) else text

    def truth(self, node: ScalarNode) -> bool | str:
        return {"true": True, "false": False}.get(node.value.lower(), str(node.value))

    def text(self, node: ScalarNode) -> str:
        return str(node.value)

    def check_mapping_key(
        self, node: Any, key_node: Any, mapping: Any, key: Any, value: Any
    ) -> bool:
        """Refuse a repeated key without its values, which may be aliases of aliases."""
        if key in mapping:
            found = f'found duplicate key "{key}"'
            start = "while constructing a mapping"
            raise DuplicateKeyError(start, node.start_mark, found, key_node.start_mark)
        return True


for _tag, _construct in {
    "int": _Constructor.number,
    "float": _Constructor.number,
    "bool": _Constructor.truth,
    "timestamp": _Constructor.text,
    "binary": _Constructor.text,
}.items():
    _Constructor.add_constructor(f"tag:yaml.org,2002:{_tag}", _construct)


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
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and anchors given again
            return _Reader(place).read(yaml.load(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = place(mark.line + 1, mark.column + 1) if mark else place(1, 1)
        problem = f"{where}: not valid YAML: {error.problem or error.context}"
    except YAMLError as error:
        problem = f"{place(1, 1)}: not valid YAML: {str(error).splitlines()[0]}"
    except RecursionError:
        problem = f"{place(1, 1)}: lists or mappings are nested too deeply"
    return Document(problems=[problem], readable=False)


class _Reader:
    """Makes plain values of those of ruamel.yaml, whose `lc` says where they stand."""

    def __init__(self, place: Callable[[int, int], str]) -> None:
        self._place = place
        self._around: list[int] = []
        self._document = Document()

    def read(self, root: Any) -> Document:
        lc = getattr(root, "lc", None)
        here = self._at(getattr(lc, "line", 0) or 0, getattr(lc, "col", 0) or 0)
        self._document.value = self._plain(root, (), here)
        if len(self._document.places) > MOST_VALUES:
            found = f"more than {MOST_VALUES} values, aliases written out; a config must be small"
            return Document(problems=[f"{self._place(1, 1)}: {found}"], readable=False)
        self._document.places[()] = (here, here)
        return self._document

    def _at(self, line: int, column: int) -> str:
        return self._place(line + 1, column + 1)

    def _plain(self, value: Any, location: Location, here: str) -> Any:
        """Return the plain value at `location`, which stands `here`; note the places in it."""
        problem = ""
        if id(value) in self._around:
            problem = "an alias contains itself; write it out"
        elif isinstance(value, Mapping | list):
            self._around.append(id(value))
            values = self._inner(value, location, here)
            self._around.pop()
            return values
        elif isinstance(value, str):
            if not any("\ud800" <= letter <= "\udfff" for letter in value):
                return str(value)
            problem = f"{str(value)!r} contains an unpaired surrogate; write it whole"
        elif isinstance(value, int) and abs(value) > LARGEST_INTEGER:
            problem = f"a whole number beyond {LARGEST_INTEGER}; write a smaller one"
        elif value is None or isinstance(value, bool | int | float):
            return value
        else:
            problem = "is no number, text, list or mapping; leave out the tag"
        self._document.problems.append(f"{here}: {problem}")
        return None

    def _inner(self, values: Any, location: Location, here: str) -> Any:
        lc = getattr(values, "lc", None)
        places = getattr(lc, "data", None) or {}  # none of what a tag or `<<` makes
        if isinstance(values, list):
            found: Any = []
            for index, inner in enumerate(values):
                own = self._at(*places[index][:2]) if index in places else here
                found.append(self._placed(inner, (*location, index), own, own))
            return found
        found = {}
        for key, inner in values.items():
            own = self._at(*places[key][:2]) if key in places else here
            if not isinstance(key, str | int | float):
                self._document.problems.append(f"{own}: a key must be a string")
                continue
            said = self._at(*places[key][2:]) if key in places and inner is not None else own
            name = str(key).lower() if isinstance(key, bool) else str(key)
            found[name] = self._placed(inner, (*location, name), own, said)
        return found

    def _placed(self, value: Any, location: Location, key: str, here: str) -> Any:
        self._document.places[location] = (key, here)
        many = len(self._document.places) > MOST_VALUES
        return None if many else self._plain(value, location, here)
