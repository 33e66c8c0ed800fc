"""Stores that do not answer, without the time that is given to them."""

import pytest

from shapefit import stores


@pytest.fixture
def impatient(monkeypatch):
    """Try each request once."""
    once = {"config_kwargs": {"connect_timeout": 2, "retries": {"total_max_attempts": 1}}}
    monkeypatch.setattr(stores, "PATIENCE", {"s3": once})
    monkeypatch.setattr("s3fs.S3FileSystem.retries", 1)
