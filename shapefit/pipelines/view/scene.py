"""The scene of a page: layers, bones, sides, recordings, the ground and facts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.config import ViewConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP
from shapefit.geometry.floor import Floor
from shapefit.io import read_dictionary
from shapefit.io.layout import FOCAL_ASSUMED
from shapefit.io.names import find_side_pairs
from shapefit.io.options import BY_DEFAULT
from shapefit.io.skeletons import edges_of
from shapefit.io.writers.metres import find_stature
from shapefit.io.writers.motion import MAX_MISSING_PER_FRAME, find_floors, video_of
from shapefit.lifting.trust import REASONS
from shapefit.pipelines.view.film import embed_film, is_film
from shapefit.pipelines.view.layers import (
    AGAINST_TRUTH,
    EXPECTED,
    change_metres_to_cm_or_mm,
    first_finite,
    has_camera,
    join_individuals,
    make_layers,
)
from shapefit.pipelines.view.photographs import embed_photographs, last_number
from shapefit.pipelines.view.reading import (
    MAX_MEGABYTES,
    Content,
    Frames,
    Inputs,
    find_places,
    read_inputs,
)
from shapefit.records import Fit
from shapefit.timeline import ASSUMED_RATE
from shapefit.viewer.page import Fact, Film, Ground, Layer, Picture, Scene

MIDDLE = 0
LEFT_SIDE = 1
RIGHT_SIDE = 2

STATED_ERRORS = {
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


def make_scene(config: ViewConfig) -> Scene:
    """Read the files of a config, and return the scene that their page shows."""
    inputs = read_inputs(config)
    contents, truth, frames = inputs.contents, inputs.truth, inputs.frames
    dictionary = None
    if config.dictionary is not None:
        dictionary = read_dictionary(config.dictionary)
    notes = [*inputs.notes, *_notes_on_thinning(frames)]
    observed = _find_observed(contents)
    layers, meshes, space_unit = make_layers(
        contents, truth, dictionary, observed, notes
    )
    timing = _find_timing(config, inputs)
    if _is_individual_each(contents, layers, timing):
        layers = [join_individuals(layers, contents)]
    length = change_metres_to_cm_or_mm(layers)
    edges = _edges(contents, truth, dictionary, inputs.landmarks)
    has_meshes = any("blend" in layer for layer in layers)
    notes += _notes_on_landmarks(contents, observed)
    if not edges and not has_meshes:
        fix = "-d DICT.h5 or --truth may have them."
        notes.append(f"No edges are known, so landmarks are points; {fix}")
    y_down = any(
        one.role != "shapes" and one.records.y_axis != "up" for one in contents
    )
    floors = _find_floors(contents, frames, timing.rate)
    image = _image_size(contents, y_down)
    pictures: dict[int, Picture] = {}
    film = None
    if config.images is not None and is_film(config.images):
        film, remarks = _embed_film(config.images, timing, frames)
        notes += remarks
    elif config.images is not None:
        pictures, remarks = embed_photographs(config.images, frames.items, image)
        notes += remarks
    sides = find_sides(inputs.landmarks)
    is_rigid = has_meshes and not timing.is_video
    assumed: list[str] = []
    if space_unit == "m":
        sentences = chain.from_iterable(map(_assumptions, _results(contents)))
        assumed = [*dict.fromkeys(sentences)]
    return {
        "title": ", ".join(config.files) + (" and the truth" if truth else ""),
        "items": frames.items,
        "sequences": frames.sequences,
        "landmarks": inputs.landmarks,
        "edges": edges,
        "layers": layers,
        "unit": contents[0].records.unit,
        "space_unit": space_unit,
        "length": length if space_unit == "m" else (space_unit, 1),
        "y_down": y_down,
        "grounds": [
            _ground(floors.get(video_of(name)), y_down) for name, _ in frames.sequences
        ],
        "frame_rate": timing.rate,
        "rate_known": timing.rate_known,
        "flat": observed is not None or _has_results(contents),
        "observed": observed,
        "outliers": _find_outliers(contents),
        "sides": sides if any(sides) else None,
        "recordings": timing.recordings,
        "times": timing.times,
        "meshes": meshes,
        "pictures": pictures,
        "film": film,
        "image": image,
        "video": timing.is_video,
        "rigid": is_rigid,
        "facts": [*_count_facts(timing, frames), *_quality_facts(contents, layers)],
        "about": "about " if any(map(_assumed_focal, _results(contents))) else "",
        "assumed": [*assumed, *([] if is_rigid else [_describe_ground(floors)])],
        "notes": notes,
    }


def _results(contents: Sequence[Content]) -> list[Content]:
    """Return the contents that are results of fits."""
    return [content for content in contents if content.role == "result"]


def _has_results(contents: Sequence[Content]) -> bool:
    """Whether one of the contents is a result of a fit."""
    return len(_results(contents)) > 0


def _find_observed(contents: Sequence[Content]) -> Floats | None:
    """Return the landmarks (n, 2, p) of files of landmarks, else those of results."""
    in_images = [content.points for content in contents if content.role == "landmarks"]
    for result in _results(contents):
        if "landmarks" in result.values:
            in_images.append(result.values["landmarks"])
    return first_finite(in_images) if in_images else None


def _find_outliers(contents: Sequence[Content]) -> NDArray[np.bool_] | None:
    """Return which landmarks (n, p) a result judged wrong; None where none is."""
    outliers = [
        result.values["outliers"] == 1
        for result in _results(contents)
        if "outliers" in result.values
    ]
    if not np.any(outliers):
        return None
    return np.asarray(np.logical_or.reduce(outliers))


def _notes_on_thinning(frames: Frames) -> Iterator[str]:
    """Yield a note where the page shows every n-th frame, to be small enough."""
    if frames.step > 1:
        yield (
            f"One of {frames.step} frames is shown: with all of them the page would be"
            f" larger than {MAX_MEGABYTES} MB. `items` chooses others."
        )


def _notes_on_landmarks(
    contents: Sequence[Content], observed: Floats | None
) -> Iterator[str]:
    """Yield notes where landmarks are missing, or are those of other results."""
    results = _results(contents)
    if results and observed is None:
        yield (
            "The results hold no observed landmarks; add the landmark file to see them."
        )
    files = [content for content in contents if content.role == "landmarks"]
    if not files or not results:
        return
    has_landmarks = np.any([file.rows >= 0 for file in files], axis=0)
    has_shape = np.any([result.rows >= 0 for result in results], axis=0)
    if not np.any(has_landmarks & has_shape):
        yield (
            "No shape matches the landmarks: give those that the results were"
            " fitted to."
        )


class Timing(NamedTuple):
    """When frames were seen: which sequences at once, and how fast.

    recordings and times as `find_recordings` returns them; rate in Hz of the frames
    that are shown, and whether it is known; is_video, whether frames follow each other
    in time.
    """

    recordings: list[list[int]]
    times: Integers
    rate: float
    rate_known: bool
    is_video: bool


def _find_timing(config: ViewConfig, inputs: Inputs) -> Timing:
    """Return when frames were seen; the rate is the config's, or the first stated."""
    recordings, times = find_recordings(inputs.contents, inputs.frames)
    contents = [*inputs.contents]
    if inputs.truth is not None:
        contents.append(inputs.truth)
    rates = [config.frame_rate, *(content.records.frame_rate for content in contents)]
    rate = next(filter(None, rates), None)
    has_sequences = any(name for name, _ in inputs.frames.sequences)
    return Timing(
        recordings,
        times,
        rate=(rate or ASSUMED_RATE) / inputs.frames.step,
        rate_known=rate is not None,
        is_video=has_sequences or (rate is not None and len(times) > 1),
    )


