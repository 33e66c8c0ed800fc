"""A key of `input` without effect on the files is an error, in every command that reads some."""

import json
import re
from importlib import import_module
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.config.commands.input import InputConfig
from shapefit.errors import InputError

SETTINGS = {
    "format": "auto",
    "keypoints": "body_25",
    "individual": "person 1",
    "track": "nearest",
    "likelihood_below": 0.01,
    "rename": {"hip": "root"},
    "image_size": [1920, 1080],
    "y_axis": "down",
    "landmarks": ["hip", "knee", "foot"],
}
"""Of every key a value."""

COUNT = {
    "ours.h5": "rename image_size y_axis landmarks",
    "scored.csv": "likelihood_below rename image_size y_axis landmarks",
    "shapes.h5": "rename landmarks",
    "openpose": "keypoints individual track likelihood_below rename image_size y_axis landmarks",
    "result.h5": "",
}
"""Kinds of input -> keys that count for them; `format` is checked wherever it is given."""

COMMANDS = {
    "convert": (["ours.h5", "scored.csv", "shapes.h5", "openpose", "result.h5"], "individual"),
    "fit": (["ours.h5", "scored.csv", "openpose"], ""),
    "project": (["shapes.h5"], ""),
    "learn-dict": (["shapes.h5"], ""),
}
"""Commands -> what they read, and the keys that they obey for any input."""


MODULES = {"convert": "convert", "fit": "fit.run", "project": "projection"}


def run_command(command, *settings, **arguments):
    config = load_config(command, None, settings, arguments)
    place = MODULES.get(command, "learn_dict.run")
    list(import_module(f"shapefit.pipelines.{place}").run(config))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, project):
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(0)
    names = ["hip", "knee", "foot", "head"]
    rows = ["item,landmark,x,y,z\n"]
    flat = ["item,landmark,x,y\n"]
    scored = ["item,landmark,x,y,confidence\n"]
    for item, name in product("abcdef", names):
        x, y, z = (rng.normal(size=3) * 100 + 300).round(3)
        rows.append(f"{item},{name},{x},{y},{z}\n")
        flat.append(f"{item},{name},{x},{y}\n")
        scored.append(f"{item},{name},{x},{y},0.5\n")
    for name, lines in (("shapes", rows), ("ours", flat), ("scored", scored)):
        (folder / f"{name}.csv").write_text("".join(lines))
    for name in ("shapes", "ours"):
        run_command("convert", files=str(folder / f"{name}.csv"), output=str(folder / f"{name}.h5"))
    run_command("learn-dict", shapes=str(folder / "shapes.h5"), output=str(folder / "d.h5"), k=2)
    given = {"landmarks": str(folder / "ours.h5"), "dictionary": str(folder / "d.h5")}
    run_command("fit", **given, output=str(folder / "result.h5"))
    (folder / "openpose").mkdir()
    for frame in range(3):
        points = np.column_stack([rng.normal(size=(25, 2)) * 50 + 300, np.full(25, 0.9)])
        person = {"pose_keypoints_2d": points.ravel().tolist()}
        text = json.dumps({"version": 1.3, "people": [person]})
        (folder / f"openpose/v_{frame:012d}_keypoints.json").write_text(text)
    return folder


def run(command, folder, name, key, tmp_path):
    path = str(folder / name)
    value = json.dumps(SETTINGS[key])
    given = {"convert": "files", "fit": "landmarks", "project": "shapes", "learn-dict": "shapes"}
    arguments = {given[command]: (path,), "output": str(tmp_path / "out.h5")}
    settings = [f"input.{key}={value}"]
    if name == "openpose" and key != "keypoints":
        settings.append("input.keypoints=body_25")
    if name == "openpose" and key == "individual":
        settings.append("input.track=nearest")
    if command == "fit":
        arguments["dictionary"] = "people" if name == "openpose" else str(folder / "d.h5")
    if command == "learn-dict":
        settings.append("k=1")
    run_command(command, *settings, **arguments)


CASES = [
    (command, name, key)
    for command, (names, _) in COMMANDS.items()
    for name in names
    for key in SETTINGS
    if key != "format"
]


def test_every_key_of_the_section_has_a_value_here():
    assert SETTINGS.keys() == InputConfig.model_fields.keys()


@pytest.mark.parametrize(("command", "name", "key"), CASES)
def test_what_has_no_effect_is_refused(folder, tmp_path, command, name, key):
    counts = key in COUNT[name].split() or key in COMMANDS[command][1].split()
    try:
        run(command, folder, name, key, tmp_path)
        refused = False
    except InputError as error:
        refused = (
            re.search(
                rf"\b{key}\b.* (has no effect (here, only|on results)|it is gone: )", str(error)
            )
            is not None
        )
    assert refused is not counts
    assert not refused or not (tmp_path / "out.h5").exists()


def test_csv_holds_no_frame_rate(folder, tmp_path):
    given = {"files": str(folder / "ours.h5"), "output": str(tmp_path / "out.csv")}
    with pytest.raises(InputError, match="`frame_rate` has no effect here"):
        run_command("convert", **given, frame_rate=25)
    assert not Path(given["output"]).exists()
