"""Columns in a file are read like arrays and tuples."""

import errno
import tracemalloc

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import columns, name_index
from shapefit.io.columns import Batched, Column, Texts, stretches
from shapefit.io.name_index import NameIndex, index_of


@pytest.fixture(params=[16, columns.MOST_HELD], ids=["in-the-file", "in-memory"])
def folder(request, monkeypatch, tmp_path):
    monkeypatch.setattr(columns, "MOST_HELD", request.param)
    monkeypatch.setattr(columns, "GAP", 5)
    monkeypatch.setattr(columns, "STRETCH", 9)
    monkeypatch.setattr(name_index, "RUN", 100)
    yield tmp_path
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("shape", [(), (2,), (3, 2)], ids=["numbers", "pairs", "matrices"])
def test_slices_and_rows_are_those_of_an_array(folder, rng, shape):
    column = Column(folder, np.float64, shape)
    parts = [rng.standard_normal((n, *shape)) for n in (0, 3, 40, 1, 0, 90, 16, 7)]
    for part in parts:
        column.append(part)
    whole = np.concatenate(parts)
    assert len(column) == len(whole)
    for start, stop in [(0, 0), (0, None), (3, 20), (15, 17), (150, 400), (-9, None)]:
        np.testing.assert_array_equal(column[start:stop], whole[start:stop])
    rows = rng.integers(0, len(whole), 60)
    np.testing.assert_array_equal(column.take(rows), whole[rows])


@pytest.mark.parametrize("size", [1, 7, 50, 1000])
def test_rows_are_replaced_in_their_place(folder, rng, size):
    column, whole = Column(folder, np.float64, (2,)), rng.standard_normal((100, 2))
    other = Column(folder, np.float64)
    for part in np.array_split(whole, 9):
        column.append(part)
        other.append(part[:, 0])
    batched = Batched(column, size)
    for rows in batched.slices():
        column[rows] = -column[rows]
    np.testing.assert_array_equal(np.concatenate(list(batched)), -whole)
    np.testing.assert_array_equal(other[:], whole[:, 0])


def test_a_column_grows_by_what_is_made_of_its_rows(folder):
    column = Column(folder, np.int64)
    column.append(np.arange(40))
    for rows in Batched(column, 9):
        column.append(-rows)
    np.testing.assert_array_equal(column[:], [*range(40), *range(0, -40, -1)])


def test_what_is_appended_later_is_read_too(folder):
    column = Column(folder, np.int32)
    column.append(np.arange(20))
    assert column[18:].tolist() == [18, 19]
    column.append(np.arange(20, 50))
    np.testing.assert_array_equal(column[:], np.arange(50))


def test_a_column_keeps_what_it_was_given(folder):
    column, values = Column(folder, np.float64), np.zeros(3)
    column.append(values)
    values[:] = 1
    assert column[:].tolist() == [0, 0, 0]


NAMES = ("", *(f"item/{'é' if n % 7 == 0 else 'e'}{n}" * (n % 3 + 1) for n in range(333)))


def test_texts_are_those_of_a_tuple(folder, rng):
    texts = Texts(folder)
    texts.append(NAMES[:100])
    texts.append(NAMES[100:])
    assert (texts[:], texts[3:88], texts[88:3], texts[-2:]) == (NAMES, NAMES[3:88], (), NAMES[-2:])
    assert [text for block in texts.blocks(5, 300) for text in block] == list(NAMES[5:300])
    rows = rng.integers(0, len(NAMES), 50)
    assert texts.take(rows) == tuple(NAMES[row] for row in rows)


@pytest.mark.parametrize("hashing", ["by-hash", "all-hashes-equal"])
def test_names_are_found_at_their_rows(folder, rng, monkeypatch, hashing):
    if hashing == "all-hashes-equal":
        monkeypatch.setattr(name_index, "hash", lambda name: -7, raising=False)
    texts = Texts(folder)
    texts.append(NAMES)
    index = index_of(folder, [NAMES[:250], NAMES[250:]])
    rows = rng.integers(0, len(NAMES), 80)
    asked = [*(NAMES[row] for row in rows), "none", "none", "item/e"]
    np.testing.assert_array_equal(index.find(asked, texts), [*rows, -1, -1, -1])
    np.testing.assert_array_equal(index.find(NAMES[::-1], texts), np.arange(len(NAMES))[::-1])


def test_hashes_that_are_there_twice(folder):
    index = index_of(folder, [NAMES, NAMES[5:8], NAMES[7:9]])
    twice = [int(number) for hashes in index.repeated() for number in hashes]
    assert sorted(twice) == sorted(hash(name) % 2**64 for name in NAMES[5:9])
    assert not any(map(len, NameIndex(folder).repeated()))


def test_near_rows_are_read_together(monkeypatch):
    monkeypatch.setattr(columns, "GAP", 5)
    monkeypatch.setattr(columns, "STRETCH", 10)
    rows = np.array([0, 1, 6, 12, 13, 40])
    assert [rows[part].tolist() for part in stretches(rows)] == [[0, 1, 6], [12, 13], [40]]
    assert list(stretches(rows[:0])) == []
    assert [part.stop for part in stretches(np.arange(25))] == [10, 20, 25]


def test_a_full_disk_is_told(tmp_path, monkeypatch):
    def full(*_arguments, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    column = Column(tmp_path, np.float64)
    monkeypatch.setattr(column._file, "rollover", full)
    column.append(np.zeros(10))
    with pytest.raises(InputError, match="cannot be used for temporary files: No space left"):
        column.append(np.zeros(columns.MOST_HELD))


def test_memory_is_that_of_what_is_held(tmp_path, monkeypatch):
    monkeypatch.setattr(columns, "MOST_HELD", 32_768)
    monkeypatch.setattr(name_index, "RUN", 4096)
    column, index = Column(tmp_path, np.float64), NameIndex(tmp_path)
    tracemalloc.start()
    try:
        for start in range(0, 200_000, 1000):
            column.append(np.arange(start, start + 1000))
            index.add(tuple(map(str, range(start, start + 1000))))
        assert not any(map(len, index.repeated()))
        assert column[70_000:70_001] == 70_000
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.6e6  # the numbers alone are 1.6 MB
