"""JSON files: the keys that one begins with, its contents, and what an unknown one may be."""

from __future__ import annotations

import gc
import json
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, Literal

import orjson

from shapefit.errors import InputError, abbreviate, input_error
from shapefit.io.foreign.recording import Recording
from shapefit.io.sources import BYTE_ORDER_MARK, read_whole

Paths = tuple[Path, ...]

_NUMBERS = re.compile(rb"[-+\d.eE,\s]{8,}")
_TOKENS = re.compile(rb'"((?:[^"\\]|\\.)*)"\s*(:?)|[{}\[\]]', re.DOTALL)
_KEYPOINTS = re.compile(rb'\[\s*\{\s*"keypoints"\s*:\s*\[\s*([-\d\[])')
_NOT_JSON = re.compile(rb"\b(?:NaN|-?Infinity)\b")

_KNOWN = {
    "COCO annotations": ("images", "annotations", "categories"),
    "COCO results": ("image_id", "category_id", "keypoints", "score"),
    "OpenPose": ("version", "people", "pose_keypoints_2d"),
    "MMPose": ("frame_id", "instances", "keypoints", "keypoint_scores", "meta_info"),
}


@dataclass(frozen=True)
class Outline:
    """What the beginning of a JSON file shows: `kind` is { or [, "" where it is no JSON.

    keys are those of the outermost object, or of the objects in the outermost list; `points` is
    pairs or flat, as the keypoints of the first of these, where they are so many that no other
    key is seen.
    """

    kind: str
    keys: frozenset[str]
    points: Literal["pairs", "flat", ""] = ""


@lru_cache(maxsize=4)
def outline(head: bytes) -> Outline:
    """Return the keys in the first bytes of a file, which may end anywhere."""
    text = head.removeprefix(BYTE_ORDER_MARK).lstrip()
    if text[:1] not in (b"{", b"["):
        return Outline("", frozenset())
    kind = text[:1].decode()
    level, depth, keys = (1 if kind == "{" else 2), 0, set()
    for token in _TOKENS.finditer(_NUMBERS.sub(b" ", text)):
        mark = token[0][:1]
        if mark in b"{[":
            depth += 1
        elif mark in b"}]":
            depth -= 1
        elif token[2] and depth == level:
            keys.add(token[1].decode("utf-8", "replace"))
    return Outline(kind, frozenset(keys), _points(text) if keys == {"keypoints"} else "")


def _points(text: bytes) -> Literal["pairs", "flat", ""]:
    found = _KEYPOINTS.match(text)
    if not found:
        return ""
    return "pairs" if found[1] == b"[" else "flat"


def first_outline(folder: Path, suffix: str = ".json", head_bytes: int = 4096) -> list[Outline]:
    """Return the outlines of the first few JSON files of a folder, by name."""
    names = sorted(name for name in os.listdir(folder) if name.lower().endswith(suffix))
    found = []
    for name in names[:5]:
        path = folder / name
        if path.is_file() and os.access(path, os.R_OK):
            with path.open("rb") as file:
                found.append(outline(file.read(head_bytes)))
    return found


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


def unknown_json(path: Path, head: bytes) -> InputError:
    """Return the error for JSON that is in no known format: what it has, what was looked for."""
    own = outline(head)
    place = "an object" if own.kind == "{" else "a list of objects"
    names = sorted(own.keys)
    found = f"{place} with {abbreviate(names)}" if names else f"{place} without names"
    looked = "; ".join(f"{title} ({', '.join(keys)})" for title, keys in _KNOWN.items())
    shared = {title: len(own.keys & set(keys)) for title, keys in _KNOWN.items()}
    near = max(shared, key=lambda title: shared[title])
    hint = f"the nearest is {near}" if shared[near] else "none of them is near"
    if {"shapes", "imagePath"} <= own.keys:
        hint = "it is LabelMe's: export it as COCO keypoints"
    return input_error(path, f"is JSON of no known kind, {found}", f"known are {looked}; {hint}")
