"""Tidy tables: what is read, whatever the way they are spelled."""

import csv
import io
import random
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from shapefit.io import (
    inputs,
)
from shapefit.io.csv_file import read_csv
from shapefit.records import Landmarks
from tests.io.files import load

VIEWS = """\
item,landmark,x,y,confidence,sequence
a,head,1,2,0.5,s
a,foot,3.5,-4e-1,1,s
b,foot,,nan,0,t
"""


SPELLINGS = [
    VIEWS,
    VIEWS.replace("\n", "\r\n"),
    "\ufeff" + VIEWS,
    VIEWS.rstrip("\n"),
    VIEWS.replace("\n", "\n\n") + ",,,,,\n",
    VIEWS.replace("x,y", " x , y").replace(",2,", ", 2 ,"),
    VIEWS.replace(",", ", "),
    VIEWS.replace(",", "\t,"),
    VIEWS.replace("head", '"head"').replace("3.5", '"3.5"'),
    VIEWS.replace("item,landmark", '"item","landmark"'),
]
"""The same table: ends of lines, a byte order mark, empty lines, spaces, quotes."""


def check_views(views):
    """Assert that these are the two images of VIEWS."""
    assert views.items == ("a", "b")
    assert views.landmark_names == ("head", "foot")
    assert views.sequences == ("s", "t")
    first, second = views.landmarks
    assert_array_equal(first, [[1, 2], [3.5, -0.4]])
    assert np.isnan(second).all()
    assert_array_equal(views.confidence, [[0.5, 1], [0, 0]])


# What is read


@pytest.mark.parametrize("text", SPELLINGS)
def test_ways_to_write_the_same_table(csv_table, text, read_views):
    views = read_views(csv_table(text))
    check_views(views)


def test_the_suffix_does_not_count(csv_table, read_views):
    views = read_views(csv_table(VIEWS, "table.txt"))
    check_views(views)


def test_standard_input_is_read(standard_input, read_views):
    standard_input(VIEWS)
    views = read_views(Path("-"))
    check_views(views)


def test_a_pipe_is_read(fill_pipe, read_views):
    pipe = fill_pipe(VIEWS.encode())
    views = read_views(pipe)
    check_views(views)


PLAIN_NAMES = st.text(st.sampled_from("ab1. é'\t\u2028\x0b"), min_size=1, max_size=4)


QUOTED_NAMES = st.text(st.sampled_from("ab \",\n\r'"), min_size=1, max_size=4)


NAMES = PLAIN_NAMES | QUOTED_NAMES


def write_shuffled(
    rows: list[tuple[str, str, float, float]], chance: random.Random
) -> bytes:
    """Return a table of these items, landmarks and positions, its columns in any order,
    with quotes where they are needed or everywhere.
    """
    columns = ["item", "landmark", "x", "y"]
    chance.shuffle(columns)
    names = "".join(item + landmark for item, landmark, _, _ in rows)
    quoting = csv.QUOTE_ALL
    if "\r" not in names:
        quoting = chance.choice([csv.QUOTE_MINIMAL, csv.QUOTE_ALL])
    out = io.StringIO(newline="")
    writer = csv.DictWriter(out, columns, quoting=quoting, lineterminator="\n")
    writer.writeheader()
    for item, landmark, x, y in rows:
        writer.writerow({"item": item, "landmark": landmark, "x": x, "y": y})
    return out.getvalue().encode()


def unique(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names once each, as they first come."""
    return tuple(dict.fromkeys(names))


def seen_points(views: Landmarks) -> dict[tuple[str, str], tuple[float, float]]:
    """Return item and landmark -> position, of those that are seen."""
    points = {}
    seen = np.isfinite(views.landmarks[..., 0])
    for i, j in np.argwhere(seen):
        name = (views.items[i], views.landmark_names[j])
        points[name] = tuple(views.landmarks[i, j])
    return points


@given(
    items=st.lists(NAMES, min_size=1, max_size=4, unique=True),
    landmarks=st.lists(NAMES, min_size=1, max_size=3, unique=True),
    chance=st.randoms(use_true_random=False),
    block_size=st.sampled_from([1, 7, 64, 1 << 16]),
)
@settings(max_examples=60, deadline=None)
def test_neither_order_nor_quotes_nor_blocks_count(
    tmp_path_factory, items, landmarks, chance, block_size
):
    """Rows and columns in any order, some missing, with or without quotes: what the
    rows say.
    """
    path = tmp_path_factory.mktemp("table") / "t.csv"
    rows = [
        (item, landmark, i + 0.5, float(-j))
        for i, item in enumerate(items)
        for j, landmark in enumerate(landmarks)
    ]
    chance.shuffle(rows)
    rows = rows[: chance.randint(1, len(rows))]
    path.write_bytes(write_shuffled(rows, chance))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(inputs, "BLOCK_BYTES", block_size)
        views = read_csv(path, "landmarks")
    assert views.items == unique([item for item, *_ in rows])
    assert views.landmark_names == unique([landmark for _, landmark, *_ in rows])
    expected = {(item, landmark): (x, y) for item, landmark, x, y in rows}
    assert seen_points(views) == expected


@pytest.mark.parametrize("cells", ["1,", ",2", "nan,2", "1,NaN"])
def test_a_landmark_with_half_a_position_is_unseen(csv_table, cells, read_views):
    views = read_views(csv_table(f"item,landmark,x,y\na,head,{cells}\na,foot,1,2\n"))
    unseen = [np.nan, np.nan]
    assert_array_equal(views.landmarks, [[unseen, [1, 2]]])


def test_columns_that_a_table_lacks_are_absent(csv_table, read_views):
    views = read_views(csv_table("item,landmark,x,y\na,foot,1,2\n"))
    assert views.confidence is None
    assert views.sequences is None


HEADER = "item,landmark,x,y"


ROWS_WITH_MINUS_ONE = ["a,nose,-1,-1", "a,tail,50,-1", "a,ear,60,70"]


def test_minus_one_without_a_confidence_is_unseen(csv_table):
    table = "\n".join([HEADER, *ROWS_WITH_MINUS_ONE])
    visible = load(csv_table(table)).visible()
    assert visible.tolist() == [[False, True, True]]


def test_minus_one_with_a_confidence_is_seen(csv_table):
    scored = [f"{row},1" for row in ROWS_WITH_MINUS_ONE]
    table = "\n".join([f"{HEADER},confidence", *scored])
    visible = load(csv_table(table)).visible()
    assert visible.all()