def _is_individual_each(
    contents: Sequence[Content], layers: Sequence[Layer], timing: Timing
) -> bool:
    """Whether each file is an individual of one recording, as motion is written."""
    are_shapes = all(content.role == "shapes" for content in contents)
    has_meshes = any("blend" in layer for layer in layers)
    one_recording = [len(members) for members in timing.recordings]
    return (
        are_shapes
        and not has_meshes
        and len(layers) == len(contents) > 1
        and one_recording == [len(contents)]
        and np.sum([content.rows >= 0 for content in contents], axis=0).max() == 1
    )


def _find_floors(
    contents: Sequence[Content], frames: Frames, rate: float
) -> Mapping[str, Floor]:
    """Return name of the video -> its floor, from the first result that has floors."""
    for result in _results(contents):
        floors = _floors_of(result, frames, rate)
        if floors:
            return floors
    return {}


def _describe_ground(floors: Mapping[str, Floor]) -> str:
    """Return a sentence on where the ground of the page comes from."""
    if not floors:
        return "The floor is not known: each body has its own ground."
    return f"Floor from resting feet: {'; '.join(map(str, floors.values()))}."


def find_recordings(
    contents: Sequence[Content], frames: Frames
) -> tuple[list[list[int]], Integers]:
    """Group sequences that were seen at once; return them and the time (n,) of frames.

    The individuals of a video are its sequences, `video/individual`; or each is a file
    of shapes. Numbers of frames say what was seen at once, and what is missing. Others
    are recordings of one sequence.
    """
    rows_of = frames.by_sequence
    files = [content for content in contents if content.role == "shapes"]
    is_file_each = len(files) == len(rows_of) > 1
    videos = defaultdict[tuple[str, str | int], list[int]](list)
    for sequence, (name, _) in enumerate(frames.sequences):
        video = name.rpartition("/")[0]
        key: tuple[str, str | int] = ("alone", sequence)
        if np.isfinite(frames.numbers[rows_of[sequence]]).all():
            if video:
                key = ("video", video)
            elif name and is_file_each:
                key = ("files", "")
        videos[key].append(sequence)
    recordings: list[list[int]] = []
    times = np.concatenate([np.arange(len(rows)) for rows in rows_of])
    for members in videos.values():
        rows = np.concatenate([rows_of[member] for member in members])
        # somebody is seen beside another
        is_together = len(np.unique(frames.numbers[rows])) < len(rows)
        here = [members] if is_together else [[member] for member in members]
        for recording in here:
            _set_times(recording, frames, times)
        recordings += here
    return recordings, times


