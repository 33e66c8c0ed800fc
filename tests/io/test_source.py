"""Files as one source: what goes together, what is refused, and what keys of reading
do.
"""

import re
import shlex
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shapefit.io import (
    open_landmarks,
    open_shapes,
    read_results,
    read_shapes,
    write_shapes,
)
from shapefit.io.checks import LIMIT, input_problems
from shapefit.io.options import InputOptions
from shapefit.io.readers.items import keep_landmarks
from shapefit.io.source import open_results
from shapefit.records import Fit, Landmarks
from tests.cli.conftest import run_in
from tests.io.files import save

SEPARATELY = "use files that agree, or process them separately"


def permuted_shapes(shapes, order):
    """Write down the same shapes with their landmarks in another order."""
    position = np.argsort(order)
    return shapes.replaced(
        shapes=shapes.as_columns()[..., order].swapaxes(1, 2),
        landmark_names=tuple(shapes.landmark_names[i] for i in order),
        edges=position[shapes.edges],
        mirror_index=position[shapes.mirror_index[order]],
    )


# Shapes


@given(st.permutations(range(4)), st.sampled_from([".h5", ".csv"]))
@settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_permuted_landmarks_are_matched_by_name(tmp_path, shapes, same, order, suffix):
    one = tmp_path / f"a{suffix}"
    two = tmp_path / f"b{suffix}"
    write_shapes(one, shapes.take([0, 1]))
    write_shapes(two, permuted_shapes(shapes.take([2, 3, 4]), order))
    found = read_shapes([one, two])
    if suffix == ".h5":
        same(found, shapes)
    np.testing.assert_array_equal(found.points, shapes.points)
    assert found.landmark_names == shapes.landmark_names
    assert found.items == shapes.items


