"""What every writer of records is: it takes records one after another, and says what it wrote."""

from __future__ import annotations

from typing import Generic, TypeVar

from shapefit.io.options import Summary

Record = TypeVar("Record")


class RecordWriter(Generic[Record]):
    """Takes records one after another; `attributes` are stored with the file on a clean exit.

    After that `summary` says what was written. `begun` is whether a record was appended.
    """

    def __init__(self) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self.begun = False

    def append(self, record: Record) -> None:
        """Write the items of a record after those that are there."""
        raise NotImplementedError

    def check_begun(self) -> None:
        """Raise ValueError where nothing was appended."""
        if not self.begun:
            raise ValueError("nothing was appended; append one record, which may be empty")
