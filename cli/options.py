"""The options that commands share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from functools import partial
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


class LocationPath(click.Path):
    """A file, or a URL of an object store."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of what was given."""
        from shapefit.stores import location

        return location(value)


class Named(click.types.StringParamType):
    """A text that the shell completes: with one of these names, or else with a file."""

    def __init__(self, names: Callable[[], Iterable[str]], help: str = "") -> None:
        self._names, self._help = names, help

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the names that begin so; where none does, and they are of files, files."""
        from click.shell_completion import CompletionItem

        fitting = [name for name in self._names() if name.startswith(incomplete)]
        found = [CompletionItem(name, help=self._help or None) for name in fitting]
        files = click.Path().shell_complete(ctx, param, incomplete) if self._help else []
        return found or files


def _dictionaries() -> Iterable[str]:
    from shapefit.config.named_files import find_dictionaries

    return find_dictionaries()


DICTIONARY = Named(_dictionaries, "installed dictionary")
"""A file, or the name of an installed dictionary."""


def _configs(command: str) -> Iterable[str]:
    from shapefit.config.loader import find_presets

    return find_presets(command)


def _settings(command: str) -> Iterable[str]:
    from shapefit.config import CONFIGS
    from shapefit.config.model import dotted_keys

    return (f"{key}=" for key in dotted_keys(CONFIGS[command]))


def config_options(command: str) -> list[click.Parameter]:
    """Return -c, --set and --print-config, which every command with a config has."""
    return [
        click.Option(
            ["-c", "--config", "config_path"],
            metavar="CONFIG",
            type=Named(partial(_configs, command), "installed config"),
            help="YAML config, or the name of an installed one, such as cars; - is stdin. The keys "
            f"are listed by `shapefit config {command}`.",
        ),
        click.Option(
            ["--set", "overrides"],
            metavar="KEY=VALUE",
            multiple=True,
            type=Named(partial(_settings, command)),
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
