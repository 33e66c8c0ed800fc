"""JSON files, read whole; what is read to recognise a file is kept until its reader asks for it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from shapefit.errors import input_error
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole

_NOT_JSON = re.compile(rb"\b(?:NaN|-?Infinity)\b")

MAX_CACHED = 1 << 27
"""Bytes of a JSON file whose content is kept from its recognition until it is read."""

_cached: tuple[Any, Any] = (None, None)


def read_json(path: Path, *, keep: bool = False) -> Any:
    """Return the content of a JSON file, and `keep` it for the next call, or give up what was kept.

    Raises InputError for a file that is too large or damaged, naming the line.
    """
    global _cached
    state = os.stat(path)
    key = (str(path), state.st_mtime_ns, state.st_size)
    before, content = _cached
    if before != key:
        content = _parse(path)
    _cached = (key, content) if keep and state.st_size <= MAX_CACHED else (None, None)
    return content


def _parse(path: Path) -> Any:
    """Return the content of a JSON file; NaN and Infinity, which Python writes, are read, too."""
    import json

    import orjson

    data = read_whole(path).removeprefix(BYTE_ORDER_MARK)
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError as error:
        if _NOT_JSON.search(data):
            try:
                return json.loads(data)
            except (ValueError, RecursionError):
                pass
        if not data.strip():
            raise input_error(path, "is empty", "make or copy the file again") from error
        found = f"is not whole JSON ({error.msg})"
        raise input_error(f"{path}:{error.lineno}", found, "make or copy the file again") from error
