"""Files of shapes as one source: what goes together, what is refused."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from shapefit.io import (
    open_shapes,
    read_shapes,
    write_shapes,
)

SEPARATELY = "use files that agree, or process them separately"


def permuted_shapes(shapes, order):
    """Write down the same shapes with their landmarks in another order."""
    position = np.argsort(order)
    return shapes.replaced(
        shapes=shapes.shapes[:, order],
        landmark_names=tuple(shapes.landmark_names[i] for i in order),
        edges=position[shapes.edges],
        mirror_index=position[shapes.mirror_index[order]],
    )


@pytest.fixture
def write_parts(tmp_path):
    """Write shapes to files a, b and so on, and return these."""

    def write(*parts, suffix=".h5"):
        paths = []
        for letter, part in zip("abc", parts, strict=False):
            path = tmp_path / f"{letter}{suffix}"
            write_shapes(path, part)
            paths.append(path)
        return paths

    return write


@given(st.permutations(range(4)), st.sampled_from([".h5", ".csv"]))
@settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_permuted_landmarks_are_matched_by_name(
    write_parts, shapes, same, order, suffix
):
    permuted = permuted_shapes(shapes.take([2, 3, 4]), order)
    files = write_parts(shapes.take([0, 1]), permuted, suffix=suffix)
    read = read_shapes(files)
    if suffix == ".h5":
        same(read, shapes)
    assert_array_equal(read.shapes, shapes.shapes)
    assert read.landmark_names == shapes.landmark_names
    assert read.items == shapes.items


SHARED_ITEM = "walk/1"


@pytest.fixture
def sharing(shapes, write_parts):
    """Two files that have an item of the same name."""
    return write_parts(shapes.take([0, 1]), shapes.take([2, 1]))


def test_items_in_two_files_begin_with_the_name_of_their_file(sharing, shapes):
    with open_shapes(sharing) as source:
        whole = source.whole()
        names = [name for part in source.item_names() for name in part]
        (note,) = source.notes
    expected = ["a/walk/0", "a/walk/1", f"b/{shapes.items[2]}", "b/walk/1"]
    assert list(whole.items) == expected
    assert names == expected
    assert whole.sequences[1] == f"a/{shapes.sequences[1]}"
    assert note.startswith(
        f"'{SHARED_ITEM}' in more than one file: items begin with the file, 'a/..."
    )


def test_files_of_one_name_are_told_apart_by_their_folders(
    sharing, shapes, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    third = tmp_path / "c" / "b.h5"
    third.parent.mkdir()
    write_shapes(third, shapes.take([0]))
    relative = [path.relative_to(tmp_path) for path in (*sharing, third)]
    with open_shapes(relative) as source:
        assert source.whole().items[3:] == ("b/walk/1", "c/b/walk/0")


def test_an_item_that_is_twice_in_a_file_is_refused_beside_another_file(
    tmp_path, problems
):
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path in files:
        path.write_text("item,landmark,x,y,z\nwalk/0,foot,1,2,3\nwalk/0,foot,1,2,3\n")
    first, *_ = problems(read_shapes, files)
    assert "is also on line 2" in first


OTHER_FIELDS = [
    ({"unit": "mm"}, "its unit is 'mm', that of {} is 'm'"),
    (
        {"mesh_faces": np.array([[3, 4, 5], [0, 1, 2]])},
        "its dataset mesh_faces is not that",
    ),
    (
        {"mesh_vertices": None, "mesh_faces": None},
        "its dataset mesh_faces is not that",
    ),
    ({"mirror_index": np.arange(4)}, "its dataset mirror_index is not that of {}"),
]
"""Fields of the second file, and what is said of it beside the first."""


OTHER_EXTRAS = [
    ({"weight": np.zeros((1, 2))}, "its dataset weight is not that of {}"),
    ({"more": np.zeros(1)}, "its dataset more is not that of {}"),
]


def check_refused(files, problems, fault):
    one, two = files
    (line,) = problems(read_shapes, files)
    assert line.startswith(f"{two}: {fault.format(one)}")
    assert line.endswith(SEPARATELY)


@pytest.mark.parametrize(("fields", "fault"), OTHER_FIELDS)
def test_shapes_that_do_not_go_together(write_parts, shapes, problems, fields, fault):
    other = shapes.take([1]).replaced(**fields)
    check_refused(write_parts(shapes.take([0]), other), problems, fault)


@pytest.mark.parametrize(("extras", "fault"), OTHER_EXTRAS)
def test_extras_that_do_not_go_together(write_parts, shapes, problems, extras, fault):
    other = shapes.take([1]).with_extras(extras)
    check_refused(write_parts(shapes.take([0]), other), problems, fault)


def test_files_without_sequences_units_edges_or_shapes_go_with_others(
    write_parts, shapes
):
    bare = shapes.take([0]).replaced(sequences=None, unit="unknown", edges=None)
    empty = shapes.take([]).replaced(unit="mm", extras={}, mirror_index=None)
    permuted = permuted_shapes(shapes.take([1]), [2, 0, 3, 1])
    files = write_parts(bare, empty, permuted.replaced(frame_rate=50.0))
    read = read_shapes(files)
    assert read.sequences == ("", "walk")
    assert read.unit == "m"
    assert read.frame_rate == 50.0
    assert_array_equal(read.edges, shapes.edges)
    assert_array_equal(read.mirror_index, shapes.mirror_index)
