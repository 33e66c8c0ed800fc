"""Files of results as one source, and keys of reading by the command line."""

import re
import shlex
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.io import (
    read_results,
    read_shapes,
)
from shapefit.io.readers.items import keep_landmarks
from shapefit.io.source import open_results
from shapefit.records import Fit, Landmarks
from tests.cli.conftest import run_in
from tests.io.files import save

OTHER_FIELDS = [
    (
        {"landmark_names": tuple("abcd")},
        "its list of landmarks is 'a, b, c, d', that of {} is",
    ),
    ({"rotation": None}, "its dataset rotation is not that of {}"),
    (
        {"mesh_vertices": np.zeros((1, 2, 3))},
        "its dataset mesh_vertices is not",
    ),
]
"""Fields of the second file, and what is said of it beside the first."""


@pytest.fixture
def two_results(tmp_path, results):
    """Write two results, the second with these fields."""

    def write(**fields):
        one = tmp_path / "a.h5"
        two = tmp_path / "b.h5"
        save(one, results.take([0]))
        save(two, results.take([1]).replaced(**fields))
        return [one, two]

    return write


@pytest.mark.parametrize(("fields", "fault"), OTHER_FIELDS)
def test_results_that_do_not_go_together(two_results, problems, fields, fault):
    one, two = two_results(**fields)
    (line,) = problems(open_results, [one, two])
    assert line.startswith(f"{two}: {fault.format(one)}")


def test_results_that_go_together(two_results, results):
    with open_results(two_results()) as source:
        shapes = source.whole().shapes
    assert_array_equal(shapes, results.shapes[:2])


@pytest.fixture
def shapefit(tmp_path, monkeypatch):
    """Run a command in the folder; return its exit code and all that it says."""
    monkeypatch.setenv("SHAPEFIT_TRACEBACK", "0")

    def run(command):
        done = run_in(tmp_path, *shlex.split(command))
        return SimpleNamespace(code=done.returncode, text=done.stdout + done.stderr)

    return run


TWO_PEOPLE = {
    "landmark_names": "abc",
    "items": [f"cam/person {who}/{frame}" for who in (1, 7) for frame in range(3)],
    "sequences": [f"cam/person {who}" for who in (1, 7) for _ in range(3)],
}


SHAPES_OF_TWO = np.arange(6 * 9.0).reshape(6, 3, 3)


@pytest.fixture
def result_of_two(tmp_path):
    path = tmp_path / "r.h5"
    save(path, Fit(SHAPES_OF_TWO, **TWO_PEOPLE))
    return path


def test_one_individual_of_a_file(shapefit, tmp_path, result_of_two):
    done = shapefit("convert r.h5 -o one.h5 --set individual='person 7'")
    one = read_results(tmp_path / "one.h5")
    assert done.code == 0
    assert one.items == tuple(TWO_PEOPLE["items"][3:])
    assert_array_equal(one.shapes, SHAPES_OF_TWO[3:])


REFUSED_KEYS = [
    (
        "individual='person 2'",
        "has no individual 'person 2'; there are person 1, person 7",
    ),
    ("y_axis=up", "has no effect on results"),
]


@pytest.mark.parametrize(("key", "fault"), REFUSED_KEYS)
def test_keys_that_have_no_effect_on_a_result_are_refused(
    shapefit, result_of_two, key, fault
):
    done = shapefit(f"convert r.h5 -o no.h5 --set {key}")
    assert done.code == 2
    assert fault in done.text


def test_individuals_are_chosen_of_files_of_other_tools(shapefit, tmp_path):
    save(tmp_path / "l.h5", Landmarks(SHAPES_OF_TWO[..., :2], **TWO_PEOPLE))
    done = shapefit("fit l.h5 -d people -o no.h5 --set individual='person 7'")
    assert done.code == 2
    assert "`--individual` is for files of other tools" in done.text


def points_of(shapes, sequence):
    """Return the shapes (n, p, 3) of a sequence."""
    return shapes.shapes[np.array(shapes.sequences) == sequence]


def bones(shapes):
    return {tuple(pair) for pair in shapes.edges}


@pytest.mark.real_data
def test_the_recipe_for_motion_capture_gives_the_training_shapes(
    shapefit, tmp_path, project, real_data
):
    """In which the pelvis is at 0."""
    text = (project / "docs/experiments.md").read_text()
    *_, recipe = re.findall(r"```\nshapefit (convert 86/.*?)```", text, re.S)
    (tmp_path / "86").symlink_to(real_data / "mocap/asfamc/86")
    done = shapefit(recipe.replace("86/*.amc", "86/86_01.amc 86/86_09.amc"))
    every_landmark = read_shapes([tmp_path / "subject86_24fps.h5"])
    known = read_shapes([real_data / "mocap/subject86_24fps.h5"])
    made = keep_landmarks(every_landmark, known.landmark_names, "made")
    assert done.code == 0
    assert made.frame_rate == 24.0
    assert made.unit == "m"
    assert bones(made) == bones(known)
    for trial in ("86_01", "86_09"):
        points = points_of(made, trial)
        about_pelvis = points - points[:, :1]
        assert_allclose(about_pelvis, points_of(known, trial), atol=1e-5)
