"""Rows of CSV, of texts and numbers, which the core writes."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from shapefit import core
from shapefit.arrays import Floats, Indices
from shapefit.io.csv_cells import WORD_BYTES

NUMBER_CHARACTERS = 26
"""Bytes of a number with the comma behind it, at most."""

QUOTED = re.compile(r'[,"\r\n]')
"""What a cell has in quotes alone."""


def format_rows(
    texts: Sequence[bytes],
    text_of_cell: Indices,
    numbers: Floats,
    leading: int,
    *,
    as_python: bool = False,
) -> memoryview:
    """Format n rows of CSV: `leading` cells of text, the numbers (n, d), other texts.

    text_of_cell (n, c) are indices into `texts`, which are cells as they are written.
    Numbers have the fewest digits that read back to the same float, as JSON or as
    Python writes them. nan is an empty cell.
    """
    lengths = np.array([*map(len, texts)], np.int64)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    letters = b"".join(texts)
    whole_words = len(letters) // WORD_BYTES * WORD_BYTES + WORD_BYTES
    text_bytes = int(lengths[text_of_cell].sum()) + text_of_cell.size
    capacity = text_bytes + NUMBER_CHARACTERS * numbers.size
    rows = np.empty(capacity // WORD_BYTES + 1, np.uint64)
    size = core.write_csv_rows(
        letters=np.frombuffer(letters.ljust(whole_words), np.uint64),
        starts=starts,
        texts=text_of_cell,
        numbers=numbers,
        leading=leading,
        as_python=as_python,
        rows=rows,
    )
    return rows.view(np.uint8)[:size].data


def csv_cell(text: str) -> bytes:
    """Encode a text as a CSV cell in UTF-8, in quotes where it needs them."""
    if not text or QUOTED.search(text):
        text = '"{}"'.format(text.replace('"', '""'))
    return text.encode()
