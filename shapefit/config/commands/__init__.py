"""The config of each command, imported when used: a schema takes long to build."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from shapefit.config.model import CommandConfig

CONFIGURED = ("learn-dict", "project", "fit", "eval", "convert", "info", "view")
"""Commands that have a config."""


class _Configs(Mapping[str, type[CommandConfig]]):
    """Command -> its config, such as LearnDictConfig of learn-dict."""

    def __getitem__(self, command: str) -> type[CommandConfig]:
        if command not in CONFIGURED:
            raise KeyError(command)
        if command == "fit":
            from shapefit.config.commands.fit import FitConfig

            return FitConfig
        from shapefit.config.commands import others

        name = f"{command.title().replace('-', '')}Config"
        config: type[CommandConfig] = getattr(others, name)
        return config

    def __iter__(self) -> Iterator[str]:
        return iter(CONFIGURED)

    def __len__(self) -> int:
        return len(CONFIGURED)


CONFIGS = _Configs()
