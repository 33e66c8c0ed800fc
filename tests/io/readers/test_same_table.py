"""The same landmarks as tables of all kinds: the same items, landmarks, coordinates."""

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import shapefit
from shapefit.io import open_landmarks, open_shapes
from shapefit.io.options import InputOptions

ITEMS = ("MVZ_100", "MVZ 103", "12", "img_0004")
NAMES = {
    "names": ("nose", "left ear", "Ohr", "p_4", "5th"),
    "from 0": ("0", "1", "2", "3", "4"),
    "from 1": ("1", "2", "3", "4", "5"),
}
Row = list[str]


@pytest.fixture
def points(rng) -> np.ndarray:
    """Points (n, p, 3) of few digits, without a value twice."""
    return np.round(rng.uniform(-50, 900, (4, 5, 3)), 3)


def long(names: Sequence[str], points: np.ndarray) -> list[Row]:
    """Return a header, and a row for each landmark that is seen in an image."""
    axes = "xyz"[: points.shape[2]]
    rows = [["item", "landmark", *axes]]
    for item, own in zip(ITEMS, points.tolist(), strict=True):
        for name, place in zip(names, own, strict=True):
            if place[0] == place[0]:
                rows.append([item, name, *map(repr, place)])
    return rows


def wide(names: Sequence[str], points: np.ndarray, column: str = "{}_{}") -> list[Row]:
    """Return a header, and a row for each image."""
    axes = "xyz"[: points.shape[2]]
    header = [column.format(name, axis) for name in names for axis in axes]
    rows = [
        [item, *("" if cell != cell else repr(cell) for cell in own.ravel().tolist())]
        for item, own in zip(ITEMS, points, strict=True)
    ]
    return [["item", *header], *rows]


def text_of(rows: list[Row], delimiter: str = ",", **quoting: int) -> str:
    file = io.StringIO()
    csv.writer(file, delimiter=delimiter, lineterminator="\n", **quoting).writerows(
        rows
    )
    return file.getvalue()


def decimal_commas(rows: list[Row], first: int) -> list[Row]:
    """Return rows whose numbers, from a column on, have commas."""
    head, *body = rows
    return [
        head,
        *(
            [*row[:first], *(cell.replace(".", ",") for cell in row[first:])]
            for row in body
        ),
    ]


def numbered(rows: list[Row], name: str, start: int) -> list[Row]:
    """Return rows after a column of numbers, as pandas and R write them."""
    head, *body = rows
    return [
        [name, *head],
        *([str(row), *cells] for row, cells in enumerate(body, start)),
    ]


def capitals(rows: list[Row]) -> list[Row]:
    head, *body = rows
    return [[name.title() for name in head], *body]


def by_landmark(rows: list[Row]) -> list[Row]:
    """Return a long table as pandas' melt leaves it: landmark after landmark."""
    head, *body = rows
    landmarks = list(dict.fromkeys(row[1] for row in body))
    return [head, *sorted(body, key=lambda row: landmarks.index(row[1]))]


LONG: dict[str, Callable[[list[Row]], str | bytes]] = {
    "commas": text_of,
    "commas and quotes": lambda rows: text_of(rows, quoting=csv.QUOTE_ALL),
    "semicolons": lambda rows: text_of(rows, ";"),
    "semicolons, decimal commas": lambda rows: text_of(decimal_commas(rows, 2), ";"),
    "sep=": lambda rows: "sep=;\n" + text_of(decimal_commas(rows, 2), ";"),
    "tabs": lambda rows: text_of(rows, "\t"),
    "capitals": lambda rows: text_of(capitals(rows)),
    "capitals, semicolons": lambda rows: text_of(capitals(rows), ";"),
    "melted": lambda rows: text_of(by_landmark(rows)),
    "melted, tabs": lambda rows: text_of(by_landmark(rows), "\t"),
    "index of pandas": lambda rows: text_of(numbered(rows, "", 0)),
    "index of pandas, read again": lambda rows: text_of(
        numbered(rows, "Unnamed: 0", 0)
    ),
    "index of R": lambda rows: text_of(numbered(rows, "", 1), quoting=csv.QUOTE_ALL),
    "CR LF": lambda rows: text_of(rows).replace("\n", "\r\n"),
    "CR": lambda rows: text_of(rows).replace("\n", "\r"),
    "CR, tabs": lambda rows: text_of(rows, "\t").replace("\n", "\r"),
    "UTF-16": lambda rows: text_of(rows, "\t").encode("utf-16"),
    "UTF-16, commas": lambda rows: text_of(rows).encode("utf-16"),
    "mark": lambda rows: "\ufeff" + text_of(rows),
    "item in another column": lambda rows: text_of(
        [[*row[1:], row[0]] for row in rows]
    ),
    "called image": lambda rows: text_of(rows).replace("item", "image", 1),
    "called specimen": lambda rows: text_of(rows).replace("item", "specimen", 1),
    "called as nobody else does": lambda rows: text_of(rows).replace(
        "item", "Taxon", 1
    ),
    "without a name": lambda rows: text_of(rows).replace("item", "", 1),
}
WIDE: dict[str, Callable[[list[Row]], str | bytes]] = {
    name: LONG[name]
    for name in (
        "commas",
        "commas and quotes",
        "semicolons",
        "tabs",
        "CR",
        "UTF-16",
        "index of pandas",
        "index of R",
        "called image",
        "called specimen",
        "called as nobody else does",
        "without a name",
    )
} | {
    "decimal commas": lambda rows: text_of(decimal_commas(rows, 1), ";"),
    "sep=": lambda rows: "sep=\t\n" + text_of(decimal_commas(rows, 1), "\t"),
}


