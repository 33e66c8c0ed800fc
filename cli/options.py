"""The options that commands share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"


def option(names: str, help: str, metavar: str | None = None, **settings: Any) -> click.Option:
    """Return an option of these names, with a space between them; without metavar it is a flag."""
    settings |= {"is_flag": True} if metavar is None else {}
    return click.Option(names.split(), metavar=metavar, help=help, **settings)


def _show_tracebacks(_context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        os.environ[TRACEBACK_VARIABLE] = "1"


def _not_both(context: click.Context, _option: click.Parameter, verbose: bool) -> bool:
    if verbose and context.params.get("quiet"):
        raise click.UsageError("-q and -v exclude each other; give one of them", context)
    return verbose


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
    from shapefit.config.paths import find_dictionaries

    return find_dictionaries()


DICTIONARY = Named(_dictionaries, "installed dictionary")
"""A file, or the name of an installed dictionary."""


def _configs(command: str) -> Iterable[str]:
    from shapefit.config.loader import find_presets

    return find_presets(command)


def config_options(command: str) -> list[click.Option]:
    """Return -c, --set and --print-config, which every command with a config has."""
    config = "YAML config, or the name of an installed one, such as cars; - is stdin. The keys "
    config += f"are listed by `shapefit config {command}`."
    key = "Set a key of the config, or a key inside one: --set a.b=c. Repeatable."
    names = Named(partial(_configs, command), "installed config")
    return [
        option("-c --config config_path", config, "CONFIG", type=names),
        option("--set overrides", key, "KEY=VALUE", multiple=True),
        option("--print-config", "Print the config with every default as YAML, and exit."),
        option("--json as_json", "Print what was done as JSON to stdout."),
    ]


def reporting_options() -> list[click.Option]:
    """Return -q, -v and --traceback, which every command has."""
    everything = "List every warning, failed item and written file, and name the config."
    where = f"Show where an internal error arose (as {TRACEBACK_VARIABLE}=1 does)."
    show = partial(option, "--traceback", callback=_show_tracebacks)
    return [
        option("-q --quiet", "Print only errors and failed items.", is_eager=True),
        option("-v --verbose", everything, callback=_not_both),
        show(where, is_eager=True, expose_value=False),
    ]
