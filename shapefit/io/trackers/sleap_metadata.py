"""The JSON in a SLEAP .slp file: skeletons, tracks and videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.errors import input_error, printable
from shapefit.io.trackers.frame_names import apart, name_of
from shapefit.io.trackers.reading import DAMAGED, TrackerFile, check_unique

METADATA = "metadata"

BODY = 1
"""The type of a link between nodes that is part of the body; others are symmetries."""


@dataclass(frozen=True)
class Metadata:
    """What a file says of its instances.

    version of the format; skeletons, each the names of its nodes in order; edges between
    landmarks, by place in `landmarks`; names of tracks and videos.
    """

    version: float
    skeletons: tuple[tuple[str, ...], ...]
    edges: tuple[tuple[int, int], ...]
    tracks: tuple[str, ...]
    videos: tuple[str, ...]

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Names of the nodes of all skeletons, in order of appearance."""
        return tuple(dict.fromkeys(name for skeleton in self.skeletons for name in skeleton))

    def columns(self) -> list[NDArray[np.intp]]:
        """Return the place of each node of each skeleton in `landmarks`."""
        place = {name: number for number, name in enumerate(self.landmarks)}
        return [
            np.array([place[name] for name in skeleton], np.intp) for skeleton in self.skeletons
        ]


def read_metadata(file: TrackerFile) -> Metadata:
    """Read the metadata of a file. Raises InputError where they are damaged."""
    version = file.attribute("format_id", METADATA)
    place = f"{file.place(METADATA)}@json"
    found = _parse(place, file.attribute("json", METADATA))
    try:
        nodes = [str(node["name"]) for node in found["nodes"]]
        skeletons, edges = _skeletons(found["skeletons"], nodes)
        tracks = [str(_parse("", text)[1]) for text in _texts(file, "tracks_json")]
        videos = [_video(_parse("", text)) for text in _texts(file, "videos_json")]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        what = f"is not as SLEAP writes it ({type(error).__name__}: {printable(error)})"
        raise input_error(place, what, DAMAGED) from error
    if not any(skeletons):
        raise input_error(place, "has no skeleton with nodes", DAMAGED)
    for skeleton in skeletons:
        check_unique(place, skeleton, "node of a skeleton")
    number = {name: i for i, name in enumerate(dict.fromkeys(n for s in skeletons for n in s))}
    return Metadata(
        float(version) if isinstance(version, int | float) else 1.0,
        tuple(skeletons),
        tuple(dict.fromkeys((number[a], number[b]) for a, b in edges)),
        apart(tracks),
        apart(videos),
    )


def _texts(file: TrackerFile, name: str) -> tuple[str, ...]:
    return file.texts(name) if file.is_dataset(name) else ()


def _parse(place: str, text: Any) -> Any:
    try:
        return orjson.loads(text)
    except (orjson.JSONDecodeError, TypeError) as error:
        if not place:
            raise ValueError(str(error)) from error
        raise input_error(place, "is no JSON", DAMAGED) from error


def _skeletons(
    found: Sequence[Any], nodes: Sequence[str]
) -> tuple[list[tuple[str, ...]], list[tuple[str, str]]]:
    """Return the nodes of each skeleton in its order, and the edges of all, by name."""
    skeletons, edges = [], []
    for skeleton in found:
        graph = skeleton.get("nx_graph", skeleton)
        ids = [node["id"] for node in graph["nodes"]]
        if any(isinstance(number, int) and number < 0 for number in ids):
            raise ValueError("a node has a negative number")
        skeletons.append(tuple(nodes[number] for number in ids))
        types: list[int] = []
        for link in graph.get("links", ()):
            if _type(link.get("type"), types) == BODY:
                edges.append((nodes[link["source"]], nodes[link["target"]]))
    known = {name for skeleton in skeletons for name in skeleton}
    return skeletons, [pair for pair in edges if known.issuperset(pair)]


def _type(stated: Any, types: list[int]) -> int:
    """Return the type of a link: stated in full the first time, later by its place among those."""
    if not isinstance(stated, dict):
        return BODY
    if "py/reduce" in stated:
        types.append(stated["py/reduce"][1]["py/tuple"][0])
        return types[-1]
    number = stated.get("py/id", BODY)
    return types[number - 1] if 0 < number <= len(types) else number


def _video(found: Any) -> str:
    """Return what a video is called: its name without suffix, or the folder of its images."""
    backend = found.get("backend") or {}
    name = found.get("filename") or backend.get("filename") or backend.get("filenames") or "video"
    if isinstance(name, list):
        name = str(PurePosixPath(str(name[0]).replace("\\", "/")).parent)
    last = name_of(str(name))
    return PurePosixPath(last).stem or "video"
