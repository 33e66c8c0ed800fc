"""Records in memory: taking, joining, matching of landmark names."""

import re

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import read_results
from shapefit.io.names import match_landmarks
from shapefit.io.records import LandmarkSet, ShapeSet, concatenate
from tests.io.files import save


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        (
            ["head", "left hnad"],
            ["there is no landmark 'left hnad'; did you mean 'left hand' "],
        ),
        (
            ["head", "xyz"],
            ["there is no landmark 'xyz'; use one of: left hand, right "],
        ),
        (
            ["door", "roof"],
            ["none of the 2 landmarks (door, roof) is known; known are "],
        ),
        ([*"abcdefghijkl", "head"], [*["there is no landmark"] * 10, "... and 2 more"]),
    ],
)
def test_landmarks_that_are_not_there(problems, wanted, told):
    have = ["left hand", "right hand", "head", "foot"]
    lines = problems(match_landmarks, have, wanted, "views.h5")
    for line, start in zip(lines, told, strict=True):
        assert line.removeprefix("views.h5: ").startswith(start)


@pytest.mark.parametrize(
    "rows", [[3, 0], np.array([False, True, True, False, False]), slice(1, 4)]
)
@pytest.mark.parametrize("kind", ["shapes", "landmarks", "results"])
def test_take(request, kind, rows):
    record = request.getfixturevalue(kind)
    part = record.take(rows)
    retained = np.arange(5)[rows]
    assert len(part) == len(retained)
    for name in ("items", "sequences"):
        assert getattr(part, name) == tuple(
            np.asarray(getattr(record, name))[retained].tolist()
        )
    for name, values in record.per_item.items():
        np.testing.assert_array_equal(part.per_item[name], values[retained])
    assert part.whole.keys() == record.whole.keys()
    for name, values in record.whole.items():
        np.testing.assert_array_equal(part.whole[name], values)
    assert part.attributes == record.attributes


def test_transforms_go_with_their_images(results):
    counts = [2, 0, 1, 3, 0]
    images = np.repeat(np.arange(5), counts)
    proved = results.replaced(
        transform_count=np.array(counts),
        transform_atom=np.array([4, 5, 6, 0, 1, 2]),
        active_transforms=10.0 * images[:, None, None] + np.zeros((6, 2, 3)),
    )
    part = proved.take([3, 1, 0])
    assert part.transform_count.tolist() == [3, 0, 2]
    assert part.transform_atom.tolist() == [0, 1, 2, 4, 5]
    assert part.active_transforms[:, 0, 0].tolist() == [30, 30, 30, 0, 0]
    whole = concatenate([proved.take([0, 1]), proved.take([2, 3, 4])])
    assert whole.transform_atom.tolist() == proved.transform_atom.tolist()


@pytest.mark.parametrize("kind", ["shapes", "landmarks", "results"])
def test_concatenate_undoes_take(request, kind, same):
    record = request.getfixturevalue(kind)
    same(
        concatenate(
            [record.take(slice(0, 0)), record.take(slice(0, 2)), record.take([2, 3, 4])]
        ),
        record,
    )


def test_arrange_matches_by_name_and_hides_what_is_not_there(landmarks):
    names = ("foot", "tail", "head", "right hand", "left hand")
    arranged = landmarks.arrange(names)
    assert arranged.landmark_names == names
    np.testing.assert_array_equal(
        arranged.landmarks[..., [2, 4, 3, 0]], landmarks.landmarks
    )
    np.testing.assert_array_equal(
        arranged.confidence[:, [2, 4, 3, 0]], landmarks.confidence
    )
    assert np.isnan(arranged.landmarks[..., 1]).all()
    assert (arranged.confidence[:, 1] == 0).all()
    joined = landmarks.with_columns(whole={"edges": np.array([[0, 1], [0, 3], [0, 9]])})
    assert joined.arrange(("foot", "head"), omit=True).whole["edges"].tolist() == [
        [1, 0]
    ]


@pytest.mark.parametrize("kind", [bool, np.int8])
def test_arrange_moves_labels_with_their_landmarks(landmarks, rng, kind):
    labels = (rng.random((5, 4)) < 0.5).astype(kind)
    square = np.arange(20.0).reshape(5, 4)  # has the shape of labels, by chance
    extras = {"corrupted": labels, "outliers": labels[:, :3], "bounding_box": square}
    names = ("foot", "tail", "head", "right hand", "left hand")
    arranged = landmarks.replaced(further=extras).arrange(names)
    moved = arranged.columns["corrupted"]
    assert moved.dtype == kind
    np.testing.assert_array_equal(moved[:, [2, 4, 3, 0]], labels)
    assert not moved[:, 1].any()
    np.testing.assert_array_equal(arranged.columns["bounding_box"], square)
    np.testing.assert_array_equal(
        arranged.columns["outliers"], labels[:, :3]
    )  # of something else


