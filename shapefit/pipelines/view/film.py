"""A film under the landmarks: when it shows each frame, and whether browsers play it.

The tables of MP4 (ISO/IEC 14496-12) and WebM (RFC 9559) are read, no picture is
decoded: the browser does that.
"""

from __future__ import annotations

import shlex
import struct
from base64 import b64encode
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import counted, input_error
from shapefit.io.inputs import read_head
from shapefit.viewer.page import Film

MP4_SUFFIXES = (".mp4", ".m4v", ".mov")
WEBM_SUFFIXES = (".webm",)

OTHER_FILM_SUFFIXES = (".avi", ".mkv", ".mpg", ".mpeg", ".mts", ".wmv", ".flv", ".gif")
"""Of films that no browser plays."""

MAX_FILM_BYTES = 14_000_000
"""Of a film in a page, which carries its bytes."""

SMALLER = "-vf scale=960:-2 -crf 28"
"""Of ffmpeg: 960 pixels wide, and fewer bytes a pixel."""

MP4_CODECS = ("avc1", "avc3", "vp08", "vp09", "av01")
"""Sample entries that all browsers play."""

WEBM_CODECS = ("V_VP8", "V_VP9", "V_AV1")

H264_PROFILES = (66, 77, 88, 100)
"""Of H.264 in 8 bits with colour at half size, as all browsers play it."""


class FilmTable(NamedTuple):
    """What the tables of a film say.

    starts (m,): the seconds at which its frames are shown, in that order; end, when the
    last is over; codec, its name in the container; fault: why browsers do not play it,
    "" where they do.
    """

    starts: Floats
    end: float
    codec: str
    fault: str = ""


def is_film(path: Path) -> bool:
    """Whether a path is an existing file, or ends like the name of a film."""
    films = MP4_SUFFIXES + WEBM_SUFFIXES + OTHER_FILM_SUFFIXES
    return path.is_file() or path.suffix.lower() in films


def embed_film(path: Path, places: Floats) -> tuple[Film, list[str]]:
    """Return a film with the place in it of each frame of the page, and notes.

    places (n,) count the frames of the film from 0, nan where nobody knows. Raises
    InputError for what no browser plays, what is too large for a page, and what has no
    frame of the page; each with the line of ffmpeg that makes what fits.
    """
    suffix = path.suffix.lower()
    if not path.exists():
        fix = "name a film (MP4, WebM) or a folder of pictures"
        raise input_error(path, "there is no such file", fix)
    if suffix not in MP4_SUFFIXES + WEBM_SUFFIXES:
        _refuse(path, "is no film that browsers play (H.264 in MP4, VP9 in WebM)")
    size = path.stat().st_size
    if size > MAX_FILM_BYTES:
        fault = f"has {size / 1e6:.1f} MB, and a page holds {MAX_FILM_BYTES // 10**6}"
        _refuse(path, fault, SMALLER)
    data = read_head(path, size)
    read_table = read_webm if suffix in WEBM_SUFFIXES else read_mp4
    try:
        table = read_table(data)
    except (struct.error, ValueError, IndexError, ArithmeticError):
        _refuse(path, "is damaged: its tables of frames cannot be read")
    if table.fault:
        _refuse(path, table.fault)
    count = len(table.starts)
    is_inside = (places >= 0) & (places < count)
    if not is_inside.any():
        fault = f"has {counted(count, 'frame')}, and none of the landmarks"
        fix = "give the film that the landmarks were found in"
        raise input_error(path, fault, fix)
    film: Film = {
        "kind": "video/webm" if suffix in WEBM_SUFFIXES else "video/mp4",
        "data": b64encode(data).decode("ascii"),
        "starts": np.append(table.starts, table.end),
        "places": np.where(is_inside, places, np.nan),
    }
    return film, [*_notes_on_lengths(path.name, count, places)]


def _notes_on_lengths(name: str, count: int, places: Floats) -> Iterator[str]:
    """Yield a note where a film and the landmarks are not of one length."""
    last = int(np.nanmax(places)) + 1
    beyond = np.count_nonzero(places >= count)
    has = f"{name} has {counted(count, 'frame')}"
    if beyond:
        yield (
            f"{has}, the landmarks go to frame {last}: {beyond} of them are shown"
            " without it. Is it the same film?"
        )
    elif count > last:
        yield f"{has}, the landmarks end at frame {last}."


