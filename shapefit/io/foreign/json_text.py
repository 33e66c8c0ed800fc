"""JSON files, read whole."""

from __future__ import annotations

import gc
import json
import re
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import orjson

from shapefit.errors import input_error
from shapefit.io.foreign.recording import Recording
from shapefit.io.sources import BYTE_ORDER_MARK, read_whole

Paths = tuple[Path, ...]

_NOT_JSON = re.compile(rb"\b(?:NaN|-?Infinity)\b")


def read_json(path: Path) -> Any:
    """Return the contents of a JSON file; NaN and Infinity, which Python writes, are read, too.

    Raises InputError for a file that is too large or damaged, naming the line.
    """
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


def without_collection(record: Callable[[Paths], Recording]) -> Callable[[Paths], Recording]:
    """Return a reader during which the garbage collector rests.

    It would walk again and again over the millions of lists of a large file, several times as slow.
    """

    @wraps(record)
    def resting(paths: Paths) -> Recording:
        running = gc.isenabled()
        gc.disable()
        try:
            return record(paths)
        finally:
            if running:
                gc.enable()

    return resting
