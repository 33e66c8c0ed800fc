"""Objects of a store are read as files are, put whole, and what is wrong is said at the URL."""

import errno
import importlib
import os
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

from shapefit import stores
from shapefit.api import files
from shapefit.config import load_config
from shapefit.config.paths import absolute_path, anchored, with_data
from shapefit.errors import InputError, path_text
from shapefit.io import atomic_path, check_output, open_landmarks
from shapefit.stores import StoreError, UrlPath, held_object, is_url, location, own_copies
from tests.io.files import save


class TestUrls:
    def test_one_stays_what_it_is_as_a_path(self):
        path = location("s3://bucket/a/b.h5")
        assert str(path) == path_text(path) == f"{path}" == "s3://bucket/a/b.h5"
        assert str(path.parent / "c.csv") == "s3://bucket/a/c.csv"
        assert (path.name, path.stem, path.suffix) == ("b.h5", "b", ".h5")
        assert pickle.loads(pickle.dumps(path)) == path
        assert location("s3://bucket/a/") == path.parent

    @pytest.mark.parametrize(
        "text", ["a/b.h5", "/a/b.h5", "C:\\a\\b.h5", "C://a", "s3:/bucket", "a/s3://b"]
    )
    def test_what_is_none(self, text):
        assert not is_url(text)
        assert not isinstance(location(text), UrlPath)

    def test_that_of_a_file_is_a_path(self):
        assert location("file:///a/b%20c.h5") == Path("/a/b c.h5")

    def test_user_and_password_are_for_the_store_only(self):
        path = location("https://me:planted@host/a.h5")
        assert path.url == "https://me:planted@host/a.h5"
        assert str(path) == "https://***@host/a.h5"
        assert "planted" not in repr(path)

    def test_configs_do_not_anchor_them(self):
        assert anchored("s3://bucket/a", Path("/configs")) == "s3://bucket/a"
        assert with_data("{data}/a.h5", "s3://bucket/x") == "s3://bucket/x/a.h5"
        assert str(absolute_path("s3://bucket/a")) == "s3://bucket/a"


@pytest.mark.slow
class TestCopies:
    @pytest.fixture
    def path(self, bucket):
        bucket.files.pipe_file(f"{bucket.name}/a/b.csv", b"one")
        return location(f"{bucket.url}/a/b.csv")

    def test_one_is_made_once_and_removed_in_the_end(self, bucket, path):
        with own_copies():
            copy = Path(os.fspath(path))
            assert copy.name == "b.csv"
            bucket.files.pipe_file(path.url, b"other")
            assert copy.read_text() == path.read_text() == "one"
            stores.forget_copy(path)
            assert path.read_text() == "other"
        assert not copy.exists()

    def test_a_full_disk_is_named(self, path, reopened, monkeypatch):
        async def full(*_arguments, **_options):
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr("s3fs.S3FileSystem._get_file", full)
        message = r"has no room for a copy of s3://bucket-.*/a/b\.csv .*; free some space, or set"
        with own_copies(), pytest.raises(InputError, match=message) as raised:
            os.fspath(path)
        assert isinstance(raised.value.__cause__, OSError)  # by which parts know that it may pass


