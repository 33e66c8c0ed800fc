"""URLs as paths."""

import pickle
from pathlib import Path

import pytest

from shapefit.config.paths import absolute_path, anchored, with_data
from shapefit.errors import path_text
from shapefit.stores.locations import location
from shapefit.stores.urls import UrlPath, is_url


def test_a_url_stays_what_it_is_as_a_path():
    path = location("s3://bucket/a/b.h5")
    assert str(path) == path_text(path) == f"{path}" == "s3://bucket/a/b.h5"
    assert str(path.parent / "c.csv") == "s3://bucket/a/c.csv"
    assert (path.name, path.stem, path.suffix) == ("b.h5", "b", ".h5")
    assert pickle.loads(pickle.dumps(path)) == path
    assert location("s3://bucket/a/") == path.parent


@pytest.mark.parametrize(
    "text",
    ["a/b.h5", "/a/b.h5", "C:\\a\\b.h5", "C://a", "s3:/bucket", "a/s3://b"],
    ids=["relative", "absolute", "drive", "drive-and-slashes", "one-slash", "inside"],
)
def test_what_is_no_url(text):
    assert not is_url(text)
    assert not isinstance(location(text), UrlPath)


def test_a_file_url_is_a_path():
    assert location("file:///a/b%20c.h5") == Path("/a/b c.h5")
    assert not isinstance(location("file:///a"), UrlPath)


def test_user_and_password_are_for_the_store_only():
    path = location("https://me:planted@host/a.h5")
    assert path.url == "https://me:planted@host/a.h5"
    assert str(path) == "https://***@host/a.h5"
    assert "planted" not in repr(path)


def test_configs_do_not_anchor_urls():
    assert anchored("s3://bucket/a", Path("/configs")) == "s3://bucket/a"
    assert with_data("{data}/a.h5", "s3://bucket/x") == "s3://bucket/x/a.h5"
    assert str(absolute_path("s3://bucket/a")) == "s3://bucket/a"
