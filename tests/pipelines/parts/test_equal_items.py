"""Items that are in two parts are found, all of them and no others."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.dictionary.model import Dictionary
from shapefit.io import landmark_writer, name_index, write_dictionary
from shapefit.io.records import LandmarkSet
from shapefit.pipelines.parts import equal_items
from shapefit.pipelines.parts.equal_items import find_equal
from shapefit.pipelines.parts.run import run

NAMES = tuple("abcdef")


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """A function that names the items of parts, which it makes without reading what else is."""
    made: dict[Path, tuple[str, ...]] = {}

    def make(*items: tuple[str, ...]) -> list[Path]:
        made.update({tmp_path / f"part-{n:05}.h5": names for n, names in enumerate(items)})
        return list(made)

    monkeypatch.setattr(equal_items, "_items", lambda part: iter([made[part]]))
    return make


def test_all_and_no_others(parts, rng):
    numbers = rng.integers(0, 3000, size=(5, 500))
    rows = [tuple(f"i{n}" for n in np.unique(row)) for row in numbers]
    flat = [name for row in rows for name in row]
    expected = {name for name in flat if flat.count(name) > 1}
    equal = find_equal(parts(*rows))
    assert equal.count == len(expected) > 100
    assert equal.examples[0][0] == min(expected)
    assert len(equal.examples) == 3


def test_several_readings_find_the_same(parts, monkeypatch):
    rows = [tuple(f"i{n}" for n in range(start, start + 1000)) for start in (0, 500, 900)]
    once = find_equal(parts(*rows))
    monkeypatch.setattr(name_index, "MOST_COMPARED", 7)
    assert find_equal(parts(*rows)) == once
    assert once.count == 500 + 500


def test_equal_hashes_are_not_equal_names(parts, monkeypatch):
    monkeypatch.setattr(name_index, "hashed", lambda names: np.zeros(len(names), np.uint64))
    equal = find_equal(parts(("a", "b"), ("c", "b"), ("b", "d")))
    assert equal.count == 1
    assert [path.name for path in equal.examples[0][1:]] == ["part-00000.h5", "part-00001.h5"]


def test_none_within_one_part(parts):
    assert find_equal(parts(("a", "a"), ("b",))).count == 0


def test_memory_is_that_of_a_block(tmp_path, monkeypatch):
    paths = [tmp_path / f"part-{n:05}.h5" for n in range(200)]
    block = 5000

    def items(part: Path):
        start = paths.index(part) * block
        yield tuple(f"image/{n:09}" for n in range(start, start + block))

    monkeypatch.setattr(equal_items, "_items", items)
    tracemalloc.start()
    try:
        assert find_equal(paths).count == 0
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 5e6  # 10^6 hashes alone are 8 MB


def test_a_run_reports_them(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    atoms = rng.normal(size=(4, 3, 6))
    write_dictionary(Path("dict.h5"), Dictionary(atoms, NAMES, atoms[0]))
    for name, start in (("one", 0), ("two", 8)):
        with landmark_writer(Path(f"{name}.h5")) as writer:
            items = tuple(f"i{n}" for n in range(start, start + 10))
            points = rng.normal(size=(10, 2, 6))
            writer.append(LandmarkSet(landmarks=points, landmark_names=NAMES, items=items))
    inputs = {"landmarks": ("one.h5", "two.h5"), "dictionary": "dict.h5", "output": "out/"}
    outcomes = list(run(load_config("fit", None, (), inputs)))
    (warning,) = [str(w) for outcome in outcomes for w in outcome.warnings if "part" in str(w)]
    assert warning.startswith("2 items in more than one part")
    assert "'i8' in part-00000.h5 and part-00001.h5" in warning
    with h5py.File("out/part-00001.h5") as file:
        assert len(file["item"]) == 10
    assert {path.name for path in Path("out").iterdir()} == {
        *("manifest.json", ".lock", "part-00000.h5", "part-00001.h5")
    }
