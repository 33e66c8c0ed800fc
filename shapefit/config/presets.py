"""Installed configs that a name stands for: `cars` of `fit` is `configs/cars/fit.yaml`."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from shapefit.config.paths import STANDARD_STREAM
from shapefit.errors import input_error

_PACKAGE = Path(__file__).resolve().parents[1]


class ConfigFile(NamedTuple):
    """The YAML file of a config; of a preset only settings count, not what it says of its data."""

    path: Path
    is_preset: bool = False


def presets_folder() -> Path:
    """Return the folder of installed configs: in the package, or beside it in a checkout."""
    installed = _PACKAGE / "configs"
    return installed if installed.is_dir() else _PACKAGE.parent / "configs"


def preset_names(command: str) -> list[str]:
    """Return the names that have a file for the command, sorted."""
    return sorted(file.parent.name for file in presets_folder().glob(f"*/{command}.yaml"))


def find_config(command: str, path: Path | None) -> ConfigFile | None:
    """Return the config file of `command` that a path or the name of a preset stands for.

    A file wins over a preset of the same name. Raises InputError where there is neither.
    """
    if path is None:
        return None
    if path == STANDARD_STREAM or (path.exists() and not path.is_dir()):
        return ConfigFile(path)
    names = preset_names(command)
    if str(path) in names:
        return ConfigFile(presets_folder() / path / f"{command}.yaml", is_preset=True)
    found = "it is a folder" if path.is_dir() else "no such file"
    known = f"or one of the installed configs: {', '.join(names)}" if names else "to read"
    raise input_error(path, found, f"name a YAML file, {known}")
