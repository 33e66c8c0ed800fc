"""The file below an HDF5 file that is written."""

from __future__ import annotations

import os
from collections.abc import Callable
from io import FileIO

from shapefit.errors import InputError
from shapefit.io.whole.atomic import write_all

PAGE = 1 << 16


class Spool:
    """A binary file that never fails before the eyes of HDF5, and holds all that was written.

    HDF5 crashes on a file that is shorter than it believes, and when it cannot close one. So the
    first error is kept in `error`, for the writer to raise, and from then on whatever is written
    stays in memory, page by page, and is read from there. The writer looks at `error` after every
    dataset, so that this is little.
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self._pages: dict[int, bytearray] = {}
        self._position = 0
        self._size = 0
        self.error: OSError | InputError | None = None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place in the file; returns it."""
        if self.error is None:
            return self._file.seek(offset, whence)
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Return the place in the file."""
        return self._file.tell() if self.error is None else self._position

    def read(self, size: int) -> bytes:
        """Return `size` bytes, or as many as there are; h5py knows a file by this."""
        buffer = bytearray(size)
        return bytes(buffer[: self.readinto(memoryview(buffer))])

    def readinto(self, buffer: memoryview) -> int:
        """Fill the buffer, or as much of it as there is in the file."""
        if self.error is None:
            return self._file.readinto(buffer) or 0
        target = memoryview(buffer).cast("B")[: max(self._size - self._position, 0)]
        done = 0
        while done < len(target):
            page, offset = divmod(self._position + done, PAGE)
            part = memoryview(self._page(page))[offset : offset + len(target) - done]
            target[done : done + len(part)] = part
            done += len(part)
        self._position += done
        return done

    def write(self, data: memoryview) -> int:
        """Write all of `data`, to memory after an error."""
        place = self.tell()
        if not self._attempt(lambda: write_all(self._file, data)):
            self._keep(place, memoryview(data).cast("B"))
        return len(data)

    def truncate(self, size: int) -> int:
        """Cut or extend the file to `size` bytes."""
        if not self._attempt(lambda: self._file.truncate(size)):
            self._size = size
        return size

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def _attempt(self, action: Callable[[], object]) -> bool:
        """Do something to the file unless it failed before; return whether that went well."""
        if self.error is None:
            try:
                action()
            except (OSError, InputError) as error:
                self.error = error
                self._size = os.fstat(self._file.fileno()).st_size
        return self.error is None

    def _keep(self, place: int, data: memoryview) -> None:
        done = 0
        while done < len(data):
            page, offset = divmod(place + done, PAGE)
            part = data[done : done + PAGE - offset]
            self._page(page)[offset : offset + len(part)] = part
            done += len(part)
        self._position = place + done
        self._size = max(self._size, self._position)

    def _page(self, number: int) -> bytearray:
        """Return a page to read and write: as in the file, zero beyond its end."""
        if number not in self._pages:
            stored = os.pread(self._file.fileno(), PAGE, number * PAGE)
            self._pages[number] = bytearray(stored.ljust(PAGE, b"\0"))
        return self._pages[number]
