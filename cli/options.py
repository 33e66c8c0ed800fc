"""The options that commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"


def _show_tracebacks(_context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        os.environ[TRACEBACK_VARIABLE] = "1"


def _not_both(context: click.Context, _option: click.Parameter, verbose: bool) -> bool:
    if verbose and context.params.get("quiet"):
        raise click.UsageError("-q and -v exclude each other; give one of them", context)
    return verbose


class _ConfigPath(click.Path):
    """A file, or the name of a folder of installed configs."""

    def __init__(self, command: str) -> None:
        super().__init__(path_type=Path)
        self._command = command

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the names of installed configs, and files."""
        from click.shell_completion import CompletionItem

        from shapefit.config.loader import find_presets

        names = [name for name in find_presets(self._command) if name.startswith(incomplete)]
        files = super().shell_complete(ctx, param, incomplete)
        return [CompletionItem(name, help="installed config") for name in names] or files


class LocationPath(click.Path):
    """A file, or a URL of an object store."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of what was given."""
        from shapefit.stores.locations import location

        return location(value)


class DictionaryPath(click.types.StringParamType):
    """A file, or the name of an installed dictionary."""

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the names of installed dictionaries, and files."""
        from click.shell_completion import CompletionItem

        from shapefit.config.named_files import find_dictionaries

        names = [name for name in find_dictionaries() if name.startswith(incomplete)]
        files = click.Path().shell_complete(ctx, param, incomplete)
        return [CompletionItem(name, help="installed dictionary") for name in names] or files


class _Setting(click.types.StringParamType):
    """`key=value` for a key of the config of a command."""

    def __init__(self, command: str) -> None:
        self._command = command

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the keys of the config."""
        from click.shell_completion import CompletionItem

        from shapefit.config import CONFIGS
        from shapefit.config.model import dotted_keys

        keys = dotted_keys(CONFIGS[self._command])
        return [CompletionItem(f"{key}=") for key in keys if key.startswith(incomplete)]


def config_options(command: str) -> list[click.Parameter]:
    """Return -c, --set and --print-config, which every command with a config has."""
    return [
        click.Option(
            ["-c", "--config", "config_path"],
            metavar="CONFIG",
            type=_ConfigPath(command),
            help="YAML config, or the name of an installed one, such as cars; - is stdin. The keys "
            f"are listed by `shapefit config {command}`.",
        ),
        click.Option(
            ["--set", "overrides"],
            metavar="KEY=VALUE",
            multiple=True,
            type=_Setting(command),
            help="Set a key of the config, or a key inside one: --set a.b=c. Repeatable.",
        ),
        click.Option(
            ["--print-config"],
            is_flag=True,
            help="Print the config with every default as YAML, and exit.",
        ),
    ]


def reporting_options() -> list[click.Parameter]:
    """Return -q, -v and --traceback, which every command has."""
    return [
        click.Option(
            ["-q", "--quiet"],
            is_flag=True,
            is_eager=True,
            help="Print only errors and failed items.",
        ),
        click.Option(
            ["-v", "--verbose"],
            is_flag=True,
            callback=_not_both,
            help="List every warning, failed item and written file, and name the config.",
        ),
        click.Option(
            ["--traceback"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_show_tracebacks,
            help=f"Show where an internal error arose (as {TRACEBACK_VARIABLE}=1 does).",
        ),
    ]
