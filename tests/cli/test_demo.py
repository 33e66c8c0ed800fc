"""`shapefit demo`: the commands that it shows are those that it runs."""

import errno
import json
import shlex
import shutil
from unittest.mock import Mock

import pytest
from shapefit.cli.main import run

from shapefit.config import paths


def test_the_page_of_the_samples(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(["demo", "my walk"]) == 0
    told = capsys.readouterr().err
    shown = [line[2:] for line in told.splitlines() if line.startswith("$ ")]
    assert [shlex.split(line)[:2] for line in shown] == [
        ["shapefit", "fit"],
        ["shapefit", "view"],
    ]
    assert "72 of 72 images trusted" in told
    assert "open 'my walk/walk.html' in a browser" in told
    page = tmp_path / "my walk/walk.html"
    made = page.read_bytes()
    page.unlink()
    assert run(shlex.split(shown[1])[1:]) == 0  # what is shown does the same
    assert page.read_bytes() == made
    capsys.readouterr()
    assert run(["demo", "my walk", "--json", "-q"]) == 0  # once more, over its own
    told = json.loads(capsys.readouterr().out)
    assert told["command"] == "demo"
    assert told["done"] == 72
    assert [name.rpartition("/")[2] for name in told["written"]] == [
        "walk.h5",
        "walk.html",
    ]


@pytest.mark.parametrize("name", ["mine.txt", "openpose/other.json", "openpose"])
def test_files_of_others_are_left_alone(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "there" / name
    other.parent.mkdir(parents=True)
    other.write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    assert run(["demo", "there"]) == 2
    assert sorted(tmp_path.rglob("*")) == before
    told = capsys.readouterr().err
    assert f"files that are not of the demo, such as {other.name}" in told
    assert "name a new folder: shapefit demo FOLDER" in told


def test_a_detection_that_was_changed_is_not_replaced(
    tmp_path, monkeypatch, capsys, project
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there/openpose").mkdir(parents=True)
    name = "walk_000000000000_keypoints.json"
    (tmp_path / "there/openpose" / name).write_text('{"people": []}')
    assert run(["demo", "there"]) == 2
    assert f"such as {name}" in capsys.readouterr().err


def test_a_full_disk_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(shutil, "copyfile", Mock(side_effect=full))
    assert run(["demo"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_installation_without_sample_data_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(paths, "find_installed", lambda folder: tmp_path / folder)
    assert run(["demo"]) == 2
    assert "this installation has no sample data" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("preset", "needs"),
    [("fit -c demo", "landmarks"), ("learn-dict -c cars", "shapes")],
)
def test_an_installed_config_says_which_files_it_needs(preset, needs, capsys):
    assert run(preset.split()) == 2
    told = capsys.readouterr().err
    assert "which has settings and no files" in told
    assert f"missing key '{needs}'" in told
