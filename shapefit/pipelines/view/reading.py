"""What the files of a page hold, each opened and read once, by frames and landmarks."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from shapefit.arrays import Floats, Indices
from shapefit.config import ViewConfig
from shapefit.errors import InputError, input_error
from shapefit.io import (
    open_landmarks,
    open_shapes,
    read_dictionary,
)
from shapefit.io.detect import detect_format
from shapefit.io.dictionaries import atoms_of
from shapefit.io.formats import CSV
from shapefit.io.layout import FRAME, UNKNOWN_UNIT
from shapefit.io.options import InputOptions, input_options
from shapefit.io.skeletons import people_joints
from shapefit.io.source import (
    OPTIONAL_DATASETS,
    AnyRecord,
    Source,
    find_kind,
    open_results,
    source_of,
)
from shapefit.io.writers.metres import EXTRINSIC_ROTATION, with_stated_height
from shapefit.io.writers.motion import angle_columns
from shapefit.pipelines.evaluate.measure import match_truth, with_shapes_of
from shapefit.pipelines.items import ChosenItems
from shapefit.records import Fit, Landmarks, Shapes, concatenate
from shapefit.records.columns import column_by_name, in_columns
from shapefit.records.items import Items

MAX_MEGABYTES = 20
"""Largest page; of more frames than fit, every n-th is shown."""

MAX_FRAME_BYTES = 300
"""Of a frame of one file on the page, without its landmarks."""

MAX_LANDMARK_BYTES = 30
"""Of each landmark of a frame."""

POSE_DATASETS = ("coefficients", "rotation", "translation", "scale")
"""Of a result that carry a mesh."""

SHOWN_DATASETS = {"sequence", "landmarks_fitted", "status", "shape_sd", *POSE_DATASETS}
"""Of a result that a page is made of, beside those that the format does not list."""

BY_LANDMARK = ("landmarks", "shapes", "landmarks_fitted", "shape_sd", "outliers")
"""Datasets whose last axis is that of landmarks on the page."""

ITEMS_READ_AT_ONCE = 1 << 14

AnySource = Source[Landmarks] | Source[Shapes] | Source[Fit]

Role = Literal["result", "shapes", "landmarks", "truth"]


class Frames(NamedTuple):
    """n items in the order of the page; sequences (name, first frame) cover them all.

    About every `step`-th of the chosen frames is here. numbers (n,) are their places in
    their videos, nan where no file states them.
    """

    items: tuple[str, ...]
    sequences: tuple[tuple[str, int], ...]
    step: int
    numbers: Floats

    @property
    def by_sequence(self) -> list[Indices]:
        """Return the indices of the frames of each sequence."""
        starts = [start for _, start in self.sequences[1:]]
        return np.split(np.arange(len(self.items)), starts)


class Content(NamedTuple):
    """The records of one name, by the n frames and the p landmarks of the page.

    values are (n, ...), those of landmarks (n, ..., p); nan or "" where there is no
    record. rows (n,) is the record of each frame, -1 where there is none.
    """

    name: str
    role: Role
    records: Items
    rows: Indices
    values: Mapping[str, Any]

    @property
    def points(self) -> Floats:
        """Return the shapes (n, 3, p), or the landmarks (n, 2, p)."""
        points: Floats = self.values[self.records.POINTS]
        return points


class Inputs(NamedTuple):
    """What a page is made of: contents of files, truth, frames, landmarks, notes."""

    contents: list[Content]
    truth: Content | None
    frames: Frames
    landmarks: tuple[str, ...]
    notes: list[str]


def read_inputs(config: ViewConfig) -> Inputs:
    """Return the chosen items of all files, and their true shapes.

    Of more than fit into a page every n-th of each sequence is read. Results are shown
    with the landmarks of their input where the truth names these. Raises InputError for
    what cannot be read or shown together, and where no item is chosen.
    """
    options = replace(input_options(config), rename={})  # which is for the truth
    true = None
    if config.truth:
        with open_shapes(config.truth, input_options(config), gaps=True) as source:
            true = source.whole()
    roles = {
        name: _find_role(paths[0], options) for name, paths in config.files.items()
    }
    records, step, notes = _read_records(config, options, roles, true)
    landmarks = tuple(
        dict.fromkeys(chain(*(one.landmark_names for one in records.values())))
    )
    items, sequences = _find_frames(list(records.values()))
    contents = [
        _make_content(name, roles[name], one, find_places(one.items, items), landmarks)
        for name, one in records.items()
    ]
    frames = Frames(items, sequences, step, _frame_numbers(contents, len(items)))
    truth = None if true is None else _true_content(config, true, contents, landmarks)
    return Inputs(contents, truth, frames, landmarks, notes)


def _read_records(
    config: ViewConfig,
    options: InputOptions,
    roles: Mapping[str, Role],
    true: Shapes | None,
) -> tuple[dict[str, AnyRecord], int, list[str]]:
    """Return the chosen records of each name, the step between frames, and notes."""
    chosen = ChosenItems("items", config.items)
    with ExitStack() as stack:
        sources: dict[str, AnySource] = {}
        for name, paths in config.files.items():
            sources[name] = _open_source(paths, roles[name], options)
            stack.enter_context(sources[name])
        rows: dict[str, list[int]] = {}
        size = 0
        for name, source in sources.items():
            every = enumerate(chain.from_iterable(source.item_names()))
            rows[name] = [row for row, item in every if item in chosen]
            landmarks = len(source.head.landmark_names)
            frame_bytes = MAX_FRAME_BYTES + MAX_LANDMARK_BYTES * landmarks
            size += frame_bytes * len(rows[name])
        step = math.ceil(size / (MAX_MEGABYTES * 1e6)) or 1
        records = {
            name: _with_true_landmarks(_read_every(source, rows[name], step), true)
            for name, source in sources.items()
            if rows[name]
        }
        notes = [note for source in sources.values() for note in source.notes]
    if not records:
        problem = "no item fits, or there are none"
        raise input_error(
            ", ".join(sources), problem, "correct `items`, or check the files"
        )
    return records, step, [*notes, *chosen.warnings]


def _frame_numbers(contents: Sequence[Content], n: int) -> Floats:
    """Return the number (n,) of each frame in its video, nan where it is unknown.

    It is that of the first file which states one.
    """
    numbers = np.full(n, np.nan)
    for content in contents:
        stated = content.values.get(FRAME)
        if stated is not None and stated.ndim == 1 and stated.dtype == np.float64:
            numbers = np.where(np.isfinite(numbers), numbers, stated)
    return numbers


def _find_role(path: Path, options: InputOptions) -> Role:
    """Return the role of a file: result, shapes or landmarks, by what it holds.

    CSV with a column z is a result: shapes in front of a camera.
    """
    kind = find_kind(path, options)
    if kind == "dictionary":
        return "shapes"
    in_csv = kind == "shapes" and detect_format(path, options.format) is CSV
    return "result" if in_csv else kind


def _open_source(paths: Sequence[Path], role: Role, options: InputOptions) -> AnySource:
    """Open files that have a role; the shapes of a dictionary are its atoms."""
    if role == "landmarks":
        return open_landmarks(paths, options)
    if role == "shapes" and find_kind(paths[0], options) == "dictionary":
        atoms = atoms_of(read_dictionary(paths[0]))
        return source_of(atoms, str(paths[0]), {}, gaps=True)
    if role == "shapes":
        return open_shapes(paths, options, gaps=True)
    return open_results(paths, OPTIONAL_DATASETS - SHOWN_DATASETS)


def _read_every(source: AnySource, rows: Sequence[int], step: int) -> AnyRecord:
    """Read every `step`-th of the items `rows` in each sequence."""
    sequence_of = [*chain.from_iterable(source.sequences())]
    seen_in = Counter[str]()
    taken = []
    for row in rows:
        sequence = sequence_of[row]
        if seen_in[sequence] % step == 0:
            taken.append(row)
        seen_in[sequence] += 1
    parts: list[AnyRecord] = [*source.select(np.array(taken), ITEMS_READ_AT_ONCE)]
    return concatenate(parts)


def _with_true_landmarks(records: AnyRecord, truth: Shapes | None) -> AnyRecord:
    """Return a fit with its joints, or its detector's landmarks if the truth has these.

    Other records stay. It has, too, where each landmark was observed; those of a
    detector are observed where a joint stands for them.
    """
    if not isinstance(records, Fit):
        return records
    records = with_stated_height(records, "view")
    shown = with_shapes_of(records, () if truth is None else truth.landmark_names)
    if records.landmarks is None or shown is records:
        return shown
    stands_for = people_joints(shown.landmark_names)
    names = [stands_for.get(name, name) for name in shown.landmark_names]
    rows = find_places(records.landmark_names, names)
    unseen = rows[:, None] < 0
    observed = np.where(unseen, np.nan, records.landmarks[:, rows])
    return replace(shown, landmarks=observed, edges=None)


def _find_frames(
    sets: Sequence[AnyRecord],
) -> tuple[tuple[str, ...], tuple[tuple[str, int], ...]]:
    """Return the items of all records, and the sequences with their first frames.

    Items are in their order, those of a sequence together. Sequences of one frame each
    are no sequences.
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
        return tuple(sequence_of), (("", 0),)
    items = tuple(chain.from_iterable(groups.values()))
    starts = np.cumsum([0, *map(len, groups.values())])[:-1].tolist()
    return items, tuple(zip(groups, starts, strict=True))


