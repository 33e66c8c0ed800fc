"""The scene of a page, put together from its files: layers, bones, sides, recordings, words."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.config import ViewConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP
from shapefit.geometry.floor import Floor
from shapefit.io import read_dictionary, read_results
from shapefit.io.joined import agreed
from shapefit.io.layout import FRAME, METRES_PER_UNIT, UNKNOWN_UNIT
from shapefit.io.listing import Listing
from shapefit.io.options import AS_KNOWN
from shapefit.io.records import concatenate
from shapefit.io.skeletons import edges_of
from shapefit.io.writers.motion import find_floors, video_of
from shapefit.pipelines.view.images import MEGABYTES, embed_images
from shapefit.pipelines.view.layers import first_known, has_camera, make_layers
from shapefit.pipelines.view.reading import (
    Frames,
    Gathered,
    Truth,
    as_judged,
    gather,
    read_truth,
    renamed_edges,
)
from shapefit.pipelines.view.words import assumed, facts, lacking
from shapefit.viewer.scene import USUAL_RATE, Scene, Stand

MIDDLE, LEFT, RIGHT = 0, 1, 2
OTHER_SIDE = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
WORD_LEFT = re.compile(r"left|Left|LEFT|(?<![A-Za-z])[lL](?![a-z])|^[lL](?=[A-Za-z])|(?<=[a-z])L$")
"""`left` anywhere, `l` alone, before or behind a name: left_hip, HipLeft, L_Hip, LHip, HipL."""
FILES = "*"
"""In the place of a video: files of one individual each, which are shown together."""
MOST_ON_FLOOR = 100_000
"""Images of a result that are read once more, to find the floor."""
ALONE = "\0"
"""Before a number, in the place of a video: a sequence by itself."""


def assemble(
    config: ViewConfig, listings: Mapping[str, Sequence[Listing]], frames: Frames
) -> Scene:
    """Return the scene of these frames, with notes on what it lacks."""
    notes: list[str] = []
    if frames.step > 1:
        notes.append(
            f"Every {_ordinal(frames.step)} of {frames.count:,} frames is shown: with all of "
            f"them the page would be larger than {MEGABYTES} MB. `items` chooses others."
        )
    listings = {name: [as_judged(config, one) for one in own] for name, own in listings.items()}
    every = [listing for own in listings.values() for listing in own]
    landmarks = tuple(dict.fromkeys(name for one in every for name in one.landmark_names))
    found = [gather(n, own, frames, landmarks, config.match) for n, own in listings.items()]
    results = [each for each in found if each.kind == "result"]
    truth = read_truth(config, found, frames, landmarks) if config.truth else None
    seen = first_known(e.of_frames["landmarks"] for e in found if "landmarks" in e.of_frames)
    dictionary = None if config.dictionary is None else read_dictionary(config.dictionary)
    layers, meshes, unit = make_layers(found, dictionary, seen, truth, notes)
    edges = _edges(found, dictionary, truth, landmarks)
    notes += lacking(layers, seen, edges)
    named = find_sides(landmarks)
    outliers = [each.of_frames["outliers"] == 1 for each in results if "outliers" in each.of_frames]
    images = any(one.kind != "shapes" for one in every)
    unsaid = ("down") if images else "up"
    y_axis = agreed("y_axis", [(str(one.path), one.y_axis) for one in every]) or unsaid
    rates = [config.frame_rate, *(one.frame_rate for one in every)]
    rates += [] if truth is None else [truth.frame_rate]
    rate = next((rate for rate in rates if rate is not None and rate < 1e6), None)
    in_motion = any(name for name, _ in frames.sequences)
    pictures = {} if config.images is None else embed_images(config.images, frames.items)
    if config.images is not None and len(pictures) < len(frames.items):
        notes.append(f"{len(pictures)} of {counted(len(frames.items), 'frame')} have a picture.")
    recordings, times = find_recordings(found, frames) or (None, None)
    stands, floor = find_stands(results, frames, y_down=y_axis == "down")
    video = in_motion or (rate is not None and len(frames.items) > 1)
    shown_rate = (rate or USUAL_RATE) / frames.step
    words = f"{shown_rate:.4g} Hz" + ("" if rate else " assumed") if video else ""
    return Scene(
        title=", ".join(listings) + (" and the truth" if truth else ""),
        items=frames.items,
        sequences=frames.sequences,
        landmarks=landmarks,
        edges=[] if edges is None else edges.tolist(),
        layers=layers,
        unit=_shown(every[0].unit),
        space_unit=_shown(every[0].unit if unit is None else unit),
        y_down=y_axis == "down",
        stands=stands,
        frame_rate=shown_rate,
        rate_known=rate is not None,
        flat=seen is not None or bool(results),
        seen=seen,
        outliers=np.logical_or.reduce(outliers) if np.any(outliers) else None,
        sides=named if any(named) else None,
        recordings=recordings,
        times=times,
        meshes=meshes,
        pictures=pictures,
        image=_image_size(found),
        video=video,
        rigid=not video and any(layer.pose is not None for layer in layers),
        facts=tuple(
            facts(results, layers, frames, recordings, _moments(frames, recordings, times), words)
        ),
        assumed=tuple(assumed(results, floor, video=video)),
        notes=tuple(notes),
    )


def find_sides(names: Sequence[str]) -> list[int]:
    """Return MIDDLE, LEFT or RIGHT for each name; what has no counterpart is in the middle."""
    place = {name: number for number, name in enumerate(names)}
    sides = [MIDDLE] * len(names)
    for name, number in place.items():
        for found in WORD_LEFT.finditer(name):
            other = name[: found.start()] + OTHER_SIDE[found[0]] + name[found.end() :]
            if other in place:
                sides[number], sides[place[other]] = LEFT, RIGHT
    return sides


def find_recordings(
    found: Sequence[Gathered], frames: Frames
) -> tuple[list[list[int]], Integers] | None:
    """Return the sequences that were seen at once, and the time (n,) of each frame among theirs.

    The individuals of a video are its sequences, `video/individual`; or each is a file. The dataset
    `frame` numbers their frames. None where every sequence is by itself.
    """
    owner = {item: each.name for each in found for one in each.listings for item in one.items}
    numbers = np.full(len(frames.items), np.nan)
    for each in found:
        numbers = np.where(np.isfinite(numbers), numbers, each.of_frames.get(FRAME, np.nan))
    starts = [*(start for _, start in frames.sequences), len(frames.items)]
    owners = [owner.get(frames.items[start]) for start in starts[:-1]]
    each_a_file = len(set(owners)) == len(owners)
    times = np.arange(len(frames.items)) - np.repeat(starts[:-1], np.diff(starts))
    recordings: dict[str, list[int]] = {}
    for row, (name, start) in enumerate(frames.sequences):
        video = name.rpartition("/")[0] or (FILES if name and each_a_file else "")
        known = np.isfinite(numbers[start : starts[row + 1]]).all()
        recordings.setdefault(video if video and known else f"{ALONE}{row}", []).append(row)
    groups = []
    for members in recordings.values():
        rows = np.concatenate([np.arange(starts[m], starts[m + 1]) for m in members])
        moments, order = np.unique(numbers[rows], return_inverse=True)
        if len(members) == 1 or len(moments) == len(rows):  # nobody is seen beside another
            groups += [[member] for member in members]
            continue
        groups.append(members)
        times[rows] = order
    return (groups, times) if len(groups) < len(frames.sequences) else None


def find_stands(
    results: Sequence[Gathered], frames: Frames, *, y_down: bool
) -> tuple[list[Stand], str]:
    """Return how the shapes of each sequence stand, and the floor in words, "" for none.

    Up is that of the floor that the feet of people rest on, where it is known, else that of the
    image.
    """
    level = TO_Y_UP[IMAGE_UP] if y_down else np.eye(3)
    floors = next(filter(None, map(_floors, results)), {})
    flat = Stand(level.ravel().tolist())
    own = [floors.get(video_of(name)) for name, _ in frames.sequences]
    stands = [flat if floor is None else _on_floor(floor, level) for floor in own]
    words = f"{len(floors)} videos have one" if len(floors) > 1 else str(*floors.values())
    return stands, words if floors else ""


def _floors(result: Gathered) -> Mapping[str, Floor]:
    """Return the floor of each video of a result, where it is known."""
    images = sum(len(one.items) for one in result.listings)
    if not has_camera(result) or METRES_PER_UNIT not in result.of_frames or images > MOST_ON_FLOOR:
        return {}
    records = concatenate([read_results(one.path) for one in result.listings])
    return find_floors(records, AS_KNOWN, result.name)


def _on_floor(floor: Floor, level: Floats) -> Stand:
    """Return how shapes in metres before the camera stand on a floor."""
    turn = floor._replace(height=0.0).stand(np.eye(3))
    return Stand((turn @ level).ravel().tolist(), -floor.height)


def _edges(
    found: Sequence[Gathered],
    dictionary: Dictionary | None,
    truth: Truth | None,
    landmarks: Sequence[str],
) -> NDArray[np.int64] | None:
    """Return lines between landmarks: of the dictionary, of the files, of known skeletons."""
    edges = [each.edges for each in found if each.kind == "shapes"]
    if dictionary is not None:
        edges.insert(0, renamed_edges(dictionary.edges, dictionary.landmark_names, landmarks))
    if truth is not None:
        edges.append(renamed_edges(truth.shapes.edges, truth.shapes.landmark_names, landmarks))
    edges += [each.edges for each in found]
    edges += [np.array(usual) for usual in [edges_of(landmarks)] if usual]
    return next((each for each in edges if each is not None and len(each)), None)


def _moments(
    frames: Frames, recordings: Sequence[Sequence[int]] | None, times: Integers | None
) -> int:
    """Count the frames of all videos, those in which several individuals are seen once."""
    if recordings is None or times is None:
        return len(frames.items)
    ends = [*(start for _, start in frames.sequences[1:]), len(frames.items)]
    starts = [start for _, start in frames.sequences]
    return sum(
        len(np.unique(np.concatenate([times[starts[m] : ends[m]] for m in members])))
        for members in recordings
    )


def _image_size(found: Sequence[Gathered]) -> list[float] | None:
    """Return the width and height of the images, where a file says them or its camera does."""
    for each in found:
        if each.image_size is not None and np.isfinite(each.image_size).all():
            return each.image_size.tolist()
        centre = each.of_frames.get("principal_point")
        if centre is not None and np.isfinite(centre).any() and each.y_down:
            return (2 * np.nanmedian(centre, axis=0)).tolist()
    return None


def _shown(unit: str) -> str:
    """Return a unit as the page has it: nothing for one that is not known."""
    return "" if unit == UNKNOWN_UNIT else unit


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ending}"
