"""Keys and values of earlier versions are errors that name what took their place."""

from __future__ import annotations

import re

import pytest

from shapefit.config import CONFIGS, load_config
from shapefit.config.expectation import dotted_keys
from shapefit.config.old_keys import OLD_KEYS, OLD_VALUES
from shapefit.errors import InputError

COMMANDS = {place.rpartition(".")[2]: command for command, place in CONFIGS.places.items()}

KEYS = [
    (COMMANDS[schema], key, text) for schema, gone in OLD_KEYS.items() for key, text in gone.items()
]
VALUES = [
    (COMMANDS[schema], *pair, text)
    for schema, gone in OLD_VALUES.items()
    for pair, text in gone.items()
]


def problems(command, *options):
    with pytest.raises(InputError) as caught:
        load_config(command, None, options)
    return caught.value.problems


@pytest.mark.parametrize(("command", "key", "text"), KEYS)
def test_an_old_key_names_its_successor(command, key, text):
    lines = problems(command, f"{key}=1")
    assert f"--set {key}=1: {key!r} is no longer a key; {text}" in lines


@pytest.mark.parametrize(("command", "key", "value", "text"), VALUES)
def test_an_old_value_names_its_successor(command, key, value, text):
    lines = problems(command, f"{key}={value}")
    assert f"--set {key}={value}: {value!r} is no longer a value here; {text}" in lines


def test_an_old_key_in_a_file_has_its_place(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("method: alternate+\nsolver:\n  name: admm\nloss: l1\n")
    with pytest.raises(InputError) as caught:
        load_config("fit", path)
    lines = [line for line in caught.value.problems if "no longer" in line]
    places = {re.match(r".*c\.yaml:(\d+:\d+):", line).group(1) for line in lines}
    assert places == {"1:9", "3:3", "4:7"}


def test_an_old_key_in_the_section_of_a_sweep_names_its_successor(tmp_path):
    (line,) = [line for line in problems("sweep", "fit={beta: 2}") if "no longer" in line]
    assert "'beta' is no longer a key; use `outliers.threshold`" in line
    (tmp_path / "a.h5").touch()
    options = (
        f"fit={{landmarks: {tmp_path}/a.h5, dictionary: {tmp_path}/a.h5}}",
        f"truth={tmp_path}/a.h5",
        "output=out",
        "vary={fit.path: [1]}",
    )
    (line,) = problems("sweep", *options)
    assert "fit.path=1: 'path' is no longer a key; use `shapefit sweep`" in line


@pytest.mark.parametrize(("command", "key", "text"), KEYS)
def test_a_successor_exists_and_an_old_key_does_not(command, key, text):
    known = set(dotted_keys(CONFIGS[command]))
    assert key not in known
    if "shapefit sweep" in text:
        known = set(dotted_keys(CONFIGS["sweep"]))
    named = [re.match(r"[\w.]+", word).group() for word in re.findall(r"`([\w.]+[^`]*)`", text)]
    for word in named:
        assert word in {*known, "shapefit", "python", "per", "orthogonal", "shared", "tolerance"}


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("fit", ["outliers={method: l1, threshold: 0.3}"]),
        ("fit", ["method=convex+refine", "alternation={signed: true}"]),
        ("fit", ["alternation.views=all"]),
        ("fit", ["rotations=orthogonal"]),
        ("learn-dict", ["method=pca-bases", "bases=0.9"]),
        ("project", ["camera.view=[[1,0,0],[0,1,0],[0,0,1]]", "camera.scale=2"]),
    ],
)
def test_the_successors_are_accepted(tmp_path, command, options):
    file = tmp_path / "a.h5"
    file.touch()
    arguments = {
        "fit": {"landmarks": (str(file),), "dictionary": str(file)},
        "learn-dict": {"shapes": (str(file),)},
        "project": {"shapes": (str(file),)},
    }[command]
    load_config(command, None, options, {**arguments, "output": str(tmp_path / "out.h5")})
