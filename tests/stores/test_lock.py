"""One run holds a lock in a store; that of a killed run is taken over."""

import pytest

from shapefit.errors import InputError
from shapefit.stores import lock
from shapefit.stores.locations import location


@pytest.fixture
def path(bucket):
    return location(f"{bucket.url}/results/.lock")


@pytest.fixture
def killed(bucket, path):
    """The lock of a run that was killed."""
    bucket.files.pipe_file(path.url, b"elsewhere 1\n")


def test_it_is_held_once_and_removed(bucket, path):
    with lock.held_object(path) as first, lock.held_object(path) as second:
        assert first
        assert not second
        assert bucket.files.find(bucket.name)
    assert bucket.files.find(bucket.name) == []


def test_a_fresh_one_is_respected(killed, path):
    with lock.held_object(path) as held:
        assert not held


def test_an_abandoned_one_is_taken_over(killed, path, monkeypatch):
    monkeypatch.setattr(lock, "ABANDONED", 0.0)
    with lock.held_object(path) as held:
        assert held


def test_of_two_that_take_it_over_one_holds_it(bucket, killed, path, monkeypatch):
    monkeypatch.setattr(lock, "ABANDONED", 0.0)
    real = type(bucket.files).modified

    def overtaken(files, name):
        when = real(files, name)
        files.pipe_file(name, b"another 2\n")
        return when

    monkeypatch.setattr("s3fs.S3FileSystem.modified", overtaken)
    with lock.held_object(path) as held:
        assert not held


def test_it_stays_young(bucket, path, monkeypatch):
    monkeypatch.setattr(lock, "HEARTBEAT", 0.05)
    with lock.held_object(path):
        bucket.files.rm_file(path.url)
        for _ in range(100):
            if bucket.files.exists(path.url):
                break
        assert bucket.files.exists(path.url)


def test_a_missing_bucket(bucket):
    with (
        pytest.raises(InputError, match="there is no such bucket"),
        lock.held_object(location("s3://no-such-bucket/results/.lock")),
    ):
        pass
