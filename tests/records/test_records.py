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
from shapefit.records.columns import columns_of, present_columns

KINDS = ("shapes", "landmarks", "fit")


def assert_same(one, other) -> None:
    """Assert that two records agree field by field, to the last bit."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        value = getattr(one, field.name)
        found = getattr(other, field.name)
        if isinstance(value, np.ndarray):
            assert_array_equal(value, found, strict=True)
        elif field.name in ("extras", "file_extras"):
            assert_same_extras(value, found)
        else:
            assert value == found, field.name


def assert_same_extras(one, other) -> None:
    assert one.keys() == other.keys()
    for name, values in one.items():
        assert_array_equal(values, other[name], strict=True)


@pytest.fixture(params=KINDS)
def record(request):
    """A record of each kind."""
    return request.getfixturevalue(request.param)


SOME = [[3, 0], np.array([False, True, True, False, False]), slice(1, 4)]
"""Ways to say which items are taken."""


@pytest.mark.parametrize("rows", SOME)
class TestTake:
    @pytest.fixture
    def numbers(self, rows):
        """Of the items that are taken."""
        return np.arange(5)[rows]

    @pytest.fixture
    def part(self, record, rows):
        return record.take(rows)

    def test_it_has_as_many_items(self, part, numbers):
        assert len(part) == len(numbers)

    def test_columns_of_items_have_their_rows(self, record, part, numbers):
        for column, values in present_columns(record):
            if column.axes[0] == "n":
                taken = getattr(part, column.field)
                assert_array_equal(taken, np.asarray(values)[numbers])

    def test_other_columns_stay(self, record, part):
        """But for lists of transforms, which go with their images."""
        for column, values in present_columns(record):
            if column.axes[0] not in ("n", "a"):
                assert_array_equal(getattr(part, column.field), values)

    def test_extras_of_items_have_their_rows(self, record, part, numbers):
        for name, values in record.extras.items():
            assert_array_equal(part.extras[name], values[numbers])

    def test_what_is_of_the_file_stays(self, record, part):
        assert part.file_extras.keys() == record.file_extras.keys()
        assert part.attributes == record.attributes


def test_a_slice_copies_nothing(shapes):
    part = shapes.take(slice(1, 4))
    assert np.shares_memory(part.shapes, shapes.shapes)


def test_transforms_are_taken_with_their_images(fit):
    part = fit.take([3, 1, 0])
    assert part.transform_count.tolist() == [3, 0, 2]
    assert part.transform_atom.tolist() == [0, 1, 2, 4, 5]
    assert part.active_transforms[:, 0, 0].tolist() == [18, 24, 30, 0, 6]


def test_transforms_are_joined_with_their_images(fit):
    whole = concatenate([fit.take([0, 1]), fit.take([2, 3, 4])])
    assert whole.transform_atom.tolist() == fit.transform_atom.tolist()


@pytest.mark.parametrize("kind", ["shapes", "landmarks"])
def test_concatenate_undoes_take(request, kind):
    record = request.getfixturevalue(kind)
    nothing = record.take(slice(0, 0))
    first = record.take(slice(0, 2))
    others = record.take([2, 3, 4])
    assert_same(concatenate([nothing, first, others]), record)


def test_records_survive_pickling(record):
    restored = pickle.loads(pickle.dumps(record))
    assert_same(restored, record)


def test_failures_go_with_their_images(fit):
    assert fit[1].failures == {"image 1": "no landmark"}
    assert fit[2:4].failures == {"image 3": "too few"}


def test_a_fit_says_what_it_holds(fit):
    assert repr(fit) == (
        "<shapefit.Fit: 5 images, 4 landmarks, method convex, 2 failed, 3 trusted, in"
        " unknown>"
    )


def test_the_mathematics_has_landmarks_in_columns(landmarks):
    w = landmarks.as_columns()
    assert w.shape == (5, 2, 4)
    assert w.flags.c_contiguous
    assert_array_equal(w[3, 1], landmarks.landmarks[3, :, 1])


def test_columns_lie_in_memory_alike_whatever_the_landmarks_do(landmarks):
    in_other_order = np.asfortranarray(landmarks.landmarks)
    elsewhere = landmarks.with_points(in_other_order).as_columns()
    assert elsewhere.strides == landmarks.as_columns().strides


def test_weights_are_the_confidence_of_what_is_seen(landmarks):
    weights = landmarks.weights()
    assert weights[1, 2] == 0
    assert weights[0, 1] == landmarks.confidence[0, 1]


def test_without_confidence_weights_are_1(landmarks):
    without = dataclasses.replace(landmarks, confidence=None)
    assert without.weights()[0, 1] == 1


def test_landmarks_that_are_no_nan_are_visible(landmarks):
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


def test_numbers_may_be_given_for_true_and_false():
    fit = Fit(np.zeros((1, 2, 3)), trusted=[1])
    assert fit.trusted.dtype == np.bool_


def test_names_that_look_the_same_are_the_same():
    record = Shapes(np.zeros((1, 1, 3)), landmark_names=("e\u0301paule",))
    assert record.landmark_names == ("\u00e9paule",)


TWO_SHAPES = {"shapes": np.zeros((2, 1, 3))}
TWO_IMAGES = {"landmarks": np.zeros((2, 1, 2))}
DISAGREEING = [
    (Shapes, {"shapes": np.zeros((2, 3, 4))}, "shapes: has the shape (2, 3, 4)"),
    (Shapes, {"shapes": "abc"}, "shapes: is no array of numbers"),
    (
        Landmarks,
        TWO_IMAGES | {"frames": [0.5, 1.0]},
        "landmarks.frames: is no array of whole numbers; give whole numbers",
    ),
    (
        Fit,
        TWO_SHAPES | {"trusted": [2, 1]},
        "shapes.trusted: is no array of true and false",
    ),
    (
        Landmarks,
        TWO_IMAGES | {"confidence": np.zeros((1, 1))},
        "landmarks.confidence: has the shape (1, 1); it must be (2, 1)",
    ),
    (
        Shapes,
        TWO_SHAPES | {"landmark_names": ("a", "b")},
        "shapes.landmark_names: has the shape (2,); it must be (1,)",
    ),
    (
        Shapes,
        TWO_SHAPES | {"extras": {"angle": np.zeros(3)}},
        "extras.angle: has the shape (3,), not a row for each of 2 items",
    ),
    (
        Shapes,
        TWO_SHAPES | {"extras": {"frame": np.zeros(2)}},
        "extras.frame: is a field of its own; give it as `frames`",
    ),
]
"""Fields that do not agree with each other or with their kind, and the error."""


@pytest.mark.parametrize(("kind", "fields", "message"), DISAGREEING)
def test_what_does_not_agree_is_refused(kind, fields, message):
    with pytest.raises(InputError, match=re.escape(message)):
        kind(**fields)


def test_a_field_that_is_not_there_cannot_be_given():
    with pytest.raises(TypeError, match="confidence"):
        Shapes(np.zeros((1, 1, 3)), confidence=np.ones((1, 1)))


def test_a_field_that_is_not_there_cannot_be_read(shapes):
    with pytest.raises(AttributeError):
        shapes.confidence  # noqa: B018


def test_a_field_cannot_be_set(shapes):
    with pytest.raises(dataclasses.FrozenInstanceError):
        shapes.unit = "px"


class TestExtras:
    """They are of items or of the file."""

    CAMERA_MATRIX = np.eye(3)

    @pytest.fixture
    def with_file_extra(self, shapes):
        return shapes.with_file_extras({"camera_matrix": self.CAMERA_MATRIX})

    @pytest.fixture
    def with_item_extra(self, with_file_extra):
        matrices = np.zeros((5, 3, 3))
        return with_file_extra.with_extras({"camera_matrix": matrices})

    def test_one_of_the_file_is_whole_in_every_part(self, with_file_extra):
        part = with_file_extra.take([1])
        assert part.file_extras["camera_matrix"].shape == (3, 3)

    def test_one_of_items_takes_the_place_of_one_of_the_file(self, with_item_extra):
        part = with_item_extra.take([1])
        assert "camera_matrix" not in with_item_extra.file_extras
        assert part.extras["camera_matrix"].shape == (1, 3, 3)

    def test_one_of_the_file_takes_the_place_of_one_of_items(self, with_item_extra):
        again = with_item_extra.with_file_extras({"camera_matrix": self.CAMERA_MATRIX})
        assert again.extras.keys() == {"weight"}
        assert again.file_extras.keys() == {"camera_matrix"}

    def test_they_are_left_out_by_name_as_columns_are(self, with_file_extra):
        bare = with_file_extra.without(["camera_matrix", "weight", "edges", "sequence"])
        assert bare.extras == {}
        assert bare.file_extras == {}
        assert bare.edges is None
        assert bare.sequences is None

    def test_all_columns_are_found_by_name(self, with_file_extra):
        assert_array_equal(with_file_extra.column("camera_matrix"), self.CAMERA_MATRIX)
        assert with_file_extra.column("shapes") is with_file_extra.shapes
        assert with_file_extra.column("nothing") is None


def test_without_edges_there_are_no_lines(landmarks):
    assert landmarks.lines is None


def test_lines_join_landmarks_that_are_there(landmarks):
    edges = np.array([[0, 1], [0, 9], [-1, 2]])
    joined = dataclasses.replace(landmarks, edges=edges)
    assert joined.lines.tolist() == [[0, 1]]


def test_a_point_with_one_unknown_coordinate_has_none(landmarks):
    points = landmarks.landmarks.copy()
    points[0, 0, 1] = np.nan

    whole = landmarks.with_points(points).with_whole_points()

    assert np.isnan(whole.landmarks[0, 0]).all()
    assert_array_equal(whole.landmarks[2:], points[2:])


class TestWithoutNames:
    """What has no names gets some when it is asked to."""

    @pytest.fixture
    def bare(self):
        return Shapes(np.zeros((2, 3, 3)))

    def test_there_are_none_at_first(self, bare):
        assert bare.landmark_names == ()
        assert bare.items == ()
        assert bare.take([1]).items == ()

    def test_numbers_are_names(self, bare):
        named = bare.named()
        assert named.landmark_names == ("0", "1", "2")
        assert named.items == ("0", "1")

    def test_landmarks_may_have_others(self, bare):
        assert bare.named("abc").landmark_names == ("a", "b", "c")


@pytest.mark.parametrize("kind", [Landmarks, Shapes, Fit])
def test_each_column_has_a_field(kind):
    fields = {field.name for field in dataclasses.fields(kind)}
    assert {column.field for column in columns_of(kind)} <= fields


@pytest.mark.parametrize("kind", [Landmarks, Shapes, Fit])
def test_each_column_has_a_name_of_its_own(kind):
    columns = columns_of(kind)
    names = {column.name for column in columns}
    assert len(names) == len(columns)


SCRIPT = """
import numpy as np
import shapefit

