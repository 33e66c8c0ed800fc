"""Installed configs that a name stands for: `cars` of `fit` is `configs/cars/fit.yaml`."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from shapefit.config.paths import STANDARD_STREAM
from shapefit.errors import input_error

_PACKAGE = Path(__file__).resolve().parents[1]

WHOLE_SEQUENCES = "people/sequences.yaml"
"""A second way to fit people, so a file of that name beside the one for single images."""


class ConfigFile(NamedTuple):
    """The YAML file of a config; of a preset only settings count, not what it says of its data."""

    path: Path
    is_preset: bool = False


def presets_folder() -> Path:
    """Return the folder of installed configs: in the package, or beside it in a checkout."""
    installed = _PACKAGE / "configs"
    return installed if installed.is_dir() else _PACKAGE.parent / "configs"


def find_presets(command: str) -> dict[str, Path]:
    """Return the files of the command by the names that stand for them, sorted."""
    files = {file.parent.name: file for file in presets_folder().glob(f"*/{command}.yaml")}
    if command == "fit":
        files |= {file.stem: file for file in presets_folder().glob(WHOLE_SEQUENCES)}
    return dict(sorted(files.items()))


def find_config(command: str, path: Path | None) -> ConfigFile | None:
    """Return the config file of `command` that a path or the name of a preset stands for.

    A file wins over a preset of the same name. Raises InputError where there is neither.
    """
    if path is None:
        return None
    if path == STANDARD_STREAM or (path.exists() and not path.is_dir()):
        return ConfigFile(path)
    presets = find_presets(command)
    if str(path) in presets:
        return ConfigFile(presets[str(path)], is_preset=True)
    found = "it is a folder" if path.is_dir() else "no such file"
    known = f"or one of the installed configs: {', '.join(presets)}" if presets else "to read"
    raise input_error(path, found, f"name a YAML file, {known}")
