"""Files of all kinds are read from a store as from a disk."""

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.face import files
from shapefit.io import open_landmarks
from shapefit.stores.locations import location
from tests.io.files import save


@pytest.fixture
def samples(bucket, project):
    for name in ("people_views.csv", "cars_views.h5"):
        bucket.files.put_file(str(project / "sample_data" / name), f"{bucket.name}/{name}")
    for path in sorted((project / "sample_data" / "openpose").rglob("*.json"))[:3]:
        bucket.files.put_file(str(path), f"{bucket.name}/openpose/{path.name}")
    return bucket


def read(paths):
    with open_landmarks(paths) as source:
        return source.whole()


@pytest.mark.parametrize("name", ["people_views.csv", "cars_views.h5"])
def test_our_formats(samples, project, name):
    local = read([project / "sample_data" / name])
    there = read([location(f"{samples.url}/{name}")])
    np.testing.assert_array_equal(there.landmarks, local.landmarks)
    assert there.items == local.items


def test_a_format_of_another_tool(samples, project):
    known = sorted((project / "sample_data" / "openpose").rglob("*.json"))[:3]
    urls = (f"{samples.url}/openpose/{path.name}" for path in known)
    there = files.read_landmarks(*urls, keypoints="body_25")
    local = files.read_landmarks(*known, keypoints="body_25")
    np.testing.assert_array_equal(there.landmarks, local.landmarks)
    assert there.items == local.items


def test_globs_and_the_data_folder(samples):
    arguments = {"landmarks": "{data}/*s.csv", "dictionary": "people", "output": "-"}
    config = load_config("fit", None, (f"data={samples.url}",), arguments)
    assert list(map(str, config.landmarks)) == [f"{samples.url}/people_views.csv"]
    assert config.as_plain()["landmarks"] == [f"{samples.url}/people_views.csv"]


def test_a_changed_object_is_read_anew(samples):
    url = f"{samples.url}/people_views.csv"
    before = files.read_landmarks(url)
    lines = samples.files.cat_file(url).splitlines(keepends=True)
    samples.files.pipe_file(url, b"".join(lines[: len(lines) // 2]))
    assert len(files.read_landmarks(url).items) < len(before.items)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"a\.csv: is empty \(0 bytes\)"),
        ("item,landmark,x,y\na,b,1,nonsense\n", r"a\.csv:2"),
    ],
    ids=["empty", "not-a-number"],
)
def test_messages_name_the_url(bucket, text, message):
    bucket.files.pipe_file(f"{bucket.name}/a.csv", text.encode())
    with pytest.raises(InputError, match=f"^{bucket.url}/{message}"):
        read([location(f"{bucket.url}/a.csv")])


def test_parquet(samples, project, tmp_path):
    pytest.importorskip("pyarrow")
    local = read([project / "sample_data" / "cars_views.h5"])
    save(location(f"{samples.url}/written.parquet"), local)
    there = read([location(f"{samples.url}/written.parquet")])
    np.testing.assert_array_equal(there.landmarks, local.landmarks)
