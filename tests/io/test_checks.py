"""Numbers that stand for missing landmarks, and names in two spellings of Unicode."""

import unicodedata

import numpy as np
import pytest
from numpy.testing import assert_allclose

import shapefit
from shapefit.errors import InputError
from shapefit.io import open_landmarks, open_shapes
from shapefit.io.checks import warn_of_codes
from shapefit.io.options import InputOptions
from shapefit.records import Landmarks
from tests.io.files import load, save

SIZE = (20, 10, 2)


@pytest.fixture
def points(rng) -> np.ndarray:
    return np.round(rng.uniform(200, 900, SIZE), 2)


@pytest.mark.parametrize("code", [-999.0, 9999.0, -100.0, -9.0, 1e6, -1000.0])
@pytest.mark.parametrize("axes", [2, 3])
def test_a_code_of_missing_points_is_named(rng, code, axes):
    points = rng.uniform(200, 900, (20, 10, axes))
    points[::2, 3] = code
    (warning,) = warn_of_codes(points)
    position = ", ".join([f"{code:g}"] * axes)
    assert warning.startswith(f"10 landmarks at ({position}), far from all others")


def test_one_point_alone_must_be_far(points):
    points[4, 3] = -999
    assert "1 landmark at (-999, -999)" in warn_of_codes(points)[0]
    points[4, 3] = 150
    assert warn_of_codes(points) == ()


def test_one_point_that_is_far_is_named(points):
    points[4, 3] = -999
    (warning,) = warn_of_codes(points)
    assert "1 landmark at (-999, -999)" in warning


def test_one_point_that_is_near_is_not_named(points):
    points[4, 3] = 150
    assert warn_of_codes(points) == ()


def test_several_codes(points):
    points[::2, 3] = -999
    points[1::2, 4] = 9999
    first, second = warn_of_codes(points)
    assert first.startswith("10 landmarks at (-999,")
    assert second.startswith("10 landmarks at (9999,")


def put_at(*place_and_value):
    """Return what puts a value at a place of the points."""
    *place, value = place_and_value

    def change(points):
        points[tuple(place)] = value

    return change


NO_CODES = {
    "none": lambda points: None,
    "among the others": put_at(slice(0, 9), 3, 500.0),
    "in one coordinate": put_at(slice(0, 9), 3, 0, -999.0),
    "unknown": put_at(slice(0, 9), 3, np.nan),
}


@pytest.mark.parametrize("change", NO_CODES.values(), ids=NO_CODES)
def test_points_among_others_are_no_codes(points, change):
    change(points)
    assert warn_of_codes(points) == ()


def test_hidden_points_do_not_count(points):
    points[::2, 3] = -999
    weights = np.ones((20, 10))
    weights[::2, 3] = 0
    assert warn_of_codes(points, weights) == ()


def write_tsv(path, write, record):
    """Write a table with tabs: a CSV whose commas are replaced."""
    csv = path.with_suffix(".csv")
    write(csv, record)
    text = csv.read_text(encoding="utf-8")
    path.write_text(text.replace(",", "\t"), encoding="utf-8")


def write_as(path, record):
    """Write landmarks or shapes in the format of the suffix."""
    is_landmarks = isinstance(record, Landmarks)
    write = shapefit.write_landmarks if is_landmarks else shapefit.write_shapes
    if path.suffix == ".tsv":
        write_tsv(path, write, record)
    else:
        write(path, record)


KINDS = {
    "landmarks": (shapefit.Landmarks, 2, open_landmarks),
    "shapes": (shapefit.Shapes, 3, open_shapes),
}
"""Kind -> its record, how many coordinates a point has, and what opens files of it."""


@pytest.mark.parametrize("name", ["a.csv", "a.h5", "a.tsv"])
@pytest.mark.parametrize("kind", KINDS)
def test_codes_are_named_with_their_file(tmp_path, rng, name, kind):
    make_record, dimensions, open_files = KINDS[kind]
    path = tmp_path / name
    points = np.round(rng.uniform(200, 900, (20, 6, dimensions)))
    points[3:7, 2] = -999
    write_as(path, make_record(points, landmark_names=list("abcdef")))
    with open_files([path]) as source:
        (note,) = source.notes
    assert note.startswith(f"{path}: 4 landmarks at (-999, -999")


COMPOSED = unicodedata.normalize("NFC", "éte ö")


