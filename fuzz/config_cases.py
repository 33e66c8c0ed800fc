"""YAML files and --set options: wrong and right values for every key that a command knows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from shapefit.config.loader import CONFIGS
from shapefit.config.model import field_keys, submodel

from .texts import YAML_VALUES

COMMANDS = {
    "learn-dict": {"shapes": "shapes.h5", "output": "out.h5", "k": "3", "iterations": "2"},
    "project": {"shapes": "shapes.h5", "output": "out.h5"},
    "fit": {"landmarks": "views.h5", "dictionary": "dict.h5", "output": "out.h5", "threads": "1"},
    "eval": {"results": "result.h5", "truth": "shapes.h5", "output": "out", "plots": "false"},
    "view": {"files": "result.h5", "truth": "shapes.h5", "output": "out.html"},
    "simulate": {"output": "out", "k": "6", "landmarks": "[5]", "active_atoms": "[1, 2]"}
    | {"trials": "1", "plots": "false", "threads": "1"},
    "sweep": {"truth": "shapes.h5", "output": "out", "vary": "{fit.lambda: [0.1, 0.2]}"}
    | {"fit": "{landmarks: views.h5, dictionary: dict.h5, threads: 1}", "plots": "false"},
}
"""A good config of each command."""

SLOW = ("trials", "k", "landmarks")
"""Keys whose large values are right and take long."""


def _dotted(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, field in field_keys(model).items():
        yield prefix + key, field.annotation
        inner = submodel(field)
        if inner is not None:
            yield from _dotted(inner, f"{prefix}{key}.")


KEYS = {command: list(_dotted(CONFIGS[command])) for command in COMMANDS}


def _right_value(rng: Random, annotation: Any) -> str:
    """Return a value that the type admits, whatever else the schema says."""
    kinds = (
        [annotation] if get_origin(annotation) is Literal else [annotation, *get_args(annotation)]
    )
    kind = rng.choice(kinds)
    if get_origin(kind) is Literal:
        return str(rng.choice(get_args(kind)))
    if kind is bool:
        return rng.choice(("true", "false"))
    if kind is int:
        return str(rng.choice((0, 1, 2, 3, 7, 50)))
    if kind is float:
        return f"{10.0 ** rng.uniform(-9, 9):.3g}"
    return rng.choice(YAML_VALUES)


def _setting(rng: Random, command: str) -> tuple[str, str]:
    key, annotation = rng.choice(KEYS[command])
    value = _right_value(rng, annotation) if rng.random() < 0.6 else rng.choice(YAML_VALUES)
    if key.rpartition(".")[2] in SLOW and value.strip("[]'\"+-").isdigit():
        value = str(min(int(value.strip("[]'\"+-")), 4))
    return key, value


def make_options(rng: Random, _folder: Path) -> tuple[str, ...]:
    """A good command with some options more."""
    command = rng.choice(list(COMMANDS))
    settings = [*COMMANDS[command].items()]
    settings += [_setting(rng, command) for _ in range(rng.choice((1, 1, 2, 3)))]
    if rng.random() < 0.1:
        settings.append((rng.choice(("", "a", ".", "a..b", "output.x", "fit", "\x1b[2J")), "1"))
    options = [f"{key}={value}".replace("\0", "") for key, value in settings]
    return (command, *(word for option in options for word in ("--set", _encodable(option))))


def _encodable(text: str) -> str:
    """Return what a shell can hand over."""
    return text.encode("utf-8", "replace").decode()


def make_yaml(rng: Random, folder: Path) -> tuple[str, ...]:
    """A good config with some keys more, spoiled as a text."""
    command = rng.choice(list(COMMANDS))
    settings = COMMANDS[command] | dict(
        _setting(rng, command) for _ in range(rng.choice((0, 1, 2)))
    )
    lines = []
    for key, value in settings.items():
        *sections, last = key.split(".")
        text = f"{last}: {value}"
        for section in reversed(sections):
            text = f"{section}: {{{text}}}"
        lines.append(text)
    text = "\n".join(lines) + "\n"
    for _ in range(rng.choice((0, 1, 1, 2))):
        text = rng.choice(_SPOILS)(rng, text)
    (folder / "config.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    return (command, "-c", "config.yaml")


def _insert(rng: Random, text: str, piece: str) -> str:
    place = rng.randrange(len(text) + 1)
    return text[:place] + piece + text[place:]


def _bomb(rng: Random, text: str) -> str:
    lists = ["&a [x,x,x,x,x,x,x,x,x,x]"]
    for number in range(rng.randrange(9)):
        lists.append(f"&{chr(98 + number)} [{','.join(['*' + chr(97 + number)] * 10)}]")
    return f"{text}metrics: [{', '.join(lists)}]\n"


_SPOILS = (
    lambda rng, text: text[: rng.randrange(len(text) + 1)],
    lambda rng, text: _insert(rng, text, rng.choice(":-[]{}#&*!|>'\"%@`,?\t\n\0\r\x85\u2028")),
    lambda rng, text: _insert(rng, text, rng.choice(YAML_VALUES)),
    lambda rng, text: text + rng.choice(text.splitlines() or [""]) + "\n",
    lambda rng, text: _insert(rng, text, "[" * rng.choice((10, 3000))),
    lambda rng, text: text.replace("\n", rng.choice(("\n  ", "\r", "\n---\n", "\n...\n", "\n\t"))),
    lambda rng, text: _insert(rng, text, chr(rng.choice((0xD800, 0xFEFF, 0x10FFFF, 0xE9, 7)))),
    _bomb,
    lambda rng, text: "%YAML 1.1\n---\n" + text,
)
