"""Read files of 2D landmarks in chunks, several files as one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.io.agreement import agreed, agreed_rate, check_same_extras
from shapefit.io.chunked import ChunkedSource, SourceFile, changed, with_names
from shapefit.io.duplicates import ItemList
from shapefit.io.extras import Extras
from shapefit.io.foreign.file_format import FileFormat
from shapefit.io.foreign.opening import group_inputs, mixture, open_recording
from shapefit.io.formats import find_reader
from shapefit.io.layout import LANDMARKS, UNKNOWN_UNIT
from shapefit.io.options import AS_THEY_ARE, Direction, InputOptions
from shapefit.io.records import LandmarkSet
from shapefit.io.renaming import check_known
from shapefit.io.sources import source_name
from shapefit.io.stored.checks import check_confidence, check_named, check_not_infinite
from shapefit.io.stored.opening import open_stored
from shapefit.io.stored.reader import StoredReader

Read = Callable[[slice], LandmarkSet]


@dataclass(frozen=True)
class _File(SourceFile[LandmarkSet]):
    """One file of a source, and the direction of y where it states one."""

    y_axis: Direction | None = None


def open_landmarks(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, rows: slice | None = None
) -> LandmarkSource:
    """Open files of landmarks in any format (`-` is standard input) as one source.

    Everything is checked before the first image is given out. Raises InputError for what is
    wrong with a file, for items that occur twice, and for files that do not go together (other
    units, directions of y, frame rates, or further datasets), and for names of landmarks to rename
    that no file has. HDF5 and Parquet are read a chunk at a time, all else whole. `rows` are those
    of the one HDF5 or Parquet file that are given out: nothing else of it is read.
    """
    if rows is not None:
        (path,) = paths
        files = [hiding(open_stored_file(path, rows), options.likelihood_below)]
    else:
        groups = group_inputs(paths, options)
        files = [_open(known, own, options) for known, own in groups]
        files[0] = replace(files[0], notes=files[0].notes + mixture(groups))
    rename = options.rename
    check_known(rename, [(file.name, file.head.landmark_names) for file in files])
    return LandmarkSource([with_names(file, rename) for file in files], options.y_axis)


class LandmarkSource(ChunkedSource[LandmarkSet, _File]):
    """The images of one or more files: `with open_landmarks(paths) as source: ...`.

    Landmarks are matched by name: `landmark_names` are those of all files in order of
    appearance, and what a file lacks is unseen. `count` images have `unit` and `y_axis`, which is
    that given where no file states it.
    """

    def __init__(self, files: Sequence[_File], y_axis: Direction) -> None:
        super().__init__(files)
        self.states_y_axis = any(file.y_axis is not None for file in files)
        self._head = _common_head([file for file in files if file.count] or files, y_axis)

    @property
    def head(self) -> LandmarkSet:
        """All of the source but its images."""
        return self._head

    @property
    def landmark_names(self) -> tuple[str, ...]:
        """Names of the landmarks, in the order of the arrays."""
        return self._head.landmark_names

    @property
    def unit(self) -> str:
        """Unit of the landmarks."""
        return self._head.unit

    @property
    def y_axis(self) -> Direction:
        """Whether y points up or down."""
        return self._head.y_axis

    @property
    def frame_rate(self) -> float | None:
        """Frames a second of a sequence; None where no file states it."""
        return self._head.frame_rate

    @property
    def further_datasets(self) -> tuple[str, ...]:
        """Names of the datasets that the format does not know."""
        return tuple(self._head.extras)

    def _conform(self, part: LandmarkSet, place: str) -> LandmarkSet:
        """Give a part of one file the landmarks and fields of the whole source."""
        changes: dict[str, Any] = {
            name: getattr(self._head, name) for name in ("unit", "y_axis", "frame_rate")
        }
        if self._head.confidence is not None and part.confidence is None:
            changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
        if self._head.sequences is not None and part.sequences is None:
            changes["sequences"] = ("",) * len(part)
        return replace(part, **changes).arrange(self._head.landmark_names, place)


def _common_head(files: Sequence[_File], y_axis: Direction) -> LandmarkSet:
    """Return the head of a whole source; InputError where its files do not go together."""
    units = [(file.name, _stated_unit(file.head)) for file in files]
    check_same_extras([(file.name, Extras.of(file.head.extras, 0)) for file in files])
    first = files[0].head
    names = dict.fromkeys(name for file in files for name in file.head.landmark_names)
    sequences = any(file.head.sequences is not None for file in files)
    confidence = any(file.head.confidence is not None for file in files)
    return LandmarkSet(
        landmarks=np.empty((0, 2, len(names))),
        confidence=np.empty((0, len(names))) if confidence else None,
        landmark_names=tuple(names),
        items=(),
        sequences=() if sequences else None,
        unit=agreed("unit", units, UNKNOWN_UNIT),
        y_axis=agreed("y_axis", [(file.name, file.y_axis) for file in files], y_axis),
        frame_rate=agreed_rate([(file.name, file.head.frame_rate) for file in files]),
        extras=first.arrange(tuple(names)).extras,
    )


def _stated_unit(head: LandmarkSet) -> str | None:
    return None if head.unit == UNKNOWN_UNIT else head.unit


def hiding(file: _File, least: float) -> _File:
    """Return a file that hides landmarks whose confidence is below `least`."""
    if not least or file.head.confidence is None:
        return file

    def hidden(images: LandmarkSet) -> LandmarkSet:
        assert images.confidence is not None
        doubtful = images.confidence < least
        return replace(
            images,
            landmarks=np.where(doubtful[:, None], np.nan, images.landmarks),
            confidence=np.where(doubtful, 0.0, images.confidence),
        )

    return changed(file, hidden)


def _open(known: FileFormat, paths: tuple[Path, ...], options: InputOptions) -> _File:
    """Open a file of any format; one that is read whole gives out parts of what was read."""
    path = paths[0]
    if known.recorder is not None:
        from shapefit.io.foreign.sources import landmark_file

        recording = open_recording(known, paths, "landmarks")
        found = landmark_file(recording, options)
        return _File(**vars(found), y_axis=recording.y_axis if known.states_y_axis else None)
    file = read = find_reader(path, "landmarks")(path)
    if not isinstance(read, _File):
        name = source_name(path)
        items = ItemList(lambda: [read.items], lambda _: name)
        stated = read.y_axis if known.states_y_axis else None
        file = one_file(name, read, items, lambda: nullcontext(read.take), stated)
    return hiding(file, options.likelihood_below)


def one_file(
    name: str,
    landmarks: LandmarkSet,
    items: ItemList,
    opened: Callable[[], AbstractContextManager[Read]],
    y_axis: Direction | None = None,
) -> _File:
    """Return landmarks in memory as a file of a source; `y_axis` where it is stated."""
    head = landmarks.take(slice(0))
    return _File(name, head, len(landmarks), items, opened, y_axis=y_axis)


def open_stored_file(path: Path, part: slice | None = None) -> _File:
    """Open an HDF5 or Parquet file, or a part of its rows, which is read a chunk at a time."""

    @contextmanager
    def opened() -> Iterator[Read]:
        with open_stored(path, LANDMARKS) as reader:
            yield lambda rows: _read_rows(reader, slice(start + rows.start, start + rows.stop))

    def items() -> Iterator[tuple[str, ...]]:
        with open_stored(path, LANDMARKS) as reader:
            yield from reader.read_blocks("item", part)

    with open_stored(path, LANDMARKS) as reader:
        start, stop, _ = (part or slice(None)).indices(reader.count)
        check_named(reader, reader.read_blocks("item", part))
        check_not_infinite(reader, "landmarks", reader.read_blocks("landmarks", part))
        if reader.has("confidence"):
            check_confidence(reader, reader.read_blocks("confidence", part))
        head = _read_rows(reader, slice(0))
        item_list = ItemList(items, lambda row: reader.place("item", start + row))
        return _File(str(path), head, stop - start, item_list, opened, y_axis=reader.y_axis)


def _read_rows(reader: StoredReader, rows: slice) -> LandmarkSet:
    fields = reader.fields(rows)
    landmarks = fields["landmarks"]
    unseen = np.isnan(landmarks).any(axis=1, keepdims=True)
    fields["landmarks"] = np.where(unseen, np.nan, landmarks)
    extras = reader.extras(rows)
    return LandmarkSet(
        **fields,
        unit=reader.unit,
        y_axis=reader.y_axis or "down",
        frame_rate=reader.frame_rate,
        extras=extras,
    )
