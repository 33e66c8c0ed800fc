"""What a key of `input` asks for is done, or refused with the reason; each was ignored before."""

import json
import re
import shlex
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.io import open_landmarks, read_results, read_shapes
from shapefit.io.readers.items import keep_landmarks
from shapefit.io.records import LandmarkSet, ResultSet
from tests.cli.conftest import run_in
from tests.io.files import load, save


@pytest.fixture
def shapefit(tmp_path, monkeypatch):
    monkeypatch.setenv("SHAPEFIT_TRACEBACK", "0")

    def run(*arguments):
        done = run_in(tmp_path, *arguments)
        return SimpleNamespace(code=done.returncode, text=done.stdout + done.stderr)

    return run


def openpose(folder, x=100.0):
    folder.mkdir()
    for frame in range(3):
        numbers = [v for j in range(25) for v in (x + 3 * j, 200.0 + 5 * j + frame, 0.9)]
        people = {"version": 1.3, "people": [{"pose_keypoints_2d": numbers}]}
        (folder / f"a_{frame:03}.json").write_text(json.dumps(people))


def test_y_axis_of_a_format_that_has_its_own(shapefit, tmp_path):
    openpose(tmp_path / "cam")
    done = shapefit(
        "convert", "cam", "-o", "a.h5", "--set", "y_axis=up", "--set", "keypoints=body_25"
    )
    assert done.code == 0
    assert load(tmp_path / "a.h5").y_axis == "up"


def test_y_axis_against_what_a_file_of_ours_states(shapefit, tmp_path):
    images = LandmarkSet(
        landmarks=np.full((1, 2, 3), 20.0),
        confidence=None,
        landmark_names=("a", "b", "c"),
        items=("i",),
        y_axis="down",
    )
    save(tmp_path / "a.h5", images)
    done = shapefit("convert", "a.h5", "-o", "b.h5", "--set", "y_axis=up")
    assert done.code == 2
    assert "states that y points down" in done.text
    assert shapefit("convert", "a.h5", "-o", "b.h5", "--set", "y_axis=down").code == 0


def test_the_recipe_for_motion_capture_gives_the_training_shapes(
    shapefit, tmp_path, project, real_data
):
    recipe = re.findall(
        r"```\n(shapefit convert 86/.*?)```", (project / "docs/experiments.md").read_text(), re.S
    )
    command = shlex.split(recipe[-1].replace("86/*.amc", "86/86_01.amc 86/86_09.amc"))
    (tmp_path / "86").symlink_to(real_data / "mocap/asfamc/86")
    assert shapefit(*command[1:]).code == 0
    made = read_shapes([tmp_path / "subject86_24fps.h5"])
    known = read_shapes([real_data / "mocap/subject86_24fps.h5"])
    made = keep_landmarks(made, known.landmark_names, "made")
    assert (made.frame_rate, made.unit) == (24.0, "m")
    assert {tuple(pair) for pair in made.edges} == {tuple(pair) for pair in known.edges}
    for trial in ("86_01", "86_09"):
        own, others = (
            each.shapes[[name == trial for name in each.sequences]] for each in (made, known)
        )
        np.testing.assert_allclose(own - own[..., :1], others, atol=1e-5)  # the pelvis is at 0


TIDY = "item,landmark,x,y\ni,a,.25,.5\ni,b,.75,.125\nj,a,.1,.9\nj,b,.3,1.02\n"


def test_fractions_in_our_own_table_need_the_size(shapefit, tmp_path):
    (tmp_path / "a.csv").write_text(TIDY)
    refused = shapefit("convert", "a.csv", "-o", "b.h5")
    assert (refused.code, "image_size=[" in refused.text) == (2, True)
    assert shapefit("convert", "a.csv", "-o", "b.h5", "--set", "image_size=[200,100]").code == 0
    images = load(tmp_path / "b.h5")
    assert images.unit == "px"
    np.testing.assert_allclose(images.landmarks[0], [[50, 150], [50, 12.5]])


def test_small_points_about_a_centre_are_no_fractions(tmp_path):
    (tmp_path / "a.csv").write_text("item,landmark,x,y\ni,a,-.25,.5\ni,b,.25,-.5\n")
    with open_landmarks([tmp_path / "a.csv"]) as source:
        assert source.whole().landmarks.min() == -0.5


def test_a_number_of_a_frame_that_no_frame_has(shapefit, tmp_path):
    (tmp_path / "a.csv").write_text("frame,landmark,x,y\n1e300,a,10,20\n0,a,30,40\n")
    found = shapefit("convert", "a.csv", "-o", "b.h5")
    assert (found.code, "'1e300'" in found.text) == (2, True)


@pytest.fixture
def two_people(tmp_path):
    shapes = np.arange(6 * 9.0).reshape(6, 3, 3)
    names = [f"cam/person {n}/{frame}" for n in (1, 7) for frame in range(3)]
    result = ResultSet(
        shapes=shapes,
        landmark_names=("a", "b", "c"),
        items=tuple(names),
        sequences=tuple(name.rpartition("/")[0] for name in names),
    )
    save(tmp_path / "r.h5", result)
    return result


def test_one_individual_of_a_result(shapefit, tmp_path, two_people):
    assert shapefit("convert", "r.h5", "-o", "one.h5", "--set", "individual=person 7").code == 0
    one = read_results(tmp_path / "one.h5")
    assert one.items == two_people.items[3:]
    np.testing.assert_array_equal(one.shapes, two_people.shapes[3:])
    refused = shapefit("convert", "r.h5", "-o", "no.h5", "--set", "individual=person 2")
    assert (refused.code, "person 1" in refused.text) == (2, True)


@pytest.mark.parametrize("key", ["y_axis=up", "rename={a: z}"])
def test_what_would_change_the_landmarks_of_a_result_is_refused(shapefit, two_people, key):
    refused = shapefit("convert", "r.h5", "-o", "other.h5", "--set", key)
    assert (refused.code, "has no effect on results" in refused.text) == (2, True)


def test_every_second_item_of_each_sequence(shapefit, tmp_path, two_people):
    command = ("convert", "r.h5", "-o", "half.h5", "--set", "frame_rate=30", "--set", "every=2")
    assert shapefit(*command).code == 0
    half = read_results(tmp_path / "half.h5")
    assert half.items == tuple(two_people.items[row] for row in (0, 2, 3, 5))
    assert half.frame_rate == 15.0