def _set_times(recording: Sequence[int], frames: Frames, times: Integers) -> None:
    """Set, in `times`, the times of a recording's frames by their numbers, if any.

    Missing frames are gaps.
    """
    rows_of = [frames.by_sequence[member] for member in recording]
    numbers = frames.numbers[np.concatenate(rows_of)]
    if not np.isfinite(numbers).all():
        return
    first = numbers.min()
    last = numbers.max()
    if last - first > MAX_MISSING_PER_FRAME * len(numbers) * frames.step:
        if len(recording) > 1:
            _, order = np.unique(numbers, return_inverse=True)
            times[np.concatenate(rows_of)] = order
        return
    for rows in rows_of:
        places = (frames.numbers[rows] - first) // frames.step
        count = np.arange(len(rows))
        times[rows] = np.maximum.accumulate(places - count) + count


def find_sides(names: Sequence[str]) -> list[int]:
    """Return MIDDLE, LEFT_SIDE or RIGHT_SIDE for each name of a landmark.

    What has no counterpart is in the middle.
    """
    sides = [MIDDLE] * len(names)
    for left, right in find_side_pairs(names):
        sides[left] = LEFT_SIDE
        sides[right] = RIGHT_SIDE
    return sides


def _count_facts(timing: Timing, frames: Frames) -> Iterator[Fact]:
    """Yield the numbers of images, or of sequences, individuals and frames."""
    if not timing.is_video:
        yield {"text": counted(len(frames.items), "image")}
        return
    recordings = timing.recordings
    if len(recordings) > 1:
        yield {"text": counted(len(recordings), "sequence")}
    individuals = max(map(len, recordings))
    if individuals > 1:
        yield {"text": counted(individuals, "individual")}
    moments = 0
    for members in recordings:
        rows = np.concatenate([frames.by_sequence[member] for member in members])
        moments += len(np.unique(timing.times[rows]))
    yield {"text": counted(moments, "frame")}
    assumed = "" if timing.rate_known else " assumed"
    yield {"text": f"{timing.rate:.4g} Hz{assumed}"}


def _quality_facts(
    contents: Sequence[Content], layers: Sequence[Layer]
) -> Iterator[Fact]:
    """Yield how many frames of each layer are trusted, and how large its errors are."""
    reasons_of = {content.name: content.values.get(REASONS) for content in contents}
    for layer in layers:
        prefix = f"{layer['name']}: " if len(contents) > 1 else ""
        is_trusted = np.ones(len(layer["points"]), bool)
        reasons = reasons_of.get(layer["name"])
        if reasons is not None:
            has_shape = np.isfinite(layer["points"]).any(axis=(1, 2))
            is_trusted = has_shape & (reasons == "")
            share = f"{np.count_nonzero(is_trusted):,} of {len(is_trusted):,} trusted"
            style = "trust" if is_trusted.mean() > 0.5 else "trust doubtful"
            yield {"text": prefix + share, "style": style}
        for measure in layer["measures"]:
            is_counted = np.isfinite(measure["values"])
            if measure["name"] == EXPECTED:
                is_counted &= is_trusted
            values = measure["values"][is_counted]
            if measure["name"] in STATED_ERRORS and values.size:
                name, definition = STATED_ERRORS[measure["name"]]
                median = float(np.median(values))
                number = f"{median:.0f}" if median >= 9.5 else f"{median:.2g}"
                text = f"{prefix}{name} {number} {measure['unit']}".strip()
                yield {"text": text, "title": definition}


