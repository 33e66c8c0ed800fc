"""The scene of a page: layers, bones, sides, recordings, the ground and what is stated
of them.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.config import ViewConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP
from shapefit.geometry.floor import Floor
from shapefit.io import read_dictionary
from shapefit.io.names import pairs_of_sides
from shapefit.io.options import BY_DEFAULT
from shapefit.io.skeletons import edges_of
from shapefit.io.writers.motion import MOST_MISSING, find_floors, video_of
from shapefit.lifting.trust import REASONS
from shapefit.pipelines.view.layers import (
    AGAINST_TRUTH,
    EXPECTED,
    Layer,
    first_finite,
    has_camera,
    in_usual_units,
    make_layers,
)
from shapefit.pipelines.view.reading import (
    MEGABYTES,
    Content,
    Frames,
    columns_of,
    read_inputs,
)
from shapefit.records import Fit
from shapefit.timeline import ASSUMED_RATE

MIDDLE, LEFT, RIGHT = 0, 1, 2
ERRORS = {
    EXPECTED: (
        "typical error",
        (
            "Median over trusted frames of the error to expect: the mean distance"
            " between the shape and the true one after the best similarity, computed"
            " from the error bars."
        ),
    ),
    AGAINST_TRUTH: (
        AGAINST_TRUTH,
        (
            "Median over frames of the mean distance to the truth, after "
            "the best similarity."
        ),
    ),
}
"""Measures that the header states -> their names and definitions there."""
MOST_BYTES = 14_000_000
"""Of all pictures of a page; of more, every n-th is shown."""
LONGEST_SIDE = 960
"""Pixels of the longest side of a picture on the page."""
SUFFIXES = (".jpg", ".jpeg", ".png")
LAST_NUMBER = re.compile(r"(\d{1,12})\D*$")


def make_scene(config: ViewConfig) -> dict[str, Any]:
    """Return the scene of the files of a config, by the keys of
    shapefit.viewer.page.
    """
    contents, truth, frames, landmarks, notes = read_inputs(config)
    dictionary = None
    if config.dictionary is not None:
        dictionary = read_dictionary(config.dictionary)
    if frames.step > 1:
        notes.append(
            f"One of {frames.step} frames is shown: with all of them the page would be"
            f" larger than {MEGABYTES} MB. `items` chooses others."
        )
    results = [content for content in contents if content.role == "result"]
    observed = _find_observed(contents)
    layers, meshes, space_unit = make_layers(
        contents, truth, dictionary, observed, notes
    )
    edges = _edges(contents, truth, dictionary, landmarks)
    meshed = any("blend" in layer for layer in layers)
    notes += _missing_of(contents, observed)
    if not edges and not meshed:
        fix = "-d DICT.h5 or --truth may have them."
        notes.append(f"No edges are known, so landmarks are points; {fix}")
    clock = _find_clock(config, contents, truth, frames)
    y_down = any(
        one.role != "shapes" and one.records.y_axis != "up" for one in contents
    )
    floors = _find_floors(results, frames, clock.rate)
    sides = find_sides(landmarks)
    length = in_usual_units(layers)
    facts = _facts_of(frames, clock)
    return {
        "title": ", ".join(config.files) + (" and the truth" if truth else ""),
        "items": frames.items,
        "sequences": frames.sequences,
        "landmarks": landmarks,
        "edges": edges,
        "layers": layers,
        "unit": contents[0].records.unit,
        "space_unit": space_unit,
        "length": length if space_unit == "m" else (space_unit, 1),
        "y_down": y_down,
        "grounds": [
            _ground(floors.get(video_of(name)), y_down) for name, _ in frames.sequences
        ],
        "frame_rate": clock.rate,
        "rate_known": clock.is_known,
        "flat": observed is not None or bool(results),
        "observed": observed,
        "outliers": _find_outliers(results),
        "sides": sides if any(sides) else None,
        "recordings": clock.recordings,
        "times": clock.times,
        "meshes": meshes,
        "pictures": _pictures(config, frames),
        "image": _image_size(contents, y_down),
        "video": clock.is_video,
        "rigid": meshed and not clock.is_video,
        "facts": [*({"text": text} for text in facts), *_quality(contents, layers)],
        "assumed": _assumed(floors, rigid=meshed and not clock.is_video),
        "notes": notes,
    }


class Clock(NamedTuple):
    """How the frames of a page follow each other.

    recordings are the sequences that were seen at once, times (n,) the places of the
    frames in theirs; rate in Hz of the frames that are shown, assumed unless it
    is_known; is_video: whether frames are those of a video.
    """

    recordings: list[list[int]]
    times: Integers
    rate: float
    is_known: bool
    is_video: bool


def _find_clock(
    config: ViewConfig,
    contents: Sequence[Content],
    truth: Content | None,
    frames: Frames,
) -> Clock:
    """Return how the frames follow each other, by the config and the files."""
    recordings, times = find_recordings(contents, frames)
    files = [*contents] if truth is None else [*contents, truth]
    stated = [config.frame_rate, *(one.records.frame_rate for one in files)]
    rate = next(filter(None, stated), None)
    named = any(name for name, _ in frames.sequences)
    return Clock(
        recordings=recordings,
        times=times,
        rate=(rate or ASSUMED_RATE) / frames.step,
        is_known=rate is not None,
        is_video=named or (rate is not None and len(times) > 1),
    )


def _find_observed(contents: Sequence[Content]) -> Floats | None:
    """Return the landmarks (n, 2, p) of the page: of files, else of results; None
    without any.
    """
    in_images = [content.points for content in contents if content.role == "landmarks"]
    for content in contents:
        if content.role == "result" and "landmarks" in content.values:
            in_images.append(content.values["landmarks"])
    return first_finite(in_images) if in_images else None


def _missing_of(contents: Sequence[Content], observed: Floats | None) -> Iterator[str]:
    """Yield what the files do not show of each other: observed landmarks, and shapes
    of these.
    """
    results = [content for content in contents if content.role == "result"]
    if results and observed is None:
        yield (
            "The results hold no observed landmarks; add the landmark file to see them."
        )
    given = [one.rows >= 0 for one in contents if one.role == "landmarks"]
    shown = [(one.rows >= 0) & np.any(given, axis=0) for one in results if given]
    if shown and not np.any(shown):
        yield (
            "No shape matches the landmarks: give those that the results were"
            " fitted to."
        )


def _find_outliers(results: Sequence[Content]) -> Any:
    """Return which landmarks (n, p) any result sets aside; None where none does."""
    outliers = [
        one.values["outliers"] == 1 for one in results if "outliers" in one.values
    ]
    return np.logical_or.reduce(outliers) if np.any(outliers) else None


def _find_floors(
    results: Sequence[Content], frames: Frames, rate: float
) -> Mapping[str, Floor]:
    """Return the floor of each video, of the first result that knows one."""
    for result in results:
        if floors := _floors(result, frames, rate):
            return floors
    return {}


def _assumed(floors: Mapping[str, Floor], *, rigid: bool) -> list[str]:
    """Return what the page assumes of the ground; rigid objects stand on none."""
    if rigid:
        return []
    if not floors:
        return ["The floor is not known: each body has its own ground."]
    return [f"Floor from resting feet: {'; '.join(map(str, floors.values()))}."]


def _pictures(config: ViewConfig, frames: Frames) -> dict[int, dict[str, Any]]:
    """Return the pictures of the frames, none where no folder is given."""
    return {} if config.images is None else embed_images(config.images, frames.items)


def _facts_of(frames: Frames, clock: Clock) -> list[str]:
    """Return how many frames the header states, and how fast they follow."""
    if not clock.is_video:
        return [counted(len(frames.items), "image")]
    rate = f"{clock.rate:.4g} Hz" + ("" if clock.is_known else " assumed")
    return [*_counts(clock.recordings, clock.times, frames), rate]


def find_recordings(
    contents: Sequence[Content], frames: Frames
) -> tuple[list[list[int]], Integers]:
    """Return the sequences that were seen at once, and the time (n,) of each frame
    among theirs.

    The individuals of a video are its sequences, `video/individual`; or each is a file
    of shapes. Numbers of frames say what was seen at once, and what is missing. Others
    are recordings of one sequence.
    """
    rows_of = frames.by_sequence
    files = [content for content in contents if content.role == "shapes"]
    videos = defaultdict[object, list[int]](list)
    for sequence, (name, _) in enumerate(frames.sequences):
        video = name.rpartition("/")[0] or (name and len(files) == len(rows_of) > 1)
        numbered = video and np.isfinite(frames.numbers[rows_of[sequence]]).all()
        videos[video if numbered else sequence].append(sequence)
    recordings: list[list[int]] = []
    times = np.concatenate([np.arange(len(rows)) for rows in rows_of])
    for members in videos.values():
        rows = np.concatenate([rows_of[member] for member in members])
        # somebody is seen beside another
        together = len(np.unique(frames.numbers[rows])) < len(rows)
        here = [members] if together else [[member] for member in members]
        for recording in here:
            _place_frames(recording, frames, times)
        recordings += here
    return recordings, times


def _place_frames(recording: Sequence[int], frames: Frames, times: Integers) -> None:
    """Write down the times of the frames of a recording by their numbers, where they
    have some: missing frames are gaps.
    """
    rows_of = [frames.by_sequence[member] for member in recording]
    numbers = frames.numbers[np.concatenate(rows_of)]
    if not np.isfinite(numbers).all():
        return
    first, last = numbers.min(), numbers.max()
    if last - first > MOST_MISSING * len(numbers) * frames.step:
        if len(recording) > 1:
            _, order = np.unique(numbers, return_inverse=True)
            times[np.concatenate(rows_of)] = order
        return
    for rows in rows_of:
        places = (frames.numbers[rows] - first) // frames.step
        count = np.arange(len(rows))
        times[rows] = np.maximum.accumulate(places - count) + count


def find_sides(names: Sequence[str]) -> list[int]:
    """Return MIDDLE, LEFT or RIGHT for each name; what has no counterpart is in the
    middle.
    """
    sides = [MIDDLE] * len(names)
    for left, right in pairs_of_sides(names):
        sides[left], sides[right] = LEFT, RIGHT
    return sides


def _counts(
    recordings: Sequence[Sequence[int]], times: Integers, frames: Frames
) -> Iterator[str]:
    """Yield how many sequences, individuals and frames of videos there are."""
    if len(recordings) > 1:
        yield counted(len(recordings), "sequence")
    if (individuals := max(map(len, recordings))) > 1:
        yield counted(individuals, "individual")
    moments = 0
    for members in recordings:
        rows = np.concatenate([frames.by_sequence[member] for member in members])
        moments += len(np.unique(times[rows]))
    yield counted(moments, "frame")


def _quality(
    contents: Sequence[Content], layers: Sequence[Layer]
) -> Iterator[dict[str, str]]:
    """Yield how many frames of each layer are trusted, and how large its errors are."""
    reasons_of = {content.name: content.values.get(REASONS) for content in contents}
    for layer in layers:
        prefix = f"{layer['name']}: " if len(contents) > 1 else ""
        trusted, reasons = (
            np.ones(len(layer["points"]), bool),
            reasons_of.get(layer["name"]),
        )
        if reasons is not None:
            trusted = np.isfinite(layer["points"]).any(axis=(1, 2)) & (reasons == "")
            share = f"{np.count_nonzero(trusted):,} of {len(trusted):,} trusted"
            style = "trust" if trusted.mean() > 0.5 else "trust doubtful"
            yield {"text": prefix + share, "style": style}
        for measure in layer["measures"]:
            counted_in = trusted if measure["name"] == EXPECTED else True
            values = measure["values"][counted_in & np.isfinite(measure["values"])]
            if measure["name"] in ERRORS and values.size:
                name, definition = ERRORS[measure["name"]]
                median = float(np.median(values))
                number = f"{median:.0f}" if median >= 9.5 else f"{median:.2g}"
                text = f"{prefix}{name} {number} {measure['unit']}".strip()
                yield {"text": text, "title": definition}


def _floors(result: Content, frames: Frames, rate: float) -> Mapping[str, Floor]:
    """Return the floor of each video of a result, by the frames of the page, where it
    is known.
    """
    if not has_camera(result) or "metres_per_unit" not in result.values:
        return {}
    records = result.records
    if not isinstance(records, Fit):
        return {}
    if frames.step > 1 and records.frames is None:
        records = replace(records, frame_rate=rate)
    return find_floors(records, BY_DEFAULT, result.name)


def _ground(floor: Floor | None, y_down: bool) -> dict[str, Any]:
    """Return where up is, that of the image where no floor is known, and the floor in
    metres.
    """
    level = TO_Y_UP[IMAGE_UP] if y_down else np.eye(3)
    if floor is None:
        return {"upright": level.ravel().tolist()}
    turn = floor._replace(height=0.0).stand(np.eye(3))
    return {"upright": (turn @ level).ravel().tolist(), "floor": -floor.height}


def _edges(
    contents: Sequence[Content],
    truth: Content | None,
    dictionary: Dictionary | None,
    landmarks: Sequence[str],
) -> list[list[int]]:
    """Return lines between landmarks: of the dictionary, of shapes, of others, of
    skeletons.
    """
    by_role = sorted(contents, key=lambda content: content.role != "shapes")
    records = [content.records for content in (truth, *by_role) if content is not None]
    stated = [(one.lines, one.landmark_names) for one in records]
    if dictionary is not None:
        stated.insert(0, (dictionary.edges, dictionary.landmark_names))
    for edges, names in stated:
        ends = columns_of(landmarks, names)[
            np.zeros((0, 2), int) if edges is None else edges
        ]
        if (ends >= 0).all(axis=1).any():
            pairs: list[list[int]] = ends[(ends >= 0).all(axis=1)].tolist()
            return pairs
    return [list(pair) for pair in edges_of(landmarks)]


def _image_size(contents: Sequence[Content], y_down: bool) -> list[float] | None:
    """Return the width and height of the images, where a file or its camera states
    them.
    """
    for content in contents:
        size, centre = (
            content.records.column("image_size"),
            content.values.get("principal_point"),
        )
        if size is not None and size.shape[-1:] == (2,) and np.isfinite(size).all():
            width_and_height: list[float] = (
                np.reshape(size, (-1, 2))[0].astype(float).tolist()
            )
            return width_and_height
        if centre is not None and np.isfinite(centre).any() and y_down:
            middle: Floats = np.nanmedian(centre, axis=0)
            return (2 * middle).tolist() if middle.all() else None
    return None


def embed_images(folder: Path, items: Sequence[str]) -> dict[int, dict[str, Any]]:
    """Return the pictures of the frames that have one.

    A file is called by the item, or by what follows its last slash; or else the files
    are the frames of a video, in the order of the numbers in their names, from 0.
    Raises InputError where there is no such folder, no image, no Pillow, and for what
    is no image.
    """
    if find_spec("PIL") is None:
        raise input_error(
            "images", "Pillow is not installed", "run `pip install pillow`"
        )
    if not folder.is_dir():
        raise input_error(
            "images", f"there is no folder {folder}", "name a folder of pictures"
        )
    files = [path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES]
    numbered = sorted(
        (number, path) for path in files if (number := _number(path.stem)) >= 0
    )
    by_name: dict[object, Path] = {
        str(p.relative_to(folder).with_suffix("")): p for p in files
    }
    by_name |= {str(path.relative_to(folder)): path for path in files}
    by_number: dict[object, Path] = dict(enumerate(path for _, path in numbered))
    named = {
        i: by_name.get(x) or by_name.get(x.rpartition("/")[2])
        for i, x in enumerate(items)
    }
    if not any(named.values()):
        named = {
            frame: by_number.get(_number(item)) for frame, item in enumerate(items)
        }
    paths = {frame: path for frame, path in named.items() if path is not None}
    if not paths:
        fault = f"no item has an image, such as {folder / items[0]}.jpg"
        raise input_error("images", fault, "correct the path")
    first = _embed(next(iter(paths.values())))
    step = 1 + int(len(paths) * len(first["data"]) / MOST_BYTES)
    return {frame: _embed(paths[frame]) for frame in list(paths)[::step]}


def _number(text: str) -> int:
    """Return the last number of a text, -1 for none."""
    end = LAST_NUMBER.search(text)
    return int(end[1]) if end else -1


def _embed(path: Path) -> dict[str, Any]:
    """Return an image as data URL with its size. Raises InputError for what is no
    image.
    """
    from PIL import Image

    data = BytesIO()
    try:
        with Image.open(path, formats=("JPEG", "PNG")) as image:
            size = image.size
            image.draft("RGB", (LONGEST_SIDE, LONGEST_SIDE))
            small = image.convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        fault = f"cannot be read as an image ({error})"
        raise input_error(path, fault, "give PNG or JPEG, or leave it out") from error
    small.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
    small.save(data, "JPEG", quality=75)
    text = b64encode(data.getvalue()).decode()
    return {"data": f"data:image/jpeg;base64,{text}", "size": size}
