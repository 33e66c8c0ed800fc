"""The table of file formats: how each is recognised, what it can hold, what reads and writes it.

It is light: readers and writers are imported when a file of theirs is met. A format of others has
one file with its functions, and one entry in the table of its room.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from shapefit.errors import input_error, listed
from shapefit.io.foreign.table import FORMATS as OF_OTHERS
from shapefit.io.foreign.table import FileFormat
from shapefit.io.sources import (
    BYTE_ORDER_MARK,
    HDF5_SIGNATURE,
    PARQUET_SIGNATURE,
    is_stream,
    require_file,
    source_name,
)
from shapefit.io.written import table as written
from shapefit.stores.reading import read_head

HEAD_BYTES = 4096
"""Of a file that a recogniser sees."""

STORED = dict.fromkeys(("landmarks", "shapes", "result"), "shapefit.io.stored.files:stored_file")
"""Readers of the formats that hold every dataset, by kind."""

HDF5 = FileFormat(
    title="an HDF5 file",
    suffixes=(".h5", ".hdf5", ".hdf", ".he5"),
    recogniser="shapefit.io.formats:begins_like_hdf5",
    readers={
        **STORED,
        "dictionary": "shapefit.io.kinds.dictionaries:read_hdf5",
    },
    reader="shapefit.io.hdf5.reading:Hdf5Reader",
    form="shapefit.io.hdf5.reading:hdf5_form",
    writer="shapefit.io.hdf5.writing:hdf5_output",
    writes=("landmarks", "shapes", "result", "dictionary"),
    points_only=False,
)

PARQUET = FileFormat(
    title="a Parquet file",
    suffixes=(".parquet", ".pq"),
    recogniser="shapefit.io.formats:begins_like_parquet",
    readers=STORED,
    reader="shapefit.io.parquet.reading:ParquetReader",
    form="shapefit.io.parquet.reading:parquet_form",
    writer="shapefit.io.parquet.writing:parquet_output",
    writes=("landmarks", "shapes", "result"),
    points_only=False,
)

CSV = FileFormat(
    title="a CSV file",
    suffixes=(".csv",),
    recogniser="shapefit.io.formats:begins_like_tidy_csv",
    readers={
        "landmarks": "shapefit.io.csv.tables:read_landmark_table",
        "shapes": "shapefit.io.csv.tables:read_shape_table",
        "result": "shapefit.io.csv.tables:read_result_table",
    },
    writer="shapefit.io.csv.writing:csv_output",
    writes=("landmarks", "shapes", "result"),
    states_y_axis=False,
)

FORMATS: dict[str, FileFormat] = {
    "hdf5": HDF5,
    "parquet": PARQUET,
    "csv": CSV,
    **OF_OTHERS,
}
"""Those of the package come first; the recognisers of others are asked before theirs."""


def targets() -> dict[str, FileFormat]:
    """Return the formats that can be written, by their names."""
    own = {name: known for name, known in FORMATS.items() if known.writer}
    return own | written.FORMATS


def find_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format of a file, by its content; what nothing recognises is read as CSV.

    Standard input and pipes are CSV. With another `name` than auto it is that format. Raises
    InputError as `require_file` does, for unknown names, and for binary files that nothing
    recognises.
    """
    if is_stream(path):
        return CSV
    if name != "auto":
        return _named(name, FORMATS)
    if path.is_dir():
        return _find_folder_format(path)
    require_file(path)
    if not path.is_file():
        return CSV
    head = read_head(path, HEAD_BYTES)
    for known in _likely_first(path):
        if load(known.recogniser)(path, head):
            return known
    if HDF5.has_suffix(path):
        fix = "give an HDF5 file, or name it .csv if it is CSV"
        raise input_error(path, "is not an HDF5 file", fix)
    other = load("shapefit.io.foreign.opening:stranger")(path, head)
    if other is not None:
        raise other
    if b"\0" in head and not CSV.has_suffix(path):
        raise load("shapefit.io.foreign.opening:unknown")(path, FORMATS.values())
    if head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"["):
        raise load("shapefit.io.detectors.json_text:unknown_json")(path, head)
    return CSV