def _floors_of(result: Content, frames: Frames, rate: float) -> Mapping[str, Floor]:
    """Return name of the video -> its floor, from a result; {} without any."""
    if not has_camera(result) or "metres_per_unit" not in result.values:
        return {}
    records = result.records
    if not isinstance(records, Fit):
        return {}
    if frames.step > 1 and records.frames is None:
        records = replace(records, frame_rate=rate)
    return find_floors(records, BY_DEFAULT, result.name)


def _embed_film(path: Path, timing: Timing, frames: Frames) -> tuple[Film, list[str]]:
    """Return the film of the page's one recording, and notes.

    Frames are those of the film that files state, else the last numbers of the items,
    else they follow each other. Raises InputError for several recordings, and as
    `embed_film`.
    """
    recordings = timing.recordings
    if len(recordings) > 1 and timing.is_video:
        fault = f"is one film, and the landmarks are of {len(recordings)} recordings"
        name = frames.sequences[recordings[0][0]][0]
        raise input_error(path, fault, f"choose one by `items`, such as '{name}/*'")
    places = frames.numbers
    if not np.isfinite(places).all():
        places = np.array(list(map(last_number, frames.items)), np.float64)
    if (places < 0).any():
        places = (timing.times * frames.step).astype(np.float64)
    return embed_film(path, places)


def _assumed_focal(result: Content) -> float | None:
    """Return the focal length that a fit assumed, None where it was stated."""
    focal = result.records.attributes.get(FOCAL_ASSUMED)
    return None if focal is None else float(focal)


def _assumptions(result: Content) -> Iterator[str]:
    """Yield sentences on what the metres of a result rest on, and on how to set it.

    Heights can be stated of people alone.
    """
    focal = _assumed_focal(result)
    if focal is not None:
        yield (
            f"Focal length assumed ({focal:.0f} px), so distances from the camera are"
            " rough: `fit --focal` or `--calibration` sets it."
        )
    if np.isfinite(result.values.get("stated_height", np.nan)).any():
        return
    sizes = "Sizes are those of the training shapes"
    is_person = find_stature(result.points[:0], result.records.landmark_names)
    yield f"{sizes}." if is_person is None else f"{sizes}: `fit --height` sets them."


def _ground(floor: Floor | None, y_down: bool) -> Ground:
    """Return the rotation that turns y up, and the y of the floor there in metres.

    Without a floor, up is that of the image.
    """
    level = TO_Y_UP[IMAGE_UP] if y_down else np.eye(3)
    if floor is None:
        return {"upright": level.ravel().tolist()}
    turn = floor._replace(height=0.0).in_floor_frame(np.eye(3))
    return {"upright": (turn @ level).ravel().tolist(), "floor": -floor.height}


def _edges(
    contents: Sequence[Content],
    truth: Content | None,
    dictionary: Dictionary | None,
    landmarks: Sequence[str],
) -> list[list[int]]:
    """Return the edges between landmarks of the page, as pairs of indices.

    They are those of the dictionary, else of the truth, shapes, others, or a skeleton.
    """
    by_role = sorted(contents, key=lambda content: content.role != "shapes")
    records = [content.records for content in (truth, *by_role) if content is not None]
    stated = [(one.lines, one.landmark_names) for one in records]
    if dictionary is not None:
        stated.insert(0, (dictionary.edges, dictionary.landmark_names))
    for edges, names in stated:
        if edges is None:
            continue
        ends = find_places(landmarks, names)[edges]
        is_here = (ends >= 0).all(axis=1)
        if is_here.any():
            lines: list[list[int]] = ends[is_here].tolist()
            return lines
    return [list(pair) for pair in edges_of(landmarks)]


def _image_size(contents: Sequence[Content], y_down: bool) -> list[float] | None:
    """Return width and height of the images, from the first file that tells, or None.

    A camera has no size: twice its principal point is taken, where y points down.
    """
    for content in contents:
        size = content.records.column("image_size")
        if size is not None and size.shape[-1:] == (2,) and np.isfinite(size).all():
            first: list[float] = np.reshape(size, (-1, 2))[0].astype(float).tolist()
            return first
        centre = content.values.get("principal_point")
        if centre is not None and np.isfinite(centre).any() and y_down:
            middle: Floats = np.nanmedian(centre, axis=0)
            return (2 * middle).tolist() if middle.all() else None
    return None