def find_places(names: Sequence[str], wanted: Sequence[str]) -> Indices:
    """Return the place of each wanted name in `names`, -1 for what is not there."""
    place = {name: column for column, name in enumerate(names)}
    return np.array([place.get(name, -1) for name in wanted], dtype=np.intp)


def _make_content(
    name: str,
    role: Role,
    records: Items,
    rows: Indices,
    landmarks: Sequence[str],
) -> Content:
    """Return the columns of records by frames and landmarks of the page, and angles.

    rows (n,) are the record of each frame, -1 for none.
    """
    columns = find_places(records.landmark_names, landmarks)
    if records.unit == UNKNOWN_UNIT:
        records = replace(records, unit="")
    angles: Mapping[str, Floats] = {}
    if role in ("result", "shapes") and isinstance(records, Fit | Shapes):
        # no file states which axis of the world is up
        angles = angle_columns(records.without([EXTRINSIC_ROTATION]), None)
    records = records.with_extras(angles)
    listed = column_by_name(type(records))
    values = {}
    for dataset, stored in records.item_columns().items():
        is_text = stored.dtype.kind in "OSU"
        value = np.array(stored[rows], object if is_text else np.float64)
        value[rows < 0] = "" if is_text else np.nan
        if dataset in listed and listed[dataset].has_points:
            value = in_columns(value)
        if dataset in BY_LANDMARK:
            value = np.where(columns < 0, np.nan, value[..., columns])
        values[dataset] = value
    return Content(name, role, records, rows, values)


def _true_content(
    config: ViewConfig,
    truth: Shapes,
    contents: Sequence[Content],
    landmarks: Sequence[str],
) -> Content:
    """Return the true shapes by frames of the page; InputError where none has any."""
    place = next(iter(config.files.values()))[0]
    true_rows = np.full(len(contents[0].rows), -1)
    errors: list[InputError] = []
    for content in contents:
        try:
            rows = match_truth(place, content.records, truth, config.match)[0]
        except InputError as error:
            errors.append(error)
        else:
            lacks = (true_rows < 0) & (content.rows >= 0)
            true_rows[lacks] = rows[content.rows[lacks]]
    if len(errors) == len(contents):
        raise errors[0]
    wanted, rows = np.unique(true_rows, return_inverse=True)
    if wanted[0] < 0:  # -1 stands for frames without a true shape
        wanted = wanted[1:]
        rows = rows - 1
    return _make_content("truth", "truth", truth.take(wanted), rows, landmarks)
