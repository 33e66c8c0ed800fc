"""From paths to recordings: which files are one, what reads them, what a strange file may be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

from shapefit.errors import InputError, input_error, listed
from shapefit.io.foreign.recording import Recording
from shapefit.io.foreign.table import FileFormat
from shapefit.io.formats import FORMATS, find_format, load
from shapefit.io.options import InputOptions
from shapefit.io.sources import HDF5_SIGNATURE, begins_with, source_name
from shapefit.stores.shelf import has_copy, on_threads
from shapefit.stores.urls import UrlPath


def look_into(paths: Sequence[Path]) -> None:
    """Have the HDF5 files among several tried together, in less time than when each is opened."""
    here = [path for path in paths if not isinstance(path, UrlPath) or has_copy(path)]
    several = [path for path in here if len(here) > 1 and begins_with(path, HDF5_SIGNATURE)]
    if several:
        load("shapefit.io.hdf5.trial:try_together")(several)


def group_inputs(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Return the inputs in order, each with its format; files that are one recording together."""
    groups: dict[tuple[str, str], tuple[FileFormat, list[Path]]] = {}
    look_into(paths)
    formats = on_threads(partial(find_format, name=options.format), paths)
    for path, known in zip(paths, formats, strict=True):
        shared = known.together and not path.is_dir()
        key = (known.title, str(path.parent)) if shared else ("", str(path))
        groups.setdefault(key, (known, []))[1].append(path)
    return [(known, tuple(own)) for known, own in groups.values()]


def mixture(groups: Sequence[tuple[FileFormat, tuple[Path, ...]]]) -> tuple[str, ...]:
    """Warn of inputs in several formats, some of them of other tools, whose names may not agree."""
    counts = Counter(known.title for known, _ in groups)
    if len(counts) < 2 or all(known.recorder is None for known, _ in groups):
        return ()
    found = listed((f"{title} ({number})" for title, number in counts.items()), "and")
    return (f"several formats in one call: {found}; landmarks are matched by their names",)


def open_either(known: FileFormat, paths: tuple[Path, ...]) -> Recording:
    """Return the recording in these files, be it of landmarks or of shapes."""
    if known.recorder is None:
        raise ValueError(f"{known.title} is not a recording")
    module, _, function = known.recorder.partition(":")
    recording: Recording = getattr(import_module(module), function)(paths)
    return recording


def open_recording(known: FileFormat, paths: tuple[Path, ...], kind: str) -> Recording:
    """Return the recording in these files. Raises InputError where it is not of this kind."""
    wanted = 2 if kind == "landmarks" else 3
    name = source_name(paths[0])
    if known.recorder is None or kind not in known.records:
        titles = listed(
            each.title for each in FORMATS.values() if kind in each.readers or kind in each.records
        )
        fix = f"give {'2D landmarks' if wanted == 2 else '3D shapes'}: {titles}"
        raise input_error(name, f"is {known.title}, which holds no {kind}", fix)
    recording = open_either(known, paths)
    if recording.dimensions != wanted:
        found = f"{known.title} of {recording.dimensions}D points"
        fix = "give 3D shapes" if wanted == 3 else "give 2D landmarks; 3D shapes are for learn-dict"
        raise input_error(name, found, fix)
    return recording


UNPACK = "unpack it first"
LANDMARKS = "give the file of landmarks that a detector made of it"
EXPORT = "export its points as CSV"

SIGNS: tuple[tuple[bytes, str, str], ...] = (
    (b"\x1f\x8b", "is compressed by gzip", UNPACK),
    (b"BZh", "is compressed by bzip2", UNPACK),
    (b"\xfd7zXZ\0", "is compressed by xz", UNPACK),
    (b"\x28\xb5\x2f\xfd", "is compressed by zstd", UNPACK),
    (
        b"PK\x03\x04",
        "is a zip archive, as models of PyTorch are, too",
        "give a file of landmarks; unpack it first if it holds one",
    ),
    *(
        (
            bytes([128, protocol]),
            "is a pickle of Python, which is never executed here",
            "give the CSV or HDF5 file that its program exports",
        )
        for protocol in range(2, 6)
    ),
    (b"MATLAB ", "is a file of MATLAB", EXPORT),
    (b"CDF", "is netCDF 3", "write it as netCDF 4: to_netcdf(..., engine='h5netcdf')"),
    (b"RIFF", "is a video, or a part of one", LANDMARKS),
    (b"\x1aE\xdf\xa3", "is a video, or a part of one", LANDMARKS),
    *(
        (start, "is an image", "give the file of landmarks found in it")
        for start in (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"BM")
    ),
)
"""First bytes -> what such a file is, and the fix."""


def stranger(path: Path, head: bytes) -> InputError | None:
    """Return the error for a file whose first bytes say what else it is; None without such."""
    if head[4:8] in (b"ftyp", b"moov", b"mdat"):
        return input_error(path, "is a video, or a part of one", LANDMARKS)
    for start, found, fix in SIGNS:
        if head.startswith(start) and not _is_text(head):
            return input_error(path, found, fix)
    return None


def unknown(path: Path, known: Iterable[FileFormat]) -> InputError:
    """Return the error for a binary file that is in none of the known formats."""
    formats = [each for each in known if each.readers or each.recorder]
    near = next((each for each in formats if each.has_suffix(path)), None)
    fix = f"it is named like {near.title}, but does not begin like one; " if near else ""
    titles = listed(each.title for each in formats)
    return input_error(path, "is of no known format", f"{fix}known are {titles}")


def _is_text(head: bytes) -> bool:
    """Whether bytes are the beginning of a text; the last letter may be cut."""
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return error.start > len(head) - 4 and b"\0" not in head
    return b"\0" not in head
