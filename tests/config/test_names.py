"""`-c NAME`, an installed config without its data, and `-d NAME`, an installed dictionary."""

from pathlib import Path

import pytest

import shapefit
from shapefit.config import find_config, load_config
from shapefit.config.loader import find_presets, presets_folder
from shapefit.config.paths import DICTIONARIES, find_dictionaries
from shapefit.errors import InputError
from shapefit.io.skeletons import FURTHER
from shapefit.io.skeletons import PEOPLE as PEOPLE_JOINTS

PEOPLE = DICTIONARIES / "people.h5"

MINE = {"landmarks": ("a.h5",), "dictionary": "d.h5", "output": "r.h5"}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    for name in ("a.h5", "d.h5"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load(command, name, options=(), **arguments):
    return load_config(command, find_config(command, Path(name)), options, arguments)


def dictionary_of(name):
    return load_config("fit", None, (), MINE | {"dictionary": name}).dictionary


@pytest.mark.parametrize(
    ("command", "name", "file"),
    [
        *((command, "cars", f"cars/{command}.yaml") for command in ("learn-dict", "fit", "eval")),
        ("fit", "sequences", "people/sequences.yaml"),
    ],
)
def test_a_name_is_the_file_of_the_command(command, name, file):
    assert find_config(command, Path(name)) == (presets_folder() / file, True)
    assert name not in find_presets("project")


@pytest.mark.parametrize(("name", "method"), [("people", "posterior"), ("sequences", "sequences")])
def test_people_need_no_file_but_the_landmarks(name, method):
    config = load("fit", name, **(MINE | {"dictionary": "people"}))
    assert (config.method, config.dictionary) == (method, PEOPLE)


def test_the_settings_of_a_preset_count_without_what_it_says_of_its_data(folder):
    config = load("fit", "cars", **MINE)
    assert (config.method, config.lam, config.camera.model) == ("convex+refine", 1.0, "perspective")
    assert config.landmarks == (folder / "a.h5",)
    assert config.data is config.leave_one_out is config.camera.principal_point is None
    assert config.export.folder is None
    report = load("eval", "cars", results=("a.h5",), truth=("d.h5",), output="report")
    assert (report.match, report.groups, report.least_visible) == ("item", {}, 20)


def test_files_must_be_named():
    with pytest.raises(InputError) as caught:
        load("fit", "cars")
    missing = [line.split("missing key ")[1].split()[0] for line in caught.value.problems]
    assert missing == ["'landmarks'"]


def test_a_file_wins_and_a_folder_does_not(folder):
    for name in ("cars", "people"):
        (folder / name).mkdir()
    assert find_config("fit", Path("cars")).is_preset
    assert dictionary_of("people") == PEOPLE
    for name in ("cars", "people"):
        (folder / name).rmdir()
        (folder / name).write_text("lambda: 7\n")
    assert find_config("fit", Path("cars")) == (Path("cars"), False)
    assert load("fit", "cars", **MINE).lam == 7
    assert dictionary_of("people") == folder / "people"


def test_a_config_names_a_dictionary_unless_a_file_beside_the_config_does(folder):
    (folder / "configs").mkdir()
    config = folder / "configs" / "fit.yaml"
    config.write_text("landmarks: ../a.h5\ndictionary: people\noutput: r.h5\n")
    assert load_config("fit", config).dictionary == PEOPLE
    (folder / "people").touch()
    assert load_config("fit", config).dictionary == PEOPLE
    (folder / "configs" / "people").touch()
    assert load_config("fit", config).dictionary == folder / "configs" / "people"


def test_the_path_of_an_installed_file_keeps_its_data(project):
    config = load_config("project", project / "configs/demo/project.yaml")
    assert config.output == project / "results/demo/landmarks.h5"


@pytest.mark.parametrize("name", ["carz", "configs/cars", "cars/fit", "mine"])
def test_an_unknown_config_lists_those_that_there_are(folder, name):
    (folder / "mine").mkdir()
    with pytest.raises(InputError) as caught:
        find_config("fit", Path(name))
    known = ", ".join(find_presets("fit"))
    assert "cars" in known
    found = "it is a folder" if name == "mine" else "no such file"
    assert caught.value.problems == (
        f"{name}: {found}; name a YAML file, or one of the installed configs: {known}",
    )


def test_an_unknown_dictionary_lists_those_that_there_are(folder):
    with pytest.raises(InputError) as caught:
        dictionary_of("poeple")
    assert caught.value.problems == (
        f"command line, dictionary: no file {folder / 'poeple'}, and no installed dictionary "
        f"'poeple'; installed: {', '.join(find_dictionaries())}",
    )


@pytest.mark.parametrize("path", ["models/people", "./people", "people.h5"])
def test_a_path_is_no_name(path, folder):
    with pytest.raises(InputError, match=r"no file .*people(\.h5)?; check the spelling"):
        dictionary_of(path)
    config = folder / "fit.yaml"
    config.write_text(f"landmarks: a.h5\ndictionary: {path}\noutput: r.h5\n")
    with pytest.raises(InputError, match="check the spelling"):
        load_config("fit", config)


def test_every_command_with_a_dictionary_takes_a_name_and_python_too(folder):
    (folder / "people").mkdir()
    given = {"files": ("a.h5",), "dictionary": "people", "output": "page.html"}
    assert load_config("view", None, (), given).dictionary == PEOPLE
    assert shapefit.read_dictionary("people").landmark_names == (*PEOPLE_JOINTS, *FURTHER)


@pytest.mark.parametrize(
    ("command", "given"),
    [
        ("learn-dict", {"shapes": ("a.h5",)}),
        ("fit", {"landmarks": ("a.h5",), "dictionary": "d.h5"}),
        ("eval", {"results": ("a.h5",), "truth": ("d.h5",)}),
        ("project", {"shapes": ("a.h5",)}),
    ],
)
def test_every_preset_is_right_but_for_files(command, given):
    names = find_presets(command)
    assert names
    for name in names:
        load(command, name, output="out", **given)
