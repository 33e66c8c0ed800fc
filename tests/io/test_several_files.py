"""Several files read as one."""

import numpy as np
import pytest

from shapefit.io import open_landmarks, read_shapes, write_shapes
from shapefit.io.hdf5_records import Hdf5Reader
from shapefit.io.names import check_unique
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


@pytest.mark.parametrize("suffixes", [(".h5", ".h5"), (".csv", ".csv")])
def test_permuted_landmarks_are_matched_by_name(tmp_path, shapes, same, suffixes):
    one, two = (tmp_path / f"{name}{suffix}" for name, suffix in zip("ab", suffixes, strict=True))
    write_shapes(one, shapes.take([0, 1]))
    write_shapes(two, permuted_shapes(shapes.take([2, 3, 4]), ORDER))
    found = read_shapes([one, two])
    if suffixes == (".h5", ".h5"):
        same(found, shapes)
    np.testing.assert_array_equal(found.shapes, shapes.shapes)
    assert found.landmark_names == shapes.landmark_names
    assert found.items == shapes.items


def test_edges_and_mirror_follow_their_landmarks(tmp_path, shapes):
    write_shapes(tmp_path / "a.h5", shapes.take([0]).replaced(edges=None))
    write_shapes(tmp_path / "b.h5", permuted_shapes(shapes.take([1]), ORDER))
    found = read_shapes([tmp_path / "a.h5", tmp_path / "b.h5"])
    np.testing.assert_array_equal(found.edges, shapes.edges)
    np.testing.assert_array_equal(found.columns["mirror_index"], shapes.columns["mirror_index"])


@pytest.mark.parametrize(
    "index", [np.arange(3), np.arange(4.0), np.array([0, 1, 2, 4]), np.array([-1, 1, 2, 3])]
)
def test_a_mirror_index_that_is_none_cannot_be_permuted(tmp_path, shapes, problems, edit, index):
    write_shapes(tmp_path / "a.h5", shapes.take([0]))
    write_shapes(tmp_path / "b.h5", permuted_shapes(shapes.take([1]), ORDER))
    wrong = edit(tmp_path / "b.h5", mirror_index=index)
    assert problems(read_shapes, [tmp_path / "a.h5", wrong]) == (
        f"{wrong}:/mirror_index: does not pair the landmarks; "
        "store the index of each landmark's mirror image, or remove it",
    )


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


def test_items_in_two_files(tmp_path, shapes, problems):
    one, two, three = tmp_path / "a.h5", tmp_path / "b.h5", tmp_path / "c.csv"
    write_shapes(one, shapes.take([0, 1]))
    write_shapes(two, shapes.take([2, 1]))
    write_shapes(three, shapes.take([0]))
    assert problems(read_shapes, [one, two, three]) == (
        f"{two}:/item[1]: item 'walk/1' is also at {one}:/item[1]; give every item a unique name",
        f"{three}: item 'walk/0' is also at {one}:/item[0]; give every item a unique name",
    )


