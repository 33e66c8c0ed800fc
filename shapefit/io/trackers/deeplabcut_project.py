"""The skeleton of a DeepLabCut project, from the `config.yaml` near a table of its landmarks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from shapefit.io.sources import is_stream
from shapefit.stores.urls import UrlPath

FILE = "config.yaml"
FOLDERS_ABOVE = 2
"""Predictions lie in a folder of the project, labels in a folder of that."""


def skeleton_edges(path: Path, names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the edges of `skeleton` between these landmarks, by place in `names`.

    It lists pairs of names, or chains of them. A pair with a name that the table has not is left
    out; a file that is no YAML, or not of DeepLabCut, says nothing.
    """
    if is_stream(path) or isinstance(path, UrlPath):
        return ()
    folder = path.resolve().parent
    near = (each / FILE for each in (folder, *folder.parents[:FOLDERS_ABOVE]))
    found = next((each for each in near if each.is_file()), None)
    place = {name: number for number, name in enumerate(names)}
    pairs = () if found is None else _pairs(found)
    edges = ((place[a], place[b]) for a, b in pairs if a != b and a in place and b in place)
    return tuple(dict.fromkeys(edges))


def _pairs(path: Path) -> Iterator[tuple[str, str]]:
    """Yield neighbours of each chain in the skeleton of a project."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        found: Any = YAML(typ="safe", pure=True).load(path)
    except (YAMLError, OSError, ValueError, RecursionError):
        return
    chains = found.get("skeleton") if isinstance(found, dict) else None
    for chain in chains if isinstance(chains, list) else ():
        if isinstance(chain, list):
            yield from pairwise(map(str, chain))
