"""The config of each command, imported when it is used: a schema takes long to build."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from shapefit.config.model import CommandConfig

COMMANDS = ("learn-dict", "project", "fit", "eval", "convert", "info", "view")


class _Configs(Mapping[str, type[CommandConfig]]):
    """Command -> its config."""

    def __getitem__(self, command: str) -> type[CommandConfig]:
        if command == "fit":
            from shapefit.config.commands.fit import FitConfig

            return FitConfig
        if command == "learn-dict":
            from shapefit.config.commands.learn_dict import LearnDictConfig

            return LearnDictConfig
        from shapefit.config.commands.others import OTHERS

        return OTHERS[command]

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


CONFIGS = _Configs()
