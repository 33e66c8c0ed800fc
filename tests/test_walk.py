"""The walk of a fit through the rooms: down the map of CONTRIBUTING.md, back up at most twice."""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.io import landmark_writer, write_dictionary
from shapefit.io.records import LandmarkSet

PROJECT = Path(__file__).resolve().parents[1]

RECORDER = """
import sys
from shapefit.cli.main import run

rooms = {}

def importing(frame):
    while frame:
        if frame.f_code.co_name == "<module>" and frame.f_globals["__name__"] != "__main__":
            return True
        frame = frame.f_back

def record(frame, event, argument):
    name = frame.f_globals.get("__name__", "")
    if event == "call" and name.startswith("shapefit") and not importing(frame):
        room = ".".join(name.split(".")[:2])
        rooms.setdefault(room, f"{name}.{frame.f_code.co_name}")

sys.setprofile(record)
code = run(sys.argv[1:])
sys.setprofile(None)
print("\\n".join(f"{room} {first}" for room, first in rooms.items()))
sys.exit(code)
"""
"""Prints the rooms in the order of the first call into each, and what was called.

What runs while a module is imported is no step of the fit.
"""


@pytest.fixture(scope="module")
def walk(tmp_path_factory) -> dict[str, str]:
    """The rooms of one fit, each with the first function of it that was called."""
    folder = tmp_path_factory.mktemp("walk")
    rng = np.random.default_rng(0)
    names, atoms = tuple("abcdef"), rng.normal(size=(4, 3, 6))
    write_dictionary(folder / "dictionary.h5", Dictionary(atoms, names, atoms[0]))
    with landmark_writer(folder / "views.h5") as writer:
        landmarks = rng.normal(size=(5, 2, 6))
        writer.append(LandmarkSet(landmarks=landmarks, landmark_names=names, items=tuple("12345")))
    command = ["fit", "views.h5", "-d", "dictionary.h5", "-o", "result.h5"]
    done = subprocess.run(
        [sys.executable, "-c", RECORDER, *command],
        capture_output=True, text=True, cwd=folder, timeout=120, check=True,
    )  # fmt: skip
    return dict(line.split(" ", 1) for line in done.stdout.splitlines())


def order_of_the_map() -> list[str]:
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| `(shapefit/\w+|cli)(?:/|\.py)` \|", text, flags=re.MULTILINE)
    return ["shapefit.cli" if room == "cli" else room.replace("/", ".") for room in found]


def climbs(walked: list[str], order: list[str]) -> list[str]:
    """Return the steps of a walk that go up."""
    steps = pairwise(walked)
    return [f"{a} -> {b}" for a, b in steps if order.index(b) < order.index(a)]


def test_a_fit_goes_down_the_map_and_back_up_at_most_twice(walk):
    found = climbs(list(walk), order_of_the_map())
    assert len(found) <= 2, (found, walk)


def test_a_fit_passes_through_the_rooms_of_the_paper(walk):
    assert next(iter(walk)) == "shapefit.cli"
    passed = {"config", "pipelines", "io", "lifting", "convex", "dictionary", "geometry"}
    assert {f"shapefit.{room}" for room in passed} <= set(walk)
    assert not {"shapefit.evaluation", "shapefit.viewer", "shapefit.verification"} & set(walk)


def test_a_climb_is_seen():
    assert climbs(["a", "c", "b", "d", "a"], ["a", "b", "c", "d"]) == ["c -> b", "d -> a"]
