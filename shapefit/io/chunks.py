"""Compressed chunks of HDF5: which ones hold more than they declare, found before they
are inflated.

HDF5 inflates a chunk to its end, however long that is, and a chunk as a whole, however
few of its rows are asked for.
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

import h5py

from shapefit.io.inputs import ALWAYS_FITS, MAX_INFLATION, in_words

DEFLATE = 1
"""Number of the filter of zlib."""
SHUFFLE = 2
"""Number of the filter that puts bytes of one place together."""
FLETCHER32 = 3
"""Number of the filter that adds a checksum."""
SZIP = 4
"""Number of a filter that packs whole numbers."""
NBIT = 5
"""Number of the filter that leaves out bits that no number uses."""
SCALEOFFSET = 6
"""Number of the filter that stores numbers by their distance from the least."""
LZF = 32000
"""Number of the filter of h5py that is fast."""

CHECKSUM_BYTES = 4
"""What `fletcher32` puts behind a chunk."""

DEFLATE_GROWTH = 1032
"""Times its size that a deflated stream has at most."""

SLACK = 1.02
"""Times the size of a chunk that it has compressed, where that gains nothing."""

PIECE = 1 << 20
"""Bytes that are inflated at a time, to be counted and dropped."""

Chunk = tuple[int, ...]
"""The first row, column and so on of a chunk."""


class Chunks:
    """The chunks of a dataset that are to be looked at before HDF5 inflates them.

    `fault` says what is wrong with all of them, "" for nothing.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        """Find the fault of a dataset, if any, and chunks that may hold too much."""
        self._dataset = dataset
        self._suspects: dict[Chunk, int] = {}
        self._filters = _filters_of(dataset)
        self.bytes = 0
        self.fault = ""
        if dataset.chunks is None:
            return
        present = dataset.id.get_storage_size()
        self.bytes = math.prod(dataset.chunks) * dataset.dtype.itemsize
        if self.bytes > max(ALWAYS_FITS, MAX_INFLATION * present):
            holds = f"the file holds {in_words(present)} of them"
            self.fault = f"has chunks of {in_words(self.bytes)}, and {holds}"
            return
        self.fault = _fault_of_filters(self._filters, math.prod(dataset.chunks))
        if {DEFLATE, LZF, SZIP} & self._filters.keys() and not self.fault:
            dataset.id.chunk_iter(self._note)

    def _note(self, chunk: h5py.h5d.StoreInfo) -> None:
        """Note a chunk as a suspect where it may inflate to far more than declared."""
        max_bytes = 0
        if DEFLATE in self._filters:
            max_bytes = chunk.size * DEFLATE_GROWTH
        longer = chunk.size > SLACK * self.bytes + PIECE
        grows = max_bytes > max(ALWAYS_FITS, self.bytes)
        if longer or grows or SZIP in self._filters:
            self._suspects[chunk.chunk_offset] = chunk.size

    def find_longer(self, start: int, stop: int) -> Chunk | None:
        """Return a chunk with rows of start:stop that holds too much, None without one.

        That is more than it declares. Each is looked at once.
        """
        if not self._suspects:
            return None
        rows = self._dataset.chunks[0]
        for chunk in [*self._suspects]:
            if chunk[0] < stop and chunk[0] + rows > start:
                if self._is_longer(chunk):
                    return chunk
                del self._suspects[chunk]
        return None

    def _is_longer(self, chunk: Chunk) -> bool:
        """Whether a chunk inflates to more bytes than its dataset declares."""
        if self._suspects[chunk] > SLACK * self.bytes + PIECE:
            return True
        _, data = self._dataset.id.read_direct_chunk(chunk)
        if FLETCHER32 in self._filters and [*self._filters][-1] == FLETCHER32:
            data = data[:-CHECKSUM_BYTES]
        max_bytes = self.bytes + CHECKSUM_BYTES
        if SZIP in self._filters:
            return int.from_bytes(data[:4], "little") > max_bytes
        return inflates_beyond(data, max_bytes)


def inflates_beyond(data: bytes, max_bytes: int) -> bool:
    """Whether a deflated stream holds more than `max_bytes` bytes; False if damaged."""
    stream = zlib.decompressobj()
    size = 0
    try:
        while data and not stream.eof:
            size += len(stream.decompress(data, PIECE))
            data = stream.unconsumed_tail
            if size > max_bytes:
                return True
    except zlib.error:  # which HDF5 reports, or the chunk is stored as it is
        return False
    return False


class Filter(NamedTuple):
    """A step by which chunks are stored: how often it is taken, and its parameters."""

    times: int
    parameters: tuple[int, ...]


def _filters_of(dataset: h5py.Dataset) -> dict[int, Filter]:
    """Return the filters of a dataset by their numbers, in the order of writing."""
    properties = dataset.id.get_create_plist()
    filters: dict[int, Filter] = {}
    for place in range(properties.get_nfilters()):
        number, _, parameters, _ = properties.get_filter(place)
        before = filters[number].times if number in filters else 0
        filters[number] = Filter(before + 1, tuple(parameters))
    return filters


def _fault_of_filters(filters: dict[int, Filter], values: int) -> str:
    """Return what is wrong with the filters of chunks, "" for nothing.

    values: how many a chunk holds.
    """
    if sum(filters[n].times for n in {DEFLATE, LZF, SZIP} & filters.keys()) > 1:
        return "is compressed more than once"
    for number in {NBIT, SCALEOFFSET} & filters.keys():
        parameters = filters[number].parameters
        if len(parameters) > 2 and parameters[2] != values:
            return f"has chunks of {values:,} values that inflate to {parameters[2]:,}"
    return ""