images = shapefit.Landmarks(np.zeros((2, 3, 2)), landmark_names=["a", "b", "c"])
fit = shapefit.fit(images, "people")
if fit.shape_sd is not None:
    print(fit.shape_sd.mean())
{line}
"""


MISSPELT = [
    ("print(fit.shape_sdd)", 'has no attribute "shape_sdd"'),
    ("print(fit.rotatoin)", 'has no attribute "rotatoin"'),
    ("images = shapefit.Landmarks(fit.shapes, itms=())", 'keyword argument "itms"'),
    ("fit.unit = 'px'", 'Property "unit" defined in "Fit" is read-only'),
]
"""A line, and what mypy says of it."""


@pytest.fixture
def check_types(tmp_path, project):
    """Return the function that runs mypy on SCRIPT with a line more."""

    def check_types(line):
        script = tmp_path / "script.py"
        script.write_text(SCRIPT.format(line=line), encoding="utf-8")
        cache = project / ".mypy_cache"
        return subprocess.run(
            [sys.executable, "-m", "mypy", "--cache-dir", cache, script],
            cwd=project,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    return check_types


@pytest.mark.parametrize(("line", "message"), MISSPELT)
def test_a_misspelt_field_is_a_type_error_in_a_script(check_types, line, message):
    checked = check_types(line)
    assert checked.returncode != 0
    assert message in checked.stdout


def test_fields_that_are_spelt_rightly_are_none(check_types):
    line = "print(fit.rotation, images.landmarks[0], fit[0].failures)"
    checked = check_types(line)
    assert checked.returncode == 0, checked.stdout + checked.stderr
