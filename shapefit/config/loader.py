"""From a YAML file, `--set` options and arguments to a checked config, and back to YAML.

The name of an installed config stands for a file: `cars` of `fit` is `configs/cars/fit.yaml`.
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from shapefit.config.model import CommandConfig, with_all_optional
from shapefit.config.paths import STANDARD_STREAM
from shapefit.config.settings import STANDARD_INPUT, Settings, check
from shapefit.errors import input_error
from shapefit.stores import use_storage_options

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


class Schemas(Mapping[str, type[CommandConfig]]):
    """The config of each command, imported when it is asked for: a schema takes long to build."""

    def __init__(self, places: Mapping[str, str]) -> None:
        self.places = places

    def __getitem__(self, command: str) -> type[CommandConfig]:
        module, _, name = self.places[command].rpartition(".")
        schema: type[CommandConfig] = getattr(importlib.import_module(module), name)
        return schema

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


CONFIGS = Schemas(
    {
        "learn-dict": "shapefit.config.commands.learn_dict.LearnDictConfig",
        "fit": "shapefit.config.commands.fit.FitConfig",
        "eval": "shapefit.config.commands.evaluate.EvalConfig",
        "project": "shapefit.config.commands.project.ProjectConfig",
        "convert": "shapefit.config.commands.files.ConvertConfig",
        "info": "shapefit.config.commands.files.InfoConfig",
        "view": "shapefit.config.commands.view.ViewConfig",
    }
)


def load_config(
    command: str,
    file: Path | ConfigFile | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, object] | None = None,
    *,
    to_show: bool = False,
    final: bool = True,
) -> CommandConfig:
    """Return the checked config of `command`.

    `file` is a YAML file or a preset (`find_config`). `overrides` (each `a.b=value`) override what
    it says, and `arguments` (key -> value; None and empty ones do not count) both. Paths in the
    file are relative to the file, the others to the working directory; in the config they are
    absolute and globs are expanded. A config `to_show` may lack what is required, which is None
    then, and one that is not `final` may set keys without effect. Raises InputError with every
    problem at once, each with its place, and where standard input would be read twice.
    """
    file = ConfigFile(file) if isinstance(file, Path) else file
    schema = with_all_optional(CONFIGS[command]) if to_show else CONFIGS[command]
    settings = Settings(schema)
    if file is not None:
        settings.read_file(file.path, is_preset=file.is_preset)
    for option in overrides:
        settings.set_option(option)
    for key, value in (arguments or {}).items():
        if value is not None and value != ():
            settings.set_argument(key, value)
    use_storage_options({})  # those of an earlier config do not count
    config = check(schema, settings, final=final)
    readers = ["the config"] if file and file.path == STANDARD_STREAM else []
    readers += [f"`{key}`" for key, file in config.inputs() if file == STANDARD_STREAM]
    if len(readers) > 1:
        found = f"{' and '.join(readers)} would both read it"
        raise input_error(STANDARD_INPUT, found, "name a file for one of them")
    return config


def dump_config(config: CommandConfig) -> str:
    """Return the config as YAML, every default spelled out; it loads again to the same config."""
    from ruamel.yaml import YAML

    text = io.StringIO()
    YAML().dump(config.as_plain(), text)
    return text.getvalue()