def test_arrays_of_wrong_shape_are_a_programmers_error(rng):
    with pytest.raises(ValueError, match="shapes has the shape"):
        ShapeSet(rng.normal(size=(2, 4, 3)), ("a", "b", "c", "d"), ("x", "y"))
    with pytest.raises(ValueError, match="confidence has the shape"):
        LandmarkSet(
            landmarks=np.zeros((2, 2, 1)),
            confidence=np.zeros((1, 1)),
            landmark_names=("a",),
            items=("x", "y"),
        )
    with pytest.raises(TypeError, match="confidence"):
        ShapeSet(np.zeros((1, 3, 1)), ("a",), ("x",), confidence=np.ones((1, 1)))


def test_columns_belong_to_the_file_or_to_its_items():
    columns = {
        "angle": np.zeros((3, 2)),
        "camera_matrix": np.eye(3),
        "mirror_index": np.arange(3),
    }
    whole = {"colours": np.zeros((4, 3)), "K": np.eye(3)}
    shapes = ShapeSet(
        np.zeros((3, 3, 1)), ("a",), ("x", "y", "z"), columns=columns, whole=whole
    )
    assert shapes.whole.keys() == {"camera_matrix", "mirror_index", "colours", "K"}
    assert shapes.per_item.keys() == {"shapes", "angle"}
    assert shapes.further.keys() == columns.keys() | whole.keys()
    assert shapes.take([1]).whole["K"].shape == (3, 3)
    each = shapes.with_columns({"camera_matrix": np.zeros((3, 3, 3))})
    assert "camera_matrix" in each.per_item.keys() - each.whole.keys()
    with pytest.raises(ValueError, match="colours"):
        shapes.with_columns({"colours": np.zeros((4, 3))})


def test_columns_are_added_replaced_and_removed():
    shapes = ShapeSet(
        np.zeros((3, 3, 1)), ("a",), ("x", "y", "z"), columns={"a": np.zeros(3)}
    )
    more = shapes.with_columns({"a": np.ones(3)}, whole={"c": np.eye(3)})
    assert more.columns["a"].tolist() == [1, 1, 1]
    assert more.whole.keys() == {"c"}
    assert more.without(["a"]).further.keys() == {"c"}
    assert shapes.replaced(a=None).further == {}
    assert shapes.edges is None
    assert not hasattr(shapes, "confidence")


@pytest.mark.parametrize("name", ["further", "items"])
def test_a_column_may_have_any_name(landmarks, name):
    more = landmarks.with_columns({name: np.arange(5)}, {"camera": np.ones(3)})
    assert more.per_item[name].tolist() == [*range(5)]
    assert "camera" in more.whole
    assert more.without([name, "camera"]).columns.keys() == landmarks.columns.keys()


@pytest.mark.parametrize(
    ("name", "values", "wanted"),
    [
        ("trusted", np.ones((5, 2)), "store numbers (5,)"),
        ("metres_per_unit", np.ones(5, complex), "store numbers (5,)"),
        ("log_evidence", np.full(5, "high", dtype=object), "store numbers (5,)"),
        ("reasons", np.empty(0, dtype=object), "store UTF-8 text (5,)"),
        ("landmark_map", np.eye(3), "store numbers (4, 4)"),
        ("input_landmark_names", np.arange(4), "store UTF-8 text (4,)"),
    ],
)
def test_what_a_fit_writes_beside_the_layout_has_its_axes(
    tmp_path, results, name, values, wanted
):
    path = tmp_path / "result.h5"
    save(path, results.with_columns(whole={name: values}))
    with pytest.raises(InputError, match=re.escape(wanted)) as caught:
        read_results(path)
    assert name in str(caught.value)


@pytest.mark.parametrize("count", [-1, 1, 4])
def test_counts_that_do_not_fit_are_refused(tmp_path, results, count):
    proved = results.replaced(
        transform_count=np.array([2, 0, 1, count, 0]),
        transform_atom=np.arange(6),
        active_transforms=np.zeros((6, 2, 3)),
    )
    save(tmp_path / "result.h5", proved)
    with pytest.raises(
        InputError, match="transform_count: does not count the 6 rows of "
    ):
        read_results(tmp_path / "result.h5", proofs=True)
