"""`shapefit config`: the keys of a command, without a config of its own."""

from __future__ import annotations

import shutil

import click

from .commands import COMMANDS


def _config(command: str, section: str) -> int:
    from shapefit.config.reference import keys_text

    width = min(100, shutil.get_terminal_size().columns)
    click.echo(keys_text(command, section, width), nl=False)
    return 0


config = click.Command(
    "config",
    callback=_config,
    params=[
        click.Argument(["command"], type=click.Choice([spec.name for spec in COMMANDS])),
        click.Argument(["section"], required=False, default=""),
    ],
    short_help="List the config keys of a command.",
    help="""List the config keys of a command: what each expects, its default, what it means.

SECTION is a section of the config, or a single key: only those are listed.""",
    epilog="""\b
Examples:
  shapefit config fit
  shapefit config fit camera
  shapefit config learn-dict prior.components
""",
)
