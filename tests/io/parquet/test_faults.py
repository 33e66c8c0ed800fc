"""Parquet files that are wrong: what each fault says, and where."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shapefit.errors import InputError
from shapefit.io import landmark_writer, memory, open_landmarks, read_results
from shapefit.io.layout import SHAPES
from shapefit.io.writing import record_writer
from tests.io.files import load, save

GOOD = {
    "item": ["a", "b"],
    "x": [[1.0, 2.0], [3.0, 4.0]],
    "y": [[1.0, 2.0], [3.0, 4.0]],
}
NAMED = {"landmark_names": '["nose", "tail"]'}


@pytest.fixture
def write(tmp_path):
    """Write the good table with some columns and metadata changed; None leaves one out."""

    def written(metadata=None, **columns) -> Path:
        table = {name: values for name, values in {**GOOD, **columns}.items() if values is not None}
        path = tmp_path / "t.parquet"
        pq.write_table(pa.table(table).replace_schema_metadata(metadata or NAMED), path)
        return path

    return written


COLUMNS = {
    "no item": ({"item": None}, "column item: there is no such column; store UTF-8 text"),
    "no y": ({"y": None}, "has no columns x and y, and holds item, x; give columns item (text)"),
    "x is no list": ({"x": [1.0, 2.0]}, "column x: holds values of type double; store lists of"),
    "x is text": ({"x": [["1", "2"]] * 2}, "column x: holds values of type list<element: string>"),
    "three values": (
        {"x": [[1.0, 2.0, 3.0]] * 2},
        "column x: holds lists of 3 values, not of 2; store lists of numbers, one for each",
    ),
    "rows differ": (
        {"x": [[1.0, 2.0], [1.0]]},
        "column x, row 1: holds 1 values, and rows before it 2; give every row as many",
    ),
    "a null list": ({"x": [[1.0, 2.0], None]}, "column x, row 1: is null; give every row a list"),
    "an item is null": ({"item": ["a", None]}, "column item, row 1: is empty; name every item"),
    "an item twice": (
        {"item": ["a", "a"]},
        "column item, row 1: item 'a' is also at {path}: column item, row 0; give every item",
    ),
    "items are numbers": ({"item": [1, 2]}, "column item: holds values of type int64; store UTF-8"),
    "infinite": (
        {"y": [[1.0, 2.0], [3.0, float("inf")]]},
        "columns x, y, row 1: landmark 'tail' is (4.0, inf); write NaN where the landmark is",
    ),
    "confidence is short": (
        {"confidence": [[1.0]] * 2},
        "column confidence: holds lists of 1 values, not of 2; store lists of numbers (landmarks)",
    ),
    "confidence is negative": (
        {"confidence": [[1.0, 1.0], [-1.0, 1.0]]},
        "column confidence, row 1: landmark 'nose' is (-1.0); write 0 (hidden) or a positive",
    ),
    "confidence is null": (
        {"confidence": [[1.0, None], [1.0, 1.0]]},
        "column confidence, row 0: landmark 'tail' is (nan); write 0 (hidden) or a positive",
    ),
    "a further column has gaps": ({"age": [1, None]}, "column age, row 1: is null; write a number"),
    "further lists differ": (
        {"more": [[1], [1, 2]]},
        "column more, row 1: holds 2 values, and rows before it 1; give every row as many",
    ),
    "a struct": ({"at": [{"a": 1}] * 2}, "column at: holds struct<a: int64>; store numbers or"),
    "a zero byte": ({"item": ["a", "b\0"]}, "column item: holds a text with a zero byte; remove"),
}

METADATA = {
    "no names": ({"a": "b"}, "does not name the landmarks; add the metadata landmark_names, a JS"),
    "names are no JSON": (
        {"landmark_names": "nose"},
        "the metadata landmark_names is not a JSON list of texts; add the metadata landmark",
    ),
    "a name twice": (
        {"landmark_names": '["a", "a"]'},
        "column landmark_names, row 1: repeats the name 'a'; give every landmark a unique name",
    ),
    "another format": (
        NAMED | {"format": "shapefit-shapes", "version": "1"},
        "is a shapefit-shapes file; give a shapefit-landmarks file",
    ),
    "an unknown format": (
        NAMED | {"format": "shapefit-what"},
        "is a shapefit-what file; give one of shapefit-landmarks, shapefit-shapes, shapefit-result",
    ),
    "another version": (
        NAMED | {"format": "shapefit-landmarks", "version": "2"},
        "has version 2; this program reads version 1",
    ),
    "y_axis": (NAMED | {"y_axis": "left"}, "the metadata y_axis is 'left'; set it to up or down"),
    "frame_rate": (NAMED | {"frame_rate": "0"}, "the metadata frame_rate is 0; set it to frames"),
    "a zero byte": (NAMED | {"unit": "p\0"}, "metadata unit: is not UTF-8 text, or has a zero"),
    "no text": (
        {"landmark_names": '["a", "\\ud800"]'},
        "the metadata landmark_names is not a JSON list of texts; add the metadata landmark",
    ),
    "datasets": (NAMED | {"datasets": '{"a": 1}'}, "cannot be read ("),
}


@pytest.mark.parametrize("fault", COLUMNS)
def test_a_column_that_is_wrong(write, problems, fault):
    columns, message = COLUMNS[fault]
    path = write(**columns)
    (line,) = problems(load, path)
    assert line.startswith(f"{path}: {message.format(path=path)}")


@pytest.mark.parametrize("fault", METADATA)
def test_metadata_that_are_wrong(write, problems, fault):
    metadata, message = METADATA[fault]
    path = write(metadata)
    (line,) = problems(load, path)
    assert line.startswith(f"{path}: {message}")


@pytest.mark.parametrize("length", [4, 5, 40, 200, 500, -20, -9, -1])
def test_a_file_that_is_cut_off(write, problems, length):
    path = write()
    path.write_bytes(path.read_bytes()[:length])
    (line,) = problems(load, path)
    assert line.startswith(f"{path}: cannot be read (")
    assert line.endswith("the file may be cut off or damaged: copy or make it again")


def test_bytes_that_are_damaged_are_an_input_error_or_other_values(write):
    path = write()
    sound = path.read_bytes()
    outcomes = set()
    for place in range(4, len(sound) - 8, 5):
        path.write_bytes(sound[:place] + bytes([sound[place] ^ 0x55]) + sound[place + 1 :])
        try:
            load(path)
            outcomes.add("read")
        except InputError:
            outcomes.add("refused")
    assert "refused" in outcomes


def test_more_than_memory_is_refused(write, problems, monkeypatch):
    path = write(item=[f"i{n}" for n in range(2000)], x=[[1.0, 2.0]] * 2000, y=[[1.0, 2.0]] * 2000)
    monkeypatch.setattr(memory, "ALWAYS_FITS", 0)
    monkeypatch.setattr(memory, "free_memory", lambda: 1000)
    (line,) = problems(load, path)
    assert "of memory, and 1 kB are free; divide the file" in line


def test_counts_that_do_not_fit_their_lists(tmp_path, results, rng):
    proved = results.replaced(
        transform_count=[1, 0, 2, 0, 0],
        transform_atom=[1, 2, 3],
        active_transforms=rng.normal(size=(3, 2, 3)),
    )
    path = tmp_path / "r.parquet"
    save(path, proved)
    table = pq.read_table(path)
    assert table.column("transform_atom").to_pylist() == [[1], [], [2, 3], [], []]
    place = table.schema.get_field_index("transform_count")
    counts = pa.array([1, 1, 2, 0, 0], pa.int32())
    pq.write_table(table.set_column(place, "transform_count", counts), path)
    with pytest.raises(
        InputError, match=r"transform_atom, row 1: holds 0 values, and transform_co"
    ):
        read_results(path, proofs=True)


def test_standard_output_is_refused():
    with pytest.raises(InputError, match="cannot go to standard output; name a file"):
        record_writer(Path("-"), SHAPES, to="parquet").__enter__()


def test_a_pipe_is_refused(write):
    command = [sys.executable, "-m", "shapefit", "convert", "-", "-o", "out.h5"]
    path = write()
    with path.open("rb") as file:
        ended = subprocess.run(
            command, stdin=file, capture_output=True, text=True, check=False, cwd=path.parent
        )
    assert ended.returncode == 2
    assert "is Parquet, which cannot come through a pipe; name the file itself" in ended.stderr


def test_without_pyarrow_the_fix_is_named(write, problems, without_pyarrow):
    path = write()
    fix = "these files need the library pyarrow, which is not installed; run `pip install "
    (line,) = problems(load, path)
    assert line.startswith(f"Parquet: {fix}")
    (line,) = problems(lambda: landmark_writer(path).__enter__())
    assert line.startswith(f"Parquet: {fix}")


def test_a_writing_that_fails_leaves_the_old_file(tmp_path, landmarks):
    path = tmp_path / "views.parquet"
    path.write_bytes(b"old")
    other = landmarks.replaced(confidence=None)

    def write():
        save(path, landmarks, other)

    with pytest.raises(ValueError, match="not those of the first"):
        write()
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["views.parquet"]


@pytest.mark.parametrize("column", ["x", "further", "sequence"])
def test_a_small_file_of_large_rows_is_refused_before_it_is_read(tmp_path, monkeypatch, column):
    many = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(10**7)), 10**7)
    large = pa.array(["x" * 10**8]) if column == "sequence" else many
    columns = {"item": ["a"], "x": [[1.0, 2.0]], "y": [[1.0, 2.0]]} | {column: large}
    table = pa.table(columns).replace_schema_metadata({"landmark_names": json.dumps(["p", "q"])})
    path = tmp_path / "bomb.parquet"
    pq.write_table(table, path, compression="zstd")
    assert path.stat().st_size < 10**5
    monkeypatch.setattr("shapefit.io.memory.free_memory", lambda: 10**8)
    with pytest.raises(InputError, match=r"bomb\.parquet"), open_landmarks([path]) as source:
        list(source.chunks(1))
