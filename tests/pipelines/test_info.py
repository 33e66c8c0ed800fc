"""`info`: what files hold, in words that are true."""

import shutil
from pathlib import Path

import pytest

from shapefit.config import load_config
from shapefit.io.inputs import in_words
from shapefit.pipelines.info import run
from shapefit.pipelines.partition.run import run as fit

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


def info(*files: Path):
    """Return the outcome of the command."""
    (outcome,) = run(load_config("info", None, (), {"files": files}))
    return outcome


def lines(text: str) -> dict[str, str]:
    """Return what is said under each word."""
    rows = (line.split(":", 1) for line in text.splitlines() if line.startswith("  "))
    return {name.strip(): value.strip() for name, value in rows}


def test_shapes():
    told = lines(info(SAMPLES / "people_test.h5").note)
    assert told["shapes"] == "640"
    assert told["sequences"].startswith("8: ")
    assert told["frame rate"] == "24 Hz"
    assert told["unit"] == "m"
    assert told["missing"] == "0.0% of the landmarks"
    assert told["next"].startswith("shapefit learn-dict ")


def test_an_animal_is_no_person():
    told = lines(info(SAMPLES / "animal_walk.csv").note)  # it has hips, knees, shoulders, elbows
    assert told["next"].split()[3:5] == ["-d", "DICT.h5"]


def test_landmarks():
    told = lines(info(SAMPLES / "cars_views.h5").note)
    assert told["images"] == "108"
    assert told["landmarks"].startswith("72: ")
    assert told["camera"] == "camera_matrix"
    assert told["next"].startswith("shapefit fit ")
    assert 0 < float(told["missing"].split("%")[0]) < 100


def test_files_of_one_recording_are_one_input():
    options = ("keypoints=body_25",)
    files = sorted((SAMPLES / "openpose").glob("*.json"))
    (outcome,) = run(load_config("info", None, options, {"files": files}))
    assert outcome.note.startswith(f"{SAMPLES / 'openpose'} (36 files)")
    told = lines(outcome.note)
    assert told["images"] == "72"
    assert "openpose/*.json' -d people " in told["next"]


def test_commands_are_as_they_are_typed(tmp_path, monkeypatch):
    file = tmp_path / "my walk.h5"
    file.write_bytes((SAMPLES / "people_test.h5").read_bytes())
    told = lines(info(file).note)
    assert told["next"] == f"shapefit learn-dict '{file}' -o dict.h5"
    monkeypatch.chdir(tmp_path)
    told = lines(info(file).note)
    assert told["next"] == "shapefit learn-dict 'my walk.h5' -o dict.h5"


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
    told = lines(note)
    assert told["kind"] == "folder with result of posterior"
    assert told["parts"] == f"{len(results)}, {in_words(size)}"
    images = [int(lines(info(file).note)["images"]) for file in results]
    assert int(told["images"]) == sum(images)
    assert told["landmarks"] == lines(info(results[0]).note)["landmarks"]
    assert info(results[0]).note.startswith(f"{results[0]}\n")


@pytest.mark.parametrize(("number", "change"), [(0, "spoiled"), (0, "removed")])
def test_a_part_that_cannot_be_read_is_named(fitted, tmp_path, number, change):
    shutil.copytree(fitted, tmp_path / "out")
    part = tmp_path / f"out/part-0000{number}.h5"
    data = part.read_bytes()
    part.unlink() if change == "removed" else part.write_bytes(data[:2000] + bytes(len(data)))
    outcome = info(tmp_path / "out")
    (failure,) = outcome.failures
    assert failure.item == str(part)
