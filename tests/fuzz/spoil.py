"""What spoils tables, text, JSON, HDF5 and bytes, with values that programs stumble
over.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np

NUMBERS = (
    "0",
    "-0",
    "1",
    "-1",
    "0.5",
    "1e-8",
    "1e-320",
    "1e150",
    "1e154",
    "1e160",
    "1e308",
    "1e400",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "0x10",
    "1_000",
    "1,5",
    "１",
    "+1",
    ".5",
    "5.",
    "1e",
    "--1",
    "9223372036854775807",
    "9223372036854775808",
    "-9223372036854775809",
    "1" + 400 * "0",
    "3000000000",
    "65536",
    "true",
    "null",
    "",
    " ",
    "1 2",
    "'1'",
    '"1"',
    "1e1e1",
)
NAMES = (
    "",
    " ",
    "a",
    "item",
    "a,b",
    'a"b',
    "a\nb",
    "a\tb",
    "a\0b",
    "\x1b[31mred",
    "café",
    "cafe\u0301",
    "\u202e",
    "\ud800",
    "../up",
    "/root",
    "-",
    ".",
    "..",
    "=1+1",
    "x" * 3000,
    "😀",
    "NaN",
    "%41",
    "{data}",
    "*",
    "[a]",
    "~",
    "$HOME",
    "`id`",
    "#1",
    "|",
    "item#2",
    "²",
)
JSON_VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    -1,
    0,
    1,
    2.5,
    1e308,
    -1e308,
    10**18,
    10**30,
    float("nan"),
    float("inf"),
    "",
    "a",
    "0",
    [],
    {},
    [[]],
    [{}],
    {"a": 1},
    [1],
    [1, 2, 3],
    [None],
    ["x"],
    [1, [2], 3],
)
JSON_KEYS = (
    "images",
    "people",
    "id",
    "track_id",
    "idx",
    "person_id",
    "instances",
    "keypoints",
)
VALUES = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1e-320,
    1e-160,
    1e100,
    1e149,
    1e151,
    1e154,
    1e160,
    1e308,
    -1e308,
    np.nan,
    np.inf,
    -np.inf,
    2.0**63,
    95.0,
)
TYPES = (
    "f2",
    "f4",
    "f8",
    "g",
    "i1",
    "u1",
    "i8",
    "u8",
    ">f8",
    ">i4",
    "?",
    "c16",
    "S3",
    "V4",
)

MAX_VALUES = 10**6
"""Of a dataset that is changed: one made sparse before it would take all memory."""

Rows = list[list[str]]


def spoil_table(rng: Random, path: Path) -> None:
    """Change cells, columns and rows of a CSV file, at times its bytes as well."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    for _ in range(rng.choice((0, 1, 1, 2, 3))):
        if rows[0]:  # a header without any column cannot be spoiled further
            change = rng.choice((_cells, _cells, _columns, _rows))
            change(rng, rows)
    text = "\n".join(",".join(row) for row in rows) + "\n"
    data = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.4:
        data = spoil_text_bytes(rng, data)
    path.write_bytes(data)


def _cells(rng: Random, rows: Rows) -> None:
    """Change one cell, or some of a column; at times those of the header."""
    place = rng.randrange(len(rows[0]))
    some_rows = rng.choice(([rows[0]], [rng.choice(rows)], rows[1:]))
    for row in some_rows:
        if place < len(row):
            values = rng.choice((NUMBERS, NAMES))
            row[place] = rng.choice((row[place], *values))


COLUMNS = ("confidence", "sequence", "z", "weight")


def _columns(rng: Random, rows: Rows) -> None:
    """Drop a column, or add one."""
    place = rng.randrange(len(rows[0]))
    name = rng.choice(COLUMNS)
    for number, row in enumerate(rows):
        value = rng.choice(NUMBERS + NAMES)
        if place % 2:
            del row[place : place + 1]
        else:
            row.insert(place + 1, name if number == 0 else value)


ENDS_OF_LINES = (b"\r\n", b"\r", b"\n\n", b"\n\r\n", b"")


DELIMITERS = (b";", b"\t", b", ", b",,")


OTHER_FILES = (b"", b"\n", b"item", b"\x89HDF\r\n\x1a\n", b"PK\3\4", b"\0" * 999)


PIECES = (b'"', b"'", b"\0", b"\xff", b"\\", b"\r", b"x" * 200_000)


ENCODINGS = ("utf-16", "utf-32", "utf-7")


def _rows(rng: Random, rows: Rows) -> None:
    """Drop, repeat, empty or shuffle rows, or change the width of one."""
    start = rng.randrange(1, len(rows) + 1)
    row = rng.choice(rows)
    match rng.randrange(3):
        case 0:
            new = rng.choice(([], rows[1:3], [[]], [[""] * 9]))
            rows[start : start + rng.randrange(40)] = new
        case 1:
            rows[1:] = rng.sample(rows[1:], len(rows) - 1)
        case _:
            row[:] = row[: rng.randrange(len(row) + 1)] + [""] * rng.randrange(4)


