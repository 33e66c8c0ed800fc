"""What an entry in the table of file formats says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A format of files. Functions are named as "module:function".

    title        what a file of it is called, with its article
    suffixes     endings of its names; it is looked for in files of these names first, and an
                 output of such a name is written in it
    recogniser   takes a path and the first HEAD_BYTES of the file; whether it is in this format;
                 "" where files are written only
    recorder     of a format of others: takes the paths that are one recording, returns it
    records      the kinds that a recording can be of; its content decides
    together     files of one folder are one recording: a frame each, or parts that need each other;
                 its readers take all their paths and return a record and notes
    folders      a folder is an input, too; the recogniser is given it with no bytes
    readers      by kind (landmarks, shapes, result, dictionary): takes a path, returns the record,
                 or a SourceFile that gives out parts of it. A reader of shapes takes `gaps`, too:
                 whether landmarks may be unknown
    reader       of a format of ours that holds every dataset: takes a path and a layout, opens a
                 StoredReader
    form         of such a format: takes a path, returns the layout that the file says it has
    writer       takes a path and the layout of the records, gives a RecordWriter in a `with`
    writes       the kinds that it can write
    in_metres    what it writes is in metres and upright; its writer takes OutputOptions, too
    atom_meshes  that writer has a place for the meshes that results mix
    by_sequence  its files hold one sequence each, or nothing but sequences
    points_only  it has no place for what is not a point: attributes, further datasets
    states_y_axis  its files say, or it is known of all of them, whether y points up or down
    """

    title: str
    suffixes: tuple[str, ...]
    recogniser: str = ""
    recorder: str | None = None
    records: tuple[str, ...] = ()
    together: bool = False
    folders: bool = False
    readers: Mapping[str, str] = field(default_factory=dict)
    reader: str | None = None
    form: str | None = None
    writer: str | None = None
    writes: tuple[str, ...] = ()
    in_metres: bool = False
    atom_meshes: bool = False
    by_sequence: bool = False
    points_only: bool = True
    states_y_axis: bool = True

    def has_suffix(self, path: Path) -> bool:
        """Whether the path is named like a file of this format."""
        return path.name.lower().endswith(self.suffixes)