def test_items_in_two_files_begin_with_the_name_of_their_file(
    tmp_path, shapes, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c").mkdir()
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    three = tmp_path / "c" / "b.h5"
    write_shapes(one, shapes.take([0, 1]))
    write_shapes(two, shapes.take([2, 1]))
    write_shapes(three, shapes.take([0]))
    with open_shapes([one, two]) as source:
        assert source.whole().items == (
            "a/walk/0",
            "a/walk/1",
            f"b/{shapes.items[2]}",
            "b/walk/1",
        )
        assert [name for part in source.names() for name in part] == list(
            source.whole().items
        )
        assert source.whole().sequences[1] == f"a/{shapes.sequences[1]}"
        (note,) = source.notes
        assert note.startswith(
            "'walk/1' in more than one file: items begin with the file, 'a/..."
        )
    with open_shapes(
        [path.relative_to(tmp_path) for path in (one, two, three)]
    ) as source:
        assert source.whole().items[3:] == ("b/walk/1", "c/b/walk/0")


def test_an_item_that_is_twice_in_a_file_is_refused_beside_another_file(
    tmp_path, problems
):
    one = tmp_path / "a.csv"
    two = tmp_path / "b.csv"
    for path in (one, two):
        path.write_text("item,landmark,x,y,z\nwalk/0,foot,1,2,3\nwalk/0,foot,1,2,3\n")
    assert "is also on line 2" in problems(read_shapes, [one, two])[0]


@pytest.mark.parametrize(
    ("change", "found"),
    [
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
        ({"weight": np.zeros((1, 2))}, "its dataset weight is not that of {}"),
        ({"more": np.zeros(1)}, "its dataset more is not that of {}"),
    ],
)
def test_shapes_that_do_not_go_together(tmp_path, shapes, problems, change, found):
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    write_shapes(one, shapes.take([0]))
    part = shapes.take([1])
    extras = {name: v for name, v in change.items() if name in ("weight", "more")}
    listed = {name: v for name, v in change.items() if name not in extras}
    write_shapes(two, part.replaced(**listed).with_extras(extras))
    (line,) = problems(read_shapes, [one, two])
    assert line.startswith(f"{two}: {found.format(one)}")
    assert line.endswith(SEPARATELY)


def test_files_without_sequences_units_edges_or_shapes_go_with_others(tmp_path, shapes):
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    three = tmp_path / "c.h5"
    write_shapes(
        one, shapes.take([0]).replaced(sequences=None, unit="unknown", edges=None)
    )
    write_shapes(two, shapes.take([]).replaced(unit="mm", extras={}, mirror_index=None))
    write_shapes(
        three, permuted_shapes(shapes.take([1]), [2, 0, 3, 1]).replaced(frame_rate=50.0)
    )
    found = read_shapes([one, two, three])
    assert found.sequences == ("", "walk")
    assert found.unit == "m"
    assert found.frame_rate == 50.0
    np.testing.assert_array_equal(found.edges, shapes.edges)
    np.testing.assert_array_equal(
        found.column("mirror_index"), shapes.column("mirror_index")
    )


# Landmarks


@pytest.mark.parametrize("together", [0, 64])
@pytest.mark.parametrize("by_file", [False, True])
def test_batches_run_over_the_ends_of_files_unless_asked(
    tmp_path, landmarks, same, monkeypatch, by_file, together
):
    monkeypatch.setattr("shapefit.io.source.MAX_OPEN", together)
    parts = (slice(0, 1), slice(1, 1), slice(1, 4), slice(4, 5))
    paths = [tmp_path / f"{rows}.h5" for rows in parts]
    for path, rows in zip(paths, parts, strict=True):
        save(path, landmarks.take(rows))
    ends = {rows.stop for rows in parts} if by_file else {5}
    with open_landmarks(paths) as source:
        assert source.count == 5
        assert source.head.unit == "px"
        assert source.head.y_axis == "down"
        for size in (1, 2, 3, 100):
            start = 0
            for batch in source.batches(size, by_file=by_file):
                stop = min(start + size, min(end for end in ends if end > start))
                same(batch, landmarks.take(slice(start, stop)))
                start = stop
            assert start == 5
        chosen = [
            item
            for part in source.chosen(np.array([0, 3, 4]), 2)
            for item in part.items
        ]
        assert chosen == [landmarks.items[row] for row in (0, 3, 4)]


def test_wrong_values_of_a_later_batch_are_named_by_their_row(
    tmp_path, landmarks, problems
):
    points = landmarks.as_columns().copy()
    points[3, 0, 3] = np.inf
    save(tmp_path / "a.h5", landmarks.replaced(landmarks=points.swapaxes(1, 2)))
    for rows in (None, slice(1, None)):
        with open_landmarks([tmp_path / "a.h5"], rows=rows) as source:
            (line,) = problems(list, source.batches(2))
        assert line.startswith(
            f"{tmp_path / 'a.h5'}:/landmarks[3]: landmark 'foot' is (inf, "
        )


def test_landmarks_of_low_confidence_are_hidden(tmp_path, landmarks):
    save(tmp_path / "a.h5", landmarks)
    with open_landmarks(
        [tmp_path / "a.h5"], InputOptions(min_confidence=0.5)
    ) as source:
        images = source.whole()
    low = landmarks.confidence < 0.5
    assert np.isnan(images.points[low]).all()
    np.testing.assert_array_equal(
        images.confidence, np.where(low, 0, landmarks.confidence)
    )


def test_landmarks_of_files_are_united(tmp_path, landmarks):
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    save(one, landmarks.take([0]).replaced(confidence=None, sequences=None))
    other = landmarks.take([1, 2]).replaced(
        landmark_names=("foot", "tail", "head", "right hand")
    )
    save(two, other)
    with open_landmarks([one, two]) as source:
        whole = source.whole()
    assert source.head.landmark_names == (
        "head",
        "left hand",
        "right hand",
        "foot",
        "tail",
    )
    assert whole.sequences == ("", "a", "b")
    np.testing.assert_array_equal(
        whole.as_columns()[0, :, :4], landmarks.as_columns()[0]
    )
    assert np.isnan(whole.as_columns()[0, :, 4]).all()
    np.testing.assert_array_equal(whole.confidence[0], [1, 1, 1, 1, 0])
    np.testing.assert_array_equal(
        whole.as_columns()[1:][..., [3, 4, 0, 2]], other.as_columns()
    )
    assert np.isnan(whole.as_columns()[1:, :, 1]).all()
    np.testing.assert_array_equal(
        whole.confidence[1:][:, [3, 4, 0, 2]], other.confidence
    )


def test_what_each_camera_says_is_of_its_images(tmp_path):
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for number, path in enumerate(paths):
        camera = {
            "camera_matrix": np.eye(3) * (number + 1),
            "image_size": np.array([640, 480]),
        }
        save(
            path,
            Landmarks(
                np.zeros((2, 2, 3)).swapaxes(1, 2),
                landmark_names="abc",
                items=("i", "j"),
                file_extras=camera,
            ),
        )
    with open_landmarks(paths) as source:
        whole = source.whole()
    np.testing.assert_array_equal(whole.column("camera_matrix")[:, 0, 0], [1, 1, 2, 2])
    assert whole.column("image_size").tolist() == [640, 480]


@pytest.mark.parametrize(
    ("key", "value", "known"), [("y_axis", "up", "down"), ("unit", "m", "px")]
)
def test_landmarks_that_do_not_go_together(
    tmp_path, landmarks, problems, key, value, known
):
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    save(one, landmarks.take([0]))
    save(two, landmarks.take([1]).replaced(**{key: value}))
    fault = f"its {key} is '{value}', that of {one} is '{known}'"
    assert problems(open_landmarks, [one, two]) == (f"{two}: {fault}; {SEPARATELY}",)


# Results


def test_results_that_do_not_go_together(tmp_path, results, problems):
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    save(one, results.take([0]))
    part = results.take([1])
    for other, found in (
        (
            part.replaced(landmark_names=tuple("abcd")),
            "its list of landmarks is 'a, b, c, d', that of {} is",
        ),
        (part.replaced(rotation=None), "its dataset rotation is not that of {}"),
        (
            part.replaced(mesh_vertices=np.zeros((1, 3, 2)).swapaxes(1, 2)),
            "its dataset mesh_vertices is not",
        ),
    ):
        save(two, other)
        (line,) = problems(open_results, [one, two])
        assert line.startswith(f"{two}: {found.format(one)}")
    save(two, part)
    with open_results([one, two]) as source:
        np.testing.assert_array_equal(
            source.whole().as_columns(), results.as_columns()[:2]
        )


# Keys of reading, by the command line


@pytest.fixture
def shapefit(tmp_path, monkeypatch):
    monkeypatch.setenv("SHAPEFIT_TRACEBACK", "0")

    def run(command):
        done = run_in(tmp_path, *shlex.split(command))
        return SimpleNamespace(code=done.returncode, text=done.stdout + done.stderr)

    return run


def test_one_individual_of_a_file(shapefit, tmp_path):
    names = [f"cam/person {n}/{frame}" for n in (1, 7) for frame in range(3)]
    sequences = [name.rpartition("/")[0] for name in names]
    shapes = np.arange(6 * 9.0).reshape(6, 3, 3)
    save(
        tmp_path / "r.h5",
        Fit(
            shapes.swapaxes(1, 2),
            landmark_names="abc",
            items=names,
            sequences=sequences,
        ),
    )
    assert shapefit("convert r.h5 -o one.h5 --set individual='person 7'").code == 0
    one = read_results(tmp_path / "one.h5")
    assert one.items == tuple(names[3:])
    np.testing.assert_array_equal(one.as_columns(), shapes[3:])
    for key, found in (
        (
            "individual='person 2'",
            "has no individual 'person 2'; there are person 1, person 7",
        ),
        ("y_axis=up", "has no effect on results"),
    ):
        refused = shapefit(f"convert r.h5 -o no.h5 --set {key}")
        assert refused.code == 2
        assert found in refused.text
    save(
        tmp_path / "l.h5",
        Landmarks(
            shapes[:, :2].swapaxes(1, 2),
            landmark_names="abc",
            items=names,
            sequences=sequences,
        ),
    )
    refused = shapefit("fit l.h5 -d people -o no.h5 --set individual='person 7'")
    assert refused.code == 2
    assert "`--individual` is for files of other tools" in refused.text


@pytest.mark.real_data
def test_the_recipe_for_motion_capture_gives_the_training_shapes(
    shapefit, tmp_path, project, real_data
):
    text = (project / "docs/experiments.md").read_text()
    recipe = re.findall(r"```\nshapefit (convert 86/.*?)```", text, re.S)[-1]
    (tmp_path / "86").symlink_to(real_data / "mocap/asfamc/86")
    assert shapefit(recipe.replace("86/*.amc", "86/86_01.amc 86/86_09.amc")).code == 0
    made = read_shapes([tmp_path / "subject86_24fps.h5"])
    known = read_shapes([real_data / "mocap/subject86_24fps.h5"])
    made = keep_landmarks(made, known.landmark_names, "made")
    assert made.frame_rate == 24.0
    assert made.unit == "m"
    assert {tuple(pair) for pair in made.edges} == {tuple(pair) for pair in known.edges}
    for trial in ("86_01", "86_09"):
        one, other = (
            each.as_columns()[[name == trial for name in each.sequences]]
            for each in (made, known)
        )
        np.testing.assert_allclose(
            one - one[..., :1], other, atol=1e-5
        )  # the pelvis is at 0


# What checks say


@pytest.mark.parametrize("count", [LIMIT, LIMIT + 2])
def test_all_problems_are_listed_or_counted(count):
    lines = [f"line {number}" for number in range(count)]
    expected = lines[:LIMIT] + [f"... and {count - LIMIT} more"] * (count > LIMIT)
    assert str(input_problems(lines)).split("\n") == expected
    assert str(input_problems(lines[:LIMIT], count)).split("\n") == expected
