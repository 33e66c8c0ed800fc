"""Lists of names in attributes of pandas: pickles, which are walked here and never executed."""

from __future__ import annotations

import pickletools
from typing import Any

from shapefit.errors import input_error, printable

ALLOWED = frozenset(
    ("MARK", "LIST", "TUPLE", "INT", "LONG", "UNICODE", "PUT", "GET", "APPEND", "STOP")
)
"""Opcodes of lists and tuples of names and numbers in protocol 0; no other one is understood."""

FIX = "save it as CSV"

_MARK = object()


def names_of(place: str, pickled: Any) -> list[Any]:
    """Return the list that an attribute at `place` holds.

    Raises InputError for what is not such a list, naming the opcode where there is another.
    """
    if not isinstance(pickled, bytes):
        raise input_error(place, "holds no list of names", FIX)
    try:
        found = _walk(place, pickled)
    except (ValueError, IndexError, KeyError, UnicodeError, OverflowError) as error:
        text = printable(str(error).partition("\n")[0])
        raise input_error(place, f"holds a list that cannot be read ({text})", FIX) from error
    if not isinstance(found, list):
        raise input_error(place, "holds no list of names", FIX)
    return found


def _walk(place: str, pickled: bytes) -> Any:
    stack: list[Any] = []
    memory: dict[int, Any] = {}
    for code, argument, _ in pickletools.genops(pickled):
        name = code.name
        if name not in ALLOWED:
            raise input_error(place, f"holds the opcode {name}, which is not read here", FIX)
        if name == "STOP":
            break
        if name == "MARK":
            stack.append(_MARK)
        elif name in ("LIST", "TUPLE"):
            values = _pop_to_mark(stack)
            stack.append(values if name == "LIST" else tuple(values))
        elif name == "PUT":
            memory[int(argument or 0)] = stack[-1]
        elif name == "GET":
            stack.append(memory[int(argument or 0)])
        elif name == "APPEND":
            value = stack.pop()
            if not isinstance(stack[-1], list):
                raise ValueError("a value is appended to what is no list")
            stack[-1].append(value)
        else:
            stack.append(argument)
    return stack.pop()


def _pop_to_mark(stack: list[Any]) -> list[Any]:
    values: list[Any] = []
    while (value := stack.pop()) is not _MARK:
        values.append(value)
    return values[::-1]
