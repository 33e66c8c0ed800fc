"""One digest of all that an HDF5 file holds, whatever is in it.

It is of the names, kinds, shapes and values of all datasets and attributes, of links
and groups. Chunks, compression, the order of writing and the bytes between do not
change it; any other edit does.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.io.layout import CONTENTS

DIGEST_BLOCK_BYTES = 1 << 22
"""Of a dataset that are read at a time."""

DatasetRows = slice | tuple[()]

DigestLine = Sequence[object]
"""Kind, name, shape and so on of one link, group, dataset or attribute: a list of
JSON.
"""


def digest_contents(file: h5py.File, read: Callable[[str, DatasetRows], object]) -> str:
    """Return the SHA-256, in hexadecimal, of all that an open HDF5 file holds.

    `read(name, rows)` returns rows of a dataset. Raises what h5py and `read` raise.
    """
    links: list[tuple[str, int]] = []
    file.id.links.visit(
        lambda name, info: links.append((name.decode(), info.type)), info=True
    )
    lines = [*_describe_attributes("/", file)]
    for name, link in links:
        if link != h5py.h5l.TYPE_HARD:
            lines.append(["link", name, repr(file.get(name, getlink=True).__dict__)])
            continue
        node = file[name]
        if isinstance(node, h5py.Dataset):
            lines.append(_describe_dataset(node, name, read))
        else:
            lines.append([type(node).__name__, name])
        lines += _describe_attributes(name, node)
    return digest_of_lines(lines)


def digest_of_lines(lines: Iterable[DigestLine]) -> str:
    """Return the SHA-256, in hexadecimal, of lists as sorted lines of JSON."""
    text = "\n".join(sorted(map(json.dumps, lines)))
    return hashlib.sha256(text.encode()).hexdigest()


def _describe_attributes(
    name: str, node: h5py.Group | h5py.Dataset
) -> Iterator[DigestLine]:
    """Describe each attribute of a node, but the stored digest, as a list to hash."""
    for key in node.attrs:
        if name != "/" or key != CONTENTS:
            yield describe_attribute(name, key, node.attrs[key])


def describe_attribute(name: str, key: str, value: object) -> DigestLine:
    """Describe attribute `key` of the node called `name` as a list to hash.

    `value` is what h5py reads, or what is written by it.
    """
    if isinstance(value, h5py.Empty):
        return ["attribute", name, key, "empty"]
    if isinstance(value, str):
        value = value.encode("utf-8", "surrogateescape")
    values = np.asarray(value)
    digest = ValuesDigest()
    digest.add(values)
    kind = kind_of_dtype(values.dtype)
    return ["attribute", name, key, kind, list(values.shape), digest.hexdigest()]


def _describe_dataset(
    dataset: h5py.Dataset, name: str, read: Callable[[str, DatasetRows], object]
) -> DigestLine:
    """Describe a dataset as a list to hash; read its values in blocks of rows.

    Of one that is empty, or neither numbers nor texts, it says the kind and the type.
    """
    if dataset.shape is None:
        return ["dataset", name, "empty"]
    kind = kind_of_dtype(dataset.dtype)
    if kind == OTHER:  # which no result holds
        return ["dataset", name, kind, str(dataset.dtype)]
    digest = ValuesDigest()
    for rows in _blocks_of(dataset):
        digest.add(np.asarray(read(name, rows)))
    return describe_values(name, kind, dataset.shape, digest)


def describe_values(
    name: str, kind: str, shape: Sequence[int], digest: ValuesDigest
) -> DigestLine:
    """Describe a dataset of numbers or texts as a list to hash."""
    return ["dataset", name, kind, list(shape), digest.hexdigest()]


def _blocks_of(dataset: h5py.Dataset) -> Iterator[DatasetRows]:
    """Yield slices that cover the rows of a dataset, DIGEST_BLOCK_BYTES each."""
    if not dataset.shape:
        yield ()
    elif dataset.size:
        row_bytes = dataset.dtype.itemsize * math.prod(dataset.shape[1:])
        step = max(1, DIGEST_BLOCK_BYTES // row_bytes)
        count = len(dataset)
        for start in range(0, count, step):
            yield slice(start, min(start + step, count))


LENGTH_BYTES = 8
"""Of the length of a text that is digested."""

OTHER = "other"
"""Kind of values that are neither numbers nor texts."""


def kind_of_dtype(dtype: np.dtype[np.generic]) -> str:
    """Return a name for the kind of a dtype: `text`, `f8` and so on, or OTHER."""
    if dtype.kind in "OSU":
        return "text"
    return f"{dtype.kind}{dtype.itemsize}" if dtype.kind in "biufc" else OTHER


class ValuesDigest:
    """The SHA-256 of an array that comes in blocks of rows, of any size."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, block: NDArray[np.generic]) -> None:
        """Add the next rows of the array."""
        self._hash.update(_bytes_to_hash(block))

    def hexdigest(self) -> str:
        """Return the SHA-256 of all rows so far, in hexadecimal."""
        return self._hash.hexdigest()


def _bytes_to_hash(values: NDArray[np.generic]) -> bytes | memoryview:
    """Return numbers as little-endian bytes; texts as their length, then UTF-8."""
    if values.dtype.kind == "S" and values.dtype.itemsize:
        return _text_bytes_to_hash(values.ravel())
    if values.dtype.kind in "OSU":
        texts = [
            text if isinstance(text, bytes) else str(text).encode("utf-8", "replace")
            for text in values.ravel().tolist()
        ]
        lengths = set(map(len, texts))
        stated = {length: length.to_bytes(LENGTH_BYTES, "little") for length in lengths}
        return b"".join([stated[len(text)] + text for text in texts])
    if values.dtype.kind not in "biufc":
        return repr(values).encode()
    plain = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return plain.data


def _text_bytes_to_hash(texts: NDArray[np.generic]) -> bytes:
    """Return fixed-width byte strings (n,) as length and text each, without padding.

    Most texts of a result are such, and there are several for each image.
    """
    width = texts.dtype.itemsize
    lengths = np.char.str_len(texts.astype(np.bytes_)).astype("<i8")
    rows = np.empty((len(texts), LENGTH_BYTES + width), np.uint8)
    rows[:, :LENGTH_BYTES] = lengths[:, None].view(np.uint8)
    rows[:, LENGTH_BYTES:] = np.ascontiguousarray(texts)[:, None].view(np.uint8)
    is_text = np.arange(LENGTH_BYTES + width) < LENGTH_BYTES + lengths[:, None]
    return rows[is_text].tobytes()