DECOMPOSED = unicodedata.normalize("NFD", "éte ö")


OTHER_NAMES = tuple("abcdefghi")


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".h5"])
@pytest.mark.parametrize("names", [(COMPOSED, DECOMPOSED), (DECOMPOSED, COMPOSED)])
def test_names_that_look_the_same_are_the_same(tmp_path, points, suffix, names):
    paths = []
    for number, name in enumerate(names):
        items = [f"{number}{i}" for i in range(len(points))]
        landmarks = shapefit.Landmarks(
            points, landmark_names=[name, *OTHER_NAMES], items=items
        )
        path = tmp_path / f"{number}{suffix}"
        write_as(path, landmarks)
        paths.append(path)
    with open_landmarks(paths) as source:
        assert source.head.landmark_names == (COMPOSED, *OTHER_NAMES)


def test_what_looks_the_same_is_renamed_and_chosen(tmp_path, points):
    path = tmp_path / "a.csv"
    names = [COMPOSED, *OTHER_NAMES]
    shapefit.write_landmarks(path, shapefit.Landmarks(points, landmark_names=names))
    read = shapefit.read_landmarks(path, rename={DECOMPOSED: "q"})
    assert read.landmark_names[0] == "q"


@pytest.mark.parametrize("order", [1, -1])
def test_the_file_that_lacks_a_landmark_is_named(tmp_path, rng, order):
    a = tmp_path / "a.h5"
    b = tmp_path / "b.h5"
    for path, names in ((a, "pqr"), (b, "pqrs")):
        points = rng.normal(size=(4, len(names), 3))
        items = [f"{path.stem}{i}" for i in range(4)]
        shapes = shapefit.Shapes(points, landmark_names=list(names), items=items)
        shapefit.write_shapes(path, shapes)
    files = [a, b][::order]
    with pytest.raises(InputError) as caught:
        open_shapes(files)
    assert str(caught.value) == (
        f"{a}: has no landmark 's', which {b} has; give shapes of the same landmarks,"
        " or name those that all have by `landmarks` (p, q, r)"
    )


@pytest.mark.parametrize("first_numbers", [(0, 1), (1, 0)])
@pytest.mark.parametrize("kind", KINDS)
def test_numbers_from_0_beside_numbers_from_1_are_refused(
    tmp_path, rng, kind, first_numbers
):
    make_record, dimensions, open_files = KINDS[kind]
    paths = []
    for first in first_numbers:
        names = [str(first + number) for number in range(5)]
        items = [f"{first}_{i}" for i in range(4)]
        points = rng.uniform(100, 900, (4, 5, dimensions))
        path = tmp_path / f"{first}.h5"
        write_as(path, make_record(points, landmark_names=names, items=items))
        paths.append(path)
    with pytest.raises(InputError, match="from 0"):
        open_files(paths)


SHARES = Landmarks(
    np.linspace(0.1, 0.9, 12).reshape(2, 3, 2),
    landmark_names="abc",
    items=("i", "j"),
)
"""Landmarks as fractions of the width and height of an image."""


@pytest.mark.parametrize("suffix", ["h5", "csv"])
def test_fractions_of_the_image_are_refused_in_every_format(tmp_path, suffix, problems):
    path = tmp_path / f"views.{suffix}"
    save(path, SHARES)
    first, *_ = problems(load, path)
    assert "fractions of the width and height of the image" in first


@pytest.mark.parametrize("suffix", ["h5", "csv"])
def test_fractions_become_pixels_where_the_size_of_the_image_is_given(tmp_path, suffix):
    path = tmp_path / f"views.{suffix}"
    save(path, SHARES)
    width, height = 100.0, 200.0
    with open_landmarks([path], InputOptions(image_size=(width, height))) as source:
        scaled = source.whole()
    expected = SHARES.landmarks * (width, height)
    assert scaled.unit == "px"
    assert_allclose(scaled.landmarks, expected)


@pytest.mark.parametrize("suffix", ["h5", "csv"])
def test_small_numbers_about_a_centre_are_no_fractions(tmp_path, suffix):
    path = tmp_path / f"views.{suffix}"
    centred = SHARES.landmarks - 0.5
    save(path, SHARES.replaced(landmarks=centred))
    lowest = load(path).landmarks.min()
    assert lowest == pytest.approx(-0.4)