def test_shapes_that_do_not_go_together(tmp_path, shapes, problems):
    one, two = tmp_path / "a.h5", tmp_path / "b.h5"
    write_shapes(one, shapes.take([0]))
    part = shapes.take([1])
    for other, found in (
        (part.replaced(unit="mm"), f"its unit is 'mm', that of {one} is 'm'"),
        (part.replaced(mesh_vertices=None), f"has no mesh, unlike {one}"),
        (
            part.replaced(mesh_faces=part.mesh_faces[::-1]),
            f"its mesh_faces is not that of {one}",
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
    fix = "give it to all files (CSV cannot hold it) or to none, or process them separately"
    assert problems(read_shapes, [one, three]) == (
        f"{three}: has no dataset mirror_index, weight, unlike {one}; {fix}",
    )
    assert problems(read_shapes, [three, one]) == (
        f"{one}: has the dataset mirror_index, weight, unlike {three}; {fix}",
    )
    more = {**part.further, "more": np.zeros(1)}
    write_shapes(two, part.replaced(mesh_vertices=None, mesh_faces=None, further=more))
    assert problems(read_shapes, [one, two]) == (
        f"{two}: has the dataset more, unlike {one}; {fix}",
    )


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


def test_chunks_run_over_the_ends_of_files(tmp_path, landmarks, same):
    paths = [
        views_file(tmp_path / f"{rows}.h5", landmarks.take(rows))
        for rows in (slice(0, 1), slice(1, 1), slice(1, 4), slice(4, 5))
    ]
    with open_landmarks(paths) as source:
        assert source.count == 5
        assert source.head.landmark_names == landmarks.landmark_names
        assert (source.head.unit, source.head.y_axis) == ("px", "down")
        for size in (1, 2, 3, 5, 100):
            chunks = list(source.batches(size))
            assert [len(chunk) for chunk in chunks] == [size] * (5 // size) + [5 % size] * (
                5 % size > 0
            )
            start = 0
            for chunk in chunks:
                same(chunk, landmarks.take(slice(start, start + size)))
                start += size


def test_chunks_of_files_end_where_files_do(tmp_path, landmarks, same):
    paths = [
        views_file(tmp_path / f"{rows}.h5", landmarks.take(rows))
        for rows in (slice(0, 1), slice(1, 1), slice(1, 4), slice(4, 5))
    ]
    with open_landmarks(paths) as source:
        for size in (1, 2, 3, 5, 100):
            chunks = list(source.batches(size, by_file=True))
            middle = [1, 1, 1] if size == 1 else [2, 1] if size == 2 else [3]
            assert [len(chunk) for chunk in chunks] == [1, *middle, 1]
            start = 0
            for chunk in chunks:
                same(chunk, landmarks.take(slice(start, start + len(chunk))))
                start += len(chunk)


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


def test_csv_and_hdf5_together(tmp_path, landmarks):
    plain = landmarks.replaced(further={})
    one = views_file(tmp_path / "a.csv", plain.take([0, 1]))
    two = views_file(tmp_path / "b.h5", plain.take([2, 3, 4]))
    with open_landmarks([one, two]) as source:
        chunk = source.whole()
    np.testing.assert_array_equal(chunk.landmarks, landmarks.landmarks)
    assert (source.head.unit, source.head.y_axis, chunk.unit, chunk.y_axis) == (
        "px",
        "down",
        "px",
        "down",
    )


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


def test_landmarks_with_datasets_do_not_go_with_a_table(tmp_path, landmarks, problems):
    one = views_file(tmp_path / "a.h5", landmarks.take([0]))
    two = views_file(tmp_path / "b.csv", landmarks.take([1]))
    names = "camera_matrix, maker, true_model, true_rotation"
    (line,) = problems(open_landmarks, [one, two])
    assert line.startswith(f"{two}: has no dataset {names}, unlike {one}; give it to all files")


def test_images_in_two_files(tmp_path, landmarks, problems):
    one = views_file(tmp_path / "a.h5", landmarks)
    two = views_file(tmp_path / "b.csv", landmarks.take([3]))
    assert problems(open_landmarks, [one, two]) == (
        f"{two}: item 'image 3' is also at {one}:/item[3]; give every item a unique name",
    )


def test_more_files_than_may_be_open(tmp_path, landmarks, run_python):
    for i in range(70):
        views_file(tmp_path / f"{i}.h5", renamed(landmarks.take([0]), str(i)))
    script = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_NOFILE, (50, 50))
from shapefit.io import open_landmarks
with open_landmarks(sorted(Path(sys.argv[1]).glob("*.h5"))) as source:
    print(sum(len(chunk) for chunk in source.batches(4)))
"""
    assert run_python(script, tmp_path).stdout == "70\n"


def test_leaving_the_source_closes_its_files(tmp_path, landmarks):
    path = views_file(tmp_path / "a.h5", landmarks)
    with open_landmarks([path]) as source:
        chunks = source.batches(2)
        next(chunks)
    assert list(chunks) == []


def test_a_chunk_has_at_least_one_image(tmp_path, landmarks):
    with (
        open_landmarks([views_file(tmp_path / "a.h5", landmarks)]) as source,
        pytest.raises(ValueError, match="at least 1"),
    ):
        source.batches(0)


# Duplicates


def test_items_with_the_same_hash_are_compared(monkeypatch, problems):
    monkeypatch.setattr("shapefit.io.names.hash", len, raising=False)
    blocks = [("ab", "cd"), ("e",)]
    check_unique([(lambda: blocks, str)])
    twice = [*blocks, ("cd",)]
    assert problems(check_unique, [(lambda: twice, "row {}".format)]) == (
        "row 3: item 'cd' is also at row 1; give every item a unique name",
    )


def test_many_duplicates_are_counted(problems):
    items = [str(i % 100) for i in range(300)]
    lines = problems(check_unique, [(lambda: [items], str)])
    assert len(lines) == 11
    assert lines[-1] == "... and 190 more"


def test_datasets_of_files_that_are_nan_in_the_same_places_agree(tmp_path, landmarks):
    """nan is what a calibration leaves where it knows nothing; it differs from itself."""
    matrix = np.diag([500.0, np.nan, 1.0])
    parts = [landmarks.take([0]), landmarks.take([1])]
    files = [
        views_file(tmp_path / f"{i}.h5", part.replaced(further={"camera_matrix": matrix}))
        for i, part in enumerate(parts)
    ]
    with open_landmarks(files) as source:
        found = source.whole()
    assert found.items == landmarks.items[:2]
    np.testing.assert_array_equal(found.columns["camera_matrix"], matrix)


@pytest.mark.parametrize(("most_held", "readings"), [(8, 2), (7, 4)])
def test_names_of_few_items_are_read_once(
    tmp_path, landmarks, same, monkeypatch, most_held, readings
):
    """All files together: 4 items in each of two."""
    one = landmarks.take(slice(0, 4))
    two = one.replaced(items=tuple(f"{item} again" for item in one.items))
    paths = [tmp_path / "one.h5", tmp_path / "two.h5"]
    for path, images in zip(paths, (one, two), strict=True):
        save(path, images)
    read, found = Hdf5Reader._values, []

    def counted(self, name, rows):
        values = read(self, name, rows)
        found.extend([name] if len(values) else [])
        return values

    monkeypatch.setattr(Hdf5Reader, "_values", counted)
    monkeypatch.setattr("shapefit.io.source.MOST_HELD", most_held * len(one.landmark_names))
    with open_landmarks(paths) as source:
        first, second = source.batches(4, by_file=True)
    assert found.count("item") == readings
    same(first, one)
    same(second, two)