def insert(rng: Random, data: Any, piece: Any) -> Any:
    """Put a piece somewhere into a text or bytes."""
    place = rng.randrange(len(data) + 1)
    return data[:place] + piece + data[place:]


def spoil_text_bytes(rng: Random, data: bytes) -> bytes:
    """Cut text off, change line ends, delimiters or the encoding, or put bytes in."""
    pieces = (*PIECES, rng.randbytes(5))
    with suppress(UnicodeError):
        match rng.randrange(8):
            case 0:
                return data[: rng.randrange(len(data) + 1)]
            case 1:
                return data.replace(b"\n", rng.choice(ENDS_OF_LINES))
            case 2:
                return data.replace(b",", rng.choice(DELIMITERS), rng.randrange(99))
            case 3:
                return b"\xef\xbb\xbf" + data
            case 4:
                return data.decode().encode(rng.choice(ENCODINGS))
            case 5:
                return rng.choice(OTHER_FILES)
            case _:
                return bytes(insert(rng, data, rng.choice(pieces)))
    return data


def spoil_json(rng: Random, path: Path) -> None:
    """Replace, drop, repeat or add values somewhere in a JSON file."""
    data = json.loads(path.read_text("utf-8"))
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = list(_places(data))
        if not places:
            break
        parent, last = rng.choice(places)
        kind = rng.random()
        if kind < 0.6:
            parent[last] = _json_value(rng)
        elif kind < 0.8:
            del parent[last]
        elif isinstance(parent, list):
            parent.insert(last, deepcopy(parent[last]))
        else:
            key = rng.choice(JSON_KEYS)
            parent[key] = _json_value(rng)
    path.write_text(json.dumps(data), encoding="utf-8")


