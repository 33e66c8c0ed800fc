"""From a path to an open file of one of our layouts, in whichever format holds all of it."""

from __future__ import annotations

from pathlib import Path

from shapefit.errors import input_error, listed
from shapefit.io.formats import FORMATS, find_format, load
from shapefit.io.layout import Format
from shapefit.io.sources import source_name
from shapefit.io.stored.reader import StoredReader


def open_stored(path: Path, form: Format) -> StoredReader:
    """Open a file of this layout. Raises InputError where its format holds points only."""
    known = find_format(path)
    if known.reader is None:
        titles = listed(each.title for each in FORMATS.values() if each.reader is not None)
        found = f"is not {titles}" if path.is_file() else "is not a file on a disk"
        raise input_error(source_name(path), found, f"give a {form.name} file")
    reader: StoredReader = load(known.reader)(path, form)
    return reader


def stored_form(path: Path) -> Format:
    """Return the layout that a file of ours says it has. Raises InputError where it has none."""
    known = find_format(path)
    if known.form is None:
        raise ValueError(f"{known.title} has no layout of its own")
    form: Format = load(known.form)(path)
    return form
