"""`info`: what files hold, in words that are true."""

from pathlib import Path

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.io import csv_file
from shapefit.io.inputs import format_bytes
from shapefit.pipelines.info import describe_files as run
from shapefit.pipelines.info import next_command
from shapefit.pipelines.partition.run import fit_parts as fit
from shapefit.records import Landmarks
from tests.io.files import save

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


def info(*files: Path):
    """Return the outcome of the command."""
    (outcome,) = run(load_config("info", None, (), {"files": files}))
    return outcome


def lines(text: str) -> dict[str, str]:
    """Return what is said under each word."""
    rows = (line.split(":", 1) for line in text.splitlines() if line.startswith("  "))
    return {name.strip(): value.strip() for name, value in rows}


def test_numbers():
    found = info(SAMPLES / "people_test.h5", SAMPLES / "people_views.csv")
    assert found.numbers.images == 12
    shapes, images = (each["numbers"] for each in found.data())
    assert shapes["items"] == 640
    assert shapes["sequences"] == 8
    assert shapes["frame_rate"] == 24
    assert shapes["missing"] == 0
    assert images["items"] == 12
    assert images["landmarks"] == 15
    assert 0 < images["missing"] < 0.5
    (dictionary,) = info(SAMPLES.parent / "shapefit/data/people.h5").data()
    assert dictionary["numbers"]["atoms"] == 64
    assert dictionary["numbers"]["components"] > 1
    assert dictionary["numbers"]["items"] is None


def test_shapes():
    row = lines(info(SAMPLES / "people_test.h5").note)
    assert row["shapes"] == "640"
    assert row["sequences"].startswith("8: ")
    assert row["frame rate"] == "24 Hz"
    assert row["unit"] == "m"
    assert row["missing"] == "0.0% of the landmarks"
    assert row["next"].startswith("shapefit learn-dict ")


def test_landmarks():
    row = lines(info(SAMPLES / "cars_views.h5").note)
    assert row["images"] == "108"
    assert row["landmarks"].startswith("72: ")
    assert row["camera"] == "camera_matrix"
    assert row["next"].startswith("shapefit fit ")
    assert 0 < float(row["missing"].split("%")[0]) < 100
    # an animal has hips, knees, shoulders, and is no person
    of_animal = lines(info(SAMPLES / "animal_walk.csv").note)
    assert "-d DICT.h5" in of_animal["next"]
    assert "shapefit learn-dict SHAPES -o DICT.h5" in of_animal["dictionary"]


def test_missing_frames_are_said(tmp_path):
    names = tuple("abc")
    images = Landmarks(
        (100.0 + np.arange(36).reshape(6, 2, 3)).swapaxes(1, 2),
        landmark_names=names,
        items=tuple("123456"),
        sequences=("s", "s", "s", "t", "t", "t"),
        frame_rate=30.0,
        frames=np.array([0, 1, 4, 7, 8, 69]),
    )
    save(tmp_path / "gaps.h5", images)
    row = lines(info(tmp_path / "gaps.h5").note)
    assert row["gaps"] == "62 frames missing, at most 60 (2 s), before 6"
    save(tmp_path / "whole.h5", images.take([0, 1, 3, 4]))
    assert not {"gaps", "frames"} & lines(info(tmp_path / "whole.h5").note).keys()
    save(tmp_path / "none.h5", images.without(["frame"]))
    row = lines(info(tmp_path / "none.h5").note)
    assert row["frames"] == "not numbered, so one follows the other"


def test_files_of_one_recording_are_one_input():
    options = ("keypoints=body_25",)
    files = sorted((SAMPLES / "openpose").glob("*.json"))
    (outcome,) = run(load_config("info", None, options, {"files": files}))
    assert outcome.note.startswith(f"{SAMPLES / 'openpose'} (36 files)")
    row = lines(outcome.note)
    assert row["images"] == "72"
    assert row["next"].endswith(
        "openpose/*.json' -d people -o result.h5 --keypoints body_25"
    )


def test_commands_are_as_they_are_typed(tmp_path, monkeypatch):
    file = tmp_path / "my walk.h5"
    file.write_bytes((SAMPLES / "people_test.h5").read_bytes())
    row = lines(info(file).note)
    assert row["next"] == f"shapefit learn-dict '{file}' -o dict.h5"
    monkeypatch.chdir(tmp_path)
    row = lines(info(file).note)
    assert row["next"] == "shapefit learn-dict 'my walk.h5' -o dict.h5"


def test_files_of_several_folders_are_named_by_each():
    files = [Path(f"{folder}/{number}.json") for folder in "ab" for number in range(2)]
    command = next_command("landmarks", files, (), None)
    assert command == "shapefit fit 'a/*.json' 'b/*.json' -d DICT.h5 -o result.h5"


def test_of_a_long_table_images_are_estimated(monkeypatch):
    head = csv_file.read_csv_head
    monkeypatch.setattr(
        csv_file, "read_csv_head", lambda *given: (head(*given)[0], 1e-3)
    )
    assert lines(info(SAMPLES / "cars_views.csv").note)["images"] == "about 110,000"


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A folder of results, of two files."""
    folder = tmp_path_factory.mktemp("fitted") / "out"
    views = (SAMPLES / "people_views.csv", SAMPLES / "one_person.csv")
    inputs = {"landmarks": views, "dictionary": "people", "output": f"{folder}/"}
    list(fit(load_config("fit", None, (), inputs)))
    return folder


def test_a_folder_of_results_is_one_input(fitted):
    results = sorted(fitted.glob("part-*"))
    size = sum(path.stat().st_size for path in results)
    note = info(fitted).note
    assert note.startswith(f"{fitted}\n")
    row = lines(note)
    assert row["kind"] == "folder of results"
    assert row["parts"] == f"{len(results)}, {format_bytes(size)}"
    images = [int(lines(info(file).note)["images"]) for file in results]
    assert int(row["images"]) == sum(images)