def _json_value(rng: Random) -> Any:
    """Choose a value; it is copied, since it may be spoiled next."""
    return deepcopy(rng.choice(JSON_VALUES))


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every list or mapping in JSON with each of its keys."""
    if isinstance(data, dict):
        keys = list(data)
    elif isinstance(data, list):
        keys = list(range(len(data)))
    else:
        return
    for key in keys:
        yield data, key
        yield from _places(data[key])


CANNOT_BE_CHANGED = (
    IndexError,
    KeyError,
    TypeError,
    ValueError,
    RuntimeError,
    OSError,
)
"""What h5py raises of a change that a file cannot have."""


def spoil_bytes(rng: Random, path: Path) -> None:
    """Cut a file off, change some of its bytes, or put others before it."""
    data = bytearray(path.read_bytes())
    match rng.randrange(4):
        case 0:
            data = data[: rng.randrange(len(data))]
        case 1:
            for _ in range(rng.choice((1, 4, 32))):
                data[rng.randrange(len(data))] = rng.randrange(256)
        case 2:
            start = rng.randrange(len(data))
            data[start : start + rng.randrange(500)] = bytes(rng.randrange(500))
        case _:
            data[:0] = rng.randbytes(512)
    path.write_bytes(data)


def spoil_hdf5(rng: Random, path: Path) -> None:
    """Change datasets, links and attributes of a file or of a group in it, or its
    bytes.
    """
    with h5py.File(path, "a") as file:
        groups = _groups(file)
        group = rng.choice(groups) if rng.random() < 0.5 else file
        for _ in range(rng.choice((1, 1, 2, 3))):
            with suppress(*CANNOT_BE_CHANGED):
                change = rng.choice(HDF5_CHANGES)
                change(rng, group)
    if rng.random() < 0.15:
        spoil_bytes(rng, path)


def _groups(file: h5py.File) -> list[h5py.Group]:
    """Return a file and all groups in it."""
    groups = [file]

    def visit(_name: str, node: Any) -> None:
        if isinstance(node, h5py.Group):
            groups.append(node)

    file.visititems(visit)
    return groups


def put(file: Any, name: str, values: Any, **keys: Any) -> None:
    """Put a dataset in the place of what has its name."""
    if name in file:
        del file[name]
    with suppress(TypeError, ValueError, OSError):
        file.create_dataset(name, data=values, **keys)


def _dataset(rng: Random, file: Any) -> Any:
    """Choose a dataset that can be read."""
    nodes = [file.get(name) for name in file]
    datasets = [node for node in nodes if isinstance(node, h5py.Dataset)]
    return rng.choice([one for one in datasets if (one.size or 0) <= MAX_VALUES])


def _numbers(rng: Random, file: Any) -> None:
    """Change one number, some, or all; by a value, by a factor, or by a byte."""
    dataset = _dataset(rng, file)
    values = np.asarray(dataset[()])
    if not values.size or values.dtype.kind not in "fiu":
        return
    kind = rng.randrange(4)
    with np.errstate(all="ignore"):
        if kind < 2:
            flat = values.reshape(-1)
            for _ in range(rng.choice((1, 1, 3, flat.size))):
                place = rng.randrange(flat.size)
                flat[place] = np.float64(rng.choice(VALUES)).astype(flat.dtype)
        elif kind == 2:
            factor = 10.0 ** rng.uniform(-320, 300)
            values = (values * factor).astype(values.dtype)
        else:
            values = _with_other_bytes(rng, values)
    put(file, dataset.name, values)


def _with_other_bytes(rng: Random, values: np.ndarray) -> np.ndarray:
    """Return values of which some bytes are others."""
    data = bytearray(values.tobytes())
    for _ in range(rng.choice((1, 2, 8))):
        place = rng.randrange(len(data))
        data[place] = rng.randrange(256)
    return np.frombuffer(bytes(data), values.dtype).reshape(values.shape)


def _texts(rng: Random, file: Any) -> None:
    """Change some texts, or how they are stored."""
    dataset = _dataset(rng, file)
    if dataset.dtype.kind not in "OS" or dataset.ndim != 1 or not len(dataset):
        return
    texts = [bytes(text) for text in dataset[()]]
    for _ in range(rng.choice((1, 2, len(texts)))):
        first = texts[0].decode("utf-8", "ignore")
        name = rng.choice((*NAMES, first))
        place = rng.randrange(len(texts))
        texts[place] = name.encode("utf-8", "surrogatepass")
    if rng.random() < 0.5:
        put(file, dataset.name, np.array(texts, "S"))
    else:
        whole = [text.replace(b"\0", b"") for text in texts]
        put(file, dataset.name, whole, dtype=h5py.string_dtype())


def _type(rng: Random, file: Any) -> None:
    """Give a dataset another type, at times with zeros in it."""
    dataset = _dataset(rng, file)
    kind = rng.choice(TYPES)
    with np.errstate(all="ignore"), suppress(TypeError, ValueError):
        if rng.random() < 0.3:
            values = np.zeros(dataset.shape, kind)
        else:
            values = np.asarray(dataset[()]).astype(kind)
        put(file, dataset.name, values)


def _shape(rng: Random, file: Any) -> None:
    """Change the shape of a dataset, or make it a large one that nobody wrote."""
    dataset = _dataset(rng, file)
    name = dataset.name
    rank = dataset.ndim
    if rank and dataset.dtype.kind not in "OS" and rng.random() < 0.4:
        shape = (10 ** rng.randrange(5, 12), *dataset.shape[1:])
        del file[name]
        file.create_dataset(name, shape, "f8", chunks=(1,) * rank)
        return
    values = np.asarray(dataset[()])
    shapes: list[Any] = [values[None], values.ravel(), values.T, h5py.Empty("f8")]
    if values.ndim:
        twice = np.concatenate([values, values])
        shapes += [values[..., :-1], values[1:], values[:0], twice]
    text = {"dtype": h5py.string_dtype()} if dataset.dtype.kind == "O" else {}
    put(file, name, rng.choice(shapes), **text)


def _further(rng: Random, file: Any) -> None:
    names = (
        "further",
        b"\xff\xfe",
        "deep/er",
        "outliers",
        "bounding_box",
        "camera_matrix",
        "a\nb",
    )
    values = (
        np.zeros(8),
        np.zeros((3, 3)),
        "text",
        [b"\xff"],
        np.zeros(0),
        h5py.Empty("f4"),
        np.zeros((8, 15), "?"),
    )
    file[rng.choice(names)] = rng.choice(values)


def _replace(rng: Random, file: Any) -> None:
    """Delete a dataset, at times for a link or a group."""
    name = _dataset(rng, file).name
    del file[name]
    links = (h5py.SoftLink("/nowhere"), h5py.SoftLink(name), h5py.SoftLink("/"))
    elsewhere = (
        h5py.ExternalLink("shapes.h5", "/shapes"),
        h5py.ExternalLink("nowhere.h5", "/"),
    )
    match rng.randrange(3):
        case 0:
            file[name] = rng.choice((*links, *elsewhere))
        case 1:
            file.create_group(name)


def _attribute(rng: Random, file: Any) -> None:
    usual = (
        "y_axis",
        "unit",
        "frame_rate",
        "solve_seconds",
        "config",
        "kind",
        "method",
    )
    name = rng.choice([*file.attrs, *usual])
    values = (
        np.nan,
        np.inf,
        -1,
        2,
        "text",
        "",
        "\x1b[2J",
        b"\xff",
        [1, 2],
        np.zeros((2, 2)),
        10**18,
        h5py.Empty("f8"),
        True,
    )
    if name in file.attrs:
        del file.attrs[name]
    if rng.random() < 0.8:
        file.attrs[name] = rng.choice(values)


HDF5_CHANGES: tuple[Callable[[Random, Any], object], ...] = (
    _numbers,
    _numbers,
    _numbers,
    _texts,
    _texts,
    _type,
    _shape,
    _shape,
    _further,
    _replace,
    _replace,
    _attribute,
)