def _refuse(path: Path, fault: str, options: str = "") -> NoReturn:
    """Raise InputError for a film, with the line of ffmpeg that makes one that fits."""
    to = path.with_name(f"{path.stem}_page.mp4").name
    words = ["ffmpeg -i", shlex.quote(path.name), options, "-pix_fmt yuv420p -an"]
    line = " ".join(word for word in (*words, shlex.quote(to)) if word)
    raise input_error(path, fault, f"convert it: `{line}`")


def read_mp4(data: bytes) -> FilmTable:
    """Return the table of the first film in the bytes of an MP4 or MOV.

    `stts` holds (count, duration) of frames in the order of decoding, `ctts` the
    (count, offset) by which each is shown later, `elst` where the film begins. Raises
    ValueError and struct.error for damaged files.
    """
    for track in _mp4_boxes(data, ("moov", "trak")):
        handlers = [*_mp4_boxes(track, ("mdia", "hdlr"))]
        if handlers and handlers[0][8:12] == b"vide":
            break
    else:
        return FilmTable(np.empty(0), 0.0, "", "holds no film that can be read")
    tables = ("mdia", "minf", "stbl")
    codec, fault = _read_sample_entry(next(_mp4_boxes(track, (*tables, "stsd")), b""))
    header = next(_mp4_boxes(track, ("mdia", "mdhd")), b"")
    (ticks,) = struct.unpack_from(">I", header, 20 if header[0] else 12)
    counts, durations = _read_pairs(
        next(_mp4_boxes(track, (*tables, "stts")), b""), ">u4"
    )
    if ticks == 0 or counts.sum() > len(data):  # a frame has at least a byte
        raise ValueError("the table of times is damaged")
    if not fault and not counts.sum():
        fault = "is in fragments, and does not say in one place when frames are shown"
    lasts = np.repeat(durations, counts)
    shown = np.cumsum(lasts) - lasts
    for offsets_table in _mp4_boxes(track, (*tables, "ctts")):
        counts, offsets = _read_pairs(offsets_table, ">i4")
        if counts.sum() != len(shown):
            raise ValueError("the table of offsets is damaged")
        shown = shown + np.repeat(offsets, counts)
    if fault:
        return FilmTable(np.empty(0), 0.0, codec, fault)
    end = (shown + lasts).max() / ticks
    begin, delay, parts = _read_edits(data, track, ticks)
    if parts > 1:
        return FilmTable(np.empty(0), 0.0, codec, "is cut together from several parts")
    starts = np.sort(shown / ticks - begin)
    starts = starts[starts > -0.5 / ticks]
    return FilmTable(starts + delay, end - begin + delay, codec)


def _read_sample_entry(table: bytes) -> tuple[str, str]:
    """Return the codec of a table `stsd`, and why browsers do not play it, or ""."""
    codec = table[12:16].decode("latin-1")
    if codec not in MP4_CODECS:
        return codec, f"has the codec {codec!r}, which not all browsers play"
    # the entry begins with 8 bytes of its box and 78 of what all films have
    for settings in _mp4_boxes(table[8 + 86 :], ("avcC",)):
        if settings[1] not in H264_PROFILES:
            return (
                codec,
                "is H.264 that not all browsers play (4:4:4 or 10 bits)",
            )
    return codec, ""


