"""Whether the columns of a file can be the datasets of a layout, and the shapes of their rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import prod
from typing import Any

from shapefit.io.layout import AXES, Dataset, Format
from shapefit.io.parquet.columns import column_type
from shapefit.io.parquet.schema import columns_of

KINDS = {"number": "biuf", "index": "iu", "text": "O", "label": "Oiu"}
"""Types of NumPy that the kinds of datasets can have."""

Shape = tuple[int, ...]


def find_row_shapes(
    form: Format,
    fields: Mapping[str, Any],
    sizes: dict[str, int],
    length: Callable[[str], int | None],
) -> tuple[dict[str, Shape], list[str]]:
    """Return the shape of a row of each dataset per item that is there, and what is wrong.

    fields  of the schema, by the names of the columns
    sizes   of the axes that are known, such as p; those that are found are added
    length  returns how many values the first row of a column has; None without rows
    """
    shapes: dict[str, Shape] = {}
    problems: list[str] = []
    for dataset in form.growing:
        columns = columns_of(dataset, form)
        if not (dataset.required or fields.keys() & columns):
            continue
        for name in columns:
            if name not in fields:
                problems.append(f"column {name}: there is no such column; {_wanted(dataset, form)}")
                continue
            kind = column_type(fields[name])
            is_list = len(dataset.axes) > 1 or bool(dataset.counted_by)
            if not fits_kind(kind.kind, dataset) or bool(kind.sizes) != is_list:
                found = f"holds values of type {fields[name].type}"
                problems.append(f"column {name}: {found}; {_wanted(dataset, form)}")
                continue
            axes = dataset.axes[1:] if len(columns) == 1 else dataset.axes[1:-1]
            row = None
            if not dataset.counted_by:
                sized = [size for size in kind.sizes if size is not None]
                row = prod(sized) if len(sized) == len(kind.sizes) else length(name)
            shape = _shape(axes, sizes, row)
            if row is not None and prod(shape) != row:
                found = f"holds lists of {row} values, not of {prod(shape)}"
                problems.append(f"column {name}: {found}; {_wanted(dataset, form)}")
            shapes[dataset.name] = shape if len(columns) == 1 else (*shape, len(columns))
    return shapes, problems


def fits_kind(kind: str, dataset: Dataset) -> bool:
    """Whether values of a type of NumPy can be a dataset."""
    return bool(kind) and kind in KINDS[dataset.kind]


def _shape(axes: tuple[str | int, ...], sizes: dict[str, int], row: int | None) -> Shape:
    """Return the sizes of axes; one not known yet is what a row of so many values leaves."""
    known = [axis if isinstance(axis, int) else sizes.get(axis) for axis in axes]
    if None in known:
        rest = prod(size for size in known if size is not None)
        sizes[str(axes[known.index(None)])] = (row or 0) // max(rest, 1)
    return tuple(axis if isinstance(axis, int) else sizes[axis] for axis in axes)


def _wanted(dataset: Dataset, form: Format) -> str:
    """Say how to store a dataset in a column."""
    if dataset == form.points:
        return "store lists of numbers, one for each landmark"
    kinds = {"number": "numbers", "index": "integers"}
    kind = kinds.get(dataset.kind, "UTF-8 text")
    if len(dataset.axes) == 1 and not dataset.counted_by:
        return f"store {kind}"
    axes = [AXES.get(str(axis), str(axis)) for axis in dataset.axes[1:]]
    return f"store lists of {kind}" + (f" ({' x '.join(axes)})" if axes else "")
