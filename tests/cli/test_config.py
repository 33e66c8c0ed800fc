"""`shapefit config`, and configs that are printed before their inputs are known."""

import pytest
from shapefit.cli.commands import COMMANDS

from shapefit.config import CONFIGS, load_config
from shapefit.config.model import dotted_keys, field_keys

NAMES = [spec.name for spec in COMMANDS]


@pytest.mark.parametrize("command", NAMES)
def test_every_key_is_listed_with_default_and_meaning(shapefit, command):
    told = shapefit("config", command)
    assert told.code == 0
    listed = {line.split(":")[0] for line in told.out.splitlines() if line[0] != " "}
    keys = set(dotted_keys(CONFIGS[command])) - {"data", "storage_options"}
    sections = {key.rpartition(".")[0] for key in keys}
    assert {key for key in keys - listed if "." not in key} <= sections | listed
    assert listed <= keys


@pytest.mark.parametrize("command", NAMES)
def test_a_config_is_printed_without_inputs(shapefit, command):
    told = shapefit(command, "--print-config")
    assert (told.code, told.err) == (0, "")
    printed = {line.split(":")[0] for line in told.out.splitlines() if line[0] not in " -"}
    assert printed == set(field_keys(CONFIGS[command]))


def test_a_printed_config_serves_once_its_inputs_are_given(shapefit, folder):
    printed = shapefit("fit", "--set", "lambda=2", "--print-config").out
    (folder / "printed.yaml").write_text(printed)
    inputs = {"landmarks": ("views.h5",), "dictionary": "dict.h5", "output": "result.h5"}
    config = load_config("fit", folder / "printed.yaml", (), inputs)
    assert config == load_config("fit", None, ("lambda=2",), inputs)
