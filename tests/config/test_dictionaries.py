"""`-d NAME`: an installed dictionary, unless a file has that name."""

from pathlib import Path

import pytest

import shapefit
from shapefit.config import find_config, load_config
from shapefit.config.paths import DICTIONARIES, find_dictionaries
from shapefit.errors import InputError
from shapefit.io.skeletons import FURTHER
from shapefit.io.skeletons import PEOPLE as PEOPLE_JOINTS

PEOPLE = DICTIONARIES / "people.h5"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "a.h5").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def dictionary_of(name, **arguments):
    config = load_config(
        "fit", None, (), {"landmarks": ("a.h5",), "output": "r.h5", "dictionary": name} | arguments
    )
    return config.dictionary


def test_a_name_is_an_installed_file():
    assert find_dictionaries()["people"] == PEOPLE
    assert dictionary_of("people") == PEOPLE


def test_people_need_no_file_but_the_landmarks():
    for name, method in (("people", "posterior"), ("sequences", "sequences")):
        arguments = {"landmarks": ("a.h5",), "dictionary": "people", "output": "r.h5"}
        config = load_config("fit", find_config("fit", Path(name)), (), arguments)
        assert (config.method, config.dictionary) == (method, PEOPLE)


def test_a_file_wins_and_a_folder_does_not(folder):
    (folder / "people").mkdir()
    assert dictionary_of("people") == PEOPLE
    (folder / "people").rmdir()
    (folder / "people").touch()
    assert dictionary_of("people") == folder / "people"


def test_a_config_names_it_too_unless_a_file_beside_the_config_does(folder):
    (folder / "configs").mkdir()
    config = folder / "configs" / "fit.yaml"
    config.write_text("landmarks: ../a.h5\ndictionary: people\noutput: r.h5\n")
    assert load_config("fit", config).dictionary == PEOPLE
    (folder / "people").touch()
    assert load_config("fit", config).dictionary == PEOPLE
    (folder / "configs" / "people").touch()
    assert load_config("fit", config).dictionary == folder / "configs" / "people"


@pytest.mark.parametrize("path", ["models/people", "./people", "people.h5"])
def test_a_path_is_no_name(path, folder):
    with pytest.raises(InputError, match=r"no file .*people(\.h5)?; check the spelling"):
        dictionary_of(path)
    config = folder / "fit.yaml"
    config.write_text(f"landmarks: a.h5\ndictionary: {path}\noutput: r.h5\n")
    with pytest.raises(InputError, match="check the spelling"):
        load_config("fit", config)


def test_an_unknown_name_lists_those_that_there_are(folder):
    with pytest.raises(InputError) as caught:
        dictionary_of("poeple")
    there = ", ".join(find_dictionaries())
    assert caught.value.problems == (
        f"command line, dictionary: no file {folder / 'poeple'}, and no installed dictionary "
        f"'poeple'; installed: {there}",
    )


def test_every_command_with_a_dictionary_takes_a_name():
    view = load_config(
        "view", None, (), {"files": ("a.h5",), "dictionary": "people", "output": "page.html"}
    )
    assert view.dictionary == PEOPLE


def test_python_takes_a_name_too():
    assert shapefit.read_dictionary("people").landmark_names == (*PEOPLE_JOINTS, *FURTHER)
