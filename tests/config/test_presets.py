"""`-c NAME`: the command's own file of an installed folder, its settings without its data."""

from pathlib import Path

import pytest

from shapefit.config import find_config, load_config
from shapefit.config.loader import find_presets, presets_folder
from shapefit.errors import InputError


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    for name in ("a.h5", "d.h5"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load(command, name, options=(), **arguments):
    return load_config(command, find_config(command, Path(name)), options, arguments)


MINE = {"landmarks": ("a.h5",), "dictionary": "d.h5", "output": "r.h5"}


def test_a_name_is_the_file_of_the_command():
    for command in ("learn-dict", "fit", "eval"):
        file = find_config(command, Path("cars"))
        assert file == (presets_folder() / "cars" / f"{command}.yaml", True)
    assert "cars" not in find_presets("project")


def test_sequences_are_a_second_way_to_fit_people():
    file = presets_folder() / "people" / "sequences.yaml"
    assert find_config("fit", Path("sequences")) == (file, True)
    assert load("fit", "sequences", **MINE).method == "sequences"
    assert "sequences" not in find_presets("eval")


def test_the_settings_of_a_preset_work_on_files_of_the_user(folder):
    config = load("fit", "cars", **MINE)
    assert (config.method, config.lam) == ("convex+refine", 1.0)
    assert config.camera.model == "perspective"
    assert config.landmarks == (folder / "a.h5",)


def test_what_a_preset_says_of_its_own_data_is_left_out():
    config = load("fit", "cars", **MINE)
    assert config.data is None
    assert config.leave_out is None
    assert config.camera.principal_point is None
    assert config.export.folder is None
    assert config.pictures.folder is None
    report = load("eval", "cars", results=("a.h5",), truth=("d.h5",), output="report")
    assert (report.match, report.groups) == ("item", {})
    assert report.least_visible == 20


def test_settings_of_outputs_count_where_their_folder_is_named(folder):
    config = load("fit", "cars", ["export.folder=meshes"], **MINE)
    assert (config.export.folder, config.export.unit) == (folder / "meshes", "dictionary")
    with pytest.raises(InputError, match="`unit` does nothing without `folder`"):
        load("fit", "cars", ["export.unit=dictionary"], **MINE)


def test_files_must_be_named():
    with pytest.raises(InputError) as caught:
        load("fit", "cars")
    missing = [line.split("missing key ")[1].split()[0] for line in caught.value.problems]
    assert missing == ["'landmarks'", "'dictionary'", "'output'"]


def test_a_file_wins_and_a_folder_does_not(folder):
    (folder / "cars").mkdir()
    assert find_config("fit", Path("cars")).is_preset
    (folder / "cars").rmdir()
    (folder / "cars").write_text("lambda: 7\n")
    assert find_config("fit", Path("cars")) == (Path("cars"), False)
    assert load("fit", "cars", **MINE).lam == 7


def test_the_path_of_an_installed_file_keeps_its_data(project):
    config = load_config("project", project / "configs/mocap/project.yaml")
    assert config.output == project / "results/mocap/landmarks.h5"


@pytest.mark.parametrize("name", ["carz", "configs/cars", "cars/fit"])
def test_an_unknown_name_lists_those_that_there_are(name):
    with pytest.raises(InputError) as caught:
        find_config("fit", Path(name))
    known = ", ".join(find_presets("fit"))
    assert "cars" in known
    assert caught.value.problems == (
        f"{name}: no such file; name a YAML file, or one of the installed configs: {known}",
    )


def test_a_folder_without_a_name_is_no_config(folder):
    (folder / "mine").mkdir()
    with pytest.raises(InputError, match="mine: it is a folder; name a YAML file, or one of"):
        find_config("fit", Path("mine"))


@pytest.mark.parametrize("command", ["learn-dict", "fit", "eval", "project"])
def test_every_preset_is_right_but_for_files(command):
    arguments = {
        "learn-dict": {"shapes": ("a.h5",)},
        "fit": {"landmarks": ("a.h5",), "dictionary": "d.h5"},
        "eval": {"results": ("a.h5",), "truth": ("d.h5",)},
        "project": {"shapes": ("a.h5",)},
    }[command]
    names = find_presets(command)
    assert names
    for name in names:
        load(command, name, output="out", **arguments)
