"""The scene of a page: layers, bones, sides, recordings, the ground and what is stated of them."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from shapefit.arrays import Integers
from shapefit.config import ViewConfig
from shapefit.errors import counted
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP
from shapefit.geometry.floor import Floor
from shapefit.io.layout import FRAME, METRES_PER_UNIT, UNKNOWN_UNIT
from shapefit.io.options import AS_KNOWN
from shapefit.io.skeletons import edges_of
from shapefit.io.writers.motion import find_floors, video_of
from shapefit.pipelines.view.images import MEGABYTES, embed_images
from shapefit.pipelines.view.layers import first_known, has_camera, in_usual_units, make_layers
from shapefit.pipelines.view.messages import assumed, counts, missing, quality
from shapefit.pipelines.view.reading import Content, Frames, Inputs, columns_of
from shapefit.viewer.scene import USUAL_RATE, Ground, Scene

MIDDLE, LEFT, RIGHT = 0, 1, 2
OTHER_SIDE = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
WORD_LEFT = re.compile(r"left|Left|LEFT|(?<![A-Za-z])[lL](?![a-z])|^[lL](?=[A-Za-z])|(?<=[a-z])L$")
"""`left` anywhere, `l` alone, before or behind a name: left_hip, HipLeft, L_Hip, LHip, HipL."""
FASTEST = 1e6
"""Frames a second from which on a rate is none."""


def assemble(config: ViewConfig, inputs: Inputs) -> Scene:
    """Return the scene of these frames, with notes on what is missing."""
    contents, truth, frames = inputs.contents, inputs.truth, inputs.frames
    landmarks, notes = inputs.landmarks, [*inputs.notes]
    if frames.step > 1:
        notes.append(
            f"One of {frames.step} frames is shown: with all of them the page would be larger than "
            f"{MEGABYTES} MB. `items` chooses others."
        )
    results = [content for content in contents if content.kind == "result"]
    landmark_sets = [content for content in contents if content.kind == "landmarks"]
    image_points = [content.points for content in landmark_sets]
    inputs_of_results = [result.per_landmark("landmarks") for result in results]
    image_points += [points for points in inputs_of_results if points is not None]
    observed = first_known(image_points) if image_points else None
    layers, meshes, space_unit = make_layers(inputs, observed, notes)
    layers, length = in_usual_units(layers)
    edges = _edges(inputs)
    notes += missing(layers, observed, has_edges=bool(edges))
    outliers = [
        flags == 1 for each in results if (flags := each.per_landmark("outliers")) is not None
    ]
    recordings, times = find_recordings(contents, frames)
    stated = [each.records.frame_rate for each in (*contents, truth) if each is not None]
    rate = next((r for r in (config.frame_rate, *stated) if r is not None and r < FASTEST), None)
    video = any(name for name, _ in frames.sequences) or (rate is not None and len(times) > 1)
    rigid = not video and any(layer.blend is not None for layer in layers)
    shown_rate = (rate or USUAL_RATE) / frames.step
    in_words = f"{shown_rate:.4g} Hz" + ("" if rate else " assumed") if video else ""
    y_down = any(content.y_down for content in contents)
    floors = next(filter(None, (_floors(each, frames, shown_rate) for each in results)), {})
    pictures = {} if config.images is None else embed_images(config.images, frames.items)
    if config.images is not None and len(pictures) < len(frames.items):
        notes.append(f"{len(pictures)} of {counted(len(frames.items), 'frame')} have a picture.")
    sides = find_sides(landmarks)
    lengths = [1 + int(times[rows].max()) for rows in frames.by_sequence]
    moments = sum(max(lengths[member] for member in members) for members in recordings)
    return Scene(
        title=", ".join(config.files) + (" and the truth" if truth else ""),
        items=frames.items,
        sequences=frames.sequences,
        landmarks=landmarks,
        edges=edges,
        layers=layers,
        unit=_shown(contents[0].records.unit),
        space_unit=_shown(space_unit),
        length=length if space_unit == "m" else (_shown(space_unit), 1),
        y_down=y_down,
        grounds=[_ground(floors.get(video_of(name)), y_down) for name, _ in frames.sequences],
        frame_rate=shown_rate,
        rate_known=rate is not None,
        flat=observed is not None or bool(results),
        observed=observed,
        outliers=np.logical_or.reduce(outliers) if np.any(outliers) else None,
        sides=sides if any(sides) else None,
        recordings=recordings,
        times=times,
        meshes=meshes,
        pictures=pictures,
        image=_image_size(contents),
        video=video,
        rigid=rigid,
        facts=(
            *counts(recordings, moments, len(frames.items), in_words),
            *quality(contents, layers),
        ),
        assumed=tuple(assumed(results, [str(floor) for floor in floors.values()], rigid=rigid)),
        notes=tuple(notes),
    )


def find_sides(names: Sequence[str]) -> list[int]:
    """Return MIDDLE, LEFT or RIGHT for each name; what has no counterpart is in the middle."""
    place = {name: number for number, name in enumerate(names)}
    sides = [MIDDLE] * len(names)
    for name, number in place.items():
        for word in WORD_LEFT.finditer(name):
            other = name[: word.start()] + OTHER_SIDE[word[0]] + name[word.end() :]
            if other in place:
                sides[number], sides[place[other]] = LEFT, RIGHT
    return sides


def find_recordings(
    contents: Sequence[Content], frames: Frames
) -> tuple[list[list[int]], Integers]:
    """Return the sequences that were seen at once, and the time (n,) of each frame among theirs.

    The individuals of a video are its sequences, `video/individual`; or each is a file of shapes.
    The dataset `frame` numbers their frames. Others are recordings of one sequence.
    """
    rows_of, numbers = frames.by_sequence, np.full(len(frames.items), np.nan)
    for content in contents:
        stated = content.per_frame(FRAME)
        if stated is not None and stated.ndim == 1 and stated.dtype == np.float64:
            numbers = np.where(np.isfinite(numbers), numbers, stated)
    one_each = len(contents) == len(rows_of) and all(each.kind == "shapes" for each in contents)
    videos = defaultdict[object, list[int]](list)
    for sequence, (name, _) in enumerate(frames.sequences):
        video = name.rpartition("/")[0] or (name and one_each)
        numbered = video and np.isfinite(numbers[rows_of[sequence]]).all()
        videos[video if numbered else sequence].append(sequence)
    recordings: list[list[int]] = []
    times = np.concatenate([np.arange(len(rows)) for rows in rows_of])
    for members in videos.values():
        rows = np.concatenate([rows_of[member] for member in members])
        moments, order = np.unique(numbers[rows], return_inverse=True)
        together = len(moments) < len(rows)  # somebody is seen beside another
        recordings += [members] if together else [[member] for member in members]
        if together and len(members) > 1:
            times[rows] = order
    return recordings, times


def _floors(result: Content, frames: Frames, rate: float) -> Mapping[str, Floor]:
    """Return the floor of each video of a result, by the frames of the page, where it is known."""
    if not has_camera(result) or METRES_PER_UNIT not in result.records.per_item:
        return {}
    records = result.records
    if frames.step > 1:
        records = records.replaced(frame_rate=rate)
    return find_floors(records, AS_KNOWN, result.name)


def _ground(floor: Floor | None, y_down: bool) -> Ground:
    """Return where up is, that of the image where no floor is known, and the floor in metres."""
    level = TO_Y_UP[IMAGE_UP] if y_down else np.eye(3)
    if floor is None:
        return Ground(level.ravel().tolist())
    turn = floor._replace(height=0.0).stand(np.eye(3))
    return Ground((turn @ level).ravel().tolist(), -floor.height)


def _edges(inputs: Inputs) -> list[list[int]]:
    """Return lines between landmarks: of the dictionary, of shapes, of others, of skeletons."""
    dictionary, true = inputs.dictionary, [inputs.truth] if inputs.truth else []
    by_kind = sorted(inputs.contents, key=lambda content: content.kind != "shapes")
    stated = [(each.records.lines, each.columns) for each in (*true, *by_kind)]
    if dictionary is not None:
        columns = columns_of(dictionary.landmark_names, inputs.landmarks)
        stated.insert(0, (dictionary.edges, columns))
    for edges, columns in stated:
        place = {column: j for j, column in enumerate(columns.tolist())}
        ends = [] if edges is None else edges.tolist()
        if pairs := [[place[a], place[b]] for a, b in ends if a in place and b in place]:
            return pairs
    return [list(pair) for pair in edges_of(inputs.landmarks)]


def _image_size(contents: Sequence[Content]) -> list[float] | None:
    """Return the width and height of the images, where a file or its camera states them."""
    for content in contents:
        size = content.records.columns.get("image_size")
        if size is not None and size.shape[-1:] == (2,) and np.isfinite(size).all():
            return np.reshape(size, (-1, 2))[0].astype(float).tolist()
        centre = content.per_frame("principal_point")
        if centre is not None and np.isfinite(centre).any() and content.y_down:
            middle = np.nanmedian(centre, axis=0)
            return (2 * middle).tolist() if middle.all() else None
    return None


def _shown(unit: str) -> str:
    """Return a unit as the page has it: nothing for one that is not known."""
    return "" if unit == UNKNOWN_UNIT else unit
