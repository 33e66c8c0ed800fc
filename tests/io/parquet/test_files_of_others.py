"""Tables that other programs wrote, from arrays, by hand."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shapefit.io import open_landmarks, read_results, read_shapes
from shapefit.io.kinds.listing import find_kind
from shapefit.io.records import concatenate
from tests.io.files import load

NAMES = ["nose", "tail", "paw"]
X = [[1.0, 2.0, 3.0], [4.0, None, 6.0], [7.0, 8.0, 9.0]]
Y = [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5], [7.5, float("nan"), 9.5]]
ITEMS = ["a", "b", "c"]

VALUE_TYPES = {"float32": pa.float32(), "float64": pa.float64()}
LISTS = {
    "list": pa.list_,
    "large_list": pa.large_list,
    "fixed_size_list": lambda kind: pa.list_(kind, 3),
}


@pytest.fixture
def write(tmp_path):
    """Write columns and metadata; return the path."""

    def written(columns, metadata=None, name="table.parquet", **options) -> Path:
        named = {"landmark_names": json.dumps(NAMES)} if metadata is None else metadata
        table = pa.table(columns).replace_schema_metadata(named)
        pq.write_table(table, tmp_path / name, **options)
        return tmp_path / name

    return written


def read(path: Path, size: int = 100):
    with open_landmarks([path]) as source:
        return concatenate(list(source.chunks(size)))


@pytest.mark.parametrize("value", VALUE_TYPES)
@pytest.mark.parametrize("kind", LISTS)
def test_a_table_of_lists(write, kind, value):
    lists = LISTS[kind](VALUE_TYPES[value])
    path = write({"item": ITEMS, "x": pa.array(X, lists), "y": pa.array(Y, lists)})
    assert find_kind(path) == "landmarks"
    images = read(path)
    assert images.items == ("a", "b", "c")
    assert images.landmark_names == tuple(NAMES)
    nan = np.nan
    np.testing.assert_array_equal(images.landmarks[0], [[1, 2, 3], [1.5, 2.5, 3.5]])
    np.testing.assert_array_equal(images.landmarks[1], [[4, nan, 6], [4.5, nan, 6.5]])
    np.testing.assert_array_equal(images.landmarks[2], [[7, nan, 9], [7.5, nan, 9.5]])


def test_names_in_a_column(write):
    path = write({"item": ITEMS, "x": X, "y": Y, "landmark_names": [NAMES] * 3}, {})
    assert read(path).landmark_names == tuple(NAMES)
    assert not read(path).further


def test_rows_that_name_other_landmarks(write, problems):
    rows = [NAMES, NAMES, [NAMES[1], NAMES[0], NAMES[2]]]
    path = write({"item": ITEMS, "x": X, "y": Y, "landmark_names": rows}, {})
    (line,) = problems(read, path)
    found = "names other landmarks than the first row, or in another order; arrange all rows alike"
    assert line == f"{path}: column landmark_names, row 2: {found}"


def test_names_among_the_attributes_of_pandas(write):
    attrs = {"landmark_names": NAMES, "unit": "px", "frame_rate": 25}
    images = read(write({"item": ITEMS, "x": X, "y": Y}, {"PANDAS_ATTRS": json.dumps(attrs)}))
    assert (images.landmark_names, images.unit, images.frame_rate) == (tuple(NAMES), "px", 25.0)


def test_texts_as_a_dictionary_and_missing_sequences(write):
    sequences = pa.array(["s", None, "s"]).dictionary_encode()
    images = read(write({"item": ITEMS, "x": X, "y": Y, "sequence": sequences}))
    assert images.sequences == ("s", "", "s")


def test_further_columns_are_carried(write):
    depths = [[[1.0, 2.0], [3.0, 4.0]]] * 3
    images = read(write({"item": ITEMS, "x": X, "y": Y, "age": [1, 2, 3], "depths": depths}))
    np.testing.assert_array_equal(images.columns["age"], [1, 2, 3])
    assert images.columns["depths"].shape == (3, 2, 2)


def test_a_table_with_z_holds_shapes_or_a_result(write):
    path = write({"item": ITEMS, "x": X[:1] * 3, "y": Y[:1] * 3, "z": X[:1] * 3})
    assert find_kind(path) == "shapes"
    np.testing.assert_array_equal(read_shapes([path]).shapes[1], [X[0], Y[0], X[0]])
    np.testing.assert_array_equal(read_results(path).shapes[1], [X[0], Y[0], X[0]])


def test_the_example_is_read(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (project / "docs/files.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(example, "docs/files.md", "exec"), names)
    images = load(Path("landmarks.parquet"))
    np.testing.assert_array_equal(images.landmarks, np.swapaxes(names["points"], 1, 2))
    assert images.landmark_names == ("nose", "tail", "left ear")
    assert (images.unit, images.y_axis) == ("px", "down")
    assert images.items[7] == "film/000007"
