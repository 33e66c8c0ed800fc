"""Open files of landmarks, shapes and results, in any format, as sources; write shapes."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.foreign.items import are_fractions, keep_landmarks, size_needed
from shapefit.io.formats import FileFormat, detect_format, find_reader, group_inputs, mixture
from shapefit.io.joined import LandmarkSource, ResultSource, ShapeSource, Source, SourceFile
from shapefit.io.landmark_names import check_known
from shapefit.io.layout import LANDMARKS, PROOF, RESULTS, SHAPES, TREES, Dataset, Layout
from shapefit.io.name_index import ItemList
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.problems import Axis, check_magnitudes, warn_of_zeros
from shapefit.io.records import LandmarkSet, Record, ResultSet, ShapeSet
from shapefit.io.sources import source_name
from shapefit.io.stored.checks import Given, check_values
from shapefit.io.stored.files import open_stored, read_rows, stored_file
from shapefit.io.writing import record_writer

if TYPE_CHECKING:
    from shapefit.io.hdf5_records import Hdf5Reader


PROOFS = PROOF + TREES
"""Datasets of results that stay in the file unless they are asked for."""

UNNEEDED = ("iterations", "mesh_vertices")
"""Datasets that nothing is claimed of."""

CENTRED = 0.1
"""Share of coordinates below 0 from which on they are no fractions of an image, but points about
a centre in a unit of their own."""

MOST_HELD = 1 << 21
"""Landmarks of all items and files together that are held, some 50 MB; more are read again."""


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
    groups = group_inputs(paths, options)
    held = MOST_HELD // len(groups)
    files = [
        _open(LANDMARKS, known, own, options, part=rows, most_held=held) for known, own in groups
    ]
    files[0] = replace(files[0], notes=files[0].notes + mixture(groups))
    return LandmarkSource(_renamed(files, options), options.y_axis)


def open_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> ShapeSource:
    """Open files of shapes in any format (`-` is standard input) as one source.

    Landmarks are matched by name and stand in the order of the first file, items in the order of
    the files; where only some files have sequences, those of the others are empty texts.
    Everything is checked before the first shape is given out. Raises InputError for what is wrong
    with a file, for items that occur twice, and for files that do not go together (other
    landmarks, units, meshes or further datasets). HDF5 and Parquet are read a chunk at a time,
    all else whole.

    With `gaps` a landmark of an item may be unknown: it is NaN, in all coordinates where it is in
    one, and may lack its row in CSV. Without, that is wrong. `rename` as in `open_landmarks`.
    """
    groups = group_inputs(paths, options)
    files = [_open(SHAPES, known, own, options, gaps=gaps) for known, own in groups]
    return ShapeSource(_renamed(files, options))


def open_results(paths: Sequence[Path], without: Collection[Dataset] = PROOFS) -> ResultSource:
    """Open results as one source; datasets in `without` are not read.

    From CSV all but shapes, names, items and sequences is None. HDF5 and Parquet are read a chunk
    at a time, CSV whole. Raises InputError for what is wrong with a file, for items that occur
    twice, and for files that do not go together.
    """
    known = [(detect_format(path), (path,)) for path in paths]
    return ResultSource([_open(RESULTS, *own, AS_THEY_ARE, without=without) for own in known])


def given_source(
    records: Record, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> Source[Record]:
    """Return landmarks or shapes in memory as a source; `name` stands for a file in messages.

    With `gaps` landmarks of shapes may be unknown. Raises InputError as for what a file holds.
    """
    given = Given(name, records, records.LAYOUT)
    check_values(given, records.LAYOUT, gaps=gaps, items=records.items)
    check_known(rename, [(name, records.landmark_names)])
    records = records.with_whole_points().renamed(rename, name)
    items = ItemList(lambda: [records.items], lambda row: given.place("item", row))
    stated = records.y_axis if isinstance(records, LandmarkSet) else None
    return Source([SourceFile.held(name, records, items, y_axis=stated)])


def read_shapes(
    paths: Sequence[Path], options: InputOptions = AS_THEY_ARE, *, gaps: bool = False
) -> ShapeSet:
    """Read shapes from files of any format as one set, as `open_shapes` opens them."""
    with open_shapes(paths, options, gaps=gaps) as source:
        return source.whole()


def read_results(path: Path, *, proofs: bool = False) -> ResultSet:
    """Read a result from a file of any format that has one (`-` is standard input), as one.

    What proves the optimum stays in the file unless `proofs` asks for it. Raises InputError as
    `open_results`.
    """
    with open_results([path], () if proofs else PROOFS) as source:
        return source.whole()


@contextmanager
def open_proofs(path: Path) -> Iterator[Hdf5Reader]:
    """Open a result for its proofs. Raises InputError where it is CSV, or not a result."""
    if detect_format(path).reader is None:
        found = "is not HDF5, and tables hold points only"
        fix = "give a result that `shapefit fit` wrote to a name in .h5"
        raise input_error(path, found, fix)
    with open_stored(path, RESULTS) as reader:
        yield reader


def proof_chunks(reader: Hdf5Reader, size: int, *, sequences: bool = True) -> Iterator[ResultSet]:
    """Give out results with their proofs, `size` at a time, with or without sequences."""
    without = UNNEEDED if sequences else (*UNNEEDED, "sequence")
    unneeded = [dataset for dataset in RESULTS.datasets if dataset.name in without]
    for start in range(0, reader.count, size):
        yield read_rows(reader, slice(start, min(start + size, reader.count)), unneeded)


def write_shapes(path: Path, shapes: ShapeSet) -> None:
    """Write shapes to HDF5, or to CSV for `-` and names in .csv (without mesh, edges, extras).

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, SHAPES) as writer:
        writer.append(shapes)


