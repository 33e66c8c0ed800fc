"""Parquet files with wrong columns, types, lengths, values, metadata and bytes."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet

from .hdf5_cases import NUMBERS, spoil_bytes
from .texts import NAMES

Change = Callable[[Random, Any], Any]

TYPES = (pa.float32(), pa.int8(), pa.int64(), pa.uint64(), pa.bool_(), pa.string(), pa.binary())
"""That the values of a column, or of its lists, are cast to."""

STRANGE = (
    *(
        pa.array([None] * 8),
        pa.array([{"a": 1}] * 8),
        pa.array([[[1.0]]] * 8),
        pa.array([b"x"] * 8),
    ),
    *(pa.array([0] * 8, pa.timestamp("s")), pa.array(["a"] * 8).dictionary_encode()),
    pa.array([[1.0], None, [], [2.0, 3.0]] * 2),
)
"""Columns that no layout has."""


def _column(rng: Random, table: Any) -> int:
    return rng.randrange(table.num_columns)


def _put(table: Any, number: int, values: Any) -> Any:
    return table.set_column(number, table.column_names[number], values)


def _delete(rng: Random, table: Any) -> Any:
    return table.remove_column(_column(rng, table))


def _values(rng: Random, table: Any) -> Any:
    number = _column(rng, table)
    rows = table.column(number).to_pylist()
    row = rng.randrange(len(rows))
    new = rng.choice((*NUMBERS, *NAMES, None))
    if isinstance(rows[row], list) and rows[row] and rng.random() < 0.8:
        rows[row][rng.randrange(len(rows[row]))] = new
    else:
        rows[row] = new
    return _put(table, number, pa.array(rows))


def _lengths(rng: Random, table: Any) -> Any:
    number = _column(rng, table)
    rows = table.column(number).to_pylist()
    row = rng.randrange(len(rows))
    if isinstance(rows[row], list):
        rows[row] = rng.choice((rows[row][:-1], rows[row] * 2, [], None))
    return _put(table, number, pa.array(rows))


def _type(rng: Random, table: Any) -> Any:
    number = _column(rng, table)
    values = table.column(number).combine_chunks()
    kind = rng.choice(TYPES)
    lists = pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type)
    return _put(table, number, values.cast(pa.list_(kind) if lists else kind, safe=False))


def _strange(rng: Random, table: Any) -> Any:
    values = rng.choice(STRANGE)
    if rng.random() < 0.5:
        return _put(table, _column(rng, table), values)
    return table.append_column(rng.choice((*table.column_names, "further", "", "a\nb")), values)


def _rows(rng: Random, table: Any) -> Any:
    return rng.choice((table.slice(0, 0), table.slice(0, 1), pa.concat_tables([table, table])))


def _metadata(rng: Random, table: Any) -> Any:
    said = dict(table.schema.metadata or {})
    key = rng.choice([*said, b"landmark_names", b"format", b"further"])
    new = (b"", b"{", b"[]", b"null", b"\xff", b"1e999", b'["a", "a"]', json.dumps(NAMES).encode())
    said[key] = rng.choice(new)
    if rng.random() < 0.3:
        del said[key]
    return table.replace_schema_metadata(said)


CHANGES: tuple[Change, ...] = (
    *(_delete, _values, _values, _values, _lengths, _lengths, _type),
    *(_strange, _rows, _metadata, _metadata),
)


def spoil(rng: Random, path: Path) -> None:
    """Spoil a Parquet file."""
    table = parquet.read_table(path)
    for _ in range(rng.choice((1, 1, 2, 3))):
        with (
            suppress(pa.ArrowException, ValueError, TypeError, OverflowError),
            np.errstate(all="ignore"),
        ):
            table = rng.choice(CHANGES)(rng, table)
    parquet.write_table(table, path, row_group_size=rng.choice((1, 3, 64)))
    if rng.random() < 0.3:
        spoil_bytes(rng, path)


def make(rng: Random, folder: Path) -> tuple[str, ...]:
    """Spoil one of the Parquet files, and read it."""
    name = rng.choice(("views.parquet", "shapes.parquet", "result.parquet"))
    spoil(rng, folder / name)
    out = rng.choice(("out.h5", "out.csv", "out.parquet"))
    others = {
        "views.parquet": (
            ("fit", name, "-d", "dict.h5", "-o", out, "--set=threads=1"),
            ("fit", name, "-d", "dict.h5", "-o", "out/", "--set=threads=1"),
        ),
        "shapes.parquet": (
            ("learn-dict", name, "-o", "out.h5", "--set", "k=3", "--set", "iterations=2"),
            ("eval", "result.h5", "--truth", name, "-o", "out", "--set", "plots=false"),
        ),
        "result.parquet": (
            ("verify", name, "-d", "dict.h5"),
            ("eval", name, "--truth", "shapes.h5", "-o", "out", "--set", "plots=false"),
            ("view", name, "-o", "out.html"),
        ),
    }[name]
    return rng.choice((*others, ("convert", name, "-o", out), ("info", name)))
