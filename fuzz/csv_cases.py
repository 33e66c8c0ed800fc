"""CSV files with wrong cells, rows, headers, quotes, line ends and encodings."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

from .texts import NAMES, NUMBERS

Rows = list[list[str]]
Change = Callable[[Random, Rows], object]
Spoil = Callable[[Random, bytes], bytes]


def _cell(rng: Random, rows: Rows) -> None:
    row = rng.choice(rows[1:] or rows)
    row[rng.randrange(len(row))] = rng.choice(NUMBERS + NAMES)


def _column(rng: Random, rows: Rows) -> None:
    place = rng.randrange(len(rows[0]))
    for row in rows[1:]:
        if place < len(row):
            row[place] = rng.choice((row[place], rng.choice(NUMBERS), rng.choice(NAMES)))


def _scale(rng: Random, rows: Rows) -> None:
    factor = 10.0 ** rng.uniform(-330, 308)
    for row in rows[1:]:
        row[2:5] = [str(float(value or "nan") * factor) for value in row[2:5] if _is_number(value)]


def _is_number(text: str) -> bool:
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True


def _header(rng: Random, rows: Rows) -> None:
    names = ("item", "landmark", "x", "y", "z", "confidence", "sequence", *NAMES)
    rows[0][rng.randrange(len(rows[0]))] = rng.choice(names)


def _drop_column(rng: Random, rows: Rows) -> None:
    place = rng.randrange(len(rows[0]))
    rows[:] = [row[:place] + row[place + 1 :] for row in rows]


def _add_column(rng: Random, rows: Rows) -> None:
    name = rng.choice(("confidence", "sequence", "z", "weight"))
    values = (rng.choice(NUMBERS + NAMES), str(rng.random()), "95")
    for number, row in enumerate(rows):
        row.append(name if number == 0 else rng.choice(values))


def _rows(rng: Random, rows: Rows) -> None:
    start = rng.randrange(1, len(rows) + 1)
    rows[start : start + rng.randrange(40)] = rng.choice(([], rows[1:3], [[]], [[""] * 9]))


def _shuffle(rng: Random, rows: Rows) -> None:
    body = rows[1:]
    rng.shuffle(body)
    rows[1:] = body


def _widths(rng: Random, rows: Rows) -> None:
    row = rng.choice(rows)
    row[:] = row[: rng.randrange(len(row) + 1)] + [""] * rng.randrange(4)


CHANGES: tuple[Change, ...] = (
    *(_cell, _column, _scale, _header, _drop_column, _add_column, _rows, _shuffle, _widths),
)

SPOILS: tuple[Spoil, ...] = (
    lambda rng, data: data[: rng.randrange(len(data) + 1)],
    lambda rng, data: data.replace(b"\n", rng.choice((b"\r\n", b"\r", b"\n\n", b"\n\r\n", b""))),
    lambda rng, data: data.replace(
        b",", rng.choice((b";", b"\t", b", ", b",,")), rng.randrange(99)
    ),
    lambda rng, data: b"\xef\xbb\xbf" + data,
    lambda rng, data: data.decode().encode(rng.choice(("utf-16", "utf-32", "utf-7"))),
    lambda rng, data: _insert(rng, data, rng.choice((b'"', b"'", b"\0", b"\xff", b"\\", b"\r"))),
    lambda rng, data: _insert(rng, data, rng.randbytes(rng.randrange(1, 9))),
    lambda rng, data: _insert(rng, data, b"x" * 200_000),
    lambda rng, data: rng.choice(
        (b"", b"\n", b"item", b"\x89HDF\r\n\x1a\n", b"PK\3\4", b"\0" * 999)
    ),
)


def spoiled_csv(rng: Random, path: Path) -> None:
    """Spoil a CSV file."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    for _ in range(rng.choice((0, 1, 1, 2, 3))):
        if rows[0]:  # a header without any column cannot be spoiled further
            rng.choice(CHANGES)(rng, rows)
    text = "\n".join(",".join(row) for row in rows) + "\n"
    data = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.4:
        with suppress(UnicodeError):
            data = rng.choice(SPOILS)(rng, data)
    path.write_bytes(data)


def _insert(rng: Random, data: bytes, piece: bytes) -> bytes:
    place = rng.randrange(len(data) + 1)
    return data[:place] + piece + data[place:]


def make(rng: Random, folder: Path) -> tuple[str, ...]:
    """Spoil one of the CSV files, and read it."""
    name = rng.choice(("shapes.csv", "views.csv", "result.csv"))
    spoiled_csv(rng, folder / name)
    out = rng.choice(("out.h5", "out.csv"))
    if name == "views.csv":
        return ("fit", name, "-d", "dict.h5", "-o", out, "--set=threads=1", "--set", loss(rng))
    if rng.random() < 0.15:
        return ("view", name, "-o", "out.html")
    if name == "result.csv":
        return ("eval", name, "--truth", "shapes.h5", "-o", "out", "--set", "plots=false")
    return rng.choice(
        (
            ("learn-dict", name, "-o", "out.h5", "--set", "k=3", "--set", "iterations=2"),
            ("project", name, "-o", out, "--set", f"noise={rng.choice((0, 0.1))}"),
            ("eval", "result.h5", "--truth", name, "-o", "out", "--set", "plots=false"),
        )
    )


def loss(rng: Random) -> str:
    """Choose a loss, or another method."""
    losses = ("loss=squared", "loss=exact", "outliers.method=l1", "outliers.method=sparse-error")
    methods = ("convex+refine", "alternate", "mean-shape")
    return rng.choice([*losses] + [f"method={name}" for name in methods])
