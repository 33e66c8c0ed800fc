"""Names of files for items: safe, readable, and never the same for two items."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shapefit.io.whole.item_files import file_stem

ODD = '/.% <>:"|?*\\\n\0ab é'


@pytest.mark.parametrize(
    ("item", "stem"),
    [
        ("image171206_car0000", "image171206_car0000"),
        ("walk_emil/020", "walk_emil/020"),
        ("Škoda Fabia (2005), no. 3", "Škoda Fabia (2005), no. 3"),
        ("汽车/1", "汽车/1"),
        ("..", "%2E%2E"),
        ("../../etc/passwd", "%2E%2E/%2E%2E/etc/passwd"),
        ("/etc/passwd", "%/etc/passwd"),
        ("a//b", "a/%/b"),
        ("", "%"),
        (".hidden", "%2Ehidden"),
        ("c:\\x", "c%3A%5Cx"),
        ("two\nlines", "two%0Alines"),
        (" a ", "%20a%20"),
        ("50%", "50%25"),
        ("a\0b", "a%00b"),
    ],
)
def test_names_are_readable_and_lead_nowhere_else(item, stem):
    assert str(file_stem(item)) == stem


@given(st.text(alphabet=ODD, max_size=8))
def test_a_name_stays_in_its_folder(item):
    stem = file_stem(item)
    assert not stem.is_absolute()
    assert stem.parts == tuple(str(stem).split("/"))
    for part in stem.parts:
        assert part.strip(" .") == part
        assert part
        assert not set(part) & set('<>:"|?*\\\n\0')


@given(st.lists(st.text(alphabet=ODD, max_size=8), unique=True, max_size=20))
def test_different_items_have_different_names(items):
    assert len({file_stem(item) for item in items}) == len(items)


def test_long_names_are_cut_and_stay_apart():
    items = ["ü" * 100 + ending for ending in "abc"] + ["x" * 300, "x" * 301 + "/y"]
    stems = [file_stem(item) for item in items]
    for first, second in combinations(stems, 2):
        assert first != second
    for stem in stems:
        assert all(len(part.encode()) <= 200 for part in stem.parts)
    assert stems[0].name.startswith("ü" * 90 + "%-")
    assert stems[-1].name == "y"


@pytest.mark.parametrize(
    ("item", "whole"),
    [
        ("/".join(["ü" * 200] * 25), 2),  # of 180 bytes and 18 of the digest each
        ("/".join("a" * 3000), 31),
        ("/".join(["b" * 18] * 31 + ["c" * 20]), 22),  # 609 bytes
        ("/".join(["b" * 18] * 31 + ["c" * 11]), 32),  # 600 bytes
        ("/".join("d" * 33), 31),
        ("/".join("d" * 32), 32),
    ],
)
def test_long_paths_are_cut_and_stay_apart(item, whole):
    stem = file_stem(item)
    assert len(bytes(stem)) <= 600
    assert len(stem.parts) <= 32
    kept = [file_stem(part).name for part in item.split("/")]
    assert list(stem.parts[:whole]) == kept[:whole]
    assert len(stem.parts) == whole + (whole < len(kept))
    assert len({stem, file_stem(f"{item}/e"), file_stem(f"{item}e")}) == 3
