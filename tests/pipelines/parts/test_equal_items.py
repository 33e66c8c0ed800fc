"""Items that are in two parts are found, all of them and no others."""

import subprocess
import sys
import tracemalloc
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shapefit.config import load_config
from shapefit.io import names
from shapefit.pipelines.parts import equal_items
from shapefit.pipelines.parts.equal_items import Span, find_equal, overlapping
from shapefit.pipelines.parts.run import run
from tests.pipelines.parts.made import make_dictionary, make_images
from tests.pipelines.told import texts


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


def test_equal_hashes_are_not_equal_names(parts, monkeypatch):
    monkeypatch.setattr(names, "hashed", lambda names: np.zeros(len(names), np.uint64))
    equal = find_equal(parts(("a", "b"), ("c", "b"), ("b", "d")))
    assert equal.count == 1
    assert [path.name for path in equal.examples[0][1:]] == ["part-00000.h5", "part-00001.h5"]


def test_hashes_are_the_same_in_all_processes():
    said = "from shapefit.io.names import stable_hashes as h; print(*h(('a', 'b')).tolist())"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.split() == list(map(str, names.stable_hashes(("a", "b")).tolist()))


def test_none_within_one_part(parts):
    assert find_equal(parts(("a", "a"), ("b",))).count == 0


def test_memory_is_that_of_hashes(tmp_path, monkeypatch):
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
    assert peak < 20e6  # 10^6 hashes are 8 MB, and are sorted once


def test_a_run_reports_them(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_dictionary(Path("dict.h5"), rng)
    for name, start in (("one.h5", 0), ("two.h5", 8)):
        make_images(name, rng.normal(size=(10, 2, 8)), start)
    inputs = {"landmarks": ("one.h5", "two.h5"), "dictionary": "dict.h5", "output": "out/"}
    outcomes = list(run(load_config("fit", None, (), inputs)))
    (warning,) = [told for told in texts(outcomes) if "part" in told]
    assert warning.startswith("2 items in more than one part")
    assert "'i8' in part-00000.h5 and part-00001.h5" in warning
    with h5py.File("out/part-00001.h5") as file:
        assert len(file["item"]) == 10
    assert {path.name for path in Path("out").iterdir()} == {
        *("manifest.json", ".lock", "part-00000.h5", "part-00001.h5")
    }


some_names = st.text("ab01/", min_size=1, max_size=4)


@given(st.lists(st.lists(some_names, min_size=1, max_size=5), max_size=8))
def test_no_pair_with_a_common_name_is_left_out(parts):
    groups = overlapping({key: Span.of(items) for key, items in enumerate(parts)})
    together = {frozenset(pair) for group in groups for pair in combinations(group, 2)}
    for a, b in combinations(range(len(parts)), 2):
        if set(parts[a]) & set(parts[b]):
            assert frozenset((a, b)) in together


@pytest.mark.parametrize(
    "form", ["image{:06}", "image{}", "{}.jpg"], ids=["fixed width", "numbers", "files"]
)
def test_numbered_images_are_apart(form):
    parts = {
        start: [form.format(n) for n in range(start, start + 250)] for start in range(0, 5000, 250)
    }
    assert overlapping({key: Span.of(items) for key, items in parts.items()}) == []


def test_folders_are_apart():
    cameras = {key: [f"{key}/{n}" for n in range(0, 2000, 7)] for key in ("a", "bee", "c")}
    assert overlapping({key: Span.of(items) for key, items in cameras.items()}) == []


def test_only_those_that_may_share_a_name_are_together():
    parts = {1: "ad", 2: "be", 3: "x", 4: "yz", 5: "z"}
    groups = overlapping({key: Span.of(items) for key, items in parts.items()})
    assert sorted(map(sorted, groups)) == [[1, 2], [4, 5]]


@given(st.lists(some_names, min_size=1), st.lists(some_names, min_size=1))
def test_a_span_of_two_is_that_of_all(one, two):
    assert Span.of(one) | Span.of(two) == Span.of([*one, *two])
