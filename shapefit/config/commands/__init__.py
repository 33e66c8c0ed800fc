"""The config of each command, imported when it is used: a schema takes long to build."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from shapefit.config.model import CommandConfig

NAMES = {
    "learn-dict": "LearnDictConfig",
    "project": "ProjectConfig",
    "fit": "FitConfig",
    "eval": "EvalConfig",
    "convert": "ConvertConfig",
    "info": "InfoConfig",
    "view": "ViewConfig",
}
"""Command -> the name of its config."""


class _Configs(Mapping[str, type[CommandConfig]]):
    """Command -> its config."""

    def __getitem__(self, command: str) -> type[CommandConfig]:
        if command == "fit":
            from shapefit.config.commands import fit as module
        elif command == "learn-dict":
            from shapefit.config.commands import learn_dict as module
        elif command == "eval":
            from shapefit.config.commands import evaluate as module
        else:
            from shapefit.config.commands import files as module
        config: type[CommandConfig] = getattr(module, NAMES[command])
        return config

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)


CONFIGS = _Configs()
