"""What a file of no known format may be, by its first bytes, and what to do with it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from shapefit.errors import InputError, input_error, listed
from shapefit.io.foreign.table import FileFormat

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
