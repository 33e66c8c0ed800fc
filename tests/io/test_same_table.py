"""The same landmarks as a table in every dress, as HDF5 and as arrays: the same items,
landmarks and coordinates, to the bit.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

import shapefit
from tests.io.files import save
from tests.io.readers.made import read_images

ITEMS = ("MVZ 100", "MVZ_7", "x-1")
COUNT = 6

NUMBERINGS = {
    "from 0": [str(number) for number in range(COUNT)],
    "from 1": [str(number) for number in range(1, COUNT + 1)],
    "by names": ["Nose", "left ear", "Tail_tip", "a.b", "P 5", "Käfer"],
}

Rows = list[list[str]]
Points = dict[tuple[str, str], tuple[float, float]]
"""Item and landmark -> x and y."""


def make_points(names: Sequence[str], hidden: Sequence[int]) -> Points:
    """Coordinates with digits to lose, without the landmarks that are hidden."""
    rng = np.random.default_rng(7)
    values = rng.uniform(1, 600, (len(ITEMS), COUNT, 2)) / 3
    return {
        (item, name): (float(x), float(y))
        for item, own in zip(ITEMS, values, strict=True)
        for number, (name, (x, y)) in enumerate(zip(names, own, strict=True))
        if number not in hidden
    }


# Layouts: rows of cells, the first of them the names of the columns.


def long(points: Points, _names: Sequence[str]) -> Rows:
    rows = [[*key, repr(x), repr(y)] for key, (x, y) in points.items()]
    return [["item", "landmark", "x", "y"], *rows]


def with_empty_cells(points: Points, names: Sequence[str]) -> Rows:
    """Hidden landmarks have a row."""
    rows = []
    for item in ITEMS:
        for name in names:
            cells = map(repr, points.get((item, name), ()))
            rows.append([item, name, *cells])
    return [["item", "landmark", "x", "y"], *([*row, "", ""][:4] for row in rows)]


def melted(points: Points, names: Sequence[str]) -> Rows:
    """A landmark after the other, as pandas' melt leaves them."""
    head, *rows = long(points, names)
    return [head, *sorted(rows, key=lambda row: names.index(row[1]))]


def wide(points: Points, names: Sequence[str]) -> Rows:
    shown = [name for name in names if any(key[1] == name for key in points)]
    head = ["item", *(f"{name}_{axis}" for name in shown for axis in "xy")]
    rows = [
        [item, *(repr(v) for name in shown for v in points[item, name])]
        for item in ITEMS
    ]
    return [head, *rows]


def wide_with_empty_cells(points: Points, names: Sequence[str]) -> Rows:
    unknown = ("", "")
    head = ["item", *(f"{axis}_{name}" for name in names for axis in "xy")]
    rows = []
    for item in ITEMS:
        cells = [points.get((item, name), unknown) for name in names]
        rows.append([item, *(str(value) for pair in cells for value in pair)])
    return [head, *rows]


LAYOUTS = (long, with_empty_cells, melted, wide, wide_with_empty_cells)


# Dresses: the text of a table.


def joined(rows: Rows, delimiter: str = ",") -> str:
    return "".join(f"{delimiter.join(row)}\n" for row in rows)


def with_decimal_commas(rows: Rows, delimiter: str = ";") -> str:
    head, *others = rows
    cells = [[as_decimal_comma(cell) for cell in row] for row in others]
    return joined([head, *cells], delimiter)


def as_decimal_comma(cell: str) -> str:
    """Coordinates alone have a point between digits."""
    return cell.replace(".", ",") if cell.replace(".", "").isdigit() else cell


def in_capitals(rows: Rows) -> str:
    """What columns hold; names of landmarks in them stay as they are."""
    head, *others = rows
    shouted = []
    for name in head:
        before, between, axis = name.rpartition("_")
        first = axis in ("x", "y")
        shouted.append(f"{before}{between}{axis.upper()}" if first else name)
    if "landmark" in head:
        shouted = [name.upper() for name in head]
    shouted[0] = shouted[0].upper()
    return joined([shouted, *others])


def with_index_of_pandas(rows: Rows) -> str:
    head, *others = rows
    return joined([["", *head], *([str(n), *row] for n, row in enumerate(others))])


def with_index_of_r(rows: Rows) -> str:
    head, *others = rows
    quoted = [['""', *(f'"{name}"' for name in head)]]
    for number, row in enumerate(others, 1):
        cells = [cell if is_number(cell) or not cell else f'"{cell}"' for cell in row]
        quoted.append([f'"{number}"', *cells])
    return joined(quoted)


def is_number(cell: str) -> bool:
    return cell.replace(".", "").isdigit()


DRESSES: dict[str, Callable[[Rows], str]] = {
    "commas": joined,
    "semicolons": lambda rows: joined(rows, ";"),
    "decimal commas": with_decimal_commas,
    "tabs": lambda rows: joined(rows, "\t"),
    "tabs and decimal commas": lambda rows: with_decimal_commas(rows, "\t"),
    "capitals": in_capitals,
    "index of pandas": with_index_of_pandas,
    "index of R": with_index_of_r,
    "sep=": lambda rows: "sep=;\n" + joined(rows, ";"),
    "BOM and CRLF": lambda rows: "\ufeff" + joined(rows).replace("\n", "\r\n"),
    "CR": lambda rows: joined(rows).replace("\n", "\r"),
}


def seen(images) -> Points:
    """What records or arrays hold, of the landmarks that have a place."""
    return {
        (item, name): (float(x), float(y))
        for item, own in zip(images.items, images.landmarks, strict=True)
        for name, (x, y) in zip(images.landmark_names, own, strict=True)
        if np.isfinite([x, y]).all()
    }


@pytest.mark.parametrize("hidden", [(), (0,), (COUNT - 1,), (0, COUNT - 1)], ids=str)
@pytest.mark.parametrize("names", NUMBERINGS.values(), ids=NUMBERINGS)
@pytest.mark.parametrize("dress", DRESSES.values(), ids=DRESSES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_same_landmarks(tmp_path, layout, dress, names, hidden):
    points = make_points(names, hidden)
    path = tmp_path / "t.csv"
    path.write_bytes(dress(layout(points, names)).encode())
    images, _ = read_images(path)
    assert images.items == ITEMS
    assert [*images.landmark_names] == [
        name for name in names if name in images.landmark_names
    ]
    assert images.sequences is None
    assert seen(images) == points


@pytest.mark.parametrize("hidden", [(), (0, COUNT - 1)], ids=str)
@pytest.mark.parametrize("names", NUMBERINGS.values(), ids=NUMBERINGS)
def test_the_same_landmarks_in_hdf5_and_python(tmp_path: Path, names, hidden):
    points = make_points(names, hidden)
    path = tmp_path / "t.csv"
    path.write_text(joined(with_empty_cells(points, names), ";"), encoding="utf-8")
    images, _ = read_images(path)
    for name in ("t.h5", "again.csv"):
        save(tmp_path / name, images)
        again, _ = read_images(tmp_path / name)
        assert again.items == ITEMS
        assert seen(again) == points
    in_python = shapefit.read_landmarks(path)
    assert seen(in_python) == points
    shapefit.write_landmarks(tmp_path / "python.h5", in_python)
    again, _ = read_images(tmp_path / "python.h5")
    assert again.items == ITEMS
    assert seen(again) == points
