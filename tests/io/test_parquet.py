"""Parquet: the tidy table that CSV is, with types, its unit and its axes."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_results, read_shapes
from tests.io.files import load, save


@pytest.fixture
def table(tmp_path):
    """Write columns as a table that another program made."""

    def write(**columns):
        pq.write_table(pa.table(columns), tmp_path / "table.parquet")
        return tmp_path / "table.parquet"

    return write


TIDY = {
    "item": ["i", "i", "j", "j"],
    "landmark": ["a", "b", "b", "a"],
    "x": [10.0, 20.0, None, 40.0],
    "y": [1, 2, 3, 4],
}


def test_a_table_of_another_program(table):
    images = load(table(**TIDY, sequence=["s", "s", None, None]))
    assert (images.items, images.landmark_names) == (("i", "j"), ("a", "b"))
    assert images.sequences == ("s", "")
    np.testing.assert_array_equal(
        images.landmarks, [[[10, 20], [1, 2]], [[40, np.nan], [4, np.nan]]]
    )
    assert images.confidence is None


def test_whole_numbers_beyond_those_of_floats_are_rounded(table):
    images = load(table(**TIDY | {"y": [1, 2, 3, 2**53 + 1]}))
    assert images.landmarks[1, 1, 0] == 2.0**53


def test_columns_are_typed_and_state_what_csv_cannot(tmp_path, landmarks, results):
    landmarks = landmarks.replaced(y_axis="up", frame_rate=25.0)
    save(tmp_path / "views.parquet", landmarks)
    stored = pq.read_table(tmp_path / "views.parquet")
    assert stored.column_names == ["item", "landmark", "x", "y", "confidence", "sequence"]
    assert stored.schema.field("x").type == pa.float64()
    assert len(stored) == 20
    with open_landmarks([tmp_path / "views.parquet"]) as source:
        assert (source.head.y_axis, source.head.unit, source.head.frame_rate) == ("up", "px", 25.0)
    results = results.replaced(trusted=np.array([True, False, True, True, True]))
    save(tmp_path / "result.parquet", results)
    stored = pq.read_table(tmp_path / "result.parquet")
    assert stored["trusted"].to_pylist() == [t for t in results.trusted.tolist() for _ in range(4)]
    np.testing.assert_array_equal(read_results(tmp_path / "result.parquet").shapes, results.shapes)


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"x": ["1", "2", "3", "4"]}, "column x: holds values of type string; store numbers"),
        ({"speed": [1, 2, 3, 4]}, "unknown column 'speed'; the columns are item,landmark,x,y"),
        ({"x": None}, "there is no column 'x'"),
        ({"x": [1.0, np.inf, 3.0, 4.0]}, "row 2: x is 'inf'; write a finite number"),
        ({"item": ["i", "i", "", "j"]}, "row 3: item is empty; name the item"),
        ({"landmark": ["a", "a", "b", "a"]}, "item 'i', landmark 'a' is also on line 1"),
        ({"landmark": None}, "is a table with one item a row; convert it to HDF5"),
    ],
)
def test_what_is_wrong_is_named(table, changed, found):
    columns = {name: v for name, v in (TIDY | changed).items() if v is not None}
    with pytest.raises(InputError) as caught:
        load(table(**columns))
    assert found in str(caught.value)


def test_a_shape_needs_all_its_landmarks(table):
    path = table(**TIDY | {"x": [1.0, 2.0, 3.0, 4.0]}, z=[1.0, 2.0, 3.0, None])
    with pytest.raises(InputError, match="row 4: z is 'nan'; write a finite number"):
        read_shapes([path])
    assert np.isnan(read_shapes([path], gaps=True).shapes[1, :, 0]).all()


@pytest.mark.parametrize("damage", ["cut", "flipped", "zeroed"])
def test_damage_is_seen(tmp_path, landmarks, rng, damage):
    many = landmarks.take(np.repeat(np.arange(5), 40))
    items = tuple(f"image {i}" for i in range(200))
    path = tmp_path / "views.parquet"
    save(path, many.replaced(items=items))
    whole = load(path)
    data = path.read_bytes()
    for at in rng.integers(4, len(data) - 8, 20).tolist():
        spoilt = bytearray(data[:at] if damage == "cut" else data)
        if damage == "flipped":
            spoilt[at] ^= 1 << at % 8
        if damage == "zeroed":
            spoilt[at : at + 8] = bytes(8)
        path.write_bytes(spoilt)
        try:
            again = load(path)
        except InputError:
            continue
        np.testing.assert_array_equal(again.landmarks, whole.landmarks)
        assert again.items == whole.items
