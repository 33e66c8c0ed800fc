"""Row groups: rows are the same whatever they are, and what was decoded is let go."""

import gc
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shapefit.io import landmark_writer, open_landmarks
from shapefit.io.kinds import opening
from shapefit.io.parquet import library, writing
from shapefit.io.records import LandmarkSet

COUNT = 300


@pytest.fixture
def images(rng) -> LandmarkSet:
    return LandmarkSet(
        landmarks=rng.normal(size=(COUNT, 2, 3)),
        landmark_names=("a", "b", "c"),
        items=tuple(f"i{n}" for n in range(COUNT)),
        sequences=tuple(f"s{n // 50}" for n in range(COUNT)),
    )


@pytest.fixture
def write(tmp_path, images) -> Callable[..., Path]:
    """Write the images in row groups of so many rows, as records of so many."""

    def written(rows: int, size: int = COUNT, name: str = "images.parquet") -> Path:
        with landmark_writer(tmp_path / "ours.parquet") as writer:
            for start in range(0, COUNT, size):
                writer.append(images.take(slice(start, start + size)))
        table = pq.read_table(tmp_path / "ours.parquet")
        pq.write_table(table, tmp_path / name, row_group_size=rows)
        return tmp_path / name

    return written


@pytest.mark.parametrize("size", [1, 7, 64, 1000])
@pytest.mark.parametrize("rows", [10, 64, 300])
def test_rows_are_the_same_whatever_the_row_groups(write, images, rows, size, same, monkeypatch):
    monkeypatch.setattr(library, "BATCH", 13)
    path = write(rows)
    with open_landmarks([path]) as source:
        start = 0
        for chunk in source.chunks(size):
            same(chunk, images.take(slice(start, start + len(chunk))))
            start += len(chunk)
    assert start == COUNT
    for first, last in ((0, 64), (64, 300), (299, 300), (10, 10), (63, 65)):
        with open_landmarks([path], rows=slice(first, last)) as source:
            same(source.whole(), images.take(slice(first, last)))


@pytest.mark.parametrize("size", [1, 100, 299])
def test_a_file_does_not_depend_on_how_its_records_came(tmp_path, images, size, monkeypatch):
    monkeypatch.setattr(writing, "MOST_ROWS", 128)
    written = []
    for each in (COUNT, size):
        path = tmp_path / f"{each}.parquet"
        with landmark_writer(path) as writer:
            for start in range(0, COUNT, each):
                writer.append(images.take(slice(start, start + each)))
        written.append(path.read_bytes())
    assert written[0] == written[1]
    groups = pq.read_metadata(path)
    assert [groups.row_group(g).num_rows for g in range(groups.num_row_groups)] == [128, 128, 44]


def test_a_file_that_is_closed_takes_no_memory(write, monkeypatch):
    monkeypatch.setattr(opening, "MOST_HELD", 0)
    path = write(COUNT)
    with open_landmarks([path]) as source:  # what the library keeps of its first use
        next(iter(source.chunks(10)))
    gc.collect()
    gc.disable()
    try:
        before = pa.total_allocated_bytes()
        with open_landmarks([path]) as source:
            next(iter(source.chunks(10)))
            assert pa.total_allocated_bytes() > before
        assert pa.total_allocated_bytes() == before
    finally:
        gc.enable()
