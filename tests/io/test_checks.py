"""Numbers that stand for missing landmarks, and names in two spellings of Unicode."""

import unicodedata

import numpy as np
import pytest

import shapefit
from shapefit.errors import InputError
from shapefit.io import open_landmarks, open_shapes
from shapefit.io.checks import warn_of_codes


@pytest.fixture
def points(rng) -> np.ndarray:
    return np.round(rng.uniform(200, 900, (20, 10, 2)), 2)


@pytest.mark.parametrize("code", [-999.0, 9999.0, -100.0, -9.0, 1e6, -1000.0])
@pytest.mark.parametrize("axes", [2, 3])
def test_a_code_of_missing_points_is_named(rng, code, axes):
    points = rng.uniform(200, 900, (20, 10, axes))
    points[::2, 3] = code
    (warning,) = warn_of_codes(points)
    text = ", ".join([f"{code:g}"] * axes)
    assert warning.startswith(f"10 landmarks at ({text}), far from all others")


def test_one_point_alone_must_be_far(points):
    points[4, 3] = -999
    assert "1 landmark at (-999, -999)" in warn_of_codes(points)[0]
    points[4, 3] = 150
    assert warn_of_codes(points) == ()


def test_several_codes(points):
    points[::2, 3], points[1::2, 4] = -999, 9999
    assert [text.split(",")[0] for text in warn_of_codes(points)] == [
        "10 landmarks at (-999",
        "10 landmarks at (9999",
    ]


@pytest.mark.parametrize(
    "change",
    [
        lambda points: None,
        lambda points: points.__setitem__((slice(0, 9), 3), 500.0),
        lambda points: points.__setitem__((slice(0, 9), 3, 0), -999.0),
        lambda points: points.__setitem__((slice(0, 9), 3), np.nan),
    ],
)
def test_points_among_others_are_no_codes(points, change):
    change(points)
    assert warn_of_codes(points) == ()


def test_hidden_points_do_not_count(points):
    points[::2, 3] = -999
    weights = np.ones((20, 10))
    weights[::2, 3] = 0
    assert warn_of_codes(points, weights) == ()


@pytest.mark.parametrize("name", ["a.csv", "a.h5", "a.tsv"])
@pytest.mark.parametrize("kind", ["landmarks", "shapes"])
def test_codes_are_named_with_their_file(tmp_path, rng, name, kind):
    points = np.round(rng.uniform(200, 900, (20, 6, 2 if kind == "landmarks" else 3)))
    points[3:7, 2] = -999
    path = tmp_path / name
    names = list("abcdef")
    made = {"landmarks": shapefit.Landmarks, "shapes": shapefit.Shapes}[kind]
    write = {"landmarks": shapefit.write_landmarks, "shapes": shapefit.write_shapes}
    write[kind](
        path.with_suffix(".csv" if name == "a.tsv" else path.suffix),
        made(points, landmark_names=names),
    )
    if name == "a.tsv":
        text = path.with_suffix(".csv").read_text()
        path.write_text(text.replace(",", "\t"))
    opened = {"landmarks": open_landmarks, "shapes": open_shapes}[kind]
    with opened([path]) as source:
        (note,) = source.notes
    assert note.startswith(f"{path}: 4 landmarks at (-999, -999")


SPELLINGS = [unicodedata.normalize(form, "éte ö") for form in ("NFC", "NFD")]


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".h5"])
@pytest.mark.parametrize(("one", "other"), [SPELLINGS, SPELLINGS[::-1]])
def test_names_that_look_the_same_are_the_same(tmp_path, points, suffix, one, other):
    paths = []
    for number, name in enumerate((one, other)):
        names = [name, *"abcdefghi"]
        own = shapefit.Landmarks(
            points, landmark_names=names, items=[f"{number}{i}" for i in range(20)]
        )
        path = tmp_path / f"{number}.csv"
        if suffix == ".h5":
            path = path.with_suffix(".h5")
        shapefit.write_landmarks(path, own)
        if suffix == ".tsv":
            text = path.read_text(encoding="utf-8")
            path = path.with_suffix(".tsv")
            path.write_text(text.replace(",", "\t"), encoding="utf-8")
        paths.append(path)
    with open_landmarks(paths) as source:
        assert source.head.landmark_names == (SPELLINGS[0], *"abcdefghi")


def test_what_looks_the_same_is_renamed_and_chosen(tmp_path, points):
    path = tmp_path / "a.csv"
    names = [SPELLINGS[0], *"abcdefghi"]
    shapefit.write_landmarks(path, shapefit.Landmarks(points, landmark_names=names))
    read = shapefit.read_landmarks(path, rename={SPELLINGS[1]: "q"})
    assert read.landmark_names[0] == "q"


@pytest.mark.parametrize("order", [1, -1])
def test_the_file_that_lacks_a_landmark_is_named(tmp_path, rng, order):
    for name, landmarks in (("a", "pqr"), ("b", "pqrs")):
        shapes = shapefit.Shapes(
            rng.normal(size=(4, len(landmarks), 3)),
            landmark_names=list(landmarks),
            items=[f"{name}{i}" for i in range(4)],
        )
        shapefit.write_shapes(tmp_path / f"{name}.h5", shapes)
    files = [tmp_path / "a.h5", tmp_path / "b.h5"][::order]
    with pytest.raises(InputError) as caught:
        open_shapes(files)
    a, b = tmp_path / "a.h5", tmp_path / "b.h5"
    assert str(caught.value) == (
        f"{a}: has no landmark 's', which {b} has; give shapes of the same landmarks,"
        " or name those that all have by `landmarks` (p, q, r)"
    )


@pytest.mark.parametrize("counts", [(0, 1), (1, 0)])
@pytest.mark.parametrize("kind", ["landmarks", "shapes"])
def test_numbers_from_0_beside_numbers_from_1_are_refused(tmp_path, rng, kind, counts):
    for start in counts:
        names = [str(start + number) for number in range(5)]
        items = [f"{start}_{i}" for i in range(4)]
        if kind == "shapes":
            records = shapefit.Shapes(
                rng.normal(size=(4, 5, 3)), landmark_names=names, items=items
            )
            shapefit.write_shapes(tmp_path / f"{start}.h5", records)
        else:
            points = rng.uniform(100, 900, (4, 5, 2))
            records = shapefit.Landmarks(points, landmark_names=names, items=items)
            shapefit.write_landmarks(tmp_path / f"{start}.h5", records)
    opened = {"landmarks": open_landmarks, "shapes": open_shapes}[kind]
    with pytest.raises(InputError, match="from 0"):
        opened([tmp_path / f"{start}.h5" for start in counts])