def _open(
    form: Layout,
    known: FileFormat,
    paths: tuple[Path, ...],
    options: InputOptions,
    *,
    gaps: bool = False,
    part: slice | None = None,
    without: Collection[Dataset] = (),
    most_held: int = 0,
) -> SourceFile[Any]:
    """Open a file of any format; one that is read whole gives out parts of what was read."""
    path, name = paths[0], source_name(paths[0])
    notes: tuple[str, ...] = ()
    if known.recorder is not None and form is not RESULTS:
        from shapefit.io.foreign.items import read_landmarks
        from shapefit.io.foreign.items import read_shapes as read_foreign_shapes

        if form is LANDMARKS:
            images, notes = read_landmarks(known, paths, options)
            stated = images.y_axis if known.states_y_axis else None
            return SourceFile.held(name, images, notes=notes, y_axis=stated)
        records, notes = read_foreign_shapes(known, paths, options, gaps=gaps)
    else:
        read = find_reader(path, form.kind, known)
        if read is stored_file:
            file = stored_file(
                path, form, gaps=gaps, part=part, without=without, most_held=most_held, known=known
            )
            return _hiding(file, options.likelihood_below)
        further = {"gaps": gaps} if form is SHAPES else {}
        records = read(*((paths,) if known.together else paths), **further)
        if known.together:
            records, notes = records
    if form is SHAPES:
        landmarks = Axis("landmark", records.landmark_names)
        check_magnitudes(name, records.shapes, Axis("item", records.items), landmarks)
    elif isinstance(records, LandmarkSet):
        records = in_pixels(records, options, name)  # type: ignore[assignment]
    if isinstance(records, LandmarkSet) and records.confidence is None:
        found = warn_of_zeros(records.landmarks.swapaxes(1, 2))
        notes += tuple(f"{name}: {text}" for text in found)
    stated = getattr(records, "y_axis", None) if known.states_y_axis else None
    file = SourceFile.held(name, records, notes=notes, y_axis=stated)
    return _hiding(file, options.likelihood_below)


def _renamed(files: Sequence[SourceFile[Any]], options: InputOptions) -> list[SourceFile[Any]]:
    """Return files whose landmarks have their new names; InputError for those that none has.

    Of these the landmarks that are kept.
    """
    rename, kept = options.rename, options.landmarks
    check_known(rename, [(file.name, file.head.landmark_names) for file in files])

    def change(records: Any, place: str) -> Any:
        records = records.renamed(rename, place) if rename else records
        return records if kept is None else keep_landmarks(records, kept, place)

    if not rename and kept is None:
        return list(files)
    return [
        file.changed(lambda records, place=file.name: change(records, place))  # type: ignore[misc]
        for file in files
    ]


def in_pixels(images: LandmarkSet, options: InputOptions, name: str) -> LandmarkSet:
    """Return landmarks of a table of ours in pixels, where they are fractions of an image.

    Raises InputError for fractions without `image_size`.
    """
    placed = images.landmarks[np.isfinite(images.landmarks)]
    if not are_fractions(placed) or (placed < 0).mean() > CENTRED:
        return images
    if options.image_size is None:
        raise size_needed(name)
    size = np.array(options.image_size)[:, None]
    return images.replaced(landmarks=images.landmarks * size, unit="px")


def _hiding(file: SourceFile[Any], least: float) -> SourceFile[Any]:
    """Return a file that hides landmarks whose confidence is below `least`."""
    if not least or getattr(file.head, "confidence", None) is None:
        return file

    def hidden(images: LandmarkSet) -> LandmarkSet:
        assert images.confidence is not None
        doubtful = images.confidence < least
        return images.replaced(
            landmarks=np.where(doubtful[:, None], np.nan, images.landmarks),
            confidence=np.where(doubtful, 0.0, images.confidence),
        )

    return file.changed(hidden)