def _named(name: str, known: Mapping[str, FileFormat], key: str = "format") -> FileFormat:
    if name not in known:
        near = get_close_matches(name, known, n=1, cutoff=0.4)
        fix = f"did you mean {near[0]}?" if near else f"use auto, {listed(known)}"
        raise input_error(key, f"there is no format {name!r}", fix)
    return known[name]


def _find_folder_format(path: Path) -> FileFormat:
    """Return the format of a folder whose files are one recording."""
    folders = [known for known in FORMATS.values() if known.folders]
    for known in folders:
        if load(known.recogniser)(path, b""):
            return known
    looked = f", and holds none of these: {listed(known.title for known in folders)}"
    raise input_error(path, f"it is a folder{looked}", f"name the files in it, e.g. '{path}/*.h5'")


def find_reader(path: Path, kind: str, known: FileFormat | None = None) -> Callable[..., Any]:
    """Return what reads records of a kind from this file, whose format may be known.

    Raises InputError where nothing does.
    """
    known = known or find_format(path)
    if kind not in known.readers:
        titles = listed(each.title for each in FORMATS.values() if kind in each.readers)
        found = f"is {known.title}, not {titles}" if path.is_file() else "is not a file on a disk"
        raise input_error(source_name(path), found, f"give a shapefit-{kind} file")
    return load(known.readers[kind])


def find_target_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format that an output path asks for: CSV for `-`, HDF5 for a name without ending.

    With another `name` than auto it is that format. Raises InputError for an ending of no format.
    """
    if name != "auto":
        return _named(name, targets(), "to")
    if is_stream(path):
        return CSV
    for known in targets().values():
        if known.has_suffix(path):
            return known
    if path.suffix:
        endings = [suffix for known in targets().values() for suffix in known.suffixes]
        found = f"no format that is written ends in {path.suffix}"
        raise input_error(path, found, f"end the name in {listed(endings)}")
    return HDF5


def find_writer(path: Path, kind: str, name: str = "auto") -> Callable[..., Any]:
    """Return what writes records of a kind. Raises InputError where the format cannot hold them."""
    known = find_target_format(path, name)
    if known.writer is None or kind not in known.writes:
        name = known.title.split()[1]
        if kind == "landmarks" and known.in_metres:
            fix = "lift them with `shapefit fit` first, or write .h5, .csv or .json"
            raise input_error(path, f"2D landmarks cannot be {name}", fix)
        raise input_error(path, f"a {kind} cannot be {name}", "give it a name in .h5")
    return load(known.writer)


def begins_like_hdf5(path: Path, head: bytes) -> bool:
    """Whether a file begins with the signature of HDF5."""
    return head.startswith(HDF5_SIGNATURE)


def begins_like_parquet(path: Path, head: bytes) -> bool:
    """Whether a file begins with the signature of Parquet."""
    return head.startswith(PARQUET_SIGNATURE)


def begins_like_tidy_csv(path: Path, head: bytes) -> bool:
    """Whether the first line names the columns of our tables."""
    line = head.partition(b"\n")[0].removeprefix(BYTE_ORDER_MARK).strip()
    columns = {cell.strip(b' "') for cell in line.split(b",")}
    return {b"item", b"landmark"} <= columns and not HDF5.has_suffix(path)


def _likely_first(path: Path) -> Iterator[FileFormat]:
    """Yield the formats whose names fit before the others, and each time the package's own last.

    Many formats are HDF5 or CSV inside, so their recognisers are asked before ours.
    """
    others = [known for known in FORMATS.values() if known not in (HDF5, CSV)]
    ordered = [*others, HDF5, CSV]
    yield from (known for known in ordered if known.has_suffix(path))
    yield from (known for known in ordered if not known.has_suffix(path))


def load(place: str) -> Callable[..., Any]:
    """Import a function by its place, "module:function"."""
    module, _, name = place.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
