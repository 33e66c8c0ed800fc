"""The command that `Next` names works as it stands, from where one stands."""

import json
import shlex
import shutil

import pytest
from shapefit.cli.main import run

FRAMES = "--frame-rate 25 --image-size 1280x720"


@pytest.fixture
def desk(project, tmp_path, monkeypatch):
    """Stand in a folder with ten frames of two people, and shapes in a folder whose
    name has a space.
    """
    for frame in sorted((project / "sample_data/openpose").iterdir())[:10]:
        (tmp_path / "cam 1").mkdir(exist_ok=True)
        shutil.copy(frame, tmp_path / "cam 1")
    (tmp_path / "my data").mkdir()
    shutil.copy(project / "sample_data/people_test.h5", tmp_path / "my data/shapes.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def follow(capsys):
    """Return what runs a command line, and then the one that it names, with files in
    the place of words that stand for some.
    """

    def follow(line, **files):
        capsys.readouterr()
        assert run(shlex.split(line)) == 0, capsys.readouterr().err
        printed = capsys.readouterr()
        told = (printed.out + printed.err).splitlines()
        following = [text.removeprefix("Next    ") for text in told if "Next" in text]
        if not following:
            return None
        words = shlex.split(following[0])
        assert words[0] == "shapefit"
        given = [files.get(word.partition(".")[0], word) for word in words[1:]]
        assert run(given) == 0, capsys.readouterr().err
        return following[0]

    return follow


def test_after_learn_dict_and_project(desk, follow):
    learn = "learn-dict 'my data/shapes.h5' -o 'my data/d.h5' --set k=4 --every 20"
    shapes = "my data/views.h5"
    run(shlex.split("project 'my data/shapes.h5' -o 'my data/views.h5'"))
    following = follow(learn, LANDMARKS=shapes)
    assert following == "shapefit fit LANDMARKS -d 'my data/d.h5' -o result.h5"
    project = "project 'my data/shapes.h5' -o 'my data/more.h5'"
    following = follow(project, DICT="my data/d.h5")
    assert following == "shapefit fit 'my data/more.h5' -d DICT.h5 -o result.h5"


@pytest.mark.parametrize(
    ("output", "shown"),
    [
        ("walk.h5", "walk.h5"),
        ("cam 1/walk.h5", "'cam 1/walk.h5'"),
        ("-walk.h5", "./-walk.h5"),
        ("walk.trc", "walk_person_1.trc walk_person_2.trc"),
        ("cam 1/walk.TRC", "'cam 1/walk_person_1.TRC' 'cam 1/walk_person_2.TRC'"),
        ("walk.metres.csv", "walk_person_1.metres.csv walk_person_2.metres.csv"),
        ("walk.csv", "walk.csv"),
        ("walk.angles.csv", None),
        ("walk.mot", None),
        ("walk.bvh", None),
    ],
)
def test_after_fit(desk, follow, output, shown):
    following = follow(f"fit 'cam 1' {FRAMES} --output={shlex.quote(output)}")
    assert following == (shown and f"shapefit view {shown}")


def test_after_fit_of_one_person(desk, follow):
    line = f"fit 'cam 1' {FRAMES} --individual 'person 2' -o walk.trc"
    assert follow(line) == "shapefit view walk.trc"


def test_after_fit_of_many_people(tmp_path, monkeypatch, project, follow):
    """Five people in a file: those of OpenPose, side by side."""
    monkeypatch.chdir(tmp_path)
    for frame in sorted((project / "sample_data/openpose").iterdir())[:6]:
        stated = json.loads(frame.read_text())
        one = stated["people"][0]["pose_keypoints_2d"]
        stated["people"] = [
            {
                "pose_keypoints_2d": [
                    x + 150 * k * (i % 3 == 0) for i, x in enumerate(one)
                ]
            }
            for k in range(5)
        ]
        (tmp_path / "cam").mkdir(exist_ok=True)
        (tmp_path / "cam" / frame.name).write_text(json.dumps(stated))
    for ending in ("trc", "metres.csv"):
        following = follow(f"fit cam {FRAMES} -o walk.{ending}")
        assert following == f"shapefit view 'walk_*.{ending}'"


def test_standard_output_has_nothing_to_go_on_with(desk, capsys):
    assert run(shlex.split("project 'my data/shapes.h5' -o -")) == 0
    assert "Next" not in capsys.readouterr().err
