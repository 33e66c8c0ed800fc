"""The walk through the files of the package: down the map of CONTRIBUTING.md, with few climbs."""

import re
import subprocess
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.io import landmark_writer, write_dictionary, write_shapes
from shapefit.io.records import LandmarkSet, ShapeSet

PROJECT = Path(__file__).resolve().parents[1]

RECORDER = """
import sys
from shapefit.cli.main import run

files = {}

def importing(frame):
    while frame:
        if frame.f_code.co_name == "<module>" and frame.f_globals["__name__"] != "__main__":
            return True
        frame = frame.f_back

def record(frame, event, argument):
    name = frame.f_globals.get("__name__", "")
    own = name.startswith("shapefit") and not frame.f_code.co_name.startswith(("<", "__"))
    if event == "call" and own and not importing(frame):
        files.setdefault(name)

sys.setprofile(record)
code = run(sys.argv[1:])
sys.setprofile(None)
print("files", *files)
sys.exit(code)
"""
"""Prints the files in the order of the first call into each, as somebody reads them who follows.

What runs while a module is imported is no step of the command.
"""

MOST_CLIMBS = {"fit": 12, "eval": 8}
"""Steps from a file to one of a room higher on the map; the rest of the walk goes down."""

COMMANDS = {
    "fit": ("views.h5", "-d", "dictionary.h5", "-o", "result.h5"),
    "eval": (
        *("result.h5", "--truth", "truth.h5", "-o", "report"),
        *("--set", "plots=false", "--set", "view=false"),
    ),
}


@pytest.fixture(scope="module")
def walks(tmp_path_factory) -> dict[str, list[str]]:
    """The files of each command in the order of a reader."""
    folder = tmp_path_factory.mktemp("walk")
    rng = np.random.default_rng(0)
    names, items, atoms = tuple("abcdef"), tuple("12345"), rng.normal(size=(4, 3, 6))
    write_dictionary(folder / "dictionary.h5", Dictionary(atoms, names, atoms[0]))
    write_shapes(folder / "truth.h5", ShapeSet(rng.normal(size=(5, 3, 6)), names, items))
    with landmark_writer(folder / "views.h5") as writer:
        landmarks = rng.normal(size=(5, 2, 6))
        writer.append(LandmarkSet(landmarks=landmarks, landmark_names=names, items=items))
    found = {}
    for command, arguments in COMMANDS.items():
        done = subprocess.run(
            [sys.executable, "-c", RECORDER, command, *arguments],
            capture_output=True, text=True, cwd=folder, timeout=120, check=True,
        )  # fmt: skip
        found[command] = done.stdout.splitlines()[-1].split()[1:]
    return found


def order_of_the_map() -> list[str]:
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| `(shapefit/\w+|cli)(?:/|\.py)` \|", text, flags=re.MULTILINE)
    return ["shapefit.cli" if room == "cli" else room.replace("/", ".") for room in found]


def room_of(file: str) -> str:
    return ".".join(file.split(".")[:2])


def climbs(files: Sequence[str], order: list[str]) -> list[str]:
    """Return the steps from a file to one that is in a higher room."""
    rank = {file: order.index(room_of(file)) for file in files if room_of(file) in order}
    return [f"{a} -> {b}" for a, b in pairwise(rank) if rank[b] < rank[a]]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_climbs_seldom(walks, command):
    found = climbs(walks[command], order_of_the_map())
    assert len(found) <= MOST_CLIMBS[command], "\n".join(found)


def test_a_fit_passes_through_the_rooms_of_the_paper(walks):
    rooms = {room_of(file).removeprefix("shapefit.") for file in walks["fit"]}
    assert room_of(walks["fit"][0]) == "shapefit.cli"
    assert {"config", "pipelines", "io", "lifting", "convex", "dictionary", "geometry"} <= rooms
    assert not {"evaluation", "viewer", "verification"} & rooms


def test_a_fit_of_one_file_knows_no_parts_and_reads_no_config_after_its_plan(walks):
    files = walks["fit"]
    assert not [file for file in files if file.startswith("shapefit.pipelines.parts")]
    planned = files.index("shapefit.pipelines.fit.plan")
    assert not [file for file in files[planned:] if file.startswith("shapefit.config")]


def test_a_climb_is_seen():
    walk = ["shapefit.a", "shapefit.c.one", "shapefit.b", "shapefit.d", "shapefit.a.other"]
    order = [f"shapefit.{room}" for room in "abcd"]
    found = ["shapefit.c.one -> shapefit.b", "shapefit.d -> shapefit.a.other"]
    assert climbs(walk, order) == found
