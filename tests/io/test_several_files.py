"""Several files read as one."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shapefit.io import LandmarkSet, open_landmarks, open_shapes, read_shapes, write_shapes
from shapefit.io.source import open_results
from tests.io.files import save

ORDER = [2, 0, 3, 1]


def permuted_shapes(shapes, order):
    """Write down the same shapes with their landmarks in another order."""
    position = np.argsort(order)
    return shapes.replaced(
        shapes=shapes.shapes[..., order],
        landmark_names=tuple(shapes.landmark_names[i] for i in order),
        edges=position[shapes.edges],
        further={**shapes.further, "mirror_index": position[shapes.columns["mirror_index"][order]]},
    )


def views_file(path, landmarks):
    save(path, landmarks)
    return path


def renamed(record, prefix):
    return record.replaced(items=tuple(prefix + item for item in record.items))


# Shapes


@given(st.permutations(range(4)), st.sampled_from([".h5", ".csv"]))
@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_permuted_landmarks_are_matched_by_name(tmp_path, shapes, same, order, suffix):
    one, two = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    write_shapes(one, shapes.take([0, 1]))
    write_shapes(two, permuted_shapes(shapes.take([2, 3, 4]), order))
    found = read_shapes([one, two])
    if suffix == ".h5":
        same(found, shapes)
    np.testing.assert_array_equal(found.shapes, shapes.shapes)
    assert (found.landmark_names, found.items) == (shapes.landmark_names, shapes.items)


def test_edges_and_mirror_follow_their_landmarks(tmp_path, shapes):
    write_shapes(tmp_path / "a.h5", shapes.take([0]).replaced(edges=None))
    write_shapes(tmp_path / "b.h5", permuted_shapes(shapes.take([1]), ORDER))
    found = read_shapes([tmp_path / "a.h5", tmp_path / "b.h5"])
    np.testing.assert_array_equal(found.edges, shapes.edges)
    np.testing.assert_array_equal(found.columns["mirror_index"], shapes.columns["mirror_index"])


def test_other_landmarks(tmp_path, shapes, problems):
    one, two = tmp_path / "a.h5", tmp_path / "b.h5"
    write_shapes(one, shapes.take([0]))
    other = ("head", "left hand", "right hand", "feet")
    write_shapes(two, shapes.take([1]).replaced(landmark_names=other))
    assert problems(read_shapes, [one, two]) == (
        f"{two}: there is no landmark 'feet'; did you mean 'foot'?",
    )
    fewer = permuted_shapes(shapes.take([1]), [0, 1, 2, 3])
    fewer = fewer.replaced(
        shapes=fewer.shapes[..., :3], landmark_names=other[:3], edges=None, further={}
    )
    write_shapes(two, fewer)
    (line,) = problems(read_shapes, [one, two])
    assert line.startswith(f"{two}: there is no landmark 'foot'; ")


def test_items_in_two_files_begin_with_the_name_of_their_file(tmp_path, shapes):
    (tmp_path / "c").mkdir()
    one, two, three = tmp_path / "a.h5", tmp_path / "b.h5", tmp_path / "c" / "b.h5"
    write_shapes(one, shapes.take([0, 1]))
    write_shapes(two, shapes.take([2, 1]))
    write_shapes(three, shapes.take([0]))
    with open_shapes([one, two]) as source:
        assert source.whole().items == ("a/walk/0", "a/walk/1", f"b/{shapes.items[2]}", "b/walk/1")
        assert [name for part in source.names() for name in part] == list(source.whole().items)
        assert source.whole().sequences[1] == f"a/{shapes.sequences[1]}"
        (note,) = source.notes
        assert note.startswith("'walk/1' in more than one file: items begin with the file, 'a/...")
    with open_shapes([one, two, three]) as source:
        assert source.whole().items[3:] == (f"{tmp_path.name}/b/walk/1", "c/b/walk/0")


def test_an_item_that_is_twice_in_a_file_is_refused_beside_another_file(tmp_path, problems):
    one, two = tmp_path / "a.csv", tmp_path / "b.csv"
    for path in (one, two):
        path.write_text("item,landmark,x,y,z\nwalk/0,foot,1,2,3\nwalk/0,foot,1,2,3\n")
    assert "is also on line 2" in problems(read_shapes, [one, two])[0]


def test_what_each_camera_says_is_of_its_images(tmp_path):
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for number, path in enumerate(paths):
        camera = {"camera_matrix": np.eye(3) * (number + 1), "image_size": np.array([640, 480])}
        save(path, LandmarkSet(np.zeros((2, 2, 3)), "abc", ("i", "j"), columns=camera))
    with open_landmarks(paths) as source:
        whole = source.whole()
    np.testing.assert_array_equal(whole.columns["camera_matrix"][:, 0, 0], [1, 1, 2, 2])
    assert whole.columns["image_size"].tolist() == [640, 480]


def test_shapes_that_do_not_go_together(tmp_path, shapes, problems):
    one, two = tmp_path / "a.h5", tmp_path / "b.h5"
    write_shapes(one, shapes.take([0]))
    part = shapes.take([1])
    for other, found in (
        (part.replaced(unit="mm"), f"its unit is 'mm', that of {one} is 'm'"),
        (
            part.replaced(mesh_faces=part.mesh_faces[::-1]),
            f"its dataset mesh_faces is not that of {one}",
        ),
        (
            part.replaced(further={**part.further, "mirror_index": np.arange(4)}),
            f"its dataset mirror_index is not that of {one}",
        ),
        (
            part.replaced(further={**part.further, "weight": np.zeros((1, 2))}),
            f"its dataset weight is not that of {one}",
        ),
    ):
        write_shapes(two, other)
        assert problems(read_shapes, [one, two]) == (
            f"{two}: {found}; use files that agree, or process them separately",
        )


def test_datasets_that_only_some_files_have(tmp_path, shapes, problems):
    one, two, three = tmp_path / "a.h5", tmp_path / "b.h5", tmp_path / "c.csv"
    part = shapes.take([1])
    write_shapes(one, shapes.take([0]).replaced(mesh_vertices=None, mesh_faces=None))
    write_shapes(three, part)
    fix = "use files that agree, or process them separately"
    for files, name in (((one, three), "mirror_index"), ((three, one), "mirror_index")):
        fault = f"its dataset {name} is not that of {files[0]}"
        assert problems(read_shapes, files) == (f"{files[1]}: {fault}; {fix}",)
    more = {**part.further, "more": np.zeros(1)}
    for other, name in (
        (part.replaced(mesh_vertices=None, mesh_faces=None, further=more), "more"),
        (part, "mesh_faces"),
    ):
        write_shapes(two, other)
        fault = f"its dataset {name} is not that of {one}"
        assert problems(read_shapes, [one, two]) == (f"{two}: {fault}; {fix}",)


def test_files_without_sequences_units_or_shapes_go_with_others(tmp_path, shapes):
    one, two, three = tmp_path / "a.h5", tmp_path / "b.h5", tmp_path / "c.h5"
    write_shapes(one, shapes.take([0]).replaced(sequences=None, unit="unknown"))
    write_shapes(two, shapes.take([]).replaced(unit="mm", further={}))
    write_shapes(three, shapes.take([1]))
    found = read_shapes([one, two, three])
    assert found.sequences == ("", "walk")
    assert found.unit == "m"
    assert len(found) == 2


# Landmarks


@pytest.mark.parametrize("by_file", [False, True])
def test_chunks_run_over_the_ends_of_files_unless_told(tmp_path, landmarks, same, by_file):
    parts = (slice(0, 1), slice(1, 1), slice(1, 4), slice(4, 5))
    paths = [views_file(tmp_path / f"{rows}.h5", landmarks.take(rows)) for rows in parts]
    ends = {rows.stop for rows in parts} if by_file else {5}
    with open_landmarks(paths) as source:
        assert (source.count, source.head.unit, source.head.y_axis) == (5, "px", "down")
        for size in (1, 2, 3, 5, 100):
            start = 0
            for chunk in source.batches(size, by_file=by_file):
                stop = min(start + size, min(end for end in ends if end > start))
                same(chunk, landmarks.take(slice(start, stop)))
                start = stop
            assert start == 5


def test_landmarks_of_files_are_united(tmp_path, landmarks):
    one = views_file(
        tmp_path / "a.h5", landmarks.take([0]).replaced(confidence=None, sequences=None)
    )
    other = landmarks.take([1, 2]).replaced(landmark_names=("foot", "tail", "head", "right hand"))
    two = views_file(tmp_path / "b.h5", other)
    with open_landmarks([one, two]) as source:
        chunk = source.whole()
    assert source.head.landmark_names == ("head", "left hand", "right hand", "foot", "tail")
    assert chunk.sequences == ("", "a", "b")
    np.testing.assert_array_equal(chunk.landmarks[0, :, :4], landmarks.landmarks[0])
    assert np.isnan(chunk.landmarks[0, :, 4]).all()
    np.testing.assert_array_equal(chunk.confidence[0], [1, 1, 1, 1, 0])
    np.testing.assert_array_equal(chunk.landmarks[1:][..., [3, 4, 0, 2]], other.landmarks)
    assert np.isnan(chunk.landmarks[1:, :, 1]).all()
    np.testing.assert_array_equal(chunk.confidence[1:][:, [3, 4, 0, 2]], other.confidence)
    assert (chunk.confidence[1:, 1] == 0).all()


def test_landmarks_that_do_not_go_together(tmp_path, landmarks, problems):
    one = views_file(tmp_path / "a.h5", landmarks.take([0]))
    part = landmarks.take([1])
    for other, found in (
        (part.replaced(y_axis="up"), f"its y_axis is 'up', that of {one} is 'down'"),
        (part.replaced(unit="m"), f"its unit is 'm', that of {one} is 'px'"),
    ):
        two = views_file(tmp_path / "b.h5", other)
        assert problems(open_landmarks, [one, two]) == (
            f"{two}: {found}; use files that agree, or process them separately",
        )


# Results


def test_results_that_do_not_go_together(tmp_path, results, problems):
    one, two = tmp_path / "a.h5", tmp_path / "b.h5"
    save(one, results.take([0]))
    part = results.take([1])
    for other, found in (
        (
            part.replaced(landmark_names=tuple("abcd")),
            "its landmarks are not those of {}",
        ),
        (part.replaced(rotation=None), "its dataset rotation is not that of {}"),
        (part.replaced(mesh_vertices=np.zeros((1, 3, 2))), "its dataset mesh_vertices is not"),
    ):
        save(two, other)
        (line,) = problems(open_results, [one, two])
        assert line.startswith(f"{two}: {found.format(one)}")
        assert line.endswith("process them separately")
    save(two, part)
    with open_results([one, two]) as source:
        np.testing.assert_array_equal(source.whole().shapes, results.shapes[:2])
