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
        match command:
            case "fit":
                from shapefit.config.commands.fit import FitConfig

                return FitConfig
            case "learn-dict":
                from shapefit.config.commands.learn_dict import LearnDictConfig

                return LearnDictConfig
            case "eval":
                from shapefit.config.commands.evaluate import EvalConfig

                return EvalConfig
        from shapefit.config.commands.files import FILES

        return FILES[command]

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)


CONFIGS = _Configs()
