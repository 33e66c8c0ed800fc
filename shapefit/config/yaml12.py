"""YAML 1.2 read into plain values, with the place of each."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError, YAMLWarning
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from shapefit.config.model import Location, Place

_NUMBER_TAGS = {f"tag:yaml.org,2002:{name}" for name in ("int", "float")}
_SCALAR_TAGS = _NUMBER_TAGS | {f"tag:yaml.org,2002:{name}" for name in ("null", "bool")}

# The core schema, section 10.3.2: ruamel.yaml also takes 1_000, 0b1 and signs before 0x.
_NUMBER = re.compile(
    r"[-+]?[0-9]+ | 0o[0-7]+ | 0x[0-9a-fA-F]+"
    r"| [-+]?(\.[0-9]+ | [0-9]+(\.[0-9]*)?) ([eE][-+]?[0-9]+)?"
    r"| [-+]?\.(inf|Inf|INF) | \.(nan|NaN|NAN)",
    re.VERBOSE,
)


MOST_VALUES = 100_000
"""Aliases of aliases make more of them than memory holds, from a few lines."""

LARGEST_INTEGER = 2**63 - 1


class _TooMuch(Exception):
    """A document has more than `MOST_VALUES` values."""


@dataclass
class Document:
    """What one YAML text says: plain values, the place of each, and what is wrong with it.

    Where it is not `readable`, nothing is known about its values.
    """

    value: Any = None
    places: dict[Location, Place] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    readable: bool = True


def read_yaml(text: str, place: Callable[[int, int], str]) -> Document:
    """Return what `text` says; `place` names a line and column, both from 1.

    Numbers, true, false and null are as in YAML 1.2's core schema; everything else, dates too,
    is text. A mapping's keys are always text; the first of a repeated key counts.
    """
    document = Document()
    yaml = YAML(typ="safe", pure=True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)  # on YAML 1.1, and anchors given again
            root = yaml.compose(text)
            if root is not None:
                _Reader(yaml, place, document).read(root)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = place(mark.line + 1, mark.column + 1) if mark else place(1, 1)
        document.problems.append(f"{where}: not valid YAML: {error.problem or error.context}")
    except YAMLError as error:
        document.problems.append(f"{place(1, 1)}: not valid YAML: {str(error).splitlines()[0]}")
    except _TooMuch:
        found = f"more than {MOST_VALUES} values, aliases written out"
        document.problems.append(f"{place(1, 1)}: {found}; a config must be small")
    except RecursionError:
        document.problems.append(f"{place(1, 1)}: lists or mappings are nested too deeply")
    else:
        return document
    return replace(document, value=None, readable=False)


def _is_absent(node: Node) -> bool:
    return bool(node.start_mark.index == node.end_mark.index)


class _Reader:
    def __init__(self, yaml: YAML, place: Callable[[int, int], str], document: Document) -> None:
        self._construct = yaml.constructor.construct_object
        self._place = place
        self._document = document
        self._around: list[Node] = []
        self._count = 0

    def read(self, root: Node) -> None:
        self._document.value = self._value(root, ())
        self._document.places[()] = Place(self._at(root), self._at(root))

    def _at(self, node: Node) -> str:
        return self._place(node.start_mark.line + 1, node.start_mark.column + 1)

    def _value(self, node: Node, location: Location) -> Any:
        self._count += 1
        if self._count > MOST_VALUES:
            raise _TooMuch
        if node in self._around:
            self._document.problems.append(
                f"{self._at(node)}: an alias contains itself; write it out"
            )
            return None
        self._around.append(node)
        value: Any
        if isinstance(node, MappingNode):
            value = self._mapping(node, location)
        elif isinstance(node, SequenceNode):
            value = self._sequence(node, location)
        else:
            value = self._scalar(node)
        self._around.pop()
        return value

    def _mapping(self, node: MappingNode, location: Location) -> dict[str, Any]:
        values: dict[str, Any] = {}
        first: dict[str, str] = {}
        for key_node, value_node in node.value:
            key = key_node.value
            if not isinstance(key_node, ScalarNode):
                self._document.problems.append(f"{self._at(key_node)}: a key must be a string")
            elif key in values:
                self._document.problems.append(
                    f"{self._at(key_node)}: repeated key {key!r}, first at {first[key]}; "
                    "keep one of them"
                )
            else:
                first[key] = self._at(key_node)
                child = (*location, key)
                said = key_node if _is_absent(value_node) else value_node
                self._document.places[child] = Place(first[key], self._at(said))
                values[key] = self._value(value_node, child)
        return values

    def _sequence(self, node: SequenceNode, location: Location) -> list[Any]:
        values = []
        for index, item in enumerate(node.value):
            child = (*location, index)
            self._document.places[child] = Place(self._at(item), self._at(item))
            values.append(self._value(item, child))
        return values

    def _text(self, node: Node) -> str | None:
        r"""Return a string that UTF-8 can hold; `\ud800` in quotes is an unpaired surrogate."""
        text = str(node.value)
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            self._document.problems.append(
                f"{self._at(node)}: {text!r} contains an unpaired surrogate; write it whole"
            )
            return None
        return text

    def _scalar(self, node: Node) -> Any:
        if node.tag not in _SCALAR_TAGS:
            return self._text(node)
        try:
            value = self._construct(node)
        except (ValueError, KeyError, IndexError):  # of !!int x, !!bool x, !!int ""
            self._document.problems.append(
                f"{self._at(node)}: {node.value!r} does not match its tag"
            )
            return None
        if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
            self._document.problems.append(
                f"{self._at(node)}: a whole number beyond {LARGEST_INTEGER}; write a smaller one"
            )
            return None
        is_text = node.tag in _NUMBER_TAGS and not _NUMBER.fullmatch(node.value)
        return node.value if is_text else value
