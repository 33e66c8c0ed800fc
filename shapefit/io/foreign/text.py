"""Lines and numbers of text files of motion, some thousand lines at a time, and their labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.csv.text import read_numbers

BLOCK_LINES = 4096


def read_blocks(path: Path, skip: int = 0) -> Iterator[tuple[int, list[str]]]:
    r"""Yield the number of the first line, from 1, and lines without their ends, block by block.

    The first `skip` lines are left out. Bytes that are not UTF-8 become \xe9.
    """
    with path.open(encoding="utf-8-sig", errors="backslashreplace") as file:
        line = 1 + sum(1 for _ in islice(file, skip))
        while block := [text.rstrip("\n") for text in islice(file, BLOCK_LINES)]:
            yield line, block
            line += len(block)


def read_head(path: Path, count: int) -> list[str]:
    """Return the first lines of a file, `count` at most."""
    with path.open(encoding="utf-8-sig", errors="backslashreplace") as file:
        return [text.rstrip("\n") for text in islice(file, count)]


def read_plain(lines: Sequence[str], separator: str, width: int) -> NDArray[np.float64] | None:
    """Return lines of so many plain numbers as an array (n, width), NaN where a cell is empty.

    None where one is not so plain: `read_table` takes them cell by cell, several times as slow.
    """
    if any(line.count(separator) != width - 1 for line in lines):
        return None
    text = ",".join(lines)
    if separator != ",":
        text = text.replace(separator, ",")
    if ",," in text or text.endswith(",") or text.startswith(","):
        text = f",{text},".replace(",,", ",null,").replace(",,", ",null,")[1:-1]
    try:
        values = orjson.loads(f"[{text}]")
    except orjson.JSONDecodeError:
        return None
    kinds = set(map(type, values))
    if len(values) != len(lines) * width or not kinds <= {float, int, type(None)}:
        return None
    plain = kinds <= {float, int}
    numbers = (
        np.fromiter(values, np.float64, len(values)) if plain else np.array(values, np.float64)
    )
    return numbers.reshape(len(lines), width)


def read_table(
    rows: Sequence[Sequence[str]], lines: Sequence[int], place: object, *, finite: bool = False
) -> NDArray[np.float64]:
    """Return rows of as many cells each as numbers, NaN where a cell is empty.

    Raises InputError that names the line of the first cell that is no number; where they are to
    be `finite`, nan and inf are none.
    """
    numbers = read_numbers([cell for row in rows for cell in row])
    wrong = numbers.strange | ~np.isfinite(numbers.values) if finite else numbers.strange
    if wrong.any():
        row, column = divmod(int(wrong.argmax()), len(rows[0]))
        cell = rows[row][column]
        raise input_error(f"{place}:{lines[row]}", f"{cell[:40]!r} is no number", "correct it")
    return numbers.values.reshape(len(rows), -1)


def split_lines(
    place: object,
    first: int,
    texts: Sequence[str],
    separator: str | None,
    width: int,
    of: tuple[str, str] = ("cells", "columns"),
) -> tuple[list[list[str]], list[int]]:
    """Return the cells of lines that are not empty, from the line `first` on, and their numbers.

    Raises InputError for lines that have not as many, in the words `of` what for what.
    """
    rows, lines = [], []
    for line, text in enumerate(texts, first):
        if not text.strip(" \t,"):
            continue
        rows.append(text.split(separator))
        lines.append(line)
        if len(rows[-1]) != width:
            found = f"has {len(rows[-1])} {of[0]} for {width} {of[1]}"
            raise input_error(f"{place}:{line}", found, "write as many")
    return rows, lines


def read_words(words: Sequence[str], count: int, place: str) -> tuple[float, ...]:
    """Return so many words as finite numbers. Raises InputError where they are none."""
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = ()
    if len(numbers) != count or not np.isfinite(numbers).all():
        found = f"expected {count} numbers, found {' '.join(words)[:40]!r}"
        raise input_error(place, found, "correct it")
    return numbers


def unique_names(labels: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return labels as names that occur once, and a note on those that had to change.

    A point without a label is `*7`, as C3D files call the eighth; what repeats gets a number.
    """
    names = [label.strip() or f"*{place}" for place, label in enumerate(labels)]
    taken, seen = set(names), Counter[str]()
    changed = []
    for place, name in enumerate(names):
        seen[name] += 1
        if seen[name] > 1:
            number = seen[name]
            while f"{name}_{number}" in taken:
                number += 1
            names[place] = f"{name}_{number}"
            taken.add(names[place])
            changed.append(names[place])
    if not changed:
        return tuple(names), ()
    note = f"{counted(len(changed), 'label')} repeated, and numbered ({abbreviate(changed)})"
    return tuple(names), (note,)
