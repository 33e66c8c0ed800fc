"""What the files of a page hold, each opened and read once, and its frames."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.metrics import FEWEST_LANDMARKS
from shapefit.io import ResultSet, open_landmarks, open_shapes, read_dictionary
from shapefit.io.detect import detect_format
from shapefit.io.formats import CSV, HDF5
from shapefit.io.layout import FRAME
from shapefit.io.listing import OPTIONAL, AnyRecords, find_kind
from shapefit.io.options import InputOptions, input_options
from shapefit.io.records import concatenate
from shapefit.io.skeletons import people_joints
from shapefit.io.source import open_results
from shapefit.pipelines.evaluate.measure import with_shapes_of
from shapefit.pipelines.items import BY_FRAME, BY_ITEM, ChosenItems, Keys, find_truth, keys_of
from shapefit.pipelines.view.images import MEGABYTES

POSE = ("coefficients", "rotation", "translation", "scale")
"""Datasets of a result that carry a mesh."""
READ = {"sequence", "landmarks_fitted", "status", "shape_sd", *POSE}
"""Datasets of a result that a page is made of, beside those that the format does not list."""
BATCH = 1 << 14
"""Items that are read at a time."""
FRAME_BYTES, LANDMARK_BYTES = 300, 30
"""Of a frame of one file on the page, and of each landmark of it, at most."""

Kind = Literal["result", "shapes", "landmarks"]


@dataclass(frozen=True)
class Frames:
    """Items in the order of the page; sequences (name, first frame) cover them all.

    About every `step`-th of the chosen frames is here.
    """

    items: tuple[str, ...]
    sequences: tuple[tuple[str, int], ...]
    step: int

    @property
    def by_sequence(self) -> list[NDArray[np.intp]]:
        """Return the frames of each sequence."""
        return np.split(np.arange(len(self.items)), [start for _, start in self.sequences[1:]])


@dataclass(frozen=True)
class Content:
    """The m records of one name, by the n frames and the p landmarks of the page.

    numbers (m,) are their places in their sequences. rows (n,) is the record of each frame and
    columns (p,) the landmark of the records for each of the page; -1 where there is none.
    """

    name: str
    kind: Kind
    records: Any
    numbers: Sequence[int]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    def per_frame(self, dataset: str) -> Any:
        """Return a dataset as (n, ...), nan or "" where there is no record; None without it."""
        values = self.records.per_item.get(dataset)
        if values is None:
            return None
        is_text = values.dtype.kind in "OSU"
        per_frame = np.array(values[self.rows], object if is_text else np.float64)
        per_frame[self.rows < 0] = "" if is_text else np.nan
        return per_frame

    def per_landmark(self, dataset: str) -> Any:
        """Return a dataset whose last axis is that of landmarks as (n, ..., p)."""
        values = self.per_frame(dataset)
        if values is None:
            return None
        return np.where(self.columns < 0, np.nan, values[..., self.columns])

    @property
    def points(self) -> Floats:
        """Return the shapes (n, 3, p), or the landmarks (n, 2, p)."""
        points: Floats = self.per_landmark(self.records.LAYOUT.points)
        return points

    @property
    def y_down(self) -> bool:
        """Whether y of the records points down."""
        return self.kind != "shapes" and self.records.y_axis != "up"


@dataclass(frozen=True)
class Inputs:
    """All that a page is made of: landmarks are those of all files, notes are about the files."""

    contents: Sequence[Content]
    truth: Content | None
    dictionary: Dictionary | None
    frames: Frames
    landmarks: tuple[str, ...]
    notes: Sequence[str]


def read_inputs(config: ViewConfig) -> Inputs:
    """Read the chosen items of all files, and their true shapes.

    Of more than fit into a page every n-th of each sequence is read. Results are shown
    with the landmarks of their input where the truth names these. Raises InputError for what cannot
    be read or shown together, and where no item is chosen.
    """
    options = replace(input_options(config), rename={})  # which is for the truth
    kinds = {name: _kind(paths[0], options) for name, paths in config.files.items()}
    chosen = ChosenItems("items", config.items)
    dictionary = None if config.dictionary is None else read_dictionary(config.dictionary)
    with ExitStack() as stack:
        true: Any = None
        true_names: Sequence[str] = ()
        if config.truth:
            true = stack.enter_context(open_shapes(config.truth, input_options(config), gaps=True))
            true_names = true.head.landmark_names
        sources = {
            name: stack.enter_context(_open(paths, kinds[name], options))
            for name, paths in config.files.items()
        }
        stated = {source.head.y_axis for source in sources.values() if source.states_y_axis}
        if len(stated) > 1:
            problem = "y points up in some files and down in others"
            raise input_error(", ".join(sources), problem, "show them on pages of their own")
        size = 0
        for source in sources.values():
            bytes_of_frame = FRAME_BYTES + LANDMARK_BYTES * len(source.head.landmark_names)
            size += bytes_of_frame * sum(item in chosen for each in source.names() for item in each)
        step = math.ceil(size / (MEGABYTES * 1e6)) or 1
        read = {name: _take(source, chosen, step) for name, source in sources.items()}
        notes = [*(note for each in sources.values() for note in each.notes), *chosen.warnings]
        sets = {name: _as_shown(records, true_names) for name, (records, _) in read.items()}
        if not any(map(len, sets.values())):
            problem = "no item fits, or there are none"
            raise input_error(", ".join(sources), problem, "correct `items`, or check the files")
        landmarks = tuple(dict.fromkeys(chain(*(each.landmark_names for each in sets.values()))))
        frames = _find_frames(list(sets.values()), step)
        contents = []
        for name, records in sets.items():
            row_of = {item: row for row, item in enumerate(records.items)}
            rows = np.array([row_of.get(item, -1) for item in frames.items], dtype=np.intp)
            columns = columns_of(records.landmark_names, landmarks)
            if len(records):
                content = Content(name, kinds[name], records, read[name][1], rows, columns)
                contents.append(content)
        truth = None if true is None else _read_truth(config, true, contents, frames, landmarks)
    return Inputs(contents, truth, dictionary, frames, landmarks, notes)


def _kind(path: Path, options: InputOptions) -> Kind:
    """Return what a file is shown as. CSV with a column z is a result: shapes before a camera."""
    kind = find_kind(path, options)
    if kind == "dictionary":
        fix = "give results, shapes or landmarks"
        raise input_error(path, "is a shapefit-dictionary file", fix)
    return "result" if kind == "shapes" and detect_format(path, options.format) is CSV else kind


def _open(paths: Sequence[Path], kind: Kind, options: InputOptions) -> Any:
    """Open files of a kind; only in our own files must shapes have all landmarks."""
    if kind == "landmarks":
        return open_landmarks(paths, options)
    if kind == "shapes":
        return open_shapes(paths, options, gaps=detect_format(paths[0], options.format) is not HDF5)
    return open_results(paths, OPTIONAL - READ)


def _take(source: Any, chosen: ChosenItems, step: int) -> tuple[Any, list[int]]:
    """Read every step-th of the chosen items of each sequence, with their places in these."""
    parts: list[Any] = []
    numbers: list[int] = []
    reached, ranks = Counter[str](), Counter[str]()
    for batch in source.batches(BATCH):
        rows = []
        sequences = batch.sequences or ("",) * len(batch)
        for row, (item, sequence) in enumerate(zip(batch.items, sequences, strict=True)):
            if item in chosen:
                if ranks[sequence] % step == 0:
                    rows.append(row)
                    numbers.append(reached[sequence])
                ranks[sequence] += 1
            reached[sequence] += 1
        parts.append(batch.take(rows))
    return concatenate(parts), numbers


def _as_shown(records: AnyRecords, true_names: Sequence[str]) -> AnyRecords:
    """Return a result by the names that the truth has, its observed landmarks as (n, 2, p).

    Those of its input are observed where a joint stands for them.
    """
    observed = records.per_item.get("landmarks")
    if not isinstance(records, ResultSet):
        return records
    shown = with_shapes_of(records, true_names)
    if observed is None:
        return shown
    if shown is not records:
        stands_for = people_joints(shown.landmark_names)
        names = [stands_for.get(name, name) for name in shown.landmark_names]
        columns = columns_of(records.landmark_names, names)
        observed = np.where(columns[:, None] < 0, np.nan, observed[:, columns])
        shown = shown.without(["edges"])
    return shown.with_columns({"landmarks": np.swapaxes(observed, 1, 2)})


def columns_of(names: Sequence[str], landmarks: Sequence[str]) -> NDArray[np.intp]:
    """Return the place among `names` of each landmark, -1 for those that are not there."""
    place = {name: column for column, name in enumerate(names)}
    return np.array([place.get(name, -1) for name in landmarks], dtype=np.intp)


def _find_frames(sets: Sequence[AnyRecords], step: int) -> Frames:
    """Return the items of all records in their order, those of a sequence together.

    Sequences of one frame each are no sequences.
    """
    sequence_of: dict[str, str] = {}
    for records in sets:
        sequences = records.sequences or ("",) * len(records)
        for item, sequence in zip(records.items, sequences, strict=True):
            sequence_of.setdefault(item, sequence)
    groups = defaultdict[str, list[str]](list)
    for item, sequence in sequence_of.items():
        groups[sequence].append(item)
    if len(groups) == len(sequence_of):
        return Frames(tuple(sequence_of), (("", 0),), step)
    starts = np.cumsum([0, *map(len, groups.values())])[:-1].tolist()
    items = tuple(chain.from_iterable(groups.values()))
    return Frames(items, tuple(zip(groups, starts, strict=True)), step)


def _read_truth(
    config: ViewConfig,
    source: Any,
    contents: Sequence[Content],
    frames: Frames,
    landmarks: Sequence[str],
) -> Content:
    """Read the true shapes of the frames. Raises InputError where there is none of any."""
    names, place = source.head.landmark_names, next(iter(config.files.values()))[0]
    if len(set(landmarks) & set(names)) < FEWEST_LANDMARKS:
        found = f"fewer than 3 of its landmarks ({abbreviate(landmarks)}) are in the truth"
        raise input_error(place, found, f"`rename` those of the truth ({abbreviate(names)})")
    keys = _keys(config.match, contents, frames)
    if config.match == BY_FRAME:
        true_keys = keys_of(source.batches(BATCH))
    else:
        true_keys = Keys(list(chain.from_iterable(source.names())))
    wanted, rows = np.unique(find_truth(place, config.match, keys, true_keys), return_inverse=True)
    without = int(wanted[0] < 0)
    records = source.take(wanted[without:])
    columns = columns_of(names, landmarks)
    return Content("truth", "shapes", records, (), rows.reshape(-1) - without, columns)


def _keys(match: str, contents: Sequence[Content], frames: Frames) -> Keys:
    """Return what the frames are matched by; an item is "" where no result names one."""
    if match == BY_ITEM:
        return Keys(frames.items)
    if match != BY_FRAME:
        named = [
            texts
            for content in contents
            if (texts := content.per_frame(match)) is not None and texts.dtype.kind in "OSU"
        ]
        if not named:
            found = f"no result has the dataset '{match}' of texts"
            raise input_error("match", found, "name one that holds items of the truth")
        return Keys([next(filter(None, texts), "") for texts in zip(*named, strict=True)])
    places: dict[str, tuple[str, int]] = {}
    for content in contents:
        numbers = content.records.per_item.get(FRAME, content.numbers)
        sequences = content.records.sequences or ("",) * len(numbers)
        by_frame = zip(sequences, map(int, numbers), strict=True)
        places = dict(zip(content.records.items, by_frame, strict=True)) | places
    names, numbers = zip(*(places[item] for item in frames.items), strict=True)
    return Keys(frames.items, names, numbers, contents[0].records.frame_rate)
