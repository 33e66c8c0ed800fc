"""Streams of numbers that are mostly 0: zlib is the judge."""

import zlib

import h5py
import numpy as np
import pytest

from shapefit.io import read_results, result_writer
from shapefit.io.hdf5_writer import deflated, fletcher32


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 1.0])
def test_zlib_gets_back_what_went_in(rng, share):
    for count in (*range(70), 511, 513, 30_000):
        values = rng.standard_normal(count) * (rng.random(count) < share)
        assert zlib.decompress(deflated(values)) == values.tobytes()


def test_checksums_are_those_of_hdf5(tmp_path, rng):
    for number, size in enumerate((1, 2, 7, 4096, 100_001)):
        data = rng.integers(0, 256, size).astype(np.uint8)
        for values in (data, np.zeros_like(data), np.full_like(data, 255)):
            with h5py.File(tmp_path / f"{number}.h5", "w") as file:
                stored = file.create_dataset("a", data=values, chunks=(size,), fletcher32=True)
                _, chunk = stored.id.read_direct_chunk((0,))
            assert chunk[-4:] == fletcher32(values.tobytes())


def test_batches_of_any_length_are_read_as_they_were(tmp_path, results, rng):
    """Rows that do not fill a chunk wait for those of the next batch, the last for the end."""
    lengths, written = (300, 1, 5, 299, 700), []
    with result_writer(tmp_path / "r.h5") as writer:
        for number, length in enumerate(lengths):
            dense = rng.random((length, 7))
            part = results.take(np.arange(length) % len(results)).replaced(
                coefficients=np.where(rng.random((length, 7)) < 0.2, dense, 0.0),
                items=tuple(f"{number}/{row}" for row in range(length)),
            )
            written.append(part.coefficients)
            writer.append(part)
    expected = np.concatenate(written)
    np.testing.assert_array_equal(read_results(tmp_path / "r.h5").coefficients, expected)
    with h5py.File(tmp_path / "r.h5") as file:
        stored = file["coefficients"]
        assert stored.compression == "gzip"
        assert stored.id.get_storage_size() < 0.7 * expected.nbytes
        np.testing.assert_array_equal(stored[295:305], expected[295:305])
