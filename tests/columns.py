"""Records with other columns, by the names that these have in files, and points in
rows.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.records import Record
from shapefit.records.columns import fields_from


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


def in_rows(points: Floats) -> Floats:
    """Return points (n, d, p) as records hold them, (n, p, d), one landmark a row."""
    return np.ascontiguousarray(points.swapaxes(1, 2))
