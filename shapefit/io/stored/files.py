"""Files of our own layouts opened, in whichever format holds all of them, as files of a source."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shapefit.errors import input_error, listed
from shapefit.io.formats import FORMATS, detect_format, load
from shapefit.io.joined import SourceFile
from shapefit.io.layout import Dataset, Layout
from shapefit.io.name_index import ItemList
from shapefit.io.records import LandmarkSet, Records, ResultSet, ShapeSet
from shapefit.io.sources import source_name
from shapefit.io.stored.checks import check_values, named

if TYPE_CHECKING:
    from shapefit.io.hdf5_records import Hdf5Reader


def open_stored(path: Path, form: Layout, known: Any = None) -> Hdf5Reader:
    """Open a file of this layout, whose format may be known.

    Raises InputError where its format holds points only.
    """
    known = known or detect_format(path)
    if known.reader is None:
        titles = listed(each.title for each in FORMATS.values() if each.reader is not None)
        found = f"is not {titles}" if path.is_file() else "is not a file on a disk"
        raise input_error(source_name(path), found, f"give a {form.name} file")
    reader: Hdf5Reader = load(known.reader)(path, form)
    return reader


def stored_form(path: Path) -> Layout:
    """Return the layout that a file of ours says it has. Raises InputError where it has none."""
    known = detect_format(path)
    if known.form is None:
        raise ValueError(f"{known.title} has no layout of its own")
    form: Layout = load(known.form)(path)
    return form


KINDS: dict[str, type[Records]] = {
    kind.LAYOUT.name: kind for kind in (LandmarkSet, ShapeSet, ResultSet)
}


def stored_file(
    path: Path,
    form: Layout,
    *,
    gaps: bool = False,
    part: slice | None = None,
    without: Collection[Dataset] = (),
    most_held: int = 0,
    known: Any = None,
) -> SourceFile[Any]:
    """Open a file of landmarks, shapes or results, or a part of its rows, but for some datasets.

    With `gaps` a landmark of a shape may be unknown. Items of at most so many landmarks together
    are read once and held, those of more whenever they are needed. Raises InputError for what is
    wrong with it.
    """

    @contextmanager
    def opened() -> Iterator[Callable[[slice], Records]]:
        with open_stored(path, form, known) as reader:
            yield lambda rows: read_rows(
                reader, slice(start + rows.start, start + rows.stop), without
            )

    def items_of() -> Iterator[Sequence[str]]:
        with open_stored(path, form, known) as reader:
            yield from named(reader, reader.read_blocks("item", part))

    def sequences_of() -> Iterator[Sequence[str]]:
        with open_stored(path, form, known) as reader:
            yield from reader.read_blocks("sequence", part)

    with open_stored(path, form, known) as reader:
        start, stop, _ = (part or slice(None)).indices(reader.count)
        if (stop - start) * len(reader.landmark_names) <= most_held:
            items = tuple(chain.from_iterable(reader.read_blocks("item", part)))
            check_values(reader, form, gaps=gaps, part=part, items=items)
            records = read_rows(reader, slice(start, stop), without, items=items)
            places = ItemList(lambda: [items], lambda row: reader.place("item", start + row))
            return SourceFile.held(str(path), records, places, y_axis=reader.y_axis)
        check_values(reader, form, gaps=gaps, part=part)
        return SourceFile(
            str(path),
            read_rows(reader, slice(0), without),
            stop - start,
            ItemList(items_of, lambda row: reader.place("item", start + row)),
            opened,
            sequences=sequences_of,
            y_axis=reader.y_axis,
        )


def read_rows(
    reader: Hdf5Reader,
    rows: slice,
    without: Collection[Dataset] = (),
    *,
    items: tuple[str, ...] | None = None,
) -> Any:
    """Return the records of these items, but for some datasets; `items` are names at hand."""
    kind = KINDS[reader.form.name]
    said: dict[str, Any] = {"unit": reader.unit, "frame_rate": reader.frame_rate}
    if kind is not ShapeSet:
        said["y_axis"] = reader.y_axis or "down"
    if kind is ResultSet:
        said["attributes"] = reader.attributes
    if items is not None:
        said["items"] = items
        without = [*without, *(known for known in reader.form.datasets if known.name == "item")]
    fields = reader.fields(rows, without=without)
    found = kind(**fields, **reader.further(rows), **said)
    return found if kind is ResultSet else found.with_whole_points()
