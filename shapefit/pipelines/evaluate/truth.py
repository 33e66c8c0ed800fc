"""The truth as a source: of each result file only the true shapes that its images name are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

import numpy as np

from shapefit.errors import counted
from shapefit.io import ShapeSource, open_shapes
from shapefit.io.columns import Texts
from shapefit.io.name_index import NameIndex
from shapefit.io.records import ShapeSet
from shapefit.pipelines.evaluate.plan import ReadingOptions

AT_A_TIME = 1 << 14
"""Shapes that are read at a time to count what they lack."""


class Truth:
    """The true shapes of an evaluation, found by their items."""

    def __init__(self, source: ShapeSource, folder: Path | None) -> None:
        self._source = source
        self._folder = folder

    @property
    def head(self) -> ShapeSet:
        """All of the truth but its shapes."""
        return self._source.head

    @property
    def count(self) -> int:
        """Number of shapes."""
        return self._source.count

    def named(self, items: Sequence[str]) -> ShapeSet:
        """Return the shapes that are called so, each once, in the order of the truth.

        Where none is, the first shape of all, so that an error can say what they are called.
        """
        names, index = self._index
        rows = np.unique(index.find(items, names))
        rows = rows[rows >= 0]
        return self._source.take(rows if len(rows) else np.arange(min(1, self.count)))

    def count_gaps(self) -> list[str]:
        """Say how many landmarks of the truth are unknown."""
        shapes, landmarks = 0, 0
        for part in self._source.file_chunks(AT_A_TIME):
            gaps = np.asarray(np.isnan(part.shapes).any(axis=1))
            shapes += int(gaps.any(axis=1).sum())
            landmarks += int(gaps.sum())
        if not shapes:
            return []
        lacks = f"{counted(landmarks, 'landmark')} of {counted(shapes, 'shape')}"
        return [f"the truth lacks {lacks} (NaN): left out"]

    @cached_property
    def _index(self) -> tuple[Texts, NameIndex]:
        names, index = Texts(self._folder), NameIndex(self._folder)
        for block in self._source.names():
            names.append(block)
            index.add(block)
        return names, index


@contextmanager
def open_truth(options: ReadingOptions, folder: Path | None) -> Iterator[Truth]:
    """Open the truth. Raises InputError as `open_shapes` does."""
    with open_shapes(options.truth, options.how, gaps=True) as source:
        yield Truth(source, folder)
