"""What the commands say of wrong input, in the words of Python: `a="b"` for `--set a=b`."""

from __future__ import annotations

import functools
import json
import re
import warnings
from collections.abc import Callable, Iterable
from typing import ParamSpec, TypeVar

from shapefit.config.yaml12 import read_yaml
from shapefit.errors import InputError
from shapefit.pipelines.outcome import Note

_SETTING = re.compile(r"`(?:--set )?([a-z_]+(?:\.[a-z_]+)*)(?:=|: )([^`]+)`")
"""A key with a value, as the command line or YAML has it."""

P = ParamSpec("P")
R = TypeVar("R")


def in_python(text: str) -> str:
    """Return a message with keyword arguments in place of settings."""
    return _SETTING.sub(_argument, text)


def _argument(found: re.Match[str]) -> str:
    name, *keys = found[1].split(".")
    document = read_yaml(found[2], lambda _line, _column: "")
    if document.problems:
        return found[0]
    value = document.value
    for key in reversed(keys):
        value = {key: value}
    text = repr(value) if isinstance(value, bool | None) else json.dumps(value)
    return f"`{'lam' if name == 'lambda' else name}={text}`"


def speaks_python(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function whose errors advise arguments of Python."""

    @functools.wraps(function)
    def speaking(*args: P.args, **options: P.kwargs) -> R:
        try:
            return function(*args, **options)
        except InputError as error:
            raise InputError(map(in_python, error.problems)) from None

    return speaking


def warn(messages: Iterable[object]) -> None:
    """Warn where a function that `speaks_python` was called; notes are no warnings."""
    for message in messages:
        if not isinstance(message, Note):
            warnings.warn(in_python(str(message)), stacklevel=4)
