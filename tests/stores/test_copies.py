"""Local copies of objects."""

import errno
import os
from pathlib import Path

import pytest

from shapefit.errors import InputError
from shapefit.stores.locations import location
from shapefit.stores.shelf import look_up, own_shelf


@pytest.fixture
def path(bucket):
    bucket.files.pipe_file(f"{bucket.name}/a/b.csv", b"one")
    return location(f"{bucket.url}/a/b.csv")


def test_it_is_made_once_and_removed_with_its_shelf(path):
    with own_shelf():
        copy = Path(os.fspath(path))
        assert copy.name == "b.csv"
        assert copy.read_text() == path.read_text() == "one"
        assert os.fspath(path) == str(copy)
    assert not copy.parent.exists()


def test_shelves_do_not_share(path):
    with own_shelf():
        first = os.fspath(path)
        with own_shelf():
            assert os.fspath(path) != first
        assert Path(first).exists()


def test_an_object_that_changed_is_downloaded_again_when_it_is_looked_up(bucket, path):
    with own_shelf():
        assert path.read_text() == "one"
        bucket.files.pipe_file(path.url, b"other")
        assert path.read_text() == "one"
        look_up(path)
        assert path.read_text() == "other"


def test_a_full_disk_is_named(path, reopened, monkeypatch):
    async def full(*_arguments, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("s3fs.S3FileSystem._get_file", full)
    message = (
        r"has no room for a copy of s3://bucket-.*/a/b\.csv .*; free some space, or set TMPDIR"
    )
    with own_shelf(), pytest.raises(InputError, match=message) as raised:
        os.fspath(path)
    assert isinstance(raised.value.__cause__, OSError)  # by which parts know that it may pass
