"""The config of each command, imported when it is used: a schema takes long to
build.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from shapefit.config.model import CommandConfig

COMMANDS = ("learn-dict", "project", "fit", "eval", "convert", "info", "view")


class _Configs(Mapping[str, type[CommandConfig]]):
    """Command -> its config, such as LearnDictConfig of learn-dict."""

    def __getitem__(self, command: str) -> Any:
        if command == "fit":
            from shapefit.config.commands.fit import FitConfig

            return FitConfig
        from shapefit.config.commands import others

        return getattr(others, f"{command.title().replace('-', '')}Config")

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


CONFIGS = _Configs()
