"""Records with other columns, by the names that these have in files, and points in
rows.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.records import Record
from shapefit.records.columns import column_by_name


def put(
    record: Record, columns: Mapping[str, Any], whole: Mapping[str, Any] | None = None
) -> Record:
    """Return a record with columns of items, and with datasets of the whole file, in
    place of those of the same names.
    """
    fields = fields_from(type(record), columns)
    extras = fields.pop("extras")
    of_file = fields_from(type(record), whole or {})
    file_extras = of_file.pop("extras")
    changed = dataclasses.replace(record, **fields, **of_file)
    return changed.with_extras(extras).with_file_extras(file_extras)


def fields_from(cls: type, columns: Mapping[str, object]) -> dict[str, Any]:
    """Return the keyword arguments of a record from its columns by name in files.

    Columns that the class does not list become `extras`; those that are None are left
    out.
    """
    listed = column_by_name(cls)
    fields: dict[str, Any] = {}
    extras: dict[str, object] = {}
    for name, value in columns.items():
        if value is None:
            continue
        if name in listed:
            fields[listed[name].field] = value
        else:
            extras[name] = value
    fields["extras"] = extras
    return fields


def in_rows(points: Floats) -> Floats:
    """Return points (n, d, p) as records hold them, (n, p, d), one landmark a row."""
    return np.ascontiguousarray(points.swapaxes(1, 2))