def _read_edits(data: bytes, track: bytes, ticks: int) -> tuple[float, float, int]:
    """Return the seconds skipped and waited at the beginning, and how many parts.

    Parts of the film are shown one after the other.
    """
    begin = 0.0
    delay = 0.0
    parts = 0
    (header,) = _mp4_boxes(data, ("moov", "mvhd"))
    (movie_ticks,) = struct.unpack_from(">I", header, 20 if header[0] else 12)
    for edits in _mp4_boxes(track, ("edts", "elst")):
        layout = ">QqI" if edits[0] else ">IiI"
        size = struct.calcsize(layout)
        (count,) = struct.unpack_from(">I", edits, 4)
        for number in range(min(count, len(edits) // size)):
            entry = struct.unpack_from(layout, edits, 8 + number * size)
            lasts, media_time, _ = entry
            if media_time >= 0:
                begin = media_time / ticks
                parts += 1
            elif parts == 0:
                delay += lasts / movie_ticks
    return begin, delay, parts


def _mp4_boxes(data: bytes, path: Sequence[str]) -> Iterator[bytes]:
    """Yield the contents of the boxes in MP4 that a path of names leads to."""
    at = 0
    while at + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        head = 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", data, at + 8)
            head = 16
        size = size or len(data) - at
        if size < head:
            return
        if name == path[0].encode():
            inner = data[at + head : at + size]
            if len(path) == 1:
                yield inner
            else:
                yield from _mp4_boxes(inner, path[1:])
        at += size


def _read_pairs(table: bytes, kind: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return counts and values of a table of (count, value); `kind` is their dtype."""
    (rows,) = struct.unpack_from(">I", table, 4)
    numbers = np.frombuffer(table, kind, count=2 * rows, offset=8).astype(np.int64)
    counts, values = numbers.reshape(-1, 2).T
    if (counts < 0).any():
        raise ValueError("a table of frames has a negative count")
    return counts, values


SEGMENT = 0x18538067
INFO = 0x1549A966
TIMESTAMP_SCALE = 0x2AD7B1
DURATION = 0x4489
TRACKS = 0x1654AE6B
TRACK = 0xAE
TRACK_NUMBER = 0xD7
TRACK_TYPE = 0x83
CODEC = 0x86
CLUSTER = 0x1F43B675
CLUSTER_TIMESTAMP = 0xE7
SIMPLE_BLOCK = 0xA3
BLOCK_GROUP = 0xA0
BLOCK = 0xA1

MASTERS = (SEGMENT, INFO, TRACKS, TRACK, CLUSTER, BLOCK_GROUP)
"""Elements of WebM that hold those that are read."""

FILM_TRACK = 1
"""Type of a track that holds a film."""

INVISIBLE = 0x08
"""Flag of a frame that is decoded and not shown."""


def read_webm(data: bytes) -> FilmTable:
    """Return the table of the first film in the bytes of a WebM.

    A block holds a frame; its time is that of its cluster, and more. Raises ValueError
    and IndexError for damaged files.
    """
    scale = 1e6  # nanoseconds of a tick, unless the file has others
    duration = 0.0
    codec = ""
    # of the track that is read; film is the number of the first that holds one
    number = 0
    kind = 0
    film = 0
    cluster = 0  # its time
    ticks: list[int] = []
    for element, content in _ebml_elements(data):
        if element == TIMESTAMP_SCALE:
            scale = float(int.from_bytes(content))
        elif element == DURATION:
            (duration,) = struct.unpack(">d" if len(content) == 8 else ">f", content)
        elif element == TRACK:
            number = 0
            kind = 0
        elif element == TRACK_NUMBER:
            number = int.from_bytes(content)
        elif element == TRACK_TYPE:
            kind = int.from_bytes(content)
        elif element == CODEC and not codec and content.startswith(b"V_"):
            codec = content.decode("latin-1").strip("\0")
        elif element == CLUSTER_TIMESTAMP:
            cluster = int.from_bytes(content)
        elif element in (SIMPLE_BLOCK, BLOCK):
            owner, length = _read_variable_number(content, 0)
            (later,) = struct.unpack_from(">h", content, length)
            if owner == film and not content[length + 2] & INVISIBLE:
                ticks.append(cluster + later)
        if kind == FILM_TRACK and number and not film:
            film = number
    if codec and codec not in WEBM_CODECS:
        fault = f"has the codec {codec!r}, which not all browsers play"
        return FilmTable(np.empty(0), 0.0, codec, fault)
    if not ticks:
        return FilmTable(np.empty(0), 0.0, codec, "holds no film that can be read")
    starts = np.sort(np.array(ticks)) * scale / 1e9
    steps = [later - one for one, later in pairwise(starts)]
    usual = float(np.median(steps)) if steps else 0.0
    end = max(duration * scale / 1e9, starts[-1] + usual / 2)
    return FilmTable(starts, float(end), codec)


def _ebml_elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (id, content) of the elements of EBML, those inside others after them.

    The contents of an element that holds others come one by one, and its own is empty.
    """
    at = 0
    while at < len(data):
        name, head = _read_variable_number(data, at, keeps_length=True)
        size, length = _read_variable_number(data, at + head)
        at += head + length
        if name in MASTERS:
            yield name, b""
            continue
        if size == (1 << 7 * length) - 1:
            raise ValueError("an element that is read has no size")
        yield name, data[at : at + size]
        at += size


def _read_variable_number(
    data: bytes, at: int, *, keeps_length: bool = False
) -> tuple[int, int]:
    """Return the number of EBML at a place, and how many bytes it has.

    The first byte says how many. keeps_length: whether the bit that says so is part of
    the number, as in ids.
    """
    first = data[at]
    if first == 0:
        raise ValueError("a number of more than 8 bytes")
    length = 9 - first.bit_length()
    number = int.from_bytes(data[at : at + length])
    if not keeps_length:
        number &= (1 << 7 * length) - 1
    return number, length
