"""Recordings of other tools as files of landmarks and of shapes, as sources join them.

Landmarks that a file does not name are those of a skeleton known by name (`keypoints`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.errors import InputError, abbreviate, counted, input_error, listed
from shapefit.io.foreign.recording import FRACTION, Instances, Recording, stacked
from shapefit.io.foreign.selection import Chosen, choose
from shapefit.io.joined import SourceFile
from shapefit.io.landmark_names import match_landmarks, nearest_names
from shapefit.io.layout import EDGES
from shapefit.io.name_index import ItemList
from shapefit.io.options import InputOptions
from shapefit.io.records import LandmarkSet, ShapeSet
from shapefit.io.skeletons import SKELETONS

R = TypeVar("R", LandmarkSet, ShapeSet)

MIRROR = "mirror_index"

KEY = "keypoints"
NUMBERED = "numbered"
"""In place of a skeleton: landmarks are called 0, 1 and so on."""


def fitting_skeletons(count: int) -> list[str]:
    """Return the known skeletons of so many landmarks."""
    return [name for name, one in SKELETONS.items() if len(one.landmark_names) == count]


def landmark_names(recording: Recording, options: InputOptions) -> tuple[str, ...]:
    """Return the names of the landmarks of a recording.

    They are those of the file. Where it has none, they are those of the skeleton `keypoints`, of
    the one that its format implies, or their numbers where no known skeleton has as many, or
    `keypoints` is `numbered`. Raises InputError for an unknown skeleton, one of another number of
    landmarks, and where some have as many as the file and `keypoints` names none.
    """
    wanted = options.keypoints
    if wanted is not None and wanted not in (*SKELETONS, NUMBERED):
        near = nearest_names(wanted, tuple(SKELETONS))
        fix = f"did you mean {near[0]}?" if near else f"use {listed(SKELETONS)}"
        raise input_error(KEY, f"there is no skeleton {wanted!r}", fix)
    if recording.landmark_names is not None:
        return recording.landmark_names
    count = recording.landmark_count
    chosen = wanted or recording.default_keypoints
    if chosen is None:
        fitting = fitting_skeletons(count)
        if fitting:
            found = f"{count} landmarks without names, as {listed(fitting, 'and')} have"
            ways = [f"`--set {KEY}={name}`" for name in (*fitting, NUMBERED)]
            raise input_error(recording.name, found, f"say which: {listed(ways)}")
    if chosen in (None, NUMBERED):
        return tuple(map(str, range(count)))
    names = SKELETONS[chosen].landmark_names
    if len(names) != count:
        fitting = fitting_skeletons(count)
        known = f"; {listed(fitting)} have as many" if fitting else ""
        found = f"{count} landmarks, and {chosen} has {len(names)}"
        raise input_error(recording.name, found, f"set another `{KEY}`{known}")
    return names


HELD_BYTES = 256 << 20
"""Of a recording that is kept in memory; larger ones are read anew, sequence by sequence."""

FRAME = "frame"
"""Dataset (n,): the place of each item in its video, from 0."""


SQUEEZED = (
    "x and y are fractions of the width and the height of the image, so that figures are squeezed "
    "where it is not square"
)


@dataclass(frozen=True)
class Survey:
    """What one pass over a recording found.

    items and sequences as they are given out; counts as in `Instances`; held is everything, sorted
    by sequence, None where that is too much.
    """

    items: tuple[str, ...]
    sequences: tuple[str, ...]
    has_confidence: bool
    extras: Mapping[str, NDArray[Any]]
    counts: Mapping[str, int]
    held: Chosen | None


def landmark_file(recording: Recording, options: InputOptions) -> SourceFile[LandmarkSet]:
    """Return a recording of 2D landmarks as a file of a source; its head has `notes`."""
    names = landmark_names(recording, options)
    recording = in_pixels(replace(recording, y_axis=options.y_axis or recording.y_axis), options)
    read = choose(recording, options)
    survey = _survey(recording, read)
    whole = dict(recording.extras)
    if recording.edges:
        whole[EDGES] = np.array(recording.edges, dtype=np.int64)

    def record(chosen: Chosen) -> LandmarkSet:
        confidence = chosen.confidence
        if confidence is None and survey.has_confidence:
            confidence = np.ones(chosen.points.shape[:2])
        return LandmarkSet(
            landmarks=np.ascontiguousarray(chosen.points.transpose(0, 2, 1)),
            confidence=confidence,
            landmark_names=names,
            items=chosen.items,
            sequences=chosen.sequences if any(survey.sequences) else None,
            unit=recording.unit,
            y_axis=recording.y_axis,
            frame_rate=recording.frame_rate,
            columns={**whole, FRAME: chosen.frames, **chosen.extras},
            of_file=whole,
        )

    return SourceFile(
        recording.name,
        record(_nothing(recording, survey.has_confidence, survey.extras)),
        len(survey.items),
        ItemList(lambda: [survey.items], lambda _: recording.name),
        _opener(survey, read, record),
        notes=_notes(recording, survey),
        sequences=lambda: [survey.sequences],
        y_axis=recording.y_axis,
    )


LEAST, MOST = -0.5, 1.5
"""Coordinates that are all within these are fractions of an image, those outside of it too."""

SIZE_FIX = "give the size of the images in pixels: `--set image_size=[1920,1080]`"


def are_fractions(known: Floats) -> bool:
    """Whether coordinates are fractions of an image rather than pixels."""
    return known.size > 0 and bool(known.min() >= LEAST and known.max() <= MOST)


def size_needed(name: str) -> InputError:
    """Return the error for fractions of images whose size is not known."""
    return input_error(name, "x and y are fractions of the width and height of the image", SIZE_FIX)


def in_pixels(recording: Recording, options: InputOptions) -> Recording:
    """Return a recording whose fractions of the image are pixels, where its size is given.

    Raises InputError where they are useless without; else a note says so.
    """
    if recording.unit != FRACTION:
        return recording
    if options.image_size is None:
        if recording.size_needed:
            raise size_needed(recording.name)
        return replace(recording, notes=(*recording.notes, f"{SQUEEZED}; {SIZE_FIX}"))
    size = np.array(options.image_size)

    def blocks() -> Iterator[Instances]:
        for block in recording.blocks():
            yield replace(block, points=block.points * size)

    return replace(recording, blocks=blocks, unit="px")


def shape_file(recording: Recording, options: InputOptions) -> tuple[ShapeSet, tuple[str, ...]]:
    """Return a recording of 3D points as shapes, NaN where a landmark is unknown; and its notes."""
    names = landmark_names(recording, options)
    read = choose(recording, options)
    survey = _survey(recording, read, limit=None)
    chosen = survey.held
    assert chosen is not None
    extras = {FRAME: chosen.frames, **chosen.extras}
    if chosen.confidence is not None:
        extras["confidence"] = chosen.confidence
    shapes = ShapeSet(
        shapes=np.ascontiguousarray(chosen.points.transpose(0, 2, 1)),
        landmark_names=names,
        items=chosen.items,
        sequences=chosen.sequences if any(chosen.sequences) else None,
        edges=np.array(recording.edges, dtype=np.int64) if recording.edges else None,
        unit=recording.unit,
        frame_rate=recording.frame_rate,
        columns={**recording.extras, **extras},
        of_file=recording.extras,
    )
    return shapes, _notes(recording, survey)


def _survey(
    recording: Recording,
    read: Callable[[], Iterable[Chosen]],
    limit: int | None = HELD_BYTES,
) -> Survey:
    """Read a recording once; keep it if it is small."""
    counts: Counter[str] = Counter()
    kept: list[Chosen] = []
    items: list[str] = []
    sequences: list[str] = []
    extras: Mapping[str, NDArray[Any]] = {}
    held, has_confidence = 0, False
    for block in read():
        counts.update(block.counts)
        items += block.items
        sequences += block.sequences
        has_confidence |= block.confidence is not None
        extras = extras or {name: values[:0] for name, values in block.extras.items()}
        held += block.points.nbytes + (0 if block.confidence is None else block.confidence.nbytes)
        if limit is None or held <= limit:
            kept.append(block)
        else:
            kept.clear()
    _check_unique(recording, items)
    order = _by_sequence(sequences)
    whole = None
    if limit is None or held <= limit:
        whole = stacked(kept or [_nothing(recording, has_confidence, extras)]).take(order)
    return Survey(
        tuple(items[row] for row in order),
        tuple(sequences[row] for row in order),
        has_confidence,
        extras,
        {text: number for text, number in counts.items() if number},
        whole,
    )


def _check_unique(recording: Recording, items: list[str]) -> None:
    """Raise InputError for an individual that is twice in a frame."""
    if len(set(items)) == len(items):
        return
    twice = [item for item, number in Counter(items).items() if number > 1]
    found = (
        f"{abbreviate(twice)} occur more than once"
        if len(twice) > 1
        else f"{twice[0]} occurs more than once"
    )
    fix = "give each frame a number of its own, and each individual one place in it"
    raise input_error(recording.name, found, fix)


def _by_sequence(sequences: list[str]) -> NDArray[np.intp]:
    """Return the order in which sequences follow one another, each in the order of the file."""
    first = {name: number for number, name in enumerate(dict.fromkeys(sequences))}
    return np.argsort([first[name] for name in sequences], kind="stable").astype(np.intp)


def _nothing(
    recording: Recording, has_confidence: bool, extras: Mapping[str, NDArray[Any]]
) -> Chosen:
    """Return no instances, with the datasets of all."""
    p, d = recording.landmark_count, recording.dimensions
    confidence = np.empty((0, p)) if has_confidence else None
    return Chosen(
        points=np.empty((0, p, d)),
        confidence=confidence,
        frames=np.empty(0, np.int64),
        items=(),
        sequences=(),
        extras=extras,
    )


def _opener(
    survey: Survey,
    read: Callable[[], Iterable[Chosen]],
    record: Callable[[Chosen], LandmarkSet],
) -> Callable[[], Any]:
    """Return what opens the file: a reader of rows, which are asked for in order."""
    held = survey.held
    names = tuple(dict.fromkeys(survey.sequences))

    def again() -> Iterator[Chosen]:
        for name in names:
            for block in read():
                yield block.take(np.flatnonzero([own == name for own in block.sequences]))

    @contextmanager
    def opened() -> Iterator[Callable[[slice], LandmarkSet]]:
        if held is not None:
            yield lambda rows: record(held.take(rows))
            return
        rest = again()
        parts: list[Chosen] = []

        def following(rows: slice) -> LandmarkSet:
            wanted = rows.stop - rows.start
            while sum(map(len, parts)) < wanted:
                parts.append(next(rest))
            every = stacked(parts)
            parts[:] = [every.take(slice(wanted, None))]
            return record(every.take(slice(0, wanted)))

        yield following

    return opened


def _notes(recording: Recording, survey: Survey) -> tuple[str, ...]:
    """Say what was left out of a recording."""
    found = tuple(f"{recording.name}: {number} {text}" for text, number in survey.counts.items())
    return tuple(f"{recording.name}: {note}" for note in recording.notes) + found


KNOWN_SHARE = 0.9
"""Of the shapes of a recording in which a landmark must be known to be learned from."""


def without_gaps(
    shapes: ShapeSet, notes: tuple[str, ...], name: str
) -> tuple[ShapeSet, tuple[str, ...]]:
    """Return the whole shapes of the landmarks that are mostly known, and notes of what is lost.

    Raises InputError where no landmark is.
    """
    known = np.asarray(np.isfinite(shapes.shapes).all(axis=1))
    if not len(shapes):
        return shapes, notes
    often: Flags = np.asarray(known.mean(axis=0) >= KNOWN_SHARE)
    if not often.any():
        found = f"no landmark is known in {KNOWN_SHARE:.0%} of its {counted(len(shapes), 'shape')}"
        raise input_error(name, found, "give shapes with fewer gaps")
    rows: Flags = np.asarray(known[:, often].all(axis=1))
    lost = [name for name, stays in zip(shapes.landmark_names, often, strict=True) if not stays]
    if lost:
        text = f"left out, known in less than {KNOWN_SHARE:.0%} of the shapes"
        notes += (f"{name}: {counted(len(lost), 'landmark')} {text} ({abbreviate(lost)})",)
    if not rows.all():
        gone = counted(int((~rows).sum()), "shape")
        notes += (f"{name}: {gone} left out, in which a landmark is unknown",)
    if lost:
        shapes = _of_landmarks(shapes, np.flatnonzero(often))
    return shapes.take(rows), notes


def keep_landmarks(records: R, names: Sequence[str], place: str) -> R:
    """Return landmarks or shapes with these of their landmarks alone, in this order.

    Raises InputError at `place` for names that are not there, or twice.
    """
    if len(set(names)) < len(names):
        raise input_error("landmarks", "a name is there twice", "name each landmark once")
    columns = match_landmarks(records.landmark_names, names, f"{place}: landmarks")
    if isinstance(records, LandmarkSet):
        return records.arrange(names, place, leave_out=True)
    return _of_landmarks(records, columns)


def _of_landmarks(shapes: ShapeSet, columns: NDArray[np.intp]) -> ShapeSet:
    """Return the shapes with some of their landmarks, and the edges between those.

    Of a tree, whose edges lead from parents to children, a landmark is joined to the nearest of
    its forebears that stays.
    """
    edges = shapes.edges
    place = {int(old): new for new, old in enumerate(columns)}
    if edges is not None:
        parents = {b: a for a, b in edges.tolist()}
        tree = len(parents) == len(edges)
        pairs = []
        for a, b in edges.tolist():
            for _ in range(len(edges) if tree else 0):
                if a in place or a not in parents:
                    break
                a = parents[a]
            if a in place and b in place:
                pairs.append([place[a], place[b]])
        edges = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    kept = dict(shapes.columns)
    index = kept.pop(MIRROR, None)
    if index is not None and all(int(index[old]) in place for old in place):
        kept[MIRROR] = np.array([place[int(index[old])] for old in place])
    return shapes.replaced(
        columns=kept,
        shapes=shapes.shapes[:, :, columns],
        landmark_names=tuple(shapes.landmark_names[int(j)] for j in columns),
        edges=edges,
    )
