"""Options of the command line: those that are keys of a config, and those that commands share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"


class Key(NamedTuple):
    """An option that sets a key of the config, `a.b` in a section."""

    key: str
    option: click.Option


def key(
    names: str,
    help: str,
    metavar: str | None,
    type: Any = None,
    *,
    to: str = "",
    multiple: bool = False,
) -> Key:
    """Return the option of these names for the key `to`, by default called as the last name.

    Without metavar it is a flag, which is None where it is not given.
    """
    to = to or names.split()[-1].lstrip("-").replace("-", "_")
    settings: dict[str, Any] = {"type": type, "multiple": multiple}
    if metavar is None:
        settings = {"default": None, "is_flag": True}
    return Key(to, option(f"{names} {identifier(to)}", help, metavar, **settings))


def identifier(key: str) -> str:
    """Return a key as click names a parameter."""
    return f"key_{key.replace('.', '__')}"


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

    def __init__(self, names: Callable[[], Iterable[str]]) -> None:
        self._names = names

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the names that begin so; where none does, files."""
        from click.shell_completion import CompletionItem

        found = [CompletionItem(name) for name in self._names() if name.startswith(incomplete)]
        return found or click.Path().shell_complete(ctx, param, incomplete)


def _dictionaries() -> Iterable[str]:
    from shapefit.config.paths import find_dictionaries

    return find_dictionaries()


DICTIONARY = Named(_dictionaries)
"""A file, or the name of an installed dictionary."""


def _configs(command: str) -> Iterable[str]:
    from shapefit.config.loader import find_presets

    return find_presets(command)


def config_options(command: str) -> list[click.Option]:
    """Return -c, --set and --print-config, which every command with a config has."""
    config = "Config file (- is stdin), or the name of an installed one."
    keys = f"Set any key of the config (shapefit config {command}). Repeatable."
    return [
        option("-c --config config_path", config, "CONFIG", type=Named(partial(_configs, command))),
        option("--set overrides", keys, "KEY=VALUE", multiple=True),
        option("--print-config", "Print the config with every default as YAML, and exit."),
    ]


def reporting_options() -> list[click.Option]:
    """Return --json, -q, -v and --traceback, which every command has."""
    where = f"Show where an internal error arose (as {TRACEBACK_VARIABLE}=1 does)."
    show = partial(option, "--traceback", callback=_show_tracebacks)
    return [
        option("--json as_json", "Print one JSON object to stdout at the end."),
        option("-q --quiet", "Print only errors and failed items.", is_eager=True),
        option("-v --verbose", "Show all warnings, failed items and files.", callback=_not_both),
        show(where, is_eager=True, expose_value=False),
    ]
