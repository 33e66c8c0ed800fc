"""The rows of a section of CSV: split at commas where it has no quotes, else read with care."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from io import StringIO

import numpy as np

from shapefit.errors import InputError, input_error
from shapefit.io.csv.sections import Section

COMMA, LINE_END = b",\n"

QUOTES = "put cells with commas or quotes in double quotes, and double the quotes in them"


def split_columns(section: Section, width: int) -> list[list[str]] | None:
    """Return the columns of a section in which every line has `width` cells, none of them quoted.

    None where it is not so plain; `read_rows` takes every section, and finds the same cells.
    """
    data, text = section.data, section.text
    if b"\r" in data:
        data, text = data.replace(b"\r\n", b"\n"), text.replace("\r\n", "\n")
    if b'"' in data or b"\r" in data or len(data) > csv.field_size_limit():
        return None
    letters = np.frombuffer(data.removesuffix(b"\n") + b"\n", np.uint8)
    ends, commas = np.flatnonzero(letters == LINE_END), np.flatnonzero(letters == COMMA)
    if len(commas) != len(ends) * (width - 1):
        return None
    between = commas.reshape(len(ends), width - 1)
    if (between[:, -1] > ends).any() or (between[1:, 0] < ends[:-1]).any():
        return None
    cells = text.removesuffix("\n").replace("\n", ",").split(",")
    columns = [cells[column::width] for column in range(width)]
    return None if "" in columns[0] else columns  # there may be an empty row


def read_rows(section: Section, name: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each row that is not empty.

    A quote that is never closed swallows the rest of the section as one cell. Raises InputError
    after the last row that can be read, naming the line of the next one.
    """
    quoted = '"' in section.text
    reader = csv.reader(StringIO(section.text, newline="\n"), strict=True)
    line = section.line
    try:
        for row in reader:
            if any(row):
                if quoted:
                    _check_quotes(row, section.text, f"{name}:{line}")
                yield line, row
            line = section.line + reader.line_num
    except csv.Error as error:
        if "unexpected end" not in str(error):
            raise bad_line(f"{name}:{line}", error) from error
        yield line, _last_row(section, line)
        raise input_error(f"{name}:{line}", "a quote is never closed", QUOTES) from error


def bad_line(place: str, error: csv.Error) -> InputError:
    """Say what the csv module found at a place."""
    if "new-line" in str(error):
        found, fix = "a line ends in CR alone, others in LF", "end all lines in the same way"
    else:
        found, fix = f"a bad cell ({error})", "check the quotes around it"
    return input_error(place, found, fix)


def _last_row(section: Section, line: int) -> list[str]:
    lines = list(StringIO(section.text, newline="\n"))
    return next(csv.reader(lines[line - section.line :]))


def _check_quotes(row: list[str], text: str, place: str) -> None:
    """Refuse an odd number of quotes in a cell that has none around it."""
    for cell in row:
        if cell.count('"') % 2 and '"{}"'.format(cell.replace('"', '""')) not in text:
            raise input_error(place, "cannot be read as CSV (a quote inside a cell)", QUOTES)
