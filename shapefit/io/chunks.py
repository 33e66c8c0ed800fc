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

from shapefit.io.inputs import ALWAYS_FITS, MAX_INFLATION, format_bytes

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


class SuspectChunks:
    """The chunks of a dataset that may inflate to more bytes than it declares.

    `fault` says what is wrong with all of them, "" for nothing.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        """Find suspect chunks by their stored sizes and filters; inflate nothing."""
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
            holds = f"the file holds {format_bytes(present)} of them"
            self.fault = f"has chunks of {format_bytes(self.bytes)}, and {holds}"
            return
        self.fault = _fault_of_filters(self._filters, math.prod(dataset.chunks))
        if {DEFLATE, LZF, SZIP} & self._filters.keys() and not self.fault:
            dataset.id.chunk_iter(self._note_suspect)

    def _note_suspect(self, chunk: h5py.h5d.StoreInfo) -> None:
        """Note a chunk as a suspect if it may inflate to far more than declared."""
        max_bytes = 0
        if DEFLATE in self._filters:
            max_bytes = chunk.size * DEFLATE_GROWTH
        longer = chunk.size > SLACK * self.bytes + PIECE
        grows = max_bytes > max(ALWAYS_FITS, self.bytes)
        if longer or grows or SZIP in self._filters:
            self._suspects[chunk.chunk_offset] = chunk.size

    def find_longer(self, start: int, stop: int) -> Chunk | None:
        """Return a chunk of rows start:stop with more bytes than declared, or None.

        Each suspect is inflated, and counted, once.
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
        """Whether a chunk inflates to more bytes than its dataset declares for it."""
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
    """A filter of HDF5, as for compression: how often it is applied, its parameters."""

    times: int
    parameters: tuple[int, ...]


def _filters_of(dataset: h5py.Dataset) -> dict[int, Filter]:
    """Return HDF5's number -> filter of a dataset, in the order of writing."""
    properties = dataset.id.get_create_plist()
    filters: dict[int, Filter] = {}
    for place in range(properties.get_nfilters()):
        number, _, parameters, _ = properties.get_filter(place)
        before = filters[number].times if number in filters else 0
        filters[number] = Filter(before + 1, tuple(parameters))
    return filters


def _fault_of_filters(filters: dict[int, Filter], chunk_values: int) -> str:
    """Return a message where filters inflate to more than `chunk_values` values, or "".

    They do by compressing twice, or by stating another number of values.
    """
    if sum(filters[n].times for n in {DEFLATE, LZF, SZIP} & filters.keys()) > 1:
        return "is compressed more than once"
    for number in {NBIT, SCALEOFFSET} & filters.keys():
        parameters = filters[number].parameters
        if len(parameters) > 2 and parameters[2] != chunk_values:
            stated = f"{chunk_values:,} values that inflate to {parameters[2]:,}"
            return f"has chunks of {stated}"
    return ""
