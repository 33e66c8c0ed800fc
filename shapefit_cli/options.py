"""The options that every command has."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"

Command = Callable[..., Any]


def _show_tracebacks(_context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        os.environ[TRACEBACK_VARIABLE] = "1"


traceback_option = click.option(
    "--traceback",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_tracebacks,
    help=f"Show where an internal error arose (as {TRACEBACK_VARIABLE}=1 does).",
)


def common_options(command: Command) -> Command:
    """Add -c, --set, --print-config and --traceback to a command."""
    for option in (
        traceback_option,
        click.option(
            "--print-config",
            is_flag=True,
            help="Print the config with every default as YAML, and exit.",
        ),
        click.option(
            "--set",
            "overrides",
            metavar="KEY=VALUE",
            multiple=True,
            help="Set a key of the config, or a key inside one: --set a.b=c. Repeatable.",
        ),
        click.option(
            "-c",
            "--config",
            "config_path",
            metavar="CONFIG",
            type=click.Path(path_type=Path),
            help="YAML config; - is stdin. Its keys are described in docs/config.md.",
        ),
    ):
        command = option(command)
    return command
