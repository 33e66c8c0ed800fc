"""What is wrong with a store is said at once, at the URL, with a fix."""

import importlib
import sys

import pytest

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.io.whole.atomic import atomic_path, check_output
from shapefit.io.whole.folder import check_folder
from shapefit.stores.locations import location
from shapefit.stores.opening import StoreError

pytestmark = pytest.mark.slow


def fit(landmarks: str, **options: str):
    overrides = [f"storage_options.{name}={value}" for name, value in options.items()]
    arguments = {"landmarks": landmarks, "dictionary": "people", "output": "-"}
    return load_config("fit", None, overrides, arguments)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.h5", "no object s3://bucket-.*/none.h5; check the spelling"),
        ("*.h5", r"no object matches s3://bucket-.*/\*.h5; check the pattern"),
    ],
    ids=["missing", "nothing-matches"],
)
def test_missing_objects(bucket, name, message):
    with pytest.raises(InputError, match=message):
        fit(f"{bucket.url}/{name}")


def test_a_missing_bucket(bucket):
    with pytest.raises(InputError, match="s3://no-such-bucket: there is no such bucket; make it"):
        check_output(location("s3://no-such-bucket/a.h5"))
    with pytest.raises(InputError, match=r"s3://no-such-bucket/a\.h5"):
        fit("s3://no-such-bucket/a.h5")


def test_no_credentials(bucket, reopened, monkeypatch, tmp_path):
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(InputError, match=r"there are no credentials .*; check the credentials in"):
        fit(f"{bucket.url}/a.h5")


def test_no_connection(bucket, impatient):
    with pytest.raises(StoreError, match=r"Could not connect .*; check the connection") as raised:
        fit(f"{bucket.url}/a.h5", endpoint_url="http://127.0.0.1:9")
    assert "127.0.0.1:9" not in str(raised.value)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("gs://bucket/a.h5", "run `pip install gcsfs`"),
        ("s3://bucket/a.h5", "run `pip install s3fs`"),
        ("floppy://a/b.h5", "there is no kind of store 'floppy'; give s3:// or gs://"),
    ],
    ids=["gs", "s3", "unknown"],
)
def test_what_is_not_installed(url, message, monkeypatch):
    registry = importlib.import_module("fsspec.registry")
    for name, module in (("s3", "s3fs"), ("gs", "gcsfs")):
        monkeypatch.setitem(sys.modules, module, None)
        monkeypatch.delitem(registry._registry, name, raising=False)
    with pytest.raises(InputError, match=message):
        fit(url)


def test_options_of_another_store(bucket):
    with pytest.raises(
        InputError, match=r"storage_options: the store of s3://.* does not take them"
    ):
        fit(f"{bucket.url}/a.h5", nonsense="planted")


@pytest.mark.parametrize("name", ["report/", "meshes"])
def test_folders_are_refused(bucket, name):
    with pytest.raises(InputError, match="a folder of files is not written to an object store"):
        check_folder(location(f"{bucket.url}/{name}"))


def test_the_web_is_read_only():
    with pytest.raises(InputError, match=r"https://host/a\.h5: is read only"):
        check_output(location("https://host/a.h5"))


def test_nothing_is_put_when_the_writer_fails(bucket):
    def write() -> None:
        with atomic_path(location(f"{bucket.url}/a.txt")) as path:
            path.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write()
    assert bucket.files.find(bucket.name) == []
