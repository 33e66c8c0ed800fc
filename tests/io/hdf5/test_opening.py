"""HDF5 files in a store: read in blocks, while nobody else collects garbage."""

import gc

import h5py
import numpy as np
import pytest

from shapefit.io.hdf5.opening import open_hdf5
from shapefit.io.hdf5.reading import Hdf5Reader
from shapefit.io.layout import SHAPES
from shapefit.stores.locations import location
from shapefit.stores.opening import StoreError


@pytest.fixture
def path(bucket, tmp_path):
    """An object of 3 MB."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["numbers"] = np.arange(400_000.0)
        file["numbers"].attrs["of"] = "chunks"
    bucket.files.put_file(str(tmp_path / "a.h5"), f"{bucket.name}/a.h5")
    return location(f"{bucket.url}/a.h5")


def test_only_what_is_read_is_fetched(path, monkeypatch):
    from s3fs import core

    fetched = []
    real = core._fetch_range

    def counted(fs, bucket, key, version, start, end, **options):
        fetched.append(end - start)
        return real(fs, bucket, key, version, start, end, **options)

    monkeypatch.setattr(core, "_fetch_range", counted)
    with open_hdf5(path) as file:
        np.testing.assert_array_equal(file["numbers"][200_000:200_010], np.arange(2e5, 2e5 + 10))
    assert sum(fetched) < 1_000_000


def test_garbage_is_left_alone_while_a_file_is_open(path):
    assert gc.isenabled()
    with open_hdf5(path) as first:
        assert not gc.isenabled()
        with open_hdf5(path):
            assert not gc.isenabled()
        assert not gc.isenabled()
        first.close()
    assert gc.isenabled()


def test_it_is_collected_again_after_a_file_that_cannot_be_opened(bucket, path):
    bucket.files.pipe_file(path.url, b"no HDF5")
    with pytest.raises(OSError, match="signature"):
        open_hdf5(path)
    assert gc.isenabled()


def test_a_store_that_fails_is_no_damaged_file(bucket, project, monkeypatch):
    from s3fs import core

    bucket.files.put_file(str(project / "sample_data/people_test.h5"), f"{bucket.name}/b.h5")

    def fails(*_arguments, **_options):
        raise OSError(5, "the line is cut")

    monkeypatch.setattr(core, "_fetch_range", fails)
    with pytest.raises(StoreError, match=r"b\.h5: cannot be read .*the line is cut"):
        Hdf5Reader(location(f"{bucket.url}/b.h5"), SHAPES)