@pytest.mark.slow
class TestFormats:
    @pytest.fixture
    def samples(self, bucket, project):
        for name in ("people_views.csv", "cars_views.h5"):
            bucket.files.put_file(str(project / "sample_data" / name), f"{bucket.name}/{name}")
        for path in sorted((project / "sample_data" / "openpose").rglob("*.json"))[:3]:
            bucket.files.put_file(str(path), f"{bucket.name}/openpose/{path.name}")
        return bucket

    def read(self, paths):
        with open_landmarks(paths) as source:
            return source.whole()

    @pytest.mark.parametrize("name", ["people_views.csv", "cars_views.h5"])
    def test_ours(self, samples, project, name):
        local = self.read([project / "sample_data" / name])
        there = self.read([location(f"{samples.url}/{name}")])
        np.testing.assert_array_equal(there.landmarks, local.landmarks)
        assert there.items == local.items

    def test_of_another_tool(self, samples, project):
        known = sorted((project / "sample_data" / "openpose").rglob("*.json"))[:3]
        urls = (f"{samples.url}/openpose/{path.name}" for path in known)
        there = files.read_landmarks(*urls, keypoints="body_25")
        local = files.read_landmarks(*known, keypoints="body_25")
        np.testing.assert_array_equal(there.landmarks, local.landmarks)
        assert there.items == local.items

    def test_globs_and_the_data_folder(self, samples):
        arguments = {"landmarks": "{data}/*s.csv", "dictionary": "people", "output": "-"}
        config = load_config("fit", None, (f"data={samples.url}",), arguments)
        assert list(map(str, config.landmarks)) == [f"{samples.url}/people_views.csv"]

    def test_a_changed_object_is_read_anew(self, samples):
        url = f"{samples.url}/people_views.csv"
        before = files.read_landmarks(url)
        lines = samples.files.cat_file(url).splitlines(keepends=True)
        samples.files.pipe_file(url, b"".join(lines[: len(lines) // 2]))
        assert len(files.read_landmarks(url).items) < len(before.items)

    @pytest.mark.parametrize(
        ("text", "message"),
        [("", r"a\.csv: is empty \(0 bytes\)"), ("item,landmark,x,y\na,b,1,no\n", r"a\.csv:2")],
    )
    def test_messages_name_the_url(self, bucket, text, message):
        bucket.files.pipe_file(f"{bucket.name}/a.csv", text.encode())
        with pytest.raises(InputError, match=f"^{bucket.url}/{message}"):
            self.read([location(f"{bucket.url}/a.csv")])

    @pytest.mark.parametrize("name", ["written.parquet", "written.h5", "written.csv"])
    def test_written_ones(self, samples, project, name):
        pytest.importorskip("pyarrow")
        local = self.read([project / "sample_data" / "cars_views.h5"])
        save(location(f"{samples.url}/{name}"), local)
        there = self.read([location(f"{samples.url}/{name}")])
        np.testing.assert_allclose(there.landmarks, local.landmarks, atol=0.005)


def fit(landmarks: str, **options: str):
    overrides = [f"storage_options.{name}={value}" for name, value in options.items()]
    arguments = {"landmarks": landmarks, "dictionary": "people", "output": "-"}
    return load_config("fit", None, overrides, arguments)


@pytest.mark.slow
class TestFaults:
    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("none.h5", "no object s3://bucket-.*/none.h5; check the spelling"),
            ("*.h5", r"no object matches s3://bucket-.*/\*.h5; check the pattern"),
        ],
    )
    def test_missing_objects(self, bucket, name, message):
        with pytest.raises(InputError, match=message):
            fit(f"{bucket.url}/{name}")

    def test_a_missing_bucket(self, bucket):
        missing = "s3://no-such-bucket: there is no such bucket; make it"
        with pytest.raises(InputError, match=missing):
            check_output(location("s3://no-such-bucket/a.h5"))
        with pytest.raises(InputError, match=r"s3://no-such-bucket/a\.h5"):
            fit("s3://no-such-bucket/a.h5")

    def test_no_credentials(self, bucket, reopened, monkeypatch, tmp_path):
        monkeypatch.delenv("AWS_ACCESS_KEY_ID")
        monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
        monkeypatch.setenv("HOME", str(tmp_path))
        message = r"there are no credentials .*; check the credentials in"
        with pytest.raises(InputError, match=message):
            fit(f"{bucket.url}/a.h5")

    def test_no_connection(self, bucket, impatient):
        message = r"Could not connect .*; check the connection"
        with pytest.raises(StoreError, match=message) as raised:
            fit(f"{bucket.url}/a.h5", endpoint_url="http://127.0.0.1:9")
        assert "127.0.0.1:9" not in str(raised.value)

    @pytest.mark.parametrize(
        ("url", "message"),
        [
            ("gs://bucket/a.h5", "run `pip install gcsfs`"),
            ("s3://bucket/a.h5", "run `pip install s3fs`"),
            ("floppy://a/b.h5", "there is no kind of store 'floppy'; give s3:// or gs://"),
        ],
    )
    def test_what_is_not_installed(self, url, message, monkeypatch):
        registry = importlib.import_module("fsspec.registry")
        for name, module in (("s3", "s3fs"), ("gs", "gcsfs")):
            monkeypatch.setitem(sys.modules, module, None)
            monkeypatch.delitem(registry._registry, name, raising=False)
        with pytest.raises(InputError, match=message):
            fit(url)

    def test_options_of_another_store(self, bucket):
        message = r"storage_options: the store of s3://.* does not take them"
        with pytest.raises(InputError, match=message):
            fit(f"{bucket.url}/a.h5", nonsense="planted")

    def test_the_web_is_read_only(self):
        with pytest.raises(InputError, match=r"https://host/a\.h5: is read only"):
            check_output(location("https://host/a.h5"))

    def test_nothing_is_put_when_the_writer_fails(self, bucket):
        def write() -> None:
            with atomic_path(location(f"{bucket.url}/a.txt")) as path:
                path.write_text("half")
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            write()
        assert bucket.files.find(bucket.name) == []

    def test_one_run_holds_an_object(self, bucket):
        path = location(f"{bucket.url}/results/.lock")
        with held_object(path) as first, held_object(path) as second:
            assert first
            assert not second
            assert bucket.files.find(bucket.name)
        assert bucket.files.find(bucket.name) == []