def read(path: Path, kind: str) -> shapefit.Landmarks | shapefit.Shapes:
    opened = open_landmarks if kind == "landmarks" else open_shapes
    more = {} if kind == "landmarks" else {"gaps": True}
    with opened([path], InputOptions(), **more) as source:
        return source.whole()


def check(records, names: Sequence[str], points: np.ndarray) -> None:
    """Compare what was read with what was written; landmarks in any order."""
    assert records.items == ITEMS
    assert records.sequences is None or not any(records.sequences)
    seen = [
        n
        for n, own in zip(names, points.swapaxes(0, 1), strict=True)
        if np.isfinite(own).any()
    ]
    columns = records.points.transpose(1, 0, 2)
    found = dict(zip(records.landmark_names, columns, strict=True))
    assert [*filter(found.__contains__, names)] == [*names] or sorted(found) == sorted(
        seen
    )
    for name, own in zip(names, points.swapaxes(0, 1), strict=True):
        if name in found:
            assert_array_equal(found[name], own)


@pytest.mark.parametrize("called", NAMES)
@pytest.mark.parametrize("hidden", [False, True], ids=["all", "hidden ends"])
@pytest.mark.parametrize("kind", ["landmarks", "shapes"])
@pytest.mark.parametrize(
    "form", [*(f"long, {n}" for n in LONG), *(f"wide, {n}" for n in WIDE)]
)
def test_tables_that_say_the_same(tmp_path, points, called, hidden, kind, form):
    names = NAMES[called]
    points = points[..., : 2 if kind == "landmarks" else 3]
    if hidden:
        points[:, [0, -1]] = np.nan
    layout, _, variant = form.partition(", ")
    if layout == "long":
        content = LONG[variant](long(names, points))
    else:
        content = WIDE[variant](wide(names, points))
    path = tmp_path / "images.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    check(read(path, kind), names, points)


@pytest.mark.parametrize("called", ["from 0", "from 1"])
@pytest.mark.parametrize("column", ["{1}{0}", "{1}_{0}", "{0}_{1}"])
def test_numbers_in_names_of_columns_stay(tmp_path, points, called, column):
    path = tmp_path / "images.csv"
    path.write_text(text_of(wide(NAMES[called], points[..., :2], column)))
    records = read(path, "landmarks")
    assert records.landmark_names == NAMES[called]
    check(records, NAMES[called], points[..., :2])


@pytest.mark.parametrize("called", NAMES)
@pytest.mark.parametrize("kind", ["landmarks", "shapes"])
def test_hdf5_and_python_say_the_same(tmp_path, points, called, kind):
    names = NAMES[called]
    points = points[..., : 2 if kind == "landmarks" else 3]
    path = tmp_path / "images.h5"
    if kind == "landmarks":
        given = shapefit.Landmarks(points, landmark_names=names, items=ITEMS)
        shapefit.write_landmarks(path, given)
        check(read(path, kind), names, points)
        check(given, names, points)
    else:
        given = shapefit.Shapes(points, landmark_names=names, items=ITEMS)
        shapefit.write_shapes(path, given)
        check(read(path, kind), names, points)
        check(given, names, points)
