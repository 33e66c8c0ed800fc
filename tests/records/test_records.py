"""Records in memory: their types, taking and joining, what is of items and of files."""

import dataclasses
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError
from shapefit.records import Fit, Landmarks, Shapes, concatenate
from shapefit.records.columns import columns_of, fields_from, held_columns

KINDS = ("shapes", "landmarks", "fit")


def same(one, other) -> None:
    """Assert that two records agree field by field, to the last bit."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        value, found = getattr(one, field.name), getattr(other, field.name)
        if isinstance(value, np.ndarray):
            assert_array_equal(value, found, strict=True)
        elif field.name in ("extras", "file_extras"):
            assert value.keys() == found.keys()
            for name in value:
                assert_array_equal(value[name], found[name], strict=True)
        else:
            assert value == found, field.name


@pytest.mark.parametrize(
    "rows", [[3, 0], np.array([False, True, True, False, False]), slice(1, 4)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_take(request, kind, rows):
    record = request.getfixturevalue(kind)
    part = record.take(rows)
    retained = np.arange(5)[rows]
    assert len(part) == len(retained)
    for column, values in held_columns(record):
        taken = getattr(part, column.field)
        if column.axes[0] == "n":
            assert_array_equal(taken, np.asarray(values)[retained])
        elif column.axes[0] != "a":
            assert np.array_equal(taken, values)
    for name, values in record.extras.items():
        assert_array_equal(part.extras[name], values[retained])
    assert part.file_extras.keys() == record.file_extras.keys()
    assert part.attributes == record.attributes


def test_a_slice_copies_nothing(shapes):
    assert np.shares_memory(shapes.take(slice(1, 4)).shapes, shapes.shapes)


def test_transforms_go_with_their_images(fit):
    part = fit.take([3, 1, 0])
    assert part.transform_count.tolist() == [3, 0, 2]
    assert part.transform_atom.tolist() == [0, 1, 2, 4, 5]
    assert part.active_transforms[:, 0, 0].tolist() == [18, 24, 30, 0, 6]
    whole = concatenate([fit.take([0, 1]), fit.take([2, 3, 4])])
    assert whole.transform_atom.tolist() == fit.transform_atom.tolist()


@pytest.mark.parametrize("kind", ["shapes", "landmarks"])
def test_concatenate_undoes_take(request, kind):
    record = request.getfixturevalue(kind)
    parts = [record.take(slice(0, 0)), record.take(slice(0, 2)), record.take([2, 3, 4])]
    same(concatenate(parts), record)


@pytest.mark.parametrize("kind", KINDS)
def test_records_survive_pickling(request, kind):
    record = request.getfixturevalue(kind)
    same(pickle.loads(pickle.dumps(record)), record)


def test_failures_go_with_their_images(fit):
    assert fit[1].failures == {"image 1": "no landmark"}
    assert fit[2:4].failures == {"image 3": "too few"}
    assert repr(fit) == (
        "<shapefit.Fit: 5 images, 4 landmarks, method convex, 2 failed, 3 trusted, in"
        " unknown>"
    )


def test_the_mathematics_has_landmarks_in_columns(landmarks):
    w = landmarks.as_columns()
    assert w.shape == (5, 2, 4)
    assert w.flags.c_contiguous
    assert_array_equal(w[3, 1], landmarks.landmarks[3, :, 1])
    elsewhere = landmarks.with_points(np.asfortranarray(landmarks.landmarks))
    assert elsewhere.as_columns().strides == w.strides


def test_weights(landmarks):
    weights = landmarks.weights()
    assert weights[1, 2] == 0
    assert weights[0, 1] == landmarks.confidence[0, 1]
    assert dataclasses.replace(landmarks, confidence=None).weights()[0, 1] == 1
    assert landmarks.visible().sum() == 19


def test_types_are_those_of_the_fields():
    record = Landmarks(
        [[[1, 2], [3, 4]]],
        landmark_names=["a", "b"],
        items=np.array(["x"]),
        frames=[7.0],
        confidence=[[1, 0]],
    )
    assert record.landmarks.dtype == np.float64
    assert record.frames.dtype == np.int64
    assert record.items == ("x",)
    assert record.landmark_names == ("a", "b")
    assert Fit(np.zeros((1, 2, 3)), trusted=[1]).trusted.dtype == np.bool_


def test_names_that_look_the_same_are_the_same():
    record = Shapes(np.zeros((1, 1, 3)), landmark_names=("e\u0301paule",))
    assert record.landmark_names == ("\u00e9paule",)


@pytest.mark.parametrize(
    ("kind", "given", "told"),
    [
        (Shapes, {"shapes": np.zeros((2, 3, 4))}, "shapes: has the shape (2, 3, 4)"),
        (Shapes, {"shapes": "abc"}, "shapes: is no array of numbers"),
        (
            Landmarks,
            {"landmarks": np.zeros((2, 1, 2)), "frames": [0.5, 1.0]},
            "landmarks.frames: is no array of whole numbers; give whole numbers",
        ),
        (
            Fit,
            {"shapes": np.zeros((2, 1, 3)), "trusted": [2, 1]},
            "shapes.trusted: is no array of true and false",
        ),
        (
            Landmarks,
            {"landmarks": np.zeros((2, 1, 2)), "confidence": np.zeros((1, 1))},
            "landmarks.confidence: has the shape (1, 1); it must be (2, 1)",
        ),
        (
            Shapes,
            {"shapes": np.zeros((2, 1, 3)), "landmark_names": ("a", "b")},
            "shapes.landmark_names: has the shape (2,); it must be (1,)",
        ),
        (
            Shapes,
            {"shapes": np.zeros((2, 1, 3)), "extras": {"angle": np.zeros(3)}},
            "extras.angle: has the shape (3,), not a row for each of 2 items",
        ),
        (
            Shapes,
            {"shapes": np.zeros((2, 1, 3)), "extras": {"frame": np.zeros(2)}},
            "extras.frame: is a field of its own; give it as `frames`",
        ),
    ],
)
def test_what_does_not_agree_is_refused(kind, given, told):
    with pytest.raises(InputError, match=re.escape(told)):
        kind(**given)


def test_a_field_that_is_not_there_is_an_error(shapes):
    with pytest.raises(TypeError, match="confidence"):
        Shapes(np.zeros((1, 1, 3)), confidence=np.ones((1, 1)))
    with pytest.raises(AttributeError):
        shapes.confidence  # noqa: B018
    with pytest.raises(dataclasses.FrozenInstanceError):
        shapes.unit = "px"


def test_extras_are_of_items_or_of_the_file(shapes):
    K = np.eye(3)
    shapes = shapes.with_file_extras({"camera_matrix": K})
    assert shapes.take([1]).file_extras["camera_matrix"].shape == (3, 3)
    each = shapes.with_extras({"camera_matrix": np.zeros((5, 3, 3))})
    assert "camera_matrix" not in each.file_extras
    assert each.take([1]).extras["camera_matrix"].shape == (1, 3, 3)
    again = each.with_file_extras({"camera_matrix": K})
    assert again.extras.keys() == {"weight"}
    assert again.column("camera_matrix") is not None
    assert again.column("shapes") is shapes.shapes
    assert again.column("nothing") is None
    bare = again.without(["camera_matrix", "weight", "edges", "sequence"])
    assert (bare.extras, bare.file_extras) == ({}, {})
    assert bare.edges is None
    assert bare.sequences is None


def test_lines_join_landmarks_that_are_there(landmarks):
    assert landmarks.lines is None
    edges = np.array([[0, 1], [0, 9], [-1, 2]])
    joined = dataclasses.replace(landmarks, edges=edges)
    assert joined.lines.tolist() == [[0, 1]]


def test_a_point_with_one_unknown_coordinate_has_none(landmarks):
    points = landmarks.landmarks.copy()
    points[0, 0, 1] = np.nan
    whole = landmarks.with_points(points).with_whole_points()
    assert np.isnan(whole.landmarks[0, 0]).all()
    assert_array_equal(whole.landmarks[2:], points[2:])


def test_what_has_no_names_gets_some():
    bare = Shapes(np.zeros((2, 3, 3)))
    assert (bare.landmark_names, bare.items) == ((), ())
    assert bare.take([1]).items == ()
    assert bare.named().landmark_names == ("0", "1", "2")
    assert bare.named("abc").landmark_names == ("a", "b", "c")
    assert bare.named().items == ("0", "1")


def test_columns_by_their_names_in_files(fit):
    fields = fields_from(Fit, {"lambda": fit.shapes, "item": None, "flat": fit.status})
    assert fields.keys() == {"lam", "extras"}
    assert fields["extras"].keys() == {"flat"}


@pytest.mark.parametrize("kind", [Landmarks, Shapes, Fit])
def test_each_column_has_a_name_and_a_field_of_its_own(kind):
    columns = columns_of(kind)
    fields = {field.name for field in dataclasses.fields(kind)}
    assert {column.field for column in columns} <= fields
    assert len({column.name for column in columns}) == len(columns)


SCRIPT = """
import numpy as np
import shapefit

images = shapefit.Landmarks(np.zeros((2, 3, 2)), landmark_names=["a", "b", "c"])
fit = shapefit.fit(images, "people")
if fit.shape_sd is not None:
    print(fit.shape_sd.mean())
{line}
"""


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("print(fit.rotation, images.landmarks[0], fit[0].failures)", ""),
        ("print(fit.shape_sdd)", 'has no attribute "shape_sdd"'),
        ("print(fit.rotatoin)", 'has no attribute "rotatoin"'),
        ("images = shapefit.Landmarks(fit.shapes, itms=())", 'keyword argument "itms"'),
        ("fit.unit = 'px'", 'Property "unit" defined in "Fit" is read-only'),
    ],
)
def test_a_misspelt_field_is_a_type_error_in_a_script(tmp_path, project, line, told):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(line=line), encoding="utf-8")
    cache = project / ".mypy_cache"
    command = [sys.executable, "-m", "mypy", "--cache-dir", cache, script]
    done = subprocess.run(
        command, cwd=project, capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode == 0) == (told == ""), done.stdout + done.stderr
    assert told in done.stdout
