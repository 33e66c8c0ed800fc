"""Arguments of the functions: those of the schema, with its words, for a type checker
as at run time.
"""

import inspect
import os
import re
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pytest

import shapefit
from shapefit.api import arguments
from shapefit.api.files import Reading
from shapefit.config import CONFIGS
from shapefit.config.model import AUTO_TEXT, list_config_keys
from shapefit.convex.problem import Loss
from shapefit.io.options import InputOptions

SCRIPT = Path(__file__).with_name("typed_script.py")

OF_FILES = {
    "fit": {
        "landmarks",
        "dictionary",
        "format",
        "individual",
        "markers",
        "export",
        "output",
        "frames",
        "every",
    },
    "learn": {
        "shapes",
        "output",
        "format",
        "keypoints",
        "individual",
        "y_axis",
        "min_confidence",
        "image_size",
        "flip",
    },
    "evaluate": {"results", "truth", "output", "plots", "truth_frame"},
}
"""Keys that say how files are read or written; flip, of files of 2D landmarks."""

OF_ARRAYS = {
    "fit": {"landmarks", "dictionary", "weights", "config", "progress"},
    "learn": {"shapes", "progress"},
    "evaluate": {"result", "truth"},
}
"""Arguments that are no keys."""

SECTIONS = {
    ("fit", "camera"): arguments.Camera,
    ("fit", "prior"): arguments.Prior,
    ("fit", "save"): arguments.Save,
    ("learn", "prior"): arguments.LearnedPrior,
}


def hints_of(function):
    """Return the types of the arguments of a function by their keys."""
    hints = typing.get_type_hints(function, localns={"Mapping": typing.Mapping})
    hints.pop("return")
    return {arguments.KEY_OF.get(name, name): hint for name, hint in hints.items()}


def words_of(hint):
    """Return the words that a type lists, those of its parts too."""
    if typing.get_origin(hint) is typing.Literal:
        return set(typing.get_args(hint))
    parts = [part for part in typing.get_args(hint) if not isinstance(part, str)]
    return set().union(*map(words_of, parts))


def words_of_key(key):
    """Return the words that a key of the schema takes, `auto` included."""
    auto = {AUTO_TEXT} if AUTO_TEXT in key.field.metadata else set()
    return words_of(key.field.annotation) | auto


@pytest.mark.parametrize("name", arguments.COMMANDS)
def test_arguments_are_the_keys_of_the_command(name):
    keys = list_config_keys(CONFIGS[arguments.COMMANDS[name]])
    hints = hints_of(getattr(shapefit, name))
    top = {path[0] for path in keys} - {"data"}
    assert set(hints) - OF_ARRAYS[name] == top - OF_FILES[name]


@pytest.mark.parametrize("name", arguments.COMMANDS)
def test_arguments_take_the_words_of_their_keys(name):
    keys = list_config_keys(CONFIGS[arguments.COMMANDS[name]])
    hints = hints_of(getattr(shapefit, name))
    top = {path[0] for path in keys}
    for argument in set(hints) & top - OF_ARRAYS[name]:
        key = keys[argument,]
        assert words_of_key(key) == words_of(hints[argument]), argument


@pytest.mark.parametrize(("name", "section"), SECTIONS)
def test_sections_have_the_keys_of_the_schema(name, section):
    inner = {}
    for path, key in list_config_keys(CONFIGS[arguments.COMMANDS[name]]).items():
        if path[0] == section and path[1:]:
            inner[path[1]] = key
    hints = typing.get_type_hints(SECTIONS[name, section])
    assert set(hints) == set(inner)
    for key, hint in hints.items():
        assert words_of_key(inner[key]) == words_of(hint), key


def test_words_of_losses_are_those_that_are_taken():
    loss = inspect.signature(shapefit.solve, eval_str=True).parameters["loss"]
    assert words_of(loss.annotation) == {each.value for each in Loss}


def test_words_of_reading_are_those_that_are_taken():
    reading = typing.get_type_hints(Reading)
    options = typing.get_type_hints(InputOptions, localns={"Mapping": typing.Mapping})
    assert set(reading) == set(options)
    for key, hint in reading.items():
        assert words_of(hint) == words_of(options[key]), key


LANDMARKS = np.ones((1, 15, 2))


SHAPES = np.ones((4, 15, 3))


PROGRAM = (np.ones((2, 9)), np.ones((1, 3, 9)), 1)


UNKNOWN = [
    ("fit", (LANDMARKS,), "frame_rte", "did you mean `frame_rate`?"),
    ("fit", (LANDMARKS,), "heigth", "did you mean `height`?"),
    ("fit", (LANDMARKS,), "export", "it is for files"),
    ("fit", (LANDMARKS,), "individual", "it is for files: give it to what"),
    ("learn", (SHAPES,), "iteration", "did you mean `iterations`?"),
    ("evaluate", (SHAPES, SHAPES), "mach", "did you mean `match`?"),
    ("solve", PROGRAM, "weigths", "`weights`?"),
    ("solve", PROGRAM, "xyz", "are landmarks, ato"),
]
"""A function, what it is given, an unknown argument, and what is said of it."""


@pytest.mark.parametrize(("name", "given", "argument", "hint"), UNKNOWN)
def test_an_unknown_argument_names_the_nearest(name, given, argument, hint):
    function = getattr(shapefit, name)
    fault = rf"^{name}\.{argument}: there is no argument `{argument}`; .*"
    with pytest.raises(shapefit.InputError, match=fault + re.escape(hint)):
        function(*given, **{argument: 1})


ARRAY = "ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]"


@pytest.mark.slow
def test_a_type_checker_flags_what_is_wrong_and_nothing_else(project, tmp_path):
    mypy = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path)]
    done = subprocess.run(
        [*mypy, str(SCRIPT)],
        cwd=project,
        env=os.environ | {"MYPY_FORCE_COLOR": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = SCRIPT.read_text(encoding="utf-8").splitlines()
    wrong = [number for number, line in enumerate(lines, 1) if line.endswith("# wrong")]
    flagged = [int(line) for line in re.findall(r":(\d+): error: ", done.stdout)]
    revealed = re.findall(r'Revealed type is "(?:numpy\.)?(.*)"', done.stdout)
    assert len(wrong) == 16
    assert sorted(flagged) == wrong, done.stdout + done.stderr
    assert revealed == [ARRAY, ARRAY, f"{ARRAY} | None", "float"]
