"""The config of simulate: its defaults, and what it does not accept."""

import pytest

from shapefit.config import SimulateConfig, dump_config, load_config
from shapefit.errors import InputError


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load(*options):
    return load_config("simulate", None, options, {"output": "report"})


def test_defaults_are_the_grid_of_the_paper(folder):
    config = load()
    assert isinstance(config, SimulateConfig)
    assert config.landmarks == (5, 10, 15, 20, 25, 30, 35, 40, 45, 50)
    assert config.active_atoms == (1, 2, 3, 4, 5, 6, 7, 8, 9, 10)
    assert (config.k, config.trials) == (50, 100)
    assert config.output == folder / "report"


def test_the_printed_config_loads_again(project, folder):
    config = load_config("simulate", project / "configs/recovery.yaml")
    (folder / "printed.yaml").write_text(dump_config(config), encoding="utf-8")
    assert load_config("simulate", folder / "printed.yaml") == config


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("landmarks=[]", "expected at least one number, found an empty list"),
        ("landmarks=[5, 5]", "expected different numbers, found [5, 5]"),
        ("landmarks=[1]", "expected a list of whole numbers >= 2, found 1"),
        ("landmarks=5", "expected a list of whole numbers >= 2, found 5"),
        ("active_atoms=[0]", "expected a list of whole numbers >= 1, found 0"),
        (
            "active_atoms=[51]",
            "expected numbers of atoms in use up to k = 50, found 51; "
            "leave out larger numbers, or raise k",
        ),
        ("trials=0", "expected a whole number >= 1, found 0"),
        ("translation=no", "expected free or none, found 'no'; did you mean 'none'?"),
        ("landmark=[5]", "unknown key 'landmark'; did you mean 'landmarks'?"),
    ],
)
def test_problems(option, expected):
    with pytest.raises(InputError) as caught:
        load(option)
    assert caught.value.problems == (f"--set {option}: {expected}",)
