"""Our own HDF5 files, damaged: an error that names the file, or the same values."""

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import (
    open_landmarks,
    read_dictionary,
    read_results,
    read_shapes,
)
from shapefit.io.records import Records


def spoil(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Flip a bit, zero a stretch, or put noise there: in the header, or anywhere."""
    spoilt = bytearray(data)
    end = len(data) if rng.random() < 0.7 else min(len(data), 2048)
    at = int(rng.integers(0, end))
    if kind == "flip":
        spoilt[at] ^= 1 << int(rng.integers(8))
        return bytes(spoilt)
    size = min(int(rng.integers(1, 64)), len(data) - at)
    spoilt[at : at + size] = bytes(size) if kind == "zeros" else rng.bytes(size)
    return bytes(spoilt) if spoilt != data else spoil(data, kind, rng)


def _read_landmarks(path):
    with open_landmarks([path]) as source:
        return source.whole()


def values_of(record) -> dict[str, object]:
    """Return all that a record or a dictionary holds."""
    named = vars(record)
    if isinstance(record, Records):
        named = {**named, **record.columns}
    unchecked = ("per_item", "whole", "prior", "maker", "attributes", "provenance", "unit")
    named = {k: v for k, v in named.items() if k not in unchecked}
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in named.items()}


READERS = {
    "landmark_file": _read_landmarks,
    "shape_file": lambda path: read_shapes([path]),
    "result_file": lambda path: read_results(path, proofs=True),
    "dictionary_file": read_dictionary,
}


@pytest.mark.parametrize("kind", ["flip", "zeros", "noise"])
@pytest.mark.parametrize("name", READERS)
def test_no_damage_is_read_in_silence(request, tmp_path, name, kind):
    path, read = request.getfixturevalue(name), READERS[name]
    data, sound = path.read_bytes(), repr(values_of(read(path)))
    rng = np.random.default_rng(len(name) + len(kind))
    found = 0
    for number in range(25):
        spoilt = tmp_path / f"{number}.h5"
        spoilt.write_bytes(spoil(data, kind, rng))
        try:
            again = read(spoilt)
        except InputError:
            found += 1
            continue
        assert repr(values_of(again)) == sound
    assert found >= 12


def test_everything_that_is_written_has_checksums(result_file, dictionary_file):
    def check(_name: str, node: object) -> None:
        if isinstance(node, h5py.Dataset):
            assert node.fletcher32 == (node.size > 0 and node.ndim > 0)
            assert h5py.check_vlen_dtype(node.dtype) is None
            kind = h5py.check_string_dtype(node.dtype)
            assert kind is None or kind.length

    for path in (result_file, dictionary_file):
        with h5py.File(path) as file:
            assert path.read_bytes()[8] == 3  # version of the superblock, with a checksum
            file.visititems(check)


def test_the_file_ends_where_its_content_does(tmp_path, result_file):
    with h5py.File(result_file) as file:
        assert result_file.stat().st_size == file.id.get_filesize() < 1 << 20
