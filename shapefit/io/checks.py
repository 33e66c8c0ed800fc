"""What is wrong with values: the first ten problems are told, and the number of the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.normalisation import LARGEST
from shapefit.io.layout import LANDMARKS, SHAPES, Layout, fit_axes

if TYPE_CHECKING:
    from shapefit.io.hdf5_records import Hdf5Reader


LIMIT = 10


def input_problems(told: Sequence[str], count: int | None = None) -> InputError:
    """Build the InputError for these problems, of `count` in all; at most ten are listed."""
    shown = list(told[:LIMIT])
    more = (len(told) if count is None else count) - len(shown)
    return InputError([*shown, f"... and {more} more"] if more > 0 else shown)


def raise_at(rows: NDArray[Any] | Sequence[int], word: Callable[[int], str]) -> None:
    """Raise InputError with a line for each of these rows, if there are any."""
    if len(rows):
        raise input_problems([word(int(row)) for row in rows[:LIMIT]], len(rows))


AT_ZERO = 0.01
"""Share of landmarks at exactly (0, 0) from which on there is a warning."""


class Axis(NamedTuple):
    """What an axis runs over, in messages: `item` and the names of all, numbers without names."""

    kind: str
    names: Sequence[str] | None = None

    def word(self, number: int) -> str:
        """Name one entry."""
        return f"{self.kind} {number}" if not self.names else f"{self.kind} '{self.names[number]}'"


def check_magnitudes(
    place: str, points: NDArray[np.float64] | None, rows: Axis, columns: Axis
) -> None:
    """Raise InputError for points (n, 3, q) whose squares would overflow; nan is no such point."""
    if points is None:
        return
    wrong = np.argwhere((np.abs(points) > LARGEST).any(axis=1))

    def word(number: int) -> str:
        row, column = wrong[number].tolist()
        values = ", ".join(f"{value:g}" for value in points[row, :, column].tolist())
        found = f"{rows.word(row)}, {columns.word(column)} is ({values})"
        return f"{place}: {found}; correct it, or use a larger unit: the limit is {LARGEST:g}"

    raise_at(range(len(wrong)), word)


def warn_of_zeros(points: NDArray[np.float64]) -> tuple[str, ...]:
    """Warn of many landmarks (..., 2) at exactly (0, 0), where detectors put what they miss."""
    there = (points == 0).all(axis=-1)
    if there.sum() <= AT_ZERO * there.size:
        return ()
    found = f"{int(there.sum())} of {counted(there.size, 'landmark')} are at exactly (0, 0)"
    return (f"{found}: if these were not found, leave them empty, or NaN",)


Blocks = Iterable[NDArray[np.float64]]
Bad = Callable[[NDArray[np.float64]], NDArray[np.bool_]]


class InMemory:
    """Datasets in memory, with what the checks ask an open file for."""

    def __init__(self, name: str, record: Any, form: Layout) -> None:
        self._name = name
        self._values: Mapping[str, Any] = {
            dataset.name: getattr(record, dataset.attribute) for dataset in form.datasets
        }
        self._sizes: dict[str, int] = {}
        for dataset in form.datasets:
            if (value := self._values[dataset.name]) is not None:
                shape = (len(value),) if dataset.kind == "text" else value.shape
                fit_axes(dataset.memory_axes, shape, self._sizes)
        self.landmark_names: tuple[str, ...] = record.landmark_names

    def has(self, name: str) -> bool:
        """Whether there is such a dataset."""
        return self._values[name] is not None

    def size(self, axis: str) -> int | None:
        """Length of an axis of the format; None if nothing has it."""
        return self._sizes.get(axis)

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""
        whole = self._name if name == self._name else f"{self._name}.{name}"
        return whole + ("" if row is None else f"[{row}]")

    def read(self, name: str) -> Any:
        """Return a dataset; None if there is none."""
        return self._values[name]

    def read_blocks(self, name: str, part: slice | None = None) -> Iterator[Any]:
        """Read a dataset, or the rows of a part of it."""
        yield self._values[name][part or slice(None)]


Datasets: TypeAlias = "Hdf5Reader | InMemory"
"""What is checked."""


def check_values(
    reader: Datasets,
    form: Layout,
    *,
    gaps: bool = False,
    part: slice | None = None,
    items: Sequence[str] | None = None,
) -> None:
    """Raise InputError for items without a name, and values that cannot be computed with.

    With `gaps` a landmark of a shape may be unknown. Only the rows of `part` are looked at; `items`
    are the names of these, None where `named` looks at them when they are read. What results hold
    is checked where it is read.
    """
    check_named(reader, [] if items is None else [items])
    if form is LANDMARKS:
        fix = "write NaN where the landmark is unseen"
        _check(reader, "landmarks", reader.read_blocks("landmarks", part), np.isinf, fix)
        if reader.has("confidence"):
            weights = (block[:, None] for block in reader.read_blocks("confidence", part))
            fix = "write 0 (hidden) or a positive number"
            _check(reader, "confidence", weights, lambda w: ~(np.isfinite(w) & (w >= 0)), fix)
    if form is SHAPES:
        check_finite(reader, "shapes", reader.read_blocks("shapes", part), gaps=gaps)
        if reader.has("mesh_vertices"):
            check_finite(reader, "mesh_vertices", reader.read_blocks("mesh_vertices", part))
        check_indices(reader, "edges", "p")
        check_indices(reader, "mesh_faces", "q")


def check_finite(reader: Datasets, name: str, blocks: Blocks, *, gaps: bool = False) -> None:
    """Raise InputError where a coordinate of the points (n, d, p) is no number to compute with.

    That is NaN, infinite, or so large that its square is. With `gaps` NaN is an unknown landmark.
    """
    fix = f"write a finite number, at most {LARGEST:g}, or leave the item out"
    if gaps:
        fix = f"write a number of at most {LARGEST:g}, or NaN where the landmark is unknown"

    def bad(values: NDArray[np.float64]) -> NDArray[np.bool_]:
        return ~(np.abs(values) <= LARGEST) & ~(gaps & np.isnan(values))

    _check(reader, name, blocks, bad, fix)


def check_positive(reader: Datasets, name: str) -> None:
    """Raise InputError where a number of the dataset (n,), if there is one, is not above 0."""
    values = reader.read(name)
    if values is None:
        return
    wrong = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    raise_at(
        wrong, lambda row: f"{reader.place(name, row)}: is {values[row]}; write a positive number"
    )


def check_indices(reader: Datasets, name: str, axis: str) -> None:
    """Raise InputError where an index of edges or faces is not one of the axis it points at."""
    indices, size = reader.read(name), reader.size(axis)
    if indices is None or size is None:
        return
    rows = np.flatnonzero(((indices < 0) | (indices >= size)).any(axis=1))
    if len(rows):
        found = f"holds the indices {tuple(indices[rows[0]].tolist())}"
        fix = f"indices run from 0 to {size - 1}"
        raise input_error(reader.place(name, int(rows[0])), found, fix)


def check_named(reader: Datasets, blocks: Iterable[Sequence[str]], dataset: str = "item") -> None:
    """Raise InputError where an item of the dataset has no name."""
    for _ in named(reader, blocks, dataset):
        pass


def named(
    reader: Datasets, blocks: Iterable[Sequence[str]], dataset: str = "item"
) -> Iterator[Sequence[str]]:
    """Pass on the blocks of names; at the end raise as `check_named`."""
    start = 0
    for block in blocks:
        rows = [start + row for row, item in enumerate(block) if not item]
        raise_at(rows, lambda row: f"{reader.place(dataset, row)}: is empty; name every item")
        start += len(block)
        yield block


def _check(reader: Datasets, name: str, blocks: Blocks, bad: Bad, fix: str) -> None:
    """Raise InputError for the points (n, d, p) of the first block of which some are bad."""
    start = 0
    for block in blocks:
        wrong = np.argwhere(bad(block).any(axis=1))

        def word(entry: int, start: int = start, block: Any = block, wrong: Any = wrong) -> str:
            row, point = wrong[entry].tolist()
            value = ", ".join(str(number) for number in block[row, :, point].tolist())
            found = f"{_point_name(reader, name, point)} is ({value})"
            return f"{reader.place(name, start + row)}: {found}; {fix}"

        raise_at(range(len(wrong)), word)
        start += len(block)


def _point_name(reader: Datasets, name: str, point: int) -> str:
    if name == "mesh_vertices":
        return f"vertex {point}"
    return f"landmark '{reader.landmark_names[point]}'"
