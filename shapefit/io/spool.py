"""The file below an HDF5 file that is written."""

from __future__ import annotations

from collections.abc import Callable
from io import FileIO

from shapefit.io.atomic import write_all


class Spool:
    """A binary file that never fails before the eyes of HDF5.

    HDF5 cannot close a file that it could not write, and crashes when the process ends. So the
    first error is kept in `error`, for the writer to raise, and what comes after it is dropped.
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.error: OSError | None = None
        self.seek = file.seek
        self.tell = file.tell
        self.read = file.read
        self.readinto = file.readinto

    def write(self, data: memoryview) -> int:
        """Write all of `data`, or drop it after an error."""
        self._attempt(lambda: write_all(self._file, data))
        return len(data)

    def truncate(self, size: int) -> int:
        """Cut or extend the file to `size` bytes."""
        self._attempt(lambda: self._file.truncate(size))
        return size

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def _attempt(self, action: Callable[[], object]) -> None:
        if self.error is None:
            try:
                action()
            except OSError as error:
                self.error = error
